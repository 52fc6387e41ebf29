//! Trace buffer: the last `N` periods of chosen signals, frozen at a fault.
//!
//! [`Trace::record`] is one store of a sample and an index; it is called in the control interrupt, after the drive's
//! step. After a fault it keeps what led to it until [`Trace::clear`]; the main loop reads it out at leisure.

/// A ring of `N` samples; `N` is a power of two.
///
/// ```
/// use stillflux::trace::Trace;
/// // 64 periods of two signals and a word of state.
/// let mut trace: Trace<[u32; 3], 64> = Trace::new([0; 3]);
/// for k in 0..200 {
///     trace.record([k, 2 * k, 0], k == 149);
/// }
/// assert!(trace.is_frozen());
/// let last: Vec<_> = trace.samples().collect();
/// assert_eq!((last.len(), last[63][0], last[0][0]), (64, 149, 86));
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Trace<T: Copy, const N: usize> {
    samples: [T; N],
    /// Samples recorded since the beginning; the index is its remainder.
    count: u32,
    frozen: bool,
}

impl<T: Copy, const N: usize> Trace<T, N> {
    /// Not a power of two: does not compile.
    const POWER_OF_TWO: () = assert!(N.is_power_of_two(), "the length of a trace is a power of two");

    /// An empty trace, every sample `blank`. `const`: for a `static`.
    #[must_use]
    pub const fn new(blank: T) -> Self {
        const { Self::POWER_OF_TWO };
        Self { samples: [blank; N], count: 0, frozen: false }
    }

    /// Records a sample unless frozen; `fault` freezes after it.
    #[inline]
    pub fn record(&mut self, sample: T, fault: bool) {
        if self.frozen {
            return;
        }
        if let Some(to) = self.samples.get_mut(self.count as usize & (N - 1)) {
            *to = sample;
        }
        // Where the count ends it is as full as before, at the same place.
        self.count = self.count.checked_add(1).unwrap_or(N as u32);
        self.frozen = fault;
    }

    /// Whether a fault has frozen it.
    pub fn is_frozen(&self) -> bool {
        self.frozen
    }

    /// The samples, oldest first: up to `N`.
    pub fn samples(&self) -> impl Iterator<Item = &T> {
        let (newer, older) = self.samples.split_at(self.count as usize & (N - 1));
        let recorded = if (self.count as usize) < N { self.count as usize } else { N };
        older.iter().chain(newer).skip(N - recorded)
    }

    /// Forgets what is recorded and records again.
    pub fn clear(&mut self) {
        self.count = 0;
        self.frozen = false;
    }
}

#[cfg(test)]
mod tests {
    use super::Trace;
    use std::vec::Vec;

    fn values<const N: usize>(trace: &Trace<u32, N>) -> Vec<u32> {
        trace.samples().copied().collect()
    }

    #[test]
    fn holds_the_last_samples_oldest_first() {
        let mut trace = Trace::<u32, 4>::new(99);
        assert!(values(&trace).is_empty());
        for k in 0..3 {
            trace.record(k, false);
        }
        assert_eq!(values(&trace), [0, 1, 2]);
        for k in 3..11 {
            trace.record(k, false);
        }
        assert_eq!(values(&trace), [7, 8, 9, 10]);
    }

    #[test]
    fn a_count_that_ends_loses_nothing() {
        let mut trace = Trace::<u32, 4> { count: u32::MAX - 1, ..Trace::new(0) };
        for k in 1..=4 {
            trace.record(k, false);
        }
        assert_eq!(values(&trace), [1, 2, 3, 4]);
        trace.record(5, true);
        assert_eq!(values(&trace), [2, 3, 4, 5]);
    }

    #[test]
    fn a_fault_freezes_it_until_it_is_cleared() {
        static TRACE: std::sync::Mutex<Trace<u32, 4>> = std::sync::Mutex::new(Trace::new(0));
        let mut trace = TRACE.lock().unwrap();
        for k in 0..9 {
            trace.record(k, k == 5);
        }
        assert!(trace.is_frozen());
        assert_eq!(values(&trace), [2, 3, 4, 5], "the period of the fault is the last one");
        trace.clear();
        trace.record(7, false);
        assert_eq!(values(&trace), [7]);
    }
}
