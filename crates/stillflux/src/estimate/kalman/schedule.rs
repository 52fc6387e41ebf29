//! Schedule of a block: covariance prediction, noise, gain and covariance update, spread over its control periods.
//!
//! ```text
//! P⁻ = F P Fᵀ + Q,    S = H P⁻ Hᵀ + R,    K = P⁻ Hᵀ/S,    P = P⁻ - (P⁻ Hᵀ)(P⁻ Hᵀ)ᵀ/S
//! ```
//!
//! in the scaled states of [`super::model`], with one row of `F` at a time: `m` first, then the two components of the
//! flux. The other rows are those of the identity.
//!
//! | slot of the block | work |
//! |---|---|
//! | 0 | closes the block: mean current, innovation, correction, next operating point ([`Filter`]) |
//! | 1 | correction of the parameters, prediction of the stator resistance ([`crate::estimate::temperature`]) |
//! | 2 | row and column of `m` |
//! | 3 | magnetising curve at the estimates after the correction, for the next block; regressors of the flux |
//! | 4, 5 | row and column of a flux component each |
//! | 6 | `Q`; decorrelation of consider states |
//! | 7 | angle deviation, `S`, `P Hᵀ` |
//! | 8 | update of rows 0 to 7 |
//! | 9 | update of rows 8 to 10 |
//!
//! A slot has one period or a power of two, and its work is in the first of them. [`Filter::align`] lets that fall on odd
//! periods of the drive, in which the speed estimator runs and nothing else: the worst period is shorter then.
//!
//! The flux is integrated in every period. The gain of a block is one block old, against time constants of many blocks.
//!
//! A slot uses only what an earlier slot of the *same* covariance has left ([`Intermediate`]): what a re-initialisation
//! within a block finds of it is dropped, the rows of the flux are not predicted or the block is not corrected.

use super::covariance::N;
use super::intermediate::{Gain, Intermediate, Regressors};
use super::model::{
    B, C, GAMMA, KNEE, LEAKAGE, M, Model, OperatingPoint, PSI, RS, SCALE_GAMMA, SCALE_LEAKAGE, SCALE_PSI, SCALE_R, V,
};
use super::noise::{FLOOR, MEASUREMENT, SECOND_ORDER, WARMED};
use super::{Filter, FilterConfig, MAGNITUDE, NIS_THRESHOLD, SIGMA_LOST};
use crate::scalar::{Real, likely};
use crate::space::{AlphaBeta, Rotator};

/// Stator frequency, per unit, above which the gain of the flux is turned by the angle passed since.
const OMEGA_TURNED: f64 = 0.2;

/// Stator frequency, per unit, below which the leakage is not corrected even while the load changes: what it adds to the
/// innovation with the load the resistance adds with the time.
pub(super) const OMEGA_LEAKAGE_HELD: f64 = 0.008;

/// Largest scaled variance of a component of the flux, in units of the largest number. In fixed point that is a deviation of
/// 0.5 pu, which an angle that nothing shows reaches within seconds. Where the variance is cut at the end of the arithmetic
/// and the correlations are not, `P` is no covariance any more, and the gains that follow from it lose the field.
const VARIANCE_MAX: f64 = 0.8;
/// Scaled variance of a flux of 1 pu with an angle that counts as lost.
const VARIANCE_LOST: f64 = (SIGMA_LOST / SCALE_PSI) * (SIGMA_LOST / SCALE_PSI);

/// Scaled variance of the flux's magnitude in units of that of a flux controlled by its current alone, over 64.
const WEIGHT: f64 = SCALE_PSI * SCALE_PSI / (64.0 * MAGNITUDE * MAGNITUDE);

/// Work of a slot on the covariance. The closing one of a block has number zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Slot {
    /// Correction of the parameters.
    Parameters,
    /// Prediction, row and column of `m`.
    Rotor,
    /// Magnetising curve at the estimates after the correction.
    Magnetisation,
    /// Prediction, a component of the flux; `true`: the second.
    Flux(bool),
    /// Process noise.
    Noise,
    /// Innovation variance and gain.
    Gain,
    /// Update of the first rows.
    First,
    /// Update of the last rows.
    Last,
}

impl Slot {
    /// Slot by its number.
    #[inline(always)]
    fn of(number: u8) -> Self {
        match number {
            1 => Self::Parameters,
            2 => Self::Rotor,
            3 => Self::Magnetisation,
            4 => Self::Flux(false),
            5 => Self::Flux(true),
            6 => Self::Noise,
            7 => Self::Gain,
            8 => Self::First,
            _ => Self::Last,
        }
    }
}

impl<R: Real> OperatingPoint<R> {
    /// Whether resistance, inverter error, knee and leakage are consider states.
    #[inline(always)]
    pub(super) fn held(&self, model: &Model<R>) -> bool {
        self.omega_s.abs() > model.omega_held
    }

    /// Whether the field turns far within a block.
    #[inline(always)]
    pub(super) fn turns(&self) -> bool {
        self.omega_s.abs() > R::from_f64(OMEGA_TURNED)
    }

    /// Whether leakage, `γ` and `c` are not corrected where the resistance is.
    #[inline(always)]
    pub(super) fn inductances_held(&self, model: &Model<R>) -> bool {
        !self.held(model) && self.steady
    }

    /// Whether the leakage is not corrected.
    #[inline(always)]
    pub(super) fn leakage_held(&self, model: &Model<R>) -> bool {
        self.held(model) || self.steady || self.omega_s.within(R::from_f64(OMEGA_LEAKAGE_HELD))
    }

    /// Regressors of resistance, inverter error, knee and leakage: `i`, `u_l`, `u_k` and `l̂ Δi`, two components each,
    /// zero where they are held; `predicted`: but for that of the resistance.
    #[inline(always)]
    fn regressors(&self, model: &Model<R>, predicted: bool) -> Regressors<R> {
        if !self.held(model) {
            // by_knee is -∂u_l/∂ln k.
            let u_k = -AlphaBeta::from_phases(self.loss.by_knee());
            Regressors {
                i_s: self.i_s.into(),
                u_l: self.loss.vector().into(),
                u_k: u_k.into(),
                d_leakage_flux: self.d_leakage_flux.into(),
            }
        } else if predicted {
            Regressors { i_s: self.i_s.into(), ..Regressors::default() }
        } else {
            Regressors::default()
        }
    }
}

/// Covariance update of some rows, written out: the positions of all elements are constants then.
macro_rules! update_rows {
    ($filter:ident, $($row:literal)*) => {
        if let Intermediate::Gain(Gain { ph }) = &$filter.intermediate {
            let (inv_s, floor) = ($filter.inv_s, R::from_f64(FLOOR));
            $($filter.p.reduce::<$row>(ph, inv_s, floor);)*
        }
    };
}

impl<R: Real> Filter<R> {
    /// Lets slots of an even number, or of several periods, begin in odd periods of the drive. `period`: the number of the
    /// next one.
    #[inline]
    pub fn align(&mut self, period: u32) {
        self.period = (period & 1) as u8;
    }

    /// Executes the slot that begins in this period: a branch to the code of each, which has its own frame on the stack.
    #[inline(always)]
    pub(super) fn work(&mut self, c: &FilterConfig<R>) {
        // The remainder: the compiler sees that it is less than the bits of a byte.
        match Slot::of(self.period >> (c.slot_bits % 8)) {
            Slot::Parameters => {
                self.correct_parameters(c);
                // Where it is known how the current heats the winding.
                if !likely(!c.temperature.predicts()) {
                    self.warm(c);
                }
            }
            Slot::Rotor => self.rotor(c),
            Slot::Magnetisation => self.magnetise(c),
            Slot::Flux(second) => self.flux_advance(c, second),
            Slot::Noise => self.add_noise(c),
            Slot::Gain => self.weigh(c),
            Slot::First => self.update_first(),
            Slot::Last => self.update_last(c),
        }
    }

    /// Magnetising curve at the present estimates.
    #[inline(never)]
    fn magnetise(&mut self, c: &FilterConfig<R>) {
        self.point.magnetisation = c.model.magnetisation(self.m.value(), self.gamma.value(), self.c.value());
        if matches!(self.intermediate, Intermediate::Begun) {
            self.intermediate = Intermediate::Transition(self.point.regressors(&c.model, c.temperature.predicts()));
        }
    }

    /// Row and column of `m`.
    #[inline(never)]
    pub(super) fn rotor(&mut self, c: &FilterConfig<R>) {
        let rotor = self.rotor_by_current(c);
        let terms = c.model.rotor_row(&self.point, self.gamma.value(), rotor);
        let row = self.p.project(&terms);
        self.p.advance::<M, 6>(c.model.rotor_own(&self.point, rotor), &terms, &row);
        if !likely(!self.direct) {
            self.add_rotor(c, rotor);
        }
        self.intermediate = Intermediate::Begun;
    }

    #[inline(never)]
    fn flux_advance(&mut self, c: &FilterConfig<R>, second: bool) {
        let Intermediate::Transition(regressors) = &self.intermediate else { return };
        let [i, u_l, u_k, d_leakage_flux] = regressors.component(second);
        let [by_b, by_r_s, by_v, by_k, by_l] = c.model.flux_row(i, u_l, u_k, d_leakage_flux, self.r_s());
        let by_l = if likely(!self.direct) { by_l } else { R::ZERO };
        let terms = [(B, by_b), (RS, by_r_s), (V, by_v), (KNEE, by_k), (LEAKAGE, by_l)];
        self.p.advance_pair::<B, 5>(second, &terms);
    }

    /// Process noise `Q`, and decorrelation of consider states.
    #[inline(never)]
    fn add_noise(&mut self, c: &FilterConfig<R>) {
        let q = &self.point;
        let omega = q.omega_s.abs();
        let excessive = !q.held(&c.model) && self.nis() > R::from_f64(NIS_THRESHOLD);
        let mut walk = c.noise.walk(if excessive { self.nis() - R::from_f64(NIS_THRESHOLD) } else { R::ZERO });
        if q.held(&c.model) {
            // Held and decorrelated: the innovation does not change them, and their effect on the flux is part of the
            // noise that grows with frequency. The winding goes on warming or cooling. Where its resistance is predicted,
            // and as well known as the prediction can be, its correlation with the flux stays.
            let most = c.temperature.deviation().map_or(R::from_f64(WARMED), |x| {
                let scaled = x * R::from_f64(1.0 / SCALE_R);
                scaled * scaled
            });
            let room = most - self.p.get(RS, RS);
            (walk[RS], walk[V], walk[KNEE]) = (walk[RS].min(room).max(R::ZERO), R::ZERO, R::ZERO);
            if !c.temperature.predicts() || room < -most {
                self.p.isolate::<RS>();
                // At its rated flux nothing shows the saturation, and what the held resistance is off by would go there.
                self.p.isolate::<C>();
                walk[C] = R::ZERO;
            }
            self.p.isolate::<V>();
            self.p.isolate::<KNEE>();
        } else if q.steady {
            // Known, as far as the others are concerned: with their correlations the filter would take what follows, a winding
            // that warms, for the errors that they have had, and answer late.
            self.p.isolate::<GAMMA>();
            self.p.isolate::<C>();
        }
        if !likely(!self.direct) {
            self.add_direct_noise(c, &mut walk);
        } else if q.held(&c.model) || q.steady {
            walk[LEAKAGE] = R::ZERO;
            self.p.isolate::<LEAKAGE>();
        } else if q.leakage_held(&c.model) {
            walk[LEAKAGE] = R::ZERO;
            self.p.fade::<LEAKAGE>(c.noise.remembered);
        }
        if likely(!self.direct) {
            walk[M] += c.noise.lag(c.model.decay, q.transient);
        }
        walk[M] += c.noise.by_turn(q.turn, self.m.value(), self.sigma, omega);
        walk[M] += c.noise.by_curvature(c.model.decay, self.m.value(), self.sigma_of_late, omega);
        let induced = c.noise.induced(omega);
        walk[PSI] += induced;
        walk[PSI + 1] += induced;

        let zero = c.noise.zero(omega, self.load.of_late());
        // Products of the components of the phase axes: (1, 0), (-1/2, ±√3/2).
        let (three_quarters, mixed) = (R::from_f64(0.75), R::from_f64(0.433_012_701_892_219_3));
        for (k, i) in q.i_s.to_phases().into_iter().enumerate() {
            if c.noise.near_zero(i) {
                if k == 0 {
                    walk[PSI] += zero;
                } else {
                    walk[PSI] += zero.quarter();
                    walk[PSI + 1] += zero * three_quarters;
                    let mixed = zero * mixed;
                    self.p.add_at(PSI, PSI + 1, if k == 1 { -mixed } else { mixed });
                }
            }
        }
        self.p.add(&walk);
        if R::LARGEST < VARIANCE_LOST
            && self.p.get(PSI, PSI).max(self.p.get(PSI + 1, PSI + 1)) > R::from_f64(VARIANCE_MAX * R::LARGEST)
        {
            self.p.shrink_pair(R::from_f64(31.0 / 32.0));
        }
    }

    /// Deviation of the angle, innovation variance, `P Hᵀ`.
    #[inline(never)]
    fn weigh(&mut self, c: &FilterConfig<R>) {
        let q = &self.point;
        let Rotator { cos, sin } = q.n;
        let p = &self.p;
        let (a, b) = (p.get(PSI, PSI), p.get(PSI + 1, PSI + 1));
        let mixed = sin * cos * p.get(PSI, PSI + 1);
        let across = sin * sin * a + cos * cos * b - (mixed + mixed);
        let across = across.max(R::ZERO);
        // Along n: the trace less the part across.
        let along = (a + b - across).max(R::ZERO);
        self.weight = R::ONE.dividend().over_64(R::from_f64(1.0 / 64.0) + along * R::from_f64(WEIGHT));
        let scale = R::from_f64(SCALE_PSI);
        // Of the errors of inductances that are held the covariance of the flux does not know. That of the leakage turns the
        // rotor flux; that of `γ` has gone into `r̂_s`, δr_s i_q/ω_s = m δγ/2, which turns it by -δr_s i_d/(ω_s |ψ_R|).
        let mut turned = across;
        if q.inductances_held(&c.model) {
            let (i_d, i_q) = (cos * q.i_s.re() + sin * q.i_s.im(), cos * q.i_s.im() - sin * q.i_s.re());
            let by_leakage = i_q * self.sigma_l_s(c) * R::from_f64(SCALE_LEAKAGE / SCALE_PSI);
            let quotient = (i_d.half() * i_q.recip()).limit(R::TWO);
            let by_gamma = self.m.value() * quotient * R::from_f64(SCALE_GAMMA / SCALE_PSI);
            turned += by_leakage * by_leakage * p.get(LEAKAGE, LEAKAGE) + by_gamma * by_gamma * p.get(GAMMA, GAMMA);
        }
        self.sigma = turned.sqrt() * scale * q.inv_psi_r;
        self.sigma_of_late = (self.sigma_of_late * c.noise.sigma_remembered).max(self.sigma);

        if !(self.valid && c.correct) {
            self.intermediate = Intermediate::Nothing;
            return;
        }
        let row = Model::measurement_row(q);
        let ph = p.project(&row);
        let measurement = R::from_f64(MEASUREMENT) * c.noise.part;
        let second = across * scale * q.inv_psi_r;
        let mut s = R::ZERO;
        for (k, h) in row {
            s += h * ph[k];
        }
        let transient = if likely(!self.direct) { q.transient } else { R::ZERO };
        let further = transient * transient + R::from_f64(SECOND_ORDER) * (second * second);
        let s = s + measurement + further * c.noise.part;
        self.inv_s = s.max(measurement).recip();
        if !likely(!q.held(&c.model)) {
            // What the update takes off: it does not correct the resistance.
            self.p.add_at(RS, RS, ph[RS] * (ph[RS] * self.inv_s));
        }
        self.intermediate = Intermediate::Gain(Gain { ph });
    }

    #[inline(never)]
    pub(super) fn update_first(&mut self) {
        update_rows!(self, 0 1 2 3 4 5 6 7);
    }

    #[inline(never)]
    pub(super) fn update_last(&mut self, c: &FilterConfig<R>) {
        let before = self.p.get(LEAKAGE, LEAKAGE);
        update_rows!(self, 8 9 10);
        // Schmidt's update: what is not corrected keeps its variance.
        if self.point.leakage_held(&c.model) && !self.direct {
            self.p.set(LEAKAGE, LEAKAGE, before);
            if let Intermediate::Gain(Gain { ph }) = &mut self.intermediate {
                ph[LEAKAGE] = R::ZERO;
            }
        }
    }
}

/// The slots rely on the order of the states: the flux first, the components of a vector side by side, the states of the
/// machine last.
const _: () = assert!(PSI == 0 && LEAKAGE == 8 && GAMMA == 9 && C == N - 1);
