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
//! **Turns.** Flux estimator, current control and modulator run in every period. The speed estimator runs in every
//! second one, speed and flux control, resistance adaptation and confidence in every fourth, one after the other
//! and after the duties are known: their bandwidths leave room for that, and no period carries all of them.
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
use crate::scalar::{Integrator, Real, likely};
use crate::space::{AlphaBeta, Dq, Rotator};
use crate::words::words;

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

impl<R: Real> Reference<R> {
    /// Asks for a motion, with a finite number.
    #[inline]
    fn is_admissible(&self) -> bool {
        match self {
            Self::Stop => false,
            Self::Speed(x) | Self::Torque(x) => x.is_finite(),
        }
    }
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
words!(Memory: u_off, r_s, i_off);

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
    /// `1/u_dc` of the latest period.
    inv_u_dc: R,
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
            inv_u_dc: R::ZERO,
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

    /// Estimates of the latest period; what the step does not need in this form is computed here.
    pub fn estimate(&self) -> Estimate<R> {
        let flux = self.flux.estimate();
        let confidence = if self.status == Status::Running { self.confidence.value() } else { R::ZERO };
        Estimate {
            flux,
            psi_1: self.flux.offset.psi_1(),
            u_off: self.flux.offset.u_off(),
            torque: flux.magnitude * self.estimate.i_dq.im(),
            r_s: self.resistance.r_s(),
            epsilon: self.resistance.epsilon(),
            confidence,
            ..self.estimate
        }
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
        let Some(i_s) = self.acquire(measured) else {
            return self.blocked();
        };
        let running = likely(self.status == Status::Running && reference.is_admissible());
        if !running && !self.sequence(measured, reference, &i_s) {
            return self.blocked();
        }
        let u_dc = measured.u_dc;
        self.inv_u_dc = u_dc.recip_next(self.inv_u_dc).unwrap_or_else(|| u_dc.recip());
        let u_max = u_dc * self.config.u_utilisation;
        // Written two calls ago; this call's entry takes its place.
        let slot = (self.period & 1) as usize;
        let last = self.in_flight[slot];
        let u_s = last.ideal * u_dc - last.loss;
        self.estimate.u_s = u_s;

        let (u_ref, i_ref) =
            if likely(running) { self.control(&i_s, &u_s, u_max) } else { self.magnetise(&i_s, &u_s, u_max) };

        // The inverter model sees the current that will flow then: the reference, free from noise.
        let loss = self.config.inverter.distortion(&i_ref, u_dc);
        let u = u_ref.to_phases();
        let duty =
            modulate([u[0] + loss[0], u[1] + loss[1], u[2] + loss[2]], self.inv_u_dc, self.config.timer.as_ref());
        self.in_flight[slot] = InFlight { ideal: applied(&duty), loss: AlphaBeta::from_phases(loss) };

        if likely(running) {
            self.turn(reference, u_max);
        }
        Output { duty, gates_on: true }
    }

    /// Checks the measurement; the current vector, if measurement and drive can be worked with.
    #[inline]
    fn acquire(&mut self, m: &Measurement<R>) -> Option<AlphaBeta<R>> {
        let c = &self.config;
        let i = [m.i_abc[0] - self.i_off[0], m.i_abc[1] - self.i_off[1], m.i_abc[2] - self.i_off[2]];
        // One comparison for four: no channel near its range, the vector below the trip level. Written so that
        // NaN fails it.
        let sum = i[0] * i[0] + i[1] * i[1] + i[2] * i[2];
        if !likely(sum <= c.i_plain_sq && m.u_dc >= c.u_dc_min && m.u_dc <= c.u_dc_max) {
            self.examine(m)?;
        }
        Some(AlphaBeta::from_phases(i))
    }

    /// What is wrong with a measurement, if anything.
    #[cold]
    #[inline(never)]
    fn examine(&mut self, m: &Measurement<R>) -> Option<()> {
        let c = &self.config;
        let i_s = AlphaBeta::<R>::from_phases([0, 1, 2].map(|k| m.i_abc[k] - self.i_off[k]));
        let readable = m.i_abc.iter().all(|i| i.abs() < c.i_range) && m.u_dc.abs() < c.u_dc_range;
        let cause = if !readable {
            Fault::Measurement
        } else if m.u_dc < c.u_dc_min {
            Fault::UnderVoltage
        } else if m.u_dc > c.u_dc_max {
            Fault::OverVoltage
        } else if i_s.norm_sq() > c.i_trip * c.i_trip {
            Fault::OverCurrent
        } else {
            return Some(());
        };
        self.fault(cause);
        None
    }

    /// All states but `Running`: whether the bridge is to be driven in this period.
    #[cold]
    #[inline(never)]
    fn sequence(&mut self, measured: &Measurement<R>, reference: &Reference<R>, i_s: &AlphaBeta<R>) -> bool {
        self.estimate.i_s = *i_s;
        self.stage = self.stage.saturating_add(1);
        if !reference.is_admissible() && *reference != Reference::Stop {
            self.fault(Fault::Reference);
        }
        match (self.status, reference) {
            (Status::Faulted { .. }, _) | (Status::Stopped, Reference::Stop) => return false,
            (_, Reference::Stop) => {
                self.enter(Status::Stopped);
                return false;
            }
            (Status::Stopped, _) => self.enter(Status::ReadingOffset),
            _ => {}
        }
        if self.status == Status::ReadingOffset {
            self.read_offset(measured);
            return false;
        }
        true
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
    #[cold]
    #[inline(never)]
    fn magnetise(&mut self, i_s: &AlphaBeta<R>, u_s: &AlphaBeta<R>, u_max: R) -> (AlphaBeta<R>, AlphaBeta<R>) {
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
            self.flux.follow(&c.flux, R::ZERO);
            self.speed.start(&psi, R::ZERO);
            self.estimate.psi_ref = c.flux_control.psi_rated;
            self.confidence.start();
            self.flux_control.start();
            self.speed_control.start(R::ZERO);
            self.enter(Status::Running);
        }
        (field.to_stator(&u), field.to_stator(&i_ref))
    }

    /// What every period needs: flux estimator and current control. Voltage and current references for the
    /// period in which the duties act.
    #[inline(always)]
    fn control(&mut self, i_s: &AlphaBeta<R>, u_s: &AlphaBeta<R>, u_max: R) -> (AlphaBeta<R>, AlphaBeta<R>) {
        let c = &self.config;
        let e = &mut self.estimate;
        let r_s = self.resistance.r_s();

        self.flux.step(&c.flux, u_s, i_s, r_s, e.psi_ref);
        let field = self.flux.field();
        // What û_off stands for is first of all an offset of the current sensors, û_off = -r_s i_off. The
        // flux estimator has it removed already; control and inverter model get the current without it.
        e.i_s = *i_s + self.flux.offset.u_off() * c.inv_r_s;
        e.i_dq = field.to_field(&e.i_s);

        let i_ref = e.i_dq_ref;
        // The duties act from one to two periods after the sample: references are turned to their middle.
        let ahead = field.ahead(e.speed.omega_s * c.t_ahead);
        let i_ahead = ahead.to_stator(&i_ref);
        let u_ff = Dq::new(i_ref.re() * r_s, i_ref.im() * r_s + e.speed.omega_s * self.flux.magnitude());
        let u = self.current_control.step(&c.current, &i_ref, &e.i_dq, &u_ff, u_max);
        (ahead.to_stator(&u), i_ahead)
    }

    /// What is slow against the control period takes turns, after the duties are known: the speed estimator in
    /// every second period, the rest in every fourth. So no period has to carry all of it.
    #[inline(always)]
    fn turn(&mut self, reference: &Reference<R>, u_max: R) {
        match self.period & 3 {
            0 => self.set_currents(reference, u_max),
            2 => self.adapt(),
            _ => self.track(),
        }
    }

    /// Speed estimator, and what follows the stator frequency.
    #[inline(never)]
    fn track(&mut self) {
        let c = &self.config;
        let e = &mut self.estimate;
        e.speed = self.speed.step(&c.speed, &self.flux.value(), &e.i_s);
        self.flux.follow(&c.flux, e.speed.omega_s);
    }

    /// Current references: torque, i_q* within current limit and pull-out, i_d* of (12).
    #[inline(never)]
    fn set_currents(&mut self, reference: &Reference<R>, u_max: R) {
        let c = &self.config;
        let e = &mut self.estimate;
        let (omega_s, omega_m) = (e.speed.omega_s, e.speed.omega_m);
        let psi_ref = c.flux_control.reference(omega_s, u_max * c.u_flux);
        e.psi_ref = psi_ref;
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
        let i_q = torque_ref * c.flux_control.reciprocal(psi_ref);
        let i_d = self.flux_control.step(&c.flux_control, psi_ref, self.flux.magnitude(), i_q, omega_s);
        e.i_dq_ref = Dq::new(i_d, i_q);
    }

    /// Resistance (Fig. 12), confidence, plausibility.
    #[inline(never)]
    fn adapt(&mut self) {
        let c = &self.config;
        let e = &self.estimate;
        let (omega_s, omega_m) = (e.speed.omega_s, e.speed.omega_m);
        let psi_s = self.flux.magnitude();
        if let Some(resistance) = &c.resistance {
            self.resistance.step(resistance, psi_s, &e.i_dq, omega_s, omega_m);
        }
        let corrected = (self.flux.offset.updates() > 0).then(|| self.flux.offset.last_correction());
        self.confidence.step(&c.confidence, omega_s, self.flux.effort(), corrected);

        // Plausibility: the flux on its circle, the speed within reach.
        let plausible = (psi_s - e.psi_ref).within(c.psi_deviation) && omega_m.within(c.omega_trip);
        if likely(plausible) {
            self.implausible = 0;
        } else {
            self.implausible = self.implausible.saturating_add(1);
            if self.implausible > c.implausible_max {
                self.fault(Fault::EstimateLost);
            }
        }
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
        Output { duty: zero_duty(), gates_on: false }
    }
}
