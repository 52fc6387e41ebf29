"""Lines of JSON, each on the disk before the next: what a campaign that was killed goes on with. Reading them
runs no code."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from stillflux.outputs import naming

__all__ = ["append", "begin", "read"]


def read(path: Path) -> tuple[bytes, list[Any]]:
    """The text of a file, empty if there is none, and the values of its lines; one that was cut off counts
    for nothing. Raises FileNotFoundError where there is no such folder."""
    if not path.absolute().parent.is_dir():
        raise FileNotFoundError(f"{path}: there is no folder {path.parent}")
    text = path.read_bytes() if path.exists() else b""
    values = []
    for line in text.split(b"\n"):
        try:
            values.append(json.loads(line))
        except (ValueError, RecursionError):
            continue
    return text, values


def begin(path: Path) -> None:
    """Opens a file for `append`, behind a line that was cut off: that it cannot be written shows before the
    first run, not after it. Raises OSError."""
    with naming(path), path.open("ab+") as file:
        if file.tell():
            file.seek(-1, os.SEEK_END)
            if file.read(1) != b"\n":
                file.write(b"\n")


def append(path: Path, value: Any) -> None:
    """One line more, on the disk before this returns. Raises OSError."""
    with naming(path), path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(value) + "\n")
        file.flush()
        os.fsync(file.fileno())
