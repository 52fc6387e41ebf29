//! What the filter keeps over a stop, and what a start begins with.

use crate::scalar::Real;
use crate::space::AlphaBeta;

/// Identified parameters of machine, bridge and sensors that a filter keeps over a stop, per unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Learned<R: Real> {
    /// Offset of the current sensors beyond the one read at rest.
    pub b: AlphaBeta<R>,
    /// Stator resistance.
    pub r_s: R,
    /// Relative error of the inverter model's voltage.
    pub v: R,
    /// Knee of the inverter model, relative to that of the parameters.
    pub knee: R,
    /// Leakage inductance, relative to that of the parameters.
    pub leakage: R,
    /// Reciprocal of the magnetising inductance, relative to that of the parameters.
    pub gamma: R,
}

/// Values before a start, and their variances: the settled flux initialises from them a second time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct Initial<R: Real> {
    pub learned: Learned<R>,
    /// Scaled variances of `b`, `r_s`, `v`, `k`, `l`, `γ`.
    pub variance: [R; 6],
}

impl<R: Real> Initial<R> {
    /// Variance of the leakage.
    pub fn of_leakage(&self) -> R {
        self.variance[4]
    }
}
