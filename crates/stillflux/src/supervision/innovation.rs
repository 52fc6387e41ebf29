//! Lost field: the innovation of the filter contradicts its model for longer than a transient. Per unit.
//!
//! ```text
//! g = max(0, g + w (NIS - 0.2) dt) at |ω̂_s| < 0.08, else max(0, g - 0.2 dt);    a fault at g > h    (Page's CUSUM)
//! w = 1 at |ω̂_s| < 0.02, 1/2 beyond, for NIS > 0.2;    w = 1 below
//! ```
//!
//! NIS: normalised innovation squared of [`crate::estimate::kalman`], low-passed over 20 ms. The test sums what exceeds
//! the level that allowances and transients of a field that is not lost explain: a violent contradiction is found
//! within tens of ms, a small one that stays within some tenths of a second.
//!
//! The band is where a wrong field can stay. A voltage error `u` holds an angle error of `u/(ω_s ψ)`: 30° at
//! `|ω_s|` = 0.08 takes 0.04 pu, a quarter of the voltage of resistance and bridge at the largest current of a small
//! machine. Beyond it an innovation is a transient (a step of the load with a machine that is not that of the data): the
//! rotation takes the error away within some tens of ms, and a field that is lost for all that swings and is seen by
//! [`super::plausibility`]. Below 0.02 it takes a quarter of that voltage, which errors of `r_s` by some percent are, a
//! shaft is gone within a tenth of a second, and an innovation counts twice as much. Exactly at `ω_s = 0` a wrong field may
//! be without contradiction, which is left to [`super::stall`].
//!
//! `h` = 20 ms. Measured over 960 draws of ten drives in eight courses at 2.5 times the tolerances, everything off at once,
//! the test alone on runs without supervision: 28 go on lost (0.2 s with 0.2 pu of speed error, or 1 s with 30°), and it
//! finds 24 of them before that; of the 874 that come through it ends 10, with 10 to 27° of angle error, and none of 871 at
//! the tolerances themselves, which come to 0.67 of `h` at most. With `w` = 1/2 in the whole band it finds 20 and ends 6;
//! with a band of 0.2 it ended 11 of 489, 8 of them at `|ω̂_s|` of 0.09 to 0.19.

use super::fault::{Fault, Trip};
use crate::scalar::{Real, likely};
use crate::words::words;

/// NIS that is explained otherwise.
const EXPLAINED: f64 = 0.2;
/// Largest NIS that counts.
const LARGEST: f64 = 4.0;
/// Largest stator frequency at which a wrong field can stay.
const OMEGA_S: f64 = 0.08;
/// That below which errors of some percent of the resistance hold it.
const STANDING: f64 = 0.02;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct InnovationConfig<R: Real> {
    /// Time between two calls over `h`; 0: never a fault.
    pub gain: R,
}
words!(InnovationConfig: gain);

/// State.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Innovation<R: Real> {
    /// `g/h`.
    level: R,
}

impl<R: Real> Default for Innovation<R> {
    fn default() -> Self {
        Self { level: R::ZERO }
    }
}

impl<R: Real> Innovation<R> {
    /// One call.
    #[inline(always)]
    pub fn step(&mut self, c: &InnovationConfig<R>, nis: R, omega_s: R) -> Option<Trip<R>> {
        let explained = R::from_f64(EXPLAINED);
        if likely(nis <= explained && self.level == R::ZERO) {
            return None;
        }
        self.add(c, nis, omega_s)
    }

    #[cold]
    #[inline(never)]
    fn add(&mut self, c: &InnovationConfig<R>, nis: R, omega_s: R) -> Option<Trip<R>> {
        let explained = R::from_f64(EXPLAINED);
        let nis = if omega_s.within(R::from_f64(OMEGA_S)) { nis.min(R::from_f64(LARGEST)) } else { R::ZERO };
        let mut excess = nis - explained;
        if excess > R::ZERO && !omega_s.within(R::from_f64(STANDING)) {
            excess = excess.half();
        }
        self.level = (self.level + excess * c.gain).max(R::ZERO);
        (self.level > R::ONE).then(|| Trip::new(Fault::FieldLost, nis, explained))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Q;

    /// Calls of 0.4 ms until a fault; h = 50 ms.
    fn first<R: Real>(x: impl Fn(u32) -> (f64, f64)) -> Option<u32> {
        let c = InnovationConfig { gain: R::from_f64(0.4e-3 / 0.05) };
        let mut innovation = Innovation::default();
        (0..50_000).find(|&k| {
            let (nis, omega_s) = x(k);
            innovation.step(&c, R::from_f64(nis), R::from_f64(omega_s)).is_some()
        })
    }

    #[test]
    fn what_exceeds_is_summed_in_every_arithmetic() {
        for found in [first::<f32>(|_| (0.7, 0.01)), first::<f64>(|_| (0.7, 0.01)), first::<Q>(|_| (0.7, 0.01))] {
            assert!(found.is_some_and(|k| (245..=255).contains(&k)), "0.5 · 100 ms: {found:?}");
        }
        assert!(first::<f64>(|_| (9.0, -0.01)).is_some_and(|k| k < 40), "within 15 ms");
    }

    #[test]
    fn an_innovation_counts_half_where_the_field_turns_and_its_absence_in_full() {
        let calls = |omega_s: f64| first::<f64>(|_| (0.7, omega_s)).unwrap();
        assert_eq!([calls(0.019), calls(-0.019)], [calls(0.0); 2]);
        assert_eq!([calls(0.021), calls(-0.021), calls(0.079)], [2 * calls(0.0) + 1; 3]);
        // 0.4 · 0.4 is more than 0.6 · 0.2, and half of it less.
        let swings = |omega_s: f64| first::<f64>(|k| (if k % 10 < 4 { 0.6 } else { 0.0 }, omega_s));
        assert!(swings(0.01).is_some() && swings(0.03).is_none());
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
}
