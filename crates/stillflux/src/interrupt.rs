//! Content of a control interrupt: counts of the converters in, one period of the drive, compare values out.
//!
//! ```text
//! data registers ─ Counts::from_raw ─ CountsDrive::period ─ compare values and gate signal
//!                                     CountsCommissioning::period before there are parameters
//! ```

#[cfg(feature = "commission")]
use crate::commission::{Commissioning, CommissioningConfig, Found, Nameplate};
#[cfg(feature = "commission")]
use crate::config::DriveParams;
#[cfg(feature = "shunt")]
use crate::counts::PulseCounts;
use crate::counts::{Counts, Scale, compare};
use crate::drive::{Drive, Measurement, Reference, Status};
use crate::page::Ready;
#[cfg(feature = "commission")]
use crate::params::{Inverter, ParamError};
use crate::scalar::{Real, Timer};
#[cfg(feature = "encoder")]
use crate::telemetry::EncoderTelemetry;
use crate::telemetry::{FaultTelemetry, SetPoint, Telemetry, Units};

/// What the timer's preload registers take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Command {
    /// Compare values of the three legs, 0 to [`Timer::full`].
    pub compare: [u32; 3],
    /// `false`: block the bridge at once.
    pub gates_on: bool,
}

impl Command {
    /// What blocks the bridge.
    pub const BLOCKED: Self = Self { compare: [0; 3], gates_on: false };
}

/// A drive between its converters and its timer: what a control interrupt calls. Host and target run this same source.
///
/// A `static` holds [`CountsDrive::empty`] until the parameter page is read; it keeps the bridge blocked.
#[derive(Clone, Copy, Debug)]
pub struct CountsDrive<R: Real>(Option<Parts<R>>);

#[derive(Clone, Copy, Debug)]
struct Parts<R: Real> {
    drive: Drive<R>,
    scale: Scale<R>,
    timer: Timer,
    units: Units,
}

impl<R: Real> CountsDrive<R> {
    /// No drive yet: blocks the bridge.
    #[must_use]
    pub const fn empty() -> Self {
        Self(None)
    }

    /// Whether there is a drive.
    #[must_use]
    pub const fn is_some(&self) -> bool {
        self.0.is_some()
    }

    /// A stopped drive that remembers what its page holds. Without a timer clock in the page, compare values are those
    /// of [`Timer::finest`].
    #[must_use]
    pub fn new(page: &Ready<R>) -> Self {
        let timer = page.config.timer().copied().unwrap_or(const { Timer::finest() });
        let mut drive = Drive::new(page.config);
        drive.restore(&page.memory);
        Self(Some(Parts { drive, scale: page.scale, timer, units: page.units }))
    }

    /// One control period.
    #[inline]
    pub fn period(&mut self, counts: &Counts, set_point: &SetPoint) -> Command {
        let Some(Parts { drive, scale, timer, units }) = &mut self.0 else {
            return Command::BLOCKED;
        };
        let output = drive.step(&scale.measurement(counts), &units.reference(set_point));
        Command { compare: compare(&output.duty, timer), gates_on: output.gates_on }
    }

    /// [`CountsDrive::period`] with the stamp of its PWM period, a number that the hardware counts up by one in each
    /// ([`Drive::step_at`]). `None`: the period has been computed before, and what was commanded stays.
    #[cfg(feature = "supervision")]
    #[inline]
    pub fn period_at(&mut self, stamp: u16, counts: &Counts, set_point: &SetPoint) -> Option<Command> {
        let Some(Parts { drive, scale, timer, units }) = &mut self.0 else {
            return Some(Command::BLOCKED);
        };
        let output = drive.step_at(stamp, &scale.measurement(counts), &units.reference(set_point))?;
        Some(Command { compare: compare(&output.duty, timer), gates_on: output.gates_on })
    }

    /// Content of the encoder's counter at the instant of the counts of the next period ([`Drive::set_encoder`]).
    #[cfg(feature = "encoder")]
    #[inline]
    pub fn set_encoder(&mut self, count: u32) {
        if let Some(Parts { drive, .. }) = &mut self.0 {
            drive.set_encoder(count);
        }
    }

    /// What the encoder says, SI; `None` without one, or without a drive.
    #[cfg(feature = "encoder")]
    pub fn encoder(&self) -> Option<EncoderTelemetry> {
        self.0.as_ref().and_then(|p| p.units.encoder(&p.drive))
    }

    /// Compare values and instants of the next period with a single shunt, after [`CountsDrive::period`]; `None` with more
    /// sensors, or without a drive.
    #[cfg(feature = "shunt")]
    pub fn pulses(&self) -> Option<PulseCounts> {
        self.0.as_ref().and_then(|p| p.drive.pulses().map(|pulses| PulseCounts::new(&pulses, &p.timer)))
    }

    /// Compare value of the brake chopper's channel at the link voltage of these counts, 0 to [`Timer::full`], in every
    /// state of the drive ([`Drive::chopper`]); 0 without the setting, or without a drive.
    #[cfg(feature = "dclink")]
    pub fn chopper(&self, counts: &Counts) -> u32 {
        self.0.as_ref().map_or(0, |p| p.drive.chopper(p.scale.measurement(counts).u_dc).quantise(&p.timer).0)
    }

    /// The drive, if there is one.
    #[inline]
    pub fn drive(&self) -> Option<&Drive<R>> {
        self.0.as_ref().map(|p| &p.drive)
    }

    /// State of the sequence; stopped without a drive.
    pub fn status(&self) -> Status {
        self.drive().map_or(Status::Stopped, Drive::status)
    }

    /// The latched fault with what was measured against which limit, SI.
    pub fn fault(&self) -> Option<FaultTelemetry> {
        self.0.as_ref().and_then(|p| p.units.fault(&p.drive))
    }

    /// Leaves a fault; the drive is stopped then, and starts with the next set point that is no stop.
    pub fn reset(&mut self) {
        if let Some(p) = &mut self.0 {
            p.drive.reset();
        }
    }

    /// Estimates and state in SI; all zero without a drive.
    pub fn telemetry(&self) -> Telemetry {
        self.0.as_ref().map_or(Telemetry::default(), |p| p.units.telemetry(&p.drive))
    }

    /// Readings and set point in per unit, as [`CountsDrive::period`] hands them to its drive.
    pub fn inputs(&self, counts: &Counts, set_point: &SetPoint) -> Option<(Measurement<R>, Reference<R>)> {
        self.0.as_ref().map(|p| (p.scale.measurement(counts), p.units.reference(set_point)))
    }

    /// Resolution of the PWM timer.
    pub fn timer(&self) -> Option<&Timer> {
        self.0.as_ref().map(|p| &p.timer)
    }
}

/// A commissioning between its converters and its timer: what a control interrupt calls before there are parameters.
#[cfg(feature = "commission")]
#[derive(Clone, Copy, Debug)]
pub struct CountsCommissioning<R: Real> {
    commissioning: Commissioning<R>,
    scale: Scale<R>,
    timer: Timer,
    full: (f64, f64),
}

#[cfg(feature = "commission")]
impl<R: Real> CountsCommissioning<R> {
    /// Before its first period. `full`: full scale of the current channels in A and of the dc-link channel in V.
    ///
    /// # Errors
    /// The first value of nameplate, inverter or full scale outside its admissible range.
    pub fn new(plate: &Nameplate, sheet: &Inverter, full: (f64, f64)) -> Result<Self, ParamError> {
        let config = CommissioningConfig::new(plate, sheet)?;
        let machine = config.machine();
        let scale = Scale::new(machine, &DriveParams::new(machine, sheet), full.0, full.1)?;
        let timer = config.timer().copied().unwrap_or(const { Timer::finest() });
        Ok(Self { commissioning: Commissioning::new(config), scale, timer, full })
    }

    /// One control period.
    #[inline]
    pub fn period(&mut self, counts: &Counts) -> Command {
        let output = self.commissioning.step(&self.scale.measurement(counts));
        Command { compare: compare(&output.duty, &self.timer), gates_on: output.gates_on }
    }

    /// Its state, and what it has found so far.
    #[must_use]
    pub fn commissioning(&self) -> &Commissioning<R> {
        &self.commissioning
    }

    /// Blocks the gates for good; what has been found stays.
    pub fn abort(&mut self) {
        self.commissioning.abort();
    }

    /// Resolution of the PWM timer.
    #[must_use]
    pub fn timer(&self) -> &Timer {
        &self.timer
    }

    /// What has been found, and the content of the parameter page with it and the default settings of a drive
    /// ([`Found::ready`]); settings of the application go into [`Found::params`] and [`Ready::new`]. What has not been found is
    /// the nameplate's ([`crate::commission::Warnings::incomplete`]). Not for the control interrupt.
    ///
    /// # Errors
    /// A value found that no drive accepts.
    pub fn found(&self) -> Result<(Found, Ready<R>), ParamError> {
        let found = self.commissioning.result()?;
        let ready = found.ready(self.full)?;
        Ok((found, ready))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{DriveConfig, DriveParams};
    use crate::counts::{Converters, Layout, Resolution};
    use crate::drive::Fault;
    use crate::params::{Inverter, Machine, ParamError};
    use crate::scalar::Q;
    use crate::si::MemorySi;

    fn setup() -> (Machine, Inverter, DriveParams) {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        (machine, inverter, DriveParams::new(&machine, &inverter))
    }

    fn ready<R: Real>(i_full: f64, u_full: f64) -> Result<Ready<R>, ParamError> {
        let (machine, inverter, params) = setup();
        Ready::new(&machine, &inverter, &params, (i_full, u_full), &MemorySi::of(&machine, &inverter))
    }

    fn saturates<R: Real>() {
        // Hardly more than what the settings ask for.
        let (machine, inverter, params) = setup();
        let page = ready::<R>(params.i_range / 0.9989, params.u_dc_max / 0.9989).unwrap();
        let converters = Converters::new(Layout::Right(Resolution::Twelve));
        let ok = ([2048; 3], 2700);
        for (i, u, want) in [
            ([4095, 2048, 2048], ok.1, Some(Fault::Measurement)),
            ([2048, 0, 2048], ok.1, Some(Fault::Measurement)),
            (ok.0, 4095, Some(Fault::OverVoltage)),
            (ok.0, ok.1, None),
        ] {
            let mut drive = CountsDrive::new(&page);
            // One reading is bridged, a second one is a fault.
            for _ in 0..2 {
                let command = drive.period(&Counts::from_raw(i, u, &converters), &SetPoint::Speed(0.0));
                assert!(!command.gates_on);
            }
            let cause = match drive.status() {
                Status::Faulted { cause, .. } => Some(cause),
                _ => None,
            };
            assert_eq!(cause, want, "{} {i:?} {u}", R::NAME);
        }
        // The negative control: counts beside the ends are a reading like any other.
        let mut drive = CountsDrive::new(&page);
        drive.period(&Counts::from_raw([2048 + 60, 2048, 2048], 2700, &converters), &SetPoint::Speed(0.0));
        assert_eq!(drive.status(), Status::ReadingOffset);
        let config = DriveConfig::<R>::new(&machine, &inverter, &params).unwrap();
        assert_eq!(drive.drive().unwrap().config(), &config);
    }

    #[test]
    fn a_saturated_channel_is_a_fault_in_every_arithmetic() {
        saturates::<f32>();
        saturates::<f64>();
        saturates::<Q>();
    }

    #[test]
    fn a_full_scale_that_hides_a_saturated_channel_is_refused_by_name() {
        let (_, _, params) = setup();
        assert_eq!(ready::<f32>(params.i_range, 810.0).unwrap_err().field, "i_full");
        assert_eq!(ready::<f32>(20.0, params.u_dc_max).unwrap_err().field, "u_full");
        assert_eq!(ready::<Q>(f64::NAN, 810.0).unwrap_err().field, "i_full");
        assert_eq!(ready::<Q>(20.0, 1e6).unwrap_err().field, "u_full");
    }

    #[test]
    fn a_static_without_a_drive_keeps_the_bridge_blocked() {
        static DRIVE: std::sync::Mutex<CountsDrive<f32>> = std::sync::Mutex::new(CountsDrive::empty());
        let mut drive = DRIVE.lock().unwrap();
        let command = drive.period(&Counts { i_abc: [0; 3], u_dc: 20_000 }, &SetPoint::Speed(1.0));
        assert_eq!(command, Command::BLOCKED);
        assert_eq!((drive.status(), drive.telemetry()), (Status::Stopped, Telemetry::default()));
        *drive = CountsDrive::new(&ready(20.0, 810.0).unwrap());
        drive.period(&Counts { i_abc: [0; 3], u_dc: 20_000 }, &SetPoint::Speed(1.0));
        assert_eq!(drive.status(), Status::ReadingOffset);
    }

    #[cfg(feature = "supervision")]
    #[test]
    fn a_period_is_computed_once_however_often_it_is_called() {
        let page = ready::<f32>(20.0, 810.0).unwrap();
        let (counts, speed) = (Counts { i_abc: [0; 3], u_dc: 20_000 }, SetPoint::Speed(1.0));
        let (mut stamped, mut plain) = (CountsDrive::new(&page), CountsDrive::new(&page));
        assert_eq!(CountsDrive::<f32>::empty().period_at(7, &counts, &speed), Some(Command::BLOCKED));
        for stamp in 0..1100_u16 {
            let command = plain.period(&counts, &speed);
            assert_eq!(stamped.period_at(stamp, &counts, &speed), Some(command));
            if stamp % 200 == 7 {
                let again = (stamped.status() != Status::Magnetising).then_some(Command { gates_on: false, ..command });
                assert_eq!(stamped.period_at(stamp, &counts, &speed), again);
            }
        }
        assert_eq!(stamped.status(), Status::Magnetising);
        assert_eq!(stamped.telemetry(), plain.telemetry());
        // Masked for 600 periods: a fault, with a command that blocks.
        assert!(stamped.period_at(1700, &counts, &speed).is_some_and(|c| !c.gates_on));
        let fault = stamped.drive().and_then(Drive::fault).unwrap().trip;
        assert_eq!((fault.cause, fault.value), (Fault::Timing, 100.0), "calls missed, as far as they are counted");
    }
}
