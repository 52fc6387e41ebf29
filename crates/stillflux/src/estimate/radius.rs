//! Radius that the noise compensator of the published scheme ([`super::flux`]) holds.
//!
//! What the noise compensator has to remove is an error `δ` of the integral, which stands still while the field turns:
//! `|ψ̂_s|` swings with `ω_s` about the radius of the true flux. Where that radius is not `ψ_s*`, the difference is no error
//! of the estimate, and holding it against the reference turns the angle by `k (ψ_s* - |ψ_s|)/(ω_s |ψ_s|)`: 5° where the
//! flux follows field weakening, or falls near pull-out, 10 % apart from its reference. A reference that answers to the
//! estimated speed, as that of field weakening does, swings with `ω_s` itself, and feeds `δ`. So above `|ω_s|` of 0.3 the
//! mean radius takes the place of `ψ_s*`,
//!
//! ```text
//! u_hf = k (ρ - |ψ̂_s|) e^{jδ̂},    dρ/dτ = ½|ω_s| (|ψ̂_s| - ρ)
//! ```
//!
//! and `δ` decays with `0.8 k/2`: the mean follows a fifth of the swing.

use crate::scalar::{Real, likely};

/// Stator frequency, per unit, from which on the noise compensator holds the mean radius: its gain is at the ceiling from
/// 0.25 on. Below, an offset that is not yet known moves the flux while the field turns once, and `ψ_s*` is what is known of
/// the radius.
const FREQUENCY_MEAN: f64 = 0.3;

/// Mean radius `ρ`, and whether it takes the place of the reference.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct HeldRadius<R: Real> {
    mean: R,
    by_mean: bool,
}

impl<R: Real> HeldRadius<R> {
    /// Begins with the reference.
    #[inline(always)]
    pub fn start(&mut self) {
        self.by_mean = false;
    }

    /// The radius at a flux reference.
    #[inline(always)]
    pub fn value(&self, psi_ref: R) -> R {
        if likely(!self.by_mean) { psi_ref } else { self.mean }
    }

    /// One call with the magnitudes of stator frequency and flux; `half_interval`: half of the time since the last one.
    #[inline(always)]
    pub fn step(&mut self, omega: R, half_interval: R, magnitude: R) {
        if !likely(omega <= R::from_f64(FREQUENCY_MEAN)) {
            self.average(half_interval * omega, magnitude);
        } else {
            self.by_mean = false;
        }
    }

    /// Mean radius, for the part of it that the time since the last call makes.
    #[cold]
    #[inline(never)]
    fn average(&mut self, part: R, magnitude: R) {
        self.mean = if self.by_mean { self.mean + (magnitude - self.mean) * part } else { magnitude };
        self.by_mean = true;
    }
}
