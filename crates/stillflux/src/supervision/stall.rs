//! Stall: the torque is at its limit, and the speed does not approach its reference. Per unit.
//!
//! ```text
//! e = ω* - ω̂,   violated: torque limited, 0.02 < |e|, |ω̂| < 0.3;   approach: ω̂ farther towards ω* than ever, by 0.004
//! ```
//!
//! Every approach empties the counter and begins anew, so that an acceleration at the torque limit is none; a fault
//! after `calls` without one (leaky, [`super::leaky`]).
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

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StallConfig {
    /// Calls without an approach that are a fault; `u32::MAX`: never.
    pub calls: u32,
}

impl crate::words::Words for StallConfig {
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
pub struct Stall<R: Real> {
    counter: LeakyCounter,
    /// Speed nearest to the reference since the last approach.
    nearest: R,
}

impl<R: Real> Default for Stall<R> {
    fn default() -> Self {
        Self { counter: LeakyCounter::default(), nearest: R::ZERO }
    }
}

impl<R: Real> Stall<R> {
    /// One call; `limited`: the torque reference is at its limit. `deviation`: `ω* - ω̂`.
    #[inline(always)]
    pub fn step(&mut self, c: &StallConfig, limited: bool, deviation: R, omega_m: R) -> Option<Trip<R>> {
        if likely(!limited && self.counter.is_empty()) {
            return None;
        }
        self.examine(c, limited, deviation, omega_m)
    }

    #[cold]
    #[inline(never)]
    fn examine(&mut self, c: &StallConfig, limited: bool, deviation: R, omega_m: R) -> Option<Trip<R>> {
        let advance = if deviation < R::ZERO { self.nearest - omega_m } else { omega_m - self.nearest };
        if self.counter.is_empty() || advance > R::from_f64(APPROACH) {
            *self = Self { counter: LeakyCounter::default(), nearest: omega_m };
        }
        let violated = limited && !deviation.within(R::from_f64(DEVIATION)) && omega_m.within(R::from_f64(OMEGA));
        self.counter.step(violated, c.calls).then(|| Trip::new(Fault::Stall, deviation, R::from_f64(DEVIATION)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const C: StallConfig = StallConfig { calls: 500 };

    fn first(x: impl Fn(u32) -> (bool, f64)) -> Option<u32> {
        let mut stall = Stall::default();
        (0..20_000).find(|&k| {
            let (limited, omega) = x(k);
            stall.step(&C, limited, 0.1 - omega, omega).is_some()
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
            stall.step(&C, true, reference - omega, omega).is_none()
        }));
        let off = StallConfig { calls: u32::MAX };
        let mut stall = Stall::default();
        assert!((0..20_000).all(|_| stall.step(&off, true, 0.5, 0.0).is_none()));
    }
}
