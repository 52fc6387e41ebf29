//! Blocks of the published scheme beside the drive.

use super::{Cost, Input};
use core::hint::black_box;
use stillflux::config::DriveConfig;
use stillflux::control::current::CurrentController;
use stillflux::control::flux::{FREQUENCY_HIGH, FluxController, Range, weight_by_frequency};
use stillflux::control::modulator::{Duty, applied, modulate};
use stillflux::control::speed::SpeedController;
use stillflux::drive::{Drive, Estimate, Reference};
use stillflux::estimate::confidence::Confidence;
use stillflux::estimate::flux::FluxEstimator;
use stillflux::estimate::regeneration::Regeneration;
use stillflux::estimate::resistance::{ResistanceConfig, ResistanceEstimator};
use stillflux::estimate::speed::{SpeedEstimate, SpeedEstimator};
use stillflux::space::{AlphaBeta, Dq};
use stillflux_firmware::exchange::Word;

/// Name of the step in the report.
pub const STEP: &str = "drive_step";
/// Name of the whole interrupt in the report.
pub const INTERRUPT: &str = "interrupt";

/// What is measured.
#[derive(Clone, Copy, Default)]
pub struct Costs {
    flux_estimator: Cost,
    speed_estimator: Cost,
    resistance_adaptation: Cost,
    confidence: Cost,
    speed_control: Cost,
    flux_control: Cost,
    current_control: Cost,
    inverter_model: Cost,
    modulator: Cost,
}

impl Costs {
    /// Each with its name.
    pub fn each(&self, mut f: impl FnMut(&str, &Cost)) {
        f("flux_estimator", &self.flux_estimator);
        f("speed_estimator", &self.speed_estimator);
        f("resistance_adaptation", &self.resistance_adaptation);
        f("confidence", &self.confidence);
        f("speed_control", &self.speed_control);
        f("flux_control", &self.flux_control);
        f("current_control", &self.current_control);
        f("inverter_model", &self.inverter_model);
        f("modulator", &self.modulator);
    }
}

/// Copies of the drive's blocks.
pub struct Blocks<R: Word> {
    flux: FluxEstimator<R>,
    speed: SpeedEstimator<R>,
    regeneration: Regeneration<R>,
    resistance: ResistanceEstimator<R>,
    confidence: Confidence<R>,
    speed_control: SpeedController<R>,
    flux_control: FluxController<R>,
    current_control: CurrentController<R>,
    /// Stator frequency of this period, if the flux estimator has not been told it yet.
    follow: Option<R>,
    /// Field weakening in the latest slow period.
    weakened: bool,
    /// Periods in which a block and the drive disagreed: flux, speed, resistance, confidence or flux control.
    different: u32,
}

impl<R: Word> Blocks<R> {
    /// As the drive starts them at the end of the magnetisation.
    pub fn start(drive: &Drive<R>, i_s: AlphaBeta<R>) -> Self {
        let (config, e) = (drive.config(), drive.estimate());
        let psi = AlphaBeta::new(config.flux_control_config().psi_rated, R::ZERO);
        let mut blocks = Self {
            flux: FluxEstimator::default(),
            speed: SpeedEstimator::default(),
            regeneration: Regeneration::default(),
            resistance: ResistanceEstimator::default(),
            confidence: Confidence::default(),
            speed_control: SpeedController::default(),
            flux_control: FluxController::default(),
            current_control: CurrentController::default(),
            follow: None,
            weakened: false,
            different: 0,
        };
        blocks.flux_control.start();
        blocks.flux.offset.restore(e.u_off);
        blocks.flux.start(psi, i_s);
        blocks.flux.set_stator_frequency(config.flux_config(), R::ZERO);
        blocks.speed.start(&psi, R::ZERO);
        blocks.resistance.start(drive.memory().r_s);
        blocks
    }

    /// Periods in which any of them disagreed with the drive.
    pub fn apart(&self) -> u32 {
        self.different
    }

    /// One period on the drive's own inputs; `before` are its estimates of the period before.
    pub fn period(
        &mut self,
        costs: &mut Costs,
        drive: &Drive<R>,
        before: &Estimate<R>,
        i_s: &AlphaBeta<R>,
        input: &Input<R>,
    ) {
        let c = drive.config();
        let e = drive.estimate();
        // Speed estimator and slow blocks run when the drive runs them.
        let turn = drive.period() % c.slow_periods();
        let flux_input = FluxInput {
            u_s: e.u_s,
            i_s: *i_s,
            r_s: self.resistance.r_s(),
            psi_ref: before.psi_ref,
            omega_s: self.follow.take(),
            period: drive.period(),
        };
        costs.flux_estimator.call(|| flux_estimator(&mut self.flux, c, &flux_input));
        let flux = self.flux.estimate();
        let mut speed = e.speed;
        if turn % c.speed_periods() == 1 {
            speed = costs.speed_estimator.call(|| speed_estimator(&mut self.speed, c, &flux.psi_s, &e.i_s));
            self.follow = Some(speed.omega_s);
        }
        if drive.period() % c.adapt_periods() == c.adapt_periods() - c.slow_periods() / 2 {
            let (corner, least) = c.regeneration_config();
            self.flux.set_regenerating(self.regeneration.step(corner, least, &speed));
            if let Some(config) = c.resistance_config() {
                costs
                    .resistance_adaptation
                    .call(|| resistance_adaptation(&mut self.resistance, config, flux.magnitude, &e.i_dq, &speed));
            }
            let u_hf = self.flux.effort();
            let corrected = (self.flux.offset.updates() > 0).then(|| self.flux.offset.last_correction());
            costs.confidence.call(|| confidence(&mut self.confidence, c, speed.omega_s, u_hf, corrected));
        }
        let mut i_d = e.i_dq_ref.re();
        if turn == 0 {
            let i_q = e.i_dq_ref.im();
            let weakened = e.psi_ref != c.flux_control_config().psi_rated;
            if self.weakened && !weakened {
                self.flux_control.leave_weakening();
            }
            self.weakened = weakened;
            if let Reference::Speed(omega) = input.reference {
                costs.speed_control.call(|| speed_control(&mut self.speed_control, c, omega, speed.omega_m));
            }
            i_d = costs
                .flux_control
                .call(|| flux_control(&mut self.flux_control, c, &[e.psi_ref, flux.magnitude, i_q, speed.omega_s]));
        }
        let i_ref = before.i_dq_ref;
        let feedforward = i_ref * before.r_s + Dq::new(R::ZERO, before.speed.omega_s * flux.magnitude);
        let u_max = input.measured.u_dc * R::from_f64(0.98 / 1.732_050_807_568_877_2);
        let u = costs
            .current_control
            .call(|| current_control(&mut self.current_control, c, &i_ref, &e.i_dq, &feedforward, u_max));
        let loss = costs.inverter_model.call(|| inverter_model(c, &e.i_s, input.measured.u_dc));
        let u = flux.field.to_stator(&u).to_phases();
        let phases = [u[0] + loss[0], u[1] + loss[1], u[2] + loss[2]];
        let inv_u_dc = input.measured.u_dc.recip();
        black_box(costs.modulator.call(|| modulator(c, &phases, inv_u_dc)));
        let same = flux == e.flux
            && speed == e.speed
            && self.resistance.r_s() == e.r_s
            && self.confidence.value() == e.confidence
            && i_d == e.i_dq_ref.re();
        self.different += u32::from(!same);
    }
}

/// Inputs of the flux estimator.
struct FluxInput<R: Word> {
    u_s: AlphaBeta<R>,
    i_s: AlphaBeta<R>,
    r_s: R,
    psi_ref: R,
    /// A stator frequency to follow, as often as the speed estimator runs.
    omega_s: Option<R>,
    period: u32,
}

// Calls that the optimiser leaves where they are.

#[inline(never)]
fn flux_estimator<R: Word>(s: &mut FluxEstimator<R>, c: &DriveConfig<R>, x: &FluxInput<R>) {
    if let Some(omega_s) = x.omega_s {
        s.set_stator_frequency(c.flux_config(), omega_s);
    }
    s.step(c.flux_config(), (&x.u_s, &x.i_s), x.r_s, x.psi_ref, x.period);
}
#[inline(never)]
fn speed_estimator<R: Word>(
    s: &mut SpeedEstimator<R>,
    c: &DriveConfig<R>,
    psi_s: &AlphaBeta<R>,
    i_s: &AlphaBeta<R>,
) -> SpeedEstimate<R> {
    let c = c.speed_config();
    s.step(c, &c.rotor_flux(psi_s, i_s), i_s)
}
#[inline(never)]
fn resistance_adaptation<R: Word>(
    s: &mut ResistanceEstimator<R>,
    c: &ResistanceConfig<R>,
    psi_s: R,
    i: &Dq<R>,
    speed: &SpeedEstimate<R>,
) -> R {
    s.step(c, psi_s, i, speed.omega_s, speed.omega_m)
}
#[inline(never)]
fn confidence<R: Word>(s: &mut Confidence<R>, c: &DriveConfig<R>, omega_s: R, u_hf: R, corrected: Option<R>) -> R {
    s.step(c.confidence_config(), omega_s, u_hf, corrected)
}
#[inline(never)]
fn speed_control<R: Word>(s: &mut SpeedController<R>, c: &DriveConfig<R>, omega_ref: R, omega_m: R) -> R {
    s.step(c.speed_control_config(), omega_ref, omega_m, (R::ONE, R::ONE), c.speed_control_config().limits(R::ONE))
}
#[inline(never)]
fn flux_control<R: Word>(s: &mut FluxController<R>, c: &DriveConfig<R>, x: &[R; 4]) -> R {
    let [psi_ref, psi_s, i_q, omega_s] = *x;
    let config = c.flux_control_config();
    let (weight, range) = if psi_ref != config.psi_rated {
        (R::ONE, Range::Weakened)
    } else if omega_s.within(R::from_f64(FREQUENCY_HIGH)) {
        (weight_by_frequency(omega_s), Range::Low)
    } else {
        (weight_by_frequency(omega_s), Range::High)
    };
    s.step(config, (psi_ref, psi_ref, None), psi_ref - psi_s, i_q, weight, range)
}
#[inline(never)]
fn current_control<R: Word>(
    s: &mut CurrentController<R>,
    c: &DriveConfig<R>,
    i_ref: &Dq<R>,
    i: &Dq<R>,
    u_ff: &Dq<R>,
    u_max: R,
) -> Dq<R> {
    s.step(c.current_config(), i_ref, i, u_ff, u_max)
}
#[inline(never)]
fn inverter_model<R: Word>(c: &DriveConfig<R>, i_s: &AlphaBeta<R>, u_dc: R) -> [R; 3] {
    c.inverter_model().distortion(c.inverter_model().nominal(), i_s, u_dc, R::ONE).phases
}
#[inline(never)]
fn modulator<R: Word>(c: &DriveConfig<R>, u: &[R; 3], inv_u_dc: R) -> (Duty<R>, AlphaBeta<R>) {
    let duty = modulate(*u, inv_u_dc, c.timer());
    (duty, applied(&duty))
}
