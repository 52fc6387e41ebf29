//! Noise of the filter: every standard deviation, with its unit, its source, and what it is.
//!
//! *Physical* values follow from the machine, the bridge or the sensor. *Allowances* cover what the model of
//! [`super::model`] does not contain; they are chosen larger than the effect they stand for and cost accuracy, not
//! stability.
//!
//! | state | at the start (1 σ) | per √s while running | |
//! |---|---|---|---|
//! | `ψ_s` | 0.005 pu (remanence) | 2e-3 pu | physical: duty resolution, remaining inverter error |
//! | `m` | as `ψ_s` | 1e-3 pu | allowance: magnetising curve |
//! | `b` | 5e-4 pu once read with gates off, else 0.05 pu | 5e-4 pu | physical: drift of a sensor (0.1 % a minute), four times |
//! | `r_s` | 20 % | 0.3 % | physical: winding temperature, an overload |
//! | `v` | 0.15 | 3e-3 | physical: dead time and threshold by tolerance, switch temperature |
//! | `ln k` | 0.7 with a capacitance among the parameters, else 0 | 3e-3 | physical: capacitance of devices, cable, motor |
//! | `γ` | 0.07 | 1e-4 | physical: tolerance of `L_M` |
//! | `c` | 0.05 with a curve, 0.15 without | 1e-4 | allowance |
//!
//! Further terms, each beside its constant below: the residual's variance, the voltage near a current zero, the
//! voltage error that grows with frequency, the lag of the current model while it is not steady, the second-order
//! term of `|ψ_R|`, and what a step is assumed to have changed.

use super::covariance::Column;
use super::model::{
    B, C, GAMMA, KNEE, M, PSI, RS, SCALE_B, SCALE_C, SCALE_GAMMA, SCALE_K, SCALE_PSI, SCALE_R, SCALE_V, TRANSIENT, V,
    by_state,
};
use crate::base::{PerUnit, rounded};
use crate::scalar::Real;
use crate::words::words;

/// Flux at the start, per unit. Physical: remanence.
const PRIOR_PSI: f64 = 5e-3;
/// Relative deviation of the magnetising inductance. Physical: tolerance of the parameter.
const PRIOR_GAMMA: f64 = 0.07;
/// Relative deviation of the resistance. Physical: temperature of the winding, 50 K.
const PRIOR_R_S: f64 = 0.2;
/// Relative deviation of the inverter model's voltage. Physical: dead time and threshold.
const PRIOR_V: f64 = 0.15;
/// Knee of the inverter model, logarithm: within a factor of two of the parameter. Physical: cable and motor add to
/// what the bridge's data sheet says.
const PRIOR_K: f64 = 0.7;
/// Saturated part of the magnetising current, with and without a saturation curve among the parameters.
/// Allowance: what machines of this kind have.
const PRIOR_C: (f64, f64) = (0.05, 0.15);
/// Offset of the current sensors, per unit, after a reading with gates off and without one. Physical.
const PRIOR_B: (f64, f64) = (5e-4, 0.05);

/// Random walks, per √s: flux, `m`, offset (per unit), `r_s` (relative), `v`, `γ`, `c`. See the table above.
const WALK_PSI: f64 = 2e-3;
const WALK_M: f64 = 1e-3;
const WALK_B: f64 = 5e-4;
const WALK_R_S: f64 = 3e-3;
const WALK_V: f64 = 3e-3;
const WALK_K: f64 = 3e-3;
const WALK_GAMMA: f64 = 1e-4;
const WALK_C: f64 = 1e-4;
/// Part of the induced voltage that may be wrong, uncorrelated from block to block. Allowance.
const INDUCED: f64 = 0.05;

/// Deviation of the innovation in one block, per unit. Allowance: the converters' noise alone is a tenth of it and
/// the innovation of an undisturbed drive a sixtieth; the rest covers what the model has wrong for longer than a
/// block (leakage inductance, gains of the current sensors).
const RESIDUAL_PU: f64 = 0.01;
/// The same as scaled variance.
pub(super) const RESIDUAL: f64 = scaled(RESIDUAL_PU, SCALE_PSI);
/// Weight of the variance of the second-order term: `|ψ_R|` of a vector turned by `δ` exceeds its projection by
/// `δ²/2 |ψ_R|`, whose variance for Gaussian `δ` is `σ⁴/2`; four times that. Allowance.
pub(super) const SECOND_ORDER: f64 = 2.0;
/// Part of the rate of the current model that may be wrong (tolerance of `r_R`), times the root of the number of
/// blocks for which it stays so. Physical.
const LAG: f64 = 3.0;
/// Flux error that a block adds along the axis of a phase whose current is near zero, per unit. Physical: a few
/// tenths of the dead-time voltage for the fifth of a second that a slow field stays there.
const ZERO_PU: f64 = 5e-3;
/// Stator frequency up to which that counts, reciprocal: a faster field passes the zero within a block or two.
const INV_OMEGA_ZERO: f64 = 10.0;
/// Least half-width of that zone, per unit.
const ZERO_MIN: f64 = 2e-3;

/// Step of a block while innovations exceed their measure, per unit of excess: flux, offset (per unit),
/// resistance (relative). Allowance: something has stepped that the random walks do not contain.
const STEP_PSI: f64 = 0.01;
const STEP_B: f64 = 2e-3;
const STEP_R_S: f64 = 0.02;

/// Least variance of a scaled state: rounding must not make one negative.
pub(super) const FLOOR: f64 = 1e-7;
/// Angle deviation with which the flux begins anew after a loss, rad: fixed point resolves it.
pub(super) const SIGMA_AGAIN: f64 = 0.5;

/// Which effects the filter is to identify; those left out stay what they are at the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identified {
    /// Current-sensor offset.
    pub offset: bool,
    /// Stator resistance and inverter error.
    pub resistance: bool,
    /// Flux by the innovation at all; without it the filter is a pure integrator.
    pub flux: bool,
}

/// Noise of a configuration, scaled variances.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct Noise<R: Real> {
    /// Whether offset, resistance with inverter error, and knee are identified.
    offset: bool,
    resistance: bool,
    knee: bool,
    /// Whether the offsets are read before each start, and whether the saturation is that of the machine's curve.
    calibrated: bool,
    c_known: bool,
    /// What each block adds: flux, `m`, offset, resistance, inverter error, knee, `γ`, `c`.
    walk: [R; 8],
    /// Added to the flux per squared stator frequency.
    induced: R,
    /// Current of a phase, per unit, below which the voltage along its axis is known less.
    zero: R,
}
words!(Noise: offset, resistance, knee, calibrated, c_known, walk, induced, zero);

impl<R: Real> Noise<R> {
    /// For validated parameters and blocks of `seconds`; `calibrated`: the offsets of the current sensors are read
    /// before each start; `c_known`: the saturation is that of the machine's curve.
    pub fn new(pu: &PerUnit, seconds: f64, calibrated: bool, c_known: bool, identified: Identified) -> Self {
        let r = rounded::<R>;
        let r_s = pu.r_s;
        let scale = by_state([SCALE_PSI, SCALE_PSI, SCALE_B, SCALE_R * r_s, SCALE_V, SCALE_K, SCALE_GAMMA, SCALE_C]);
        let walk = by_state([WALK_PSI, WALK_M, WALK_B, WALK_R_S * r_s, WALK_V, WALK_K, WALK_GAMMA, WALK_C]);
        let Identified { offset, resistance, .. } = identified;
        let knee = resistance && pu.knee > 0.0;
        let on = |k: usize| match k {
            B..RS => offset,
            RS | V => resistance,
            KNEE => knee,
            _ => true,
        };
        let variance = |k: usize| r(if on(k) { scaled(walk[k], scale[k]) * seconds } else { 0.0 });
        Self {
            offset,
            resistance,
            knee,
            calibrated,
            c_known,
            walk: [PSI, M, B, RS, V, KNEE, GAMMA, C].map(variance),
            induced: r(INDUCED * INDUCED * seconds / (SCALE_PSI * SCALE_PSI)),
            zero: r(pu.dead_time_swing.max(ZERO_MIN)),
        }
    }

    /// Variances at the start.
    #[cold]
    #[inline(never)]
    pub fn prior(&self) -> Column<R> {
        let r = |on: bool, x: f64| if on { R::from_f64(x) } else { R::ZERO };
        let either = |first: bool, (x, y): (f64, f64), scale: f64| {
            R::from_f64(if first { scaled(x, scale) } else { scaled(y, scale) })
        };
        let psi = R::from_f64(const { scaled(PRIOR_PSI, SCALE_PSI) });
        let b = if self.offset { either(self.calibrated, PRIOR_B, SCALE_B) } else { R::ZERO };
        let r_s = r(self.resistance, const { scaled(PRIOR_R_S, SCALE_R) });
        let v = r(self.resistance, const { scaled(PRIOR_V, SCALE_V) });
        let knee = r(self.knee, const { scaled(PRIOR_K, SCALE_K) });
        let gamma = R::from_f64(const { scaled(PRIOR_GAMMA, SCALE_GAMMA) });
        by_state([psi, psi, b, r_s, v, knee, gamma, either(self.c_known, PRIOR_C, SCALE_C)])
    }

    /// Variances that each block adds; `excess`: of the innovations over their measure.
    #[inline(always)]
    pub fn walk(&self, excess: R) -> Column<R> {
        let [psi, m, b, r_s, v, knee, gamma, c] = self.walk;
        let step = |on: bool, variance: f64| if on { R::from_f64(variance) * excess } else { R::ZERO };
        let of_psi = step(true, const { scaled(STEP_PSI, SCALE_PSI) });
        let of_b = step(self.offset, const { scaled(STEP_B, SCALE_B) });
        let of_r_s = step(self.resistance, const { scaled(STEP_R_S, SCALE_R) });
        by_state([psi + of_psi, m, b + of_b, r_s + of_r_s, v, knee, gamma, c])
    }

    /// Variance added to each component of the flux at a stator frequency.
    #[inline(always)]
    pub fn induced(&self, omega: R) -> R {
        self.induced * omega * omega
    }

    /// Variance added to `m` away from its steady state, for its `decay` in a block and the distance `transient` of
    /// [`super::model::OperatingPoint`].
    #[inline(always)]
    pub fn lag(decay: R, transient: R) -> R {
        let lag = decay * R::from_f64(LAG / TRANSIENT) * transient;
        lag * lag
    }

    /// Variance added along the axis of a phase whose current is near zero ([`Noise::near_zero`]).
    #[inline(always)]
    pub fn zero(omega: R) -> R {
        let slow = (R::ONE - omega * R::from_f64(INV_OMEGA_ZERO)).max(R::ZERO);
        R::from_f64(const { scaled(ZERO_PU, SCALE_PSI) }) * slow * slow
    }

    /// Whether the voltage along a phase's axis is uncertain at its current.
    #[inline(always)]
    pub fn near_zero(&self, i: R) -> bool {
        i.within(self.zero)
    }
}

/// Variance of a scaled state.
const fn scaled(deviation: f64, scale: f64) -> f64 {
    let x = deviation / scale;
    x * x
}
