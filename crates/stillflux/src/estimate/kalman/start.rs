//! Initialisation of the filter: states and covariance at power-up, after a restore, at a start, at the settled flux of
//! a direct current, and after a loss of the angle.
//!
//! ```text
//! start:    ψ_s = 0, m = 0;    of these P_kk = σ_0² and no correlations, of the others P as it is, but P_kk ≥ ρ_k σ_0²
//! catch:    the same with ψ_s = ψ_R + σl_s i_s, m = |ψ_R|
//! settle:   ψ_s = ψ_0 ∠0, m = ψ_0 - σl_s i_α;    P = diag(σ_0²), but b, r_s, v, k, l, γ with min(P_kk, σ_0²) of the start;
//!           δψ_sα = δm = -m/(1 + S c) δγ
//! ```
//!
//! `σ_0` is that of [`super::noise`], `P` the covariance at the end of the last run, `ρ` 1/256 for the offset and 1/16
//! for the others. The correlations stay because what a run at rest shows of resistance, inductance and saturation is what they make
//! together: with each of them as known as it was, and independent of the others, a restart took the error of one for one of the flux, which
//! grew without bounds under a direct current (at rest, L_M 15 % too small: 6 of 6). `settle` holds for a machine at standstill whose flux has
//! reached the steady state of its current.

use super::covariance::{Column, Covariance};
use super::intermediate::Intermediate;
use super::learned::Learned;
use super::model::{B, C, GAMMA, KNEE, LEAKAGE, M, PSI, RS, SCALE_GAMMA, SCALE_PSI, V, reciprocal};
#[cfg(feature = "restart")]
use super::model::{SCALE_R, SCALE_V};
use super::noise::SIGMA_AGAIN;
use super::{B_MAX, Filter, FilterConfig, GAMMA_RANGE, KNEE_RANGE, LEAKAGE_RANGE, R_S_RANGE, V_MAX};
#[cfg(feature = "supervision")]
use crate::control::realign::flux_along;
use crate::scalar::{Integrator, Real, clamp_seldom};
use crate::space::AlphaBeta;

/// Standard deviation of the flux of a machine that turns with it, relative to it, as the voltage that it induces shows it.
const CAUGHT: f64 = 0.11;

/// Least variance of a state after a stop, relative to its prior variance. Allowance: resistance, bridge and inductance
/// change with temperature, an offset hardly does.
const fn least_variance(k: usize) -> f64 {
    if k == B || k == B + 1 { 1.0 / 256.0 } else { 1.0 / 16.0 }
}

impl<R: Real> Filter<R> {
    /// A filter at the values of the parameters.
    #[must_use]
    pub fn new(c: &FilterConfig<R>) -> Self {
        let prior = c.noise.prior();
        let mut filter = Self::default();
        filter.c.set(c.saturation);
        filter.rotor.set(R::ONE);
        filter.rotor_cold = R::ONE;
        filter.p.set_diagonal(&prior);
        filter.initial.learned = Learned {
            b: AlphaBeta::default(),
            r_s: c.model.r_s,
            v: R::ZERO,
            knee: R::ONE,
            leakage: R::ONE,
            gamma: R::ONE,
        };
        filter.begin(c);
        filter
    }

    /// Uncorrelated states with these variances; intermediate results of the block under way become invalid.
    #[cold]
    #[inline(never)]
    fn reset_covariance(&mut self, variance: &Column<R>) {
        self.p.set_diagonal(variance);
        self.intermediate = Intermediate::Nothing;
    }

    /// States at the values before the present start, except saturation and rotor resistance, which stay; so does the covariance.
    #[cold]
    #[inline(never)]
    fn reset_states(&mut self, c: &FilterConfig<R>) {
        // Of the period within the block the lowest bit stays ([`Filter::align`]).
        let (period, hold_off) = (self.period & 1, c.noise.hold_off);
        let &mut Self { initial, c: saturated, rotor, rotor_cold, p, .. } = self;
        *self = Self { initial, c: saturated, rotor, rotor_cold, p, period, hold_off, ..Self::default() };
        let Learned { b, r_s, v, knee, leakage, gamma } = self.initial.learned;
        (self.b[0], self.b[1]) = (Integrator::new(b.re()), Integrator::new(b.im()));
        (self.r_s, self.v, self.knee, self.gamma) =
            (Integrator::new(r_s), Integrator::new(v), Integrator::new(knee), Integrator::new(gamma));
        self.leakage = Integrator::new(leakage);
    }

    /// An unknown flux; of the parameters what the last run has left, each at least as uncertain as after a stop.
    #[cold]
    #[inline(never)]
    fn forget_flux(&mut self, c: &FilterConfig<R>) {
        for (k, of_k) in c.noise.prior().into_iter().enumerate() {
            let least = if [PSI, PSI + 1, M].contains(&k) {
                self.p.clear(k);
                of_k
            } else {
                of_k * R::from_f64(least_variance(k))
            };
            self.p.set(k, k, self.p.get(k, k).max(least));
        }
        self.intermediate = Intermediate::Nothing;
    }

    /// The resistance that a filter begins with in place of a stored one.
    pub fn admissible_resistance(c: &FilterConfig<R>, r_s: R) -> R {
        let r = R::from_f64;
        clamp_seldom(r_s, c.model.r_s * r(R_S_RANGE.0), c.model.r_s * r(R_S_RANGE.1))
    }

    /// Restores the parameters identified in an earlier run, each within its limits, with a quarter of its prior
    /// standard deviation, an offset with a sixteenth. A direct current finds the resistance anew ([`Filter::begin_direct`]).
    pub fn restore(&mut self, c: &FilterConfig<R>, learned: &Learned<R>) {
        let r = R::from_f64;
        self.initial.learned = Learned {
            b: learned.b.limit_components(r(B_MAX)),
            r_s: Self::admissible_resistance(c, learned.r_s),
            v: clamp_seldom(learned.v, r(-V_MAX), r(V_MAX)),
            knee: clamp_seldom(learned.knee, r(KNEE_RANGE.0), r(KNEE_RANGE.1)),
            leakage: clamp_seldom(learned.leakage, r(LEAKAGE_RANGE.0), r(LEAKAGE_RANGE.1)),
            gamma: clamp_seldom(learned.gamma, r(GAMMA_RANGE.0), r(GAMMA_RANGE.1)),
        };
        // A zero covariance is raised to the least variances; the saturation is that of the parameters.
        self.p = Covariance::default();
        self.p.set(C, C, c.noise.prior()[C]);
        self.begin(c);
    }

    /// Identified parameters, to be kept over a stop.
    pub fn learned(&self) -> Learned<R> {
        Learned {
            b: self.b(),
            r_s: self.r_s(),
            v: self.v(),
            knee: self.knee(),
            leakage: self.leakage(),
            gamma: self.gamma.value(),
        }
    }

    /// Begins at a flux of zero. The identified parameters stay, with variances raised by what temperature may have
    /// changed since.
    pub fn start(&mut self, c: &FilterConfig<R>, i_s: &AlphaBeta<R>) {
        self.initial.learned = self.learned();
        self.begin(c);
        self.i_s = *i_s - self.b();
    }

    /// The offsets of the sensors have been read anew: what is left of them is as unknown as before the first start.
    #[cold]
    #[inline(never)]
    pub fn forget_offset(&mut self, c: &FilterConfig<R>) {
        let prior = c.noise.prior();
        for k in 0..2 {
            self.b[k] = Integrator::default();
            self.p.set(B + k, B + k, prior[B]);
        }
    }

    /// Begins like [`Filter::start`], at the rotor flux of a machine without current; `deviation` as in [`Self::place`].
    pub fn catch(&mut self, c: &FilterConfig<R>, psi_r: AlphaBeta<R>, i_s: &AlphaBeta<R>, deviation: R) {
        self.keep_variances(c);
        self.place(c, psi_r, i_s, deviation);
    }

    /// Voltage that the changes of the resistance and of the inverter model since the start take off the present one; `loss`: loss of the
    /// bridge by the model.
    #[cfg(feature = "restart")]
    #[cold]
    #[inline(never)]
    pub fn explained(&self, loss: &AlphaBeta<R>) -> AlphaBeta<R> {
        let Learned { r_s, v, .. } = self.initial.learned;
        self.i_s * (self.r_s() - r_s) + *loss * ((self.v() - v) * (R::ONE + self.v()).recip())
    }

    /// Takes a constant error of the voltage along the present current, which is known to a `deviation` and of which the inverter
    /// model takes `loss` off, for errors of resistance and inverter model, by their variances.
    #[cfg(feature = "restart")]
    #[cold]
    #[inline(never)]
    pub fn explain(&mut self, c: &FilterConfig<R>, (error, deviation): (R, R), loss: R) {
        let r = R::from_f64;
        let r_s = c.model.r_s;
        // Voltages of both scales, and everything in units of their sum; the reciprocals fit fixed point.
        let (by_r, by_v) = (r_s * self.i_s.norm_sq().sqrt() * r(SCALE_R), loss.abs() * r(SCALE_V));
        let inv = (by_r + by_v).max(r(1e-3)).recip();
        let h = [by_r * inv, by_v * inv];
        let p = [self.p.get(RS, RS), self.p.get(RS, V), self.p.get(V, V)];
        let ph = [p[0] * h[0] + p[1] * h[1], p[1] * h[0] + p[2] * h[1]];
        let deviation = (deviation * inv).min(r(8.0));
        let gain = (deviation * deviation + R::dot(ph, h)).max(r(0.02)).recip();
        let x = error * inv * gain;
        self.r_s.add_clamped(ph[0] * x, r_s * r(SCALE_R), r_s * r(R_S_RANGE.0), r_s * r(R_S_RANGE.1));
        self.v.add_clamped(ph[1] * x, (R::ONE + self.v()) * r(SCALE_V), r(-V_MAX), r(V_MAX));
        for (i, j, x) in [(RS, RS, ph[0] * ph[0]), (RS, V, ph[0] * ph[1]), (V, V, ph[1] * ph[1])] {
            self.p.add_at(i, j, -(x * gain));
        }
    }

    /// Begins anew, before anything has been corrected, at a rotor flux whose standard deviation is [`CAUGHT`] times its
    /// magnitude plus `deviation`, per unit.
    pub fn place(&mut self, c: &FilterConfig<R>, psi_r: AlphaBeta<R>, i_s: &AlphaBeta<R>, deviation: R) {
        self.reset_states(c);
        self.forget_flux(c);
        self.i_s = *i_s;
        self.psi_s.set(psi_r + *i_s * self.sigma_l_s(c));
        let magnitude = psi_r.norm_sq().sqrt();
        self.m = Integrator::new(magnitude);
        self.widen(magnitude * R::from_f64(CAUGHT) + deviation);
    }

    /// Adds the variance of a flux whose components and whose rotor flux are known to a standard deviation, per unit.
    fn widen(&mut self, deviation: R) {
        let scaled = deviation * R::from_f64(1.0 / SCALE_PSI);
        for k in [PSI, PSI + 1, M] {
            self.p.add_at(k, k, scaled * scaled);
        }
    }

    /// Begins with the values of `initial` and the covariance after a stop.
    fn begin(&mut self, c: &FilterConfig<R>) {
        self.keep_variances(c);
        self.reset_states(c);
        self.forget_flux(c);
    }

    /// Variances after a stop: at least [`least_variance`], at most the prior.
    #[cold]
    #[inline(never)]
    fn keep_variances(&mut self, c: &FilterConfig<R>) {
        self.end_direct(c);
        let prior = c.noise.prior();
        let kept = |k: usize| clamp_seldom(self.p.get(k, k), prior[k] * R::from_f64(least_variance(k)), prior[k]);
        self.initial.variance = [kept(B), kept(RS), kept(V), kept(KNEE), kept(LEAKAGE), kept(GAMMA)];
    }

    /// Begins anew with the flux `psi_s` that a direct current along the a-axis has built up in a machine at
    /// standstill. An error `δγ` of the inductance is an error `-m g/(d(m g)/dm) δγ` of this flux. Of the states
    /// estimated during the build-up only the saturation is kept, which determines the shape of the transient; the
    /// others are falsified by the integral of the resistance error.
    pub fn settle(&mut self, c: &FilterConfig<R>, psi_s: R) {
        let i_s = self.i_s;
        let mut variance = c.noise.prior();
        variance[C] = (self.p.get(C, C) * R::from_f64(4.0)).min(variance[C]);
        let [of_b, of_r_s, of_v, of_knee, of_leakage, of_gamma] = self.initial.variance;
        (variance[B], variance[B + 1]) = (of_b, of_b);
        (variance[RS], variance[V], variance[KNEE], variance[GAMMA]) = (of_r_s, of_v, of_knee, of_gamma);
        variance[LEAKAGE] = of_leakage;
        self.reset_states(c);
        self.reset_covariance(&variance);
        self.i_s = i_s;
        let m = psi_s - self.sigma_l_s(c) * i_s.re();
        self.psi_s.set(AlphaBeta::new(psi_s, R::ZERO));
        self.m = Integrator::new(m);
        let per_gamma = self.flux_per_gamma(c, m);
        let gamma = self.p.get(GAMMA, GAMMA);
        let common = per_gamma * per_gamma * gamma;
        for (i, j, x) in [(PSI, PSI, common), (M, M, common), (PSI, M, common)] {
            self.p.add_at(i, j, x);
        }
        self.p.add_at(PSI, GAMMA, -per_gamma * gamma);
        self.p.add_at(M, GAMMA, -per_gamma * gamma);
    }

    /// Change of a settled flux `m` per error of the inductance, in the scales of both.
    #[inline(never)]
    fn flux_per_gamma(&self, c: &FilterConfig<R>, m: R) -> R {
        // At rated flux g = 1, and the slope of the curve is 1 + S c.
        m * reciprocal(c.model.rated_slope(self.c.value())) * (R::from_f64(SCALE_GAMMA) * R::from_f64(1.0 / SCALE_PSI))
    }

    /// Begins in a machine in operation, at a flux `psi_s` whose components and whose rotor flux are known to a standard
    /// deviation `deviation`, per unit: for records that begin under way. The identified parameters stay as in
    /// [`Filter::start`].
    #[cold]
    #[inline(never)]
    pub fn join(&mut self, c: &FilterConfig<R>, i_s: &AlphaBeta<R>, psi_s: AlphaBeta<R>, deviation: R) {
        self.start(c, i_s);
        self.psi_s.set(psi_s);
        self.m = Integrator::new((psi_s - self.i_s * self.sigma_l_s(c)).norm_sq().sqrt());
        self.widen(deviation);
    }

    /// Turns the rotor flux to the current, with an angle that is as uncertain as after a loss.
    #[cfg(feature = "supervision")]
    pub fn turn_to_current(&mut self, c: &FilterConfig<R>) {
        if let Some(psi_s) = flux_along(&self.i_s, self.m.value(), self.sigma_l_s(c)) {
            self.psi_s.set(psi_s);
            self.forget(c);
        }
    }

    /// Covariance after a loss of the angle: the prior, with the flux at [`SIGMA_AGAIN`]. The states stay.
    #[cold]
    #[inline(never)]
    pub(super) fn forget(&mut self, c: &FilterConfig<R>) {
        let mut variance = c.noise.prior();
        let again = R::from_f64(SIGMA_AGAIN) * R::from_f64(1.0 / SCALE_PSI);
        (variance[PSI], variance[PSI + 1]) = (again * again, again * again);
        self.reset_covariance(&variance);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::PerUnit;
    use crate::estimate::kalman::Identified;
    use crate::params::{Inverter, Machine};

    #[test]
    fn joins_a_machine_in_operation_at_its_flux_with_the_given_deviation() {
        let (machine, inverter) = (Machine::preset_11k(), Inverter::preset_11k());
        let pu = PerUnit::new(&machine, &inverter).unwrap();
        let identified = Identified { offset: true, resistance: true, flux: true };
        let c = FilterConfig::<f64>::new(&machine, &inverter, &pu, 1.0, false, identified);
        let mut filter = Filter::new(&c);
        let (psi_s, i_s) = (AlphaBeta::new(-0.6, 0.8), AlphaBeta::new(0.3, 0.4));
        filter.join(&c, &i_s, psi_s, 0.1);
        assert_eq!(filter.value(), psi_s);
        let psi_r = psi_s - i_s * pu.sigma_l_s;
        assert!((filter.m.value() - psi_r.norm_sq().sqrt()).abs() < 1e-9);
        let variance = (0.1 / SCALE_PSI) * (0.1 / SCALE_PSI);
        for k in [PSI, PSI + 1, M] {
            assert!((filter.p.get(k, k) - c.noise.prior()[k] - variance).abs() < 1e-9);
        }
        assert_eq!(filter.p.get(RS, RS), c.noise.prior()[RS]);
    }

    /// A filter at the settled flux of a direct current.
    fn settled() -> (FilterConfig<f64>, Filter<f64>) {
        let (machine, inverter) = (Machine::preset_11k(), Inverter::preset_11k());
        let pu = PerUnit::new(&machine, &inverter).unwrap();
        let identified = Identified { offset: true, resistance: true, flux: true };
        let c = FilterConfig::new(&machine, &inverter, &pu, 1.0, true, identified);
        let mut filter = Filter::new(&c);
        filter.start(&c, &AlphaBeta::new(0.3, 0.0));
        filter.settle(&c, 1.0);
        (c, filter)
    }

    #[test]
    fn the_settled_flux_keeps_what_the_transient_has_shown_of_the_saturation() {
        let (c, mut filter) = settled();
        let prior = c.noise.prior()[C];
        for (before, after) in [(prior / 100.0, prior / 25.0), (prior, prior)] {
            let own = filter.p.get(C, C);
            filter.p.add_at(C, C, before - own);
            filter.c.set(0.21);
            filter.settle(&c, 1.0);
            assert_eq!(filter.c.value(), 0.21);
            assert!((filter.p.get(C, C) / after - 1.0).abs() < 1e-12);
        }
    }
}
