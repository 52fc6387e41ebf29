//! Energies of the dc link: what link and rectifier add to.

/// Energies of the link since the plant was made, J.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkEnergy {
    /// From the supply into the capacitor.
    pub supply: f64,
    /// Into the bridge.
    pub bridge: f64,
    /// Into the chopper's resistor.
    pub chopper: f64,
    /// From the grid, or the source of a smooth supply.
    pub grid: f64,
    /// Into the supply's resistance.
    pub loss: f64,
    /// Now stored in the grid's inductances.
    pub inductance: f64,
}
