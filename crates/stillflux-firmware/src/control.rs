//! What runs in the control interrupt: counts in, drive, counts out. Host and target run this same source.

use crate::blob::Parameters;
use stillflux::config::{DriveConfig, DriveParams};
use stillflux::counts::{Counts, Scale, compare};
use stillflux::drive::{Drive, Reference};
use stillflux::params::ParamError;
use stillflux::scalar::{Real, Timer};

/// What the timer's preload registers take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Command {
    /// Compare values of the three legs, 0 to [`Timer::full`].
    pub compare: [u32; 3],
    /// `false`: block the bridge at once.
    pub gates_on: bool,
}

/// A drive between its converters and its timer.
#[derive(Clone, Copy, Debug)]
pub struct Control<R: Real> {
    /// The drive.
    pub drive: Drive<R>,
    scale: Scale<R>,
    timer: Timer,
}

impl<R: Real> Control<R> {
    /// A stopped drive that remembers what its page holds.
    ///
    /// # Errors
    /// The first parameter outside its admissible range.
    // Not inlined: the code of the configuration has a size of its own in the report.
    #[inline(never)]
    pub fn new(p: &Parameters) -> Result<Self, ParamError> {
        let config = DriveConfig::new(&p.machine, &p.inverter, &DriveParams::new(&p.machine, &p.inverter))?;
        // A page without timer clock: the finest timer there is.
        let timer = config.timer().copied().unwrap_or(Timer::new(u32::MAX));
        let mut drive = Drive::new(config);
        drive.restore(&p.memory());
        Ok(Self { drive, scale: Scale::new(&p.machine, p.i_full, p.u_full), timer })
    }

    /// Readings in per unit.
    #[inline]
    pub fn scale(&self) -> &Scale<R> {
        &self.scale
    }

    /// Resolution of the PWM timer.
    pub fn timer(&self) -> &Timer {
        &self.timer
    }

    /// One control period.
    #[inline]
    pub fn period(&mut self, counts: &Counts, reference: &Reference<R>) -> Command {
        let output = self.drive.step(&self.scale.measurement(counts), reference);
        Command { compare: compare(&output.duty, &self.timer), gates_on: output.gates_on }
    }
}
