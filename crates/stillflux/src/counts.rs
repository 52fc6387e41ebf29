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
#[cfg(feature = "shunt")]
use crate::control::shunt::Pulses;
use crate::drive::Measurement;
use crate::params::{Machine, ParamError, check};
use crate::scalar::{Real, Timer};
use crate::words::words;

/// Bits of a converter's result: 6, 8, 10 or 12 of a conversion (`RES`), any other number of oversampled ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
#[repr(u8)]
pub enum Resolution {
    /// 6 bits.
    Six = 6,
    /// 7 bits.
    Seven = 7,
    /// 8 bits.
    Eight = 8,
    /// 9 bits.
    Nine = 9,
    /// 10 bits.
    Ten = 10,
    /// 11 bits.
    Eleven = 11,
    /// 12 bits.
    Twelve = 12,
    /// 13 bits.
    Thirteen = 13,
    /// 14 bits.
    Fourteen = 14,
    /// 15 bits.
    Fifteen = 15,
    /// 16 bits.
    Sixteen = 16,
}

impl Resolution {
    /// Of so many bits, 6 to 16.
    #[must_use]
    pub const fn of(bits: u32) -> Option<Self> {
        Some(match bits {
            6 => Self::Six,
            7 => Self::Seven,
            8 => Self::Eight,
            9 => Self::Nine,
            10 => Self::Ten,
            11 => Self::Eleven,
            12 => Self::Twelve,
            13 => Self::Thirteen,
            14 => Self::Fourteen,
            15 => Self::Fifteen,
            16 => Self::Sixteen,
            _ => return None,
        })
    }

    /// Of the sum of `ratio` samples of 12 bits that the hardware shifts right by `shift` bits, rounded: 2 to 256
    /// samples (`OVSR`), 0 to 8 bits (`OVSS`). `None` for what the hardware does not do, and where more than 16 bits
    /// remain: it cuts the upper ones off.
    #[must_use]
    pub const fn oversampled(ratio: u32, shift: u32) -> Option<Self> {
        if !ratio.is_power_of_two() || ratio < 2 || ratio > 256 || shift > 8 {
            return None;
        }
        Self::of(12 + ratio.trailing_zeros() - shift)
    }

    /// The code of a saturated converter. Of a sum without or with little shift the lowest bits stay zero; one that is
    /// shifted further than it has grown is rounded up to a power of two, which is beyond this.
    const fn top(self) -> i32 {
        let bits = self as u32;
        if bits > 12 { (1 << bits) - (1 << (bits - 12)) } else { (1 << bits) - 1 }
    }
}

/// How a result lies in the 16-bit data register of a converter. Names of bits are those of the STM32G4 (RM0440, data
/// management of the converters); F3 and L4 lie the same. The converters of H7 and U5 shift to the left by a number of
/// bits instead: without that shift and without offset they are [`Layout::Right`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Layout {
    /// `ALIGN` = 0, no offset, or one with `SATEN`: `D11…D0` in bits 11 to 0, unsigned. So are oversampled results,
    /// whatever `ALIGN` and `OFFSETy_EN` say.
    Right(Resolution),
    /// `ALIGN` = 1, no offset, or one with `SATEN`: `D11…D0 0000`, bits 15 to 4, unsigned; 6 bits in bits 7 to 2.
    Left(Resolution),
    /// `ALIGN` = 0, `OFFSETy_EN` = 1, `SATEN` = 0: `SEXT… D11…D0`, signed; `OFFSETPOS` = 0 or 1.
    RightOffset(Resolution),
    /// `ALIGN` = 1, `OFFSETy_EN` = 1, `SATEN` = 0, `OFFSETPOS` = 0: `SEXT D11…D0 000`, signed, one bit lower than
    /// without offset; 6 bits in bits 6 to 1.
    LeftOffset(Resolution),
}

impl Layout {
    #[inline]
    const fn resolution(self) -> Resolution {
        match self {
            Self::Right(r) | Self::Left(r) | Self::RightOffset(r) | Self::LeftOffset(r) => r,
        }
    }

    /// Whether the hardware subtracts an offset and keeps the sign.
    #[inline]
    const fn is_signed(self) -> bool {
        matches!(self, Self::RightOffset(_) | Self::LeftOffset(_))
    }

    /// The number in a register.
    #[inline]
    const fn number(self, register: u16) -> i32 {
        match self {
            Self::Right(_) => register as i32,
            Self::Left(Resolution::Six) => (register >> 2) as i32,
            Self::Left(r) => (register >> (16 - r as u32)) as i32,
            Self::LeftOffset(Resolution::Six) => (register as i16 >> 1) as i32,
            Self::RightOffset(_) | Self::LeftOffset(Resolution::Sixteen) => register as i16 as i32,
            Self::LeftOffset(r) => (register as i16 >> (15 - r as u32)) as i32,
        }
    }

    /// The converter's own code, 0 to [`Resolution::top`], or the end of its range: `false` the lower, `true` the upper
    /// one. `offset`: what the hardware subtracts.
    #[inline]
    const fn code(self, register: u16, offset: i16) -> Result<i32, bool> {
        let (number, top) = (self.number(register), self.resolution().top());
        let code = number + offset as i32;
        // An unsigned number at an end of its own range was cut off there: by the converter, or by `SATEN`.
        if code <= 0 || (number <= 0 && !self.is_signed()) {
            Err(false)
        } else if code >= top || (number >= top && !self.is_signed()) {
            Err(true)
        } else {
            Ok(code)
        }
    }

    /// A reading around the code `zero`, positive above it, as part of half of the range.
    #[inline]
    const fn signed(self, register: u16, offset: i16, zero: u16) -> i16 {
        match self.code(register, offset) {
            Err(false) => i16::MIN,
            Err(true) => i16::MAX,
            Ok(code) => {
                let n = (code - zero as i32) << (16 - self.resolution() as u32);
                if n > i16::MAX as i32 {
                    i16::MAX
                } else if n < i16::MIN as i32 {
                    i16::MIN
                } else {
                    n as i16
                }
            }
        }
    }

    /// A reading from the code 0 on, as part of the whole range.
    #[inline]
    const fn unsigned(self, register: u16) -> i16 {
        match self.code(register, 0) {
            Err(false) => 0,
            Err(true) => i16::MAX,
            Ok(code) => ((code << (16 - self.resolution() as u32)) >> 1) as i16,
        }
    }
}

/// Converters of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Converters {
    /// Layout of the three current channels.
    pub current: Layout,
    /// Code of each current channel at zero current, nominally half of the range: 2048 of 12 bits.
    pub zero: [u16; 3],
    /// What the hardware subtracts from the codes of the current channels, 0 without an offset; negative with
    /// `OFFSETPOS`. A code as all others: `OFFSETy` holds it at 12 bits, `OFFSETy >> 2` of 10 bits, `>> 4` of 8, `>> 6`
    /// of 6.
    pub offset: [i16; 3],
    /// Layout of the dc-link channel, which has no offset.
    pub u_dc: Layout,
}

impl Converters {
    /// The same resolution and alignment in all channels, zero current at half of the range; with a layout for an
    /// offset by hardware, that is the offset of the current channels.
    #[must_use]
    pub const fn new(layout: Layout) -> Self {
        let half = 1 << (layout.resolution() as u32 - 1);
        // Half of 16 bits is no `i16`; but no hardware takes an offset off such a result.
        let (offset, u_dc) = match layout {
            Layout::Right(_) | Layout::Left(_) => (0, layout),
            Layout::RightOffset(r) => (half as i16, Layout::Right(r)),
            Layout::LeftOffset(r) => (half as i16, Layout::Left(r)),
        };
        Self { current: layout, zero: [half; 3], offset: [offset; 3], u_dc }
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
        let Converters { current, zero, offset, u_dc: voltage } = converters;
        Self {
            i_abc: [
                current.signed(i_abc[0], offset[0], zero[0]),
                current.signed(i_abc[1], offset[1], zero[1]),
                current.signed(i_abc[2], offset[2], zero[2]),
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

/// Compare values of the three legs and of the converter's trigger for a single shunt.
#[cfg(feature = "shunt")]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PulseCounts {
    /// Compare values of the half period with the rising edges, 0 to [`Timer::full`].
    pub rising: [u32; 3],
    /// Compare values of the half period with the falling edges.
    pub falling: [u32; 3],
    /// Counts in the half period with the falling edges at which the two samples have to be complete, ascending. A third
    /// one is taken at the end of the period.
    pub sample: [u32; 2],
}

#[cfg(feature = "shunt")]
impl PulseCounts {
    /// Of a timer.
    pub fn new<R: Real>(pulses: &Pulses<R>, timer: &Timer) -> Self {
        let count = |x: R| x.quantise(timer).0;
        Self { rising: pulses.rising.map(count), falling: pulses.falling.map(count), sample: pulses.sample.map(count) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::Inverter;
    use crate::scalar::Q;

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

    /// Configuration of a converter by the bits of its registers.
    #[derive(Clone, Copy, Debug)]
    struct Hardware {
        /// 6, 8, 10 or 12.
        res: u32,
        align: bool,
        /// `OFFSETy`, `OFFSETPOS` and `SATEN` of an enabled offset.
        offset: Option<(i32, bool, bool)>,
        /// Samples and shift.
        oversampling: Option<(i32, u32)>,
    }

    impl Hardware {
        /// The data register of the reference manual, bit by bit, of the code of a conversion.
        fn register(&self, code: i32) -> u16 {
            if let Some((ratio, shift)) = self.oversampling {
                // Neither offset nor alignment. Rounded by the bits shifted out, cut to 16 bits.
                return (((ratio * code) + (1 << shift >> 1)) >> shift) as u16;
            }
            let Some((offset, positive, saturated)) = self.offset else {
                return self.align(code, false);
            };
            // The offset is taken off the code as it lies in 12 bits.
            let place = 12 - self.res;
            let mut value = ((code << place) + if positive { offset } else { -offset }) >> place;
            if saturated {
                value = value.clamp(0, (1 << self.res) - 1);
            }
            self.align(value, !saturated)
        }

        /// Figures of the alignment: `D` data, `S` sign extension. Right-aligned, the sign extends the number as it is.
        fn align(&self, value: i32, signed: bool) -> u16 {
            let figure = match (self.align, signed, self.res) {
                (false, ..) => return value as i16 as u16,
                (true, false, 6) => "00000000DDDDDD00",
                (true, false, 8) => "DDDDDDDD00000000",
                (true, false, 10) => "DDDDDDDDDD000000",
                (true, false, _) => "DDDDDDDDDDDD0000",
                (true, true, 6) => "SSSSSSSSSDDDDDD0",
                (true, true, 8) => "SDDDDDDDD0000000",
                (true, true, 10) => "SDDDDDDDDDD00000",
                (true, true, _) => "SDDDDDDDDDDDD000",
            };
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
    }

    #[test]
    fn every_code_of_every_alignment_and_offset_mode_reads_as_its_part_of_full_scale() {
        for res in [6, 8, 10, 12] {
            let (r, full) = (Resolution::of(res).unwrap(), 1 << res);
            for zero in [full / 2, full / 2 + full / 40, full / 2 - full / 40] {
                let none = [(false, None, Layout::Right(r)), (true, None, Layout::Left(r))];
                let offset = |align, o: i32, saturated| {
                    let layout = match (align, saturated) {
                        (false, false) => Layout::RightOffset(r),
                        (true, false) => Layout::LeftOffset(r),
                        (false, true) => Layout::Right(r),
                        (true, true) => Layout::Left(r),
                    };
                    (align, Some((o, saturated)), layout)
                };
                let modes = none.into_iter().chain([
                    offset(false, zero, false),
                    offset(true, zero, false),
                    // Not that of zero current.
                    offset(false, zero / 3, false),
                    offset(true, zero / 3, false),
                    offset(false, zero / 3, true),
                    offset(true, zero / 3, true),
                    // OFFSETPOS.
                    offset(false, -zero / 3, false),
                    offset(false, -zero / 3, true),
                    offset(true, -zero / 3, true),
                ]);
                for (align, offset, layout) in modes {
                    let (o, saturated) = offset.unwrap_or((0, false));
                    let hardware = Hardware {
                        res,
                        align,
                        offset: offset.map(|_| (o.abs() << (12 - res), o < 0, saturated)),
                        oversampling: None,
                    };
                    let converters =
                        Converters { current: layout, zero: [zero as u16; 3], offset: [o as i16; 3], u_dc: layout };
                    for code in 0..full {
                        let n = Counts::from_raw([hardware.register(code); 3], 0, &converters).i_abc[1];
                        let want = if code == 0 || (saturated && code <= o) {
                            i32::from(i16::MIN)
                        } else if code == full - 1 || (saturated && code >= full - 1 + o) {
                            i32::from(i16::MAX)
                        } else {
                            // Exact: whole counts, limited to what 16 bits hold.
                            ((code - zero) * (65_536 / full)).clamp(i32::from(i16::MIN), i32::from(i16::MAX))
                        };
                        assert_eq!(i32::from(n), want, "{hardware:?} {code} {zero}");
                        if offset.is_none() {
                            let u = Counts::from_raw([0; 3], hardware.register(code), &converters).u_dc;
                            let want = if code == full - 1 { 32_767 } else { code * 32_768 / full };
                            assert_eq!(i32::from(u), want, "{hardware:?} {code}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn an_oversampled_result_reads_as_its_part_of_full_scale_and_shows_a_saturated_channel() {
        let mut served = 0;
        for n in 1..=8 {
            for shift in 0..=8 {
                let ratio = 1 << n;
                let Some(r) = Resolution::oversampled(ratio, shift) else {
                    assert!(!(-6..=4).contains(&(n - shift as i32)), "{ratio} {shift}");
                    continue;
                };
                served += 1;
                let bits = r as u32;
                assert_eq!(bits, 12 + n as u32 - shift);
                let hardware = Hardware {
                    res: 12,
                    align: shift % 2 == 0,
                    offset: None,
                    oversampling: Some((ratio as i32, shift)),
                };
                // Zero current beside the middle: a saturated channel reads less than full scale unless it is noticed.
                let zero = (1 << (bits - 1)) + (1 << bits) / 20;
                let converters = Converters { zero: [zero as u16; 3], ..Converters::new(Layout::Right(r)) };
                for code in 0..4096 {
                    let raw = hardware.register(code);
                    let got = Counts::from_raw([raw; 3], raw, &converters);
                    if code == 4095 {
                        assert_eq!((got.i_abc[0], got.u_dc), (i16::MAX, i16::MAX), "{ratio} {shift}");
                    } else if code == 0 {
                        assert_eq!((got.i_abc[0], got.u_dc), (i16::MIN, 0), "{ratio} {shift}");
                    } else {
                        // To a step of what the hardware rounds to; the steps at the ends count as saturated.
                        let step = 65_536 >> bits.min(12);
                        let want = (code * 16 - (zero << (16 - bits))).clamp(-32_768, 32_767);
                        let end = got.i_abc[0] == i16::MAX || got.i_abc[0] == i16::MIN;
                        let near = (i32::from(got.i_abc[0]) - want).abs() <= step;
                        let (low, high) = (code * 16 <= step, code * 16 >= 65_536 - 2 * step);
                        assert!(near || (end && (low || high)), "{ratio} {shift} {code}: {got:?} {want}");
                    }
                }
            }
        }
        // Of 72, but 10 beyond 16 bits and one below 6.
        assert_eq!(served, 61);
        assert_eq!(Resolution::oversampled(32, 0), None, "17 bits");
        assert_eq!(Resolution::oversampled(3, 0), None);
        assert_eq!(Resolution::oversampled(512, 8), None);
    }

    /// What the register of a converter with its offset enabled holds at positive full scale is a quarter of the
    /// 16-bit range, and without offset the top code is negative as a signed number: neither is a left-aligned reading.
    #[test]
    fn the_raw_register_is_not_a_reading() {
        let offset = Some((2048, false, false));
        let top = Hardware { res: 12, align: true, offset, oversampling: None }.register(4094);
        assert_eq!(top, 2046 << 3);
        let converters = Converters::new(Layout::LeftOffset(Resolution::Twelve));
        let counts = Counts::from_raw([top; 3], 4000 << 4, &converters);
        assert_eq!((counts.i_abc[0], counts.u_dc), (2046 << 4, 4000 << 3));
        assert!(((4000_u16 << 4) as i16) < 0);
        const FOLDED: Counts = Counts::from_raw([2048; 3], 0, &Converters::new(Layout::Right(Resolution::Twelve)));
        assert_eq!(FOLDED, Counts::default());
    }
}
