//! The published scheme: the estimators of Figs. 4, 7 and 12 with the confidence model, and its start-up.
//!
//! **Start-up**, valid at standstill only. A direct current along the a-axis builds up the flux; the mean of
//! `r̂_s = u_d/i_d*` over the last quarter is the initial resistance. Control begins at `ψ̂_s = ψ̂_1 = ψ_s*∠0`.

use super::estimators::{CurrentControl, Estimated, Estimators, FieldQuantities, PeriodInput, PeriodOutput, StartUp};
use super::interface::Memory;
use crate::config::{DriveConfig, PaperConfig, r_s_periods};
use crate::control::flux::weight_by_frequency;
#[cfg(feature = "supervision")]
use crate::control::realign::flux_along;
use crate::estimate::confidence::Confidence;
use crate::estimate::flux::FluxEstimator;
#[cfg(feature = "variants")]
use crate::estimate::light_load::LightLoad;
use crate::estimate::regeneration::Regeneration;
#[cfg(feature = "variants")]
use crate::estimate::resistance::ResistanceConfig;
use crate::estimate::resistance::{self, ResistanceEstimator};
use crate::estimate::speed::{SpeedEstimate, SpeedEstimator};
use crate::inverter::Knee;
use crate::scalar::{Integrator, Real};
use crate::space::{AlphaBeta, Dq, Rotator};

/// Corrections of the offset, of both components, after which it counts as known: more than one period.
const OFFSET_UPDATES: u32 = 3;

/// State of the estimators.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct PaperEstimators<R: Real> {
    flux: FluxEstimator<R>,
    resistance: ResistanceEstimator<R>,
    #[cfg(feature = "variants")]
    light_load: LightLoad<R>,
    confidence: Confidence<R>,
    /// The offset was read at rest or restored.
    offset_known: bool,
    speed_estimator: SpeedEstimator<R>,
    speed: SpeedEstimate<R>,
    regeneration: Regeneration<R>,
    /// Mean of `u_d/i_d*` at the end of the magnetisation.
    r_s_mean: Integrator<R>,
    /// Latest current without its offset.
    i_s: AlphaBeta<R>,
}

impl<R: Real> PaperEstimators<R> {
    /// Estimators with the resistance of the machine's parameters.
    pub fn new(c: &DriveConfig<R>) -> Self {
        let mut resistance = ResistanceEstimator::default();
        resistance.start(c.paper.r_s);
        Self {
            flux: FluxEstimator::default(),
            resistance,
            #[cfg(feature = "variants")]
            light_load: LightLoad::default(),
            confidence: Confidence::default(),
            offset_known: c.calibrate_offset,
            speed_estimator: SpeedEstimator::default(),
            speed: SpeedEstimate::default(),
            regeneration: Regeneration::default(),
            r_s_mean: Integrator::default(),
            i_s: AlphaBeta::default(),
        }
    }

    /// A resistance from the magnetisation or from memory, within its limits.
    fn set_resistance(&mut self, c: &DriveConfig<R>, r_s: R) {
        let (lo, hi) = resistance::range(c.paper.r_s);
        self.resistance.start(r_s.clamp(lo, hi));
    }

    /// Begins at a flux that the magnetisation has built up along the a-axis.
    fn start(&mut self, c: &DriveConfig<R>, i_s: &AlphaBeta<R>) {
        let psi_s = AlphaBeta::new(c.flux_control.psi_rated, R::ZERO);
        if c.calibrate_offset {
            self.set_resistance(c, self.r_s_mean.value());
        }
        #[cfg(feature = "variants")]
        let psi_s = if c.paper.initial_flux.is_some() { self.flux.value() } else { psi_s };
        self.flux.start(psi_s, *i_s);
        self.flux.set_stator_frequency(&c.paper.flux, R::ZERO);
        self.confidence.start();
        self.speed_estimator.start(&psi_s, R::ZERO);
    }

    /// Direct current along the a-axis.
    #[cold]
    #[inline(never)]
    fn magnetise(
        &mut self,
        c: &DriveConfig<R>,
        x: &PeriodInput<'_, R>,
        i_dq_ref: &Dq<R>,
        stage: u32,
    ) -> PeriodOutput<R> {
        let a_axis = Rotator::default();
        self.i_s = x.i_s;
        #[cfg(feature = "variants")]
        if let Some([re, im]) = c.paper.initial_flux {
            // Fig. 9: the estimator runs from the first period on, from a flux that has nothing to do with the true one.
            if stage <= 1 {
                self.flux.start(AlphaBeta::new(re, im), x.i_s);
                self.flux.set_stator_frequency(&c.paper.flux, R::ZERO);
            } else {
                let r_s = self.resistance.r_s();
                self.flux.step(&c.paper.flux, (&x.u_s, &x.i_s), r_s, c.flux_control.psi_rated, x.period);
            }
        }
        let left = c.magnetise_periods.saturating_sub(stage);
        if left < r_s_periods(c.magnetise_periods) {
            // Over the reference, so that a current offset does not enter; u_s is free of the threshold by the inverter
            // model, and dψ/dt has decayed.
            self.r_s_mean.add(c.paper.inv_r_s_periods * i_dq_ref.re().recip_seldom(), x.u_s.re());
        }
        if left == 0 {
            self.start(c, &x.i_s);
        }
        let i_dq = a_axis.to_field(&x.i_s);
        let field = FieldQuantities { field: a_axis, psi_s: R::ZERO, omega_s: R::ZERO, r_s: c.paper.r_s, i_dq };
        PeriodOutput { field, complete: left == 0, current_control: CurrentControl::Continues }
    }

    /// Where |i_q| is too small for (15): the method of [9] beyond its smallest frequency, the radius at rest.
    #[cfg(feature = "variants")]
    fn adapt_at_light_load(&mut self, c: &PaperConfig<R>, resistance: &ResistanceConfig<R>, i_dq: &Dq<R>, omega_s: R) {
        let i_q = i_dq.im();
        let light = self.resistance.is_light(resistance, i_q);
        if let Some(config) = &c.light_load {
            let u_i = self.flux.field().to_field(&self.flux.estimate().u_i);
            if let Some(error) = self.light_load.step(config, &u_i, i_dq, omega_s, i_q, light) {
                self.resistance.follow(config.gain, error);
            }
        }
        if c.adapt_at_rest && light && omega_s.abs() < resistance.omega_min {
            self.resistance.adapt_at_rest(resistance);
        }
    }

    /// Estimators under control.
    #[inline(always)]
    fn step(&mut self, c: &PaperConfig<R>, x: &PeriodInput<'_, R>) -> FieldQuantities<R> {
        let r_s = self.resistance.r_s();
        self.flux.step(&c.flux, (&x.u_s, &x.i_s), r_s, x.psi_ref, x.period);
        let field = self.flux.field();
        // û_off is taken as the effect of an offset of the current sensors, û_off = -r_s i_offset. The flux estimator
        // subtracts it from the voltage; control uses the current without it.
        let i_s = x.i_s + self.flux.offset.u_off() * c.inv_r_s;
        self.i_s = i_s;
        // The estimated frequency, not the noisier one at which the loop turns: with that the field stood for good in some realisations of
        // Fig. 9, and the speed in Fig. 18 was off by more than 0.002 pu. It lags while the speed changes (docs/limits.md, published scheme).
        let (psi_s, omega_s, i_dq) = (self.flux.magnitude(), self.speed.omega_s, field.to_field(&i_s));
        FieldQuantities { field, psi_s, omega_s, r_s, i_dq }
    }
}

impl<R: Real> Estimators<R> for PaperEstimators<R> {
    fn forget_offset(&mut self, _: &DriveConfig<R>) {
        self.flux.offset.restore(AlphaBeta::default());
    }

    fn begin(&mut self, _: &DriveConfig<R>, _: Option<u32>, _: u32) {
        self.r_s_mean = Integrator::default();
        self.speed = SpeedEstimate::default();
        self.regeneration = Regeneration::default();
        #[cfg(feature = "variants")]
        {
            self.light_load = LightLoad::default();
        }
    }

    #[inline(always)]
    fn period(
        &mut self,
        c: &DriveConfig<R>,
        x: &PeriodInput<'_, R>,
        i_dq_ref: &mut Dq<R>,
        start_up: Option<StartUp>,
    ) -> PeriodOutput<R> {
        match start_up {
            Some(at) => {
                *i_dq_ref = c.magnetising_current(at.stage);
                // A copy: the input itself then stays in registers.
                let x = *x;
                self.magnetise(c, &x, i_dq_ref, at.stage)
            }
            None => PeriodOutput {
                field: self.step(&c.paper, x),
                complete: false,
                current_control: CurrentControl::Continues,
            },
        }
    }

    fn idle(&mut self, i_s: &AlphaBeta<R>) {
        self.i_s = *i_s;
    }

    // Inlined: a call saves and restores registers, and loads addresses and constants once more.
    #[inline(always)]
    fn update_speed(&mut self, c: &DriveConfig<R>) {
        self.speed = self.speed_estimator.step(&c.speed, &c.speed.rotor_flux(&self.flux.value(), &self.i_s), &self.i_s);
        self.flux.set_stator_frequency(&c.paper.flux, self.speed.omega_s);
    }

    #[cfg(feature = "supervision")]
    #[cold]
    #[inline(never)]
    fn turn_to_current(&mut self, c: &DriveConfig<R>) {
        let psi_r = c.speed.rotor_flux(&self.flux.value(), &self.i_s).norm_sq().sqrt();
        if let Some(psi_s) = flux_along(&self.i_s, psi_r, c.speed.sigma_l_s) {
            self.flux.start(psi_s, self.i_s);
            self.speed.set_synchronous(self.speed.omega_s);
            self.speed_estimator.start(&c.speed.rotor_flux(&psi_s, &self.i_s), self.speed.omega_s);
        }
    }

    /// Resistance (Fig. 12) and confidence.
    #[inline(always)]
    fn adapt(&mut self, c: &DriveConfig<R>, i_dq: &Dq<R>) {
        let c = &c.paper;
        let SpeedEstimate { omega_s, omega_m, .. } = self.speed;
        self.flux.set_regenerating(self.regeneration.step(c.slip_corner, c.omega_r_regeneration, &self.speed));
        // (17) takes it that voltages and currents are free of offset: until that is so, ε is not of the resistance.
        let known = self.offset_known || self.flux.offset.updates() >= OFFSET_UPDATES;
        if let (Some(resistance), true) = (&c.resistance, known) {
            self.resistance.step(resistance, self.flux.magnitude(), i_dq, omega_s, omega_m);
            #[cfg(feature = "variants")]
            self.adapt_at_light_load(c, resistance, i_dq, omega_s);
        }
        let corrected = (self.flux.offset.updates() > 0).then(|| self.flux.offset.last_correction());
        self.confidence.step(&c.confidence, omega_s, self.flux.effort(), corrected);
    }

    /// The published scheme has no flux shift.
    #[inline(always)]
    fn flux_factor(&mut self, _: &DriveConfig<R>, _: R) -> R {
        R::ONE
    }

    #[inline(always)]
    fn speed(&self) -> &SpeedEstimate<R> {
        &self.speed
    }

    #[inline(always)]
    fn psi_s(&self) -> R {
        self.flux.magnitude()
    }

    /// The noise compensator holds `|ψ̂_s|` at the reference: near zero frequency it contains no
    /// information on the true flux.
    #[inline(always)]
    fn present_flux(&self, psi_ref: R) -> (R, R, R) {
        (psi_ref, psi_ref, weight_by_frequency(self.speed.omega_s))
    }

    /// `|ψ̂_s|` as far as it is known by its frequency.
    #[inline(always)]
    fn pull_out_flux(&self, psi: R) -> R {
        psi + (self.flux.magnitude() - psi) * weight_by_frequency(self.speed.omega_s)
    }

    #[inline(always)]
    fn inverter<'a>(&'a self, c: &'a DriveConfig<R>) -> (R, &'a Knee<R>) {
        (R::ONE, c.inverter.nominal())
    }

    #[inline(always)]
    fn nis(&self) -> R {
        R::ZERO
    }

    #[inline(always)]
    fn flux_falls(&self) -> bool {
        false
    }

    #[inline(always)]
    fn confidence(&self) -> R {
        self.confidence.value()
    }

    fn sensed(&self, c: &DriveConfig<R>) -> AlphaBeta<R> {
        self.i_s - self.flux.offset.u_off() * c.paper.inv_r_s
    }

    fn estimated(&self, c: &DriveConfig<R>) -> Estimated<R> {
        Estimated {
            flux: self.flux.estimate(),
            speed: self.speed,
            psi_1: self.flux.offset.psi_1(),
            u_off: self.flux.offset.u_off(),
            i_s: self.i_s,
            r_s: self.resistance.r_s(),
            r_r: c.speed.r_r,
            epsilon: self.resistance.epsilon(),
            innovation: R::ZERO,
            nis: R::ZERO,
            angle_deviation: self.confidence.sigma(),
            confidence: self.confidence.value(),
        }
    }

    /// Inverter and inductance are not estimated.
    #[cfg_attr(not(feature = "legs"), allow(unused_variables))]
    fn memory(&self, c: &DriveConfig<R>, i_off: [R; 3]) -> Memory<R> {
        let (u_off, r_s) = (self.flux.offset.u_off(), self.resistance.r_s());
        let one = R::ONE;
        Memory {
            u_off,
            r_s,
            i_off,
            loss_error: R::ZERO,
            knee: one,
            leakage: one,
            inv_l_m: one,
            #[cfg(feature = "legs")]
            legs: *c.inverter.legs(),
        }
    }

    fn restore(&mut self, c: &DriveConfig<R>, memory: &Memory<R>, u_off: AlphaBeta<R>) {
        self.flux.offset.restore(u_off);
        // An offset of zero is that of a memory in which nothing was stored.
        self.offset_known = c.calibrate_offset || u_off != AlphaBeta::default();
        self.set_resistance(c, memory.r_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{DriveParams, Scheme};
    use crate::params::{Inverter, Machine};

    #[test]
    fn an_offset_is_known_by_a_memory_in_which_one_was_stored() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let params =
            DriveParams { scheme: Scheme::Paper, calibrate_offset: false, ..DriveParams::new(&machine, &inverter) };
        let c = DriveConfig::<f64>::new(&machine, &inverter, &params).unwrap();
        let mut estimators = PaperEstimators::new(&c);
        let memory = estimators.memory(&c, [0.0; 3]);
        for (u_off, known) in [(AlphaBeta::default(), false), (AlphaBeta::new(0.0, 1e-3), true)] {
            estimators.restore(&c, &memory, u_off);
            assert_eq!(estimators.offset_known, known);
        }
    }
}
