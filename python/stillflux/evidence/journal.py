"""Jobs whose results are written down as they come, so that a campaign that was killed goes on where it was.

A journal is a file of JSON, a line each: the first says that it is one, of which campaign and of which build,
every other one is a job with its result. What was done counts only for the very same build, by a fingerprint
of the compiled part and of all Python code: a journal that was begun by another build is begun anew. A file
that is none, or that is of another campaign, is refused and stays as it is. Reading one runs no code.
"""

from __future__ import annotations

import base64
import hashlib
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from stillflux import json_lines
from stillflux.build import fingerprint
from stillflux.evidence.machines import OwnMachine
from stillflux.outputs import write_text
from stillflux.parallel import Stopped, run_jobs

__all__ = ["Journal", "Runner", "from_json", "to_json"]

T = TypeVar("T")


class Runner(Protocol):
    """Runs jobs: `parallel.run_jobs`, or `Journal.run`."""

    def __call__(
        self,
        function: Callable[..., T],
        jobs: Sequence[tuple[Any, ...]],
        *common: Any,
        first: Callable[[tuple[Any, ...]], bool],
        show: Callable[[int, int, T], None] | None = None,
    ) -> list[T]:
        """`function(*job, *common)` of every job, in the order of `jobs`."""


class Journal:
    """A file of results by job. Raises ValueError for a file that is no journal of the campaign, OSError if
    it cannot be written."""

    def __init__(self, path: Path, campaign: str, build: str | None = None) -> None:
        self._path = path
        self._done: dict[str, Any] = {}
        head = {"stillflux": "journal", "campaign": campaign, "build": build or fingerprint()}
        text, lines = json_lines.read(path)
        begun = lines[0] if lines and isinstance(lines[0], dict) else {}
        if text and begun.get("stillflux") != head["stillflux"]:
            raise ValueError(f"journal = {path} is no journal, which begins with a line that says so")
        other = begun.get("campaign")
        if text and other != campaign:
            raise ValueError(f"journal = {path} is of `stillflux {other}`, not of `stillflux {campaign}`")
        if begun == head:
            pairs = (x for x in lines[1:] if isinstance(x, list) and len(x) == 2)
            self._done = {key: result for key, result in pairs if isinstance(key, str)}
            json_lines.begin(path)
        else:
            write_text(path, json.dumps(head) + "\n")

    @property
    def done(self) -> int:
        """Number of jobs whose results are written down."""
        return len(self._done)

    def run(
        self,
        function: Callable[..., T],
        jobs: Sequence[tuple[Any, ...]],
        *common: Any,
        first: Callable[[tuple[Any, ...]], bool],
        show: Callable[[int, int, T], None] | None = None,
    ) -> list[T]:
        """As `parallel.run_jobs`, but without those that are done. On Ctrl-C raises `Stopped` with all
        done."""
        keys = [_key((function.__module__, function.__qualname__, job, common)) for job in jobs]
        results: dict[str, T] = {key: self._result(key) for key in keys if key in self._done}
        todo = [(key, *job) for key, job in zip(keys, jobs, strict=True) if key not in results]
        begun = len(jobs) - len(todo)

        def record(done: int, total: int, found: tuple[str, T]) -> None:
            del total
            key, results[key] = found[0], found[1]
            self._done[key] = to_json(found[1])
            json_lines.append(self._path, [key, self._done[key]])
            if show is not None:
                show(begun + done, len(jobs), found[1])

        try:
            run_jobs(partial(_keyed, function), todo, *common, first=lambda job: first(job[1:]), show=record)
        except Stopped:
            raise Stopped([results[key] for key in keys if key in results], len(jobs)) from None
        return [results[key] for key in keys]

    def _result(self, key: str) -> Any:
        try:
            return from_json(self._done[key])
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise ValueError(f"journal = {self._path}: a result cannot be read: {error}") from None

    def remove(self) -> None:
        """Of no use any more."""
        self._path.unlink(missing_ok=True)


def _keyed(function: Callable[..., T], key: str, *arguments: Any) -> tuple[str, T]:
    return key, function(*arguments)


def _key(job: tuple[Any, ...]) -> str:
    return hashlib.sha256(repr(job).encode()).hexdigest()


def to_json(value: Any) -> Any:
    """A result as plain data for JSON, exactly: numbers of numpy, arrays, tuples, mappings and dataclasses of
    this package are objects that say what they are. Raises TypeError for anything else."""
    if isinstance(value, np.generic | np.ndarray):
        array = np.asarray(value)
        if array.dtype.hasobject:
            raise TypeError(f"an array of {array.dtype} cannot be written into a journal")
        content = base64.b64encode(array.tobytes()).decode("ascii")
        kind = "number" if isinstance(value, np.generic) else "array"
        return {kind: content, "type": array.dtype.str, "shape": list(array.shape)}
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, complex):
        return {"complex": [value.real, value.imag]}
    if isinstance(value, OwnMachine):
        return {"machine": to_json(value.machine), "source": value.source}
    if isinstance(value, list):
        return [to_json(item) for item in value]
    if isinstance(value, tuple):
        return {"tuple": [to_json(item) for item in value]}
    if isinstance(value, Mapping):
        return {"mapping": [[to_json(key), to_json(item)] for key, item in value.items()]}
    name = f"{type(value).__module__}:{type(value).__qualname__}"
    if is_dataclass(value) and _class(name) is type(value):
        of = {one.name: to_json(getattr(value, one.name)) for one in fields(value) if one.init}
        return {"class": name, "fields": of}
    raise TypeError(f"{value!r} cannot be written into a journal")


def from_json(data: Any) -> Any:
    """Undoes `to_json`. Raises ValueError, TypeError or KeyError for what it has not made."""
    if isinstance(data, list):
        return [from_json(item) for item in data]
    if not isinstance(data, dict):
        return data
    kind = next(iter(data), "")
    content: Any = data.get(kind)
    if kind in ("number", "array"):
        array = np.frombuffer(base64.b64decode(content), np.dtype(data["type"])).reshape(data["shape"])
        return array[()] if kind == "number" else array.copy()
    if kind == "complex":
        return complex(*content)
    if kind == "machine":
        return OwnMachine(from_json(content), data["source"])
    if kind == "tuple":
        return tuple(from_json(item) for item in content)
    if kind == "mapping":
        return {from_json(key): from_json(item) for key, item in content}
    if kind == "class":
        return _class(content)(**{name: from_json(item) for name, item in data["fields"].items()})
    raise ValueError(f"{kind!r} is not known")


def _class(name: str) -> Any:
    """A dataclass of this package, of a module that is imported already: what a file names is not begun."""
    module, _, qualified = name.partition(":")
    found = getattr(sys.modules.get(module), qualified, None)
    if not module.startswith("stillflux.") or not isinstance(found, type) or not is_dataclass(found):
        raise TypeError(f"{name} is no dataclass of stillflux")
    return found
