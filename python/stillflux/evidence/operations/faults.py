"""What fails around a drive: a phase, a current channel, a single sample, calls of the control, the shaft."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillflux.evidence.claims import Claim, at_least, at_most, holds
from stillflux.evidence.drives import DRIVES
from stillflux.evidence.operation import Control, Operation, asked, magnetised
from stillflux.metrics import faulted
from stillflux.options import PlantOptions
from stillflux.result import Result
from stillflux.scenario import Scenario
from stillflux.status import StatusCode

_OMEGA, _LOAD = 0.3, 0.5
"""Speed, per unit, and load, of rated torque, at which something fails."""
_AFTER = 0.5
"""Time that is looked at after it, s."""
_SIGNALS = ("omega_m", "reference", "torque", "i_s", "angle_error", "estimate.omega_m", "status")
_SHOWN = ("omega_m", "torque", "i_s")


def _event(machine: str) -> float:
    """When it happens, s: the speed is reached on half of rated torque, and the load stands."""
    motor = DRIVES[machine].motor
    return magnetised(machine) + _ramp(machine) + 2.0 * motor.tau_r + 0.6


def _ramp(machine: str) -> float:
    motor = DRIVES[machine].motor
    return max(0.4, 2.0 * _OMEGA * motor.J * motor.base["omega_m"] / motor.T_N)


def _running(
    what: str,
    changes: Callable[[float, str], list[tuple[float, dict[str, Any]]]],
    machine: str,
    scheme: str,
    arithmetic: str,
) -> Scenario:
    """At 0.3 pu under half of rated torque, until something happens."""
    motor = DRIVES[machine].motor
    begin, omega, event = magnetised(machine), _OMEGA * motor.base["omega_m"], _event(machine)
    end = begin + _ramp(machine)
    return asked(
        what,
        machine,
        scheme,
        arithmetic,
        omega_ref=[(0.0, 0.0), (begin, 0.0), (end, omega)],
        load_torque=[(0.0, 0.0), (end, 0.0), (end + 0.1, _LOAD * motor.T_N)],
        changes=changes(event, machine),
        duration=event + _AFTER,
        record_every=1,
        signals=_SIGNALS,
    )


def _found(result: Result) -> float:
    """When the bridge was blocked by a fault, s; inf: it was not."""
    first = np.flatnonzero(faulted(result))
    return float(result.t[first[0]]) if len(first) else math.inf


def _phase(result: Result, number: int) -> NDArray[np.float64]:
    """True current of a phase, A."""
    i: NDArray[np.complex128] = result["i_s"]
    current: NDArray[np.float64] = (i * np.exp(-2j * np.pi / 3.0 * number)).real
    return current


def _last_current(result: Result, number: int) -> float:
    """When a phase that is opened carries current for the last time, s: the arc leads it to its next zero."""
    carries = (np.abs(_phase(result, number)) > 1e-6) & (result.t < _found(result) - 1e-9)
    return float(result.t[np.flatnonzero(carries)[-1]])


def _open_phase(event: float, machine: str) -> list[tuple[float, dict[str, Any]]]:
    del machine
    return [(event, {"open_phase": 1})]


def _check_open(result: Result) -> list[Claim]:
    return [
        holds("open phase", result.status.fault == "open phase"),
        at_most(
            "time from its last current to the fault, ms",
            1e3 * (_found(result) - _last_current(result, 1)),
            20.0,
        ),
    ]


def _goes_on(result: Result) -> list[Claim]:
    event = float(result.scenario.changes[0][0])
    return [
        holds("another fault, or none", result.status.fault != "open phase"),
        at_least("time to it, ms", min(1e3 * (_found(result) - event), 1e3 * _AFTER), 25.0),
    ]


def _opened_before(machine: str, scheme: str, arithmetic: str) -> Scenario:
    """A contactor that does not close: the phase is open before the start."""
    motor = DRIVES[machine].motor
    return asked(
        "start with an open phase",
        machine,
        scheme,
        arithmetic,
        omega_ref=0.1 * motor.base["omega_m"],
        changes=[(0.02, {"open_phase": 1})],
        duration=0.1 + _AFTER,
        record_every=1,
        signals=_SIGNALS,
    )


def _begins(result: Result) -> float:
    """When the bridge switches for the first time, s."""
    return float(result.t[np.flatnonzero(result["status"] == StatusCode.MAGNETISING)[0]])


def _check_start(result: Result) -> list[Claim]:
    late = 1e3 * (_found(result) - _begins(result))
    return [
        holds("open phase", result.status.fault == "open phase"),
        at_most("time from the first voltage to the fault, ms", late, 50.0),
    ]


def _starts_on(result: Result) -> list[Claim]:
    """The enhanced scheme takes the open phase for a rotation and drives a current up to its trip."""
    time = 1e3 * (min(_found(result), float(result.t[-1])) - _begins(result))
    return [
        holds("over-current, or no fault for 100 ms", result.status.fault == "over-current" or time >= 100.0)
    ]


_CHANNELS: dict[str, tuple[str, list[dict[str, Any]]]] = {
    "held": ("A current channel that stays at its value", [{"channel": (1, "held")}]),
    "inverted": ("A current channel whose sign turns", [{"channel": (2, "gain", -1.0)}]),
    "swapped": (
        "Two current channels that are swapped",
        [{"channel": (1, "of", 2.0)}, {"channel": (2, "of", 1.0)}],
    ),
}


def _channel(name: str) -> Callable[[float, str], list[tuple[float, dict[str, Any]]]]:
    return lambda event, machine: [(event, change) for change in _CHANNELS[name][1]]


def _largest(result: Result) -> float:
    """Largest true current, of the trip level."""
    return float(np.abs(result["i_s"]).max()) / (2.3 * math.sqrt(2.0) * result.scenario.motor.I_N)


def _check_channel(result: Result) -> list[Claim]:
    event = float(result.scenario.changes[0][0])
    return [
        at_most("time to the fault, ms", 1e3 * (_found(result) - event), 30.0),
        # Of a wrong channel the current grows with the bandwidth of its control. One that is just below the
        # trip at a sample has grown by e^(2π 0.03), 1.207, at the next, where it is found: it is within
        # reach of the voltage, so that the reading is not bridged as a single bad one. A sign that turns at
        # once takes the reference's part beside it; the delay of the duties makes both less.
        at_most("largest current, of the trip level", _largest(result), 1.21),
    ]


def _later(result: Result) -> list[Claim]:
    event = float(result.scenario.changes[0][0])
    late = min(1e3 * (_found(result) - event), 1e3 * _AFTER)
    return [at_least("time to the fault, or without one, ms", late, 60.0)]


def _does_harm(result: Result) -> list[Claim]:
    return [at_least("largest current, of the trip level", _largest(result), 1.3)]


def _without_trips(scenario: Scenario) -> Scenario:
    """Neither monitors, nor a trip level or an end of the sensors' range within reach."""
    i_n = math.sqrt(2.0) * scenario.motor.I_N
    plant: PlantOptions = {**scenario.plant, "adc_range": 20.0 * i_n}
    return scenario.with_settings(supervision=False, i_trip=7.9 * i_n, i_range=19.0 * i_n).replace(
        plant=plant
    )


def _bad_samples(number: int, event: float, machine: str) -> list[tuple[float, dict[str, Any]]]:
    """Readings at the rail in so many periods, one after the other."""
    drive = DRIVES[machine]
    rail = 10.0 * drive.motor.I_N
    return [(event + k / drive.inverter.f_s, {"channel": (0, "once", rail)}) for k in range(number)]


def _check_bridged(result: Result) -> list[Claim]:
    event = float(result.scenario.changes[0][0])
    angle = np.degrees(np.abs(result.window(event)["angle_error"]))
    return [
        holds("no fault", not faulted(result).any()),
        at_most("field angle error after it", float(angle.max()), 3.0, "°"),
    ]


def _two(scenario: Scenario) -> Scenario:
    (t, change), *_ = scenario.changes
    return scenario.replace(changes=[(t, change), (t + 1.0 / scenario.inverter.f_s, change)])


def _measurement(result: Result) -> list[Claim]:
    return [holds("measurement", result.status.fault == "measurement")]


def _missed(machine: str, scheme: str, arithmetic: str) -> Scenario:
    """Every twentieth call of the control is missed; each has its stamp."""
    scenario = _running("missed calls", lambda event, machine: [], machine, scheme, arithmetic)
    return scenario.replace(plant={**scenario.plant, "missed_calls": 0.05}, cycle_stamps=True)


def _check_missed(result: Result) -> list[Claim]:
    return [
        holds("timing", result.status.fault == "timing"),
        at_most("time of the fault after the first voltage, s", _found(result) - _begins(result), 0.3),
    ]


def _unseen(result: Result) -> list[Claim]:
    return [holds("not timing", result.status.fault != "timing")]


def _blocked(machine: str, scheme: str, arithmetic: str) -> Scenario:
    """A shaft that does not turn: the brake stays closed."""
    motor = DRIVES[machine].motor
    begin, omega = magnetised(machine), 0.2 * motor.base["omega_m"]
    return asked(
        "blocked shaft",
        machine,
        scheme,
        arithmetic,
        plant={"speed": 0.0},
        omega_ref=[(0.0, 0.0), (begin, 0.0), (begin, omega)],
        duration=begin + 2.0,
        signals=_SIGNALS,
    )


def _moves(result: Result) -> float:
    assert isinstance(result.scenario.omega_ref, Sequence)
    return float(result.scenario.omega_ref[1][0])


def _check_stall(result: Result) -> list[Claim]:
    return [
        holds("stall", result.status.fault == "stall"),
        at_most("time of the fault after the step, s", _found(result) - _moves(result), 0.8),
    ]


def _pushes_on(result: Result) -> list[Claim]:
    return [
        holds("no fault", not faulted(result).any()),
        at_least("torque at the end, of T_N", float(result["torque"][-1]) / result.scenario.motor.T_N, 1.3),
    ]


def _unsupervised(scenario: Scenario) -> Scenario:
    return scenario.with_settings(supervision=False)


_MONITORS = "the monitors"

OPERATIONS = (
    Operation(
        "open-phase",
        70,
        "A phase that opens at 0.3 pu under half of rated torque",
        partial(_running, "open phase", _open_phase),
        _check_open,
        Control(_MONITORS, _unsupervised, _goes_on),
        shown=_SHOWN,
        schemes=("enhanced", "paper"),
    ),
    Operation(
        "open-phase-start",
        71,
        "A start with a phase that is open",
        _opened_before,
        _check_start,
        Control(_MONITORS, _unsupervised, _starts_on),
        shown=_SHOWN,
        schemes=("enhanced", "paper"),
    ),
    *(
        Operation(
            f"channel-{name}",
            72 + k,
            f"{what}, at 0.3 pu under half of rated torque",
            partial(_running, f"channel {name}", _channel(name)),
            _check_channel,
            Control(_MONITORS, _unsupervised, _later)
            if name == "held"
            else Control("monitors and trip levels", _without_trips, _does_harm),
            shown=_SHOWN,
        )
        for k, (name, (what, _)) in enumerate(_CHANNELS.items())
    ),
    Operation(
        "bad-sample",
        75,
        "One reading of a current at the end of its range",
        partial(_running, "one bad sample", partial(_bad_samples, 1)),
        _check_bridged,
        Control("the good sample after it", _two, _measurement),
        shown=_SHOWN,
        schemes=("enhanced", "paper"),
    ),
    Operation(
        "missed-calls",
        76,
        "Every twentieth call of the control is missed",
        _missed,
        _check_missed,
        Control("the stamps of the calls", lambda s: s.replace(cycle_stamps=False), _unseen),
        shown=_SHOWN,
    ),
    Operation(
        "stall",
        77,
        "A step of the reference to 0.2 pu against a closed brake",
        _blocked,
        _check_stall,
        Control("the monitor of the stall", lambda s: s.with_settings(stall_time=0.0), _pushes_on),
        shown=_SHOWN,
        schemes=("enhanced", "paper"),
    ),
)
