//! Estimators of the published scheme: Figs. 4, 7, 12, and the confidence model on top.

use super::{Seen, Slow};
use crate::base::{Base, PerUnit, rounded};
use crate::config::{DriveConfig, DriveParams, SLOW_PERIODS, SPEED_PERIODS};
use crate::drive::Memory;
use crate::estimate::confidence::{Confidence, ConfidenceConfig};
use crate::estimate::flux::{FluxConfig, FluxEstimate, FluxEstimator};
use crate::estimate::offset::{OffsetConfig, longest_window};
use crate::estimate::resistance::{ResistanceConfig, ResistanceEstimator};
use crate::params::{Inverter, Machine};
use crate::scalar::{Integrator, Real};
use crate::space::AlphaBeta;
use crate::words::words;

/// Settings of the estimators.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct PublishedConfig<R: Real> {
    pub flux: FluxConfig<R>,
    pub resistance: Option<ResistanceConfig<R>>,
    pub confidence: ConfidenceConfig<R>,
    /// Resistance of the nameplate, and its reciprocal.
    pub r_s: R,
    pub inv_r_s: R,
    /// Periods over which the magnetisation reads `r̂_s`, and their reciprocal.
    pub r_s_periods: u32,
    pub inv_r_s_periods: R,
}
words!(PublishedConfig: flux, resistance, confidence, r_s, inv_r_s, r_s_periods, inv_r_s_periods);

impl<R: Real> PublishedConfig<R> {
    /// Settings for validated parameters and a magnetisation of so many periods.
    pub fn new(
        machine: &Machine,
        inverter: &Inverter,
        pu: &PerUnit<R>,
        p: &DriveParams,
        magnetise_periods: u32,
    ) -> Self {
        let b = Base::new(machine);
        let r = rounded::<R>;
        let t_s = b.omega / inverter.f_s;
        let (t_speed, t_slow) = (t_s * f64::from(SPEED_PERIODS), t_s * f64::from(SLOW_PERIODS));
        let hz = |f: f64| core::f64::consts::TAU * f / b.omega;
        let l_s = machine.L_s() / b.l;
        let sigma_l_s = machine.L_sigma / b.l;
        let r_s = (machine.R_s + inverter.r_d) / b.z;
        let dead_time = inverter.dead_time * inverter.f_s * inverter.u_dc / b.u;
        let noise = if p.noise_compensator { p.noise_gain } else { (0.0, 0.0) };
        let r_s_periods = magnetise_periods / 4;
        let offset = OffsetConfig {
            t_s: pu.t_s,
            gain: r(p.offset_gain),
            limit: r(0.05),
            hysteresis: r(0.2 * p.psi_ref),
            interval: r(t_speed),
            turn: r(t_speed / core::f64::consts::TAU),
            longest: longest_window(0.004, t_speed),
            omega_max: r(0.2),
        };
        Self {
            flux: FluxConfig {
                t_s: pu.t_s,
                noise_min: r(noise.0),
                noise_max: r(noise.1),
                offset: p.offset_estimator.then_some(offset),
            },
            resistance: p.resistance_adaptation.then(|| ResistanceConfig {
                l_sum: r(l_s + sigma_l_s),
                l_product: r(l_s * sigma_l_s),
                gain: r(t_slow * (p.resistance_gain / b.omega)),
                i_q_min: r(0.15 * machine.T_N / b.torque / p.psi_ref),
                i_q_high: r(0.6 * machine.T_N / b.torque / p.psi_ref),
                omega_min: r(0.004),
                omega_max: r(0.1),
                transient: r(0.05),
                corner: r(t_slow * hz(2.0)),
                hold: inverter.periods(0.2 / f64::from(SLOW_PERIODS)),
            }),
            confidence: ConfidenceConfig {
                t_s: r(t_slow),
                u_floor: r(1e-4 * r_s + 1e-4 * dead_time),
                u_initial: r(0.01 * r_s),
                corner: r(t_slow * hz(0.2)),
            },
            r_s: pu.r_s,
            inv_r_s: r(1.0 / r_s),
            r_s_periods,
            inv_r_s_periods: r(1.0 / f64::from(r_s_periods)),
        }
    }
}

impl<R: Real> DriveConfig<R> {
    /// Settings of the flux estimator, for its use alone.
    pub fn flux_config(&self) -> &FluxConfig<R> {
        &self.published.flux
    }

    /// Settings of the resistance adaptation, if it is on.
    pub fn resistance_config(&self) -> Option<&ResistanceConfig<R>> {
        self.published.resistance.as_ref()
    }

    /// Settings of the confidence model.
    pub fn confidence_config(&self) -> &ConfidenceConfig<R> {
        &self.published.confidence
    }
}

/// State of the estimators.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct Published<R: Real> {
    flux: FluxEstimator<R>,
    resistance: ResistanceEstimator<R>,
    confidence: Confidence<R>,
    /// `r̂_s` as the magnetisation reads it.
    r_s_sum: Integrator<R>,
    /// Latest current without its offset.
    i_s: AlphaBeta<R>,
}

impl<R: Real> Published<R> {
    /// Estimators that know the nameplate.
    pub fn new(c: &DriveConfig<R>) -> Self {
        let mut resistance = ResistanceEstimator::default();
        resistance.start(c.published.r_s);
        Self {
            flux: FluxEstimator::default(),
            resistance,
            confidence: Confidence::default(),
            r_s_sum: Integrator::default(),
            i_s: AlphaBeta::default(),
        }
    }

    /// One period under control.
    #[inline(always)]
    pub fn step(&mut self, c: &PublishedConfig<R>, i_s: &AlphaBeta<R>, u_s: &AlphaBeta<R>, psi_ref: R) -> Seen<R> {
        let r_s = self.resistance.r_s();
        self.flux.step(&c.flux, u_s, i_s, r_s, psi_ref);
        let field = self.flux.field();
        // What û_off stands for is first of all an offset of the current sensors, û_off = -r_s i_off. The flux
        // estimator has it removed already; control and inverter model get the current without it.
        let i_s = *i_s + self.flux.offset.u_off() * c.inv_r_s;
        self.i_s = i_s;
        Seen { field, magnitude: self.flux.magnitude(), r_s, i_dq: field.to_field(&i_s) }
    }

    /// Adds a voltage under the direct current `i_d` to the reading of `r̂_s`.
    pub fn read_resistance(&mut self, c: &PublishedConfig<R>, u_d: R, i_d: R) {
        // u_d / i_d*, averaged: no current offset is left in it, no threshold, and no dψ/dt.
        self.r_s_sum.add(c.inv_r_s_periods * i_d.recip(), u_d);
    }

    /// From magnetisation to control, at a known flux.
    pub fn start(&mut self, c: &DriveConfig<R>, psi_s: AlphaBeta<R>, i_s: AlphaBeta<R>) {
        if c.calibrate_offset {
            self.set_resistance(c, self.r_s_sum.value());
        }
        self.flux.start(psi_s, i_s);
        self.flux.follow(&c.published.flux, R::ZERO);
        self.confidence.start();
    }

    /// A resistance from outside, within its limits.
    fn set_resistance(&mut self, c: &DriveConfig<R>, r_s: R) {
        self.resistance.start(r_s.clamp(c.published.r_s * R::HALF, c.published.r_s * R::from_f64(1.5)));
    }

    pub fn rest(&mut self, i_s: &AlphaBeta<R>) {
        self.i_s = *i_s;
    }

    #[inline(always)]
    pub fn i_s(&self) -> AlphaBeta<R> {
        self.i_s
    }

    #[inline(always)]
    pub fn psi_s(&self) -> AlphaBeta<R> {
        self.flux.value()
    }

    #[inline(always)]
    pub fn magnitude(&self) -> R {
        self.flux.magnitude()
    }

    #[inline(always)]
    pub fn loss_gain(&self) -> R {
        R::ONE
    }

    pub fn flux(&self) -> FluxEstimate<R> {
        self.flux.estimate()
    }

    pub fn r_s(&self) -> R {
        self.resistance.r_s()
    }

    pub fn u_off(&self) -> AlphaBeta<R> {
        self.flux.offset.u_off()
    }

    pub fn psi_1(&self) -> AlphaBeta<R> {
        self.flux.offset.psi_1()
    }

    pub fn residual(&self) -> R {
        self.resistance.epsilon()
    }

    pub fn confidence(&self) -> R {
        self.confidence.value()
    }

    /// Neither is known here.
    pub fn learned(&self) -> (R, R) {
        (R::ZERO, R::ONE)
    }

    pub fn restore(&mut self, c: &DriveConfig<R>, memory: &Memory<R>, u_off: AlphaBeta<R>) {
        self.flux.offset.restore(u_off);
        self.set_resistance(c, memory.r_s);
    }

    pub fn begin(&mut self) {
        self.r_s_sum = Integrator::default();
    }

    /// The published scheme keeps its flux.
    #[inline(always)]
    pub fn flux_factor(&mut self, _: &DriveConfig<R>, _: R, _: R) -> R {
        R::ONE
    }

    #[inline(always)]
    pub fn follow(&mut self, c: &DriveConfig<R>, omega_s: R) {
        self.flux.follow(&c.published.flux, omega_s);
    }

    /// Resistance (Fig. 12) and confidence.
    #[inline(always)]
    pub fn adapt(&mut self, c: &DriveConfig<R>, x: &Slow<R>) {
        let c = &c.published;
        if let Some(resistance) = &c.resistance {
            self.resistance.step(resistance, self.flux.magnitude(), &x.i_dq, x.omega_s, x.omega_m);
        }
        let corrected = (self.flux.offset.updates() > 0).then(|| self.flux.offset.last_correction());
        self.confidence.step(&c.confidence, x.omega_s, self.flux.effort(), corrected);
    }
}
