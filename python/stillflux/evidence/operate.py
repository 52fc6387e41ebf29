"""Performs operations in processes: each with its negative control, at its drives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillflux.evidence.claims import Claim
from stillflux.evidence.journal import Runner
from stillflux.evidence.registry import operations
from stillflux.parallel import run_jobs
from stillflux.plots import thin
from stillflux.simulation import simulate

__all__ = ["Performed", "perform", "perform_all"]


@dataclass(frozen=True)
class Performed:
    """What happened at one drive under one scheme."""

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


def perform(name: str, machine: str, scheme: str, arithmetic: str) -> Performed:
    """Runs an operation and its negative control."""
    operation = operations()[name]
    scenario = operation.build(machine, scheme, arithmetic)
    result, without = simulate(scenario), simulate(operation.control.build(scenario))
    traces = {
        f"{prefix}{signal}": thin(run.t, abs(run[signal]) if run[signal].dtype.kind == "c" else run[signal])
        for prefix, run in (("", result), ("without ", without))
        for signal in operation.shown
    }
    controls = [
        replace(claim, quantity=f"without: {claim.quantity}") for claim in operation.control.check(without)
    ]
    return Performed(name, machine, scheme, tuple(operation.check(result)), tuple(controls), traces)


def perform_all(
    names: Sequence[str],
    machines: Sequence[str],
    schemes: Sequence[str],
    arithmetic: str,
    show: Callable[[int, int, Performed], None] | None = None,
    runner: Runner = run_jobs,
) -> list[Performed]:
    """Every operation at those of the drives and under those of the schemes that it is shown with."""
    jobs = [
        (name, machine, scheme)
        for name in names
        for machine in operations()[name].machines
        if machine in machines
        for scheme in operations()[name].schemes
        if scheme in schemes
    ]
    return runner(perform, jobs, arithmetic, first=lambda job: job[1] in ("160kW", "fan"), show=show)
