"""Structure of the Rust core: modules depend on each other in one direction."""

from __future__ import annotations

import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

CORE = Path(__file__).resolve().parents[1] / "crates" / "stillflux" / "src"


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

    A parent that hands on what a child defines (`pub use child::Name`) does not depend on it, and a child
    that extends a type of its own parent (`impl super::Name`) is a part of the parent: that way back is no
    import.
    """
    files = {_module(path, root): path for path in sorted(root.rglob("*.rs"))}
    graph: dict[str, set[str]] = {}
    for module, path in files.items():
        code = _code(path.read_text())
        found = [
            p for tree in re.findall(r"(?m)^\s*(?:pub\(\w+\) )?use ([^;]+);", code) for p in _paths(tree)
        ]
        found += [tuple(p.split("::")) for p in re.findall(r"(?<!\$)\b(?:crate|super|self)(?:::\w+)+", code)]
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
            if absolute and absolute != module and absolute != module[:-1]:
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


def test_no_circle_of_imports_in_the_core() -> None:
    graph = imports(CORE)
    assert len(graph) > 30
    # The parser sees what is known to be there.
    assert "params" in graph["base"]
    assert {"config", "control::current"} <= graph["drive::control"]
    assert circle(graph) == []


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


def test_children_extend_their_parent_but_form_no_circle_among_themselves(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a.rs").write_text("mod b;\nmod c;\nuse self::b::B;\npub use c::C;\n")
    (tmp_path / "a" / "b.rs").write_text("use super::A;\nuse super::c::C;\n")
    (tmp_path / "a" / "c.rs").write_text("use super::A;\n")
    assert not circle(imports(tmp_path))
    (tmp_path / "a" / "c.rs").write_text("use super::b::B;\n")
    assert circle(imports(tmp_path))
