//! Every beginning of the filter: priors, restored values, a machine without flux, one with the flux of a direct
//! current, and a covariance that no longer means anything. All go through one reset of the covariance.

use super::model::{B, C, GAMMA, KNEE, M, PSI, RS, SCALE_GAMMA, SCALE_PSI, V};
use super::noise::SIGMA_AGAIN;
use super::schedule::Holds;
use super::{B_MAX, Column, Covariance, Filter, FilterConfig, GAMMA_RANGE, KNEE_RANGE, Learned, R_S_RANGE, V_MAX};
use crate::scalar::{Integrator, Real, clamp_seldom};
use crate::space::AlphaBeta;

/// Blocks after a start in which no innovation counts as a step: the priors are still being tried.
const TRIAL: u8 = 200;

/// Part of its prior variance that is left of a state after a stop, at least: resistance, bridge and inductance move
/// with temperature, an offset hardly does.
const fn known(k: usize) -> f64 {
    if k == B || k == B + 1 { 1.0 / 256.0 } else { 1.0 / 16.0 }
}

/// What was known before a start, and how well: the start may have to be repeated from it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct Initial<R: Real> {
    learned: Learned<R>,
    /// Scaled variances of `b`, `r_s`, `v`, `k`, `γ`.
    variance: [R; 5],
}

impl<R: Real> Filter<R> {
    /// A filter that knows the priors.
    #[must_use]
    pub fn new(c: &FilterConfig<R>) -> Self {
        let prior = c.noise.prior();
        let mut filter = Self::default();
        filter.c.set(c.saturation);
        filter.p.set_diagonal(&prior);
        filter.initial.learned =
            Learned { b: AlphaBeta::default(), r_s: c.model.r_s, v: R::ZERO, knee: R::ONE, gamma: R::ONE };
        filter.begin(c);
        filter
    }

    /// The one way in which a covariance begins: independent states, and nothing left of the block under way that
    /// belongs to another covariance.
    #[cold]
    #[inline(never)]
    fn reset_covariance(&mut self, variance: &Column<R>) {
        self.p.set_diagonal(variance);
        self.holds = Holds::Nothing;
    }

    /// As the filter was before the start under way, but for the saturation.
    #[cold]
    #[inline(never)]
    fn reset_from_initial(&mut self, c: &FilterConfig<R>) {
        *self = Self { initial: self.initial, c: self.c, trial: TRIAL, ..Self::default() };
        let Learned { b, r_s, v, knee, gamma } = self.initial.learned;
        (self.b[0], self.b[1]) = (Integrator::new(b.re()), Integrator::new(b.im()));
        (self.r_s, self.v, self.knee, self.gamma) =
            (Integrator::new(r_s), Integrator::new(v), Integrator::new(knee), Integrator::new(gamma));
        let mut variance = c.noise.prior();
        let [of_b, of_r_s, of_v, of_knee, of_gamma] = self.initial.variance;
        (variance[B], variance[B + 1]) = (of_b, of_b);
        (variance[RS], variance[V], variance[KNEE], variance[GAMMA]) = (of_r_s, of_v, of_knee, of_gamma);
        self.reset_covariance(&variance);
    }

    /// Takes back what an earlier run has learned, each within its limits. What is restored counts as known to
    /// a quarter of its prior deviation, an offset to a sixteenth.
    pub fn restore(&mut self, c: &FilterConfig<R>, learned: &Learned<R>) {
        let r = R::from_f64;
        let r_s = c.model.r_s;
        self.initial.learned = Learned {
            b: learned.b.limit_components(r(B_MAX)),
            r_s: clamp_seldom(learned.r_s, r_s * r(R_S_RANGE.0), r_s * r(R_S_RANGE.1)),
            v: clamp_seldom(learned.v, r(-V_MAX), r(V_MAX)),
            knee: clamp_seldom(learned.knee, r(KNEE_RANGE.0), r(KNEE_RANGE.1)),
            gamma: clamp_seldom(learned.gamma, r(GAMMA_RANGE.0), r(GAMMA_RANGE.1)),
        };
        // As well known as anything is that comes out of a stop.
        self.p = Covariance::default();
        self.begin(c);
    }

    /// What is worth keeping.
    pub fn learned(&self) -> Learned<R> {
        Learned { b: self.b(), r_s: self.r_s(), v: self.v(), knee: self.knee(), gamma: self.gamma.value() }
    }

    /// Begins with a machine without flux; what has been learned stays, less certain by what temperature may have
    /// done to it since.
    pub fn start(&mut self, c: &FilterConfig<R>, i_s: &AlphaBeta<R>) {
        self.initial.learned = self.learned();
        self.begin(c);
        self.i_s = *i_s - self.b();
    }

    /// Begins with the values of `initial`, each with the variance that it comes out of a stop with.
    fn begin(&mut self, c: &FilterConfig<R>) {
        self.keep_variances(c);
        self.reset_from_initial(c);
    }

    /// What a stop leaves of the variances.
    #[cold]
    #[inline(never)]
    fn keep_variances(&mut self, c: &FilterConfig<R>) {
        let prior = c.noise.prior();
        let kept = |k: usize| clamp_seldom(self.p.get(k, k), prior[k] * R::from_f64(known(k)), prior[k]);
        self.initial.variance = [kept(B), kept(RS), kept(V), kept(KNEE), kept(GAMMA)];
    }

    /// Begins anew with the flux `psi_s` that a direct current along the a-axis has built up in a machine at
    /// rest. It is as well known as the inductance: an error `δγ` is one of `-m g/(d(m g)/dm) δγ` of it. Of what
    /// the build-up has told, only the saturation is kept: it shapes the transient, while all the rest drowns in
    /// the integral of a wrong resistance.
    pub fn settle(&mut self, c: &FilterConfig<R>, psi_s: R) {
        let i_s = self.i_s;
        let prior = c.noise.prior()[C];
        let variance = (self.p.get(C, C) * R::from_f64(4.0)).min(prior);
        self.reset_from_initial(c);
        self.i_s = i_s;
        self.p.add_at(C, C, variance - prior);
        let m = psi_s - c.model.sigma_l_s * i_s.re();
        self.psi_s.set(AlphaBeta::new(psi_s, R::ZERO));
        self.m = Integrator::new(m);
        // At rated flux g = 1, and the slope of the curve is 1 + S c.
        let per_gamma =
            m * c.model.rated_slope(self.c.value()).recip() * (R::from_f64(SCALE_GAMMA) * R::from_f64(1.0 / SCALE_PSI));
        let gamma = self.p.get(GAMMA, GAMMA);
        let common = per_gamma * per_gamma * gamma;
        for (i, j, x) in [(PSI, PSI, common), (M, M, common), (PSI, M, common)] {
            self.p.add_at(i, j, x);
        }
        self.p.add_at(PSI, GAMMA, -per_gamma * gamma);
        self.p.add_at(M, GAMMA, -per_gamma * gamma);
    }

    /// Nothing is known any more but what was known at the start, and of the flux not even that.
    #[cold]
    #[inline(never)]
    pub(super) fn forget(&mut self, c: &FilterConfig<R>) {
        let mut variance = c.noise.prior();
        let again = R::from_f64(SIGMA_AGAIN) * R::from_f64(1.0 / SCALE_PSI);
        (variance[PSI], variance[PSI + 1]) = (again * again, again * again);
        self.reset_covariance(&variance);
    }
}
