"""Jobs whose results are written down as they come, so that a campaign that was killed goes on where it was.

What was done counts only for the very same build: a journal begins with a fingerprint of the compiled part
and of all Python code, and one that was begun by another build is begun anew.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

from stillflux.build import fingerprint
from stillflux.parallel import Stopped, run_jobs

__all__ = ["Journal", "Runner"]

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
    """A file of results by job. Raises OSError if it cannot be written."""

    def __init__(self, path: Path, build: str | None = None) -> None:
        self._path = path
        self._done: dict[str, Any] = {}
        build = build or fingerprint()
        if path.exists():
            records = _records(path)
            if next(records, None) == build:
                self._done = dict(records)
        # Written anew, since the last record of one that was killed may be half a record.
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            pickle.dump(build, file)
            for record in self._done.items():
                pickle.dump(record, file)

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
        keys = [repr((function.__module__, function.__qualname__, job, common)) for job in jobs]
        todo = [(key, *job) for key, job in zip(keys, jobs, strict=True) if key not in self._done]
        begun = len(jobs) - len(todo)

        def record(done: int, total: int, found: tuple[str, T]) -> None:
            del total
            self._done[found[0]] = found[1]
            with self._path.open("ab") as file:
                pickle.dump(found, file)
            if show is not None:
                show(begun + done, len(jobs), found[1])

        try:
            run_jobs(partial(_keyed, function), todo, *common, first=lambda job: first(job[1:]), show=record)
        except Stopped:
            raise Stopped([self._done[key] for key in keys if key in self._done], len(jobs)) from None
        return [self._done[key] for key in keys]

    def remove(self) -> None:
        """Of no use any more."""
        self._path.unlink(missing_ok=True)


def _keyed(function: Callable[..., T], key: str, *arguments: Any) -> tuple[str, T]:
    return key, function(*arguments)


def _records(path: Path) -> Iterator[Any]:
    """What can be read of a journal."""
    with path.open("rb") as file:
        while True:
            try:
                yield pickle.load(file)
            except (EOFError, pickle.UnpicklingError, ValueError):
                return
