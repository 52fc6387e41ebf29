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
pub(super) const SCALE_PSI: f64 = 0.05;
const SCALE_B: f64 = 0.01;
/// Relative to `r_s`.
const SCALE_R: f64 = 0.05;
const SCALE_V: f64 = 0.1;
pub(super) const SCALE_GAMMA: f64 = 0.05;
const SCALE_C: f64 = 0.1;

/// Deviations at the start that no parameter changes: flux (remanence), inductance.
const PRIOR_PSI: f64 = 5e-3;
const PRIOR_GAMMA: f64 = 0.07;
/// Step of the flux in a block whose residual is beyond its measure.
const SURPRISE_PSI: f64 = 0.01;

/// Variance of the residual in one block, scaled: of a deviation of 0.01 per unit. The ADC's noise alone would be a
/// tenth of it; the rest stands for what the model has wrong for longer than a block (leakage, gains of the current
/// sensors).
pub(super) const RESIDUAL: f64 = 0.01 * 0.01 / (SCALE_PSI * SCALE_PSI);
/// What a block adds along the axis of a phase whose current is near zero, scaled: a few tenths of the dead-time
/// voltage for the fifth of a second that a slow field stays there.
pub(super) const DRIFT_ZERO: f64 = 5e-3 * 5e-3 / (SCALE_PSI * SCALE_PSI);
/// Part of the distance to the steady state of the current model that its saturation curve may have wrong.
pub(super) const TRANSIENT: f64 = 0.1;

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
    /// Length `Δ` of a block, `r_R Δ` and `Δ/τ_r`.
    pub(super) delta: R,
    pub(super) r_r_block: R,
    pub(super) decay: R,
    /// Reciprocal of the rated rotor flux.
    pub(super) inv_m_rated: R,
    /// Saturation of the main inductance: prior of `c`.
    pub(super) saturation: R,
    /// Variances at the start, scaled: offset, resistance, inverter error, saturation.
    prior: [R; 4],
    /// What each block adds, scaled: flux, `m`, offset, resistance, inverter error, `γ`, `c`.
    drift: [R; 7],
    /// What a block adds beside `drift` per unit of excess of the residuals: offset, resistance.
    surprise: [R; 2],
    /// Added to the flux per squared stator frequency.
    pub(super) drift_omega: R,
    /// Current of a phase below which the voltage along its axis is known less.
    pub(super) zero: R,
    /// Deviation that a block adds to `m` per distance from the steady state: a rotor resistance that is not
    /// the parameter.
    pub(super) lag: R,
    /// Whether the residual corrects anything.
    pub(super) correct: bool,
}
words! {
    FilterConfig:
    t_s, block, inv_block, sigma_l_s, r_s, l_m, delta, r_r_block, decay, inv_m_rated, saturation, prior, drift, surprise,
    drift_omega, zero, lag, correct,
}

impl<R: Real> FilterConfig<R> {
    /// Settings for validated parameters at a flux reference `psi_ref`; `calibrated`: the offsets of the
    /// current sensors are read before each start.
    #[must_use]
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
        let block = inverter.periods(BLOCK_TIME).clamp(BLOCK_MIN, 64);
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
        // Deviations at the start. Offset: 0.05 % of base current once read, a sensor's tolerance otherwise.
        // Resistance: temperature. Bridge: dead time and threshold.
        let offset = if calibrated { 5e-4 } else { 0.05 };
        let prior = by_state(PRIOR_PSI, PRIOR_PSI, offset, 0.2 * r_s, 0.15, PRIOR_GAMMA, c_deviation);
        // Deviations that grow as the root of time, per √s. Flux: resolution of the duties and the rest of the
        // inverter model. Offset: four times what a sensor drifts by (0.1 % a minute), for one that does more. Resistance:
        // a winding at overload. Bridge: the temperature of the switches.
        let drift = by_state(2e-3, 1e-3, 5e-4, 3e-3 * r_s, 3e-3, 1e-4, 1e-4);
        // Steps that residuals beyond their measure stand for, per block.
        let surprise = by_state(SURPRISE_PSI, 0.0, 2e-3, 0.02 * r_s, 0.0, 0.0, 0.0);

        let on = |k: usize| match k {
            B..RS => identified.offset,
            RS | V => identified.resistance,
            _ => true,
        };
        let variance =
            |k: usize, x: &[f64; N], seconds: f64| r(if on(k) { scaled(x[k], scale[k]) * seconds } else { 0.0 });
        let flux_variance = |x: f64, seconds: f64| r(x * x * seconds / (SCALE_PSI * SCALE_PSI));
        Self {
            t_s: pu.t_s,
            block,
            inv_block: r(1.0 / f64::from(block)),
            sigma_l_s: pu.sigma_l_s,
            r_s: r(r_s),
            l_m: r(l_m),
            delta: r(delta),
            r_r_block: r(r_r * delta),
            decay: r(r_r / l_m * delta),
            inv_m_rated: r(machine.L_s() / (machine.L_M * psi_ref)),
            saturation: r(c),
            prior: [B, RS, V, C].map(|k| variance(k, &prior, 1.0)),
            drift: [PSI, M, B, RS, V, GAMMA, C].map(|k| variance(k, &drift, seconds)),
            surprise: [B, RS].map(|k| variance(k, &surprise, 1.0)),
            // 5 % of the induced voltage, uncorrelated from block to block.
            drift_omega: flux_variance(0.05, seconds),
            zero: r((2.0 / 3.0 * inverter.u_dc * inverter.dead_time / machine.L_sigma / b.i).max(2e-3)),
            lag: r(LAG * r_r / l_m * delta / TRANSIENT),
            correct: identified.flux,
        }
    }

    /// Sizes of the scaled states.
    #[inline(always)]
    pub(super) fn scale(&self) -> Column<R> {
        let r = R::from_f64;
        let r_s = self.r_s * r(SCALE_R);
        by_state(r(SCALE_PSI), r(SCALE_PSI), r(SCALE_B), r_s, r(SCALE_V), r(SCALE_GAMMA), r(SCALE_C))
    }

    /// Transition of `m` by a unit of offset, of `γ` and of `c`, scaled.
    #[inline(always)]
    pub(super) fn of_m(&self) -> [R; 3] {
        let r = R::from_f64;
        let (gamma, c) = (r(SCALE_GAMMA / SCALE_PSI), r(SCALE_C / SCALE_PSI));
        [self.r_r_block * r(SCALE_B / SCALE_PSI), self.decay * gamma, self.decay * c]
    }

    /// Transition of the flux by a unit of offset (times `r_s`), of resistance and of inverter error, scaled.
    #[inline(always)]
    pub(super) fn of_psi(&self) -> [R; 3] {
        let r = R::from_f64;
        let by_r_s = self.delta * self.r_s * r(SCALE_R / SCALE_PSI);
        [self.delta * r(SCALE_B / SCALE_PSI), by_r_s, self.delta * r(SCALE_V / SCALE_PSI)]
    }

    /// Variances at the start, scaled.
    pub(super) fn prior(&self) -> Column<R> {
        let [b, r_s, v, c] = self.prior;
        let psi = R::from_f64(const { scaled(PRIOR_PSI, SCALE_PSI) });
        by_state(psi, psi, b, r_s, v, R::from_f64(const { scaled(PRIOR_GAMMA, SCALE_GAMMA) }), c)
    }

    /// Variances that each block adds, scaled; `excess`: of the residuals over their measure.
    #[inline(always)]
    pub(super) fn drift(&self, excess: R) -> Column<R> {
        let [psi, m, b, r_s, v, gamma, c] = self.drift;
        let [of_b, of_r_s] = self.surprise.map(|x| x * excess);
        let of_psi = R::from_f64(const { scaled(SURPRISE_PSI, SCALE_PSI) }) * excess;
        by_state(psi + of_psi, m, b + of_b, r_s + of_r_s, v, gamma, c)
    }
}

/// Variance of a scaled state.
const fn scaled(deviation: f64, scale: f64) -> f64 {
    let x = deviation / scale;
    x * x
}

/// A value for each state.
#[inline(always)]
fn by_state<T: Copy>(psi: T, m: T, b: T, r_s: T, v: T, gamma: T, c: T) -> [T; N] {
    let mut x = [psi; N];
    (x[M], x[B], x[B + 1], x[RS], x[V], x[GAMMA], x[C]) = (m, b, b, r_s, v, gamma, c);
    x
}
