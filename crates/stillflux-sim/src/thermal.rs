#![allow(non_snake_case)]
//! Stator winding temperature: one time constant, driven by the copper loss. The rotor's rise is proportional to it.

use stillflux::params::{ParamError, check};

/// `tau dT/dt = rise P_cu/P_cu,N - T`, `R_s = R_s,cold (1 + alpha T)`, `R_R = R_R,cold (1 + alpha_R T)`;
/// `P_cu,N = 3 R_s,cold I_N²`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thermal {
    /// Thermal time constant, s.
    pub time_constant: f64,
    /// Temperature rise at rated copper loss, K.
    pub rise: f64,
    /// Temperature coefficient, 1/K; copper 0.0039.
    pub alpha: f64,
    /// That of the rotor, per K of the *winding*: times the rotor's rise over the winding's. 0: the rotor stays cold.
    pub alpha_R: f64,
}

impl Thermal {
    /// Checks every field against its admissible range.
    ///
    /// # Errors
    /// The first field found outside its range.
    pub fn validate(&self) -> Result<(), ParamError> {
        check("thermal.time_constant", self.time_constant, 1e-3, 1e6, "s")?;
        check("thermal.rise", self.rise, 0.0, 500.0, "K")?;
        check("thermal.alpha", self.alpha, 0.0, 0.02, "1/K")?;
        check("thermal.alpha_R", self.alpha_R, 0.0, 0.02, "1/K")
    }

    /// Temperature after `h` seconds at `load` = `P_cu/P_cu,N` (trapezoidal: stable at any `h`).
    pub(crate) fn advance(&self, kelvin: f64, load: f64, h: f64) -> f64 {
        let r = h / self.time_constant;
        kelvin + (self.rise * load - kelvin) * r / (1.0 + 0.5 * r)
    }
}
