//! Calls of the control: missed and doubled ones, by a cycle stamp that the firmware gives with the measurement.
//!
//! ```text
//! d = stamp - last stamp (wrapping)       d = 1: in time;   d = 0: called twice;   else: d - 1 missed
//! level += 98 for each missed or doubled call, level -= 1 for each in time;     fault beyond 490
//! ```
//!
//! Calls that are missed while the bridge is blocked, as in a write to the flash, are none that count.
//!
//! The estimators integrate one period a call, with the voltage of two calls ago: a call that is missed or doubled is an
//! error of the flux and of the speed that nothing else shows. One in a hundred is tolerated, every 20th is found after
//! some 120 periods, six in a row at once. The stamp counts PWM periods in hardware, e.g. the update events of the
//! timer: 16 bits that wrap.

use super::fault::{Fault, Trip};
use crate::scalar::Real;

/// Weight of a call that is missed or doubled: where one in a hundred is missed, 98 of the others add nothing to the one
/// that counts two periods.
const RISE: u32 = 98;
/// Level of a fault.
const FULL: u32 = 5 * RISE;

/// State.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Timing {
    last: Option<u16>,
    level: u32,
}

impl Timing {
    /// Periods since the latest call; 0: it was in the same one.
    #[inline(always)]
    #[must_use]
    pub fn periods_since(&self, stamp: u16) -> u16 {
        self.last.map_or(1, |last| stamp.wrapping_sub(last))
    }

    /// One call with the stamp of its period, while the bridge switches or while it is blocked.
    #[inline(always)]
    pub fn step<R: Real>(&mut self, stamp: u16, switching: bool) -> Option<Trip<R>> {
        let advance = self.periods_since(stamp);
        self.last = Some(stamp);
        if advance == 1 || !switching {
            self.level = self.level.saturating_sub(1);
            return None;
        }
        self.book(advance)
    }

    #[cold]
    #[inline(never)]
    fn book<R: Real>(&mut self, advance: u16) -> Option<Trip<R>> {
        let n = if advance == 0 { 1 } else { u32::from(advance) - 1 };
        let level = self.level.saturating_add(RISE.saturating_mul(n));
        self.level = if level > FULL { 0 } else { level };
        (level > FULL).then(|| {
            // As a number of irregular calls. Without double precision: this runs in the control interrupt.
            let count = |level: u32| R::ONE.periods(64 * level.div_ceil(RISE).min(100));
            Trip::new(Fault::Timing, count(level), count(FULL))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn first(stamps: impl Iterator<Item = u16>) -> Option<usize> {
        let mut timing = Timing::default();
        stamps.take(100_000).position(|stamp| timing.step::<f64>(stamp, true).is_some())
    }

    #[test]
    fn calls_in_time_are_none_whatever_the_counter_does() {
        assert_eq!(first((0..200_000_u32).map(|k| k as u16)), None);
    }

    #[test]
    fn every_twentieth_call_missing_or_doubled_is_found_soon_and_one_in_a_hundred_tolerated() {
        let missing = |n: u32| (0..400_000_u32).filter(move |k| k % n != 0).map(|k| k as u16);
        let doubled =
            |n: u32| (0..400_000_u32).flat_map(move |k| core::iter::repeat_n(k as u16, 1 + usize::from(k % n == 0)));
        assert!(first(missing(20)).is_some_and(|k| k < 200), "{:?}", first(missing(20)));
        assert!(first(doubled(20)).is_some_and(|k| k < 200), "{:?}", first(doubled(20)));
        assert_eq!((first(missing(100)), first(doubled(100))), (None, None));
        assert!(first(doubled(90)).is_some() && first(missing(90)).is_some());
    }

    #[test]
    fn a_gap_of_six_periods_is_found_at_once_and_one_of_two_is_bridged() {
        let gap = |n: u32| (0..1000_u32).map(move |k| (k + if k < 500 { 0 } else { n }) as u16);
        assert_eq!((first(gap(6)), first(gap(2))), (Some(500), None));
    }

    #[test]
    fn calls_that_are_missed_while_the_bridge_is_blocked_leave_nothing_behind() {
        let mut timing = Timing::default();
        for stamp in [1, 2, 8, 8, 40, 41] {
            assert_eq!(timing.step::<f64>(stamp, false), None);
        }
        assert_eq!(timing, Timing { last: Some(41), level: 0 });
        assert!(timing.step::<f64>(47, true).is_none() && timing.step::<f64>(49, true).is_some(), "six are missed");
    }

    #[test]
    fn the_fault_reports_what_it_was_found_by_and_not_what_was_tolerated_in_the_weeks_before() {
        let mut timing = Timing::default();
        let tolerated = (0..100_000_u32).filter(|k| k % 1000 != 0).find_map(|k| timing.step::<f64>(k as u16, true));
        assert_eq!(tolerated, None);
        assert_eq!(timing.step(100_006_u32 as u16, true), Some(Trip::new(Fault::Timing, 6.0, 5.0)));
    }
}
