"""What the crates carry with them: licences of all they depend on, and what a registry asks for."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
#: Workspaces, and the packages that are for others.
WORKSPACES = {
    ".": ["stillflux", "stillflux-sim"],
    "crates/stillflux-c": [],
    "crates/stillflux-firmware": [],
    "examples/firmware": [],
}
#: Licences that ask for no more than their own text. Of alternatives one has to be among them.
PERMISSIVE = {
    "0BSD",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "CC0-1.0",
    "ISC",
    "MIT",
    "MIT-0",
    "Unicode-3.0",
    "Unlicense",
    "Zlib",
}
#: The header's generator links to nothing that is shipped; its licence reaches changed files of itself alone.
TOOLS = {"cbindgen": "MPL-2.0"}


def metadata(workspace: str) -> dict[str, Any]:
    command = ["cargo", "metadata", "--format-version", "1", "--locked"]
    done = subprocess.run(command, cwd=ROOT / workspace, capture_output=True, check=True)
    content: dict[str, Any] = json.loads(done.stdout)
    return content


def is_permissive(expression: str) -> bool:
    """Whether an SPDX expression can be met by permissive licences."""
    expression = expression.replace("/", " OR ").replace("(", " ( ").replace(")", " ) ")
    tokens = expression.replace(" WITH LLVM-exception", "-WITH").split()
    # Every part of a conjunction, one of each alternative: as Python's operators bind.
    words = {"AND": "and", "OR": "or", "(": "(", ")": ")"}
    known = {p.replace(" WITH LLVM-exception", "-WITH") for p in PERMISSIVE}
    terms = (words.get(t.upper(), str(t in known)) for t in tokens)
    return bool(eval(" ".join(terms), {"__builtins__": {}}))


def test_an_expression_of_licences_is_read_as_it_is_meant() -> None:
    assert is_permissive("MIT OR Apache-2.0")
    assert is_permissive("MIT/Apache-2.0")
    assert is_permissive("MIT or Apache-2.0")
    assert is_permissive("GPL-3.0 OR MIT")
    assert is_permissive("(MIT OR Apache-2.0) AND Unicode-3.0")
    assert is_permissive("Apache-2.0 WITH LLVM-exception OR MIT")
    assert not is_permissive("GPL-3.0-only")
    assert not is_permissive("MIT AND GPL-3.0")


@pytest.mark.parametrize("workspace", list(WORKSPACES))
def test_every_dependency_has_a_permissive_licence(workspace: str) -> None:
    packages = metadata(workspace)["packages"]
    assert len(packages) > 5
    other = {p["name"]: p["license"] for p in packages if not is_permissive(p["license"] or "none")}
    assert {n: x for n, x in other.items() if TOOLS.get(n) != x} == {}


def test_the_list_of_licences_is_that_of_the_lock_files() -> None:
    sys.path.insert(0, str(ROOT / "docs"))
    licences: Any = importlib.import_module("_licences")
    assert licences.PAGE.read_text(encoding="utf-8") == licences.text(), "python3 docs/_licences.py"


def test_a_published_crate_says_what_a_registry_asks_for() -> None:
    packages = {p["name"]: p for p in metadata(".")["packages"]}
    for name in WORKSPACES["."]:
        package = packages[name]
        for field in ("description", "license", "readme", "rust_version"):
            assert package[field], f"{name}: {field}"
        assert 1 <= len(package["keywords"]) <= 5
        assert package["categories"]
        for dependency in package["dependencies"]:
            assert dependency["kind"] == "dev" or dependency["req"] != "*", (name, dependency["name"])
        command = ["cargo", "package", "--list", "--allow-dirty", "--locked", "-p", name]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
        assert {"LICENSE-MIT", "LICENSE-APACHE", "README.md", "src/lib.rs"} <= set(done.stdout.split())
