//! Parameters of machine, inverter and drive in SI units, validated.
//!
//! The field's standard symbols are kept (`R_s`, `L_M`), hence the lint exception. Upper case is SI;
//! the per-unit counterparts of [`crate::base`] are lower case (`r_s`, `l_s`).
//!
//! The canonical machine is the **inverse-Γ** equivalent circuit: `R_s`, `R_R`, `L_sigma`, `L_M` with
//! `psi_s = psi_R + L_sigma i_s`, because the paper's quantities are its direct functions:
//! `L_s = L_M + L_sigma`, `sigma L_s = L_sigma`, `tau_r = L_M / R_R`. The Γ and the T form convert
//! exactly; the T form has one parameter more, of which the terminals see only four combinations.
#![allow(non_snake_case)]

use crate::error::refuse;
pub use crate::error::{ParamError, check};
use crate::scalar::Timer;

/// Checks a stator resistance in Ω.
///
/// # Errors
/// A resistance outside its admissible range.
pub fn check_resistance(R_s: f64) -> Result<(), ParamError> {
    check("R_s", R_s, 1e-5, 1e3, "ohm")
}

/// Magnetic saturation of the Γ-form stator inductance, `L_s(psi) = L_u / (1 + (a psi)^S)`.
///
/// The plant has it over the whole range of the flux. The enhanced scheme starts its model of the curve from it, and
/// the published one knows the machine at its rated flux alone.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Saturation {
    /// Unsaturated stator inductance `L_u` in H.
    pub L_u: f64,
    /// Reciprocal of the flux scale, `a` in 1/(V·s).
    pub a: f64,
    /// Exponent `S`.
    pub S: f64,
}

/// Induction machine, inverse-Γ parameters and rating, SI.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Machine {
    /// Stator resistance, Ω.
    pub R_s: f64,
    /// Rotor resistance referred to the inverse-Γ circuit, Ω.
    pub R_R: f64,
    /// Leakage inductance `sigma L_s`, H.
    pub L_sigma: f64,
    /// Magnetising inductance of the inverse-Γ circuit, `(1 - sigma) L_s`, H.
    pub L_M: f64,
    /// Pole pairs.
    pub n_p: u32,
    /// Moment of inertia of the whole shaft, kg·m².
    pub J: f64,
    /// Rated line-to-line voltage, V rms.
    pub U_N: f64,
    /// Rated phase current, A rms.
    pub I_N: f64,
    /// Rated frequency, Hz.
    pub f_N: f64,
    /// Rated torque, N·m.
    pub T_N: f64,
    /// Magnetising curve. The plant simulates it; the enhanced scheme starts its model of the curve from it. `None`: a
    /// plant without saturation, and a typical curve for the scheme.
    pub saturation: Option<Saturation>,
}

/// Rating part of a machine's data: what the nameplate says.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Rating {
    /// Pole pairs.
    pub n_p: u32,
    /// Moment of inertia of the whole shaft, kg·m².
    pub J: f64,
    /// Rated line-to-line voltage, V rms.
    pub U_N: f64,
    /// Rated phase current, A rms.
    pub I_N: f64,
    /// Rated frequency, Hz.
    pub f_N: f64,
    /// Rated torque, N·m.
    pub T_N: f64,
}

/// Γ-form parameters: all leakage on the rotor side, `L_s` shunt at the stator.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Gamma {
    /// Stator resistance, Ω.
    pub R_s: f64,
    /// Rotor resistance of the Γ circuit, Ω.
    pub R_r: f64,
    /// Leakage inductance of the Γ circuit, H.
    pub L_l: f64,
    /// Stator inductance, H.
    pub L_s: f64,
}

/// T-form parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct TModel {
    /// Stator resistance, Ω.
    pub R_s: f64,
    /// Rotor resistance referred to the stator, Ω.
    pub R_r: f64,
    /// Stator leakage inductance, H.
    pub L_ls: f64,
    /// Rotor leakage inductance referred to the stator, H.
    pub L_lr: f64,
    /// Main inductance, H.
    pub L_m: f64,
}

impl Machine {
    /// 2.2-kW machine: 400 V, 5 A, 50 Hz, 14.6 N·m, two pole pairs, with its saturation curve.
    #[must_use]
    pub const fn preset_2k2() -> Self {
        Self {
            R_s: 3.7,
            R_R: 2.1,
            L_sigma: 0.021,
            L_M: 0.224,
            n_p: 2,
            J: 0.015,
            U_N: 400.0,
            I_N: 5.0,
            f_N: 50.0,
            T_N: 14.6,
            saturation: Some(Saturation { L_u: 0.34, a: 0.84, S: 7.0 }),
        }
    }

    /// 11-kW machine: 400 V, 21.5 A, 50 Hz, 72 N·m, 1460 r/min, two pole pairs (T form converted).
    #[must_use]
    pub fn preset_11k() -> Self {
        Self::from_t_model(
            TModel { R_s: 0.2147, R_r: 0.2205, L_ls: 0.991e-3, L_lr: 0.991e-3, L_m: 64.19e-3 },
            Rating { n_p: 2, J: 0.102, U_N: 400.0, I_N: 21.5, f_N: 50.0, T_N: 72.0 },
        )
    }

    /// From the Γ form. With `g = (L_s + L_l)/L_s`: `L_M = L_s/g`, `L_sigma = L_l/g`, `R_R = R_r/g²`.
    #[must_use]
    pub fn from_gamma(p: Gamma, rating: Rating) -> Self {
        let g = (p.L_s + p.L_l) / p.L_s;
        Self::assemble(p.R_s, p.R_r / (g * g), p.L_l / g, p.L_s / g, rating)
    }

    /// From the T form. With `k = L_m/L_r`: `L_M = k L_m`, `L_sigma = L_s - k L_m`, `R_R = k² R_r`.
    #[must_use]
    pub fn from_t_model(p: TModel, rating: Rating) -> Self {
        let k = p.L_m / (p.L_m + p.L_lr);
        let L_M = k * p.L_m;
        // L_s - L_M written without cancellation.
        let L_sigma = p.L_ls + k * p.L_lr;
        Self::assemble(p.R_s, k * k * p.R_r, L_sigma, L_M, rating)
    }

    fn assemble(R_s: f64, R_R: f64, L_sigma: f64, L_M: f64, r: Rating) -> Self {
        let Rating { n_p, J, U_N, I_N, f_N, T_N } = r;
        Self { R_s, R_R, L_sigma, L_M, n_p, J, U_N, I_N, f_N, T_N, saturation: None }
    }

    /// The Γ form of this machine.
    #[must_use]
    pub fn to_gamma(&self) -> Gamma {
        let L_s = self.L_M + self.L_sigma;
        let g = L_s / self.L_M;
        Gamma { R_s: self.R_s, R_r: self.R_R * g * g, L_l: self.L_sigma * g, L_s }
    }

    /// The T form of this machine with equal leakages on both sides (the choice the terminals cannot see).
    ///
    /// `L_ls = L_lr = L` obeys `(L_s - L)² = L_M L_s`, since `L_m = L_s - L`, `L_r = L_s`.
    #[must_use]
    pub fn to_t_model(&self) -> TModel {
        let L_s = self.L_M + self.L_sigma;
        let L_m = libm::sqrt(self.L_M * L_s);
        let L_l = L_s - L_m;
        let k = L_m / L_s;
        TModel { R_s: self.R_s, R_r: self.R_R / (k * k), L_ls: L_l, L_lr: L_l, L_m }
    }

    /// Stator inductance `L_s = L_M + L_sigma`, H.
    #[must_use]
    pub fn L_s(&self) -> f64 {
        self.L_M + self.L_sigma
    }

    /// Rated electrical angular frequency `omega_sR`, rad/s.
    #[must_use]
    pub fn omega_sR(&self) -> f64 {
        core::f64::consts::TAU * self.f_N
    }

    /// Checks every field against its admissible range.
    ///
    /// # Errors
    /// The first field found outside its range.
    #[inline(never)]
    pub fn validate(&self) -> Result<(), ParamError> {
        check_resistance(self.R_s)?;
        check("R_R", self.R_R, 1e-5, 1e3, "ohm")?;
        check("L_sigma", self.L_sigma, 1e-6, 10.0, "H")?;
        check("L_M", self.L_M, 1e-5, 100.0, "H")?;
        check("L_sigma/L_M", self.L_sigma / self.L_M, 0.005, 0.5, "")?;
        check("n_p", f64::from(self.n_p), 1.0, 60.0, "")?;
        check("J", self.J, 1e-7, 1e5, "kg m^2")?;
        check("U_N", self.U_N, 1.0, 20e3, "V")?;
        check("I_N", self.I_N, 0.01, 10e3, "A")?;
        check("f_N", self.f_N, 1.0, 2000.0, "Hz")?;
        check("T_N", self.T_N, 1e-4, 1e6, "N m")?;
        if let Some(s) = &self.saturation {
            check("saturation.L_u", s.L_u, 1e-5, 1e3, "H")?;
            check("saturation.a", s.a, 0.0, 1e4, "1/(V s)")?;
            check("saturation.S", s.S, 1.0, 20.0, "")?;
        }
        Ok(())
    }
}

/// Two-level inverter, SI: what the nonlinear inverter model (4)-(7) knows.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Inverter {
    /// Rated dc-link voltage, V.
    pub u_dc: f64,
    /// Switching frequency, Hz: that of the carrier.
    pub f_s: f64,
    /// Threshold voltage of switches and diodes, V.
    pub u_th: f64,
    /// Differential resistance of switches and diodes, Ω.
    pub r_d: f64,
    /// Dead time between the switches of a leg, s.
    pub dead_time: f64,
    /// Clock of the PWM timer, Hz; duties are multiples of `2 f_s / f_clk`. Zero: no quantisation.
    pub f_clk: f64,
    /// Total capacitance of one leg's node against the dc link, F: switches, motor cable and machine.
    /// Zero: the node follows its current at once.
    pub c_out: f64,
    /// Half periods of the carrier in a control period: 2, one update of the duties per carrier period; 1, one at each of
    /// its extremes, with samples at both; 4, 6 … 16: in every second, third … eighth carrier period.
    pub half_periods: u32,
    /// Time by which the pulse of each leg is longer than commanded, for a positive and for a negative current of the leg,
    /// s: delays of its switches and drivers. Only differences between the legs act.
    pub leg_delay: [[f64; 2]; 3],
}

impl Inverter {
    /// An IGBT inverter on a 400-V grid: 540 V, 10 kHz, 1 V, 0.2 Ω, 2 µs, 170-MHz timer, 1 nF at
    /// each leg's node (devices, some metres of cable, motor).
    #[must_use]
    pub const fn preset_2k2() -> Self {
        Self {
            u_dc: 540.0,
            f_s: 10e3,
            u_th: 1.0,
            r_d: 0.2,
            dead_time: 2e-6,
            f_clk: 170e6,
            c_out: 1e-9,
            half_periods: 2,
            leg_delay: [[0.0; 2]; 3],
        }
    }

    /// As [`Inverter::preset_2k2`] with the larger devices' 0.05 Ω and 2 nF.
    #[must_use]
    pub const fn preset_11k() -> Self {
        Self { r_d: 0.05, c_out: 2e-9, ..Self::preset_2k2() }
    }

    /// The PWM timer, if duties are multiples of its counts. The counts of half a period are a whole number.
    ///
    /// # Errors
    /// A clock for which they are beyond the range of [`Timer`].
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn timer(&self) -> Result<Option<Timer>, ParamError> {
        if self.f_clk == 0.0 {
            return Ok(None);
        }
        Timer::new((self.f_clk / (2.0 * self.f_s) + 0.5) as u32).map(Some)
    }

    /// Control frequency, Hz: samples and updates of the duties per second.
    #[must_use]
    pub fn f_c(&self) -> f64 {
        2.0 * self.f_s / f64::from(self.half_periods)
    }

    /// Largest admissible delay of [`Inverter::leg_delay`], s.
    pub(crate) fn leg_delay_max(&self) -> f64 {
        if cfg!(feature = "legs") { (0.005 / self.f_s).min(1e-6) } else { 0.0 }
    }

    /// Control periods in a time, s, to the nearest.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub(crate) fn periods(&self, time: f64) -> u32 {
        (time * self.f_c() + 0.5) as u32
    }

    /// Checks every field against its admissible range.
    ///
    /// # Errors
    /// The first field found outside its range.
    #[inline(never)]
    pub fn validate(&self) -> Result<(), ParamError> {
        check("u_dc", self.u_dc, 5.0, 10e3, "V")?;
        check("f_s", self.f_s, 1e3, 100e3, "Hz")?;
        check("u_th", self.u_th, 0.0, 0.05 * self.u_dc, "V")?;
        check("r_d", self.r_d, 0.0, 1e2, "ohm")?;
        check("dead_time", self.dead_time, 0.0, 0.1 / self.f_s, "s")?;
        if self.f_clk != 0.0 {
            let (least, most) = (2.0 * f64::from(Timer::MIN) * self.f_s, 2.0 * f64::from(Timer::MAX) * self.f_s);
            check("f_clk", self.f_clk, least, most.min(1e10), "Hz")?;
        }
        check("c_out", self.c_out, 0.0, 10e-9, "F")?;
        for delay in self.leg_delay.into_iter().flatten() {
            let most = self.leg_delay_max();
            check("leg_delay", delay, -most, most, "s")
                .map_err(|e| if cfg!(feature = "legs") { e } else { e.with_note("needs the feature `legs`") })?;
        }
        check("half_periods", f64::from(self.half_periods), 1.0, 16.0, "")?;
        if self.half_periods != 1 && !self.half_periods.is_multiple_of(2) {
            return Err(refuse("half_periods", f64::from(self.half_periods), "", "1, or an even number to 16"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATING: Rating = Rating { n_p: 2, J: 0.1, U_N: 400.0, I_N: 20.0, f_N: 50.0, T_N: 70.0 };

    fn close(a: f64, b: f64) {
        assert!((a - b).abs() <= 1e-13 * a.abs().max(b.abs()), "{a} != {b}");
    }

    #[test]
    fn gamma_round_trip_is_exact() {
        let m = Machine::preset_2k2();
        let back = Machine::from_gamma(m.to_gamma(), RATING);
        close(back.R_R, m.R_R);
        close(back.L_sigma, m.L_sigma);
        close(back.L_M, m.L_M);
    }

    #[test]
    fn t_model_round_trip_is_exact() {
        let m = Machine::preset_11k();
        let back = Machine::from_t_model(m.to_t_model(), RATING);
        close(back.R_R, m.R_R);
        assert!((back.L_sigma / m.L_sigma - 1.0).abs() < 1e-11, "small difference of large inductances");
        close(back.L_M, m.L_M);
    }

    #[test]
    fn error_names_field_value_and_range() {
        let m = Machine { R_s: -1.0, ..Machine::preset_2k2() };
        let e = m.validate().unwrap_err();
        assert_eq!((e.field, e.value), ("R_s", -1.0));
        let nan = Machine { L_M: f64::NAN, ..Machine::preset_2k2() };
        assert_eq!(nan.validate().unwrap_err().field, "L_M");
    }

    #[test]
    fn presets_are_valid() {
        for m in [Machine::preset_2k2(), Machine::preset_11k()] {
            m.validate().unwrap();
        }
        Inverter::preset_2k2().validate().unwrap();
        Inverter::preset_11k().validate().unwrap();
    }
}
