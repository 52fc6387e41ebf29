//! Settings of the filter: model, noise and block of a machine on a bridge.

use super::load::LOAD_TIME;
use super::model::{Model, Saturated};
use super::noise::{Identified, Noise};
use crate::base::{PerUnit, rounded};
use crate::estimate::priors::Priors;
use crate::estimate::temperature::{Temperature, TemperatureConfig};
use crate::params::{Inverter, Machine};
#[cfg(feature = "enhanced")]
use crate::params::{ParamError, check};
use crate::scalar::Real;
use crate::words::words;

/// Length of a block, s: long against the control period, short against the rotor time constant.
const BLOCK_TIME: f64 = 1e-3;
/// Control periods that the work of a block needs, the closing one included ([`super::schedule`]).
pub(super) const SLOTS: u32 = 10;

/// Settings of the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct FilterConfig<R: Real> {
    /// Control period, normalised time.
    pub(super) t_s: R,
    /// Control periods in a block, and the reciprocal.
    pub(super) block: u8,
    pub(super) inv_block: R,
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
words!(FilterConfig: t_s, block, inv_block, model, noise, saturation, load_corner, correct, temperature);

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
        let (block, seconds) = Self::block(inverter);
        let saturated = Saturated::of(machine);
        Self {
            t_s: rounded(pu.t_s),
            block: block as u8,
            inv_block: rounded(1.0 / f64::from(block)),
            model: Model::new(machine, pu, psi_ref, seconds),
            noise: Noise::new(pu, seconds, calibrated, saturated.known, identified),
            saturation: rounded(saturated.c),
            load_corner: rounded(seconds / LOAD_TIME),
            correct: identified.flux,
            temperature: TemperatureConfig::new(machine, pu, None, seconds),
        }
    }

    /// Periods and duration, s, of a block.
    fn block(inverter: &Inverter) -> (u32, f64) {
        let block = inverter.periods(BLOCK_TIME).clamp(SLOTS, 64);
        (block, f64::from(block) / inverter.f_c())
    }

    /// Checks that the current model, integrated once a block, is stable: blocks of a tenth of the rotor time constant
    /// at the most.
    ///
    /// # Errors
    /// A rotor resistance too large for that.
    #[cfg(feature = "enhanced")]
    pub(crate) fn check(machine: &Machine, inverter: &Inverter) -> Result<(), ParamError> {
        let most = 0.1 * machine.L_M / Self::block(inverter).1;
        check("R_R", machine.R_R, 0.0, most, "ohm")
            .map_err(|e| e.with_note("the rotor time constant must be at least ten blocks of the filter"))
    }

    /// The same with what is known of the temperatures.
    #[must_use]
    pub fn with_temperature(self, machine: &Machine, inverter: &Inverter, pu: &PerUnit, known: &Temperature) -> Self {
        let temperature = TemperatureConfig::new(machine, pu, Some(known), Self::block(inverter).1);
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
