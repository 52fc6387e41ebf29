//! Configuration of the published scheme: constants of its estimators, per unit.

use super::settings::{DriveParams, Scheme, adapt_periods, slow_periods, speed_periods};
use crate::base::{PerUnit, rounded};
use crate::estimate::confidence::ConfidenceConfig;
use crate::estimate::flux::FluxConfig;
#[cfg(feature = "variants")]
use crate::estimate::light_load::LightLoadConfig;
use crate::estimate::offset::{OFFSET_PERIODS, OffsetConfig, U_OFF_MAX, longest_window};
use crate::estimate::resistance::ResistanceConfig;
use crate::params::Inverter;
use crate::scalar::Real;
use crate::words::words;

/// Corner frequency of the low-pass in the effort of the noise compensator, Hz.
const LOW_PASS: f64 = 0.2;
/// The same in the slip of regeneration.
const LOW_PASS_SLIP: f64 = 10.0;

/// Periods over which a magnetisation of so many reads `r̂_s`: the last quarter.
pub(crate) fn r_s_periods(magnetise_periods: u32) -> u32 {
    magnetise_periods / 4
}

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
    /// Corner frequency of the low-pass in the slip of regeneration, times the time between two calls.
    pub slip_corner: R,
    /// Slip from which on the machine counts as regenerating: a seventh of the rated one.
    pub omega_r_regeneration: R,
    /// Reciprocal of the periods over which the magnetisation reads `r̂_s` ([`r_s_periods`]).
    pub inv_r_s_periods: R,
    /// The resistance at light load by the method of [9].
    #[cfg(feature = "variants")]
    pub light_load: Option<LightLoadConfig<R>>,
    /// The resistance by the radius, at rest without load.
    #[cfg(feature = "variants")]
    pub adapt_at_rest: bool,
    /// Estimate that a start begins with, while the machine is not magnetised yet.
    #[cfg(feature = "variants")]
    pub initial_flux: Option<[R; 2]>,
}
words! {
    PaperConfig: flux, resistance, confidence, r_s, inv_r_s, slip_corner, omega_r_regeneration, inv_r_s_periods,
    #[cfg(feature = "variants")] light_load,
    #[cfg(feature = "variants")] adapt_at_rest,
    #[cfg(feature = "variants")] initial_flux,
}

impl<R: Real> PaperConfig<R> {
    /// Settings for validated parameters and a magnetisation of so many periods.
    pub fn new(pu: &PerUnit, inverter: &Inverter, p: &DriveParams, magnetise_periods: u32) -> Self {
        let r = rounded::<R>;
        let t_s = pu.t_s;
        let slow_periods = slow_periods(inverter);
        let adapt = f64::from(adapt_periods(slow_periods));
        let (t_speed, t_adapt) = (t_s * f64::from(speed_periods(Scheme::Paper, slow_periods)), t_s * adapt);
        let noise = if p.paper.noise_compensator { p.paper.noise_gain } else { (0.0, 0.0) };
        let offset = OffsetConfig {
            t_s: r(f64::from(OFFSET_PERIODS) * t_s),
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
                noise_regeneration: r(if p.paper.noise_compensator { p.paper.noise_regeneration } else { 0.0 }),
                regeneration_rate: r(1.0 / pu.tau_r + pu.hz(p.flux_bandwidth)),
                half_interval: r(0.5 * t_speed),
                offset: p.paper.offset_estimator.then_some(offset),
                #[cfg(feature = "variants")]
                replaced: p.paper.limiter || p.paper.low_pass > 0.0,
                #[cfg(feature = "variants")]
                low_pass: r(pu.hz(p.paper.low_pass)),
            },
            resistance: p.paper.resistance_adaptation.then(|| ResistanceConfig {
                l_sum: r(pu.l_s + pu.sigma_l_s),
                l_product: r(pu.l_s * pu.sigma_l_s),
                gain: r(t_adapt * (p.paper.resistance_gain / pu.base.omega)),
                i_q_min: r(0.15 * pu.torque_rated / p.psi_ref),
                i_q_high: r(0.6 * pu.torque_rated / p.psi_ref),
                swing_slope: r((pu.tau_r * 2.0 / 75.0 * p.psi_ref / pu.torque_rated).min(100.0)),
                omega_min: r(0.004),
                omega_max: r(0.1),
                transient: r(0.05),
                corner: r(t_adapt * pu.hz(2.0)),
                hold: inverter.periods(0.2 / adapt),
                // As fast as the sign law at ω_s = 0.06 and half of rated i_q: faster, the transients of ε count.
                #[cfg(feature = "variants")]
                quotient: r(if p.paper.resistance_quotient { 0.5 * pu.torque_rated / p.psi_ref / 0.06 } else { 0.0 }),
            }),
            confidence: ConfidenceConfig {
                t_s: r(t_adapt),
                u_floor: r(1e-4 * pu.r_s + 1e-4 * pu.dead_time * pu.u_dc),
                u_initial: r(0.01 * pu.r_s),
                corner: r(t_adapt * pu.hz(LOW_PASS)),
            },
            r_s: r(pu.r_s),
            // Not used by the enhanced scheme: limited instead of a refusal.
            inv_r_s: r(if p.scheme == Scheme::Paper { 1.0 / pu.r_s } else { (1.0 / pu.r_s).min(R::LARGEST) }),
            slip_corner: r(t_adapt * pu.hz(LOW_PASS_SLIP)),
            // ω_r ≈ r_R T/ψ_R², ψ_R ≈ ψ*.
            omega_r_regeneration: r(0.15 * pu.r_r * pu.torque_rated / (p.psi_ref * p.psi_ref)),
            inv_r_s_periods: r(1.0 / f64::from(r_s_periods(magnetise_periods))),
            #[cfg(feature = "variants")]
            light_load: p.paper.resistance_at_light_load.then(|| LightLoadConfig {
                l_s: r(pu.l_s),
                sigma_l_s: r(pu.sigma_l_s),
                corner: r(t_adapt * pu.hz(2.0)),
                // Time constant of 10 τ_r at the current without load (see its module).
                gain: r(t_adapt / (10.0 * pu.tau_r) * (pu.l_s / p.psi_ref) * (pu.l_s / p.psi_ref)),
                half_period: r(0.5 * t_s),
                // The flux of the machine has settled after a change of load or speed.
                settle: inverter.periods(5.0 * pu.tau_r / pu.base.omega / adapt),
                omega_min: r(0.03),
                omega_max: r(0.2),
            }),
            #[cfg(feature = "variants")]
            adapt_at_rest: p.paper.resistance_at_rest,
            #[cfg(feature = "variants")]
            initial_flux: p.paper.initial_flux.map(|(re, im)| [r(re), r(im)]),
        }
    }
}
