//! One estimator for flux, offset, resistance and inverter error, over the whole torque-speed plane.
//!
//! # What is known without a speed
//!
//! The voltage model is a pure integrator. With the offset `b` of the current sensors (`i_m = i + b`), the
//! resistance `r_s` and the relative error `v` of the inverter model's voltage `u_l` as unknowns,
//!
//! ```text
//! dψ_s/dτ = u - v u_l - r_s (i_m - b),        ψ_R = ψ_s - σl_s (i_m - b)
//! ```
//!
//! The rotor equation `dψ_R/dτ = -(1/τ_r) ψ_R + r_R i + jω ψ_R` contains the unknown speed, but only in its
//! tangential component. Along `n = ψ_R/|ψ_R|` the speed drops out, and what is left says how the *magnitude*
//! of the rotor flux follows the current:
//!
//! ```text
//! dm/dτ = r_R (i·n - i_μ(m)),     i_μ(m) = γ m/l_M (1 - c + c (m/m_N)⁸)
//! |ψ_R| - m = 0
//! ```
//!
//! with `γ` for an inductance that is not `l_M` and `c` for its saturation: at the small-signal level
//! saturation makes the magnitude follow the current `1 + 8c` times faster, and a model without it loses
//! stability near `ω_s = 0`. Differentiated once, the second line is the speed-independent residual of
//! reduced-order observers, `ψ_R·dψ_R/dτ + (|ψ_R|² - l_M i·ψ_R)/τ_r`; in this form nothing has to be
//! differentiated, and the noise of the ADC enters as `σl_s` times it.
//!
//! # What one number can tell
//!
//! Let `δ` be the flux error in rotor field coordinates. The residual is `δ_d` less the current model's own
//! answer to it, and that model sees `i·n` change by `i_q δ_q/|ψ_R|`. So
//! * at no load only the radial error shows, under load a combination with the angle (weight `i_q/i_d`);
//! * an error of `r_s` or `v` moves the flux along the current, one of `b` along a direction fixed in the
//!   stator: rotation tells them apart;
//! * at exactly `ω_s = 0` one direction remains unseen. Its variance grows, and with it the confidence signal
//!   drops: persistence there is memory. Under load a drive need not stay there ([`crate::control::shift`]).
//!
//! An extended Kalman filter in error-state form weighs all this in every quadrant alike; there is nothing to
//! gate and no sign to choose. States: `ψ_s` (2), `m`, `b` (2), `r_s`, `v`, `γ`, `c`, each in units of a
//! typical deviation, so that the covariance fits fixed point.
//!
//! # In blocks
//!
//! Prediction runs every control period, the rest once per block of about 1 ms: averages, one scalar
//! innovation, one correction. The covariance of a block is worked out during the next one, a part in each
//! period; the gain is a block old, against time constants of many blocks.
//!
//! # Where linearisation ends
//!
//! * `|ψ_R|` of a vector turned by `δ` is larger than its projection by `δ²/2`: the variance of that is added
//!   to the residual's, or a large angle variance would turn a small residual into a false correction.
//! * Near the zero of a phase current the bridge's voltage is known least (see [`crate::inverter`]): noise
//!   along that phase's axis while the field is slow.
//! * Above `ω_s = 0.2` neither `r_s` nor `v` can be seen beside the error of the voltage itself: they are
//!   held, with the variance they have, and that error takes their place in the flux.
//! * `m` is driven by `r_R`, which is known to some 20 %: where the current is away from the steady state, `m`
//!   collects noise. Otherwise a change of current would tell the stator resistance from the rotor's.
//! * A residual beyond its measure for some ten blocks means that something has stepped: flux, offset and
//!   resistance may then have moved by more than they do by themselves.

mod config;
mod covariance;
mod state;

pub use config::{FilterConfig, Identified};

use self::config::{DRIFT_ZERO, RESIDUAL, SCALE_GAMMA, SCALE_PSI, TRANSIENT};
use self::covariance::{Column, Covariance, N};
use self::state::{B, C, GAMMA, M, PSI, RS, V};
use super::confidence::SIGMA_HALF;
use super::flux::FluxEstimate;
use super::integral::FluxIntegral;
use crate::scalar::{Integrator, Real, clamp_seldom, likely};
use crate::space::{AlphaBeta, Dq, Rotator};

/// Limits of what is identified.
const B_MAX: f64 = 0.2;
const V_MAX: f64 = 0.8;
const GAMMA_RANGE: (f64, f64) = (0.6, 1.6);
const C_MAX: f64 = 0.5;
/// Of the prior: a winding is not colder than at commissioning by more, nor hotter.
const R_S_RANGE: (f64, f64) = (0.4, 2.0);
/// Rotor flux below which its direction says nothing.
const M_MIN: f64 = 0.1;
/// Stator frequency above which resistance and inverter error are held.
const OMEGA_HELD: f64 = 0.2;
/// Stator frequency up to which the voltage near a current zero counts, reciprocal.
const INV_OMEGA_ZERO: f64 = 10.0;
/// Smallest variance of a scaled state: keeps rounding from making one negative.
const FLOOR: f64 = 1e-7;
/// Low-pass of the normalised squared residual, per block, and its value that counts as a surprise.
const NIS_CORNER: f64 = 0.05;
const NIS_SURPRISE: f64 = 0.3;
/// Blocks after a start in which nothing counts as a surprise: the priors are still being tried.
const TRIAL: u32 = 200;
/// Deviation of the angle, rad, from which on the covariance begins anew: nothing is known of it any more. It begins
/// with this deviation, which fixed point resolves.
const SIGMA_LOST: f64 = 3.0;
const SIGMA_AGAIN: f64 = 0.5;
/// Weight of the second-order term's variance.
const SECOND_ORDER: f64 = 2.0;

/// Averages and model values of a block: where the next covariance is linearised.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
struct Point<R: Real> {
    /// Direction of the rotor flux.
    n: Rotator<R>,
    /// `1/|ψ_R|`.
    inv_psi_r: R,
    /// Current reference: free from noise, which would pass for excitation.
    i_s: AlphaBeta<R>,
    /// Voltage of the inverter model.
    u_l: AlphaBeta<R>,
    /// Sensitivity of `m` to a turn of the flux, `r_R Δ i_q/|ψ_R|`.
    turn: R,
    /// `m`, `m g`, and `g' = dg(m)m/dm`, with `g = 1 - c + c x⁸`.
    m: R,
    m_g: R,
    slope: R,
    /// `x⁸ - 1`.
    bend: R,
    /// Distance from the steady state, of the scale of fluxes.
    away: R,
    omega_s: R,
    /// The rotor flux is large enough for its direction to mean something.
    valid: bool,
}

impl<R: Real> Point<R> {
    /// Too fast for resistance and inverter error to be seen.
    fn held(&self) -> bool {
        self.omega_s.abs() > R::from_f64(OMEGA_HELD)
    }
}

/// What the filter sees of one period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Input<R: Real> {
    /// Voltage applied since the last call.
    pub u_s: AlphaBeta<R>,
    /// The part of it that the inverter model took.
    pub u_l: AlphaBeta<R>,
    /// Current sample at the end.
    pub i_m: AlphaBeta<R>,
    /// Current reference, field coordinates.
    pub i_ref: Dq<R>,
    /// Stator frequency.
    pub omega_s: R,
}

/// State of the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Filter<R: Real> {
    psi_s: FluxIntegral<R>,
    m: Integrator<R>,
    b: [Integrator<R>; 2],
    r_s: Integrator<R>,
    v: Integrator<R>,
    gamma: Integrator<R>,
    c: Integrator<R>,
    i_s: AlphaBeta<R>,
    u_i: AlphaBeta<R>,
    /// Sum of the current over the block, field coordinates.
    sum: Dq<R>,
    /// Period within the block.
    period: u32,
    point: Point<R>,
    p: Covariance<R>,
    /// `P h`, of which `1/S` makes the gain that the next innovation gets; before, a row of the transition.
    ph: Column<R>,
    /// `1/S` of the last block.
    inv_s: R,
    /// Residual, and low-pass of its normalised square.
    residual: R,
    nis: R,
    /// Blocks for which residuals are not yet a surprise.
    trial: u32,
    /// Deviation of the field angle, rad.
    sigma: R,
    /// What was known before the start under way, and how well: `b`, `r_s`, `v`, `γ`.
    brought: Learned<R>,
    brought_variance: [R; 4],
}

/// Part of its prior variance that is left of a state after a stop, at least: resistance, bridge and inductance move
/// with temperature, an offset hardly does.
const fn known(k: usize) -> f64 {
    if k == B || k == B + 1 { 1.0 / 256.0 } else { 1.0 / 16.0 }
}

impl<R: Real> Filter<R> {
    /// A filter that knows the priors.
    #[must_use]
    pub fn new(c: &FilterConfig<R>) -> Self {
        let (mut filter, prior) = (Self::empty(), c.prior());
        filter.brought = Learned { b: AlphaBeta::default(), r_s: c.r_s, v: R::ZERO, gamma: R::ONE };
        filter.brought_variance = [B, RS, V, GAMMA].map(|k| prior[k]);
        filter.c = Integrator::new(c.saturation);
        filter.rewind(c);
        filter
    }

    /// A filter that knows nothing.
    #[inline(always)]
    fn empty() -> Self {
        Self {
            psi_s: FluxIntegral::default(),
            m: Integrator::default(),
            b: Default::default(),
            r_s: Integrator::default(),
            v: Integrator::default(),
            gamma: Integrator::default(),
            c: Integrator::default(),
            i_s: AlphaBeta::default(),
            u_i: AlphaBeta::default(),
            sum: Dq::default(),
            period: 0,
            point: Point::default(),
            p: Covariance::default(),
            ph: [R::ZERO; N],
            inv_s: R::ZERO,
            residual: R::ZERO,
            nis: R::ZERO,
            trial: TRIAL,
            sigma: R::ZERO,
            brought: Learned { b: AlphaBeta::default(), r_s: R::ZERO, v: R::ZERO, gamma: R::ZERO },
            brought_variance: [R::ZERO; 4],
        }
    }

    /// Takes back what an earlier run has learned, each within its limits. What is restored counts as known to
    /// a quarter of its prior deviation, an offset to a sixteenth.
    pub fn restore(&mut self, c: &FilterConfig<R>, learned: &Learned<R>) {
        let r = R::from_f64;
        self.brought = Learned {
            b: learned.b.limit_components(r(B_MAX)),
            r_s: clamp_seldom(learned.r_s, c.r_s * r(R_S_RANGE.0), c.r_s * r(R_S_RANGE.1)),
            v: clamp_seldom(learned.v, r(-V_MAX), r(V_MAX)),
            gamma: clamp_seldom(learned.gamma, r(GAMMA_RANGE.0), r(GAMMA_RANGE.1)),
        };
        let prior = c.prior();
        self.brought_variance = [B, RS, V, GAMMA].map(|k| prior[k] * r(known(k)));
        self.rewind(c);
    }

    /// What is worth keeping.
    pub fn learned(&self) -> Learned<R> {
        Learned { b: self.b(), r_s: self.r_s(), v: self.v(), gamma: self.gamma.value() }
    }

    /// Begins with a machine without flux; what has been learned stays.
    pub fn start(&mut self, c: &FilterConfig<R>, i_s: &AlphaBeta<R>) {
        // What was learned before the stop may have changed since: temperature, above all.
        self.brought = self.learned();
        let prior = c.prior();
        self.brought_variance =
            [self.kept::<B>(&prior), self.kept::<RS>(&prior), self.kept::<V>(&prior), self.kept::<GAMMA>(&prior)];
        self.rewind(c);
        self.i_s = *i_s - self.b();
    }

    /// Variance with which a state comes out of a stop.
    #[inline(always)]
    fn kept<const K: usize>(&self, prior: &Column<R>) -> R {
        clamp_seldom(self.p.get(K, K), prior[K] * R::from_f64(known(K)), prior[K])
    }

    /// As the filter was before the start under way, but for the saturation.
    #[cold]
    #[inline(never)]
    fn rewind(&mut self, c: &FilterConfig<R>) {
        let (bent, brought, brought_variance) = (self.c, self.brought, self.brought_variance);
        *self = Self::empty();
        let Learned { b, r_s, v, gamma } = brought;
        self.b = [Integrator::new(b.re()), Integrator::new(b.im())];
        (self.r_s, self.v) = (Integrator::new(r_s), Integrator::new(v));
        (self.gamma, self.c) = (Integrator::new(gamma), bent);
        let mut variance = c.prior();
        let [of_b, of_r_s, of_v, of_gamma] = brought_variance;
        (variance[B], variance[B + 1]) = (of_b, of_b);
        (variance[RS], variance[V], variance[GAMMA]) = (of_r_s, of_v, of_gamma);
        self.p.set_diagonal(&variance);
        (self.brought, self.brought_variance) = (brought, brought_variance);
    }

    /// Begins anew with the flux `psi_s` that a direct current along the a-axis has built up in a machine at
    /// rest. It is as well known as the inductance: an error `δγ` is one of `-m g/(d(m g)/dm) δγ` of it. Of what
    /// the build-up has told, only the saturation is kept: it shapes the transient, while all the rest drowns in
    /// the integral of a wrong resistance.
    pub fn settle(&mut self, c: &FilterConfig<R>, psi_s: R) {
        let i_s = self.i_s;
        let prior = c.prior()[C];
        let variance = (self.p.get(C, C) * R::from_f64(4.0)).min(prior);
        self.rewind(c);
        self.i_s = i_s;
        self.p.add_at(C, C, variance - prior);
        let m = psi_s - c.sigma_l_s * i_s.re();
        self.psi_s.set(AlphaBeta::new(psi_s, R::ZERO));
        self.m = Integrator::new(m);
        // At rated flux g = 1 and its slope 1 + 8c, whatever c is.
        let bent = R::ONE + R::from_f64(8.0) * self.c.value();
        let per_gamma = m * bent.recip() * (R::from_f64(SCALE_GAMMA) * R::from_f64(1.0 / SCALE_PSI));
        let gamma = self.p.get(GAMMA, GAMMA);
        let common = per_gamma * per_gamma * gamma;
        for (i, j, x) in [(PSI, PSI, common), (M, M, common), (PSI, M, common)] {
            self.p.add_at(i, j, x);
        }
        self.p.add_at(PSI, GAMMA, -per_gamma * gamma);
        self.p.add_at(M, GAMMA, -per_gamma * gamma);
    }

    /// One period; returns the current of its sample in field coordinates. With `blind` nothing is corrected: the
    /// machine has no flux yet.
    #[inline(always)]
    pub fn step(&mut self, c: &FilterConfig<R>, x: &Input<R>, blind: bool) -> Dq<R> {
        let i_s = x.i_m - self.b();
        self.u_i = x.u_s - (self.i_s + i_s) * self.r_s().half();
        self.i_s = i_s;
        self.psi_s.add(c.t_s, &self.u_i);
        let i_dq = self.field().to_field(&i_s);
        self.sum += i_dq;
        self.work(c, x, blind);
        i_dq
    }

    /// The part of a block's work that this period does.
    #[inline(never)]
    fn work(&mut self, c: &FilterConfig<R>, x: &Input<R>, blind: bool) {
        self.period += 1;
        if self.period >= c.block {
            self.period = 0;
            self.close(c, x, blind);
            return;
        }
        match self.period {
            1 => self.prepare_m(c),
            2 => self.advance_m(c),
            3 | 4 => self.advance_psi(c, self.period == 4),
            5 => self.add_noise(c),
            6 => self.weigh(c),
            7 => self.reduce_to_4(),
            8 => self.reduce_to_6(),
            9 => self.reduce_to_8(),
            _ => {}
        }
    }

    /// End of a block: current model, residual, correction, and the point of the next linearisation.
    #[inline(never)]
    fn close(&mut self, c: &FilterConfig<R>, input: &Input<R>, blind: bool) {
        let i_dq = self.sum * c.inv_block;
        self.sum = Dq::default();
        let psi_s = self.value();
        let psi_r = psi_s - self.i_s * c.sigma_l_s;
        let (n, psi_r, inv) = Rotator::near(&psi_r, self.point.inv_psi_r);
        let valid = !blind && psi_r > R::from_f64(M_MIN);
        let inv = inv.min(R::from_f64(1.0 / M_MIN));

        // The mean current seen from the rotor flux: ψ_R·i = ψ_s i_d - σl_s i², ψ_R×i = ψ_s i_q.
        let i_d = (self.magnitude() * i_dq.re() - c.sigma_l_s * i_dq.norm_sq()) * inv;
        let i_q = self.magnitude() * i_dq.im() * inv;

        let m = self.m.value();
        let (gamma, bent) = (self.gamma.value(), self.c.value());
        let x = (m * c.inv_m_rated).min(R::from_f64(1.3));
        let x2 = x * x;
        let x8 = x2 * x2 * (x2 * x2);
        let g = R::ONE - bent + bent * x8;
        let m_g = m * g;
        let m_steady = gamma * m_g;
        self.point = Point {
            n,
            inv_psi_r: inv,
            i_s: self.field().to_stator(&input.i_ref),
            u_l: input.u_l,
            turn: c.r_r_block * (i_q * inv).limit(R::TWO),
            m,
            m_g,
            slope: gamma * (g + R::from_f64(8.0) * (bent * x8)),
            bend: x8 - R::ONE,
            away: (i_d * c.l_m - m_steady) * R::from_f64(TRANSIENT / SCALE_PSI),
            omega_s: input.omega_s,
            valid,
        };
        if !valid {
            self.m.set(psi_r);
            return;
        }
        let m = self.m.add(R::ONE, c.r_r_block * i_d - c.decay * m_steady);
        let z = (m - psi_r) * R::from_f64(1.0 / SCALE_PSI);
        self.residual = z;
        if self.trial == 0 {
            let nis = (z * z * self.inv_s).min(R::from_f64(9.0));
            self.nis += R::from_f64(NIS_CORNER) * (nis - self.nis);
        } else {
            self.trial -= 1;
        }
        self.correct(c, z.limit(R::from_f64(20.0)));
    }

    /// Every state takes its part of the residual.
    #[inline(always)]
    fn correct(&mut self, c: &FilterConfig<R>, z: R) {
        let scale = c.scale();
        let by: Column<R> = core::array::from_fn(|k| self.ph[k] * self.inv_s * scale[k]);
        let r = R::from_f64;
        self.psi_s.correct([by[PSI], by[PSI + 1]], z);
        nudge(&mut self.m, by[M], z, R::ZERO, r(3.0));
        nudge(&mut self.b[0], by[B], z, r(-B_MAX), r(B_MAX));
        nudge(&mut self.b[1], by[B + 1], z, r(-B_MAX), r(B_MAX));
        nudge(&mut self.r_s, by[RS], z, c.r_s * r(R_S_RANGE.0), c.r_s * r(R_S_RANGE.1));
        nudge(&mut self.v, by[V], z, r(-V_MAX), r(V_MAX));
        nudge(&mut self.gamma, by[GAMMA], z, r(GAMMA_RANGE.0), r(GAMMA_RANGE.1));
        nudge(&mut self.c, by[C], z, R::ZERO, r(C_MAX));
    }

    /// `m` follows flux direction, offset, inductance and saturation.
    #[inline(always)]
    fn terms_of_m(&self, c: &FilterConfig<R>) -> [(usize, R); 6] {
        let q = &self.point;
        let [by_b, by_gamma, by_c] = c.of_m();
        [
            (PSI, -q.turn * q.n.sin),
            (PSI + 1, q.turn * q.n.cos),
            (B, -by_b * q.n.cos),
            (B + 1, -by_b * q.n.sin),
            (GAMMA, -by_gamma * q.m_g),
            (C, -by_c * (self.gamma.value() * q.m * q.bend)),
        ]
    }

    /// The row of `m`, for the period after.
    #[inline(never)]
    fn prepare_m(&mut self, c: &FilterConfig<R>) {
        self.ph = self.p.project(&self.terms_of_m(c));
    }

    /// The row that the period before has prepared takes its place.
    #[inline(never)]
    fn advance_m(&mut self, c: &FilterConfig<R>) {
        let terms = self.terms_of_m(c);
        self.p.advance::<M, 6>(R::ONE - c.decay * self.point.slope, &terms, &self.ph);
    }

    /// The first or the second component of the flux follows its offset, the resistance and the inverter error.
    #[inline(never)]
    fn advance_psi(&mut self, c: &FilterConfig<R>, second: bool) {
        let (i, u) = (&self.point.i_s, &self.point.u_l);
        let (i, u) = if second { (i.im(), u.im()) } else { (i.re(), u.re()) };
        let (i, u) = if self.point.held() { (R::ZERO, R::ZERO) } else { (i, u) };
        let [by_b, by_r_s, by_v] = c.of_psi();
        self.p.advance_psi(second, [by_b * self.r_s(), -by_r_s * i, -by_v * u]);
    }

    /// What the states may have done by themselves.
    #[inline(never)]
    fn add_noise(&mut self, c: &FilterConfig<R>) {
        let q = &self.point;
        let omega = q.omega_s.abs();
        let surprised = !q.held() && self.nis > R::from_f64(NIS_SURPRISE);
        let mut drift = c.drift(if surprised { self.nis - R::from_f64(NIS_SURPRISE) } else { R::ZERO });
        if q.held() {
            (drift[RS], drift[V]) = (R::ZERO, R::ZERO);
            self.p.isolate(RS);
            self.p.isolate(V);
        }
        let lag = c.lag * q.away;
        drift[M] += lag * lag;
        let fast = c.drift_omega * omega * omega;
        drift[PSI] += fast;
        drift[PSI + 1] += fast;

        let slow = (R::ONE - omega * R::from_f64(INV_OMEGA_ZERO)).max(R::ZERO);
        let zero = R::from_f64(DRIFT_ZERO) * slow * slow;
        // Products of the components of the phase axes: (1, 0), (-1/2, ±√3/2).
        let (three_quarters, mixed) = (R::from_f64(0.75), R::from_f64(0.433_012_7));
        for (k, i) in q.i_s.to_phases().into_iter().enumerate() {
            if i.within(c.zero) {
                if k == 0 {
                    drift[PSI] += zero;
                } else {
                    drift[PSI] += zero.quarter();
                    drift[PSI + 1] += zero * three_quarters;
                    let mixed = zero * mixed;
                    self.p.add_at(PSI, PSI + 1, if k == 1 { -mixed } else { mixed });
                }
            }
        }
        self.p.add(&drift);
    }

    /// Variance of the angle, variance of the residual, gain.
    #[inline(never)]
    fn weigh(&mut self, c: &FilterConfig<R>) {
        let q = &self.point;
        let Rotator { cos, sin } = q.n;
        let p = &self.p;
        let mixed = sin * cos * p.get(PSI, PSI + 1);
        let across = sin * sin * p.get(PSI, PSI) + cos * cos * p.get(PSI + 1, PSI + 1) - (mixed + mixed);
        let across = across.max(R::ZERO);
        self.sigma = across.sqrt() * R::from_f64(SCALE_PSI) * q.inv_psi_r;

        if !(q.valid && c.correct) {
            self.ph = [R::ZERO; N];
            return;
        }
        self.ph = p.project(&[(PSI, cos), (PSI + 1, sin), (M, -R::ONE)]);
        let residual = R::from_f64(RESIDUAL);
        let second = across * R::from_f64(SCALE_PSI) * q.inv_psi_r;
        let s = cos * self.ph[PSI] + sin * self.ph[PSI + 1] - self.ph[M]
            + residual
            + q.away * q.away
            + R::from_f64(SECOND_ORDER) * (second * second);
        self.inv_s = s.max(residual).recip();
    }

    // Row by row, the covariance loses what the residual has told.
    #[inline(never)]
    fn reduce_to_4(&mut self) {
        let gain = self.gain::<5>();
        self.reduce::<0>(&gain);
        self.reduce::<1>(&gain);
        self.reduce::<2>(&gain);
        self.reduce::<3>(&gain);
        self.reduce::<4>(&gain);
    }

    #[inline(never)]
    fn reduce_to_6(&mut self) {
        let gain = self.gain::<7>();
        self.reduce::<5>(&gain);
        self.reduce::<6>(&gain);
    }

    #[inline(never)]
    fn reduce_to_8(&mut self) {
        let gain = self.gain::<N>();
        self.reduce::<7>(&gain);
        self.reduce::<8>(&gain);
    }

    /// Row `I` of the covariance loses what the residual has told.
    #[inline(always)]
    fn reduce<const I: usize>(&mut self, gain: &[R]) {
        self.p.reduce::<I>(self.ph[I], gain, R::from_f64(FLOOR));
    }

    /// Gains of the first states.
    #[inline(always)]
    fn gain<const K: usize>(&self) -> [R; K] {
        core::array::from_fn(|k| self.ph[k] * self.inv_s)
    }

    /// A current sample while nothing is estimated.
    pub fn rest(&mut self, i_s: &AlphaBeta<R>) {
        self.i_s = *i_s;
    }

    /// Present `ψ̂_s`.
    #[inline]
    pub fn value(&self) -> AlphaBeta<R> {
        self.psi_s.value()
    }

    /// Field angle as `e^{jδ̂}`.
    #[inline]
    pub fn field(&self) -> Rotator<R> {
        self.psi_s.field()
    }

    /// `|ψ̂_s|`.
    #[inline]
    pub fn magnitude(&self) -> R {
        self.psi_s.magnitude()
    }

    /// Stator resistance.
    #[inline]
    pub fn r_s(&self) -> R {
        self.r_s.value()
    }

    /// Offset of the current sensors.
    #[inline]
    pub fn b(&self) -> AlphaBeta<R> {
        AlphaBeta::new(self.b[0].value(), self.b[1].value())
    }

    /// Relative error of the inverter model's voltage.
    #[inline]
    pub fn v(&self) -> R {
        self.v.value()
    }

    /// Current of the latest sample without its offset.
    #[inline]
    pub fn i_s(&self) -> AlphaBeta<R> {
        self.i_s
    }

    /// Latest residual `m - |ψ̂_R|`, in units of the scale of fluxes (0.05).
    pub fn residual(&self) -> R {
        self.residual
    }

    /// Expected deviation of the field angle, rad.
    pub fn sigma(&self) -> R {
        self.sigma
    }

    /// Confidence in the field angle, 0 to 1, as of [`super::confidence`]: one half where 15° must be expected.
    /// Residuals beyond their measure count as an angle, too.
    #[inline(never)]
    pub fn confidence(&self) -> R {
        let x = self.sigma * R::from_f64(1.0 / SIGMA_HALF);
        let y = self.nis * R::from_f64(1.0 / NIS_SURPRISE);
        (R::ONE + x * x + y * y).recip()
    }

    /// Flux estimator outputs of the latest period.
    pub fn estimate(&self) -> FluxEstimate<R> {
        FluxEstimate {
            psi_s: self.value(),
            field: self.field(),
            magnitude: self.magnitude(),
            u_i: self.u_i,
            u_hf: AlphaBeta::default(),
        }
    }

    /// Brings back what has left its range: the flux, and a covariance that rounding or a lost estimate has driven
    /// out of it.
    #[inline]
    pub fn confine(&mut self, c: &FilterConfig<R>) {
        self.psi_s.confine();
        if !likely(self.sigma.within(R::from_f64(SIGMA_LOST))) {
            self.forget(c);
        }
    }

    /// Nothing is known any more but what was known at the start, and of the flux not even that.
    #[cold]
    #[inline(never)]
    fn forget(&mut self, c: &FilterConfig<R>) {
        let mut variance = c.prior();
        let again = R::from_f64(SIGMA_AGAIN) * R::from_f64(1.0 / SCALE_PSI);
        (variance[PSI], variance[PSI + 1]) = (again * again, again * again);
        self.p.set_diagonal(&variance);
    }
}

/// A state takes its part of a residual, once in the code for all of them.
#[inline(never)]
fn nudge<R: Real>(x: &mut Integrator<R>, gain: R, z: R, lo: R, hi: R) {
    x.add_clamped(gain, z, lo, hi);
}

/// What a filter has learned of machine, bridge and sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Learned<R: Real> {
    /// Offset of the current sensors beyond the one read at rest.
    pub b: AlphaBeta<R>,
    /// Stator resistance.
    pub r_s: R,
    /// Relative error of the inverter model.
    pub v: R,
    /// Reciprocal of the main inductance, relative to its prior.
    pub gamma: R,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{Base, PerUnit};
    use crate::params::{Inverter, Machine};

    /// A linear machine under impressed current, exact in every period, as the filter sees it.
    struct Rig {
        c: FilterConfig<f64>,
        filter: Filter<f64>,
        psi_s: AlphaBeta<f64>,
    }

    const OMEGA: f64 = 0.05;
    const B_TRUE: (f64, f64) = (0.01, -0.006);

    /// Runs `seconds` at a torque current, with a resistance that is `r_s` times the parameter.
    fn run(correct: bool, i_q: f64, r_s: f64, seconds: f64) -> Rig {
        let machine = Machine { saturation: None, ..Machine::preset_11k() };
        let inverter = Inverter::preset_11k();
        let pu = PerUnit::new(&machine, &inverter).unwrap();
        let b = Base::new(&machine);
        let identified = Identified { offset: true, resistance: true, flux: correct };
        let c = FilterConfig::new(&machine, &inverter, &pu, 1.0, false, identified);
        let (l_m, r_r) = (machine.L_M / b.l, machine.R_R / b.z);
        let (t_s, steps): (f64, usize) = (pu.t_s, (seconds * inverter.f_s) as usize);
        let m = 0.95;
        let (i_d, omega_s): (f64, f64) = (m / l_m, OMEGA + r_r * i_q / m);
        let offset = AlphaBeta::new(B_TRUE.0, B_TRUE.1);
        // The current turns with the flux that it keeps: both are known at every instant.
        let at = |k: usize| {
            let (sin, cos) = (omega_s * t_s * k as f64).sin_cos();
            let e = Rotator { cos, sin };
            let i = e.to_stator(&Dq::new(i_d, i_q));
            (i, e.axis() * m + i * pu.sigma_l_s)
        };
        let mut filter = Filter::new(&c);
        filter.start(&c, &(at(0).0 + offset));
        let (i, psi_s) = at(0);
        filter.psi_s.set(psi_s);
        filter.m = Integrator::new(m);
        filter.i_s = i + offset;
        for k in 1..=steps {
            let ((i, psi), (i_last, psi_last)) = (at(k), at(k - 1));
            let u_s = (i + i_last) * (0.5 * c.r_s * r_s) + (psi - psi_last) * (1.0 / t_s);
            let i_ref = filter.field().to_field(&i);
            let x = Input { u_s, u_l: AlphaBeta::default(), i_m: i + offset, i_ref, omega_s };
            filter.step(&c, &x, false);
        }
        Rig { c, filter, psi_s: at(steps).1 }
    }

    impl Rig {
        fn angle(&self) -> f64 {
            let psi = self.filter.value();
            self.psi_s.cross(&psi).atan2(self.psi_s.dot(&psi)).to_degrees()
        }
    }

    #[test]
    fn offset_and_resistance_are_found_in_motoring_and_regeneration() {
        for i_q in [0.6, -0.6, -0.9] {
            let rig = run(true, i_q, 1.2, 20.0);
            let (f, c) = (&rig.filter, &rig.c);
            assert!(rig.angle().abs() < 0.3, "{i_q}: {}°", rig.angle());
            assert!((f.r_s() / c.r_s - 1.2).abs() < 0.02, "{i_q}: {}", f.r_s() / c.r_s);
            let b = f.b();
            assert!((b.re() - B_TRUE.0).abs() < 5e-4 && (b.im() - B_TRUE.1).abs() < 5e-4, "{i_q}: {b:?}");
            assert!(f.sigma().to_degrees() < 2.0 && f.confidence() > 0.9);
        }
    }

    #[test]
    fn without_the_residual_the_flux_drifts_away() {
        let rig = run(false, -0.6, 1.2, 20.0);
        assert!(rig.angle().abs() > 10.0 || (rig.filter.magnitude() - 1.0).abs() > 0.3);
        assert!(rig.filter.confidence() < 0.5, "and the filter knows it");
    }

    #[test]
    fn what_was_learned_makes_the_next_start_confident() {
        let rig = run(true, 0.6, 1.2, 20.0);
        let mut next = Filter::new(&rig.c);
        next.restore(&rig.c, &rig.filter.learned());
        next.start(&rig.c, &AlphaBeta::default());
        assert_eq!(next.r_s(), rig.filter.r_s());
        let prior = rig.c.prior();
        assert!(next.p.get(RS, RS) <= prior[RS] / 16.0 && next.p.get(B, B) <= prior[B] / 256.0);
    }
}
