//! What the filter tells of a field that stands, and the turn of its flux ([`crate::control::sides`]).

use super::{Filter, FilterConfig};
use crate::control::sides::{Quantities, StandingField};
use crate::scalar::Real;
use crate::space::Rotator;

impl<R: Real> Filter<R> {
    /// The largest recent torque current over the magnetising one, up to one.
    #[inline(always)]
    pub fn load_of_late(&self) -> R {
        self.load.of_late()
    }

    /// `γ` and `c` of the magnetising curve.
    #[inline(always)]
    pub fn magnetising_curve(&self) -> (R, R) {
        (self.gamma.value(), self.c.value())
    }

    /// The flux of a field that stands, with a magnetising curve `(γ, c)`; `omega_m`: the speed.
    #[cold]
    #[inline(never)]
    pub fn standing_field(&self, c: &FilterConfig<R>, (gamma, saturated): (R, R), omega_m: R) -> StandingField<R> {
        let (flux, i_s) = (self.rotor_flux(c), self.i_s);
        let psi_r = flux.norm_sq().sqrt();
        let (inv, l_m) = (self.point.inv_psi_r, c.model.l_m);
        let now = Quantities {
            magnetised: gamma * c.model.curve(psi_r, saturated).m_g,
            along: flux.dot(&i_s) * inv * l_m,
            across: flux.cross(&i_s) * inv * l_m,
            i_s,
            omega_m,
        };
        StandingField { psi_r, sigma: self.sigma, now }
    }

    /// Turns the rotor flux by an angle. The covariance stays as it is.
    #[cold]
    #[inline(never)]
    pub fn turn_flux(&mut self, c: &FilterConfig<R>, by: &Rotator<R>) {
        let psi_r = by.turn(&self.rotor_flux(c));
        self.psi_s.set(psi_r + self.i_s * self.sigma_l_s(c));
    }
}
