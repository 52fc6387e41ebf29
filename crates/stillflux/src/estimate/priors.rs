//! How well the parameters are known at the start: what the filter of the enhanced scheme begins with. What is known
//! well moves little.

/// Standard deviation of a start, relative.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Priors {
    /// Stator resistance. Physical: temperature of the winding, 50 K at 0.39 %/K. A winding that was measured cold is
    /// not cold for ever.
    pub r_s: f64,
    /// Threshold and dead time. Physical: their tolerance.
    pub loss: f64,
    /// Knee of the bridge's curve: within a factor of two of the parameter. Physical: cable and motor add to the
    /// capacitance of the devices.
    pub knee: f64,
    /// Leakage inductance. Physical: its tolerance.
    pub leakage: f64,
    /// Rotor resistance. Physical: its tolerance, and temperature of the cage, 40 K at 0.41 %/K.
    pub r_r: f64,
    /// Magnetising inductance. Physical: its tolerance.
    pub l_m: f64,
}

impl Default for Priors {
    fn default() -> Self {
        Self { r_s: 0.2, loss: 0.15, knee: 0.7, leakage: 0.1, r_r: 0.2, l_m: 0.07 }
    }
}
