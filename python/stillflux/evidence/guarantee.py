"""The guarantee: no drive reports "running" while it is lost, over installations drawn at random.

Ten drives on the courses of `courses`, with default settings, the tolerances of `draws` and 2.5 times those:

    |ω̂ - ω| > 0.2 pu for no longer than 0.2 s,      field angle error > 30° for no longer than 1 s

while the status is "running". Its counterpart: a run that ends with a fault is made again without supervision
(`supervision=False`, the negative control); one that is not lost then as `tolerance` has it, by the angle or
by the speed at its end, was ended needlessly.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stillflux.evidence.claims import Claim, at_most, reported
from stillflux.evidence.courses import COURSES
from stillflux.evidence.drives import DRIVES
from stillflux.evidence.journal import Runner
from stillflux.evidence.judge import angle
from stillflux.evidence.seeds import seed_of
from stillflux.evidence.tolerance import LOST_ANGLE, loss, scenario
from stillflux.metrics import faulted
from stillflux.parallel import run_jobs
from stillflux.result import Result
from stillflux.status import StatusCode

__all__ = [
    "DRAWS",
    "SCALES",
    "Found",
    "Job",
    "Outcome",
    "found",
    "held",
    "judged",
    "rerun",
    "run",
    "run_all",
    "table",
]

DRAWS = 8
"""Draws of each drive, course and scale, five minutes on two cores."""
SCALES = (1.0, 2.5)
"""Tolerances, in units of those of `draws`."""
SPEED, SPEED_TIME = 0.2, 0.2
"""Error of the speed estimate, per unit, and for how long, s."""
ANGLE_TIME = 1.0
"""For how long the field angle error may be above `LOST_ANGLE`, s."""
_SIGNALS = ("omega_m", "angle_error", "reference", "estimate.omega_m", "estimate.confidence", "status")

Job: TypeAlias = tuple[str, str, int, float]
"""Drive, course, number of the draw, scale."""


@dataclass(frozen=True)
class Outcome:
    """What one run showed."""

    machine: str
    course: str
    draw: int
    scale: float
    speed: float
    """Longest time with a speed error beyond `SPEED` while running, s."""
    angle: float
    """Longest time with an angle error beyond `LOST_ANGLE` while running, s."""
    fault: str
    """That ended the run; empty: none."""
    needless: bool
    """Without supervision the run is not lost."""
    speed_off: float
    """`speed` of the run without supervision, where there is one, else `speed`."""
    angle_off: float
    """`angle` of it."""

    @property
    def violated(self) -> bool:
        """Whether the drive kept running lost."""
        return self.speed > SPEED_TIME or self.angle > ANGLE_TIME

    @property
    def violated_off(self) -> bool:
        """The same without supervision."""
        return self.speed_off > SPEED_TIME or self.angle_off > ANGLE_TIME


def held(t: NDArray[Any], condition: NDArray[np.bool_]) -> float:
    """Longest uninterrupted time for which a condition holds, s; it holds from one row to the next."""
    edges = np.diff(np.concatenate(([False], condition, [False])).astype(np.int8))
    begin, end = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if not len(begin):
        return 0.0
    return float((t[np.minimum(end, len(t) - 1)] - t[begin]).max())


def judged(result: Result) -> tuple[float, float]:
    """Longest times while running with a speed error and an angle error beyond the limits, s."""
    running = result["status"] == StatusCode.RUNNING
    error = np.abs(result["estimate.omega_m"] - result["omega_m"]) / result.scenario.motor.base["omega_m"]
    return (
        held(result.t, running & (error > SPEED)),
        held(result.t, running & (np.abs(angle(result)) > LOST_ANGLE)),
    )


def run(machine: str, course: str, draw: int, scale: float) -> Outcome:
    """Runs one draw, and once more without supervision if it ended with a fault."""
    from stillflux.simulation import simulate

    seed = seed_of(machine, course, draw)
    made, _ = scenario(machine, COURSES[course], seed, scale=scale, signals=_SIGNALS)
    result = simulate(made)
    speed, lost = judged(result)
    needless, off = False, (speed, lost)
    if faulted(result).any():
        alone = simulate(made.with_settings(supervision=False))
        off = judged(alone)
        needless = not loss(alone, 0.0)[1]
    return Outcome(machine, course, draw, scale, speed, lost, result.status.fault or "", needless, *off)


def run_all(
    machines: Sequence[str],
    courses: Sequence[str],
    draws: Sequence[int],
    scales: Sequence[float] = SCALES,
    show: Callable[[int, int, Outcome], None] | None = None,
    runner: Runner = run_jobs,
) -> list[Outcome]:
    """Runs draws of drives on courses at each of the scales. On Ctrl-C raises `parallel.Stopped`."""
    jobs: list[tuple[str, str, int, float]] = [
        (machine, course, draw, scale)
        for draw in draws
        for scale in scales
        for machine in machines
        for course in courses
    ]
    return runner(run, jobs, first=lambda job: False, show=show)


def progress(done: int, total: int, outcome: Outcome) -> None:
    """A line on stderr for every violation, and for every hundredth run."""
    if outcome.violated:
        print(f"[{done}/{total}] VIOLATED: {outcome}", file=sys.stderr, flush=True)
    elif done % 100 == 0 or done == total:
        print(f"[{done}/{total}]", file=sys.stderr, flush=True)


RUNS, GO_ON, WITHOUT = "runs", "runs that go on lost", "go on lost without supervision"
ENDED, NEEDLESSLY = "runs ended by a fault", "ended needlessly"
LONGEST_SPEED = f"longest time with {SPEED:g} pu of speed error"
LONGEST_ANGLE = f"longest time with {LOST_ANGLE:g}° of angle error"


@dataclass(frozen=True)
class Found:
    """What all runs of a drive at one scale showed."""

    machine: str
    scale: float
    outcomes: tuple[Outcome, ...]

    @property
    def claims(self) -> list[Claim]:
        """Counts and longest times, then every run that goes on lost or is ended needlessly."""
        runs = self.outcomes
        return [
            reported(RUNS, len(runs)),
            at_most(GO_ON, sum(x.violated for x in runs), 0),
            reported(WITHOUT, sum(x.violated_off for x in runs)),
            reported(ENDED, sum(bool(x.fault) for x in runs)),
            reported(NEEDLESSLY, sum(x.needless for x in runs)),
            reported(LONGEST_SPEED, max(x.speed for x in runs), "s"),
            reported(LONGEST_ANGLE, max(x.angle for x in runs), "s"),
            *(_of_run(x, "goes on lost", max(x.speed, x.angle)) for x in runs if x.violated),
            *(_of_run(x, f"ended needlessly by {x.fault}") for x in runs if x.needless),
        ]


def _of_run(x: Outcome, what: str, seconds: float = 0.0) -> Claim:
    """Of one run."""
    return replace(reported(f"draw {x.draw} of {x.course} {what}", seconds, "s"), run=x.course, seed=x.draw)


def found(outcomes: Iterable[Outcome]) -> list[Found]:
    """By scale and drive, in the order of `DRIVES`."""
    by: dict[tuple[float, str], list[Outcome]] = {}
    for outcome in outcomes:
        by.setdefault((outcome.scale, outcome.machine), []).append(outcome)
    scales = sorted({scale for scale, _ in by})
    return [
        Found(machine, scale, tuple(by[scale, machine]))
        for scale in scales
        for machine in DRIVES
        if (scale, machine) in by
    ]


def rerun(machine: str, course: str, draw: int, scale: float) -> str:
    """The command that runs one draw again."""
    return f"stillflux beyond guarantee --machine {machine} --course {course} --draw {draw} --scale {scale:g}"


def table(outcomes: Sequence[Outcome]) -> str:
    """What was found, as text."""
    lines = []
    for of_drive in found(outcomes):
        lines.append(f"{of_drive.machine}, tolerances x {of_drive.scale:g}")
        lines += [f"  {x.quantity}: {x.measured}" for x in of_drive.claims]
    return "\n".join(lines)
