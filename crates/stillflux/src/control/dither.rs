//! Dither: an oscillation of the torque current near zero stator frequency, by which the error of the bridge near the zero of a
//! phase current counts by its mean. Per unit.
//!
//! A leg loses the less voltage the smaller its current is, and near zero its loss has a steep slope. What the inverter model
//! leaves of it, `Δu(i)`, has one as well, `Δu'`. The current of the drive follows the estimated flux: of a current `i_d` at the zero of a
//! phase, turned by `δ`, that phase carries `i_d δ`, and the error turns the estimate on or back,
//!
//! ```text
//! dδ/dt = -ω_b Δu'(0) i_d δ/ψ
//! ```
//!
//! A positive slope holds the field at the zero, whatever the shaft does: at 48 V (`i_d` = 29 A, a knee of 0.14 A) a loss that is
//! 0.07 V off, a tenth, holds it against a shaft that drags its flux by 14° in a second, 0.04° from the zero. Field and current
//! then stand, a light load drags the rotor flux out of the current (`control::sides`), and no voltage shows it. A negative one
//! pushes the field over the zero.
//!
//! With an oscillation of amplitude `a` in the phase current the mean of the error counts. A triangle dwells everywhere alike,
//!
//! ```text
//! mean Δu(i) = 1/(2a) ∫ Δu(i + x) dx from -a to a,    its slope (Δu(a) - Δu(-a))/(2a)
//! ```
//!
//! and with an amplitude beyond the knee the slope is the error out there over `a`: of the same 0.07 V over `a` = 5.8 A 1.7°. The
//! knee shows in the voltage then, too, while a current at its zero shows nothing of it.
//!
//! The torque oscillates with 40 Hz, which turns the shaft little, and current control follows it. The amplitude rises in the first second
//! near zero stator frequency, so that a drive that only passes has none, and it fades towards a stator frequency and a torque. Both are
//! there by measurement, not by derivation. At full amplitude at once, the preset of 11 kW with a large leakage, whose sensors' offset steps
//! at the beginning of a ramp, was lost in 23 of 546 runs, in 10 without dither. At any load, a drive of 160 kW with rotor resistance and leakage a
//! quarter above the parameters was lost in 15 of 40 realisations, in 4 without dither. It is left out while a side of the current is
//! tried.
//!
//! Validity: the enhanced scheme. The published one takes the torque for a sign of its resistance (Fig. 13b).

use crate::scalar::{Real, likely};
use crate::words::words;

/// Stator frequency from which on there is no dither, per unit. Beyond it the zeros pass within a tenth of a second. Allowance.
const BELOW: f64 = 0.012;
/// Torque from which on there is none, in parts of rated torque. Allowance.
pub const TORQUE: f64 = 0.4;
/// Period of the oscillation, s: many of current control, and short for the shaft and for the speed control that answers to it. With
/// 20 Hz the speed oscillates by 2.6 times as much, with 80 Hz the error of the angle at light load is larger.
pub const PERIOD: f64 = 0.025;
/// Time in which it rises, s. Allowance: a load that drags the field off takes longer.
const RISE: f64 = 1.0;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct DitherConfig<R: Real> {
    /// Amplitude of the torque; 0: none.
    pub amplitude: R,
    /// Calls of one period, over four, as a reciprocal.
    pub step: R,
    /// Reciprocal of the torque from which on there is none.
    pub inv_torque: R,
}
words!(DitherConfig: amplitude, step, inv_torque);

/// State.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Dither<R: Real> {
    /// Quarters of a period since the triangle was at its lower end, less two.
    position: R,
    /// Part of the amplitude that it has risen to.
    rise: R,
}

impl<R: Real> Dither<R> {
    /// One call: what is added to a torque reference.
    #[inline(always)]
    pub fn step(&mut self, c: &DitherConfig<R>, omega_s: R, torque: R) -> Option<R> {
        if likely(!omega_s.within(R::from_f64(BELOW))) || c.amplitude == R::ZERO {
            self.rise = R::ZERO;
            return None;
        }
        Some(self.advance(c, omega_s, torque))
    }

    #[inline(never)]
    fn advance(&mut self, c: &DitherConfig<R>, omega_s: R, torque: R) -> R {
        self.position += c.step;
        if self.position > R::TWO {
            self.position -= R::TWO + R::TWO;
        }
        self.rise = (self.rise + c.step * R::from_f64(PERIOD / (4.0 * RISE))).min(R::ONE);
        let fade = (omega_s * R::from_f64(1.0 / BELOW)).abs().max((torque * c.inv_torque).abs());
        (R::ONE - self.position.abs()) * c.amplitude * (R::ONE - fade).max(R::ZERO) * self.rise
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use std::vec::Vec;

    use super::*;

    const C: DitherConfig<f64> = DitherConfig { amplitude: 0.2, step: 0.08, inv_torque: 4.0 };

    /// Calls of the rise.
    const RISING: u32 = 2000;

    /// From where it has risen on.
    fn run(omega_s: f64, torque: f64, calls: u32) -> Vec<f64> {
        let mut dither = Dither::default();
        (0..RISING + calls).map(|_| dither.step(&C, omega_s, torque).unwrap()).skip(RISING as usize).collect()
    }

    fn most(x: &[f64]) -> f64 {
        x.iter().fold(0.0, |most, x| x.abs().max(most))
    }

    #[test]
    fn the_mean_of_an_error_with_a_steep_zero_has_the_slope_of_its_ends_over_the_amplitude() {
        // An error of the voltage that is proportional up to a knee and constant beyond it.
        let error = |i: f64| (i / 0.01).clamp(-1.0, 1.0);
        let x = run(0.0, 0.0, 500);
        let mean = |i: f64| x.iter().map(|x| error(i + x)).sum::<f64>() / x.len() as f64;
        let slope = (mean(0.005) - mean(-0.005)) / 0.01;
        assert!((slope * C.amplitude - 1.0).abs() < 0.2, "{slope}");
        assert!((error(0.005) - error(-0.005)) / 0.01 > 15.0 * slope);
    }

    #[test]
    fn the_triangle_has_its_amplitude_and_no_mean_and_fades_with_stator_frequency_and_torque() {
        for (omega_s, torque, part) in
            [(0.0, 0.0, 1.0), (0.006, 0.0, 0.5), (-0.009, 0.1, 0.25), (0.003, -0.125, 0.5), (0.0, 0.3, 0.0)]
        {
            let x = run(omega_s, torque, 500);
            assert!((most(&x) - 0.2 * part).abs() < 0.01, "{}", most(&x));
            assert!(x.iter().sum::<f64>().abs() < 0.2, "{x:?}");
            assert!(x.windows(2).all(|x| (x[1] - x[0]).abs() < 0.017 * part + 1e-12), "no step");
        }
    }

    #[test]
    fn it_rises_in_a_second_and_again_after_a_passage() {
        let mut dither = Dither::default();
        for _ in 0..2 {
            // A period has 50 calls.
            let mut amplitude = || most(&(0..50).map(|_| dither.step(&C, 0.0, 0.0).unwrap()).collect::<Vec<_>>());
            let rising: Vec<f64> = (0..45).map(|_| amplitude()).collect();
            for (k, a) in rising.iter().enumerate() {
                let part = ((k as f64 + 0.5) / 40.0).min(1.0);
                assert!((a - 0.2 * part).abs() < 0.01, "{k}: {a}");
            }
            assert!(dither.step(&C, 0.013, 0.0).is_none());
        }
    }

    #[test]
    fn without_an_amplitude_there_is_none() {
        assert!(Dither::default().step(&DitherConfig { amplitude: 0.0, ..C }, 0.0, 0.0).is_none());
    }
}
