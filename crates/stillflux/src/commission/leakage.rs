//! Leakage inductance: a square voltage of some 100 Hz on direct current.
//!
//! ```text
//! L_σ = T_s Σ s (u - R' i)/Σ s Δi       s = ±1: sign of the square voltage
//! ```
//!
//! summed over the periods of each ramp but the first two: by then the eddy currents of the iron, which follow the
//! voltage, have settled and no longer contribute to `Δi`. The sign is known without error, so that noise of the current
//! does not bias the result (instrumental variable). Ramps last [`RAMP`] periods; the direct current keeps
//! every phase away from its current zero and alternates before the rotor flux builds up.
//!
//! **Saturation.** Ramps on a direct current `i` show the slope of the leakage flux, while the drive's model has its
//! chord. Of a leakage that falls with the square of the current, `ψ_σ = L_0 (1 - k i²) i`, the slope falls by three times as
//! much as the chord, and two direct currents tell the chord at the larger one:
//!
//! ```text
//! slope(i) = L_0 (1 - 3k i²)     chord(i_2) = slope(i_2) + 2 i_2² (slope(i_1) - slope(i_2))/(3 (i_2² - i_1²))
//! ```
//!
//! With the slope at 0.8 pu alone, 5 to 25 % less leakage at 1.5 pu made 3 to 25 % less of `L_σ`. The difference of chord and slope is
//! stated as a deviation: the leakage of other currents differs by about that.
//!
//! **Valid** at the frequency of the square voltage, `f_s/(2 RAMP)`, at small flux: the total leakage as the high
//! frequency sees it, without what a deep bar adds at slip frequency ([`super::magnetising`] finds their ratio).

use super::excitation::{Command, Sample};
use crate::scalar::{Integrator, Real};

/// Periods of a ramp, and those at its beginning that are not used.
pub const RAMP: u32 = 6;
const SKIP: u32 = 2;
/// Direct currents, and peak-to-peak value of the ramps, per unit.
const BIAS: [f64; 2] = [0.5, 0.8];
pub(super) const SWING: f64 = 0.2;
/// Chord less slope at the larger current, in units of the difference of the slopes.
const CHORD: f64 = 2.0 * BIAS[1] * BIAS[1] / (3.0 * (BIAS[1] * BIAS[1] - BIAS[0] * BIAS[0]));
/// Largest difference of the slopes that counts, in parts of the slope: beyond it a reading has failed.
const DIFFERENCE: f64 = 0.3;
/// Plateaus at each of them, alternating in sign, and of the whole procedure.
const PLATEAUS_EACH: u32 = 8;
const PLATEAUS: u32 = BIAS.len() as u32 * PLATEAUS_EACH;

/// State and record.
#[derive(Clone, Copy, Debug)]
pub(super) struct Leakage<R: Real> {
    tick: u32,
    plateau: u32,
    /// At each direct current: voltage, change of the current, current, with the sign of the square voltage.
    sums: [[Integrator<R>; 3]; BIAS.len()],
}

/// Periods of the whole procedure.
pub(super) fn duration(settle: u32) -> u32 {
    PLATEAUS * 2 * settle
}

impl<R: Real> Leakage<R> {
    pub fn new() -> Self {
        Self { tick: 0, plateau: 0, sums: Default::default() }
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
            let values = [x.u, x.i - x.i_last, (x.i + x.i_last).half()];
            for (sum, value) in self.sums[self.level()].iter_mut().zip(values) {
                sum.add(weight, if negative { -value } else { value });
            }
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
        let bias = R::from_f64(BIAS[self.level()]);
        Some(Command::Current(if self.plateau % 2 == 1 { -bias } else { bias }, injected))
    }

    /// Which of the direct currents flows.
    fn level(&self) -> usize {
        usize::from(self.plateau >= PLATEAUS_EACH)
    }

    /// One over the periods, roughly: numerator and denominator share it.
    pub fn weight(settle: u32) -> R {
        R::from_f64(1.0 / f64::from(PLATEAUS_EACH * settle))
    }

    /// Leakage inductance, per unit, for the resistance `R'` and the control period, and by what part its slope is less.
    pub fn inductance(&self, r: f64, t_s: f64) -> (f64, f64) {
        let [first, slope] = self.sums.map(|sums| {
            let [u, di, i] = sums.map(|x| x.value().to_f64());
            t_s * (u - r * i) / di
        });
        // No `clamp`, which panics where the slope is no number.
        let chord = slope + CHORD * (first - slope).max(0.0).min(DIFFERENCE * slope.abs());
        (chord, 1.0 - slope / chord)
    }
}
