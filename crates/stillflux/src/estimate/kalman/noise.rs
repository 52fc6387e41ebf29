//! Noise of the filter: `P_0`, `Q` and `R`, every standard deviation with its unit and source.
//!
//! ```text
//! P_0 = diag(σ_0²),    Q = diag(σ_w²) T + further terms,    S = H P Hᵀ + R + further terms
//! ```
//!
//! with `σ_0` and `σ_w` of this table and the duration `T` of a block in s. Per unit unless relative; the code stores
//! them in units of the scales of [`super::model`].
//!
//! *Physical* values follow from the machine, the bridge or the sensor. *Allowances* cover what the model of
//! [`super::model`] does not contain, or keep a variance from becoming too small; they are chosen larger than the
//! effect they stand for and cost accuracy, not stability. The states are modelled as independent random walks. A
//! change faster than its walk is covered only by the terms for steps below; one faster than these is not covered.
//!
//! | state | `σ_0` | `σ_w`, per √s | source |
//! |---|---|---|---|
//! | `ψ_s` | 0.005 pu | 2e-3 pu | `σ_0` physical: remanence. `σ_w` allowance: duty resolution, remaining inverter error |
//! | `m` | 0.005 pu | 1e-3 pu | `σ_0` as `ψ_s`. `σ_w` allowance: magnetising curve |
//! | `b` | 5e-4 pu if read with gates off before the start, else 0.05 pu | 5e-4 pu | physical; `σ_w` is four times a drift of 0.1 % of rated peak current a minute |
//! | `r_s` | 0.2 relative | 3e-3 relative | physical: winding temperature (50 K; overload) |
//! | `ε_v` | 0.15 | 3e-3 | `σ_0` physical: tolerance of dead time and threshold. `σ_w` allowance: temperature of the switches |
//! | `ε_k` | 0.7 with a capacitance among the parameters, else 0 | 3e-3 | `σ_0` physical: capacitance of devices, cable, motor. `σ_w` allowance |
//! | `ε_l` | 0.1 | 2e-3 | `σ_0` physical: tolerance of `L_σ`. `σ_w` allowance: saturation of the leakage paths with the load |
//! | `r_R`, in place of `ε_l`, at a start | 0.2 relative | 0 | `σ_0` physical: tolerance, temperature of the cage (40 K) |
//! | `γ` | 0.07 | 1e-4 | `σ_0` physical: tolerance of `L_M`. `σ_w` allowance |
//! | `c` | 0.05 with a saturation curve, 0.15 without | 1e-4 | allowance |
//!
//! What these terms add in a block is that of the *stated* block `T_0` of 1 ms, or of [`super::config::SLOTS`] periods if
//! that is longer. In a block of `T` the terms of `S` are multiplied by `T_0/T` and those of the states by `T/T_0`: they
//! stand for errors that last longer than a block, whose effect in a second does not depend on how often it is looked at.
//!
//! Errors of the voltage move the flux by the angle that the rated field turns meanwhile: the stated block and the `σ_w` of
//! `ψ_s` and `m`, `INDUCED` included, are those of a machine of 50 Hz, and `f_N`/50 Hz times as fast at any other. What is
//! left, temperatures above all, takes its time in s. With all of it in s the filter was too slow for machines of 400 and
//! 800 Hz: beyond half of rated speed its flux went its own way.
//!
//! The `σ_0` of `r_s`, `ε_v`, `ε_k`, `ε_l`, `r_R` and `γ` are defaults ([`Priors`]) and settings of the drive, which a
//! commissioning gives.
//!
//! | further term | constants | added to |
//! |---|---|---|
//! | measurement noise `R` | `MEASUREMENT_PU` 0.01 pu | `S` |
//! | second-order term of `\|ψ_R\|` | `SECOND_ORDER` 2 | `S` |
//! | distance from the steady state | `TRANSIENT` 0.1 (of [`super::model`]) | `S` |
//! | the same, by `r_R` | `LAG` 3 | `m` |
//! | product of the errors of the angle, as it acts on `i·n`, and of `r_R` | `LAG` 3, up to `SIGMA_TURN` 0.03 rad, from `OMEGA_TURN` 0.002 on in full | `m` |
//! | square of the error of the angle, as it acts on `i·n` | `CURVATURE` 2, up to `SIGMA_CURVED` 0.3 rad, fades up to `ω_s` = 1/`INV_OMEGA_CURVED` = 0.01 | `m` |
//! | voltage error that grows with frequency | `INDUCED` 0.05 pu per √s and pu of `ω_s` | `ψ_s` |
//! | voltage near a current zero | `ZERO_PU` 5e-3 pu a block, up to `ω_s` = 1/`INV_OMEGA_ZERO` = 0.1, at least `ZERO_MIN` 2e-3 pu of current | `ψ_s` along the phase's axis |
//! | the same under load | `PASSING_PU` 0.015 pu a block, in full from `\|i_q\|/i_d` = 1/`INV_LOADED` = 1/8 on, up to `ω_s` = 1/`INV_OMEGA_PASSING` = 0.02 | `ψ_s` along the phase's axis |
//! | step assumed from the NIS, a block, times √excess | `STEP_PSI` 0.01 pu, `STEP_B` 2e-3 pu, `STEP_R_S` 0.02 relative | `ψ_s`, `b`, `r_s` |
//! | error of the sum of the phase currents | `OF_SUM` 2/3 of what exceeds `OF_GAINS` 0.02 of a change of `i_q` | `b`, at least |
//! | least scaled variance | `FLOOR` 1e-7 | every state |
//! | angle after a loss | `SIGMA_AGAIN` 0.5 rad | `ψ_s`, instead of `σ_0` |

use super::covariance::Column;
use super::model::{
    B, C, GAMMA, KNEE, LEAKAGE, M, PSI, RS, SCALE_B, SCALE_C, SCALE_GAMMA, SCALE_K, SCALE_LEAKAGE, SCALE_PSI, SCALE_R,
    SCALE_ROTOR, SCALE_V, TRANSIENT, V, by_state,
};
use crate::base::{PerUnit, rounded};
use crate::estimate::priors::Priors;
use crate::scalar::Real;
use crate::words::words;

/// Standard deviations at the start. Flux, per unit. Physical: remanence.
const PRIOR_PSI: f64 = 5e-3;
/// Saturated part of the magnetising current, with and without a saturation curve among the parameters.
/// Allowance.
const PRIOR_C: (f64, f64) = (0.05, 0.15);
/// Offset of the current sensors, per unit, after a reading with gates off and without one. Physical.
const PRIOR_B: (f64, f64) = (5e-4, 0.05);

/// Random walks, per √s: flux, `m`, offset (per unit), `r_s` (relative), `ε_v`, `ε_k`, `ε_l`, `γ`, `c`. See the table above.
const WALK_PSI: f64 = 2e-3;
const WALK_M: f64 = 1e-3;
const WALK_B: f64 = 5e-4;
const WALK_R_S: f64 = 3e-3;
const WALK_V: f64 = 3e-3;
const WALK_K: f64 = 3e-3;
const WALK_LEAKAGE: f64 = 2e-3;
const WALK_GAMMA: f64 = 1e-4;
const WALK_C: f64 = 1e-4;
/// Random walk of the flux per unit of stator frequency, per √s. In a block of 1 ms at 50 Hz and rated flux it is
/// 0.05 √0.001 = 1.6e-3 pu, which is 0.5 % of the flux that the induced voltage adds in the block (0.314 pu), uncorrelated
/// from block to block. Allowance.
const INDUCED: f64 = 0.05;

/// Measurement noise of a block, per unit. Allowance, larger than the noise of the converters (the NIS of an
/// undisturbed drive is 0.001 to 0.04, docs/tolerance.md): it covers model errors that last longer than a block
/// (gains of the current sensors, leakage that depends on the current) and are therefore not white.
const MEASUREMENT_PU: f64 = 0.01;
/// The same as scaled variance: `R`.
pub(super) const MEASUREMENT: f64 = scaled(MEASUREMENT_PU, SCALE_PSI);
/// Weight of the variance of the second-order term: `|ψ_R|` of a vector turned by `δ` exceeds its projection by
/// `δ²/2 |ψ_R|`, whose variance for Gaussian `δ` is `σ⁴/2`; four times that. Allowance.
pub(super) const SECOND_ORDER: f64 = 2.0;
/// Relative error of the rate of the current model (tolerance of `r_R`), times the root of the number of blocks for
/// which it persists: a constant error expressed as white noise. Allowance.
const LAG: f64 = 3.0;
/// Deviation of the angle up to which the product of its error and that of `r_R` is noise, rad. An angle that is less known has
/// to be found by the innovation: without this limit a field that was realigned (0.5 rad) at the limit of the torque, where the
/// product is largest, is found within a second in 11 of 30 runs, with 0.05 to 0.2 rad in 24 to 28, with 0.03 in all. Allowance,
/// measured, not derived.
const SIGMA_TURN: f64 = 0.03;
/// Stator frequency, per unit, below which [`Noise::by_turn`] falls in proportion to it. The product is taken for white noise
/// since it changes its sign as the field turns, once in five seconds at this frequency and 50 Hz. In a field that stays
/// slower it is a constant, to which `m` has settled; as noise it would only widen the variance of `m`, and let it drift.
/// Allowance: with 0.001 to 0.004 as many drives are lost (16 to 17 of 30 that keep zero stator frequency under rated load).
const OMEGA_TURN: f64 = 0.002;
/// Weight of [`Noise::by_curvature`]; derived there, it is 0.7 for one rotor time constant. Allowance for the several that a field
/// stands.
const CURVATURE: f64 = 2.0;
/// Deviation of the angle up to which the square of its error is noise, rad: the correction by a larger one is small already.
const SIGMA_CURVED: f64 = 0.3;
/// Reciprocal of the stator frequency, per unit, up to which it is added. A field that turns shows its angle by the voltage.
const INV_OMEGA_CURVED: f64 = 100.0;
/// Flux error that a block adds along the axis of a phase whose current is near zero, per unit. Allowance for some
/// tenths of the dead-time voltage over the fifth of a second that a slow field stays there.
const ZERO_PU: f64 = 5e-3;
/// Reciprocal of the stator frequency, per unit, up to which it is added: a faster field passes the zero within a block
/// or two.
const INV_OMEGA_ZERO: f64 = 10.0;
/// The same in a field that is loaded, or was of late: one that passes the zero so slowly, or stands in it, takes the error of the
/// bridge's curve with its sign for as long, and flux and resistance would take it for their own. Allowance.
const PASSING_PU: f64 = 0.015;
/// Reciprocal of the torque current over the magnetising one from which on it counts in full: without load the angle is not
/// observable, and noise would only let it go.
const INV_LOADED: f64 = 8.0;
/// Reciprocal of the stator frequency, per unit, up to which that is added.
const INV_OMEGA_PASSING: f64 = 50.0;
/// Least half width of the current range in which it is added, per unit; otherwise the current change within a dead
/// time.
const ZERO_MIN: f64 = 2e-3;

/// Standard deviations that a block adds while the NIS is above its threshold, times the root of the excess: flux,
/// offset (per unit), resistance (relative). Allowance for a step that the random walks do not contain.
const STEP_PSI: f64 = 0.01;
const STEP_B: f64 = 2e-3;
const STEP_R_S: f64 = 0.02;

/// Standard deviation of a component of the offset per error `e` of the sum of the phase currents. Errors `σ` of three
/// channels that know nothing of each other give `e² = 3 σ²` and components of the space vector with `(2/3) σ²`; one channel
/// alone gives a vector of `2/3 e`, and `(2/9) e²` for a component of unknown direction: the same. Twice that, since the
/// low-pass and the fit have taken part of `e` away before it is largest. Physical.
const OF_SUM: f64 = 2.0 / 3.0;
/// What the gains of the sensors may make of a change of the current, as long as the fit has not seen it: the sum of gains
/// `1 + δ` has an amplitude of `√3 σ_δ` per unit of current, and 1 % is what sensors are sold with. Physical.
const OF_GAINS: f64 = 0.02;

/// Correlations with the leakage that a block takes off while it is not corrected: they fade with 4096 blocks, some seconds.
/// A change of load is weighed by them; over minutes errors of the bridge near current zero, which are no noise, would go by
/// them into the flux. Allowance.
pub(super) const FORGOTTEN: f64 = 1.0 / 4096.0;
/// Part of the recent load ([`Noise::zero`]) that a stated block forgets: some half a second, the time of a zero at
/// `ω_s` = 0.001. Allowance.
const LOAD_FORGOTTEN: f64 = 1.0 / 512.0;
/// Part of the recent deviation of the angle ([`Noise::by_curvature`]) that a stated block forgets: some four seconds, for which a
/// flux on the wrong side of the current can look like the right one. Allowance.
const SIGMA_FORGOTTEN: f64 = 1.0 / 4096.0;
/// Corner of the low-pass of the normalised innovation squared, per stated block.
pub(super) const NIS_CORNER: f64 = 0.05;
/// Blocks after a start in which the NIS is not evaluated (hold-off): initial errors are not steps.
const HOLD_OFF: f64 = 200.0;

/// Least variance of a scaled state: keeps rounding from making one negative.
pub(super) const FLOOR: f64 = 1e-7;
/// Standard deviation of the flux over its magnitude, rad, after a loss of the angle: its scaled variance, 100 at
/// rated flux, is within the range of fixed point.
pub(super) const SIGMA_AGAIN: f64 = 0.5;

/// Scaled variance of `r_s` that its random walk does not exceed while the filter holds it: that of a winding of unknown
/// temperature, 0.2 relative.
pub(super) const WARMED: f64 = scaled(0.2, SCALE_R);

/// Effects that the filter identifies; the states of the others keep their initial values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identified {
    /// Current-sensor offset.
    pub offset: bool,
    /// Stator resistance, inverter error and knee.
    pub resistance: bool,
    /// Whether the innovation corrects any state; without it the filter is a pure integrator.
    pub flux: bool,
}

/// Scaled variances of `r_s`, `ε_v`, `ε_k`, `ε_l`, `γ`.
fn variances<R: Real>(priors: &Priors) -> [R; 5] {
    let Priors { r_s, loss, knee, leakage, l_m, .. } = *priors;
    [
        scaled(r_s, SCALE_R),
        scaled(loss, SCALE_V),
        scaled(knee, SCALE_K),
        scaled(leakage, SCALE_LEAKAGE),
        scaled(l_m, SCALE_GAMMA),
    ]
    .map(rounded)
}

/// Scaled variance of `r_R`.
fn of_rotor<R: Real>(priors: &Priors) -> R {
    rounded(scaled(priors.r_r, SCALE_ROTOR))
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
    /// Variance at the start: resistance, inverter error, knee, leakage, `γ`.
    prior: [R; 5],
    /// The same of the rotor resistance, where a direct current begins ([`super::direct`]).
    pub rotor: R,
    /// Variance that each block adds: flux, `m`, offset, resistance, inverter error, knee, leakage, `γ`, `c`.
    walk: [R; 9],
    /// Added to the flux per squared stator frequency.
    induced: R,
    /// Current of a phase, per unit, below which its voltage is uncertain.
    zero: R,
    /// `T_0/T`: the stated block as part of the block, and the reciprocal.
    pub part: R,
    stated: R,
    /// Corner of the low-pass of the NIS, per block.
    pub nis_corner: R,
    /// Part of the correlations with the leakage that is left after a block in which it is not corrected.
    pub remembered: R,
    /// Part of the recent load that is left after a block.
    pub load_remembered: R,
    /// The same of the recent deviation of the angle.
    pub sigma_remembered: R,
    /// Blocks after a start in which the NIS is not evaluated (hold-off).
    pub hold_off: u16,
}
words!(Noise: offset, resistance, knee, calibrated, c_known, prior, rotor, walk, induced, zero, part, stated, nis_corner,
    remembered, load_remembered, sigma_remembered, hold_off);

impl<R: Real> Noise<R> {
    /// For validated parameters and blocks of `seconds`, of which the stated block is a `part`, of a machine whose
    /// rated frequency is `relative_frequency` times that for which it is stated; `calibrated`: the offsets of the
    /// current sensors are read before each start; `c_known`: the saturation is that of the machine's curve.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn new(
        pu: &PerUnit,
        (seconds, relative_frequency, part): (f64, f64, f64),
        calibrated: bool,
        c_known: bool,
        identified: Identified,
    ) -> Self {
        let r = rounded::<R>;
        let r_s = pu.r_s;
        let scale = by_state([
            SCALE_PSI,
            SCALE_PSI,
            SCALE_B,
            SCALE_R * r_s,
            SCALE_V,
            SCALE_K,
            SCALE_LEAKAGE,
            SCALE_GAMMA,
            SCALE_C,
        ]);
        let walk =
            by_state([WALK_PSI, WALK_M, WALK_B, WALK_R_S * r_s, WALK_V, WALK_K, WALK_LEAKAGE, WALK_GAMMA, WALK_C]);
        let Identified { offset, resistance, .. } = identified;
        let knee = resistance && pu.knee > 0.0;
        let on = |k: usize| match k {
            B..RS => offset,
            RS | V => resistance,
            KNEE => knee,
            _ => true,
        };
        let duration = |k: usize| if k <= M { seconds * relative_frequency } else { seconds };
        let variance = |k: usize| r(if on(k) { scaled(walk[k], scale[k]) * duration(k) } else { 0.0 });
        Self {
            offset,
            resistance,
            knee,
            calibrated,
            c_known,
            prior: variances(&Priors::default()),
            rotor: of_rotor(&Priors::default()),
            walk: [PSI, M, B, RS, V, KNEE, LEAKAGE, GAMMA, C].map(variance),
            induced: r(INDUCED * INDUCED * seconds * relative_frequency / (SCALE_PSI * SCALE_PSI)),
            zero: r(pu.dead_time_swing.max(ZERO_MIN)),
            part: r(part),
            stated: r(1.0 / part),
            nis_corner: r(NIS_CORNER / part),
            remembered: r(1.0 - FORGOTTEN / part),
            load_remembered: r(1.0 - LOAD_FORGOTTEN / part),
            sigma_remembered: r(1.0 - SIGMA_FORGOTTEN / part),
            hold_off: (HOLD_OFF * part) as u16,
        }
    }

    /// The same with other priors.
    pub fn with_priors(self, priors: &Priors) -> Self {
        Self { prior: variances(priors), rotor: of_rotor(priors), ..self }
    }

    /// Variances at the start.
    #[cold]
    #[inline(never)]
    pub fn prior(&self) -> Column<R> {
        let [of_r_s, of_v, of_knee, leakage, gamma] = self.prior;
        let r = |on: bool, x: R| if on { x } else { R::ZERO };
        let either = |first: bool, (x, y): (f64, f64), scale: f64| {
            R::from_f64(if first { scaled(x, scale) } else { scaled(y, scale) })
        };
        let psi = R::from_f64(const { scaled(PRIOR_PSI, SCALE_PSI) });
        let b = if self.offset { either(self.calibrated, PRIOR_B, SCALE_B) } else { R::ZERO };
        let (r_s, v, knee) = (r(self.resistance, of_r_s), r(self.resistance, of_v), r(self.knee, of_knee));
        by_state([psi, psi, b, r_s, v, knee, leakage, gamma, either(self.c_known, PRIOR_C, SCALE_C)])
    }

    /// Variances that each block adds; `excess`: of the NIS over its threshold.
    #[inline(always)]
    pub fn walk(&self, excess: R) -> Column<R> {
        let excess = excess * self.stated;
        let [psi, m, b, r_s, v, knee, leakage, gamma, c] = self.walk;
        let step = |on: bool, variance: f64| if on { R::from_f64(variance) * excess } else { R::ZERO };
        let of_psi = step(true, const { scaled(STEP_PSI, SCALE_PSI) });
        let of_b = step(self.offset, const { scaled(STEP_B, SCALE_B) });
        let of_r_s = step(self.resistance, const { scaled(STEP_R_S, SCALE_R) });
        by_state([psi + of_psi, m, b + of_b, r_s + of_r_s, v, knee, leakage, gamma, c])
    }

    /// Variance added to each component of the flux at a stator frequency.
    #[inline(always)]
    pub fn induced(&self, omega: R) -> R {
        self.induced * omega * omega
    }

    /// Variance added to `m` away from its steady state, for its `decay` in a block and the distance `transient` of
    /// [`super::model::OperatingPoint`].
    #[inline(always)]
    pub fn lag(&self, decay: R, transient: R) -> R {
        let lag = decay * R::from_f64(LAG / TRANSIENT) * transient;
        // `decay` contains the duration of the block once.
        lag * lag * self.part
    }

    /// Variance added to `m` for an error of the angle with the standard deviation `sigma`, rad: by it `i·n` differs by
    /// `i_q σ`, and what the filter expects `m` to make of that has the error of `r_R`, a product of two errors that the
    /// derivatives do not have. `turn` of [`super::model::OperatingPoint`]; `omega`: magnitude of the stator frequency.
    #[inline(always)]
    pub fn by_turn(&self, turn: R, m: R, sigma: R, omega: R) -> R {
        let by_turn = turn * m * sigma.min(R::from_f64(SIGMA_TURN)) * R::from_f64(LAG / SCALE_PSI);
        // In two factors: 1/0.002 is beyond the range of fixed point.
        let turning = omega.min(R::from_f64(OMEGA_TURN)) * R::from_f64(100.0) * R::from_f64(0.01 / OMEGA_TURN);
        by_turn * by_turn * self.part * turning
    }

    /// Variance added to `m` in a field that stands, for the square of an error of the angle with the standard deviation
    /// `sigma`, rad. By an error `δ` the current along the flux is less by `i_d δ²/2` than what the derivatives have, `i_q δ`,
    /// which without load is nothing. Its variance for Gaussian `δ` is `i_d² σ⁴/2`, the same for as long as the field stands;
    /// over a rotor time constant, `1/decay` blocks of `decay · m δ²/2`, as white noise it is `m² σ⁴/2 decay` a block.
    /// `sigma` is the largest of late: of the two angles that the current model allows the filter takes one and forgets the other.
    /// `omega`: magnitude of the stator frequency.
    #[inline(always)]
    pub fn by_curvature(&self, decay: R, m: R, sigma: R, omega: R) -> R {
        let sigma = sigma.min(R::from_f64(SIGMA_CURVED));
        let by_curvature = m * (sigma * sigma) * R::from_f64(CURVATURE / SCALE_PSI);
        let standing = (R::ONE - omega * R::from_f64(INV_OMEGA_CURVED)).max(R::ZERO);
        by_curvature * by_curvature * decay * standing
    }

    /// Variance added along the axis of a phase whose current is near zero ([`Noise::near_zero`]); `load`: the largest recent
    /// torque current over the magnetising one.
    #[inline(always)]
    pub fn zero(&self, omega: R, load: R) -> R {
        let within = |inv_omega: f64| (R::ONE - omega * R::from_f64(inv_omega)).max(R::ZERO);
        let (slow, passing) =
            (within(INV_OMEGA_ZERO), within(INV_OMEGA_PASSING) * (load * R::from_f64(INV_LOADED)).min(R::ONE));
        let variance = R::from_f64(const { scaled(ZERO_PU, SCALE_PSI) }) * (slow * slow)
            + R::from_f64(const { scaled(PASSING_PU, SCALE_PSI) }) * (passing * passing);
        variance * self.stated
    }

    /// Least variance of a component of the offset where the sum of the phase currents has an error, and the torque current
    /// has changed.
    #[inline(always)]
    pub fn of_sum(&self, error: R, change: R) -> R {
        let unexplained = (error.abs() - change * R::from_f64(OF_GAINS)).max(R::ZERO);
        let deviation = if self.offset { unexplained * R::from_f64(OF_SUM / SCALE_B) } else { R::ZERO };
        deviation * deviation
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
