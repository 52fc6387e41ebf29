"""Independent jobs on all processors, with progress, ended at once by Ctrl-C."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any, TypeVar

__all__ = ["run_jobs"]

T = TypeVar("T")


def run_jobs(
    function: Callable[..., T],
    jobs: Sequence[tuple[str, ...]],
    *common: Any,
    first: Callable[[tuple[str, ...]], bool],
    show: Callable[[int, int, T], None] | None = None,
) -> list[T]:
    """`function(*job, *common)` of every job in a process of its own, results in the order of `jobs`.

    Jobs that are `first` (the long ones) begin first, lest one of them is left over at the end. `show` gets
    the number done, the number of all, and the latest result.
    """
    results: dict[tuple[str, ...], T] = {}
    workers = max(1, min(os.cpu_count() or 1, len(jobs)))
    with ProcessPoolExecutor(max_workers=workers, mp_context=get_context("spawn")) as pool:
        waiting = {
            pool.submit(function, *job, *common): job for job in sorted(jobs, key=lambda j: not first(j))
        }
        try:
            for done in as_completed(waiting):
                results[waiting[done]] = done.result()
                if show is not None:
                    show(len(results), len(jobs), done.result())
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [results[job] for job in jobs]
