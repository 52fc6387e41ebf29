//! The stator flux as an integral, and what control needs of it: the part both schemes share.

use crate::scalar::{Integrator, Real, likely};
use crate::space::{AlphaBeta, Rotator};

/// Flux, per unit, beyond which an estimate is lost and not a value to go on from.
const LOST: f64 = 3.0;

/// Integral of the induced voltage (compensated, so that no increment is lost in a minute at zero frequency),
/// with its direction and magnitude.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct FluxIntegral<R: Real> {
    psi_s: [Integrator<R>; 2],
    field: Rotator<R>,
    magnitude: R,
    /// `1/|ψ̂_s|`.
    inv_psi: R,
}

impl<R: Real> FluxIntegral<R> {
    /// Begins at a known flux.
    #[must_use]
    pub fn new(psi_s: AlphaBeta<R>) -> Self {
        let (field, magnitude, inv_psi) = Rotator::near(&psi_s, R::ZERO);
        Self { psi_s: [Integrator::new(psi_s.re()), Integrator::new(psi_s.im())], field, magnitude, inv_psi }
    }

    /// Another flux; direction and magnitude follow with the next period.
    #[inline]
    pub fn set(&mut self, psi_s: AlphaBeta<R>) {
        self.psi_s = [Integrator::new(psi_s.re()), Integrator::new(psi_s.im())];
    }

    /// One period with the voltage `u`.
    #[inline(always)]
    pub fn add(&mut self, t_s: R, u: &AlphaBeta<R>) {
        let psi_s = AlphaBeta::new(self.psi_s[0].add(t_s, u.re()), self.psi_s[1].add(t_s, u.im()));
        (self.field, self.magnitude, self.inv_psi) = Rotator::near(&psi_s, self.inv_psi);
    }

    /// One period with the voltage `u`, each component limited.
    #[cfg(feature = "variants")]
    pub fn add_limited(&mut self, t_s: R, u: &AlphaBeta<R>, bound: R) {
        let [a, b] = &mut self.psi_s;
        let psi_s = AlphaBeta::new(a.add_limited(t_s, u.re(), bound), b.add_limited(t_s, u.im(), bound));
        (self.field, self.magnitude, self.inv_psi) = Rotator::near(&psi_s, self.inv_psi);
    }

    /// Adds `gain · z` to each component; direction and magnitude follow with the next period.
    #[inline(always)]
    pub fn correct(&mut self, gain: [R; 2], z: R) {
        for (psi, gain) in self.psi_s.iter_mut().zip(gain) {
            psi.add_limited(gain, z, R::from_f64(LOST));
        }
    }

    /// Brings a lost estimate back.
    #[inline(always)]
    pub fn confine(&mut self) {
        if !likely(self.magnitude <= R::from_f64(LOST)) {
            self.set(self.value().limit_components(R::TWO));
        }
    }

    /// Present `ψ̂_s`.
    #[inline]
    pub fn value(&self) -> AlphaBeta<R> {
        AlphaBeta::new(self.psi_s[0].value(), self.psi_s[1].value())
    }

    /// Field angle as `e^{jδ̂}`.
    #[inline]
    pub fn field(&self) -> Rotator<R> {
        self.field
    }

    /// `|ψ̂_s|`.
    #[inline]
    pub fn magnitude(&self) -> R {
        self.magnitude
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corrections_stop_where_an_estimate_counts_as_lost() {
        let mut flux = FluxIntegral::new(AlphaBeta::new(1.0, -1.0));
        for _ in 0..100 {
            flux.correct([1.0, -1.0], 0.1);
        }
        assert_eq!(flux.value(), AlphaBeta::new(3.0, -3.0));
    }

    #[test]
    fn a_lost_estimate_comes_back_to_twice_the_rated_flux_and_a_healthy_one_stays() {
        for (psi, kept) in [(2.9, true), (3.1, false), (1e9, false), (f64::NAN, false)] {
            let mut flux = FluxIntegral::new(AlphaBeta::new(psi, 0.5));
            flux.confine();
            let value = flux.value();
            assert_eq!(value.re() == psi, kept, "{psi}");
            assert!(kept || (value.re().abs() == 2.0 && value.im() == 0.5), "{value:?}");
        }
    }

    #[test]
    fn direction_and_magnitude_are_those_of_the_integral() {
        let mut flux = FluxIntegral::new(AlphaBeta::new(0.3, 0.0));
        flux.add(0.5, &AlphaBeta::new(0.0, 0.8));
        assert!((flux.magnitude() - 0.5).abs() < 1e-9);
        assert!((flux.field().axis() - AlphaBeta::new(0.6, 0.8)).norm_sq() < 1e-18);
    }
}
