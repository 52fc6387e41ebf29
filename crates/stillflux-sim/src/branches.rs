//! Eddy currents in the iron and the skin effect in the rotor's bars: short-circuited windings beside the rotor's.
//!
//! ```text
//! i_s = psi_s/L_s(|psi_s|) + (psi_s - psi_r)/L_l + (psi_s - psi_x)/L_x          for each branch x
//! psi_x' = (R_x/L_x) (psi_s - psi_x) + j omega_x psi_x                          T += (3/2) n_p (psi_x x psi_s)/L_x
//! ```
//!
//! **Iron loss**: `omega_x = 0`, no torque, `R_x = R_fe` parallel to the magnetising branch of the Γ circuit,
//! `L_x = R_fe tau`. Below `1/tau` its current is `psi_s'/R_fe` and its loss `(3/2) |psi_s'|²/R_fe`; above, the eddy
//! currents keep the field out of the sheets and the stator current does not jump with the voltage.
//!
//! **Deep bar**: `omega_x = omega`. The branch takes the share `g` of the cage's conductance and the share `s` of its
//! inverse leakage: `R_r/(1 - g)`, `L_l/(1 - s)` for the first, `R_r/g`, `L_l/s` for the second. The cage keeps `R_r` at
//! small slip and `L_l` at high frequency; with `g < s` resistance rises and leakage falls with the slip
//! frequency, as in a bar. With `g = s` both are one winding again.
#![allow(non_snake_case)]

use stillflux::params::{Gamma, Machine, ParamError, Rating, check};

/// Eddy currents in the stator's iron.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IronLoss {
    /// Resistance parallel to the magnetising branch of the Γ circuit, Ω.
    pub R_fe: f64,
    /// Time constant of the field in the sheets, s.
    pub time_constant: f64,
}

/// Second branch of the rotor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeepBar {
    /// Its share of the cage's conductance at small slip.
    pub conductance: f64,
    /// Its share of the cage's inverse leakage inductance at high frequency.
    pub leakage: f64,
}

impl IronLoss {
    /// Checks every field against its admissible range.
    ///
    /// # Errors
    /// The first field found outside its range. The time constant is at least 20 µs, and the branch's inductance at
    /// least twice the leakage's: with less it would be another leakage path, no loss.
    pub fn validate(&self, machine: &Machine) -> Result<(), ParamError> {
        check("iron_loss R_fe", self.R_fe, 1e-3, 1e7, "ohm")?;
        let L = machine.to_gamma().L_l;
        check("iron_loss time constant", self.time_constant, (2.0 * L / self.R_fe).max(20e-6), 0.1, "s")
    }
}

impl DeepBar {
    /// Checks every field against its admissible range.
    ///
    /// # Errors
    /// The first field found outside its range.
    pub fn validate(&self) -> Result<(), ParamError> {
        check("deep_bar conductance", self.conductance, 0.01, 0.9, "")?;
        check("deep_bar leakage", self.leakage, 0.01, 0.9, "")
    }

    /// The machine without a second branch that has the same rotor currents at small slip: with `(1 - g)²/(1 - s) + g²/s` times the leakage
    /// of the Γ circuit, the term of first order in the frequency of the branches' admittance, and the same `R_r` and `L_s`.
    #[must_use]
    pub fn at_slip_frequency(&self, machine: &Machine) -> Machine {
        let (g, s) = (self.conductance, self.leakage);
        let ratio = (1.0 - g).powi(2) / (1.0 - s) + g * g / s;
        let gamma = machine.to_gamma();
        let &Machine { n_p, J, U_N, I_N, f_N, T_N, saturation, .. } = machine;
        let rating = Rating { n_p, J, U_N, I_N, f_N, T_N };
        Machine { saturation, ..Machine::from_gamma(Gamma { L_l: ratio * gamma.L_l, ..gamma }, rating) }
    }
}

/// A branch as the circuit needs it; none: zeros.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Branch {
    /// `1/L_x`
    pub inv_L: f64,
    /// `R_x/L_x`
    pub k: f64,
    /// Electrical turns per mechanical turn of the shaft: `n_p` or 0.
    pub turns: f64,
}

impl Branch {
    pub fn iron(loss: Option<IronLoss>) -> Self {
        loss.map_or(Self::default(), |l| Self {
            inv_L: 1.0 / (l.R_fe * l.time_constant),
            k: 1.0 / l.time_constant,
            turns: 0.0,
        })
    }
}
