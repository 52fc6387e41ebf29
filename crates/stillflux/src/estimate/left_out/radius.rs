//! Without the feature `weakening` the noise compensator of the published scheme holds the reference of the flux at every
//! stator frequency.

use crate::scalar::Real;
use core::marker::PhantomData;

/// The reference.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct HeldRadius<R: Real> {
    of: PhantomData<R>,
}

impl<R: Real> HeldRadius<R> {
    /// Begins with the reference.
    #[inline(always)]
    pub fn start(&mut self) {}

    /// The reference.
    #[inline(always)]
    pub fn value(&self, psi_ref: R) -> R {
        psi_ref
    }

    /// No mean.
    #[inline(always)]
    pub fn step(&mut self, _: R, _: R, _: R) {}
}
