//! Speed from a position counter: an incremental encoder or a resolver. Per unit.
//!
//! ```text
//! Δθ(k) = δ (n_k - n_k-1),   δ = n_p 2π/(4 lines)         n: content of the counter, modulo its states
//! dω/dτ = k_i e,   dθ/dτ = ω + k_p e,   e = Σ Δθ - θ,   k_p = 2 ω_n,   k_i = ω_n²
//! ```
//!
//! The counter counts the four edges of each line; a resolver of `2^b` steps a turn is an encoder of `2^b/4` lines. `δ` is
//! the electrical angle of a count. Differences are taken on the circle of the counter's states, so that its overflow, or
//! its reset at each turn, is no event: the speed must stay below half of that circle an interval.
//!
//! A quotient of counts and time (M-method) over `w` periods has steps of `δ/(w t_s)`: 0.1 pu from one period to the next
//! with 1024 lines, two pole pairs and 10 kHz. The tracking loop, with `ω` its integral part, is
//!
//! ```text
//! ω/ω_m = ω_n²/(s + ω_n)²         gain 1, delay 2/ω_n: 13 ms at 25 Hz; a ramp a is followed 2a/ω_n behind
//! ```
//!
//! One count that comes alone raises `ω` by at most `δ ω_n/e` (the answer `δ ω_n² τ e^(-ω_n τ)` has its maximum at
//! `1/ω_n`): the resolution, 0.0006 pu with these numbers. At a constant speed the ripple is below it. Natural frequency
//! and interval are those of the speed estimator ([`super::speed`]): measured and estimated speed have the same dynamics,
//! their difference shows errors and not delays, and a control loop does not notice which of the two it is given.
//!
//! The content has to be that of the instant at which the currents are sampled. A period without it goes on at the same
//! speed; what was counted meanwhile comes with the next content. After 8 of them the counter may have gone round, and its
//! content is a beginning.
//!
//! Validity: `|ω| < 4`, and at most half of the counter's states in 8 intervals.

use crate::estimate::speed::SpeedConfig;
use crate::scalar::{QuickIntegrator, Real};
use crate::words::words;

/// Largest speed, per unit.
const OMEGA_MAX: f64 = 4.0;
/// Largest error of the angle, rad: more than a machine makes that is connected at full speed.
const ERROR_MAX: f64 = 4.0;
/// Largest angle of `2^15` shifted counts: it keeps eight bits more than its rounding needs, and fits fixed point.
const ANGLE_MAX: f64 = 64.0;
/// Intervals after which the difference of two contents is no longer taken for the angle between them.
pub(crate) const INTERVALS: u32 = 8;

/// Settings of the counter.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct EncoderConfig<R: Real> {
    /// Angle of `2^15` counts after the shift.
    angle: R,
    /// Bits by which a number of counts is moved up.
    shift: u32,
    /// States of the counter.
    states: u32,
}
words!(EncoderConfig: angle, shift, states);

impl<R: Real> EncoderConfig<R> {
    /// For an encoder of so many lines on a machine of `n_p` pole pairs, and a counter of so many states.
    #[must_use]
    pub fn new(lines: u32, n_p: u32, states: u32) -> Self {
        let mut angle = 32_768.0 * count_angle(lines, n_p);
        let mut shift = 0;
        while angle > ANGLE_MAX && shift < 14 {
            angle *= 0.5;
            shift += 1;
        }
        Self { angle: R::from_f64(angle), shift, states }
    }

    /// Electrical angle between two contents of the counter, the shorter way round, and limited to `2^15` shifted counts.
    #[inline]
    fn between(&self, from: u32, to: u32) -> R {
        // Contents below 2^31: their difference fits, and wrapping keeps any other pair harmless. So is 2^31 states, which
        // have no sign.
        let states = self.states as i32;
        let half = (self.states >> 1) as i32;
        let mut n = to.wrapping_sub(from) as i32;
        if n > half {
            n = n.wrapping_sub(states);
        } else if n < -half {
            n = n.wrapping_add(states);
        }
        let most = i32::from(i16::MAX) >> (self.shift & 15);
        let n = n.clamp(-most, most) << (self.shift & 15);
        self.angle * R::fraction(n as i16)
    }
}

/// Electrical angle of one count, rad.
pub(crate) fn count_angle(lines: u32, n_p: u32) -> f64 {
    core::f64::consts::TAU * f64::from(n_p) / (4.0 * f64::from(lines))
}

/// State of the tracking loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Encoder<R: Real> {
    /// Content that has not been looked at yet, and the one before it.
    count: Option<u32>,
    last: Option<u32>,
    /// Angle counted less that of the loop.
    error: R,
    omega: QuickIntegrator<R>,
    /// Calls since the latest content.
    silent: u32,
}

impl<R: Real> Encoder<R> {
    /// Content of the counter at the instant of the next currents.
    #[inline]
    pub fn set(&mut self, count: u32) {
        self.count = Some(count);
    }

    /// Measured speed.
    #[inline]
    pub fn omega(&self) -> R {
        self.omega.value()
    }

    /// Calls since the counter was read last; `u32::MAX`: never.
    #[inline]
    pub fn silent(&self) -> u32 {
        if self.last.is_some() { self.silent } else { u32::MAX }
    }

    /// One call, with interval and gains of the speed estimator.
    #[inline]
    pub fn step(&mut self, c: &EncoderConfig<R>, speed: &SpeedConfig<R>) {
        let bound = R::from_f64(ERROR_MAX);
        let on = speed.t_s * self.omega.value();
        let Some(count) = self.count.take() else {
            self.error = (self.error - on).limit(bound);
            self.silent = self.silent.saturating_add(1);
            return;
        };
        let turned = self.last.filter(|_| self.silent < INTERVALS).map_or(on, |last| c.between(last, count));
        (self.last, self.silent) = (Some(count), 0);
        let error = (self.error + (turned - on)).limit(bound);
        self.omega.add_limited(speed.k_i, error, R::from_f64(OMEGA_MAX));
        self.error = error - speed.t_s * (speed.k_p * error);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Q;
    use proptest::prelude::*;

    /// Of the 2.2-kW machine at 10 kHz, two periods apart.
    const T_S: f64 = 0.0628;
    const OMEGA_N: f64 = 0.5;

    fn speed<R: Real>() -> SpeedConfig<R> {
        let r = R::from_f64;
        SpeedConfig {
            t_s: r(T_S),
            sigma_l_s: r(0.1),
            r_r: r(0.05),
            k_p: r(2.0 * OMEGA_N),
            k_i: r(T_S * OMEGA_N * OMEGA_N),
        }
    }

    /// Measured speed of a shaft over `calls`, the electrical angle given by `theta` over the call.
    fn run<R: Real>(lines: u32, states: u32, calls: u32, theta: impl Fn(f64) -> f64) -> std::vec::Vec<f64> {
        let c = EncoderConfig::<R>::new(lines, 2, states);
        let mut encoder = Encoder::<R>::default();
        (0..calls)
            .map(|k| {
                let count = (theta(f64::from(k)) / count_angle(lines, 2)).floor() as i64;
                encoder.set(count.rem_euclid(i64::from(states)) as u32);
                encoder.step(&c, &speed());
                encoder.omega().to_f64()
            })
            .collect()
    }

    fn tells_the_speed<R: Real>() {
        for lines in [32, 512, 1024, 5000, 16_384] {
            let resolution = count_angle(lines, 2) * OMEGA_N / core::f64::consts::E;
            for omega in [0.0, 0.002, -0.05, 1.0, -2.2] {
                let w = run::<R>(lines, 1 << 16, 2000, |k| omega * T_S * k);
                let worst = w[1000..].iter().map(|w| (w - omega).abs()).fold(0.0, f64::max);
                assert!(worst < resolution + 2e-5, "{} {lines} {omega}: {worst} {resolution}", R::NAME);
                let mean = w[1000..].iter().sum::<f64>() / 1000.0;
                assert!((mean - omega).abs() < 0.1 * resolution + 2e-5, "{} {lines} {omega}: {mean}", R::NAME);
            }
        }
    }

    #[test]
    fn tells_the_speed_within_its_resolution_in_every_arithmetic() {
        tells_the_speed::<f32>();
        tells_the_speed::<f64>();
        tells_the_speed::<Q>();
    }

    #[test]
    fn a_counter_of_any_number_of_states_tells_the_speed() {
        for states in [1 << 16, 1 << 30, (1 << 31) - 1, 1 << 31] {
            for omega in [0.5, -0.5] {
                let w = run::<f64>(1024, states, 2000, |k| omega * T_S * k);
                assert!(
                    (w[1999] - omega).abs() < count_angle(1024, 2) * OMEGA_N / core::f64::consts::E,
                    "{states} {omega}: {}",
                    w[1999]
                );
            }
        }
    }

    #[test]
    fn follows_a_ramp_with_the_delay_of_its_loop() {
        let a = 1e-3;
        let w = run::<f64>(5000, 1 << 16, 3000, |k| 0.5 * a * (T_S * k) * (T_S * k));
        let lag = a * T_S * 2999.0 - w[2999];
        assert!((lag / (2.0 * a / OMEGA_N) - 1.0).abs() < 0.05, "{lag}");
    }

    #[test]
    fn one_count_that_comes_alone_raises_the_speed_by_the_resolution() {
        let w = run::<f64>(32, 1 << 16, 2000, |k| if k < 500.0 { 0.0 } else { 1.5 * count_angle(32, 2) });
        let most = w.iter().fold(0.0_f64, |most, w| most.max(*w));
        let resolution = count_angle(32, 2) * OMEGA_N / core::f64::consts::E;
        assert!((most / resolution - 1.0).abs() < 0.05, "{most} {resolution}");
    }

    #[test]
    fn periods_without_a_content_change_nothing_in_the_speed() {
        let c = EncoderConfig::<f64>::new(1024, 2, 4096);
        let mut encoder = Encoder::default();
        for k in 0..6000_u32 {
            if k < 2000 || k % 3 == 0 {
                let count = (0.3 * T_S * f64::from(k) / count_angle(1024, 2)).floor();
                encoder.set(count as u32 % 4096);
            }
            encoder.step(&c, &speed());
            assert!(k < 1000 || (encoder.omega() - 0.3).abs() < 1e-3, "{k}: {}", encoder.omega());
        }
        assert_eq!(Encoder::<f64>::default().silent(), u32::MAX);
        let silent = encoder.silent();
        encoder.step(&c, &speed());
        assert_eq!(encoder.silent(), silent + 1);
    }

    proptest! {
        /// Whatever the width of the counter, and wherever it wraps: the angle between two contents is that between the
        /// positions.
        #[test]
        fn an_overflow_of_the_counter_is_no_event(
            states in 64_u32..=1 << 31,
            lines in 16_u32..=65_536,
            from in any::<u32>(),
            part in -0.49_f64..0.49,
        ) {
            let c = EncoderConfig::<f64>::new(lines, 2, states);
            let from = from % states;
            let most = (f64::from(i16::MAX) / f64::from(1 << c.shift)).floor();
            let n = (part * f64::from(states)).round().clamp(-most, most);
            let to = (i64::from(from) + n as i64).rem_euclid(i64::from(states)) as u32;
            let want = n * count_angle(lines, 2);
            prop_assert!((c.between(from, to) - want).abs() < 1e-9 * (1.0 + want.abs()));
            prop_assert!((EncoderConfig::<Q>::new(lines, 2, states).between(from, to).to_f64() - want).abs() < 2e-6);
        }

        /// Contents that no counter has, one after the other.
        #[test]
        fn no_content_makes_a_speed_beyond_its_range(
            states in any::<u32>(),
            lines in 1_u32..=1 << 20,
            contents in proptest::collection::vec(any::<Option<u32>>(), 1..200),
        ) {
            let (c, q) = (EncoderConfig::<f32>::new(lines, 60, states), EncoderConfig::<Q>::new(lines, 60, states));
            let (mut float, mut fixed) = (Encoder::<f32>::default(), Encoder::<Q>::default());
            for count in contents {
                if let Some(count) = count {
                    float.set(count);
                    fixed.set(count);
                }
                float.step(&c, &speed());
                fixed.step(&q, &speed());
                prop_assert!(float.omega().abs() <= 3.0 && fixed.omega().to_f64().abs() <= 3.0);
            }
        }
    }
}
