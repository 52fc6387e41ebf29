"""`fingerprint`: of the build, for results that count for no other one."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from stillflux import _core

__all__ = ["fingerprint"]


@cache
def fingerprint() -> str:
    """Of the build: the compiled part and every Python file of the package."""
    digest = hashlib.sha256()
    compiled = Path(_core.__file__)
    for path in [compiled, *sorted(compiled.parent.rglob("*.py"))]:
        digest.update(path.name.encode("utf-8") + path.read_bytes())
    return digest.hexdigest()
