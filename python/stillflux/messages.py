"""Parts of errors and warnings: names that were meant, and the place to which a warning points."""

from __future__ import annotations

import dataclasses
import difflib
import os
import sys
from collections.abc import Iterable

__all__ = ["MachineWarning", "meant", "near", "outside"]


class MachineWarning(UserWarning):
    """A machine that can hardly be the one that is meant: values that do not fit each other, or a motor file
    whose commissioning had something to say."""


def outside() -> int:
    """How many calls away the code is that uses this package: a warning points there."""
    depth, frame = 1, sys._getframe(1)
    inside = (os.path.dirname(__file__) + os.sep, dataclasses.__file__, "<string>")
    while frame.f_code.co_filename.startswith(inside) and frame.f_back is not None:
        depth, frame = depth + 1, frame.f_back
    return depth


def near(name: object, known: Iterable[str]) -> str:
    """The end of a message about a name that there is not: "; 'R_s'?" where it is spelt nearly so."""
    names = list(known)
    lower = {one.lower(): one for one in reversed(names)}
    text = str(name)
    close = difflib.get_close_matches(text, names, 1) or [
        lower[one] for one in difflib.get_close_matches(text.lower(), lower, 1)
    ]
    return f"; {close[0]!r}?" if close else ""


def meant(name: object, known: Iterable[str]) -> str:
    """The same; where none is spelt nearly so, all that there are."""
    names = list(known)
    return near(name, names) or f"; there are {', '.join(names)}"
