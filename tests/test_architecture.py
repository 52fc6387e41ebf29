"""Structure of core and plant: modules depend on each other in one direction, every test file is compiled."""

from __future__ import annotations

import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

CRATES = Path(__file__).resolve().parents[1] / "crates"


def _module(path: Path, root: Path) -> tuple[str, ...]:
    parts = path.relative_to(root).with_suffix("").parts
    return parts[:-1] if parts[-1] in ("mod", "lib") else parts


def _code(text: str) -> str:
    """Without comments and without the unit tests, which end a file."""
    text = re.split(r"#\[cfg\(test\)\]\s*mod \w+ \{", text)[0]
    return re.sub(r"//.*|/\*.*?\*/", "", text)


def _paths(tree: str, prefix: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Every path of a `use` tree such as `a::{b, c::{d, e}}`."""
    items, depth, begin = [], 0, 0
    for k, letter in enumerate(tree + ","):
        depth += {"{": 1, "}": -1}.get(letter, 0)
        if letter == "," and depth == 0:
            items.append(tree[begin:k].strip())
            begin = k + 1
    found = []
    for item in filter(None, items):
        head, brace, rest = item.partition("{")
        path = (*prefix, *(p for p in head.split(" as ")[0].strip().split("::") if p))
        found += _paths(rest.rsplit("}", 1)[0], path) if brace else [path]
    return found


def imports(root: Path) -> dict[str, set[str]]:
    """What each file imports: `use` declarations and paths from `crate::` or `super::` in the code.

    A parent that only hands on what a child defines (`pub use child::Name`, the name nowhere else in it) does
    not depend on it. All else counts: a child that extends a type of its parent is no exception.
    """
    files = {_module(path, root): path for path in sorted(root.rglob("*.rs"))}
    graph: dict[str, set[str]] = {}
    for module, path in files.items():
        code = _code(path.read_text())
        declared = re.compile(r"(?m)^\s*(pub(?:\(\w+\))? )?use ([^;]+);")
        body = declared.sub("", code)
        found = [
            p
            for public, tree in declared.findall(code)
            for p in _paths(tree)
            if not public or re.search(rf"\b{p[-1]}\b", body)
        ]
        found += [tuple(p.split("::")) for p in re.findall(r"(?<!\$)\b(?:crate|super|self)(?:::\w+)+", body)]
        targets = set()
        for parts in found:
            if parts[0] == "crate":
                absolute = parts[1:]
            elif parts[0] == "super":
                up = next(k for k, part in enumerate(parts) if part != "super")
                absolute = (*module[: len(module) - up], *parts[up:])
            elif parts[0] == "self":
                absolute = (*module, *parts[1:])
            elif (*module, parts[0]) in files:
                absolute = (*module, *parts)
            else:
                continue
            while absolute not in files:
                absolute = absolute[:-1]
            if absolute and absolute != module:
                targets.add("::".join(absolute))
        graph["::".join(module)] = targets
    return graph


def circle(graph: dict[str, set[str]]) -> list[str]:
    """A circle of imports, empty if there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


@pytest.mark.parametrize(
    "crate", ["stillflux", "stillflux-sim", "stillflux-py", "stillflux-c", "stillflux-wasm"]
)
def test_no_circle_of_imports_in_a_crate(crate: str) -> None:
    assert circle(imports(CRATES / crate / "src")) == []


def test_the_parser_sees_what_is_known_to_be_there() -> None:
    graph = imports(CRATES / "stillflux" / "src")
    assert len(graph) > 30
    assert "params" in graph["base"]
    assert {"config", "control::current"} <= graph["drive::control"]
    # From child to parent, and to a name that the parent hands on and uses itself.
    assert "estimate::kalman" in graph["estimate::kalman::start"]
    assert "estimate::kalman::config" in graph["estimate::kalman"]


@pytest.mark.parametrize(
    ("a", "b", "found"),
    [
        ("use crate::b::B;", "use crate::a::A;", True),
        ("use crate::{scalar, b::{B, C}};", "fn f() { crate::a::g(); }", True),
        ("use crate::b::B;", "use super::a::{A};", True),
        ("use crate::b::B;", "//! [`crate::a::A`]", False),
        ("use crate::b::B;", "#[cfg(test)]\nmod tests {\n    use crate::a::A;\n}", False),
    ],
)
def test_a_circle_of_imports_is_found(tmp_path: Path, a: str, b: str, found: bool) -> None:
    (tmp_path / "lib.rs").write_text("mod a;\nmod b;\n")
    (tmp_path / "a.rs").write_text(a)
    (tmp_path / "b.rs").write_text(b)
    assert bool(circle(imports(tmp_path))) == found


def test_a_child_that_uses_its_parent_is_not_used_by_it(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a.rs").write_text("mod b;\nmod c;\nuse c::C;\npub struct A;\n")
    (tmp_path / "a" / "b.rs").write_text("use super::A;\nuse super::c::C;\n")
    (tmp_path / "a" / "c.rs").write_text("pub struct C;\n")
    assert not circle(imports(tmp_path))
    (tmp_path / "a" / "c.rs").write_text("use super::A;\n")
    assert circle(imports(tmp_path))
    # Only handed on, then used as well.
    (tmp_path / "a.rs").write_text("mod c;\npub use c::C;\npub struct A;\n")
    assert not circle(imports(tmp_path))
    (tmp_path / "a.rs").write_text("mod c;\npub use c::C;\npub struct A(C);\n")
    assert circle(imports(tmp_path))


@pytest.mark.parametrize("crate", ["stillflux", "stillflux-sim"])
def test_every_file_of_tests_is_in_the_one_test_program_of_its_crate(crate: str) -> None:
    """One that `main.rs` does not name would not run, and nothing would say so."""
    folder = CRATES / crate / "tests"
    named = set(re.findall(r"(?m)^mod (\w+);$", (folder / "main.rs").read_text()))
    assert named == {p.stem for p in folder.iterdir() if p.name != "main.rs"}
