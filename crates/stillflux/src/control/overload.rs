//! Derating by the heat of machine and bridge (I²t), per unit.
//!
//! Each is a body with one time constant `τ`, in units of the rise of temperature at its continuous current `i_c`,
//!
//! ```text
//! dθ/dt = ((i/i_c)² - θ)/τ,    i² ≤ i_c² + (i_max² - i_c²) min(1, (1 - θ)/0.1)
//! ```
//!
//! so that the whole current is there up to `θ` = 0.9 and the continuous one at 1: `θ` does not exceed one, and the
//! drive goes on with less torque instead of a trip. Computed every 64th call, with the mean of `i²` over these calls.

use crate::scalar::{Integrator, QuickIntegrator, Real, likely};
use crate::words::words;

/// Calls from one computation to the next.
pub const CALLS: u32 = 64;
/// Reciprocal of the range of `θ` in which the current is derated.
const INV_RANGE: f64 = 10.0;

/// Settings of one body.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct OverloadConfig<R: Real> {
    /// `i_c²` and its reciprocal.
    pub i_c_sq: R,
    /// `1/i_c²`.
    pub inv_i_c_sq: R,
    /// Time between two computations over `τ`; 0: no derating.
    pub rate: R,
}
words!(OverloadConfig: i_c_sq, inv_i_c_sq, rate);

/// Heat of machine and bridge.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Overload<R: Real> {
    theta: [Integrator<R>; 2],
    /// Mean of `i²` since the last computation, as far as it is complete.
    i_sq: QuickIntegrator<R>,
    calls: u8,
}

impl<R: Real> Overload<R> {
    /// `θ` of machine and bridge.
    pub fn theta(&self) -> [R; 2] {
        [self.theta[0].value(), self.theta[1].value()]
    }

    /// One call with the square of the current; the square of the largest one where it is computed anew, `i_max_sq` being
    /// that without derating.
    #[inline(always)]
    pub fn step(&mut self, c: &[OverloadConfig<R>; 2], i_sq: R, i_max_sq: R) -> Option<R> {
        self.i_sq.add(R::from_f64(const { 1.0 / CALLS as f64 }), i_sq);
        self.calls = (self.calls + 1) % CALLS as u8;
        if likely(self.calls != 0) { None } else { Some(self.derate(c, i_max_sq)) }
    }

    #[cold]
    fn derate(&mut self, c: &[OverloadConfig<R>; 2], i_max_sq: R) -> R {
        let i_sq = core::mem::take(&mut self.i_sq).value();
        let [machine, bridge] = &mut self.theta;
        c[0].derate(machine, i_sq, i_max_sq).min(c[1].derate(bridge, i_sq, i_max_sq))
    }
}

impl<R: Real> OverloadConfig<R> {
    /// Of a body with `i_c²`, its reciprocal, and the time between two computations over `τ`.
    pub fn new(i_c_sq: R, inv_i_c_sq: R, rate: R) -> Self {
        Self { i_c_sq, inv_i_c_sq, rate }
    }

    /// Square of the largest current of this body, at the mean square of the current since the last computation.
    // A call: the code exists once for both.
    #[inline(never)]
    fn derate(&self, theta: &mut Integrator<R>, i_sq: R, i_max_sq: R) -> R {
        if self.rate <= R::ZERO {
            return i_max_sq;
        }
        let rise = i_sq * self.inv_i_c_sq - theta.value();
        let left = R::ONE - theta.add_clamped(self.rate, rise, R::ZERO, R::TWO);
        let part = (left * R::from_f64(INV_RANGE)).clamp(R::ZERO, R::ONE);
        i_max_sq.min(self.i_c_sq + (i_max_sq - self.i_c_sq) * part)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Q;

    fn body<R: Real>(i_c: f64, rate: f64) -> OverloadConfig<R> {
        let r = R::from_f64;
        OverloadConfig { i_c_sq: r(i_c * i_c), inv_i_c_sq: r(1.0 / (i_c * i_c)), rate: r(rate) }
    }

    /// Calls until the current is reduced, and the current in the end.
    fn overloaded<R: Real>(c: [OverloadConfig<R>; 2]) -> (u32, f64) {
        let (most, mut i_sq, mut first) = (R::from_f64(1.8 * 1.8), R::from_f64(1.5 * 1.5), None);
        let mut overload = Overload::default();
        for k in 0..CALLS * 20_000 {
            if let Some(limit) = overload.step(&c, i_sq, most) {
                i_sq = R::from_f64(1.5 * 1.5).min(limit);
                if limit < R::from_f64(1.5 * 1.5) {
                    first = first.or(Some(k / CALLS));
                }
            }
        }
        assert!(overload.theta().iter().all(|x| *x <= R::ONE + R::from_f64(1e-3)));
        (first.unwrap(), i_sq.to_f64().sqrt())
    }

    fn derates<R: Real>() {
        // The machine allows 1.5 times its continuous current until θ = 2.25 (1 - e^(-t/τ)) comes near one.
        let (first, end) = overloaded::<R>([body(1.0, 1e-3), body(1.2, 0.0)]);
        assert!((500..600).contains(&first), "{}: {first}", R::NAME);
        assert!((end - 1.0).abs() < 0.04, "{}: {end}", R::NAME);
        // The bridge is the hotter one.
        let (first, end) = overloaded::<R>([body(1.3, 1e-3), body(1.2, 0.01)]);
        assert!(first < 100 && (end - 1.2).abs() < 0.04, "{}: {first} {end}", R::NAME);
    }

    #[test]
    fn an_overload_ends_in_the_continuous_current() {
        derates::<f32>();
        derates::<f64>();
        derates::<Q>();
    }

    #[test]
    fn what_counts_is_the_mean_square_of_a_current_that_pulses_with_the_computation() {
        for phase in [0, 20, 45] {
            let mut overload = Overload::<f32>::default();
            for k in 0..CALLS * 2000 {
                let i_sq = if (k + phase) % CALLS < CALLS / 2 { 1.6 } else { 0.0 };
                overload.step(&[body(1.0, 0.01), body(1.0, 0.0)], i_sq, 4.0);
            }
            let [theta, _] = overload.theta();
            assert!((theta - 0.8).abs() < 1e-3, "{phase}: {theta}");
        }
    }

    #[test]
    fn without_settings_nothing_is_limited() {
        let mut overload = Overload::<f64>::default();
        for _ in 0..10 * CALLS {
            assert!(overload.step(&[body(1.0, 0.0); 2], 3.0, 2.0).is_none_or(|most| most == 2.0));
        }
    }
}
