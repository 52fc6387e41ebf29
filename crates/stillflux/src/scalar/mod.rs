//! One source, three arithmetics: `f32`, `f64` and the fixed-point [`Q`].
//!
//! [`Real`] holds what the blocks use and nothing more. No operation panics, and none returns a
//! non-finite number for finite arguments in the range of a drive's per-unit quantities. Conversions
//! from and to `f64` are for configuration and telemetry; the control step does not call them.

mod float;
mod q;

pub use q::Q;

use crate::words::Words;
use core::fmt::Debug;
use core::marker::PhantomData;
use core::ops::{Add, AddAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// What the feature `serde` adds to every arithmetic; without it, nothing.
#[cfg(feature = "serde")]
pub trait Store: serde::Serialize + serde::de::DeserializeOwned {}
#[cfg(feature = "serde")]
impl<T: serde::Serialize + serde::de::DeserializeOwned> Store for T {}
/// What the feature `serde` adds to every arithmetic; without it, nothing.
#[cfg(not(feature = "serde"))]
pub trait Store {}
#[cfg(not(feature = "serde"))]
impl<T> Store for T {}

/// What the feature `defmt` adds to every arithmetic; without it, nothing.
#[cfg(feature = "defmt")]
pub trait Log: defmt::Format {}
#[cfg(feature = "defmt")]
impl<T: defmt::Format> Log for T {}
/// What the feature `defmt` adds to every arithmetic; without it, nothing.
#[cfg(not(feature = "defmt"))]
pub trait Log {}
#[cfg(not(feature = "defmt"))]
impl<T> Log for T {}

/// Arithmetic of the per-unit quantities of a drive.
pub trait Real:
    Copy
    + Debug
    + Default
    + PartialEq
    + PartialOrd
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
    + num_traits::Zero
    + num_traits::One
    + Store
    + Log
{
    /// Accumulator that keeps what an addition to `Self` would round away.
    type Sum: Sum<Self>;
    /// Accumulator for loops that correct themselves: free from bias, but increments below one rounding step
    /// may get lost where that saves instructions.
    type Quick: Sum<Self>;

    /// 0.
    const ZERO: Self;
    /// 1/2.
    const HALF: Self;
    /// 1.
    const ONE: Self;
    /// 2.
    const TWO: Self;
    /// Name of the arithmetic.
    const NAME: &'static str;

    /// Nearest representable value; saturates. NaN stays what it is where there is one, and is zero
    /// in fixed point. Folds to a constant for literals.
    fn from_f64(x: f64) -> Self;
    /// Exact value.
    fn to_f64(self) -> f64;
    /// Whether the value is a finite number (always true in fixed point).
    fn is_finite(self) -> bool;
    /// `1/x`, odd; the largest representable magnitude where `x` is (nearly) zero.
    fn recip(self) -> Self;
    /// `1/√x` for `x > 0`; a large positive value where `x` is not above (nearly) zero.
    fn rsqrt(self) -> Self;

    /// `x/(64 y)` of `x >= 0` and `y >= 2^-13` for a quotient below 2, with a relative error of 2e-5: the part of a
    /// voltage that an inverter loses, or a weight. In fixed point cheaper than [`Real::recip`].
    fn over_64(self, y: Self) -> Self;

    /// `n / 2^15`, exact: a left-aligned converter reading as part of full scale.
    fn fraction(n: i16) -> Self;
    /// Nearest multiple of one timer count, for `0 <= x <= 1`.
    fn quantise(self, timer: &Timer) -> (u32, Self);

    /// `x/2`.
    fn half(self) -> Self;
    /// `x/4`.
    fn quarter(self) -> Self;
    /// `64⁻¹ n x`, saturated: durations of many periods.
    fn periods(self, n: u32) -> Self;

    /// `a·b`, the scalar product: rounded once where a wide register holds both products.
    #[inline]
    fn dot(a: [Self; 2], b: [Self; 2]) -> Self {
        a[0] * b[0] + a[1] * b[1]
    }
    /// `a×b`, rounded as [`Real::dot`].
    #[inline]
    fn cross(a: [Self; 2], b: [Self; 2]) -> Self {
        a[0] * b[1] - a[1] * b[0]
    }
    /// `Σ a·b`, rounded as [`Real::dot`]. In fixed point the exact sum must be within ±2^15.
    #[inline]
    fn sum_of_products<const T: usize>(a: [Self; T], b: [Self; T]) -> Self {
        // Nothing is to be added to a negative zero: the first product is the sum.
        let mut sum = -Self::ZERO;
        for (x, y) in a.into_iter().zip(b) {
            sum += x * y;
        }
        sum
    }
    /// `|x| <= bound` for `bound >= 0`; never true of NaN.
    #[inline]
    fn within(self, bound: Self) -> bool {
        self.abs() <= bound
    }

    /// `1/√x` by one Newton step from the value of an earlier period, if that one is good to 1 %. Its error
    /// `e` becomes `3/2 e²`: quantities that move by a thousandth in a period lose nothing here.
    #[inline]
    fn rsqrt_next(self, guess: Self) -> Option<Self> {
        let e = Self::ONE - self * guess * guess;
        likely(e.within(Self::from_f64(0.02))).then_some(guess + guess * e.half())
    }
    /// [`Real::rsqrt_next`], and [`Real::rsqrt`] where the guess is not good enough.
    #[inline]
    fn rsqrt_near(self, guess: Self) -> Self {
        self.rsqrt_next(guess).unwrap_or_else(|| self.rsqrt())
    }
    /// `1/x` by one Newton step from the value of an earlier period, if that one is good to 1 %.
    #[inline]
    fn recip_next(self, guess: Self) -> Option<Self> {
        let e = Self::ONE - self * guess;
        likely(e.within(Self::from_f64(0.01))).then_some(guess + guess * e)
    }

    /// `√x`, zero for `x <= 0`.
    #[inline]
    fn sqrt(self) -> Self {
        if self > Self::ZERO { self * self.rsqrt() } else { Self::ZERO }
    }
    /// `|x|`.
    #[inline]
    fn abs(self) -> Self {
        if self < Self::ZERO { -self } else { self }
    }
    /// The smaller one.
    #[inline]
    fn min(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
    /// The larger one.
    #[inline]
    fn max(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
    /// Limits to `-bound ..= bound`, `bound >= 0`; NaN goes to a bound, never through.
    #[inline]
    fn limit(self, bound: Self) -> Self {
        // One comparison where nothing is to be limited, which is nearly always.
        if likely(self.within(bound)) { self } else { outside(self, -bound, bound) }
    }
    /// Limits to `lo ..= hi`, `lo <= hi`; NaN goes to `lo`, never through.
    #[inline]
    fn clamp(self, lo: Self, hi: Self) -> Self {
        if likely(self >= lo && self <= hi) { self } else { outside(self, lo, hi) }
    }
    /// `-1`, `0` or `1`.
    #[inline]
    fn sign(self) -> Self {
        if self > Self::ZERO {
            Self::ONE
        } else if self < Self::ZERO {
            -Self::ONE
        } else {
            Self::ZERO
        }
    }
}

/// Where a value goes that is not within its limits.
#[inline]
fn outside<R: Real>(x: R, lo: R, hi: R) -> R {
    if x > hi { hi } else { lo }
}

/// [`Real::clamp`] where it seldom runs: one copy in the code for all.
#[cold]
#[inline(never)]
pub(crate) fn clamp_seldom<R: Real>(x: R, lo: R, hi: R) -> R {
    x.clamp(lo, hi)
}

/// Tells the compiler which way a branch nearly always goes.
#[inline(always)]
pub(crate) fn likely(condition: bool) -> bool {
    #[cold]
    fn seldom() {}
    if !condition {
        seldom();
    }
    condition
}

/// Resolution of the PWM timer, with the reciprocal that replaces a division by it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Timer {
    /// Counts of a full duty (from carrier valley to peak).
    full: u32,
    /// `2^40 / full`, rounded up: `full` times it is one.
    recip: u32,
}

impl Timer {
    /// A timer that counts `full` from valley to peak, 512 to 65,536.
    #[must_use]
    pub fn new(full: u32) -> Self {
        let full = full.clamp(512, 65_536);
        Self { full, recip: (1_u64 << 40).div_ceil(u64::from(full)) as u32 }
    }

    /// Counts of a full duty.
    #[must_use]
    pub fn full(&self) -> u32 {
        self.full
    }
}

impl Words for Timer {
    fn put(&self, out: &mut impl FnMut(u32)) {
        out(self.full);
        out(self.recip);
    }
    fn take(from: &mut impl FnMut() -> u32) -> Self {
        Self { full: from(), recip: from() }
    }
}

/// A running sum of products.
pub trait Sum<R>: Copy + Debug + Default + PartialEq + Send + Sync + Store + Log + 'static {
    /// A sum that holds `x`.
    fn of(x: R) -> Self;
    /// Adds `gain · x`.
    fn accumulate(&mut self, gain: R, x: R);
    /// The sum, rounded.
    fn value(self) -> R;
}

/// Integrator that loses no low-order bits: increments below one rounding step are carried.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Integrator<R: Real, S: Sum<R> = <R as Real>::Sum> {
    sum: S,
    of: PhantomData<R>,
}

/// [`Integrator`] on [`Real::Quick`]: within a closed loop, whose error grows until it counts.
pub type QuickIntegrator<R> = Integrator<R, <R as Real>::Quick>;

impl<R: Real, S: Sum<R>> Integrator<R, S> {
    /// Starts at `x`.
    #[must_use]
    #[inline]
    pub fn new(x: R) -> Self {
        Self { sum: S::of(x), of: PhantomData }
    }

    /// Adds `gain · x` and returns the new value.
    #[inline]
    pub fn add(&mut self, gain: R, x: R) -> R {
        self.sum.accumulate(gain, x);
        self.value()
    }

    /// Adds `gain · x` and limits to `lo ..= hi`.
    #[inline]
    pub fn add_clamped(&mut self, gain: R, x: R, lo: R, hi: R) -> R {
        let y = self.add(gain, x);
        if likely(y >= lo && y <= hi) { y } else { self.stop(outside(y, lo, hi)) }
    }

    /// Adds `gain · x` and limits to `-bound ..= bound`.
    #[inline]
    pub fn add_limited(&mut self, gain: R, x: R, bound: R) -> R {
        self.add(gain, x);
        self.limit(bound)
    }

    /// Limits to `-bound ..= bound`.
    #[inline]
    pub fn limit(&mut self, bound: R) -> R {
        let y = self.value();
        if likely(y.within(bound)) { y } else { self.stop(outside(y, -bound, bound)) }
    }

    #[inline]
    fn stop(&mut self, at: R) -> R {
        self.set(at);
        at
    }

    /// Present value.
    #[inline]
    pub fn value(&self) -> R {
        self.sum.value()
    }

    /// Sets the value and drops the residual.
    #[inline]
    pub fn set(&mut self, x: R) {
        self.sum = S::of(x);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn newton<R: Real>() {
        for x in [0.04, 0.5, 1.0, 2.3, 9.0] {
            for off in [-0.02, -0.009, -0.004, 0.0, 0.004, 0.009, 0.02] {
                let (good, r) = (f64::abs(off) < 0.01, |x: f64| R::from_f64(x));
                let root = 1.0 / libm::sqrt(x);
                let next = r(x).rsqrt_next(r(root * (1.0 + off)));
                assert_eq!(next.is_some(), good, "{} {x} {off}", R::NAME);
                assert!(next.is_none_or(|y| (y.to_f64() / root - 1.0 + 1.5 * off * off).abs() < 2e-6));
                assert!((r(x).rsqrt_near(r(root * (1.0 + off))).to_f64() / root - 1.0).abs() < 1.3e-4);
                let next = r(x).recip_next(r((1.0 + off) / x));
                assert_eq!(next.is_some(), good, "{} {x} {off}", R::NAME);
                assert!(next.is_none_or(|y| (y.to_f64() * x - 1.0 + off * off).abs() < 3e-6));
            }
        }
    }

    #[test]
    fn a_newton_step_squares_the_error_of_a_guess_good_to_a_hundredth_and_takes_no_other() {
        newton::<f32>();
        newton::<f64>();
        newton::<Q>();
    }

    fn durations<R: Real>() {
        assert_eq!(R::ONE.periods(640).to_f64(), 10.0);
        assert_eq!((-R::HALF).periods(64).to_f64(), -0.5);
    }

    #[test]
    fn a_duration_is_a_sixty_fourth_of_so_many_periods() {
        durations::<f32>();
        durations::<f64>();
        durations::<Q>();
        assert_eq!(Q::ONE.periods(u32::MAX), Q::MAX);
        assert_eq!((-Q::ONE).periods(u32::MAX), Q::from_bits(i32::MIN));
    }
}
