//! Configuration of a drive: settings in SI ([`DriveParams`]) and the constants of the control step in per unit
//! ([`DriveConfig`], with every division done beforehand).
//!
//! ```text
//! current: k_p = ω_c σl_s, k_i = k_p ω_c/5       flux: k_p = ω_ψ τ_r/l_s, k_i = ω_ψ/l_s
//! speed:   k_p = j ω_Ω,    k_i = k_p ω_Ω/4       speed estimator: k_p = 2 ω_n, k_i = ω_n²
//! ```
//!
//! The integral gains are stored times the period of their block. Derivations and defaults: docs/gains.md. Parameters
//! outside their ranges are refused ([`ParamError`]), never limited.

#[cfg(feature = "enhanced")]
mod enhanced;
#[cfg(feature = "paper")]
mod paper;
mod settings;
use settings::SUPERVISION_PERIODS;
pub(crate) use settings::{BOOST, QUICK};

pub use settings::{BALANCE_PERIODS, DriveParams, EncoderMode, EnhancedParams, LowConfidence, PaperParams, Scheme};

use crate::base::{PerUnit, rounded};
use crate::control::current::CurrentConfig;
#[cfg(feature = "dclink")]
use crate::control::dclink::{self, DcLinkConfig};
use crate::control::flux::FluxControlConfig;
#[cfg(feature = "encoder")]
use crate::control::handover::{self, HandOverConfig};
use crate::control::overload::{self, OverloadConfig};
use crate::control::ramp::{self, RampConfig};
#[cfg(feature = "supervision")]
use crate::control::realign::RealignConfig;
#[cfg(feature = "shunt")]
use crate::control::shunt::ShuntConfig;
use crate::control::speed::SpeedControlConfig;
use crate::control::weakening::{self, WeakeningConfig};
#[cfg(feature = "enhanced")]
use crate::estimate::balance::BalanceConfig;
#[cfg(feature = "paper")]
use crate::estimate::confidence::ConfidenceConfig;
#[cfg(feature = "encoder")]
use crate::estimate::encoder::{EncoderConfig, count_angle};
#[cfg(feature = "paper")]
use crate::estimate::flux::FluxConfig;
#[cfg(feature = "enhanced")]
use crate::estimate::kalman::FilterConfig;
#[cfg(feature = "paper")]
use crate::estimate::resistance::ResistanceConfig;
use crate::estimate::speed::SpeedConfig;
use crate::inverter::InverterModel;
use crate::params::{Inverter, Machine, ParamError, check};
use crate::scalar::{Real, Timer};
use crate::space::Dq;
use crate::supervision::SupervisionConfig;
#[cfg(feature = "supervision")]
use crate::supervision::channels::ChannelConfig;
#[cfg(feature = "supervision")]
use crate::supervision::innovation::InnovationConfig;
#[cfg(feature = "supervision")]
use crate::supervision::phases::PhaseConfig;
use crate::supervision::plausibility::PlausibilityConfig;
use crate::words::{Words, words};
#[cfg(feature = "enhanced")]
pub(crate) use enhanced::{EnhancedConfig, REDUCED, SMALL};
#[cfg(feature = "paper")]
pub(crate) use paper::PaperConfig;

/// Largest offset of a current channel at rest, per unit.
pub(crate) const I_OFF_MAX: f64 = 0.15;

/// Part of the dc link that the voltage vector may use: inscribed circle of the hexagon, less a margin.
pub(crate) const U_UTILISATION: f64 = 0.98 / 1.732_050_807_568_877_2;
/// The same with overmodulation: the reference reaches half way to the corners of the hexagon, and the modulator takes the
/// nearest voltage on its edge. Of a reference that turns with the length `ρ` the fundamental that is left is, with
/// `r = 1/√3` and `cos θ = r/ρ`,
///
/// ```text
/// (6/π) (r sin θ + ρ (θ/2 - sin 2θ/4) + ρ (π/6 - θ)) = 0.601,    at the corners 0.609
/// ```
const U_REACH: f64 = 0.622;
/// The steady state stays on the circle, of which field weakening leaves it a part. On the edge of the hexagon current
/// control has little room.
const U_OVERMODULATED: f64 = 1.0 / (1.732_050_807_568_877_2 * weakening::UTILISATION);
/// Least dc-link voltage of a bridge that switches, per unit: its reciprocal is computed without a check.
const U_DC_LEAST: f64 = 1.0 / 32.0;
/// Flux control in field weakening ([`crate::control::flux`]): gain by the leakage, and crossing frequency of its integral
/// part in parts of the bandwidth of current control. Largest correction at high frequency in units of the magnetising
/// current: the flux of the largest machines falls over some tenths of a second only by a current against it.
const WEAK_GAIN: f64 = 0.15;
const WEAK_RATE: f64 = 0.05;
const LIMIT_HIGH: f64 = 2.0;
/// Largest gain from speed to torque current in field weakening, per unit of the bandwidth of current control. At 17 a
/// drive of 160 kW and 4 kHz oscillates at twice rated speed, at 15 one of 10 kHz does not.
const SPEED_GAIN: f64 = 12.0;
/// Time for which the field stands at the torque limit before the torque is halved to see why, and the least time for which
/// it is halved, s ([`crate::control::realign`]).
#[cfg(feature = "supervision")]
const REALIGN: f64 = 0.12;
/// The time for which it is halved, in rotor time constants, where that is longer.
#[cfg(feature = "supervision")]
const REALIGN_TEST: f64 = 0.5;
/// Time constant of the speed's low-pass there, s.
#[cfg(feature = "supervision")]
const REALIGN_LOW_PASS: f64 = 0.025;
/// Thresholds `h` of the tests for a lost field ([`crate::supervision::innovation`]): any contradiction, s, and a flux that
/// falls, in rotor time constants, and at least, s. The part of the rotor time constant is measured, not derived: with a third
/// of it steps of `r_s` by 25 % in regeneration at 11 kW end, which are held.
#[cfg(feature = "supervision")]
const LOST_FIELD: f64 = 0.04;
#[cfg(feature = "supervision")]
const FLUX_FALLS: f64 = 0.75;
#[cfg(feature = "supervision")]
const FLUX_FALLS_LEAST: f64 = 0.06;

/// Constants of the control step, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct DriveConfig<R: Real> {
    pub(crate) t_s: R,
    /// Control periods from one run of speed and flux control to the next, a power of two, less one.
    pub(crate) slow_mask: u32,
    pub(crate) inverter: InverterModel<R>,
    pub(crate) timer: Option<Timer>,
    #[cfg(feature = "modes")]
    double_update: bool,
    /// Square of the voltage, over the dc link, from which a leg is held at a rail; `None`: continuous modulation.
    #[cfg(feature = "modes")]
    discontinuous_sq: Option<R>,
    pub(crate) scheme: Scheme,
    #[cfg(feature = "paper")]
    pub(crate) paper: PaperConfig<R>,
    #[cfg(feature = "enhanced")]
    pub(crate) enhanced: EnhancedConfig<R>,
    pub(crate) speed: SpeedConfig<R>,
    pub(crate) current: CurrentConfig<R>,
    pub(crate) flux_control: FluxControlConfig<R>,
    pub(crate) weakening: WeakeningConfig<R>,
    pub(crate) speed_control: SpeedControlConfig<R>,
    pub(crate) supervision: SupervisionConfig<R>,
    pub(crate) low_confidence: LowConfidence,
    /// From a sample to the middle of the period in which its duties act.
    pub(crate) t_ahead: R,
    /// Part of the deviation of the current from its reference that is corrected within that time.
    pub(crate) part_ahead: R,
    pub(crate) i_range: R,
    /// Sum of the squared phase currents below which neither range nor trip level can be reached.
    pub(crate) i_plain_sq: R,
    pub(crate) i_trip: R,
    /// Square of the largest current, the largest direct current (97 % of it), and the largest torque current.
    pub(crate) i_max_sq: R,
    pub(crate) i_d_max: R,
    pub(crate) i_q_max: R,
    pub(crate) pull_out_use: R,
    /// Largest voltage reference and largest fundamental voltage, in parts of the dc link.
    pub(crate) u_limit: R,
    pub(crate) u_use: R,
    pub(crate) u_dc_min: R,
    pub(crate) u_dc_max: R,
    /// Limits of the speed reference.
    pub(crate) omega_least: R,
    pub(crate) omega_most: R,
    pub(crate) ramp: RampConfig<R>,
    pub(crate) overload: [OverloadConfig<R>; 2],
    #[cfg(feature = "supervision")]
    pub(crate) realign: RealignConfig<R>,
    #[cfg(feature = "dclink")]
    pub(crate) dclink: DcLinkConfig<R>,
    /// Counter of an encoder, `None` without one, and what its speed is used for.
    #[cfg(feature = "encoder")]
    pub(crate) encoder: Option<EncoderConfig<R>>,
    #[cfg(feature = "encoder")]
    pub(crate) hand_over: HandOverConfig<R>,
    /// Periods after a stop for which offsets and identified parameters are fresh, and the current that builds up the
    /// flux then.
    pub(crate) fresh_periods: u32,
    pub(crate) i_quick: R,
    /// Periods after a sample that could not be used in which another one is a fault.
    pub(crate) bridged_periods: u32,
    pub(crate) calibrate_offset: bool,
    /// The current of phase c is computed from the other two.
    #[cfg(feature = "modes")]
    two_sensors: bool,
    /// A single shunt in the dc link.
    #[cfg(feature = "shunt")]
    pub(crate) shunt: Option<ShuntConfig<R>>,
    pub(crate) offset_periods: u32,
    pub(crate) inv_offset_periods: R,
    pub(crate) magnetise_periods: u32,
    pub(crate) boost_periods: u32,
}
words! {
    DriveConfig:
    t_s, slow_mask, inverter, timer,
    #[cfg(feature = "modes")] double_update,
    #[cfg(feature = "modes")] discontinuous_sq,
    scheme,
    #[cfg(feature = "paper")] paper,
    #[cfg(feature = "enhanced")] enhanced,
    speed, current, flux_control, weakening, speed_control, supervision, low_confidence, t_ahead, part_ahead, i_range, i_plain_sq,
    i_trip, i_max_sq, i_d_max, i_q_max, pull_out_use, u_limit, u_use, u_dc_min, u_dc_max, omega_least, omega_most, ramp, overload,
    #[cfg(feature = "supervision")] realign,
    #[cfg(feature = "dclink")] dclink,
    #[cfg(feature = "encoder")] encoder,
    #[cfg(feature = "encoder")] hand_over,
    fresh_periods, i_quick,
    bridged_periods, calibrate_offset,
    #[cfg(feature = "modes")] two_sensors,
    #[cfg(feature = "shunt")] shunt,
    offset_periods, inv_offset_periods, magnetise_periods, boost_periods,
}

impl<R: Real> DriveConfig<R> {
    /// Control periods from one run to the next of speed and flux control.
    pub fn slow_periods(&self) -> u32 {
        self.slow_mask + 1
    }

    /// Control periods from one run to the next of field weakening, resistance adaptation, confidence and flux shift.
    pub fn adapt_periods(&self) -> u32 {
        settings::adapt_periods(self.slow_periods())
    }

    /// Whether it is the turn of the limits of the references, and of the adaptation of the estimators, in a period half of
    /// [`Self::slow_periods`] after speed and flux control: both, or in turns where [`Self::adapt_periods`] are twice these.
    #[inline(always)]
    pub(crate) fn turns_of_adaptation(&self, period: u32) -> (bool, bool) {
        let second = period & self.slow_periods() != 0;
        let both = self.adapt_periods() == self.slow_periods();
        (both || !second, both || second)
    }

    /// Control periods from one run to the next of the speed estimator.
    pub fn speed_periods(&self) -> u32 {
        self.speed_mask() + 1
    }

    /// These, less one.
    #[inline(always)]
    pub(crate) fn speed_mask(&self) -> u32 {
        // In a build of one scheme it is known.
        let enhanced = cfg!(feature = "enhanced") && (!cfg!(feature = "paper") || self.scheme == Scheme::Enhanced);
        if enhanced { self.slow_mask >> 1 } else { 1 }
    }

    /// Settings of the speed estimator, for its use alone.
    pub fn speed_config(&self) -> &SpeedConfig<R> {
        &self.speed
    }

    /// Settings of the current controller.
    pub fn current_config(&self) -> &CurrentConfig<R> {
        &self.current
    }

    /// Settings of the flux controller.
    pub fn flux_control_config(&self) -> &FluxControlConfig<R> {
        &self.flux_control
    }

    /// The inverter model.
    pub fn inverter_model(&self) -> &InverterModel<R> {
        &self.inverter
    }

    /// Resolution of the PWM timer, if duties are multiples of its counts.
    pub fn timer(&self) -> Option<&Timer> {
        self.timer.as_ref()
    }

    /// Settings of the speed controller.
    pub fn speed_control_config(&self) -> &SpeedControlConfig<R> {
        &self.speed_control
    }

    /// Settings of the flux estimator, for its use alone.
    #[cfg(feature = "paper")]
    pub fn flux_config(&self) -> &FluxConfig<R> {
        &self.paper.flux
    }

    /// Settings of the published scheme's detection of regeneration: corner of the low-pass in the slip times the time
    /// between two calls, and the least slip.
    #[cfg(feature = "paper")]
    pub fn regeneration_config(&self) -> (R, R) {
        (self.paper.slip_corner, self.paper.omega_r_regeneration)
    }

    /// Settings of the resistance adaptation, if it is on.
    #[cfg(feature = "paper")]
    pub fn resistance_config(&self) -> Option<&ResistanceConfig<R>> {
        self.paper.resistance.as_ref()
    }

    /// Settings of the confidence model.
    #[cfg(feature = "paper")]
    pub fn confidence_config(&self) -> &ConfidenceConfig<R> {
        &self.paper.confidence
    }

    /// Settings of the filter, for its use alone.
    #[cfg(feature = "enhanced")]
    pub fn filter_config(&self) -> &FilterConfig<R> {
        &self.enhanced.filter
    }

    /// Settings of the fit of the current sensors' gains.
    #[cfg(feature = "enhanced")]
    pub fn balance_config(&self) -> &BalanceConfig<R> {
        &self.enhanced.balance
    }

    /// Whether the current of phase c is computed from the other two.
    #[inline(always)]
    pub(crate) fn two_sensors(&self) -> bool {
        #[cfg(feature = "modes")]
        return self.two_sensors;
        #[cfg(not(feature = "modes"))]
        false
    }

    /// Whether the currents are those of a single shunt.
    #[inline(always)]
    pub(crate) fn single_shunt(&self) -> bool {
        #[cfg(feature = "shunt")]
        return self.shunt.is_some();
        #[cfg(not(feature = "shunt"))]
        false
    }

    /// Whether the duties are updated at both extremes of the carrier.
    #[inline(always)]
    pub(crate) fn double_update(&self) -> bool {
        #[cfg(feature = "modes")]
        return self.double_update;
        #[cfg(not(feature = "modes"))]
        false
    }

    /// Square of the voltage, over the dc link, from which a leg is held at a rail.
    #[inline(always)]
    pub(crate) fn discontinuous_sq(&self) -> Option<R> {
        #[cfg(feature = "modes")]
        return self.discontinuous_sq;
        #[cfg(not(feature = "modes"))]
        None
    }

    /// Magnetising current of the start-up: boosted until the flux has built up, then held.
    pub(crate) fn magnetising_current(&self, stage: u32) -> Dq<R> {
        let i_d = self.flux_control.no_load(self.flux_control.psi_rated);
        Dq::new(if stage < self.boost_periods { self.boosted(i_d) } else { i_d }, R::ZERO)
    }

    /// The magnetising current, boosted as far as the largest current allows.
    fn boosted(&self, i_d: R) -> R {
        (i_d * R::from_f64(BOOST)).min(self.i_quick.max(i_d))
    }

    /// Per-unit configuration of validated settings.
    ///
    /// # Errors
    /// The first field of machine, inverter or settings outside its admissible range.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn new(machine: &Machine, inverter: &Inverter, p: &DriveParams) -> Result<Self, ParamError> {
        let pu = PerUnit::new(machine, inverter)?;
        p.scheme.check()?;
        p.validate(machine, inverter)?;
        let PerUnit { base: b, t_s, l_s, sigma_l_s, tau_r, .. } = pu;
        let r = rounded::<R>;
        let periods = |t: f64| inverter.periods(t);

        let slow_periods = settings::slow_periods(inverter);
        let (speed_periods, adapt_periods) =
            (settings::speed_periods(p.scheme, slow_periods), settings::adapt_periods(slow_periods));
        let [t_speed, t_slow, t_adapt] = [speed_periods, slow_periods, adapt_periods].map(|n| t_s * f64::from(n));
        let supervised = |t: f64| periods(t / f64::from(SUPERVISION_PERIODS));
        #[cfg(feature = "supervision")]
        let watched = |t: f64| if p.supervision { supervised(t).max(2) } else { u32::MAX };
        let l_product = l_s * sigma_l_s;
        let i_0 = p.psi_ref / l_s;
        let i_max = p.i_max / b.i;
        let i_q_max = libm::sqrt(i_max * i_max - i_0 * i_0);
        let i_trip = p.i_trip / b.i;
        // The highest code of a 12-bit converter is a 2048th below full scale.
        let i_range = (1.0 - 1.0 / 512.0) * p.i_range / b.i;
        // Readings are within their range if the currents are, less the largest offset taken off them.
        let plain = (i_range - I_OFF_MAX).max(0.0);

        let (torque_least, torque_most) = p.torque_limits.unwrap_or((-p.torque_max, p.torque_max));
        let (omega_least, omega_most) = p.speed_limits.unwrap_or((-p.omega_max, p.omega_max));
        let torque_max = torque_most.max(-torque_least) / b.torque;
        let slow = f64::from(slow_periods) / inverter.f_c();

        let k_p = pu.hz(p.current_bandwidth) * sigma_l_s;
        let (u_limit, u_use) =
            if p.overmodulation { (U_REACH, U_OVERMODULATED) } else { (U_UTILISATION, U_UTILISATION) };
        // A single shunt takes its window from the middle duty.
        let window = p.window(inverter);
        let (u_limit, u_use) = (u_limit * (1.0 - window), u_use * (1.0 - window));
        let u_max = u_use * pu.u_dc;
        let flux_gain = pu.hz(p.flux_bandwidth) / l_s;
        let speed_gain = pu.j * pu.hz(p.speed_bandwidth);
        let omega_n = pu.hz(p.pll_bandwidth);
        let magnetise_periods = periods(p.build_up_time(machine));
        // Flux reaches its final value under the boosted current after τ_r ln(B/(B-1)), or nearly so after three τ_r.
        let boost = p.boost(machine);
        let boost_time = tau_r / b.omega * libm::log(boost / (boost - 1.0));

        let inv_two_l_product = 0.5 / l_product;
        let k_i = t_s * k_p * pu.hz(p.current_bandwidth) / 5.0;
        let speed_k_i = t_slow * speed_gain * pu.hz(p.speed_bandwidth) / 4.0;
        fits::<R>("J", machine.J, "kg m^2", speed_gain, 1.0)?;
        fits::<R>("speed_bandwidth", p.speed_bandwidth, "Hz", speed_k_i, 2.0)?;
        fits::<R>("flux_bandwidth", p.flux_bandwidth, "Hz", flux_gain * tau_r, 1.0)?;
        fits::<R>("flux_bandwidth", p.flux_bandwidth, "Hz", t_slow * flux_gain, 1.0)?;
        fits::<R>("current_bandwidth", p.current_bandwidth, "Hz", 1.0 / k_p, -1.0)?;
        fits::<R>("current_bandwidth", p.current_bandwidth, "Hz", k_i, 2.0)?;
        fits::<R>("current_bandwidth", p.current_bandwidth, "Hz", k_p, 1.0)?;
        fits::<R>("pll_bandwidth", p.pll_bandwidth, "Hz", 2.0 * omega_n, 1.0)?;
        fits::<R>("pll_bandwidth", p.pll_bandwidth, "Hz", t_speed * omega_n * omega_n, 2.0)?;
        #[cfg(feature = "enhanced")]
        if p.scheme == Scheme::Enhanced {
            FilterConfig::<R>::check(machine, inverter)?;
        }
        // Root of the radicand of (12), in the enhanced scheme at half of the leakage.
        let root = p.psi_ref * if p.scheme == Scheme::Enhanced { l_s + l_s - sigma_l_s } else { l_s - sigma_l_s };
        fits::<R>("L_M", machine.L_M, "H", (root * root).max(pu.l_m * pu.l_m), 2.0)?;
        fits::<R>("L_sigma", machine.L_sigma, "H", 4.0 * l_product * l_product, 4.0)?;
        fits::<R>("L_sigma", machine.L_sigma, "H", inv_two_l_product, -1.0)?;
        fits::<R>("i_max", p.i_max, "A", 1.0 / (0.9 * i_q_max * p.psi_ref), -1.0)?;
        let ramp_acceleration = slow * ramp::CALLS / b.omega_m;
        let ramp_jerk = slow * ramp_acceleration;
        for (field, value, unit, factor) in
            [("acceleration", p.acceleration, "rad/s²", ramp_acceleration), ("jerk", p.jerk, "rad/s³", ramp_jerk)]
        {
            if let Some(value) = value {
                fits::<R>(field, value, unit, value * factor, 1.0)?;
            }
        }
        for (field, body) in [("machine_overload[0]", p.machine_overload), ("bridge_overload[0]", p.bridge_overload)] {
            if let Some((current, _)) = body {
                fits::<R>(field, current, "A", 0.5 * b.i * b.i / (current * current), -2.0)?;
            }
        }
        if p.current_sensors == 1 {
            fits::<R>("f_s", inverter.f_s, "Hz", b.omega / inverter.f_s * pu.u_dc / sigma_l_s, -1.0)?;
        }
        if let Some((on, full)) = p.u_dc_chopper {
            check("u_dc_chopper[1]", full, on + b.u / R::LARGEST, p.u_dc_max, "V")
                .map_err(|e| e.with_note("a gain that follows from it must fit the arithmetic"))?;
        }
        fits::<R>("offset_time", p.offset_time, "s", 1.0 / f64::from(periods(p.offset_time)), -1.0)?;
        #[cfg(feature = "paper")]
        if p.scheme == Scheme::Paper {
            fits::<R>("R_s", machine.R_s, "ohm", 1.0 / pu.r_s, -1.0)?;
        }

        let config = Self {
            t_s: r(t_s),
            slow_mask: slow_periods - 1,
            inverter: if p.inverter_model { InverterModel::new(&pu) } else { InverterModel::ideal() },
            timer: inverter.timer()?,
            #[cfg(feature = "modes")]
            double_update: pu.double_update,
            #[cfg(feature = "modes")]
            discontinuous_sq: p.discontinuous_above.map(|part| r(part * part / 3.0)),
            scheme: p.scheme,
            #[cfg(feature = "paper")]
            paper: PaperConfig::new(&pu, inverter, p, magnetise_periods),
            #[cfg(feature = "enhanced")]
            enhanced: EnhancedConfig::new(machine, inverter, &pu, p, i_q_max),
            speed: SpeedConfig {
                t_s: r(t_speed),
                sigma_l_s: r(sigma_l_s),
                r_r: r(pu.r_r),
                k_p: r(2.0 * omega_n),
                k_i: r(t_speed * omega_n * omega_n),
            },
            current: CurrentConfig { k_p: r(k_p), k_i: r(k_i), inv_k_p: r(1.0 / k_p) },
            flux_control: FluxControlConfig {
                psi_rated: r(p.psi_ref),
                inv_psi_rated: r(1.0 / p.psi_ref),
                l_sum: r(l_s + sigma_l_s),
                l_difference: r(l_s - sigma_l_s),
                root_i_q: r(4.0 * l_product * l_product),
                inv_two_l_product: r(inv_two_l_product),
                k_p: r(flux_gain * tau_r),
                k_i: r(t_slow * flux_gain),
                limit: r(if p.scheme == Scheme::Enhanced { 1.0 } else { 0.3 } * i_0),
                limit_high: r((LIMIT_HIGH * i_0).min(100.0)),
                k_p_weak: r((WEAK_GAIN / sigma_l_s).min(100.0)),
                k_i_weak: r((t_slow * WEAK_RATE * pu.hz(p.current_bandwidth) / sigma_l_s).min(100.0)),
            },
            weakening: WeakeningConfig {
                psi_rated: r(p.psi_ref),
                psi_min: r(if p.field_weakening { 0.2 } else { 1.0 } * p.psi_ref),
                // |ψ_s|/|ψ_R| is l_s/l_M/cos δ with the load angle δ; sin 2δ = 0.8 at 80 % of pull-out.
                resistance: r(pu.r_s + pu.r_r * (l_s / pu.l_m) * (l_s / pu.l_m) / 0.8),
                k: r(t_adapt * pu.hz(p.flux_bandwidth) / 2.0),
                inv_u_max_sq: r((1.0 / (u_max * u_max)).min(100.0)),
            },
            speed_control: SpeedControlConfig {
                k_p: r(speed_gain),
                k_i: r(speed_k_i),
                inv_gain: r((SPEED_GAIN * pu.hz(p.current_bandwidth) / speed_gain).min(100.0)),
                torque_max: r(torque_max),
                torque_pos: r(torque_most / b.torque),
                torque_neg: r(-torque_least / b.torque),
            },
            supervision: SupervisionConfig {
                plausibility: PlausibilityConfig {
                    psi_deviation: r(0.4 * p.psi_ref),
                    omega_max: r(1.3 * p.omega_max / b.omega_m),
                    calls: supervised(0.05),
                    confidence: p.low_confidence == LowConfidence::Fault,
                },
                #[cfg(feature = "supervision")]
                phases: PhaseConfig {
                    floor_sq: r(0.05 * 0.05),
                    small_floor_sq: r(0.02 * 0.02),
                    calls_open: watched(0.004),
                    calls_control: watched(0.25),
                    calls_zero: watched(0.004),
                    t_s: r(t_s * f64::from(SUPERVISION_PERIODS)),
                },
                #[cfg(feature = "supervision")]
                channels: ChannelConfig {
                    limit: r(0.05 * i_range + 0.08),
                    // A computed current makes the sum zero.
                    calls: if p.current_sensors < 3 { u32::MAX } else { watched(0.004) },
                },
                #[cfg(feature = "supervision")]
                innovation: {
                    let seconds = f64::from(SUPERVISION_PERIODS) / inverter.f_c();
                    let gain = |h: f64| r(if p.supervision { seconds / h } else { 0.0 });
                    let falling = (FLUX_FALLS * tau_r / b.omega).max(FLUX_FALLS_LEAST);
                    InnovationConfig { gain: gain(LOST_FIELD), gain_falling: gain(falling) }
                },
                #[cfg(feature = "supervision")]
                stall_calls: if p.stall_time > 0.0 { watched(p.stall_time) } else { u32::MAX },
            },
            low_confidence: p.low_confidence,
            t_ahead: r(1.5 * t_s),
            part_ahead: r((1.5 * t_s * pu.hz(p.current_bandwidth)).min(1.0)),
            i_range: r(i_range),
            i_plain_sq: r((plain * plain).min(1.5 * i_trip * i_trip).min(100.0)),
            i_trip: r(i_trip),
            i_max_sq: r((i_max * i_max).min(100.0)),
            // Leaves a quarter of the current to the torque.
            i_d_max: r(libm::sqrt(15.0 / 16.0) * i_max),
            i_q_max: r(i_q_max),
            pull_out_use: r(0.8 * (1.0 - sigma_l_s / l_s) / (2.0 * sigma_l_s)),
            u_limit: r(u_limit),
            u_use: r(u_use),
            u_dc_min: r((p.u_dc_min / b.u).max(U_DC_LEAST)),
            u_dc_max: r(p.u_dc_max / b.u),
            omega_least: r(omega_least / b.omega_m),
            omega_most: r(omega_most / b.omega_m),
            ramp: RampConfig {
                acceleration: r(p.acceleration.map_or(0.0, |a| a * ramp_acceleration)),
                jerk: r(p.jerk.map_or(0.0, |j| j * ramp_jerk)),
                // Twice the deviation at which the proportional part alone asks for the largest torque.
                lead: r((2.0 * torque_max / speed_gain).min(1.0)),
            },
            overload: [p.machine_overload, p.bridge_overload].map(|body| {
                let (i_c_sq, rate) = body.map_or((1.0, 0.0), |(current, time)| {
                    let interval = f64::from(adapt_periods * overload::CALLS) / inverter.f_c();
                    (2.0 * current * current / (b.i * b.i), interval / time)
                });
                OverloadConfig { i_c_sq: r(i_c_sq), inv_i_c_sq: r(1.0 / i_c_sq), rate: r(rate) }
            }),
            #[cfg(feature = "supervision")]
            realign: {
                let calls = |t: f64| periods(t / f64::from(slow_periods));
                RealignConfig {
                    suspicion: if p.realignment { calls(REALIGN) } else { u32::MAX },
                    test: match p.scheme {
                        Scheme::Paper => 0,
                        Scheme::Enhanced => calls((REALIGN_TEST * tau_r / b.omega).max(REALIGN)),
                    },
                    low_pass: r((slow / REALIGN_LOW_PASS).min(1.0)),
                }
            },
            #[cfg(feature = "dclink")]
            dclink: {
                let u = |volts: Option<f64>, without: f64| volts.map_or(without, |u| u / b.u);
                let (on, full) = p.u_dc_chopper.map_or((100.0, 101.0), |(on, full)| (on / b.u, full / b.u));
                DcLinkConfig {
                    // Beyond what is ever measured where they are not set.
                    u_brake: r(u(p.u_dc_brake, 100.0)),
                    u_buffer: r(u(p.u_dc_buffer, -100.0)),
                    inv_width: r((1.0 / (dclink::WIDTH * pu.u_dc)).min(100.0)),
                    u_on: r(on),
                    inv_span: r(1.0 / (full - on)),
                }
            },
            #[cfg(feature = "encoder")]
            encoder: (p.encoder_lines > 0).then(|| EncoderConfig::new(p.encoder_lines, machine.n_p, p.encoder_states)),
            #[cfg(feature = "encoder")]
            hand_over: {
                // The ripple of one count ([`crate::estimate::encoder`]).
                let ripple = count_angle(p.encoder_lines.max(1), machine.n_p) * omega_n / core::f64::consts::E;
                let calls = |t: f64| periods(t / f64::from(speed_periods));
                HandOverConfig {
                    band: r((p.encoder_deviation / b.omega_m + ripple).min(100.0)),
                    gain: r(f64::from(speed_periods) / inverter.f_c() / handover::FILTER),
                    calls_apart: calls(handover::APART),
                    calls_return: calls(handover::RETURN),
                    control: p.encoder_mode == EncoderMode::Control,
                    fault: p.encoder_fault,
                }
            },
            fresh_periods: if p.fresh_time > 0.0 { periods(p.fresh_time) } else { 0 },
            i_quick: r(QUICK * i_max),
            bridged_periods: periods(0.01),
            calibrate_offset: p.calibrate_offset,
            #[cfg(feature = "modes")]
            two_sensors: p.current_sensors == 2,
            #[cfg(feature = "shunt")]
            shunt: (p.current_sensors == 1).then(|| {
                ShuntConfig::new(
                    (window, 2.0 * p.shunt_settling * inverter.f_s),
                    b.omega / inverter.f_s / (2.0 * sigma_l_s),
                    pu.u_dc,
                )
            }),
            offset_periods: periods(p.offset_time),
            inv_offset_periods: r(1.0 / f64::from(periods(p.offset_time))),
            magnetise_periods,
            boost_periods: periods(boost_time),
        };
        // The checks above name their field; this one holds for every constant.
        if config.is_representable() {
            Ok(config)
        } else {
            let (value, max) = (f64::INFINITY, R::LARGEST);
            let note = "a per-unit constant of the configuration is beyond the range of the arithmetic";
            Err(ParamError { field: "configuration", value, min: -max, max, unit: "p.u.", note })
        }
    }
}

/// Checks that the arithmetic `R` holds a constant `x`, which is proportional to this power of a field (or grows with
/// at least this power).
fn fits<R: Real>(field: &'static str, value: f64, unit: &'static str, x: f64, power: f64) -> Result<(), ParamError> {
    let at = |limit: f64| value * libm::pow(limit / x, 1.0 / power);
    let (a, b) = (at(R::LEAST_GAIN), at(R::LARGEST));
    check(field, value, a.min(b), a.max(b), unit)
        .map_err(|e| e.with_note("a gain that follows from it must fit the arithmetic"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Q;

    #[test]
    fn the_modulator_leaves_the_nearest_voltage_of_the_hexagon_with_the_fundamental_that_is_counted_on() {
        use crate::control::modulator::{applied, modulate};
        use crate::space::AlphaBeta;
        let steps = 3600;
        let (mut along, mut farthest) = (0.0, 0.0f64);
        for k in 0..steps {
            let (sin, cos) = libm::sincos(f64::from(k) * core::f64::consts::TAU / f64::from(steps));
            let u = AlphaBeta::new(U_REACH * cos, U_REACH * sin);
            let left = applied(&modulate(u.to_phases(), 1.0, None));
            along += (left.re() * cos + left.im() * sin) / f64::from(steps);
            // The edge that faces the reference is at right angles to what is cut off.
            let cut = u - left;
            let length = cut.norm_sq().sqrt();
            if length > 1e-9 {
                farthest = farthest.max(length);
                let distance = (left.re() * cut.re() + left.im() * cut.im()) / length;
                assert!((distance - 1.0 / 3f64.sqrt()).abs() < 1e-9, "{k}: {distance}");
            }
        }
        assert!((along - 0.6007).abs() < 1e-4 && along > U_OVERMODULATED, "{along}");
        assert!((farthest - (U_REACH - 1.0 / 3f64.sqrt())).abs() < 1e-4, "{farthest}");
    }

    #[test]
    fn a_scheme_that_is_not_built_is_refused_by_name() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        for scheme in [Scheme::Paper, Scheme::Enhanced] {
            let params = DriveParams { scheme, ..DriveParams::new(&machine, &inverter) };
            match DriveConfig::<f32>::new(&machine, &inverter, &params) {
                Ok(_) => assert!(Scheme::ALL.contains(&scheme)),
                Err(e) => assert!(e.field == "scheme" && !Scheme::ALL.contains(&scheme), "{e}"),
            }
        }
        assert!(Scheme::ALL.contains(&Scheme::default()));
    }

    /// What the arithmetic `R` says of a change to the presets.
    fn refused<R: Real>(change: impl Fn(&mut Machine, &mut Inverter, &mut DriveParams)) -> Option<ParamError> {
        let (mut machine, mut inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        // Twice: the defaults of the settings are those of the changed machine.
        let mut params = DriveParams::new(&machine, &inverter);
        change(&mut machine, &mut inverter, &mut params);
        let mut params = DriveParams::new(&machine, &inverter);
        change(&mut machine, &mut inverter, &mut params);
        DriveConfig::<R>::new(&machine, &inverter, &params).err()
    }

    #[test]
    fn what_its_arithmetic_cannot_hold_is_refused_by_name_with_the_range_that_it_can() {
        // 25 times the inertia, a speed gain of 151: beyond fixed point, nothing special in floating point.
        let heavy = |factor: f64| move |m: &mut Machine, _: &mut Inverter, _: &mut DriveParams| m.J = 0.015 * factor;
        assert_eq!(refused::<f32>(heavy(25.0)), None);
        assert_eq!(refused::<Q>(heavy(10.0)), None);
        let e = refused::<Q>(heavy(25.0)).unwrap();
        assert!(e.field == "J" && e.max > 0.015 * 20.0 && e.max < 0.015 * 25.0, "{e}");
        assert_eq!(refused::<Q>(heavy(0.999 * e.max / 0.015)), None, "the range is the admissible one");
        let e = refused::<Q>(|_, i, p| {
            i.f_s = 40e3;
            p.speed_bandwidth = 0.05;
        });
        assert_eq!(e.map(|e| e.field), Some("speed_bandwidth"), "an integral gain of less than one bit");
    }

    #[test]
    fn a_rating_that_does_not_belong_to_the_machine_is_refused_by_name_in_every_arithmetic() {
        fn everywhere(field: &str, change: impl Fn(&mut Machine, &mut Inverter, &mut DriveParams)) {
            for e in [refused::<f32>(&change), refused::<f64>(&change), refused::<Q>(&change)] {
                let e = e.unwrap();
                assert!(e.field == field && !(e.min..=e.max).contains(&e.value), "{field}: {e}");
            }
        }
        // 1 V on a dc link of 80 V, with impedances to match.
        everywhere("U_N", |m, i, _| {
            (m.R_s, m.R_R, m.L_sigma, m.L_M) = (0.008, 0.004, 5e-5, 5e-4);
            (m.U_N, m.T_N, i.r_d, i.u_dc, i.u_th) = (1.0, 0.03, 0.0, 80.0, 0.0);
            m.J = 1e-4;
            m.saturation = None;
        });
        // 1664 Hz at 1469 periods a second.
        everywhere("f_s", |m, i, _| {
            (m.L_sigma, m.L_M) = (6.3e-4, 6.73e-3);
            (m.J, m.T_N, m.f_N, m.saturation) = (1e-4, 0.5, 1664.0, None);
            i.f_s = 1469.0;
            (i.dead_time, i.c_out) = (0.0, 0.0);
        });
        everywhere("L_M", |m, _, _| (m.L_M, m.L_sigma) = (5.0, 0.1));
        everywhere("f_clk", |_, i, _| i.f_clk = 1e5);
    }

    #[test]
    fn an_encoder_that_does_not_fit_is_refused_by_name() {
        let with = |change: fn(&mut DriveParams)| {
            refused::<Q>(move |_, _, p| {
                p.encoder_lines = 1024;
                change(p);
            })
        };
        if !cfg!(feature = "encoder") {
            for e in [with(|_| {}), refused::<Q>(|_, _, p| p.encoder_fault = true)] {
                assert!(e.is_some_and(|e| e.field == "encoder_lines" && e.note.contains("feature")), "{e:?}");
            }
            return;
        }
        assert_eq!(with(|_| {}), None);
        assert_eq!(with(|p| (p.encoder_lines, p.encoder_states) = (65_536, 1 << 18)), None, "reset at each turn");
        for (field, e) in [
            ("encoder_lines", with(|p| p.encoder_lines = 31)),
            ("encoder_lines", with(|p| p.encoder_lines = 65_537)),
            ("encoder_states", with(|p| p.encoder_states = 500)),
            ("encoder_states", with(|p| p.encoder_states = u32::MAX)),
            ("encoder_deviation", with(|p| p.encoder_deviation = 0.0)),
            ("encoder_deviation", with(|p| p.encoder_deviation = f64::NAN)),
            ("encoder_lines", refused::<Q>(|_, _, p| p.encoder_mode = EncoderMode::Control)),
            ("encoder_lines", refused::<Q>(|_, _, p| p.encoder_fault = true)),
        ] {
            assert!(e.as_ref().is_some_and(|e| e.field == field), "{field}: {e:?}");
        }
    }

    #[test]
    fn a_setting_of_the_other_scheme_is_refused_by_name() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let defaults = DriveParams::new(&machine, &inverter);
        let paper = PaperParams { noise_gain: (0.06, 0.4), ..defaults.paper };
        let enhanced = EnhancedParams { identify_resistance: false, ..defaults.enhanced };
        for (changed, own, field, other) in [
            (DriveParams { paper, ..defaults }, Scheme::Paper, "noise_gain[1]", Scheme::Enhanced),
            (DriveParams { enhanced, ..defaults }, Scheme::Enhanced, "identify_resistance", Scheme::Paper),
        ] {
            assert_eq!(DriveParams { scheme: own, ..changed }.validate(&machine, &inverter), Ok(()));
            let e = DriveParams { scheme: other, ..changed }.validate(&machine, &inverter).unwrap_err();
            assert!(e.field == field && e.note.contains("scheme"), "{e}");
        }
    }
}
