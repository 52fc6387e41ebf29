//! Swing of speed and torque of a shaft that is far lighter than told: it shows the gain at which the speed control is stable. Per unit.
//!
//! With `J` told `k` times too large the loop of the speed has `k` times its bandwidth, and the lag of the estimated speed (two poles at
//! `ω_n`) makes it unstable from `k = 2ω_n/ω_c` on, 5.5 with the defaults, and with the lag of the current from about 4 on. Speed and
//! torque then swing at a frequency near `ω_n`, where the lags make up half a turn, with amplitudes `a` and `d` that something limits:
//! torque, voltage, the loop of the estimated speed. The gain from the one to the other is that of the limit of stability (relay
//! experiment of Åström and Hägglund, 1984; of a relay it is `4d/πa`),
//!
//! ```text
//! k_u = d/a
//! part of the inertia told, with a gain margin of 4:     k_u/4k_p
//! ```
//!
//! That is the margin that a controller has whose inertia is told right. Both gains fall with the part, by which bandwidth and damping are
//! those that were asked for.
//!
//! ```text
//! swing: the torque goes four times from half of its one limit to half of the other, not later than 2π/ω_n after the time before
//! d, a, r: half of what torque, deviation from the reference and reference go through in the last two of them;  a > 0.02, a > 2r
//! ```
//!
//! A shaft of the inertia told does not follow its torque so fast, and of a reference that goes to and fro a stable loop makes no deviation
//! of twice its amplitude. What is found counts until the next start.
//!
//! Validity: speed control. Between instability and a swing of the torque to half of its limits, and with a load beyond these, nothing is
//! found.

use core::f64::consts::TAU;

use crate::base::rounded;
use crate::scalar::{Real, likely};
use crate::words::words;

/// Margin of the gain of a controller whose inertia is told right.
const MARGIN: f64 = 4.0;
/// Changes of the torque's side from which the amplitudes count, and which show the swing.
const FROM: u32 = 2;
const SHOWN: u32 = 4;
/// Least amplitude of the speed, which the estimated one does not have by itself (that of [`crate::supervision::stall`]).
const LEAST: f64 = 0.02;
/// Bound of `1/(4 k_p)`, which fits fixed point.
const PER_GAIN_MOST: f64 = 64.0;
/// Least part.
const PART_LEAST: f64 = 1.0 / 32.0;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct SwingConfig<R: Real> {
    /// Calls between two changes at most; 0: nothing is looked for.
    pub calls: u32,
    /// `1/(4 k_p)`.
    pub per_gain: R,
}
words!(SwingConfig: calls, per_gain);

impl<R: Real> SwingConfig<R> {
    /// For a gain of the speed controller, a bandwidth of the estimated speed, and the time between two calls.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn new(k_p: f64, omega_n: f64, t_s: f64) -> Self {
        Self {
            calls: libm::ceil(TAU / (omega_n * t_s)).min(1e9) as u32,
            per_gain: rounded((1.0 / (MARGIN * k_p)).min(PER_GAIN_MOST)),
        }
    }
}

/// What a quantity goes through.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
struct Range<R: Real> {
    least: R,
    most: R,
}

impl<R: Real> Range<R> {
    fn of(x: R) -> Self {
        Self { least: x, most: x }
    }

    fn extend(&mut self, x: R) {
        *self = Self { least: self.least.min(x), most: self.most.max(x) };
    }

    fn amplitude(&self) -> R {
        (self.most - self.least).half()
    }
}

/// State.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Swing<R: Real> {
    /// Changes of the torque's side so far, that side (1 or -1), and the calls since the latest change.
    changes: u32,
    side: R,
    calls: u32,
    torque: Range<R>,
    deviation: Range<R>,
    reference: Range<R>,
    /// Part of the inertia told.
    part: R,
}

impl<R: Real> Default for Swing<R> {
    fn default() -> Self {
        let nothing = Range::default();
        Self {
            changes: 0,
            side: R::ONE,
            calls: 0,
            torque: nothing,
            deviation: nothing,
            reference: nothing,
            part: R::ONE,
        }
    }
}

impl<R: Real> Swing<R> {
    /// Part of the inertia told for which the gains of the speed controller are: 1 as long as nothing has swung.
    #[inline(always)]
    pub fn part(&self) -> R {
        self.part
    }

    /// One call, with the reference of the torque, the `room` between its two limits, and the `reference` and the speed.
    #[inline(always)]
    pub fn step(&mut self, c: &SwingConfig<R>, torque: R, room: R, reference: R, omega_m: R) {
        let changed = torque * self.side < -room.times(0.25);
        if !likely(!changed && self.changes == 0) {
            self.advance(c, changed, torque, reference, omega_m);
        }
    }

    #[cold]
    #[inline(never)]
    fn advance(&mut self, c: &SwingConfig<R>, changed: bool, torque: R, reference: R, omega_m: R) {
        let deviation = reference - omega_m;
        self.calls = self.calls.saturating_add(1);
        if self.calls > c.calls {
            self.changes = 0;
        }
        self.torque.extend(torque);
        self.deviation.extend(deviation);
        self.reference.extend(reference);
        if !changed {
            return;
        }
        (self.side, self.calls, self.changes) = (-self.side, 0, self.changes + 1);
        if self.changes == SHOWN {
            let amplitude = self.deviation.amplitude();
            if amplitude > R::from_f64(LEAST) && self.reference.amplitude() < amplitude.half() {
                let part = self.torque.amplitude() * c.per_gain * amplitude.recip();
                self.part = self.part.min(part.max(R::from_f64(PART_LEAST)));
            }
            self.changes = 0;
        }
        if self.changes <= FROM {
            (self.torque, self.deviation) = (Range::of(torque), Range::of(deviation));
            self.reference = Range::of(reference);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::speed::{SpeedControlConfig, SpeedController};

    const T_S: f64 = 1e-3;
    /// Bandwidth of the estimated speed in units of that of the speed control.
    const OMEGA_N: f64 = 25.0 / 9.0;
    const CONTROL: SpeedControlConfig<f64> = SpeedControlConfig {
        k_p: 1.0,
        k_i: T_S / 4.0,
        per_t: T_S / 4.0,
        weight: 0.3,
        lead: 1.0,
        inv_gain: 1.0,
        torque_max: 0.1,
        torque_pos: 0.1,
        torque_neg: 0.1,
    };

    /// Steps of the reference to 0.5 and of the load to `load`; how far the speed goes in the end, and the part of the gains. The shaft
    /// has `j` times the inertia told. `looked_for`: as by default.
    fn loaded(j: f64, load: f64, looked_for: bool) -> (f64, f64) {
        let c = SwingConfig::new(CONTROL.k_p, OMEGA_N, T_S);
        let c = if looked_for { c } else { SwingConfig { calls: 0, ..c } };
        let (mut control, mut swing) = (SpeedController::<f64>::default(), Swing::default());
        let (mut omega, mut omega_m, mut angle, mut torque) = (0.0_f64, 0.0, 0.0, 0.0);
        let (mut least, mut most) = (f64::MAX, f64::MIN);
        for k in 0..200_000 {
            swing.step(&c, torque, 0.2, 0.5, omega_m);
            torque = control.step(&CONTROL, 0.5, omega_m, (1.0, swing.part()), (-0.1, 0.1));
            angle += T_S * (omega - omega_m - 2.0 * OMEGA_N * angle);
            omega_m += T_S * OMEGA_N * OMEGA_N * angle;
            omega += T_S * (torque - if k > 100_000 { load } else { 0.0 }) / j;
            if k > 180_000 {
                (least, most) = (least.min(omega), most.max(omega));
            }
        }
        (most - least, swing.part())
    }

    #[test]
    fn a_shaft_far_lighter_than_told_swings_without_and_comes_to_rest_with_about_its_part_of_the_inertia() {
        for j in [1.0 / 8.0, 1.0 / 12.0, 1.0 / 20.0] {
            for load in [0.0, 0.05] {
                let (without, whole) = loaded(j, load, false);
                let (with, part) = loaded(j, load, true);
                assert!(without > 0.1 && whole == 1.0, "{j} {load}: {without}");
                assert!(with < 0.001, "{j} {load}: {with} with {part}");
                assert!(part > 0.5 * j && part < 2.5 * j, "{j} {load}: {part}");
            }
        }
    }

    #[test]
    fn a_shaft_that_does_not_swing_keeps_its_gains() {
        for j in [0.3, 0.5, 1.0, 2.0, 10.0] {
            let (most, part) = loaded(j, 0.05, true);
            assert!(most < 0.001 && part == 1.0, "{j}: {most}, {part}");
        }
    }

    /// Part after a torque that goes `changes` times from one limit to the other, every `half` calls, with an amplitude of the speed.
    fn to_and_fro(half: u32, (torque, speed): (f64, f64), room: f64, changes: u32) -> f64 {
        let c = SwingConfig { calls: 50, per_gain: 0.01 };
        let mut swing = Swing::default();
        for k in half / 2..half * changes + half {
            let x = libm::sin(core::f64::consts::PI * f64::from(k) / f64::from(half));
            // A ramp of the reference, and its deviation.
            let reference = 0.1 + 1e-4 * f64::from(k);
            swing.step(&c, torque * (x + 0.1), room, reference, reference - speed * x);
        }
        swing.part()
    }

    #[test]
    fn the_part_is_that_of_the_gain_at_the_limit_of_stability_with_a_margin_of_four() {
        for (torque, speed, room) in [(1.5, 0.2, 3.0), (1.5, 0.2, 5.0), (0.25, 0.05, 0.5), (2.0, 0.5, 4.0)] {
            let (part, expected) = (to_and_fro(40, (torque, speed), room, 6), torque * 0.01 / speed);
            assert!((part / expected - 1.0).abs() < 0.02, "{torque} {speed} {room}: {part}, {expected}");
        }
    }

    #[test]
    fn slow_small_and_few_changes_are_no_swing() {
        let (swing, room) = ((1.5, 0.2), 3.0);
        assert!(to_and_fro(40, swing, room, 5) < 1.0, "the control");
        assert_eq!(to_and_fro(60, swing, room, 40), 1.0, "a reference that steps to and fro");
        assert_eq!(to_and_fro(40, (1.5, 0.019), room, 40), 1.0, "noise, of a small torque");
        assert_eq!(to_and_fro(40, swing, 7.0, 40), 1.0, "far from the limits");
        assert_eq!(to_and_fro(40, swing, room, 3), 1.0, "a step of the reference with its overshoot");
    }

    #[test]
    fn a_reference_that_goes_to_and_fro_is_no_swing() {
        for (amplitude, reduced) in [(0.2, false), (0.101, false), (0.099, true), (0.0, true)] {
            let c = SwingConfig { calls: 50, per_gain: 0.01 };
            let mut swing = Swing::default();
            for k in 0..1000 {
                let x = libm::sin(core::f64::consts::PI * f64::from(k) / 40.0);
                swing.step(&c, 1.5 * x, 3.0, amplitude * x, amplitude * x - 0.2 * x);
            }
            assert_eq!(swing.part() < 1.0, reduced, "{amplitude}");
        }
    }

    #[test]
    fn something_is_left_whatever_the_swing() {
        assert_eq!(to_and_fro(40, (0.2, 3.0), 0.1, 100), PART_LEAST);
    }
}
