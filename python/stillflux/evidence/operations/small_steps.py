"""Small steps of the speed reference, of a shaft whose inertia is not that of the data."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from stillflux.evidence.claims import Claim, at_least, at_most, holds, reported
from stillflux.evidence.drives import DRIVES
from stillflux.evidence.operation import Control, Operation, asked, magnetised
from stillflux.metrics import faulted
from stillflux.result import Result
from stillflux.scenario import Scenario

_FROM, _STEP = 0.2, 0.02
"""Speed and step, per unit: the torque stays below its limit."""
_SETTLE, _AFTER = 1.5, 2.0
"""Time at the first speed, and after the step, s."""
_BAND = 0.1
"""Part of the step within which it is over."""
_FACTOR = 1.5
"""Tolerance of the inertia (docs/gains.md)."""


def _scenario(machine: str, scheme: str, arithmetic: str, *, inertia: float) -> Scenario:
    """The step, of a shaft with `inertia` times that of the data."""
    motor, begin = DRIVES[machine].motor, magnetised(machine)
    low, high = (x * motor.base["omega_m"] for x in (_FROM, _FROM + _STEP))
    step = begin + _SETTLE
    return asked(
        f"a small step, {inertia:.2g} times the inertia",
        machine,
        scheme,
        arithmetic,
        plant_motor=motor.replace(J=inertia * motor.J),
        omega_ref=[(0.0, 0.0), (begin, 0.0), (begin, low), (step, low), (step, high)],
        duration=step + _AFTER,
    )


def _deviation(result: Result) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Time since the step, s, and the true speed beyond its end, in parts of the step."""
    begin = result.scenario.duration - _AFTER
    after = result.window(begin)
    omega: NDArray[np.float64] = after["omega_m"] / result.scenario.motor.base["omega_m"]
    return after.t - begin, (omega - _FROM - _STEP) / _STEP


def _check(result: Result) -> list[Claim]:
    t, deviation = _deviation(result)
    outside = np.flatnonzero(np.abs(deviation) > _BAND)
    return [
        holds("no fault", not faulted(result).any()),
        at_most("speed beyond the reference, of the step", float(deviation.max()), _BAND),
        reported(f"time until within {100.0 * _BAND:g} %", float(t[outside[-1]]), "s"),
    ]


def _overshoots(result: Result) -> list[Claim]:
    _, deviation = _deviation(result)
    return [at_least("speed beyond the reference, of the step", float(deviation.max()), 0.3)]


OPERATIONS = tuple(
    Operation(
        f"small-step-{name}",
        order,
        f"A step of the reference from 0.2 to 0.22 pu, real inertia {text} times that of the data",
        partial(_scenario, inertia=inertia),
        _check,
        Control("the weight of the set point", lambda s: s.with_settings(set_point_weight=1.0), _overshoots),
        schemes=("enhanced", "paper"),
    )
    for name, order, text, inertia in (
        ("light", 12, "1/1.5", 1.0 / _FACTOR),
        ("heavy", 13, "1.5", _FACTOR),
    )
)
