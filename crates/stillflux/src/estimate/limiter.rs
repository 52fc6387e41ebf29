//! Integrator with limited components as flux estimator ([12] of the paper): what Section II-C argues against.
//!
//! ```text
//! ψ̂_s = limit(∫ û_i dτ, ±ψ_s*)   per component
//! ```
//!
//! A dc component drives the trajectory against one limit per axis, where it is clipped in every period: it cannot
//! accumulate, but with the component `d` half of a period moves the trajectory by `π d/ω_s`, and the clipped part is an
//! error of angle of the same size. The paper gives 2 to 3 Hz as the limit of stable operation. Fig. 4 uses the very same
//! trajectory (ψ̂_1) to *measure* the offset, and keeps it out of the field angle.
//!
//! Normalised like the integrator of [`super::flux`]; no state of its own.

use super::integral::FluxIntegral;
use crate::scalar::Real;
use crate::space::AlphaBeta;

/// One period of length `t_s` with the induced voltage `u_i`, limited to ±`psi_ref`.
pub fn step<R: Real>(psi_s: &mut FluxIntegral<R>, t_s: R, u_i: &AlphaBeta<R>, psi_ref: R) {
    psi_s.add_limited(t_s, u_i, psi_ref);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest angle error over the last of ten revolutions at `omega` with the dc component `d` on each axis.
    fn worst(omega: f64, d: f64) -> f64 {
        let t_s = 0.02;
        let n = (core::f64::consts::TAU / (omega * t_s)) as u32;
        let mut psi = FluxIntegral::new(AlphaBeta::new(1.0, 0.0));
        let at = |k: u32| (omega * t_s * f64::from(k)).sin_cos();
        (0..10 * n).fold(0.0, |most: f64, k| {
            let ((a, b), (c, e)) = (at(k), at(k + 1));
            step(&mut psi, t_s, &AlphaBeta::new((e - b) / t_s + d, (c - a) / t_s + d), 1.0);
            let x = psi.value();
            let error = (x.im() * e - x.re() * c).atan2(x.re() * e + x.im() * c).abs();
            if k > 9 * n { most.max(error) } else { most }
        })
    }

    #[test]
    fn without_offset_the_limits_are_not_touched() {
        assert!(worst(0.05, 0.0) < 1e-3);
    }

    #[test]
    fn the_angle_error_grows_with_the_offset_over_the_frequency() {
        let (fast, slow) = (worst(0.1, 5e-4), worst(0.01, 5e-4));
        assert!(fast > 5e-3 && fast < 0.05, "{fast}");
        assert!(slow > 6.0 * fast && slow < 0.5, "{slow}");
    }
}
