"""Performs operations in processes: each with its negative control, at its drives, under every seed.

The worst of each claim counts, and the negative control has to fail under each seed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillflux.evidence.claims import Claim, worst_of_runs
from stillflux.evidence.journal import Runner
from stillflux.evidence.registry import operations
from stillflux.evidence.seeds import SEEDS, seeded
from stillflux.parallel import run_jobs
from stillflux.plots import thin
from stillflux.simulation import simulate

__all__ = ["Performed", "perform", "perform_all", "worst"]


@dataclass(frozen=True)
class Performed:
    """What happened at one drive under one scheme, in one run or in the worst of several."""

    name: str
    machine: str
    scheme: str
    claims: Sequence[Claim]
    without: Sequence[Claim]
    """Of the negative control."""
    traces: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]
    """Signals of the picture, and beside them those of the negative control under `without NAME`."""

    @property
    def ok(self) -> bool:
        """Whether every claim holds and the negative control fails as it must."""
        return all(claim.ok for claim in (*self.claims, *self.without))


def perform(name: str, machine: str, scheme: str, arithmetic: str, seed: int = SEEDS[0]) -> Performed:
    """Runs an operation and its negative control under a realisation of the noise."""
    operation = operations()[name]
    (scenario,) = seeded([operation.build(machine, scheme, arithmetic)], seed)
    result, without = simulate(scenario), simulate(operation.control.build(scenario))
    traces = {
        f"{prefix}{signal}": thin(run.t, abs(run[signal]) if run[signal].dtype.kind == "c" else run[signal])
        for prefix, run in (("", result), ("without ", without))
        for signal in operation.shown
    }
    claims = [replace(claim, seed=seed) for claim in operation.check(result)]
    controls = [
        replace(claim, quantity=f"without: {claim.quantity}", seed=seed)
        for claim in operation.control.check(without)
    ]
    return Performed(name, machine, scheme, tuple(claims), tuple(controls), traces)


def worst(found: Iterable[Performed]) -> list[Performed]:
    """The worst of each claim over the runs of an operation at a drive under a scheme; traces of one."""
    groups: dict[tuple[str, str, str], list[Performed]] = {}
    for x in found:
        groups.setdefault((x.name, x.machine, x.scheme), []).append(x)
    return [
        replace(
            runs[0],
            claims=tuple(worst_of_runs([x.claims for x in runs])),
            without=tuple(worst_of_runs([x.without for x in runs])),
        )
        for runs in groups.values()
    ]


def perform_all(
    names: Sequence[str],
    machines: Sequence[str],
    schemes: Sequence[str],
    arithmetic: str,
    show: Callable[[int, int, Performed], None] | None = None,
    runner: Runner = run_jobs,
) -> list[Performed]:
    """Every operation at those of the drives and under those of the schemes that it is shown with, under each
    of `seeds.SEEDS`: run by run, see `worst`."""
    jobs = [
        (name, machine, scheme, seed)
        for name in names
        for machine in operations()[name].machines
        if machine in machines
        for scheme in operations()[name].schemes
        if scheme in schemes
        for seed in SEEDS
    ]
    return runner(_perform, jobs, arithmetic, first=lambda job: job[1] in ("160kW", "fan"), show=show)


def _perform(name: str, machine: str, scheme: str, seed: int, arithmetic: str) -> Performed:
    return perform(name, machine, scheme, arithmetic, seed)
