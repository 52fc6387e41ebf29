"""Rated load for ten minutes where ω_s would be zero, the flux lowered to leave zero stator frequency."""

from __future__ import annotations

import math

import numpy as np

from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.conditions import AT_SPEED, LOAD_AT, REACHED, START, drive, line_speed
from stillflux.evidence.judge import Measured
from stillflux.evidence.machines import motor_of, ramp
from stillflux.evidence.points import stay
from stillflux.evidence.target import Case, Target
from stillflux.result import Result
from stillflux.scenario import Scenario

_LEAVE_TIME, _LEAVE_REST, _LEAVE_BY = 10.0, 5.0, 0.02
"""After its stay a drive goes on through the line: time of the ramp, rest at its end, s; how far, pu."""


def scenario(
    machine: str, scheme: str, arithmetic: str = "f32", *, torque: float = 1.0, time: float = 600.0
) -> Scenario:
    """That point for `time` s with the flux shift on, its default, then on through the line in 10 s."""
    omega = line_speed(motor_of(machine), torque)
    end = REACHED + time
    beyond = omega - math.copysign(_LEAVE_BY, torque)
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"T = {torque:g} T_N where ω_s would be 0, flux shifted",
        omega=[*ramp(START, AT_SPEED, omega), (end, omega), (end + _LEAVE_TIME, beyond)],
        load=ramp(LOAD_AT, REACHED, torque),
        duration=end + _LEAVE_TIME + _LEAVE_REST,
    )


def _cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    # The published scheme has no flux shift.
    cases = []
    for torque in (1.0, -1.0) if scheme == "enhanced" else ():
        run = scenario(machine, scheme, arithmetic, torque=torque).replace(record_every=100)
        part = (REACHED + 5.0, run.duration - _LEAVE_TIME - _LEAVE_REST)
        cases.append(stay("persistence-shifted", run, (machine, scheme), torque, part))
    return cases


def _claims(case: Case, result: Result, m: Measured) -> list[Claim]:
    part = result.window(*case.settled)
    whole = result.window(case.settled[0])
    rated = result.window(case.held[1] - 1.0)
    current = [float(np.abs(r["estimate.i_dq_ref"]).mean()) for r in (part, rated)]
    moved = float(np.abs(whole["torque"] - whole["load_torque"]).max()) / result.scenario.motor.T_N
    return [
        at_most("field angle error", m.angle_held, 5.0, "°"),
        at_most("speed error", m.speed_settled, 0.003, "pu"),
        at_most("torque ripple", 100 * m.torque_ripple, 5.0, "% of T_N"),
        at_most("torque off the load's while the flux changes", 100 * moved, 10.0, "% of T_N"),
        at_most("current against that at rated flux", current[0] / current[1], 1.4, "×"),
    ]


TARGETS = (
    Target(
        "persistence-shifted",
        22,
        "The same ten minutes long, the flux lowered to leave zero stator frequency",
        _cases,
        _claims,
        "confidence",
        "courses",
        ("angle_held", "speed_settled", "omega_s", "torque_ripple"),
    ),
)
