//! Leakage inductance: a square voltage of some 100 Hz on direct current.
//!
//! ```text
//! L_σ = T_s Σ s (u - R' i)/Σ s Δi       s = ±1: sign of the square voltage
//! ```
//!
//! summed over the periods of each ramp but the first two: by then the eddy currents of the iron, which follow the
//! voltage, have settled and no longer contribute to `Δi`. The sign is known without error, so that noise of the current
//! does not bias the result (instrumental variable). Ramps last [`RAMP`] periods; the direct current of 0.8 pu keeps
//! every phase away from its current zero and alternates before the rotor flux builds up.
//!
//! **Valid** at the frequency of the square voltage, `f_s/(2 RAMP)`, at small flux: the total leakage as the high
//! frequency sees it, without what a deep bar adds at slip frequency.

use super::excitation::{Command, Sample};
use crate::scalar::{Integrator, Real};

/// Periods of a ramp, and those at its beginning that are not used.
pub const RAMP: u32 = 6;
const SKIP: u32 = 2;
/// Direct current, and peak-to-peak value of the ramps, per unit.
const BIAS: f64 = 0.8;
pub(super) const SWING: f64 = 0.2;
/// Plateaus, alternating in sign.
const PLATEAUS: u32 = 8;

/// State and record.
#[derive(Clone, Copy, Debug)]
pub(super) struct Leakage<R: Real> {
    tick: u32,
    plateau: u32,
    u: Integrator<R>,
    di: Integrator<R>,
    i: Integrator<R>,
}

/// Periods of the whole procedure.
pub(super) fn duration(settle: u32) -> u32 {
    PLATEAUS * 2 * settle
}

impl<R: Real> Leakage<R> {
    pub fn new() -> Self {
        Self { tick: 0, plateau: 0, u: Integrator::default(), di: Integrator::default(), i: Integrator::default() }
    }

    /// Whether all plateaus have been read.
    pub fn is_complete(&self) -> bool {
        self.plateau == PLATEAUS
    }

    /// One period with the amplitude `u` of the square voltage; `weight` is one over the periods. `None` at the end.
    pub fn step(&mut self, settle: u32, weight: R, u: R, x: &Sample<R>) -> Option<Command<R>> {
        let square = |tick: u32| tick.checked_sub(settle).map(|t| ((t / RAMP) % 2 == 1, t % RAMP));
        // The voltage between the last two samples is that of two calls ago.
        if let Some((negative, at)) = self.tick.checked_sub(2).and_then(square)
            && at >= SKIP
        {
            let sign = |x: R| if negative { -x } else { x };
            self.u.add(weight, sign(x.u));
            self.di.add(weight, sign(x.i - x.i_last));
            self.i.add(weight, sign((x.i + x.i_last).half()));
        }
        let injected = square(self.tick).map_or(R::ZERO, |(negative, _)| if negative { -u } else { u });
        self.tick += 1;
        if self.tick == 2 * settle {
            self.tick = 0;
            self.plateau += 1;
            if self.is_complete() {
                return None;
            }
        }
        let bias = R::from_f64(if self.plateau % 2 == 1 { -BIAS } else { BIAS });
        Some(Command::Current(bias, injected))
    }

    /// One over the periods, roughly: numerator and denominator share it.
    pub fn weight(settle: u32) -> R {
        R::from_f64(1.0 / f64::from(PLATEAUS * settle))
    }

    /// Leakage inductance, per unit, for the resistance `R'` and the control period.
    pub fn inductance(&self, r: f64, t_s: f64) -> f64 {
        let [u, di, i] = [self.u, self.di, self.i].map(|x| x.value().to_f64());
        t_s * (u - r * i) / di
    }
}
