//! Settings of the published scheme.

use crate::error::refuse;
use crate::params::{ParamError, check};

/// Settings of the published scheme.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PaperParams {
    /// Offset estimator of Fig. 4.
    pub offset_estimator: bool,
    /// Part of the measured offset voltage taken over per fundamental period, 0.01 to 1.
    pub offset_gain: f64,
    /// Noise compensator of Section III-D.
    pub noise_compensator: bool,
    /// Smallest and largest gain of the noise compensator, per unit, both up to 4.
    pub noise_gain: (f64, f64),
    /// Least gain of the noise compensator while regenerating, where it falls with the slip ([`crate::estimate::flux`]), per unit, up to 4.
    pub noise_regeneration: f64,
    /// Stator resistance adaptation of Fig. 12.
    pub resistance_adaptation: bool,
    /// Gain of the adaptation: change of `r̂_s` in per unit, per second and unit of ε, 0 to 5. In per unit the answer
    /// to a wrong resistance, `2 k i_q/ω_s`, is the same for all machines.
    pub resistance_gain: f64,
    /// Also adapt at rest without load, by the radius (Fig. 13a). Feature `variants`, as all that follow.
    pub resistance_at_rest: bool,
    /// Also adapt at light load away from rest, by the method of [9].
    pub resistance_at_light_load: bool,
    /// Weight ε by the quotient `ω_s/i_q` (Fig. 12) instead of its sign.
    pub resistance_quotient: bool,
    /// Estimate of the flux that a start begins with, per unit, each component within ±2; `None`: the estimator begins
    /// at the flux that the magnetisation has built up.
    pub initial_flux: Option<(f64, f64)>,
    /// Corner frequency of a low-pass filter in place of Fig. 7, 0 to 10 Hz; 0: none.
    pub low_pass: f64,
    /// An integrator with limited components in place of Fig. 7; excludes `low_pass`.
    pub limiter: bool,
}

impl Default for PaperParams {
    fn default() -> Self {
        Self {
            offset_estimator: true,
            offset_gain: 0.5,
            noise_compensator: true,
            noise_gain: (0.06, 0.5),
            noise_regeneration: 0.005,
            resistance_adaptation: true,
            resistance_gain: 0.42,
            resistance_at_rest: false,
            resistance_at_light_load: false,
            resistance_quotient: false,
            initial_flux: None,
            low_pass: 0.0,
            limiter: false,
        }
    }
}

impl PaperParams {
    pub(super) fn validate(&self) -> Result<(), ParamError> {
        check("offset_gain", self.offset_gain, 0.01, 1.0, "")?;
        check("noise_gain[0]", self.noise_gain.0, 0.0, 4.0, "")?;
        check("noise_gain[1]", self.noise_gain.1, self.noise_gain.0, 4.0, "")?;
        check("noise_regeneration", self.noise_regeneration, 0.0, 4.0, "")?;
        check("resistance_gain", self.resistance_gain, 0.0, 5.0, "p.u./s")?;
        for (name, x) in ["initial_flux[0]", "initial_flux[1]"].into_iter().zip(self.initial()) {
            check(name, x, -2.0, 2.0, "p.u.")?;
        }
        check("low_pass", self.low_pass, 0.0, 10.0, "Hz")?;
        if self.limiter && self.low_pass > 0.0 {
            return Err(refuse("low_pass", self.low_pass, "Hz", "0 with limiter: each is in place of Fig. 7"));
        }
        if cfg!(feature = "variants") {
            return Ok(());
        }
        self.refuse_variants("built with the feature `variants` only")
    }

    /// The initial flux as it is checked.
    fn initial(&self) -> [f64; 2] {
        self.initial_flux.map_or([0.0; 2], |(re, im)| [re, im])
    }

    /// An error for the first of the variants that is chosen.
    fn refuse_variants(&self, why: &'static str) -> Result<(), ParamError> {
        let off = |field, chosen| check(field, f64::from(u8::from(chosen)), 0.0, 0.0, "").map_err(|e| e.with_note(why));
        off("resistance_at_rest", self.resistance_at_rest)?;
        off("resistance_at_light_load", self.resistance_at_light_load)?;
        off("resistance_quotient", self.resistance_quotient)?;
        off("initial_flux", self.initial_flux.is_some())?;
        off("low_pass", self.low_pass > 0.0)?;
        off("limiter", self.limiter)
    }

    /// An error for the first field that is not at its default.
    pub(super) fn refuse_changes(&self) -> Result<(), ParamError> {
        let d = Self::default();
        const WHY: &str = "a setting of the published scheme, and the drive runs the enhanced one";
        let same = |field, value, default| check(field, value, default, default, "").map_err(|e| e.with_note(WHY));
        let switch = |field, value, default| same(field, f64::from(u8::from(value)), f64::from(u8::from(default)));
        switch("offset_estimator", self.offset_estimator, d.offset_estimator)?;
        same("offset_gain", self.offset_gain, d.offset_gain)?;
        switch("noise_compensator", self.noise_compensator, d.noise_compensator)?;
        same("noise_gain[0]", self.noise_gain.0, d.noise_gain.0)?;
        same("noise_gain[1]", self.noise_gain.1, d.noise_gain.1)?;
        same("noise_regeneration", self.noise_regeneration, d.noise_regeneration)?;
        switch("resistance_adaptation", self.resistance_adaptation, d.resistance_adaptation)?;
        same("resistance_gain", self.resistance_gain, d.resistance_gain)?;
        self.refuse_variants(WHY)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn what_excludes_another_setting_names_it() {
        let both = PaperParams { low_pass: 0.5, limiter: true, ..PaperParams::default() };
        let text = "low_pass = 0.5 Hz is not admissible: 0 with limiter: each is in place of Fig. 7";
        assert_eq!(both.validate().unwrap_err().to_string(), text);
        let large = PaperParams { low_pass: 20.0, ..both };
        assert_eq!(
            large.validate().unwrap_err().to_string(),
            "low_pass = 20 Hz is outside the admissible range 0 to 10 Hz"
        );
    }

    #[cfg(feature = "variants")]
    #[test]
    fn each_of_them_is_admissible() {
        let both = PaperParams { low_pass: 0.5, limiter: true, ..PaperParams::default() };
        assert!(PaperParams { low_pass: 0.0, ..both }.validate().is_ok());
        assert!(PaperParams { limiter: false, ..both }.validate().is_ok());
    }
}
