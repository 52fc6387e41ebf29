"""The committed tables as files: CSV with the columns of one kind, read line by line."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar

__all__ = ["read", "text"]

T = TypeVar("T")


def read(path: Path, columns: Sequence[str], what: str, make: Callable[[Sequence[str]], T]) -> list[T]:
    """What `make` makes of each line of a file; nothing if there is no file.

    Raises ValueError naming the file and its columns for a file of another kind, and naming the line, which
    is no `what`, where `make` raises ValueError or TypeError.
    """
    if not path.exists():
        return []
    try:
        lines = list(csv.reader(io.StringIO(path.read_text(encoding="utf-8"), newline="")))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path}: {error}") from None
    found = lines[0] if lines else []
    if tuple(found) != tuple(columns):
        raise ValueError(f"{path}: columns {', '.join(found)[:200] or 'none'}, expected {', '.join(columns)}")
    made = []
    for number, line in enumerate(lines[1:], 2):
        try:
            made.append(make(line))
        except (TypeError, ValueError):
            raise ValueError(f"{path}, line {number}: {','.join(line)[:200]!r} is no {what}") from None
    return made


def text(columns: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """The content of a file."""
    found = io.StringIO()
    writer = csv.writer(found, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(lines)
    return found.getvalue()
