//! Bridging of a measurement that cannot be used: the current of the latest one takes its place, once in 10 ms.

use super::{Fault, Measurement, Sequence, Trip};
use crate::config::DriveConfig;
use crate::scalar::Real;
use crate::space::AlphaBeta;

impl<R: Real> Sequence<R> {
    /// In place of a measurement that cannot be used: that of the current vector `last` of the latest one, with the dc link's
    /// voltage then; nothing while the bridge is blocked, or at the second such measurement.
    #[inline(always)]
    pub fn bridge(
        &mut self,
        c: &DriveConfig<R>,
        m: &Measurement<R>,
        last: impl FnOnce() -> AlphaBeta<R>,
        u_dc: impl FnOnce() -> Option<R>,
    ) -> Option<Measurement<R>> {
        let last = last();
        if !self.bridges(c, m, &last) {
            return None;
        }
        let switching = self.is_switching();
        let u_dc = u_dc().filter(|_| switching)?;
        Some(self.measurement(c, &last, u_dc))
    }

    /// A measurement that cannot be used: whether it is the only one for a while, which is bridged. The second within
    /// 10 ms is a fault. So is, at once, a current beyond the trip level that the voltage can have made since the last
    /// measurement: that is a current that grows, even at the end of a channel's range, and no wrong reading.
    #[cold]
    #[inline(never)]
    fn bridges(&mut self, c: &DriveConfig<R>, m: &Measurement<R>, last: &AlphaBeta<R>) -> bool {
        let alone = self.period.wrapping_sub(self.last_bad) > c.bridged_periods;
        self.last_bad = self.period;
        let trip = if let Some(i) = self.grown(c, m, last) {
            Some(Trip::new(Fault::OverCurrent, i, c.i_trip))
        } else if alone {
            None
        } else {
            self.examine(c, m)
        };
        let Some(trip) = trip else { return alone };
        self.fault(trip);
        false
    }

    /// The current, if it is beyond the trip level and the voltage can have changed it by that since the last measurement:
    /// `|i - i_last| ≤ 4/3 u_dc t_s/σl_s`, that of the bridge and as much induced.
    fn grown(&self, c: &DriveConfig<R>, m: &Measurement<R>, last: &AlphaBeta<R>) -> Option<R> {
        let i_s = AlphaBeta::<R>::from_phases(self.without_offset(c, m, || R::ZERO));
        // `part_ahead` is 1.5 ω_c t_s, and k_p = ω_c σl_s.
        let most = m.u_dc * c.part_ahead * c.current.inv_k_p * R::from_f64(8.0 / 9.0);
        let beyond = i_s.norm_sq() > c.i_trip * c.i_trip && (i_s - *last).norm_sq() <= most * most;
        beyond.then(|| i_s.norm_sq().sqrt())
    }

    /// The measurement that a current vector without offsets and a dc-link voltage would have been.
    #[cold]
    #[inline(never)]
    fn measurement(&self, c: &DriveConfig<R>, i_s: &AlphaBeta<R>, u_dc: R) -> Measurement<R> {
        let ([i_a, i_b, i_c], off) = (i_s.to_phases(), self.offsets(c));
        Measurement { i_abc: [i_a + off[0], i_b + off[1], i_c + off[2]], u_dc }
    }
}
