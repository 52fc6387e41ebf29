# Everything runs in .venv, made on first use. Needs Rust and Python ≥ 3.10 with venv.
PYTHON ?= python3
BIN := .venv/bin
SOURCES := Cargo.toml Cargo.lock pyproject.toml $(shell find crates/stillflux crates/stillflux-sim crates/stillflux-py \
	-path '*/src/*.rs' -o -name Cargo.toml)

# As maturin sets it: one build of pyo3 serves extension, tests and lints, and none links to an interpreter.
export PYO3_BUILD_EXTENSION_MODULE := 1
export PYO3_PYTHON := $(abspath $(BIN)/python)
export VIRTUAL_ENV := $(abspath .venv)

.PHONY: demo reproduce beyond tolerance sensitivity metrics docs test test-builds test-slow test-rust lint bench bench-tools
.PHONY: build clean

demo: build
	$(BIN)/stillflux demo

build: .venv/built

.venv/made:
	$(PYTHON) -m venv .venv
	touch $@

# Without bytecode: most of what is installed is never imported.
.venv/installed: requirements.lock | .venv/made
	$(BIN)/pip install --quiet --disable-pip-version-check --no-compile -r requirements.lock
	touch $@

.venv/built: .venv/installed $(SOURCES)
	$(BIN)/maturin develop --release --locked --quiet >/dev/null
	touch $@

# Cargo has jobs of its own: those of make would only make rustdoc warn.
test-rust: .venv/made
	MAKEFLAGS= cargo test --locked

# One process a core; the tests of a file stay together, for the runs that they share. What is skipped is named.
PYTEST := $(BIN)/python -m pytest -q -rs -n auto --dist loadfile --no-loadscope-reorder < /dev/null

test: test-rust build
	$(PYTEST) -m "not slow and not builds"

# What has to be built for it: images for a Cortex-M under QEMU, the C library, the core with other features.
test-builds: build
	$(PYTEST) -m "not slow and builds"

# All tests, among them 10⁹ periods of random drives: an hour on two cores.
test-slow: test-rust build
	cargo test --locked --tests -- --ignored
	$(PYTEST)

lint: build
	cargo fmt --all --check
	cargo clippy --workspace --all-targets --locked -- -D warnings
	$(BIN)/ruff format --check python tests benches examples docs crates
	$(BIN)/ruff check python tests benches examples docs crates
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest stillflux._core

# Every figure of the paper under twenty realisations: verdicts and report, some ten minutes on two cores.
reproduce: build
	$(BIN)/stillflux reproduce

# The torque-speed plane, crossings, mismatches and starts for each scheme: half an hour on two cores.
beyond: build
	$(BIN)/stillflux beyond

# Every parameter off at once at ten drives: rates of loss and the consistency of the estimate, a quarter of an hour.
tolerance: build
	$(BIN)/stillflux beyond tolerance
	$(BIN)/stillflux beyond consistency

# How far each parameter may be off: some minutes.
sensitivity: build
	$(BIN)/stillflux reproduce 13b 15 18 19 20 --sensitivity

# Brings the committed table of all that was measured up to date, some hours on two cores. Killed, it goes on where it
# was when called again, as long as nothing was built anew.
METRICS := tests/metrics.csv
metrics: build
	@mkdir -p target
	$(BIN)/stillflux reproduce --sensitivity --beyond --metrics $(METRICS) --journal target/metrics.journal
	$(BIN)/stillflux beyond tolerance --metrics $(METRICS) --journal target/tolerance.journal
	$(BIN)/stillflux beyond tolerance --machine drawn --metrics $(METRICS) --journal target/drawn.journal
	$(BIN)/stillflux beyond tolerance --beyond-model --draws 12 --metrics $(METRICS) --journal target/effects.journal
	$(BIN)/stillflux beyond guarantee --metrics $(METRICS) --journal target/guarantee.journal
	$(BIN)/stillflux beyond consistency --metrics $(METRICS) --journal target/consistency.journal
	$(BIN)/stillflux beyond consistency --beyond-model --metrics $(METRICS) --journal target/consistency.journal
	$(BIN)/stillflux beyond commissioning --metrics $(METRICS) --journal target/commissioning.journal
	$(BIN)/stillflux beyond operations --metrics $(METRICS) --journal target/operations.journal

# Writes the committed table into README and docs.
docs: build
	$(BIN)/stillflux docs --metrics $(METRICS)

# Time with criterion, instructions with gungraun where valgrind is there, and one table of both beside the
# target's counts of the last `make firmware-bench`.
bench: bench-tools
	PATH="$(abspath target/tools/bin):$$PATH" cargo bench --locked -p stillflux-benches
	$(PYTHON) benches/table.py

# Library and runner of gungraun must be of one version: that of Cargo.lock.
GUNGRAUN = $(shell sed -n '/^name = "gungraun"$$/{n;s/version = "\(.*\)"/\1/p;}' Cargo.lock)

bench-tools:
	@command -v valgrind >/dev/null || \
		echo "valgrind not found: no instructions will be counted (Debian/Ubuntu: apt-get install valgrind)"
	@! command -v valgrind >/dev/null || \
		PATH="$(abspath target/tools/bin):$$PATH" gungraun-runner --version 2>/dev/null | grep -q "$(GUNGRAUN)" || \
		cargo install gungraun-runner --version $(GUNGRAUN) --locked --root target/tools

# The documentation site, with the examples run: some minutes.
.PHONY: site
site: build
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

# The playground: drive and plant as WebAssembly in a page of static files that opens without a server. Needs a compiler
# for wasm32-unknown-unknown; says so where it is missing. The first build takes one to two minutes.
.PHONY: playground
playground:
	$(PYTHON) crates/stillflux-wasm/playground.py

clean:
	rm -rf .venv target reports python/stillflux/*.so

# --- C: library and header for the host in target/c; C_FEATURES="--no-default-features --features paper,q" for another
# scheme and arithmetic, C_TO for another folder. A target's library: `cargo build --release --target …` in
# crates/stillflux-c.
.PHONY: c
C_TO ?= target/c
C_FEATURES ?=

c:
	mkdir -p $(C_TO)
	cd crates/stillflux-c && export CARGO_TARGET_DIR="$(abspath target/c/build)" && \
		cargo build --quiet --release --locked $(C_FEATURES) && \
		cargo run --quiet --locked -p stillflux-c-header $(C_FEATURES) -- "$(abspath $(C_TO)/stillflux.h)"
	cp target/c/build/release/libstillflux.a $(C_TO)/libstillflux.a

# --- Firmware: needs QEMU, binutils for ARM and a compiler for the target; says so where they are missing.
.PHONY: firmware firmware-bench

firmware:
	cd crates/stillflux-firmware && $(PYTHON) -m tools run

firmware-bench:
	cd crates/stillflux-firmware && $(PYTHON) -m tools bench

# --- Rust's checks with compilers of their own. Miri needs `rustup component add --toolchain nightly miri rust-src`; it
# interprets the unsafe code of the C library, and the core with its dependencies, for a 32-bit ARM: some minutes. The
# minimum Rust version needs `rustup toolchain install 1.89`. cargo-semver-checks compares with the revision SEMVER_BASE.
.PHONY: miri msrv semver
MIRI := cargo +nightly miri test --locked --target armv7-unknown-linux-gnueabihf
MSRV := $(shell sed -n 's/^rust-version = "\(.*\)"/\1/p' Cargo.toml)
SEMVER_BASE ?= main

miri:
	cd crates/stillflux-c && CARGO_TARGET_DIR="$(abspath target/miri)" $(MIRI)
	CARGO_TARGET_DIR="$(abspath target/miri)" $(MIRI) -p stillflux --lib -- --skip any_one_bit \
		page:: words:: trace:: interrupt:: telemetry::

msrv:
	CARGO_TARGET_DIR="$(abspath target/msrv)" cargo +$(MSRV) check --locked -p stillflux -p stillflux-sim --features stillflux/commission
	cd crates/stillflux-c && CARGO_TARGET_DIR="$(abspath target/msrv)" cargo +$(MSRV) check --locked

semver:
	cargo semver-checks -p stillflux -p stillflux-sim --baseline-rev $(SEMVER_BASE)
