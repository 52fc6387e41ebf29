"""The targets: which runs, and what each of them must show on the plant's truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from stillflux.beyond import scenarios as s
from stillflux.beyond.judge import EXCURSION, Measured, Window
from stillflux.claims import Claim, at_least, at_most
from stillflux.metrics import settled_after, speed_error
from stillflux.result import Result
from stillflux.scenario import Scenario

__all__ = ["KNOWN", "STEPPED", "TARGETS", "Case", "Target", "choose"]

KNOWN, STEPPED = "confidence", "confidence-stepped"
"""Verdicts on the confidence: over the runs of targets 1 to 4, and over those in which the offset of a sensor
steps while the drive runs, which is not what the confidence takes a sensor for: one that drifts slowly."""

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

    @property
    def near_line(self) -> bool:
        """Whether the point lies within `LINE` of zero stator frequency."""
        if self.point is None:
            return False
        omega, torque = self.point
        # 1e-9: a point on the border, such as speed 0.01 without load, lies within.
        return abs(omega + s.slip(self.scenario.motor, torque)) <= LINE + 1e-9


Check = Callable[[Case, Result, Measured], list[Claim]]


@dataclass(frozen=True)
class Target:
    """A kind of experiment: its runs for a machine, a scheme and an arithmetic, and what they must show."""

    title: str
    cases: Callable[[str, str, str], list[Case]]
    check: Check
    verdict: str = ""
    """The verdict on the confidence in which its runs count, if any: `KNOWN` or `STEPPED`."""
    numbers: tuple[str, ...] = field(default=())
    """Fields of `Measured` worth a column in its table."""


def _kept(m: Measured) -> Claim:
    measured = "held" if not m.why else f"lost at {m.lost:.3g} s ({m.why})"
    return Claim("never lost", measured, not m.why)


def _case(
    target: str,
    scenario: Scenario,
    label: str,
    held: Window,
    settled: Window | None = None,
    point: tuple[float, float] | None = None,
    since: float = 0.0,
    traced: bool = False,
) -> Case:
    machine, scheme = scenario.name.split(", ")[-3:-1]
    return Case(target, machine, scheme, label, scenario, held, settled or held, point, since, None, traced)


# 1. The plane.


def _plane_cases(kind: str, machine: str, scheme: str, arithmetic: str) -> list[Case]:
    speeds = (0.0,) if kind.startswith("rest") else s.SPEEDS
    end = s.REACHED + s.HOLD
    return [
        _case(
            f"plane-{kind}",
            s.plane(machine, scheme, arithmetic, omega=omega, torque=torque, kind=kind),
            f"ω = {omega:g}, T = {torque:g} T_N",
            (s.REACHED, end),
            (end - 15.0, end),
            (omega, torque),
        )
        for omega in speeds
        for torque in s.TORQUES
    ]


def _plane(case: Case, result: Result, m: Measured) -> list[Claim]:
    del result
    if case.near_line:
        return [
            _kept(m),
            at_most("field angle error within 0.01 of ω_s = 0", m.angle_settled, EXCURSION, "°"),
        ]
    return [
        _kept(m),
        at_most("field angle error", m.angle_settled, 3.0, "°"),
        at_most("speed error", m.speed_settled, 0.003, " pu"),
    ]


# 2. Crossing.


def _crossing_cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    return [
        _case(
            "crossing",
            s.crossing(machine, scheme, arithmetic, begin=begin, torque=torque, time=time),
            f"{begin:g} to {-begin:g} in {time:g} s, T = {torque:g} T_N",
            (s.REACHED, s.CROSS_AT + time + s.CROSS_REST),
            traced=True,
        )
        for time in (20.0, 60.0)
        for begin in (0.1, -0.1)
        for torque in (1.0, -1.0)
    ]


def _crossing(case: Case, result: Result, m: Measured) -> list[Claim]:
    del case, result
    return [
        _kept(m),
        at_most("true torque against commanded", 100 * m.torque_command, 10.0, " % of T_N"),
        at_most("true torque against estimated", 100 * m.torque_estimate, 10.0, " % of T_N"),
    ]


# 3. Persistence.


def _persistence_cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    scenario = s.persistence(machine, scheme, arithmetic).replace(record_every=200)
    end = scenario.duration
    case = _case(
        "persistence-no-load",
        scenario,
        "600 s, then a rated step",
        (s.PERSIST_AT, end),
        (end - 2.0, end),
        traced=True,
    )
    return [case]


def _persistence(case: Case, result: Result, m: Measured) -> list[Claim]:
    del case, result
    return [_kept(m), at_most("speed error under the rated step", m.speed_settled, 0.003, " pu")]


def _line_cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    return [
        _line_case("persistence-rated", s.rated_at_line(machine, scheme, arithmetic, torque=torque), torque)
        for torque in (1.0, -1.0)
    ]


def _line_case(target: str, scenario: Scenario, torque: float, settled: Window | None = None) -> Case:
    """A stay at the speed at which ω_s would be zero at rated flux."""
    return _case(
        target,
        scenario,
        f"T = {torque:g} T_N",
        (s.REACHED, scenario.duration),
        settled,
        (s.line_speed(scenario.motor, torque), torque),
        traced=True,
    )


def _line(case: Case, result: Result, m: Measured) -> list[Claim]:
    begin, end = case.held
    kept = min(m.angle_passed, m.lost, end) - begin
    del result
    return [_kept(m), at_least("time with an angle error below 15°", kept, s.HOLD, " s")]


def _shifted_cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    # The published scheme has no flux shift.
    cases = []
    for torque in (1.0, -1.0) if scheme == "enhanced" else ():
        scenario = s.shifted(machine, scheme, arithmetic, torque=torque).replace(record_every=100)
        stay = (s.REACHED + 5.0, scenario.duration - s.LEAVE_TIME - s.LEAVE_REST)
        cases.append(_line_case("persistence-shifted", scenario, torque, stay))
    return cases


def _shifted(case: Case, result: Result, m: Measured) -> list[Claim]:
    part = result.window(*case.settled)
    whole = result.window(case.settled[0])
    rated = result.window(case.held[1] - 1.0)
    current = [float(np.abs(r["estimate.i_dq_ref"]).mean()) for r in (part, rated)]
    moved = float(np.abs(whole["torque"] - whole["load_torque"]).max()) / result.scenario.motor.T_N
    return [
        _kept(m),
        at_most("field angle error", m.angle_held, 5.0, "°"),
        at_most("speed error", m.speed_settled, 0.003, " pu"),
        at_most("torque ripple", 100 * m.torque_ripple, 5.0, " % of T_N"),
        at_most("torque off the load's while the flux changes", 100 * moved, 10.0, " % of T_N"),
        at_most("current against that at rated flux", current[0] / current[1], 1.4, " ×"),
    ]


# 4. Mismatch.


def _mismatch_cases(target: str, machine: str, scheme: str, arithmetic: str) -> list[Case]:
    end = s.REACHED + s.HOLD
    stepped = target == "mismatch-stepped"
    return [
        _case(
            target,
            s.mismatch(machine, scheme, arithmetic, error=error, omega=omega, torque=torque),
            error,
            (s.REACHED, end),
            (end - 5.0, end),
            (omega, torque),
        )
        for error in s.MISMATCHES
        if (error in s.STEPPED) == stepped
        for omega, torque in s.POINTS
    ]


def _mismatch(case: Case, result: Result, m: Measured) -> list[Claim]:
    del case, result
    return [_kept(m), at_most("field angle error after adaptation", m.angle_settled, 10.0, "°")]


# 5. Transients.


def _torque_cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    at = s.TORQUE_STEP_AT
    return [
        _case(
            "transient-torque",
            s.torque_step(machine, scheme, arithmetic, omega=omega, torque=torque),
            f"ω = {omega:g}, to {torque:g} T_N",
            (at, at + 1.0),
            (at + 0.1, at + 1.0),
            (omega, torque),
        )
        for omega in s.SPEEDS
        for torque in (1.0, -1.0)
    ]


def _torque(case: Case, result: Result, m: Measured) -> list[Claim]:
    assert case.point is not None
    after = result.window(s.TORQUE_STEP_AT)
    there = np.flatnonzero(after["torque"] / (case.point[1] * result.scenario.motor.T_N) >= 0.9)
    rise = 1e3 * float(after.t[there[0]] - s.TORQUE_STEP_AT) if len(there) else math.inf
    return [
        _kept(m),
        at_most("90 % of the torque step", rise, 5.0, " ms"),
        at_most("true torque against commanded", 100 * m.torque_command, 10.0, " % of T_N"),
    ]


def _load_cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    return [
        _case(
            "transient-load",
            s.load_steps(machine, scheme, arithmetic, torque=torque),
            f"{100 * torque:+.0f} %",
            (s.LOAD_STEP_AT, s.UNLOAD_AT + 3.0),
        )
        for torque in (1.2, -1.2)
    ]


def _load(case: Case, result: Result, m: Measured) -> list[Claim]:
    on = result.window(0.0, s.UNLOAD_AT - 0.01)
    band = 0.002
    del case
    return [
        _kept(m),
        at_most(
            "speed within ±0.002 after the load is on", settled_after(on, s.LOAD_STEP_AT, band), 1.0, " s"
        ),
        at_most("speed within ±0.002 after it is off", settled_after(result, s.UNLOAD_AT, band), 1.0, " s"),
        at_most("field angle error", m.angle_held, 5.0, "°"),
    ]


def _reversal_cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    end = s.REVERSE_AT + s.REVERSAL + 3.0
    return [
        _case(
            "transient-reversal",
            s.reversal(machine, scheme, arithmetic, begin=begin, torque=torque),
            f"{begin:g} to {-begin:g}, T = {torque:g} T_N",
            (s.START + 5.0, end),
            (end - 1.0, end),
            traced=True,
        )
        for begin in (-1.0, 1.0)
        for torque in (0.5, -0.5)
    ]


def _reversal(case: Case, result: Result, m: Measured) -> list[Claim]:
    del case, result
    return [
        _kept(m),
        at_most("field angle error", m.angle_held, 5.0, "°"),
        at_most("speed error at the end", m.speed_settled, 0.003, " pu"),
    ]


def _weakening_cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    end = s.WEAKENED_AT + 9.0
    return [
        _case(
            "transient-weakening",
            s.field_weakening(machine, scheme, arithmetic, top=top, torque=torque),
            f"rest to {top:g} and back, T = {torque:g} T_N",
            (s.START + 1.0, end),
            traced=True,
        )
        for top, torque in ((2.0, 0.0), (2.0, 0.3), (-2.0, 0.3))
    ]


def _weakening(case: Case, result: Result, m: Measured) -> list[Claim]:
    part = result.window(*case.held)
    estimate = (part["estimate.omega_m"] - part["omega_m"]) / part.scenario.motor.base["omega_m"]
    return [
        _kept(m),
        at_most("field angle error", m.angle_held, 5.0, "°"),
        at_most("estimated against true speed", float(np.abs(estimate).max()), 0.01, " pu"),
        at_most("true torque against commanded", 100 * m.torque_command, 10.0, " % of T_N"),
    ]


# 6. Flying start.


def _flying_cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    end = s.FLYING_LOAD_AT + 3.0
    return [
        _case(
            "flying",
            s.flying_start(machine, scheme, arithmetic, omega=omega),
            f"ω = {omega:g}",
            (s.FLYING_LOAD_AT - 1.0, end),
            (end - 1.0, end),
            since=s.FLYING_LOAD_AT - 1.0,
            traced=True,
        )
        for omega in s.FLYING_SPEEDS
    ]


def _flying(case: Case, result: Result, m: Measured) -> list[Claim]:
    catch = result.window(0.0, s.FLYING_LOAD_AT - 0.01)
    running = np.flatnonzero(catch["status"] == 3)
    begin = float(catch.t[running[0]]) if len(running) else math.inf
    speed = speed_error(catch)
    moved = 100 * float(np.abs(speed).max() / abs(catch["reference"][-1] / _omega_m(catch)))
    caught = max(begin, settled_after(catch, 0.0, 0.01))
    peak = float(np.abs(catch["i_s"]).max() / result.scenario.motor.base["i"])
    del case
    return [
        _kept(m),
        at_most("time to a speed error below 0.01 under control", caught, 3.0, " s"),
        at_most("speed disturbed meanwhile by", moved, 50.0, " % of it"),
        at_most("peak current", peak, 2.0, " × rated"),
        at_most("speed error under half of rated load", m.speed_settled, 0.003, " pu"),
    ]


def _omega_m(result: Result) -> float:
    return result.scenario.motor.base["omega_m"]


# 7. Memory.


def _memory_cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    first, second = s.memory(machine, scheme, arithmetic)
    window = (s.START, second.duration)
    without = _case("memory", second, "nothing restored", window, traced=True)
    restored = _case("memory", second, "memory of the first run restored", window, traced=True)
    return [without, Case(**{**restored.__dict__, "before": first})]


def _memory(case: Case, result: Result, m: Measured) -> list[Claim]:
    del result
    which = "restored" if case.before is not None else "nothing restored"
    return [
        Claim(f"{which}: never lost", _kept(m).measured, not m.why),
        at_most(f"{which}: field angle error from the start on", m.angle_held, 5.0, "°"),
    ]


TARGETS: Mapping[str, Target] = {
    **{
        f"plane-{kind}": Target(
            f"Plane, {text}",
            partial(_plane_cases, kind),
            _plane,
            STEPPED if kind.endswith("drift") else KNOWN,
        )
        for kind, text in s.KINDS.items()
    },
    "crossing": Target(
        "Reversals through zero stator frequency under rated torque",
        _crossing_cases,
        _crossing,
        KNOWN,
        ("angle_held", "torque_command", "torque_estimate", "torque_ripple"),
    ),
    "persistence-no-load": Target(
        "Ten minutes at zero stator frequency, offset and resistance drifting",
        _persistence_cases,
        _persistence,
        KNOWN,
        ("angle_held", "angle_settled", "angle_passed", "r_s"),
    ),
    "persistence-rated": Target(
        "Rated load exactly at zero stator frequency, up to two minutes",
        _line_cases,
        _line,
        KNOWN,
        ("angle_held", "angle_passed", "omega_s", "torque_ripple"),
    ),
    "persistence-shifted": Target(
        "The same ten minutes long, the flux lowered to leave zero stator frequency",
        _shifted_cases,
        _shifted,
        KNOWN,
        ("angle_held", "speed_settled", "omega_s", "torque_ripple"),
    ),
    "mismatch": Target(
        "The machine is not what the drive was told",
        partial(_mismatch_cases, "mismatch"),
        _mismatch,
        KNOWN,
        ("angle_held", "angle_settled", "r_s"),
    ),
    "mismatch-stepped": Target(
        "An offset of 5 % steps in while the drive runs",
        partial(_mismatch_cases, "mismatch-stepped"),
        _mismatch,
        STEPPED,
        ("angle_held", "angle_settled", "r_s"),
    ),
    "transient-torque": Target(
        "Rated torque steps on a turning shaft",
        _torque_cases,
        _torque,
        numbers=("angle_held", "torque_command"),
    ),
    "transient-load": Target(
        "Load steps of 120 % at zero speed", _load_cases, _load, numbers=("angle_held",)
    ),
    "transient-reversal": Target(
        "Full reversal through zero under half of rated load",
        _reversal_cases,
        _reversal,
        numbers=("angle_held", "torque_command"),
    ),
    "transient-weakening": Target(
        "Field weakening to twice rated speed and back",
        _weakening_cases,
        _weakening,
        numbers=("angle_held", "torque_command"),
    ),
    "flying": Target(
        "Flying start of the demagnetised motor", _flying_cases, _flying, numbers=("angle_held",)
    ),
    "memory": Target(
        "Second start, into rated load at rest, with what the first run learned",
        _memory_cases,
        _memory,
        numbers=("angle_held", "r_s"),
    ),
}
"""All targets."""


def choose(names: Iterable[str]) -> tuple[str, ...]:
    """Targets by name or its beginning: "plane" stands for all four; none: all of them.

    Raises ValueError for one that does not exist.
    """
    chosen: list[str] = []
    for name in names:
        found = [t for t in TARGETS if t == name] or [t for t in TARGETS if t.startswith(f"{name}-")]
        if not found:
            raise ValueError(f"there is no target {name}; there are {', '.join(TARGETS)}")
        chosen += found
    return tuple(dict.fromkeys(chosen)) or tuple(TARGETS)


def cases(
    targets: Sequence[str], machines: Sequence[str], schemes: Sequence[str], arithmetic: str = "f32"
) -> list[Case]:
    """All runs of targets at machines under schemes."""
    return [
        case
        for target in targets
        for machine in machines
        for scheme in schemes
        for case in TARGETS[target].cases(machine, scheme, arithmetic)
    ]
