//! Flux control: reference with field weakening, feedforward of i_d from (12), PI correction.
//!
//! (12) holds for the correct field orientation and is implicit in `i_d`; solved for a reference,
//!
//! ```text
//! i_d* = [(1 + 2 λγ) ψ* - √(ψ*² - (k i_q)²)]/k,    k = 2λ (1 + λγ),    λ = σl_s,  γ = 1/l_M
//! |i_q| < ψ*/k                                                            pull-out
//! ```
//!
//! with what the scheme has learned of both inductances ([`FluxController::step`]). It is the flux asked for that counts,
//! also where the one that is estimated differs: `i_d*` of the latter would hold it where it is.
//!
//! The PI part corrects errors of the inductances; with `e = ψ* - |ψ̂_s|`,
//!
//! ```text
//! Δi_d = w k_p e + x,    dx/dτ = k_i (w e - (1 - w) x),    |x|, |Δi_d| ≤ limit
//! ```
//!
//! Its weight `w`, 0 to 1, is the scheme's: in the published one it falls to zero between `|ω_s|` = 0.06 and 0.02 pu
//! ([`weight_by_frequency`]), where the noise compensator holds the amplitude of the estimate, so that it contains no
//! information on the true flux; the feedforward alone sets the flux there. In the enhanced one it follows from the
//! variance of `|ψ̂_s|` at every frequency, and is reduced to 0.12 of that in regeneration near zero stator frequency
//! only.
//!
//! Beyond pull-out the radicand is taken as zero: `i_d*` is that at pull-out.
//!
//! At high stator frequency the estimate is that of the voltage model in either scheme, and the limit is wider
//! ([`Range`]). In field weakening the flux has to follow the speed: there the gains belong to the leakage, through which
//! `i_d` acts on the stator flux within the rotor's transient time constant `στ_r`, `ψ_s ≈ σl_s i_d + ψ_R`,
//!
//! ```text
//! k_p = 0.15/σl_s,    k_i = 0.05 ω_c/σl_s
//! ```
//!
//! with the bandwidth `ω_c` of current control. The integral part alone crosses at `0.05 ω_c` there; below `1/στ_r` the
//! loop gain rises.

use crate::scalar::{Integrator, Real, likely};
use crate::words::words;

/// Stator frequency, per unit, below which [`weight_by_frequency`] is zero, and reciprocal of the width to one.
const OMEGA_BEGIN: f64 = 0.02;
const INV_FADE: f64 = 25.0;

/// Where a drive runs, as far as flux control is concerned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Range {
    /// Low stator frequency.
    Low,
    /// High stator frequency, [`FREQUENCY_HIGH`]: the limit is wider.
    High,
    /// Field weakening: the limit is wider, and the gains are those of the transient.
    Weakened,
}

/// Stator frequency, per unit, from which on the limit is wider.
pub const FREQUENCY_HIGH: f64 = 0.3;

/// Settings of the flux controller.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct FluxControlConfig<R: Real> {
    /// Rated flux reference, per unit as all of these.
    pub psi_rated: R,
    /// Its reciprocal.
    pub inv_psi_rated: R,
    /// Leakage inductance `λ`.
    pub leakage: R,
    /// Inverse main inductance `γ`.
    pub gamma: R,
    /// `1/k`.
    pub inv_k: R,
    /// Proportional gain.
    pub k_p: R,
    /// Integral gain times the time between two calls.
    pub k_i: R,
    /// Largest correction of i_d.
    pub limit: R,
    /// Largest correction at high frequency.
    pub limit_high: R,
    /// Gains in field weakening.
    pub k_p_weak: R,
    /// Integral gain times the time between two calls.
    pub k_i_weak: R,
}
words! {
    FluxControlConfig:
    psi_rated, inv_psi_rated, leakage, gamma, inv_k, k_p, k_i, limit, limit_high, k_p_weak, k_i_weak,
}

/// State of the flux controller.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct FluxController<R: Real> {
    x: Integrator<R>,
    /// Reciprocal root of the radicand of the last call, and its `1/k`.
    inv_root: R,
    inv_k: R,
}

impl<R: Real> FluxControlConfig<R> {
    /// `1/ψ*`; a division in field weakening only.
    #[inline]
    pub fn reciprocal(&self, psi_ref: R) -> R {
        if likely(psi_ref == self.psi_rated) { self.inv_psi_rated } else { psi_ref.recip() }
    }

    /// Magnetising current `ψ*/l_s` of a flux, with the inductances of the parameters.
    #[cold]
    pub fn magnetising_current(&self, psi_ref: R) -> R {
        psi_ref * self.gamma * (R::ONE + self.leakage * self.gamma).recip()
    }
}

/// Weight of the PI part by the stator frequency, for an estimate whose magnitude is that of the voltage model.
#[inline(always)]
pub fn weight_by_frequency<R: Real>(omega_s: R) -> R {
    ((omega_s.abs() - R::from_f64(OMEGA_BEGIN)) * R::from_f64(INV_FADE)).clamp(R::ZERO, R::ONE)
}

impl<R: Real> FluxController<R> {
    /// Begins without a correction.
    pub fn start(&mut self, c: &FluxControlConfig<R>) {
        *self = Self { inv_k: c.inv_k, ..Self::default() };
    }

    /// One period; returns `i_d*`: that of (12) for a flux `psi_ref` with leakage and inverse main inductance relative to
    /// the parameters, and the PI part of an `error` of the flux with a `weight` from 0 to 1.
    #[inline(always)]
    pub fn step(
        &mut self,
        c: &FluxControlConfig<R>,
        (psi_ref, [leakage, gamma]): (R, [R; 2]),
        error: R,
        i_q: R,
        weight: R,
        range: Range,
    ) -> R {
        let (k_p, k_i, limit) = match range {
            Range::Low => (c.k_p, c.k_i, c.limit),
            Range::High => (c.k_p, c.k_i, c.limit_high),
            Range::Weakened => (c.k_p_weak, c.k_i_weak, c.limit_high),
        };
        let x = self.x.value();
        // At weight zero the integrator decays with the rate k_i.
        let leak = x * (R::ONE - weight);
        let x = self.x.add_limited(k_i, error * weight - leak, limit);
        let leakage = c.leakage * leakage;
        let part = leakage * (c.gamma * gamma);
        let half = leakage + leakage * part;
        let k = half + half;
        // The inductances change by far less than a hundredth from call to call: a Newton step, which also comes from the
        // nominal ones to those that were learned before a restart.
        self.inv_k = (self.inv_k + self.inv_k * (R::ONE - k * self.inv_k)).max(c.inv_k.quarter());
        let across = k * i_q;
        let radicand = (psi_ref * psi_ref - across * across).max(R::ZERO);
        self.inv_root = radicand.rsqrt_near(self.inv_root);
        let i_d = (psi_ref + psi_ref * (part + part) - radicand * self.inv_root) * self.inv_k;
        i_d + (error * k_p * weight + x).limit(limit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const L_S: f64 = 1.67;
    const SIGMA_L_S: f64 = 0.143;
    const NOMINAL: [f64; 2] = [1.0; 2];

    fn started() -> FluxController<f64> {
        let mut ctrl = FluxController::default();
        ctrl.start(&config());
        ctrl
    }

    /// `i_d*` without an error of the flux, once it stands.
    fn feedforward(psi: f64, inductances: [f64; 2], i_q: f64) -> f64 {
        let (c, mut ctrl) = (config(), started());
        (0..50).map(|_| ctrl.step(&c, (psi, inductances), 0.0, i_q, 1.0, Range::Low)).last().unwrap()
    }

    pub(super) fn config() -> FluxControlConfig<f64> {
        FluxControlConfig {
            psi_rated: 1.0,
            inv_psi_rated: 1.0,
            leakage: SIGMA_L_S,
            gamma: 1.0 / (L_S - SIGMA_L_S),
            inv_k: 0.5 * (L_S - SIGMA_L_S) / (L_S * SIGMA_L_S),
            k_p: 1.0,
            k_i: 0.003,
            limit: 0.2,
            k_p_weak: 2.0,
            k_i_weak: 0.02,
            limit_high: 1.0,
        }
    }

    #[test]
    fn feedforward_solves_equation_12_with_the_inductances_that_were_learned() {
        for [of_leakage, of_gamma] in [NOMINAL, [1.3, 1.15], [0.8, 0.9]] {
            let (leakage, l_m) = (of_leakage * SIGMA_L_S, (L_S - SIGMA_L_S) / of_gamma);
            let l_s = l_m + leakage;
            for k in 0..30 {
                let i_q = f64::from(k) * 0.08;
                let i_d = feedforward(1.0, [of_leakage, of_gamma], i_q);
                let rhs = (1.0 + l_s * leakage * (i_d * i_d + i_q * i_q)) / (l_s + leakage);
                assert!((i_d - rhs).abs() < 1e-9, "{i_d} {rhs}");
            }
            assert!((feedforward(1.0, [of_leakage, of_gamma], 0.0) - 1.0 / l_s).abs() < 1e-9);
        }
        assert!((config().magnetising_current(0.8) - 0.8 / L_S).abs() < 1e-12);
        let pull_out = (1.0 - SIGMA_L_S / L_S) / (2.0 * SIGMA_L_S);
        assert!((config().inv_k - pull_out).abs() < 1e-9);
    }

    /// `i_d*` beyond the feedforward, after `periods` at a flux and a stator frequency.
    fn correction(ctrl: &mut FluxController<f64>, psi_s: f64, omega_s: f64, periods: u32) -> f64 {
        let c = config();
        let mut i_d = 0.0;
        for _ in 0..periods {
            i_d = ctrl.step(&c, (1.0, NOMINAL), 1.0 - psi_s, 0.3, weight_by_frequency(omega_s), Range::Low);
        }
        i_d - feedforward(1.0, NOMINAL, 0.3)
    }

    #[test]
    fn a_flux_that_is_missing_is_asked_for_up_to_the_limit_and_no_more_is_held() {
        for sign in [1.0, -1.0] {
            let mut ctrl = started();
            assert!((sign * correction(&mut ctrl, 1.0 - 0.1 * sign, 0.5, 1) - 0.1003).abs() < 1e-6, "k_p and k_i");
            assert!((sign * correction(&mut ctrl, 1.0 - 0.5 * sign, 0.5, 10_000) - 0.2).abs() < 1e-9);
            // The integrator holds the limit and nothing beyond it.
            assert!((sign * correction(&mut ctrl, 1.0 + 0.05 * sign, 0.5, 1) - 0.15).abs() < 2e-3);
        }
    }

    #[test]
    fn the_flux_estimate_counts_as_far_as_the_voltage_tells_it() {
        for sign in [1.0, -1.0] {
            let first = |omega: f64| correction(&mut started(), 0.9, sign * omega, 1);
            assert!(first(0.0).abs() < 1e-9 && first(0.0199).abs() < 1e-9);
            assert!((first(0.04) - 0.5 * 0.1003).abs() < 1e-6);
            assert!((first(0.06) - 0.1003).abs() < 1e-6 && (first(0.3) - 0.1003).abs() < 1e-6);
        }
    }

    #[test]
    fn at_zero_stator_frequency_the_correction_is_forgotten() {
        let mut ctrl = started();
        correction(&mut ctrl, 0.5, 0.5, 10_000);
        let k_i = config().k_i;
        assert!((correction(&mut ctrl, 0.5, 0.0, (1.0 / k_i) as u32) - 0.2 * (-1.0f64).exp()).abs() < 1e-3);
        assert!(correction(&mut ctrl, 0.5, 0.0, 10_000).abs() < 1e-9);
    }

    #[test]
    fn beyond_pull_out_the_current_is_that_of_pull_out() {
        let (c, mut ctrl) = (config(), started());
        for i_q in [6.0, -50.0] {
            let i_d = ctrl.step(&c, (1.0, NOMINAL), 0.0, i_q, 0.0, Range::Low);
            assert!((i_d - (1.0 + 2.0 * c.leakage * c.gamma) * c.inv_k).abs() < 1e-6, "{i_d}");
        }
    }

    #[test]
    fn the_reciprocal_follows_the_reference() {
        for psi in [1.0, 0.5, 0.2] {
            assert!((config().reciprocal(psi) * psi - 1.0).abs() < 1e-12);
        }
    }
}
