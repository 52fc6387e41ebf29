"""Flying start of the demagnetised motor."""

from __future__ import annotations

import math

import numpy as np

from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.conditions import SIGNALS, drive
from stillflux.evidence.judge import Measured
from stillflux.evidence.machines import motor_of, ramp
from stillflux.evidence.target import Case, Target
from stillflux.metrics import settled_after, speed_error, start_time
from stillflux.result import Result
from stillflux.scenario import Scenario

SPEEDS = (-1.0, -0.5, -0.1, 0.1, 0.5, 1.0)
"""Speeds at which the motor coasts, per unit."""
_LOAD_AT = 6.0
_END = _LOAD_AT + 3.0


def scenario(machine: str, scheme: str, arithmetic: str = "f32", *, omega: float) -> Scenario:
    """The shaft coasts at `omega`, demagnetised; speed reference `omega` from power-up on.

    From 6 s on half of rated load proves that the motor is under control.
    """
    speed = motor_of(machine).base["omega_m"] * omega
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"flying start at ω = {omega:g}",
        omega=omega,
        load=ramp(_LOAD_AT, _LOAD_AT + 0.5, math.copysign(0.5, omega)),
        changes=[(0.005, {"speed": None})],
        plant={"speed": speed},
        record_every=5,
        signals=(*SIGNALS, "i_s"),
        duration=_END,
    )


def _cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    return [
        Case(
            "flying",
            machine,
            scheme,
            f"ω = {omega:g}",
            scenario(machine, scheme, arithmetic, omega=omega),
            (_LOAD_AT - 1.0, _END),
            (_END - 1.0, _END),
            since=_LOAD_AT - 1.0,
            traced=True,
        )
        for omega in SPEEDS
    ]


def _claims(case: Case, result: Result, m: Measured) -> list[Claim]:
    del case
    base = result.scenario.motor.base
    catch = result.window(0.0, _LOAD_AT - 0.01)
    reference = catch["reference"][-1] / base["omega_m"]
    moved = 100 * float(np.abs(speed_error(catch)).max() / abs(reference))
    caught = max(start_time(catch), settled_after(catch, 0.0, 0.01))
    peak = float(np.abs(catch["i_s"]).max() / base["i"])
    return [
        at_most("time to a speed error below 0.01 under control", caught, 3.0, "s"),
        at_most("speed disturbed meanwhile by", moved, 50.0, "% of it"),
        at_most("peak current", peak, 2.0, "× rated"),
        at_most("speed error under half of rated load", m.speed_settled, 0.003, "pu"),
    ]


TARGETS = (
    Target(
        "flying",
        50,
        "Flying start of the demagnetised motor",
        _cases,
        _claims,
        view="courses",
        numbers=("angle_held",),
    ),
)
