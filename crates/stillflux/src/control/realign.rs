//! Way out of a false equilibrium: when the torque is at its limit and the field stands still, a smaller torque shows whether
//! it is the shaft that stands so, and if it is not, the flux is taken to lie along the current. Per unit.
//!
//! A shaft that stands while the torque is at its limit has `ω_s = ω_r`. Where the field stands still instead, either the
//! shaft turns backwards at the very speed of the slip, or the estimated angle is wrong by the angle of the current,
//!
//! ```text
//! δ̂ - δ = -arctan(i_q/i_d):    the flux lies along the current, T = 0
//! ```
//!
//! and nothing in it changes: the speed controller asks for all the torque there is, the slip of that torque makes up the
//! speed that it has not, and a dc current makes neither torque nor voltage. Under a load the angle is some degrees less, as
//! the torque needs it, the load drives the shaft and the field slowly backwards, and the field wanders to and fro.
//!
//! Half of the torque current tells the two apart. The shaft of the first keeps its speed or follows the load, against the
//! torque; its field turns by the slip that is missing. The field of the second follows the current for a rotor time constant
//! at most and then stands as before, so that the estimated speed moves by the slip that is missing, with the torque:
//!
//! ```text
//! suspected: torque at its limit, -1 < ω̂_s/ω̂_r < 1/2;     n += 1 suspected, n -= 1 not
//! n = 0 wherever the low-pass of ω̂ has moved by |ω̂_r|/8
//! n = N:          half of the torque limits for P
//! after that:     (Δω̂ - Δω̂_N P/N)/ω̂_r > 2/5:    ψ̂_R = |ψ̂_R| i/|i|,   ω̂ = ω̂_s
//! ```
//!
//! `Δω̂_N` is what `ω̂` has moved in the suspicion with the torque: a heavy shaft of a machine with a large `P` goes on to move so.
//!
//! The missing slip is as large as what is left of `ω̂_r`. Its part that counts as evidence leaves room for a rotor resistance
//! that is not that of the data, by which a shaft that keeps its speed seems to move by `ΔR_R/R_R` of it. Without the test a
//! drive is turned that is well and meets its load at the limit, or brakes a heavy shaft through this speed.
//!
//! The speed is then that of the field, since the flux along the current has no slip; the angle is as uncertain as after a loss.
//! Without torque instead, the current would lie along a wrong axis: its torque against the reference throws a small machine
//! back faster than the filter finds the field.
//!
//! Once within 10 N + P: what does not help is left to [`crate::supervision::stall`]. `N` is 0.12 s, an allowance: a third of the
//! default of `stall_time`. `P` is `N`, or half of the rotor time constant if that is longer.
//!
//! Validity: speed control. In the published scheme the suspicion is enough, `P` = 0: at half of the torque a light load throws
//! a small machine back with its field, and nothing is left to tell; a field that passes so slowly through the speed of the
//! slip in regeneration (the slow fan motor with ten times its inertia) is lost there with and without it.

use crate::scalar::{Real, likely};
use crate::space::AlphaBeta;
use crate::words::words;

/// Calls until the next time, in units of those of the suspicion.
const PAUSE: u32 = 10;
/// Bounds of the stator frequency of a field that stands, relative to `ω_r`, and the change that the speed may make.
const STANDS: (f64, f64) = (-1.0, 0.5);
const MOVED: f64 = 0.125;
/// Change of the speed, relative to what is left of `ω_r` at half of the torque, from which on the field does not follow the slip.
const STAYS: f64 = 0.4;
/// Least current that has a direction.
const CURRENT_MIN: f64 = 0.1;

/// Stator flux whose rotor flux, of this magnitude, lies along the current.
pub fn flux_along<R: Real>(i_s: &AlphaBeta<R>, psi_r: R, sigma_l_s: R) -> Option<AlphaBeta<R>> {
    let length = i_s.norm_sq().sqrt();
    (length > R::from_f64(CURRENT_MIN)).then(|| *i_s * (sigma_l_s + psi_r * length.recip()))
}

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct RealignConfig<R: Real> {
    /// Calls of the suspicion, `N`; `u32::MAX`: never.
    pub suspicion: u32,
    /// Calls of the test, `P`; 0: the suspicion is enough.
    pub test: u32,
    /// `P/N`, at most 50, which fits fixed point.
    pub relative_test: R,
    /// Coefficient of the low-pass of the speed, against the wandering of the field.
    pub low_pass: R,
}
words!(RealignConfig: suspicion, test, relative_test, low_pass);

/// State.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Realign<R: Real> {
    /// Suspicion; from its limit on the time since then.
    calls: u32,
    /// The flux was turned after the latest test.
    turned: bool,
    /// Speed when suspicion or test began.
    omega: R,
    /// Its low-pass.
    mean: R,
}

impl<R: Real> Default for Realign<R> {
    fn default() -> Self {
        Self { calls: 0, turned: false, omega: R::ZERO, mean: R::ZERO }
    }
}

impl<R: Real> Realign<R> {
    /// One call: whether the flux has to be turned to the current. `limited`: 1 if the torque is at its upper limit, -1 at
    /// its lower one, else 0. `omega_r`: `ω_s - ω` of the estimate.
    #[inline(always)]
    pub fn step(&mut self, c: &RealignConfig<R>, limited: R, omega_s: R, omega_r: R) -> bool {
        if likely(limited == R::ZERO && self.calls == 0) {
            return false;
        }
        self.advance(c, limited, omega_s, omega_r)
    }

    /// Whether half of the torque is the limit.
    #[inline(always)]
    pub fn is_testing(&self, c: &RealignConfig<R>) -> bool {
        !likely(self.calls < c.suspicion) && self.calls - c.suspicion < c.test
    }

    /// Whether the flux was turned less than `N` ago: what the filter makes of it is no evidence against the field yet.
    #[inline(always)]
    pub fn is_settling(&self, c: &RealignConfig<R>) -> bool {
        !likely(self.calls < c.suspicion) && self.turned && self.calls - c.suspicion - c.test < c.suspicion
    }

    /// A call without speed control, which shows nothing: a suspicion is dropped, the time since a turn goes on.
    #[inline(always)]
    pub fn without_reference(&mut self, c: &RealignConfig<R>) {
        if self.is_settling(c) {
            self.calls += 1;
        } else if self.calls != 0 {
            *self = Self::default();
        }
    }

    #[cold]
    #[inline(never)]
    fn advance(&mut self, c: &RealignConfig<R>, limited: R, omega_s: R, omega_r: R) -> bool {
        let omega = omega_s - omega_r;
        self.mean += (omega - self.mean) * c.low_pass;
        let moved = self.mean - self.omega;
        if self.calls >= c.suspicion {
            self.calls += 1;
            let since = self.calls - c.suspicion;
            if since == c.test {
                let with_torque = if omega_r < R::ZERO { -moved } else { moved };
                self.turned = with_torque > omega_r.abs() * R::from_f64(STAYS);
                return self.turned;
            }
            if since >= c.test + c.suspicion * (PAUSE - 1) {
                self.calls = 0;
            }
            return false;
        }
        if self.calls == 0 || !moved.within(omega_r.abs() * R::from_f64(MOVED)) {
            *self = Self { calls: 0, turned: false, mean: omega, omega };
        }
        let (centre, width) = (
            omega_r * R::from_f64((STANDS.0 + STANDS.1) / 2.0),
            omega_r.abs() * R::from_f64((STANDS.1 - STANDS.0) / 2.0),
        );
        if limited != R::ZERO && (omega_s - centre).within(width) {
            self.calls += 1;
        } else {
            self.calls = self.calls.saturating_sub(1);
        }
        if self.calls == c.suspicion {
            // What a heavy shaft goes on to move in the test is no evidence.
            let with_torque = (moved < R::ZERO) == (omega_r < R::ZERO);
            let goes_on = if with_torque { moved * c.relative_test } else { R::ZERO };
            (self.omega, self.turned) = (self.mean + goes_on, c.test == 0);
            return self.turned;
        }
        false
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use std::vec::Vec;

    use super::*;

    const N: u32 = 100;
    const C: RealignConfig<f64> = RealignConfig { suspicion: N, test: 150, relative_test: 1.5, low_pass: 1.0 / 32.0 };

    /// Calls of 2000 in which the flux is turned: torque at its limit, `ω_s`, `ω_r`, by the number of the call and the part
    /// of the torque that the drive may have.
    fn turned(x: impl Fn(f64, f64) -> (f64, f64, f64)) -> Vec<u32> {
        let mut realign = Realign::default();
        (0..2000)
            .filter(|&k| {
                let part = if realign.is_testing(&C) { 0.5 } else { 1.0 };
                let (limited, omega_s, omega_r) = x(f64::from(k), part);
                realign.step(&C, limited, omega_s, omega_r)
            })
            .collect()
    }

    #[test]
    fn a_field_that_stands_whatever_the_torque_is_turned_once_in_a_while() {
        for sign in [1.0, -1.0] {
            // The slip grows, and with it the speed that makes up for it; the field stands.
            let calls = turned(|k, part| {
                (sign, sign * (0.002 - 5e-5 * (k % 100.0)), sign * part * (0.08 + 1e-4 * (k % 100.0)))
            });
            assert_eq!(calls, [99 + 150, 99 + 150 + 900 + 100 + 150], "not sooner");
        }
    }

    #[test]
    fn a_field_that_wanders_to_and_fro_stands() {
        for sign in [1.0, -1.0] {
            let calls = turned(|k, part| (sign, sign * (-0.015 + 0.01 * (0.4 * k).sin()), sign * part * 0.05));
            assert!(!calls.is_empty() && calls[0] < 2 * N + 150, "{calls:?}");
        }
    }

    #[test]
    fn a_shaft_that_keeps_its_speed_or_follows_the_load_is_left_alone_whatever_its_rotor_resistance() {
        for sign in [1.0, -1.0] {
            for told in [0.7, 1.0, 1.4] {
                for fall in [0.0, 2e-5, 1e-4] {
                    // The speed of the slip, against the torque; ω_s = ω + ω_r.
                    let calls = turned(|k, part| {
                        let omega = -0.08 - if part < 1.0 { fall * (k % 250.0) } else { 0.0 };
                        (sign, sign * (omega + 0.08 * part), sign * told * 0.08 * part)
                    });
                    assert!(calls.is_empty(), "{told}, {fall}: {calls:?}");
                }
            }
        }
    }

    #[test]
    fn a_heavy_shaft_that_goes_on_to_move_with_the_torque_is_left_alone() {
        // As at 160 kW: the test takes five times as long as the suspicion.
        let c = RealignConfig { test: 5 * N, relative_test: 5.0, ..C };
        let turned = |sign: f64, relative_test: f64| {
            let (c, mut realign, mut omega) = (RealignConfig { relative_test, ..c }, Realign::default(), -0.084);
            (0..600).any(|_| {
                let part = if realign.is_testing(&c) { 0.5 } else { 1.0 };
                // By less than an eighth of the slip in a suspicion, through the speed of the slip.
                omega += 8e-5 * part;
                realign.step(&c, sign, sign * (omega + 0.08 * part), sign * 0.08 * part)
            })
        };
        for sign in [1.0, -1.0] {
            assert!(!turned(sign, c.relative_test));
            assert!(turned(sign, 0.0), "what it goes on to move taken for evidence");
        }
    }

    #[test]
    fn the_rotor_flux_is_turned_to_the_current_with_its_magnitude() {
        let i_s = AlphaBeta::new(-0.6, 0.8);
        let psi_r = flux_along(&i_s, 0.9, 0.1).unwrap() - i_s * 0.1;
        assert!(psi_r.cross(&i_s).abs() < 1e-12 && (psi_r.re() + 0.54_f64).abs() < 1e-12);
        assert_eq!(flux_along(&AlphaBeta::new(0.0, 0.05), 0.9, 0.1), None, "no direction");
    }

    #[test]
    fn a_shaft_that_is_blocked_or_moves_with_its_field_and_a_free_torque_are_none() {
        assert!(turned(|_, part| (1.0, 0.08 * part, 0.08 * part)).is_empty(), "blocked");
        for sign in [1.0, -1.0] {
            let moves = |rate: f64| turned(|k, part| (sign, sign * (0.02 - rate * (k - 1000.0)), sign * part * 0.08));
            assert!(moves(2e-4).is_empty() && moves(-2e-4).is_empty(), "braking through zero, falling with its load");
        }
        assert!(turned(|_, _| (0.0, 0.0, 0.08)).is_empty());
        let (mut realign, never) = (Realign::default(), RealignConfig { suspicion: u32::MAX, ..C });
        assert!((0..100_000).all(|_| !realign.step(&never, 1.0, 0.0, 0.08) && !realign.is_testing(&never)));
    }

    #[test]
    fn without_speed_control_the_time_after_a_turn_ends_and_a_suspicion_does() {
        let c = RealignConfig { test: 0, ..C };
        let mut realign = Realign::<f64>::default();
        assert!((0..5000).any(|_| realign.step(&c, 1.0, 0.0, 0.05)) && realign.is_settling(&c));
        let calls = (0..5000).position(|_| {
            realign.without_reference(&c);
            !realign.is_settling(&c)
        });
        assert_eq!(calls, Some(N as usize - 1));
        realign = Realign::default();
        for _ in 0..N + 10 {
            realign.step(&C, 1.0, 0.0, 0.08);
        }
        assert!(realign.is_testing(&C));
        realign.without_reference(&C);
        assert!(!realign.is_testing(&C) && realign == Realign::default());
    }
}
