"""What the runs over the plane share: the drive and the conditions it runs under.

Speeds in per unit of rated frequency (1 pu is `2π f_N/n_p` mechanical rad/s), torques in units of rated
torque.

Nothing is tuned to a run: the drive's settings are its defaults, one set per machine. The plant switches,
with dead time, clamping, 12-bit converters, 0.4 % noise, one period of delay and no friction. Its current
sensors have an offset of 1 % of rated peak current (each of i_α and i_β: 1 % of rated rms), which the drive
may read at rest (`calibrate_offset`, its default), unless `offset_at` lets it appear only afterwards.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from typing import Any

from stillflux import _core
from stillflux.evidence.machines import ADC_NOISE, inverter_of, motor_of, plant_of, scaled
from stillflux.options import PlantOptions
from stillflux.parameters import Motor
from stillflux.scenario import Profile, Scenario

__all__ = [
    "AT_SPEED",
    "HOLD",
    "LOAD_AT",
    "OFFSET",
    "OFFSET_AT",
    "REACHED",
    "SCHEMES",
    "SIGNALS",
    "START",
    "current",
    "drive",
    "line_speed",
    "slip",
]

SCHEMES = ("paper", "enhanced")
"""The published scheme and the one that goes beyond it."""

OFFSET = 0.01 * cmath.exp(0.25j * math.pi)
"""Offset of the current sensors, a space vector per unit of rated peak current."""

SIGNALS = tuple(
    name
    for name in (
        "psi_s",
        "omega_m",
        "torque",
        "load_torque",
        "angle_error",
        "reference",
        "R_s",
        "estimate.psi_s",
        "estimate.i_dq_ref",
        "estimate.omega_m",
        "estimate.torque",
        "estimate.R_s",
        "estimate.confidence",
        "estimate.angle_deviation",
        "status",
    )
    if name in _core.signals()
)
"""What is recorded: enough to judge a run and to draw it."""
EVERY = 50
"""Control periods from one recorded row to the next, 5 ms; the field turns by 18° at most at 0.2 pu."""

START = 1.6
"""Offset reading and magnetisation take 1.5 s: from then on the references move, s."""
OFFSET_AT = START
"""When an offset that no reading at rest can have seen appears, s."""
AT_SPEED, LOAD_AT, REACHED = START + 1.5, START + 1.9, START + 2.9
"""Speed ramp at no load from `START` to `AT_SPEED`, load ramp from `LOAD_AT` to `REACHED`, s."""
HOLD = 20.0
"""Time for which an operating point is held, s."""


def drive(
    machine: str,
    scheme: str,
    arithmetic: str = "f32",
    *,
    name: str,
    duration: float,
    omega: Profile = 0.0,
    load: Profile = 0.0,
    offset: complex = OFFSET,
    offset_at: float | None = None,
    changes: Sequence[tuple[float, dict[str, Any]]] = (),
    plant: PlantOptions | None = None,
    **fields: Any,
) -> Scenario:
    """A drive with its default settings on the switching-level plant. That of a user's machine which was
    commissioned is told what was found, and runs on what was simulated.

    `omega` in per unit, `load` in units of rated torque, `offset` of the current space vector in per unit,
    there from power-up or from `offset_at` s on; `plant` holds further options of the plant, `fields` fields
    of the scenario.
    """
    motor = motor_of(machine)
    ampere = offset * motor.base["i"]
    options: PlantOptions = {"current_offset": ampere, "adc_noise": ADC_NOISE * motor.I_N}
    if plant is not None:
        options.update(plant)
    changed = list(changes)
    if offset_at is not None:
        options["current_offset"] = 0j
        changed.append((offset_at, {"current_offset": ampere}))
    return Scenario(
        name=f"{name}, {machine}, {scheme}, {arithmetic}",
        motor=motor,
        inverter=inverter_of(machine),
        scheme=scheme,
        arithmetic=arithmetic,
        plant=options,
        omega_ref=scaled(omega, motor.base["omega_m"]),
        load_torque=scaled(load, motor.T_N),
        duration=duration,
        changes=sorted(changed, key=lambda change: change[0]),
        **{"signals": SIGNALS, "record_every": EVERY, **plant_of(machine, scheme), **fields},
    )


def slip(motor: Motor, torque: float) -> float:
    """Slip frequency at rated stator flux in per unit of rated frequency; `torque` in units of rated torque.

    Steady state of the machine as the drive knows it: `ω_r = R_R T/(1.5 n_p y)` with `y = |ψ_R|²`.
    """
    flow, y = _steady(motor, torque)
    return motor.R_R * flow / y / motor.base["omega"]


def current(motor: Motor, torque: float) -> float:
    """Stator current there, of the rated peak: `i_d = |ψ_R|/L_M`, `i_q = T/(1.5 n_p |ψ_R|)`."""
    flow, y = _steady(motor, torque)
    return math.hypot(math.sqrt(y) / motor.L_M, flow / math.sqrt(y)) / motor.base["i"]


def _steady(motor: Motor, torque: float) -> tuple[float, float]:
    """`T/(1.5 n_p)` and `y = |ψ_R|²` at rated stator flux: with the torque `(3/2) n_p |ψ_R| i_q` it is
    `|ψ_s|² = (L_s/L_M)² y + (L_σ T/(1.5 n_p))²/y`."""
    flow = torque * motor.T_N / (1.5 * motor.n_p)
    a, b, square = (motor.L_s / motor.L_M) ** 2, (motor.L_sigma * flow) ** 2, motor.base["psi"] ** 2
    return flow, (square + math.sqrt(square * square - 4.0 * a * b)) / (2.0 * a)


def line_speed(motor: Motor, torque: float) -> float:
    """Speed in per unit at which the stator frequency is zero under `torque` (units of rated torque)."""
    return -slip(motor, torque)
