//! Low-pass filter in place of the flux integrator: what Section II-C argues against.
//!
//! ```text
//! dψ̂_s/dτ = û_i - ω_c ψ̂_s
//! ```
//!
//! A dc component û_0 leaves a displacement û_0/ω_c instead of growing without bound. The price is paid at every
//! stator frequency: `ψ̂_s = ψ_s/(1 - jω_c/ω_s)`, so the field angle leads by `arctan(ω_c/ω_s)` and the magnitude is
//! its cosine. At five times the cutoff, which the paper gives as the limit of stable operation, that is 11.3° and
//! 0.98; at the cutoff 45°.
//!
//! Normalised like the integrator of [`super::flux`]; no state of its own.

use super::integral::FluxIntegral;
use crate::scalar::Real;
use crate::space::AlphaBeta;

/// One period of length `t_s` with the induced voltage `u_i`; `corner` is ω_c.
pub fn step<R: Real>(psi_s: &mut FluxIntegral<R>, t_s: R, corner: R, u_i: &AlphaBeta<R>) {
    let fed_back = psi_s.value() * corner;
    psi_s.add(t_s, &(*u_i - fed_back));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Angle error and magnitude after the transient, of a flux that turns at `ratio` times the cutoff.
    fn turned(ratio: f64) -> (f64, f64) {
        let (corner, t_s) = (0.01, 0.02);
        let omega = ratio * corner;
        let mut psi = FluxIntegral::new(AlphaBeta::new(1.0, 0.0));
        let n = (12.0 / (corner * t_s)) as u32;
        let at = |k: u32| (omega * t_s * f64::from(k)).sin_cos();
        for k in 0..n {
            let ((a, b), (c, d)) = (at(k), at(k + 1));
            step(&mut psi, t_s, corner, &AlphaBeta::new((d - b) / t_s, (c - a) / t_s));
        }
        let ((sin, cos), x) = (at(n), psi.value());
        let error = (x.im() * cos - x.re() * sin).atan2(x.re() * cos + x.im() * sin);
        (error.to_degrees(), psi.magnitude())
    }

    #[test]
    fn the_angle_leads_by_the_arc_tangent_of_cutoff_over_frequency() {
        for ratio in [1.0_f64, 5.0, 20.0] {
            let (angle, magnitude) = turned(ratio);
            let expected = (1.0 / ratio).atan();
            assert!((angle - expected.to_degrees()).abs() < 0.1, "{ratio}: {angle}");
            assert!((magnitude - expected.cos()).abs() < 2e-3, "{ratio}: {magnitude}");
        }
    }

    #[test]
    fn a_direct_voltage_displaces_by_its_ratio_to_the_cutoff() {
        let mut psi = FluxIntegral::new(AlphaBeta::new(0.0, 0.0));
        for _ in 0..200_000 {
            step(&mut psi, 0.02, 0.01, &AlphaBeta::new(0.002, -0.001));
        }
        assert!((psi.value() - AlphaBeta::new(0.2, -0.1)).norm_sq() < 1e-12, "{:?}", psi.value());
    }
}
