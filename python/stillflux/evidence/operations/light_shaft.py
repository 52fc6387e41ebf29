"""A shaft that is far lighter than told: a motor on the bench without its load."""

from __future__ import annotations

import numpy as np

from stillflux.evidence.claims import Claim, at_least, at_most, holds, reported
from stillflux.evidence.drives import DRIVES
from stillflux.evidence.operation import Control, Operation, asked, magnetised
from stillflux.metrics import faulted
from stillflux.result import Result
from stillflux.scenario import Scenario

_LIGHTER = 7.0
"""Inertia that is told over that of the shaft."""
_SPEED = 0.5
"""Speed after the first second, per unit; before that a tenth of it."""
_WHOLE = 0.02
"""Swing that is none, per unit."""


def _scenario(machine: str, scheme: str, arithmetic: str) -> Scenario:
    """0.05 pu, then 0.5 pu, then half of rated torque."""
    motor = DRIVES[machine].motor
    omega, begin = _SPEED * motor.base["omega_m"], magnetised(machine)
    step, load = begin + 1.0, begin + 2.0
    return asked(
        "light shaft",
        machine,
        scheme,
        arithmetic,
        plant_motor=motor.replace(J=motor.J / _LIGHTER),
        omega_ref=[(0.0, 0.1 * omega), (step, 0.1 * omega), (step, omega)],
        load_torque=[(0.0, 0.0), (load, 0.0), (load, 0.5 * motor.T_N)],
        duration=load + 1.0,
        record_every=5,
        signals=("omega_m", "reference", "torque", "angle_error", "estimate.speed_gain", "status"),
    )


def _swing(result: Result) -> float:
    """The largest of the last 0.3 s before step, load and end, per unit."""
    end = result.scenario.duration
    parts = [result.window(t - 0.3, t)["omega_m"] for t in (end - 2.0, end - 1.0, end)]
    return max(float(np.ptp(omega)) for omega in parts) / 2.0 / result.scenario.motor.base["omega_m"]


def _check(result: Result) -> list[Claim]:
    return [
        holds("no fault", not faulted(result).any()),
        at_most("swing of the speed, pu", _swing(result), _WHOLE),
        reported("inertia for which the gains are, of the true one", _found(result)),
    ]


def _found(result: Result) -> float:
    return float(result["estimate.speed_gain"][-1]) * _LIGHTER


def _swings(result: Result) -> list[Claim]:
    return [at_least("swing of the speed, pu", _swing(result), 2.0 * _WHOLE)]


OPERATIONS = (
    Operation(
        "light-shaft",
        17,
        f"A shaft with 1/{_LIGHTER:g} of the inertia told: a step of the reference to {_SPEED:g} pu, "
        "then half of rated load",
        _scenario,
        _check,
        Control(
            "what reduces the gains", lambda scenario: scenario.with_settings(reduce_gain=False), _swings
        ),
        schemes=("enhanced", "paper"),
        shown=("omega_m", "reference", "torque", "estimate.speed_gain"),
    ),
)
