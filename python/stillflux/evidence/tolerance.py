"""Rates of loss over installations drawn at random: ten drives on the courses of `courses`, every parameter
off at once.

Every run has an installation and a realisation of the noise of its own, which follow from drive, course and
number of the draw (`seed_of`), so that any of them can be run again. Lost is a fault, a field angle error
above 30° while running, or a true speed off its reference by more than 0.05 pu at the end. Rates stand with
their 95 % intervals of Wilson's score,

    (p + z²/2n ± z √(p (1 − p)/n + z²/4n²)) / (1 + z²/n),    z = 1.96
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any, TypeAlias, cast

import numpy as np

from stillflux.evidence.claims import Claim, at_most, reported
from stillflux.evidence.courses import COURSES, Course
from stillflux.evidence.draws import drawn, ripple
from stillflux.evidence.drives import DRIVES, TypicalDrive
from stillflux.evidence.effects import effects
from stillflux.evidence.journal import Runner
from stillflux.evidence.judge import CALM, CONFIDENT, EXCURSION, angle, confidence, stops
from stillflux.evidence.machines import scaled
from stillflux.evidence.population import drive_of
from stillflux.evidence.seeds import seed_of
from stillflux.metrics import running, speed_error
from stillflux.options import DriveSettings, Scheme
from stillflux.parallel import run_jobs
from stillflux.result import Result
from stillflux.scenario import Scenario

__all__ = [
    "DRAWS",
    "LOST_ANGLE",
    "Job",
    "Outcome",
    "Progress",
    "Rate",
    "interval",
    "loss",
    "rates",
    "rerun",
    "run",
    "run_all",
    "scenario",
    "start_up",
]

DRAWS = 100
"""Draws of each drive and course, about ten minutes on two cores."""
LOST_ANGLE, LOST_SPEED = 30.0, 0.05
"""Lost: field angle error, °, and error of the true speed at the end, per unit, beyond these."""
EVERY = 5e-3
"""Time between two recorded rows, s."""
SIGNALS = (
    "psi_s",
    "omega_m",
    "load_torque",
    "angle_error",
    "reference",
    "estimate.confidence",
    "estimate.angle_deviation",
    "estimate.nis",
    "status",
)
EXCURSIONS, MISSES = "excursions beyond 15°", "excursions not announced"
NEEDLESS = "share of time with a needless alarm"
FAULTS, RIGHTED = "lost runs that end in a fault", "lost runs within 15° at the end"
_Z = 1.959964

Settings: TypeAlias = tuple[tuple[str, Any], ...]
"""Settings of the drive by name, in place of the defaults."""
Job: TypeAlias = tuple[str, str, int, str, str, bool, Settings, float]
"""Drive, course, number of the draw, scheme, arithmetic, whether with `effects`, settings, `scale` as of
`draws.drawn`."""


@dataclass(frozen=True)
class Outcome:
    """What one run showed. Times in s since the end of the start-up, angles in degrees."""

    machine: str
    course: str
    draw: int
    scheme: str
    lost: float
    """Time of the loss; inf: never."""
    why: str
    """A fault by name, "angle" or "speed"; empty: nothing was lost."""
    end: float
    """Angle error at the end of the run; nan: a fault has ended it before."""
    angle: float
    """Largest angle error up to a loss."""
    excursions: int
    """Times at which the angle error came to exceed 15°, through a loss."""
    misses: int
    """Those at a confidence of one half or more."""
    needless: float
    """Time with a confidence below one half and an angle error below 5°, s."""
    running: float
    """Time the drive ran, s."""
    numbers: Mapping[str, float]
    """What was drawn."""
    beyond_model: bool = False
    """The plant has `effects`."""
    settings: Settings = ()
    """Settings that are not the defaults."""
    scale: float = 1.0
    """Of the tolerances, as of `draws.drawn`."""


@dataclass(frozen=True)
class Rate:
    """The runs of one drive, or of all, on one course."""

    machine: str
    course: str
    scheme: str
    outcomes: Sequence[Outcome]
    beyond_model: bool = False

    @property
    def losses(self) -> list[Outcome]:
        """The runs that were lost."""
        return [x for x in self.outcomes if x.why]

    @property
    def claims(self) -> list[Claim]:
        """The rate against its target, its interval, the largest angle error of those kept, and every
        loss."""
        n, losses, target = len(self.outcomes), self.losses, COURSES[self.course].target
        rate, (low, high) = 100.0 * len(losses) / n, interval(len(losses), n)
        judged = reported("rate of loss", rate, "%")
        if target is not None:
            judged = at_most("rate of loss", rate, target, "%")
        kept = max((x for x in self.outcomes if not x.why), key=lambda x: x.angle, default=None)
        found = [
            reported("draws", n),
            replace(judged, note=f"{len(losses)} of {n}"),
            reported("lower end of its 95 % interval", 100.0 * low, "%"),
            reported("upper end of its 95 % interval", 100.0 * high, "%"),
        ]
        if kept is not None:
            largest = reported("largest angle error of the runs kept", kept.angle, "°")
            found.append(replace(largest, seed=kept.draw))
        excursions, misses = (
            sum(getattr(x, name) for x in self.outcomes) for name in ("excursions", "misses")
        )
        if excursions:
            found += [reported(EXCURSIONS, excursions), reported(MISSES, misses)]
        time = max(sum(x.running for x in self.outcomes), 1e-9)
        found.append(reported(NEEDLESS, 100.0 * sum(x.needless for x in self.outcomes) / time, "%"))
        if losses:
            found.append(reported(FAULTS, sum(math.isnan(x.end) for x in losses)))
            found.append(reported(RIGHTED, sum(x.end <= EXCURSION for x in losses)))
        found += [
            replace(reported(f"draw {x.draw} lost at", x.lost, "s"), run=x.why, seed=x.draw) for x in losses
        ]
        return found


def interval(lost: int, runs: int) -> tuple[float, float]:
    """95 % interval of a rate, Wilson's score."""
    if not runs:
        return 0.0, 1.0
    p, square = lost / runs, _Z * _Z / runs
    middle = p + 0.5 * square
    half = _Z * math.sqrt(p * (1.0 - p) / runs + 0.25 * square / runs)
    # Without a loss it begins at 0, and with losses alone it ends at 1, which rounding misses by 1e-17.
    low = (middle - half) / (1.0 + square) if lost else 0.0
    return low, (middle + half) / (1.0 + square) if lost < runs else 1.0


def start_up(motor: Any, inverter: Any, scheme: str = "enhanced", settings: Settings = ()) -> float:
    """Duration of offset reading and magnetisation by the drive's defaults, s, or with these settings of a
    scheme where it is longer; four rotor time constants. Two sensors whose gains differ repeat the last three
    quarters of the magnetisation."""
    from stillflux import Drive

    def of(drive: Drive) -> float:
        of_drive = drive.settings
        again = 0.75 if of_drive["current_sensors"] == 2 and scheme == "enhanced" else 0.0
        return float(of_drive["offset_time"] + (1.0 + again) * of_drive["magnetise_time"])

    by_default = of(Drive(motor, inverter))
    if not settings:
        return by_default
    return max(by_default, of(Drive(motor, inverter, scheme=cast(Scheme, scheme), **_of_drive(settings))))


def _of_drive(settings: Settings) -> DriveSettings:
    """As keywords of a drive."""
    return cast(DriveSettings, dict(settings))


def scenario(
    machine: str,
    course: Course,
    seed: int,
    scheme: str = "enhanced",
    arithmetic: str = "f32",
    scale: float = 1.0,
    beyond_model: bool = False,
    signals: Sequence[str] | None = SIGNALS,
    drive: TypicalDrive | None = None,
    settings: Settings = (),
) -> tuple[Scenario, Mapping[str, float]]:
    """A drive on an installation, and what was drawn of it; `scale` as of `draws.drawn`. `beyond_model`: the
    plant has `effects` as well. `signals` to record, None: all. `drive`: None is that of the name."""
    drive = drive or DRIVES[machine]
    motor, found = drive.motor, drawn(drive, seed, scale)
    begin = start_up(motor, found.told, scheme, settings) + 0.05
    demand = course.build(motor, seed).after(begin)
    changes = ripple(drive.inverter.u_dc, found.phase, demand.end) + demand.changes
    plant = found.plant
    if beyond_model:
        plant = {**plant, **effects(found.motor, seed)}
    return (
        Scenario(
            name=f"{course.title}, {machine}, {scheme}, seed {seed}",
            motor=motor,
            inverter=found.told,
            plant_motor=found.motor,
            plant_inverter=found.inverter,
            scheme=scheme,
            arithmetic=arithmetic,
            settings=_of_drive(settings),
            plant=plant,
            omega_ref=scaled(demand.omega, motor.base["omega_m"]),
            load_torque=scaled(demand.load, motor.T_N),
            duration=demand.end,
            changes=sorted(changes, key=itemgetter(0)),
            signals=signals,
            record_every=max(1, round(EVERY * drive.inverter.f_s)),
        ),
        found.numbers,
    )


def loss(result: Result, begin: float) -> tuple[float, str]:
    """When control was lost, s after `begin`, and by what; (inf, "") if it was not."""
    found = stops(result)
    beyond = np.flatnonzero(np.abs(angle(result)) > LOST_ANGLE)
    if len(beyond):
        found.append((float(result.t[beyond[0]]), "angle"))
    off = np.abs(speed_error(result)) > LOST_SPEED
    if off[-1]:
        within = np.flatnonzero(~off)
        found.append((float(result.t[within[-1]]) if len(within) else 0.0, "speed"))
    when, why = min(found, default=(math.inf, ""))
    return when - begin, why


def run(
    machine: str,
    course: str,
    draw: int,
    scheme: str = "enhanced",
    arithmetic: str = "f32",
    beyond_model: bool = False,
    settings: Settings = (),
    scale: float = 1.0,
    signals: Sequence[str] | None = SIGNALS,
) -> tuple[Outcome, Result]:
    """Runs one draw and judges it; `signals` to record, None: all."""
    from stillflux.simulation import simulate

    seed = seed_of(machine, course, draw)
    made, numbers = scenario(
        machine,
        COURSES[course],
        seed,
        scheme,
        arithmetic,
        scale,
        beyond_model,
        signals=signals,
        drive=drive_of(machine, draw),
        settings=settings,
    )
    result = simulate(made)
    begin = start_up(made.motor, made.inverter, scheme, settings)
    when, why = loss(result, begin)
    error, runs = np.abs(angle(result)), running(result)
    trust = confidence(result, begin + when)
    doubt = runs & (result["estimate.confidence"] < CONFIDENT) & (error < CALM)
    dt = float(result.t[1] - result.t[0])
    outcome = Outcome(
        machine=machine,
        course=course,
        draw=draw,
        scheme=scheme,
        lost=when,
        why=why,
        end=float(error[-1]) if runs[-1] else math.nan,
        angle=float(error[result.t <= begin + when].max(initial=0.0)),
        excursions=trust.excursions,
        misses=trust.misses,
        # The first row under control has no confidence yet.
        needless=dt * float(np.count_nonzero(doubt[1:] & runs[:-1])),
        running=dt * float(np.count_nonzero(runs)),
        numbers=numbers,
        beyond_model=beyond_model,
        settings=settings,
        scale=scale,
    )
    return outcome, result


def _outcome(job: Job) -> Outcome:
    return run(*job)[0]


def rerun(
    machine: str,
    course: str,
    draw: int,
    scheme: str,
    beyond_model: bool = False,
    settings: Settings = (),
    scale: float = 1.0,
) -> str:
    """The command that runs a draw again."""
    last = "" if scheme == "enhanced" else f" --scheme {scheme}"
    last += " --beyond-model" if beyond_model else ""
    last += "" if scale == 1.0 else f" --scale {scale:g}"
    last += "".join(f" --set {name}={value}" for name, value in settings)
    return f"stillflux beyond tolerance --machine {machine} --course {course} --draw {draw}{last}"


def rerun_of(x: Outcome) -> str:
    """The command that makes an outcome again."""
    return rerun(x.machine, x.course, x.draw, x.scheme, x.beyond_model, x.settings, x.scale)


def run_all(
    machines: Sequence[str],
    courses: Sequence[str],
    draws: Sequence[int],
    schemes: Sequence[str] = ("enhanced",),
    arithmetic: str = "f32",
    show: Callable[[int, int, Outcome], None] | None = None,
    runner: Runner = run_jobs,
    beyond_model: bool = False,
    settings: Settings = (),
    scale: float = 1.0,
) -> list[Outcome]:
    """Runs draws of drives on courses, on all processors; draw after draw, so that what is done by an
    interruption is of all of them. On Ctrl-C raises `parallel.Stopped`."""
    jobs: list[tuple[Job]] = [
        ((machine, course, draw, scheme, arithmetic, beyond_model, settings, scale),)
        for draw in draws
        for machine in machines
        for course in courses
        for scheme in schemes
    ]
    return runner(_outcome, jobs, first=lambda job: False, show=show)


class Progress:
    """A line on stderr for every run that is lost, and for every hundredth."""

    def __init__(self) -> None:
        self._begin, self._lost = time.monotonic(), 0
        self._first: int | None = None

    def __call__(self, done: int, total: int, outcome: Outcome) -> None:
        """After a run: the number done, the number of all, and the latest."""
        if self._first is None:
            self._first = done - 1
        self._lost += bool(outcome.why)
        if not outcome.why and done % 100 and done < total:
            return
        what = "ok"
        if outcome.why:
            what = f"LOST after {outcome.lost:.3g} s ({outcome.why}): "
            what += rerun_of(outcome)
        left = (time.monotonic() - self._begin) / (done - self._first) * (total - done)
        print(f"[{done:5d}/{total}, {left / 60:.1f} min left] {what}", file=sys.stderr, flush=True)


def rates(outcomes: Sequence[Outcome]) -> list[Rate]:
    """By drive and course."""
    groups: dict[tuple[str, str, str, bool], list[Outcome]] = {}
    for x in outcomes:
        groups.setdefault((x.machine, x.course, x.scheme, x.beyond_model), []).append(x)
    return [
        Rate(machine, course, scheme, group, beyond_model)
        for (machine, course, scheme, beyond_model), group in groups.items()
    ]
