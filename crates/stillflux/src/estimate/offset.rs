//! Offset voltage estimator of Fig. 4, equation (9), in the parallel path ψ̂_1.
//!
//! ```text
//! ψ̂_1 = limit(∫ (û_i - û_off) dτ, ±ψ_s*)   per component
//! û_off ← û_off + g (ψ̂_1max + ψ̂_1min) / Δt                                    (9), accumulating
//! ```
//!
//! A dc component drives the trajectory of ψ̂_1 towards one limit; between that limit and the opposite
//! extreme lies half a fundamental period, in which the component `d` moves it by `d Δt`. So with
//! `Δt = T/2` the bracket is `d` itself, and `g <= 1` the part of it taken over each period. (9) read as
//! the *value* of the offset through a unity-gain low-pass would leave half of it; the loop has to
//! accumulate.
//!
//! One window runs per component from one rising zero crossing to the next (with hysteresis). It counts
//! only if
//! * it is not overdue: a window longer than `2π/omega_min` would outlast the drift it is to measure, and
//!   spans perhaps a hold at zero frequency;
//! * it began with a crossing: what lies before the first one after a start is discarded;
//! * it is not the first one after a hold or a time above `omega_max`, where the clearance `d T/2` drowns in
//!   ripple: ψ̂_1 may have moved anywhere in the meantime;
//! * the field turned by one revolution, give or take a quarter: no crossing missed, none too many;
//! * its duration is within a third of the one before, if there was one: the operating point did not change.
//!
//! Otherwise the estimate holds. That is also the state at zero stator frequency: hold.

use crate::scalar::{Integrator, Real};
use crate::space::AlphaBeta;

/// Settings of the offset estimator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OffsetConfig<R: Real> {
    /// Control period, normalised.
    pub t_s: R,
    /// Part `g` of the measured offset that one period takes over; 0.25 to 1.
    pub gain: R,
    /// Limit of each component of `û_off`.
    pub limit: R,
    /// Longest window, in units of 64 of normalised time; see [`longest_window`].
    pub longest: R,
    /// Stator frequency above which the estimate holds.
    pub omega_max: R,
}

/// Windows are measured in units of 64 of normalised time, so that they fit the fixed-point range.
const WINDOW_UNIT: f64 = 1.0 / 64.0;

/// Longest window for a smallest stator frequency, in the unit of [`OffsetConfig::longest`].
#[must_use]
pub fn longest_window(omega_min: f64) -> f64 {
    core::f64::consts::TAU / omega_min * WINDOW_UNIT
}

/// One component of the parallel path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Axis<R: Real> {
    psi_1: Integrator<R>,
    u_off: R,
    max: R,
    min: R,
    /// Duration of the window in `WINDOW_UNIT`s, and the angle the field turned by, in revolutions.
    elapsed: Integrator<R>,
    turned: Integrator<R>,
    /// Duration of the window before; zero: there was none.
    last: R,
    /// ψ̂_1 has been below the hysteresis band since the last crossing.
    armed: bool,
    /// A window is open: there was a crossing since the start or the last hold.
    open: bool,
    /// The next window counts for nothing.
    discard: bool,
}

impl<R: Real> Axis<R> {
    fn start(&mut self, psi: R) {
        let u_off = self.u_off;
        *self = Self { psi_1: Integrator::new(psi), u_off, ..Self::default() };
    }

    #[inline]
    fn step(&mut self, c: &OffsetConfig<R>, u_i: R, psi_ref: R, omega_s: R) -> bool {
        let psi = self.psi_1.add_clamped(c.t_s, u_i - self.u_off, -psi_ref, psi_ref);
        self.max = self.max.max(psi);
        self.min = self.min.min(psi);
        let elapsed = self.elapsed.add(c.t_s, R::from_f64(WINDOW_UNIT));
        let turned = self.turned.add(c.t_s * R::from_f64(core::f64::consts::FRAC_1_PI * 0.5), omega_s);
        if elapsed > c.longest || omega_s.abs() > c.omega_max {
            self.open = false;
            self.discard = true;
            self.last = R::ZERO;
            self.open_window(psi);
        }
        let hysteresis = psi_ref * R::from_f64(0.2);
        if psi < -hysteresis {
            self.armed = true;
        }
        if !(self.armed && psi > hysteresis) {
            return false;
        }
        self.armed = false;
        let steady = self.last == R::ZERO || (elapsed - self.last).abs() < elapsed * R::from_f64(1.0 / 3.0);
        let valid = self.open && !self.discard && steady && (turned.abs() - R::ONE).abs() < R::from_f64(0.25);
        if valid {
            // g (max + min) / (T/2), T = 64 elapsed.
            let correction = (self.max + self.min) * elapsed.recip() * (c.gain * R::from_f64(2.0 * WINDOW_UNIT));
            self.u_off = (self.u_off + correction).limit(c.limit);
        }
        if self.open {
            self.last = elapsed;
            self.discard = false;
        }
        self.open = true;
        self.open_window(psi);
        valid
    }

    fn open_window(&mut self, psi: R) {
        self.elapsed = Integrator::default();
        self.turned = Integrator::default();
        self.max = psi;
        self.min = psi;
    }
}

/// State of the offset estimator.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OffsetEstimator<R: Real> {
    axes: [Axis<R>; 2],
    updates: u32,
    last_correction: R,
}

impl<R: Real> OffsetEstimator<R> {
    /// Begins a trajectory at a known flux; `û_off` stays.
    pub fn start(&mut self, psi_s: AlphaBeta<R>) {
        self.axes[0].start(psi_s.re());
        self.axes[1].start(psi_s.im());
        self.updates = 0;
    }

    /// Loads a stored offset voltage.
    pub fn restore(&mut self, u_off: AlphaBeta<R>) {
        self.axes[0].u_off = u_off.re();
        self.axes[1].u_off = u_off.im();
    }

    /// One period; returns `û_off`.
    #[inline]
    pub fn step(&mut self, config: &OffsetConfig<R>, u_i: &AlphaBeta<R>, psi_ref: R, omega_s: R) -> AlphaBeta<R> {
        let before = self.u_off();
        let a = self.axes[0].step(config, u_i.re(), psi_ref, omega_s);
        let b = self.axes[1].step(config, u_i.im(), psi_ref, omega_s);
        if a || b {
            self.updates = self.updates.saturating_add(1);
            let d = self.u_off() - before;
            self.last_correction = d.re().abs().max(d.im().abs());
        }
        before
    }

    /// Present estimate of the offset voltage.
    #[inline]
    pub fn u_off(&self) -> AlphaBeta<R> {
        AlphaBeta::new(self.axes[0].u_off, self.axes[1].u_off)
    }

    /// The flux trajectory ψ̂_1 of the parallel path.
    pub fn psi_1(&self) -> AlphaBeta<R> {
        AlphaBeta::new(self.axes[0].psi_1.value(), self.axes[1].psi_1.value())
    }

    /// Number of corrections since the start, both components.
    pub fn updates(&self) -> u32 {
        self.updates
    }

    /// Magnitude of the latest correction: how far `û_off` may still be off.
    pub fn last_correction(&self) -> R {
        self.last_correction
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: OffsetConfig<f64> = OffsetConfig { t_s: 0.03, gain: 0.5, limit: 0.05, longest: 24.5, omega_max: 0.2 };

    /// Feeds the induced voltage of a rotating flux of amplitude `a` with a dc component.
    fn run(est: &mut OffsetEstimator<f64>, omega: f64, offset: (f64, f64), a: f64, periods: f64) {
        let n = (periods * core::f64::consts::TAU / (omega.abs() * CONFIG.t_s)) as u32;
        for k in 0..n {
            let (s, c) = (omega * CONFIG.t_s * (f64::from(k) + 0.5)).sin_cos();
            let u = AlphaBeta::new(-a * omega * s + offset.0, a * omega * c + offset.1);
            est.step(&CONFIG, &u, 1.0, omega);
        }
    }

    #[test]
    fn converges_to_the_offset_in_both_directions_of_rotation() {
        for omega in [0.01, -0.01, 0.05] {
            let mut est = OffsetEstimator::default();
            est.start(AlphaBeta::new(1.0, 0.0));
            run(&mut est, omega, (5e-4, -3e-4), 1.0, 12.0);
            let u = est.u_off();
            assert!((u.re() - 5e-4).abs() < 1e-5 && (u.im() + 3e-4).abs() < 1e-5, "{u:?}");
        }
    }

    #[test]
    fn holds_below_the_smallest_frequency_and_never_uses_a_window_that_spans_the_hold() {
        let mut est = OffsetEstimator::default();
        est.start(AlphaBeta::new(1.0, 0.0));
        run(&mut est, 0.01, (5e-4, 0.0), 1.0, 12.0);
        let before = est.u_off();
        for _ in 0..2_000_000 {
            est.step(&CONFIG, &AlphaBeta::new(1e-3, -1e-3), 1.0, 0.0);
        }
        assert_eq!(est.u_off(), before);
        run(&mut est, 0.01, (5e-4, 0.0), 1.0, 1.7);
        assert_eq!(est.u_off(), before, "the first window after a hold does not count");
    }

    #[test]
    fn amplitude_above_the_limit_hides_part_of_the_offset() {
        let mut est = OffsetEstimator::default();
        est.start(AlphaBeta::new(1.0, 0.0));
        run(&mut est, 0.01, (5e-4, 0.0), 1.06, 20.0);
        assert!(est.u_off().re() < 4.5e-4, "the level of the limiter has to be the amplitude");
    }
}
