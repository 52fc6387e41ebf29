//! Configuration of the published scheme: what its estimators read, per unit.

use super::settings::{DriveParams, SLOW_PERIODS, SPEED_PERIODS};
use crate::base::{Base, PerUnit, rounded};
use crate::estimate::confidence::ConfidenceConfig;
use crate::estimate::flux::FluxConfig;
use crate::estimate::offset::{OffsetConfig, longest_window};
use crate::estimate::resistance::ResistanceConfig;
use crate::params::{Inverter, Machine};
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
    pub fn new(
        machine: &Machine,
        inverter: &Inverter,
        pu: &PerUnit<R>,
        p: &DriveParams,
        magnetise_periods: u32,
    ) -> Self {
        let b = Base::new(machine);
        let r = rounded::<R>;
        let t_s = b.omega / inverter.f_s;
        let (t_speed, t_slow) = (t_s * f64::from(SPEED_PERIODS), t_s * f64::from(SLOW_PERIODS));
        let hz = |f: f64| core::f64::consts::TAU * f / b.omega;
        let l_s = machine.L_s() / b.l;
        let sigma_l_s = machine.L_sigma / b.l;
        let r_s = (machine.R_s + inverter.r_d) / b.z;
        let dead_time = inverter.dead_time * inverter.f_s * inverter.u_dc / b.u;
        let noise = if p.noise_compensator { p.noise_gain } else { (0.0, 0.0) };
        let r_s_periods = magnetise_periods / 4;
        let offset = OffsetConfig {
            t_s: pu.t_s,
            gain: r(p.offset_gain),
            limit: r(0.05),
            hysteresis: r(0.2 * p.psi_ref),
            interval: r(t_speed),
            turn: r(t_speed / core::f64::consts::TAU),
            longest: longest_window(0.004, t_speed),
            omega_max: r(0.2),
        };
        Self {
            flux: FluxConfig {
                t_s: pu.t_s,
                noise_min: r(noise.0),
                noise_max: r(noise.1),
                offset: p.offset_estimator.then_some(offset),
            },
            resistance: p.resistance_adaptation.then(|| ResistanceConfig {
                l_sum: r(l_s + sigma_l_s),
                l_product: r(l_s * sigma_l_s),
                gain: r(t_slow * (p.resistance_gain / b.omega)),
                i_q_min: r(0.15 * machine.T_N / b.torque / p.psi_ref),
                i_q_high: r(0.6 * machine.T_N / b.torque / p.psi_ref),
                omega_min: r(0.004),
                omega_max: r(0.1),
                transient: r(0.05),
                corner: r(t_slow * hz(2.0)),
                hold: inverter.periods(0.2 / f64::from(SLOW_PERIODS)),
            }),
            confidence: ConfidenceConfig {
                t_s: r(t_slow),
                u_floor: r(1e-4 * r_s + 1e-4 * dead_time),
                u_initial: r(0.01 * r_s),
                corner: r(t_slow * hz(0.2)),
            },
            r_s: pu.r_s,
            inv_r_s: r(1.0 / r_s),
            r_s_periods,
            inv_r_s_periods: r(1.0 / f64::from(r_s_periods)),
        }
    }
}
