"""The dc link on a capacitor behind a diode rectifier: braking, a brake chopper, and a supply that fails."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stillflux.evidence.claims import Claim, at_least, at_most, holds
from stillflux.evidence.drives import DRIVES
from stillflux.evidence.operation import Control, Operation, asked
from stillflux.metrics import faulted
from stillflux.parameters import Inverter, Motor
from stillflux.result import Result
from stillflux.scenario import Scenario

_MACHINES = ("2.2kW", "11kW", "4kW", "fan")
_START = 1.8
_SIGNALS = ("omega_m", "reference", "torque", "u_dc", "chopper", "psi_s", "i_s", "status")


def _link(
    motor: Motor, inverter: Inverter, chopper: float | None = None
) -> tuple[float, float, float | None]:
    """250 µF at 540 V and 1 kW, a supply with 2 % drop, a chopper for so many times rated power."""
    power, u = motor.T_N * motor.base["omega_m"], inverter.u_dc
    size = power / 1e3 * (540.0 / u) ** 2
    return (
        250e-6 * size,
        0.02 * u * u / power,
        None if chopper is None else (1.3 * u) ** 2 / (chopper * power),
    )


def _braked(machine: str, scheme: str, arithmetic: str) -> Scenario:
    """To 0.8 pu with four times the inertia, and a step of the reference to zero."""
    drive = DRIVES[machine]
    motor, u = drive.motor, drive.inverter.u_dc
    omega = 0.8 * motor.base["omega_m"]
    # Three times rated torque's time from rest, and time to lose the energy in the machine alone.
    rise = 4.0 * motor.J * omega / motor.T_N
    stop = _START + 1.5 * rise + 0.5
    return asked(
        "braking",
        machine,
        scheme,
        arithmetic,
        signals=_SIGNALS,
        settings={"u_dc_brake": 1.3 * u},
        plant={"J_load": 3.0 * motor.J, "dc_link": _link(motor, drive.inverter)},
        omega_ref=[(0.0, 0.0), (_START, 0.0), (_START, omega), (stop, omega), (stop, 0.0)],
        duration=stop + 12.0 * rise + 1.0,
        record_every=20,
    )


def _peak(result: Result) -> float:
    return float(result["u_dc"].max()) / result.scenario.inverter.u_dc


def _stopped(result: Result) -> float:
    return abs(float(result["omega_m"][-1])) / result.scenario.motor.base["omega_m"]


def _check_braked(result: Result) -> list[Claim]:
    return [
        holds("no fault", not faulted(result).any()),
        at_most("largest link voltage, of rated", _peak(result), 1.3),
        # Only the losses take energy: how soon the drive is at rest is theirs.
        at_most("speed at the end, pu", _stopped(result), 0.7),
    ]


def _over_voltage(result: Result) -> list[Claim]:
    first = np.flatnonzero(faulted(result))
    assert isinstance(result.scenario.omega_ref, Sequence)
    event = result.scenario.omega_ref[-1][0]
    return [
        holds("over-voltage", result.status.fault == "over-voltage"),
        at_least(
            "time of the fault after the step, s",
            float(result.t[first[0]]) - event if len(first) else math.inf,
            0.0,
        ),
        at_least("largest link voltage, of rated", _peak(result), 1.44),
    ]


def _chopped(machine: str, scheme: str, arithmetic: str) -> Scenario:
    """The same with a chopper for rated power and no limit of the braking torque."""
    drive = DRIVES[machine]
    braked = _braked(machine, scheme, arithmetic)
    u = drive.inverter.u_dc
    return braked.replace(
        settings={"u_dc_chopper": (1.2 * u, 1.3 * u)},
        plant={**braked.plant, "dc_link": _link(drive.motor, drive.inverter, chopper=1.5)},
        name=braked.name.replace("braking", "chopper"),
    )


def _check_chopped(result: Result) -> list[Claim]:
    motor = result.scenario.motor
    assert isinstance(result.scenario.omega_ref, Sequence)
    event = result.scenario.omega_ref[-1][0]
    after = result.window(event)
    there = np.flatnonzero(np.abs(after["omega_m"]) < 0.02 * motor.base["omega_m"])
    took = float(after.t[there[0]] - event) if len(there) else math.inf
    # All of the torque to the end: the kinetic energy over its mean power.
    least = 4.0 * motor.J * 0.8 * motor.base["omega_m"] / (1.5 * motor.T_N)
    return [
        holds("no fault", not faulted(result).any()),
        at_most("largest link voltage, of rated", _peak(result), 1.3),
        at_most("time to rest, against that at full torque", took / least, 1.2),
    ]


def _dip(machine: str, scheme: str, arithmetic: str) -> Scenario:
    """Half of rated speed and a fifth of rated torque, eight times the inertia; no supply for 0.5 s."""
    drive = DRIVES[machine]
    motor, u = drive.motor, drive.inverter.u_dc
    omega = 0.5 * motor.base["omega_m"]
    # The load takes a tenth of the speed in the dip.
    inertia = max(8.0 * motor.J, 0.2 * motor.T_N * 0.5 / (0.15 * motor.base["omega_m"]))
    gone = _START + 2.0 * inertia * omega / motor.T_N + 1.0
    return asked(
        "supply dip",
        machine,
        scheme,
        arithmetic,
        signals=_SIGNALS,
        settings={"u_dc_buffer": 0.8 * u},
        plant={"J_load": inertia - motor.J, "dc_link": _link(motor, drive.inverter)},
        omega_ref=[(0.0, 0.0), (_START, 0.0), (_START, omega)],
        load_torque=[(0.0, 0.0), (_START, 0.0), (_START + 0.5, 0.2 * motor.T_N)],
        changes=[(gone, {"u_dc": 0.0}), (gone + 0.5, {"u_dc": u})],
        duration=gone + 0.5 + 1.0 * inertia * omega / motor.T_N + 1.0,
        record_every=20,
    )


def _gone(result: Result) -> float:
    return float(result.scenario.changes[0][0])


def _check_dip(result: Result) -> list[Claim]:
    gone = _gone(result)
    dip = result.window(gone + 0.1, gone + 0.5)
    error = (
        abs(float(result["omega_m"][-1] - result["reference"][-1])) / result.scenario.motor.base["omega_m"]
    )
    return [
        holds("no fault", not faulted(result).any()),
        at_least(
            "least link voltage in the dip, of rated",
            float(dip["u_dc"].min()) / result.scenario.inverter.u_dc,
            0.7,
        ),
        at_most("speed error at the end, pu", error, 0.01),
    ]


def _under_voltage(result: Result) -> list[Claim]:
    first = np.flatnonzero(faulted(result))
    when = float(result.t[first[0]]) - _gone(result) if len(first) else math.inf
    return [
        holds("under-voltage", result.status.fault == "under-voltage"),
        at_least("time of the fault after the supply has gone, s", when, 0.0),
        at_most("time of the fault after the supply has gone, s", when, 0.4),
    ]


OPERATIONS = (
    Operation(
        "braking",
        40,
        "A step from 0.8 pu to rest on a rectifier, which takes nothing back",
        _braked,
        _check_braked,
        Control("the limit of the braking torque", lambda s: s.replace(settings={}), _over_voltage),
        _MACHINES,
        ("enhanced",),
        ("omega_m", "torque", "u_dc"),
    ),
    Operation(
        "chopper",
        41,
        "The same with a brake chopper for 1.5 times rated power",
        _chopped,
        _check_chopped,
        Control("the chopper", lambda s: s.replace(settings={}), _over_voltage),
        _MACHINES,
        ("enhanced",),
        ("omega_m", "torque", "u_dc", "chopper"),
    ),
    Operation(
        "supply-dip",
        42,
        "No supply for 0.5 s at half speed under a fifth of rated torque",
        _dip,
        _check_dip,
        Control("kinetic buffering", lambda s: s.replace(settings={}), _under_voltage),
        _MACHINES,
        ("enhanced",),
        ("omega_m", "torque", "u_dc"),
    ),
)
