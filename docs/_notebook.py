"""Runs a notebook without Jupyter: cell by cell in one namespace, with what each prints and shows."""

from __future__ import annotations

import ast
import contextlib
import io
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["Cell", "executed"]


@dataclass(frozen=True)
class Cell:
    """A cell of a notebook and what it left."""

    code: bool
    source: str
    text: str = ""
    """What it printed, and the representation of its last expression unless that has a picture or HTML."""
    html: str = ""
    picture: bytes = b""
    """PNG."""


def executed(path: Path) -> tuple[list[Cell], dict[str, Any]]:
    """The cells of a notebook, run in its folder, and the namespace at the end. An error of a cell is an
    error here."""
    content = json.loads(path.read_text(encoding="utf-8"))
    names: dict[str, Any] = {"__name__": path.stem}
    before = Path.cwd()
    os.chdir(path.parent)
    try:
        return list(_cells(path.name, content["cells"], names)), names
    finally:
        os.chdir(before)


def _cells(name: str, cells: list[dict[str, Any]], names: dict[str, Any]) -> Iterator[Cell]:
    for k, cell in enumerate(cells):
        source = "".join(cell["source"])
        if cell["cell_type"] == "code":
            yield _ran(source, f"{name}, cell {k + 1}", names)
        else:
            yield Cell(False, source)


def _ran(source: str, where: str, names: dict[str, Any]) -> Cell:
    """A cell of code; its last expression is shown as a notebook shows it."""
    body = ast.parse(source, where).body
    last = body.pop() if body and isinstance(body[-1], ast.Expr) else None
    printed, shown = io.StringIO(), None
    with contextlib.redirect_stdout(printed):
        exec(compile(ast.Module(body, []), where, "exec"), names)
        if isinstance(last, ast.Expr):
            shown = eval(compile(ast.Expression(last.value), where, "eval"), names)
    text = printed.getvalue()
    if shown is None:
        return Cell(True, source, text)
    if hasattr(shown, "_repr_png_"):
        return Cell(True, source, text, picture=shown._repr_png_())
    if hasattr(shown, "_repr_html_"):
        return Cell(True, source, text, html=shown._repr_html_())
    return Cell(True, source, text + repr(shown))
