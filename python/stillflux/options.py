"""Keywords of `Drive`, `FluxEstimator` and `Plant`: names, types, units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias, TypedDict

__all__ = ["Arithmetic", "DriveSettings", "PlantOptions", "Scheme"]

Arithmetic: TypeAlias = Literal["f32", "f64", "q"]
"""Arithmetic of a drive: single or double precision, or fixed point."""
Scheme: TypeAlias = Literal["enhanced", "paper"]
"""Control scheme: one filter for all that is estimated, or the published scheme."""


class DriveSettings(TypedDict, total=False):
    """Settings of a drive; what is not given follows from motor and inverter."""

    psi_ref: float
    """Flux reference, per unit of rated flux."""
    i_max: float
    """Largest current reference, A peak."""
    torque_max: float
    """Largest torque reference, N·m."""
    omega_max: float
    """Largest speed reference, mechanical rad/s."""
    i_trip: float
    """Over-current trip level, A peak of the space vector."""
    i_range: float
    """Full scale of the current sensors, A: a reading at or beyond it is a fault."""
    u_dc_min: float
    """Smallest dc-link voltage, V; below 1/32 of the base voltage it is that."""
    u_dc_max: float
    """Largest dc-link voltage, V."""
    current_bandwidth: float
    """Bandwidth of current control, Hz."""
    flux_bandwidth: float
    """Bandwidth of flux control, Hz: 5, less where a long rotor time constant and a large leakage ask for
    it."""
    speed_bandwidth: float
    """Bandwidth of speed control, Hz: 9, less where the inertia is large."""
    set_point_weight: float
    """Part of a change of the speed reference that speed control answers at once, 0 to 1; the rest follows
    with the time constant of its integral part. 0.3: a step does not overshoot. 1: for a reference that is
    itself a controller's output."""
    pll_bandwidth: float
    """Natural frequency of the speed estimator's phase-locked loop, Hz: 25, more where the shaft is light."""
    inverter_model: bool
    """Compensation of threshold and dead time."""
    calibrate_offset: bool
    """Read the current offsets before each start, and R_s while magnetising."""
    offset_time: float
    """Duration of the reading of the offsets, s."""
    current_sensors: int
    """3, or 2 in phases a and b: the current of phase c is -(i_a + i_b) then, and its channel is not read.
    The enhanced scheme finds the difference of their gains in the magnetisation at standstill instead of
    while running; the monitor of the sum of the currents is off. 1: a single shunt in the dc link, whose
    three readings take the place of the currents (`Drive.pulses`); the plant needs the option `shunt`."""
    shunt_window: float
    """Time for which a state of the bridge lasts that a single shunt is sampled in, s: dead time, settling of
    the amplifier, sampling of the converter; from the dead time to 15 % of the carrier period. 0: pulses are
    not shifted, and at low voltage nothing is seen."""
    shunt_settling: float
    """Time constant of the amplifier of a single shunt, s: the reading is behind by it. 0: none."""
    magnetise_time: float
    """Duration of the magnetisation with the comparison of the legs before it, s; for the flux at least three
    rotor time constants are left."""
    low_confidence: Literal["keep", "limit", "fault"]
    """What to do while the confidence in the field angle is below 0.5: nothing, limit the torque in
    proportion, or stop with a fault."""
    fresh_time: float
    """Time after a stop within which a start takes over offsets and what was identified, and is as short as
    the current allows, s, 0 to 3600; 0: never."""
    supervision: bool
    """Monitors of phases, current channels, stall and lost field; off for tests of a bridge without a
    machine only."""
    stall_time: float
    """Time for which the torque may be at its limit at low speed without the speed approaching its
    reference, s, 0.1 to 60; 0: any."""

    realignment: bool
    """The flux is taken to lie along the current where the torque is at its limit and the field stands still,
    also at half of the torque: the way out of a false equilibrium. In the enhanced scheme it is tried on the
    other side of the current as well, where the field stands at light load and its angle is not known. On by
    default."""
    reduce_gain: bool
    """Reduce the gains of the speed controller until the next start where the speed swings between the limits
    of the torque, as with a shaft that is far lighter than told. On by default."""
    discontinuous_above: float | None
    """Discontinuous modulation (60° clamp) from this voltage on, in parts of u_dc/√3, 0.3 to 1; None:
    continuous at every voltage."""
    field_weakening: bool
    """Lower the flux where the voltage is used up; without it the speed ends there."""
    overmodulation: bool
    """Use the voltage between the circle within the hexagon and the hexagon: 5.2 % more for flux and torque,
    and a current with the 5th and 7th harmonic while all of it is used. Needs 45 control periods in one turn
    of the field at `omega_max`. Off by default."""
    acceleration: float | None
    """Largest acceleration of the speed reference, mechanical rad/s²; None: it is followed as it is."""
    jerk: float | None
    """Largest jerk of the speed reference, mechanical rad/s³, with an acceleration; None: no limit."""
    torque_limits: tuple[float, float] | None
    """Negative and positive limit of the torque, N·m, within `torque_max`; None: ±`torque_max`."""
    speed_limits: tuple[float, float] | None
    """Negative and positive limit of the speed reference, mechanical rad/s, within `omega_max`; None:
    ±`omega_max`."""
    machine_overload: tuple[float, float] | None
    """Continuous current of the machine in A rms and time constant of its heat in s: the current is derated
    before the heat exceeds that of the continuous current; None: no derating. Heat is counted while the drive
    runs, not while it magnetises."""
    bridge_overload: tuple[float, float] | None
    """The same of the bridge."""
    u_dc_brake: float | None
    """dc-link voltage at which no braking torque is left, V; None: no limit."""
    u_dc_buffer: float | None
    """dc-link voltage below which the machine feeds the link from its inertia, V; None: it does not."""
    u_dc_chopper: tuple[float, float] | None
    """dc-link voltages from which on the brake chopper takes current and at which its duty is 1, V; None: no
    chopper."""

    encoder_lines: int
    """Lines of an incremental encoder on the shaft, a quarter of the steps a turn of a resolver: from 16 a
    pole pair to 65,536; 0 (default): none. Its speed is compared with the estimate; the drive gets its
    position by `Drive.step(encoder=…)`, in a scenario from the plant's option of the same name."""
    encoder_states: int
    """States of the counter of the encoder, 65,536 of one of 16 bits."""
    encoder_mode: Literal["compare", "control"]
    """"compare" (default): nothing depends on the encoder; "control": the speed control follows its speed as
    long as it agrees with the estimate, and the estimate otherwise."""
    encoder_deviation: float
    """Difference from which on measured and estimated speed do not agree, mechanical rad/s, 0.005 to 10 pu:
    three quarters of the rated slip and 0.01 pu."""
    encoder_fault: bool
    """Stop with a fault when the encoder does not agree, or is not read; otherwise the drive is sensorless
    until it agrees again. Off by default."""

    # Of the scheme "paper" alone; an error in the other one.
    offset_estimator: bool
    """Offset voltage estimator of Fig. 4."""
    offset_gain: float
    """Part of the measured offset voltage taken over per fundamental period, 0.01 to 1."""
    noise_compensator: bool
    """Noise compensator of Section III-D."""
    noise_gain: tuple[float, float]
    """Smallest and largest gain of the noise compensator, per unit."""
    noise_regeneration: float
    """Its least gain while regenerating, where it falls with the slip, per unit, up to 4."""
    resistance_adaptation: bool
    """Stator resistance adaptation of Fig. 12."""
    resistance_gain: float
    """Its gain: change of R_s per unit, per second and unit of ε of (15), 0 to 5."""
    resistance_at_rest: bool
    """Adapt also at rest without load, by the radius of the flux (Fig. 13a); False."""
    resistance_at_light_load: bool
    """Adapt also at light load away from rest, by the method of [9] of the paper; False."""
    resistance_quotient: bool
    """Weight ε by the quotient ω_s/i_q (Fig. 12) instead of its sign; False."""
    initial_flux: tuple[float, float] | None
    """Flux estimate (α, β) that a start begins with, per unit of rated flux, each within ±2, while the
    machine is not magnetised yet (Fig. 9); None: the estimate begins after the magnetisation."""
    low_pass: float
    """Corner frequency of a low-pass filter in place of Fig. 7, 0 to 10 Hz; 0: none."""
    limiter: bool
    """An integrator with limited components in place of Fig. 7; not together with `low_pass`."""

    # Of the scheme "enhanced" alone; an error in the other one.
    identify_offset: bool
    """Estimate the offset of the current sensors."""
    identify_resistance: bool
    """Estimate stator resistance and inverter error. Off, for comparisons: what either is off by stays, and a
    few percent of R_s lose the field under load at low speed."""
    identify_legs: bool
    """Measure at each start at standstill how the legs of the bridge differ, in the first 0.2 s of its
    magnetisation (0.74 s at 160 kW)."""
    find_slow_rotation: bool
    """Look at each start for a shaft that something else turns slowly, and in a machine that turns without
    flux for the circle of the flux that builds up; without it a slow shaft is taken to stand still, the
    field is off by arctan ω τ_r, and large machines may be lost that turn without flux."""
    hold_inductances: bool
    """Correct leakage and magnetising inductance while the load changes alone, since a steady load does not
    tell them from the resistance; otherwise always, by which minutes of steady load carry them away."""
    apply_innovation: bool
    """Correct the states by the filter's innovation; without it the flux is a pure integral."""
    omega_s_min: float
    """Stator frequency that is kept under load, electrical rad/s: where it would be smaller the flux is
    lowered, by at most 30 %. 0: the flux stays. By default 0.4 of the rated slip frequency, and 0.006 of
    rated frequency at least; 0.001 to 0.05 of rated frequency are admissible."""
    dither: float
    """Amplitude of an oscillation of the torque with 40 Hz, in parts of rated torque, 0 to 0.3; by default
    0.05. It rises within a second below 0.012 of rated frequency, and fades towards there and towards 0.4 of
    rated torque. By it the field does not stay at the zeros of the phase currents, where the bridge is known
    least: of light loads that come at rest far fewer are lost (page Limits). 0: none."""
    prior_R_s: float
    """Relative standard deviation with which the filter begins, 0.002 to 0.5: of the stator resistance, with
    its temperature. What is known well moves little: `Commissioned.settings`."""
    prior_loss: float
    """Of threshold and dead time, 0.002 to 1."""
    prior_c_out: float
    """Of the capacitance of the legs of the inverter, 0.002 to 1."""
    prior_L_sigma: float
    """Of the leakage inductance, 0.002 to 1."""
    prior_R_R: float
    """Of the rotor resistance with its temperature, 0.002 to 0.5. A start at standstill estimates it; at a
    small value it keeps that of the motor, and takes its error for one of the others."""
    prior_L_M: float
    """Of the magnetising inductance, 0.002 to 0.5."""
    winding_temperature: float | None
    """Temperature of winding and rotor at which the motor's R_s and R_R hold, -40 to 120 °C: the drive
    follows R_R by the temperature that R_s shows. None: R_R is the parameter. The next three with it only."""
    cage_constant: float
    """Constant of the cage's material, 200 to 260 K: 225 for aluminium (default), 235 for copper."""
    rotor_rise: float
    """Rise of the rotor's temperature over that of the winding's, 0.3 to 2; 1."""
    winding_heat: tuple[float, float] | None
    """Rise of the winding's temperature at rated current in K, 5 to 200, and its time constant in s, 1 to
    7200: R_s is predicted where it cannot be measured. None: it is held there."""


class PlantOptions(TypedDict, total=False):
    """Options of a plant."""

    mode: Literal["switching", "averaged"]
    """"switching": every edge, dead time and diode event; "averaged": mean leg voltages."""
    seed: int
    """Seed of the measurement noise."""
    saturation: bool
    """Use the motor's saturation curve, if it has one."""
    J_load: float
    """Inertia added to the motor's, kg·m²."""
    coupling: tuple[float, float, float] | None
    """Elastic coupling between motor and J_load: stiffness in N·m/rad, damping in N·m·s/rad and backlash in
    rad; the load torque acts on J_load then, friction on the motor. None: it is rigid."""
    viscous: float
    """Viscous friction, N·m·s."""
    coulomb: float
    """Coulomb friction, N·m."""
    stribeck: float
    """Breakaway torque in excess of the Coulomb friction, N·m."""
    stribeck_speed: float
    """Speed at which that excess has fallen to 1/e, mechanical rad/s."""
    speed: float | None
    """Imposed shaft speed, mechanical rad/s; None: the shaft is free."""
    turn_on_delay: Sequence[tuple[float, float]]
    """Time that each switch takes to turn on after its command, s: (upper, lower) for each leg."""
    turn_off_delay: Sequence[tuple[float, float]]
    """The same for turning off, at most the dead time and the turn-on delay of the leg's other switch."""
    adc_bits: int
    """Resolution of the current channels, bit; 0: no quantisation."""
    adc_range: float | None
    """Full scale of the current channels, ±A; None: 2.5 √2 I_N of the real motor. One that is given is at
    least `i_trip` of the drive in a scenario: a channel that ends below hides an over-current."""
    adc_noise: float
    """White noise of the current channels, A rms."""
    current_offset: complex | Sequence[float]
    """Offset of the current channels, A: a space vector, which is one complex number and in plain data (TOML,
    JSON) the pair [re, im], or three values, those of the phases. A pair in Python is refused: it could be
    either."""
    current_offset_drift: complex | Sequence[float]
    """Its drift, A/s."""
    current_gain: Sequence[float]
    """Gain of each current channel, ideally 1."""
    adc_skew: Sequence[float]
    """Time before the carrier peak at which each current channel is sampled, s, at most half a period."""
    encoder_lines: int | None
    """Lines of an incremental encoder on the shaft, None: there is none."""
    shunt: float | None
    """A single shunt in the dc link in place of the current channels, with the time constant of its amplifier
    in s; offset and gain are those of the first channel. None: three channels."""
    iron_loss: tuple[float, float] | None
    """Eddy currents: resistance parallel to the magnetising branch of the Γ circuit in Ω, and time constant
    of the field in the sheets in s, at least 20 µs."""
    deep_bar: tuple[float, float] | None
    """Second branch of the rotor: its share of the cage's conductance at small slip and its share of the
    inverse leakage inductance at high frequency, each from 0.01 to 0.9."""
    leakage_saturation: tuple[float, float] | None
    """Share of the leakage inductance, up to 0.6, that is lost at a peak rotor current in A."""
    slot_ripple: tuple[int, float, float] | None
    """Number of rotor slots, relative ripple of the air gap's permeance as they pass (up to 0.2) and of the
    inverse leakage inductance (up to 0.3)."""
    missed_calls: float
    """Probability that the control is not called in a period: duties stay. Only in a scenario,
    refused by `Plant`."""
    doubled_calls: float
    """Probability that the control is called twice with the same sample. Only in a scenario,
    refused by `Plant`."""
    dc_link: tuple[float, float, float | None] | None
    """Capacitance in F, resistance of the supply in Ω, resistor of the brake chopper in Ω or None: the link
    is fed by a diode rectifier of ideal mean voltage `u_dc`. None: the link has the voltage that is set."""
    grid: tuple[float, float] | None
    """Frequency in Hz and inductance of a phase in H of the grid that feeds the rectifier of `dc_link`, whose
    resistance of the supply is then that of two phases: the link ripples with six times the frequency and
    rises to `π/3 u_dc` without load. None: the rectified voltage is smooth."""
    thermal: tuple[float, float, float] | tuple[float, float, float, float] | None
    """Winding: time constant in s, rise at rated copper loss in K, temperature coefficient in 1/K; and that
    of the rotor's resistance per K of the winding, 0 if it is not given."""
