//! Flux shift: leaves the line `ω_s = 0` under load by a reduced flux. Per unit.
//!
//! At `ω_s = 0` one direction of the flux error is unobservable, whatever the estimator (see
//! [`crate::estimate::kalman`]). Speed and load are given by the application; the slip `ω_r = r_R T/|ψ_R|²` grows as
//! the flux is reduced. With `s` the sign of the torque, `κ = ψ_s*/ψ_s,rated` and
//! the slip `ω_r0` at rated flux,
//!
//! ```text
//! s ω_s = s ω + ω_r0/κ² = a    ⇒    κ² = ω_r0/(a - s ω),      -a < s ω + ω_r0 < a
//! ```
//!
//! so a drive that would stand on the line, or cross it slowly, has `s ω_s = a` instead. The torque current rises by
//! `1/κ`, and the torque deviates while the flux changes.
//!
//! `κ` is at least 0.7 (twice the slip), at least what the torque takes of the current limit, and at least what keeps the
//! distance to pull-out; with the largest of these, `κ_min`, the drive comes to
//!
//! ```text
//! s ω_s = b,   b = min(a, s ω + ω_r0/κ_min²)
//! ```
//!
//! Where `s ω + ω_r0` falls below `-b` the field turns faster on the other side of the line: the flux returns to rated, and
//! `s ω_s` jumps over the line; in the other direction at `-b/2` (hysteresis). With `a` in place of `b` a machine with
//! little slip goes over the line at part load to turn its field more slowly there, and is lost.
//!
//! A load that passes is left alone: from 0.05 to 0.15 of rated torque the effect comes with the torque *or with its low-pass
//! of 2 s*, whichever is less. A load that comes to a machine at rest goes through `-a < s ω + ω_r0 < a` within a second. While
//! the flux changes the current model says least of it, and the currents change for which resistance and bridge are known: a
//! small error of the sensors, which a constant flux survives, was enough to lose it. A second or two on the line are no
//! danger: without the shift the angle is 15° off after 6 s at the earliest (docs/beyond.md, `persistence-rated`).
//!
//! **Back to rated flux.** The equation has a gain of
//!
//! ```text
//! dκ²/d(s ω) = κ⁴/ω_r0
//! ```
//!
//! 85 at `κ²` = 0.65 and a slip of 0.005, where a speed off by 0.002 asks for 0.17 of `κ²`. Speed and torque are estimates
//! that answer to a flux that changes: near the line the voltage tells a change of the flux with an error of
//! `Δr_s i_s/ω` within a time of `1/ω`. Where the flux always follows at the full rate it hunts at machines with little slip: it swings by
//! 0.2 to 0.3, more in every cycle of 1 to 1.5 s, until the torque exceeds pull-out. While `s ω_s` is kept positive it therefore
//! rises at the full rate by 0.1 only, which is available anew after 13 s, and beyond that at an eighth of the rate at which it falls: it
//! stays near the least value of a cycle. 0.1 lies below a swing, and above the 0.08 by which the flux has to be back within
//! 0.2 s after a resistance that steps by 25 % (`mismatch` in docs/beyond.md). The full rate is not
//! limited where the torque needs the flux (`κ < κ_min`), where the field turns to the other side, and from `s ω + ω_r0` = 1.5 `a` on.
//!
//! **Validity.** Needs slip: no effect below 0.05 of rated torque, full effect from 0.15. Where `b < a`, `|ω_s|` is smaller
//! than `a`. The equation neglects the change of `|ψ_R|/|ψ_s|` with load.

use crate::scalar::{Real, clamp_seldom, likely};
use crate::words::words;

/// Smallest flux, of rated: doubles the slip.
pub const FACTOR_MIN: f64 = 0.7;

/// By what the flux rises at the full rate while the shift lasts.
const QUICK_RISE: f64 = 0.1;
/// Rate at which that becomes available anew, and rate at which the flux rises beyond it, relative to the full one.
const RENEWAL_RATE: f64 = 1.0 / 64.0;
const SLOW_RATE: f64 = 0.125;

/// Settings of the flux shift.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct ShiftConfig<R: Real> {
    /// Stator frequency `a` to keep; 0: no shift.
    pub omega_s_min: R,
    /// Slip per torque at rated flux.
    pub slip: R,
    /// Reciprocal of twice the torque `T_0` below which the shift has no effect; full effect from `3 T_0`.
    pub inv_torque_fade: R,
    /// Reciprocal of the torque that needs rated flux at the current limit.
    pub inv_torque: R,
    /// Reciprocal of the largest torque at rated flux for the distance to pull-out, which falls as `κ²`.
    pub inv_pull_out: R,
    /// Largest change of the factor from call to call.
    pub step: R,
    /// Corner of the low-pass of the torque, per call.
    pub corner: R,
}
words!(ShiftConfig: omega_s_min, slip, inv_torque_fade, inv_torque, inv_pull_out, step, corner);

/// State of the flux shift.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct FluxShift<R: Real> {
    /// `κ`.
    factor: R,
    /// `s ω_s` is kept positive; until `s ω + ω_r0` falls below `-b`.
    ahead: bool,
    /// Low-pass of the torque's magnitude.
    lasting: R,
    /// By what the flux may still rise at the full rate.
    quick_rise: R,
}

impl<R: Real> Default for FluxShift<R> {
    fn default() -> Self {
        Self { factor: R::ONE, ahead: false, lasting: R::ZERO, quick_rise: R::from_f64(QUICK_RISE) }
    }
}

impl<R: Real> FluxShift<R> {
    /// `κ` of the last call.
    #[inline(always)]
    pub fn factor(&self) -> R {
        self.factor
    }

    /// One call at a speed, a torque reference, and leakage inductance and rotor resistance relative to the parameters;
    /// returns `κ`, the flux reference in units of the rated one.
    #[inline(never)]
    pub fn step(&mut self, c: &ShiftConfig<R>, omega_m: R, torque: R, [leakage, rotor]: [R; 2]) -> R {
        let a = c.omega_s_min;
        let load = torque.abs();
        self.lasting += (load - self.lasting) * c.corner;
        let slip = c.slip * load * rotor;
        let omega = if torque < R::ZERO { -omega_m } else { omega_m };
        let omega_s = omega + slip;

        let mut wanted = R::ONE;
        // κ_min².
        let mut least = R::ZERO;
        if omega_s.abs() < a {
            let weight = clamp_seldom(load.min(self.lasting) * c.inv_torque_fade - R::HALF, R::ZERO, R::ONE);
            let of_current = load * c.inv_torque;
            least = (R::ONE - weight.times(1.0 - FACTOR_MIN * FACTOR_MIN))
                .max(load * (c.inv_pull_out * leakage))
                .max(of_current * of_current)
                .min(R::ONE);
            let behind = if self.ahead { -omega_s } else { -(omega_s + omega_s) };
            self.ahead = behind < a && behind * least < omega * least + slip;
            // The divisor lies between ω_r0 and ω_r0 + 2a, and the quotient is needed where it exceeds `least`.
            if self.ahead {
                let divisor = a - omega;
                let square = if likely(slip > divisor * least) { slip * divisor.recip() } else { least };
                wanted = square.min(R::ONE).sqrt();
            }
        } else {
            self.ahead = omega_s > R::ZERO;
        }
        let lasts = self.ahead && omega_s < a + a.half() && self.factor * self.factor >= least;
        let rise = if lasts { self.quick_rise.clamp(c.step.times(SLOW_RATE), c.step) } else { c.step };
        let change = (wanted - self.factor).clamp(-c.step, rise);
        self.factor += change;
        let quick_rise = self.quick_rise + c.step.times(RENEWAL_RATE) - change.max(R::ZERO);
        self.quick_rise = quick_rise.clamp(R::ZERO, R::from_f64(QUICK_RISE));
        self.factor
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: f64 = 0.01;
    const SLIP: f64 = 0.016;
    const CONFIG: ShiftConfig<f64> = ShiftConfig {
        omega_s_min: A,
        slip: SLIP,
        inv_torque_fade: 5.0,
        inv_torque: 0.6,
        inv_pull_out: 0.4,
        step: 1e-3,
        corner: 0.01,
    };

    /// Factor and stator frequency once they stand.
    fn settled(shift: &mut FluxShift<f64>, omega_m: f64, torque: f64) -> (f64, f64) {
        for _ in 0..1000 {
            shift.step(&CONFIG, omega_m, torque, [1.0; 2]);
        }
        let factor = shift.step(&CONFIG, omega_m, torque, [1.0; 2]);
        (factor, omega_m + SLIP * torque / (factor * factor))
    }

    #[test]
    fn a_loaded_drive_on_the_line_turns_its_field_in_the_direction_of_its_torque() {
        for torque in [1.0, -1.0] {
            let (factor, omega_s) = settled(&mut FluxShift::default(), -SLIP * torque, torque);
            assert!((omega_s - A * torque).abs() < 1e-9 && factor < 0.8, "{omega_s} at {factor}");
        }
    }

    #[test]
    fn away_from_the_line_and_without_load_the_flux_is_rated() {
        for (omega_m, torque) in [(0.0, 1.0), (-0.05, 1.0), (0.05, -1.0), (0.0, 0.0), (0.004, 0.05)] {
            assert_eq!(settled(&mut FluxShift::default(), omega_m, torque).0, 1.0);
        }
    }

    #[test]
    fn a_slow_crossing_never_rests_between_the_two_sides() {
        let mut shift = FluxShift::default();
        for (from, to) in [(0.03, -0.06), (-0.06, 0.03)] {
            for k in 0..=90 {
                let omega_m = from + (to - from) * f64::from(k) / 90.0;
                let (_, omega_s) = settled(&mut shift, omega_m, 1.0);
                assert!(!(-0.5 * A..0.6 * A).contains(&omega_s), "{omega_s} at {omega_m}");
            }
        }
    }

    /// Least factor while a load comes to a machine at rest, within `calls`.
    fn least_while_a_load_comes(c: &ShiftConfig<f64>, calls: u32) -> f64 {
        let mut shift = FluxShift::default();
        (0..=calls).map(|k| shift.step(c, 0.0, f64::from(k) / f64::from(calls), [1.0; 2])).fold(1.0, f64::min)
    }

    #[test]
    fn a_load_that_comes_at_once_leaves_the_flux_alone() {
        // ω_s passes the range of A at 0.6 of the torque. The low-pass takes 2 s of calls of 20 ms here.
        assert!(least_while_a_load_comes(&CONFIG, 50) > 0.99);
        assert!(least_while_a_load_comes(&CONFIG, 4000) < 0.75, "a load that comes slowly");
        let at_once = ShiftConfig { corner: 1.0, step: 0.01, ..CONFIG };
        assert!(least_while_a_load_comes(&at_once, 50) < 0.9, "without the low-pass");
    }

    /// Least and largest factor while the speed swings by an amplitude within 75 calls, once that has gone on; `follows`: as if
    /// the flux had not risen before.
    fn swing(amplitude: f64, follows: bool) -> (f64, f64) {
        let little = ShiftConfig { slip: 0.65 * A, step: 0.01, ..CONFIG };
        let mut shift = FluxShift::default();
        let factors = (0..2000).map(|k| {
            let omega_m = amplitude * (std::f64::consts::TAU * f64::from(k) / 75.0).sin();
            if follows {
                shift.quick_rise = QUICK_RISE;
            }
            shift.step(&little, omega_m, 1.0, [1.0; 2])
        });
        factors.skip(1000).fold((1.0, 0.0), |(least, most), x| (f64::min(least, x), f64::max(most, x)))
    }

    #[test]
    fn a_flux_that_is_shifted_does_not_follow_a_speed_that_swings() {
        let (least, most) = swing(0.3 * A, false);
        assert!(most - least < 0.08 && least < 0.72, "{least} to {most}");
        let (least, most) = swing(0.3 * A, true);
        assert!(most - least > 0.2, "{least} to {most}, at the full rate in both directions");
        let (least, most) = swing(0.0, false);
        assert!(most - least < 1e-6 && (least - 0.65f64.sqrt()).abs() < 1e-6, "{least} to {most}");
    }

    /// Calls until the flux is rated at a speed and a torque, after it was lowered on the line and `rises` times brought back
    /// before, and the calls that takes at the full rate.
    fn back(omega_m: f64, torque: f64, rises: u32) -> (f64, f64) {
        let mut shift = FluxShift::default();
        let (least, _) = settled(&mut shift, -SLIP, 1.0);
        for _ in 0..rises {
            settled(&mut shift, -SLIP + 1.6 * A, 1.0);
            for _ in 0..300 {
                shift.step(&CONFIG, -SLIP, 1.0, [1.0; 2]);
            }
        }
        let calls = (1..).find(|_| shift.step(&CONFIG, omega_m, torque, [1.0; 2]) >= 1.0).unwrap_or(0);
        (f64::from(calls), (1.0 - least) / CONFIG.step)
    }

    #[test]
    fn the_flux_is_back_at_once_where_the_shift_ends() {
        for (omega_m, torque) in [(-SLIP + 1.6 * A, 1.0), (-SLIP - 1.6 * A, 1.0), (0.0, 0.0), (-2.0 * SLIP, 2.0)] {
            for rises in [0, 3] {
                let (calls, quick) = back(omega_m, torque, rises);
                assert!((calls - quick).abs() < 2.0, "{calls}, {quick} at {omega_m}, {torque}");
            }
        }
    }

    #[test]
    fn while_the_shift_lasts_the_flux_rises_at_once_by_a_tenth_and_slowly_beyond() {
        let (calls, quick) = back(-SLIP + 1.2 * A, 1.0, 0);
        let tenth = QUICK_RISE / CONFIG.step;
        let slowly = tenth + (quick - tenth - tenth * RENEWAL_RATE) / SLOW_RATE;
        assert!(quick > 2.0 * tenth && (calls - slowly).abs() < 0.05 * slowly, "{calls}, {slowly}");
        let (calls, quick) = back(-SLIP + 1.2 * A, 1.0, 3);
        assert!(calls > 7.0 * quick, "{calls}, {quick}: the tenth is spent");
    }

    #[test]
    fn nothing_to_keep_leaves_the_flux_alone() {
        let off = ShiftConfig { omega_s_min: 0.0, ..CONFIG };
        let mut shift = FluxShift::default();
        for k in -50..50 {
            assert_eq!(shift.step(&off, f64::from(k) * 1e-3, 1.0, [1.0; 2]), 1.0);
        }
    }

    #[test]
    fn a_torque_that_needs_the_flux_gets_it() {
        let (factor, _) = settled(&mut FluxShift::default(), -SLIP * 1.6, 1.6);
        assert!((factor - 0.6 * 1.6).abs() < 1e-12);
    }

    #[test]
    fn between_the_two_sides_a_drive_stays_on_the_one_it_comes_from() {
        // ω_s at rated flux of -0.7 a: shifted if it was ahead before, left alone if it was not.
        let (mut ahead, mut behind) = (FluxShift::default(), FluxShift::default());
        settled(&mut ahead, -SLIP, 1.0);
        settled(&mut behind, -SLIP - 3.0 * A, 1.0);
        assert!(settled(&mut ahead, -SLIP - 0.7 * A, 1.0).1 > 0.5 * A);
        assert_eq!(settled(&mut behind, -SLIP - 0.7 * A, 1.0).0, 1.0);
        // Each once on the other side, away from the line.
        settled(&mut ahead, -SLIP - 3.0 * A, 1.0);
        settled(&mut behind, -SLIP + 3.0 * A, 1.0);
        assert_eq!(settled(&mut ahead, -SLIP - 0.7 * A, 1.0).0, 1.0);
        assert!(settled(&mut behind, -SLIP - 0.7 * A, 1.0).1 > 0.5 * A);
    }

    #[test]
    fn the_slip_is_that_of_the_rotor_at_its_temperature() {
        for rotor in [0.8, 1.3] {
            let mut shift = FluxShift::default();
            let omega_m = -SLIP * rotor;
            for _ in 0..1000 {
                shift.step(&CONFIG, omega_m, 1.0, [1.0, rotor]);
            }
            let omega_s = omega_m + SLIP * rotor / (shift.factor() * shift.factor());
            assert!((omega_s - A).abs() < 1e-9, "{omega_s} at {rotor}");
        }
    }

    #[test]
    fn a_field_that_turns_faster_at_rated_flux_is_left_there() {
        // Twice the slip of this load does not reach as far beyond the line as the drive stands before it.
        let mut shift = FluxShift::default();
        let omega_m = -SLIP * 0.3 - 0.3 * A;
        assert_eq!(settled(&mut shift, omega_m, 0.3), (1.0, omega_m + SLIP * 0.3));
        settled(&mut shift, -SLIP * 0.3, 0.3);
        assert!(shift.factor() < 0.8, "from the line itself it goes");
        assert_eq!(settled(&mut shift, omega_m, 0.3).0, 1.0, "and comes back");
    }

    #[test]
    fn the_flux_never_falls_below_what_doubles_the_slip_and_moves_in_small_steps() {
        let wide = ShiftConfig { omega_s_min: 10.0 * A, ..CONFIG };
        let mut shift = FluxShift::default();
        let mut last = 1.0;
        for _ in 0..1000 {
            let factor = shift.step(&wide, -SLIP, 1.0, [1.0; 2]);
            assert!(last - factor < CONFIG.step + 1e-12);
            last = factor;
        }
        assert!((last - 0.7).abs() < 1e-9, "{last}");
    }

    #[test]
    fn the_flux_keeps_its_distance_to_pull_out() {
        let near = ShiftConfig { inv_pull_out: 0.8, ..CONFIG };
        for leakage in [1.0, 1.1] {
            let mut shift = FluxShift::default();
            for _ in 0..1000 {
                shift.step(&near, -SLIP, 1.0, [leakage, 1.0]);
            }
            let factor = shift.step(&near, -SLIP, 1.0, [leakage, 1.0]);
            assert!((factor - (0.8 * leakage).sqrt()).abs() < 1e-9, "{factor}");
        }
    }
}
