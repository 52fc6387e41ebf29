"""What a file in `plane` holds: a target, which runs it has, and what each of them must show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

from stillflux.evidence.claims import Claim, holds
from stillflux.evidence.conditions import slip
from stillflux.evidence.judge import Measured, Window
from stillflux.evidence.seeds import seed_of, seeded
from stillflux.result import Result
from stillflux.scenario import Scenario

__all__ = ["Case", "Target", "Verdict", "View"]

Verdict: TypeAlias = Literal["confidence", "confidence-stepped", ""]
"""Verdicts on the confidence: over the runs of most targets, and over those in which the offset of a sensor
steps while the drive runs, which is not what the confidence takes a sensor for: one that drifts slowly."""
View: TypeAlias = Literal["map", "loads", "courses", "errors", "numbers"]
"""How the page shows a target: a map of the plane, angle over load, courses of runs, a table with one error a
line, or a table of numbers alone."""

LINE = 0.01
"""Distance from ω_s = 0 within which a wider angle is allowed, per unit."""


@dataclass(frozen=True)
class Case:
    """One run of a target."""

    target: str
    machine: str
    scheme: str
    label: str
    """What distinguishes it from the other runs of the target."""
    scenario: Scenario
    held: Window
    """While the operating point is held, s: the angle is judged here."""
    settled: Window
    """Its settled part, s."""
    point: tuple[float, float] | None = None
    """Speed in per unit and torque in units of rated torque, if it is about one point."""
    since: float = 0.0
    """From when on a large angle error means that control is lost, s."""
    before: Scenario | None = None
    """An earlier run whose memory the scenario begins with."""
    traced: bool = False
    """Whether its course is kept for a picture."""
    error: str = ""
    """Name of what is wrong in the real machine, if anything is."""
    seed: int = 0
    """Of the plant's noise."""

    @property
    def near_line(self) -> bool:
        """Whether the point lies within `LINE` of zero stator frequency."""
        if self.point is None:
            return False
        omega, torque = self.point
        # 1e-9: a point on the border, such as speed 0.01 without load, lies within.
        return abs(omega + slip(self.scenario.motor, torque)) <= LINE + 1e-9

    def under(self, seed: int) -> Case:
        """The same under another realisation of the noise."""
        scenario, *before = seeded([self.scenario, *([self.before] if self.before else [])], seed)
        return replace(self, scenario=scenario, before=before[0] if before else None, seed=seed)


@dataclass(frozen=True)
class Target:
    """A kind of experiment: its runs for a machine, a scheme and an arithmetic, and what they must show."""

    name: str
    order: int
    """Its place among the targets."""
    title: str
    build: Callable[[str, str, str], list[Case]]
    check: Callable[[Case, Result, Measured], list[Claim]]
    """Claims about a run beyond the one that control was never lost."""
    verdict: Verdict = ""
    """The verdict on the confidence in which its runs count, if any."""
    view: View = "numbers"
    numbers: tuple[str, ...] = ()
    """Fields of `Measured` worth a column in its table."""
    map: bool = False
    """Whether it is a map: each run has a seed of its own, and all of them together are judged."""

    def cases(
        self, machine: str, scheme: str, arithmetic: str = "f32", seeds: Sequence[int] = (0,)
    ) -> list[Case]:
        """Its runs, each under every one of the seeds; those of a map under one of their own."""
        built = self.build(machine, scheme, arithmetic)
        if self.map:
            return [case.under(seed_of(self.name, case.label)) for case in built]
        return [case.under(seed) for case in built for seed in seeds]

    def judge(self, case: Case, result: Result, measured: Measured) -> list[Claim]:
        """Every claim about a run."""
        lost = f"lost at {measured.lost:.3g} s ({measured.why})" if measured.why else "held"
        return [holds("never lost", not measured.why, lost), *self.check(case, result, measured)]
