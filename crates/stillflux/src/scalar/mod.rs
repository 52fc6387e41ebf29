//! One source, three arithmetics: `f32`, `f64` and the fixed-point [`Q`].
//!
//! [`Real`] holds what the blocks use and nothing more. No operation panics, and none returns a
//! non-finite number for finite arguments in the range of a drive's per-unit quantities. Conversions
//! from and to `f64` are for configuration and telemetry; the control step does not call them.

mod float;
mod q;

pub use q::Q;

use crate::error::ParamError;
use crate::words::Words;
use core::fmt::Debug;
use core::marker::PhantomData;
use core::num::NonZeroU32;
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
    Words
    + Copy
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
    /// Largest constant of a configuration.
    const LARGEST: f64;
    /// Smallest gain of a configuration: smaller ones are resolved to less than 3 %.
    const LEAST_GAIN: f64;
    /// Floating point: values are in the registers of the FPU, into which loads reach 1 KiB from an address (VLDR of a
    /// Cortex-M4).
    const FLOATING: bool = false;

    /// Nearest representable value; saturates. NaN stays what it is where there is one, and is zero
    /// in fixed point. Folds to a constant for literals.
    fn from_f64(x: f64) -> Self;
    /// Exact value.
    fn to_f64(self) -> f64;
    /// Nearest representable value, saturated, as [`Real::from_f64`]; without double precision.
    fn from_f32(x: f32) -> Self;
    /// Nearest single-precision value; without double precision where the arithmetic has none.
    fn to_f32(self) -> f32;
    /// Whether the value is a finite number (always true in fixed point).
    fn is_finite(self) -> bool;
    /// `1/x`, odd; the largest representable magnitude where `x` is (nearly) zero.
    fn recip(self) -> Self;
    /// The same where it seldom runs: where it is more than an instruction, one copy in the code for all.
    #[inline(always)]
    fn recip_seldom(self) -> Self {
        self.recip()
    }
    /// `1/√x` for `x > 0`; a large positive value where `x` is not above (nearly) zero.
    fn rsqrt(self) -> Self;

    /// What [`Real::over_64`] takes for `x`: several quotients of one number share what this does.
    fn dividend(self) -> Self;
    /// `x/(64 y)` of the [`Real::dividend`] of `x >= 0` and `y >= 2^-13` for a quotient below 2, with a relative error of
    /// 2e-5: the part of a voltage that an inverter loses, or a weight. In fixed point cheaper than [`Real::recip`].
    fn over_64(self, y: Self) -> Self;
    /// The same, `y <= -2^-13`.
    fn over_64_of_negative(self, y: Self) -> Self;

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

    /// Product with a literal from -1/2 to 1. Fixed point needs neither saturation nor a second word for it.
    #[inline(always)]
    fn times(self, literal: f64) -> Self {
        self * Self::from_f64(literal)
    }
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
        // x + (-0.0) is x for every x: the compiler omits the first addition, which it must not with +0.0.
        let mut sum = -Self::ZERO;
        for (x, y) in a.into_iter().zip(b) {
            sum += x * y;
        }
        sum
    }
    /// `Σ a²` of at most three numbers, saturated in fixed point whatever they are.
    #[inline]
    fn sum_of_squares<const T: usize>(a: [Self; T]) -> Self {
        Self::sum_of_products(a, a)
    }
    /// `|x| <= bound` for `bound >= 0`; never true of NaN. In fixed point a negative bound would hold nearly everything.
    #[inline]
    fn within(self, bound: Self) -> bool {
        debug_assert!(bound >= Self::ZERO || !bound.is_finite(), "{bound:?}");
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
    /// `1/x` for `|x| >= 2^-5`, of which `guess` is the value of an earlier period.
    #[inline]
    fn recip_near(self, guess: Self) -> Self {
        self.recip_next(guess).unwrap_or_else(|| self.recip())
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

/// Resolution of the PWM timer, with the reciprocals that replace a division by it.
///
/// [`Real::quantise`] gives duties in [0, 1] in every arithmetic, and full counts are a duty of 1 but for the last bit
/// of `f32`: the reciprocals are rounded so that no number of counts up to `full` exceeds it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Timer {
    /// Counts of a full duty (from carrier valley to peak); not zero, so that no timer takes no word of its own.
    full: NonZeroU32,
    /// Bits by which `full` is moved up to lie in `2^30 ..= 2^31 - 1`.
    shift: u32,
    /// `2^(56 - shift) / full`, rounded up: the upper word of its product with `full << shift` is `2^24`.
    recip_q: u32,
    /// Bits of `1 / full` as `f32`, so rounded that its product with `full` is at most 1.
    recip_f32: u32,
}

impl Timer {
    /// Smallest number of full counts: duties in steps of one per cent.
    pub const MIN: u32 = 100;
    /// Largest number of full counts: up to here every count is a number of its own in `f32`.
    pub const MAX: u32 = 1 << 22;

    /// A timer that counts `full` from valley to peak, [`Timer::MIN`] to [`Timer::MAX`].
    ///
    /// # Errors
    /// Counts outside this range.
    pub const fn new(full: u32) -> Result<Self, ParamError> {
        if full < Self::MIN || full > Self::MAX {
            let (value, min, max) = (full as f64, Self::MIN as f64, Self::MAX as f64);
            return Err(ParamError { field: "timer", value, min, max, unit: "counts", note: "" });
        }
        Ok(Self::of(full))
    }

    /// The finest timer.
    #[must_use]
    pub const fn finest() -> Self {
        Self::of(Self::MAX)
    }

    /// For counts within the range.
    const fn of(full: u32) -> Self {
        let shift = full.leading_zeros() - 1;
        let recip_q = (1_u64 << (56 - shift)).div_ceil(full as u64) as u32;
        // 24 bits of 1/full, rounded up unless full counts would exceed one by more than rounding takes off again.
        let exponent = 23 + (u32::BITS - (full - 1).leading_zeros());
        let up = (1_u64 << exponent).div_ceil(full as u64);
        let excess = up * full as u64 - (1_u64 << exponent);
        let mantissa = (if excess <= 1_u64 << (exponent - 24) { up } else { up - 1 }) as u32;
        // mantissa 2^-exponent with 2^23 <= mantissa <= 2^24; 2^24 is the next power of two.
        let recip_f32 = ((127 + 23 - exponent) << 23) + (mantissa - (1 << 23));
        let full = match NonZeroU32::new(full) {
            Some(full) => full,
            None => NonZeroU32::MIN,
        };
        Self { full, shift, recip_q, recip_f32 }
    }

    /// Counts of a full duty.
    #[inline]
    #[must_use]
    pub fn full(&self) -> u32 {
        self.full.get()
    }
}

impl Words for Timer {
    const LEN: usize = 4;
    const BLANK: Self = Self { full: NonZeroU32::MIN, shift: 0, recip_q: 0, recip_f32: 0 };
    fn put(&self, out: &mut impl FnMut(u32)) {
        [self.full(), self.shift, self.recip_q, self.recip_f32].put(out);
    }
    fn fill(&mut self, from: &mut impl FnMut() -> u32) {
        let [full, shift, recip_q, recip_f32] = Words::take(from);
        // A shift is below the width of a word, whatever a page holds.
        *self = Self { full: NonZeroU32::new(full).unwrap_or(NonZeroU32::MIN), shift: shift & 31, recip_q, recip_f32 };
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

    /// `n` counts of `timer` as duty: its counts and its value.
    fn duty<R: Real>(timer: &Timer, n: u32) -> (u32, R) {
        R::from_f64(f64::from(n) / f64::from(timer.full())).quantise(timer)
    }

    fn full_counts<R: Real>(timer: &Timer) {
        let full = timer.full();
        for n in [full, full - 1, full / 2, 1, 0] {
            let (counts, duty) = duty::<R>(timer, n);
            assert!(duty >= R::ZERO && duty <= R::ONE, "{} {n} of {full}: {duty:?}", R::NAME);
            assert_eq!(counts, n, "{} {full}", R::NAME);
            let error = (duty.to_f64() - f64::from(n) / f64::from(full)).abs();
            assert!(error < 1.3e-7, "{} {n} of {full}: {error}", R::NAME);
        }
        // Limited, but not at a whole count.
        let almost = R::ONE.quantise(timer);
        assert!(almost.0 == full && almost.1 <= R::ONE);
    }

    /// Every timer, and in each the counts at both ends: between them a duty is a product that grows with them.
    #[test]
    fn a_duty_is_between_zero_and_one_for_every_timer_in_every_arithmetic() {
        for full in Timer::MIN..=Timer::MAX {
            let timer = Timer::new(full).unwrap();
            // The numbers behind full_counts, for every timer; full_counts itself for a part of them.
            let top = full as f32 * f32::from_bits(timer.recip_f32);
            assert!(top <= 1.0 && f64::from(top) > 1.0 - 6e-8, "{full}: {top}");
            assert_eq!((u64::from(full << timer.shift) * u64::from(timer.recip_q)) >> 32, 1 << 24, "{full}");
            if full <= 70_000 || full % 61 == 0 || full.is_power_of_two() || (full + 1).is_power_of_two() {
                full_counts::<f32>(&timer);
                full_counts::<f64>(&timer);
                full_counts::<Q>(&timer);
            }
        }
    }

    #[test]
    fn every_count_of_a_timer_is_its_own_duty_in_every_arithmetic() {
        for full in [100, 511, 720, 8500, 65_535, 85_000] {
            let timer = Timer::new(full).unwrap();
            for n in 0..=full {
                assert_eq!(duty::<f32>(&timer, n).0, n);
                assert_eq!(duty::<Q>(&timer, n).0, n);
                assert!(duty::<f32>(&timer, n).1 <= 1.0 && duty::<Q>(&timer, n).1 <= Q::ONE);
                assert_eq!(duty::<f64>(&timer, n), (n, f64::from(n) / f64::from(full)));
            }
        }
    }

    #[test]
    fn a_timer_beyond_its_range_is_refused_by_name() {
        for full in [0, 99, Timer::MAX + 1, u32::MAX] {
            assert_eq!(Timer::new(full).unwrap_err().field, "timer");
        }
        assert_eq!(Timer::finest(), Timer::new(Timer::MAX).unwrap());
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
