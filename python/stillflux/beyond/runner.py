"""Runs cases in processes and sums up what they showed."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stillflux.beyond.judge import Measured, angle, measure
from stillflux.beyond.targets import TARGETS, Case, cases
from stillflux.claims import Claim, at_most
from stillflux.parallel import run_jobs
from stillflux.plots import thin
from stillflux.result import Result
from stillflux.simulation import simulate

__all__ = ["Row", "Summary", "Trace", "progress", "run_all", "run_case", "run_cases", "summaries"]

Trace: TypeAlias = Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]]
"""Times in s and values of "angle" (°), "speed" and "reference" (per unit), "torque" (of rated) and so on."""


@dataclass(frozen=True)
class Row:
    """What one run showed."""

    target: str
    machine: str
    scheme: str
    label: str
    point: tuple[float, float] | None
    """Speed in per unit and torque in units of rated torque, if it is about one point."""
    measured: Measured
    claims: tuple[Claim, ...]
    trace: Trace = field(default_factory=dict, repr=False, compare=False)

    @property
    def ok(self) -> bool:
        """Whether every claim holds."""
        return all(claim.ok for claim in self.claims)

    @property
    def name(self) -> str:
        """Its label, with the point where the label does not say it."""
        if self.target != "mismatch" or self.point is None:
            return self.label
        return f"{self.label} at ω = {self.point[0]:g}, T = {self.point[1]:g} T_N"


@dataclass(frozen=True)
class Summary:
    """What all runs of a target showed at one machine under one scheme: the worst of each claim."""

    target: str
    machine: str
    scheme: str
    runs: int
    held: int
    """Runs in which every claim held."""
    claims: tuple[Claim, ...]

    @property
    def figure(self) -> str:
        """Its name in the table of metrics."""
        return f"{self.target}, {self.scheme}"


def run_case(case: Case) -> Row:
    """Runs one case and judges it."""
    scenario = case.scenario
    if case.before is not None:
        scenario = scenario.replace(memory=simulate(case.before).memory)
    result = simulate(scenario)
    measured = measure(result, case.held, case.settled, case.since)
    return Row(
        target=case.target,
        machine=case.machine,
        scheme=case.scheme,
        label=case.label,
        point=case.point,
        measured=measured,
        claims=tuple(TARGETS[case.target].check(case, result, measured)),
        trace=trace(result) if case.traced else {},
    )


def trace(result: Result) -> Trace:
    """The course of a run, thinned for a picture."""
    base, T_N = result.scenario.motor.base, result.scenario.motor.T_N
    signals = {
        "angle": angle(result),
        "speed": result["omega_m"] / base["omega_m"],
        "torque": result["torque"] / T_N,
        "load": result["load_torque"] / T_N,
        "confidence": result["estimate.confidence"],
    }
    if result.scenario.torque_ref is None:
        signals["reference"] = result["reference"] / base["omega_m"]
    return {name: thin(result.t, values, 600) for name, values in signals.items()}


Show: TypeAlias = Callable[[int, int, Row], None] | None
"""Called with the number of runs done, the number of all, and the latest."""


def run_cases(chosen: Sequence[Case], show: Show = None) -> list[Row]:
    """Runs cases on all processors. On Ctrl-C raises `parallel.Stopped` with the rows there are by then."""
    jobs = [(case,) for case in chosen]
    return run_jobs(run_case, jobs, first=lambda job: job[0].scenario.duration > 60.0, show=show)


def run_all(
    targets: Sequence[str],
    machines: Sequence[str],
    schemes: Sequence[str],
    arithmetic: str = "f32",
    show: Show = None,
) -> list[Row]:
    """Runs every case of targets at machines under schemes, as `run_cases` does."""
    return run_cases(cases(targets, machines, schemes, arithmetic), show)


def progress(done: int, total: int, row: Row) -> None:
    """A line on stderr for every run that falls short, and for every fiftieth."""
    if row.ok and done % 50 and done < total:
        return
    bad = "; ".join(f"{c.text}: {c.measured}" for c in row.claims if not c.ok)
    what = f"{row.target}, {row.machine}, {row.scheme}, {row.name}"
    print(f"[{done:4d}/{total}] {what}: {bad or 'ok'}", file=sys.stderr, flush=True)


def summaries(rows: Sequence[Row]) -> list[Summary]:
    """One for each target, machine and scheme, and for each verdict on the confidence."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.target, row.machine, row.scheme), []).append(row)
    found = [
        Summary(*key, len(group), sum(row.ok for row in group), (_all(group), *_worst(group)))
        for key, group in groups.items()
    ]
    judged: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        if verdict := TARGETS[row.target].verdict:
            judged.setdefault((verdict, row.machine, row.scheme), []).append(row)
    return found + [_confidence(key, group) for key, group in judged.items()]


def _all(rows: Sequence[Row]) -> Claim:
    share = 100 * sum(row.ok for row in rows) / len(rows)
    held = sum(row.ok for row in rows)
    return Claim(
        "runs that meet all of it",
        f"{held} of {len(rows)}",
        held == len(rows),
        value=share,
        limit=100.0,
        unit=" %",
    )


def _worst(rows: Sequence[Row]) -> list[Claim]:
    by: dict[str, list[Claim]] = {}
    for row in rows:
        for claim in row.claims:
            by.setdefault(claim.text, []).append(claim)
    return [_worst_of(group) for group in by.values()]


def _worst_of(group: Sequence[Claim]) -> Claim:
    held = sum(claim.ok for claim in group)
    count = f"{held} of {len(group)}"
    numbers = [c for c in group if c.value is not None and c.limit is not None]
    if not numbers:
        return Claim(group[0].text, count, held == len(group), value=100 * held / len(group), unit=" %")
    # "≥" or "≤": the worst is the one that is furthest on the failing side.
    least = "≥" in group[0].text
    worst = (min if least else max)(numbers, key=lambda c: c.value or 0.0)
    return replace(worst, measured=f"{worst.measured} ({count})", ok=held == len(group))


def _confidence(key: tuple[str, str, str], rows: Sequence[Row]) -> Summary:
    judged = [row.measured.confidence for row in rows]
    excursions, misses = sum(c.excursions for c in judged), sum(c.misses for c in judged)
    running = sum(c.running for c in judged)
    false = 100 * sum(c.false_time for c in judged) / running if running else 0.0
    blind = 100 * sum(c.blind for c in judged) / running if running else 0.0
    alarms = sum(c.false_alarms for c in judged)
    missed = at_most("excursions beyond 15° at a confidence of 0.5 or more", misses, 0.0)
    claims = (
        replace(missed, measured=f"{misses} of {excursions}"),
        Claim("time so", f"{blind:.2g} %", blind == 0.0, value=blind, unit=" %"),
        Claim(
            "confidence below 0.5 for more than 0.5 s with an error below 5°",
            f"{alarms} times, {false:.2g} % of the time",
            True,
            value=false,
            unit=" %",
        ),
    )
    runs = len(judged)
    return Summary(*key, runs, sum(c.misses == 0 for c in judged), claims)
