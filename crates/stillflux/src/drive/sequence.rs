//! Sequence and measurement checks: the state of a drive, the offsets of its current sensors at standstill, and the
//! faults that block the bridge.

use super::interface::{Fault, Measurement, Reference, Status};
use crate::config::{DriveConfig, I_OFF_MAX};
use crate::scalar::{Integrator, Real, clamp_seldom, likely};
use crate::space::AlphaBeta;

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
    /// Slow periods for which the estimate has been implausible, or its confidence too low.
    implausible: u32,
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
            implausible: 0,
            i_off: [R::ZERO; 3],
            offset_mean: [Integrator::default(); 3],
        }
    }

    /// Present state.
    #[inline(always)]
    pub fn status(&self) -> Status {
        self.status
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

    /// Restores offsets, each within its limits.
    pub fn restore(&mut self, i_off: [R; 3]) {
        for (to, i) in self.i_off.iter_mut().zip(i_off) {
            *to = clamp_seldom(i, R::from_f64(-I_OFF_MAX), R::from_f64(I_OFF_MAX));
        }
    }

    /// Begins a period.
    #[inline(always)]
    pub fn count(&mut self) {
        self.period = self.period.wrapping_add(1);
    }

    /// Phase currents less their offsets.
    #[inline(always)]
    fn without_offset(&self, m: &Measurement<R>) -> [R; 3] {
        let ([a, b, c], off) = (m.i_abc, &self.i_off);
        [a - off[0], b - off[1], c - off[2]]
    }

    /// Checks the measurement: phase currents without their offsets and the current vector, unless there is a fault.
    #[inline]
    pub fn acquire(&mut self, c: &DriveConfig<R>, m: &Measurement<R>) -> Option<([R; 3], AlphaBeta<R>)> {
        let i = self.without_offset(m);
        // One comparison for four: no channel near its range, the vector below the trip level. Written so that
        // NaN fails it.
        let sum = i[0] * i[0] + i[1] * i[1] + i[2] * i[2];
        if !likely(sum <= c.i_plain_sq && m.u_dc >= c.u_dc_min && m.u_dc <= c.u_dc_max) {
            self.examine(c, m)?;
        }
        Some((i, AlphaBeta::from_phases(i)))
    }

    /// The full check of a measurement.
    #[cold]
    #[inline(never)]
    fn examine(&mut self, c: &DriveConfig<R>, m: &Measurement<R>) -> Option<()> {
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

    /// All states but `Running`.
    #[cold]
    #[inline(never)]
    pub fn advance(&mut self, c: &DriveConfig<R>, m: &Measurement<R>, reference: &Reference<R>) -> Action {
        self.stage = self.stage.saturating_add(1);
        if !reference.is_admissible() && *reference != Reference::Stop {
            self.fault(Fault::Reference);
        }
        match (self.status, reference) {
            (Status::Faulted { .. }, _) | (Status::Stopped, Reference::Stop) => return Action::Blocked,
            (_, Reference::Stop) => {
                self.enter(Status::Stopped);
                return Action::Blocked;
            }
            (Status::Stopped, _) => {
                self.offset_mean = [Integrator::default(); 3];
                self.enter(Status::ReadingOffset);
            }
            _ => {}
        }
        if self.status == Status::ReadingOffset { self.read_offset(c, m) } else { Action::StartUp }
    }

    /// Mean of the current samples while no current can flow.
    #[inline(never)]
    fn read_offset(&mut self, c: &DriveConfig<R>, m: &Measurement<R>) -> Action {
        if c.calibrate_offset {
            for k in 0..3 {
                self.offset_mean[k].add(c.inv_offset_periods, m.i_abc[k]);
            }
        }
        if self.stage < c.offset_periods {
            return Action::Blocked;
        }
        if c.calibrate_offset {
            for (to, mean) in self.i_off.iter_mut().zip(&self.offset_mean) {
                *to = mean.value();
            }
            if self.i_off.iter().any(|i| i.abs() > R::from_f64(I_OFF_MAX)) {
                self.fault(Fault::CurrentOffset);
                return Action::Blocked;
            }
        }
        self.enter(Status::Magnetising);
        Action::Ready
    }

    /// Supervision: a fault, and `false`, if the estimate is implausible or its confidence too low for longer than
    /// `implausible_max` slow periods.
    #[inline(always)]
    pub fn supervise(&mut self, c: &DriveConfig<R>, plausible: bool, trusted: bool) -> bool {
        if likely(plausible && trusted) {
            self.implausible = 0;
            return true;
        }
        self.implausible = self.implausible.saturating_add(1);
        let tolerated = self.implausible <= c.implausible_max;
        if !tolerated {
            self.fault(if plausible { Fault::LowConfidence } else { Fault::EstimateLost });
        }
        tolerated
    }

    /// Enters a state.
    #[inline(never)]
    pub fn enter(&mut self, status: Status) {
        self.status = status;
        self.stage = 0;
        self.implausible = 0;
    }

    /// Blocks the bridge; the first cause stays until a reset.
    #[cold]
    #[inline(never)]
    fn fault(&mut self, cause: Fault) {
        if !matches!(self.status, Status::Faulted { .. }) {
            self.enter(Status::Faulted { cause, period: self.period });
        }
    }
}
