"""The paper's experiments as scenarios: copy one, change it, `simulate` it.

Every function takes the name of a machine and of an arithmetic. Speeds in per unit of rated frequency: 1 pu
is `2π f_N/n_p` mechanical rad/s. Torques in units of rated torque. `stillflux.claims` says what each run must
show, `stillflux.experiments` brings both together.

Nothing is tuned to a figure: the drive's settings are its defaults, but for what the paper itself changes
(the offset estimator off in Fig. 10, say) and `calibrate_offset`, which is off throughout: the paper's drive
did not read its offsets at rest.
"""

from __future__ import annotations

from typing import Any

from stillflux.openloop import VoltageFed
from stillflux.parameters import Inverter, Motor
from stillflux.scenario import Profile, Scenario

__all__ = [
    "ALL_MACHINES",
    "MACHINES",
    "fig2",
    "fig5",
    "fig6",
    "fig8",
    "fig9",
    "fig10",
    "fig11",
    "fig13a",
    "fig13b",
    "fig14",
    "fig15",
    "fig16",
    "fig17",
    "fig18",
    "fig19",
    "fig20",
    "fig20_band",
    "headline",
    "inverter_of",
    "motor_of",
    "paper_drive",
]

MACHINES = ("2.2kW", "11kW")
"""The machines of the presets; the paper's figures are run on these."""
LEAKY = "11kW-leaky"
"""The 11-kW machine with the leakage inductance σl_s = 0.15; l_s, r_s and τ_r stay."""
ALL_MACHINES = (*MACHINES, LEAKY)

OFFSET_25_MV = 0.00625
"""25 mV at ±10 V = 2.5 I_N, per unit of rated peak current; added to i_α and i_β (Fig. 9)."""
OFFSET_250_MV = 10 * OFFSET_25_MV
"""The offset of Figs. 10 and 15 in the paper, whose scale it does not give; ten times that of Fig. 9."""

ADC_NOISE = 0.004
"""Noise of the 12-bit current sensors, rms per unit of rated rms current."""

RUN = 1.5
"""Offset reading and magnetisation: the drive runs after this time, s."""
IDENTIFIED = RUN + 12.0
"""Until then at 1 Hz, where the offset voltage shows, s."""
HOLD = IDENTIFIED + 1.0
"""From then at the speed of the experiment, s."""


def motor_of(machine: str) -> Motor:
    """Motor of one of `ALL_MACHINES`."""
    if machine != LEAKY:
        return Motor.preset(machine)
    motor = Motor.preset("11kW")
    L_sigma = 0.15 * motor.base["l"]
    L_M = motor.L_s - L_sigma
    return motor.replace(L_sigma=L_sigma, L_M=L_M, R_R=L_M / motor.tau_r)


def inverter_of(machine: str) -> Inverter:
    """Inverter of one of `ALL_MACHINES`."""
    return Inverter.preset("11kW" if machine == LEAKY else machine)


def paper_drive(
    machine: str,
    arithmetic: str = "f32",
    *,
    name: str,
    duration: float,
    omega: Profile = 0.0,
    load: Profile = 0.0,
    offset: complex = OFFSET_25_MV * (1 + 1j),
    **fields: Any,
) -> Scenario:
    """The drive of the paper on a switching-level plant with current offset, 12 bit and noise.

    `omega` in per unit, `load` in units of rated torque, `offset` of the current space vector in per unit.
    """
    motor = motor_of(machine)
    return Scenario(
        name=f"{name}, {machine}, {arithmetic}",
        motor=motor,
        inverter=inverter_of(machine),
        arithmetic=arithmetic,
        scheme="paper",
        settings={"calibrate_offset": False},
        plant={"current_offset": offset * motor.base["i"], "adc_noise": ADC_NOISE * motor.I_N},
        omega_ref=scaled(omega, motor.base["omega_m"]),
        load_torque=scaled(load, motor.T_N),
        duration=duration,
        **fields,
    )


def scaled(profile: Profile, base: float) -> Profile:
    """A profile times `base`."""
    if isinstance(profile, int | float):
        return profile * base
    return [(t, value * base) for t, value in profile]


def step(t: float, after: float) -> list[tuple[float, float]]:
    """Zero, from `t` on `after`."""
    return [(0.0, 0.0), (t, 0.0), (t, after)]


def identify_then(omega: float) -> list[tuple[float, float]]:
    """Speed reference: long enough at 1 Hz to find the offset, then within a second to `omega`."""
    return [(0.0, 0.02), (IDENTIFIED, 0.02), (HOLD, omega)]


# Fig. 2: threshold voltages of the bridge, nothing compensated, u* on a circle, shaft driven or braked.


def fig2(machine: str, arithmetic: str = "f32") -> tuple[VoltageFed, ...]:
    """Motoring at ω_s = 0.017 and 0.01; driven at 0.017; driven at 0.15, where power does flow back."""
    del arithmetic  # No drive takes part.
    bare = Inverter.preset(machine).replace(dead_time=0.0)
    points = [(0.017, 0.02), (0.01, 0.02), (0.017, -0.02), (0.15, -0.02)]
    return tuple(
        VoltageFed(motor=Motor.preset(machine), inverter=bare, omega_s=omega_s, omega_r=omega_r)
        for omega_s, omega_r in points
    )


# Fig. 5: the trajectory of ψ̂_1 while a large offset is all but uncompensated.


def fig5(machine: str, arithmetic: str = "f32") -> Scenario:
    """Offset of the signs of the paper's example at ω = 0.1; the estimator all but ignores what it sees."""
    offset = OFFSET_250_MV * (1 - 1j)
    scenario = paper_drive(machine, arithmetic, name="Fig. 5", omega=0.1, offset=offset, duration=6.0)
    return scenario.with_settings(offset_gain=0.01)


# Fig. 6: phase currents at their zero crossings, dead time uncompensated.


def fig6(machine: str, arithmetic: str = "f32") -> tuple[VoltageFed, ...]:
    """Motoring at ω_s = 0.1 on a circle of u*, with dead time and hence zero-current clamping."""
    del arithmetic
    inverter = Inverter.preset(machine)
    return (VoltageFed(motor=Motor.preset(machine), inverter=inverter, omega_s=0.1, omega_r=0.02, periods=3),)


# Fig. 8: what the noise compensator has to do in a drive without deliberate offset.

FIG8_STEADY = 8.0


def fig8(machine: str, arithmetic: str = "f32") -> Scenario:
    """Rated load at ω = 0.1, every period recorded."""
    return paper_drive(
        machine,
        arithmetic,
        name="Fig. 8",
        omega=0.1,
        load=step(4.0, 1.0),
        offset=0.0,
        duration=10.0,
        record_every=1,
    )


# Fig. 9: six periods of 2 s after the start, then two to measure the true offset by.

FIG9_SETTLED = RUN + 0.5 + 6 * 2.0


def fig9(machine: str, arithmetic: str = "f32") -> Scenario:
    """De-energised start with offset to ω = 0.01."""
    return paper_drive(machine, arithmetic, name="Fig. 9", omega=0.01, duration=FIG9_SETTLED + 4.5)


# Figs. 15 and 10: one operating point with and without the offset estimator.

_FROM_5_HZ = [(0.0, 0.1), (RUN + 8.0, 0.1), (RUN + 10.0, 0.023)]
"""Approached from 5 Hz: started at 0.023 with the large offset, the first estimate comes too late."""
FIG15_SETTLED = RUN + 20.0


def fig15(machine: str, arithmetic: str = "f32", offset: float = OFFSET_25_MV) -> Scenario:
    """Steady state at ω = 0.023 with offset."""
    return paper_drive(
        machine,
        arithmetic,
        name="Fig. 15",
        omega=_FROM_5_HZ,
        offset=offset * (1 + 1j),
        duration=FIG15_SETTLED + 5.0,
    )


def fig10(machine: str, arithmetic: str = "f32", offset: float = OFFSET_25_MV) -> Scenario:
    """`fig15` with the offset estimator off."""
    scenario = fig15(machine, arithmetic, offset).with_settings(offset_estimator=False)
    return scenario.replace(name=scenario.name.replace("Fig. 15", "Fig. 10"))


# Fig. 11: the steady state under a wrong r̂_s, loaded in steps, adaptation off, no saturation.

FIG11_RATIOS = (0.5, 0.75, 1.0, 1.25, 1.5)
FIG11_LOADS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
FIG11_BEGIN, FIG11_STAY = 8.0, 2.0


def fig11(machine: str, arithmetic: str = "f32", omega: float = 0.5) -> tuple[Scenario, ...]:
    """One run for each r̂_s/r_s: the real resistance changes at 5 s, the drive does not follow."""
    load = [(0.0, 0.0)]
    for k, torque in enumerate(FIG11_LOADS):
        begin = FIG11_BEGIN + k * FIG11_STAY
        load += [(begin, torque), (begin + FIG11_STAY, torque)]
    runs = []
    for ratio in FIG11_RATIOS:
        motor, inverter = Motor.preset(machine), Inverter.preset(machine)
        real = (motor.R_s + inverter.r_d) / ratio - inverter.r_d
        run = paper_drive(
            machine,
            arithmetic,
            name=f"Fig. 11, r̂_s/r_s = {ratio:g}",
            omega=omega,
            load=load,
            offset=0.0,
            duration=load[-1][0],
            changes=[(5.0, {"R_s": real})],
        ).with_settings(resistance_adaptation=False)
        runs.append(run.replace(plant={**run.plant, "saturation": False}))
    return tuple(runs)


# Fig. 13: the stator resistance rises to 125 % in a step.

FIG13A_CHANGE, FIG13A_LOAD = HOLD + 2.0, HOLD + 6.0
FIG13B_CHANGE = HOLD + 8.0


def fig13a(machine: str, arithmetic: str = "f32") -> Scenario:
    """No load, zero stator frequency; rated torque step 4 s after the change."""
    return paper_drive(
        machine,
        arithmetic,
        name="Fig. 13a",
        omega=identify_then(0.0),
        load=step(FIG13A_LOAD, 1.0),
        duration=FIG13A_LOAD + 6.0,
        changes=[(FIG13A_CHANGE, {"R_s": 1.25 * Motor.preset(machine).R_s})],
    )


def fig13b(machine: str, arithmetic: str = "f32") -> Scenario:
    """ω = 0.01 at 30 % load."""
    return paper_drive(
        machine,
        arithmetic,
        name="Fig. 13b",
        omega=identify_then(0.01),
        load=step(HOLD, 0.3),
        duration=FIG13B_CHANGE + 6.0,
        changes=[(FIG13B_CHANGE, {"R_s": 1.25 * Motor.preset(machine).R_s})],
    )


# Fig. 14: the winding heats up at high speed, where its resistance cannot be seen.

FIG14_UP, FIG14_TOP, FIG14_DOWN, FIG14_BACK = 9.0, 10.5, 18.0, 20.0


def fig14(machine: str, arithmetic: str = "f32") -> Scenario:
    """Half load; cold at ω = 0.02, up to 0.5, there 25 % warmer within 6 s, down again within 2 s."""
    R_s = Motor.preset(machine).R_s
    warming = [(11.0 + 0.1 * k, {"R_s": R_s * (1.0 + 0.25 * k / 60)}) for k in range(61)]
    return paper_drive(
        machine,
        arithmetic,
        name="Fig. 14",
        omega=[(0.0, 0.02), (FIG14_UP, 0.02), (FIG14_TOP, 0.5), (FIG14_DOWN, 0.5), (FIG14_BACK, 0.02)],
        load=step(7.0, 0.5),
        duration=FIG14_BACK + 4.0,
        changes=warming,
    )


# Fig. 16: start at a quarter hertz with the offset voltage that an earlier run has stored.


def fig16(machine: str, arithmetic: str = "f32") -> tuple[Scenario, ...]:
    """The earlier run at 1 Hz, then the start to ω = 0.005; the second takes over the first one's memory."""
    earlier = paper_drive(machine, arithmetic, name="before Fig. 16", omega=0.02, duration=RUN + 12.0)
    return earlier, paper_drive(machine, arithmetic, name="Fig. 16", omega=0.005, duration=RUN + 16.0)


# Fig. 17: zero speed under a load that falls in steps.

FIG17_BEGIN, FIG17_STAY = HOLD + 2.0, 4.0
FIG17_STEPS = (1.0, 0.75, 0.5, 0.25, 0.0)


def fig17(machine: str, arithmetic: str = "f32", load: float = 1.3) -> Scenario:
    """`load` times rated torque at zero speed, taken away in four steps."""
    profile = [(0.0, 0.0), (FIG17_BEGIN, 0.0)]
    for k, part in enumerate(FIG17_STEPS):
        begin = FIG17_BEGIN + k * FIG17_STAY
        profile += [(begin, load * part), (begin + FIG17_STAY, load * part)]
    return paper_drive(
        machine,
        arithmetic,
        name=f"Fig. 17, {100 * load:.0f} %",
        omega=identify_then(0.0),
        load=profile,
        duration=profile[-1][0] + 4.0,
    )


# Fig. 18, and the headline: the same, then the load is removed.

FIG18_LOAD = HOLD + 61.5
FIG18_END = FIG18_LOAD + 6.0


def fig18(machine: str, arithmetic: str = "f32") -> Scenario:
    """Start, offset found at 1 Hz, a minute at zero stator frequency, then a rated torque step."""
    return paper_drive(
        machine,
        arithmetic,
        name="Fig. 18",
        omega=identify_then(0.0),
        load=step(FIG18_LOAD, 1.0),
        duration=FIG18_END,
    )


def headline(machine: str, arithmetic: str = "f32") -> Scenario:
    """`fig18`, then the load is removed."""
    scenario = fig18(machine, arithmetic)
    load = [*step(FIG18_LOAD, 1.0), (FIG18_END, 1.0), (FIG18_END, 0.0)]
    return scenario.replace(
        name=scenario.name.replace("Fig. 18", "zero stator frequency"),
        load_torque=scaled(load, scenario.motor.T_N),
        duration=FIG18_END + 4.0,
    )


# Figs. 19 and 20: load steps at and next to zero speed.

LOAD_STEP = HOLD + 3.0


def fig19(machine: str, arithmetic: str = "f32") -> Scenario:
    """120 % torque step at zero speed."""
    return paper_drive(
        machine,
        arithmetic,
        name="Fig. 19",
        omega=identify_then(0.0),
        load=step(LOAD_STEP, 1.2),
        duration=LOAD_STEP + 4.0,
    )


def fig20(machine: str, arithmetic: str = "f32", omega: float = 0.003) -> Scenario:
    """Negative rated torque step at ω = 0.003, regeneration."""
    return paper_drive(
        machine,
        arithmetic,
        name="Fig. 20",
        omega=identify_then(omega),
        load=step(LOAD_STEP, -1.0),
        duration=LOAD_STEP + 12.0,
    )


def fig20_band(machine: str, arithmetic: str = "f32") -> Scenario:
    """`fig20` at ω = 0.04, inside the band 0 < ω_s < ω in which regeneration is unstable."""
    scenario = fig20(machine, arithmetic, omega=0.04)
    return scenario.replace(name=scenario.name.replace("Fig. 20", "Fig. 20, unstable band"))
