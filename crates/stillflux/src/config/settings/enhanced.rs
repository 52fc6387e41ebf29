//! Settings of the enhanced scheme.

use crate::base::Base;
use crate::error::refuse;
use crate::estimate::priors::Priors;
use crate::estimate::temperature::ALUMINIUM;
#[cfg(feature = "enhanced")]
use crate::estimate::temperature::Temperature;
use crate::params::{Machine, ParamError, check};

/// Settings of the enhanced scheme.
#[allow(non_snake_case)]
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct EnhancedParams {
    /// Estimate the offset of the current sensors.
    pub identify_offset: bool,
    /// Estimate stator resistance, inverter error and knee. Off, for comparisons: what they are off by stays, and a few percent of
    /// `R_s` lose the field under load at low speed.
    pub identify_resistance: bool,
    /// Measure at each start at standstill how the legs of the bridge differ ([`crate::estimate`]'s `legs`), in the first
    /// 0.2 s of its magnetisation, 0.74 s at 160 kW; not without `inverter_model` and `calibrate_offset`, nor with a `current_bandwidth`
    /// below `7.6 R_R/L_M`, in Hz.
    pub identify_legs: bool,
    /// Look at each start for a shaft that something else turns slowly ([`crate::estimate`]'s `slow_turn`), and in a machine that
    /// turns without flux for the circle of the flux that builds up (`circle`); without it a slow shaft is taken to stand still, and the field is off by
    /// `arctan ω τ_r`, and large machines may be lost that turn without flux. Needs the feature `restart`.
    pub find_slow_rotation: bool,
    /// Correct the inductances while the load changes alone ([`crate::estimate::kalman`]); otherwise always, by which a
    /// steady load of minutes carries them away.
    pub hold_inductances: bool,
    /// Correct the states by the filter's innovation; without it the flux is a pure integral.
    pub apply_innovation: bool,
    /// Stator frequency that is kept under load, electrical rad/s: where it would be smaller the flux is lowered, by at
    /// most 30 % ([`crate::control::shift`]). 0: the flux stays. By default 0.4 of the rated slip frequency, which at rated
    /// load takes a sixth of the flux, and 0.006 of rated frequency at least; 0.001 to 0.05 of it are admissible.
    pub omega_s_min: f64,
    /// Amplitude of an oscillation of the torque near zero stator frequency in parts of rated torque, 0 to 0.3, by which the field
    /// does not stay at the zeros of the phase currents ([`crate::control`]'s `dither`). 0.05 by default, 0 (none) without the
    /// feature `dither`.
    pub dither: f64,
    /// Relative standard deviation with which the filter begins, at least 0.002: of the stator resistance with its
    /// temperature, at most 0.5.
    pub prior_R_s: f64,
    /// Of threshold and dead time, at most 1.
    pub prior_loss: f64,
    /// Of the legs' capacitance, at most 1.
    pub prior_c_out: f64,
    /// Of the leakage inductance, at most 1.
    pub prior_L_sigma: f64,
    /// Of the rotor resistance with its temperature, at most 0.5: a start at standstill estimates it.
    pub prior_R_R: f64,
    /// Of the magnetising inductance, at most 0.5.
    pub prior_L_M: f64,
    /// Temperature of winding and rotor at which `R_s` and `R_R` hold, -40 to 120 °C: the rotor resistance follows the
    /// stator's ([`crate::estimate::temperature`]). `None`: it is the parameter. The next three with it only.
    pub winding_temperature: Option<f64>,
    /// Constant of the cage's material, 200 to 260 K: 225 for aluminium, 235 for copper.
    pub cage_constant: f64,
    /// Rise of the rotor's temperature over that of the winding's, 0.3 to 2.
    pub rotor_rise: f64,
    /// Rise of the winding's temperature at rated current in K, 5 to 200, and its time constant in s, 1 to 7200: the
    /// stator resistance is predicted where it is not measured. `None`: it is held there.
    pub winding_heat: Option<(f64, f64)>,
}

/// Parts of the rated frequency and of the rated slip.
const SHIFT_LEAST: f64 = 0.006;
const SHIFT: f64 = 0.4;
/// Admissible, of rated frequency. Slower the field does not turn once in 20 s at 50 Hz: no use, and per unit mistaken for rad/s.
const SHIFT_RANGE: (f64, f64) = (0.001, 0.05);
/// Dither by default, in parts of rated torque.
const DITHER: f64 = 0.05;
/// Largest dither.
const DITHER_MOST: f64 = 0.3;

/// Stator frequency to keep, rad/s. A constant error of the voltage turns the flux by the more, the slower the field turns; the
/// flux that is given up for it is `1 - √(1/1.4)` at rated load, whatever the slip.
fn shift(machine: &Machine) -> f64 {
    let base = Base::new(machine);
    let psi_r = machine.L_M / machine.L_s();
    let slip = machine.R_R / base.z * machine.T_N / base.torque / (psi_r * psi_r);
    // Within its range for machines with an unusual slip.
    (SHIFT * slip).clamp(SHIFT_LEAST, SHIFT_RANGE.1) * base.omega
}

impl EnhancedParams {
    /// Defaults for a machine.
    #[must_use]
    pub fn new(machine: &Machine) -> Self {
        let Priors { r_s, loss, knee, leakage, r_r, l_m } = Priors::default();
        Self {
            identify_offset: true,
            identify_resistance: true,
            identify_legs: cfg!(feature = "legs"),
            find_slow_rotation: cfg!(feature = "restart"),
            hold_inductances: true,
            apply_innovation: true,
            omega_s_min: shift(machine),
            dither: if cfg!(feature = "dither") { DITHER } else { 0.0 },
            prior_R_s: r_s,
            prior_loss: loss,
            prior_c_out: knee,
            prior_L_sigma: leakage,
            prior_R_R: r_r,
            prior_L_M: l_m,
            winding_temperature: None,
            cage_constant: ALUMINIUM,
            rotor_rise: 1.0,
            winding_heat: None,
        }
    }

    pub(super) fn validate(&self, machine: &Machine) -> Result<(), ParamError> {
        if self.omega_s_min != 0.0 {
            let (least, most) = SHIFT_RANGE;
            check("omega_s_min", self.omega_s_min, least * machine.omega_sR(), most * machine.omega_sR(), "rad/s")
                .map_err(|e| e.with_note("electrical, not per unit; 0: the flux stays"))?;
        }
        let most = if cfg!(feature = "dither") { DITHER_MOST } else { 0.0 };
        check("dither", self.dither, 0.0, most, "")
            .map_err(|e| if most > 0.0 { e } else { e.with_note("needs the feature `dither`") })?;
        self.priors().into_iter().try_for_each(|(name, value, most)| check(name, value, 0.002, most, ""))?;
        let built = |field, on: bool, built: bool, note| {
            check(field, f64::from(u8::from(on)), 0.0, f64::from(u8::from(built)), "").map_err(|e| e.with_note(note))
        };
        built("identify_legs", self.identify_legs, cfg!(feature = "legs"), "needs the feature `legs`")?;
        built("find_slow_rotation", self.find_slow_rotation, cfg!(feature = "restart"), "needs the feature `restart`")?;
        self.validate_temperature()
    }

    fn validate_temperature(&self) -> Result<(), ParamError> {
        let Some(winding) = self.winding_temperature else {
            return self.no_temperature();
        };
        check("winding_temperature", winding, -40.0, 120.0, "°C")?;
        check("cage_constant", self.cage_constant, 200.0, 260.0, "K")?;
        check("rotor_rise", self.rotor_rise, 0.3, 2.0, "")?;
        if let Some((rise, time)) = self.winding_heat {
            check("winding_heat[0]", rise, 5.0, 200.0, "K")?;
            check("winding_heat[1]", time, 1.0, 7200.0, "s")?;
        }
        Ok(())
    }

    /// An error for the first setting that needs a `winding_temperature`, which is not given.
    fn no_temperature(&self) -> Result<(), ParamError> {
        let same = |field, value, default, unit, note| {
            check(field, value, default, default, "").map_err(|_| refuse(field, value, unit, note))
        };
        same("cage_constant", self.cage_constant, ALUMINIUM, "K", "200 to 260 K, with a winding_temperature only")?;
        same("rotor_rise", self.rotor_rise, 1.0, "", "0.3 to 2, with a winding_temperature only")?;
        self.winding_heat.map_or(Ok(()), |(rise, _)| {
            const NOTE: &str = "5 to 200 K, and 1 to 7200 s, with a winding_temperature only";
            Err(refuse("winding_heat[0]", rise, "K", NOTE))
        })
    }

    /// An error for the first setting of the temperatures that is not that of `d`.
    fn same_temperature(&self, d: &Self, why: &'static str) -> Result<(), ParamError> {
        let same = |field, value, default| check(field, value, default, default, "").map_err(|e| e.with_note(why));
        let flag = |x: bool| f64::from(u8::from(x));
        same("winding_temperature", flag(self.winding_temperature.is_some()), flag(d.winding_temperature.is_some()))?;
        same("cage_constant", self.cage_constant, d.cage_constant)?;
        same("rotor_rise", self.rotor_rise, d.rotor_rise)?;
        same("winding_heat", flag(self.winding_heat.is_some()), flag(d.winding_heat.is_some()))
    }

    /// What is known of the temperatures.
    #[cfg(feature = "enhanced")]
    pub(crate) fn temperature(&self) -> Option<Temperature> {
        let Self { cage_constant: cage, rotor_rise, winding_heat: heat, .. } = *self;
        self.winding_temperature.map(|winding| Temperature { winding, cage, rotor_rise, heat })
    }

    /// Name, value and largest admissible value of each prior: its variance, in units of the filter's scale of that
    /// state, has to fit fixed point.
    fn priors(&self) -> [(&'static str, f64, f64); 6] {
        [
            ("prior_R_s", self.prior_R_s, 0.5),
            ("prior_loss", self.prior_loss, 1.0),
            ("prior_c_out", self.prior_c_out, 1.0),
            ("prior_L_sigma", self.prior_L_sigma, 1.0),
            ("prior_R_R", self.prior_R_R, 0.5),
            ("prior_L_M", self.prior_L_M, 0.5),
        ]
    }

    /// An error for the first field that is not at its default.
    pub(super) fn refuse_changes(&self, machine: &Machine) -> Result<(), ParamError> {
        const OTHER: &str = "a setting of the enhanced scheme, and the drive runs the published one";
        let d = Self::new(machine);
        let same = |field, value, default| check(field, value, default, default, "").map_err(|e| e.with_note(OTHER));
        let switch = |field, value, default| same(field, f64::from(u8::from(value)), f64::from(u8::from(default)));
        switch("identify_offset", self.identify_offset, d.identify_offset)?;
        switch("identify_resistance", self.identify_resistance, d.identify_resistance)?;
        switch("identify_legs", self.identify_legs, d.identify_legs)?;
        switch("find_slow_rotation", self.find_slow_rotation, d.find_slow_rotation)?;
        switch("hold_inductances", self.hold_inductances, d.hold_inductances)?;
        switch("apply_innovation", self.apply_innovation, d.apply_innovation)?;
        same("omega_s_min", self.omega_s_min, d.omega_s_min)?;
        same("dither", self.dither, d.dither)?;
        let mut priors = self.priors().into_iter().zip(d.priors());
        priors.try_for_each(|((name, value, _), (_, default, _))| same(name, value, default))?;
        self.same_temperature(&d, OTHER)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn a_setting_that_needs_a_temperature_says_so_and_what_it_can_be() {
        let machine = Machine::preset_2k2();
        let given = EnhancedParams::new(&machine);
        assert!(given.validate(&machine).is_ok());
        for (alone, text) in [
            (
                EnhancedParams { cage_constant: 235.0, ..given },
                "cage_constant = 235 K is not admissible: 200 to 260 K, with a winding_temperature only",
            ),
            (
                EnhancedParams { rotor_rise: 1.2, ..given },
                "rotor_rise = 1.2 is not admissible: 0.3 to 2, with a winding_temperature only",
            ),
            (
                EnhancedParams { winding_heat: Some((80.0, 600.0)), ..given },
                "winding_heat[0] = 80 K is not admissible: 5 to 200 K, and 1 to 7200 s, with a winding_temperature only",
            ),
        ] {
            assert_eq!(alone.validate(&machine).unwrap_err().to_string(), text);
            assert!(EnhancedParams { winding_temperature: Some(20.0), ..alone }.validate(&machine).is_ok());
        }
        assert!(EnhancedParams { rotor_rise: f64::NAN, ..given }.validate(&machine).is_err());
    }
}
