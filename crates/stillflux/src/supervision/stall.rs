//! Stall: the torque is at its limit, and the speed does not approach its reference. Per unit.
//!
//! ```text
//! e = ω* - ω̂,   violated: torque limited, 0.02 < |e|, |ω̂| < 0.3;   approach: ω̂ by 0.004 farther towards ω* than ω_0
//! ω_0: speed of the last approach; that which is 0.02 nearer to ω* than ω̂, where the shaft has been driven away by more
//! ```
//!
//! Every approach empties the counter and begins anew, so that neither an acceleration at the torque limit nor the way back
//! of a shaft that a load has driven away counts as a stall; a swing of the estimate within the admissible deviation is no
//! approach. A fault after some calls without one (leaky, [`super::leaky`]). While the field is realigned ([`crate::control::realign`])
//! nothing counts, and `ω_0` is the speed at its end.
//!
//! Besides a blocked shaft and a load beyond the limit this is how a field that is lost at low speed shows: the speed
//! controller asks for all the torque it may have, the true torque is next to nothing, and the estimate holds a
//! frequency near zero at which nothing contradicts it. The shaft then leaves with the load: the time is short.
//!
//! Validity: speed control. Beyond `|ω̂|` = 0.3 the voltage may limit the torque, and the reference may be out of reach.

use super::fault::{Fault, Trip};
use super::leaky::LeakyCounter;
use crate::scalar::{Real, likely};

/// Deviation of the speed that is always admissible.
const DEVIATION: f64 = 0.02;
/// Least approach of the speed that counts.
const APPROACH: f64 = 0.004;
/// Largest speed of a stall.
const OMEGA: f64 = 0.3;

/// State.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Stall<R: Real> {
    counter: LeakyCounter,
    /// Speed from which an approach counts.
    from: R,
}

impl<R: Real> Default for Stall<R> {
    fn default() -> Self {
        Self { counter: LeakyCounter::default(), from: R::ZERO }
    }
}

impl<R: Real> Stall<R> {
    /// One call; `calls` without an approach are a fault, `u32::MAX`: never. `limited`: the torque reference is at its
    /// limit; `None`: the drive takes the torque away itself. `deviation`: `ω* - ω̂`.
    #[inline(always)]
    pub fn step(&mut self, calls: u32, limited: Option<bool>, deviation: R, omega_m: R) -> Option<Trip<R>> {
        if likely(limited == Some(false) && self.counter.is_empty()) {
            return None;
        }
        self.examine(calls, limited, deviation, omega_m)
    }

    #[cold]
    #[inline(never)]
    fn examine(&mut self, calls: u32, limited: Option<bool>, deviation: R, omega_m: R) -> Option<Trip<R>> {
        let Some(limited) = limited else {
            self.from = omega_m;
            return None;
        };
        let admissible = R::from_f64(DEVIATION);
        let moved = omega_m - self.from;
        let advance = if deviation < R::ZERO { -moved } else { moved };
        if self.counter.is_empty() || advance > R::from_f64(APPROACH) {
            *self = Self { counter: LeakyCounter::default(), from: omega_m };
        } else {
            self.from += moved - moved.limit(admissible);
        }
        let violated = limited && !deviation.within(admissible) && omega_m.within(R::from_f64(OMEGA));
        self.counter.step(violated, calls).then(|| Trip::new(Fault::Stall, deviation, admissible))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CALLS: u32 = 500;

    fn first(x: impl Fn(u32) -> (bool, f64)) -> Option<u32> {
        let mut stall = Stall::default();
        (0..20_000).find(|&k| {
            let (limited, omega) = x(k);
            stall.step(CALLS, Some(limited), 0.1 - omega, omega).is_some()
        })
    }

    #[test]
    fn a_blocked_shaft_and_one_that_is_driven_back_are_found() {
        assert_eq!(first(|_| (true, 0.0)), Some(500));
        assert!(first(|k| (true, (-1e-5 * f64::from(k)).max(-0.2))).is_some_and(|k| k <= 500));
        assert!(first(|k| (k % 2 == 0, 0.0)).is_some(), "a limit that is left now and then");
    }

    #[test]
    fn an_acceleration_at_the_limit_and_a_speed_that_is_held_are_none() {
        assert_eq!(first(|k| (true, (1e-5 * f64::from(k)).min(0.1))), None);
        assert_eq!(first(|_| (true, 0.09)), None);
        assert_eq!(first(|_| (false, 0.0)), None);
        // A step of the reference at a speed that stands in the limit already.
        let mut stall = Stall::default();
        let course = |k: u32| (if k < 100 { 0.05 } else { 0.25 }, (2e-5 * f64::from(k.saturating_sub(50))).min(0.24));
        assert!((0..20_000).all(|k| {
            let (reference, omega) = course(k);
            stall.step(CALLS, Some(true), reference - omega, omega).is_none()
        }));
        let mut stall = Stall::default();
        assert!((0..20_000).all(|_| stall.step(u32::MAX, Some(true), 0.5, 0.0).is_none()));
    }

    #[test]
    fn a_shaft_that_creeps_is_stalled_and_one_that_turns_fast_is_not() {
        // 0.004 take 800 calls, more than a stall may last.
        assert_eq!(first(|k| (true, 5e-6 * f64::from(k))), Some(500));
        let beyond = |omega: f64| {
            let mut stall = Stall::default();
            (0..2000).any(|_| stall.step(CALLS, Some(true), 0.1, omega).is_some())
        };
        assert!([0.29, -0.29].into_iter().all(beyond) && ![0.31, -0.31].into_iter().any(beyond));
    }

    #[test]
    fn the_way_back_of_a_shaft_that_was_driven_away_is_an_approach_and_a_swing_is_none() {
        // Away from 0.08 to -0.02 within 200 calls, back within 1000.
        let back = |k: u32| (0.08 - 5e-4 * f64::from(k.min(200)) + 1e-4 * f64::from(k.saturating_sub(200))).min(0.09);
        assert_eq!(first(|k| (true, back(k))), None);
        assert!(first(|k| (true, 0.01 * (0.02 * f64::from(k)).sin())).is_some());
    }

    #[test]
    fn nothing_counts_while_the_drive_takes_the_torque_away() {
        let mut stall = Stall::default();
        let falls = |k: u32| 0.08 - 2e-4 * f64::from(k);
        assert!((0..400).all(|k| stall.step(CALLS, Some(true), 0.1 - falls(0), falls(0)).is_none() && k < 400));
        assert!((0..300).all(|k| stall.step(CALLS, None, 0.1 - falls(k), falls(k)).is_none()));
        // Counted on from where it was, the way back begins where the torque came back.
        let end = falls(299);
        assert!((0..90).all(|_| stall.step(CALLS, Some(true), 0.1 - end, end).is_none()));
        assert!(stall.step(CALLS, Some(true), 0.1 - end - 0.005, end + 0.005).is_none());
        assert!((0..400).all(|_| stall.step(CALLS, Some(true), 0.1 - end, end + 0.005).is_none()));
    }
}
