//! Curve of the bridge: direct currents at twelve levels, so short that the rotor flux stays small.
//!
//! ```text
//! u(i) = R' i + (1 + t) u_t(i) + (1 + v) u_v(i; I_k)       R' = R_s + r_d + R_R       t_σ ≪ t ≪ τ_r
//! ```
//!
//! After the leakage's transient and long before the rotor flux has built up, the rotor resistance is in series with
//! the stator's: both, and what flux there is in symmetrical alternation, make a voltage linear in the current. All
//! that is not linear is the bridge's: `u_t` of the threshold, `u_v` of the dead time. In the a-axis phases b and c carry
//! half the current: two points of the curve at once, `u_v = 2/3 (e(i) + e(i/2))` with the curve `e` of a leg
//! ([`crate::inverter`]). The current rises in the same time at all levels, so that the flux stays proportional to it.
//!
//! The fit is linear in `R'`, `t` and `v`; the knee `I_k` is found on a logarithmic grid between 0.02 and 50 times that
//! of the data sheet, refined by a parabola. Far beyond the knee only the sum of threshold and dead time shows: their
//! priors share it.
//!
//! **Wrong plate.** Star instead of delta, or delta instead of star, changes every impedance by a factor of three, more
//! than the plate leaves open. From the levels of 0.22 and 0.45 pu follows `R'` to some tens of per cent, the loss being
//! that of the data sheet; with `L_σ` of the wiring's pulses, both relative to those of the plate,
//!
//! ```text
//! 3^-1.5 < (L_σ/L_σ,plate) (R'/R'_plate)² < 3^1.5          else Cause::WrongMotor
//! ```
//!
//! which is half way, in logarithms, to both; a plate tells `R'` better than `L_σ`, which is assumed. No level above
//! 0.45 pu is set before.
//!
//! **Legs** that differ ([`super::legs`]) are in the loss as known.

use super::excitation::{Command, Sample};
use super::status::Cause;
use crate::base::{PerUnit, rounded};
use crate::inverter::InverterModel;
use crate::params::{Inverter, Machine, ParamError};
use crate::scalar::{Integrator, Real};
use crate::space::AlphaBeta;
use nalgebra::{Matrix3, Vector3};

/// Current levels, per unit.
pub const LEVELS: [f64; 12] = [0.02, 0.03, 0.045, 0.07, 0.1, 0.15, 0.22, 0.32, 0.45, 0.62, 0.85, 1.15];
/// Plateaus of a level; the first and the last one are not read and last half as long, so that the flux alternates
/// symmetrically.
const PLATEAUS: u32 = 6;
/// Prior standard deviations of `t`, of `v`, and of the logarithm of the knee.
const PRIOR_T: f64 = 0.3;
const PRIOR_V: f64 = 0.1;
const PRIOR_KNEE: f64 = 1.5;
/// Standard deviation assumed of a level's voltage, per unit: noise, duty resolution, current ripple.
const SIGMA_U: f64 = 2e-4;

/// Levels that the plate is judged by: one that was read before, and the latest.
const JUDGED: (usize, usize) = (6, 8);
/// Half way to the product of the factors between star and delta, 3^1.5.
const CONNECTION: f64 = 5.196_152_422_706_632;

/// Constants, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BridgeConfig<R: Real> {
    /// Periods for which a current settles.
    settle: u32,
    /// One over the samples of a level.
    weight: R,
    /// What the bridge loses more at the later of the levels [`JUDGED`], by the data sheet.
    loss: R,
    /// Voltage that the plate's `R'` takes more there.
    u: R,
}

impl<R: Real> BridgeConfig<R> {
    /// By plate and data sheet.
    ///
    /// # Errors
    /// Parameters outside their admissible range.
    pub fn new(machine: &Machine, sheet: &Inverter, pu: &PerUnit, settle: u32) -> Result<Self, ParamError> {
        let loss = BridgeCurve::mean_loss(sheet, machine)?;
        let (low, high) = (LEVELS[JUDGED.0], LEVELS[JUDGED.1]);
        Ok(Self {
            settle,
            weight: rounded(1.0 / f64::from((PLATEAUS - 2) * settle)),
            loss: rounded(loss(high) - loss(low)),
            u: rounded((high - low) * (pu.r_s + pu.r_r)),
        })
    }
}

/// State and record.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bridge<R: Real> {
    tick: u32,
    plateau: u32,
    /// Levels done.
    pub level: usize,
    u_sum: Integrator<R>,
    i_sum: Integrator<R>,
    /// Mean voltage and current of each level.
    pub u: [R; LEVELS.len()],
    /// The currents.
    pub i: [R; LEVELS.len()],
}

/// Periods of the whole procedure, for plateaus of `2 settle` periods.
pub(super) fn duration(settle: u32) -> u32 {
    (PLATEAUS - 1) * 2 * settle * LEVELS.len() as u32
}

impl<R: Real> Bridge<R> {
    pub fn new() -> Self {
        Self {
            tick: 0,
            plateau: 0,
            level: 0,
            u_sum: Integrator::default(),
            i_sum: Integrator::default(),
            u: [R::ZERO; LEVELS.len()],
            i: [R::ZERO; LEVELS.len()],
        }
    }

    /// One period; `leakage`: inductance found by the wiring's pulses relative to the plate's. `None` at the end.
    pub fn step(&mut self, c: &BridgeConfig<R>, leakage: R, x: &Sample<R>) -> Result<Option<Command<R>>, Cause> {
        let BridgeConfig { settle, weight, .. } = *c;
        let outer = self.plateau == 0 || self.plateau == PLATEAUS - 1;
        let negative = self.plateau % 2 == 1;
        if !outer && self.tick >= settle {
            let sign = |x: R| if negative { -x } else { x };
            self.u_sum.add(weight, sign(x.u));
            self.i_sum.add(weight, sign((x.i + x.i_last).half()));
        }
        self.tick += 1;
        if self.tick == if outer { settle } else { 2 * settle } {
            self.tick = 0;
            self.plateau += 1;
            if self.plateau == PLATEAUS {
                self.plateau = 0;
                (self.u[self.level], self.i[self.level]) = (self.u_sum.value(), self.i_sum.value());
                self.u_sum.set(R::ZERO);
                self.i_sum.set(R::ZERO);
                if self.level == JUDGED.1 {
                    self.judge(c, leakage)?;
                }
                self.level += 1;
                if self.level == LEVELS.len() {
                    return Ok(None);
                }
            }
        }
        let i = R::from_f64(LEVELS[self.level]);
        Ok(Some(Command::Current(if self.plateau % 2 == 1 { -i } else { i }, R::ZERO)))
    }

    /// Whether the machine can be that of its plate, in that connection.
    fn judge(&self, c: &BridgeConfig<R>, leakage: R) -> Result<(), Cause> {
        let u = self.u[JUDGED.1] - self.u[JUDGED.0] - c.loss;
        let (found, plate) = (leakage * (u * u), c.u * c.u);
        let fits = found > plate * R::from_f64(1.0 / CONNECTION) && found < plate * R::from_f64(CONNECTION);
        if fits && u > R::ZERO { Ok(()) } else { Err(Cause::WrongMotor) }
    }
}

/// Curve that fits the levels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BridgeCurve {
    /// The inverter with this curve: threshold, dead time, capacitance.
    pub inverter: Inverter,
    /// `R'`, per unit.
    pub r: f64,
    /// Standard deviation of the factor of threshold and dead time, and relative one of the knee.
    pub deviation: [f64; 2],
    /// Largest residual, per unit.
    pub residual: f64,
}

impl BridgeCurve {
    /// Loss along the a-axis at a current along it, both per unit.
    ///
    /// # Errors
    /// Parameters outside their admissible range.
    pub fn loss(inverter: &Inverter, machine: &Machine) -> Result<impl Fn(f64) -> f64 + use<>, ParamError> {
        let pu = PerUnit::new(machine, inverter)?;
        let model = InverterModel::<f64>::new(&pu);
        Ok(move |i: f64| model.distortion(model.nominal(), &AlphaBeta::new(i, 0.0), pu.u_dc, 1.0).vector().re())
    }

    /// The same in the mean of both directions of the current, as the levels are read. Near their current zero the legs' curves
    /// are no odd functions of the sampled current, whose ripple is on one side of it: with one direction alone the knee
    /// was off by up to 20 %, five times what was stated.
    ///
    /// # Errors
    /// Parameters outside their admissible range.
    pub fn mean_loss(inverter: &Inverter, machine: &Machine) -> Result<impl Fn(f64) -> f64 + use<>, ParamError> {
        let loss = Self::loss(inverter, machine)?;
        Ok(move |i: f64| 0.5 * (loss(i) - loss(-i)))
    }
}

/// Fit of the levels' voltages and currents, per unit, from what the data sheet says; `n`: levels that were read.
///
/// # Errors
/// Parameters outside their admissible range.
pub(super) fn fit(
    machine: &Machine,
    sheet: &Inverter,
    u: &[f64; LEVELS.len()],
    i: &[f64; LEVELS.len()],
    n: usize,
) -> Result<BridgeCurve, ParamError> {
    let base = if sheet.c_out > 0.0 { sheet.c_out } else { 0.3e-9 };
    let with = |c_out: f64| Inverter { c_out: c_out.min(10e-9), ..*sheet };
    // For one knee: cost, R', 1 + t, 1 + v, variance of v, largest residual.
    let solve = |x: f64| -> Result<[f64; 6], ParamError> {
        let whole = BridgeCurve::mean_loss(&with(base * libm::exp(x)), machine)?;
        let equal = Inverter { leg_delay: [[0.0; 2]; 3], ..with(base * libm::exp(x)) };
        let both = BridgeCurve::mean_loss(&equal, machine)?;
        let dead = BridgeCurve::mean_loss(&Inverter { u_th: 0.0, ..equal }, machine)?;
        let row = |i: f64| Vector3::new(i, both(i) - dead(i), dead(i));
        let legs = |i: f64| whole(i) - both(i);
        let w = 1.0 / (SIGMA_U * SIGMA_U);
        let prior = Vector3::new(0.0, 1.0 / (PRIOR_T * PRIOR_T), 1.0 / (PRIOR_V * PRIOR_V));
        let (mut a, mut b) = (Matrix3::from_diagonal(&prior), prior);
        for k in 0..n {
            let h = row(i[k]);
            a += h * h.transpose() * w;
            b += h * (w * (u[k] - legs(i[k])));
        }
        let inverse = a.try_inverse().unwrap_or_else(Matrix3::zeros);
        let p = inverse * b;
        let (t, v) = (p[1] - 1.0, p[2] - 1.0);
        let mut cost = prior[1] * t * t + prior[2] * v * v + x * x / (PRIOR_KNEE * PRIOR_KNEE);
        let mut largest = 0.0f64;
        for k in 0..n {
            let e = u[k] - legs(i[k]) - p.dot(&row(i[k]));
            cost += w * e * e;
            largest = largest.max(e.abs());
        }
        Ok([cost, p[0], p[1].max(0.0), p[2].max(0.01), inverse[(2, 2)], largest])
    };
    let (step, mut best, mut at) = (0.1, f64::INFINITY, 0.0);
    for k in -39..=39 {
        let x = step * f64::from(k);
        let [cost, ..] = solve(x)?;
        if cost < best {
            (best, at) = (cost, x);
        }
    }
    let (low, high) = (solve(at - step)?[0], solve(at + step)?[0]);
    let curvature = (low + high - 2.0 * best) / (step * step);
    if curvature > 0.0 {
        at += (0.5 * (low - high) / (step * curvature)).clamp(-step, step);
    }
    let [_, r, t, v, variance, residual] = solve(at)?;
    // What is left says how good the model is: it scales the deviations.
    let scale = (0.5 * residual / SIGMA_U).max(1.0);
    let knee = if curvature > 0.0 { (scale * libm::sqrt(2.0 / curvature)).min(PRIOR_KNEE) } else { PRIOR_KNEE };
    let deviation = (scale * libm::sqrt(variance)).min(PRIOR_V);
    // The knee is I_k = C u_dc/T_d of the data sheet's dead time; the curve keeps it with the dead time found.
    let c = with(base * libm::exp(at)).c_out * v;
    let inverter = Inverter { u_th: sheet.u_th * t, dead_time: sheet.dead_time * v, ..with(c) };
    inverter.validate()?;
    Ok(BridgeCurve { inverter, r, deviation: [deviation, knee], residual })
}
