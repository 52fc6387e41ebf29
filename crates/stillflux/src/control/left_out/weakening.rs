//! Without the feature `weakening` the flux reference is the rated one: where the voltage ends, the torque does.

use crate::scalar::Real;
use crate::words::words;
use core::marker::PhantomData;

/// Part of the largest voltage that field weakening would leave to the steady state.
pub(crate) const UTILISATION: f64 = 0.97;
/// A limit of the torque current that is none, per unit.
pub(crate) const FREE: f64 = 100.0;
/// Torque never gives way to a flux that lags.
pub(crate) const LAG_ALLOWED: f64 = FREE;
/// Rises of limits that there are not.
pub(crate) const RISE: f64 = 0.0;
pub(crate) const RISE_OF_VOLTAGE: f64 = 0.0;

/// No settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct WeakeningConfig<R: Real> {
    of: PhantomData<R>,
}
words!(WeakeningConfig: of);

impl<R: Real> WeakeningConfig<R> {
    /// Of none.
    pub fn new(_: R, _: R, _: R, _: R, _: (R, R)) -> Self {
        Self { of: PhantomData }
    }

    /// The flux itself.
    #[inline(always)]
    pub fn at_least(&self, psi_s: R) -> R {
        psi_s
    }
}

/// What is left of its state: whether the current of a start of the enhanced scheme follows a flux that builds up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Weakening<R: Real> {
    #[cfg(feature = "enhanced")]
    follows_flux: bool,
    of: PhantomData<R>,
}

impl<R: Real> Weakening<R> {
    /// A start-up begins, to rated flux.
    pub fn begin(&mut self, _: R) {
        *self = Self::default();
    }

    /// The current of a start follows a flux that builds up.
    pub fn follow_flux(&mut self) {
        #[cfg(feature = "enhanced")]
        {
            self.follows_flux = true;
        }
    }

    /// Begins anew at rated flux.
    pub fn start(&mut self, _: R) {
        *self = Self::default();
    }

    /// Rated flux.
    #[inline(always)]
    pub fn most(&self, psi_rated: R) -> R {
        psi_rated
    }

    /// Always, but for a start that follows its flux.
    #[inline(always)]
    pub fn is_rated(&self, _: R) -> bool {
        #[cfg(feature = "enhanced")]
        return !self.follows_flux;
        #[cfg(not(feature = "enhanced"))]
        true
    }

    /// Never.
    #[inline(always)]
    pub fn is_weak(&self, _: R) -> bool {
        false
    }

    /// No limit is remembered.
    #[inline(always)]
    pub fn limits_torque(&self) -> bool {
        false
    }

    /// The torque current at the limit of the voltage.
    #[inline(always)]
    pub fn torque_current(&mut self, _: &WeakeningConfig<R>, now: Option<R>, _: R) -> R {
        now.unwrap_or(R::from_f64(FREE))
    }

    /// Nothing that could end.
    #[inline(always)]
    pub fn limit(&mut self, _: &WeakeningConfig<R>, _: R, _: R, _: (R, R), _: (R, R)) -> bool {
        false
    }
}
