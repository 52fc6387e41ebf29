"""A motor that heats up by 80 K under rated torque: speed and torque, cold and hot, motoring and
regenerating.

Winding and cage heat with a time constant of 20 s instead of a quarter of an hour: what the filter sees of
it is worse than in the field, where `R_s` changes by less in a second. The motor heats at half speed, where
`R_s` cannot be identified; the drive is told the winding's temperature at which its parameters hold, and of
its heating a rise that is wrong by a tenth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from stillflux.evidence.claims import Claim, at_least, at_most, holds
from stillflux.evidence.conditions import current, slip
from stillflux.evidence.drives import DRIVES, TypicalDrive
from stillflux.evidence.machines import ADC_NOISE
from stillflux.evidence.operation import Control, Operation
from stillflux.evidence.tolerance import start_up
from stillflux.metrics import faulted, smoothed
from stillflux.options import DriveSettings, PlantOptions
from stillflux.parameters import Motor
from stillflux.result import Result
from stillflux.scenario import Scenario

_COLD = 20.0
"""Temperature at which the drive's parameters hold, °C."""
_RISE = 80.0
"""Rise of the winding under rated torque, K."""
_ROTOR = 1.1
"""Rise of the cage over that of the winding."""
_TIME = 20.0
"""Time constant, s."""
_HEATING = 5.0 * _TIME
_AT = 0.5
"""Speed at which the motor heats up, per unit."""
_HELD = 0.2
"""Stator frequency from which on the drive holds `R_s` where it is told no temperature, per unit."""
_SPEEDS = (0.2, 0.5, 0.8)
"""Speeds that are judged, per unit."""
_HOLD, _JUDGED = 2.0, 1.0
"""Time at each speed, and the last part of it, which is judged, s."""


def _start(of: Scenario | TypicalDrive) -> float:
    """When a drive has certainly started, s."""
    return start_up(of.motor, of.inverter) + 0.2


def _plant(motor: Motor) -> PlantOptions:
    """Copper loss that ends in `_RISE`, and its resistances."""
    copper = 1.0 / (235.0 + _COLD)
    loss = (1.0 + copper * _RISE) * current(motor, 1.0) ** 2
    return {
        "adc_noise": ADC_NOISE * motor.I_N,
        "thermal": (_TIME, _RISE / loss, copper, _ROTOR / (225.0 + _COLD)),
    }


def _told(motor: Motor) -> DriveSettings:
    """The rise at rated current, a tenth too small."""
    rise = 0.9 * _RISE / current(motor, 1.0) ** 2
    return {"winding_temperature": _COLD, "rotor_rise": _ROTOR, "winding_heat": (rise, _TIME)}


def _rise(motor: Motor, change: float) -> float:
    """Time for a change of speed in per unit, s: half of rated torque accelerates, beside the load."""
    return max(0.3, 2.0 * abs(change) * motor.base["omega_m"] * motor.J / motor.T_N)


def _times(
    of: Scenario | TypicalDrive,
) -> tuple[list[tuple[float, float]], list[tuple[bool, float, float]], float]:
    """Points of the speed in per unit, what is judged (hot, speed, until when), and when the load comes."""
    motor = of.motor
    t, last = _start(of), 0.0
    points, judged, loaded = [(0.0, 0.0), (t, 0.0)], [], 0.0
    course = [(False, omega) for omega in _SPEEDS] + [(None, _AT)] + [(True, omega) for omega in _SPEEDS]
    for hot, omega in course:
        t += _rise(motor, omega - last)
        loaded = loaded or t
        points.append((t, omega))
        t += _HEATING if hot is None else _HOLD
        points.append((t, omega))
        if hot is not None:
            judged.append((hot, omega, t))
        last = omega
    return points, judged, loaded


def _speed(sign: float, machine: str, scheme: str, arithmetic: str) -> Scenario:
    """Three speeds cold, half speed until the motor is hot, three speeds hot, all under rated torque."""
    drive = DRIVES[machine]
    motor = drive.motor
    points, _, loaded = _times(drive)
    return Scenario(
        name=f"temperature, {sign:+.0f} T_N; {machine}, {scheme}, {arithmetic}",
        motor=motor,
        inverter=drive.inverter,
        scheme=scheme,
        arithmetic=arithmetic,
        settings=_told(motor),
        plant=_plant(motor),
        omega_ref=[(t, omega * motor.base["omega_m"]) for t, omega in points],
        load_torque=[(0.0, 0.0), (loaded, 0.0), (loaded + 0.1, sign * motor.T_N)],
        duration=points[-1][0],
        record_every=100,
        signals=("omega_m", "reference", "torque", "R_s", "estimate.R_s", "status"),
    )


def _errors(result: Result, hot: bool) -> list[float]:
    """Mean speed error at each of the speeds, of rated speed."""
    motor = result.scenario.motor
    ends = [t for is_hot, _, t in _times(result.scenario)[1] if is_hot == hot]
    parts = [result.window(t - _JUDGED, t) for t in ends]
    return [abs(float(np.mean(p["omega_m"] - p["reference"]))) / motor.base["omega_m"] for p in parts]


def _check_speed(result: Result) -> list[Claim]:
    return [
        holds("no fault", not faulted(result).any()),
        at_least("rise of the winding, K", _kelvin(result), 0.9 * _RISE),
        at_most("speed error cold, of rated", 100.0 * max(_errors(result, False)), 0.2, "%"),
        at_most("speed error hot, of rated", 100.0 * max(_errors(result, True)), 0.2, "%"),
    ]


def _kelvin(result: Result) -> float:
    return (float(result["R_s"].max()) / result.scenario.motor.R_s - 1.0) * (235.0 + _COLD)


def _wrong_speed(result: Result) -> list[Claim]:
    """The slip of a cold cage: it falls short by the rise of its resistance. In regeneration the error of the
    stator resistance, which is not predicted either, takes up to a half off again: 0.4 is an allowance for
    that, 2 one for the error cold, which has other causes."""
    motor = result.scenario.motor
    expected = slip(motor, 1.0) * _ROTOR * _RISE / (225.0 + _COLD)
    return [
        at_least("speed error hot, of that expected", max(_errors(result, True)) / expected, 0.4),
        at_least(
            "speed error hot over that cold", max(_errors(result, True)) / max(_errors(result, False)), 2.0
        ),
    ]


def _without(scenario: Scenario) -> Scenario:
    return scenario.replace(settings={})


_STEP = 0.02
"""Step of the imposed speed, per unit."""
_EVERY = 0.06
"""Time from one step to the next, s."""


def _sweeps(of: Scenario | TypicalDrive) -> tuple[float, float, float]:
    """When the cold sweep begins, when the hot one does, and the end."""
    begin = _start(of) + 0.5
    sweep = _EVERY / _STEP
    return begin, begin + sweep + _HEATING, begin + 2.0 * sweep + _HEATING + 0.2


def _steps(begin: float, first: float, last: float) -> list[tuple[float, float]]:
    """Times and speeds in per unit of a sweep."""
    number = round(abs(last - first) / _STEP)
    return [(begin + _EVERY * k, first + (last - first) * k / number) for k in range(1, number + 1)]


def _torque(sign: float, machine: str, scheme: str, arithmetic: str) -> Scenario:
    """Rated torque at an imposed speed, from standstill to rated speed cold and, after heating up at half
    speed, from rated speed to standstill."""
    drive = DRIVES[machine]
    motor = drive.motor
    cold, hot, end = _sweeps(drive)
    base = motor.base["omega_m"]
    half = 0.5 * _EVERY / _STEP
    speeds = [
        *_steps(cold, 0.0, 1.0),
        *_steps(cold + 2.0 * half, 1.0, _AT),
        *_steps(hot - half, _AT, 1.0),
        *_steps(hot, 1.0, 0.0),
    ]
    return Scenario(
        name=f"torque, temperature, {sign:+.0f} T_N; {machine}, {scheme}, {arithmetic}",
        motor=motor,
        inverter=drive.inverter,
        scheme=scheme,
        arithmetic=arithmetic,
        settings=_told(motor),
        plant={**_plant(motor), "speed": 0.0},
        torque_ref=[(0.0, 0.0), (_start(drive), 0.0), (_start(drive) + 0.1, sign * motor.T_N)],
        changes=[(t, {"speed": omega * base}) for t, omega in speeds],
        duration=end,
        record_every=10,
        signals=("omega_m", "reference", "torque", "R_s", "estimate.R_s", "status"),
    )


def _deviation(result: Result, begin: float, end: float) -> float:
    """Largest deviation of the true torque, means of 20 ms, from the commanded one, of rated torque."""
    samples = round(0.02 / float(result.t[1] - result.t[0]))
    torque = smoothed(result["torque"] - result["reference"], samples)
    inside = (result.t > begin) & (result.t < end)
    return float(np.abs(torque[inside]).max()) / result.scenario.motor.T_N


def _deviations(result: Result) -> tuple[float, float]:
    """Of the cold sweep and of the hot one."""
    cold, hot, end = _sweeps(result.scenario)
    return _deviation(result, cold, cold + _EVERY / _STEP), _deviation(result, hot, end)


def _check_torque(result: Result) -> list[Claim]:
    cold, hot = _deviations(result)
    return [
        holds("no fault", not faulted(result).any()),
        at_most("torque deviation cold, of rated", 100.0 * cold, 2.0, "%"),
        at_most("torque deviation hot, of rated", 100.0 * hot, 2.0, "%"),
    ]


def _wrong_torque(result: Result) -> list[Claim]:
    """The loss in the part of the resistance that the drive does not know is taken for power of the field,

        ΔT = 3/2 ΔR_s |i|²/ω,

    largest at the lowest speed at which `R_s` is held without a temperature. In small motors the filter's
    correction takes up to a half off: 0.4 as for the speed. The error cold has other causes and is no
    measure: at 160 kW both are some 2 %."""
    motor = result.scenario.motor
    _, hot, end = _sweeps(result.scenario)
    rise = motor.R_s * _RISE / (235.0 + _COLD)
    loss = 1.5 * rise * (current(motor, 1.0) * motor.base["i"]) ** 2
    expected = loss / (_HELD * motor.base["omega_m"]) / motor.T_N
    # From rated speed to standstill: until the step below the speed, and a tenth of rated speed before.
    held = hot + (1.0 - _HELD) * _EVERY / _STEP
    deviation = _deviation(result, held - 0.1 * _EVERY / _STEP, held + _EVERY)
    return [
        at_least("torque deviation hot at 0.2 pu, of that expected", deviation / expected, 0.4),
        at_least("torque deviation hot, of rated", 100.0 * _deviation(result, hot, end), 2.0, "%"),
    ]


def _both(
    names: tuple[str, str],
    order: int,
    asked: str,
    build: Callable[[float, str, str, str], Scenario],
    checks: tuple[Callable[[Result], Sequence[Claim]], Callable[[Result], Sequence[Claim]]],
) -> tuple[Operation, Operation]:
    """Motoring, and the same in regeneration."""
    control = Control("the temperature that the drive is told", _without, checks[1])
    shown = ("omega_m", "torque", "R_s")

    def operation(k: int, text: str, sign: float) -> Operation:
        return Operation(
            names[k], order + k, text, partial(build, sign), checks[0], control, MACHINES, shown=shown
        )

    return operation(0, asked, 1.0), operation(1, "The same in regeneration", -1.0)


MACHINES = tuple(DRIVES)
OPERATIONS = (
    *_both(
        ("temperature-motoring", "temperature-regenerating"),
        50,
        "Speed under rated torque, cold and after a rise of 80 K",
        _speed,
        (_check_speed, _wrong_speed),
    ),
    *_both(
        ("temperature-torque", "temperature-torque-regenerating"),
        52,
        "Rated torque from standstill to rated speed cold, and back after a rise of 80 K",
        _torque,
        (_check_torque, _wrong_torque),
    ),
)
