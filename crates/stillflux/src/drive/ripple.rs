//! What the ripple of the currents adds to the loss of the inverter model near current zero
//! ([`InverterModel::ripple`]), one leg after the other.

use crate::inverter::{Distortion, InverterModel, Knee};
use crate::scalar::{Real, likely};
use crate::space::AlphaBeta;

/// Of the three legs.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct Ripple<R: Real> {
    of: [R; 3],
    /// The leg that was computed last.
    leg: u8,
}

impl<R: Real> Ripple<R> {
    /// None yet.
    pub fn new() -> Self {
        Self { of: [R::ZERO; 3], leg: 0 }
    }

    /// The bridge is blocked.
    pub fn block(&mut self) {
        self.of = [R::ZERO; 3];
    }

    /// Ripple of the next leg; at larger voltages, where it does not count, the currents would have turned away before
    /// it is the leg's turn again. Where a step of the reference takes the currents away from their zeros it ends in all
    /// legs at once: equal voltages of the legs cancel, while legs that end one after the other would differ by up to `U` for
    /// eight periods.
    #[inline(never)]
    pub fn follow(
        &mut self,
        model: &InverterModel<R>,
        u_ref: &AlphaBeta<R>,
        i_ref: &AlphaBeta<R>,
        knee: &Knee<R>,
        loss: &Distortion<R>,
    ) {
        if u_ref.norm_sq() > model.ripple_within_sq() {
            self.of = [R::ZERO; 3];
            return;
        }
        self.leg = if self.leg < 2 { self.leg + 1 } else { 0 };
        let [of_a, of_b, of_c] = i_ref.to_phases();
        for (ripple, i) in self.of.iter_mut().zip([of_a, of_b, of_c]) {
            if !knee.is_near_zero(i) {
                *ripple = R::ZERO;
            }
        }
        let i = match self.leg {
            0 => of_a,
            1 => of_b,
            _ => of_c,
        };
        if !likely(!knee.is_near_zero(i)) {
            let (k, phases, u) = (usize::from(self.leg), [of_a, of_b, of_c], u_ref.to_phases());
            self.of[k % 3] = model.ripple(knee, k, (&phases, &u), loss);
        }
    }

    /// Adds it to the loss of the phases.
    #[inline(always)]
    pub fn add_to(&self, phases: &mut [R; 3]) {
        for (e, ripple) in phases.iter_mut().zip(&self.of) {
            *e += *ripple;
        }
    }
}
