//! Every beginning of the filter: priors, restored values, a machine without flux, one with the flux of a direct
//! current, and a covariance that no longer means anything. All go through one reset of the covariance.

use super::model::{B, C, GAMMA, KNEE, M, PSI, RS, SCALE_GAMMA, SCALE_PSI, V};
use super::noise::SIGMA_AGAIN;
use super::schedule::Scratch;
use super::{B_MAX, Column, Covariance, Filter, FilterConfig, GAMMA_RANGE, KNEE_RANGE, Learned, R_S_RANGE, V_MAX};
use crate::estimate::integral::FluxIntegral;
use crate::scalar::{Integrator, Real, clamp_seldom};
use crate::space::{AlphaBeta, Dq};

/// Blocks after a start in which no innovation counts as a step: the priors are still being tried.
const TRIAL: u32 = 200;

/// Part of its prior variance that is left of a state after a stop, at least: resistance, bridge and inductance move
/// with temperature, an offset hardly does.
const fn known(k: usize) -> f64 {
    if k == B || k == B + 1 { 1.0 / 256.0 } else { 1.0 / 16.0 }
}

/// What was known before a start, and how well: the start may have to be repeated from it.
#[derive(Clone, Copy, Debug, PartialEq)]
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
        let initial = Initial {
            learned: Learned { b: AlphaBeta::default(), r_s: c.model.r_s, v: R::ZERO, knee: R::ONE, gamma: R::ONE },
            variance: [B, RS, V, KNEE, GAMMA].map(|k| prior[k]),
        };
        let mut filter = Self::with(initial, Integrator::new(c.saturation));
        filter.reset_from_initial(c);
        filter
    }

    /// States and memory of a block at their beginning; the covariance is not set.
    #[inline(always)]
    fn with(initial: Initial<R>, c: Integrator<R>) -> Self {
        let Learned { b, r_s, v, knee, gamma } = initial.learned;
        Self {
            psi_s: FluxIntegral::default(),
            m: Integrator::default(),
            b: [Integrator::new(b.re()), Integrator::new(b.im())],
            r_s: Integrator::new(r_s),
            v: Integrator::new(v),
            knee: Integrator::new(knee),
            gamma: Integrator::new(gamma),
            c,
            i_s: AlphaBeta::default(),
            u_i: AlphaBeta::default(),
            sum: Dq::default(),
            period: 0,
            point: super::OperatingPoint::default(),
            p: Covariance::default(),
            scratch: Scratch::Empty,
            inv_s: R::ZERO,
            residual: R::ZERO,
            nis: R::ZERO,
            trial: TRIAL,
            sigma: R::ZERO,
            variance: R::ZERO,
            initial,
        }
    }

    /// The one way in which a covariance begins: independent states, and nothing left of the block under way that
    /// belongs to another covariance.
    #[cold]
    #[inline(never)]
    fn reset_covariance(&mut self, variance: &Column<R>) {
        self.p.set_diagonal(variance);
        self.scratch = Scratch::Empty;
    }

    /// As the filter was before the start under way, but for the saturation.
    #[cold]
    #[inline(never)]
    fn reset_from_initial(&mut self, c: &FilterConfig<R>) {
        *self = Self::with(self.initial, self.c);
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
        let prior = c.noise.prior();
        self.initial = Initial {
            learned: Learned {
                b: learned.b.limit_components(r(B_MAX)),
                r_s: clamp_seldom(learned.r_s, r_s * r(R_S_RANGE.0), r_s * r(R_S_RANGE.1)),
                v: clamp_seldom(learned.v, r(-V_MAX), r(V_MAX)),
                knee: clamp_seldom(learned.knee, r(KNEE_RANGE.0), r(KNEE_RANGE.1)),
                gamma: clamp_seldom(learned.gamma, r(GAMMA_RANGE.0), r(GAMMA_RANGE.1)),
            },
            variance: [B, RS, V, KNEE, GAMMA].map(|k| prior[k] * r(known(k))),
        };
        self.reset_from_initial(c);
    }

    /// What is worth keeping.
    pub fn learned(&self) -> Learned<R> {
        Learned { b: self.b(), r_s: self.r_s(), v: self.v(), knee: self.knee(), gamma: self.gamma.value() }
    }

    /// Begins with a machine without flux; what has been learned stays, less certain by what temperature may have
    /// done to it since.
    pub fn start(&mut self, c: &FilterConfig<R>, i_s: &AlphaBeta<R>) {
        let prior = c.noise.prior();
        self.initial = Initial {
            learned: self.learned(),
            variance: [
                self.kept::<B>(&prior),
                self.kept::<RS>(&prior),
                self.kept::<V>(&prior),
                self.kept::<KNEE>(&prior),
                self.kept::<GAMMA>(&prior),
            ],
        };
        self.reset_from_initial(c);
        self.i_s = *i_s - self.b();
    }

    /// Variance with which a state comes out of a stop.
    #[inline(always)]
    fn kept<const K: usize>(&self, prior: &Column<R>) -> R {
        clamp_seldom(self.p.get(K, K), prior[K] * R::from_f64(known(K)), prior[K])
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
