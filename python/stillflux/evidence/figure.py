"""What a file in `figures` holds: experiments with their claims, plot, negative control and limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from stillflux.evidence.claims import Claim
from stillflux.evidence.conditions import SCHEMES
from stillflux.evidence.judge import lost
from stillflux.evidence.machines import MACHINES, OwnMachine
from stillflux.evidence.openloop import OpenLoop
from stillflux.evidence.paper import RUN
from stillflux.evidence.seeds import REALISATIONS, SEEDS, realised
from stillflux.options import DriveSettings
from stillflux.result import Result
from stillflux.scenario import Scenario
from stillflux.simulation import DivergenceError, Progress, simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from typing_extensions import Unpack

__all__ = [
    "Control",
    "Controlled",
    "Experiment",
    "Limit",
    "Role",
    "enhanced",
    "fields",
    "first",
    "inverter",
    "settings",
    "until_it_runs_away",
    "warmer_winding",
]

Runs: TypeAlias = Sequence[Any]
"""Scenarios or `OpenLoop` runs."""
Change: TypeAlias = Callable[[Runs], Runs]
"""Makes the runs of a negative control out of those of the experiment."""


Role: TypeAlias = Literal["published", "control", "enhanced"]
"""The experiment itself, its negative control, or the same with the scheme that goes beyond the paper."""


@dataclass(frozen=True)
class Limit:
    """What the published scheme cannot do on a machine, and why."""

    quantities: tuple[str, ...]
    """Of the claims that fail; every other claim has to hold."""
    reason: str
    """Why they must fail."""


@dataclass(frozen=True)
class Control:
    """The same runs with the mechanism left out, in which a named claim has to fail, and not before its
    time."""

    text: str
    """What is left out."""
    change: Change
    expected: tuple[str, ...]
    """Quantities of the claims for which the mechanism is there: one of them has to fail."""
    event: float = 0.0
    """From when on the mechanism is needed, s: until then the drive must not be lost."""


@dataclass(frozen=True)
class Controlled:
    """What a negative control did."""

    claims: tuple[Claim, ...]
    expected: tuple[Claim, ...]
    """Those of the claims it is there for."""
    lost: float
    """Time at which control was lost, s; inf: never."""
    event: float
    """When the mechanism begins to be needed, s."""

    @property
    def ok(self) -> bool:
        """Whether it fails for its reason, and not before its event."""
        return self.lost >= self.event and any(not claim.ok for claim in self.expected)


@dataclass(frozen=True)
class Experiment:
    """Runs for each machine and arithmetic, and the claims about their results."""

    name: str
    """Number of the paper's figure."""
    title: str
    claim: str
    """What the paper shows."""
    build: Callable[[str, str], Any]
    """A scenario, or several."""
    check: Callable[..., list[Claim]]
    """Takes the results."""
    draw: Callable[..., Figure]
    """Takes the results."""
    control: Control | None
    no_control: str = ""
    """Why there is none."""
    limits: Mapping[str, Limit] = field(default_factory=dict)
    """By machine."""
    chained: bool = False
    """Each run begins with what the one before has stored; those of the negative control do not."""
    of_paper: bool = True
    """Whether it is a figure of the paper."""
    own: tuple[str, ...] = ()
    """Quantities of blocks that only the published scheme has."""
    directed: bool = True
    """Whether the direction of the offset is free."""
    machines: tuple[str, ...] = MACHINES
    """Where it is run."""
    beside: str = ""
    """Why there is nothing to put beside it: it is about a block of the published scheme. Empty: the scheme
    that goes beyond it runs the same experiment."""

    def at(self, machine: str) -> bool:
        """Whether it is run at a machine: a user's own takes part in what is not about single machines."""
        own = isinstance(machine, OwnMachine) and self.machines == MACHINES
        return own or machine in self.machines

    def runs(self, machine: str, arithmetic: str = "f32", seed: int = 0, *, role: Role = "published") -> Runs:
        """What is to be run under a realisation of noise and offset."""
        built = self.build(machine, arithmetic)
        runs = realised(built if isinstance(built, tuple) else (built,), seed)
        if role == "control" and self.control is not None:
            return self.control.change(runs)
        return tuple(map(enhanced, runs)) if role == "enhanced" else runs

    def noisy(self, machine: str) -> bool:
        """Whether noise takes part, so that the seed makes a difference."""
        return not all(isinstance(run, OpenLoop) for run in self.runs(machine))

    def realisations(self, machine: str) -> tuple[int, ...]:
        """Realisations of noise and offset under which it is judged."""
        if not self.noisy(machine):
            return SEEDS[:1]
        return REALISATIONS if self.directed else SEEDS

    def simulate(
        self, machine: str, arithmetic: str = "f32", seed: int = 0, *, role: Role = "published"
    ) -> tuple[Any, ...]:
        """Runs it, its negative control, or the same with the other scheme."""
        results: list[Any] = []
        for run in self.runs(machine, arithmetic, seed, role=role):
            if isinstance(run, OpenLoop):
                results.append(run.run())
            elif self.chained and results and role != "control":
                results.append(until_it_runs_away(run.replace(memory=results[-1].memory)))
            else:
                results.append(until_it_runs_away(run))
        return tuple(results)

    def run(self, machine: str, arithmetic: str = "f32", seed: int = 0) -> list[Claim]:
        """Simulates and judges."""
        return self.check(*self.simulate(machine, arithmetic, seed))

    def run_control(self, machine: str, arithmetic: str = "f32", seed: int = 0) -> Controlled | None:
        """Simulates and judges the negative control, if there is one."""
        if self.control is None:
            return None
        return self.judge_control(self.simulate(machine, arithmetic, seed, role="control"))

    def judge_control(self, results: Sequence[Any]) -> Controlled:
        """Judges what the runs of the negative control showed."""
        assert self.control is not None
        claims = self.check(*results)
        losses = [lost(r, since=RUN)[0] for r in results if isinstance(r, Result)]
        return Controlled(
            claims=tuple(claims),
            expected=tuple(c for c in claims if c.quantity in self.control.expected),
            lost=min(losses, default=math.inf),
            event=self.control.event,
        )

    def unexpected(self, machine: str, judged: Sequence[Claim]) -> list[Claim]:
        """The claims that do not hold and that no limit explains."""
        excused = self.limits[machine].quantities if machine in self.limits else ()
        return [claim for claim in judged if not claim.ok and claim.quantity not in excused]


def until_it_runs_away(scenario: Scenario, progress: Progress = None) -> Result:
    """The run, up to where its shaft leaves what the plant can compute: a drive that is lost leaves it to its
    load."""
    try:
        return simulate(scenario, progress)
    except DivergenceError as stop:
        return stop.result


def enhanced(run: Any) -> Any:
    """The same run with the scheme that goes beyond the paper, at its defaults: settings of blocks that it
    does not have are left out."""
    if not isinstance(run, Scenario):
        return run
    kept = {name: value for name, value in run.settings.items() if name in _COMMON}
    published, beyond = SCHEMES
    name = run.name.replace(f", {published},", f", {beyond},")
    return run.replace(scheme=beyond, settings=kept, name=name)


_COMMON = ("calibrate_offset", "psi_ref", "supervision")
"""Settings that figures change and that both schemes have."""


def settings(**changed: Unpack[DriveSettings]) -> Change:
    """Every drive with other settings."""
    return lambda runs: tuple(run.with_settings(**changed) for run in runs)


def told_what_is_simulated(runs: Runs) -> Runs:
    """Every drive with the parameters of the motor that is simulated, as constants."""
    return tuple(run.replace(motor=run.plant_motor) for run in runs)


def first(change: Change) -> Change:
    """Only the first run changed."""
    return lambda runs: (*change(runs[:1]), *runs[1:])


def fields(**changed: Any) -> Change:
    """Every scenario with other fields."""
    return lambda runs: tuple(run.replace(**changed) for run in runs)


def inverter(**changed: Any) -> Change:
    """Every run with another inverter, which the drive knows too."""
    return lambda runs: tuple(run.replace(inverter=run.inverter.replace(**changed)) for run in runs)


def warmer_winding(event: float, expected: tuple[str, ...]) -> Control:
    """The control of a load step at `event` s: the real resistance is 25 % larger from 0.5 s before on."""

    def change(runs: Runs) -> Runs:
        return tuple(run.replace(changes=[(event - 0.5, {"R_s": 1.25 * run.motor.R_s})]) for run in runs)

    return Control(
        "winding 25 % warmer from 0.5 s before the step on, r̂_s kept", change, expected, event=event
    )
