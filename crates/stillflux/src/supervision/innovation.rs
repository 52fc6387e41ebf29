//! Lost field: the innovation of the filter contradicts its model for longer than a transient. Per unit.
//!
//! ```text
//! g = max(0, g + (x - k) dt)      (Page's CUSUM),      a fault at g_1/h_1 + g_2/h_2 > 1
//!
//! 1, any contradiction      x = NIS at |ω̂_s| < 0.08, else 0                              k = 0.2,     h = max(40 ms, 2 τ)
//! 2, flux that falls        x = NIS at |ω̂_s| < 0.03 and m > |ψ̂_R|, else 0              k = 0.05,    h = max(60 ms, 3 τ, τ_r/2)
//! ```
//!
//! NIS: normalised innovation squared of [`crate::estimate::kalman`], low-passed with the time constant `τ`, 20 of the blocks for
//! which noise is stated: one turn of the rated field, and 200 control periods at least. What a transient leaves in the low-pass
//! counts for some `τ`, and `h` has room for it: with 40 ms alone a control of 2 to 3.3 kHz (`τ` of 60 to 100 ms) took steps of the load near
//! rest for a lost field, 14 of 126 drawn runs at 2.5 times the tolerances, 2 with it. The
//! first test sums what exceeds the level that allowances and transients of a field that is not lost explain: a violent contradiction is found
//! within tens of ms.
//!
//! The second finds a flux that collapses. At `ω_s = 0` the field may turn away from the estimate and decay, while the filter
//! corrects what the voltage says of it: the flux `|ψ̂_R|` that follows from the voltage is less than the flux `m` that the
//! current should make, block after block, and the correction makes up for the difference. Its innovation is small, NIS 0.1
//! to 0.4, and has one sign for a tenth of a second or two, in which the flux is lost. A flux larger than the current explains
//! (`m < |ψ̂_R|`) comes from a wrong inductance or is half of a swing, and does not count: where it did once `g` was above `h/2`, a speed
//! that hunted at 5 Hz without load filled the sum within 2 s (0.3 kW, 6 of 48 realisations of the noise, the angle within 15°). `k` is that of
//! the likelihood-ratio test of a variance, `ln(x_1/x_0)/(1/x_0 - 1/x_1)`, for a mean of `x_0` = 0.02, of drives that are
//! undisturbed, against `x_1` = 0.2. `h` grows with the rotor time constant, in which a flux falls: what a slower machine
//! contradicts for 0.3 s is its parameters, which are still being identified, and its flux lasts until the first test has
//! found it. The two are evidence of the same, and add up.
//!
//! The band is where a wrong field can stay. A voltage error `u` holds an angle error of `u/(ω_s ψ)`: 30° at
//! `|ω_s|` = 0.08 takes 0.04 pu, a quarter of the voltage of resistance and bridge at the largest current of a small
//! machine. Beyond it an innovation is a transient (a step of the load with a machine that is not that of the data): the
//! rotation takes the error away within some tens of ms, and a field that is lost for all that swings and is seen by
//! [`super::plausibility`]. Exactly at `ω_s = 0` a wrong field may be without contradiction, which is left to
//! [`super::stall`].
//!
//! First test: measured over 560 draws of ten drives in four courses at 2.5 times the tolerances, everything off at once,
//! with an NIS whose low-pass did not have the innovation's sign, the test alone on runs without it: 29 go on lost (0.2 s
//! with 0.2 pu of speed error, or 1 s with 30°), and it finds all of them at least 0.15 s before that; of the 489 that come
//! through it ends 2, with 4 and 7° of angle error. With a band of 0.2 it ends 11, 8 of them at `|ω̂_s|` of 0.09 to 0.19.
//! Both tests as they are, on other draws of all courses: docs/tolerance.md, guarantee.

use super::fault::{Fault, Trip};
use crate::scalar::{Real, likely};
use crate::words::words;

/// NIS that is explained otherwise, and that of a flux that does not fall.
const EXPLAINED: f64 = 0.2;
const CALM: f64 = 0.05;
/// Largest NIS that counts.
const LARGEST: f64 = 4.0;
/// Largest stator frequency at which a wrong field can stay.
const OMEGA_S: f64 = 0.08;
/// Largest stator frequency at which a flux can collapse: beyond it the correction of its angle takes less than 0.1 s.
const STANDING: f64 = 0.03;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct InnovationConfig<R: Real> {
    /// Time between two calls over `h`, of any contradiction; 0: never a fault.
    pub gain: R,
    /// The same of a flux that falls.
    pub gain_falling: R,
}
words!(InnovationConfig: gain, gain_falling);

/// State.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Innovation<R: Real> {
    /// `g/h` of any contradiction.
    level: R,
    /// `g/h` of a flux that falls.
    falling: R,
}

impl<R: Real> Default for Innovation<R> {
    fn default() -> Self {
        Self { level: R::ZERO, falling: R::ZERO }
    }
}

impl<R: Real> Innovation<R> {
    /// One call; `falls`: the flux that follows from the voltage is less than that of the current.
    #[inline(always)]
    pub fn step(&mut self, c: &InnovationConfig<R>, nis: R, falls: bool, omega_s: R) -> Option<Trip<R>> {
        if likely(nis <= R::from_f64(CALM) && self.level + self.falling == R::ZERO) {
            return None;
        }
        self.add(c, nis.min(R::from_f64(LARGEST)), falls, omega_s)
    }

    #[cold]
    #[inline(never)]
    fn add(&mut self, c: &InnovationConfig<R>, nis: R, falls: bool, omega_s: R) -> Option<Trip<R>> {
        let (explained, calm) = (R::from_f64(EXPLAINED), R::from_f64(CALM));
        let within = |omega: f64, seen: bool| if seen && omega_s.within(R::from_f64(omega)) { nis } else { R::ZERO };
        self.level = (self.level + (within(OMEGA_S, true) - explained) * c.gain).max(R::ZERO);
        self.falling = (self.falling + (within(STANDING, falls) - calm) * c.gain_falling).max(R::ZERO);
        let limit = if self.level >= self.falling { explained } else { calm };
        (self.level + self.falling > R::ONE).then(|| Trip::new(Fault::FieldLost, nis, limit))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Q;

    /// Calls of 0.4 ms until a fault; h = 50 ms.
    fn first<R: Real>(x: impl Fn(u32) -> (f64, f64)) -> Option<u32> {
        let c = InnovationConfig { gain: R::from_f64(0.4e-3 / 0.05), gain_falling: R::ZERO };
        let mut innovation = Innovation::default();
        (0..50_000).find(|&k| {
            let (nis, omega_s) = x(k);
            innovation.step(&c, R::from_f64(nis), false, R::from_f64(omega_s)).is_some()
        })
    }

    #[test]
    fn what_exceeds_is_summed_in_every_arithmetic() {
        for found in [first::<f32>(|_| (0.7, 0.01)), first::<f64>(|_| (0.7, 0.01)), first::<Q>(|_| (0.7, 0.01))] {
            assert!(found.is_some_and(|k| (245..=255).contains(&k)), "0.5 · 100 ms: {found:?}");
        }
        assert!(first::<f64>(|_| (9.0, -0.07)).is_some_and(|k| k < 40), "within 15 ms");
    }

    #[test]
    fn one_large_innovation_counts_as_one_of_the_largest() {
        // 3.8 of it a call of 0.4 ms: 50 ms are full in 33 calls, whatever the NIS.
        for nis in [4.0, 9.0, 1e4] {
            assert_eq!(first::<f64>(|_| (nis, 0.0)), Some(32), "{nis}");
        }
    }

    #[test]
    fn transients_and_fast_fields_are_none() {
        assert_eq!(first::<f64>(|_| (0.19, 0.0)), None);
        assert_eq!(first::<f64>(|_| (2.0, 0.09)), None);
        assert_eq!(first::<f64>(|k| (if k % 500 < 20 { 2.0 } else { 0.01 }, 0.0)), None, "8 ms of every 0.2 s");
    }

    /// Calls until a fault of a flux that falls in some of every hundred calls; h = 50 ms.
    fn falling<R: Real>(nis: f64, part: u32, omega_s: f64) -> Option<u32> {
        let c = InnovationConfig { gain: R::from_f64(0.4e-3 / 0.04), gain_falling: R::from_f64(0.4e-3 / 0.05) };
        let mut innovation = Innovation::default();
        (0..50_000).find(|&k| innovation.step(&c, R::from_f64(nis), k % 100 < part, R::from_f64(omega_s)).is_some())
    }

    #[test]
    fn a_small_innovation_that_has_one_sign_is_a_flux_that_collapses() {
        // 0.1 · 0.5 s.
        for found in [falling::<f32>(0.15, 100, 0.0), falling::<f64>(0.15, 100, -0.02), falling::<Q>(0.15, 100, 0.02)] {
            assert!(found.is_some_and(|k| (1230..=1270).contains(&k)), "{found:?}");
        }
    }

    #[test]
    fn a_flux_that_grows_or_swings_or_a_field_that_turns_is_none() {
        assert_eq!(falling::<f64>(0.15, 0, 0.0), None, "grows");
        assert_eq!(falling::<f64>(0.15, 33, 0.0), None, "swings");
        assert_eq!(falling::<f64>(0.15, 100, 0.031), None, "turns");
        assert_eq!(falling::<f64>(0.05, 100, 0.0), None, "calm");
    }

    #[test]
    fn a_flux_that_swings_is_none_however_long_and_both_tests_add_up() {
        let c = InnovationConfig { gain: 0.01, gain_falling: 0.008 };
        // Falls for 1700 calls, 0.54 of h, and rises for as long, in which the sum forgets it.
        let mut innovation = Innovation::<f64>::default();
        let mut swings = |k: u32| innovation.step(&c, 0.09, k % 3400 < 1700, 0.0).is_some();
        assert_eq!((0..200_000).find(|&k| swings(k)), None);
        let both = |nis: f64| {
            let mut innovation = Innovation::<f64>::default();
            (0..2000).find(|_| innovation.step(&c, nis, true, 0.0).is_some())
        };
        // 0.1 · 0.01 + 0.25 · 0.008 a call.
        assert!(both(0.3).is_some_and(|k| (330..=335).contains(&k)));
    }
}
