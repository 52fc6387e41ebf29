"""Independent jobs on all processors, with progress, ended at once by Ctrl-C."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any, TypeVar

__all__ = ["EndedEarlyError", "Pool", "Stopped", "ended_early", "run_jobs", "undisturbed"]

T = TypeVar("T")


class Stopped(KeyboardInterrupt):
    """Ended by Ctrl-C; `results` holds what was done by then, in the order of the jobs."""

    def __init__(self, results: Sequence[Any], total: int) -> None:
        super().__init__(f"interrupted after {len(results)} of {total} runs")
        self.results = list(results)


class EndedEarlyError(RuntimeError):
    """Processes that ended before their jobs were done."""


def ended_early(what: str, some_done: bool, goes_on: str = "", otherwise: str = "") -> EndedEarlyError:
    """The error of processes that ended before their time. Those of which none has done a job were begun by
    a script that begins them again in each; `otherwise` says what else helps, `goes_on` what helps where one
    was killed."""
    if some_done:
        hint = "; ".join(filter(None, ("one was killed, perhaps for want of memory", goes_on)))
    else:
        hint = f'in a script begin the {what} below `if __name__ == "__main__":`'
        hint += f", or {otherwise}" if otherwise else ""
    return EndedEarlyError(f"the processes of the {what} ended before their time: {hint}")


class Pool(ProcessPoolExecutor):
    """Processes, at most one for each processor, that hear of Ctrl-C while they run a task, and then run no
    other one: those that begin, wait or end say nothing of it."""

    def __init__(self, tasks: int) -> None:
        workers = max(1, min(os.cpu_count() or 1, tasks))
        super().__init__(max_workers=workers, mp_context=get_context("spawn"), initializer=_begin)

    def submit(self, function: Callable[..., T], /, *arguments: Any, **named: Any) -> Future[T]:
        """As that of every executor."""
        with _held_back():
            return super().submit(_task, function, *arguments, **named)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """As that of every executor; another Ctrl-C meanwhile goes to the tasks alone."""
        with undisturbed():
            super().shutdown(wait, cancel_futures=cancel_futures)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Ctrl-C does nothing meanwhile: for the short work that is left after one, or after a long run."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        # None: that of a program in C, which cannot be set from here.
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)


_running = _interrupted = False
"""In a process of a pool: a task is being run; one was ended by Ctrl-C."""


def _begin() -> None:
    """Begins a process of a pool."""
    # Of a program that ignores Ctrl-C, as one in the background of a shell, the processes do as well.
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, _hear)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _hear(*_: Any) -> None:
    """Ctrl-C in a process of a pool."""
    global _running, _interrupted
    if _running:
        _running, _interrupted = False, True
        raise KeyboardInterrupt


def _task(function: Callable[..., T], *arguments: Any, **named: Any) -> T:
    """A task in a process of a pool. Those that are handed to it in advance cannot be taken back."""
    global _running
    if _interrupted:
        raise KeyboardInterrupt
    _running = True
    try:
        return function(*arguments, **named)
    finally:
        _running = False


@contextmanager
def _held_back() -> Iterator[None]:
    """Holds Ctrl-C back for a moment: a process that is begun within inherits that, up to `_begin`."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def run_jobs(
    function: Callable[..., T],
    jobs: Sequence[tuple[Any, ...]],
    *common: Any,
    first: Callable[[tuple[Any, ...]], bool],
    show: Callable[[int, int, T], None] | None = None,
) -> list[T]:
    """`function(*job, *common)` of every job in a process of its own, results in the order of `jobs`.

    Jobs that are `first` (the long ones) begin first, lest one of them is left over at the end. `show` gets
    the number done, the number of all, and the latest result. Raises `Stopped` on Ctrl-C, `EndedEarlyError`
    if the processes end before their time. In a script call it below `if __name__ == "__main__":`.
    """
    results: dict[int, T] = {}
    order = sorted(range(len(jobs)), key=lambda k: not first(jobs[k]))
    # Not as a context, whose exit would take back the cancelling; and waited for, since a pool that is
    # forgotten forgets to cancel. What runs hears of Ctrl-C itself.
    pool = Pool(len(jobs))
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
        if isinstance(error, BrokenProcessPool):
            raise ended_early("campaign", bool(results), "with a journal it goes on where it was") from None
        raise
    pool.shutdown()
    return [results[k] for k in range(len(jobs))]
