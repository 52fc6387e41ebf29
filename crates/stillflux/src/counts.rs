//! Counts of converters and timer ↔ per unit: what stands between a drive and its peripherals.
//!
//! Readings are left-aligned 16-bit fractions of full scale, `n / 2^15`, whatever the resolution of the
//! converter: an STM32 does this alignment in hardware. Currents are signed (the zero of the sensor is
//! already subtracted); what is left of it the drive reads at rest.

use crate::base::Base;
use crate::control::modulator::Duty;
use crate::drive::Measurement;
use crate::params::Machine;
use crate::scalar::{Real, Timer};
use crate::words::words;

/// One set of readings, left-aligned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Counts {
    /// Phase currents, positive into the machine.
    pub i_abc: [i16; 3],
    /// dc-link voltage, 0 to `i16::MAX`.
    pub u_dc: i16,
}

/// Per-unit values of full scale.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Scale<R: Real> {
    i: R,
    u_dc: R,
}
words!(Scale: i, u_dc);

impl<R: Real> Scale<R> {
    /// Channels that read `±i_full` A and up to `u_full` V.
    #[must_use]
    pub fn new(machine: &Machine, i_full: f64, u_full: f64) -> Self {
        let base = Base::new(machine);
        Self { i: R::from_f64(i_full / base.i), u_dc: R::from_f64(u_full / base.u) }
    }

    /// Readings in per unit.
    #[inline]
    pub fn measurement(&self, counts: &Counts) -> Measurement<R> {
        Measurement { i_abc: counts.i_abc.map(|n| R::fraction(n) * self.i), u_dc: R::fraction(counts.u_dc) * self.u_dc }
    }
}

/// Compare values of the three legs.
#[inline]
pub fn compare<R: Real>(duty: &Duty<R>, timer: &Timer) -> [u32; 3] {
    duty.map(|d| d.quantise(timer).0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Q;

    #[test]
    fn full_scale_reads_as_full_scale_in_all_arithmetics() {
        let machine = Machine::preset_2k2();
        let base = Base::new(&machine);
        let counts = Counts { i_abc: [i16::MIN, 0, 1 << 14], u_dc: 1 << 14 };
        fn read<R: Real>(machine: &Machine, counts: &Counts) -> [f64; 4] {
            let m = Scale::<R>::new(machine, 20.0, 800.0).measurement(counts);
            [m.i_abc[0], m.i_abc[1], m.i_abc[2], m.u_dc].map(R::to_f64)
        }
        let want = [-20.0 / base.i, 0.0, 10.0 / base.i, 400.0 / base.u];
        for got in [read::<f32>(&machine, &counts), read::<f64>(&machine, &counts), read::<Q>(&machine, &counts)] {
            for (g, w) in got.iter().zip(want) {
                assert!((g - w).abs() < 3e-7, "{g} {w}");
            }
        }
    }
}
