"""Writes `licences.md` beside it: every crate that is linked into what a user ships, with its licence.

`python3 docs/_licences.py` after a change of a Cargo.lock; `tests/test_packages.py` compares.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "licences.md"
#: Package, its workspace and its features, by what is shipped. Own crates are left out of the lists.
SHIPPED = {
    "The core in a firmware": ("stillflux", ".", ["--no-default-features", "--features", "enhanced"]),
    "The C library": ("stillflux-c", "crates/stillflux-c", []),
    "The Python extension, on any platform": ("stillflux-py", ".", ["--target", "all"]),
}


def linked(package: str, workspace: str, options: list[str]) -> list[list[str]]:
    """Name, version and licence of all that a package links to, directly or through others."""
    command = ["cargo", "tree", "--locked", "--edges", "normal", "--prefix", "none", "--no-dedupe"]
    command += ["--package", package, "--format", "{p}|{l}", *options]
    done = subprocess.run(command, cwd=ROOT / workspace, capture_output=True, text=True, check=True)
    rows = {line.replace(" (proc-macro)", "") for line in done.stdout.splitlines()}
    found = [[*row.split("|")[0].split()[:2], row.split("|")[1]] for row in rows]
    return sorted([n, v.removeprefix("v"), x] for n, v, x in found if not n.startswith("stillflux"))


def text() -> str:
    """The page."""
    lines = [
        "# Licences",
        "",
        "stillflux is under MIT or Apache-2.0, at your choice. What it links to, from the lock files; a test",
        "compares this page with them and admits permissive licences only.",
    ]
    for title, (package, workspace, features) in SHIPPED.items():
        lines += ["", f"## {title}", "", "| crate | version | licence |", "|---|---|---|"]
        lines += [f"| {n} | {v} | {x} |" for n, v, x in linked(package, workspace, features)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(text(), encoding="utf-8")
