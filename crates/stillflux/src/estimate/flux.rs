//! Stator flux estimator of Fig. 7: a pure integrator, kept from drifting by the offset estimator of
//! Fig. 4 and kept on its circle by the noise compensator.
//!
//! ```text
//! û_i = û_s - r̂_s î_s                                                          (8)
//! ψ̂_s = ∫ (û_i - û_off + u_hf) dτ                                              Fig. 7
//! u_hf = k (ψ_s* - |ψ̂_s|) e^{jδ̂}                                               Section III-D
//! ```
//!
//! State: the two integrators (compensated, so that no increment is lost in a minute at zero frequency)
//! and the current sample that began the period. `û_s` is the voltage applied *between* the last two
//! current samples; `r̂_s î_s` is taken at their mean (trapezoid).
//!
//! Validity: the integral holds at any stator frequency, zero included, as long as `û_off` does. The
//! noise compensator acts on the radius only, and its gain `k = 2|ω_s|` is limited to a working range:
//! without a floor nothing would hold the radius at zero frequency, without a ceiling steady
//! disturbances would be turned into angle errors.
//!
//! The radius that it holds is `ψ_s*`, at high stator frequency the mean radius ([`super::radius`]).
//!
//! In regeneration with `0 < ω_s < ω` its steady action destabilises: an error of angle makes the true flux, and with it
//! the radius that the compensator corrects, change with the sign that turns the field further away. With `ψ̂_s - ψ_s = x + jy`
//! and the deviation `a` of the true flux, both in field coordinates, a steady torque current and speed, without leakage
//!
//! ```text
//! da/dτ = -(1/τ_r + h) a - h x - ω_r y,    dx/dτ = ω_s y - k (a + x),    dy/dτ = -ω_s x
//! s³ + (1/τ_r + h + k) s² + (ω_s² + k/τ_r) s + (1/τ_r + h) ω_s² + k ω_r ω_s = 0
//! k < (1/τ_r + h) |ω_s/ω_r|              where ω_r ω_s < 0
//! ```
//!
//! where `h`, the bandwidth `ω_f` of flux control, stands for its proportional part. With the leakage and all of flux control, whose
//! weight falls with `ω_s`, the bound is lower. So while regenerating
//!
//! ```text
//! k ≤ 0.3 |ω_s/ω_r| min(1/τ_r + ω_f, |ω_s|)
//! ```
//!
//! but at least [`FluxConfig::noise_regeneration`]. `tests/test_regeneration.py` has the polynomial with leakage and flux control,
//! counts over drawn machines, loads and speeds where its roots are unstable with this gain and with `2|ω_s|`, and compares its
//! bound with the plant's.

use super::integral::FluxIntegral;
use super::offset::{OFFSET_PERIODS, OffsetConfig, OffsetEstimator};
use super::radius::HeldRadius;
use crate::scalar::{Real, likely};
use crate::space::{AlphaBeta, Rotator};
use crate::words::words;

/// Part of its bound without leakage that the gain has while regenerating. Allowance, for what leakage and flux control take off
/// that bound.
const REGENERATION: f64 = 0.3;

/// Settings of the flux estimator.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct FluxConfig<R: Real> {
    /// Control period, normalised.
    pub t_s: R,
    /// Smallest gain of the noise compensator; with `noise_max = 0` the compensator is off.
    pub noise_min: R,
    /// Largest gain of the noise compensator.
    pub noise_max: R,
    /// Least gain of the noise compensator while regenerating.
    pub noise_regeneration: R,
    /// `1/τ_r + ω_f` with the bandwidth `ω_f` of flux control.
    pub regeneration_rate: R,
    /// Half of the time between two calls of [`FluxEstimator::set_stator_frequency`], normalised.
    pub half_interval: R,
    /// The parallel path with the offset estimator; `None`: its output stays what it was set to.
    pub offset: Option<OffsetConfig<R>>,
    /// Whether one of the two estimators of Section II takes the place of Fig. 7.
    #[cfg(feature = "variants")]
    pub replaced: bool,
    /// Corner frequency of the low-pass filter ([`super::lowpass`]) that does; zero: the limited integrator
    /// ([`super::limiter`]) does.
    #[cfg(feature = "variants")]
    pub low_pass: R,
}
words! {
    FluxConfig: t_s, noise_min, noise_max, noise_regeneration, regeneration_rate, half_interval, offset,
    #[cfg(feature = "variants")] replaced,
    #[cfg(feature = "variants")] low_pass,
}

/// What the estimator delivers for one period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct FluxEstimate<R: Real> {
    /// Stator flux linkage `ψ̂_s`.
    pub psi_s: AlphaBeta<R>,
    /// Field angle as `e^{jδ̂}`.
    pub field: Rotator<R>,
    /// `|ψ̂_s|`.
    pub magnitude: R,
    /// Induced voltage `û_i` of the period.
    pub u_i: AlphaBeta<R>,
    /// Output `u_hf` of the noise compensator.
    pub u_hf: AlphaBeta<R>,
}

/// State of the flux estimator.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct FluxEstimator<R: Real> {
    psi_s: FluxIntegral<R>,
    i_s: AlphaBeta<R>,
    u_i: AlphaBeta<R>,
    /// Gain of the noise compensator, and its output along the field axis.
    gain: R,
    effort: R,
    /// `0.3/|ω_r|` while the machine regenerates, else zero.
    per_slip: R,
    /// Radius that the noise compensator holds.
    radius: HeldRadius<R>,
    /// The parallel path of Fig. 4.
    pub offset: OffsetEstimator<R>,
}

impl<R: Real> FluxEstimator<R> {
    /// Begins at a known flux, with the current sample of this instant.
    pub fn start(&mut self, psi_s: AlphaBeta<R>, i_s: AlphaBeta<R>) {
        self.psi_s = FluxIntegral::new(psi_s);
        self.radius.start();
        self.i_s = i_s;
        self.u_i = AlphaBeta::default();
        self.per_slip = R::ZERO;
        self.offset.start(psi_s);
    }

    /// One period: `u_s` was applied since the last call, `i_s` is the sample at its end; `period`: its number. The parallel
    /// path takes the voltages of two periods together, in the odd one.
    #[inline(always)]
    pub fn step(
        &mut self,
        config: &FluxConfig<R>,
        (u_s, i_s): (&AlphaBeta<R>, &AlphaBeta<R>),
        r_s: R,
        psi_ref: R,
        period: u32,
    ) {
        let u_i = *u_s - (self.i_s + *i_s) * r_s.half();
        self.i_s = *i_s;

        #[cfg(feature = "variants")]
        if !likely(!config.replaced) {
            self.u_i = u_i;
            return self.step_replaced(config, &u_i, psi_ref);
        }

        self.effort = self.gain * (self.radius.value(psi_ref) - self.psi_s.magnitude());
        let u_hf = self.psi_s.field().axis() * self.effort;

        self.psi_s.add(config.t_s, &(u_i - self.offset.u_off() + u_hf));
        if period % OFFSET_PERIODS == 1
            && let Some(c) = &config.offset
        {
            self.offset.step(c, &((self.u_i + u_i) * R::HALF), psi_ref);
        }
        // Last: where the parallel path does not run, the voltage of the period before is not even read.
        self.u_i = u_i;
    }

    /// One period of an estimator of Section II, which has neither offset estimator nor noise compensator.
    #[cfg(feature = "variants")]
    #[cold]
    fn step_replaced(&mut self, config: &FluxConfig<R>, u_i: &AlphaBeta<R>, psi_ref: R) {
        if config.low_pass > R::ZERO {
            super::lowpass::step(&mut self.psi_s, config.t_s, config.low_pass, u_i);
        } else {
            super::limiter::step(&mut self.psi_s, config.t_s, u_i, psi_ref);
        }
    }

    /// Stator frequency, once in [`OffsetConfig::interval`]: sets the gain of the noise compensator and the time base
    /// of the offset estimator, and averages the radius, which need not be computed in every period.
    #[inline(always)]
    pub fn set_stator_frequency(&mut self, config: &FluxConfig<R>, omega_s: R) {
        let omega = omega_s.abs();
        let damped = omega + omega;
        // Branches: what is not asked for need not be computed.
        let gain = if damped > config.noise_min { damped.min(config.noise_max) } else { config.noise_min };
        self.gain = if likely(self.per_slip == R::ZERO) { gain } else { self.lowered(config, omega, gain) };
        if let Some(c) = &config.offset {
            self.offset.set_stator_frequency(c, omega_s);
        }
        self.radius.step(omega, config.half_interval, self.psi_s.magnitude());
        self.psi_s.confine();
    }

    /// Gain of the noise compensator while regenerating, at a magnitude of the stator frequency; `gain`: as in motoring.
    #[cold]
    #[inline(never)]
    fn lowered(&self, config: &FluxConfig<R>, omega: R, gain: R) -> R {
        let stable = omega * (omega.min(config.regeneration_rate) * self.per_slip).min(R::TWO);
        gain.min(stable.max(config.noise_regeneration))
    }

    /// Slip against the rotation, if the machine regenerates, as the next call of [`Self::set_stator_frequency`] takes it.
    #[inline(always)]
    pub fn set_regenerating(&mut self, slip: Option<R>) {
        self.per_slip = slip.map_or(R::ZERO, |x| R::from_f64(REGENERATION) * x.recip_seldom());
    }

    /// Field angle as `e^{jδ̂}`.
    #[inline]
    pub fn field(&self) -> Rotator<R> {
        self.psi_s.field()
    }

    /// `|ψ̂_s|`.
    #[inline]
    pub fn magnitude(&self) -> R {
        self.psi_s.magnitude()
    }

    /// Output of the noise compensator along the field axis.
    #[inline]
    pub fn effort(&self) -> R {
        self.effort
    }

    /// Everything of the latest period.
    pub fn estimate(&self) -> FluxEstimate<R> {
        FluxEstimate {
            psi_s: self.value(),
            field: self.field(),
            magnitude: self.magnitude(),
            u_i: self.u_i,
            u_hf: self.field().axis() * self.effort,
        }
    }

    /// Present `ψ̂_s`.
    #[inline]
    pub fn value(&self) -> AlphaBeta<R> {
        self.psi_s.value()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const T_S: f64 = 0.01;

    /// Worst angle error and worst deviation of the radius over the last of `periods` revolutions.
    fn run(noise: f64, offset: f64, periods: u32) -> (f64, f64) {
        let config = FluxConfig { noise_min: noise, noise_max: noise, ..CONFIG };
        let mut est = FluxEstimator::<f64>::default();
        est.start(AlphaBeta::new(1.0, 0.0), AlphaBeta::default());
        let omega: f64 = 0.05;
        let n = (core::f64::consts::TAU / (omega * T_S)) as u32;
        let (mut angle, mut radius) = (0.0_f64, 0.0_f64);
        for k in 0..n * periods {
            let (a, b) = (omega * T_S * f64::from(k), omega * T_S * f64::from(k + 1));
            let u = AlphaBeta::new((b.cos() - a.cos()) / T_S + offset, (b.sin() - a.sin()) / T_S);
            est.step(&config, (&u, &AlphaBeta::default()), 0.1, 1.0, k);
            est.set_stator_frequency(&config, omega);
            let out = est.estimate();
            let d = Rotator { cos: b.cos(), sin: b.sin() }.to_field(&out.psi_s);
            if k >= n * (periods - 1) {
                angle = angle.max(d.im().atan2(d.re()).abs());
                radius = radius.max((out.magnitude - 1.0).abs());
            }
        }
        (angle, radius)
    }

    #[test]
    fn pure_integral_of_clean_voltage_is_exact() {
        let (angle, radius) = run(0.0, 0.0, 10);
        assert!(angle < 1e-9 && radius < 1e-9);
    }

    #[test]
    fn noise_compensator_holds_the_radius_but_not_the_angle_against_an_offset() {
        let (_, free) = run(0.0, 0.005, 6);
        let (angle, held) = run(0.1, 0.005, 6);
        assert!(free > 1.0, "without it the integrator drifts away: {free}");
        // Damped resonance at ω: 2 u_0/k.
        assert!(held < 0.12, "{held}");
        assert!(angle > 0.1, "u_0/(ω_s ψ) of Fig. 10: {angle}");
    }

    const CONFIG: FluxConfig<f64> = FluxConfig {
        t_s: T_S,
        noise_min: 0.01,
        noise_max: 0.5,
        noise_regeneration: 0.02,
        regeneration_rate: 0.08,
        half_interval: T_S,
        offset: None,
        #[cfg(feature = "variants")]
        replaced: false,
        #[cfg(feature = "variants")]
        low_pass: 0.0,
    };

    #[test]
    fn the_resistive_voltage_is_taken_at_the_mean_of_the_two_samples() {
        let (before, now, psi) = (AlphaBeta::new(0.2, 0.1), AlphaBeta::new(0.6, -0.3), AlphaBeta::new(0.0, 1.0));
        let mut est = FluxEstimator::<f64>::default();
        est.start(psi, before);
        est.step(&CONFIG, (&((before + now) * 0.05), &now), 0.1, 1.0, 1);
        assert!((est.value() - psi).norm_sq() < 1e-24, "{:?}", est.value());
    }

    #[test]
    fn the_offset_voltage_is_taken_off_and_its_estimator_begins_at_the_same_flux() {
        let psi = AlphaBeta::new(0.6, -0.8);
        let mut est = FluxEstimator::<f64>::default();
        est.offset.restore(AlphaBeta::new(0.01, -0.02));
        est.start(psi, AlphaBeta::default());
        assert_eq!(est.offset.psi_1(), psi);
        for _ in 0..100 {
            est.step(&CONFIG, (&AlphaBeta::default(), &AlphaBeta::default()), 0.1, 1.0, 1);
        }
        assert!((est.value() - psi - AlphaBeta::new(-0.01, 0.02)).norm_sq() < 1e-20, "{:?}", est.value());
    }

    #[test]
    fn the_noise_compensator_acts_with_twice_the_stator_frequency_within_its_range() {
        for (omega, gain) in [(0.05, 0.1), (-0.05, 0.1), (0.001, 0.01), (0.0, 0.01), (0.28, 0.5), (-0.28, 0.5)] {
            let mut est = FluxEstimator::<f64>::default();
            est.start(AlphaBeta::new(0.0, 0.9), AlphaBeta::default());
            est.set_stator_frequency(&CONFIG, omega);
            est.step(&CONFIG, (&AlphaBeta::default(), &AlphaBeta::default()), 0.1, 1.0, 1);
            assert!((est.effort() - gain * 0.1).abs() < 1e-9, "{omega}: {}", est.effort());
            assert!((est.value() - AlphaBeta::new(0.0, 0.9 + T_S * gain * 0.1)).norm_sq() < 1e-20);
            est.start(AlphaBeta::new(0.0, 0.9), AlphaBeta::default());
            est.set_regenerating(Some(0.03));
            est.set_stator_frequency(&CONFIG, omega);
            est.step(&CONFIG, (&AlphaBeta::default(), &AlphaBeta::default()), 0.1, 1.0, 1);
            assert!(
                (est.effort() - gain.min((10.0 * omega.abs() * omega.abs().min(0.08)).max(0.02)) * 0.1).abs() < 1e-9,
                "regenerating {omega}: {}",
                est.effort()
            );
        }
    }

    /// Largest angle error, rad, in each of six turns of a field at frequency 1, with an error of the integral to begin
    /// with, whose radius falls to 0.8 of the reference within the first turn. `told`: frequency that the estimator is told.
    fn turns(error: f64, told: f64) -> [f64; 6] {
        let mut est = FluxEstimator::<f64>::default();
        est.start(AlphaBeta::new(1.0 + error, 0.0), AlphaBeta::default());
        let n = (core::f64::consts::TAU / T_S) as u32;
        let at = |k: u32| {
            let (turn, angle) = (f64::from(k) / f64::from(n), T_S * f64::from(k));
            AlphaBeta::new(angle.cos(), angle.sin()) * (1.0 - 0.2 * turn.min(1.0))
        };
        let mut found = [0.0_f64; 6];
        for k in 0..6 * n {
            if k % 2 == 0 {
                est.set_stator_frequency(&CONFIG, told);
            }
            let psi = at(k + 1);
            est.step(&CONFIG, (&((psi - at(k)) * (1.0 / T_S)), &AlphaBeta::default()), 0.1, 1.0, k);
            let angle = (psi.cross(&est.value()) / psi.norm_sq()).abs();
            found[(k / n) as usize] = found[(k / n) as usize].max(angle);
        }
        found
    }

    #[test]
    fn a_flux_that_is_not_at_its_reference_is_no_error_of_the_estimate_at_high_frequency() {
        // Held against the reference: k (ψ* - |ψ|)/(ω |ψ|).
        let against_reference = |found: [f64; 6]| assert!((found[5] - 0.125).abs() < 0.02, "{found:?}");
        against_reference(turns(0.0, 0.28));
        let found = turns(0.0, 1.0);
        if cfg!(feature = "weakening") {
            // While it falls the mean lags by 0.2/2π · 2, which turns the angle by k times that.
            assert!(found[0] < 0.05 && found[5] < 1e-3, "{found:?}");
        } else {
            against_reference(found);
        }
    }

    #[cfg(feature = "weakening")]
    #[test]
    fn an_error_of_the_integral_decays_while_the_mean_radius_is_held() {
        let found = turns(0.1, 1.0);
        // Rate 0.8 k/2 = 0.2 to the first order in k: by 0.08 in two turns.
        assert!(found[1] > 0.01 && found[3] < 0.2 * found[1] && found[5] < 1e-3, "{found:?}");
    }

    #[cfg(feature = "variants")]
    #[test]
    fn an_estimator_of_section_two_takes_the_place_of_fig_7() {
        for (low_pass, expected) in [(0.0, 1.0), (0.01, 2.0 - 0.01 * T_S)] {
            let config = FluxConfig { replaced: true, low_pass, ..CONFIG };
            let mut est = FluxEstimator::<f64>::default();
            est.start(AlphaBeta::new(1.0, 0.0), AlphaBeta::default());
            est.step(&config, (&AlphaBeta::new(1.0 / T_S, 0.0), &AlphaBeta::default()), 0.1, 1.0, 1);
            assert!((est.value().re() - expected).abs() < 1e-12, "{:?}", est.value());
        }
    }

    #[test]
    fn a_lost_flux_comes_back() {
        let mut est = FluxEstimator::<f64>::default();
        est.start(AlphaBeta::new(1.0, 0.0), AlphaBeta::default());
        est.step(&CONFIG, (&AlphaBeta::new(1e6, 0.0), &AlphaBeta::default()), 0.1, 1.0, 1);
        est.set_stator_frequency(&CONFIG, 0.0);
        assert!(est.value().norm_sq() <= 8.0);
    }
}
