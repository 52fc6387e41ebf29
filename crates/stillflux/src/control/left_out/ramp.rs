//! Without the feature `ramp` the reference of the speed is followed at once.

use crate::scalar::Real;
use crate::words::words;
use core::marker::PhantomData;

/// Calls in the unit of the acceleration, by which the settings are refused.
pub const CALLS: f64 = 256.0;

/// No settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct RampConfig<R: Real> {
    of: PhantomData<R>,
}
words!(RampConfig: of);

impl<R: Real> RampConfig<R> {
    /// Of no ramp.
    pub fn new(_: R, _: R, _: R) -> Self {
        Self { of: PhantomData }
    }
}

/// No state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Ramp<R: Real> {
    of: PhantomData<R>,
}

impl<R: Real> Ramp<R> {
    /// Begins at a speed.
    #[inline(always)]
    pub fn start(&mut self, _: R) {}

    /// The reference.
    #[inline(always)]
    pub fn step(&mut self, _: &RampConfig<R>, reference: R, _: R, _: R) -> R {
        reference
    }
}
