//! Gains of the current sensors against each other, from the sum of the three phase currents.
//!
//! The currents of a machine with isolated star point add up to nothing. What three sensors with gains
//! `1 + g_k` make of them adds up to
//!
//! ```text
//! s = Σ g_k i_k + s_0 = x·i_s + s_0,     x = (g_a - (g_b + g_c)/2, √3/2 (g_b - g_c))
//! ```
//!
//! so a least-mean-squares fit of `s` to `i_s` finds the differences of the gains, with no model of the machine
//! in it. With gains that are right on average, unequal ones add to the space vector the image
//!
//! ```text
//! Δi_s = (x_α - j x_β)/3 · i_s*
//! ```
//!
//! which is taken off. The state is `x/3`. Gains change with temperature: the image is removed in every period, the fit
//! takes a sample in every eighth one. At low stator frequency that image is what an offset is elsewhere: it moves with the
//! field, too slowly to be told from it.
//!
//! **What the fit leaves.** An error of the sum that the fit has not explained yet is new: the step of an offset, as a sensor
//! has that an overload has magnetised, or a gain that the present current shows for the first time. Either is an error of
//! the measured space vector of about that size, of unknown direction. Low-passed, it is [`Balance::rest`], from which the
//! filter learns that it does not know its offset any more. `s_0` follows within some seconds. A step of several offsets
//! that leaves the sum as it was is not seen. A start-up fits in every period, so that its current has shown the gains when
//! it ends.
//!
//! With two sensors and a computed third the sum is zero and nothing is fitted: `pair` has what replaces it.

use crate::scalar::{QuickIntegrator, Real, likely};
use crate::space::AlphaBeta;
use crate::words::words;

/// Settings of the fit.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct BalanceConfig<R: Real> {
    /// Step size of `x/3`; 0: off.
    pub step: R,
    /// Step size of the constant `s_0`, an offset, which moves slowly.
    pub step_offset: R,
}
words!(BalanceConfig: step, step_offset);

impl<R: Real> BalanceConfig<R> {
    /// Coefficient of the low-pass of what the fit leaves of the sum.
    #[inline(always)]
    fn step_rest(&self) -> R {
        self.step_offset * R::from_f64(REST)
    }
}

/// Rate of the low-pass of what the fit leaves, relative to that of the constant `s_0`: 25 ms, fast against the half second
/// after which the filter has taken the step of an offset for something else.
const REST: f64 = 120.0;
/// Largest `x/3` that is believed: differences of the gains of 20 %.
const IMAGE_MAX: f64 = 0.2 / 3.0;
/// Largest constant that is believed, and largest part of a sum that a single sample may show.
const OFFSET_MAX: f64 = 0.2;
const ERROR_MAX: f64 = 0.1;
/// Largest rest that is noise: three standard deviations of what the low-pass leaves at 10 kHz of channels with 0.4 % of
/// rated rms current.
const REST_MIN: f64 = 2e-3;

/// State of the fit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Balance<R: Real> {
    /// `x/3`.
    image: [QuickIntegrator<R>; 2],
    offset: QuickIntegrator<R>,
    /// Low-pass of what the fit leaves of the sum.
    rest: R,
}

impl<R: Real> Balance<R> {
    /// The space vector `i` as measured without the image of the unequal gains.
    #[inline(always)]
    pub fn remove(&self, i: &AlphaBeta<R>) -> AlphaBeta<R> {
        let x = [self.image[0].value(), self.image[1].value()];
        let i = [i.re(), i.im()];
        AlphaBeta::new(i[0] - R::cross(x, [i[1], i[0]]), i[1] + R::dot(x, [i[1], i[0]]))
    }

    /// What is taken off, `x/3`.
    pub fn image(&self) -> AlphaBeta<R> {
        AlphaBeta::new(self.image[0].value(), self.image[1].value())
    }

    /// The offsets of the channels have been read anew.
    #[cold]
    pub fn forget_offset(&mut self) {
        (self.offset, self.rest) = (QuickIntegrator::default(), R::ZERO);
    }

    /// What the fit leaves of the sum, low-passed, where it is more than noise, per unit.
    #[inline(always)]
    pub fn rest(&self) -> Option<R> {
        (!likely(self.rest.within(R::from_f64(REST_MIN)))).then_some(self.rest)
    }

    /// The fit, by one sample: space vector `i` and `sum` of the phase currents as measured.
    #[inline(never)]
    pub fn fit(&mut self, c: &BalanceConfig<R>, i: &AlphaBeta<R>, sum: R) {
        let (a, b) = (self.image[0].value(), self.image[1].value());
        let fitted = R::dot([a, b], [i.re(), i.im()]);
        let error = (sum - (fitted + fitted + fitted) - self.offset.value()).limit(R::from_f64(ERROR_MAX));
        let step = c.step * error;
        self.image[0].add_limited(step, i.re(), R::from_f64(IMAGE_MAX));
        self.image[1].add_limited(step, i.im(), R::from_f64(IMAGE_MAX));
        self.offset.add_limited(c.step_offset, error, R::from_f64(OFFSET_MAX));
        self.rest += c.step_rest() * (error - self.rest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn unequal_gains_are_found_and_their_image_is_removed() {
        let c = BalanceConfig { step: 1.7e-3 / 3.0, step_offset: 3.4e-5 };
        let mut balance = Balance::<f64>::default();
        let gains = [1.02, 0.99, 0.99];
        let mut worst = 0.0_f64;
        for k in 0..120_000 {
            let (s, cos) = (f64::from(k) * 1e-3).sin_cos();
            let i = AlphaBeta::new(0.7 * cos, 0.7 * s);
            let phases = i.to_phases();
            let measured = [0, 1, 2].map(|k| phases[k] * gains[k] + 0.001);
            let out = balance.remove(&AlphaBeta::from_phases(measured));
            balance.fit(&c, &AlphaBeta::from_phases(measured), measured.iter().sum());
            // The constant takes longest.
            if k > 60_000 {
                worst = worst.max((out - i).norm_sq().sqrt());
            }
        }
        assert!(worst < 7e-4, "less than a tenth of the image of 0.007 is left: {worst}");
    }

    /// Ten seconds of turning current by channels with these gains, with an offset from 5 s on: times at which the rest is more
    /// than noise, and the largest.
    fn rests(gains: [f64; 3], offset: [f64; 3]) -> (Vec<f64>, f64) {
        let c = BalanceConfig { step: 1.7e-3 / 3.0, step_offset: 2.7e-4 };
        let mut balance = Balance::<f64>::default();
        let (mut times, mut largest) = (Vec::new(), 0.0_f64);
        let mut seed = 1_u32;
        let mut noise = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            // Uniform, with the standard deviation of 0.4 % of rated rms current.
            (f64::from(seed >> 8) / f64::from(1_u32 << 24) - 0.5) * 12_f64.sqrt() * 2.8e-3
        };
        for k in 0..12_500 {
            let t = f64::from(k) * 8e-4;
            let (s, cos) = (6.0 * t).sin_cos();
            let phases = AlphaBeta::new(0.7 * cos, 0.7 * s).to_phases();
            let there = if t < 5.0 { 0.0 } else { 1.0 };
            let measured = [0, 1, 2].map(|k| phases[k] * gains[k] + there * offset[k] + noise());
            balance.fit(&c, &AlphaBeta::from_phases(measured), measured.iter().sum());
            if let Some(rest) = balance.rest() {
                times.push(t);
                largest = largest.max(rest.abs());
            }
        }
        (times, largest)
    }

    #[test]
    fn the_step_of_an_offset_is_seen_in_the_sum_and_noise_or_fitted_gains_are_not() {
        let (times, _) = rests([1.0; 3], [0.0; 3]);
        assert!(times.len() < 25, "two in a thousand: {}", times.len());
        let (times, _) = rests([1.02, 0.99, 0.99], [0.0; 3]);
        assert!(times.iter().filter(|&&t| t > 8.0).count() < 25, "once the gains are found");
        for channel in 0..3 {
            let mut offset = [0.0; 3];
            offset[channel] = 0.015;
            let (times, largest) = rests([1.0; 3], offset);
            let first = times.iter().find(|&&t| t > 5.0).unwrap() - 5.0;
            assert!(first < 0.02 && (0.0125..0.018).contains(&largest), "after {first} s, {largest}");
            let last = times.iter().rfind(|&&t| t < 9.9).unwrap() - 5.0;
            assert!((1.0..4.95).contains(&last), "the constant follows: {last} s");
        }
        let (times, _) = rests([1.0; 3], [0.01, -0.01, 0.0]);
        assert!(times.len() < 25, "not seen: the sum stays as it was");
    }

    #[test]
    fn two_sensors_and_a_computed_third_change_nothing() {
        let mut balance = Balance::<f64>::default();
        let i = AlphaBeta::new(0.4, -0.3);
        balance.fit(&BalanceConfig { step: 1e-3, step_offset: 1e-5 }, &i, 0.0);
        assert_eq!(balance.remove(&i), i);
    }

    #[test]
    fn a_disturbed_sample_moves_little_and_no_fit_leaves_its_bounds() {
        let c = BalanceConfig { step: 0.01 / 3.0, step_offset: 0.01 };
        let i = AlphaBeta::new(1.0, 0.5);
        for sign in [1.0, -1.0] {
            let mut balance = Balance::<f64>::default();
            balance.fit(&c, &i, 5.0 * sign);
            let x = balance.image.map(|x| 3.0 * x.value());
            assert!((x[0] - 0.001 * sign).abs() < 1e-12 && (x[1] - 0.0005 * sign).abs() < 1e-12, "{x:?}");
            for _ in 0..100_000 {
                balance.fit(&c, &i, 5.0 * sign);
            }
            assert_eq!(balance.image.map(|x| x.value() * sign), [IMAGE_MAX; 2]);
            assert_eq!(balance.offset.value() * sign, 0.2);
        }
    }
}
