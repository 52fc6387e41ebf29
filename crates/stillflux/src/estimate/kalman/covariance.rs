//! Packed symmetric matrix: algebra of the covariance, independent of the meaning of the states.
//!
//! ```text
//! P ← F P Fᵀ                    prediction, F differs from the identity in one row
//! P ← P + Q                     process noise, Q diagonal
//! P ← P - (P h)(P h)ᵀ/S         update by a scalar measurement
//! ```
//!
//! Of `P = Pᵀ` only the lower triangle is stored, row after row. The matrix is not kept positive definite by its form:
//! rounding is countered by a floor of the variances in the update.

use crate::scalar::Real;

/// Number of states.
pub(super) const N: usize = 11;
/// Elements of the lower triangle.
const PACKED: usize = N * (N + 1) / 2;

/// A vector over the states.
pub(super) type Column<R> = [R; N];

/// Symmetric matrix over the states.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct Covariance<R: Real> {
    /// Row after row of the lower triangle, cut into pieces of `N`.
    p: [[R; N]; N.div_ceil(2)],
}

/// A column whose elements a closure computes, written out: in a loop, fixed point would compute the position of every
/// element of the covariance at run time.
macro_rules! written_out {
    ($of:ident) => {
        [$of(0), $of(1), $of(2), $of(3), $of(4), $of(5), $of(6), $of(7), $of(8), $of(9), $of(10)]
    };
}

/// Position of element `(i, j)` or `(j, i)`.
#[inline(always)]
const fn at(i: usize, j: usize) -> usize {
    let (i, j) = if i >= j { (i, j) } else { (j, i) };
    // The minimum keeps the index in range for the compiler to see: no bounds check, no panic path.
    let k = i * (i + 1) / 2 + j;
    if k < PACKED { k } else { PACKED - 1 }
}

impl<R: Real> Default for Covariance<R> {
    fn default() -> Self {
        Self { p: [[R::ZERO; N]; N.div_ceil(2)] }
    }
}

impl<R: Real> Covariance<R> {
    /// Independent states with these variances. In place: no copy of a matrix on the stack.
    #[cold]
    #[inline(never)]
    pub fn set_diagonal(&mut self, variance: &Column<R>) {
        self.p.as_flattened_mut().fill(R::ZERO);
        for (k, &v) in variance.iter().enumerate() {
            *self.get_mut(k, k) = v;
        }
    }

    /// One element.
    #[inline(always)]
    pub fn get(&self, i: usize, j: usize) -> R {
        self.p.as_flattened()[at(i, j)]
    }

    #[inline(always)]
    fn get_mut(&mut self, i: usize, j: usize) -> &mut R {
        &mut self.p.as_flattened_mut()[at(i, j)]
    }

    /// Sets one element.
    #[inline(always)]
    pub fn set(&mut self, i: usize, j: usize, x: R) {
        *self.get_mut(i, j) = x;
    }

    /// Adds a diagonal matrix.
    pub fn add(&mut self, variance: &Column<R>) {
        for (k, &v) in variance.iter().enumerate() {
            *self.get_mut(k, k) += v;
        }
    }

    /// Adds to one element.
    #[inline(always)]
    pub fn add_at(&mut self, i: usize, j: usize, x: R) {
        *self.get_mut(i, j) += x;
    }

    /// Prediction of one state, `x_I ← a x_I + Σ c_j x_j` with `j ≠ I`: row and column of a sparse transition. `row`
    /// is [`Covariance::project`] of the same terms.
    #[inline(always)]
    pub fn advance<const I: usize, const T: usize>(&mut self, a: R, terms: &[(usize, R); T], row: &Column<R>) {
        let own = self.get(I, I);
        let variance =
            a * (a * own + row[I] + row[I]) + R::sum_of_products(terms.map(|(_, c)| c), terms.map(|(j, _)| row[j]));
        let mut add = |k: usize| *self.get_mut(I, k) = a * self.get(I, k) + row[k];
        let _: [(); N] = written_out!(add);
        *self.get_mut(I, I) = variance;
    }

    /// Prediction of one state by another, `x_I ← x_I + c x_J`.
    #[inline(always)]
    pub fn advance_by<const I: usize, const J: usize>(&mut self, c: R) {
        let (own, mixed, other) = (self.get(I, I), self.get(I, J), self.get(J, J));
        let mut add = |k: usize| {
            let by_other = c * self.get(J, k);
            *self.get_mut(I, k) += by_other;
        };
        let _: [(); N] = written_out!(add);
        *self.get_mut(I, I) = own + c * (mixed + mixed + c * other);
    }

    /// The same as [`Covariance::advance`] for one of the first two states, a vector whose components have rows of the same shape:
    /// `x_0 ← x_0 + Σ c_j x_j`, the first term with `j = O`, or `x_1` with the first of `x_(O+1)` (`second`). One code
    /// for both.
    #[inline(always)]
    pub fn advance_pair<const O: usize, const T: usize>(&mut self, second: bool, terms: &[(usize, R); T]) {
        let from = usize::from(second);
        let element = |k: usize| self.pair_row::<O, T>(from, terms, k);
        let row: Column<R> = written_out!(element);
        let (of_self, first) = if second { (row[1], row[O + 1]) } else { (row[0], row[O]) };
        let of = |t: usize| if t == 0 { first } else { row[terms[t].0] };
        let variance = R::sum_of_products(terms.map(|(_, c)| c), core::array::from_fn(of));
        // Columns 0 and 1 lie side by side, also where the element is (0, 1) = (1, 0): with another origin all positions
        // are constants.
        let flat = self.p.as_flattened_mut();
        let Some(column) = flat.get_mut(from..).and_then(<[R]>::first_chunk_mut::<{ PACKED - 1 }>) else { return };
        for (k, r) in row.into_iter().enumerate() {
            column[at(k, 0)] += r;
        }
        // The element of the variance has got the row once.
        column[from] += of_self + variance;
    }

    /// Element of the row that [`Covariance::advance_pair`] adds.
    #[inline(always)]
    fn pair_row<const O: usize, const T: usize>(&self, from: usize, terms: &[(usize, R); T], k: usize) -> R {
        // Row O + 1 begins O + 1 elements behind row O; columns O and O + 1 lie side by side.
        let of_first = self.p.as_flattened()[at(O, k) + if k <= O { (O + 1) * from } else { from }];
        let of = |t: usize| if t == 0 { of_first } else { self.get(terms[t].0, k) };
        R::sum_of_products(terms.map(|(_, c)| c), core::array::from_fn(of))
    }

    /// `P h` for a sparse `h`.
    #[inline(always)]
    pub fn project<const T: usize>(&self, h: &[(usize, R); T]) -> Column<R> {
        let of = |k: usize| R::sum_of_products(h.map(|(_, c)| c), h.map(|(j, _)| self.get(j, k)));
        written_out!(of)
    }

    /// Sets the correlations of a state with all others to zero; its variance stays.
    #[inline(always)]
    pub fn isolate<const I: usize>(&mut self) {
        let variance = self.get(I, I);
        let mut clear = |k: usize| *self.get_mut(I, k) = R::ZERO;
        let _: [(); N] = written_out!(clear);
        *self.get_mut(I, I) = variance;
    }

    /// Multiplies the correlations of a state with all others by a `factor` from 0 to 1; its variance stays. `P` stays
    /// positive: the result is the mean of itself and of the isolated one, with these weights.
    #[inline(always)]
    pub fn fade<const I: usize>(&mut self, factor: R) {
        let variance = self.get(I, I);
        let mut fade = |k: usize| {
            let of = self.get_mut(I, k);
            *of *= factor;
        };
        let _: [(); N] = written_out!(fade);
        *self.get_mut(I, I) = variance;
    }

    /// Multiplies the deviations of the first two states, a vector, by a `factor` from 0 to 1, and their correlations with
    /// them: `P ← D P D` with a diagonal `D`, positive as `P` is.
    #[cold]
    #[inline(never)]
    pub fn shrink_pair(&mut self, factor: R) {
        for i in 0..2 {
            for k in 0..N {
                *self.get_mut(i, k) *= factor;
            }
            *self.get_mut(i, i) *= factor;
        }
    }

    /// Sets the variance of a state and its correlations to zero.
    pub fn clear(&mut self, i: usize) {
        for k in 0..N {
            self.set(i, k, R::ZERO);
        }
    }

    /// Update of row `I`: `P ← P - (P h)(P h)ᵀ/S`, the variance not below a floor.
    #[inline(always)]
    pub fn reduce<const I: usize>(&mut self, ph: &Column<R>, inv_s: R, floor: R) {
        let gain = ph[I] * inv_s;
        for (j, y) in ph.iter().enumerate().take(I) {
            *self.get_mut(I, j) -= gain * *y;
        }
        let own = self.get_mut(I, I);
        *own = (*own - gain * ph[I]).max(floor);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::SMatrix;

    type Full = SMatrix<f64, N, N>;

    fn full(p: &Covariance<f64>) -> Full {
        Full::from_fn(|i, j| p.get(i, j))
    }

    /// A covariance with every element in use.
    fn sample() -> Covariance<f64> {
        let mut p = Covariance::default();
        p.set_diagonal(&[1.0, 2.0, 0.5, 3.0, 1.5, 0.7, 0.9, 1.1, 0.6, 0.4, 0.8]);
        for i in 0..N {
            for j in 0..i {
                p.add_at(i, j, 0.02 * (i as f64 - 0.7 * j as f64));
            }
        }
        p
    }

    #[test]
    fn advance_is_the_product_with_a_sparse_transition() {
        let mut p = sample();
        let before = full(&p);
        let (i, a, terms) = (2, 0.9, [(0, 0.3), (4, -0.2), (8, 0.05)]);
        let row = p.project(&terms);
        p.advance::<2, 3>(a, &terms, &row);
        let mut f = Full::identity();
        f[(i, i)] = a;
        for (j, c) in terms {
            f[(i, j)] = c;
        }
        assert!((full(&p) - f * before * f.transpose()).norm() < 1e-12);
    }

    #[test]
    fn advance_by_another_is_the_product_with_an_elementary_transition() {
        let mut p = sample();
        let before = full(&p);
        p.advance_by::<2, 8>(0.3);
        let mut f = Full::identity();
        f[(2, 8)] = 0.3;
        assert!((full(&p) - f * before * f.transpose()).norm() < 1e-12);
    }

    #[test]
    fn reduce_is_the_kalman_update() {
        let h = [(0, 0.6), (1, 0.8), (2, -1.0)];
        let mut row = SMatrix::<f64, 1, N>::zeros();
        for (j, c) in h {
            row[j] = c;
        }
        let mut p = sample();
        let before = full(&p);
        let ph = p.project(&h);
        let s = (row * before * row.transpose())[0] + 0.1;
        macro_rules! reduce {
            ($($i:literal)*) => { $(p.reduce::<$i>(&ph, 1.0 / s, 0.0);)* };
        }
        reduce!(0 1 2 3 4 5 6 7 8 9 10);
        assert!((full(&p) - (before - before * row.transpose() * row * before / s)).norm() < 1e-12);
    }

    #[test]
    fn a_smaller_deviation_of_the_flux_leaves_every_correlation_coefficient() {
        let mut p = sample();
        let before = full(&p);
        p.shrink_pair(0.5);
        let mut d = Full::identity();
        (d[(0, 0)], d[(1, 1)]) = (0.5, 0.5);
        assert!((full(&p) - d * before * d).norm() < 1e-12);
    }

    #[test]
    fn an_isolated_state_gets_nothing_from_a_measurement() {
        let mut p = sample();
        p.isolate::<5>();
        let ph = p.project(&[(0, 1.0), (2, -1.0)]);
        assert_eq!(ph[5], 0.0);
        assert_eq!(p.get(5, 5), 0.7);
    }
}
