"""Field weakening to twice rated speed and back."""

from __future__ import annotations

import numpy as np

from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.conditions import START, drive
from stillflux.evidence.judge import Measured
from stillflux.evidence.machines import ramp
from stillflux.evidence.target import Case, Target
from stillflux.result import Result
from stillflux.scenario import Scenario

_THERE = START + 6.0
_END = _THERE + 9.0


def scenario(
    machine: str, scheme: str, arithmetic: str = "f32", *, top: float = 2.0, torque: float = 0.3
) -> Scenario:
    """From rest to `top`, a while there, and back, under a constant load: every hand-over twice."""
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"rest to {top:g} and back, T = {torque:g} T_N",
        omega=[*ramp(START + 1.0, _THERE, top), (_THERE + 2.0, top), (_THERE + 7.0, 0.0)],
        load=ramp(START, START + 1.0, torque),
        record_every=10,
        duration=_END,
    )


def _cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    window = (START + 1.0, _END)
    return [
        Case(
            "transient-weakening",
            machine,
            scheme,
            f"rest to {top:g} and back, T = {torque:g} T_N",
            scenario(machine, scheme, arithmetic, top=top, torque=torque),
            window,
            window,
            traced=True,
        )
        for top, torque in ((2.0, 0.0), (2.0, 0.3), (-2.0, 0.3))
    ]


def _claims(case: Case, result: Result, m: Measured) -> list[Claim]:
    part = result.window(*case.held)
    estimate = (part["estimate.omega_m"] - part["omega_m"]) / part.scenario.motor.base["omega_m"]
    return [
        at_most("field angle error", m.angle_held, 5.0, "°"),
        at_most("estimated against true speed", float(np.abs(estimate).max()), 0.01, "pu"),
        at_most("true torque against commanded", 100 * m.torque_command, 10.0, "% of T_N"),
    ]


TARGETS = (
    Target(
        "transient-weakening",
        43,
        "Field weakening to twice rated speed and back",
        _cases,
        _claims,
        view="courses",
        numbers=("angle_held", "torque_command"),
    ),
)
