//! The drive: one control period from the current samples to the duties, Figs. 3, 7 and 12 in one pass.
//!
//! ```text
//! i_abc ─ Clarke ─ estimators ─ speed ─┐
//! reference ─ speed control ─ flux control ─ current control ─ modulator ─ duties
//! ```
//!
//! **Timing.** Currents sampled at the start of period *k* give the duties applied during period *k + 1*.
//!
//! **Rates.** Estimators, current control and modulator run in every period, supervision in every fourth. With at least 8000
//! periods a second the speed estimator runs in every fourth (that of the published scheme in every second), speed and flux
//! control in every eighth, the limits of the references and the slow adaptation in every sixteenth; with fewer in every second,
//! fourth, fourth and fourth one: each in a period of its own, but for limits, adaptation and supervision with fewer, and
//! after the duties are known. Their bandwidths allow it, and no period has to compute all of them.
//!
//! **Schemes.** The published scheme estimates by Figs. 4, 7 and 12, the enhanced one by one filter
//! ([`crate::estimate::kalman`]). Each has its own start-up for the stage `Magnetising` of the sequence `Stopped` →
//! `ReadingOffset` (gates off) → `Magnetising` → `Running`. The scheme is matched once in a period.
//!
//! **Faults.** Any fault blocks the gates and latches with its cause until [`Drive::reset`].
//!
//! No call panics, allocates, or lets a number that is not finite through, whatever the ADC delivers.

mod control;
#[cfg(feature = "enhanced")]
mod enhanced;
mod estimators;
mod interface;
#[cfg(feature = "paper")]
mod paper;
#[cfg(feature = "ripple")]
mod ripple;
#[cfg(not(feature = "ripple"))]
#[path = "drive/left_out/ripple.rs"]
mod ripple;
mod scheme;
mod sequence;
mod voltage;

#[cfg(feature = "encoder")]
pub use crate::control::handover::EncoderState;
pub use crate::supervision::{Fault, FaultReport, Quantity, Trip};
#[cfg(feature = "encoder")]
pub use interface::EncoderReading;
pub use interface::{Estimate, Measurement, Memory, Output, Reference, Status};

use crate::config::DriveConfig;
use crate::control::modulator::zero_duty;
#[cfg(feature = "shunt")]
use crate::control::shunt::Pulses;
use crate::scalar::{Real, likely};
use crate::space::AlphaBeta;
use crate::supervision::{Currents, Supervision, Tracking};
use control::Control;
use estimators::{CurrentControl, Estimated, Estimators, FieldQuantities, PeriodInput, PeriodOutput, StartUp};
use scheme::{SchemeEstimators, with_estimators};
use sequence::{Action, Sequence};

/// A sensorless induction motor drive.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
#[repr(C)]
pub struct Drive<R: Real> {
    // In this order: what every period reads and writes comes first, within the reach of one instruction.
    common: Common<R>,
    estimators: SchemeEstimators<R>,
    config: DriveConfig<R>,
}

impl<R: Real> Drive<R> {
    /// A stopped drive.
    #[must_use]
    pub fn new(config: DriveConfig<R>) -> Self {
        Self {
            config,
            estimators: SchemeEstimators::new(&config),
            common: Common { sequence: Sequence::new(), supervision: Supervision::new(), control: Control::new() },
        }
    }

    /// Configuration.
    pub fn config(&self) -> &DriveConfig<R> {
        &self.config
    }

    /// State of the sequence.
    pub fn status(&self) -> Status {
        self.common.sequence.status()
    }

    /// The latched fault: cause, period, and what was measured; `None` unless the drive is in a fault.
    pub fn fault(&self) -> Option<FaultReport<R>> {
        self.common.sequence.report()
    }

    /// Control periods since power-up (wraps).
    pub fn period(&self) -> u32 {
        self.common.sequence.period()
    }

    /// One control period.
    pub fn step(&mut self, measured: &Measurement<R>, reference: &Reference<R>) -> Output<R> {
        let Self { config, estimators, common } = self;
        // Loads into the FPU reach 1 KiB from an address (VLDR). The configuration lies behind the state: beyond 1 KiB each of
        // its constants would cost an addition. With an address that the compiler knows nothing of it has a base register of
        // its own. The state of the published scheme alone is short enough.
        let config = if R::FLOATING && cfg!(feature = "enhanced") { core::hint::black_box(&*config) } else { &*config };
        with_estimators!(estimators, e => common.step(config, e, measured, reference))
    }

    /// One control period with the stamp of its PWM period, a number that the hardware counts up by one in each
    /// ([`crate::supervision::timing`]). `None`: the period has been computed before, and its duties stay. Only while the
    /// bridge switches and is to go on: a stop, a reference that is not admissible and a fault block it with any stamp, so
    /// that a counter that stands still keeps no gate on.
    #[cfg(feature = "supervision")]
    pub fn step_at(&mut self, stamp: u16, measured: &Measurement<R>, reference: &Reference<R>) -> Option<Output<R>> {
        let periods = self.common.periods_since(stamp);
        if !likely(periods != 0) {
            if !self.common.sequence.is_switching() {
                return Some(self.common.blocked());
            }
            if reference.is_admissible() {
                return None;
            }
        }
        #[cfg(feature = "modes")]
        if periods.is_multiple_of(2) {
            self.common.control.voltage.swap_halves();
        }
        Some(self.step(measured, reference))
    }

    /// Estimates of the latest period; what the step does not need in this form is computed here.
    pub fn estimate(&self) -> Estimate<R> {
        let Control { i_dq, i_dq_ref, psi_ref, ref voltage, .. } = self.common.control;
        let estimated: Estimated<R> = with_estimators!(&self.estimators, e => e.estimated(&self.config));
        let running = self.status() == Status::Running;
        let confidence = self.common.control.confidence(|| estimated.confidence);
        // What the bridge made in an earlier run is not there while it is blocked.
        let present = if self.common.sequence.is_switching() { R::ONE } else { R::ZERO };
        let (i_dq, i_dq_ref) = (i_dq * present, i_dq_ref * present);
        Estimate {
            flux: estimated.flux,
            speed: estimated.speed,
            psi_1: estimated.psi_1,
            u_off: estimated.u_off,
            i_s: estimated.i_s,
            u_s: voltage.u_s * present,
            i_dq,
            i_dq_ref,
            psi_ref,
            torque: estimated.flux.magnitude * i_dq.im(),
            r_s: estimated.r_s,
            r_r: estimated.r_r,
            epsilon: estimated.epsilon,
            innovation: estimated.innovation,
            nis: estimated.nis,
            angle_deviation: if running { estimated.angle_deviation } else { R::from_f64(core::f64::consts::PI) },
            confidence: if running { confidence } else { R::ZERO },
            speed_gain: self.common.control.speed_gain(),
        }
    }

    /// Pulses of the next period and instants of its samples with a single shunt ([`DriveParams::current_sensors`] = 1),
    /// `None` with more sensors. Their duties are those of [`Output::duty`]; while the bridge is blocked they have no effect.
    ///
    /// [`DriveParams::current_sensors`]: crate::config::DriveParams::current_sensors
    #[cfg(feature = "shunt")]
    pub fn pulses(&self) -> Option<Pulses<R>> {
        let half = [R::HALF; 3];
        let blocked = Pulses { rising: half, falling: half, sample: [R::HALF; 2] };
        self.config.single_shunt().then(|| self.common.control.voltage.pulses().unwrap_or(blocked))
    }

    /// Content of the encoder's counter at the instant of the currents of the next step, below
    /// [`DriveParams::encoder_states`]; once a period, in every state of the drive. Without effect if the drive has no
    /// encoder.
    ///
    /// [`DriveParams::encoder_states`]: crate::config::DriveParams::encoder_states
    #[cfg(feature = "encoder")]
    #[inline]
    pub fn set_encoder(&mut self, count: u32) {
        self.common.control.encoder.set(count);
    }

    /// What the encoder says; `None` without one ([`DriveParams::encoder_lines`]).
    ///
    /// [`DriveParams::encoder_lines`]: crate::config::DriveParams::encoder_lines
    #[cfg(feature = "encoder")]
    pub fn encoder(&self) -> Option<EncoderReading<R>> {
        let (c, control) = (&self.config, &self.common.control);
        let (encoder, hand_over) = (&control.encoder, &control.hand_over);
        let running = self.status() == Status::Running;
        let state = match hand_over.state() {
            _ if control.is_silent(c) => EncoderState::Silent,
            // There is nothing yet that could contradict it.
            EncoderState::Silent if !running => EncoderState::Agrees,
            state => state,
        };
        let difference = if running { hand_over.difference() } else { R::ZERO };
        c.encoder.as_ref().map(|_| EncoderReading { omega_m: encoder.omega(), difference, state })
    }

    /// Data worth keeping over a stop or a loss of supply.
    pub fn memory(&self) -> Memory<R> {
        let i_off = self.common.sequence.i_off();
        with_estimators!(&self.estimators, e => e.memory(&self.config, i_off))
    }

    /// Restores what an earlier run stored. Values beyond their limits are limited. Only while the bridge is blocked: an
    /// estimate that is in use stays as it is, and the return value is `false`.
    #[cold]
    #[inline(never)]
    pub fn restore(&mut self, memory: &Memory<R>) -> bool {
        if self.common.sequence.is_switching() {
            return false;
        }
        self.common.sequence.restore(&self.config, memory.i_off);
        self.estimators.restore(&self.config, memory);
        true
    }

    /// Duty of the brake chopper at a link voltage, 0 to 1, in every state of the drive; 0 without the setting.
    #[cfg(feature = "dclink")]
    pub fn chopper(&self, u_dc: R) -> R {
        self.config.dclink.chopper(u_dc)
    }

    /// Heat of machine and bridge in units of that at their continuous currents; 0 without the settings.
    pub fn overload(&self) -> [R; 2] {
        self.common.control.overload()
    }

    /// Leaves a fault; the drive is stopped then.
    pub fn reset(&mut self) {
        if matches!(self.status(), Status::Faulted { .. }) {
            self.common.sequence.enter(Status::Stopped);
        }
    }
}

/// State that does not depend on the scheme.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
struct Common<R: Real> {
    sequence: Sequence<R>,
    supervision: Supervision<R>,
    control: Control<R>,
}

impl<R: Real> Common<R> {
    /// One control period with the estimators of a scheme.
    #[inline(always)]
    fn step<E: Estimators<R>>(
        &mut self,
        c: &DriveConfig<R>,
        estimators: &mut E,
        measured: &Measurement<R>,
        reference: &Reference<R>,
    ) -> Output<R> {
        let period = self.sequence.count();
        #[cfg(feature = "encoder")]
        self.control.track(c, period);
        #[cfg(feature = "shunt")]
        let seen;
        #[cfg(feature = "shunt")]
        let measured = if likely(!c.single_shunt()) {
            measured
        } else {
            seen = self.seen(c, measured);
            &seen
        };
        let bridged;
        // The currents in either branch: in the likely one the check of the measurement has them already.
        let (measured, i_abc, u_dc) = if likely(self.sequence.accepts(c, measured)) {
            (measured, self.sequence.currents(c, measured, estimators), measured.u_dc)
        } else {
            let Some(instead) = self.bridge(c, estimators, measured) else {
                return self.blocked();
            };
            bridged = instead;
            (&bridged, self.sequence.currents(c, &bridged, estimators), bridged.u_dc)
        };
        let i_s = AlphaBeta::from_phases(i_abc);
        // Before the state of the sequence is asked for: with nothing between the questions about it the compiler asks once.
        let u_s = self.control.voltage.applied(period, u_dc);
        let mut start_up = None;
        if likely(matches!(self.sequence.status(), Status::Running)) {
            if !likely(reference.is_admissible()) {
                // A stop, or a reference that is not a number.
                self.prepare(c, estimators, measured, reference, i_s);
                return self.blocked();
            }
        } else {
            start_up = self.prepare(c, estimators, measured, reference, i_s);
            if start_up.is_none() {
                return self.blocked();
            }
        }
        let field = self.estimate(c, estimators, (i_abc, i_s), (period, u_dc, u_s), start_up);
        let (ripple, running) = (period & 3 == 2, start_up.is_none());
        let duty = self.control.duties(c, &field, (period, ripple, running), u_dc, estimators.inverter(c));
        if likely(running) {
            self.slow_tasks(c, estimators, reference, (period, u_dc));
        }
        if period & 3 == 2 && !likely(self.supervise(c, estimators, reference, (&i_abc, &field), running)) {
            return self.blocked();
        }
        Output { duty, gates_on: start_up.is_none_or(|at| !estimators.blocks(at)) }
    }

    /// Phase currents of the readings of a single shunt. A reading at or beyond its range stays what it is, and is found as
    /// that.
    #[cfg(feature = "shunt")]
    #[cold]
    #[inline(never)]
    fn seen(&mut self, c: &DriveConfig<R>, m: &Measurement<R>) -> Measurement<R> {
        let (shunt, period) = (&mut self.control.voltage.shunt, self.sequence.period());
        let of_three = |i| Measurement { i_abc: [i; 3], u_dc: m.u_dc };
        // Written so that NaN is not readable.
        let readable = |i: R| i.abs() < c.i_range;
        if let Some(bad) = m.i_abc.into_iter().find(|i| !readable(*i)) {
            return of_three(bad);
        }
        if let Some(reading) = shunt.zero(period, &m.i_abc) {
            self.sequence.follow_offset(reading);
        }
        let offset = self.sequence.i_off()[2];
        match c.shunt.as_ref().and_then(|c| shunt.currents(c, period, &m.i_abc, offset)) {
            Some(i_abc) => Measurement { i_abc, u_dc: m.u_dc },
            // Three equal currents have no space vector: none flows while the bridge is blocked.
            None => of_three(m.i_abc[2]),
        }
    }

    /// All states but `Running`: progress of the start-up, if this is a period of it.
    #[cold]
    #[inline(never)]
    fn prepare<E: Estimators<R>>(
        &mut self,
        c: &DriveConfig<R>,
        estimators: &mut E,
        measured: &Measurement<R>,
        reference: &Reference<R>,
        i_s: AlphaBeta<R>,
    ) -> Option<StartUp> {
        let action = self.sequence.advance(c, measured, reference);
        if action == Action::StartUp {
            return Some(StartUp { stage: self.sequence.stage() });
        }
        if action == Action::Ready {
            self.control.begin(c);
            self.supervision.begin();
            let pause = self.sequence.pause(c);
            // The sequence reads the offsets in every start but one with fresh data.
            if c.calibrate_offset && pause.is_none() {
                estimators.forget_offset(c);
            }
            estimators.begin(c, pause, self.sequence.periods_blocked());
        }
        estimators.idle(&i_s);
        None
    }

    /// Estimators of the scheme, under control or in its start-up.
    #[inline(always)]
    fn estimate<E: Estimators<R>>(
        &mut self,
        c: &DriveConfig<R>,
        estimators: &mut E,
        (i_abc, i_s): ([R; 3], AlphaBeta<R>),
        (period, u_dc, u_s): (u32, R, AlphaBeta<R>),
        start_up: Option<StartUp>,
    ) -> FieldQuantities<R> {
        let Control { voltage, i_dq_ref, psi_ref, .. } = &mut self.control;
        voltage.u_s = u_s;
        let x = PeriodInput { i_abc, i_s, u_s, voltage, u_dc, psi_ref: *psi_ref, period };
        let PeriodOutput { field, complete, current_control } = estimators.period(c, &x, i_dq_ref, start_up);
        match current_control {
            CurrentControl::Continues => {}
            CurrentControl::BeginsAnew => self.control.current.start(),
            CurrentControl::FollowsFlux => self.control.follow_flux(),
        }
        if complete {
            self.control.start(c, estimators.speed().omega_m);
            self.sequence.enter(Status::Running);
        }
        field
    }

    /// Books the stamp of a call; returns the periods since the one before, 0 if it is the second one of its period.
    #[cfg(feature = "supervision")]
    #[inline(always)]
    fn periods_since(&mut self, stamp: u16) -> u16 {
        let timing = &mut self.supervision.timing;
        let periods = timing.periods_since(stamp);
        if let Some(trip) = timing.step(stamp, self.sequence.is_switching()) {
            self.sequence.fault(trip);
        }
        periods
    }

    /// In place of a measurement that cannot be used: the current of the latest one, with the dc link's voltage then;
    /// nothing while the bridge is blocked, or at the second such measurement.
    #[cold]
    #[inline(never)]
    fn bridge<E: Estimators<R>>(
        &mut self,
        c: &DriveConfig<R>,
        estimators: &E,
        measured: &Measurement<R>,
    ) -> Option<Measurement<R>> {
        let Self { sequence, control, .. } = self;
        sequence.age(c);
        sequence.bridge(c, measured, || estimators.sensed(c), || control.voltage.u_dc())
    }

    /// Tasks slower than the control period, each in a period of its own.
    #[inline(always)]
    fn slow_tasks<E: Estimators<R>>(
        &mut self,
        c: &DriveConfig<R>,
        estimators: &mut E,
        reference: &Reference<R>,
        (period, u_dc): (u32, R),
    ) {
        if period & 1 == 1 {
            if period & c.speed_mask() == 1 {
                estimators.update_speed(c);
                #[cfg(feature = "encoder")]
                self.control.compare(c, estimators.speed());
            }
            return;
        }
        // Speed and flux control, and half of their interval later what is slower.
        let turn = period & c.slow_mask;
        if turn == 0 {
            self.control.set_references(c, estimators, reference, u_dc);
        } else if turn + turn == c.slow_mask + 1 {
            // Where these periods are eight, the limits of the references and the adaptation take turns.
            let (limits, adaptation) = c.turns_of_adaptation(period);
            if limits {
                self.control.set_limits(c, estimators, u_dc);
            }
            if adaptation {
                self.adapt(c, estimators);
            }
        }
    }

    /// Slow adaptation of the estimators: a call, outside the registers of the step.
    #[inline(never)]
    fn adapt<E: Estimators<R>>(&mut self, c: &DriveConfig<R>, estimators: &mut E) {
        estimators.adapt(c, &self.control.i_dq);
    }

    /// Supervision while the bridge switches, every fourth period. `false`: a monitor has found a fault.
    // Inlined: most of what it costs as a call is the call, and its answer.
    #[inline(always)]
    fn supervise<E: Estimators<R>>(
        &mut self,
        c: &DriveConfig<R>,
        estimators: &E,
        reference: &Reference<R>,
        (i_abc, x): (&[R; 3], &FieldQuantities<R>),
        running: bool,
    ) -> bool {
        let control = &self.control;
        let omega_s = running.then_some(estimators.speed().omega_s);
        let currents = Currents { i_abc, i_dq: &x.i_dq, i_dq_ref: &control.i_dq_ref, field: &x.field, omega_s };
        let mut trip = self.supervision.currents(&c.supervision, &currents);
        if likely(running) {
            let (omega_m, omega_s) =
                (control.controlled_speed(c, estimators.speed().omega_m), estimators.speed().omega_s);
            let speed_deviation = match *reference {
                Reference::Speed(omega) => omega.clamp(c.omega_least, c.omega_most) - omega_m,
                _ => R::ZERO,
            };
            let (realigned, testing) = control.realigning(c);
            let limited = control.limited != R::ZERO;
            // While the dc link leaves the shaft little torque the speed hardly moves.
            #[cfg(feature = "dclink")]
            let by_link = limited && control.voltage.u_dc().is_some_and(|u| c.dclink.is_limiting(u));
            #[cfg(not(feature = "dclink"))]
            let by_link = false;
            let tracking = Tracking {
                psi_s: estimators.psi_s(),
                psi_ref: control.psi_ref,
                omega_m,
                omega_s,
                nis: if realigned { R::ZERO } else { estimators.nis() },
                flux_falls: estimators.flux_falls(),
                speed_deviation,
                torque_limited: (!realigned && !testing && !by_link).then_some(limited),
            };
            let confidence = || control.confidence(|| estimators.confidence());
            trip = trip.or_else(|| self.supervision.tracking(&c.supervision, &tracking, confidence));
            #[cfg(feature = "encoder")]
            {
                trip = trip.or_else(|| control.hand_over.trip(&c.hand_over));
            }
        }
        match trip {
            None => true,
            Some(trip) => {
                self.sequence.fault(trip);
                false
            }
        }
    }

    /// The bridge is blocked in this period.
    // In line, but for the call: the output then stays in registers.
    #[inline(always)]
    fn blocked(&mut self) -> Output<R> {
        self.block();
        Output { duty: zero_duty(), gates_on: false }
    }

    #[cold]
    #[inline(never)]
    fn block(&mut self) {
        self.control.voltage.block();
    }
}

#[cfg(all(test, feature = "modes", feature = "supervision"))]
mod tests {
    use super::*;
    use crate::config::DriveParams;
    use crate::params::{Inverter, Machine};

    #[test]
    fn a_missed_call_does_not_swap_the_halves_of_the_carrier_period() {
        let machine = Machine::preset_2k2();
        let inverter = Inverter { half_periods: 1, ..Inverter::preset_2k2() };
        let params = DriveParams::new(&machine, &inverter);
        let mut drive = Drive::new(DriveConfig::<f64>::new(&machine, &inverter, &params).unwrap());
        let measured = Measurement { i_abc: [0.0; 3], u_dc: 1.65 };
        let mut step = |stamp: u16, reference| {
            drive.step_at(stamp, &measured, &reference);
            (drive.common.control.voltage.is_rising(drive.period()), drive.status())
        };
        let hold = Reference::Speed(0.0);
        let mut stamp = 0;
        // Calls in time until the bridge switches, then some that are missed, doubled, and doubled with a stop.
        while step(stamp, hold) != (stamp % 2 == 1, Status::Magnetising) {
            stamp += 1;
            assert!(stamp < 60_000);
        }
        for (passed, reference) in
            [(1, hold), (2, hold), (1, hold), (3, hold), (0, hold), (4, hold), (0, Reference::Stop)]
        {
            stamp += passed;
            assert_eq!(step(stamp, reference).0, stamp % 2 == 1, "{passed}");
        }
        for passed in [1, 2, 1, 100, 1] {
            stamp += passed;
            assert_eq!(step(stamp, hold).0, stamp % 2 == 1, "{passed}");
        }
    }
}
