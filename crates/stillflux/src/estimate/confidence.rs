//! Confidence: how far the field angle may have drifted, as a number a drive can act on.
//!
//! A voltage error `u` that no mechanism knows of moves the estimated flux by `u` per normalised time. While
//! the field rotates the error moves on a circle and stays at `u/ω_s`, the angle error of Fig. 10; at zero
//! stator frequency nothing limits it. Both are one first-order model of the angle's uncertainty σ,
//!
//! ```text
//! dσ/dτ = u/ψ_s* - |ω_s| σ,      u = u_floor + |û_off correction| + low-pass |u_hf|
//! ```
//!
//! whose inputs are what the drive can see: a floor from the resolution of its sensors and its inverter
//! model, the latest correction of the offset estimator, and the effort of the noise compensator (a
//! steady radial error is a voltage error that rotation would turn tangential).
//! `confidence = 1 / (1 + (σ/15°)²)`: 0.5 where 15° must be expected, above 0.9 where 5° must.
//!
//! It is a model, not a measurement: it knows of nothing that leaves no trace in the residuals.

use crate::scalar::{Integrator, Real};
use crate::words::words;

/// Angle uncertainty at which the confidence is one half, rad (15°).
pub const SIGMA_HALF: f64 = 0.261_8;

/// Settings of the confidence model.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct ConfidenceConfig<R: Real> {
    /// Time between two calls, normalised.
    pub t_s: R,
    /// Voltage uncertainty that no estimate can remove, per unit.
    pub u_floor: R,
    /// Offset uncertainty before the offset estimator has made its first correction, per unit.
    pub u_initial: R,
    /// Corner frequency of the low-pass of `|u_hf|`, times that time.
    pub corner: R,
}
words!(ConfidenceConfig: t_s, u_floor, u_initial, corner);

/// State of the confidence model.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Confidence<R: Real> {
    sigma: Integrator<R>,
    effort: Integrator<R>,
    value: R,
}

impl<R: Real> Default for Confidence<R> {
    fn default() -> Self {
        Self { sigma: Integrator::default(), effort: Integrator::default(), value: R::ONE }
    }
}

impl<R: Real> Confidence<R> {
    /// Begins with a certain angle.
    pub fn start(&mut self) {
        *self = Self::default();
    }

    /// Begins with an angle that is known to a standard deviation `sigma`, rad, at most π: for records that begin under way.
    pub fn join(&mut self, sigma: R) {
        let sigma = sigma.clamp(R::ZERO, R::from_f64(core::f64::consts::PI));
        let ratio = sigma * R::from_f64(1.0 / SIGMA_HALF);
        let value = (R::ONE + ratio * ratio).recip();
        *self = Self { sigma: Integrator::new(sigma), value, ..Self::default() };
    }

    /// One call; `offset_uncertainty` is the latest correction of the offset estimator, if there was one.
    #[inline(always)]
    pub fn step(&mut self, c: &ConfidenceConfig<R>, omega_s: R, u_hf: R, offset_uncertainty: Option<R>) -> R {
        let effort = self.effort.value();
        self.effort.add(c.corner, u_hf - effort);
        let u = c.u_floor + effort.abs() + offset_uncertainty.unwrap_or(c.u_initial);
        let sigma = self.sigma.value();
        // π is as wrong as an angle can be.
        let sigma =
            self.sigma.add_clamped(c.t_s, u - omega_s.abs() * sigma, R::ZERO, R::from_f64(core::f64::consts::PI));
        let ratio = sigma * R::from_f64(1.0 / SIGMA_HALF);
        // σ moves by less than a thousandth of its scale in a period: one Newton step from the last value is
        // the reciprocal, without a division.
        let step = self.value * (R::TWO - self.value * (R::ONE + ratio * ratio));
        self.value = step.clamp(R::ZERO, R::ONE);
        self.value
    }

    /// Latest confidence.
    #[inline]
    pub fn value(&self) -> R {
        self.value
    }

    /// Expected magnitude of the angle error, rad.
    pub fn sigma(&self) -> R {
        self.sigma.value()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: ConfidenceConfig<f64> = ConfidenceConfig { t_s: 0.03, u_floor: 1e-4, u_initial: 1e-3, corner: 3e-4 };

    #[test]
    fn settles_at_the_angle_error_of_an_offset_while_rotating_and_falls_at_rest() {
        let mut c = Confidence::<f64>::default();
        let mut last = 1.0;
        for _ in 0..100_000 {
            last = c.step(&CONFIG, 0.02, 0.0, None);
        }
        assert!((c.sigma() - 1.1e-3 / 0.02).abs() < 1e-6);
        assert!(last > 0.9);
        for _ in 0..60 * 10_000 {
            last = c.step(&CONFIG, 0.0, 0.0, None);
        }
        assert!(last < 0.1, "a minute at zero frequency with an unknown offset");
        for _ in 0..100_000 {
            last = c.step(&CONFIG, 0.02, 0.0, Some(0.0));
        }
        assert!(last > 0.99, "recovers with rotation");
    }

    /// Confidence and σ once they stand.
    fn settled(u_hf: f64, omega_s: f64) -> (f64, f64) {
        let mut c = Confidence::<f64>::default();
        let mut last = 1.0;
        for _ in 0..1_000_000 {
            last = c.step(&CONFIG, omega_s, u_hf, Some(0.0));
            assert!((0.0..=1.0).contains(&last));
        }
        (last, c.sigma())
    }

    #[test]
    fn the_effort_of_the_noise_compensator_counts_whatever_its_sign() {
        for u_hf in [0.002, -0.002] {
            assert!((settled(u_hf, 0.02).1 - 0.0021 / 0.02).abs() < 1e-6);
        }
    }

    #[test]
    fn the_angle_is_never_more_than_half_a_turn_off() {
        let (last, sigma) = settled(0.05, 0.0);
        assert_eq!(sigma, core::f64::consts::PI);
        assert!((last - 1.0 / (1.0 + (sigma / SIGMA_HALF) * (sigma / SIGMA_HALF))).abs() < 1e-9);
    }

    #[test]
    fn a_deviation_at_the_beginning_is_forgotten_with_the_rotation_of_the_field() {
        let mut c = Confidence::<f64>::default();
        c.join(10.0);
        assert_eq!(c.sigma(), core::f64::consts::PI);
        assert!(c.value() < 0.01);
        let begin = 0.1;
        c.join(begin);
        assert!((c.value() - 1.0 / (1.0 + (begin / SIGMA_HALF).powi(2))).abs() < 1e-12);
        // One turn's radian at 0.02 pu.
        let calls = (1.0 / (0.02 * CONFIG.t_s)) as u32;
        for _ in 0..calls {
            c.step(&CONFIG, 0.02, 0.0, Some(0.0));
        }
        let settled = CONFIG.u_floor / 0.02;
        assert!((c.sigma() - settled - (begin - settled) * (-1.0f64).exp()).abs() < 1e-4);
        assert!((c.value() - 1.0 / (1.0 + (c.sigma() / SIGMA_HALF).powi(2))).abs() < 1e-6);
        for _ in 0..10 * calls {
            c.step(&CONFIG, 0.0, 0.0, Some(0.0));
        }
        assert!(c.sigma() > settled, "without rotation nothing is forgotten");
    }

    #[test]
    fn the_confidence_is_one_half_at_15_degrees_and_stays_a_confidence_through_jumps() {
        let (half, sigma) = settled(0.005_136, 0.02);
        assert!((sigma - 15f64.to_radians()).abs() < 1e-4 && (half - 0.5).abs() < 1e-3);
        // A jump of σ from call to call, which the Newton step was not made for.
        let wild = ConfidenceConfig { t_s: 30.0, u_floor: 0.1, ..CONFIG };
        let mut c = Confidence::<f64>::default();
        for k in 0..100 {
            assert!((0.0..=1.0).contains(&c.step(&wild, f64::from(k % 2), 1.0, None)));
        }
    }
}
