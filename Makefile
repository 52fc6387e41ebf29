# Everything runs in .venv, made on first use. Needs Rust and Python ≥ 3.10 with venv.
PYTHON ?= python3
BIN := .venv/bin
SOURCES := Cargo.toml Cargo.lock pyproject.toml $(shell find crates/stillflux crates/stillflux-sim crates/stillflux-py \
	-name '*.rs' -o -name Cargo.toml)

# As maturin sets it: one build of pyo3 serves extension, tests and lints, and none links to an interpreter.
export PYO3_BUILD_EXTENSION_MODULE := 1
export PYO3_PYTHON := $(abspath $(BIN)/python)
export VIRTUAL_ENV := $(abspath .venv)

.PHONY: demo test test-slow test-rust lint bench build clean

demo: build
	$(BIN)/stillflux demo

build: .venv/built

.venv/installed: requirements.lock
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check -r requirements.lock
	touch $@

.venv/built: .venv/installed $(SOURCES)
	$(BIN)/maturin develop --release --quiet >/dev/null
	touch $@

test-rust: .venv/installed
	cargo test --workspace --locked

test: test-rust build
	$(BIN)/python -m pytest -q -m "not slow"

test-slow: test-rust build
	$(BIN)/python -m pytest -q

lint: build
	cargo fmt --all --check
	cargo clippy --workspace --all-targets --locked -- -D warnings
	$(BIN)/ruff format --check python tests
	$(BIN)/ruff check python tests
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest stillflux._core

bench:
	cargo bench

clean:
	rm -rf .venv target reports python/stillflux/*.so
