"""Runs the targets of the plane in processes and sums up what they showed.

Every run of a target is made under each of `seeds.SEEDS`, and the worst counts; on the two full maps (273
points at each machine under each scheme) every point has one realisation of the noise of its own, and a
coarse map is run under all five beside them. That is some 260,000 simulated seconds, with 250 of them a
second on two cores less than twenty minutes, on a busy machine half an hour.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stillflux.evidence.claims import Claim, Key, at_least, at_most, reported, worst
from stillflux.evidence.conditions import START
from stillflux.evidence.journal import Runner
from stillflux.evidence.judge import Measured, angle, measure
from stillflux.evidence.registry import targets
from stillflux.evidence.seeds import SEEDS
from stillflux.evidence.target import Case, Verdict
from stillflux.evidence.tolerance import start_up
from stillflux.parallel import run_jobs
from stillflux.plots import thin
from stillflux.result import Result
from stillflux.scenario import ProfileLike, Scenario
from stillflux.simulation import simulate

_AFTER_START = 0.1
"""From the end of the start-up to the first motion of a reference, s."""

__all__ = ["Row", "Summary", "Trace", "cases", "progress", "run_all", "run_case", "run_cases", "summaries"]

Trace: TypeAlias = Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]]
"""Times in s and values of "angle" (°), "speed" and "reference" (per unit), "torque" (of rated) and so on."""


@dataclass(frozen=True)
class Row:
    """What one run showed."""

    target: str
    machine: str
    scheme: str
    label: str
    seed: int
    error: str
    """Name of what is wrong in the real machine, if anything is."""
    point: tuple[float, float] | None
    """Speed in per unit and torque in units of rated torque, if it is about one point."""
    measured: Measured
    claims: tuple[Claim, ...]
    trace: Trace = field(default_factory=dict, repr=False, compare=False)

    @property
    def ok(self) -> bool:
        """Whether every claim holds."""
        return all(claim.ok for claim in self.claims)


@dataclass(frozen=True)
class Summary:
    """What all runs of a target showed at one machine under one scheme: the worst of each claim."""

    name: str
    """The target, or the verdict on the confidence."""
    machine: str
    scheme: str
    runs: int
    held: int
    """Runs in which every claim held."""
    claims: tuple[Claim, ...]


def cases(
    chosen: Sequence[str],
    machines: Sequence[str],
    schemes: Sequence[str],
    arithmetic: str = "f32",
    seeds: Sequence[int] = SEEDS,
) -> list[Case]:
    """All runs of targets at machines under schemes."""
    return [
        case
        for target in chosen
        for machine in machines
        for scheme in schemes
        for case in targets()[target].cases(machine, scheme, arithmetic, seeds)
    ]


def run_case(case: Case) -> Row:
    """Runs one case and judges it."""
    scenario = case.scenario
    if case.before is not None:
        scenario = scenario.replace(memory=_run(case.before).memory)
    result = _run(scenario)
    measured = measure(result, case.held, case.settled, case.since)
    claims = targets()[case.target].judge(case, result, measured)
    return Row(
        target=case.target,
        machine=case.machine,
        scheme=case.scheme,
        label=case.label,
        seed=case.seed,
        error=case.error,
        point=case.point,
        measured=measured,
        claims=tuple(replace(claim, run=case.label, seed=case.seed) for claim in claims),
        trace=trace(result) if case.traced else {},
    )


def _run(scenario: Scenario) -> Result:
    """A run whose references move from `START` on. A machine that has not started by then, since its rotor
    time constant is long, gets the time that it takes beyond: it is left out of the result."""
    late = start_up(scenario.motor, scenario.inverter) + _AFTER_START - START
    if late < 1e-6:
        return simulate(scenario)

    def later(profile: ProfileLike) -> ProfileLike:
        if not isinstance(profile, Sequence):
            return profile
        return [(0.0, profile[0][1]), *((t + late, value) for t, value in profile)]

    torque = scenario.torque_ref
    delayed = scenario.replace(
        omega_ref=later(scenario.omega_ref),
        torque_ref=None if torque is None else later(torque),
        load_torque=later(scenario.load_torque),
        changes=[(t + late, change) for t, change in scenario.changes],
        duration=scenario.duration + late,
    )
    result = simulate(delayed).window(late)
    return replace(result, scenario=scenario, t=result.t - late)


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


def run_cases(chosen: Sequence[Case], show: Show = None, runner: Runner = run_jobs) -> list[Row]:
    """Runs cases on all processors. On Ctrl-C raises `parallel.Stopped` with the rows there are by then."""
    jobs = [(case,) for case in chosen]
    return runner(run_case, jobs, first=lambda job: job[0].scenario.duration > 60.0, show=show)


def run_all(
    chosen: Sequence[str],
    machines: Sequence[str],
    schemes: Sequence[str],
    arithmetic: str = "f32",
    show: Show = None,
    runner: Runner = run_jobs,
) -> list[Row]:
    """Runs every case of targets at machines under schemes, as `run_cases` does."""
    return run_cases(cases(chosen, machines, schemes, arithmetic), show, runner)


def progress(done: int, total: int, row: Row) -> None:
    """A line on stderr for every run that falls short, and for every fiftieth."""
    if row.ok and done % 50 and done < total:
        return
    bad = "; ".join(f"{c.text}: {c.measured}" for c in row.claims if not c.ok)
    what = f"{row.target}, {row.machine}, {row.scheme}, {row.label}, seed {row.seed}"
    print(f"[{done:4d}/{total}] {what}: {bad or 'ok'}", file=sys.stderr, flush=True)


def summaries(rows: Sequence[Row]) -> list[Summary]:
    """One for each target, machine and scheme, and for each verdict on the confidence."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    judged: dict[tuple[Verdict, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.target, row.machine, row.scheme), []).append(row)
        if verdict := targets()[row.target].verdict:
            judged.setdefault((verdict, row.machine, row.scheme), []).append(row)
    return [
        *(Summary(*key, len(group), _held(group), _summed(group)) for key, group in groups.items()),
        *(_confidence(key, group) for key, group in judged.items()),
    ]


def _held(rows: Sequence[Row]) -> int:
    return sum(row.ok for row in rows)


def _summed(rows: Sequence[Row]) -> tuple[Claim, ...]:
    """How many runs meet their target, how many are lost, and the worst of each numeric claim."""
    by: dict[Key, list[Claim]] = {}
    for row in rows:
        for claim in row.claims:
            if claim.direction != "boolean":
                by.setdefault(claim.key, []).append(claim)
    lost = [row for row in rows if row.measured.why]
    first = min(lost, key=lambda row: row.measured.lost, default=None)
    return (
        at_least("runs that meet the target", _held(rows), len(rows), "runs"),
        replace(
            at_most("runs lost", len(lost), 0, "runs", first.measured.why if first else ""),
            run=first.label if first else "",
            seed=first.seed if first else None,
        ),
        *(replace(worst(group), note=_count(group)) for group in by.values()),
    )


def _count(group: Sequence[Claim]) -> str:
    return f"{sum(claim.ok for claim in group)} of {len(group)}"


def _confidence(key: tuple[Verdict, str, str], rows: Sequence[Row]) -> Summary:
    judged = [row.measured.confidence for row in rows]
    excursions, misses = sum(c.excursions for c in judged), sum(c.misses for c in judged)
    running = max(sum(c.running for c in judged), 1e-9)
    false = 100 * sum(c.false_time for c in judged) / running
    blind = 100 * sum(c.blind for c in judged) / running
    alarms = sum(c.false_alarms for c in judged)
    claims = (
        reported("excursions beyond 15°", excursions),
        at_most("excursions not announced", misses, 0, note=f"of {excursions}"),
        at_most("time beyond 15° at a confidence of 0.5 or more", blind, 0.0, "%"),
        reported("false alarms, part of the time", false, "%", f"{alarms} times"),
    )
    return Summary(*key, len(judged), sum(c.misses == 0 for c in judged), claims)
