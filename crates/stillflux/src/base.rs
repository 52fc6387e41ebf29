//! Per-unit system: the base quantities and the machine and inverter in them.
//!
//! ```text
//! u_b = √(2/3) U_N    i_b = √2 I_N    ω_b = ω_sR    ψ_b = u_b/ω_b    z_b = u_b/i_b    l_b = z_b/ω_b
//! T_b = 3/2 n_p ψ_b i_b    ω_m,b = ω_sR/n_p    τ = ω_b t
//! ```
//!
//! Amplitude-invariant space vectors; base voltage and current are the rated phase peaks, base frequency
//! is `omega_sR`, time is normalised by it (`tau = omega_sR t`). Torque base is `3/2 n_p psi_b i_b`, so
//! that `T = psi_s × i_s`; mechanical speed base is `omega_sR / n_p`, so that electrical and mechanical
//! speed share one per-unit number.
//!
//! A rating that does not belong to its machine shows in per unit. [`PerUnit::new`] refuses, by the name of the SI
//! field,
//!
//! | field | quantity | range, per unit |
//! |---|---|---|
//! | `R_s`, `R_R` | with the inverter's `r_d` in series with `R_s` | 5e-4 to 0.5 |
//! | `L_sigma` | `σl_s` | 0.02 to 0.8 |
//! | `L_M` | `l_M` | 0.3 to 20 |
//! | `J` | `j` | 0.1 to 1e6 |
//! | `T_N` | rated torque | 0.05 to 2 |
//! | `U_N` | rated dc link | 0.2 to 8 |
//! | `f_s` | `t_s` | 1e-3 to 2π/20: at least 20 periods a turn of the rated field |

use crate::params::{Inverter, Machine, ParamError, check};
use crate::scalar::Real;

/// Base quantities, SI.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Base {
    /// Voltage, V.
    pub u: f64,
    /// Current, A.
    pub i: f64,
    /// Electrical angular frequency, rad/s.
    pub omega: f64,
    /// Flux linkage, V·s.
    pub psi: f64,
    /// Impedance, Ω.
    pub z: f64,
    /// Inductance, H.
    pub l: f64,
    /// Torque, N·m.
    pub torque: f64,
    /// Mechanical angular speed, rad/s.
    pub omega_m: f64,
}

impl Base {
    /// Base quantities of a machine's rating.
    #[must_use]
    pub fn new(machine: &Machine) -> Self {
        let u = machine.U_N * libm::sqrt(2.0 / 3.0);
        let i = machine.I_N * core::f64::consts::SQRT_2;
        let omega = machine.omega_sR();
        let n_p = f64::from(machine.n_p);
        let psi = u / omega;
        Self { u, i, omega, psi, z: u / i, l: u / (i * omega), torque: 1.5 * n_p * psi * i, omega_m: omega / n_p }
    }
}

/// [`Real::from_f64`] as a call, to save flash: a configuration has some hundred of them.
#[inline(never)]
pub(crate) fn rounded<R: Real>(x: f64) -> R {
    R::from_f64(x)
}

/// Machine and inverter in per unit: the one derivation, in double precision, for the configurations of all blocks.
/// Each rounds its values to the arithmetic once, at the end.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct PerUnit {
    /// Base quantities.
    pub base: Base,
    /// Stator resistance (with the inverter's `r_d`: the two are in series and identified as one).
    pub r_s: f64,
    /// Stator inductance.
    pub l_s: f64,
    /// Leakage inductance `sigma l_s`.
    pub sigma_l_s: f64,
    /// Magnetising inductance `l_M` of the inverse-Γ circuit.
    pub l_m: f64,
    /// Rotor resistance of the inverse-Γ circuit, `l_M / tau_r`.
    pub r_r: f64,
    /// Rotor time constant.
    pub tau_r: f64,
    /// Inertia: the torque that changes the speed by one in normalised time.
    pub j: f64,
    /// Control period in normalised time, `omega_sR T_s`.
    pub t_s: f64,
    /// Threshold voltage.
    pub u_th: f64,
    /// Dead-time voltage loss per volt of dc link, `T_d / T_s` with the period of the carrier.
    pub dead_time: f64,
    /// Largest change of a phase current within the dead time, `2/3 u_dc T_d / (sigma L_s)`.
    pub dead_time_swing: f64,
    /// Current that moves the charge of a leg's node within the dead time, `c_out u_dc / T_d`; 0 without dead time.
    pub knee: f64,
    /// Rated torque.
    pub torque_rated: f64,
    /// Rated dc-link voltage.
    pub u_dc: f64,
    /// What the pulse of each leg is longer than commanded, as part of the period.
    pub legs: [[f64; 2]; 3],
    /// The duties are updated at both extremes of the carrier.
    pub double_update: bool,
}

impl PerUnit {
    /// Converts parameters.
    ///
    /// # Errors
    /// The first parameter outside its admissible range.
    pub fn new(machine: &Machine, inverter: &Inverter) -> Result<Self, ParamError> {
        machine.validate()?;
        inverter.validate()?;
        let b = Base::new(machine);
        let within = |field, value: f64, base: f64, (min, max): (f64, f64), unit| {
            check(field, value, min * base, max * base, unit)
                .map_err(|e| e.with_note("limited by its per-unit value; is the rating that of this machine?"))
        };
        within("R_s", machine.R_s + inverter.r_d, b.z, (5e-4, 0.5), "ohm")?;
        within("R_R", machine.R_R, b.z, (5e-4, 0.5), "ohm")?;
        within("L_sigma", machine.L_sigma, b.l, (0.02, 0.8), "H")?;
        within("L_M", machine.L_M, b.l, (0.3, 20.0), "H")?;
        within("J", machine.J, b.torque / (b.omega_m * b.omega), (0.1, 1e6), "kg m^2")?;
        within("T_N", machine.T_N, b.torque, (0.05, 2.0), "N m")?;
        // u_b is proportional to U_N.
        within("U_N", machine.U_N, inverter.u_dc * machine.U_N / b.u, (1.0 / 8.0, 1.0 / 0.2), "V")?;
        // Limits are those of the control frequency.
        let f_s = machine.f_N * inverter.f_s / inverter.f_c();
        check("f_s", inverter.f_s, 20.0 * f_s, 1e3 * core::f64::consts::TAU * f_s, "Hz")
            .map_err(|e| e.with_note("with half_periods and f_N, 20 to 6283 control periods in a turn at f_N"))?;
        Ok(Self {
            base: b,
            r_s: (machine.R_s + inverter.r_d) / b.z,
            l_s: machine.L_s() / b.l,
            sigma_l_s: machine.L_sigma / b.l,
            l_m: machine.L_M / b.l,
            r_r: machine.R_R / b.z,
            tau_r: machine.L_M / machine.R_R * b.omega,
            j: machine.J * b.omega_m * b.omega / b.torque,
            t_s: b.omega / inverter.f_c(),
            u_th: inverter.u_th / b.u,
            dead_time: inverter.dead_time * inverter.f_s,
            dead_time_swing: 2.0 / 3.0 * inverter.u_dc * inverter.dead_time / machine.L_sigma / b.i,
            knee: if inverter.dead_time > 0.0 {
                inverter.c_out * inverter.u_dc / inverter.dead_time / b.i
            } else {
                0.0
            },
            torque_rated: machine.T_N / b.torque,
            u_dc: inverter.u_dc / b.u,
            legs: inverter.leg_delay.map(|delay| delay.map(|t| t * inverter.f_s)),
            double_update: inverter.half_periods == 1,
        })
    }

    /// Pull-out of a stator flux, `(1 - σ)/(2 σl_s)` times this: with the flux the torque current, with its square the
    /// torque.
    pub(crate) fn pull_out(&self, times: f64) -> f64 {
        times * (1.0 - self.sigma_l_s / self.l_s) / (2.0 * self.sigma_l_s)
    }

    /// A frequency in Hz as angular frequency.
    pub(crate) fn hz(&self, f: f64) -> f64 {
        core::f64::consts::TAU * f / self.base.omega
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_have_the_per_unit_values_of_their_data_sheets() {
        for (machine, inverter, want) in [
            (Machine::preset_2k2(), Inverter::preset_2k2(), (0.080, 1.67, 0.143, 0.107)),
            (Machine::preset_11k(), Inverter::preset_11k(), (0.020, 1.91, 0.058, 0.296)),
        ] {
            let p = PerUnit::new(&machine, &Inverter { r_d: 0.0, ..inverter }).unwrap();
            assert!((p.r_s - want.0).abs() < 5e-4);
            assert!((p.l_s - want.1).abs() < 1e-2);
            assert!((p.sigma_l_s - want.2).abs() < 1e-3);
            assert!((p.tau_r / machine.omega_sR() - want.3).abs() < 1e-3);
        }
    }

    #[test]
    fn every_per_unit_value_is_that_of_its_base() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let (b, p) = (Base::new(&machine), PerUnit::new(&machine, &inverter).unwrap());
        // Rated phase peaks 326.6 V and 7.071 A, 314.2 rad/s, two pole pairs.
        for (name, got, want) in [
            ("u", b.u, 326.599),
            ("i", b.i, 7.071_07),
            ("psi", b.psi, 1.039_60),
            ("omega_m", b.omega_m, 157.080),
            ("torque", b.torque, 22.0533),
            ("r_s with r_d", p.r_s, 3.9 / 46.1880),
            ("r_r", p.r_r, 2.1 / 46.1880),
            ("t_s", p.t_s, 0.031_415_9),
            ("u_th", p.u_th, 1.0 / 326.599),
            ("dead time", p.dead_time, 0.02),
            ("T_N", p.torque_rated, 14.6 / 22.0533),
            ("u_dc", p.u_dc, 540.0 / 326.599),
        ] {
            assert!((got / want - 1.0).abs() < 1e-5, "{name}: {got} instead of {want}");
        }
        let power = b.torque * b.omega_m;
        assert!((power / (1.5 * b.u * b.i) - 1.0).abs() < 1e-12, "torque and speed make the power base");
    }
}
