//! Places of the states in the filter's vectors and its covariance.

/// Stator flux `ψ̂_s`, two components.
pub(super) const PSI: usize = 0;
/// Magnitude of the rotor flux by the current model.
pub(super) const M: usize = 2;
/// Offset of the current sensors, two components.
pub(super) const B: usize = 3;
/// Stator resistance.
pub(super) const RS: usize = 5;
/// Relative error of the inverter model's voltage.
pub(super) const V: usize = 6;
/// Reciprocal of the main inductance, relative to its prior.
pub(super) const GAMMA: usize = 7;
/// Saturated part of the magnetising current.
pub(super) const C: usize = 8;
