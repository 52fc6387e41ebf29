//! Space vectors of the plant as pairs of numbers, stator coordinates.

use stillflux::space::AlphaBeta;

pub(crate) type V2 = [f64; 2];

#[inline(always)]
pub(crate) fn dot(a: V2, b: V2) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// `x + k y`
#[inline(always)]
pub(crate) fn axpy(x: V2, k: f64, y: V2) -> V2 {
    [x[0] + k * y[0], x[1] + k * y[1]]
}

/// `v` turned by the angle `d`; a small one by the series, whose next terms are 1e-14.
#[inline(always)]
pub(crate) fn turned(v: V2, d: f64) -> V2 {
    let (sin, cos) = if d.abs() < 0.3 {
        let x = d * d;
        let sin = 1.0 - x * (1.0 / 6.0) * (1.0 - x * 0.05 * (1.0 - x * (1.0 / 42.0) * (1.0 - x * (1.0 / 72.0))));
        let late = 1.0 - x * (1.0 / 30.0) * (1.0 - x * (1.0 / 56.0) * (1.0 - x * (1.0 / 90.0)));
        (d * sin, 1.0 - x * 0.5 * (1.0 - x * (1.0 / 12.0) * late))
    } else {
        libm::sincos(d)
    };
    [v[0] * cos - v[1] * sin, v[0] * sin + v[1] * cos]
}

const S3: f64 = 0.866_025_403_784_438_6;
/// Unit vectors of the three phase axes.
pub(crate) const AXIS: [V2; 3] = [[1.0, 0.0], [-0.5, S3], [-0.5, -S3]];

/// Phase quantities of a space vector.
#[inline(always)]
pub(crate) fn phases(v: V2) -> [f64; 3] {
    AlphaBeta::from(v).to_phases()
}

/// Space vector of three leg potentials; the common part drops out.
#[inline(always)]
pub(crate) fn space_vector(v: [f64; 3]) -> V2 {
    AlphaBeta::from_phases(v).into()
}
