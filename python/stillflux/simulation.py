"""`simulate`: runs a scenario in the compiled part, in pieces short enough for Ctrl-C and progress."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from stillflux._core import Run
from stillflux.parallel import undisturbed
from stillflux.parameters import instance
from stillflux.result import Result
from stillflux.scenario import Scenario

__all__ = ["DivergenceError", "Interrupted", "Progress", "check_progress", "in_pieces", "simulate"]

Progress: TypeAlias = Callable[[float], object] | bool | None
"""Called with the fraction done, 0 to 1; True: a bar on stderr."""

_PIECE = 0.05  # s of wall time between looks at Ctrl-C


class Interrupted(KeyboardInterrupt):
    """A run ended by Ctrl-C; `result` is what it had recorded."""

    def __init__(self, result: Result) -> None:
        super().__init__(f"interrupted at t = {result.t[-1] if len(result.t) else 0.0:.3f} s")
        self.result = result

    def __reduce__(self) -> tuple[type[Interrupted], tuple[Result]]:
        return Interrupted, (self.result,)


class DivergenceError(ArithmeticError):
    """A run whose plant left what can be computed; `result` is what was recorded before."""

    def __init__(self, message: str, result: Result) -> None:
        super().__init__(message)
        self.result = result

    def __reduce__(self) -> tuple[type[DivergenceError], tuple[str, Result]]:
        return DivergenceError, (str(self), self.result)


def simulate(scenario: Scenario, progress: Progress = None) -> Result:
    """Runs a scenario and returns what it recorded.

    Releases the GIL; raises `Interrupted` within 0.2 s of Ctrl-C, `DivergenceError`, an ArithmeticError,
    if the plant's state leaves what can be computed.
    """
    instance("scenario", scenario, Scenario)
    check_progress(progress)
    run = Run(scenario)
    report = progress_bar(scenario.name) if progress is True else progress or None

    def show() -> None:
        if report is not None:
            report(min(1.0, run.time / scenario.duration))

    try:
        in_pieces(run.advance, show)
    except KeyboardInterrupt:
        with undisturbed():
            raise Interrupted(_result(scenario, run)) from None
    result = _result(scenario, run)
    begun = {
        name: int(np.argmin(finite))
        for name, x in result.data.items()
        if not (finite := np.isfinite(x)).all()
    }
    if begun:
        name = min(begun, key=lambda name: begun[name])
        row = begun[name]
        before = {signal: values[:row] for signal, values in result.data.items()}
        since = result.t[row]
        # A drive that has ended before no longer holds its load.
        ended = result.status.time is not None and result.status.time < since
        cause = f"the drive had ended with {result.status}, and " if ended else ""
        raise DivergenceError(
            f"{name} is not finite from t = {since:.4g} s on: {cause}the shaft runs away beyond what the "
            f"plant can compute; is the load torque right?",
            replace(result, t=result.t[:row], data=before),
        )
    return result


def check_progress(progress: Any) -> None:
    """Raises TypeError for what can show no progress."""
    if not (progress is None or isinstance(progress, bool) or callable(progress)):
        raise TypeError(f"progress = {progress!r} is neither a function nor True, False or None")


def in_pieces(advance: Callable[[int], bool], show: Callable[[], object]) -> None:
    """Calls `advance` with numbers of control periods until it returns False, and `show` after each call; the
    numbers are chosen so that a call takes little enough for Ctrl-C."""
    periods, more = 200, True
    while more:
        begin = time.monotonic()
        more = advance(periods)
        show()
        elapsed = time.monotonic() - begin
        periods = max(1, int(periods * min(2.0, _PIECE / max(elapsed, 1e-6))))


def _result(scenario: Scenario, run: Run) -> Result:
    data = run.record()
    return Result(scenario=scenario, t=data.pop("t"), data=data, status=run.status, memory=run.memory())


def progress_bar(title: str) -> Callable[[float], None]:
    """A bar on stderr, redrawn at whole percents; plain text, once at the end, if that is no terminal."""
    shown = -1

    def show(fraction: float) -> None:
        nonlocal shown
        percent = int(100 * fraction)
        if percent == shown:
            return
        shown = percent
        if sys.stderr.isatty():
            bar = "#" * (percent * 3 // 10)
            end = "\n" if percent == 100 else ""
            print(
                f"\r{title or 'simulating'} [{bar:<30}] {percent:3d} %", end=end, file=sys.stderr, flush=True
            )
        elif percent == 100:
            print(f"{title or 'simulation'}: done", file=sys.stderr, flush=True)

    return show
