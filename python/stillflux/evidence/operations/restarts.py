"""Starts of a machine that turns: restarts with the flux of before, a shaft that something else turns, and a
supply that comes back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from stillflux.evidence.claims import Claim, at_least, at_most, holds
from stillflux.evidence.draws import drawn
from stillflux.evidence.drives import DRIVES
from stillflux.evidence.operation import Control, Operation, asked, magnetised
from stillflux.evidence.tolerance import LOST_ANGLE
from stillflux.metrics import faulted
from stillflux.options import PlantOptions
from stillflux.result import Result
from stillflux.scenario import Scenario
from stillflux.status import StatusCode

_OMEGA, _LOAD = 0.24, 0.3
"""Speed, per unit, and load, of rated torque."""
_AFTER = 1.0
"""Time that is looked at after the restart, s."""
_SIGNALS = ("omega_m", "reference", "torque", "psi_s", "i_s", "angle_error", "u_dc", "status")
_SHOWN = ("omega_m", "reference", "torque", "psi_s")


def _restart(pause: float, machine: str, scheme: str, arithmetic: str) -> Scenario:
    """At 0.24 pu under 0.3 of rated torque; a stop, which takes the load off, and a restart."""
    motor = DRIVES[machine].motor
    begin, omega = magnetised(machine), _OMEGA * motor.base["omega_m"]
    ramp = max(0.4, 2.0 * _OMEGA * motor.J * motor.base["omega_m"] / motor.T_N)
    stop = begin + ramp + 2.0 * motor.tau_r + 0.6
    again = stop + pause
    load = _LOAD * motor.T_N
    return asked(
        f"restart after {1e3 * pause:g} ms",
        machine,
        scheme,
        arithmetic,
        omega_ref=[(0.0, 0.0), (begin, 0.0), (begin + ramp, omega)],
        load_torque=[
            (0.0, 0.0),
            (begin + ramp, 0.0),
            (begin + ramp + 0.1, load),
            (stop, load),
            (stop, 0.0),
            (again + 0.3, 0.0),
            (again + 0.4, load),
        ],
        changes=[(stop, {"stop": True}), (again, {"stop": False})],
        duration=again + 0.4 + _AFTER,
        record_every=2,
        signals=_SIGNALS,
    )


def _again(result: Result) -> float:
    """When the drive may run again, s."""
    return float(result.scenario.changes[-1][0])


def _took(result: Result) -> float:
    """Time until it runs, s."""
    after = result.window(_again(result))
    runs = np.flatnonzero(after["status"] == StatusCode.RUNNING)
    return float(after.t[runs[0]]) - _again(result) if len(runs) else math.inf


def _flux_left(result: Result) -> float:
    """Flux at the restart, of rated."""
    rows = np.flatnonzero(result.t <= _again(result))
    return float(np.abs(result["psi_s"][rows[-1]])) / result.scenario.motor.base["psi"]


def _check(result: Result) -> list[Claim]:
    motor = result.scenario.motor
    after = result.window(_again(result))
    angle = np.degrees(np.abs(after["angle_error"][after["status"] == StatusCode.RUNNING]))
    trip = 2.3 * math.sqrt(2.0) * motor.I_N
    error = abs(float(result["omega_m"][-1] - result["reference"][-1])) / motor.base["omega_m"]
    return [
        holds("no fault", not faulted(result).any()),
        at_most("time until it runs, s", _took(result), 0.1),
        at_most("largest current, of the trip level", float(np.abs(after["i_s"]).max()) / trip, 0.9),
        at_most("field angle error", float(angle.max(initial=0.0)), LOST_ANGLE, "°"),
        at_most("speed error at the end, pu", error, 0.01),
    ]


def _anew(result: Result) -> list[Claim]:
    return [at_least("time until it runs, s", _took(result), 0.1)]


def _not_fresh(scenario: Scenario) -> Scenario:
    return scenario.with_settings(fresh_time=0.0)


def _supply(machine: str, scheme: str, arithmetic: str) -> Scenario:
    """The supply fails for 0.5 s at half speed under a fifth of rated torque; the application leaves the
    fault when it is back."""
    drive = DRIVES[machine]
    motor, u = drive.motor, drive.inverter.u_dc
    omega, begin = 0.5 * motor.base["omega_m"], magnetised(machine)
    power = motor.T_N * motor.base["omega_m"]
    inertia = max(8.0 * motor.J, 0.2 * motor.T_N * 0.5 / (0.15 * motor.base["omega_m"]))
    gone = begin + 2.0 * inertia * omega / motor.T_N + 1.0
    back = gone + 0.5
    return asked(
        "supply fails and comes back",
        machine,
        scheme,
        arithmetic,
        plant={
            "J_load": inertia - motor.J,
            "dc_link": (250e-6 * power / 1e3 * (540.0 / u) ** 2, 0.02 * u * u / power, None),
        },
        omega_ref=[(0.0, 0.0), (begin, 0.0), (begin, omega)],
        load_torque=[(0.0, 0.0), (begin, 0.0), (begin + 0.5, 0.2 * motor.T_N)],
        changes=[(gone, {"u_dc": 0.0}), (back, {"u_dc": u}), (back + 0.1, {"reset": True})],
        duration=back + 0.1 + 1.5 * inertia * omega / motor.T_N + 1.5,
        record_every=5,
        signals=_SIGNALS,
    )


def _check_supply(result: Result) -> list[Claim]:
    motor = result.scenario.motor
    gone = float(result.scenario.changes[0][0])
    first = np.flatnonzero(faulted(result))
    error = abs(float(result["omega_m"][-1] - result["reference"][-1])) / motor.base["omega_m"]
    return [
        holds(
            "a fault while the supply is gone",
            bool(len(first)) and gone < float(result.t[first[0]]) < gone + 0.5,
        ),
        # No flux is left after this time: the current has to build it up.
        at_most("time until it runs, s", _took(result), 0.3),
        at_most("speed error at the end, pu", error, 0.01),
    ]


def _stays_blocked(result: Result) -> list[Claim]:
    return [holds("it does not run", not math.isfinite(_took(result)))]


def _without_reset(scenario: Scenario) -> Scenario:
    return scenario.replace(
        changes=[(t, {"reset": False} if "reset" in what else what) for t, what in scenario.changes]
    )


_DRAGGED, _TURNED = 1.3, 0.045
"""Product of speed and rotor time constant, which turns the field by 52°, at a speed of at most this, pu."""


def _held(
    what: str,
    machine: str,
    scheme: str,
    arithmetic: str,
    omega: float,
    plant: PlantOptions | None = None,
    **fields: Any,
) -> Scenario:
    """Something else turns the shaft at the speed that is asked for; 0.5 s after the start it lets go, then
    half of rated torque comes."""
    motor = DRIVES[machine].motor
    begin = magnetised(machine)
    load = math.copysign(0.5 * motor.T_N, omega)
    return asked(
        what,
        machine,
        scheme,
        arithmetic,
        plant={**(plant or {}), "speed": omega},
        omega_ref=omega,
        load_torque=[(0.0, 0.0), (begin + 1.0, 0.0), (begin + 1.5, load)],
        changes=[(begin + 0.5, {"speed": None})],
        duration=begin + 3.0,
        record_every=5,
        signals=_SIGNALS,
        **fields,
    )


def _turned(machine: str, scheme: str, arithmetic: str) -> Scenario:
    """So slowly that the search does not find it."""
    motor = DRIVES[machine].motor
    base = motor.base
    omega = min(_DRAGGED / (base["omega"] * motor.tau_r), _TURNED) * base["omega_m"]
    return _held("start while the shaft is turned", machine, scheme, arithmetic, omega)


def _angle_at_first(result: Result) -> float:
    """Field angle error when the drive begins to run, °."""
    runs = np.flatnonzero(result["status"] == StatusCode.RUNNING)
    return abs(math.degrees(float(result["angle_error"][runs[0]]))) if len(runs) else 0.0


def _check_turned(result: Result) -> list[Claim]:
    angle = np.degrees(np.abs(result["angle_error"][result["status"] == StatusCode.RUNNING]))
    error = abs(float(result["omega_m"][-1] - result["reference"][-1]))
    return [
        holds("no fault", not faulted(result).any()),
        at_most("field angle error when it begins to run", _angle_at_first(result), 15.0, "°"),
        at_most("field angle error", float(angle.max(initial=0.0)), LOST_ANGLE, "°"),
        at_most("speed error at the end, pu", error / result.scenario.motor.base["omega_m"], 0.01),
    ]


def _off_at_first(result: Result) -> list[Claim]:
    return [at_least("field angle error when it begins to run", _angle_at_first(result), 30.0, "°")]


def _taken_to_stand(scenario: Scenario) -> Scenario:
    return scenario.with_settings(find_slow_rotation=False)


_UNMAGNETISED, _INSTALLATIONS = -0.1, {"45kW": 56, "160kW": 2}
"""Speed, pu, and installations whose voltage is off by as much as builds up the flux of the drive."""


def _turned_large(machine: str, scheme: str, arithmetic: str) -> Scenario:
    """A large machine with every parameter off."""
    omega = _UNMAGNETISED * DRIVES[machine].motor.base["omega_m"]
    real = drawn(DRIVES[machine], _INSTALLATIONS[machine])
    scenario = _held(
        "start while a large machine is turned",
        machine,
        scheme,
        arithmetic,
        omega,
        plant=real.plant,
        plant_motor=real.motor,
        plant_inverter=real.inverter,
    )
    return scenario.replace(inverter=real.told)


def _lost_once_running(result: Result) -> list[Claim]:
    runs = result["status"] == StatusCode.RUNNING
    angle = np.degrees(np.abs(result["angle_error"][runs]))
    return [at_least("field angle error", float(angle.max(initial=0.0)), LOST_ANGLE, "°")]


_PAUSES: Sequence[float] = (0.001, 0.02, 0.3)

OPERATIONS = (
    *(
        Operation(
            f"restart-{round(1e3 * pause)}ms",
            80 + k,
            f"A stop at 0.24 pu, and a restart {round(1e3 * pause)} ms later",
            partial(_restart, pause),
            _check,
            Control("what is fresh from before", _not_fresh, _anew),
            shown=_SHOWN,
        )
        for k, pause in enumerate(_PAUSES)
    ),
    Operation(
        "start-turned",
        84,
        "A start while something else turns the shaft, below 0.05 pu",
        _turned,
        _check_turned,
        Control("what turns the field from the current", _taken_to_stand, _off_at_first),
        shown=_SHOWN,
    ),
    Operation(
        "start-turned-large",
        85,
        "A start while something else turns a large machine at 0.1 pu, every parameter off",
        _turned_large,
        _check_turned,
        Control("the circle of the flux", _taken_to_stand, _lost_once_running),
        machines=tuple(_INSTALLATIONS),
        shown=_SHOWN,
    ),
    Operation(
        "supply-back",
        86,
        "The supply fails for 0.5 s at half speed, and the fault is left 0.1 s after it is back",
        _supply,
        _check_supply,
        Control("the reset", _without_reset, _stays_blocked),
        machines=("2.2kW", "11kW", "4kW", "fan"),
        shown=("omega_m", "torque", "psi_s", "u_dc"),
    ),
)
