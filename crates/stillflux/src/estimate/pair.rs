//! Gains of two current sensors against each other, from the voltage of a direct current.
//!
//! With sensors in phases a and b, of gains `1 + g_a` and `1 + g_b`, and a third current computed from the two, the
//! measured space vector is
//!
//! ```text
//! i_m = i + (1 + j/√3)/2 Δ i* + j Δ/(2√3) i + (g_a + g_b)/2 i,     Δ = g_a - g_b
//! ```
//!
//! There is no sum that shows `Δ` ([`super::balance`] has one with three sensors), and near `ω_s = 0` its image, which
//! turns with `-ω_s`, cannot be told from an offset: the drive is lost with `Δ` of 1 %. In a direct current of a machine
//! at rest it shows. Current control keeps the *measured* current on the a-axis, so the real one is `Δ/√3` off it; flux
//! and voltage `u = r_s i + dψ/dt` have the direction of the real one, whatever the parameters and however the current
//! changes:
//!
//! ```text
//! u_β = u_0 - Δ/√3 x,     x = u_α + |k_b| + |k_c|
//! ```
//!
//! `k` is the derivative of the inverter model's loss by the logarithm of the current: legs b and c, whose currents are
//! unequal by `Δ`, lose unequal voltages, while the model sees equal ones. The constant `u_0` is of offsets and of unequal
//! dead times of the legs. Steps of the current reference `z` separate both; as instrument it keeps the noise of the
//! currents, which control puts into the voltage, out of the result:
//!
//! ```text
//! -Δ/√3 = c_y c_x/(c_x² + c_w²),    c_y = cov(z, u_β),  c_x = cov(z, x)
//! ```
//!
//! with `c_w` for the noise: the field follows the noise of the current control at low frequency, by some 2e-4 rad, whatever
//! the machine, and the signal is proportional to `r_s`. Its standard deviation is 0.1 % at 2.2 kW and 0.5 % at 11 kW;
//! where it exceeds the tolerance of the sensors, little of the result is taken over.
//!
//! `z`, `x` and `u_β` go through a low-pass each, because of a free shaft: it swings in the flux (5 Hz at 11 kW), and
//! `u_β` contains the derivative of its angle.
//!
//! The phase currents are then divided by `1 ± Δ/2`; the common gain stays.
//!
//! Validity: at standstill, with dead times of the legs that are equal or do not change with the current.

use crate::scalar::{Integrator, Real};
use crate::space::SQRT_3;

/// Covariance of reference and voltage, per unit, at which the noise of the result is as large as what is expected of it:
/// 1 %. Measured at 11 kW: 0.5 % at a covariance of 1.6e-4.
const COVARIANCE_WEAK: f64 = 8e-5;
/// Voltages and covariances are scaled, for fixed point.
const SCALE: f64 = 64.0;
const SCALE_COV: f64 = 8.0;

/// Largest half difference of the gains that is believed.
pub const HALF_MAX: f64 = 0.05;
/// Corner of the low-passes, in reciprocals of the duration.
const SMOOTHING: f64 = 8.0;

/// Means over a direct current whose magnitude changes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Pair<R: Real> {
    /// `z`, `x` and `u_β` after their low-passes, the voltages scaled.
    smooth: [Integrator<R>; 3],
    z: Integrator<R>,
    x: Integrator<R>,
    y: Integrator<R>,
    zx: Integrator<R>,
    zy: Integrator<R>,
}

impl<R: Real> Pair<R> {
    /// One sample of weight `weight`, the reciprocal of the number of those that `count`: current reference, `x` and `u_β`
    /// as above. Those before are for the low-passes to settle.
    pub fn add(&mut self, weight: R, [i_ref, x, u_beta]: [R; 3], count: bool) {
        let now = [i_ref, x * R::from_f64(SCALE), u_beta * R::from_f64(SCALE)];
        let smooth = &mut self.smooth;
        let corner = weight * R::from_f64(SMOOTHING);
        let [z, x, u_beta] = [0, 1, 2].map(|k| {
            let deviation = now[k] - smooth[k].value();
            smooth[k].add(corner, deviation)
        });
        if !count {
            return;
        }
        self.z.add(weight, z);
        self.x.add(weight, x);
        self.y.add(weight, u_beta);
        self.zx.add(weight, z * x);
        self.zy.add(weight, z * u_beta);
    }

    /// What is left of `Δ` in the samples.
    pub fn difference(&self) -> R {
        let r = R::from_f64;
        let cov_x = (self.zx.value() - self.z.value() * self.x.value()) * r(SCALE_COV);
        let cov_y = (self.zy.value() - self.z.value() * self.y.value()) * r(SCALE_COV);
        let weak = r(COVARIANCE_WEAK * SCALE * SCALE_COV);
        cov_y * cov_x * (cov_x * cov_x + weak * weak).recip() * r(-SQRT_3)
    }
}

/// Phase currents of two sensors without the half difference `Δ/2` of their gains, and the third.
#[inline(always)]
pub fn equalised<R: Real>([i_a, i_b]: [R; 2], half: R) -> [R; 3] {
    let (i_a, i_b) = (i_a - i_a * half, i_b + i_b * half);
    [i_a, i_b, -(i_a + i_b)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Q;
    use crate::space::AlphaBeta;

    /// Half of the difference that is found in a direct current of a machine with resistance and inductance.
    fn found<R: Real>(difference: f64, starts: usize) -> R {
        let (mut half, n) = (R::ZERO, 8000);
        let r = |x: f64| R::from_f64(x);
        for _ in 0..starts {
            let mut pair = Pair::default();
            let mut flux = 0.95;
            // Real current of a measured one on the a-axis.
            let angle = -(difference - 2.0 * half.to_f64()) / SQRT_3;
            for k in -n / 2..n {
                let z = 0.6
                    * if k < n / 8 {
                        1.0
                    } else if k < 3 * n / 8 {
                        0.7
                    } else if k < n / 2 {
                        0.4
                    } else {
                        1.0
                    };
                let d_flux = (z / 0.6 - flux) * 1e-3;
                flux += d_flux;
                let u = 0.08 * z + d_flux / 0.03;
                pair.add(r(1.0 / f64::from(n)), [r(z), r(u), r(angle * u + 5e-4)], k >= 0);
            }
            half += pair.difference().half();
        }
        half
    }

    /// Largest pulsation of the magnitude of a rotating current of magnitude 1.
    fn pulsation<R: Real>(difference: f64, half: R) -> f64 {
        let (g_a, g_b) = (difference / 2.0, -difference / 2.0);
        let mut worst = 0.0_f64;
        for k in 0..24 {
            let (s, c) = (f64::from(k) * 0.2618).sin_cos();
            let [a, b, _] = AlphaBeta::<f64>::new(c, s).to_phases();
            let i = equalised([a * (1.0 + g_a), b * (1.0 + g_b)].map(R::from_f64), half);
            assert_eq!(i[0] + i[1] + i[2], R::ZERO);
            worst = worst.max((AlphaBeta::from_phases(i).norm_sq().to_f64().sqrt() - 1.0).abs());
        }
        worst
    }

    fn is_found<R: Real>() {
        for difference in [0.02, -0.01, 0.0] {
            for starts in [1, 2, 5] {
                let left = pulsation(difference, found::<R>(difference, starts));
                assert!(left < 0.05 * difference.abs() + 1e-4, "{} {difference} {starts}: {left}", R::NAME);
            }
        }
        // The negative control: Δ/√3.
        assert!(pulsation(0.02, R::ZERO) > 0.011);
    }

    #[test]
    fn a_difference_of_gains_is_found_in_every_arithmetic_and_again_at_the_next_start() {
        is_found::<f64>();
        is_found::<f32>();
        is_found::<Q>();
    }

    #[test]
    fn a_current_that_does_not_change_shows_nothing() {
        let mut pair = Pair::<f64>::default();
        for k in -1000..100 {
            pair.add(0.01, [0.5, 0.04, 0.01], k >= 0);
        }
        assert!(pair.difference().abs() < 1e-6, "{}", pair.difference());
    }
}
