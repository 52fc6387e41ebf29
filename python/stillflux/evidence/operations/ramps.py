"""Ramps with limits of acceleration and jerk, limits by direction, and derating in an overload."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stillflux.evidence.claims import Claim, at_least, at_most, holds
from stillflux.evidence.drives import DRIVES
from stillflux.evidence.operation import Control, Operation, asked
from stillflux.metrics import faulted, smoothed
from stillflux.options import DriveSettings
from stillflux.result import Result
from stillflux.scenario import Scenario

_MACHINES = ("2.2kW", "11kW", "4kW")
_START = 1.8
"""When the reference moves, s: magnetisation is over."""
_SPEED = 0.5
"""Speed of the ramp, per unit."""
_RISE, _ROUND = 1.0, 0.25
"""Time that the speed takes at the largest acceleration, and the acceleration at the largest jerk, s."""


def _ramp(machine: str, scheme: str, arithmetic: str) -> Scenario:
    """A step of the reference from rest to half of rated speed, made a ramp by the drive."""
    omega = _SPEED * DRIVES[machine].motor.base["omega_m"]
    return asked(
        "ramp",
        machine,
        scheme,
        arithmetic,
        settings={"acceleration": omega / _RISE, "jerk": omega / (_RISE * _ROUND)},
        omega_ref=[(0.0, 0.0), (_START, 0.0), (_START, omega)],
        duration=_START + _RISE + _ROUND + 1.0,
    )


def _acceleration(result: Result) -> NDArray[np.float64]:
    """True acceleration over 50 ms, in units of that asked for."""
    asked = _SPEED * result.scenario.motor.base["omega_m"] / _RISE
    n = round(0.05 / float(result.t[1] - result.t[0]))
    omega, t = result["omega_m"], result.t
    found: NDArray[np.float64] = (omega[n:] - omega[:-n]) / (t[n:] - t[:-n]) / asked
    return found


def _check_ramp(result: Result) -> list[Claim]:
    after = result.window(_START)
    omega = after["omega_m"] / result.scenario.motor.base["omega_m"]
    arrived = (
        after.t[np.flatnonzero(np.abs(omega - _SPEED) < 0.005)[0]] - _START if omega[-1] > 0.4 else np.inf
    )
    a = _acceleration(after)
    n = round(0.1 / float(after.t[1] - after.t[0]))
    return [
        holds("no fault", not faulted(result).any()),
        at_most("acceleration over 50 ms, against its limit", float(np.abs(a).max()), 1.1),
        at_most(
            "change of acceleration in 0.1 s, against its limit", float(np.abs(a[n:] - a[:-n]).max()), 0.5
        ),
        at_most("time to the speed, s", float(arrived), _RISE + _ROUND + 0.1),
        at_most("speed beyond the reference, pu", float(omega.max() - _SPEED), 0.01),
    ]


def _check_step(result: Result) -> list[Claim]:
    return [
        at_least(
            "acceleration over 50 ms, against its limit", float(np.abs(_acceleration(result)).max()), 1.5
        )
    ]


_LIMITS = (-0.3, 0.8)
"""Torque limits, of rated torque."""


def _limited(machine: str, scheme: str, arithmetic: str) -> Scenario:
    """To half of rated speed and back with limits of torque and speed that differ by direction."""
    motor = DRIVES[machine].motor
    omega, T_N = motor.base["omega_m"], motor.T_N
    settings: DriveSettings = {
        "torque_limits": (_LIMITS[0] * T_N, _LIMITS[1] * T_N),
        "speed_limits": (-0.1 * omega, 0.4 * omega),
    }
    return asked(
        "limits by direction",
        machine,
        scheme,
        arithmetic,
        settings=settings,
        omega_ref=[(0.0, 0.0), (_START, 0.0), (_START, 0.6 * omega), (3.5, 0.6 * omega), (3.5, -0.6 * omega)],
        duration=6.0,
    )


def _check_limits(result: Result) -> list[Claim]:
    part = result.window(_START - 0.1)
    # Means over 20 ms: the limits are those of the reference, and the torque has a ripple of the switching.
    torque = smoothed(part["torque"] / result.scenario.motor.T_N, 20)[20:-20]
    omega = part["omega_m"] / result.scenario.motor.base["omega_m"]
    return [
        holds("no fault", not faulted(result).any()),
        at_most("largest torque, of T_N", float(torque.max()), _LIMITS[1] + 0.05),
        at_least("least torque, of T_N", float(torque.min()), _LIMITS[0] - 0.05),
        at_most("speed before the turn, off its limit, pu", abs(float(omega[part.t < 3.5][-1]) - 0.4), 0.005),
        at_most("speed at the end, off its limit, pu", abs(float(omega[-1]) + 0.1), 0.005),
    ]


def _unlimited(result: Result) -> list[Claim]:
    omega = result.window(_START)["omega_m"] / result.scenario.motor.base["omega_m"]
    torque = result.window(_START)["torque"] / result.scenario.motor.T_N
    return [
        at_least("largest speed, pu", float(omega.max()), 0.55),
        at_most("least torque, of T_N", float(torque.min()), -0.6),
    ]


_OVERLOAD, _HEAT = 1.4, 5.0
"""Load in units of rated torque; time constant of the bridge's heat, s."""


def _overloaded(machine: str, scheme: str, arithmetic: str) -> Scenario:
    """A load above the bridge's continuous current at 0.3 pu, for three of its time constants."""
    motor = DRIVES[machine].motor
    return asked(
        "overload",
        machine,
        scheme,
        arithmetic,
        settings={"bridge_overload": (1.05 * motor.I_N, _HEAT)},
        torque_ref=[(0.0, 0.0), (_START, 0.0), (_START, _OVERLOAD * motor.T_N)],
        plant={"speed": 0.3 * motor.base["omega_m"]},
        duration=_START + 3.0 * _HEAT,
        record_every=50,
        signals=("torque", "omega_m", "reference", "i_s", "psi_s", "status"),
    )


def _heat(result: Result) -> NDArray[np.float64]:
    """Heat of the bridge by the true current, in units of that of the continuous one."""
    square = np.abs(result["i_s"]) ** 2 / (2.0 * (1.05 * result.scenario.motor.I_N) ** 2)
    dt, theta = float(result.t[1] - result.t[0]), [0.0]
    for x in square:
        theta.append(theta[-1] + dt / _HEAT * (float(x) - theta[-1]))
    return np.array(theta)


def _check_overload(result: Result) -> list[Claim]:
    T_N = result.scenario.motor.T_N
    return [
        holds("no fault", not faulted(result).any()),
        at_most("heat of the bridge", float(_heat(result).max()), 1.02),
        at_least(
            "torque in the first second, of T_N",
            float(result.window(_START + 0.2, _START + 1.0)["torque"].min()) / T_N,
            1.3,
        ),
        at_least("torque at the end, of T_N", float(result["torque"][-20:].mean()) / T_N, 0.9),
    ]


def _too_hot(result: Result) -> Sequence[Claim]:
    return [at_least("heat of the bridge", float(_heat(result).max()), 1.1)]


OPERATIONS = (
    Operation(
        "ramp",
        30,
        "A step of the reference with limits of acceleration and jerk set in the drive",
        _ramp,
        _check_ramp,
        Control("the limits", lambda s: s.replace(settings={}), _check_step),
        _MACHINES,
        ("enhanced", "paper"),
    ),
    Operation(
        "limits-by-direction",
        31,
        "Forth and back with limits of torque and speed that differ by direction",
        _limited,
        _check_limits,
        Control("the limits", lambda s: s.replace(settings={}), _unlimited),
        _MACHINES,
        ("enhanced",),
    ),
    Operation(
        "overload",
        32,
        "140 % of rated torque for three time constants of the bridge's heat",
        _overloaded,
        _check_overload,
        Control("the derating", lambda s: s.replace(settings={}), _too_hot),
        _MACHINES,
        ("enhanced",),
        ("torque", "i_s", "psi_s"),
    ),
)
