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
//! suspected: torque at its limit, |ω̂_s| < |ω̂_r|/4;     n += 1 suspected, n -= 1 not
//! n = 0 wherever ω̂_s has moved by |ω̂_r|/8;     no torque for N calls after n = N
//! ```
//!
//! Once within 12 N: what does not help is left to [`crate::supervision::stall`]. An acceleration, a braking through zero
//! speed and a load beyond the torque limit move the field with the shaft, by `(T - T_L) dτ/j`: to stand for `N` they would
//! have to meet the torque limit within `j |ω̂_r|/(8 N)`, some hundredths of rated torque, at the very speed of the slip.
//!
//! `N` is 0.12 s, an allowance: a third of the default of `stall_time`, so that suspicion and realignment have ended by
//! then. A load falls meanwhile by `T_L N/j`.
//!
//! Validity: speed control.

use crate::scalar::{Real, likely};

/// Calls until the next time, in units of those of the suspicion.
const PAUSE: u32 = 10;

/// State.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Realign<R: Real> {
    /// Suspicion; from its limit on the time since then.
    calls: u32,
    /// Stator frequency when it began.
    omega_s: R,
}

impl<R: Real> Default for Realign<R> {
    fn default() -> Self {
        Self { calls: 0, omega_s: R::ZERO }
    }
}

impl<R: Real> Realign<R> {
    /// One call: whether there has to be no torque. `n`: calls of suspicion before that, `u32::MAX`: never. `limited`: 1 if
    /// the torque is at its upper limit, -1 at its lower one, else 0. `omega_r`: `ω_s - ω` of the estimate.
    #[inline(always)]
    pub fn step(&mut self, n: u32, limited: R, omega_s: R, omega_r: R) -> bool {
        if likely(limited == R::ZERO && self.calls == 0) {
            return false;
        }
        self.advance(n, limited, omega_s, omega_r)
    }

    /// Whether a way out is under way or has ended less than `n` calls ago: what the filter makes of it is no evidence
    /// against the field yet, and the speed is that of a shaft without torque.
    #[inline(always)]
    pub fn is_settling(&self, n: u32) -> bool {
        !likely(self.calls < n) && self.calls < n.saturating_mul(3)
    }

    #[cold]
    #[inline(never)]
    fn advance(&mut self, n: u32, limited: R, omega_s: R, omega_r: R) -> bool {
        let quarter = omega_r.abs().quarter();
        let suspected = limited != R::ZERO && omega_s.within(quarter);
        if self.calls < n && (self.calls == 0 || !(omega_s - self.omega_s).within(quarter.half())) {
            *self = Self { calls: 0, omega_s };
        }
        let hold = n.saturating_mul(2);
        if self.calls < n && !suspected {
            self.calls = self.calls.saturating_sub(1);
        } else {
            self.calls = self.calls.saturating_add(1);
        }
        let active = self.calls >= n && self.calls < hold;
        if self.calls >= hold.saturating_add(n.saturating_mul(PAUSE)) {
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

    const N: u32 = 100;

    /// Calls without torque of 2000: torque at its limit, `ω_s`, `ω_r`.
    fn without_torque(x: impl Fn(f64) -> (f64, f64, f64)) -> Vec<u32> {
        let mut realign = Realign::default();
        (0..2000)
            .filter(|&k| {
                let (limited, omega_s, omega_r) = x(f64::from(k));
                realign.step(N, limited, omega_s, omega_r)
            })
            .collect()
    }

    #[test]
    fn a_field_that_stands_at_the_torque_limit_is_left_without_torque_once_in_a_while() {
        for sign in [1.0, -1.0] {
            // The slip grows, and with it the speed that makes up for it; the field stands.
            let calls =
                without_torque(|k| (sign, sign * (0.002 - 5e-5 * (k % 100.0)), sign * (0.08 + 1e-4 * (k % 100.0))));
            assert_eq!(calls[..100], (99..199).collect::<Vec<_>>());
            assert_eq!(calls[100], 199 + 1000 + 100, "not sooner");
        }
    }

    #[test]
    fn a_shaft_that_is_blocked_or_moves_with_its_field_and_a_free_torque_are_none() {
        assert!(without_torque(|_| (1.0, 0.08, 0.08)).is_empty(), "blocked");
        for sign in [1.0, -1.0] {
            let moves = |rate: f64| without_torque(|k| (sign, sign * (0.02 - rate * (k - 1000.0)), sign * 0.08));
            assert!(moves(2e-4).is_empty() && moves(-2e-4).is_empty(), "braking through zero, falling with its load");
        }
        assert!(without_torque(|_| (0.0, 0.0, 0.08)).is_empty());
        let mut realign = Realign::default();
        assert!((0..100_000).all(|_| !realign.step(u32::MAX, 1.0, 0.0, 0.08)));
    }
}
