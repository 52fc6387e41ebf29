"""Independent jobs on all processors, with progress, ended at once by Ctrl-C."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any, TypeVar

__all__ = ["Stopped", "run_jobs"]

T = TypeVar("T")


class Stopped(KeyboardInterrupt):
    """Ended by Ctrl-C; `results` holds what was done by then, in the order of the jobs."""

    def __init__(self, results: Sequence[Any], total: int) -> None:
        super().__init__(f"interrupted after {len(results)} of {total} runs")
        self.results = list(results)


def run_jobs(
    function: Callable[..., T],
    jobs: Sequence[tuple[Any, ...]],
    *common: Any,
    first: Callable[[tuple[Any, ...]], bool],
    show: Callable[[int, int, T], None] | None = None,
) -> list[T]:
    """`function(*job, *common)` of every job in a process of its own, results in the order of `jobs`.

    Jobs that are `first` (the long ones) begin first, lest one of them is left over at the end. `show` gets
    the number done, the number of all, and the latest result. Raises `Stopped` on Ctrl-C.
    """
    results: dict[int, T] = {}
    workers = max(1, min(os.cpu_count() or 1, len(jobs)))
    order = sorted(range(len(jobs)), key=lambda k: not first(jobs[k]))
    # Not as a context, whose exit would take back the cancelling; and waited for, since a pool that is
    # forgotten forgets to cancel. What runs hears of Ctrl-C itself.
    pool = ProcessPoolExecutor(max_workers=workers, mp_context=get_context("spawn"))
    try:
        waiting = {pool.submit(function, *jobs[k], *common): k for k in order}
        for done in as_completed(waiting):
            results[waiting[done]] = done.result()
            if show is not None:
                show(len(results), len(jobs), done.result())
    except BaseException as error:
        pool.shutdown(cancel_futures=True)
        if isinstance(error, KeyboardInterrupt):
            raise Stopped([results[k] for k in sorted(results)], len(jobs)) from None
        raise
    pool.shutdown()
    return [results[k] for k in range(len(jobs))]
