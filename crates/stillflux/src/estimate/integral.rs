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
