//! The settings themselves.

use super::enhanced::EnhancedParams;
use super::paper::PaperParams;
use super::scheme::Scheme;
use crate::words::Words;

/// What a drive does while its confidence in the field angle is below one half: an error of 15° and more must be
/// expected then, and the torque deviates from its reference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum LowConfidence {
    /// No reaction: the confidence is a signal only.
    #[default]
    Keep,
    /// Limits the torque in proportion to the confidence: to the whole at one half, to nothing at zero.
    LimitTorque,
    /// Stops with [`crate::drive::Fault::LowConfidence`] after 50 ms.
    Fault,
}

impl Words for LowConfidence {
    const BLANK: Self = Self::Keep;
    fn put(&self, out: &mut impl FnMut(u32)) {
        out(*self as u32);
    }
    fn fill(&mut self, from: &mut impl FnMut() -> u32) {
        *self = match from() {
            0 => Self::Keep,
            1 => Self::LimitTorque,
            _ => Self::Fault,
        };
    }
}

/// What a drive does with the speed of its encoder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum EncoderMode {
    /// It is compared with the estimated speed, and nothing depends on it.
    #[default]
    Compare,
    /// It is what the speed control follows, as long as the encoder is valid.
    Control,
}

/// Settings of a drive. [`DriveParams::new`] derives every value from machine and inverter; change single
/// fields from there.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct DriveParams {
    /// Which estimators to run.
    pub scheme: Scheme,
    /// Flux reference, per unit of rated flux `U_N √(2/3) / omega_sR`; 0.3 to 1.2.
    pub psi_ref: f64,
    /// Largest current reference, A peak.
    pub i_max: f64,
    /// Largest torque reference, N·m.
    pub torque_max: f64,
    /// Largest mechanical speed reference, rad/s; at most 3 pu, and 30 control periods in one turn of the field.
    pub omega_max: f64,
    /// Over-current trip level, A peak of the space vector.
    pub i_trip: f64,
    /// Full scale of the current sensors, A: a reading at or beyond it is a fault.
    pub i_range: f64,
    /// Smallest dc-link voltage, V; below 1/32 of the base voltage it is that.
    pub u_dc_min: f64,
    /// Largest dc-link voltage, V.
    pub u_dc_max: f64,
    /// Bandwidth of current control, Hz: 0.03 `f_s`, at most 0.04 of the control's frequency. Up to 0.06 of it is
    /// admissible.
    pub current_bandwidth: f64,
    /// Bandwidth of flux control, Hz: 5, less where a long rotor time constant and a large leakage ask for it
    /// (docs/gains.md); at most 30, and little more than the default there.
    pub flux_bandwidth: f64,
    /// Bandwidth of speed control, Hz: 9, less where the inertia is large (docs/gains.md).
    pub speed_bandwidth: f64,
    /// Part of a change of the speed reference that the proportional part of speed control sees at once, from 0 to 1;
    /// the rest follows with the time constant of its integral part ([`crate::control::speed`]). 0.3: a step does not
    /// overshoot. 1: for a reference that is itself a controller's output.
    pub set_point_weight: f64,
    /// Natural frequency of the speed estimator's phase-locked loop, Hz: 25, more where the shaft is light (docs/gains.md).
    pub pll_bandwidth: f64,
    /// Inverter model: compensation of threshold and dead time.
    pub inverter_model: bool,
    /// Read the current offsets with gates off before each start, and `r̂_s` while magnetising.
    pub calibrate_offset: bool,
    /// Duration of the reading of the offsets, s.
    pub offset_time: f64,
    /// Current sensors: 3, or 2 in phases a and b. With two the current of phase c is `-(i_a + i_b)` and its channel is
    /// not read. The difference of the gains of the two is found in the magnetisation at standstill then, by the
    /// enhanced scheme, instead of while running, and the monitor of the sum is off. This and `discontinuous_above`
    /// need the feature `modes`.
    ///
    /// 1: a single shunt in the dc link, feature `shunt`. [`crate::drive::Measurement::i_abc`] holds its three readings
    /// then, at the instants of [`crate::drive::Drive::pulses`] and at the end of the period
    /// ([`crate::control::shunt`]).
    pub current_sensors: u32,
    /// Time for which a state of the bridge lasts that a single shunt is sampled in, s: dead time, settling of the
    /// amplifier, sampling of the converter; from the dead time to 15 % of the carrier period. 0: pulses are not
    /// shifted, and at low voltage nothing is seen. Without effect with more sensors.
    pub shunt_window: f64,
    /// Time constant of the amplifier of a single shunt, s, at most a quarter of the longest window: the current rises
    /// while it is sampled, and the reading is behind it. 0: none. Without effect with more sensors.
    pub shunt_settling: f64,
    /// Duration of the magnetisation, s, at least three rotor time constants. The comparison of the legs
    /// ([`EnhancedParams::identify_legs`]) is its first part; three rotor time constants are left for the flux in any
    /// case.
    pub magnetise_time: f64,
    /// What to do while the confidence is low.
    pub low_confidence: LowConfidence,
    /// Time after a stop within which a start takes over the offsets of the current sensors and what was identified,
    /// and is as short as the current allows, s, 0 to 3600; 0: never.
    pub fresh_time: f64,
    /// Monitors of phases, current channels, stall and lost field. Off, a drive checks its measurements, the
    /// plausibility of its estimate and the stamps of [`Drive::step_at`](crate::drive::Drive::step_at) alone: for tests
    /// of the bridge without a machine, not for a load.
    pub supervision: bool,
    /// Time for which the torque may be at its limit at low speed without the speed approaching its reference, s, 0.1
    /// to 60; 0: any ([`crate::supervision::stall`]).
    pub stall_time: f64,
    /// The flux is taken to lie along the current where the torque is at its limit and the field stands still, whatever
    /// the torque ([`crate::control::realign`]); in the enhanced scheme it is also tried on the other side of the
    /// current where the field stands without load and its angle is not known ([`crate::control::sides`]). Feature
    /// `supervision`.
    pub realignment: bool,
    /// Reduce the gains of the speed controller until the next start where the speed swings between the limits of the
    /// torque, as with a shaft that is far lighter than told ([`crate::control::swing`]). Feature `supervision`.
    pub reduce_gain: bool,
    /// Discontinuous modulation from this voltage on, in parts of the largest that continuous modulation makes,
    /// `u_dc/√3`; 0.3 to 1 ([`crate::control::modulator`]); `None`: continuous at every voltage.
    pub discontinuous_above: Option<f64>,
    /// Lower the flux where the voltage is used up ([`crate::control::weakening`]). Without it the speed ends there.
    /// Needs the feature `weakening`.
    pub field_weakening: bool,
    /// Use the voltage between the circle within the hexagon and the hexagon: 5.2 % more for flux and torque, and a
    /// current with the 5th and 7th harmonic while all of it is used. At least 45 control periods in one turn of the
    /// field at `omega_max`.
    pub overmodulation: bool,
    /// Largest acceleration of the speed reference, mechanical rad/s²; `None`: it is followed as it is. It and the jerk
    /// need the feature `ramp`.
    pub acceleration: Option<f64>,
    /// Largest jerk of the speed reference, mechanical rad/s³, together with an acceleration; `None`: no limit.
    pub jerk: Option<f64>,
    /// Negative and positive limit of the torque reference, N·m, within `torque_max`; `None`: ±`torque_max`.
    pub torque_limits: Option<(f64, f64)>,
    /// Negative and positive limit of the speed reference, mechanical rad/s, within `omega_max`; `None`: ±`omega_max`.
    pub speed_limits: Option<(f64, f64)>,
    /// Continuous current of the machine in A rms and the time constant of its heat in s: the current is derated before
    /// the heat exceeds that of the continuous current ([`crate::control::overload`]); `None`: no derating. Heat is
    /// counted while the drive runs, not while it magnetises. It and the bridge's need the feature `derating`.
    pub machine_overload: Option<(f64, f64)>,
    /// The same of the bridge.
    pub bridge_overload: Option<(f64, f64)>,
    /// dc-link voltage at which no braking torque is left, V ([`crate::control::dclink`]); `None`: no limit. This and
    /// the next two need the feature `dclink`.
    pub u_dc_brake: Option<f64>,
    /// dc-link voltage below which the machine feeds the link, V: kinetic buffering; `None`: none.
    pub u_dc_buffer: Option<f64>,
    /// dc-link voltages from which on the brake chopper takes current and at which it takes all, V; `None`: no chopper.
    pub u_dc_chopper: Option<(f64, f64)>,
    /// Lines of an incremental encoder on the shaft, a quarter of the steps a turn of a resolver; from 16 a pole pair
    /// to 65,536; 0: none. This and the next four are the feature `encoder` ([`crate::control::handover`]); the content
    /// of its counter is given by [`crate::drive::Drive::set_encoder`].
    pub encoder_lines: u32,
    /// States of the encoder's counter, 65,536 of one of 16 bits; of one that is reset at each turn four times the
    /// lines. At least 16 times the counts between two runs of the speed estimator at `omega_max`, at most 2^31.
    pub encoder_states: u32,
    /// What the measured speed is used for.
    pub encoder_mode: EncoderMode,
    /// Difference from which on measured and estimated speed do not agree, mechanical rad/s, 0.005 to 10 pu, beside the
    /// ripple of one count.
    pub encoder_deviation: f64,
    /// Whether an encoder that does not agree, or is silent, stops the drive
    /// ([`crate::drive::Fault::EncoderApart`]). Otherwise the drive is sensorless until it agrees again.
    pub encoder_fault: bool,
    /// Settings of the published scheme: the defaults, unless the drive runs it.
    pub paper: PaperParams,
    /// Settings of the enhanced scheme: the defaults, unless the drive runs it.
    pub enhanced: EnhancedParams,
}
