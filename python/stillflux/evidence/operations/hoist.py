"""A hoist: torque before the brake opens, the load held and lowered."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillflux.evidence.claims import Claim, at_least, at_most, holds, reported
from stillflux.evidence.drives import DRIVES
from stillflux.evidence.operation import Control, Operation, asked, magnetised
from stillflux.metrics import faulted
from stillflux.result import Result
from stillflux.scenario import Scenario
from stillflux.status import StatusCode

_PROOF = 0.02
"""Speed reference against the closed brake, per unit: the speed controller builds the torque up."""
_BANDWIDTH = 2.0 * np.pi * 9.0
"""Of speed control by default, rad/s."""
_LOWER = -0.3
"""Speed at which the load is lowered, per unit."""


def _hoist(machine: str, scheme: str, arithmetic: str) -> Scenario:
    """Rated torque hangs on the shaft all the time; the brake holds the shaft until the drive has built that
    torque up."""
    motor = DRIVES[machine].motor
    omega, begin = motor.base["omega_m"], magnetised(machine)
    # The integral part of the speed controller, J ω² e/4 a second, reaches rated torque.
    proof = 4.0 * motor.T_N / (motor.J * _BANDWIDTH**2 * _PROOF * omega)
    ready = begin + proof
    opens = ready + 0.1
    lowers = opens + 3.0
    return asked(
        "hoist",
        machine,
        scheme,
        arithmetic,
        plant={"speed": 0.0},
        omega_ref=[
            (0.0, 0.0),
            (begin, 0.0),
            (begin, _PROOF * omega),
            (ready, _PROOF * omega),
            (ready, 0.0),
            (lowers, 0.0),
            (lowers + 1.0, _LOWER * omega),
            (lowers + 3.0, _LOWER * omega),
            (lowers + 4.0, 0.0),
        ],
        load_torque=motor.T_N,
        changes=[(opens, {"speed": None})],
        duration=lowers + 6.0,
        signals=("omega_m", "reference", "torque", "psi_s", "angle_error", "status"),
    )


def _opens(result: Result) -> float:
    return float(result.scenario.changes[0][0])


def _sag(result: Result, end: float) -> float:
    """Largest speed downwards from the brake's opening to `end` s after it, per unit."""
    begin = _opens(result)
    part = result.window(begin, begin + end)["omega_m"]
    return -float(part.min()) / result.scenario.motor.base["omega_m"]


def _check(result: Result) -> list[Claim]:
    motor, opens = result.scenario.motor, _opens(result)
    base = motor.base["omega_m"]
    before = result.window(opens - 0.05, opens)
    error = np.abs(result["omega_m"] - result["reference"]) / base
    lowering = (result.t > opens + 4.5) & (result.t < opens + 6.0)
    angle = np.degrees(np.abs(result["angle_error"][result["status"] == StatusCode.RUNNING]))
    return [
        holds("no fault", not faulted(result).any()),
        at_least("torque before the brake opens, of T_N", float(before["torque"].mean()) / motor.T_N, 0.9),
        at_most("sag when the brake opens, pu", _sag(result, 1.0), 0.02),
        at_most("speed error while it is lowered, pu", float(error[lowering].max()), 0.01),
        at_most("speed error at the end, pu", float(error[-1]), 0.005),
        reported("field angle error", float(angle.max()), "°"),
    ]


def _sags(result: Result) -> Sequence[Claim]:
    motor, opens = result.scenario.motor, _opens(result)
    before = result.window(opens - 0.05, opens)
    return [
        at_most("torque before the brake opens, of T_N", float(before["torque"].mean()) / motor.T_N, 0.2),
        at_least("sag when the brake opens, pu", _sag(result, 1.0), 0.03),
    ]


def _unproven(scenario: Scenario) -> Scenario:
    """Without the reference against the brake."""
    assert isinstance(scenario.omega_ref, Sequence)
    return scenario.replace(omega_ref=[point for point in scenario.omega_ref if point[1] <= 0.0])


OPERATIONS = (
    Operation(
        "hoist",
        60,
        "Rated torque held when the brake opens, then lowered",
        _hoist,
        _check,
        Control("the torque before the brake opens", _unproven, _sags),
        machines=("2.2kW", "4kW", "11kW", "45kW"),
        shown=("omega_m", "reference", "torque", "angle_error"),
    ),
)
