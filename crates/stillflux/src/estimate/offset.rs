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

use crate::scalar::{QuickIntegrator, Real, likely};
use crate::space::AlphaBeta;
use crate::words::words;

/// Control periods of one step of the parallel path. It counts up to `omega_max`, 0.2 pu, where a turn of the field has at
/// least 100 periods ([`crate::base`]): what two of them miss of an extreme is 0.2 % of the flux, in both extremes alike.
pub const OFFSET_PERIODS: u32 = 2;

/// Largest offset voltage, per unit: several times what current sensors and inverter cause.
pub const U_OFF_MAX: f64 = 0.05;

/// Settings of the offset estimator.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct OffsetConfig<R: Real> {
    /// Time between two calls of [`OffsetEstimator::step`], normalised.
    pub t_s: R,
    /// Part `g` of the measured offset that one period takes over; 0.25 to 1.
    pub gain: R,
    /// Limit of each component of `û_off`.
    pub limit: R,
    /// Half width of the band around zero within which the sign of ψ̂_1 counts as unchanged.
    pub hysteresis: R,
    /// Time between two calls of [`OffsetEstimator::set_stator_frequency`], normalised.
    pub interval: R,
    /// That time in revolutions at a stator frequency of one, `interval / 2π`.
    pub turn: R,
    /// Longest window in such intervals; see [`longest_window`].
    pub longest: u32,
    /// Stator frequency above which the estimate holds.
    pub omega_max: R,
}
words!(OffsetConfig: t_s, gain, limit, hysteresis, interval, turn, longest, omega_max);

/// Longest window for a smallest stator frequency, in intervals of normalised length.
#[must_use]
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
pub fn longest_window(omega_min: f64, interval: f64) -> u32 {
    (core::f64::consts::TAU / (omega_min * interval)) as u32
}

/// Time and field angle, common to both components: windows are differences of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
struct Now<R: Real> {
    /// Calls of [`OffsetEstimator::set_stator_frequency`], wrapping.
    interval: u32,
    /// Angle that the field turned by, in revolutions.
    turned: R,
}

/// One component of the parallel path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
struct Axis<R: Real> {
    psi_1: QuickIntegrator<R>,
    u_off: R,
    max: R,
    min: R,
    /// Interval and angle at which the window began.
    began: u32,
    began_at: R,
    /// Intervals of the window before; zero: there was none.
    last: u32,
    /// ψ̂_1 has been below the hysteresis band since the last crossing: the negative half wave.
    armed: bool,
    /// A window is open: there was a crossing since the start or the last hold.
    open: bool,
    /// The next window counts for nothing.
    discard: bool,
}

impl<R: Real> Axis<R> {
    fn start(&mut self, psi: R) {
        *self = Self { psi_1: QuickIntegrator::new(psi), u_off: self.u_off, max: psi, min: psi, ..Self::default() };
    }

    /// One call; `true` at a rising zero crossing.
    #[inline(always)]
    fn step(&mut self, c: &OffsetConfig<R>, u_i: R, psi_ref: R) -> bool {
        let psi = self.psi_1.add_limited(c.t_s, u_i - self.u_off, psi_ref);
        if self.armed {
            if psi < self.min {
                self.min = psi;
            }
            return !likely(psi <= c.hysteresis);
        }
        if psi > self.max {
            self.max = psi;
        } else if !likely(psi >= -c.hysteresis) {
            self.min = psi;
            self.armed = true;
        }
        false
    }

    /// The window that is open, and the next one, do not count.
    fn hold(&mut self, now: &Now<R>) {
        self.open = false;
        self.discard = true;
        self.last = 0;
        self.open_window(self.psi_1.value(), now);
    }

    /// A rising zero crossing: judges the window that it ends and opens the next one.
    #[inline(never)]
    fn crossing(&mut self, c: &OffsetConfig<R>, now: &Now<R>) -> bool {
        let psi = self.psi_1.value();
        self.armed = false;
        let elapsed = now.interval.wrapping_sub(self.began);
        let turned = now.turned - self.began_at;
        let steady = self.last == 0 || elapsed.abs_diff(self.last) < elapsed / 3;
        let valid = self.open && !self.discard && steady && (turned.abs() - R::ONE).abs() < R::from_f64(0.25);
        if valid {
            // g (max + min) / (T/2), T = 64 · duration.
            let duration = c.interval.periods(elapsed);
            let correction = (self.max + self.min) * duration.recip_seldom() * (c.gain * R::from_f64(2.0 / 64.0));
            self.u_off = (self.u_off + correction).limit(c.limit);
        }
        if self.open {
            self.last = elapsed;
            self.discard = false;
        }
        self.open = true;
        self.open_window(psi, now);
        valid
    }

    fn open_window(&mut self, psi: R, now: &Now<R>) {
        self.began = now.interval;
        self.began_at = now.turned;
        self.max = psi;
        self.min = psi;
    }
}

/// State of the offset estimator.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct OffsetEstimator<R: Real> {
    axes: [Axis<R>; 2],
    now: Now<R>,
    /// Interval in which some window may be overdue.
    due: u32,
    /// The field turns faster than the estimate can follow.
    fast: bool,
    updates: u32,
    last_correction: R,
}

impl<R: Real> OffsetEstimator<R> {
    /// Begins a trajectory at a known flux; `û_off` stays.
    pub fn start(&mut self, psi_s: AlphaBeta<R>) {
        self.now = Now::default();
        self.due = 1;
        self.axes[0].start(psi_s.re());
        self.axes[1].start(psi_s.im());
        self.updates = 0;
    }

    /// Loads a stored offset voltage.
    pub fn restore(&mut self, u_off: AlphaBeta<R>) {
        self.axes[0].u_off = u_off.re();
        self.axes[1].u_off = u_off.im();
    }

    /// One call, with the mean of `û_i` since the last one.
    #[inline(always)]
    pub fn step(&mut self, c: &OffsetConfig<R>, u_i: &AlphaBeta<R>, psi_ref: R) {
        // A number that only a crossing changes: two answers would have to be made values in every call.
        let mut crossed = 0_u8;
        if !likely(!self.axes[0].step(c, u_i.re(), psi_ref)) {
            crossed = 1;
        }
        if !likely(!self.axes[1].step(c, u_i.im(), psi_ref)) {
            crossed += 2;
        }
        if !likely(crossed == 0) {
            self.crossing(c, [crossed & 1 != 0, crossed & 2 != 0]);
        }
    }

    /// Once in [`OffsetConfig::interval`]: time and field angle move on at the stator frequency `omega_s`.
    #[inline(always)]
    pub fn set_stator_frequency(&mut self, c: &OffsetConfig<R>, omega_s: R) {
        self.now.interval = self.now.interval.wrapping_add(1);
        self.now.turned += omega_s * c.turn;
        // A branch for each state: compared with it, the answer would have to be made a value first.
        let stays = if self.fast { !omega_s.within(c.omega_max) } else { omega_s.within(c.omega_max) };
        if !likely(stays && self.now.interval != self.due) {
            self.hold(c, self.fast == stays);
        }
    }

    /// Rising zero crossings, one or two in a fundamental period.
    #[cold]
    #[inline(never)]
    fn crossing(&mut self, c: &OffsetConfig<R>, crossed: [bool; 2]) {
        let before = self.u_off();
        let mut corrected = false;
        for (axis, crossed) in self.axes.iter_mut().zip(crossed) {
            if crossed && self.fast {
                axis.armed = false;
                axis.hold(&self.now);
            } else if crossed {
                corrected |= axis.crossing(c, &self.now);
            }
        }
        if corrected {
            self.updates = self.updates.saturating_add(1);
            let d = self.u_off() - before;
            self.last_correction = d.re().abs().max(d.im().abs());
        }
        self.renew(c);
    }

    /// Windows that do not count: those that are overdue, and any that touches a time of fast rotation.
    #[cold]
    #[inline(never)]
    fn hold(&mut self, c: &OffsetConfig<R>, fast: bool) {
        let changed = fast != self.fast;
        self.fast = fast;
        for axis in &mut self.axes {
            if changed || self.now.interval.wrapping_sub(axis.began) > c.longest {
                axis.hold(&self.now);
            }
        }
        self.renew(c);
    }

    /// When the oldest window will be overdue. The angle begins anew, so that it stays within the range where it
    /// is resolved well.
    fn renew(&mut self, c: &OffsetConfig<R>) {
        let age = |axis: &Axis<R>| self.now.interval.wrapping_sub(axis.began);
        let oldest = age(&self.axes[0]).max(age(&self.axes[1]));
        self.due = self.now.interval.wrapping_add(c.longest.saturating_sub(oldest)).wrapping_add(1);
        for axis in &mut self.axes {
            axis.began_at -= self.now.turned;
        }
        self.now.turned = R::ZERO;
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

    const CONFIG: OffsetConfig<f64> = OffsetConfig {
        t_s: 0.03,
        gain: 0.5,
        limit: 0.05,
        hysteresis: 0.2,
        interval: 0.03,
        turn: 0.03 / core::f64::consts::TAU,
        longest: 52_266,
        omega_max: 0.2,
    };

    /// Feeds the induced voltage of a rotating flux of amplitude `a` with a dc component.
    fn run(est: &mut OffsetEstimator<f64>, omega: f64, offset: (f64, f64), a: f64, periods: f64) {
        let n = (periods * core::f64::consts::TAU / (omega.abs() * CONFIG.t_s)) as u32;
        for k in 0..n {
            let (s, c) = (omega * CONFIG.t_s * (f64::from(k) + 0.5)).sin_cos();
            let u = AlphaBeta::new(-a * omega * s + offset.0, a * omega * c + offset.1);
            est.step(&CONFIG, &u, 1.0);
            est.set_stator_frequency(&CONFIG, omega);
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
            est.step(&CONFIG, &AlphaBeta::new(1e-3, -1e-3), 1.0);
            est.set_stator_frequency(&CONFIG, 0.0);
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

    /// Revolutions, to an eighth, until there have been `times` more corrections; `told` is what the estimator hears
    /// of the stator frequency.
    fn until_corrected(
        est: &mut OffsetEstimator<f64>,
        (omega, told): (f64, f64),
        times: u32,
        most: u32,
    ) -> Option<f64> {
        let (n, before) = ((core::f64::consts::TAU / (omega * CONFIG.t_s)) as u32, est.updates());
        (0..n * most).find_map(|k| {
            let (s, c) = (omega * CONFIG.t_s * (f64::from(k) + 0.5)).sin_cos();
            est.step(&CONFIG, &AlphaBeta::new(-omega * s + 2e-4, omega * c), 1.0);
            est.set_stator_frequency(&CONFIG, told);
            (est.updates() >= before + times).then(|| (8.0 * f64::from(k) / f64::from(n)).round() / 8.0)
        })
    }

    #[test]
    fn a_window_counts_once_it_lies_between_two_crossings_and_not_next_to_fast_rotation() {
        let mut est = OffsetEstimator::default();
        est.start(AlphaBeta::new(1.0, 0.0));
        // The first rising crossing, that of α, is at three quarters.
        assert_eq!(until_corrected(&mut est, (0.05, 0.05), 1, 4), Some(1.75));
        // Above `omega_max` nothing counts, nor does the first window below it: crossings of β at 0, 1 and 2.
        assert_eq!(until_corrected(&mut est, (0.25, 0.25), 1, 40), None);
        assert_eq!(until_corrected(&mut est, (0.05, 0.05), 1, 6), Some(2.0));
    }

    #[test]
    fn a_window_counts_only_if_the_field_turned_once_in_it() {
        for told in [0.0, 0.03, 0.08, 0.1] {
            let mut est = OffsetEstimator::default();
            est.start(AlphaBeta::new(1.0, 0.0));
            assert_eq!(until_corrected(&mut est, (0.05, told), 1, 8), None, "{told}");
        }
    }

    #[test]
    fn a_window_counts_only_if_it_is_as_long_as_the_one_before() {
        let mut est = OffsetEstimator::default();
        est.start(AlphaBeta::new(1.0, 0.0));
        run(&mut est, 0.02, (2e-4, 0.0), 1.0, 6.0);
        // β ends its last slow window at once; the next one is shorter, and the one after that as long as it.
        assert_eq!(until_corrected(&mut est, (0.06, 0.06), 2, 6), Some(2.0));
    }

    #[test]
    fn a_moment_of_fast_rotation_spoils_the_window_it_falls_into_and_the_next_one() {
        let mut est = OffsetEstimator::default();
        est.start(AlphaBeta::new(1.0, 0.0));
        run(&mut est, 0.05, (2e-4, 0.0), 1.0, 1.0);
        assert_eq!(est.updates(), 0);
        est.set_stator_frequency(&CONFIG, 0.25);
        assert_eq!(until_corrected(&mut est, (0.05, 0.05), 1, 6), Some(2.0), "not the window of α that ends at 0.75");
    }

    #[test]
    fn ripple_within_the_hysteresis_opens_no_window() {
        let mut est = OffsetEstimator::default();
        est.start(AlphaBeta::new(1.0, 0.0));
        let n = (20.0 * core::f64::consts::TAU / (0.01 * CONFIG.t_s)) as u32;
        for k in 0..n {
            let tau = CONFIG.t_s * (f64::from(k) + 0.5);
            let ((s, c), ripple) = ((0.01 * tau).sin_cos(), 0.45 * (3.0 * tau).cos());
            est.step(&CONFIG, &AlphaBeta::new(-0.01 * s + ripple + 5e-4, 0.01 * c + ripple), 1.05);
            est.set_stator_frequency(&CONFIG, 0.01);
        }
        assert!(est.updates() > 30, "{}", est.updates());
    }

    #[test]
    fn the_estimate_stays_within_its_limit_and_tells_its_latest_correction_of_either_axis() {
        let mut est = OffsetEstimator::default();
        est.start(AlphaBeta::new(1.0, 0.0));
        run(&mut est, 0.01, (0.0, -5e-4), 1.0, 2.2);
        assert!((est.last_correction() - 2.5e-4).abs() < 2e-5, "half of it: {}", est.last_correction());
        let tight = OffsetConfig { limit: 1e-4, ..CONFIG };
        for sign in [1.0, -1.0] {
            let mut axis = Axis { open: true, max: sign, min: 0.0, ..Axis::<f64>::default() };
            assert!(axis.crossing(&tight, &Now { interval: 10_000, turned: 1.0 }));
            assert_eq!(axis.u_off, 1e-4 * sign);
        }
    }
}
