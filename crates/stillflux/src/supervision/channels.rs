//! Current channels: the three phase currents add up to zero. Per unit.
//!
//! ```text
//! |i_a + i_b + i_c| > 0.05 i_range + 0.08 violated; a fault after 4 ms (leaky, [`super::leaky`])
//!                   > 3 times that        counts for 2 ms
//! ```
//!
//! A machine with an isolated star point has no zero-sequence current: a sum is an error of a channel. A channel that
//! is stuck, saturated, inverted or has lost its gain shows as soon as its phase's current changes. The limit is above
//! what gain errors of 5 % make of the largest current.
//!
//! A channel whose sign turns makes current control unstable along its axis: the current grows by `e` in `1/ω_c`, a
//! millisecond and less. Within 4 ms it is far beyond the trip level, which the measured vector, without this channel, does
//! not show. Such a sum is large at once. Two calls of it are a fault; what a single reading shows is not, once in 10 to 20 ms.
//!
//! Validity: three channels. Where the third current is computed from two the sum is always zero and the monitor is off;
//! swapped channels leave it zero. Both show in [`super::phases`].

use super::fault::{Fault, Trip};
use super::leaky::LeakyCounter;
use crate::scalar::Real;
use crate::words::words;

/// Largest sum that errors of the gains make, relative to the range of the channels, and what is admitted beside it, per
/// unit.
pub(crate) const GAIN_ERROR: f64 = 0.05;
pub(crate) const BESIDE: f64 = 0.08;
/// Time of an uninterrupted violation that is a fault, s.
pub(crate) const TIME: f64 = 0.004;
/// Sum, in units of the limit, that no error of a gain explains.
const GROSS: f64 = 3.0;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct ChannelConfig<R: Real> {
    /// Largest sum.
    pub limit: R,
    /// Calls of uninterrupted violation that are a fault.
    pub calls: u32,
}
words!(ChannelConfig: limit, calls);

/// State.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Channels {
    counter: LeakyCounter,
}

impl Channels {
    /// One call with the phase currents less their offsets.
    #[inline(always)]
    pub fn step<R: Real>(&mut self, c: &ChannelConfig<R>, i_abc: &[R; 3]) -> Option<Trip<R>> {
        let sum = i_abc[0] + i_abc[1] + i_abc[2];
        let violated = !sum.within(c.limit);
        let full = if violated && !sum.within(c.limit * R::from_f64(GROSS)) {
            self.counter.step_by(c.calls / 2 + 1, c.calls)
        } else {
            self.counter.step(violated, c.calls)
        };
        full.then(|| Trip::new(Fault::CurrentSum, sum, c.limit))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stuck_channel_is_found_within_its_calls_and_the_sum_is_reported() {
        let c = ChannelConfig { limit: 0.2, calls: 10 };
        let mut channels = Channels::default();
        let found = (0..1000).find_map(|k| {
            let x = 0.6 * (0.03 * f64::from(k)).cos();
            let y = 0.6 * (0.03 * f64::from(k) - 2.094).cos();
            // Phase a is stuck at the value it had at the beginning.
            channels.step(&c, &[0.6, y, -x - y]).map(|trip| (k, trip))
        });
        let (k, trip) = found.unwrap();
        assert!(trip.cause == Fault::CurrentSum && trip.value > 0.2 && trip.limit == 0.2);
        assert!((28..60).contains(&k), "0.6 (1 - cos 0.84) = 0.2 at 28: {k}");
    }

    #[test]
    fn a_gross_sum_is_found_in_its_second_call_and_a_single_reading_is_none() {
        for (sign, calls) in [(1.0, 10), (-1.0, 10), (1.0, 4), (1.0, 20)] {
            let c = ChannelConfig { limit: 0.2, calls };
            let mut channels = Channels::default();
            assert_eq!(channels.step(&c, &[sign, 0.0, 0.0]), None);
            assert!(channels.step(&c, &[sign, 0.0, 0.0]).is_some());
            let mut channels = Channels::default();
            for k in 0..10_000 {
                let i = if k % (4 * calls) == 0 { sign } else { 0.0 };
                assert_eq!(channels.step(&c, &[i, 0.0, 0.0]), None, "{k}");
            }
        }
    }

    #[test]
    fn gain_errors_are_none() {
        let mut channels = Channels::default();
        let c = ChannelConfig { limit: 0.2, calls: 10 };
        for k in 0..10_000 {
            let i = [0.0, 2.094, 4.189].map(|phase| 1.8 * (0.03 * f64::from(k) - phase).cos());
            assert_eq!(channels.step(&c, &[1.05 * i[0], i[1], 0.95 * i[2]]), None);
        }
    }
}
