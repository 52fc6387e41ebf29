//! Leaky counter: a condition that comes and goes is seen as well as one that stays.
//!
//! ```text
//! level += 4 where violated, level -= 1 where not (at least 0);     full at 4 n
//! ```
//!
//! Violated all the time, it is full after `n` calls; violated for more than a fifth of the time, it fills up as well,
//! later. An uninterrupted counter starts again at every zero crossing of a quantity that swings.

use crate::scalar::likely;

/// What one violated call adds, in units of what another takes away.
const RISE: u32 = 4;

/// The counter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LeakyCounter(u32);

impl LeakyCounter {
    /// One call: whether the counter is full, `n` calls of uninterrupted violation; never with
    /// `n = u32::MAX`.
    #[inline(always)]
    pub fn step(&mut self, violated: bool, n: u32) -> bool {
        if likely(!violated) {
            self.0 = self.0.saturating_sub(1);
            return false;
        }
        self.0 = self.0.saturating_add(RISE);
        self.0 > n.saturating_mul(RISE)
    }

    /// A violated call that counts as `times` of them.
    #[cold]
    pub fn step_by(&mut self, times: u32, n: u32) -> bool {
        self.0 = self.0.saturating_add(RISE.saturating_mul(times));
        self.0 > n.saturating_mul(RISE)
    }

    /// Forgets what is more than `n` calls of uninterrupted violation.
    #[cold]
    pub fn limit(&mut self, n: u32) {
        self.0 = self.0.min(n.saturating_mul(RISE));
    }

    /// Nothing has been violated lately.
    #[inline(always)]
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Uninterrupted violation that the level stands for, in calls.
    #[must_use]
    pub fn calls(self) -> u32 {
        self.0 / RISE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Calls until a condition violated for `part` of every ten calls fills a counter of `n`.
    fn calls(part: u32, n: u32) -> Option<u32> {
        let mut counter = LeakyCounter::default();
        (0..100_000).find(|k| counter.step(k % 10 < part, n))
    }

    #[test]
    fn a_condition_that_stays_fills_it_after_n_calls_and_one_that_swings_later() {
        assert_eq!(calls(10, 50), Some(50));
        assert!(calls(5, 50).is_some_and(|k| k > 100 && k < 150));
        assert!(calls(3, 50).is_some());
    }

    #[test]
    fn what_happens_now_and_then_never_does() {
        assert_eq!(calls(2, 50), None);
        assert_eq!(calls(0, 50), None);
    }
}
