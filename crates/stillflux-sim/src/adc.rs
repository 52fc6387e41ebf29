//! Current and dc-link measurement: gain, offset with drift, noise, range, quantisation.

use crate::rng::Rng;
use stillflux::params::{Inverter, Machine, ParamError, check};
use stillflux::si::MeasurementSi;

/// A/D conversion of three phase currents and the dc-link voltage.
///
/// `reading = quantise(gain i + offset + drift t + noise)`, clipped to the range of a two's complement
/// converter. `i` is the current at the channel's instant, `skew` before the carrier peak: a converter that takes
/// one channel after the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adc {
    /// Resolution of the current channels, bit; 0: no quantisation.
    pub bits: u32,
    /// Full scale of the current channels, A: readings lie within `±range`.
    pub range: f64,
    /// Noise per channel, A rms, Gaussian and white.
    pub noise: f64,
    /// Offset per channel at t = 0, A.
    pub offset: [f64; 3],
    /// Drift of the offset, A/s.
    pub offset_drift: [f64; 3],
    /// Gain per channel, ideally 1.
    pub gain: [f64; 3],
    /// Time before the carrier peak at which each channel is sampled, s.
    pub skew: [f64; 3],
    /// Resolution of the dc-link channel, bit; 0: no quantisation.
    pub u_dc_bits: u32,
    /// Full scale of the dc-link channel, V.
    pub u_dc_range: f64,
}

impl Adc {
    /// 12 bit over `±2.5 √2 I_N` and `1.5 u_dc`, without error.
    #[must_use]
    pub fn new(machine: &Machine, inverter: &Inverter) -> Self {
        Self {
            bits: 12,
            range: 2.5 * std::f64::consts::SQRT_2 * machine.I_N,
            noise: 0.0,
            offset: [0.0; 3],
            offset_drift: [0.0; 3],
            gain: [1.0; 3],
            skew: [0.0; 3],
            u_dc_bits: 12,
            u_dc_range: 1.5 * inverter.u_dc,
        }
    }

    /// Checks every field against its admissible range.
    ///
    /// # Errors
    /// The first field found outside its range.
    pub fn validate(&self) -> Result<(), ParamError> {
        check("adc_bits", f64::from(self.bits), 0.0, 32.0, "bit")?;
        check("adc_range", self.range, 1e-6, 1e6, "A")?;
        check("adc_noise", self.noise, 0.0, self.range, "A")?;
        self.check_offset(&self.offset)?;
        for k in 0..3 {
            check("current_offset_drift", self.offset_drift[k], -self.range, self.range, "A/s")?;
            check("current_gain", self.gain[k], 0.1, 10.0, "")?;
        }
        check("u_dc_bits", f64::from(self.u_dc_bits), 0.0, 32.0, "bit")?;
        check("u_dc_range", self.u_dc_range, 1.0, 1e6, "V")
    }

    /// Checks offsets of the channels against their range.
    ///
    /// # Errors
    /// The first offset beyond it.
    pub fn check_offset(&self, offset: &[f64; 3]) -> Result<(), ParamError> {
        offset.iter().try_for_each(|&i| check("current_offset", i, -self.range, self.range, "A"))
    }
}

/// Nearest whole number, ties to even, for `|x| < 2^51`: no library call on the baseline instruction set.
#[inline(always)]
pub(crate) fn nearest(x: f64) -> f64 {
    const M: f64 = 6_755_399_441_055_744.0; // 1.5 · 2^52
    (x + M) - M
}

/// What a failed current channel reads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ChannelFault {
    /// The same value from now on, A.
    Stuck(f64),
    /// The value that it has now, from now on.
    Held,
    /// The current times a factor: −1 inverted, 0 broken.
    Gain(f64),
    /// The current of another channel (0 to 2): with two such channels, swapped ones.
    Of(usize),
    /// One sample of this value, A.
    Once(f64),
}

impl ChannelFault {
    /// Checks channel, current and factor against their ranges.
    ///
    /// # Errors
    /// The first one found outside its range.
    pub fn validate(&self, channel: usize) -> Result<(), ParamError> {
        check_channel(channel)?;
        match *self {
            Self::Held => Ok(()),
            Self::Of(other) => check_channel(other),
            Self::Gain(factor) => check("channel gain", factor, -10.0, 10.0, ""),
            Self::Stuck(i) | Self::Once(i) => check("channel current", i, -1e9, 1e9, "A"),
        }
    }
}

fn check_channel(number: usize) -> Result<(), ParamError> {
    check("channel", number as f64, 0.0, 2.0, "")
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Converter {
    adc: Adc,
    faults: [Option<ChannelFault>; 3],
    pub offset: [f64; 3],
    rng: Rng,
    lsb: f64,
    inv_lsb: f64,
    u_lsb: f64,
}

impl Converter {
    pub fn new(adc: Adc, seed: u64) -> Self {
        let lsb = 2.0 * adc.range / (1u64 << adc.bits) as f64;
        let u_lsb = adc.u_dc_range / (1u64 << adc.u_dc_bits) as f64;
        Self { adc, faults: [None; 3], offset: adc.offset, rng: Rng::new(seed), lsb, inv_lsb: 1.0 / lsb, u_lsb }
    }

    pub fn set_fault(&mut self, channel: usize, fault: Option<ChannelFault>) {
        if let Some(state) = self.faults.get_mut(channel) {
            *state = fault.filter(|fault| !matches!(fault, ChannelFault::Of(other) if *other > 2));
        }
    }

    pub fn drift(&mut self, dt: f64) {
        for k in 0..3 {
            self.offset[k] += self.adc.offset_drift[k] * dt;
        }
    }

    pub fn read(&mut self, i_abc: [f64; 3], u_dc: f64) -> MeasurementSi {
        let a = &self.adc;
        let mut i = [0, 1, 2].map(|k| match self.faults[k] {
            Some(ChannelFault::Of(other)) => i_abc[other],
            Some(ChannelFault::Gain(gain)) => gain * i_abc[k],
            _ => i_abc[k],
        });
        for k in 0..3 {
            i[k] = a.gain[k] * i[k] + self.offset[k];
            if a.noise > 0.0 {
                i[k] += a.noise * self.rng.gauss();
            }
            if a.bits > 0 {
                i[k] = nearest((i[k] * self.inv_lsb).clamp(-1e12, 1e12)) * self.lsb;
                i[k] = i[k].clamp(-a.range, a.range - self.lsb);
            } else {
                i[k] = i[k].clamp(-a.range, a.range);
            }
        }
        for k in 0..3 {
            match self.faults[k] {
                Some(ChannelFault::Stuck(value)) => i[k] = value,
                Some(ChannelFault::Held) => self.faults[k] = Some(ChannelFault::Stuck(i[k])),
                Some(ChannelFault::Once(value)) => (i[k], self.faults[k]) = (value, None),
                _ => {}
            }
        }
        let u = if a.u_dc_bits > 0 {
            (nearest(u_dc / self.u_lsb) * self.u_lsb).clamp(0.0, a.u_dc_range - self.u_lsb)
        } else {
            u_dc.clamp(0.0, a.u_dc_range)
        };
        MeasurementSi { i_abc: i, u_dc: u }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adc() -> Adc {
        Adc::new(&Machine::preset_2k2(), &Inverter::preset_2k2())
    }

    #[test]
    fn quantises_to_the_nearest_code_and_clips() {
        let mut c = Converter::new(adc(), 1);
        let lsb = 2.0 * adc().range / 4096.0;
        let s = c.read([1.2345, -0.3 * lsb, 0.6 * lsb], 540.0);
        assert!((s.i_abc[0] - 1.2345).abs() <= 0.5 * lsb && (s.i_abc[0] / lsb).fract().abs() < 1e-9);
        assert_eq!((s.i_abc[1], s.i_abc[2]), (0.0, lsb));
        assert!((s.u_dc - 540.0).abs() <= 0.5 * 810.0 / 4096.0);
        let clipped = c.read([1e3, -1e3, 0.0], 1e4);
        assert_eq!(clipped.i_abc, [adc().range - lsb, -adc().range, 0.0]);
        assert!(clipped.u_dc < 810.0);
    }

    #[test]
    fn gain_offset_and_drift_add_up() {
        let ideal =
            Adc { bits: 0, gain: [1.1, 1.0, 0.9], offset: [0.1, 0.0, -0.1], offset_drift: [0.0, 0.5, 0.0], ..adc() };
        let mut c = Converter::new(ideal, 1);
        for _ in 0..1000 {
            c.drift(1e-3);
        }
        let s = c.read([1.0, 2.0, 3.0], 540.0);
        for (got, want) in s.i_abc.iter().zip([1.2, 2.5, 2.6]) {
            assert!((got - want).abs() < 1e-12);
        }
    }

    #[test]
    fn noise_is_gaussian_and_reproducible() {
        let noisy = Adc { bits: 0, noise: 0.02, ..adc() };
        let (mut a, mut b, mut other) = (Converter::new(noisy, 7), Converter::new(noisy, 7), Converter::new(noisy, 8));
        let (mut m2, mut m4, n) = (0.0, 0.0, 200_000);
        for _ in 0..n {
            let x = a.read([0.0; 3], 540.0);
            assert_eq!(x, b.read([0.0; 3], 540.0));
            assert_ne!(x, other.read([0.0; 3], 540.0));
            let r = x.i_abc[1] / 0.02;
            m2 += r * r;
            m4 += r.powi(4);
        }
        let (m2, m4) = (m2 / f64::from(n), m4 / f64::from(n));
        assert!((m2 - 1.0).abs() < 0.02 && (m4 - 3.0).abs() < 0.15, "{m2} {m4}");
    }
}
