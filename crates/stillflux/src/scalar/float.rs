//! `f32` and `f64`. Reciprocal roots by Newton's method from the exponent trick: the same operations on
//! every target, so that host and microcontroller agree to the bit, and no call into a maths library.

use super::{Real, Sum, Timer, likely};

/// Value and rounding residual of a compensated (Kahan) sum.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Compensated<T> {
    value: T,
    residual: T,
}

macro_rules! impl_real {
    ($t:ident, $bits:ident, $magic:expr, $tiny:expr, $newton:expr, $part:expr) => {
        impl Real for $t {
            type Sum = Compensated<$t>;
            type Quick = $t;

            const ZERO: Self = 0.0;
            const HALF: Self = 0.5;
            const ONE: Self = 1.0;
            const TWO: Self = 2.0;
            const NAME: &'static str = stringify!($t);
            // Its square, and that times the square of a signal, are finite.
            const LARGEST: f64 = 1e9;
            const LEAST_GAIN: f64 = 1e-20;
            const FLOATING: bool = true;

            #[inline]
            #[allow(clippy::cast_possible_truncation)]
            fn from_f64(x: f64) -> Self {
                x.clamp(f64::from(<$t>::MIN), f64::from(<$t>::MAX)) as $t
            }
            #[inline]
            fn to_f64(self) -> f64 {
                f64::from(self)
            }
            #[inline]
            #[allow(clippy::useless_conversion, clippy::unnecessary_cast)]
            fn from_f32(x: f32) -> Self {
                if likely(f32::is_finite(x)) { x as $t } else { x.clamp(f32::MIN, f32::MAX) as $t }
            }
            #[inline]
            #[allow(clippy::unnecessary_cast)]
            fn to_f32(self) -> f32 {
                self as f32
            }
            // Zero but for an infinity and NaN. One comparison in the FPU; a test of the bits would move them to an integer
            // register.
            #[allow(clippy::eq_op)]
            #[inline]
            fn is_finite(self) -> bool {
                self - self == 0.0
            }
            #[inline]
            fn abs(self) -> Self {
                <$t>::abs(self)
            }
            #[inline]
            fn half(self) -> Self {
                0.5 * self
            }
            #[inline]
            fn quarter(self) -> Self {
                0.25 * self
            }
            #[inline]
            #[allow(clippy::cast_precision_loss)]
            fn periods(self, n: u32) -> Self {
                self * n as $t * (1.0 / 64.0)
            }
            #[inline]
            fn recip(self) -> Self {
                if likely(<$t>::abs(self) > $tiny) {
                    1.0 / self
                } else if self < 0.0 {
                    -1.0 / $tiny
                } else {
                    1.0 / $tiny
                }
            }
            // One instruction of 14 cycles; Newton's step with the check of its guess is seven, of about as many.
            #[inline(always)]
            fn recip_near(self, _: Self) -> Self {
                1.0 / self
            }
            #[inline(always)]
            fn dividend(self) -> Self {
                self * (1.0 / 64.0)
            }
            #[inline(always)]
            fn over_64(self, y: Self) -> Self {
                self / y
            }
            #[inline(always)]
            fn over_64_of_negative(self, y: Self) -> Self {
                self / y
            }
            // A call: hardly any period needs one, and flash is short.
            #[inline(never)]
            fn rsqrt(self) -> Self {
                let x = Real::max(self, $tiny);
                let half = 0.5 * x;
                let mut y = <$t>::from_bits($magic - (x.to_bits() >> 1));
                for _ in 0..$newton {
                    y *= 1.5 - half * y * y;
                }
                y
            }
            #[inline]
            fn fraction(n: i16) -> Self {
                <$t>::from(n) * (1.0 / 32_768.0)
            }
            #[inline]
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            fn quantise(self, timer: &Timer) -> (u32, Self) {
                // `as` saturates and takes NaN for zero.
                let n = (self * timer.full() as $t + 0.5) as u32;
                (n, $part(n, timer))
            }
        }

        impl Sum<$t> for Compensated<$t> {
            #[inline]
            fn of(x: $t) -> Self {
                Self { value: x, residual: 0.0 }
            }
            #[inline]
            fn accumulate(&mut self, gain: $t, x: $t) {
                let increment = gain * x + self.residual;
                let value = self.value + increment;
                self.residual = increment - (value - self.value);
                self.value = value;
            }
            #[inline]
            fn value(self) -> $t {
                self.value
            }
        }

        impl Sum<$t> for $t {
            #[inline]
            fn of(x: $t) -> Self {
                x
            }
            #[inline]
            fn accumulate(&mut self, gain: $t, x: $t) {
                *self += gain * x;
            }
            #[inline]
            fn value(self) -> $t {
                self
            }
        }
    };
}

// `n` counts as part of full ones, at most 1: by a factor that is rounded for that, or a quotient.
impl_real!(f32, u32, 0x5f37_5a86_u32, 1e-12, 3, |n: u32, timer: &Timer| n as f32 * f32::from_bits(timer.recip_f32));
impl_real!(f64, u64, 0x5fe6_eb50_c7b5_37a9_u64, 1e-24, 4, |n: u32, timer: &Timer| f64::from(n)
    / f64::from(timer.full()));

#[cfg(test)]
mod tests {
    use crate::scalar::{Integrator, Real};

    #[test]
    fn rsqrt_is_accurate_over_the_range_of_a_drive() {
        for k in 1..4000 {
            let x = f64::from(k) * 0.005;
            assert!((Real::rsqrt(x) * x.sqrt() - 1.0).abs() < 4e-15, "{x}");
            let y = x as f32;
            assert!((f64::from(Real::rsqrt(y)) * f64::from(y).sqrt() - 1.0).abs() < 2.5e-7, "{y}");
        }
    }

    #[test]
    fn degenerate_arguments_stay_finite() {
        for x in [0.0_f32, -0.0, -1.0, 1e-30, f32::MIN_POSITIVE, 1e30, f32::NAN] {
            assert!(Real::rsqrt(x).is_finite() && Real::rsqrt(x) > 0.0, "rsqrt {x}");
            assert!(Real::recip(x).is_finite() || x.is_nan(), "recip {x}");
        }
        assert!(f32::from_f64(1e300).is_finite() && f32::from_f64(f64::NAN).is_nan());
        assert_eq!(Real::clamp(f32::NAN, -1.0, 1.0), -1.0);
    }

    #[test]
    fn integrator_keeps_increments_below_one_ulp() {
        let mut s = Integrator::<f32>::new(1.0);
        for _ in 0..1_000_000 {
            s.add(1e-3, 1e-6);
        }
        assert!((s.value() - 1.001).abs() < 2e-7);
    }
}
