//! Way out of a false equilibrium: for a moment no torque, when the torque is at its limit and the field stands still. Per
//! unit.
//!
//! A shaft that stands while the torque is at its limit has `ω_s = ω_r`. Where the field stands still instead, either the
//! shaft turns backwards at the very speed of the slip, or the estimated angle is wrong by the angle of the current,
//!
//! ```text
//! δ̂ - δ = -arctan(i_q/i_d):    the flux lies along the current, T = 0
//! ```
//!
//! and nothing in it changes: the speed controller asks for all the torque there is, the slip of that torque makes up the
//! speed that it has not, and a dc current makes neither torque nor voltage. With `i_q = 0` the current has an angle to the
//! flux again: what follows in flux and speed is seen by the filter.
//!
//! ```text
//! suspected: torque at its limit, -|ω̂_r| < ω̂_s sgn ω̂_r < |ω̂_r|/2;     n += 1 suspected, n -= 1 not
//! n = 0 wherever ω̂ has come farther in the direction of the torque, by |ω̂_r|/8;     no torque for N calls after n = N
//! ```
//!
//! Once within 12 N: what does not help is left to [`crate::supervision::stall`], whose counter goes on. `N` is 0.12 s. An
//! acceleration, a braking through zero speed and the recovery from a load step move on.
//!
//! Validity: speed control. A load beyond the torque limit that the drive lowers at the speed of the slip falls for N
//! calls; an inertia that 1.5 times rated torque accelerates in more than ten seconds to rated speed loses the torque for
//! as long at most once on its way through zero speed.

use crate::scalar::{Real, likely};

/// Calls until the next time, in units of the suspicion's.
const PAUSE: u32 = 10;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RealignConfig {
    /// Calls of suspicion before it is acted upon; `u32::MAX`: never.
    pub calls: u32,
}

impl crate::words::Words for RealignConfig {
    fn put(&self, out: &mut impl FnMut(u32)) {
        self.calls.put(out);
    }
    fn take(from: &mut impl FnMut() -> u32) -> Self {
        Self { calls: u32::take(from) }
    }
}

/// State.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Realign<R: Real> {
    /// Suspicion; from its limit on the time since then.
    calls: u32,
    /// Speed farthest in the direction of the torque since it began.
    omega_m: R,
}

impl<R: Real> Default for Realign<R> {
    fn default() -> Self {
        Self { calls: 0, omega_m: R::ZERO }
    }
}

impl<R: Real> Realign<R> {
    /// One call: whether there has to be no torque. `limited`: 1 if it is at its upper limit, -1 at its lower one, else 0. `omega_r`: `ω_s - ω` of the estimate.
    #[inline(always)]
    pub fn step(&mut self, c: &RealignConfig, limited: R, omega_s: R, omega_r: R) -> bool {
        if likely(limited == R::ZERO && self.calls == 0) {
            return false;
        }
        self.advance(c, limited, omega_s, omega_r)
    }

    /// Whether a way out is under way or has ended less than N calls ago: what the filter makes of it is no evidence against
    /// the field yet.
    #[inline(always)]
    pub fn is_settling(&self, c: &RealignConfig) -> bool {
        !likely(self.calls < c.calls) && self.calls < c.calls.saturating_mul(3)
    }

    #[cold]
    #[inline(never)]
    fn advance(&mut self, c: &RealignConfig, limited: R, omega_s: R, omega_r: R) -> bool {
        let (omega_m, slip) = (omega_s - omega_r, omega_r.abs());
        let along = if omega_r < R::ZERO { -omega_s } else { omega_s };
        let suspected = limited != R::ZERO && along < slip.half() && along > -slip;
        if self.calls < c.calls && (self.calls == 0 || (omega_m - self.omega_m) * limited > slip.quarter().half()) {
            *self = Self { calls: 0, omega_m };
        }
        let hold = c.calls.saturating_mul(2);
        if self.calls < c.calls && !suspected {
            self.calls = self.calls.saturating_sub(1);
        } else {
            self.calls = self.calls.saturating_add(1);
        }
        let active = self.calls >= c.calls && self.calls < hold;
        if self.calls >= hold.saturating_add(c.calls.saturating_mul(PAUSE)) {
            self.calls = 0;
        }
        active
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use std::vec::Vec;

    use super::*;

    const C: RealignConfig = RealignConfig { calls: 100 };

    /// Calls without torque of 2000: torque at its limit, `ω_s`, `ω_r`.
    fn without_torque(x: impl Fn(f64) -> (f64, f64, f64)) -> Vec<u32> {
        let mut realign = Realign::default();
        (0..2000)
            .filter(|&k| {
                let (limited, omega_s, omega_r) = x(f64::from(k));
                realign.step(&C, limited, omega_s, omega_r)
            })
            .collect()
    }

    #[test]
    fn a_field_that_stands_at_the_torque_limit_is_left_without_torque_once_in_a_while() {
        for sign in [1.0, -1.0] {
            let calls = without_torque(|k| (sign, sign * (0.01 - 2e-4 * (k % 100.0)), sign * 0.08));
            assert_eq!(calls[..100], (99..199).collect::<Vec<_>>());
            assert_eq!(calls[100], 199 + 1000 + 100, "not sooner");
        }
    }

    #[test]
    fn a_blocked_shaft_an_acceleration_a_braking_through_zero_and_a_free_torque_are_none() {
        assert!(without_torque(|_| (1.0, 0.08, 0.08)).is_empty());
        for sign in [1.0, -1.0] {
            assert!(without_torque(|k| (sign, sign * (-0.2 + 2e-4 * k), sign * 0.08)).is_empty());
        }
        assert!(without_torque(|_| (0.0, 0.0, 0.08)).is_empty());
        let off = RealignConfig { calls: u32::MAX };
        let mut realign = Realign::default();
        assert!((0..100_000).all(|_| !realign.step(&off, 1.0, 0.0, 0.08)));
    }
}
