//! What the filter is told of the machine, the bridge and the sensors: all of its noise is physical.

use super::covariance::{Column, N};
use super::state::{B, C, GAMMA, M, PSI, RS, V};
use crate::base::{Base, PerUnit, rounded};
use crate::params::{Inverter, Machine};
use crate::scalar::Real;
use crate::words::words;

/// Length of a block, s: long against the control period, short against the rotor time constant.
const BLOCK_TIME: f64 = 1e-3;
/// Fewest control periods in a block: the work of a block is done in so many parts.
pub(super) const BLOCK_MIN: u32 = 10;

/// Scales of the states: with deviations of these sizes every covariance lies where fixed point resolves it.
const SCALE_PSI: f64 = 0.05;
const SCALE_B: f64 = 0.01;
/// Relative to `r_s`.
const SCALE_R: f64 = 0.05;
const SCALE_V: f64 = 0.1;
const SCALE_GAMMA: f64 = 0.05;
const SCALE_C: f64 = 0.1;

/// Standard deviation of the residual in one block, per unit. The ADC's noise alone would be a tenth of it;
/// the rest stands for what the model has wrong for longer than a block (leakage, gains of the current sensors).
const RESIDUAL: f64 = 0.01;
/// Part of the distance to the steady state of the current model that its saturation curve may have wrong.
const TRANSIENT: f64 = 0.1;

/// Part of the rate of the current model that may be wrong, times the root of the blocks for which it stays so.
const LAG: f64 = 3.0;

/// Which effects the filter is to identify; those left out stay what they are at the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identified {
    /// Current-sensor offset.
    pub offset: bool,
    /// Stator resistance and inverter error.
    pub resistance: bool,
    /// Flux by the residual at all; without it the filter is a pure integrator.
    pub flux: bool,
}

/// Settings of the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct FilterConfig<R: Real> {
    pub(super) t_s: R,
    /// Control periods in a block.
    pub(super) block: u32,
    pub(super) inv_block: R,
    pub(super) sigma_l_s: R,
    /// Prior of the stator resistance.
    pub(super) r_s: R,
    /// Inductance `l_M` at rated flux.
    pub(super) l_m: R,
    /// `r_R Δ` and `Δ/τ_r` with `Δ` the length of a block.
    pub(super) r_r_block: R,
    pub(super) decay: R,
    /// Reciprocal of the rated rotor flux.
    pub(super) inv_m_rated: R,
    /// Saturation of the main inductance: prior of `c`.
    pub(super) saturation: R,
    /// Transition coefficients between scaled states, see [`super::Filter`].
    pub(super) m_b: R,
    pub(super) m_gamma: R,
    pub(super) m_c: R,
    pub(super) psi_b: R,
    pub(super) psi_r: R,
    pub(super) psi_v: R,
    /// Sizes of the scaled states, and the reciprocal for fluxes.
    pub(super) scale: Column<R>,
    pub(super) inv_scale_psi: R,
    /// Variances at the start and what each block adds, scaled.
    pub(super) prior: Column<R>,
    pub(super) drift: Column<R>,
    /// What a block adds beside `drift` per unit of excess of the residuals.
    pub(super) surprise: Column<R>,
    /// Added to the flux per squared stator frequency.
    pub(super) drift_omega: R,
    /// Added along the axis of a phase whose current is within `zero` of zero.
    pub(super) drift_zero: R,
    pub(super) zero: R,
    /// Variance of the residual, and its growth in transients.
    pub(super) residual: R,
    pub(super) transient: R,
    /// Deviation that a block adds to `m` per distance from the steady state: a rotor resistance that is not
    /// the parameter.
    pub(super) lag: R,
    /// Whether the residual corrects anything.
    pub(super) correct: bool,
}
words! {
    FilterConfig:
    t_s, block, inv_block, sigma_l_s, r_s, l_m, r_r_block, decay, inv_m_rated, saturation, m_b, m_gamma, m_c, psi_b,
    psi_r, psi_v, scale, inv_scale_psi, prior, drift, surprise, drift_omega, drift_zero, zero, residual, transient, lag,
    correct,
}

impl<R: Real> FilterConfig<R> {
    /// Settings for validated parameters at a flux reference `psi_ref`; `calibrated`: the offsets of the
    /// current sensors are read before each start.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn new(
        machine: &Machine,
        inverter: &Inverter,
        pu: &PerUnit<R>,
        psi_ref: f64,
        calibrated: bool,
        identified: Identified,
    ) -> Self {
        let r = rounded::<R>;
        let b = Base::new(machine);
        let block = ((BLOCK_TIME * inverter.f_s + 0.5) as u32).clamp(BLOCK_MIN, 64);
        let seconds = f64::from(block) / inverter.f_s;
        let delta = b.omega * seconds;
        let r_s = (machine.R_s + inverter.r_d) / b.z;
        let r_r = machine.R_R / b.z;
        let l_m = machine.L_M / b.l;
        let scale = by_state(SCALE_PSI, SCALE_PSI, SCALE_B, SCALE_R * r_s, SCALE_V, SCALE_GAMMA, SCALE_C);

        // The saturation curve, if there is one; otherwise what machines of this kind have, more or less.
        let (c, c_deviation) = match &machine.saturation {
            Some(s) => ((1.0 - machine.L_s() / s.L_u).clamp(0.0, 0.5), 0.05),
            None => (0.15, 0.15),
        };
        // Deviations at the start. Flux: remanence. Offset: 0.05 % of base current once read, a sensor's
        // tolerance otherwise. Resistance: temperature. Bridge: dead time and threshold.
        let offset = if calibrated { 5e-4 } else { 0.05 };
        let prior = by_state(5e-3, 5e-3, offset, 0.2 * r_s, 0.15, 0.07, c_deviation);
        // Deviations that grow as the root of time, per √s. Flux: resolution of the duties and the rest of the
        // inverter model. Resistance: a winding at overload. Bridge: the temperature of the switches.
        let drift = by_state(2e-3, 1e-3, 5e-4, 3e-3 * r_s, 3e-3, 1e-4, 1e-4);
        // Steps that residuals beyond their measure stand for, per block.
        let surprise = by_state(0.01, 0.0, 2e-3, 0.02 * r_s, 0.0, 0.0, 0.0);

        let on = |k: usize| match k {
            B..RS => identified.offset,
            RS | V => identified.resistance,
            _ => true,
        };
        let variance = |deviation: &[f64; N], seconds: f64| -> Column<R> {
            core::array::from_fn(|k| {
                let x = deviation[k] / scale[k];
                r(if on(k) { x * x * seconds } else { 0.0 })
            })
        };
        let flux_variance = |x: f64, seconds: f64| r(x * x * seconds / (SCALE_PSI * SCALE_PSI));
        Self {
            t_s: pu.t_s,
            block,
            inv_block: r(1.0 / f64::from(block)),
            sigma_l_s: pu.sigma_l_s,
            r_s: r(r_s),
            l_m: r(l_m),
            r_r_block: r(r_r * delta),
            decay: r(r_r / l_m * delta),
            inv_m_rated: r(machine.L_s() / (machine.L_M * psi_ref)),
            saturation: r(c),
            m_b: r(r_r * delta * SCALE_B / SCALE_PSI),
            m_gamma: r(r_r / l_m * delta * SCALE_GAMMA / SCALE_PSI),
            m_c: r(r_r / l_m * delta * SCALE_C / SCALE_PSI),
            psi_b: r(delta * SCALE_B / SCALE_PSI),
            psi_r: r(delta * scale[RS] / SCALE_PSI),
            psi_v: r(delta * SCALE_V / SCALE_PSI),
            scale: scale.map(r),
            inv_scale_psi: r(1.0 / SCALE_PSI),
            prior: variance(&prior, 1.0),
            drift: variance(&drift, seconds),
            surprise: variance(&surprise, 1.0),
            // 5 % of the induced voltage, uncorrelated from block to block.
            drift_omega: flux_variance(0.05, seconds),
            // A few tenths of the dead-time voltage for the fifth of a second that a slow field stays there.
            drift_zero: flux_variance(5e-3, 1.0),
            zero: r((2.0 / 3.0 * inverter.u_dc * inverter.dead_time / machine.L_sigma / b.i).max(2e-3)),
            residual: flux_variance(RESIDUAL, 1.0),
            transient: r(TRANSIENT / SCALE_PSI),
            lag: r(LAG * r_r / l_m * delta / TRANSIENT),
            correct: identified.flux,
        }
    }
}

/// A value for each state.
fn by_state(psi: f64, m: f64, b: f64, r_s: f64, v: f64, gamma: f64, c: f64) -> [f64; N] {
    let mut x = [psi; N];
    x[PSI + 1] = psi;
    (x[M], x[B], x[B + 1], x[RS], x[V], x[GAMMA], x[C]) = (m, b, b, r_s, v, gamma, c);
    x
}
