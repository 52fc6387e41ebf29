"""The runs beyond the paper's figures, as scenarios: copy one, change it, `simulate` it.

Every function takes a machine of `stillflux.scenarios.ALL_MACHINES`, a scheme and an arithmetic. Speeds in
per unit of rated frequency (1 pu is `2π f_N/n_p` mechanical rad/s), torques in units of rated torque.

Nothing is tuned to a run: the drive's settings are its defaults, one set per machine. The plant switches,
with dead time, clamping, 12-bit converters, 0.4 % noise, one period of delay and no friction. Its current
sensors have an offset of 1 % of rated peak current (each of i_α and i_β: 1 % of rated rms), which the drive
may read at rest (`calibrate_offset`, its default), unless `offset_at` lets it appear only afterwards.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from stillflux import _core
from stillflux.options import PlantOptions
from stillflux.parameters import Motor
from stillflux.scenario import Profile, Scenario
from stillflux.scenarios import ADC_NOISE, IDENTIFIED, identify_then, inverter_of, motor_of, scaled, step
from stillflux.sensitivity import ERRORS

__all__ = [
    "KINDS",
    "MISMATCHES",
    "POINTS",
    "SCHEMES",
    "SPEEDS",
    "STEPPED",
    "TORQUES",
    "crossing",
    "drive",
    "field_weakening",
    "flying_start",
    "line_speed",
    "load_steps",
    "memory",
    "mismatch",
    "persistence",
    "plane",
    "rated_at_line",
    "reversal",
    "shifted",
    "slip",
    "torque_step",
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
        "estimate.angle_sigma",
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
    """A drive with its default settings on the switching-level plant.

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
        **{"signals": SIGNALS, "record_every": EVERY, **fields},
    )


def ramp(begin: float, end: float, after: float, before: float = 0.0) -> list[tuple[float, float]]:
    """`before` until `begin`, on a straight line to `after` at `end`, s."""
    return [(0.0, before), (begin, before), (end, after)]


def slip(motor: Motor, torque: float) -> float:
    """Slip frequency at rated stator flux in per unit of rated frequency; `torque` in units of rated torque.

    Steady state of the machine as the drive knows it: with `y = |ψ_R|²` and the torque `(3/2) n_p |ψ_R| i_q`,
    `|ψ_s|² = (L_s/L_M)² y + (L_σ T/(1.5 n_p))²/y` and `ω_r = R_R T/(1.5 n_p y)`.
    """
    flow = torque * motor.T_N / (1.5 * motor.n_p)
    a, b, square = (motor.L_s / motor.L_M) ** 2, (motor.L_sigma * flow) ** 2, motor.base["psi"] ** 2
    y = (square + math.sqrt(square * square - 4.0 * a * b)) / (2.0 * a)
    return motor.R_R * flow / y / motor.base["omega"]


def line_speed(motor: Motor, torque: float) -> float:
    """Speed in per unit at which the stator frequency is zero under `torque` (units of rated torque)."""
    return -slip(motor, torque)


# 1. The plane.

SPEEDS = tuple(k / 100 for k in range(-10, 11))
"""Speeds of the plane, per unit."""
TORQUES = tuple(k / 5 for k in range(-6, 7))
"""Torques of the plane, units of rated torque."""
KINDS = {
    "ramps": "reached by ramps, 1 % offset from power-up",
    "drift": "reached by ramps, 1 % offset appears once the drive runs",
    "rest": "loaded at rest before the motor has ever turned, 1 % offset from power-up",
    "rest-drift": "loaded at rest before the motor has ever turned, 1 % offset appears once the drive runs",
}
"""How the points of the plane are reached. At rest: at speed zero only."""


def plane(
    machine: str,
    scheme: str,
    arithmetic: str = "f32",
    *,
    omega: float,
    torque: float,
    kind: str = "ramps",
    hold: float = HOLD,
) -> Scenario:
    """One point of the plane, held from `REACHED` to `REACHED + hold` s.

    `omega` in per unit, `torque` in units of rated torque. Of a kind "rest" the load comes first: a ramp of
    1 s from `START` on, and `omega` has to be 0.
    """
    if kind not in KINDS:
        raise ValueError(f"kind = {kind!r}: there are {', '.join(KINDS)}")
    at_rest = kind.startswith("rest")
    if at_rest and omega != 0.0:
        raise ValueError(f"omega = {omega:g}: a load applied at rest is one at speed zero")
    load_at = START if at_rest else LOAD_AT
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"ω = {omega:g}, T = {torque:g} T_N, {kind}",
        omega=ramp(START, AT_SPEED, omega),
        load=ramp(load_at, load_at + REACHED - LOAD_AT, torque),
        offset_at=OFFSET_AT if kind.endswith("drift") else None,
        duration=REACHED + hold,
    )


# 2. Crossing zero stator frequency under load.

CROSS_AT, CROSS_REST = REACHED + 2.0, 3.0
"""The reversal begins at the first, s, and is followed by the second, s."""


def crossing(
    machine: str, scheme: str, arithmetic: str = "f32", *, begin: float, torque: float, time: float
) -> Scenario:
    """From `begin` (per unit) to `-begin` within `time` s under a constant load (units of rated torque)."""
    omega = [
        *ramp(START, AT_SPEED, begin),
        (CROSS_AT, begin),
        (CROSS_AT + time, -begin),
    ]
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"{begin:g} to {-begin:g} in {time:g} s, T = {torque:g} T_N",
        omega=omega,
        load=ramp(LOAD_AT, REACHED, torque),
        duration=CROSS_AT + time + CROSS_REST,
    )


# 3. Persistence at zero stator frequency.

PERSIST_AT = IDENTIFIED + 1.0
"""At zero stator frequency from then on, s; before that at 1 Hz, as in Fig. 18."""
STEP_LASTS = 6.0
"""The rated step at the end is held that long, s."""


def persistence(machine: str, scheme: str, arithmetic: str = "f32", *, time: float = 600.0) -> Scenario:
    """No load at ω_s = 0 for `time` s, then a rated torque step.

    Meanwhile the offset of the current sensors drifts by 0.1 % of rated peak current a minute (along i_α and
    i_β alike) and r_s rises by 10 %, in steps every 2 s.
    """
    motor = motor_of(machine)
    end, steps = PERSIST_AT + time, max(1, round(time / 2.0))
    warming = [
        (PERSIST_AT + time * k / steps, {"R_s": motor.R_s * (1.0 + 0.1 * k / steps)})
        for k in range(1, steps + 1)
    ]
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"no load at ω_s = 0 for {time:g} s",
        omega=identify_then(0.0),
        load=step(end, 1.0),
        changes=warming,
        plant={"current_offset_drift": 0.1 * OFFSET * motor.base["i"] / 60.0},
        duration=end + STEP_LASTS,
    )


def rated_at_line(
    machine: str, scheme: str, arithmetic: str = "f32", *, torque: float = 1.0, time: float = 120.0
) -> Scenario:
    """Load `torque` (units of rated torque) exactly at ω_s = 0 from `REACHED` on, for `time` s.

    The flux stays rated: the drive is not allowed to leave the line.
    """
    omega = line_speed(motor_of(machine), torque)
    scenario = drive(
        machine,
        scheme,
        arithmetic,
        name=f"T = {torque:g} T_N at ω_s = 0",
        omega=ramp(START, AT_SPEED, omega),
        load=ramp(LOAD_AT, REACHED, torque),
        duration=REACHED + time,
    )
    return scenario.with_settings(omega_s_min=0.0) if scheme == "enhanced" else scenario


LEAVE_TIME, LEAVE_REST, LEAVE_BY = 10.0, 5.0, 0.02
"""After its stay a drive goes on through the line: time of the ramp, rest at its end, s; how far, pu."""


def shifted(
    machine: str, scheme: str, arithmetic: str = "f32", *, torque: float = 1.0, time: float = 600.0
) -> Scenario:
    """The same point for `time` s with the flux shift on, its default, then on through the line in 10 s."""
    omega = line_speed(motor_of(machine), torque)
    end = REACHED + time
    beyond = omega - math.copysign(LEAVE_BY, torque)
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"T = {torque:g} T_N where ω_s would be 0, flux shifted",
        omega=[*ramp(START, AT_SPEED, omega), (end, omega), (end + LEAVE_TIME, beyond)],
        load=ramp(LOAD_AT, REACHED, torque),
        duration=end + LEAVE_TIME + LEAVE_REST,
    )


# 4. What the drive was told is wrong.


def _l_m(scenario: Scenario, x: float) -> Scenario:
    """Magnetising inductance of the inverse-Γ circuit off by `x`, everything else as it is (also R_R)."""
    motor = scenario.motor
    real = motor.replace(L_M=(1 + x) * motor.L_M)
    curve = motor.saturation
    if curve is not None:
        real = real.replace(saturation=(curve[0] * real.L_s / motor.L_s, *curve[1:]))
    return scenario.replace(plant_motor=real)


def _r_s_step(scenario: Scenario, x: float) -> Scenario:
    """r_s changes by `x` once the point is reached."""
    changes = [*scenario.changes, (REACHED, {"R_s": (1 + x) * scenario.motor.R_s})]
    return scenario.replace(changes=sorted(changes, key=lambda change: change[0]))


def _offset_after(scenario: Scenario, x: float) -> Scenario:
    """An offset `x` times that of the plane, only once the drive runs."""
    ampere = x * OFFSET * scenario.motor.base["i"]
    return scenario.replace(
        plant={**scenario.plant, "current_offset": 0j},
        changes=[(OFFSET_AT, {"current_offset": ampere}), *scenario.changes],
    )


def _dead_time(scenario: Scenario, x: float) -> Scenario:
    """The real dead time off by `x` µs."""
    inverter = scenario.inverter
    return scenario.replace(plant_inverter=inverter.replace(dead_time=inverter.dead_time + 1e-6 * x))


def _nothing(scenario: Scenario, x: float) -> Scenario:
    del x
    return scenario


MISMATCHES: Mapping[str, tuple[Callable[[Scenario, float], Scenario], float]] = {
    "nothing": (_nothing, 0.0),
    "r_s +30 %": (ERRORS["r_s"].apply, 0.3),
    "r_s −30 %": (ERRORS["r_s"].apply, -0.3),
    "r_s step +25 %": (_r_s_step, 0.25),
    "τ_r +20 %": (ERRORS["τ_r"].apply, 0.2),
    "τ_r −20 %": (ERRORS["τ_r"].apply, -0.2),
    "L_M +10 %": (_l_m, 0.1),
    "L_M −10 %": (_l_m, -0.1),
    "σl_s +20 %": (ERRORS["σl_s"].apply, 0.2),
    "σl_s −20 %": (ERRORS["σl_s"].apply, -0.2),
    "u_th +50 %": (ERRORS["u_th"].apply, 0.5),
    "u_th −50 %": (ERRORS["u_th"].apply, -0.5),
    "dead time +0.3 µs": (_dead_time, 0.3),
    "dead time −0.3 µs": (_dead_time, -0.3),
    "offset 5 %": (ERRORS["current offset"].apply, 5.0),
    "offset 5 % once running": (_offset_after, 5.0),
    "gain of a channel +2 %": (ERRORS["gain of one current channel"].apply, 0.02),
    "gain of a channel −2 %": (ERRORS["gain of one current channel"].apply, -0.02),
}
"""What is off in the real machine, inverter or sensors; the drive keeps its own values."""
STEPPED = ("offset 5 % once running",)
"""Those in which a sensor changes while the drive runs."""
POINTS = ((0.0, 0.0), (0.0, 1.0), (0.02, 1.0), (0.02, -1.0), (-0.02, 1.0), (-0.02, -1.0))
"""Speed in per unit and torque in units of rated torque at which mismatches are tried."""


def mismatch(
    machine: str, scheme: str, arithmetic: str = "f32", *, error: str, omega: float, torque: float
) -> Scenario:
    """A point of the plane (`plane`, reached by ramps) with one of `MISMATCHES`."""
    apply, x = MISMATCHES[error]
    scenario = apply(plane(machine, scheme, arithmetic, omega=omega, torque=torque), x)
    return scenario.replace(name=scenario.name.replace("ramps", error))


# 5. Transients.

TORQUE_STEP_AT = REACHED + 1.0


def torque_step(
    machine: str, scheme: str, arithmetic: str = "f32", *, omega: float, torque: float = 1.0
) -> Scenario:
    """Torque control on a shaft that a dynamometer takes to `omega`: a torque step at `TORQUE_STEP_AT`."""
    motor = motor_of(machine)
    steps = 50
    turning = [
        (START + (AT_SPEED - START) * k / steps, {"speed": motor.base["omega_m"] * omega * k / steps})
        for k in range(1, steps + 1)
    ]
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"torque step to {torque:g} T_N at ω = {omega:g}",
        torque_ref=scaled(step(TORQUE_STEP_AT, torque), motor.T_N),
        changes=turning,
        plant={"speed": 0.0},
        record_every=2,
        duration=TORQUE_STEP_AT + 1.0,
    )


LOAD_STEP_AT, UNLOAD_AT = START + 2.0, START + 6.0


def load_steps(machine: str, scheme: str, arithmetic: str = "f32", *, torque: float = 1.2) -> Scenario:
    """Zero speed; load on at `LOAD_STEP_AT`, off at `UNLOAD_AT`."""
    load = [*step(LOAD_STEP_AT, torque), (UNLOAD_AT, torque), (UNLOAD_AT, 0.0)]
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"load step of {torque:g} T_N at rest",
        load=load,
        record_every=10,
        duration=UNLOAD_AT + 3.0,
    )


REVERSE_AT, REVERSAL = START + 6.0, 4.0


def reversal(
    machine: str, scheme: str, arithmetic: str = "f32", *, begin: float = -1.0, torque: float = 0.5
) -> Scenario:
    """From `begin` through zero to `-begin` within `REVERSAL` s under a constant load."""
    omega = [*ramp(START, START + 3.0, begin), (REVERSE_AT, begin), (REVERSE_AT + REVERSAL, -begin)]
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"{begin:g} to {-begin:g}, T = {torque:g} T_N",
        omega=omega,
        load=ramp(START + 4.0, START + 5.0, torque),
        record_every=10,
        duration=REVERSE_AT + REVERSAL + 3.0,
    )


WEAKENED_AT = START + 6.0


def field_weakening(
    machine: str, scheme: str, arithmetic: str = "f32", *, top: float = 2.0, torque: float = 0.3
) -> Scenario:
    """From rest to `top`, a while there, and back, under a constant load: every hand-over twice."""
    omega = [
        *ramp(START + 1.0, WEAKENED_AT, top),
        (WEAKENED_AT + 2.0, top),
        (WEAKENED_AT + 7.0, 0.0),
    ]
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"rest to {top:g} and back, T = {torque:g} T_N",
        omega=omega,
        load=ramp(START, START + 1.0, torque),
        record_every=10,
        duration=WEAKENED_AT + 9.0,
    )


# 6. Flying start.

FLYING_SPEEDS = (-1.0, -0.5, -0.1, 0.1, 0.5, 1.0)
FLYING_LOAD_AT = 6.0


def flying_start(machine: str, scheme: str, arithmetic: str = "f32", *, omega: float) -> Scenario:
    """The shaft coasts at `omega`, demagnetised; speed reference `omega` from power-up on.

    From `FLYING_LOAD_AT` on half of rated load proves that the motor is under control.
    """
    speed = motor_of(machine).base["omega_m"] * omega
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"flying start at ω = {omega:g}",
        omega=omega,
        load=ramp(FLYING_LOAD_AT, FLYING_LOAD_AT + 0.5, math.copysign(0.5, omega)),
        changes=[(0.005, {"speed": None})],
        plant={"speed": speed},
        record_every=5,
        signals=(*SIGNALS, "i_s"),
        duration=FLYING_LOAD_AT + 3.0,
    )


# 7. What one run learned serves the next.

LEARNED = 16.0


def memory(machine: str, scheme: str, arithmetic: str = "f32") -> tuple[Scenario, Scenario]:
    """A run that turns and is loaded, then a start into rated load at rest: the second takes the memory.

    The offset of the sensors is not read at rest, the real machine is warm (r_s + 20 %) and the real
    thresholds are half as large again as the drive was told: all of it has to be learned.
    """

    def made(name: str, omega: Profile, load: Profile, duration: float) -> Scenario:
        built = drive(
            machine, scheme, arithmetic, name=name, omega=omega, load=load, duration=duration
        ).with_settings(calibrate_offset=False)
        return built.replace(
            plant_motor=built.motor.replace(R_s=1.2 * built.motor.R_s),
            plant_inverter=built.inverter.replace(u_th=1.5 * built.inverter.u_th),
        )

    load = [(0.0, 0.0), (4.0, 0.0), (5.0, 0.8), (9.0, 0.8), (11.0, -0.8), (LEARNED, -0.8)]
    return (
        made("run that learns", ramp(START, AT_SPEED, 0.03), load, LEARNED),
        made("second start", 0.0, ramp(START, START + 0.5, 1.0), START + 5.5),
    )
