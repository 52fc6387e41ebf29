//! State of the circuit, and what follows from it alone.

use super::vector::V2;

/// What the compiler may leave out: a circuit without saturation, with it, with further branches, with all of them and
/// saturating leakage and slots.
pub(crate) const LINEAR: u8 = 0;
pub(crate) const SATURATING: u8 = 1;
pub(crate) const BRANCHED: u8 = 2;
pub(crate) const FULL: u8 = 3;

/// What is integrated: Γ-form fluxes in V·s, mechanical speed in rad/s and angle in rad.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct State {
    pub psi_s: V2,
    pub psi_r: V2,
    /// Flux of the further branches: iron, bar.
    pub psi_x: [V2; 2],
    pub omega: f64,
    pub theta: f64,
    /// `e^{j Z theta}` of the slots, where there are any.
    pub slot: V2,
}

/// What follows from a state alone, whatever the terminal voltage.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Field {
    /// `1/L_s(|psi_s|) + 1/L_l` of small leakage currents
    pub b: f64,
    pub i: V2,
    pub dpsi_r: V2,
    pub dpsi_x: [V2; 2],
    pub torque: f64,
}
