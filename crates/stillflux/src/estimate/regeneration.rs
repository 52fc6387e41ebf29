//! Whether the machine regenerates, for the noise compensator of the published scheme ([`super::flux`]).
//!
//! ```text
//! ω_r,b = -ω̂_r sign ω̂,    dx/dτ = ω_c (ω_r,b - x),    regenerating: ω_r,min < x < |ω̂|
//! ```
//!
//! `ω_r,b` is the slip against the direction of rotation. Its low-pass follows a load before the error of the angle has grown
//! ([`super::flux`]): 3 Hz are too slow for a rated load within 20 ms at -0.1 pu and 48 V. A light load (below `ω_r,min`) does not
//! count, nor does a slip beyond the speed, where the field turns against it. Per unit; valid wherever the estimated slip is.

use super::speed::SpeedEstimate;
use crate::scalar::{Integrator, Real};

/// Slip against the direction of rotation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Regeneration<R: Real> {
    slip: Integrator<R>,
}

impl<R: Real> Regeneration<R> {
    /// One call; `corner`: `ω_c` times the time between two calls, `least`: `ω_r,min`. The slip `x`, if the
    /// machine regenerates.
    #[inline(always)]
    pub fn step(&mut self, corner: R, least: R, speed: &SpeedEstimate<R>) -> Option<R> {
        let slip = if speed.omega_m < R::ZERO { speed.omega_r } else { -speed.omega_r };
        let slip = self.slip.add(corner, slip - self.slip.value());
        (slip > least && slip < speed.omega_m.abs()).then_some(slip)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What so many calls at a speed and a slip end with.
    fn after(calls: u32, omega_m: f64, omega_r: f64) -> Option<f64> {
        let mut regeneration = Regeneration::default();
        let speed = SpeedEstimate { omega_m, omega_r, omega_s: omega_m + omega_r, ..SpeedEstimate::default() };
        (0..calls).fold(None, |_, _| regeneration.step(0.01, 0.005, &speed))
    }

    #[test]
    fn slip_against_the_rotation_is_regeneration_in_both_directions_and_after_the_low_pass() {
        for sign in [1.0, -1.0] {
            let slip = after(1000, 0.1 * sign, -0.03 * sign).expect("regeneration");
            assert!((slip - 0.03).abs() < 1e-5, "{slip}");
            assert_eq!(after(10, 0.1 * sign, -0.03 * sign), None, "not yet");
            assert_eq!(after(1000, 0.1 * sign, 0.03 * sign), None, "motoring");
            assert_eq!(after(1000, 0.1 * sign, -0.004 * sign), None, "light load");
            assert_eq!(after(1000, 0.02 * sign, -0.03 * sign), None, "the field turns against the rotor");
        }
    }
}
