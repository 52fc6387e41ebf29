//! Counts of converters and timer ↔ per unit: what stands between a drive and its peripherals.
//!
//! [`Counts`] are 16-bit fractions of full scale, `n / 2^15`, whatever the resolution of the converter;
//! [`Counts::from_raw`] makes them of the content of the data registers, for every alignment and offset mode of the
//! converters of an STM32 ([`Layout`]).
//!
//! **Saturation.** A converter at an end of its range reads full scale, `i16::MIN` or `i16::MAX`, and [`Scale::new`]
//! refuses a scale at which that would not be a fault: of a current at least `i_range`, of the dc link more than
//! `u_dc_max`.

use crate::base::Base;
use crate::config::DriveParams;
use crate::control::modulator::Duty;
use crate::drive::Measurement;
use crate::params::{Machine, ParamError, check};
use crate::scalar::{Real, Timer};
use crate::words::words;

/// Bits of a converter's result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
#[repr(u8)]
pub enum Resolution {
    /// 6 bits.
    Six = 6,
    /// 8 bits.
    Eight = 8,
    /// 10 bits.
    Ten = 10,
    /// 12 bits.
    Twelve = 12,
    /// 14 bits: four samples of 12 bits added up by the hardware.
    Fourteen = 14,
    /// 16 bits: sixteen samples of 12 bits added up by the hardware.
    Sixteen = 16,
}

/// How a result lies in the 16-bit data register of a converter. Names of bits are those of the STM32G4 (RM0440, data
/// management of the converters); F3, H7, L4 and U5 lie the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Layout {
    /// `ALIGN` = 0, no offset: `D11…D0` in bits 11 to 0. So are oversampled results, whatever `ALIGN` says, and those of
    /// an offset with `SATEN`.
    Right(Resolution),
    /// `ALIGN` = 1, no offset: `D11…D0 0000`, bits 15 to 4; 6 bits in bits 7 to 2.
    Left(Resolution),
    /// `ALIGN` = 0, `OFFSETy_EN` = 1, `SATEN` = 0: signed.
    RightOffset(Resolution),
    /// `ALIGN` = 1, `OFFSETy_EN` = 1, `SATEN` = 0, `OFFSETPOS` = 0: signed, `SEXT D11…D0 000`, one bit lower than without
    /// offset.
    LeftOffset(Resolution),
}

impl Layout {
    /// Bits of the result.
    #[inline]
    const fn bits(self) -> u32 {
        match self {
            Self::Right(r) | Self::Left(r) | Self::RightOffset(r) | Self::LeftOffset(r) => r as u32,
        }
    }

    /// The converter's own code: 0 to `2^bits - 1`. `offset`: what the hardware subtracts.
    #[inline]
    const fn code(self, register: u16, offset: u16) -> i32 {
        match self {
            Self::Right(_) => register as i32,
            Self::Left(Resolution::Six) => (register >> 2) as i32,
            Self::Left(r) => (register >> (16 - r as u32)) as i32,
            Self::RightOffset(_) => register as i16 as i32 + offset as i32,
            Self::LeftOffset(Resolution::Six) => (register as i16 >> 1) as i32 + offset as i32,
            Self::LeftOffset(Resolution::Sixteen) => register as i16 as i32 + offset as i32,
            Self::LeftOffset(r) => (register as i16 >> (15 - r as u32)) as i32 + offset as i32,
        }
    }

    /// Full scale for a code at an end of the range, else nothing.
    #[inline]
    const fn saturated(self, code: i32) -> Option<i16> {
        if code <= 0 {
            Some(i16::MIN)
        } else if code >= (1 << self.bits()) - 1 {
            Some(i16::MAX)
        } else {
            None
        }
    }

    /// A reading around the code `zero`, positive above it, as part of half of the range.
    #[inline]
    const fn signed(self, register: u16, zero: u16) -> i16 {
        let code = self.code(register, zero);
        if let Some(end) = self.saturated(code) {
            return end;
        }
        let n = (code - zero as i32) << (16 - self.bits());
        if n > i16::MAX as i32 {
            i16::MAX
        } else if n < i16::MIN as i32 {
            i16::MIN
        } else {
            n as i16
        }
    }

    /// A reading from the code 0 on, as part of the whole range.
    #[inline]
    const fn unsigned(self, register: u16) -> i16 {
        let code = self.code(register, 0);
        match self.saturated(code) {
            Some(i16::MAX) => i16::MAX,
            Some(_) => 0,
            None => ((code << (16 - self.bits())) >> 1) as i16,
        }
    }
}

/// Converters of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Converters {
    /// Layout of the three current channels.
    pub current: Layout,
    /// Code of each current channel at zero current, nominally half of the range (2048 of 12 bits); with an offset by
    /// hardware, the content of its `OFFSETy`.
    pub zero: [u16; 3],
    /// Layout of the dc-link channel, which has no offset.
    pub u_dc: Layout,
}

impl Converters {
    /// The same layout in all channels, without offset by hardware, zero current at half of the range.
    #[must_use]
    pub const fn new(layout: Layout) -> Self {
        Self { current: layout, zero: [1 << (layout.bits() - 1); 3], u_dc: layout }
    }
}

/// One set of readings as fractions of full scale, `n / 2^15`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
#[repr(C)]
pub struct Counts {
    /// Phase currents, positive into the machine; `i16::MIN` and `i16::MAX`: the channel is saturated.
    pub i_abc: [i16; 3],
    /// dc-link voltage, 0 to `i16::MAX`; `i16::MAX`: the channel is saturated.
    pub u_dc: i16,
}

impl Counts {
    /// From the content of the data registers. A channel at an end of its range reads full scale.
    #[inline]
    #[must_use]
    pub const fn from_raw(i_abc: [u16; 3], u_dc: u16, converters: &Converters) -> Self {
        let Converters { current, zero, u_dc: voltage } = converters;
        Self {
            i_abc: [
                current.signed(i_abc[0], zero[0]),
                current.signed(i_abc[1], zero[1]),
                current.signed(i_abc[2], zero[2]),
            ],
            u_dc: voltage.unsigned(u_dc),
        }
    }
}

/// Part of full scale that a saturated channel is certain to read: all ones but the last bit of 11.
const SATURATED: f64 = 0.999;

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
    /// Channels that read `±i_full` A and up to `u_full` V, for a drive of these settings.
    ///
    /// # Errors
    /// A full scale at which a saturated channel would not be a fault: `i_full` not above `i_range`, `u_full` not above
    /// `u_dc_max`; or one so large that its resolution is lost (40 times rated peak current, 64 times rated peak
    /// voltage).
    pub fn new(machine: &Machine, params: &DriveParams, i_full: f64, u_full: f64) -> Result<Self, ParamError> {
        let base = Base::new(machine);
        check("i_full", i_full, params.i_range / SATURATED, 40.0 * base.i, "A")
            .map_err(|e| e.with_note("a saturated channel must read at least i_range"))?;
        check("u_full", u_full, params.u_dc_max / SATURATED, 64.0 * base.u, "V")
            .map_err(|e| e.with_note("a saturated channel must read more than u_dc_max"))?;
        Ok(Self { i: R::from_f64(i_full / base.i), u_dc: R::from_f64(u_full / base.u) })
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
    use crate::params::Inverter;
    use crate::scalar::Q;
    use std::vec::Vec;

    fn setup() -> (Machine, DriveParams) {
        let machine = Machine::preset_2k2();
        (machine, DriveParams::new(&machine, &Inverter::preset_2k2()))
    }

    #[test]
    fn full_scale_reads_as_full_scale_in_all_arithmetics() {
        let (machine, params) = setup();
        let base = Base::new(&machine);
        let counts = Counts { i_abc: [i16::MIN, 0, 1 << 14], u_dc: 1 << 14 };
        fn read<R: Real>(machine: &Machine, params: &DriveParams, counts: &Counts) -> [f64; 4] {
            let m = Scale::<R>::new(machine, params, 20.0, 800.0).unwrap().measurement(counts);
            [m.i_abc[0], m.i_abc[1], m.i_abc[2], m.u_dc].map(R::to_f64)
        }
        let want = [-20.0 / base.i, 0.0, 10.0 / base.i, 400.0 / base.u];
        for got in [
            read::<f32>(&machine, &params, &counts),
            read::<f64>(&machine, &params, &counts),
            read::<Q>(&machine, &params, &counts),
        ] {
            for (g, w) in got.iter().zip(want) {
                assert!((g - w).abs() < 3e-7, "{g} {w}");
            }
        }
    }

    /// Data registers of the reference manual, bit by bit: `D` data, `S` sign extension.
    fn register(layout: Layout, code: i32, offset: i32) -> u16 {
        let figure = match layout {
            Layout::Right(r) | Layout::RightOffset(r) => return register_right(r, code, offset),
            Layout::Left(Resolution::Six) => "00000000DDDDDD00",
            Layout::Left(Resolution::Eight) => "DDDDDDDD00000000",
            Layout::Left(Resolution::Ten) => "DDDDDDDDDD000000",
            Layout::Left(Resolution::Twelve) => "DDDDDDDDDDDD0000",
            Layout::LeftOffset(Resolution::Six) => "SSSSSSSSSDDDDDD0",
            Layout::LeftOffset(Resolution::Eight) => "SDDDDDDDD0000000",
            Layout::LeftOffset(Resolution::Ten) => "SDDDDDDDDDD00000",
            Layout::LeftOffset(Resolution::Twelve) => "SDDDDDDDDDDDD000",
            _ => unreachable!("oversampled results are right-aligned"),
        };
        let value = code - offset;
        let mut bit = figure.matches('D').count();
        figure.chars().fold(0, |word, c| {
            let b = match c {
                'D' => {
                    bit -= 1;
                    (value >> bit) & 1
                }
                'S' => i32::from(value < 0),
                _ => 0,
            };
            word << 1 | b as u16
        })
    }

    fn register_right(_: Resolution, code: i32, offset: i32) -> u16 {
        (code - offset) as i16 as u16
    }

    #[test]
    fn every_code_of_every_register_layout_reads_as_its_part_of_full_scale() {
        use Resolution::{Eight, Fourteen, Six, Sixteen, Ten, Twelve};
        let aligned = [Six, Eight, Ten, Twelve];
        let mut layouts: Vec<(Layout, bool)> = Vec::new();
        layouts.extend(aligned.map(|r| (Layout::Left(r), false)));
        layouts.extend(aligned.map(|r| (Layout::LeftOffset(r), true)));
        layouts.extend([Six, Eight, Ten, Twelve, Fourteen, Sixteen].map(|r| (Layout::Right(r), false)));
        layouts.extend(aligned.map(|r| (Layout::RightOffset(r), true)));
        for (layout, hardware) in layouts {
            let full = 1 << layout.bits();
            for zero in [full / 2, full / 2 + full / 40, full / 2 - full / 40] {
                let converters = Converters { current: layout, zero: [zero as u16; 3], u_dc: layout };
                for code in 0..full {
                    let raw = register(layout, code, if hardware { zero } else { 0 });
                    let n = Counts::from_raw([raw; 3], 0, &converters).i_abc[1];
                    if code == 0 {
                        assert_eq!(n, i16::MIN, "{layout:?}");
                    } else if code == full - 1 {
                        assert_eq!(n, i16::MAX, "{layout:?}");
                    } else {
                        // Exact: whole counts, limited to what 16 bits hold.
                        let want = ((code - zero) * (65_536 / full)).clamp(i32::from(i16::MIN), i32::from(i16::MAX));
                        assert_eq!(i32::from(n), want, "{layout:?} {code} {zero}");
                    }
                    if !hardware {
                        let u = Counts::from_raw([0; 3], raw, &converters).u_dc;
                        let want = if code == full - 1 { 32_767 } else { code * 32_768 / full };
                        assert_eq!(i32::from(u), want, "{layout:?} {code}");
                    }
                }
            }
        }
    }

    /// What the register of a converter with its offset enabled holds at positive full scale is a quarter of the
    /// 16-bit range, and without offset the top code is negative as a signed number: neither is a left-aligned reading.
    #[test]
    fn the_raw_register_is_not_a_reading() {
        let top = register(Layout::LeftOffset(Resolution::Twelve), 4094, 2048);
        assert_eq!(top, 2046 << 3);
        let converters = Converters {
            current: Layout::LeftOffset(Resolution::Twelve),
            zero: [2048; 3],
            u_dc: Layout::Left(Resolution::Twelve),
        };
        let counts = Counts::from_raw([top; 3], 4000 << 4, &converters);
        assert_eq!((counts.i_abc[0], counts.u_dc), (2046 << 4, 4000 << 3));
        assert!(((4000_u16 << 4) as i16) < 0);
        const FOLDED: Counts = Counts::from_raw([2048; 3], 0, &Converters::new(Layout::Right(Resolution::Twelve)));
        assert_eq!(FOLDED, Counts::default());
    }
}
