"""Runs the paper's figures with their negative controls, in parallel, and judges them.

Every figure runs under each of its realisations of noise and offset (`seeds.REALISATIONS`) and each claim is
judged by its worst run; the negative control runs under two of them, with opposite offsets, and has to fail
in both. The scheme that goes beyond the paper runs the same experiment under `seeds.BESIDE`: what it measures
stands beside and takes no part in the verdict. What no noise takes part in (Figs. 2 and 6, which have no
drive) runs once.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

from stillflux.evidence.claims import Claim, worst_of_runs
from stillflux.evidence.figure import Controlled, Experiment, Role
from stillflux.evidence.journal import Runner
from stillflux.evidence.openloop import Line, VoltageFed, Waveforms
from stillflux.evidence.paper import OFFSET_FOUND
from stillflux.evidence.registry import experiments
from stillflux.evidence.report.page import conditions
from stillflux.evidence.seeds import BESIDE, SEEDS
from stillflux.html_page import svg
from stillflux.parallel import run_jobs

__all__ = ["Outcome", "Run", "jobs", "judge", "outcomes", "progress", "run", "run_all"]

Verdict: TypeAlias = Literal["reproduced", "limit", "FAILED"]
"""Limit: falls short as explained."""
Job: TypeAlias = tuple[str, str, int, Role]
"""Figure, machine, realisation, and what is run."""


@dataclass(frozen=True)
class Run:
    """One figure at one machine under one realisation, its negative control, or the other scheme's run."""

    figure: str
    machine: str
    seed: int
    role: Role
    claims: tuple[Claim, ...]
    control: Controlled | None = None
    """Set for a negative control."""
    conditions: str = ""
    picture: str = ""
    """The plot as SVG."""


@dataclass(frozen=True)
class Outcome:
    """One figure at one machine: the worst over its runs."""

    figure: str
    machine: str
    verdict: Verdict
    claims: tuple[Claim, ...]
    control: tuple[Controlled, ...]
    """What the negative control did under each of its seeds; empty: there is none."""
    enhanced: tuple[Claim, ...] = ()
    """The worst of every claim over the runs of the other scheme; empty: it has none."""
    conditions: str = ""
    picture: str = ""

    @property
    def experiment(self) -> Experiment:
        """What was run."""
        return experiments()[self.figure]

    @property
    def reason(self) -> str:
        """Why it falls short; empty if it does not."""
        return self.experiment.limits[self.machine].reason if self.verdict == "limit" else ""

    @property
    def summary(self) -> str:
        """The claims that say most: those that fail, else the first that have a number."""
        shown = [claim for claim in self.claims if not claim.ok]
        shown = shown or [c for c in self.claims if c.direction != "boolean"][:3] or list(self.claims[:1])
        return "; ".join(f"{claim.text}: {claim.measured}" for claim in shown)

    @property
    def control_claim(self) -> Claim | None:
        """The claim that the negative control fails, where it fails least; None if there is no control."""
        failing = [
            max(run.expected, key=lambda claim: (not claim.ok, claim.excess))
            for run in self.control
            if run.expected
        ]
        return min(failing, key=lambda claim: claim.excess, default=None)

    @property
    def control_text(self) -> str:
        """What the negative control leaves out and what fails then."""
        control, claim = self.experiment.control, self.control_claim
        if control is None:
            return f"no control found: {self.experiment.no_control}"
        if claim is None or not all(run.ok for run in self.control):
            return f"{control.text}: does not fail as it must"
        return f"{control.text}: {claim.text}: {claim.measured}"


def judge(
    experiment: Experiment, machine: str, claims: Sequence[Claim], control: Sequence[Controlled]
) -> Verdict:
    """The verdict on claims and on what the negative control did."""
    if experiment.control is not None and not (control and all(run.ok for run in control)):
        return "FAILED"
    if experiment.unexpected(machine, claims):
        return "FAILED"
    return "reproduced" if all(claim.ok for claim in claims) else "limit"


def run(
    figure: str, machine: str, seed: int, role: Role, arithmetic: str = "f32", folder: Path | None = None
) -> Run:
    """Runs one job; with a folder, draws the figure under the first realisation there as PNG."""
    experiment = experiments()[figure]
    results = experiment.simulate(machine, arithmetic, seed, role=role)
    noise = seed if experiment.noisy(machine) else None
    if role == "control":
        judged = experiment.judge_control(results)
        expected = tuple(replace(claim, seed=noise) for claim in judged.expected)
        return Run(figure, machine, seed, role, (), replace(judged, expected=expected))
    claims = tuple(replace(claim, seed=noise) for claim in experiment.check(*results))
    if role == "enhanced":
        claims = tuple(claim for claim in claims if claim.quantity not in (*experiment.own, OFFSET_FOUND))
    if folder is None or seed != SEEDS[0] or role != "published":
        return Run(figure, machine, seed, role, claims)
    drawing = experiment.draw(*results)
    drawing.savefig(folder / f"figure-{figure}-{machine}.png", dpi=100)
    drawing.set_layout_engine("none")
    described = _described(results[-1] if experiment.chained else results[0])
    return Run(figure, machine, seed, role, claims, None, described, svg(drawing))


def _described(result: Any) -> str:
    if isinstance(result, Waveforms):
        run: VoltageFed = result.run
        return (
            f"Conditions: open loop, u* on a circle, shaft speed imposed, rated flux; switching plant, "
            f"{run.inverter.f_s / 1e3:g} kHz, dc link {run.inverter.u_dc:g} V, dead time "
            f"{1e6 * run.inverter.dead_time:g} µs, threshold {run.inverter.u_th:g} V, "
            f"r_d {run.inverter.r_d:g} Ω."
        )
    if isinstance(result, Line):
        at_rest = result.run.inverter
        return (
            f"Conditions: open loop, direct current at rest; switching plant, {at_rest.f_s / 1e3:g} kHz, "
            f"dc link {at_rest.u_dc:g} V, dead time {1e6 * at_rest.dead_time:g} µs, "
            f"threshold {at_rest.u_th:g} V."
        )
    return conditions(result)


def jobs(figures: Sequence[str], machines: Sequence[str]) -> list[Job]:
    """Every run of figures at machines."""
    found: list[Job] = []
    for figure in figures:
        experiment = experiments()[figure]
        for machine in filter(experiment.at, machines):
            chosen = experiment.realisations(machine)
            found += [(figure, machine, seed, "published") for seed in chosen]
            if experiment.control is not None:
                # Two, as far apart as can be: of opposite offsets, if its direction is free.
                two = chosen[:: max(1, len(chosen) // 2)][:2]
                found += [(figure, machine, seed, "control") for seed in two]
            if not experiment.beside and experiment.noisy(machine):
                found += [(figure, machine, seed, "enhanced") for seed in BESIDE if seed in chosen]
    return found


def outcomes(runs: Iterable[Run]) -> list[Outcome]:
    """Verdicts, one for each figure and machine, in the order of the runs."""
    groups: dict[tuple[str, str], list[Run]] = {}
    for one in runs:
        groups.setdefault((one.figure, one.machine), []).append(one)
    found = []
    for (figure, machine), group in groups.items():
        plain = [one for one in group if one.role == "published"]
        beside = worst_of_runs([one.claims for one in group if one.role == "enhanced"])
        control = tuple(one.control for one in group if one.control is not None)
        claims = worst_of_runs([one.claims for one in plain])
        verdict = judge(experiments()[figure], machine, claims, control)
        drawn = next((one for one in plain if one.picture), plain[0])
        found.append(
            Outcome(
                figure,
                machine,
                verdict,
                tuple(claims),
                control,
                tuple(beside),
                drawn.conditions,
                drawn.picture,
            )
        )
    return found


def whole(runs: Iterable[Run], figures: Sequence[str], machines: Sequence[str]) -> list[Run]:
    """Of runs that were interrupted those of figures and machines of which every one is done."""
    done = list(runs)
    missing = set(jobs(figures, machines)) - {(x.figure, x.machine, x.seed, x.role) for x in done}
    partial = {(figure, machine) for figure, machine, *_ in missing}
    return [x for x in done if (x.figure, x.machine) not in partial]


def run_all(
    figures: Sequence[str],
    machines: Sequence[str],
    arithmetic: str = "f32",
    folder: Path | None = None,
    show: Callable[[int, int, Run], None] | None = None,
    runner: Runner = run_jobs,
) -> list[Outcome]:
    """Runs figures at machines in as many processes as there are processors; `show` reports progress."""
    todo = jobs(figures, machines)
    if not todo:
        raise ValueError(f"figure {', '.join(figures)}: none of them is run at {', '.join(machines)}")
    return outcomes(runner(run, todo, arithmetic, folder, first=is_long, show=show))


def is_long(job: tuple[Any, ...]) -> bool:
    """Whether a run takes more than a minute of simulated time."""
    figure, machine, *_ = job
    runs = experiments()[figure].runs(machine)
    return sum(getattr(one, "duration", 0.0) for one in runs) > 60.0


def progress(done: int, total: int, one: Run) -> None:
    """One line on stderr for each run."""
    if one.control is None:
        who = "" if one.role == "published" else f"{one.role}, "
        bad = "; ".join(f"{c.text}: {c.measured}" for c in one.claims if not c.ok)
        what = f"{who}seed {one.seed}: {bad or 'ok'}"
    else:
        what = (
            f"negative control, seed {one.seed}: {'fails' if one.control.ok else 'DOES NOT FAIL as it must'}"
        )
    print(f"[{done:3d}/{total}] Fig. {one.figure}, {one.machine}, {what}", file=sys.stderr, flush=True)
