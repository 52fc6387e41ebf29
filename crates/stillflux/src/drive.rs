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
//! ([`crate::estimate::filter`]).
//!
//! **Sequence.** `Stopped` → offset reading with gates off → magnetisation → `Running`. Any fault blocks the
//! gates and latches with its cause until [`Drive::reset`].
//! The published scheme magnetises by direct current along the a-axis (with `r̂_s` from its dc values) and
//! then begins at a known flux, `ψ̂_s = ψ̂_1 = ψ_s*∠0`. The enhanced one begins at a flux of zero, which is
//! known better: its filter runs while the flux builds up, along the a-axis for the first 10 ms, which tell
//! the speed of a rotating machine, and along the rotor flux from there on, wherever it turns.
//!
//! No call panics, allocates, or lets a number that is not finite through, whatever the ADC delivers.

use crate::config::{BOOST, DriveConfig, LowConfidence, SPEED_PERIODS};
use crate::control::current::CurrentController;
use crate::control::flux::FluxController;
use crate::control::modulator::{Duty, applied, modulate, zero_duty};
use crate::control::shift::FluxShift;
use crate::control::speed::SpeedController;
use crate::estimate::filter::Learned;
use crate::estimate::flux::FluxEstimate;
use crate::estimate::speed::{SpeedEstimate, SpeedEstimator};
use crate::observer::{Applied, Observer, Seen};
use crate::scalar::{Integrator, Real, likely};
use crate::space::{AlphaBeta, Dq, Rotator};
use crate::words::words;

/// Speed above which a machine counts as rotating at the start.
const TURNING: f64 = 0.03;

/// Part of the magnetising current with which a start at rest tells resistance from inverter error.
const REDUCED: f64 = 0.7;

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
    r_s_sum: Integrator<R>,
    in_flight: [InFlight<R>; 2],
    /// `1/u_dc` of the latest period.
    inv_u_dc: R,
    observer: Observer<R>,
    speed: SpeedEstimator<R>,
    /// Sums of `ψ_R × dψ_R` without its slip part and of `|ψ_R|²`: their ratio is the speed.
    probe: [R; 2],
    /// What they said: the machine turns.
    turning: bool,
    current_control: CurrentController<R>,
    flux_control: FluxController<R>,
    speed_control: SpeedController<R>,
    shift: FluxShift<R>,
    estimate: Estimate<R>,
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
            r_s_sum: Integrator::default(),
            in_flight: [InFlight::default(); 2],
            inv_u_dc: R::ZERO,
            observer: Observer::new(&config),
            speed: SpeedEstimator::default(),
            probe: [R::ZERO; 2],
            turning: false,
            current_control: CurrentController::default(),
            flux_control: FluxController::default(),
            speed_control: SpeedController::default(),
            shift: FluxShift::default(),
            estimate: Estimate::default(),
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
        let flux = o.flux();
        let confidence = if self.status == Status::Running { o.confidence() } else { R::ZERO };
        Estimate {
            flux,
            psi_1: o.psi_1(),
            u_off: o.u_off(),
            torque: flux.magnitude * self.estimate.i_dq.im(),
            r_s: o.r_s(),
            epsilon: o.residual(),
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
        let o = &self.observer;
        let (loss_error, inv_l_m) = match o {
            Observer::Published(_) => (R::ZERO, R::ONE),
            Observer::Enhanced(o) => (o.filter.v(), o.filter.learned().gamma),
        };
        Memory { u_off: o.u_off(), r_s: o.r_s(), i_off: self.i_off, loss_error, inv_l_m }
    }

    /// Takes back what an earlier run stored. Values beyond their limits are limited.
    pub fn restore(&mut self, memory: &Memory<R>) {
        let c = &self.config;
        self.i_off = memory.i_off.map(|i| i.limit(c.i_off_max));
        let u_off = memory.u_off.limit_components(c.u_off_limit);
        match (&mut self.observer, &c.filter) {
            (Observer::Published(o), _) => {
                o.flux.offset.restore(u_off);
                o.resistance.start(memory.r_s.clamp(c.pu.r_s * R::HALF, c.pu.r_s * R::from_f64(1.5)));
            }
            (Observer::Enhanced(o), Some(f)) => {
                // Readings at rest replace what was learned beyond the readings of that run.
                let b = if c.calibrate_offset { AlphaBeta::default() } else { u_off * -memory.r_s.recip() };
                let Memory { r_s, loss_error: v, inv_l_m: gamma, .. } = *memory;
                o.filter.restore(f, &Learned { b, r_s, v, gamma });
            }
            (Observer::Enhanced(_), None) => {}
        }
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
        let last = self.in_flight[self.slot()];
        let u_s = last.ideal * u_dc - last.loss;
        self.estimate.u_s = u_s;
        if matches!(self.observer, Observer::Enhanced(_)) {
            let [a, b, c] = measured.i_abc;
            let sum = a - self.i_off[0] + (b - self.i_off[1]) + (c - self.i_off[2]);
            let x = Applied { i_s, sum, u_s, u_l: last.loss };
            return self.step_enhanced(&x, u_dc, u_max, reference, running);
        }
        let (u_ref, i_ref) =
            if likely(running) { self.control(&i_s, &u_s, u_max) } else { self.magnetise(&i_s, &u_s, u_max) };
        let duty = self.command(&u_ref, &i_ref, u_dc, R::ONE);
        if likely(running) {
            self.turn(reference, u_max);
        }
        Output { duty, gates_on: true }
    }

    /// The rest of a period of the enhanced scheme, under control or on the way to it.
    // Apart, so that the published scheme's period stays straight.
    #[inline(never)]
    fn step_enhanced(
        &mut self,
        x: &Applied<R>,
        u_dc: R,
        u_max: R,
        reference: &Reference<R>,
        running: bool,
    ) -> Output<R> {
        let (u_ref, i_ref) = if likely(running) { self.control_enhanced(x, u_max) } else { self.build_up(x, u_max) };
        let duty = self.command(&u_ref, &i_ref, u_dc, self.observer.loss_gain());
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

    /// Duties for a voltage and current reference; `gain` is what the inverter model has to be multiplied by.
    #[inline(always)]
    fn command(&mut self, u_ref: &AlphaBeta<R>, i_ref: &AlphaBeta<R>, u_dc: R, gain: R) -> Duty<R> {
        // The inverter model sees the current that will flow then: the reference, free from noise.
        let loss = self.config.inverter.distortion(i_ref, u_dc, gain);
        let u = u_ref.to_phases();
        let duty =
            modulate([u[0] + loss[0], u[1] + loss[1], u[2] + loss[2]], self.inv_u_dc, self.config.timer.as_ref());
        self.in_flight[self.slot()] = InFlight { ideal: applied(&duty), loss: AlphaBeta::from_phases(loss) };
        duty
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
        let i_ref = self.magnetising_current();
        let field = Rotator::default();
        let i_dq = field.to_field(i_s);
        let u = self.current_control.step(&c.current, &i_ref, &i_dq, &(i_ref * c.pu.r_s), u_max);

        let left = c.magnetise_periods.saturating_sub(self.stage);
        if left < c.r_s_periods {
            // u_d / i_d*, averaged: no current offset is left in it, no threshold, and no dψ/dt.
            self.r_s_sum.add(c.inv_r_s_periods * i_ref.re().recip(), u_s.re());
        }
        self.estimate.i_dq = i_dq;
        self.estimate.i_dq_ref = i_ref;
        if left == 0 {
            let psi = AlphaBeta::new(c.flux_control.psi_rated, R::ZERO);
            if let Observer::Published(o) = &mut self.observer {
                if c.calibrate_offset {
                    let r = c.pu.r_s;
                    o.resistance.start(self.r_s_sum.value().clamp(r * R::HALF, r * R::from_f64(1.5)));
                }
                o.flux.start(psi, *i_s);
                o.flux.follow(&c.flux, R::ZERO);
                o.confidence.start();
            }
            self.speed.start(&psi, R::ZERO);
            self.run();
        }
        (field.to_stator(&u), field.to_stator(&i_ref))
    }

    /// The enhanced scheme's way to its flux, at any speed. A current that stands still in space drives
    /// `ψ_R` away from zero, and the rotor turns it: `ω = Σ ψ_R × (dψ_R - r_R i dτ) / Σ |ψ_R|² dτ` needs no more
    /// than some milliseconds of it, at 1 pu half a turn. In a machine that turns the current follows `ψ̂_R` from
    /// there on, and the flux builds up as it does at rest. In one at rest the current stays where it is (following
    /// a flux that is a degree off would set a free shaft in motion) until the flux has settled, and then long
    /// enough for the filter to find what resistance and inverter take together.
    #[cold]
    #[inline(never)]
    fn build_up(&mut self, x: &Applied<R>, u_max: R) -> (AlphaBeta<R>, AlphaBeta<R>) {
        let mut i_ref = self.magnetising_current();
        let c = &self.config;
        // Less current for a while: a resistance notices, a voltage that the inverter model has wrong does not.
        if !self.turning && (9..12).contains(&(self.stage * 16 / c.magnetise_periods.max(1))) {
            i_ref = i_ref * R::from_f64(REDUCED);
        }
        let e = &mut self.estimate;
        let probing = self.stage <= c.probe_periods;
        // At rest, the flux is waited for: then it is known by the current.
        let settled = c.magnetise_periods / 2;
        let before = e.speed.psi_r;
        let mut seen = Seen::default();
        if let (Observer::Enhanced(o), Some(f)) = (&mut self.observer, &c.filter) {
            if self.stage <= 1 {
                o.filter.start(f, &x.i_s);
            } else if self.stage == settled && !self.turning {
                o.filter.settle(f, c.flux_control.psi_rated);
                self.speed.start(&o.filter.value(), R::ZERO);
            }
            seen = o.step(f, c, x, &i_ref, e.speed.omega_s, probing);
        }
        let psi_s = self.observer.psi_s();
        e.i_s = seen.i_s;
        let mut field = Rotator::default();
        if probing {
            let psi_r = psi_s - seen.i_s * c.speed.sigma_l_s;
            // The rise of the current is over after a fifth of it.
            if self.stage > c.probe_periods / 5 {
                let turned = before.cross(&(psi_r - before)) - c.pu.t_s * c.pu.r_r * psi_r.cross(&seen.i_s);
                self.probe[0] += turned;
                self.probe[1] += c.pu.t_s * psi_r.norm_sq();
            }
            e.speed.psi_r = psi_r;
            if self.stage == c.probe_periods {
                let omega = (self.probe[0] * self.probe[1].recip()).limit(R::from_f64(1.5));
                self.turning = omega.abs() > R::from_f64(TURNING);
                self.speed.start(&psi_r, omega);
                (e.speed.omega_m, e.speed.omega_s) = (omega, omega);
            }
        } else {
            if self.period.is_multiple_of(SPEED_PERIODS) {
                e.speed = self.speed.step(&c.speed, &psi_s, &seen.i_s);
            }
            if self.turning {
                field = Rotator::of(&(psi_s - seen.i_s * c.speed.sigma_l_s)).0;
            }
        }
        e.i_dq = field.to_field(&seen.i_s);
        e.i_dq_ref = i_ref;
        let u_ff = Dq::new(i_ref.re() * seen.r_s, e.speed.omega_s * seen.magnitude);
        let u = self.current_control.step(&c.current, &i_ref, &e.i_dq, &u_ff, u_max);
        let ahead = field.ahead(e.speed.omega_s * c.t_ahead);
        if self.stage >= if self.turning { c.boost_periods } else { c.magnetise_periods } {
            self.run();
        }
        (ahead.to_stator(&u), ahead.to_stator(&i_ref))
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
        self.shift = FluxShift::default();
        self.enter(Status::Running);
    }

    /// What every period of the enhanced scheme needs: filter and current control.
    #[inline(always)]
    fn control_enhanced(&mut self, x: &Applied<R>, u_max: R) -> (AlphaBeta<R>, AlphaBeta<R>) {
        let (c, e) = (&self.config, &self.estimate);
        let mut seen = Seen::default();
        if let (Observer::Enhanced(o), Some(f)) = (&mut self.observer, &c.filter) {
            seen = o.period(f, c, x, &e.i_dq_ref, e.speed.omega_s, false);
        }
        self.follow(&seen, u_max)
    }

    /// What every period of the published scheme needs: flux estimator and current control.
    #[inline(always)]
    fn control(&mut self, i_s: &AlphaBeta<R>, u_s: &AlphaBeta<R>, u_max: R) -> (AlphaBeta<R>, AlphaBeta<R>) {
        let (c, e) = (&self.config, &self.estimate);
        let mut seen = Seen::default();
        if let Observer::Published(o) = &mut self.observer {
            seen = o.step(c, i_s, u_s, e.psi_ref);
        }
        self.follow(&seen, u_max)
    }

    /// Current control on what the observer has seen. Voltage and current references for the period in which the
    /// duties act.
    #[inline(always)]
    fn follow(&mut self, seen: &Seen<R>, u_max: R) -> (AlphaBeta<R>, AlphaBeta<R>) {
        let c = &self.config;
        let e = &mut self.estimate;
        (e.i_s, e.i_dq) = (seen.i_s, seen.i_dq);
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
        e.speed = self.speed.step(&c.speed, &self.observer.psi_s(), &e.i_s);
        if let Observer::Published(o) = &mut self.observer {
            o.flux.follow(&c.flux, e.speed.omega_s);
        }
    }

    /// Current references: torque, i_q* within current limit and pull-out, i_d* of (12).
    #[inline(never)]
    fn set_currents(&mut self, reference: &Reference<R>, u_max: R) {
        let c = &self.config;
        let e = &mut self.estimate;
        let (omega_s, omega_m) = (e.speed.omega_s, e.speed.omega_m);
        let mut psi_ref = c.flux_control.reference(omega_s, u_max * c.u_flux);
        if let Some(shift) = &c.shift {
            let factor = self.shift.step(shift, omega_m, e.i_dq_ref.im() * e.psi_ref);
            psi_ref = psi_ref.min(c.flux_control.psi_rated * factor);
        }
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

    /// Resistance (Fig. 12) and confidence of the published scheme, plausibility.
    #[inline(never)]
    fn adapt(&mut self) {
        let c = &self.config;
        let e = &self.estimate;
        let (omega_s, omega_m) = (e.speed.omega_s, e.speed.omega_m);
        let psi_s = self.observer.magnitude();
        match &mut self.observer {
            Observer::Published(o) => {
                if let Some(resistance) = &c.resistance {
                    o.resistance.step(resistance, psi_s, &e.i_dq, omega_s, omega_m);
                }
                let corrected = (o.flux.offset.updates() > 0).then(|| o.flux.offset.last_correction());
                o.confidence.step(&c.confidence, omega_s, o.flux.effort(), corrected);
            }
            Observer::Enhanced(o) => {
                if let Some(f) = &c.filter {
                    o.filter.confine(f);
                }
            }
        }

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
                self.r_s_sum = Integrator::default();
                self.current_control.start();
                self.in_flight = [InFlight::default(); 2];
                self.estimate.speed = SpeedEstimate::default();
                (self.probe, self.turning) = ([R::ZERO; 2], false);
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
