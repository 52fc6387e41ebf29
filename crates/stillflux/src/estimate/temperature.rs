//! Rotor resistance from the stator's: both follow a temperature. Per unit.
//!
//! ```text
//! r_s = r_s0 + r_cu (ϑ - ϑ_0)/(235 + ϑ_0)                              winding of copper, ϑ in °C; r_s0 contains r_d
//! r_R = r_R0 (1 + ρ (ϑ - ϑ_0)/(θ_R + ϑ_0))                             cage of aluminium (θ_R = 225) or copper (235)
//! ⇒  r̂_R/r_R0 = 1 + g (r̂_s - r_s0),    g = ρ (235 + ϑ_0)/((θ_R + ϑ_0) r_cu)
//! dr_s/dt = (r_s0 + r_cu ΔT_N/(235 + ϑ_0) i² - r_s)/τ                  prediction by the current, `i` = 1: rated
//! ```
//!
//! `r_s0` and `r_R0` are the parameters, which hold at the winding's temperature `ϑ_0` (that of the commissioning); `ρ` is
//! the rise of the rotor's temperature over that of the winding's, `ΔT_N` the winding's rise at rated current, `τ` its time
//! constant.
//!
//! **What is known how well.** The filter's `r̂_s` with variance `P` is the mean of `r_s` given prior and measurements; `r_R`
//! is linear in it, so `r̂_R` is the mean of `r_R`, and in steady state, where the slip is `ω_r = r_R i_q/|ψ_R|` and `ω_s`
//! that of the flux,
//!
//! ```text
//! δω = -ω_r δr_R/r_R,    (δr_R/r_R)² = (g √P)² + ((ϑ_R - ϑ_0 - ρ (ϑ - ϑ_0))/(θ_R + ϑ_0))²
//! ```
//!
//! A percent of `r̂_s`, or 2.5 K between rotor and winding, is a percent of the slip. Where a temperature is
//! known the filter identifies `r_s` up to `|ω_s| = 0.35` instead of 0.2 ([`crate::estimate::kalman`]), so that a motor at 0.2
//! of rated speed under load shows it. Above, `r̂_s` is held and the error grows with the winding's temperature: the
//! prediction carries it there. Its own error is that of `ΔT_N`, of a part `1 - e^(-t/τ)`. Below it is a drift of the
//! state that is known; what the filter measures corrects it.
//!
//! **Torque.** A flux that is estimated by the voltage satisfies the balance of active power, `ω_s T̂ = u·i - r̂_s i²`,
//! whatever its other errors, so that an error of the resistance is one of the torque,
//!
//! ```text
//! δT = δr_s i²/ω_s
//! ```
//!
//! largest where `r_s` begins to be predicted: with 2 % of `r_s` = 0.15, the current of rated torque and `ω_s` = 0.35 it is
//! 1 % of rated torque. It displaces the flux by `δψ = -j δr_s i/ω_s`, which the innovation shows. Were `r_s` not
//! correlated with the flux, the magnetising curve, which is identified at any speed, would take this for an error of its
//! own: after a while at half speed the curve fits there, and it is wrong where the field is slower and the displacement
//! larger. That adds to `δT` (3.1 % in all at 0.37 kW in regeneration, when `r_s` was held down to 0.2). So where it is predicted `r_s` keeps its
//! correlation with the flux (Schmidt's consider state), with a variance that grows up to that of a tenth of `ΔT_N`. `r̂_s`
//! itself is not corrected there: the innovation shows errors of the leakage inductance just as well.
//!
//! **Validity.** While the drive runs: what a winding cools at a stop the next start measures. The ratio is limited to 0.7
//! to 2. Without a temperature `g` is zero, and `r_R` is the parameter.

use crate::base::{PerUnit, rounded};
use crate::params::Machine;
use crate::scalar::{Real, clamp_seldom};
use crate::words::words;

/// Temperature at which copper would have no resistance, °C, sign reversed.
pub const COPPER: f64 = 235.0;
/// The same of a cast aluminium cage.
pub const ALUMINIUM: f64 = 225.0;

/// Range of `r̂_R/r_R0`: rotors from 70 K below to 240 K above 20 °C.
const RATIO: (f64, f64) = (0.7, 2.0);
/// Relative standard deviation of `ΔT_N`: what is known of a winding's heating. Allowance.
const DEVIATION_RISE: f64 = 0.1;
/// Largest standard deviation of the prediction: that of a winding of unknown temperature.
const DEVIATION_MOST: f64 = 0.2;
/// Factor by which small numbers are kept within fixed point.
const SCALE: f64 = 64.0;

/// What is known of the temperatures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Temperature {
    /// `ϑ_0`, °C.
    pub winding: f64,
    /// `θ_R`, K.
    pub cage: f64,
    /// `ρ`.
    pub rotor_rise: f64,
    /// `ΔT_N` in K and `τ` in s, if they are known.
    pub heat: Option<(f64, f64)>,
}

/// Settings, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct TemperatureConfig<R: Real> {
    /// `r_s0`.
    r_s: R,
    /// `g` over [`SCALE`]; 0: the rotor resistance is the parameter.
    gain: R,
    /// `r_cu ΔT_N/(235 + ϑ_0)`.
    heat: R,
    /// Time between two predictions over `τ`, times [`SCALE`]; 0: no prediction.
    rate: R,
    /// Standard deviation of the predicted `r_s`, relative to `r_s0`; 0 without prediction.
    deviation: R,
}
words!(TemperatureConfig: r_s, gain, heat, rate, deviation);

impl<R: Real> TemperatureConfig<R> {
    /// For predictions every `seconds`; without temperatures nothing is corrected.
    #[must_use]
    pub fn new(machine: &Machine, pu: &PerUnit, known: Option<&Temperature>, seconds: f64) -> Self {
        let r_cu = machine.R_s / pu.base.z;
        let (gain, heat, rate) = known.map_or((0.0, 0.0, 0.0), |t| {
            let (rise, rate) = t.heat.map_or((0.0, 0.0), |(rise, time)| (rise, seconds / time));
            let copper = COPPER + t.winding;
            (t.rotor_rise * copper / ((t.cage + t.winding) * r_cu), r_cu * rise / copper, rate)
        });
        Self {
            r_s: rounded(pu.r_s),
            gain: rounded(gain / SCALE),
            heat: rounded(heat),
            rate: rounded(SCALE * rate),
            deviation: rounded((DEVIATION_RISE * heat / pu.r_s).min(DEVIATION_MOST)),
        }
    }

    /// `r̂_R/r_R0` at a stator resistance.
    #[inline(always)]
    pub fn rotor(&self, r_s: R) -> R {
        let rise = self.gain * ((r_s - self.r_s) * R::from_f64(SCALE));
        clamp_seldom(R::ONE + rise, R::from_f64(RATIO.0), R::from_f64(RATIO.1))
    }

    /// Whether the stator resistance is predicted.
    #[inline(always)]
    pub fn predicts(&self) -> bool {
        self.rate > R::ZERO
    }

    /// Standard deviation of the prediction, relative to `r_s0`, if there is one.
    #[inline(always)]
    pub fn deviation(&self) -> Option<R> {
        self.predicts().then_some(self.deviation)
    }

    /// Gain and argument, over [`SCALE`], of the stator resistance's increment at a squared current.
    #[inline(always)]
    pub fn increment(&self, r_s: R, i_sq: R) -> (R, R) {
        (self.rate, (self.r_s + self.heat * i_sq - r_s).quarter().quarter().quarter())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::Inverter;
    use crate::scalar::{Integrator, Q};

    const KNOWN: Temperature =
        Temperature { winding: 20.0, cage: ALUMINIUM, rotor_rise: 1.1, heat: Some((80.0, 600.0)) };

    fn config<R: Real>(known: Option<&Temperature>) -> (TemperatureConfig<R>, f64, f64) {
        let machine = Machine::preset_2k2();
        let pu = PerUnit::new(&machine, &Inverter::preset_2k2()).unwrap();
        (TemperatureConfig::new(&machine, &pu, known, 1e-3), pu.r_s, machine.R_s / pu.base.z)
    }

    fn follows<R: Real>() {
        let (c, r_s0, r_cu) = config::<R>(Some(&KNOWN));
        for kelvin in [-30.0, 0.0, 40.0, 80.0] {
            let ratio = c.rotor(R::from_f64(r_s0 + r_cu * kelvin / 255.0)).to_f64();
            let exact = 1.0 + 1.1 * kelvin / 245.0;
            assert!((ratio - exact).abs() < 1e-4, "{} {kelvin}: {ratio} {exact}", R::NAME);
        }
        assert_eq!((c.rotor(R::ZERO).to_f64(), c.rotor(R::ONE)), (R::from_f64(0.7).to_f64(), R::TWO));
        let off = config::<R>(None).0;
        assert!(off.rotor(R::ONE) == R::ONE && off.rotor(R::ZERO) == R::ONE && !off.predicts());
    }

    /// A winding at rated current over one time constant.
    fn heats<R: Real>() {
        let (c, r_s0, r_cu) = config::<R>(Some(&KNOWN));
        let mut r_s = Integrator::<R>::new(R::from_f64(r_s0));
        for _ in 0..600_000 {
            let (gain, x) = c.increment(r_s.value(), R::ONE);
            r_s.add(gain, x);
        }
        let kelvin = (r_s.value().to_f64() - r_s0) / r_cu * 255.0;
        assert!((kelvin / (80.0 * (1.0 - (-1.0f64).exp())) - 1.0).abs() < 0.01, "{} {kelvin}", R::NAME);
    }

    #[test]
    fn the_rotor_resistance_follows_the_temperature_of_the_winding_within_limits() {
        follows::<f32>();
        follows::<f64>();
        follows::<Q>();
    }

    #[test]
    fn the_prediction_loses_no_small_increment() {
        heats::<f32>();
        heats::<f64>();
        heats::<Q>();
    }
}
