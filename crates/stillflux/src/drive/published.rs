//! A period of the published scheme, under control and on the way to it.
#![allow(irrefutable_let_patterns, reason = "the other scheme may be left out of the build")]

use super::Drive;
use crate::observer::{Observer, Seen};
use crate::scalar::{Real, likely};
use crate::space::{AlphaBeta, Rotator};

impl<R: Real> Drive<R> {
    /// Voltage and current references for the period in which the duties act.
    #[inline(always)]
    pub(super) fn published(&mut self, i_s: &AlphaBeta<R>, u_max: R, running: bool) -> (AlphaBeta<R>, AlphaBeta<R>) {
        if !likely(running) {
            return self.magnetise(i_s, u_max);
        }
        let (c, e) = (&self.config, &self.estimate);
        let mut seen = Seen::default();
        if let Observer::Published(o) = &mut self.observer {
            seen = o.step(&c.published, i_s, &e.u_s, e.psi_ref);
        }
        self.follow(&seen, u_max)
    }

    /// Direct current along the a-axis; its last quarter gives `r̂_s`.
    #[cold]
    #[inline(never)]
    fn magnetise(&mut self, i_s: &AlphaBeta<R>, u_max: R) -> (AlphaBeta<R>, AlphaBeta<R>) {
        let i_ref = self.magnetising_current();
        let (c, e) = (&self.config, &mut self.estimate);
        let field = Rotator::default();
        let i_dq = field.to_field(i_s);
        let u = self.current_control.step(&c.current, &i_ref, &i_dq, &(i_ref * c.published.r_s), u_max);
        (e.i_dq, e.i_dq_ref) = (i_dq, i_ref);

        let left = c.magnetise_periods.saturating_sub(self.stage);
        if let Observer::Published(o) = &mut self.observer {
            o.rest(i_s);
            if left < c.published.r_s_periods {
                o.read_resistance(&c.published, e.u_s.re(), i_ref.re());
            }
            if left == 0 {
                let psi = AlphaBeta::new(c.flux_control.psi_rated, R::ZERO);
                o.start(c, psi, *i_s);
                self.speed.start(&psi, R::ZERO);
                self.run();
            }
        }
        (field.to_stator(&u), field.to_stator(&i_ref))
    }
}
