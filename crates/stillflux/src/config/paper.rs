//! Configuration of the published scheme: constants of its estimators, per unit.

use super::settings::{DriveParams, SLOW_PERIODS, SPEED_PERIODS, Scheme};
use crate::base::{PerUnit, rounded};
use crate::estimate::confidence::ConfidenceConfig;
use crate::estimate::flux::FluxConfig;
use crate::estimate::offset::{OffsetConfig, U_OFF_MAX, longest_window};
use crate::estimate::resistance::ResistanceConfig;
use crate::params::Inverter;
use crate::scalar::Real;
use crate::words::words;

/// Settings of the estimators.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct PaperConfig<R: Real> {
    pub flux: FluxConfig<R>,
    pub resistance: Option<ResistanceConfig<R>>,
    pub confidence: ConfidenceConfig<R>,
    /// Resistance of the nameplate, and its reciprocal.
    pub r_s: R,
    pub inv_r_s: R,
    /// Periods over which the magnetisation reads `r̂_s`, and their reciprocal.
    pub r_s_periods: u32,
    pub inv_r_s_periods: R,
}
words!(PaperConfig: flux, resistance, confidence, r_s, inv_r_s, r_s_periods, inv_r_s_periods);

impl<R: Real> PaperConfig<R> {
    /// Settings for validated parameters and a magnetisation of so many periods.
    pub fn new(pu: &PerUnit, inverter: &Inverter, p: &DriveParams, magnetise_periods: u32) -> Self {
        let r = rounded::<R>;
        let t_s = pu.t_s;
        let (t_speed, t_slow) = (t_s * f64::from(SPEED_PERIODS), t_s * f64::from(SLOW_PERIODS));
        let noise = if p.paper.noise_compensator { p.paper.noise_gain } else { (0.0, 0.0) };
        let r_s_periods = magnetise_periods / 4;
        let offset = OffsetConfig {
            t_s: r(t_s),
            gain: r(p.paper.offset_gain),
            limit: r(U_OFF_MAX),
            hysteresis: r(0.2 * p.psi_ref),
            interval: r(t_speed),
            turn: r(t_speed / core::f64::consts::TAU),
            longest: longest_window(0.004, t_speed),
            omega_max: r(0.2),
        };
        Self {
            flux: FluxConfig {
                t_s: r(t_s),
                noise_min: r(noise.0),
                noise_max: r(noise.1),
                offset: p.paper.offset_estimator.then_some(offset),
            },
            resistance: p.paper.resistance_adaptation.then(|| ResistanceConfig {
                l_sum: r(pu.l_s + pu.sigma_l_s),
                l_product: r(pu.l_s * pu.sigma_l_s),
                gain: r(t_slow * (p.paper.resistance_gain / pu.base.omega)),
                i_q_min: r(0.15 * pu.torque_rated / p.psi_ref),
                i_q_high: r(0.6 * pu.torque_rated / p.psi_ref),
                omega_min: r(0.004),
                omega_max: r(0.1),
                transient: r(0.05),
                corner: r(t_slow * pu.hz(2.0)),
                hold: inverter.periods(0.2 / f64::from(SLOW_PERIODS)),
            }),
            confidence: ConfidenceConfig {
                t_s: r(t_slow),
                u_floor: r(1e-4 * pu.r_s + 1e-4 * pu.dead_time * pu.u_dc),
                u_initial: r(0.01 * pu.r_s),
                corner: r(t_slow * pu.hz(0.2)),
            },
            r_s: r(pu.r_s),
            // Where the scheme does not run, a resistance too small for it is none of its concern.
            inv_r_s: r(if p.scheme == Scheme::Paper { 1.0 / pu.r_s } else { (1.0 / pu.r_s).min(R::LARGEST) }),
            r_s_periods,
            inv_r_s_periods: r(1.0 / f64::from(r_s_periods)),
        }
    }
}
