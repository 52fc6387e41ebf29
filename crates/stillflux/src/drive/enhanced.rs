//! A period of the enhanced scheme, under control and on the way to it.
#![allow(irrefutable_let_patterns, reason = "the other scheme may be left out of the build")]

use super::{Drive, Measurement};
use crate::config::SPEED_PERIODS;
use crate::observer::{Applied, Observer, Seen};
use crate::scalar::{Real, likely};
use crate::space::{AlphaBeta, Rotator};

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
        let [a, b, c] = self.without_offset(measured);
        let blind = !likely(running) && self.prepare(i_s);
        let (config, e) = (&self.config, &self.estimate);
        let x = Applied { i_s: *i_s, sum: a + b + c, u_s: e.u_s, u_l: *u_l };
        let mut seen = Seen::default();
        if let Observer::Enhanced(o) = &mut self.observer {
            seen = o.period(&config.enhanced, &x, &e.i_dq_ref, e.speed.omega_s, blind);
        }
        if !likely(running) {
            self.build_up(&mut seen);
        }
        self.follow(&seen, u_max)
    }

    /// The way to the flux, at any speed. A current that stands still in space drives `ψ_R` away from zero, and the
    /// rotor turns it: `ω = Σ ψ_R × (dψ_R - r_R i dτ) / Σ |ψ_R|² dτ` needs no more than some milliseconds of it, at
    /// 1 pu half a turn. In a machine that turns the current follows `ψ̂_R` from there on, and the flux builds up as
    /// it does at rest. In one at rest the current stays where it is (following a flux that is a degree off would
    /// set a free shaft in motion) until the flux has settled, and then long enough for the filter to find what
    /// resistance and inverter take together.
    ///
    /// Before the filter's period: the current reference; whether the machine is still without flux.
    #[cold]
    #[inline(never)]
    fn prepare(&mut self, i_s: &AlphaBeta<R>) -> bool {
        let mut i_ref = self.magnetising_current();
        let c = &self.config;
        if let Observer::Enhanced(o) = &mut self.observer {
            // Less current for a while: a resistance notices, a voltage that the inverter model has wrong does not.
            if !o.turning() && (9..12).contains(&(self.stage * 16 / c.magnetise_periods.max(1))) {
                i_ref = i_ref * R::from_f64(REDUCED);
            }
            // At rest, the flux is waited for: then it is known by the current.
            if self.stage <= 1 {
                o.start(&c.enhanced, i_s);
            } else if self.stage == c.magnetise_periods / 2 && !o.turning() {
                o.settle(&c.enhanced, c.flux_control.psi_rated);
                self.speed.start(&o.psi_s(), R::ZERO);
            }
        }
        self.estimate.i_dq_ref = i_ref;
        self.stage <= c.enhanced.probe_periods
    }

    /// After it: speed, and the direction that the current takes.
    #[cold]
    #[inline(never)]
    fn build_up(&mut self, seen: &mut Seen<R>) {
        let probing = self.stage <= self.config.enhanced.probe_periods;
        if !probing && self.period.is_multiple_of(SPEED_PERIODS) {
            self.track();
        }
        let (c, e) = (&self.config, &mut self.estimate);
        let probe_periods = c.enhanced.probe_periods;
        let mut enough = c.magnetise_periods;
        if let Observer::Enhanced(o) = &mut self.observer {
            let i_s = o.i_s();
            let psi_r = o.psi_s() - i_s * c.speed.sigma_l_s;
            seen.field = Rotator::default();
            if probing {
                let before = e.speed.psi_r;
                // The rise of the current is over after a fifth of it.
                if self.stage > probe_periods / 5 {
                    let turned = before.cross(&(psi_r - before)) - c.t_s * c.speed.r_r * psi_r.cross(&i_s);
                    o.probe(turned, c.t_s * psi_r.norm_sq());
                }
                e.speed.psi_r = psi_r;
                if self.stage == probe_periods {
                    let omega = o.probed();
                    self.speed.start(&psi_r, omega);
                    (e.speed.omega_m, e.speed.omega_s) = (omega, omega);
                }
            } else if o.turning() {
                seen.field = Rotator::of(&psi_r).0;
                enough = c.boost_periods;
            }
            seen.i_dq = seen.field.to_field(&i_s);
        }
        if self.stage >= enough {
            self.run();
        }
    }
}
