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

mod conversion;
#[cfg(feature = "enhanced")]
mod enhanced;
#[cfg(feature = "paper")]
mod paper;
mod settings;
pub(crate) use settings::{BOOST, QUICK};

pub use settings::{BALANCE_PERIODS, DriveParams, EncoderMode, EnhancedParams, LowConfidence, PaperParams, Scheme};

use crate::base::{PerUnit, rounded};
use crate::control::current::CurrentConfig;
#[cfg(feature = "dclink")]
use crate::control::dclink::DcLinkConfig;
use crate::control::flux::FluxControlConfig;
#[cfg(feature = "encoder")]
use crate::control::handover::HandOverConfig;
use crate::control::overload::OverloadConfig;
use crate::control::ramp::RampConfig;
#[cfg(feature = "supervision")]
use crate::control::realign::RealignConfig;
#[cfg(feature = "shunt")]
use crate::control::shunt::ShuntConfig;
use crate::control::speed::SpeedControlConfig;
#[cfg(feature = "supervision")]
use crate::control::swing::SwingConfig;
use crate::control::weakening::WeakeningConfig;
#[cfg(feature = "enhanced")]
use crate::estimate::balance::BalanceConfig;
#[cfg(feature = "paper")]
use crate::estimate::confidence::ConfidenceConfig;
#[cfg(feature = "encoder")]
use crate::estimate::encoder::EncoderConfig;
#[cfg(feature = "paper")]
use crate::estimate::flux::FluxConfig;
#[cfg(feature = "enhanced")]
use crate::estimate::kalman::FilterConfig;
#[cfg(feature = "paper")]
use crate::estimate::resistance::ResistanceConfig;
use crate::estimate::speed::SpeedConfig;
use crate::inverter::InverterModel;
use crate::params::{Inverter, Machine, ParamError};
use crate::scalar::{Real, Timer};
use crate::space::Dq;
use crate::supervision::SupervisionConfig;
use crate::words::{Words, words};
use conversion::{Conversion, TO_PULL_OUT};
#[cfg(feature = "enhanced")]
pub(crate) use enhanced::EnhancedConfig;
#[cfg(feature = "paper")]
pub(crate) use paper::{PaperConfig, r_s_periods};

/// Largest offset of a current channel at rest, per unit.
pub(crate) const I_OFF_MAX: f64 = 0.15;

/// Stator frequency, in units of the bandwidth of current control, from which the inverter model takes the current itself.
/// An error of the flux estimate that stands in the stator makes the current's reference swing with the stator frequency, and
/// the current follows the reference with a deviation of this part.
const APART: f64 = 0.1;

/// Time within which a second sample that cannot be used is a fault, s; the first is bridged.
const BRIDGED: f64 = 0.01;

/// Least dc-link voltage of a bridge that switches, per unit: its reciprocal is computed without a check.
const U_DC_LEAST: f64 = 1.0 / 32.0;

/// Constants of the control step, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct DriveConfig<R: Real> {
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
    /// Stator frequency from which the inverter model takes the current in place of its reference.
    pub(crate) omega_apart: R,
    pub(crate) i_range: R,
    /// Sum of the squared phase currents below which neither range nor trip level can be reached.
    pub(crate) i_plain_sq: R,
    pub(crate) i_trip: R,
    /// Square of the largest current, and the largest torque current.
    pub(crate) i_max_sq: R,
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
    #[cfg(feature = "supervision")]
    pub(crate) swing: SwingConfig<R>,
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
    slow_mask, inverter, timer,
    #[cfg(feature = "modes")] double_update,
    #[cfg(feature = "modes")] discontinuous_sq,
    scheme,
    #[cfg(feature = "paper")] paper,
    #[cfg(feature = "enhanced")] enhanced,
    speed, current, flux_control, weakening, speed_control, supervision, low_confidence, t_ahead, part_ahead, omega_apart, i_range, i_plain_sq,
    i_trip, i_max_sq, i_q_max, pull_out_use, u_limit, u_use, u_dc_min, u_dc_max, omega_least, omega_most, ramp, overload,
    #[cfg(feature = "supervision")] realign,
    #[cfg(feature = "supervision")] swing,
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
    #[cfg(feature = "modes")]
    #[inline(always)]
    pub(crate) fn double_update(&self) -> bool {
        self.double_update
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
    pub fn new(machine: &Machine, inverter: &Inverter, p: &DriveParams) -> Result<Self, ParamError> {
        let pu = PerUnit::new(machine, inverter)?;
        p.scheme.check()?;
        p.validate(machine, inverter)?;
        let x = Conversion::new(machine, inverter, p, &pu);
        x.check::<R>()?;
        let b = pu.base;
        let r = rounded::<R>;
        let (omega_least, omega_most) = p.speed_limits.unwrap_or((-p.omega_max, p.omega_max));
        // Readings are within their range if the currents are, less the largest offset taken off them.
        let plain = (x.i_range - I_OFF_MAX).max(0.0);
        let magnetise_periods = x.periods(p.build_up_time(machine));

        let (flux_control, speed_control) = (x.flux_control(), x.speed_control());
        let config = Self {
            slow_mask: x.slow_periods - 1,
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
            enhanced: EnhancedConfig::new(machine, inverter, &pu, p, x.i_q_max),
            speed: x.speed(),
            current: x.current(),
            flux_control,
            weakening: x.weakening(),
            speed_control,
            supervision: x.supervision(),
            low_confidence: p.low_confidence,
            t_ahead: r(1.5 * pu.t_s),
            part_ahead: r((1.5 * pu.t_s * pu.hz(p.current_bandwidth)).min(1.0)),
            omega_apart: r((APART * pu.hz(p.current_bandwidth)).min(10.0)),
            i_range: r(x.i_range),
            i_plain_sq: r((plain * plain).min(1.5 * x.i_trip * x.i_trip).min(100.0)),
            i_trip: r(x.i_trip),
            i_max_sq: r((x.i_max * x.i_max).min(100.0)),
            i_q_max: r(x.i_q_max),
            pull_out_use: r(pu.pull_out(TO_PULL_OUT)),
            u_limit: r(x.u_limit),
            u_use: r(x.u_use),
            u_dc_min: r((p.u_dc_min / b.u).max(U_DC_LEAST)),
            u_dc_max: r(p.u_dc_max / b.u),
            omega_least: r(omega_least / b.omega_m),
            omega_most: r(omega_most / b.omega_m),
            ramp: x.ramp(),
            overload: x.overload(),
            #[cfg(feature = "supervision")]
            realign: x.realign(),
            #[cfg(feature = "supervision")]
            swing: x.swing(),
            #[cfg(feature = "dclink")]
            dclink: x.dclink(),
            #[cfg(feature = "encoder")]
            encoder: (p.encoder_lines > 0).then(|| EncoderConfig::new(p.encoder_lines, machine.n_p, p.encoder_states)),
            #[cfg(feature = "encoder")]
            hand_over: x.hand_over(),
            fresh_periods: if p.fresh_time > 0.0 { x.periods(p.fresh_time) } else { 0 },
            i_quick: r(QUICK * x.i_max),
            bridged_periods: x.periods(BRIDGED),
            calibrate_offset: p.calibrate_offset,
            #[cfg(feature = "modes")]
            two_sensors: p.current_sensors == 2,
            #[cfg(feature = "shunt")]
            shunt: x.shunt(),
            offset_periods: x.periods(p.offset_time),
            inv_offset_periods: r(1.0 / f64::from(x.periods(p.offset_time))),
            magnetise_periods,
            boost_periods: x.periods(x.boost_time()),
        };
        // The checks name their field; this one holds for every constant.
        if config.is_representable() {
            Ok(config)
        } else {
            let (value, max) = (f64::INFINITY, R::LARGEST);
            let note = "a per-unit constant of the configuration is beyond the range of the arithmetic";
            Err(ParamError { field: "configuration", value, min: -max, max, unit: "p.u.", note })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Q;

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
        // 25 times the inertia with 9 Hz, a speed gain of 151: beyond fixed point, nothing special in floating point.
        let heavy = |factor: f64| {
            move |m: &mut Machine, _: &mut Inverter, p: &mut DriveParams| {
                m.J = 0.015 * factor;
                p.speed_bandwidth = 9.0;
            }
        };
        assert_eq!(refused::<f32>(heavy(25.0)), None);
        assert_eq!(refused::<Q>(heavy(10.0)), None);
        let e = refused::<Q>(heavy(25.0)).unwrap();
        assert!(e.field == "J" && e.max > 0.015 * 20.0 && e.max < 0.015 * 25.0, "{e}");
        assert_eq!(refused::<Q>(heavy(0.999 * e.max / 0.015)), None, "the range is the admissible one");
        let by_default = |m: &mut Machine, _: &mut Inverter, _: &mut DriveParams| m.J = 0.015 * 1000.0;
        assert_eq!(refused::<Q>(by_default), None, "the default gain does not grow with the inertia");
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
    fn a_setting_whose_feature_is_left_out_is_refused_by_name() {
        fn with(field: &str, built: bool, change: impl Fn(&mut DriveParams)) {
            match refused::<Q>(|_, _, p| change(p)) {
                None => assert!(built, "{field}"),
                Some(e) => assert!(!built && e.field == field && e.note.contains("feature"), "{e}"),
            }
        }
        with("field_weakening", cfg!(feature = "weakening"), |p| p.field_weakening = true);
        with("acceleration", cfg!(feature = "ramp"), |p| p.acceleration = Some(100.0));
        with("machine_overload[0]", cfg!(feature = "derating"), |p| p.machine_overload = Some((5.0, 60.0)));
        with("bridge_overload[0]", cfg!(feature = "derating"), |p| p.bridge_overload = Some((5.0, 60.0)));
        assert_eq!(refused::<Q>(|_, _, _| {}), None, "no default needs what is left out");
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
