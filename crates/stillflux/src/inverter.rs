//! Nonlinear inverter model, equations (4)-(7) of the paper, and the dead time.
//!
//! ```text
//! u_th(i_s) = 4/3 u_th sec(i_s),   sec(i_s) = 1/2 (sign i_a + a sign i_b + a² sign i_c)     (5), (6)
//! u_s = u*_inv - u_th(i_s) - r_d i_s                                                         (7)
//! ```
//!
//! A leg that commutates with dead time `T_d` loses `T_d/T_s u_dc` of its average voltage in the direction
//! of its current, exactly as a threshold does: both are one term here. The term `r_d i_s` is *not*
//! compensated: it is in series with the winding and `r̂_s` identifies the sum (Section III-E).
//!
//! **At current zero.** Within the dead time a small phase current reaches zero and stays there (both
//! switches are open), so the average error passes from one sign to the other over a band of currents,
//! not in a step. The band is at most what the current can change by while both switches are off,
//! `(2/3) u_dc T_d / sigma L_s`, and narrower where the legs commutate together (half of it was seen at
//! 2.2 kW, a tenth at 11 kW, both at standstill). No model knows it exactly, but the *sign* of the error is
//! a matter of choice: at no load and zero stator frequency the current of a phase is zero where the field
//! stands across its axis, and an error of the compensation turns the field. A band wider than the real one
//! draws the field to that place and keeps it there, where the voltage is known least; a narrower one
//! pushes it away. The model therefore takes a tenth of the physical band, linear inside.

use crate::base::{Base, PerUnit};
use crate::params::{Inverter, Machine};
use crate::scalar::{Real, likely};
use crate::space::AlphaBeta;
use crate::words::words;

/// Width of the model's band as part of the physical one.
const BAND: f64 = 0.1;
/// Keeps the reciprocal of a narrow band within the fixed-point range.
const SCALE: f64 = 64.0;

/// Parameters of the inverter model, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct InverterModel<R: Real> {
    /// Threshold voltage.
    u_th: R,
    /// Dead time as part of the period.
    dead_time: R,
    /// Half width of the linear band around current zero.
    band: R,
    /// `1 / (SCALE · band)`.
    inv_band: R,
}
words!(InverterModel: u_th, dead_time, band, inv_band);

impl<R: Real> InverterModel<R> {
    /// Model of an inverter that feeds a machine.
    #[must_use]
    pub fn new(machine: &Machine, inverter: &Inverter, pu: &PerUnit<R>) -> Self {
        let base = Base::new(machine);
        let swing = 2.0 / 3.0 * inverter.u_dc * inverter.dead_time / machine.L_sigma / base.i;
        let band = (BAND * swing).clamp(2e-4, 0.05);
        Self {
            u_th: pu.u_th,
            dead_time: pu.dead_time,
            band: R::from_f64(band),
            inv_band: R::from_f64(1.0 / (SCALE * band)),
        }
    }

    /// A model of an ideal inverter: no compensation.
    #[must_use]
    pub fn ideal() -> Self {
        Self { u_th: R::ZERO, dead_time: R::ZERO, band: R::ZERO, inv_band: R::ONE }
    }

    /// Voltage lost in each phase at the phase currents of `i_s`: add it to the reference to compensate. `gain`
    /// is what has been found of threshold and dead time, relative to their values here.
    #[inline]
    pub fn distortion(&self, i_s: &AlphaBeta<R>, u_dc: R, gain: R) -> [R; 3] {
        let u = (self.u_th + self.dead_time * u_dc) * gain;
        let leg = |i: R| {
            if likely(!i.within(self.band)) {
                if i < R::ZERO { -u } else { u }
            } else {
                i * self.inv_band * (u * R::from_f64(SCALE))
            }
        };
        let [a, b, c] = i_s.to_phases();
        [leg(a), leg(b), leg(c)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model() -> (InverterModel<f64>, PerUnit<f64>) {
        let (m, inv) = (Machine::preset_2k2(), Inverter { dead_time: 0.0, ..Inverter::preset_2k2() });
        let pu = PerUnit::new(&m, &inv).unwrap();
        (InverterModel::new(&m, &inv, &pu), pu)
    }

    #[test]
    fn threshold_vector_has_six_positions_of_four_thirds_u_th() {
        let (model, pu) = model();
        for k in 0..360 {
            let (s, c) = (f64::from(k) + 0.5).to_radians().sin_cos();
            let u = AlphaBeta::from_phases(model.distortion(&AlphaBeta::new(c, s), pu.u_dc, 1.0));
            assert!((u.norm_sq().sqrt() - 4.0 / 3.0 * pu.u_th).abs() < 1e-12);
            let angle = u.im().atan2(u.re()).to_degrees().rem_euclid(60.0);
            assert!(!(1e-6..=59.999_999).contains(&angle), "sector indicator points to multiples of 60°");
        }
    }

    #[test]
    fn around_current_zero_the_model_is_linear() {
        let (model, pu) = model();
        let at = |i: f64| model.distortion(&AlphaBeta::new(i, 0.0), pu.u_dc, 1.0)[0];
        assert_eq!(at(0.0), 0.0);
        assert!((at(1e-4) - 0.5 * pu.u_th).abs() < 1e-12);
        assert!((at(1.0) - pu.u_th).abs() < 1e-12);
        assert_eq!(at(-0.3), -at(0.3));
    }

    #[test]
    fn dead_time_is_lost_as_a_threshold_and_both_scale_with_what_was_found() {
        let (m, inv) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let pu = PerUnit::<f64>::new(&m, &inv).unwrap();
        let model = InverterModel::new(&m, &inv, &pu);
        // 1 V and 2 µs of 100 µs at 540 V, of 326.6 V.
        let lost = |gain| model.distortion(&AlphaBeta::new(0.7, 0.0), pu.u_dc, gain);
        let volts = (1.0 + 0.02 * 540.0) / Base::new(&m).u;
        for gain in [1.0, 1.3, 0.0] {
            for (u, sign) in lost(gain).iter().zip([1.0, -1.0, -1.0]) {
                assert!((u - sign * gain * volts).abs() < 1e-12, "{u}");
            }
        }
    }

    #[test]
    fn the_band_is_a_tenth_of_what_the_current_changes_by_in_a_dead_time() {
        let (m, inv) = (Machine::preset_11k(), Inverter::preset_11k());
        let pu = PerUnit::<f64>::new(&m, &inv).unwrap();
        let model = InverterModel::new(&m, &inv, &pu);
        let band = 0.1 * 2.0 / 3.0 * inv.u_dc * inv.dead_time / m.L_sigma / Base::new(&m).i;
        let full = model.distortion(&AlphaBeta::new(1.0, 0.0), pu.u_dc, 1.0)[0];
        for (i, part) in [(0.5, 0.5), (0.9, 0.9), (1.01, 1.0), (-0.5, -0.5)] {
            let u = model.distortion(&AlphaBeta::new(i * band, 0.0), pu.u_dc, 1.0)[0];
            assert!((u / full - part).abs() < 1e-9, "{i} of the band: {}", u / full);
        }
    }
}
