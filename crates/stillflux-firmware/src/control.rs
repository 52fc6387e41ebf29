//! What runs in the control interrupt: counts in, drive, counts out. Host and target run this same source.

use crate::blob::Parameters;
use crate::page::Ready;
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
    pub fn ready(page: &Ready<R>) -> Self {
        // A page without timer clock: the finest timer there is.
        let timer = page.config.timer().copied().unwrap_or(Timer::new(u32::MAX));
        let mut drive = Drive::new(page.config);
        drive.restore(&page.memory);
        Self { drive, scale: page.scale, timer }
    }

    /// The same from SI values.
    ///
    /// # Errors
    /// The first parameter outside its admissible range.
    pub fn new(p: &Parameters) -> Result<Self, ParamError> {
        Ready::new(p).map(|ready| Self::ready(&ready))
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
