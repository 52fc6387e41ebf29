//! Without the feature `derating` no current is limited for the heat of machine or bridge.

use crate::scalar::Real;
use crate::words::words;
use core::marker::PhantomData;

/// Calls from one computation to the next, by which the settings are refused.
pub const CALLS: u32 = 64;

/// No settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct OverloadConfig<R: Real> {
    of: PhantomData<R>,
}
words!(OverloadConfig: of);

impl<R: Real> OverloadConfig<R> {
    /// Of no body.
    pub fn new(_: R, _: R, _: R) -> Self {
        Self { of: PhantomData }
    }
}

/// No state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Overload<R: Real> {
    of: PhantomData<R>,
}

impl<R: Real> Overload<R> {
    /// None.
    pub fn theta(&self) -> [R; 2] {
        [R::ZERO; 2]
    }

    /// No other largest current.
    #[inline(always)]
    pub fn step(&mut self, _: &[OverloadConfig<R>; 2], _: R, _: R) -> Option<R> {
        None
    }
}
