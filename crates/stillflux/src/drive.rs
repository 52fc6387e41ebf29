//! The drive: one control period from the current samples to the duties, Figs. 3, 7 and 12 in one pass.
//!
//! ```text
//! i_abc ─ Clarke ─ observer ─ speed ─┐
//! reference ─ speed control ─ flux control ─ current control ─ modulator ─ duties
//! ```
//!
//! **Timing.** Currents sampled at the start of period *k* give the duties applied during period *k + 1*.
//! At the call of period *k* the voltage between the last two samples is therefore the one computed two
//! calls earlier; a pipeline of two entries keeps the estimator on the voltage that was really applied:
//! limited, quantised, at the measured dc link, less what the inverter model says was lost.
//!
//! **Turns.** Observer, current control and modulator run in every period. The speed estimator runs in every
//! second one, speed and flux control, resistance adaptation and confidence in every fourth, one after the other
//! and after the duties are known: their bandwidths leave room for that, and no period carries all of them.
//!
//! **Observer.** Figs. 4, 7 and 12 in the published scheme, one filter in the enhanced one
//! ([`crate::estimate::kalman`]).
//!
//! **Sequence.** `Stopped` → offset reading with gates off → magnetisation → `Running`. Any fault blocks the
//! gates and latches with its cause until [`Drive::reset`].
//! The published scheme magnetises by direct current along the a-axis (with `r̂_s` from its dc values) and
//! then begins at a known flux, `ψ̂_s = ψ̂_1 = ψ_s*∠0`. The enhanced one begins at a flux of zero, which is
//! known better: its filter runs while the flux builds up, along the a-axis for the first 10 ms, which tell
//! the speed of a rotating machine, and along the rotor flux from there on, wherever it turns.
//!
//! No call panics, allocates, or lets a number that is not finite through, whatever the ADC delivers.

#[cfg(feature = "enhanced")]
mod enhanced;
#[cfg(feature = "paper")]
mod published;

use crate::config::{BOOST, DriveConfig, I_OFF_MAX, LowConfidence};
use crate::control::current::CurrentController;
use crate::control::flux::FluxController;
use crate::control::modulator::{Duty, applied, modulate, zero_duty};
use crate::control::speed::SpeedController;
use crate::estimate::flux::FluxEstimate;
use crate::estimate::speed::{SpeedEstimate, SpeedEstimator};
use crate::observer::{Observer, Seen, Slow};
use crate::scalar::{Integrator, Real, clamp_seldom, likely};
use crate::space::{AlphaBeta, Dq};
use crate::words::words;

/// Part of the dc link that the voltage vector may use: the circle within the hexagon, less a margin.
const U_UTILISATION: f64 = 0.98 / 1.732_050_807_568_877_2;
/// Part of that voltage that the flux may take; the rest drives the torque current.
const U_FLUX: f64 = 0.88;
/// dc-link voltage that no sensor reads, per unit.
const U_DC_RANGE: f64 = 100.0;

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
    /// The confidence in the field angle was below one half for longer than a transient, and the drive has been
    /// told to stop then ([`crate::config::LowConfidence::Fault`]).
    LowConfidence,
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
    /// Error of the inverter model's voltage, relative; the published scheme knows none.
    pub loss_error: R,
    /// Main inductance, reciprocal and relative to the parameter; the published scheme knows none.
    pub inv_l_m: R,
}
words!(Memory: u_off, r_s, i_off, loss_error, inv_l_m);

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
    /// Residual: ε of (15), or `m - |ψ̂_R|` of the filter in units of 0.05.
    pub epsilon: R,
    /// Confidence in the field angle, 0 to 1; below 0.5 an error of 15° must be expected.
    pub confidence: R,
}

/// What a period leaves for the next ones; the rest of an [`Estimate`] is computed for those who ask.
#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
struct Latest<R: Real> {
    speed: SpeedEstimate<R>,
    u_s: AlphaBeta<R>,
    i_dq: Dq<R>,
    i_dq_ref: Dq<R>,
    psi_ref: R,
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
    /// Slow turns for which the estimate has been implausible, or too doubtful.
    implausible: u32,
    i_off: [R; 3],
    offset_sum: [Integrator<R>; 3],
    in_flight: [InFlight<R>; 2],
    /// `1/u_dc` of the latest period.
    inv_u_dc: R,
    observer: Observer<R>,
    speed: SpeedEstimator<R>,
    current_control: CurrentController<R>,
    flux_control: FluxController<R>,
    speed_control: SpeedController<R>,
    estimate: Latest<R>,
}

impl<R: Real> Drive<R> {
    /// A stopped drive.
    #[must_use]
    pub fn new(config: DriveConfig<R>) -> Self {
        Self {
            config,
            status: Status::Stopped,
            period: 0,
            stage: 0,
            implausible: 0,
            i_off: [R::ZERO; 3],
            offset_sum: [Integrator::default(); 3],
            in_flight: [InFlight::default(); 2],
            inv_u_dc: R::ZERO,
            observer: Observer::new(&config),
            speed: SpeedEstimator::default(),
            current_control: CurrentController::default(),
            flux_control: FluxController::default(),
            speed_control: SpeedController::default(),
            estimate: Latest::default(),
        }
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
        let o = &self.observer;
        let Latest { speed, u_s, i_dq, i_dq_ref, psi_ref } = self.estimate;
        let flux = o.flux();
        Estimate {
            flux,
            speed,
            psi_1: o.psi_1(),
            u_off: o.u_off(),
            i_s: o.i_s(),
            u_s,
            i_dq,
            i_dq_ref,
            psi_ref,
            torque: flux.magnitude * i_dq.im(),
            r_s: o.r_s(),
            epsilon: o.residual(),
            confidence: if self.status == Status::Running { o.confidence() } else { R::ZERO },
        }
    }

    /// Control periods since power-up (wraps).
    pub fn period(&self) -> u32 {
        self.period
    }

    /// Data worth keeping over a stop or a loss of supply.
    pub fn memory(&self) -> Memory<R> {
        let o = &self.observer;
        let (loss_error, inv_l_m) = o.learned();
        Memory { u_off: o.u_off(), r_s: o.r_s(), i_off: self.i_off, loss_error, inv_l_m }
    }

    /// Takes back what an earlier run stored. Values beyond their limits are limited.
    #[cold]
    #[inline(never)]
    pub fn restore(&mut self, memory: &Memory<R>) {
        for (to, i) in self.i_off.iter_mut().zip(memory.i_off) {
            *to = clamp_seldom(i, R::from_f64(-I_OFF_MAX), R::from_f64(I_OFF_MAX));
        }
        self.observer.restore(&self.config, memory);
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
        if !running && !self.sequence(measured, reference) {
            self.observer.rest(&i_s);
            return self.blocked();
        }
        let u_dc = measured.u_dc;
        self.inv_u_dc = u_dc.recip_next(self.inv_u_dc).unwrap_or_else(|| u_dc.recip());
        let u_max = u_dc * R::from_f64(U_UTILISATION);
        // Written two calls ago; this call's entry takes its place.
        let last = self.in_flight[self.slot()];
        self.estimate.u_s = last.ideal * u_dc - last.loss;
        let (u_ref, i_ref) = match &self.observer {
            #[cfg(feature = "paper")]
            Observer::Published(_) => self.published(&i_s, u_max, running),
            #[cfg(feature = "enhanced")]
            Observer::Enhanced(_) => self.enhanced(measured, &i_s, &last.loss, u_max, running),
        };
        let duty = self.command(&u_ref, &i_ref, u_dc);
        if likely(running) {
            self.turn(reference, u_max);
        }
        Output { duty, gates_on: true }
    }

    /// Place of this period's voltage on its way to the machine.
    #[inline(always)]
    fn slot(&self) -> usize {
        (self.period & 1) as usize
    }

    /// Duties for a voltage and current reference.
    #[inline(always)]
    fn command(&mut self, u_ref: &AlphaBeta<R>, i_ref: &AlphaBeta<R>, u_dc: R) -> Duty<R> {
        // The inverter model sees the current that will flow then: the reference, free from noise.
        let loss = self.config.inverter.distortion(i_ref, u_dc, self.observer.loss_gain());
        let u = u_ref.to_phases();
        let duty =
            modulate([u[0] + loss[0], u[1] + loss[1], u[2] + loss[2]], self.inv_u_dc, self.config.timer.as_ref());
        self.in_flight[self.slot()] = InFlight { ideal: applied(&duty), loss: AlphaBeta::from_phases(loss) };
        duty
    }

    /// Phase currents less the offsets read at rest.
    #[inline(always)]
    fn without_offset(&self, m: &Measurement<R>) -> [R; 3] {
        let ([a, b, c], off) = (m.i_abc, &self.i_off);
        [a - off[0], b - off[1], c - off[2]]
    }

    /// Checks the measurement; the current vector, if measurement and drive can be worked with.
    #[inline]
    fn acquire(&mut self, m: &Measurement<R>) -> Option<AlphaBeta<R>> {
        let c = &self.config;
        let i = self.without_offset(m);
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
        let i_s = AlphaBeta::<R>::from_phases(self.without_offset(m));
        let readable = m.i_abc.iter().all(|i| i.abs() < c.i_range) && m.u_dc.abs() < R::from_f64(U_DC_RANGE);
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
    fn sequence(&mut self, measured: &Measurement<R>, reference: &Reference<R>) -> bool {
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
            for (to, sum) in self.i_off.iter_mut().zip(&self.offset_sum) {
                *to = sum.value();
            }
            if self.i_off.iter().any(|i| i.abs() > R::from_f64(I_OFF_MAX)) {
                self.fault(Fault::CurrentOffset);
                return;
            }
        }
        self.enter(Status::Magnetising);
    }

    /// Boosted until the flux is there, then held.
    fn magnetising_current(&self) -> Dq<R> {
        let c = &self.config;
        let i_d = c.flux_control.feedforward(c.flux_control.psi_rated, R::ZERO);
        Dq::new(if self.stage < c.boost_periods { i_d * R::from_f64(BOOST) } else { i_d }, R::ZERO)
    }

    /// From magnetisation to control.
    fn run(&mut self) {
        self.estimate.psi_ref = self.config.flux_control.psi_rated;
        self.flux_control.start();
        self.speed_control.start(R::ZERO);
        self.enter(Status::Running);
    }

    /// Current control on what the observer has seen. Voltage and current references for the period in which the
    /// duties act.
    #[inline(always)]
    fn follow(&mut self, seen: &Seen<R>, u_max: R) -> (AlphaBeta<R>, AlphaBeta<R>) {
        let c = &self.config;
        let e = &mut self.estimate;
        e.i_dq = seen.i_dq;
        let i_ref = e.i_dq_ref;
        // The duties act from one to two periods after the sample: references are turned to their middle.
        let ahead = seen.field.ahead(e.speed.omega_s * c.t_ahead);
        let i_ahead = ahead.to_stator(&i_ref);
        let u_ff = Dq::new(i_ref.re() * seen.r_s, i_ref.im() * seen.r_s + e.speed.omega_s * seen.magnitude);
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
        e.speed = self.speed.step(&c.speed, &self.observer.psi_s(), &self.observer.i_s());
        self.observer.follow(c, e.speed.omega_s);
    }

    /// Current references: torque, i_q* within current limit and pull-out, i_d* of (12).
    #[inline(never)]
    fn set_currents(&mut self, reference: &Reference<R>, u_max: R) {
        let c = &self.config;
        let e = &mut self.estimate;
        let (omega_s, omega_m) = (e.speed.omega_s, e.speed.omega_m);
        let factor = self.observer.flux_factor(c, omega_m, e.i_dq_ref.im() * e.psi_ref);
        let psi_ref = c.flux_control.reference(omega_s, u_max * R::from_f64(U_FLUX));
        let psi_ref = psi_ref.min(c.flux_control.psi_rated * factor);
        e.psi_ref = psi_ref;
        let i_q_max = (c.pull_out_use * psi_ref).min(c.i_q_max);
        let mut torque_max = i_q_max * psi_ref;
        if c.low_confidence == LowConfidence::LimitTorque {
            let part = (self.observer.confidence() * R::TWO).min(R::ONE);
            torque_max = torque_max.min(c.speed_control.torque_max) * part;
        }
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
        let i_d = self.flux_control.step(&c.flux_control, psi_ref, self.observer.magnitude(), i_q, omega_s);
        e.i_dq_ref = Dq::new(i_d, i_q);
    }

    /// What the estimators adapt slowly, plausibility.
    #[inline(never)]
    fn adapt(&mut self) {
        let c = &self.config;
        let e = &self.estimate;
        let (omega_s, omega_m) = (e.speed.omega_s, e.speed.omega_m);
        let psi_s = self.observer.magnitude();
        self.observer.adapt(c, &Slow { i_dq: e.i_dq, omega_s, omega_m });

        // Plausibility: the flux on its circle, the speed within reach.
        let plausible = (psi_s - e.psi_ref).within(c.psi_deviation) && omega_m.within(c.omega_trip);
        let trusted = c.low_confidence != LowConfidence::Fault || self.observer.confidence() >= R::HALF;
        if likely(plausible && trusted) {
            self.implausible = 0;
        } else {
            self.implausible = self.implausible.saturating_add(1);
            if self.implausible > c.implausible_max {
                self.fault(if plausible { Fault::LowConfidence } else { Fault::EstimateLost });
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
                self.observer.begin();
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
