//! Way out of a false equilibrium: when the torque is at its limit and the field stands still, the flux is taken to lie along
//! the current. Per unit.
//!
//! A shaft that stands while the torque is at its limit has `ω_s = ω_r`. Where the field stands still instead, either the
//! shaft turns backwards at the very speed of the slip, or the estimated angle is wrong by the angle of the current,
//!
//! ```text
//! δ̂ - δ = -arctan(i_q/i_d):    the flux lies along the current, T = 0
//! ```
//!
//! and nothing in it changes: the speed controller asks for all the torque there is, the slip of that torque makes up the
//! speed that it has not, and a dc current makes neither torque nor voltage. Under a load the angle is some degrees less, as
//! the torque needs it, the load drives the shaft and the field slowly backwards, and the field wanders to and fro.
//!
//! ```text
//! suspected: torque at its limit, -1 < ω̂_s/ω̂_r < 1/8;     n += 1 suspected, n -= 1 not
//! n = 0 wherever the low-pass of ω̂ has moved by |ω̂_r|/8
//! n = N:  ψ̂_R = |ψ̂_R| i/|i|,   ω̂ = ω̂_s
//! ```
//!
//! The speed is that of the field, since the flux along the current has no slip; the angle is as uncertain as after a loss.
//! Without torque instead, the current would lie along a wrong axis: its torque against the reference throws a small machine
//! back faster than the filter finds the field.
//!
//! Once within 10 N: what does not help is left to [`crate::supervision::stall`]. An acceleration, a braking through zero
//! speed and a load beyond the torque limit move the shaft by `(T - T_L) dτ/j`: to stand for `N` the load would have to meet
//! the torque limit within `j |ω̂_r|/(8 N)`, some hundredths of rated torque, at about the speed of the slip.
//!
//! `N` is 0.12 s, an allowance: a third of the default of `stall_time`, so that suspicion and what the filter makes of the
//! new angle have ended by then.
//!
//! Validity: speed control.

use crate::scalar::{Real, likely};
use crate::space::AlphaBeta;

/// Calls until the next time, in units of those of the suspicion.
const PAUSE: u32 = 10;
/// Coefficient of the low-pass of the speed: 25 ms at 10 kHz, against the wandering of the field.
const LOW_PASS: f64 = 1.0 / 32.0;
/// Bounds of the stator frequency of a field that stands, relative to `ω_r`, and the change that the speed may make.
const STANDS: (f64, f64) = (-1.0, 0.5);
const MOVED: f64 = 0.125;
/// Least current that has a direction.
const CURRENT_MIN: f64 = 0.1;

/// Stator flux whose rotor flux, of this magnitude, lies along the current.
pub fn flux_along<R: Real>(i_s: &AlphaBeta<R>, psi_r: R, sigma_l_s: R) -> Option<AlphaBeta<R>> {
    let length = i_s.norm_sq().sqrt();
    (length > R::from_f64(CURRENT_MIN)).then(|| *i_s * (sigma_l_s + psi_r * length.recip()))
}

/// State.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Realign<R: Real> {
    /// Suspicion; from its limit on the time since then.
    calls: u32,
    /// Speed when it began.
    omega: R,
    /// Its low-pass.
    mean: R,
}

impl<R: Real> Default for Realign<R> {
    fn default() -> Self {
        Self { calls: 0, omega: R::ZERO, mean: R::ZERO }
    }
}

impl<R: Real> Realign<R> {
    /// One call: whether the flux has to be turned to the current. `n`: calls of suspicion before that, `u32::MAX`: never. `limited`: 1 if
    /// the torque is at its upper limit, -1 at its lower one, else 0. `omega_r`: `ω_s - ω` of the estimate.
    #[inline(always)]
    pub fn step(&mut self, n: u32, limited: R, omega_s: R, omega_r: R) -> bool {
        if likely(limited == R::ZERO && self.calls == 0) {
            return false;
        }
        self.advance(n, limited, omega_s, omega_r)
    }

    /// Whether the flux was turned less than `n` calls ago: what the filter makes of it is no evidence against the field yet.
    #[inline(always)]
    pub fn is_settling(&self, n: u32) -> bool {
        !likely(self.calls < n) && self.calls < n.saturating_mul(2)
    }

    #[cold]
    #[inline(never)]
    fn advance(&mut self, n: u32, limited: R, omega_s: R, omega_r: R) -> bool {
        if self.calls >= n {
            self.calls = self.calls.saturating_add(1);
            if self.calls >= n.saturating_mul(PAUSE) {
                self.calls = 0;
            }
            return false;
        }
        let omega = omega_s - omega_r;
        self.mean += (omega - self.mean) * R::from_f64(LOW_PASS);
        if self.calls == 0 || !(self.mean - self.omega).within(omega_r.abs() * R::from_f64(MOVED)) {
            *self = Self { calls: 0, mean: omega, omega };
        }
        let (centre, width) = (
            omega_r * R::from_f64((STANDS.0 + STANDS.1) / 2.0),
            omega_r.abs() * R::from_f64((STANDS.1 - STANDS.0) / 2.0),
        );
        if limited != R::ZERO && (omega_s - centre).within(width) {
            self.calls += 1;
        } else {
            self.calls = self.calls.saturating_sub(1);
        }
        self.calls >= n
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use std::vec::Vec;

    use super::*;

    const N: u32 = 100;

    /// Calls of 2000 in which the flux is turned: torque at its limit, `ω_s`, `ω_r`.
    fn turned(x: impl Fn(f64) -> (f64, f64, f64)) -> Vec<u32> {
        let mut realign = Realign::default();
        (0..2000)
            .filter(|&k| {
                let (limited, omega_s, omega_r) = x(f64::from(k));
                realign.step(N, limited, omega_s, omega_r)
            })
            .collect()
    }

    #[test]
    fn a_field_that_stands_at_the_torque_limit_is_turned_once_in_a_while() {
        for sign in [1.0, -1.0] {
            // The slip grows, and with it the speed that makes up for it; the field stands.
            let calls = turned(|k| (sign, sign * (0.002 - 5e-5 * (k % 100.0)), sign * (0.08 + 1e-4 * (k % 100.0))));
            assert_eq!(calls, [99, 99 + 900 + 100], "not sooner");
        }
    }

    #[test]
    fn a_field_that_wanders_to_and_fro_stands() {
        for sign in [1.0, -1.0] {
            let calls = turned(|k| (sign, sign * (-0.015 + 0.01 * (0.4 * k).sin()), sign * 0.05));
            assert!(!calls.is_empty() && calls[0] < 2 * N, "{calls:?}");
        }
    }

    #[test]
    fn the_rotor_flux_is_turned_to_the_current_with_its_magnitude() {
        let i_s = AlphaBeta::new(-0.6, 0.8);
        let psi_r = flux_along(&i_s, 0.9, 0.1).unwrap() - i_s * 0.1;
        assert!(psi_r.cross(&i_s).abs() < 1e-12 && (psi_r.re() + 0.54_f64).abs() < 1e-12);
        assert_eq!(flux_along(&AlphaBeta::new(0.0, 0.05), 0.9, 0.1), None, "no direction");
    }

    #[test]
    fn a_shaft_that_is_blocked_or_moves_with_its_field_and_a_free_torque_are_none() {
        assert!(turned(|_| (1.0, 0.08, 0.08)).is_empty(), "blocked");
        for sign in [1.0, -1.0] {
            let moves = |rate: f64| turned(|k| (sign, sign * (0.02 - rate * (k - 1000.0)), sign * 0.08));
            assert!(moves(2e-4).is_empty() && moves(-2e-4).is_empty(), "braking through zero, falling with its load");
        }
        assert!(turned(|_| (0.0, 0.0, 0.08)).is_empty());
        let mut realign = Realign::default();
        assert!((0..100_000).all(|_| !realign.step(u32::MAX, 1.0, 0.0, 0.08)));
    }
}
