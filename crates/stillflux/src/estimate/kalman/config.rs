//! Settings of the filter: model, noise and block of a machine on a bridge.

use super::load::LOAD_TIME;
use super::model::{Model, Saturated};
#[cfg(feature = "supervision")]
use super::noise::NIS_CORNER;
use super::noise::{Identified, Noise};
use crate::base::{PerUnit, rounded};
use crate::estimate::priors::Priors;
use crate::estimate::temperature::{Temperature, TemperatureConfig};
use crate::params::{Inverter, Machine};
#[cfg(feature = "enhanced")]
use crate::params::{ParamError, check};
use crate::scalar::Real;
use crate::words::words;

/// Largest duration of a block of more than `SLOTS` periods: in s, in turns of the rated field, and in rotor time
/// constants. In a block the direction of the field is one, and the current model is integrated in one step.
const BLOCK_TIME: f64 = 2.5e-3;
const BLOCK_TURN: f64 = 0.13;
const BLOCK_DECAY: f64 = 0.05;
/// Least duration of the block for which noise is stated, s, and the rated frequency, Hz, for which it is.
const STATED_BLOCK_TIME: f64 = 1e-3;
const STATED_FREQUENCY: f64 = 50.0;
/// Slots of a block, the closing one included ([`super::schedule`]).
pub(super) const SLOTS: u32 = 10;
/// Largest binary logarithm of the control periods in a slot: the periods of a block are counted in a byte.
const SLOT_BITS_MAX: u8 = 3;

/// Settings of the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct FilterConfig<R: Real> {
    /// Control period, normalised time.
    pub(crate) t_s: R,
    /// Control periods in a block, and the reciprocal.
    pub(super) block: u8,
    pub(super) inv_block: R,
    /// Control periods in a slot, a power of two, less one, and its binary logarithm.
    pub(super) slot_mask: u8,
    pub(super) slot_bits: u8,
    pub(super) model: Model<R>,
    pub(super) noise: Noise<R>,
    /// Prior of `c`, the saturated part of the magnetising current.
    pub(super) saturation: R,
    /// Corner of the load's low-pass, per block; 0: no load is steady.
    pub(super) load_corner: R,
    /// Whether the innovation corrects anything.
    pub(super) correct: bool,
    pub(super) temperature: TemperatureConfig<R>,
}
words!(FilterConfig: t_s, block, inv_block, slot_mask, slot_bits, model, noise, saturation, load_corner, correct, temperature);

/// Control periods in the block for which noise is stated.
fn stated_periods(machine: &Machine, inverter: &Inverter) -> f64 {
    f64::from(SLOTS).max(STATED_BLOCK_TIME * STATED_FREQUENCY / machine.f_N * inverter.f_c())
}

/// Time constant of the NIS' low-pass, s.
#[cfg(feature = "supervision")]
#[must_use]
pub fn nis_time(machine: &Machine, inverter: &Inverter) -> f64 {
    stated_periods(machine, inverter) / (NIS_CORNER * inverter.f_c())
}

impl<R: Real> FilterConfig<R> {
    /// Settings for validated parameters at a flux reference `psi_ref`; `calibrated`: the offsets of the
    /// current sensors are read before each start.
    #[must_use]
    pub fn new(
        machine: &Machine,
        inverter: &Inverter,
        pu: &PerUnit,
        psi_ref: f64,
        calibrated: bool,
        identified: Identified,
    ) -> Self {
        let (slot_bits, seconds) = Self::block(machine, inverter);
        let block = SLOTS << slot_bits;
        let part = stated_periods(machine, inverter) / f64::from(block);
        let saturated = Saturated::of(machine);
        Self {
            t_s: rounded(pu.t_s),
            block: block as u8,
            inv_block: rounded(1.0 / f64::from(block)),
            slot_mask: (1 << slot_bits) - 1,
            slot_bits,
            model: Model::new(machine, pu, psi_ref, seconds),
            noise: Noise::new(
                pu,
                (seconds, machine.f_N / STATED_FREQUENCY, part),
                calibrated,
                saturated.known,
                identified,
            ),
            saturation: rounded(saturated.c),
            load_corner: rounded(seconds / LOAD_TIME),
            correct: identified.flux,
            temperature: TemperatureConfig::new(machine, pu, None, seconds),
        }
    }

    /// Binary logarithm of the periods in a slot, and duration of a block, s.
    fn block(machine: &Machine, inverter: &Inverter) -> (u8, f64) {
        let seconds = |bits: u8| f64::from(SLOTS << bits) / inverter.f_c();
        let turn = BLOCK_TURN / machine.f_N;
        let longest = BLOCK_TIME.min(turn).min(BLOCK_DECAY * machine.L_M / machine.R_R);
        let bits = (1..=SLOT_BITS_MAX).rev().find(|&bits| seconds(bits) <= longest).unwrap_or(0);
        (bits, seconds(bits))
    }

    /// Checks that the current model, integrated once a block, is stable: blocks of a tenth of the rotor time constant
    /// at the most.
    ///
    /// # Errors
    /// A rotor resistance too large for that.
    #[cfg(feature = "enhanced")]
    pub(crate) fn check(machine: &Machine, inverter: &Inverter) -> Result<(), ParamError> {
        // In blocks of the fewest periods: more are taken only where the time constant is longer still.
        let most = 0.1 * machine.L_M * inverter.f_c() / f64::from(SLOTS);
        check("R_R", machine.R_R, 0.0, most, "ohm")
            .map_err(|e| e.with_note("the rotor time constant must be at least ten blocks of the filter"))
    }

    /// The same with what is known of the temperatures.
    #[must_use]
    pub fn with_temperature(self, machine: &Machine, inverter: &Inverter, pu: &PerUnit, known: &Temperature) -> Self {
        let temperature = TemperatureConfig::new(machine, pu, Some(known), Self::block(machine, inverter).1);
        Self { temperature, model: self.model.with_thermometer(), ..self }
    }

    /// The same with inductances that are corrected under a steady load, too ([`super::load`]).
    #[must_use]
    pub fn never_steady(self) -> Self {
        // A low-pass that stays at zero.
        Self { load_corner: R::ZERO, ..self }
    }

    /// The same with other standard deviations of the parameters at the start.
    #[must_use]
    pub fn with_priors(self, priors: &Priors) -> Self {
        Self { noise: self.noise.with_priors(priors), ..self }
    }
}
