//! DC link with a capacitor, fed by a diode rectifier, with a brake chopper. SI.
//!
//! ```text
//! C u du/dt = u i_supply - p_bridge - δ u²/R_chopper
//! smooth:  i_supply = max(0, (E - u)/R_supply)           with a grid:  i_supply of [`crate::rectifier`]
//! ```
//!
//! `E` is the rectifier's ideal mean voltage, 3/π of the peak between two lines. Without a [`Grid`] it has no ripple and
//! `R_supply` stands for the grid: the mean drop by commutation, `3 ω L/π`, and resistance. With one, `R_supply` is the
//! resistance of the two phases in series that conduct.
//!
//! The link is constant within a PWM period and takes the period's energies at its end, each part exactly: bridge,
//! chopper, supply. So the books balance to rounding,
//!
//! ```text
//! C/2 (u² - u_0²) = W_supply - W_bridge - W_chopper,   W_supply = W_grid - W_loss - W_inductance
//! ```
//!
//! Validity: `u` changes by little in a period.
#![allow(non_snake_case)]

use crate::link_energy::LinkEnergy;
use crate::rectifier::{Grid, Rectifier};
use stillflux::params::{ParamError, check};

/// What a link consists of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DcLink {
    /// Capacitance, F.
    pub C: f64,
    /// Resistance that stands for the supply, Ω.
    pub R_supply: f64,
    /// Resistor of the brake chopper, Ω; infinite: there is none.
    pub R_chopper: f64,
}

impl DcLink {
    /// Checks every field against its admissible range.
    pub(crate) fn validate(&self) -> Result<(), ParamError> {
        check("dc_link C", self.C, 1e-6, 10.0, "F")?;
        check("dc_link R_supply", self.R_supply, 1e-4, 1e3, "ohm")?;
        check("dc_link R_chopper", self.R_chopper, 1e-3, f64::INFINITY, "ohm")
    }
}

/// State of a link.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Link {
    pub params: DcLink,
    /// `E`, V.
    pub supply: f64,
    /// Duty of the chopper.
    pub chopper: f64,
    pub energy: LinkEnergy,
    rectifier: Option<Rectifier>,
}

impl Link {
    pub fn new(params: DcLink, grid: Option<Grid>, supply: f64) -> Self {
        let rectifier = grid.map(|g| Rectifier::new(g, 0.5 * params.R_supply, params.C));
        Self { params, supply, chopper: 0.0, energy: LinkEnergy::default(), rectifier }
    }

    /// Voltage without load, V.
    pub fn no_load(&self) -> f64 {
        if self.rectifier.is_some() { Rectifier::peak(self.supply) } else { self.supply }
    }

    /// A period of length `dt` that began at `u` and in which the bridge took the energy `bridge`; returns its voltage
    /// at the end.
    pub fn advance(&mut self, u: f64, bridge: f64, dt: f64) -> f64 {
        let DcLink { C, R_supply, R_chopper, .. } = self.params;
        let fed = (u * u - 2.0 * bridge / C).max(0.0).sqrt();
        let chopped = if self.chopper > 0.0 { fed * libm::exp(-self.chopper * dt / (R_chopper * C)) } else { fed };
        let e = &mut self.energy;
        let charged = if let Some(rectifier) = &mut self.rectifier {
            rectifier.advance(self.supply, chopped, dt, e)
        } else if self.supply > chopped {
            let u = self.supply + (chopped - self.supply) * libm::exp(-dt / (R_supply * C));
            let taken = self.supply * C * (u - chopped);
            e.grid += taken;
            e.loss += taken - 0.5 * C * (u * u - chopped * chopped);
            u
        } else {
            chopped
        };
        e.bridge += 0.5 * C * (u * u - fed * fed);
        e.chopper += 0.5 * C * (fed * fed - chopped * chopped);
        e.supply += 0.5 * C * (charged * charged - chopped * chopped);
        charged
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_part_follows_its_equation() {
        let p = DcLink { C: 1e-3, R_supply: 0.5, R_chopper: 50.0 };
        // The bridge takes 1 kW for 10 ms without a supply.
        let mut link = Link::new(p, None, 0.0);
        let u = (0..100).fold(540.0, |u, _| link.advance(u, 0.1, 1e-4));
        assert!((0.5 * p.C * (540.0 * 540.0 - u * u) - 10.0).abs() < 1e-9);
        // The chopper alone discharges with 50 ms.
        let mut link = Link { chopper: 1.0, ..Link::new(p, None, 0.0) };
        let u = (0..500).fold(540.0, |u, _| link.advance(u, 0.0, 1e-4));
        assert!((u / 540.0 - (-1.0f64).exp()).abs() < 1e-9);
        // A load of 2 kW on the supply: u (E - u)/R = P.
        let mut link = Link::new(p, None, 540.0);
        let u = (0..10_000).fold(540.0, |u, _| link.advance(u, 0.02, 1e-5));
        assert!((u * (540.0 - u) / p.R_supply - 2000.0).abs() < 25.0, "{u}");
        let e = link.energy;
        assert!((0.5 * p.C * (u * u - 540.0 * 540.0) - (e.supply - e.bridge - e.chopper)).abs() < 1e-9);
        assert!((e.grid - e.loss - e.supply).abs() < 1e-9 * e.grid);
    }
}
