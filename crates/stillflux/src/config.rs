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
use settings::BOOST;

pub use settings::{
    BALANCE_PERIODS, DriveParams, EnhancedParams, LowConfidence, PaperParams, SLOW_PERIODS, SPEED_PERIODS, Scheme,
};

use crate::base::{PerUnit, rounded};
use crate::control::current::CurrentConfig;
use crate::control::flux::FluxControlConfig;
#[cfg(feature = "enhanced")]
use crate::control::shift::ShiftConfig;
use crate::control::speed::SpeedControlConfig;
#[cfg(feature = "enhanced")]
use crate::estimate::balance::BalanceConfig;
#[cfg(feature = "paper")]
use crate::estimate::confidence::ConfidenceConfig;
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
use crate::words::words;
#[cfg(feature = "enhanced")]
pub(crate) use enhanced::EnhancedConfig;
#[cfg(feature = "paper")]
pub(crate) use paper::PaperConfig;

/// Largest offset of a current channel at rest, per unit.
pub(crate) const I_OFF_MAX: f64 = 0.15;

/// Constants of the control step, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct DriveConfig<R: Real> {
    pub(crate) t_s: R,
    pub(crate) inverter: InverterModel<R>,
    pub(crate) timer: Option<Timer>,
    pub(crate) scheme: Scheme,
    #[cfg(feature = "paper")]
    pub(crate) paper: PaperConfig<R>,
    #[cfg(feature = "enhanced")]
    pub(crate) enhanced: EnhancedConfig<R>,
    pub(crate) speed: SpeedConfig<R>,
    pub(crate) current: CurrentConfig<R>,
    pub(crate) flux_control: FluxControlConfig<R>,
    pub(crate) speed_control: SpeedControlConfig<R>,
    pub(crate) low_confidence: LowConfidence,
    /// From a sample to the middle of the period in which its duties act.
    pub(crate) t_ahead: R,
    pub(crate) i_range: R,
    /// Sum of the squared phase currents below which neither range nor trip level can be reached.
    pub(crate) i_plain_sq: R,
    pub(crate) i_trip: R,
    pub(crate) i_q_max: R,
    pub(crate) pull_out_use: R,
    pub(crate) u_dc_min: R,
    pub(crate) u_dc_max: R,
    pub(crate) omega_max: R,
    pub(crate) omega_trip: R,
    pub(crate) psi_deviation: R,
    pub(crate) implausible_max: u32,
    pub(crate) calibrate_offset: bool,
    pub(crate) offset_periods: u32,
    pub(crate) inv_offset_periods: R,
    pub(crate) magnetise_periods: u32,
    pub(crate) boost_periods: u32,
}
words! {
    DriveConfig:
    t_s, inverter, timer, scheme,
    #[cfg(feature = "paper")] paper,
    #[cfg(feature = "enhanced")] enhanced,
    speed, current, flux_control, speed_control, low_confidence, t_ahead, i_range, i_plain_sq,
    i_trip, i_q_max, pull_out_use, u_dc_min, u_dc_max, omega_max, omega_trip, psi_deviation,
    implausible_max, calibrate_offset, offset_periods, inv_offset_periods, magnetise_periods, boost_periods,
}

impl<R: Real> DriveConfig<R> {
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

    /// Settings of the flux shift.
    #[cfg(feature = "enhanced")]
    pub fn shift_config(&self) -> &ShiftConfig<R> {
        &self.enhanced.shift
    }

    /// Settings of the fit of the current sensors' gains.
    #[cfg(feature = "enhanced")]
    pub fn balance_config(&self) -> &BalanceConfig<R> {
        &self.enhanced.balance
    }

    /// Magnetising current of the start-up: boosted until the flux has built up, then held.
    pub(crate) fn magnetising_current(&self, stage: u32) -> Dq<R> {
        let i_d = self.flux_control.feedforward(self.flux_control.psi_rated, R::ZERO);
        Dq::new(if stage < self.boost_periods { i_d * R::from_f64(BOOST) } else { i_d }, R::ZERO)
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

        let (t_speed, t_slow) = (t_s * f64::from(SPEED_PERIODS), t_s * f64::from(SLOW_PERIODS));
        let slow_periods = |t: f64| periods(t / f64::from(SLOW_PERIODS));
        let l_product = l_s * sigma_l_s;
        let i_0 = p.psi_ref / l_s;
        let i_max = p.i_max / b.i;
        let i_q_max = libm::sqrt(i_max * i_max - i_0 * i_0);
        let i_trip = p.i_trip / b.i;
        // Readings are within their range if the currents are, less the largest offset taken off them.
        let plain = (p.i_range / b.i - I_OFF_MAX).max(0.0);

        let k_p = pu.hz(p.current_bandwidth) * sigma_l_s;
        let flux_gain = pu.hz(p.flux_bandwidth) / l_s;
        let speed_gain = pu.j * pu.hz(p.speed_bandwidth);
        let omega_n = pu.hz(p.pll_bandwidth);
        let magnetise_periods = periods(p.magnetise_time);
        // Flux reaches its final value under the boosted current after τ_r ln(B/(B-1)).
        let boost_time = tau_r / b.omega * libm::log(BOOST / (BOOST - 1.0));

        Ok(Self {
            t_s: r(t_s),
            inverter: if p.inverter_model { InverterModel::new(&pu) } else { InverterModel::ideal() },
            timer: (inverter.f_clk > 0.0).then(|| Timer::new((inverter.f_clk / (2.0 * inverter.f_s)) as u32)),
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
            current: CurrentConfig {
                k_p: r(k_p),
                k_i: r(t_s * k_p * pu.hz(p.current_bandwidth) / 5.0),
                inv_k_p: r(1.0 / k_p),
            },
            flux_control: FluxControlConfig {
                psi_rated: r(p.psi_ref),
                inv_psi_rated: r(1.0 / p.psi_ref),
                psi_min: r(0.2 * p.psi_ref),
                l_sum: r(l_s + sigma_l_s),
                root_psi: r((l_s - sigma_l_s) * (l_s - sigma_l_s)),
                root_i_q: r(4.0 * l_product * l_product),
                inv_two_l_product: r(0.5 / l_product),
                k_p: r(flux_gain * tau_r),
                k_i: r(t_slow * flux_gain),
                limit: r(if p.scheme == Scheme::Enhanced { 1.0 } else { 0.3 } * i_0),
            },
            speed_control: SpeedControlConfig {
                k_p: r(speed_gain),
                k_i: r(t_slow * speed_gain * pu.hz(p.speed_bandwidth) / 4.0),
                torque_max: r(p.torque_max / b.torque),
            },
            low_confidence: p.low_confidence,
            t_ahead: r(1.5 * t_s),
            i_range: r(p.i_range / b.i),
            i_plain_sq: r((plain * plain).min(1.5 * i_trip * i_trip).min(100.0)),
            i_trip: r(i_trip),
            i_q_max: r(i_q_max),
            pull_out_use: r(0.8 * (1.0 - sigma_l_s / l_s) / (2.0 * sigma_l_s)),
            u_dc_min: r(p.u_dc_min / b.u),
            u_dc_max: r(p.u_dc_max / b.u),
            omega_max: r(p.omega_max / b.omega_m),
            omega_trip: r(1.3 * p.omega_max / b.omega_m),
            psi_deviation: r(0.4 * p.psi_ref),
            implausible_max: slow_periods(0.05),
            calibrate_offset: p.calibrate_offset,
            offset_periods: periods(p.offset_time),
            inv_offset_periods: r(1.0 / f64::from(periods(p.offset_time))),
            magnetise_periods,
            boost_periods: periods(boost_time),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
