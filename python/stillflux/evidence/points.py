"""Points of the torque-speed plane: how one is reached and held, what it must show, and maps of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Literal, TypeAlias, get_args

from stillflux.evidence.claims import Claim, at_least, at_most
from stillflux.evidence.conditions import (
    AT_SPEED,
    HOLD,
    LOAD_AT,
    OFFSET_AT,
    REACHED,
    START,
    drive,
    line_speed,
)
from stillflux.evidence.errors import MISMATCHES
from stillflux.evidence.judge import EXCURSION, Measured, Window
from stillflux.evidence.machines import ramp
from stillflux.evidence.target import Case, Target, Verdict
from stillflux.result import Result
from stillflux.scenario import Scenario

__all__ = [
    "POINTS",
    "SPEEDS",
    "TORQUES",
    "Kind",
    "map_of",
    "mismatch",
    "mismatch_cases",
    "mismatch_claims",
    "plane",
    "stay",
    "stay_claims",
]

SPEEDS = tuple(k / 100 for k in range(-10, 11))
"""Speeds of the plane, per unit."""
TORQUES = tuple(k / 5 for k in range(-6, 7))
"""Torques of the plane, units of rated torque."""
POINTS = ((0.0, 0.0), (0.0, 1.0), (0.02, 1.0), (0.02, -1.0), (-0.02, 1.0), (-0.02, -1.0))
"""Speed in per unit and torque in units of rated torque at which mismatches are tried."""

Kind: TypeAlias = Literal["ramps", "drift", "rest", "rest-drift"]
"""How a point is reached: by ramps with the offset there from power-up; by ramps, the offset appears once the
drive runs; loaded at rest before the motor has ever turned; the same, the offset appears once the drive
runs."""
_LATE: tuple[Kind, ...] = ("drift", "rest-drift")
_AT_REST: tuple[Kind, ...] = ("rest", "rest-drift")


def plane(
    machine: str,
    scheme: str,
    arithmetic: str = "f32",
    *,
    omega: float,
    torque: float,
    kind: Kind = "ramps",
    hold: float = HOLD,
) -> Scenario:
    """One point of the plane, held from `REACHED` to `REACHED + hold` s.

    `omega` in per unit, `torque` in units of rated torque. At rest the load comes first: a ramp of 1 s from
    `START` on, and `omega` has to be 0.
    """
    if kind not in get_args(Kind):
        raise ValueError(f"kind = {kind!r}: there are {', '.join(get_args(Kind))}")
    at_rest = kind in _AT_REST
    if at_rest and omega != 0.0:
        raise ValueError(f"omega = {omega:g}: a load applied at rest is one at speed zero")
    load_at = START if at_rest else LOAD_AT
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"ω = {omega:g}, T = {torque:g} T_N, {kind}",
        omega=ramp(START, AT_SPEED, omega),
        load=ramp(load_at, load_at + REACHED - LOAD_AT, torque),
        offset_at=OFFSET_AT if kind in _LATE else None,
        duration=REACHED + hold,
    )


def _cases(
    target: str,
    kind: Kind,
    speeds: Sequence[float],
    torques: Sequence[float],
    machine: str,
    scheme: str,
    arithmetic: str,
) -> list[Case]:
    return [
        _held(
            (target, machine, scheme),
            f"ω = {omega:g}, T = {torque:g} T_N",
            plane(machine, scheme, arithmetic, omega=omega, torque=torque, kind=kind),
            (omega, torque),
            judged=15.0,
        )
        for omega in speeds
        for torque in torques
    ]


def _held(
    where: tuple[str, str, str],
    label: str,
    scenario: Scenario,
    point: tuple[float, float],
    judged: float,
    error: str = "",
) -> Case:
    """A point held for `HOLD` s, of which the last `judged` s count."""
    end = REACHED + HOLD
    return Case(*where, label, scenario, (REACHED, end), (end - judged, end), point, error=error)


def _claims(case: Case, result: Result, m: Measured) -> list[Claim]:
    del result
    if case.near_line:
        return [at_most("field angle error within 0.01 of ω_s = 0", m.angle_settled, EXCURSION, "°")]
    return [
        at_most("field angle error", m.angle_settled, 3.0, "°"),
        at_most("speed error", m.speed_settled, 0.003, "pu"),
    ]


def map_of(
    name: str,
    order: int,
    title: str,
    kind: Kind,
    speeds: Sequence[float] = SPEEDS,
    torques: Sequence[float] = TORQUES,
    *,
    own_seeds: bool,
) -> Target:
    """A target of many points; `own_seeds`: of so many that one realisation of the noise for each will do."""
    verdict: Verdict = "confidence-stepped" if kind in _LATE else "confidence"
    return Target(
        name,
        order,
        title,
        partial(_cases, name, kind, tuple(speeds), tuple(torques)),
        _claims,
        verdict,
        "loads" if kind in _AT_REST else "map",
        map=own_seeds,
    )


def mismatch(
    machine: str, scheme: str, arithmetic: str = "f32", *, error: str, omega: float, torque: float
) -> Scenario:
    """A point of the plane (`plane`, reached by ramps) with one of `MISMATCHES`."""
    apply, x = MISMATCHES[error]
    scenario = apply(plane(machine, scheme, arithmetic, omega=omega, torque=torque), x)
    return scenario.replace(name=scenario.name.replace("ramps", error))


def mismatch_cases(
    target: str, errors: Sequence[str], machine: str, scheme: str, arithmetic: str
) -> list[Case]:
    """Each of the errors at each of `POINTS`."""
    return [
        _held(
            (target, machine, scheme),
            f"{error} at ω = {omega:g}, T = {torque:g} T_N",
            mismatch(machine, scheme, arithmetic, error=error, omega=omega, torque=torque),
            (omega, torque),
            judged=5.0,
            error=error,
        )
        for error in errors
        for omega, torque in POINTS
    ]


def mismatch_claims(case: Case, result: Result, m: Measured) -> list[Claim]:
    """What a point has to show although something is wrong."""
    del case, result
    return [at_most("field angle error after adaptation", m.angle_settled, 10.0, "°")]


def stay(target: str, scenario: Scenario, where: tuple[str, str], torque: float, settled: Window) -> Case:
    """A stay of machine and scheme at the speed at which ω_s would be zero at rated flux."""
    machine, scheme = where
    return Case(
        target,
        machine,
        scheme,
        f"T = {torque:g} T_N",
        scenario,
        (REACHED, scenario.duration),
        settled,
        (line_speed(scenario.motor, torque), torque),
        traced=True,
    )


def stay_claims(case: Case, result: Result, m: Measured) -> list[Claim]:
    """How long the angle stays right."""
    begin, end = case.held
    del result
    return [
        at_least("time with an angle error below 15°", min(m.angle_passed, m.lost, end) - begin, HOLD, "s")
    ]
