//! Plausibility of the estimate: the flux on its circle, the speed within reach, the confidence as high as the user
//! asks for. Per unit.
//!
//! ```text
//! | |ψ̂_s| - ψ* | ≤ 0.4 ψ_N,  |ψ̂_s| ≥ 0.2 ψ*,      |ω̂| ≤ 1.3 ω_max,      confidence ≥ 0.5 if the drive is set to stop below it
//! ```
//!
//! The second bound of the flux is that of field weakening, where `ψ*` may be less than 0.4 ψ_N. Each by a leaky counter of 50 ms ([`super::leaky`]): a lost estimate swings, and a swing passes through its circle.

use super::fault::{Fault, Trip};
use super::leaky::LeakyCounter;
use crate::scalar::{Real, likely};
use crate::words::words;

/// Largest deviation of the flux from its reference, relative to rated flux.
pub(crate) const DEVIATION: f64 = 0.4;
/// Largest estimated speed, in units of the largest reference.
pub(crate) const OVER_SPEED: f64 = 1.3;
/// Time of an uninterrupted violation that is a fault, s.
pub(crate) const TIME: f64 = 0.05;
/// Least flux, relative to its reference.
const LEAST: f64 = 0.2;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct PlausibilityConfig<R: Real> {
    /// Largest deviation of `|ψ̂_s|` from its reference.
    pub psi_deviation: R,
    /// Largest speed.
    pub omega_max: R,
    /// Calls of uninterrupted violation that are a fault.
    pub calls: u32,
    /// Whether a low confidence is a fault.
    pub confidence: bool,
}
words!(PlausibilityConfig: psi_deviation, omega_max, calls, confidence);

impl<R: Real> PlausibilityConfig<R> {
    /// Whether the flux is as near to its reference as an estimate keeps it.
    #[inline(always)]
    fn holds(&self, (psi_s, psi_ref): (R, R)) -> bool {
        (psi_s - psi_ref).within(self.psi_deviation) && psi_s >= psi_ref * R::from_f64(LEAST)
    }
}

/// State: one counter a condition.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Plausibility {
    flux: LeakyCounter,
    speed: LeakyCounter,
    confidence: LeakyCounter,
}

impl Plausibility {
    /// One call with `|ψ̂_s|`, `ψ*` and the speed; `confidence` is asked for if it counts.
    #[inline(always)]
    pub fn step<R: Real>(
        &mut self,
        c: &PlausibilityConfig<R>,
        flux: (R, R),
        omega_m: R,
        confidence: impl FnOnce() -> R,
    ) -> Option<Trip<R>> {
        let plausible = c.holds(flux) && omega_m.within(c.omega_max);
        if likely(plausible && !c.confidence && self.is_empty()) {
            return None;
        }
        self.count(c, flux, omega_m, if c.confidence { confidence() } else { R::ONE })
    }

    /// Nothing has been violated lately.
    #[inline(always)]
    fn is_empty(self) -> bool {
        self.flux.is_empty() & self.speed.is_empty() & self.confidence.is_empty()
    }

    /// A call where something is or was violated, or the confidence counts.
    #[cold]
    #[inline(never)]
    fn count<R: Real>(
        &mut self,
        c: &PlausibilityConfig<R>,
        (psi_s, psi_ref): (R, R),
        omega_m: R,
        confidence: R,
    ) -> Option<Trip<R>> {
        let flux = step(&mut self.flux, !c.holds((psi_s, psi_ref)), c.calls);
        let speed = step(&mut self.speed, !omega_m.within(c.omega_max), c.calls);
        let low = step(&mut self.confidence, confidence < R::HALF, c.calls);
        if likely(!(flux | speed | low)) {
            return None;
        }
        let (cause, value, limit) = if flux {
            (Fault::EstimateLost, psi_s - psi_ref, c.psi_deviation.min(psi_ref * R::from_f64(1.0 - LEAST)))
        } else if speed {
            (Fault::OverSpeed, omega_m, c.omega_max)
        } else {
            (Fault::LowConfidence, confidence, R::HALF)
        };
        Some(Trip::new(cause, value, limit))
    }
}

/// A call of one of the counters: the code exists once for all.
#[cold]
#[inline(never)]
fn step(counter: &mut LeakyCounter, violated: bool, calls: u32) -> bool {
    counter.step(violated, calls)
}

#[cfg(test)]
mod tests {
    use super::*;

    const C: PlausibilityConfig<f64> =
        PlausibilityConfig { psi_deviation: 0.4, omega_max: 2.0, calls: 50, confidence: true };

    /// Calls until a fault, and the fault.
    fn first(x: impl Fn(u32) -> (f64, f64, f64)) -> Option<(u32, Trip<f64>)> {
        first_at(1.0, x)
    }

    /// The same at a reference of the flux.
    fn first_at(psi_ref: f64, x: impl Fn(u32) -> (f64, f64, f64)) -> Option<(u32, Trip<f64>)> {
        let mut p = Plausibility::default();
        (0..10_000).find_map(|k| {
            let (psi, omega, confidence) = x(k);
            p.step(&C, (psi_ref + psi, psi_ref), omega, || confidence).map(|trip| (k, trip))
        })
    }

    #[test]
    fn in_field_weakening_a_flux_that_vanishes_is_as_implausible_as_at_rated_flux() {
        let (calls, trip) = first_at(0.3, |_| (-0.29, 0.0, 1.0)).unwrap();
        assert_eq!((calls, trip.cause), (50, Fault::EstimateLost));
        assert!((trip.limit - 0.24).abs() < 1e-9);
        assert_eq!(first_at(0.3, |_| (-0.2, 0.0, 1.0)), None);
    }

    #[test]
    fn each_condition_has_its_cause_and_reports_what_was_measured() {
        let cases = [
            ((-0.5, 0.0, 1.0), Trip { cause: Fault::EstimateLost, value: -0.5, limit: 0.4 }),
            ((0.0, 2.5, 1.0), Trip { cause: Fault::OverSpeed, value: 2.5, limit: 2.0 }),
            ((0.0, 0.0, 0.2), Trip { cause: Fault::LowConfidence, value: 0.2, limit: 0.5 }),
        ];
        for (x, trip) in cases {
            assert_eq!(first(|_| x), Some((50, trip)));
        }
        assert_eq!(first(|_| (0.3, 1.9, 0.6)), None);
    }

    #[test]
    fn a_swinging_estimate_does_not_escape() {
        let swing = |k: u32| (0.6 * (f64::from(k) * 0.3).sin(), 0.0, 1.0);
        assert!(first(swing).is_some_and(|(k, _)| k < 200));
    }
}
