//! A period of the enhanced scheme, under control and on the way to it.
#![allow(irrefutable_let_patterns, reason = "the other scheme may be left out of the build")]

use super::{Drive, Measurement};
use crate::config::SPEED_PERIODS;
use crate::observer::{Applied, Observer, Seen};
use crate::scalar::{Real, likely};
use crate::space::{AlphaBeta, Dq, Rotator};

/// Part of the magnetising current with which a start at rest tells resistance from inverter error.
const REDUCED: f64 = 0.7;

impl<R: Real> Drive<R> {
    /// Voltage and current references for the period in which the duties act.
    #[inline(always)]
    pub(super) fn enhanced(
        &mut self,
        measured: &Measurement<R>,
        i_s: &AlphaBeta<R>,
        u_l: &AlphaBeta<R>,
        u_max: R,
        running: bool,
    ) -> (AlphaBeta<R>, AlphaBeta<R>) {
        let [a, b, c] = measured.i_abc;
        let sum = a - self.i_off[0] + (b - self.i_off[1]) + (c - self.i_off[2]);
        let x = Applied { i_s: *i_s, sum, u_s: self.estimate.u_s, u_l: *u_l };
        if !likely(running) {
            return self.build_up(&x, u_max);
        }
        let (c, e) = (&self.config, &self.estimate);
        let mut seen = Seen::default();
        if let Observer::Enhanced(o) = &mut self.observer {
            seen = o.period(&c.enhanced, &x, &e.i_dq_ref, e.speed.omega_s, false);
        }
        self.follow(&seen, u_max)
    }

    /// The way to the flux, at any speed. A current that stands still in space drives
    /// `ψ_R` away from zero, and the rotor turns it: `ω = Σ ψ_R × (dψ_R - r_R i dτ) / Σ |ψ_R|² dτ` needs no more
    /// than some milliseconds of it, at 1 pu half a turn. In a machine that turns the current follows `ψ̂_R` from
    /// there on, and the flux builds up as it does at rest. In one at rest the current stays where it is (following
    /// a flux that is a degree off would set a free shaft in motion) until the flux has settled, and then long
    /// enough for the filter to find what resistance and inverter take together.
    #[cold]
    #[inline(never)]
    fn build_up(&mut self, x: &Applied<R>, u_max: R) -> (AlphaBeta<R>, AlphaBeta<R>) {
        let mut i_ref = self.magnetising_current();
        let (c, e) = (&self.config, &mut self.estimate);
        let (mut seen, mut psi_s, mut turning) = (Seen::default(), AlphaBeta::default(), false);
        let mut field = Rotator::default();
        if let Observer::Enhanced(o) = &mut self.observer {
            // Less current for a while: a resistance notices, a voltage that the inverter model has wrong does not.
            if !o.turning() && (9..12).contains(&(self.stage * 16 / c.magnetise_periods.max(1))) {
                i_ref = i_ref * R::from_f64(REDUCED);
            }
            // At rest, the flux is waited for: then it is known by the current.
            if self.stage <= 1 {
                o.start(&c.enhanced, &x.i_s);
            } else if self.stage == c.magnetise_periods / 2 && !o.turning() {
                o.settle(&c.enhanced, c.flux_control.psi_rated);
                self.speed.start(&o.psi_s(), R::ZERO);
            }
            let probing = self.stage <= c.enhanced.probe_periods;
            seen = o.step(&c.enhanced, x, &i_ref, e.speed.omega_s, probing);
            psi_s = o.psi_s();
            let psi_r = psi_s - seen.i_s * c.speed.sigma_l_s;
            if probing {
                let before = e.speed.psi_r;
                // The rise of the current is over after a fifth of it.
                if self.stage > c.enhanced.probe_periods / 5 {
                    let turned = before.cross(&(psi_r - before)) - c.pu.t_s * c.pu.r_r * psi_r.cross(&seen.i_s);
                    o.probe(turned, c.pu.t_s * psi_r.norm_sq());
                }
                e.speed.psi_r = psi_r;
                if self.stage == c.enhanced.probe_periods {
                    let omega = o.probed();
                    self.speed.start(&psi_r, omega);
                    (e.speed.omega_m, e.speed.omega_s) = (omega, omega);
                }
            } else if o.turning() {
                field = Rotator::of(&psi_r).0;
            }
            turning = o.turning();
        }
        let probing = self.stage <= c.enhanced.probe_periods;
        if !probing && self.period.is_multiple_of(SPEED_PERIODS) {
            e.speed = self.speed.step(&c.speed, &psi_s, &seen.i_s);
        }
        e.i_s = seen.i_s;
        e.i_dq = field.to_field(&seen.i_s);
        e.i_dq_ref = i_ref;
        let u_ff = Dq::new(i_ref.re() * seen.r_s, e.speed.omega_s * seen.magnitude);
        let u = self.current_control.step(&c.current, &i_ref, &e.i_dq, &u_ff, u_max);
        let ahead = field.ahead(e.speed.omega_s * c.t_ahead);
        if self.stage >= if turning { c.boost_periods } else { c.magnetise_periods } {
            self.run();
        }
        (ahead.to_stator(&u), ahead.to_stator(&i_ref))
    }
}
