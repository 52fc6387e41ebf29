//! Space vectors, the frames they live in, and the rotators between the frames.
//!
//! Amplitude-invariant space vectors `i_s = 2/3 (i_a + a i_b + a² i_c)`. A vector's frame is part of its
//! type: [`AlphaBeta`] is stator coordinates, [`Dq`] field coordinates; only a [`Rotator`] leads from one
//! to the other, so frames cannot be mixed by accident. No trigonometry: a rotator is a unit vector,
//! taken from a flux vector or turned by small angles.

use crate::scalar::Real;
use crate::words::Words;
use core::marker::PhantomData;
use core::ops::{Add, AddAssign, Mul, Neg, Sub};

/// Marker of stator coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stator;
/// Marker of field coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Field;

/// Space vector in the frame `F`; stored as its two components, which pass between functions in a register each. (A vector
/// of nalgebra holds an array: the compiler passes it as an integer, and moves it between both kinds of registers.)
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound = "F: Clone", from = "[R; 2]", into = "[R; 2]")
)]
pub struct Space<R: Real, F> {
    re: R,
    im: R,
    frame: PhantomData<F>,
}

/// Space vector in stator coordinates (α, β).
pub type AlphaBeta<R> = Space<R, Stator>;
/// Space vector in field coordinates (d, q).
pub type Dq<R> = Space<R, Field>;

impl<R: Real, F> From<[R; 2]> for Space<R, F> {
    fn from([re, im]: [R; 2]) -> Self {
        Self::new(re, im)
    }
}
impl<R: Real, F> From<Space<R, F>> for [R; 2] {
    fn from(v: Space<R, F>) -> Self {
        [v.re(), v.im()]
    }
}

impl<R: Real, F> Words for Space<R, F> {
    const LEN: usize = <[R; 2]>::LEN;
    const BLANK: Self = Self { re: R::ZERO, im: R::ZERO, frame: PhantomData };
    fn is_representable(&self) -> bool {
        [self.re(), self.im()].is_representable()
    }
    fn put(&self, out: &mut impl FnMut(u32)) {
        [self.re(), self.im()].put(out);
    }
    fn fill(&mut self, from: &mut impl FnMut() -> u32) {
        self.re.fill(from);
        self.im.fill(from);
    }
}

#[cfg(feature = "defmt")]
impl<R: Real, F> defmt::Format for Space<R, F> {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "({}, {})", self.re(), self.im());
    }
}

impl<R: Real, F> Default for Space<R, F> {
    fn default() -> Self {
        Self::new(R::ZERO, R::ZERO)
    }
}

impl<R: Real, F> Space<R, F> {
    /// From its real (α or d) and imaginary (β or q) component.
    #[inline]
    pub fn new(re: R, im: R) -> Self {
        Self { re, im, frame: PhantomData }
    }

    /// Real component.
    #[inline]
    pub fn re(&self) -> R {
        self.re
    }

    /// Imaginary component.
    #[inline]
    pub fn im(&self) -> R {
        self.im
    }

    /// Scalar product, `Re(conj(a) b)`.
    #[inline]
    pub fn dot(&self, o: &Self) -> R {
        R::dot([self.re, self.im], [o.re, o.im])
    }

    /// Cross product, `Im(conj(a) b)`; with `a` a flux and `b` a current the per-unit torque.
    #[inline]
    pub fn cross(&self, o: &Self) -> R {
        R::cross([self.re, self.im], [o.re, o.im])
    }

    /// Squared magnitude.
    #[inline]
    pub fn norm_sq(&self) -> R {
        self.dot(self)
    }

    /// Each component limited to `±bound`.
    // A call: only starts need it, and flash is short.
    #[inline(never)]
    pub fn limit_components(&self, bound: R) -> Self {
        Self::new(self.re.limit(bound), self.im.limit(bound))
    }

    /// Both components finite.
    pub fn is_finite(&self) -> bool {
        self.re.is_finite() && self.im.is_finite()
    }
}

impl<R: Real, F> Add for Space<R, F> {
    type Output = Self;
    #[inline]
    fn add(self, o: Self) -> Self {
        Self::new(self.re + o.re, self.im + o.im)
    }
}
impl<R: Real, F> AddAssign for Space<R, F> {
    #[inline]
    fn add_assign(&mut self, o: Self) {
        self.re += o.re;
        self.im += o.im;
    }
}
impl<R: Real, F> Sub for Space<R, F> {
    type Output = Self;
    #[inline]
    fn sub(self, o: Self) -> Self {
        Self::new(self.re - o.re, self.im - o.im)
    }
}
impl<R: Real, F> Mul<R> for Space<R, F> {
    type Output = Self;
    #[inline]
    fn mul(self, k: R) -> Self {
        Self::new(self.re * k, self.im * k)
    }
}
impl<R: Real, F> Neg for Space<R, F> {
    type Output = Self;
    #[inline]
    fn neg(self) -> Self {
        Self::new(-self.re, -self.im)
    }
}

/// `√3` and `√3/2`.
pub(crate) const SQRT_3: f64 = 1.732_050_807_568_877_2;
pub(crate) const HALF_SQRT_3: f64 = SQRT_3 / 2.0;

impl<R: Real> AlphaBeta<R> {
    /// Clarke transformation; a common (zero-sequence) part of the phase values drops out.
    #[inline]
    pub fn from_phases(abc: [R; 3]) -> Self {
        Self::from_lines([abc[0] - abc[2], abc[1] - abc[2]])
    }

    /// [`Self::from_phases`] of the values of phases a and b less that of phase c.
    #[inline]
    pub fn from_lines([ac, bc]: [R; 2]) -> Self {
        Self::new((ac + ac - bc).times(1.0 / 3.0), bc.times(0.577_350_269_189_625_8))
    }

    /// Phases a and b less phase c of [`Self::to_phases`].
    #[inline]
    pub fn to_lines(&self) -> [R; 2] {
        let h = self.im().times(HALF_SQRT_3);
        [self.re() + self.re().half() + h, h + h]
    }

    /// Inverse Clarke transformation without zero sequence.
    #[inline]
    pub fn to_phases(&self) -> [R; 3] {
        let half = self.re().half();
        let h = self.im().times(HALF_SQRT_3);
        [self.re(), h - half, -half - h]
    }
}

/// Unit vector `e^{jδ}`: the transformation into and out of field coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Rotator<R: Real> {
    /// `cos δ`.
    pub cos: R,
    /// `sin δ`.
    pub sin: R,
}

impl<R: Real> Default for Rotator<R> {
    fn default() -> Self {
        Self { cos: R::ONE, sin: R::ZERO }
    }
}

impl<R: Real> Rotator<R> {
    /// `ψ/|ψ|` and `|ψ|`; keeps the angle zero where the vector (nearly) vanishes.
    #[inline]
    pub fn of(v: &AlphaBeta<R>) -> (Self, R) {
        let (e, magnitude, _) = Self::anew(v, v.norm_sq());
        (e, magnitude)
    }

    /// [`Rotator::of`] from `1/|ψ|` of the period before; returns also the next one.
    #[inline]
    pub fn near(v: &AlphaBeta<R>, guess: R) -> (Self, R, R) {
        let n2 = v.norm_sq();
        match n2.rsqrt_next(guess) {
            Some(inv) => (Self { cos: v.re() * inv, sin: v.im() * inv }, n2 * inv, inv),
            None => Self::anew(v, n2),
        }
    }

    #[cold]
    #[inline(never)]
    fn anew(v: &AlphaBeta<R>, n2: R) -> (Self, R, R) {
        let inv = n2.rsqrt();
        let magnitude = n2 * inv;
        if magnitude > R::from_f64(0.01) {
            (Self { cos: v.re() * inv, sin: v.im() * inv }, magnitude, inv)
        } else {
            (Self::default(), magnitude, R::ZERO)
        }
    }

    /// The unit vector itself, in stator coordinates.
    #[inline]
    pub fn axis(&self) -> AlphaBeta<R> {
        AlphaBeta::new(self.cos, self.sin)
    }

    /// Stator → field coordinates, `e^{-jδ} v`.
    #[inline]
    pub fn to_field(&self, v: &AlphaBeta<R>) -> Dq<R> {
        let (e, v) = ([self.cos, self.sin], [v.re(), v.im()]);
        Dq::new(R::dot(e, v), R::cross(e, v))
    }

    /// Field → stator coordinates, `e^{jδ} v`.
    #[inline]
    pub fn to_stator(&self, v: &Dq<R>) -> AlphaBeta<R> {
        let e = [self.cos, self.sin];
        AlphaBeta::new(R::cross(e, [v.im(), v.re()]), R::dot(e, [v.im(), v.re()]))
    }

    /// A vector of stator coordinates turned by the angle, `e^{jδ} v`.
    #[inline]
    pub fn turn(&self, v: &AlphaBeta<R>) -> AlphaBeta<R> {
        self.to_stator(&Dq::new(v.re(), v.im()))
    }

    /// Turned by the angle of another one.
    #[inline]
    pub fn turned_by(&self, other: &Self) -> Self {
        self.times(other.cos, other.sin)
    }

    /// The opposite angle, `e^{-jδ}`.
    #[inline]
    pub fn reversed(&self) -> Self {
        Self { cos: self.cos, sin: -self.sin }
    }

    /// Turned by a small angle `x` (rad) to the second order: error of the angle `x³/6`, 2e-5 rad at 0.05, of
    /// the magnitude `x⁴/8`.
    #[inline]
    pub fn ahead(&self, x: R) -> Self {
        self.times(R::ONE - (x * x).half(), x)
    }

    /// Turned by `x` and renormalised by one Newton step, so that the magnitude stays at one however often this
    /// is repeated. Not `e^{jx}` but a vector of the same angle: `tan x = x / (1 - x²/3)` up to `x⁵/45`.
    #[inline]
    pub fn turned(&self, x: R) -> Self {
        let r = self.times(R::ONE - (x * x).times(1.0 / 3.0), x);
        let k = R::from_f64(1.5) - R::dot([r.cos, r.sin], [r.cos, r.sin]).half();
        Self { cos: r.cos * k, sin: r.sin * k }
    }

    /// The complex product with `c + js`.
    #[inline]
    fn times(&self, c: R, s: R) -> Self {
        let e = [self.cos, self.sin];
        Self { cos: R::cross(e, [s, c]), sin: R::dot(e, [s, c]) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_add_and_their_opposite_takes_them_back() {
        let at = |x: f64| Rotator { cos: x.cos(), sin: x.sin() };
        let (sum, v) = (at(0.3).turned_by(&at(-1.1)), AlphaBeta::new(0.7, -0.4));
        assert!((sum.sin + 0.8f64.sin()).abs() < 1e-15 && (sum.cos - 0.8f64.cos()).abs() < 1e-15);
        assert!((sum.reversed().turn(&sum.turn(&v)) - v).norm_sq() < 1e-30);
        assert!((at(0.5 * core::f64::consts::PI).turn(&v) - AlphaBeta::new(0.4, 0.7)).norm_sq() < 1e-30);
    }

    #[test]
    fn clarke_is_amplitude_invariant_and_drops_the_zero_sequence() {
        let v = AlphaBeta::<f64>::new(0.7, -0.4);
        let abc = v.to_phases();
        let w = AlphaBeta::from_phases([abc[0] + 0.3, abc[1] + 0.3, abc[2] + 0.3]);
        assert!((v - w).norm_sq() < 1e-28);
        assert!((abc[0] - 0.7).abs() < 1e-15);
    }

    #[test]
    fn rotator_turns_through_a_circle_and_stays_on_it() {
        let mut e = Rotator::<f32>::default();
        let n = 1_000_000_u32;
        for _ in 0..n {
            e = e.turned(0.1);
            assert!((e.cos * e.cos + e.sin * e.sin - 1.0).abs() < 1e-5);
        }
        let mut e = Rotator::<f64>::default();
        for _ in 0..10 {
            e = e.turned(0.3);
        }
        assert!((libm::atan2(e.sin, e.cos) - 3.0).abs() < 2e-3);
    }

    #[test]
    fn field_and_stator_coordinates_invert_each_other() {
        let (e, m) = Rotator::of(&AlphaBeta::new(-3.0_f64, 4.0));
        assert!((m - 5.0).abs() < 1e-12);
        let v = AlphaBeta::new(0.2, 1.1);
        assert!((e.to_stator(&e.to_field(&v)) - v).norm_sq() < 1e-24);
        assert!(Rotator::of(&AlphaBeta::<f64>::default()).0 == Rotator::default());
    }

    #[test]
    fn the_products_are_those_of_complex_numbers() {
        let (a, b) = (AlphaBeta::new(0.3, -0.8), AlphaBeta::new(1.1, 0.4));
        assert!((a.dot(&b) - (0.33 - 0.32)).abs() < 1e-15 && (a.cross(&b) - (0.12 + 0.88)).abs() < 1e-15);
    }

    #[test]
    fn a_vector_is_finite_with_both_components_only() {
        for (re, im, finite) in [(1.0, 2.0, true), (f64::NAN, 0.0, false), (0.0, f64::INFINITY, false)] {
            assert_eq!(AlphaBeta::new(re, im).is_finite(), finite);
        }
    }

    #[test]
    fn small_turns_are_exact_to_their_order() {
        let e = Rotator::<f64> { cos: libm::cos(1.0), sin: libm::sin(1.0) };
        for x in [0.05, -0.05, 0.2] {
            let r = e.ahead(x);
            let turned = libm::atan2(r.sin, r.cos) - 1.0 - x;
            let magnitude = libm::sqrt(r.cos * r.cos + r.sin * r.sin) - 1.0;
            assert!((turned - x * x * x / 6.0).abs() < 0.1 * (x * x * x).abs(), "{x} {turned}");
            assert!((magnitude - x * x * x * x / 8.0).abs() < 0.02 * x * x * x * x, "{x} {magnitude}");
        }
    }
}
