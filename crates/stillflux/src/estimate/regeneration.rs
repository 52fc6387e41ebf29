//! Whether the machine regenerates, for the noise compensator of the published scheme ([`super::flux`]).
//!
//! ```text
//! ω_r,b = -ω̂_r sign ω̂,    dx/dτ = ω_c (ω_r,b - x),    regenerating: ω_r,min < x < |ω̂|
//! ```
//!
//! `ω_r,b` is the slip against the direction of rotation. Its low-pass is slower than the swinging that an offset
//! causes. A light load (below `ω_r,min`) does not count, nor does a slip beyond the speed, where the field turns
//! against it. Per unit; valid wherever the estimated slip is.

use super::speed::SpeedEstimate;
use crate::scalar::{Integrator, Real};

/// Slip against the direction of rotation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Regeneration<R: Real> {
    slow: Integrator<R>,
}

impl<R: Real> Regeneration<R> {
    /// One call; `corner`: `ω_c` times the time between two calls, `least`: `ω_r,min`. Whether the machine regenerates.
    #[inline(always)]
    pub fn step(&mut self, corner: R, least: R, speed: &SpeedEstimate<R>) -> bool {
        let slip = if speed.omega_m < R::ZERO { speed.omega_r } else { -speed.omega_r };
        let slow = self.slow.add(corner, slip - self.slow.value());
        slow > least && slow < speed.omega_m.abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The verdict after so many calls at a speed and a slip.
    fn after(calls: u32, omega_m: f64, omega_r: f64) -> bool {
        let mut regeneration = Regeneration::default();
        let speed = SpeedEstimate { omega_m, omega_r, omega_s: omega_m + omega_r, ..SpeedEstimate::default() };
        (0..calls).fold(false, |_, _| regeneration.step(0.01, 0.005, &speed))
    }

    #[test]
    fn slip_against_the_rotation_is_regeneration_in_both_directions_and_after_the_low_pass() {
        for sign in [1.0, -1.0] {
            assert!(after(1000, 0.1 * sign, -0.03 * sign));
            assert!(!after(10, 0.1 * sign, -0.03 * sign), "not yet");
            assert!(!after(1000, 0.1 * sign, 0.03 * sign), "motoring");
            assert!(!after(1000, 0.1 * sign, -0.004 * sign), "light load");
            assert!(!after(1000, 0.02 * sign, -0.03 * sign), "the field turns against the rotor");
        }
    }
}
