//! Without the feature `bridging` the first measurement that cannot be used is a fault.

use super::{Measurement, Sequence};
use crate::config::DriveConfig;
use crate::scalar::Real;
use crate::space::AlphaBeta;

impl<R: Real> Sequence<R> {
    /// Nothing in place of a measurement that cannot be used.
    #[inline(always)]
    pub fn bridge(
        &mut self,
        c: &DriveConfig<R>,
        m: &Measurement<R>,
        _: impl FnOnce() -> AlphaBeta<R>,
        _: impl FnOnce() -> Option<R>,
    ) -> Option<Measurement<R>> {
        if let Some(trip) = self.examine(c, m) {
            self.fault(trip);
        }
        None
    }
}
