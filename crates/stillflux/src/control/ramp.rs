//! Speed ramp with limits of acceleration and jerk, per unit.
//!
//! ```text
//! dω*/dt = a,    |da/dt| ≤ J,    a → sgn(e) min(A, √(2 J |e|)),    e = ω_ref - ω*
//! ```
//!
//! `√(2 J |e|)` is the acceleration that a constant jerk takes back to zero on the way `e`. Without a limit of the jerk
//! `a` changes at once; without one of the acceleration `ω*` is the reference. While the torque is at its limit in the
//! direction of the ramp, for want of current, voltage or link, the ramp is held, at most so far ahead of the speed that
//! the speed controller stays at the limit. `a` jumps, whatever `J`, where the ramp is held (to 0), and in the last calls before
//! the reference, within four steps of `J`.
//!
//! `a` is in units of speed per 256 calls, which leaves small ones resolved in fixed point.

use crate::scalar::{Integrator, Real};
use crate::words::words;

/// Calls in the unit of the acceleration.
pub const CALLS: f64 = 256.0;

/// Settings of the ramp.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct RampConfig<R: Real> {
    /// `A`: change of speed in 256 calls; 0: no ramp.
    pub acceleration: R,
    /// `J`: change of it in a call; 0: at once.
    pub jerk: R,
    /// Largest lead of `ω*` over the speed while it is held.
    pub lead: R,
}
words!(RampConfig: acceleration, jerk, lead);

impl<R: Real> RampConfig<R> {
    /// Of a ramp.
    pub fn new(acceleration: R, jerk: R, lead: R) -> Self {
        Self { acceleration, jerk, lead }
    }
}

/// State of the ramp.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Ramp<R: Real> {
    omega: Integrator<R>,
    acceleration: R,
}

impl<R: Real> Ramp<R> {
    /// Begins at a speed.
    pub fn start(&mut self, omega: R) {
        *self = Self { omega: Integrator::new(omega), acceleration: R::ZERO };
    }

    /// One call; returns `ω*`. `limited`: 1 if the torque is at its upper limit, -1 at its lower one, else 0.
    #[inline(always)]
    pub fn step(&mut self, c: &RampConfig<R>, reference: R, omega_m: R, limited: R) -> R {
        if c.acceleration == R::ZERO { reference } else { self.advance(c, reference, omega_m, limited) }
    }

    #[inline(never)]
    fn advance(&mut self, c: &RampConfig<R>, reference: R, omega_m: R, limited: R) -> R {
        let unit = R::from_f64(1.0 / CALLS);
        let omega = self.omega.value();
        let error = reference - omega;
        if limited * error > R::ZERO {
            self.acceleration = R::ZERO;
            let ahead = (omega - omega_m) * limited;
            if ahead > c.lead {
                self.omega.set(omega_m + c.lead * limited);
            }
            return self.omega.value();
        }
        let mut wanted = c.acceleration;
        if c.jerk > R::ZERO {
            // 256 √(2 J |e|/256) = √(512 J) √|e|: the product of a small jerk and a small error has few digits in fixed point.
            let root = (c.jerk * R::from_f64(64.0) * R::from_f64(8.0)).sqrt() * error.abs().sqrt();
            // Two steps less, for the calls in which the acceleration follows.
            wanted = wanted.min((root - c.jerk - c.jerk).max(c.jerk));
        }
        let wanted = if error < R::ZERO { -wanted } else { wanted };
        let change = wanted - self.acceleration;
        self.acceleration += if c.jerk > R::ZERO { change.limit(c.jerk) } else { change };
        // The last call: what is left is less than the step, and the step small enough to end.
        let step = self.acceleration * unit;
        let slow = c.jerk == R::ZERO || self.acceleration.within(c.jerk * R::from_f64(4.0));
        if slow && error.within(step.abs().max(c.jerk * unit)) {
            self.start(reference);
        } else {
            self.omega.add(unit, self.acceleration);
        }
        self.omega.value()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Q;

    /// Courses of speed, acceleration and jerk to a reference, by differences of `ω*`.
    fn course<R: Real>(c: [f64; 2], reference: f64, calls: usize) -> Vec<f64> {
        let c = RampConfig { acceleration: R::from_f64(c[0]), jerk: R::from_f64(c[1]), lead: R::ONE };
        let mut ramp = Ramp::<R>::default();
        (0..calls).map(|_| ramp.step(&c, R::from_f64(reference), R::ZERO, R::ZERO).to_f64()).collect()
    }

    extern crate std;
    use std::vec::Vec;

    #[test]
    fn without_settings_the_reference_passes() {
        assert_eq!(course::<f64>([0.0, 0.0], 0.7, 1), [0.7]);
    }

    fn limits<R: Real>() {
        for reference in [1.0, -1.0] {
            let (a, j) = (0.256, 0.256 / 200.0);
            let omega = course::<R>([a, j], reference, 3000);
            let speed: Vec<f64> = omega.windows(2).map(|w| w[1] - w[0]).collect();
            let worst = speed.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            let jerk = speed.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0_f64, f64::max);
            assert!(worst <= a / CALLS * 1.001, "{}: {worst}", R::NAME);
            assert!(jerk <= 4.1 * j / CALLS, "{}: {jerk}", R::NAME);
            assert!(omega.iter().all(|x| x.abs() <= 1.0 + 1e-6), "no overshoot");
            assert_eq!(omega[2999], reference);
            // 1000 calls at full acceleration and 200 for its rise and fall.
            let there = omega.iter().position(|x| (x - reference).abs() < 1e-3).unwrap();
            assert!((1150..1230).contains(&there), "{}: {there}", R::NAME);
        }
    }

    #[test]
    fn acceleration_and_jerk_keep_their_limits_and_the_speed_arrives() {
        limits::<f32>();
        limits::<f64>();
        limits::<Q>();
    }

    /// Calls until the reference is reached, at 0.05 pu/s in calls of 0.8 ms.
    fn calls_to_arrive<R: Real>(jerk: f64) -> f64 {
        let (t, r) = (0.8e-3, R::from_f64);
        let c = RampConfig { acceleration: r(0.05 * t * CALLS), jerk: r(jerk * t * t * CALLS), lead: R::ONE };
        let mut ramp = Ramp::<R>::default();
        let arrives = (0..100_000).position(|_| ramp.step(&c, r(0.3), R::ZERO, R::ZERO) == r(0.3));
        arrives.unwrap() as f64
    }

    #[test]
    fn a_small_jerk_takes_as_long_in_fixed_point() {
        for jerk in [0.01, 0.023, 0.1, 0.37, 1.0, 10.0] {
            let (exact, fixed) = (calls_to_arrive::<f64>(jerk), calls_to_arrive::<Q>(jerk));
            assert!((fixed - exact).abs() < 0.03 * exact, "{jerk}: {fixed} calls, exactly {exact}");
            assert!((calls_to_arrive::<f32>(jerk) - exact).abs() < 0.03 * exact, "{jerk}");
        }
    }

    #[test]
    fn while_the_torque_is_at_its_limit_the_ramp_waits_for_the_speed() {
        let c = RampConfig { acceleration: 0.256, jerk: 0.0, lead: 0.05 };
        let mut ramp = Ramp::<f64>::default();
        for _ in 0..100 {
            ramp.step(&c, 1.0, 0.1, 0.0);
        }
        let held = ramp.step(&c, 1.0, 0.08, 1.0);
        assert!((held - 0.1).abs() < 1e-9, "{held}");
        assert!((ramp.step(&c, 1.0, 0.02, 1.0) - 0.07).abs() < 1e-9, "a speed that falls takes it back");
        assert!(ramp.step(&c, 1.0, 0.02, -1.0) > 0.07, "a limit in the other direction does not hold it");
    }
}
