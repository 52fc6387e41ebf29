"""Builds the playground: one folder of static files that opens in a browser without a server.

    python playground.py [FOLDER]

`docs/playground` holds the page; beside it comes the WebAssembly module in base 64, since a page that is
opened as a file must not fetch one.
"""

from __future__ import annotations

import base64
import gzip
import importlib
import shutil
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "crates" / "stillflux-firmware"))
toolchain: Any = importlib.import_module("tools.toolchain")

PAGE = ROOT / "docs" / "playground"
OUT = ROOT / "target" / "playground"
BUILD = ROOT / "target" / "playground-build"
TARGET = "wasm32-unknown-unknown"

HELP = f"""\
  rustup:         rustup target add {TARGET}
  Debian/Ubuntu:  apt-get install rustc-web cargo-web rust-web-src lld   (compiler with library source)"""


def find() -> Any:
    """A compiler for WebAssembly; MissingError says what to install."""
    chain = toolchain.compiler(TARGET, "std,panic_abort")
    if chain is None or (chain.build_std and not shutil.which("wasm-ld")):
        raise toolchain.MissingError(f"no compiler and linker for {TARGET}. Install one of\n{HELP}")
    if chain.build_std:
        chain.env["RUSTFLAGS"] = "-C linker=wasm-ld"
    return chain


def module(chain: Any) -> Path:
    """Builds the WebAssembly module."""
    args = ["build", "--profile", "playground", "--locked", "--lib", "-p", "stillflux-wasm"]
    chain.cargo(*args, target=TARGET, cwd=ROOT, out=BUILD)
    return BUILD / TARGET / "playground" / "stillflux_wasm.wasm"


def build(chain: Any, out: Path = OUT) -> Path:
    """Builds module and page into `out`."""
    code = base64.b64encode(module(chain).read_bytes()).decode("ascii")
    out.mkdir(parents=True, exist_ok=True)
    for file in PAGE.iterdir():
        shutil.copy(file, out / file.name)
    (out / "module.js").write_text(f'"use strict";\nconst MODULE = "{code}";\n', encoding="ascii")
    return out


def compressed(out: Path) -> int:
    """Bytes that a server sends for all files of the page."""
    return sum(len(gzip.compress(file.read_bytes(), 9)) for file in out.iterdir())


def main() -> None:
    """Builds and says where and how large."""
    try:
        out = build(find(), *map(Path, sys.argv[1:]))
    except toolchain.MissingError as missing:
        sys.exit(str(missing))
    print(f"{out / 'index.html'}: {compressed(out) / 1000:.0f} kB compressed")


if __name__ == "__main__":
    main()
