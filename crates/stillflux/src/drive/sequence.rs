//! Sequence and measurement checks: the state of a drive, the offsets of its current sensors at standstill, and the
//! faults that block the bridge.

#[cfg(feature = "bridging")]
mod bridging;
#[cfg(not(feature = "bridging"))]
#[path = "left_out/bridging.rs"]
mod bridging;

use super::estimators::Estimators;
use super::interface::{Measurement, Reference, Status};
use crate::config::{DriveConfig, I_OFF_MAX};
#[cfg(feature = "shunt")]
use crate::control::shunt::RATE;
use crate::estimate::pair::equalised;
use crate::scalar::{Integrator, Real, clamp_seldom, likely};
use crate::space::AlphaBeta;
use crate::supervision::{Fault, FaultReport, Trip};

/// dc-link voltage, per unit, beyond every sensor's range.
const U_DC_RANGE: f64 = 100.0;

/// Action in a period that is not under control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    /// The bridge is blocked.
    Blocked,
    /// The bridge is blocked for the last time before a start-up.
    Ready,
    /// A period of the start-up.
    StartUp,
}

/// State of the sequence.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct Sequence<R: Real> {
    status: Status,
    /// Periods since power-up, and since the present stage began.
    period: u32,
    stage: u32,
    /// Period in which the drive ran last, if what it learned then still holds, and the filter the flux that it had.
    ran: Option<u32>,
    /// Periods since the bridge switched last. At power-up the machine is taken to be without flux.
    periods_blocked: u32,
    /// Period of the latest sample that could not be used.
    #[cfg(feature = "bridging")]
    last_bad: u32,
    /// What was measured at the fault, and its limit.
    trip: (R, R),
    i_off: [R; 3],
    offset_mean: [Integrator<R>; 3],
}

impl<R: Real> Sequence<R> {
    /// Stopped, offsets zero.
    pub fn new() -> Self {
        Self {
            status: Status::Stopped,
            period: 0,
            stage: 0,
            ran: None,
            periods_blocked: u32::MAX,
            #[cfg(feature = "bridging")]
            last_bad: u32::MAX / 2,
            trip: (R::ZERO, R::ZERO),
            i_off: [R::ZERO; 3],
            offset_mean: [Integrator::default(); 3],
        }
    }

    /// Present state.
    #[inline(always)]
    pub fn status(&self) -> Status {
        self.status
    }

    /// Whether the bridge switches.
    #[inline(always)]
    pub fn is_switching(&self) -> bool {
        matches!(self.status, Status::Magnetising | Status::Running)
    }

    /// Periods since power-up.
    #[inline(always)]
    pub fn period(&self) -> u32 {
        self.period
    }

    /// Periods since the present stage began.
    #[inline(always)]
    pub fn stage(&self) -> u32 {
        self.stage
    }

    /// Offsets of the current sensors.
    pub fn i_off(&self) -> [R; 3] {
        self.i_off
    }

    /// Restores offsets, each within its limits. The next start reads them anew.
    pub fn restore(&mut self, c: &DriveConfig<R>, i_off: [R; 3]) {
        self.ran = None;
        for (to, i) in self.i_off.iter_mut().zip(i_off) {
            *to = clamp_seldom(i, R::from_f64(-I_OFF_MAX), R::from_f64(I_OFF_MAX));
        }
        self.follow_from_here(c);
    }

    /// The offset of a single shunt is followed from the one that is known, which its three readings have in common.
    #[cfg_attr(not(feature = "shunt"), allow(unused_variables, clippy::unused_self))]
    fn follow_from_here(&mut self, c: &DriveConfig<R>) {
        #[cfg(feature = "shunt")]
        if c.single_shunt() {
            self.offset_mean[2] = Integrator::new(self.i_off[2]);
        }
    }

    /// A reading of a single shunt that shows its offset.
    #[cfg(feature = "shunt")]
    pub fn follow_offset(&mut self, reading: R) {
        let mean = &mut self.offset_mean[2];
        let deviation = reading - mean.value();
        self.i_off = [mean.add_limited(R::from_f64(RATE), deviation, R::from_f64(I_OFF_MAX)); 3];
    }

    /// Begins a period; its number.
    #[inline(always)]
    pub fn count(&mut self) -> u32 {
        self.period = self.period.wrapping_add(1);
        self.period
    }

    /// Phase currents less their offsets; with two sensors, whose gains differ by twice `half`, the third is computed from
    /// the other two.
    #[inline(always)]
    fn without_offset(&self, c: &DriveConfig<R>, m: &Measurement<R>, half: impl FnOnce() -> R) -> [R; 3] {
        let ([i_a, i_b, i_c], off) = (m.i_abc, self.offsets(c));
        let (i_a, i_b) = (i_a - off[0], i_b - off[1]);
        if likely(!c.two_sensors()) { [i_a, i_b, i_c - off[2]] } else { equalised([i_a, i_b], half()) }
    }

    /// Offsets that are still in a measurement: none of those that a single shunt was freed from.
    #[inline(always)]
    fn offsets(&self, c: &DriveConfig<R>) -> [R; 3] {
        if likely(!c.single_shunt()) { self.i_off } else { [R::ZERO; 3] }
    }

    /// Whether a measurement can be used as it is.
    #[inline(always)]
    pub fn accepts(&self, c: &DriveConfig<R>, m: &Measurement<R>) -> bool {
        let i = self.without_offset(c, m, || R::ZERO);
        // One comparison for four: no channel near its range, the vector below the trip level. Written so that
        // NaN fails it.
        let sum = R::sum_of_squares(i);
        likely(sum <= c.i_plain_sq && m.u_dc >= c.u_dc_min && m.u_dc <= c.u_dc_max) || self.examine(c, m).is_none()
    }

    /// Phase currents without their offsets.
    #[inline(always)]
    pub fn currents<E: Estimators<R>>(&self, c: &DriveConfig<R>, m: &Measurement<R>, estimators: &E) -> [R; 3] {
        self.without_offset(c, m, || estimators.half_difference())
    }

    /// The full check of a measurement: what is wrong with it.
    #[cold]
    #[inline(never)]
    fn examine(&self, c: &DriveConfig<R>, m: &Measurement<R>) -> Option<Trip<R>> {
        let i_s = AlphaBeta::<R>::from_phases(self.without_offset(c, m, || R::ZERO));
        let ([i_a, i_b, i_c], r) = (m.i_abc, c.i_range);
        let i_c = if c.two_sensors() { R::ZERO } else { i_c };
        // The channel's number; constants of the arithmetic: a conversion here would be one in software.
        let channel = if !is_readable(i_a, r) {
            R::ONE
        } else if !is_readable(i_b, r) {
            R::TWO
        } else if !is_readable(i_c, r) {
            R::from_f64(3.0)
        } else if !is_readable(m.u_dc, R::from_f64(U_DC_RANGE)) {
            R::from_f64(4.0)
        } else {
            R::ZERO
        };
        if channel > R::ZERO {
            Some(Trip::new(Fault::Measurement, channel, R::ZERO))
        } else if m.u_dc < c.u_dc_min && !matches!(self.status, Status::Stopped) {
            Some(Trip::new(Fault::UnderVoltage, m.u_dc, c.u_dc_min))
        } else if m.u_dc > c.u_dc_max {
            Some(Trip::new(Fault::OverVoltage, m.u_dc, c.u_dc_max))
        } else if i_s.norm_sq() > c.i_trip * c.i_trip {
            Some(Trip::new(Fault::OverCurrent, i_s.norm_sq().sqrt(), c.i_trip))
        } else {
            None
        }
    }

    /// All states but `Running`.
    #[cold]
    #[inline(never)]
    pub fn advance(&mut self, c: &DriveConfig<R>, m: &Measurement<R>, reference: &Reference<R>) -> Action {
        self.stage = self.stage.saturating_add(1);
        self.age(c);
        if !reference.is_admissible() && *reference != Reference::Stop {
            self.fault(Trip::new(Fault::Reference, R::ZERO, R::ZERO));
        }
        match (self.status, reference) {
            (Status::Faulted { .. }, _) | (Status::Stopped, Reference::Stop) => return Action::Blocked,
            (_, Reference::Stop) => {
                self.enter(Status::Stopped);
                return Action::Blocked;
            }
            // A drive that is stopped waits for its link to be charged; one that is to start does not.
            (Status::Stopped, _) if m.u_dc < c.u_dc_min => {
                self.fault(Trip::new(Fault::UnderVoltage, m.u_dc, c.u_dc_min));
                return Action::Blocked;
            }
            (Status::Stopped, _) if self.pause(c).is_some() => {
                self.enter(Status::Magnetising);
                return Action::Ready;
            }
            (Status::Stopped, _) => {
                self.offset_mean = [Integrator::default(); 3];
                self.enter(Status::ReadingOffset);
            }
            _ => {}
        }
        if self.status == Status::ReadingOffset { self.read_offset(c, m) } else { Action::StartUp }
    }

    /// A period goes by in which the drive is not under control, or whose measurement cannot be used.
    #[cold]
    #[inline(never)]
    pub fn age(&mut self, c: &DriveConfig<R>) {
        if !self.is_switching() {
            self.periods_blocked = self.periods_blocked.saturating_add(1);
        }
        if self.pause(c).is_none() {
            // For good: the number of periods wraps.
            self.ran = None;
        }
    }

    /// Periods since the drive ran last, if what it learned then is fresh.
    #[cold]
    #[inline(never)]
    pub fn pause(&self, c: &DriveConfig<R>) -> Option<u32> {
        let pause = self.period.wrapping_sub(self.ran?);
        (pause < c.fresh_periods).then_some(pause)
    }

    /// Periods since the bridge switched last, in which the flux that it left decays.
    pub fn periods_blocked(&self) -> u32 {
        self.periods_blocked
    }

    /// Mean of the current samples while no current can flow.
    #[inline(never)]
    fn read_offset(&mut self, c: &DriveConfig<R>, m: &Measurement<R>) -> Action {
        // The period that enters this state is none of the `offset_periods`.
        if c.calibrate_offset && self.stage > 0 {
            for k in 0..if c.two_sensors() { 2 } else { 3 } {
                self.offset_mean[k].add(c.inv_offset_periods, m.i_abc[k]);
            }
        }
        if self.stage < c.offset_periods {
            return Action::Blocked;
        }
        if c.calibrate_offset {
            let (read, limit) = (self.offset_mean.each_ref().map(|mean| mean.value()), R::from_f64(I_OFF_MAX));
            if let Some(&i) = read.iter().find(|i| i.abs() > limit) {
                self.fault(Trip::new(Fault::CurrentOffset, i, limit));
                return Action::Blocked;
            }
            self.i_off = read;
        }
        self.follow_from_here(c);
        self.enter(Status::Magnetising);
        Action::Ready
    }

    /// Enters a state.
    #[inline(never)]
    pub fn enter(&mut self, status: Status) {
        // After a supply that failed everything learned holds, after other faults it may be their cause.
        let sound = match status {
            Status::Faulted { cause, .. } => matches!(cause, Fault::UnderVoltage | Fault::OverVoltage),
            _ => true,
        };
        match self.status {
            Status::Running => self.ran = Some(self.period),
            // Of the flux of a start that did not end the filter knows nothing yet.
            Status::Magnetising if status != Status::Running => self.ran = None,
            _ => {}
        }
        if !sound {
            self.ran = None;
        }
        if self.is_switching() {
            self.periods_blocked = 0;
        }
        self.status = status;
        self.stage = 0;
    }

    /// Blocks the bridge; the first cause stays until a reset.
    #[cold]
    #[inline(never)]
    pub fn fault(&mut self, trip: Trip<R>) {
        if !matches!(self.status, Status::Faulted { .. }) {
            self.trip = (trip.value, trip.limit);
            self.enter(Status::Faulted { cause: trip.cause, period: self.period });
        }
    }

    /// The latched fault with what was measured.
    pub fn report(&self) -> Option<FaultReport<R>> {
        match self.status {
            Status::Faulted { cause, period } => {
                let (value, limit) = self.trip;
                Some(FaultReport { trip: Trip { cause, value, limit }, period })
            }
            _ => None,
        }
    }
}

/// Whether a reading lies within its range; NaN does not.
// A call: the code exists once for all channels.
#[cold]
#[inline(never)]
fn is_readable<R: Real>(x: R, range: R) -> bool {
    x.abs() < range
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::DriveParams;
    use crate::params::{Inverter, Machine};

    #[test]
    fn what_is_stale_stays_stale_when_the_number_of_periods_wraps() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let params = DriveParams { fresh_time: 1.0, ..DriveParams::new(&machine, &inverter) };
        let c = DriveConfig::<f32>::new(&machine, &inverter, &params).unwrap();
        let measured = Measurement { i_abc: [0.0; 3], u_dc: 1.65 };
        let mut sequence = Sequence { ran: Some(0), period: 9_999, ..Sequence::new() };
        sequence.advance(&c, &measured, &Reference::Stop);
        assert_eq!(sequence.pause(&c), Some(9_999));
        sequence.period = 10_000;
        sequence.advance(&c, &measured, &Reference::Stop);
        sequence.period = 5;
        assert_eq!(sequence.pause(&c), None);
    }

    /// With the feature `bridging` the first one is replaced; by what is tested elsewhere.
    #[test]
    fn a_measurement_that_cannot_be_used_is_a_fault_where_it_is_not_bridged() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let c = DriveConfig::<f32>::new(&machine, &inverter, &DriveParams::new(&machine, &inverter)).unwrap();
        let bad = Measurement { i_abc: [f32::NAN, 0.0, 0.0], u_dc: 1.65 };
        let mut sequence = Sequence { status: Status::Running, ..Sequence::new() };
        for sample in 0..2 {
            let instead = sequence.bridge(&c, &bad, AlphaBeta::default, || Some(1.65));
            let bridged = cfg!(feature = "bridging") && sample == 0;
            assert_eq!(instead.is_some(), bridged);
            assert_eq!(sequence.report().map(|r| r.trip.cause), (!bridged).then_some(Fault::Measurement));
        }
    }

    fn config(current_sensors: u32) -> DriveConfig<f64> {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let params = DriveParams { current_sensors, ..DriveParams::new(&machine, &inverter) };
        DriveConfig::new(&machine, &inverter, &params).unwrap()
    }

    #[test]
    fn offsets_that_are_restored_while_they_are_read_leave_the_reading_alone() {
        let (c, measured) = (config(3), Measurement { i_abc: [0.05; 3], u_dc: 1.65 });
        let mut sequence = Sequence::new();
        for k in 0..=c.offset_periods {
            if k == c.offset_periods / 2 {
                sequence.restore(&c, [0.05; 3]);
            }
            sequence.advance(&c, &measured, &Reference::Speed(0.0));
        }
        assert_eq!(sequence.status(), Status::Magnetising);
        assert!(sequence.i_off().iter().all(|i| (i - 0.05).abs() < 1e-9), "{:?}", sequence.i_off());
    }

    #[test]
    fn time_goes_by_without_a_link_as_well() {
        let c = config(3);
        let mut sequence = Sequence { status: Status::Running, period: 7, ..Sequence::new() };
        let none = Measurement { i_abc: [0.0; 3], u_dc: 0.0 };
        for _ in 0..1000 {
            sequence.count();
            assert!(!sequence.accepts(&c, &none));
            sequence.age(&c);
            sequence.bridge(&c, &none, AlphaBeta::default, || None);
        }
        assert!(matches!(sequence.status(), Status::Faulted { cause: Fault::UnderVoltage, .. }));
        assert!((998..1000).contains(&sequence.periods_blocked()), "{}", sequence.periods_blocked());
    }
}
