//! Flux control: reference with field weakening, feedforward of i_d from (12), PI correction.
//!
//! (12) holds for the correct field orientation and is implicit in `i_d`; solved for a reference,
//!
//! ```text
//! i_d* = ψ*/l_s + [p - √(p² - (2 σl_s i_q)²)] / (2 σl_s),    p = (1 - σ) ψ*
//! |i_q| < p / (2 σl_s)                                              pull-out
//! ```
//!
//! with the leakage factor `σ = σl_s/l_s`. With a leakage of `λσl_s` the same holds with `p = (1/λ - σ) ψ*`.
//!
//! Near pull-out that is a good part of the current: at 0.8 of the pull-out current a leakage 20 % larger takes 19 % more
//! `i_d`, without which the flux falls, and with it the pull-out torque.
//!
//! That is a limit of the steady state. With the angle `δ` between the fluxes, `x = |i_q|/i_q,pull-out = sin 2δ`, and
//!
//! ```text
//! tan δ = σl_s i_q/(ψ - σl_s i_d) ≤ 1/2        at x ≤ 0.8
//! ```
//!
//! contains the rotor flux that there is: less than in the steady state where a flux builds up, and where a limit that takes the leakage for
//! smaller than it is has let it collapse, a growing `i_d` makes up for it, and `ψ` does not tell
//! ([`FluxControlConfig::within_load_angle`], in field weakening; at rated flux the limit of `Δi_d` below keeps `i_d` from it).
//!
//! The PI part corrects errors of the inductances; with `e = ψ* - |ψ̂_s|`,
//!
//! ```text
//! Δi_d = y + x,    y = m y⁻ + (1 - m) w k_p e,    dx/dτ = k_i (w e - (1 - w) x),    |x|, |Δi_d| ≤ limit
//! ```
//!
//! The low-pass filter, `m` = 1/2 or 4/5, is for machines with a long rotor time constant, whose gain through the leakage is
//! large; `m` is zero at others.
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
    /// `1/l_s`.
    pub inv_l_s: R,
    /// `1 - σ`, coefficient of `ψ*` in `p`.
    pub one_minus_sigma: R,
    /// `(2 σl_s)²`, coefficient of `-i_q²`.
    pub root_i_q: R,
    /// `1 / (2 σl_s)`.
    pub inv_two_sigma_l_s: R,
    /// Part `m` of the last proportional correction that is kept.
    pub memory: R,
    /// Proportional gain times `1 - m`.
    pub k_p: R,
    /// Integral gain times the time between two calls.
    pub k_i: R,
    /// Largest correction of i_d.
    pub limit: R,
    /// Largest correction at high frequency.
    pub limit_high: R,
    /// Proportional gain in field weakening times `1 - m`.
    pub k_p_weak: R,
    /// Integral gain there times the time between two calls.
    pub k_i_weak: R,
}
words! {
    FluxControlConfig:
    psi_rated, inv_psi_rated, inv_l_s, one_minus_sigma, root_i_q, inv_two_sigma_l_s, memory, k_p, k_i, limit, limit_high, k_p_weak, k_i_weak,
}

/// State of the flux controller.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct FluxController<R: Real> {
    x: Integrator<R>,
    /// Proportional correction behind its low-pass filter.
    y: R,
    /// Reciprocal root of the radicand of the last call.
    inv_root: R,
}

impl<R: Real> FluxControlConfig<R> {
    /// `1/ψ*`; a division in field weakening only.
    #[inline]
    pub fn reciprocal(&self, psi_ref: R) -> R {
        if likely(psi_ref == self.psi_rated) { self.inv_psi_rated } else { psi_ref.recip() }
    }

    /// Torque current at a load angle of 26.6°, that of 0.8 of pull-out, for the rotor flux that a flux `psi` and a direct current leave; the
    /// leakage as in [`FluxController::step`].
    #[inline(always)]
    pub fn within_load_angle(&self, psi: R, inv_leakage: Option<R>, i_d: R) -> R {
        let half = psi * self.inv_two_sigma_l_s;
        (inv_leakage.map_or(half, |x| half * x) - i_d.half()).max(R::ZERO)
    }

    /// `i_d*` of (12) without torque current.
    #[inline(always)]
    pub fn no_load(&self, psi_ref: R) -> R {
        psi_ref * self.inv_l_s
    }
}

/// Weight of the PI part by the stator frequency, for an estimate whose magnitude is that of the voltage model.
#[inline(always)]
pub fn weight_by_frequency<R: Real>(omega_s: R) -> R {
    ((omega_s.abs() - R::from_f64(OMEGA_BEGIN)) * R::from_f64(INV_FADE)).clamp(R::ZERO, R::ONE)
}

impl<R: Real> FluxController<R> {
    /// Resets the integrator.
    pub fn start(&mut self) {
        *self = Self::default();
    }

    /// Field weakening has ended. What the integrator holds there is the current with which the flux follows the speed;
    /// with the gains of rated flux it would go on for some rotor time constants.
    #[cold]
    pub fn leave_weakening(&mut self) {
        self.x = Integrator::default();
    }

    /// One period; returns `i_d*`: that of (12), its part for the torque at the flux `psi` and its part without load at the flux
    /// `psi_no_load`, for a leakage of `1/inv_leakage` times that of the parameters (`None`: that of the parameters), and the PI part of
    /// an `error` of the flux with a `weight` from 0 to 1.
    #[inline(always)]
    pub fn step(
        &mut self,
        c: &FluxControlConfig<R>,
        (psi, psi_no_load, inv_leakage): (R, R, Option<R>),
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
        let p = psi * inv_leakage.map_or(c.one_minus_sigma, |x| c.one_minus_sigma + (x - R::ONE));
        let radicand = (p * p - i_q * i_q * c.root_i_q).max(R::ZERO);
        self.inv_root = radicand.rsqrt_near(self.inv_root);
        self.y = error * k_p * weight + self.y * c.memory;
        c.no_load(psi_no_load) + (p - radicand * self.inv_root) * c.inv_two_sigma_l_s + (self.y + x).limit(limit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn config() -> FluxControlConfig<f64> {
        let (l_s, sl) = (1.67, 0.143);
        FluxControlConfig {
            psi_rated: 1.0,
            inv_psi_rated: 1.0,
            inv_l_s: 1.0 / l_s,
            one_minus_sigma: 1.0 - sl / l_s,
            root_i_q: 4.0 * sl * sl,
            inv_two_sigma_l_s: 0.5 / sl,
            memory: 0.0,
            k_p: 1.0,
            k_i: 0.003,
            limit: 0.2,
            k_p_weak: 2.0,
            k_i_weak: 0.02,
            limit_high: 1.0,
        }
    }

    /// `i_d*` of (12): what the controller asks for without an error of the flux.
    fn feedforward(c: &FluxControlConfig<f64>, psi_ref: f64, i_q: f64) -> f64 {
        FluxController::default().step(c, (psi_ref, psi_ref, None), 0.0, i_q, 0.0, Range::Low)
    }

    #[test]
    fn feedforward_solves_equation_12() {
        let (c, l_s, sl) = (config(), 1.67, 0.143);
        for k in 0..30 {
            let i_q = f64::from(k) * 0.1;
            let i_d = feedforward(&c, 1.0, i_q);
            let rhs = (1.0 + l_s * sl * (i_d * i_d + i_q * i_q)) / (l_s + sl);
            assert!((i_d - rhs).abs() < 1e-12);
        }
        assert!((feedforward(&c, 1.0, 0.0) - 1.0 / 1.67).abs() < 1e-12);
        assert!((c.no_load(0.9) - 0.9 / 1.67).abs() < 1e-12);
        let pull_out = (1.0 - sl / l_s) / (2.0 * sl);
        assert!((c.one_minus_sigma * c.one_minus_sigma - c.root_i_q * pull_out * pull_out).abs() < 1e-9);
    }

    #[test]
    fn the_load_angle_is_that_of_four_fifths_of_pull_out_in_the_steady_state_and_less_current_where_the_rotor_flux_is_less()
     {
        let (c, l_s, sl) = (config(), 1.67, 0.143);
        for (psi, leakage) in [(1.0, 1.0), (0.5, 1.0), (0.5, 1.4)] {
            let s = leakage * sl;
            let i_q = 0.8 * (1.0 - s / l_s) / (2.0 * s) * psi;
            let i_d =
                FluxController::default().step(&c, (psi, psi, Some(1.0 / leakage)), 0.0, i_q, 0.0, Range::Weakened);
            let most = |i_d: f64| c.within_load_angle(psi, Some(1.0 / leakage), i_d);
            assert!((most(i_d) - i_q).abs() < 1e-3, "{psi} {leakage}: {} of {i_q}", most(i_d));
            assert!((most(i_d + 0.4) - most(i_d) + 0.2).abs() < 1e-9);
            assert_eq!(most(psi / s + 0.1), 0.0, "no rotor flux");
        }
        assert_eq!(c.within_load_angle(0.5, None, 0.6), c.within_load_angle(0.5, Some(1.0), 0.6));
    }

    /// `i_d*` beyond the feedforward, after `periods` at a flux and a stator frequency.
    fn correction(ctrl: &mut FluxController<f64>, psi_s: f64, omega_s: f64, periods: u32) -> f64 {
        let c = config();
        let mut i_d = 0.0;
        for _ in 0..periods {
            i_d = ctrl.step(&c, (1.0, 1.0, None), 1.0 - psi_s, 0.3, weight_by_frequency(omega_s), Range::Low);
        }
        i_d - feedforward(&c, 1.0, 0.3)
    }

    #[test]
    fn a_flux_that_is_missing_is_asked_for_up_to_the_limit_and_no_more_is_held() {
        for sign in [1.0, -1.0] {
            let mut ctrl = FluxController::default();
            assert!((sign * correction(&mut ctrl, 1.0 - 0.1 * sign, 0.5, 1) - 0.1003).abs() < 1e-6, "k_p and k_i");
            assert!((sign * correction(&mut ctrl, 1.0 - 0.5 * sign, 0.5, 10_000) - 0.2).abs() < 1e-9);
            // The integrator holds the limit and nothing beyond it.
            assert!((sign * correction(&mut ctrl, 1.0 + 0.05 * sign, 0.5, 1) - 0.15).abs() < 2e-3);
        }
    }

    #[test]
    fn the_flux_estimate_counts_as_far_as_the_voltage_tells_it() {
        for sign in [1.0, -1.0] {
            let first = |omega: f64| correction(&mut FluxController::default(), 0.9, sign * omega, 1);
            assert!(first(0.0).abs() < 1e-9 && first(0.0199).abs() < 1e-9);
            assert!((first(0.04) - 0.5 * 0.1003).abs() < 1e-6);
            assert!((first(0.06) - 0.1003).abs() < 1e-6 && (first(0.3) - 0.1003).abs() < 1e-6);
        }
    }

    #[test]
    fn at_zero_stator_frequency_the_correction_is_forgotten() {
        let mut ctrl = FluxController::default();
        correction(&mut ctrl, 0.5, 0.5, 10_000);
        let k_i = config().k_i;
        assert!((correction(&mut ctrl, 0.5, 0.0, (1.0 / k_i) as u32) - 0.2 * (-1.0f64).exp()).abs() < 1e-3);
        assert!(correction(&mut ctrl, 0.5, 0.0, 10_000).abs() < 1e-9);
    }

    #[test]
    fn beyond_pull_out_the_current_is_that_of_pull_out() {
        let (c, mut ctrl) = (config(), FluxController::default());
        for i_q in [6.0, -50.0] {
            let i_d = ctrl.step(&c, (1.0, 1.0, None), 0.0, i_q, 0.0, Range::Low);
            assert!((i_d - c.inv_l_s - c.one_minus_sigma * c.inv_two_sigma_l_s).abs() < 1e-6, "{i_d}");
        }
    }

    #[test]
    fn the_feedforward_is_that_of_the_leakage_that_is_there() {
        let (c, l_s, sl) = (config(), 1.67, 0.143);
        for leakage in [0.7, 1.0, 1.25] {
            let s = leakage * sl;
            let pull_out = 0.8 * (1.0 - s / l_s) / (2.0 * s);
            for (psi, part) in [(1.0, 1.0), (1.0, -0.9), (0.7, 0.9), (1.0, 0.0)] {
                let i_q = psi * part * pull_out;
                let i_d =
                    FluxController::default().step(&c, (psi, psi, Some(1.0 / leakage)), 0.0, i_q, 0.0, Range::Low);
                let rhs = (psi * psi + l_s * s * (i_d * i_d + i_q * i_q)) / ((l_s + s) * psi);
                assert!((i_d - rhs).abs() < 1e-3, "{leakage}, {psi}, {i_q}: {i_d} and {rhs}");
            }
        }
        // That of the parameters is too little: a tenth of the current at 1.25 of the leakage.
        let i_q = 0.8 * (1.0 - 1.25 * sl / l_s) / (2.5 * sl);
        let with = FluxController::default().step(&c, (1.0, 1.0, Some(1.0 / 1.25)), 0.0, i_q, 0.0, Range::Low);
        let without = FluxController::default().step(&c, (1.0, 1.0, None), 0.0, i_q, 0.0, Range::Low);
        assert!(with > 1.1 * without, "{with} against {without}");
    }

    #[test]
    fn the_reciprocal_follows_the_reference() {
        for psi in [1.0, 0.5, 0.2] {
            assert!((config().reciprocal(psi) * psi - 1.0).abs() < 1e-12);
        }
    }
}
