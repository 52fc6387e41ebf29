//! Intermediate results of a block's work, which pass from slot to slot ([`super::schedule`]).
//!
//! Regressors of a transition and the gain of a correction are needed one after the other: they share their memory.

use super::covariance::Column;
use crate::scalar::Real;

/// Regressors of the flux rows in `F` ([`super::model::Model::flux_row`]), two components each.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct Regressors<R: Real> {
    /// Current `i`, of the resistance.
    pub i_s: [R; 2],
    /// Loss `u_l` of the inverter model, of its error.
    pub u_l: [R; 2],
    /// `u_k = ∂u_l/∂ln k`, of the knee.
    pub u_k: [R; 2],
    /// `l̂ Δi`, of the leakage.
    pub d_leakage_flux: [R; 2],
}

impl<R: Real> Regressors<R> {
    /// One component of each, in the order of the fields; `second`: the β component.
    #[inline(always)]
    pub fn component(&self, second: bool) -> [R; 4] {
        [self.i_s, self.u_l, self.u_k, self.d_leakage_flux].map(|x| x[usize::from(second)])
    }
}

/// Numerator of the gain `K = P Hᵀ/S`: of this block's update and of the next correction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct Gain<R: Real> {
    /// `P Hᵀ`.
    pub ph: Column<R>,
}

/// What the latest slot has left for the next ones.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) enum Intermediate<R: Real> {
    /// Nothing that another slot may use.
    #[default]
    Nothing,
    /// That the prediction of this covariance has begun.
    Begun,
    /// For the prediction of the flux.
    Transition(Regressors<R>),
    /// For update and correction.
    Gain(Gain<R>),
}
