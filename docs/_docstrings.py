"""Extension of griffe: what follows a docstring's parameters (what it returns and raises, as sentences) goes
before them, since in numpy's style a section has no end."""

from __future__ import annotations

from typing import Any

import griffe

_HEADER = "Parameters\n----------\n"


def reordered(text: str) -> str:
    """The text with its parameters at the end."""
    head, header, rest = text.partition(_HEADER)
    if not header:
        return text
    lines = rest.split("\n")
    end = len(lines)
    for k, line in enumerate(lines):
        after = lines[k + 1] if k + 1 < len(lines) else ""
        if line and not line.startswith(" ") and not after.startswith(" "):
            end = k
            break
    parameters, tail = lines[:end], lines[end:]
    return "\n".join([head.rstrip(), "", *tail, "", _HEADER + "\n".join(parameters).rstrip()])


class Docstrings(griffe.Extension):
    """Reorders every docstring."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Called by griffe with each object."""
        if obj.docstring is not None:
            obj.docstring.value = reordered(obj.docstring.value)
