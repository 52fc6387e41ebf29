//! State of what a start-up measures in one of its steps: the comparison of the legs, or the circle of the flux. They share memory.

#[cfg(feature = "restart")]
use crate::estimate::circle::CircleProbe;
#[cfg(feature = "legs")]
use crate::estimate::legs::LegsProbe;
use crate::scalar::Real;

/// What is measured at present.
#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) enum Probe<R: Real> {
    /// Nothing.
    #[default]
    Nothing,
    /// How the legs differ.
    #[cfg(feature = "legs")]
    Legs(LegsProbe<R>),
    /// The circle of the flux.
    #[cfg(feature = "restart")]
    Circle(CircleProbe<R>),
}

impl<R: Real> Probe<R> {
    /// A period of the comparison of the legs, whose state begins anew after something else.
    #[cfg(feature = "legs")]
    pub fn legs<T>(&mut self, period: impl FnOnce(&mut LegsProbe<R>) -> T) -> T {
        let mut probe = if let Self::Legs(probe) = *self { probe } else { LegsProbe::default() };
        let result = period(&mut probe);
        *self = Self::Legs(probe);
        result
    }

    /// A period of the circle of the flux, likewise.
    #[cfg(feature = "restart")]
    pub fn circle<T>(&mut self, period: impl FnOnce(&mut CircleProbe<R>) -> T) -> T {
        let mut probe = if let Self::Circle(probe) = *self { probe } else { CircleProbe::default() };
        let result = period(&mut probe);
        *self = Self::Circle(probe);
        result
    }
}
