//! Saturating fixed point Q7.24 in an `i32`: range ±128, resolution 6e-8.
//!
//! The format covers every per-unit quantity and coefficient of the drive with one scaling, at the
//! resolution of `f32` near one. Products take one 32×32→64 multiplication; the upper word is saturated
//! to 24 bits (one SSAT) before the words are joined, so an overflow lands within 2^-16 of the bound,
//! never on the other side. Division exists only as [`Real::recip`]: normalise, linear start, Newton;
//! no 64-bit division anywhere.

use super::{Real, Sum, Timer};
use crate::words::Words;
use core::ops::{Add, AddAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// Fixed-point number with 24 fractional bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
#[repr(transparent)]
pub struct Q(i32);

impl Q {
    /// Number of fractional bits.
    pub const FRAC: u32 = 24;
    /// Largest value.
    pub const MAX: Self = Self(i32::MAX);

    /// From the raw integer, `raw / 2^24`.
    #[must_use]
    pub const fn from_bits(raw: i32) -> Self {
        Self(raw)
    }

    /// The raw integer.
    #[must_use]
    pub const fn to_bits(self) -> i32 {
        self.0
    }
}

/// The whole product, Q15.48.
#[inline]
fn wide(a: Q, b: Q) -> i64 {
    product(a.0, b.0)
}

/// The whole product of two words: one instruction of a Cortex-M3 and all above.
#[cfg(not(all(target_arch = "arm", not(target_has_atomic = "32"))))]
#[inline(always)]
fn product(a: i32, b: i32) -> i64 {
    i64::from(a) * i64::from(b)
}

/// The upper word of a product: one instruction there, too.
#[cfg(not(all(target_arch = "arm", not(target_has_atomic = "32"))))]
#[inline(always)]
fn upper(a: i32, b: i32) -> i32 {
    (product(a, b) >> 32) as i32
}

/// [`narrow`] of the product of two words.
#[cfg(not(all(target_arch = "arm", not(target_has_atomic = "32"))))]
#[inline(always)]
fn rounded(a: i32, b: i32) -> i32 {
    narrow(product(a, b))
}

/// The same of two words without sign.
#[cfg(not(all(target_arch = "arm", not(target_has_atomic = "32"))))]
#[inline(always)]
fn product_unsigned(a: u32, b: u32) -> u64 {
    u64::from(a) * u64::from(b)
}

/// Upper word of `a·b`: product of a Q31 fraction. (Written with halves here as well, the compiler would recognise them
/// and call `__aeabi_lmul`.)
#[inline]
fn mul_hi(a: u32, b: u32) -> u32 {
    (product_unsigned(a, b) >> 32) as u32
}

/// Zeros before the first one bit: one instruction there, too.
#[cfg(not(all(target_arch = "arm", not(target_has_atomic = "32"))))]
#[inline(always)]
fn leading_zeros(x: u32) -> u32 {
    x.leading_zeros()
}

#[cfg(all(target_arch = "arm", not(target_has_atomic = "32")))]
use halves::{leading_zeros, product, product_unsigned, rounded, upper};

/// Products of two words on a Cortex-M0+, whose multiplier returns the lower word only: four products of half words,
///
/// ```text
/// a b = a₁b₁ 2^32 + (a₁b₀ + a₀b₁) 2^16 + a₀b₀
/// ```
///
/// in place of the compiler's routine for 64 by 64 bits. Of all ARM processors in use only these (ARMv6-M) have no atomic
/// exchange, which is how the build knows them. No sum below exceeds a word: `(2^16 - 1)² + 2^16 - 1 < 2^32`.
#[cfg(any(test, all(target_arch = "arm", not(target_has_atomic = "32"))))]
mod halves {
    use crate::scalar::likely;

    #[cfg_attr(not(test), inline(never))]
    pub(super) fn product(a: i32, b: i32) -> i64 {
        i64::from(upper_word(a, b)) << 32 | i64::from(a.wrapping_mul(b) as u32)
    }

    /// `a b >> 24`, saturated as in [`super::narrow`].
    #[cfg_attr(not(test), inline(never))]
    pub(super) fn rounded(a: i32, b: i32) -> i32 {
        let (high, last) = parts(a, b);
        // The upper word but for what `last` carries into it, 2^15 at most. Below 2^22, ±64, nothing is saturated.
        if likely(high >> 22 == high >> 31) { (high << 8) + (last >> 8) } else { saturated(high, last) }
    }

    #[cold]
    #[inline(never)]
    fn saturated(high: i32, last: i32) -> i32 {
        let high = high.wrapping_add(last >> 16);
        let upper = high.clamp(-(1 << 23), (1 << 23) - 1) << 8;
        upper | (last >> 8 & 0xFF)
    }

    /// Upper word of [`product`].
    #[cfg_attr(not(test), inline(never))]
    pub(super) fn upper(a: i32, b: i32) -> i32 {
        upper_word(a, b)
    }

    #[inline(always)]
    fn upper_word(a: i32, b: i32) -> i32 {
        let (high, last) = parts(a, b);
        high.wrapping_add(last >> 16)
    }

    /// `a b = high 2^32 + last 2^16 +` the lower half of `a₀b₀`.
    #[inline(always)]
    fn parts(a: i32, b: i32) -> (i32, i32) {
        let (a_1, a_0, b_1, b_0) = (a >> 16, a & 0xFFFF, b >> 16, b & 0xFFFF);
        let low = (a_0 as u32).wrapping_mul(b_0 as u32);
        let middle = a_1.wrapping_mul(b_0).wrapping_add((low >> 16) as i32);
        let last = a_0.wrapping_mul(b_1).wrapping_add(middle & 0xFFFF);
        (a_1.wrapping_mul(b_1).wrapping_add(middle >> 16), last)
    }

    #[cfg_attr(not(test), inline(never))]
    pub(super) fn product_unsigned(a: u32, b: u32) -> u64 {
        let (a_1, a_0, b_1, b_0) = (a >> 16, a & 0xFFFF, b >> 16, b & 0xFFFF);
        let low = a_0.wrapping_mul(b_0);
        let middle = a_1.wrapping_mul(b_0).wrapping_add(low >> 16);
        let last = a_0.wrapping_mul(b_1).wrapping_add(middle & 0xFFFF);
        let high = a_1.wrapping_mul(b_1).wrapping_add(middle >> 16).wrapping_add(last >> 16);
        // With `a.wrapping_mul(b)` as lower word the compiler would make its routine of all this.
        u64::from(high) << 32 | u64::from(last << 16 | low & 0xFFFF)
    }

    #[cfg_attr(not(test), inline(never))]
    pub(super) fn leading_zeros(mut x: u32) -> u32 {
        const OF_NIBBLE: [u8; 16] = [4, 3, 2, 2, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0];
        let mut n = 0;
        for step in [16, 8, 4] {
            if x >> (32 - step) == 0 {
                (n, x) = (n + step, x << step);
            }
        }
        n + u32::from(OF_NIBBLE[(x >> 28) as usize])
    }
}

/// `p >> 24`, saturated, rounded down: with the product four instructions on Cortex-M4, where rounding to
/// nearest takes six. The bias of half an LSB is 3e-8; integrators take the product unrounded.
#[inline]
fn narrow(p: i64) -> i32 {
    let hi = ((p >> 32) as i32).clamp(-(1 << 23), (1 << 23) - 1);
    (hi << 8) | ((p as u32) >> 24) as i32
}

impl Add for Q {
    type Output = Self;
    #[inline]
    fn add(self, o: Self) -> Self {
        Self(self.0.saturating_add(o.0))
    }
}
impl Sub for Q {
    type Output = Self;
    #[inline]
    fn sub(self, o: Self) -> Self {
        Self(self.0.saturating_sub(o.0))
    }
}
impl Mul for Q {
    type Output = Self;
    #[inline]
    fn mul(self, o: Self) -> Self {
        Self(rounded(self.0, o.0))
    }
}
impl Neg for Q {
    type Output = Self;
    #[inline]
    fn neg(self) -> Self {
        Self(0_i32.saturating_sub(self.0))
    }
}
impl AddAssign for Q {
    #[inline]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}
impl SubAssign for Q {
    #[inline]
    fn sub_assign(&mut self, o: Self) {
        *self = *self - o;
    }
}
impl MulAssign for Q {
    #[inline]
    fn mul_assign(&mut self, o: Self) {
        *self = *self * o;
    }
}
impl num_traits::Zero for Q {
    fn zero() -> Self {
        Self(0)
    }
    fn is_zero(&self) -> bool {
        self.0 == 0
    }
}
impl num_traits::One for Q {
    fn one() -> Self {
        Self::ONE
    }
}

impl Real for Q {
    type Sum = Wide;
    type Quick = Wide;

    const ZERO: Self = Self(0);
    const HALF: Self = Self(1 << 23);
    const ONE: Self = Self(1 << 24);
    const TWO: Self = Self(1 << 25);
    const NAME: &'static str = "q";
    const LARGEST: f64 = 127.9;
    const LEAST_GAIN: f64 = 16.0 / 16_777_216.0;

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)]
    fn from_f64(x: f64) -> Self {
        // `as` saturates and takes NaN for zero.
        let scaled = x * f64::from(1 << Self::FRAC);
        Self((scaled + if scaled < 0.0 { -0.5 } else { 0.5 }) as i32)
    }
    fn to_f64(self) -> f64 {
        f64::from(self.0) / f64::from(1 << Self::FRAC)
    }
    #[inline]
    #[allow(clippy::cast_possible_truncation)]
    fn from_f32(x: f32) -> Self {
        let scaled = x * 16_777_216.0;
        Self((scaled + if scaled < 0.0 { -0.5 } else { 0.5 }) as i32)
    }
    #[inline]
    #[allow(clippy::cast_precision_loss)]
    fn to_f32(self) -> f32 {
        self.0 as f32 * (1.0 / 16_777_216.0)
    }
    #[inline]
    fn is_finite(self) -> bool {
        true
    }

    /// Newton on the mantissa `m` in [1/2, 1): start `48/17 - 32/17 m` (error 1/17), three steps square
    /// it to below 2^-32.
    #[inline]
    fn recip(self) -> Self {
        let magnitude = self.0.unsigned_abs();
        if magnitude < (1 << 17) {
            // 1/x beyond the range.
            return Self(if self.0 < 0 { -i32::MAX } else { i32::MAX });
        }
        let shift = leading_zeros(magnitude);
        let m = magnitude << shift; // Q32 in [1/2, 1)
        // y in Q30, 1/m in (1, 2].
        let mut y = 0xB4B4_B4B4_u32.wrapping_sub(mul_hi(m, 0x7878_7878));
        for _ in 0..3 {
            let two_minus = 0x8000_0000_u32.wrapping_sub(mul_hi(m, y)); // 2 - m y, Q30
            y = (product_unsigned(y, two_minus) >> 30) as u32;
        }
        // x = m·2^(8-shift), 1/x = y·2^(shift-8): Q30 → Q24 is >> 6. The shift is at most 14 here.
        let down = 14_u32.wrapping_sub(shift) & 31;
        let r = (y.saturating_add((1_u32 << down) >> 1) >> down).min(i32::MAX as u32) as i32;
        Self(if self.0 < 0 { -r } else { r })
    }

    #[cold]
    #[inline(never)]
    fn recip_seldom(self) -> Self {
        self.recip()
    }

    #[inline(always)]
    fn dividend(self) -> Self {
        self
    }
    /// As [`Real::recip`] with two steps of Newton's method, whose products are upper words.
    #[inline]
    fn over_64(self, y: Self) -> Self {
        let shift = leading_zeros(y.0 as u32) & 31;
        let m = (y.0 as u32) << shift;
        let mut inv = 0xB4B4_B4B4_u32.wrapping_sub(mul_hi(m, 0x7878_7878));
        for _ in 0..2 {
            inv = mul_hi(inv, 0x8000_0000_u32.wrapping_sub(mul_hi(m, inv))) << 2;
        }
        // x·inv is Q54, its upper word Q22; 1/y = inv·2^(shift-8), and 64 = 2^6: together 2^(shift-12).
        let quotient = mul_hi(self.0 as u32, inv);
        Self(if shift < 12 { quotient >> (12 - shift) } else { quotient << (shift - 12) } as i32)
    }

    #[inline(always)]
    fn over_64_of_negative(self, y: Self) -> Self {
        -self.over_64(-y)
    }

    /// Mantissa `m` in [1/4, 1) by an even shift, start by a parabola, three Newton steps
    /// `y ← y (3 - m y²)/2`.
    #[inline]
    fn rsqrt(self) -> Self {
        if self.0 < (1 << 10) {
            return Self(i32::MAX);
        }
        let x = self.0 as u32;
        let shift = leading_zeros(x) & !1;
        let m = x << shift; // Q32 in [1/4, 1)
        // Parabola through 1/√m at Chebyshev-like points, Q29; 1/√m in (1, 2].
        // y0 = 2.60 - 3.12 m + 1.55 m²; worst relative error below 4 %.
        let m2 = mul_hi(m, m);
        const C0: u32 = 1_395_864_371; // 2.60 in Q29
        const C1: u32 = 1_675_037_245; // 3.12 in Q29
        const C2: u32 = 832_149_914; // 1.55 in Q29
        let mut y = C0.wrapping_add(mul_hi(m2, C2)).wrapping_sub(mul_hi(m, C1));
        for _ in 0..3 {
            let y2 = mul_hi(y, y); // Q58>>32 = Q26
            let my2 = mul_hi(m, y2); // Q26
            let k = (3_u32 << 26).wrapping_sub(my2); // 3 - m y², Q26
            // y·k/2: Q29·Q26 = Q55, >> 27 gives Q29/2.
            y = (product_unsigned(y, k) >> 27) as u32;
        }
        // x = m·2^(8-shift): 1/√x = y·2^(shift/2 - 4); Q29 → Q24 is >> 5.
        let down = 9_i32 - (shift >> 1) as i32;
        let r = if down > 0 { (y + (1 << (down - 1))) >> down } else { y << -down };
        Self(r.min(i32::MAX as u32) as i32)
    }

    #[inline]
    fn half(self) -> Self {
        Self(self.0 >> 1)
    }
    #[inline]
    fn quarter(self) -> Self {
        Self(self.0 >> 2)
    }
    #[inline]
    fn periods(self, n: u32) -> Self {
        // In two parts: a number of periods is without sign.
        let x = self.0 >> 6;
        let x = (product(x, (n >> 1) as i32) << 1) + i64::from(if n & 1 == 0 { 0 } else { x });
        Self(x.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32)
    }

    #[inline]
    fn fraction(n: i16) -> Self {
        Self(i32::from(n) << (Self::FRAC - 15))
    }

    #[inline]
    fn quantise(self, timer: &Timer) -> (u32, Self) {
        // Q30 times four full counts, rounded: the upper word (SMMULR) is the count.
        let n = ((product(self.0 << 6, (timer.full() << 2) as i32) + (1 << 31)) >> 32) as u32;
        (n, Self(mul_hi(n << timer.shift, timer.recip_q) as i32))
    }

    #[inline(always)]
    fn times(self, literal: f64) -> Self {
        // The upper word of x (c 2^8), which is x c 2^-24 rounded down as in `narrow`: one instruction (SMMUL). From 1/2 on
        // as x + x (c - 1), also one (SMMLA).
        let c = Self::from_f64(literal).0;
        debug_assert!((-(1 << 23)..=1 << 24).contains(&c), "{literal}");
        let (c, whole) = if c < 1 << 23 { (c, 0) } else { (c - (1 << 24), self.0) };
        Self(whole.wrapping_add(upper(self.0, c << 8)))
    }
    #[inline]
    fn dot(a: [Self; 2], b: [Self; 2]) -> Self {
        // Only twice 2^62 is beyond i64: both factors of both products at -128, which no limited signal is.
        Self(narrow(wide(a[0], b[0]).wrapping_add(wide(a[1], b[1]))))
    }
    #[inline]
    fn cross(a: [Self; 2], b: [Self; 2]) -> Self {
        Self(narrow(wide(a[0], b[1]).wrapping_sub(wide(a[1], b[0]))))
    }
    #[inline]
    fn sum_of_products<const T: usize>(a: [Self; T], b: [Self; T]) -> Self {
        // Coefficients below 40 times anything: six such products are below 2^63.
        let mut sum = 0_i64;
        for (x, y) in a.into_iter().zip(b) {
            sum = sum.wrapping_add(wide(x, y));
        }
        Self(narrow(sum))
    }
    #[inline]
    fn sum_of_squares<const T: usize>(a: [Self; T]) -> Self {
        const { assert!(T <= 3) };
        // Three times 2^62 is within 64 bits without a sign.
        let sum = a.into_iter().fold(0_u64, |sum, x| sum.wrapping_add(wide(x, x) as u64));
        let hi = ((sum >> 32) as u32).min((1 << 23) - 1);
        Self((hi << 8 | (sum as u32) >> 24) as i32)
    }
    #[inline]
    fn within(self, bound: Self) -> bool {
        debug_assert!(bound.0 >= 0, "{bound:?}");
        // One unsigned comparison: -bound ..= bound moved to 0 ..= 2 bound.
        self.0.wrapping_add(bound.0) as u32 <= (bound.0 as u32) << 1
    }
}

impl Words for Q {
    const BLANK: Self = Self(0);
    fn is_representable(&self) -> bool {
        // Saturation ends at the bounds.
        self.0 != i32::MAX && self.0 != i32::MIN
    }
    fn put(&self, out: &mut impl FnMut(u32)) {
        out(self.0 as u32);
    }
    fn fill(&mut self, from: &mut impl FnMut() -> u32) {
        *self = Self(from() as i32);
    }
}

/// Q15.48: the full product of two [`Q`] is added without rounding. Aligned as the words around it: as the `i64` that it is
/// it would leave gaps in nearly every state that holds one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(from = "i64", into = "i64"))]
#[repr(C, packed(4))]
pub struct Wide(i64);

impl From<i64> for Wide {
    fn from(sum: i64) -> Self {
        Self(sum)
    }
}
impl From<Wide> for i64 {
    fn from(sum: Wide) -> Self {
        sum.0
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Wide {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "{}", i64::from(*self));
    }
}

impl Sum<Q> for Wide {
    #[inline]
    fn of(x: Q) -> Self {
        Self(i64::from(x.0) << Q::FRAC)
    }
    #[inline]
    fn accumulate(&mut self, gain: Q, x: Q) {
        // |product| <= 2^62; the sum is kept within ±2^55 (±128), so no overflow. Saturating the upper word
        // alone (one SSAT) lands within 2^-16 of the bound.
        let s = self.0 + wide(gain, x);
        let hi = ((s >> 32) as i32).clamp(-(1 << 23), (1 << 23) - 1);
        self.0 = i64::from(hi) << 32 | (s & 0xFFFF_FFFF);
    }
    #[inline]
    fn value(self) -> Q {
        // `self >> 24` by words: the compiler multiplies a number that it has seen as 64 bits by three instructions.
        let sum = self.0;
        Q(((sum >> 32) as i32) << 8 | (sum as u32 >> 24) as i32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fixed::types::I8F24;
    use proptest::prelude::*;

    fn oracle_close(got: Q, want: f64, rel: f64) -> bool {
        (got.to_f64() - want).abs() <= rel * want.abs() + 1.01 / f64::from(1 << 24)
    }

    #[test]
    fn products_of_halves_are_the_product_at_every_carry() {
        // Half words around every sum that carries or changes sign.
        let halves = [0_u32, 1, 2, 0x7FFE, 0x7FFF, 0x8000, 0x8001, 0xFFFE, 0xFFFF, 0x00FF, 0x0100, 0x5555, 0xAAAA];
        let words = || halves.iter().flat_map(|h| halves.iter().map(move |l| h << 16 | l));
        for a in words() {
            for b in words() {
                assert_eq!(halves::product_unsigned(a, b), u64::from(a) * u64::from(b));
                assert_eq!(halves::leading_zeros(a), a.leading_zeros());
                let (a, b) = (a as i32, b as i32);
                assert_eq!(halves::product(a, b), i64::from(a) * i64::from(b));
                assert_eq!(halves::upper(a, b), upper(a, b));
                assert_eq!(halves::rounded(a, b), (Q(a) * Q(b)).0);
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4096))]

        #[test]
        fn sum_and_difference_saturate_like_the_oracle(a: i32, b: i32) {
            let (x, y) = (I8F24::from_bits(a), I8F24::from_bits(b));
            prop_assert_eq!((Q(a) + Q(b)).0, x.saturating_add(y).to_bits());
            prop_assert_eq!((Q(a) - Q(b)).0, x.saturating_sub(y).to_bits());
        }

        #[test]
        fn a_product_with_a_literal_is_the_product(a: i32) {
            for c in [-0.5, -0.3, 0.0, 1e-3, 1.0 / 3.0, 0.499_999_9, 0.5, 0.577_350_269_189_625_8, 0.866_025_4, 1.0] {
                for a in [a, i32::MIN, i32::MAX, a >> 12] {
                    prop_assert_eq!(Q(a).times(c), Q(a) * Q::from_f64(c), "{} {}", a, c);
                }
            }
        }

        #[test]
        fn products_of_halves_are_the_product(a: i32, b: i32, m in 0_u32..32, n in 0_u32..32) {
            for (a, b) in [(a, b), (a >> m, b >> n), (a << m, b << n)] {
                prop_assert_eq!(halves::product(a, b), i64::from(a) * i64::from(b));
                prop_assert_eq!(halves::upper(a, b), upper(a, b));
                prop_assert_eq!(halves::rounded(a, b), (Q(a) * Q(b)).0);
                let (a, b) = (a as u32, b as u32);
                prop_assert_eq!(halves::product_unsigned(a, b), u64::from(a) * u64::from(b));
                prop_assert_eq!(halves::leading_zeros(a), a.leading_zeros());
            }
        }

        #[test]
        fn product_rounds_down_and_saturates(a: i32, b: i32) {
            let exact = i128::from(a) * i128::from(b);
            let want = (exact >> 24).clamp(i128::from(i32::MIN), i128::from(i32::MAX)) as i32;
            let got = (Q(a) * Q(b)).0;
            // At saturation the low byte is arbitrary.
            if want == i32::MAX || want == i32::MIN {
                prop_assert_eq!(got >> 8, want >> 8);
            } else {
                prop_assert_eq!(got, want);
            }
        }

        #[test]
        fn products_in_pairs_round_once_and_saturate(a: [i32; 2], b: [i32; 2]) {
            prop_assume!((a, b) != ([i32::MIN; 2], [i32::MIN; 2]));
            let product = |i: usize, k: usize| i128::from(a[i]) * i128::from(b[k]);
            for (exact, got) in [
                (product(0, 0) + product(1, 1), Q::dot(a.map(Q), b.map(Q))),
                (product(0, 0) + product(1, 1), Q::sum_of_products(a.map(Q), b.map(Q))),
                (product(0, 1) - product(1, 0), Q::cross(a.map(Q), b.map(Q))),
            ] {
                let want = (exact >> 24).clamp(i128::from(i32::MIN), i128::from(i32::MAX)) as i32;
                if want == i32::MAX || want == i32::MIN {
                    prop_assert_eq!(got.0 >> 8, want >> 8);
                } else {
                    prop_assert_eq!(got.0, want);
                }
            }
        }

        #[test]
        fn within_is_a_comparison_of_the_magnitude(x: i32, bound in 0..=i32::MAX) {
            prop_assert_eq!(Q(x).within(Q(bound)), i64::from(x).abs() <= i64::from(bound));
        }

        #[test]
        fn small_products_agree_with_the_oracle(a in -(8 << 24)..(8 << 24), b in -(8 << 24)..(8 << 24)) {
            let want = I8F24::from_bits(a).saturating_mul(I8F24::from_bits(b)).to_bits();
            prop_assert!(((Q(a) * Q(b)).0 - want).abs() <= 1);
        }

        #[test]
        fn reciprocal_is_accurate(a in (1 << 18)..i32::MAX) {
            let x = Q(a);
            prop_assert!(oracle_close(x.recip(), 1.0 / x.to_f64(), 3e-9), "{} {}", x.to_f64(), x.recip().to_f64());
            prop_assert_eq!((-x).recip(), -x.recip());
        }

        #[test]
        fn rsqrt_is_accurate(a in (1 << 12)..i32::MAX) {
            let x = Q(a);
            prop_assert!(oracle_close(x.rsqrt(), 1.0 / x.to_f64().sqrt(), 2e-7), "{} {}", x.to_f64(), x.rsqrt().to_f64());
        }

        #[test]
        fn nothing_panics(a: i32, b: i32) {
            let (x, y) = (Q(a), Q(b));
            let _ = (-x, x.abs(), x.recip(), x.rsqrt(), x.sqrt(), x * y + x - y);
            let _ = (Q::dot([x, y], [y, x]), Q::cross([x, y], [y, x]), x.within(y.abs()));
            let mut s = <Wide as Sum<Q>>::of(x);
            for _ in 0..8 { s.accumulate(y, y); s.accumulate(x, x); }
            let _: Q = s.value();
        }
    }

    #[test]
    fn integrator_carries_increments_below_one_lsb() {
        let mut s = crate::scalar::Integrator::<Q>::new(Q::ONE);
        for _ in 0..1_000_000 {
            s.add(Q(200), Q(300)); // 2.1e-10 each, one LSB is 6e-8
        }
        let want = 1.0 + 1e6 * 200.0 * 300.0 / 2f64.powi(48);
        assert!((s.value().to_f64() - want).abs() < 1e-7);
    }

    #[test]
    fn the_negative_of_the_smallest_is_the_largest() {
        assert_eq!(-Q(i32::MIN), Q::MAX);
        assert_eq!((Q(i32::MIN).abs(), -Q(i32::MAX)), (Q::MAX, Q(-i32::MAX)));
    }
}
