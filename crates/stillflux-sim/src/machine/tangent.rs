//! Derivative of the stator current by the stator flux: apply it, invert it.

use super::state::{FULL, LINEAR};
use super::vector::{V2, axpy, dot};

/// `∂i_s/∂psi_s = b + q psi psi^T + gap`, the last (αα, αβ, ββ) in [`FULL`] alone.
pub(crate) struct Tangent {
    pub b: f64,
    pub q: f64,
    pub psi: V2,
    pub gap: [f64; 3],
}

/// A symmetric matrix (αα, αβ, ββ) times `v`.
#[inline(always)]
pub(super) fn apply(m: &[f64; 3], v: V2) -> V2 {
    [m[0] * v[0] + m[1] * v[1], m[1] * v[0] + m[2] * v[1]]
}

impl Tangent {
    /// `∂i_s/∂psi_s` times `v`.
    #[inline(always)]
    pub fn apply<const KIND: u8>(&self, v: V2) -> V2 {
        let mut y = [self.b * v[0], self.b * v[1]];
        if KIND != LINEAR {
            y = axpy(y, self.q * dot(self.psi, v), self.psi);
        }
        if KIND == FULL {
            y = axpy(y, 1.0, apply(&self.gap, v));
        }
        y
    }

    /// `e^T ∂i_s/∂psi_s e` of a unit vector.
    #[inline(always)]
    pub fn along<const KIND: u8>(&self, e: V2) -> f64 {
        let p = dot(self.psi, e);
        let y = self.b + self.q * p * p;
        if KIND == FULL { y + dot(apply(&self.gap, e), e) } else { y }
    }

    /// No less than its largest eigenvalue.
    #[inline(always)]
    pub fn largest<const KIND: u8>(&self) -> f64 {
        let y = self.b + self.q * dot(self.psi, self.psi);
        if KIND == FULL { y + self.gap[0].max(self.gap[2]) + self.gap[1].abs() } else { y }
    }

    /// Its inverse times `w`; without [`FULL`] by Sherman-Morrison.
    #[inline(always)]
    pub fn solve<const KIND: u8>(&self, w: V2) -> V2 {
        if KIND == FULL {
            let (p, q, g) = (self.psi, self.q, self.gap);
            let m = [self.b + q * p[0] * p[0] + g[0], q * p[0] * p[1] + g[1], self.b + q * p[1] * p[1] + g[2]];
            let d = 1.0 / (m[0] * m[2] - m[1] * m[1]);
            return [d * (m[2] * w[0] - m[1] * w[1]), d * (m[0] * w[1] - m[1] * w[0])];
        }
        let k = -self.q * dot(self.psi, w) / (self.b + self.q * dot(self.psi, self.psi));
        let v = axpy(w, k, self.psi);
        [v[0] / self.b, v[1] / self.b]
    }
}
