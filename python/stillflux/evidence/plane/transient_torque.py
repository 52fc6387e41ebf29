"""Rated torque steps on a turning shaft."""

from __future__ import annotations

import math

import numpy as np

from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.conditions import AT_SPEED, REACHED, START, drive
from stillflux.evidence.judge import Measured
from stillflux.evidence.machines import motor_of, scaled, step
from stillflux.evidence.points import SPEEDS
from stillflux.evidence.target import Case, Target
from stillflux.result import Result
from stillflux.scenario import Scenario

_AT = REACHED + 1.0
"""The torque steps, s."""


def scenario(
    machine: str, scheme: str, arithmetic: str = "f32", *, omega: float, torque: float = 1.0
) -> Scenario:
    """Torque control on a shaft that a dynamometer takes to `omega`, and a torque step there."""
    motor = motor_of(machine)
    steps = 50
    turning = [
        (START + (AT_SPEED - START) * k / steps, {"speed": motor.base["omega_m"] * omega * k / steps})
        for k in range(1, steps + 1)
    ]
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"torque step to {torque:g} T_N at ω = {omega:g}",
        torque_ref=scaled(step(_AT, torque), motor.T_N),
        changes=turning,
        plant={"speed": 0.0},
        record_every=2,
        duration=_AT + 1.0,
    )


def _cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    return [
        Case(
            "transient-torque",
            machine,
            scheme,
            f"ω = {omega:g}, to {torque:g} T_N",
            scenario(machine, scheme, arithmetic, omega=omega, torque=torque),
            (_AT, _AT + 1.0),
            (_AT + 0.1, _AT + 1.0),
            (omega, torque),
        )
        for omega in SPEEDS
        for torque in (1.0, -1.0)
    ]


def _claims(case: Case, result: Result, m: Measured) -> list[Claim]:
    assert case.point is not None
    after = result.window(_AT)
    there = np.flatnonzero(after["torque"] / (case.point[1] * result.scenario.motor.T_N) >= 0.9)
    rise = 1e3 * float(after.t[there[0]] - _AT) if len(there) else math.inf
    return [
        at_most("90 % of the torque step", rise, 5.0, "ms"),
        at_most("true torque against commanded", 100 * m.torque_command, 10.0, "% of T_N"),
    ]


TARGETS = (
    Target(
        "transient-torque",
        40,
        "Rated torque steps on a turning shaft",
        _cases,
        _claims,
        numbers=("angle_held", "torque_command"),
    ),
)
