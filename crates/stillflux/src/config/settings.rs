//! Settings of a drive, SI unless marked per unit, with defaults derived from machine and inverter (docs/gains.md) and
//! the admissible range of each. A value outside it is an error that names field, value and range.

mod enhanced;
mod paper;

pub use self::enhanced::EnhancedParams;
pub use self::paper::PaperParams;

use crate::base::Base;
use crate::error::refuse;
#[cfg(all(feature = "enhanced", feature = "legs"))]
use crate::estimate::legs::legs_time;
use crate::params::{Inverter, Machine, ParamError, check};
use crate::words::Words;

/// Magnetising current during the build-up of the flux, as multiple of its final value.
pub(crate) const BOOST: f64 = 1.5;

/// The largest current of a start, as part of the largest current.
pub(crate) const QUICK: f64 = 0.9;
/// Least boost by which the duration of the build-up is computed: three rotor time constants.
const LEAST_BOOST: f64 = 1.05;

/// Least duration of the magnetisation, in rotor time constants.
const LEAST_BUILD_UP: f64 = 3.0;

/// Whether the monitors of the supervision are built.
const SUPERVISED: bool = cfg!(feature = "supervision");
/// Least trip level in units of the largest current: at 11 kW a start to rated speed with all of it reaches 1.1 times.
const TRIP_LEAST: f64 = 1.15;
/// Least bandwidth of the speed estimator in units of that of speed control: with 1.5 times the speed swings by 0.002 pu at 5 Hz and
/// less at 9 Hz, with 1.1 times by 0.02, and with once at 5 Hz control is lost (2.2 and 11 kW).
const PLL_LEAST: f64 = 1.5;

/// Whether this build has field weakening, which is on by default.
const WEAKENED: bool = cfg!(feature = "weakening");
/// Control periods from one run to the next of the supervision.
pub(crate) const SUPERVISION_PERIODS: u32 = 4;
/// Control periods between two samples of the fit of the current sensors' gains, and between two curves of the inverter
/// model.
pub const BALANCE_PERIODS: u32 = 8;

/// Least rate, Hz, of speed and flux control where they run in every eighth period only: a hundred times the bandwidths of
/// the default settings (docs/gains.md), 5 to 9 Hz.
const SLOW_RATE: f64 = 1e3;

/// Control periods from one run of these to the next: eight, or four where the control is slow.
pub(crate) fn slow_periods(inverter: &Inverter) -> u32 {
    if inverter.f_c() >= 8.0 * SLOW_RATE { 8 } else { 4 }
}

/// Control periods from one run of the speed estimator to the next, given those of speed and flux control. In the enhanced
/// scheme at least 80 runs in the reciprocal of its bandwidth, 25 Hz; in the published one, where gain and clock of the flux
/// estimator follow it, every second: with every fourth it loses 4 of 40 reversals at 11 kW, and Fig. 16.
pub(crate) fn speed_periods(scheme: Scheme, slow_periods: u32) -> u32 {
    match scheme {
        Scheme::Paper => 2,
        Scheme::Enhanced => slow_periods / 2,
    }
}

/// Control periods from one run to the next of field weakening, resistance adaptation, confidence and flux shift: sixteen, 0.1
/// of the reciprocal of the fastest of their bandwidths, the 5 Hz of field weakening, or four where the control is slow.
pub(crate) fn adapt_periods(slow_periods: u32) -> u32 {
    if slow_periods == 8 { 16 } else { slow_periods }
}

/// Largest gain of flux control relative to that at which it oscillates, with the strongest low-pass filter: of the default, and of what
/// is admitted.
const FLUX_GAIN: (f64, f64) = (0.5, 0.8);

/// Low-pass filters of flux control, the weakest first: the part `m` of its last correction that it keeps, and the gain up to which it
/// serves, relative to the one at which flux control oscillates with it by [`DirectFlux`]. The integral part of current control, which is
/// not counted there, makes that 0.86 times as large, and twice the leakage of the parameters half of it (187 kW at 4 kHz).
const FLUX_MEMORY: [(f64, f64); 3] = [(0.0, 0.4), (0.5, 0.5), (0.8, 1.0)];

/// Control periods from the sample to the voltage that flux control has made of it, in the mean: one to the next current control, one and
/// a half to the middle of its pulses.
const FLUX_DELAY: f64 = 2.5;

/// How flux control acts on the stator flux through the leakage, at once.
///
/// `i_d` acts on the stator flux without delay, `ψ_s = σl_s i_d + ψ_R`. With the gain `k_p`, once in `T`, behind a low-pass filter that
/// keeps the part `m` of its last output, a delay `D` and current control, flux control is for this part
///
/// ```text
/// i_d⁺ = a i_d + b_0 y + b_1 y⁻,    y = m y⁻ - (1 - m) g i_d
/// a = e^{-ω_c T},    b_0 = 1 - e^{-ω_c (T - D)},    b_1 = 1 - a - b_0,    g = k_p σl_s = ω_ψ τ_r L_σ/L_s
/// (z - a)(z - m) + (1 - m) g (b_0 z + b_1) = 0,    |z| < 1:
///     (1 - m) g < (1 - a m)/b_1,    (1 - m) g (b_0 - b_1) < (1 + a)(1 + m)
/// ```
///
/// Large machines have long rotor time constants. With a call in every fourth period of 4 kHz the delay is more than half of `T`: a
/// two-pole motor of 187 kW (τ_r 2.4 s) whose leakage is a fifth larger than told oscillates with 235 Hz and `m` = 1/2, until the
/// current does not follow.
struct DirectFlux {
    a: f64,
    b: (f64, f64),
    /// Bandwidth of flux control over `g`, Hz.
    bandwidth: f64,
}

impl DirectFlux {
    fn new(machine: &Machine, inverter: &Inverter, current_bandwidth: f64) -> Self {
        let periods = f64::from(slow_periods(inverter));
        let left = |periods: f64| libm::exp(-core::f64::consts::TAU * current_bandwidth * periods / inverter.f_c());
        let (a, b_0) = (left(periods), 1.0 - left(periods - FLUX_DELAY));
        let rate = machine.L_s() * machine.R_R / (machine.L_sigma * machine.L_M);
        Self { a, b: (b_0, 1.0 - a - b_0), bandwidth: rate / core::f64::consts::TAU }
    }

    /// Bandwidth of flux control, Hz, at which it oscillates with a filter that keeps `memory`.
    fn fastest(&self, memory: f64) -> f64 {
        let Self { a, b: (b_0, b_1), bandwidth } = *self;
        let gain = (1.0 - a * memory) / b_1;
        let alternating = (1.0 + a) * (1.0 + memory) / (b_0 - b_1);
        let gain = if b_0 > b_1 { gain.min(alternating) } else { gain };
        gain / (1.0 - memory) * bandwidth
    }

    /// The same with the strongest filter.
    fn fastest_filtered(&self) -> f64 {
        self.fastest(FLUX_MEMORY[2].0)
    }

    /// `m` for a bandwidth of flux control, Hz.
    fn memory(&self, bandwidth: f64) -> f64 {
        let fits = |&(memory, part): &(f64, f64)| bandwidth <= part * self.fastest(memory);
        FLUX_MEMORY.into_iter().find(fits).unwrap_or(FLUX_MEMORY[2]).0
    }
}

/// Default bandwidth of current control relative to the carrier's frequency, not to that of the control: it is the bridge that
/// disturbs the current, with each of its edges, and where the current stays near zero for longer its error is not known.
/// With 0.03 of the control's frequency, control in every second carrier period of 10 kHz loses 16 of 128 draws of the 0.37- and
/// 0.75-kW drives, with that of the carrier none.
const CURRENT_BANDWIDTH: f64 = 0.03;

/// Largest default bandwidth of current control relative to the control's frequency. The overshoot of a reversal in field weakening,
/// from the largest current to the one of the other sign, passes the trip with 0.05 and 0.06 at 11 kW and 10 kHz, control in every
/// second carrier period, and stays below it with 0.04.
const FASTEST_DEFAULT_CURRENT: f64 = 0.04;

/// Largest bandwidth of current control relative to the control's frequency: 32° of phase by 1.5 periods of delay.
const FASTEST_CURRENT: f64 = 0.06;

/// Range of the bandwidth of speed control, Hz.
const SPEED_BANDWIDTH: (f64, f64) = (0.05, 20.0);

/// Control periods in one turn of the field that the loops need: current control is lost with 25, not with 30.
const PERIODS_A_TURN: f64 = 30.0;

/// The same with overmodulation. The six edges of the hexagon are a ripple of six times the frequency in field coordinates.
/// Behind 1.5 periods of delay and the leakage inductance current control answers it in phase at a sixth of the control's
/// rate, which is 36 periods a turn; 45 keep the ripple a fifth below. Current control oscillates with 40, not with 50.
const PERIODS_OVERMODULATED: f64 = 45.0;

/// Duration of the comparison of the legs, s: without the enhanced scheme there is none.
#[cfg(not(all(feature = "enhanced", feature = "legs")))]
fn legs_time(_: f64, _: f64) -> f64 {
    0.0
}

/// Largest stator frequency that the loops carry, rad/s.
fn fastest_field(inverter: &Inverter) -> f64 {
    core::f64::consts::TAU * inverter.f_c() / PERIODS_A_TURN
}

/// Least number of an encoder's lines for each pole pair: one count is 0.1 rad of the field, and its ripple some hundredths
/// of rated speed.
const LINES_A_POLE_PAIR: f64 = 16.0;

/// Difference of measured and estimated speed that an estimate may have: three quarters of the rated slip, for a rotor
/// resistance that is wrong by half at one and a half times rated torque, and 0.01 pu for the rest.
fn encoder_deviation(machine: &Machine) -> f64 {
    0.75 * rated_slip(machine) + SLACK * Base::new(machine).omega_m
}

/// Part of `encoder_deviation` that does not follow from the slip, per unit.
const SLACK: f64 = 0.01;
/// What a rated torque has to fit where the setting that follows from it is out of range.
const SLIP: &str = "with R_R, U_N, f_N and n_p it gives the rated slip, which encoder_deviation follows from and \
    which must stay below 13 pu";

/// Slip at rated torque with the base flux in the rotor, mechanical rad/s. The rotor's own flux is `L_M/L_s` of that without load,
/// and the slip more.
fn rated_slip(machine: &Machine) -> f64 {
    let n_p = f64::from(machine.n_p);
    let psi = Base::new(machine).psi;
    machine.R_R * machine.T_N / (1.5 * n_p * psi * psi) / n_p
}

/// Part of itself by which the leakage inductance may be off, and the largest gain with which the torque may act on itself through that
/// error ([`leakage_feedback`]). Simulated drives of 45 and 160 kW oscillated with a gain of 2.1, one of 15 kW with 1.7 did not.
const LEAKAGE_ERROR: f64 = 0.2;
const LEAKAGE_GAIN: f64 = 1.6;

/// Default bandwidth of the phase-locked loop that estimates the speed, Hz.
const PLL_BANDWIDTH: f64 = 25.0;

/// Default bandwidth of speed control, Hz: 9, less where the proportional gain would ask for more than twice the rated torque
/// when the speed is off by the rated slip `Δ`, or where the torque acts on itself through the leakage.
///
/// `R_R` above the real one by a part `ε` of it leaves `ω̂ = ω - ε Δ T/T_N`: with `T = k_p (ω* - ω̂)` the
/// torque acts on itself with the gain `ε k_p Δ/T_N`, at once. From 1 on a positive one runs away, and behind the delays of speed
/// estimator and current control a negative one oscillates. `k_p = J ω_c` and `ω_c ≤ 2 T_N/(J Δ)` leave a gain of `2ε`.
///
/// An error `ΔL` of the leakage turns the estimated rotor flux by `ΔL i_q/ψ`, which the phase-locked loop that follows it, of the natural
/// frequency `ω_n`, takes for the speed `2 ω_n ΔL i_q/(ψ n_p)` while the torque changes faster than it settles: with
/// `T = 1.5 n_p ψ i_q` a gain of `2 J ω_c ω_n ΔL/(1.5 n_p² ψ²)`, that oscillates at 17 to 26 Hz.
///
/// At the drives of the evidence 9 Hz are below both; they count where a large inertia is driven.
fn speed_bandwidth(machine: &Machine) -> f64 {
    let tau = core::f64::consts::TAU;
    let by_slip = 2.0 * machine.T_N / (machine.J * rated_slip(machine));
    let by_leakage = LEAKAGE_GAIN / leakage_feedback(machine);
    (by_slip.min(by_leakage) / tau).clamp(SPEED_BANDWIDTH.0, 9.0)
}

/// Gain with which the torque acts on itself through a leakage that is [`LEAKAGE_ERROR`] off, per rad/s of speed control's bandwidth.
fn leakage_feedback(machine: &Machine) -> f64 {
    let flux = f64::from(machine.n_p) * Base::new(machine).psi;
    let omega_n = core::f64::consts::TAU * PLL_BANDWIDTH;
    2.0 * machine.J * omega_n * LEAKAGE_ERROR * machine.L_sigma / (1.5 * flux * flux)
}

/// What an error says of a setting that is left out of the build.
fn needs_modes(e: ParamError) -> ParamError {
    if cfg!(feature = "modes") { e } else { e.with_note("needs the feature `modes`") }
}

/// Longest window of a single shunt, in parts of the carrier period.
const WINDOW_MAX: f64 = 0.15;

/// Which estimators a drive runs, of those that the build has (features `paper` and `enhanced`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Scheme {
    /// The published scheme: offset estimator, noise compensator, resistance adaptation.
    Paper,
    /// One extended Kalman filter for flux, offset, resistance, inverter model and magnetising curve; the confidence
    /// follows from its covariance.
    Enhanced,
}

impl Scheme {
    /// The schemes of this build.
    pub const ALL: &[Self] = &[
        #[cfg(feature = "paper")]
        Self::Paper,
        #[cfg(feature = "enhanced")]
        Self::Enhanced,
    ];

    /// The same as a word: bit 0 the published one, bit 1 the enhanced one, bit 2 supervision, bit 3 the variants of the
    /// published one, bit 4 the loss of unequal legs. A stored configuration fits only a build of the same features.
    pub const BUILT: u32 = cfg!(feature = "paper") as u32
        | (cfg!(feature = "enhanced") as u32) << 1
        | (cfg!(feature = "supervision") as u32) << 2
        | (cfg!(feature = "variants") as u32) << 3
        | (cfg!(feature = "legs") as u32) << 4;

    /// An error if the scheme is left out of this build.
    pub(super) fn check(self) -> Result<(), ParamError> {
        let (first, last) = (f64::from(u8::from(Self::BUILT & 1 == 0)), f64::from(Self::BUILT >> 1 & 1));
        check("scheme", f64::from(self as u8), first, last, "")
            .map_err(|e| e.with_note("0 is built with the feature `paper`, 1 with `enhanced`"))
    }
}

impl Default for Scheme {
    /// The enhanced one, if the build has it.
    fn default() -> Self {
        if cfg!(feature = "enhanced") { Self::Enhanced } else { Self::Paper }
    }
}

impl Words for Scheme {
    const BLANK: Self = Self::Paper;
    fn put(&self, out: &mut impl FnMut(u32)) {
        out(*self as u32);
    }
    fn fill(&mut self, from: &mut impl FnMut() -> u32) {
        *self = if from() == Self::Paper as u32 { Self::Paper } else { Self::Enhanced };
    }
}

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
    /// Bandwidth of current control, Hz: 0.03 `f_s`, at most 0.04 of the control's frequency. Up to 0.06 of it is admissible.
    pub current_bandwidth: f64,
    /// Bandwidth of flux control, Hz: 5, less where a long rotor time constant and a large leakage ask for it (docs/gains.md);
    /// at most 30, and little more than the default there.
    pub flux_bandwidth: f64,
    /// Bandwidth of speed control, Hz: 9, less where the inertia is large (docs/gains.md).
    pub speed_bandwidth: f64,
    /// Part of a change of the speed reference that the proportional part of speed control sees at once, from 0 to 1; the rest follows with
    /// the time constant of its integral part ([`crate::control::speed`]). 0.3: a step does not overshoot. 1: for a reference that is
    /// itself a controller's output.
    pub set_point_weight: f64,
    /// Natural frequency of the speed estimator's phase-locked loop, Hz.
    pub pll_bandwidth: f64,
    /// Inverter model: compensation of threshold and dead time.
    pub inverter_model: bool,
    /// Read the current offsets with gates off before each start, and `r̂_s` while magnetising.
    pub calibrate_offset: bool,
    /// Duration of the reading of the offsets, s.
    pub offset_time: f64,
    /// Current sensors: 3, or 2 in phases a and b. With two the current of phase c is `-(i_a + i_b)` and its channel is not
    /// read. The difference of the gains of the two is found in the magnetisation at standstill then, by the enhanced
    /// scheme, instead of while running, and the monitor of the sum is off. This and `discontinuous_above` need the feature `modes`.
    ///
    /// 1: a single shunt in the dc link, feature `shunt`. [`crate::drive::Measurement::i_abc`] holds its three readings then,
    /// at the instants of [`crate::drive::Drive::pulses`] and at the end of the period ([`crate::control::shunt`]).
    pub current_sensors: u32,
    /// Time for which a state of the bridge lasts that a single shunt is sampled in, s: dead time, settling of the
    /// amplifier, sampling of the converter; from the dead time to 15 % of the carrier period. 0: pulses are not shifted,
    /// and at low voltage nothing is seen. Without effect with more sensors.
    pub shunt_window: f64,
    /// Time constant of the amplifier of a single shunt, s, at most a quarter of the longest window: the current rises while it is
    /// sampled, and the reading is behind it. 0: none. Without effect with more sensors.
    pub shunt_settling: f64,
    /// Duration of the magnetisation, s, at least three rotor time constants. The comparison of the legs
    /// ([`EnhancedParams::identify_legs`]) is its first part; three rotor time constants are left for the flux in any case.
    pub magnetise_time: f64,
    /// What to do while the confidence is low.
    pub low_confidence: LowConfidence,
    /// Time after a stop within which a start takes over the offsets of the current sensors and what was identified, and
    /// is as short as the current allows, s, 0 to 3600; 0: never.
    pub fresh_time: f64,
    /// Monitors of phases, current channels, stall and lost field. Off, a drive checks its measurements, the plausibility of its
    /// estimate and the stamps of [`Drive::step_at`](crate::drive::Drive::step_at) alone: for tests of the bridge without a
    /// machine, not for a load.
    pub supervision: bool,
    /// Time for which the torque may be at its limit at low speed without the speed approaching its reference, s, 0.1 to
    /// 60; 0: any ([`crate::supervision::stall`]).
    pub stall_time: f64,
    /// The flux is taken to lie along the current where the torque is at its limit and the field stands still, whatever the
    /// torque ([`crate::control::realign`]); in the enhanced scheme it is also tried on the other side of the current where the
    /// field stands without load and its angle is not known ([`crate::control::sides`]). Feature `supervision`.
    pub realignment: bool,
    /// Discontinuous modulation from this voltage on, in parts of the largest that continuous modulation makes, `u_dc/√3`;
    /// 0.3 to 1 ([`crate::control::modulator`]); `None`: continuous at every voltage.
    pub discontinuous_above: Option<f64>,
    /// Lower the flux where the voltage is used up ([`crate::control::weakening`]). Without it the speed ends there. Needs the
    /// feature `weakening`.
    pub field_weakening: bool,
    /// Use the voltage between the circle within the hexagon and the hexagon: 5.2 % more for flux and torque, and a current
    /// with the 5th and 7th harmonic while all of it is used. At least 45 control periods in one turn of the field at
    /// `omega_max`.
    pub overmodulation: bool,
    /// Largest acceleration of the speed reference, mechanical rad/s²; `None`: it is followed as it is. It and the jerk need
    /// the feature `ramp`.
    pub acceleration: Option<f64>,
    /// Largest jerk of the speed reference, mechanical rad/s³, together with an acceleration; `None`: no limit.
    pub jerk: Option<f64>,
    /// Negative and positive limit of the torque reference, N·m, within `torque_max`; `None`: ±`torque_max`.
    pub torque_limits: Option<(f64, f64)>,
    /// Negative and positive limit of the speed reference, mechanical rad/s, within `omega_max`; `None`: ±`omega_max`.
    pub speed_limits: Option<(f64, f64)>,
    /// Continuous current of the machine in A rms and the time constant of its heat in s: the current is derated before
    /// the heat exceeds that of the continuous current ([`crate::control::overload`]); `None`: no derating. Heat is counted
    /// while the drive runs, not while it magnetises. It and
    /// the bridge's need the feature `derating`.
    pub machine_overload: Option<(f64, f64)>,
    /// The same of the bridge.
    pub bridge_overload: Option<(f64, f64)>,
    /// dc-link voltage at which no braking torque is left, V ([`crate::control::dclink`]); `None`: no limit. This and the
    /// next two need the feature `dclink`.
    pub u_dc_brake: Option<f64>,
    /// dc-link voltage below which the machine feeds the link, V: kinetic buffering; `None`: none.
    pub u_dc_buffer: Option<f64>,
    /// dc-link voltages from which on the brake chopper takes current and at which it takes all, V; `None`: no chopper.
    pub u_dc_chopper: Option<(f64, f64)>,
    /// Lines of an incremental encoder on the shaft, a quarter of the steps a turn of a resolver; from 16 a pole pair to
    /// 65,536; 0: none. This and the next four are the feature `encoder` ([`crate::control::handover`]); the content of its
    /// counter is given by [`crate::drive::Drive::set_encoder`].
    pub encoder_lines: u32,
    /// States of the encoder's counter, 65,536 of one of 16 bits; of one that is reset at each turn four times the lines. At
    /// least 16 times the counts between two runs of the speed estimator at `omega_max`, at most 2^31.
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

impl DriveParams {
    /// Defaults for a machine on an inverter.
    #[must_use]
    pub fn new(machine: &Machine, inverter: &Inverter) -> Self {
        let i_n = machine.I_N * core::f64::consts::SQRT_2;
        let tau_r = machine.L_M / machine.R_R;
        let current_bandwidth = (CURRENT_BANDWIDTH * inverter.f_s).min(FASTEST_DEFAULT_CURRENT * inverter.f_c());
        let direct = DirectFlux::new(machine, inverter, current_bandwidth);
        Self {
            scheme: Scheme::default(),
            psi_ref: 1.0,
            i_max: 1.8 * i_n,
            torque_max: 1.5 * machine.T_N,
            omega_max: (2.2 * machine.omega_sR()).min(fastest_field(inverter)) / f64::from(machine.n_p),
            i_trip: 2.3 * i_n,
            i_range: 2.5 * i_n,
            u_dc_min: 0.6 * inverter.u_dc,
            u_dc_max: 1.45 * inverter.u_dc,
            current_bandwidth,
            flux_bandwidth: (FLUX_GAIN.0 * direct.fastest_filtered()).min(5.0),
            speed_bandwidth: speed_bandwidth(machine),
            set_point_weight: 0.3,
            pll_bandwidth: PLL_BANDWIDTH,
            inverter_model: true,
            calibrate_offset: true,
            offset_time: 0.1,
            current_sensors: 3,
            shunt_settling: 0.0,
            shunt_window: (inverter.dead_time + 2.5e-6).min(WINDOW_MAX / inverter.f_s),
            magnetise_time: (4.0 * tau_r + legs_time(tau_r, current_bandwidth)).max(1.4),
            low_confidence: LowConfidence::Keep,
            fresh_time: 10.0,
            supervision: SUPERVISED,
            stall_time: if SUPERVISED { 0.35 } else { 0.0 },
            realignment: SUPERVISED,
            discontinuous_above: None,
            field_weakening: WEAKENED,
            overmodulation: false,
            acceleration: None,
            jerk: None,
            torque_limits: None,
            speed_limits: None,
            machine_overload: None,
            bridge_overload: None,
            u_dc_brake: None,
            u_dc_buffer: None,
            u_dc_chopper: None,
            encoder_lines: 0,
            encoder_states: 1 << 16,
            encoder_mode: EncoderMode::Compare,
            encoder_deviation: encoder_deviation(machine),
            encoder_fault: false,
            paper: PaperParams::default(),
            enhanced: EnhancedParams::new(machine),
        }
    }

    /// Part of its last proportional correction that flux control keeps, [`DirectFlux`].
    pub(crate) fn flux_memory(&self, machine: &Machine, inverter: &Inverter) -> f64 {
        DirectFlux::new(machine, inverter, self.current_bandwidth).memory(self.flux_bandwidth)
    }

    /// Checks every field against its admissible range.
    ///
    /// # Errors
    /// The first field found outside its range, or changed although it belongs to the scheme that does not run.
    pub fn validate(&self, machine: &Machine, inverter: &Inverter) -> Result<(), ParamError> {
        let i_n = machine.I_N * core::f64::consts::SQRT_2;
        let f_s = inverter.f_c();
        let tau_r = machine.L_M / machine.R_R;
        check("psi_ref", self.psi_ref, 0.3, 1.2, "p.u.")?;
        let i_0 = self.psi_ref * Base::new(machine).psi / machine.L_s();
        check("i_max", self.i_max, 1.1 * i_0, 5.0 * i_n, "A")?;
        check("torque_max", self.torque_max, 0.05 * machine.T_N, 5.0 * machine.T_N, "N m")?;
        let omega_n = machine.omega_sR() / f64::from(machine.n_p);
        let fastest = fastest_field(inverter) / f64::from(machine.n_p);
        check("omega_max", self.omega_max, 0.01 * omega_n, (3.0 * omega_n).min(fastest), "rad/s")
            .map_err(|e| e.with_note("at most 3 pu, and 30 control periods in one turn of the field"))?;
        let turns = f_s * core::f64::consts::TAU / (self.omega_max * f64::from(machine.n_p));
        let most = f64::from(u8::from(turns >= PERIODS_OVERMODULATED));
        check("overmodulation", f64::from(u8::from(self.overmodulation)), 0.0, most, "")
            .map_err(|e| e.with_note("at least 45 control periods in one turn of the field at omega_max"))?;
        check("i_trip", self.i_trip, TRIP_LEAST * self.i_max, 8.0 * i_n, "A")
            .map_err(|e| e.with_note("1.15 times i_max or more: current control exceeds it in steps"))?;
        check("i_range", self.i_range, self.i_trip, 20.0 * i_n, "A")?;
        // The link at its rated voltage, with ripple, sag under load and noise of the reading, is no fault.
        check("u_dc_min", self.u_dc_min, 0.0, 0.95 * inverter.u_dc, "V")?;
        check("u_dc_max", self.u_dc_max, 1.05 * inverter.u_dc, 3.0 * inverter.u_dc, "V")
            .map_err(|e| e.with_note("1.05 to 3 times the rated voltage of the dc link"))?;
        check("current_bandwidth", self.current_bandwidth, 10.0, FASTEST_CURRENT * f_s, "Hz")?;
        let fastest = FLUX_GAIN.1 * DirectFlux::new(machine, inverter, self.current_bandwidth).fastest_filtered();
        check("flux_bandwidth", self.flux_bandwidth, 0.1, fastest.min(30.0), "Hz")
            .map_err(|e| e.with_note("by way of the leakage its current acts on the flux at once"))?;
        check("speed_bandwidth", self.speed_bandwidth, SPEED_BANDWIDTH.0, SPEED_BANDWIDTH.1, "Hz")?;
        check("set_point_weight", self.set_point_weight, 0.0, 1.0, "")?;
        // A fifteenth of the rate at which the loop runs.
        let least = (PLL_LEAST * self.speed_bandwidth).max(2.0);
        check("pll_bandwidth", self.pll_bandwidth, least, (0.03 * f_s).min(100.0), "Hz").map_err(|e| {
            e.with_note("2 Hz and 1.5 times speed_bandwidth or more: the speed that is controlled is the estimated one")
        })?;
        check("offset_time", self.offset_time, 10.0 / f_s, 10.0, "s")?;
        let modes = cfg!(feature = "modes");
        self.validate_sensors(inverter)?;
        check("half_periods", f64::from(inverter.half_periods), if modes { 1.0 } else { 2.0 }, 16.0, "")
            .map_err(needs_modes)?;
        check("magnetise_time", self.magnetise_time, LEAST_BUILD_UP * tau_r, 60.0, "s")?;
        check("fresh_time", self.fresh_time, 0.0, 3600.0, "s")?;
        if self.stall_time != 0.0 {
            check("stall_time", self.stall_time, 0.1, 60.0, "s")?;
        }
        for (field, value) in [
            ("supervision", f64::from(u8::from(self.supervision))),
            ("stall_time", self.stall_time),
            ("realignment", f64::from(u8::from(self.realignment))),
        ] {
            if value != 0.0 && !SUPERVISED {
                return Err(refuse(field, value, "", "needs the feature `supervision`"));
            }
        }
        if self.field_weakening && !WEAKENED {
            return Err(refuse("field_weakening", 1.0, "", "needs the feature `weakening`"));
        }
        if let Some(part) = self.discontinuous_above {
            check("discontinuous_above", part, 0.3, if cfg!(feature = "modes") { 1.0 } else { 0.0 }, "")
                .map_err(needs_modes)?;
        }
        self.validate_limits(machine, inverter)?;
        self.validate_link(inverter)?;
        self.validate_encoder(machine, inverter)?;
        self.paper.validate()?;
        self.enhanced.validate(machine)?;
        match self.scheme {
            Scheme::Paper => self.enhanced.refuse_changes(machine),
            Scheme::Enhanced => self.paper.refuse_changes(),
        }
    }

    /// Current of the build-up of the flux as multiple of its final value, as far as the largest current allows.
    pub(super) fn boost(&self, machine: &Machine) -> f64 {
        let i_0 = self.psi_ref * Base::new(machine).psi / machine.L_s();
        BOOST.min(QUICK * self.i_max / i_0).max(LEAST_BOOST)
    }

    /// Whether a start compares the legs of the bridge. Offsets of the sensors that were not read would be taken for a
    /// voltage of the legs.
    pub(super) fn compares_legs(&self, machine: &Machine) -> bool {
        let known = self.inverter_model && self.calibrate_offset;
        let fast = legs_time(machine.L_M / machine.R_R, self.current_bandwidth) > 0.0;
        self.scheme == Scheme::Enhanced && self.enhanced.identify_legs && known && fast
    }

    /// Part of the magnetisation in which the flux builds up and settles and the resistance is identified, s.
    pub(super) fn build_up_time(&self, machine: &Machine) -> f64 {
        if !self.compares_legs(machine) {
            return self.magnetise_time;
        }
        let left = self.magnetise_time - legs_time(machine.L_M / machine.R_R, self.current_bandwidth);
        left.max(LEAST_BUILD_UP * machine.L_M / machine.R_R)
    }

    /// Number of current sensors, and what a single shunt asks of the pulses.
    fn validate_sensors(&self, inverter: &Inverter) -> Result<(), ParamError> {
        let least = if cfg!(feature = "shunt") {
            1.0
        } else if cfg!(feature = "modes") {
            2.0
        } else {
            3.0
        };
        check("current_sensors", f64::from(self.current_sensors), least, 3.0, "").map_err(|e| {
            if cfg!(feature = "shunt") { e } else { e.with_note("2 needs the feature `modes`, 1 the feature `shunt`") }
        })?;
        let longest = WINDOW_MAX / inverter.f_s;
        if self.shunt_window != 0.0 {
            check("shunt_window", self.shunt_window, inverter.dead_time.min(longest), longest, "s")
                .map_err(|e| e.with_note("dead time, settling and sampling, at most 15 % of the carrier period"))?;
        }
        check("shunt_settling", self.shunt_settling, 0.0, 0.25 * longest, "s")?;
        if self.current_sensors > 1 {
            return Ok(());
        }
        const SHUNT: &str =
            "with a single shunt the pulses are continuous, updated once, and leave room for its window";
        let off =
            |field, chosen| check(field, f64::from(u8::from(chosen)), 0.0, 0.0, "").map_err(|e| e.with_note(SHUNT));
        off("discontinuous_above", self.discontinuous_above.is_some())?;
        off("overmodulation", self.overmodulation)?;
        check("half_periods", f64::from(inverter.half_periods), 2.0, 16.0, "").map_err(|e| e.with_note(SHUNT))
    }

    /// Window of a single shunt in parts of half of the carrier period: a whole and even number of timer counts, so that
    /// edges moved by it, and a duty moved by half of it, are whole counts; 0 with more sensors.
    pub(super) fn window(&self, inverter: &Inverter) -> f64 {
        if self.current_sensors > 1 {
            return 0.0;
        }
        let part = 2.0 * self.shunt_window * inverter.f_s;
        match inverter.timer() {
            Ok(Some(timer)) => {
                let full = f64::from(timer.full());
                2.0 * libm::ceil(0.5 * part * full - 1e-6) / full
            }
            _ => part,
        }
    }

    /// Ramp, limits by direction, derating.
    fn validate_limits(&self, machine: &Machine, inverter: &Inverter) -> Result<(), ParamError> {
        let omega_n = machine.omega_sR() / f64::from(machine.n_p);
        for (field, value, unit) in [("acceleration", self.acceleration, "rad/s²"), ("jerk", self.jerk, "rad/s³")] {
            if let (Some(value), false) = (value, cfg!(feature = "ramp")) {
                return Err(refuse(field, value, unit, "needs the feature `ramp`"));
            }
        }
        if let Some(a) = self.acceleration {
            check("acceleration", a, 1e-3 * omega_n, 1000.0 * omega_n, "rad/s²")?;
        }
        if let Some(j) = self.jerk {
            if self.acceleration.is_none() {
                return Err(refuse("jerk", j, "rad/s³", "it needs an acceleration"));
            }
            check("jerk", j, 1e-2 * omega_n, 1e5 * omega_n, "rad/s³")?;
        }
        if let Some((negative, positive)) = self.torque_limits {
            check("torque_limits[0]", negative, -self.torque_max, 0.0, "N m")?;
            check("torque_limits[1]", positive, 0.0, self.torque_max, "N m")?;
        }
        if let Some((negative, positive)) = self.speed_limits {
            check("speed_limits[0]", negative, -self.omega_max, 0.0, "rad/s")?;
            check("speed_limits[1]", positive, 0.0, self.omega_max, "rad/s")?;
        }
        let root = core::f64::consts::SQRT_2;
        let least = 1.1 * self.psi_ref * Base::new(machine).psi / machine.L_s() / root;
        for (fields, body) in [
            (["machine_overload[0]", "machine_overload[1]"], self.machine_overload),
            (["bridge_overload[0]", "bridge_overload[1]"], self.bridge_overload),
        ] {
            if let Some((current, time)) = body {
                if !cfg!(feature = "derating") {
                    return Err(refuse(fields[0], current, "A", "needs the feature `derating`"));
                }
                check(fields[0], current, least, self.i_max / root, "A")?;
                // Longer than the interval in which it is computed, short enough for fixed point.
                check(fields[1], time, 1e4 / inverter.f_c(), 3600.0, "s")?;
            }
        }
        Ok(())
    }

    /// Encoder and its counter.
    fn validate_encoder(&self, machine: &Machine, inverter: &Inverter) -> Result<(), ParamError> {
        const BUILT: bool = cfg!(feature = "encoder");
        let note = match (BUILT, self.encoder_lines) {
            (false, _) => "needs the feature `encoder`",
            (true, 0) => "encoder_mode and encoder_fault need an encoder",
            (true, _) => "at least 16 lines a pole pair; 0 is no encoder",
        };
        let (lines, omega_n) = (f64::from(self.encoder_lines), machine.omega_sR() / f64::from(machine.n_p));
        let used = self.encoder_lines > 0 || self.encoder_fault || self.encoder_mode != EncoderMode::Compare;
        let (least, most) = match (used, BUILT) {
            (false, _) => (0.0, 65_536.0),
            (true, true) => (LINES_A_POLE_PAIR * f64::from(machine.n_p), 65_536.0),
            (true, false) => (0.0, 0.0),
        };
        check("encoder_lines", if used && !BUILT { lines.max(1.0) } else { lines }, least, most, "")
            .map_err(|e| e.with_note(note))?;
        let turns = f64::from(speed_periods(self.scheme, slow_periods(inverter))) / inverter.f_c() * self.omega_max
            / core::f64::consts::TAU;
        check(
            "encoder_states",
            f64::from(self.encoder_states),
            16.0 * (4.0 * lines * turns),
            f64::from(1_u32 << 31),
            "",
        )
        .map_err(|e| {
            e.with_note("at least 16 times the counts between two runs of the speed estimator at omega_max")
        })?;
        let (least, most) = (0.005 * omega_n, 10.0 * omega_n);
        check("encoder_deviation", self.encoder_deviation, least, most, "rad/s").map_err(|e| {
            let derived = encoder_deviation(machine);
            if self.encoder_deviation.to_bits() != derived.to_bits() {
                return e.with_note("0.005 to 10 times the speed of f_N and n_p");
            }
            // Nobody gave it: it follows from the rated slip, which is in proportion to the torque.
            let of_slip = |deviation: f64| machine.T_N * (deviation - SLACK * omega_n) / (derived - SLACK * omega_n);
            ParamError {
                field: "T_N",
                value: machine.T_N,
                min: of_slip(least).max(0.0),
                max: of_slip(most),
                unit: "N m",
                note: SLIP,
            }
        })
    }

    /// Voltages of the link's control.
    fn validate_link(&self, inverter: &Inverter) -> Result<(), ParamError> {
        #[cfg(feature = "dclink")]
        use crate::control::dclink::WIDTH;
        #[cfg(not(feature = "dclink"))]
        const WIDTH: f64 = 0.0;
        let built = cfg!(feature = "dclink");
        let check = |field, value, min: f64, max: f64| {
            if built {
                check(field, value, min, max, "V")
            } else {
                Err(refuse(field, value, "V", "needs the feature `dclink`"))
            }
        };
        // Braking torque falls within a width below its voltage, driving torque within one above the buffering voltage; within
        // one below that the machine comes to feed the link, before the drive ends with an under-voltage.
        if let Some(u) = self.u_dc_brake {
            check("u_dc_brake", u, 1.1 * inverter.u_dc, self.u_dc_max)?;
        }
        if let Some(u) = self.u_dc_buffer {
            check("u_dc_buffer", u, self.u_dc_min + WIDTH * inverter.u_dc, 0.9 * inverter.u_dc)?;
        }
        if let Some((on, full)) = self.u_dc_chopper {
            check("u_dc_chopper[0]", on, 1.02 * inverter.u_dc, self.u_dc_max)?;
            check("u_dc_chopper[1]", full, on + 0.005 * inverter.u_dc, self.u_dc_max)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speed_control_asks_for_twice_the_rated_torque_at_most_where_the_speed_is_off_by_the_rated_slip() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        for factor in [0.1, 1.0, 5.0, 10.0, 100.0, 1000.0] {
            let machine = Machine { J: factor * machine.J, ..machine };
            let bandwidth = DriveParams::new(&machine, &inverter).speed_bandwidth;
            let torque = machine.J * core::f64::consts::TAU * bandwidth * rated_slip(&machine);
            assert!(bandwidth == 9.0 || (torque / machine.T_N - 2.0).abs() < 1e-12, "{factor}: {bandwidth} Hz");
            assert_eq!(bandwidth == 9.0, factor <= 5.0, "{factor}: {bandwidth} Hz");
        }
        let immovable = Machine { J: 1e5, ..machine };
        assert_eq!(DriveParams::new(&immovable, &inverter).speed_bandwidth, SPEED_BANDWIDTH.0, "admissible");
    }

    #[test]
    fn speed_control_of_a_large_inertia_leaves_the_torque_little_to_act_on_itself_through_the_leakage() {
        let (machine, inverter) = (Machine::preset_11k(), Inverter::preset_11k());
        // The leakage of a larger machine counts where its slip, small as it is, does not.
        let large = Machine { R_R: machine.R_R / 4.0, ..machine };
        for factor in [1.0, 10.0, 100.0] {
            let machine = Machine { J: factor * large.J, ..large };
            let bandwidth = DriveParams::new(&machine, &inverter).speed_bandwidth;
            let gain = leakage_feedback(&machine) * core::f64::consts::TAU * bandwidth;
            assert_eq!(bandwidth == 9.0, factor <= 10.0, "{factor}: {bandwidth} Hz");
            assert!(bandwidth == 9.0 && gain < LEAKAGE_GAIN || (gain - LEAKAGE_GAIN).abs() < 1e-9, "{factor}: {gain}");
        }
    }

    #[test]
    fn a_rated_torque_that_no_slip_fits_is_named_in_place_of_what_follows_from_it() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let refused = |machine: &Machine, change: fn(&mut DriveParams)| {
            let mut params = DriveParams::new(machine, &inverter);
            change(&mut params);
            params.validate_encoder(machine, &inverter).unwrap_err()
        };
        let wrong = Machine { T_N: 1000.0 * machine.T_N, ..machine };
        let error = refused(&wrong, |_| {});
        assert_eq!((error.field, error.value, error.min), ("T_N", wrong.T_N, 0.0));
        assert!(error.note.contains("encoder_deviation"), "{error}");
        // The range is that of the torque itself.
        for (part, fits) in [(0.999, true), (1.001, false)] {
            let machine = Machine { T_N: part * error.max, ..machine };
            assert_eq!(DriveParams::new(&machine, &inverter).validate_encoder(&machine, &inverter).is_ok(), fits);
        }
        // What was given is named itself.
        let error = refused(&machine, |params| params.encoder_deviation = 1e5);
        assert_eq!((error.field, error.value), ("encoder_deviation", 1e5));
        assert!(error.note.contains("f_N and n_p"), "{error}");
    }

    /// Part of a deviation of `i_d` that is left after a hundred runs of flux control, through a leakage of `factor` times that of
    /// the parameters: every control period, with the integral part of current control.
    fn oscillation_left(machine: &Machine, inverter: &Inverter, bandwidth: f64, memory: f64, factor: f64) -> f64 {
        let p = DriveParams::new(machine, inverter);
        let (periods, t_s) = (slow_periods(inverter), 1.0 / inverter.f_c());
        let omega_c = core::f64::consts::TAU * p.current_bandwidth;
        // k_p of docs/gains.md, in SI: i_d for a flux, and a voltage for a current.
        let k_psi = core::f64::consts::TAU * bandwidth * (machine.L_M / machine.R_R) / machine.L_s();
        let k_p = omega_c * machine.L_sigma;
        let (mut i_d, mut x, mut y, mut i_ref, mut u, mut last) = (1.0f64, 0.0, 0.0, 0.0, 0.0, 0.0);
        for k in 0..100 * periods {
            // Sample, current control, then flux control: its reference is that of the next period, a voltage acts from the next sample on.
            let i = i_d;
            i_d += u * t_s / (factor * machine.L_sigma);
            u = k_p * (i_ref - i) + x;
            x += t_s * k_p * omega_c / 5.0 * (i_ref - i);
            if k % periods == 0 {
                y = memory * y - (1.0 - memory) * k_psi * factor * machine.L_sigma * i;
                i_ref = y;
            }
            if k >= 90 * periods {
                last = i_d.abs().max(last);
            }
        }
        last
    }

    #[test]
    fn flux_control_does_not_oscillate_through_a_leakage_of_1_5_times_the_parameter() {
        let small = Machine::preset_2k2();
        let mut filters = [0; 3];
        for tau_r in [1.0, 5.0, 10.0, 20.0, 50.0] {
            let machine = Machine { R_R: small.R_R / tau_r, ..small };
            for f_s in [3e3, 4e3, 8e3, 16e3] {
                let inverter = Inverter { f_s, ..Inverter::preset_2k2() };
                let p = DriveParams::new(&machine, &inverter);
                let memory = p.flux_memory(&machine, &inverter);
                let left = |memory, factor| oscillation_left(&machine, &inverter, p.flux_bandwidth, memory, factor);
                let used = FLUX_MEMORY.iter().position(|x| x.0 == memory).unwrap();
                filters[used] += 1;
                assert!(left(memory, 1.0) < 1e-6, "{tau_r}, {f_s}: {}", left(memory, 1.0));
                assert!(left(memory, 1.5) < 1.0, "{tau_r}, {f_s}: {}", left(memory, 1.5));
                // The filter is needed where the gain is large.
                let weaker = left(FLUX_MEMORY[used.saturating_sub(1)].0, 1.5);
                assert!(tau_r < 20.0 || weaker > 1.0, "{tau_r}, {f_s}: {weaker}");
            }
        }
        assert!(filters.iter().all(|&drives| drives > 0), "{filters:?}");
    }
}
