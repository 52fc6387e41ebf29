//! Energies of machine and bridge.
#![allow(non_snake_case)]

use super::{Circuit, Field, State, V2, axpy, dot};

/// Energies in J summed since tracking was switched on, see [`crate::Plant::track_energy`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energy {
    /// Into the machine's terminals, `∫ 3/2 u·i dt`.
    pub input: f64,
    /// Stator copper loss.
    pub copper_s: f64,
    /// Rotor copper loss.
    pub copper_r: f64,
    /// Eddy current loss of the iron.
    pub iron: f64,
    /// From the air gap into the shaft, `∫ T omega dt`.
    pub shaft: f64,
    /// Out of the dc link. This and the next two only in [`crate::Mode::Switching`], 0 else.
    pub link: f64,
    /// Conduction loss of the bridge, threshold and `r_d`.
    pub conduction: f64,
    /// Charging loss: a switch that turns on charges its leg's node in no time.
    pub charging: f64,
}

impl Energy {
    pub(crate) fn add(&mut self, k: f64, p: &Energy) {
        self.input += k * p.input;
        self.copper_s += k * p.copper_s;
        self.copper_r += k * p.copper_r;
        self.iron += k * p.iron;
        self.shaft += k * p.shaft;
        self.conduction += k * p.conduction;
    }
}

impl Circuit {
    /// Stored magnetic energy, J: `3/2 (∫ |psi|/L_s d|psi| + |psi_s - psi_r|²/(2 L_l))`.
    pub fn magnetic_energy(&self, x: &State) -> f64 {
        let (s2, l) = (dot(x.psi_s, x.psi_s), axpy(x.psi_s, -1.0, x.psi_r));
        let branches: f64 = (0..2)
            .map(|n| {
                let l = axpy(x.psi_s, -1.0, x.psi_x[n]);
                0.5 * self.x[n].inv_L * dot(l, l)
            })
            .sum();
        1.5 * (0.5 * self.inv_L_u * s2
            + self.saturating(s2) * s2 / (self.S + 2.0)
            + 0.5 * self.inv_L_l * dot(l, l)
            + branches
            + if self.gap.is_some() { self.gap.energy(x) } else { 0.0 })
    }

    /// The powers of [`Energy`] in W that follow from state and voltage; `conduction` without the thresholds.
    pub fn power(&self, x: &State, f: &Field, dpsi_s: V2) -> Energy {
        let l = axpy(x.psi_s, -1.0, x.psi_r);
        let loss = |n: usize| {
            let l = axpy(x.psi_s, -1.0, x.psi_x[n]);
            1.5 * self.x[n].k * self.x[n].inv_L * dot(l, l)
        };
        let mut copper_r = 1.5 * self.k_r * self.inv_L_l * dot(l, l);
        if self.gap.is_some() {
            let i = axpy(self.gap.leak(x).i, self.inv_L_l, l);
            copper_r = 1.5 * self.gap.R_r * dot(i, i);
        }
        Energy {
            input: 1.5 * dot(axpy(dpsi_s, self.R_s, f.i), f.i),
            copper_s: 1.5 * self.R_s * dot(f.i, f.i),
            copper_r: copper_r + loss(1),
            iron: loss(0),
            shaft: f.torque * x.omega,
            conduction: 1.5 * self.r_d * dot(f.i, f.i),
            ..Energy::default()
        }
    }
}
