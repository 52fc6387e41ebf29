//! The drive: one control period from the current samples to the duties, Figs. 3, 7 and 12 in one pass.
//!
//! ```text
//! i_abc ─ Clarke ─ flux estimator (Fig. 7, 4) ─ speed ─ resistance (Fig. 12) ─┐
//! reference ─ speed control ─ flux control ─ current control ─ modulator ─ duties
//! ```
//!
//! **Timing.** Currents sampled at the start of period *k* give the duties applied during period *k + 1*.
//! At the call of period *k* the voltage between the last two samples is therefore the one computed two
//! calls earlier; a pipeline of two entries keeps the estimator on the voltage that was really applied:
//! limited, quantised, at the measured dc link, less what the inverter model says was lost.
//!
//! **Sequence.** `Stopped` → offset reading with gates off → magnetisation by direct current along the
//! a-axis (with `r̂_s` from its dc values) → `Running` with estimators that begin at a known flux,
//! `ψ̂_s = ψ̂_1 = ψ_s*∠0`. Any fault blocks the gates and latches with its cause until [`Drive::reset`].
//!
//! No call panics, allocates, or lets a number that is not finite through, whatever the ADC delivers.

use crate::config::{BOOST, DriveConfig};
use crate::control::current::CurrentController;
use crate::control::flux::FluxController;
use crate::control::modulator::{Duty, applied, modulate, zero_duty};
use crate::control::speed::SpeedController;
use crate::estimate::confidence::Confidence;
use crate::estimate::flux::{FluxEstimate, FluxEstimator};
use crate::estimate::resistance::ResistanceEstimator;
use crate::estimate::speed::{SpeedEstimate, SpeedEstimator};
use crate::scalar::{Integrator, Real};
use crate::space::{AlphaBeta, Dq, Rotator};

/// What the drive measures at the start of a period, per unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Measurement<R: Real> {
    /// Phase currents, positive into the machine.
    pub i_abc: [R; 3],
    /// dc-link voltage.
    pub u_dc: R,
}

/// What the drive is to do.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub enum Reference<R: Real> {
    /// Gates off.
    #[default]
    Stop,
    /// Speed control, mechanical speed per unit.
    Speed(R),
    /// Torque control, torque per unit.
    Torque(R),
}

/// What the drive hands to the modulator's preload registers.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Output<R: Real> {
    /// Duties of the next period, each in [0, 1].
    pub duty: Duty<R>,
    /// `false`: block the bridge at once.
    pub gates_on: bool,
}

/// Why a drive blocked its bridge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub enum Fault {
    /// Current above the trip level.
    OverCurrent,
    /// dc-link voltage below its range.
    UnderVoltage,
    /// dc-link voltage above its range.
    OverVoltage,
    /// A measurement is not finite, or beyond what its sensor can read.
    Measurement,
    /// The reference is not finite.
    Reference,
    /// Current offsets at rest beyond what a healthy sensor shows.
    CurrentOffset,
    /// The flux estimate left its circle, or the speed estimate its range, for longer than a transient.
    EstimateLost,
}

/// State of the sequence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub enum Status {
    /// Gates off, waiting for a reference.
    #[default]
    Stopped,
    /// Reading the current offsets, gates off.
    ReadingOffset,
    /// Building up the flux along the a-axis.
    Magnetising,
    /// Under control.
    Running,
    /// Gates off after a fault at `period` (periods since power-up).
    Faulted {
        /// What happened.
        cause: Fault,
        /// Control period in which it happened.
        period: u32,
    },
}

/// What a drive stores at a stop and takes back at a start (the paper's nonvolatile memory).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Memory<R: Real> {
    /// Offset voltage.
    pub u_off: AlphaBeta<R>,
    /// Stator resistance.
    pub r_s: R,
    /// Offsets of the current channels.
    pub i_off: [R; 3],
}

/// Everything the drive estimates, per unit, of the latest period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Estimate<R: Real> {
    /// Flux estimator outputs.
    pub flux: FluxEstimate<R>,
    /// Speed estimator outputs.
    pub speed: SpeedEstimate<R>,
    /// Trajectory ψ̂_1 of the parallel path.
    pub psi_1: AlphaBeta<R>,
    /// Offset voltage.
    pub u_off: AlphaBeta<R>,
    /// Stator current: measured, less the offsets read at rest and the one that `u_off` stands for.
    pub i_s: AlphaBeta<R>,
    /// Voltage applied between the last two current samples, as the inverter model has it.
    pub u_s: AlphaBeta<R>,
    /// Current in field coordinates.
    pub i_dq: Dq<R>,
    /// Its reference.
    pub i_dq_ref: Dq<R>,
    /// Flux reference.
    pub psi_ref: R,
    /// Torque `ψ̂_s × i_s`.
    pub torque: R,
    /// Stator resistance (with `r_d`).
    pub r_s: R,
    /// Residual ε of (15).
    pub epsilon: R,
    /// Confidence in the field angle, 0 to 1; below 0.5 an error of 15° must be expected.
    pub confidence: R,
}

/// A period's voltage on its way to the machine.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
struct InFlight<R: Real> {
    /// Applied by ideal legs, per unit of dc link.
    ideal: AlphaBeta<R>,
    /// Taken by the inverter model.
    loss: AlphaBeta<R>,
}

/// A sensorless induction motor drive.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Drive<R: Real> {
    config: DriveConfig<R>,
    status: Status,
    /// Periods since power-up, and since the present stage of the sequence began.
    period: u32,
    stage: u32,
    /// Periods for which the estimate has been implausible.
    implausible: u32,
    i_off: [R; 3],
    offset_sum: [Integrator<R>; 3],
    r_s_sum: Integrator<R>,
    in_flight: [InFlight<R>; 2],
    flux: FluxEstimator<R>,
    speed: SpeedEstimator<R>,
    resistance: ResistanceEstimator<R>,
    confidence: Confidence<R>,
    current_control: CurrentController<R>,
    flux_control: FluxController<R>,
    speed_control: SpeedController<R>,
    estimate: Estimate<R>,
}

impl<R: Real> Drive<R> {
    /// A stopped drive.
    #[must_use]
    pub fn new(config: DriveConfig<R>) -> Self {
        let mut drive = Self {
            config,
            status: Status::Stopped,
            period: 0,
            stage: 0,
            implausible: 0,
            i_off: [R::ZERO; 3],
            offset_sum: [Integrator::default(); 3],
            r_s_sum: Integrator::default(),
            in_flight: [InFlight::default(); 2],
            flux: FluxEstimator::default(),
            speed: SpeedEstimator::default(),
            resistance: ResistanceEstimator::default(),
            confidence: Confidence::default(),
            current_control: CurrentController::default(),
            flux_control: FluxController::default(),
            speed_control: SpeedController::default(),
            estimate: Estimate::default(),
        };
        drive.resistance.start(config.pu.r_s);
        drive.estimate.r_s = config.pu.r_s;
        drive
    }

    /// Configuration.
    pub fn config(&self) -> &DriveConfig<R> {
        &self.config
    }

    /// State of the sequence.
    pub fn status(&self) -> Status {
        self.status
    }

    /// Estimates of the latest period.
    pub fn estimate(&self) -> &Estimate<R> {
        &self.estimate
    }

    /// Control periods since power-up (wraps).
    pub fn period(&self) -> u32 {
        self.period
    }

    /// Data worth keeping over a stop or a loss of supply.
    pub fn memory(&self) -> Memory<R> {
        Memory { u_off: self.flux.offset.u_off(), r_s: self.resistance.r_s(), i_off: self.i_off }
    }

    /// Takes back what an earlier run stored. Values beyond their limits are limited.
    pub fn restore(&mut self, memory: &Memory<R>) {
        let limit = self.config.u_off_limit;
        self.flux.offset.restore(memory.u_off.limit_components(limit));
        let r_s = self.config.pu.r_s;
        self.resistance.start(memory.r_s.clamp(r_s * R::HALF, r_s * R::from_f64(1.5)));
        self.i_off = memory.i_off.map(|i| i.limit(self.config.i_off_max));
        self.estimate.u_off = self.flux.offset.u_off();
        self.estimate.r_s = self.resistance.r_s();
    }

    /// Leaves a fault; the drive is stopped then.
    pub fn reset(&mut self) {
        if matches!(self.status, Status::Faulted { .. }) {
            self.enter(Status::Stopped);
        }
    }

    /// One control period.
    pub fn step(&mut self, measured: &Measurement<R>, reference: &Reference<R>) -> Output<R> {
        self.period = self.period.wrapping_add(1);
        self.stage = self.stage.saturating_add(1);
        let Some((i_s, u_dc)) = self.acquire(measured) else {
            return self.blocked();
        };
        if let Reference::Speed(x) | Reference::Torque(x) = reference
            && !x.is_finite()
        {
            self.fault(Fault::Reference);
        }
        match (self.status, reference) {
            (Status::Faulted { .. }, _) => return self.blocked(),
            (Status::Stopped, Reference::Stop) => return self.blocked(),
            (_, Reference::Stop) => {
                self.enter(Status::Stopped);
                return self.blocked();
            }
            (Status::Stopped, _) => self.enter(Status::ReadingOffset),
            _ => {}
        }
        let inv_u_dc = u_dc.recip();
        let u_max = u_dc * self.config.u_utilisation;
        let last = self.in_flight[0];
        let u_s = last.ideal * u_dc - last.loss;
        self.estimate.u_s = u_s;

        let (field, i_ref, u_dq) = match self.status {
            Status::ReadingOffset => {
                self.read_offset(measured);
                return self.blocked();
            }
            Status::Magnetising => self.magnetise(&i_s, &u_s, u_max),
            _ => self.control(&i_s, &u_s, u_max, reference),
        };
        if self.implausible > self.config.implausible_max {
            self.fault(Fault::EstimateLost);
            return self.blocked();
        }

        // The duties act from one to two periods after the sample: turn the voltage to their middle.
        let t_s = self.config.pu.t_s;
        let omega_s = self.estimate.speed.omega_s;
        let ahead = field.ahead(omega_s * t_s * R::from_f64(1.5));
        let u_ref = ahead.to_stator(&u_dq);
        // The inverter model sees the current that will flow then: the reference, free from noise.
        let loss = self.config.inverter.distortion(&ahead.to_stator(&i_ref), u_dc);
        let u = u_ref.to_phases();
        let duty = modulate([u[0] + loss[0], u[1] + loss[1], u[2] + loss[2]], inv_u_dc, self.config.timer.as_ref());
        self.in_flight[0] = self.in_flight[1];
        self.in_flight[1] = InFlight { ideal: applied(&duty), loss: AlphaBeta::from_phases(loss) };
        Output { duty, gates_on: true }
    }

    /// Checks the measurement; current vector and dc link if they can be worked with.
    #[inline]
    fn acquire(&mut self, m: &Measurement<R>) -> Option<(AlphaBeta<R>, R)> {
        let c = &self.config;
        let range = c.i_range;
        // Written so that NaN fails every comparison.
        let readable = m.i_abc.iter().all(|i| i.abs() < range) && m.u_dc.abs() < c.u_dc_range;
        if !readable {
            self.fault(Fault::Measurement);
            return None;
        }
        if m.u_dc < c.u_dc_min || m.u_dc > c.u_dc_max {
            self.fault(if m.u_dc < c.u_dc_min { Fault::UnderVoltage } else { Fault::OverVoltage });
            return None;
        }
        let i = [m.i_abc[0] - self.i_off[0], m.i_abc[1] - self.i_off[1], m.i_abc[2] - self.i_off[2]];
        let i_s = AlphaBeta::from_phases(i);
        if i_s.norm_sq() > c.i_trip * c.i_trip {
            self.fault(Fault::OverCurrent);
            return None;
        }
        self.estimate.i_s = i_s;
        Some((i_s, m.u_dc))
    }

    /// Mean of the current samples while no current can flow.
    #[inline(never)]
    fn read_offset(&mut self, m: &Measurement<R>) {
        let c = &self.config;
        if c.calibrate_offset {
            for k in 0..3 {
                self.offset_sum[k].add(c.inv_offset_periods, m.i_abc[k]);
            }
        }
        if self.stage < c.offset_periods {
            return;
        }
        if c.calibrate_offset {
            self.i_off = [0, 1, 2].map(|k| self.offset_sum[k].value());
            if self.i_off.iter().any(|i| i.abs() > c.i_off_max) {
                self.fault(Fault::CurrentOffset);
                return;
            }
        }
        self.enter(Status::Magnetising);
    }

    /// Direct current along the a-axis; its last quarter gives `r̂_s`.
    #[inline(never)]
    fn magnetise(&mut self, i_s: &AlphaBeta<R>, u_s: &AlphaBeta<R>, u_max: R) -> (Rotator<R>, Dq<R>, Dq<R>) {
        let c = &self.config;
        let i_d = c.flux_control.feedforward(c.flux_control.psi_rated, R::ZERO);
        // Boosted until the flux is there, then held.
        let i_ref = Dq::new(if self.stage < c.boost_periods { i_d * R::from_f64(BOOST) } else { i_d }, R::ZERO);
        let field = Rotator::default();
        let i_dq = field.to_field(i_s);
        let u = self.current_control.step(&c.current, &i_ref, &i_dq, &(i_ref * c.pu.r_s), u_max);

        let left = c.magnetise_periods.saturating_sub(self.stage);
        if left < c.r_s_periods {
            // u_d / i_d*, averaged: no current offset is left in it, no threshold, and no dψ/dt.
            self.r_s_sum.add(c.inv_r_s_periods * i_d.recip(), u_s.re());
        }
        self.estimate.i_dq = i_dq;
        self.estimate.i_dq_ref = i_ref;
        if left == 0 {
            if c.calibrate_offset {
                let r = self.config.pu.r_s;
                self.resistance.start(self.r_s_sum.value().clamp(r * R::HALF, r * R::from_f64(1.5)));
            }
            let psi = AlphaBeta::new(c.flux_control.psi_rated, R::ZERO);
            self.flux.start(psi, *i_s);
            self.speed.start(&psi, R::ZERO);
            self.confidence.start();
            self.flux_control.start();
            self.speed_control.start(R::ZERO);
            self.enter(Status::Running);
        }
        (field, i_ref, u)
    }

    /// Estimators, then controllers.
    #[inline]
    fn control(
        &mut self,
        i_s: &AlphaBeta<R>,
        u_s: &AlphaBeta<R>,
        u_max: R,
        reference: &Reference<R>,
    ) -> (Rotator<R>, Dq<R>, Dq<R>) {
        let c = &self.config;
        let e = &mut self.estimate;

        // Estimators: Fig. 7 with Fig. 4, speed, Fig. 12.
        let omega_s = e.speed.omega_s;
        let psi_ref = c.flux_control.reference(omega_s, u_max * c.u_flux);
        e.flux = self.flux.step(&c.flux, u_s, i_s, self.resistance.r_s(), psi_ref, omega_s);
        // What û_off stands for is first of all an offset of the current sensors, û_off = -r_s i_off. The
        // flux estimator has it removed already; control and inverter model get the current without it.
        e.i_s = *i_s + self.flux.offset.u_off() * c.inv_r_s;
        let i_s = &e.i_s;
        e.speed = self.speed.step(&c.speed, &e.flux.psi_s, i_s);
        let field = e.flux.field;
        let psi_s = e.flux.magnitude;
        let (omega_s, omega_m) = (e.speed.omega_s, e.speed.omega_m);
        e.i_dq = field.to_field(i_s);
        e.torque = psi_s * e.i_dq.im();
        if let Some(resistance) = &c.resistance {
            self.resistance.step(resistance, psi_s, &e.i_dq, omega_s, omega_m);
        }
        e.psi_ref = psi_ref;
        e.psi_1 = self.flux.offset.psi_1();
        e.u_off = self.flux.offset.u_off();
        e.r_s = self.resistance.r_s();
        e.epsilon = self.resistance.epsilon();
        let corrected = (self.flux.offset.updates() > 0).then(|| self.flux.offset.last_correction());
        e.confidence = self.confidence.step(&c.confidence, omega_s, e.flux.u_hf.dot(&field.axis()), corrected);

        // Plausibility: the flux on its circle, the speed within reach.
        let lost = (psi_s - psi_ref).abs() > c.psi_deviation || omega_m.abs() > c.omega_trip;
        self.implausible = if lost { self.implausible.saturating_add(1) } else { 0 };

        // Controllers: torque, i_q* within current limit and pull-out, i_d* of (12), voltage.
        let inv_psi = c.flux_control.reciprocal(psi_ref);
        let i_q_max = (c.pull_out_use * psi_ref).min(c.i_q_max);
        let torque_max = i_q_max * psi_ref;
        let torque_ref = match *reference {
            Reference::Speed(omega) => {
                self.speed_control.step(&c.speed_control, omega.limit(c.omega_max), omega_m, torque_max)
            }
            Reference::Torque(torque) => {
                let torque = torque.limit(torque_max.min(c.speed_control.torque_max));
                self.speed_control.start(torque);
                torque
            }
            Reference::Stop => R::ZERO,
        };
        let i_q = torque_ref * inv_psi;
        let i_d = self.flux_control.step(&c.flux_control, psi_ref, psi_s, i_q, omega_s);
        let i_ref = Dq::new(i_d, i_q);
        e.i_dq_ref = i_ref;
        let u_ff = i_ref * e.r_s + Dq::new(R::ZERO, omega_s * psi_s);
        let u = self.current_control.step(&c.current, &i_ref, &e.i_dq, &u_ff, u_max);
        (field, i_ref, u)
    }

    #[inline(never)]
    fn enter(&mut self, status: Status) {
        self.status = status;
        self.stage = 0;
        self.implausible = 0;
        match status {
            Status::ReadingOffset => self.offset_sum = [Integrator::default(); 3],
            Status::Magnetising => {
                self.r_s_sum = Integrator::default();
                self.current_control.start();
                self.in_flight = [InFlight::default(); 2];
                self.estimate.speed = SpeedEstimate::default();
            }
            _ => {}
        }
    }

    #[cold]
    #[inline(never)]
    fn fault(&mut self, cause: Fault) {
        if !matches!(self.status, Status::Faulted { .. }) {
            self.enter(Status::Faulted { cause, period: self.period });
        }
    }

    #[inline(never)]
    fn blocked(&mut self) -> Output<R> {
        self.in_flight = [InFlight::default(); 2];
        self.estimate.confidence = R::ZERO;
        Output { duty: zero_duty(), gates_on: false }
    }
}
