//! Stator resistance adaptation of Fig. 12 on (14), (15).
//!
//! ```text
//! ε = ψ̂_s² - (l_s + σl_s) i_d ψ̂_s + l_s σl_s i_s²                               (15)
//! dr̂_s/dτ = k ε sign(ω̂_s i_q)
//! ```
//!
//! With `Δr_s = r̂_s - r_s` and `κ = Δr_s/ω_s` the steady state of (15) is exactly
//! `ε = -(2 ψ* κ i_q + κ² i_s²)`: the sign of the correction follows the quadrant, a fixed sign diverges in
//! regeneration. The sensitivity is `i_q/ω_s`, so the adaptation is frozen
//! * below a smallest `|i_q|` (15 % of rated in the paper: Fig. 11, the loci meet at no load),
//! * below a smallest `|ω_s|`: there the relation is a transient one and its sign depends on the load,
//! * above a largest `|ω_s|`, where `ε` tells parameters from noise no more,
//! * while `i_q` moves: the early response to a load step has a sign of its own,
//! * in regeneration with 0 < ω_s < ω, where that response turns the field further away, however low the gain,
//!
//! and slowed to a tenth where the early response of ε has the opposite sign: above 60 % load and while braking against
//! the field (ω_s and ω of opposite signs). Between, the gain falls with `p = |ω_s| τ_r |i_q|/i_qR`. An error of r̂_s turns
//! and shrinks the flux of the machine, which follows within τ_r only, and with the gain k the loop through it swings with
//! a growing amplitude beyond about `k p = 0.37` 1/s (at 11 kW, τ_r = 0.3 s, ω_s = 0.05 and 35 % load within 20 s from 0.6
//! to 20 % of r_s). The gain is k up to p = 0.75 and falls on a straight line below that limit, `(3/2 - 2p/3) k`, to 0.4 k.
//! `r̂_s` stays within ±50 % of the prior ([`range`]): nameplate or dc measurement.
//!
//! Feature `variants`:
//! * **Quotient** (caption of Fig. 12, N and D): `ε ω̂_s/i_q` in place of `ε sign(ω̂_s i_q)`. By the steady state above
//!   that is `-2 ψ* Δr_s`: the error itself, with sign and size, so that the time constant does not depend on speed and
//!   load. The sign law is `i_q/ω_s` times as fast: slower by ten from ω_s = 0.01 to 0.1.
//! * **At rest** (Fig. 13a): without load and with ω_s about zero ε does have a steady state. The noise compensator
//!   takes up `Δr_s i_d` along the field, which displaces the radius by `Δψ = -Δr_s i_d/k`: ε > 0 for r̂_s < r_s, whatever
//!   the direction, `dr̂_s/dτ = k ε`. An error of `l_s` or a remaining offset displaces it as well and is then taken for
//!   resistance.
//! * **Light load**: [`super::light_load`] moves the same integrator where this law is frozen for want of `i_q`.

use crate::scalar::{Integrator, Real};
use crate::space::Dq;
use crate::words::words;

/// Settings of the adaptation.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct ResistanceConfig<R: Real> {
    /// `l_s + σl_s`.
    pub l_sum: R,
    /// `l_s · σl_s`.
    pub l_product: R,
    /// Gain at partial load, motoring, per unit of `r_s` and call; elsewhere a tenth of it.
    pub gain: R,
    /// Smallest `|i_q|`.
    pub i_q_min: R,
    /// `|i_q|` above which the load counts as high.
    pub i_q_high: R,
    /// Slope by which the gain falls with load and frequency, `2 τ_r/(75 i_qR)`: the part of it that counts is
    /// `3/2 - 25 |ω_s| · swing_slope |i_q|`, between 0.4 and one.
    pub swing_slope: R,
    /// Smallest `|ω_s|`.
    pub omega_min: R,
    /// Largest `|ω_s|`.
    pub omega_max: R,
    /// Change of `i_q` against its low-pass that counts as a transient.
    pub transient: R,
    /// Corner frequency of that low-pass times the time between two calls.
    pub corner: R,
    /// Calls for which a transient freezes the adaptation.
    pub hold: u32,
    /// The quotient of Fig. 12: `ω_s/i_q` times this, in place of its sign; zero: the sign.
    #[cfg(feature = "variants")]
    pub quotient: R,
}
words! {
    ResistanceConfig:
    l_sum, l_product, gain, i_q_min, i_q_high, swing_slope, omega_min, omega_max, transient, corner, hold,
    #[cfg(feature = "variants")] quotient,
}

/// Range of a resistance around its prior, ±50 %: cold and hot windings, and the tolerance of a nameplate.
#[inline(always)]
pub fn range<R: Real>(prior: R) -> (R, R) {
    let half = prior.half();
    (half, half + prior)
}

/// State of the adaptation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct ResistanceEstimator<R: Real> {
    r_s: Integrator<R>,
    prior: R,
    i_q_slow: Integrator<R>,
    frozen: u32,
    epsilon: R,
}

impl<R: Real> ResistanceEstimator<R> {
    /// Begins at `r_s`, which is also the prior that bounds the estimate.
    pub fn start(&mut self, r_s: R) {
        *self = Self { r_s: Integrator::new(r_s), prior: r_s, ..Self::default() };
    }

    /// One call in field coordinates; returns `r̂_s`.
    #[inline(always)]
    pub fn step(&mut self, c: &ResistanceConfig<R>, psi_s: R, i: &Dq<R>, omega_s: R, omega_m: R) -> R {
        let (i_d, i_q) = (i.re(), i.im());
        self.epsilon = (psi_s - c.l_sum * i_d) * psi_s + c.l_product * i.norm_sq();

        let slow = self.i_q_slow.value();
        self.i_q_slow.add(c.corner, i_q - slow);
        self.frozen = if (i_q - slow).abs() > c.transient { c.hold } else { self.frozen.saturating_sub(1) };

        let omega = omega_s.abs();
        if self.frozen > 0 || i_q.abs() < c.i_q_min || omega < c.omega_min || omega > c.omega_max {
            return self.r_s.value();
        }
        // i_q and ω_s are beyond their smallest values here: neither sign is of a zero.
        let negative = i_q < R::ZERO;
        let regeneration = (omega_m < R::ZERO) != negative;
        if regeneration && (omega_m < R::ZERO) == (omega_s < R::ZERO) {
            return self.r_s.value();
        }
        let part = if regeneration || i_q.abs() > c.i_q_high {
            R::from_f64(0.1)
        } else {
            let fallen = R::from_f64(1.5) - omega * R::from_f64(25.0) * (c.swing_slope * i_q.abs());
            fallen.max(R::from_f64(0.4)).min(R::ONE)
        };
        let gain = c.gain * part;
        // The limit keeps a single disturbed sample from mattering.
        let epsilon = self.epsilon.limit(R::HALF);
        #[cfg(feature = "variants")]
        let gain = if c.quotient > R::ZERO { gain * (c.quotient * omega * i_q.abs().recip()) } else { gain };
        let epsilon = if (omega_s < R::ZERO) == negative { epsilon } else { -epsilon };
        self.add(gain, epsilon)
    }

    /// Moves the estimate within its range.
    fn add(&mut self, gain: R, x: R) -> R {
        let (lo, hi) = range(self.prior);
        self.r_s.add_clamped(gain, x, lo, hi)
    }

    /// Whether the load is light and steady: too small an `i_q` for (15).
    #[cfg(feature = "variants")]
    pub fn is_light(&self, c: &ResistanceConfig<R>, i_q: R) -> bool {
        self.frozen == 0 && i_q.abs() < c.i_q_min
    }

    /// After [`Self::step`], at rest without load: follows the radius (Fig. 13a).
    #[cfg(feature = "variants")]
    pub fn adapt_at_rest(&mut self, c: &ResistanceConfig<R>) {
        self.add(c.gain, self.epsilon.limit(R::HALF));
    }

    /// After [`Self::step`], at light load: the error that [`super::light_load`] found, times its gain.
    #[cfg(feature = "variants")]
    pub fn follow(&mut self, gain: R, error: R) {
        self.add(gain, error);
    }

    /// Present estimate.
    #[inline]
    pub fn r_s(&self) -> R {
        self.r_s.value()
    }

    /// The residual ε of (15).
    pub fn epsilon(&self) -> R {
        self.epsilon
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config() -> ResistanceConfig<f64> {
        let (l_s, sl) = (1.67, 0.143);
        ResistanceConfig {
            l_sum: l_s + sl,
            l_product: l_s * sl,
            gain: 3e-5,
            i_q_min: 0.1,
            i_q_high: 1.0,
            swing_slope: 2.5,
            omega_min: 0.004,
            omega_max: 0.2,
            transient: 0.05,
            corner: 0.0015,
            hold: 100,
            #[cfg(feature = "variants")]
            quotient: 0.0,
        }
    }

    /// The currents that the exact steady state of the machine gives for a wrong r̂_s.
    fn closed_form_epsilon(kappa: f64, i_q: f64, i_s2: f64) -> f64 {
        -(2.0 * kappa * i_q + kappa * kappa * i_s2)
    }

    #[test]
    fn residual_vanishes_on_the_heyland_circle() {
        let c = config();
        let (l_s, sl) = (1.67_f64, 0.143_f64);
        for i_q in [0.0_f64, 0.3, 0.7] {
            let b = l_s + sl;
            let i_d = (b - (b * b - 4.0 * l_s * sl * (1.0 + l_s * sl * i_q * i_q)).sqrt()) / (2.0 * l_s * sl);
            let mut est = ResistanceEstimator::default();
            est.start(0.08);
            est.step(&c, 1.0, &Dq::new(i_d, i_q), 0.02, 0.02);
            assert!(est.epsilon().abs() < 1e-12);
        }
    }

    #[test]
    fn correction_has_the_right_sign_in_all_quadrants_and_freezes_without_signal() {
        // Without the term in i_s² (15) is solved for i_d at once: i_d = (1 - ε)/(l_s + σl_s).
        let c = ResistanceConfig { l_product: 0.0, ..config() };
        for (omega, i_q) in [(0.02, 0.5), (-0.02, -0.5), (0.02, -0.5), (-0.02, 0.5), (0.02, 0.05), (0.001, 0.5)] {
            let mut est = ResistanceEstimator::default();
            est.start(0.1);
            for _ in 0..30_000 {
                let kappa = (est.r_s() - 0.08) / omega;
                let i_d = (1.0 - closed_form_epsilon(kappa, i_q, 0.36 + i_q * i_q)) / c.l_sum;
                est.step(&c, 1.0, &Dq::new(i_d, i_q), omega, omega);
            }
            // Slip against the rotation at the same sign of ω_s and ω: regeneration.
            let frozen = i_q.abs() < 0.1 || omega.abs() < 0.004 || omega * i_q < 0.0;
            if frozen {
                assert_eq!(est.r_s(), 0.1);
            } else {
                assert!((est.r_s() - 0.08).abs() < 0.015, "{omega} {i_q} {}", est.r_s());
            }
        }
    }

    /// Change of `r̂_s` in one call with a residual, in units of the gain.
    fn moved(epsilon: f64, i_q: f64, omega_s: f64, omega_m: f64) -> f64 {
        let c = ResistanceConfig { l_product: 0.0, transient: 10.0, ..config() };
        let mut est = ResistanceEstimator::default();
        est.start(0.08);
        (est.step(&c, 1.0, &Dq::new((1.0 - epsilon) / c.l_sum, i_q), omega_s, omega_m) - 0.08) / c.gain
    }

    #[test]
    fn high_load_is_a_tenth_as_fast_and_regeneration_holds() {
        for ((i_q, omega_s, omega_m), speed) in [
            ((0.4, 0.02, 0.02), 1.0),
            ((-0.4, -0.02, -0.02), 1.0),
            ((-0.5, 0.02, 0.04), 0.0),
            ((0.5, -0.02, -0.04), 0.0),
            ((-0.5, -0.02, 0.02), 0.1),
            ((0.5, 0.02, -0.02), 0.1),
            ((1.2, 0.02, 0.02), 0.1),
            ((-1.2, -0.02, -0.02), 0.1),
            ((0.5, 0.3, 0.3), 0.0),
            ((0.5, -0.3, -0.3), 0.0),
        ] {
            assert!((moved(0.01, i_q, omega_s, omega_m) - 0.01 * speed).abs() < 1e-9, "{i_q} {omega_s} {omega_m}");
        }
    }

    #[test]
    fn the_gain_falls_with_the_product_of_load_and_frequency_down_to_four_tenths() {
        for (i_q, omega, part) in
            [(0.4, 0.02, 1.0), (0.4, 0.03, 0.75), (-0.4, -0.04, 0.5), (0.4, 0.08, 0.4), (0.9, 0.1, 0.4)]
        {
            let got = moved(0.01, i_q, omega, omega) / 0.01;
            assert!((got - part).abs() < 1e-6, "i_q = {i_q}, ω_s = {omega}: {got}");
        }
    }

    #[test]
    fn one_disturbed_sample_counts_as_half_at_most() {
        assert!((moved(7.0, 0.4, 0.02, 0.02) - 0.5).abs() < 1e-9);
        assert!((moved(-7.0, 0.4, 0.02, 0.02) + 0.5).abs() < 1e-9);
    }

    #[test]
    fn the_estimate_stays_within_half_of_the_prior() {
        let c = ResistanceConfig { transient: 10.0, ..config() };
        for (i_d, bound) in [(-1.0, 0.12), (1.5, 0.04)] {
            let mut est = ResistanceEstimator::default();
            est.start(0.08);
            for _ in 0..20_000 {
                est.step(&c, 1.0, &Dq::new(i_d, 0.5), 0.02, 0.02);
            }
            assert!((est.r_s() - bound).abs() < 1e-12, "{}", est.r_s());
        }
    }

    #[test]
    fn a_load_step_freezes_the_adaptation_until_its_low_pass_has_followed() {
        let c = config();
        for step in [0.2, -0.2] {
            let mut est = ResistanceEstimator::default();
            est.start(0.08);
            for _ in 0..20_000 {
                est.step(&c, 1.0, &Dq::new(0.6, 0.5), 0.02, 0.02);
            }
            let before = est.r_s();
            let calls =
                (0..5000).take_while(|_| est.step(&c, 1.0, &Dq::new(0.5, 0.5 + step), 0.02, 0.02) == before).count();
            // The low-pass needs ln(0.2/0.05)/corner, then the hold.
            let want = (0.2_f64 / c.transient).ln() / c.corner + f64::from(c.hold);
            assert!((calls as f64 - want).abs() < 3.0, "{calls} calls instead of {want}");
        }
    }
}
