//! Comparison of the measured speed with the estimated one, and hand-over between the two. Per unit.
//!
//! ```text
//! Δ = ω_enc - ω̂,      Δ̄ = Δ/(1 + s τ_f)                               the difference, as it is reported
//! ω_c = ω̂ + w,        τ_f dw/dτ = w* - w                               the speed that is controlled
//! w* = Δ  where they agree, |Δ| ≤ b;   w  where |Δ| > b;   0  while the encoder is not trusted
//! ```
//!
//! The controlled speed is `ω_enc` below `1/τ_f`, and `ω̂` above it: a complementary filter. What the encoder does at once,
//! a broken wire, does not reach the speed control, and what it did before is `w`, the error of the estimate: at a
//! hand-over in either direction `ω_c` moves by `w`, over `τ_f`. Both speeds come from loops of the same natural frequency
//! ([`crate::estimate::encoder`]), so that `Δ` has no delays in it.
//!
//! **Agreement.** `b` is what the estimate may be wrong by, for the most part its slip, plus one count's worth of speed.
//! Disagreement fills a leaky counter of 20 ms. Then one of the two is wrong:
//!
//! ```text
//! the estimate:   |ω̂_s| < max(0.05, |ω_enc|/8)  and  |ω_enc| > |ω̂| + b/2            the encoder: otherwise
//! ```
//!
//! A counter that counts has a shaft that turns; one that stands proves nothing, nor does one that counts the same speed
//! the other way round. Near zero stator frequency the estimate may hold a field that is lost, and the shaft leaves with
//! its load; away from zero the voltage carries the frequency of the field, and the speed of the shaft differs from it by
//! the slip. An encoder that is too fast (wrong number of lines) is taken for a lost estimate at low frequency and found
//! away from it: the verdict is renewed every 20 ms of disagreement.
//!
//! Back to agreement: 0.2 s without disagreement, for a distrusted encoder of those only in which it turns by more than
//! `b`. A standstill agrees with a broken wire. For 0.2 s after a start there is no verdict: an estimate that begins in a
//! machine that turns has to settle.
//!
//! **Limits.** A counter that stands because it is broken is not told from a shaft that stands as long as `|ω̂| ≤ b`: until
//! the estimate leaves that band, speed control by the encoder lets the shaft creep with up to `b`. While the estimate is
//! wrong, `w*` is `Δ`: the speed that is controlled is the measured one, but the torque is that of the wrong field.

use crate::scalar::{Integrator, Real};
use crate::supervision::leaky::LeakyCounter;
use crate::supervision::{Fault, Trip};
use crate::words::words;

/// Time constant of the filter, time of disagreement and time of agreement that count, s.
pub(crate) const FILTER: f64 = 0.05;
pub(crate) const APART: f64 = 0.02;
pub(crate) const RETURN: f64 = 0.2;
/// Stator frequency up to which the field may be lost without a trace in the voltage.
const NEAR_ZERO: f64 = 0.05;
/// Part of the shaft's speed up to which a stator frequency is none of a field that drives it.
const FAR_BELOW: f64 = 0.125;

/// What is known of the encoder and of the estimate by each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum EncoderState {
    /// No content of the counter for 20 ms: the drive is sensorless.
    #[default]
    Silent,
    /// Measured and estimated speed agree, or nothing has contradicted that yet.
    Agrees,
    /// The encoder is wrong: the drive is sensorless.
    Apart,
    /// The encoder turns faster than the estimate near zero stator frequency: the field is lost, and the confidence zero.
    EstimateApart,
}

impl EncoderState {
    /// The state as a stable number: 0 silent, 1 agrees, 2 apart, 3 estimate apart.
    #[must_use]
    pub const fn code(self) -> u32 {
        self as u32
    }

    /// Its text.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Silent => "silent",
            Self::Agrees => "agrees",
            Self::Apart => "apart",
            Self::EstimateApart => "estimate apart",
        }
    }
}

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct HandOverConfig<R: Real> {
    /// Largest difference of two speeds that agree, `b`.
    pub band: R,
    /// Time between two calls over the time constant of the filter.
    pub gain: R,
    /// Calls of disagreement, and of agreement, that count.
    pub calls_apart: u32,
    /// See above.
    pub calls_return: u32,
    /// Whether the speed control uses the encoder.
    pub control: bool,
    /// Whether an encoder that is apart is a fault.
    pub fault: bool,
}
words!(HandOverConfig: band, gain, calls_apart, calls_return, control, fault);

/// State.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct HandOver<R: Real> {
    state: EncoderState,
    apart: LeakyCounter,
    /// Calls of agreement since the latest disagreement.
    agreeing: u32,
    /// Calls until the estimate has settled.
    settling: u32,
    difference: Integrator<R>,
    correction: Integrator<R>,
}

impl<R: Real> HandOver<R> {
    /// Speed control begins: the encoder is what it was found to be.
    pub fn start(&mut self, c: &HandOverConfig<R>) {
        // Whether the counter is silent is seen at the first call.
        let state = if self.state == EncoderState::Silent { EncoderState::Agrees } else { self.state };
        *self = Self { state, settling: c.calls_return, ..Self::default() };
    }

    /// One call: measured speed, `None` while the counter is silent; estimated speed and stator frequency.
    #[inline(never)]
    pub fn step(&mut self, c: &HandOverConfig<R>, measured: Option<R>, omega: R, omega_s: R) {
        let held = self.correction.value();
        let (mut target, mut difference) = (R::ZERO, R::ZERO);
        if let Some(measured) = measured {
            difference = measured - omega;
            let within = difference.within(c.band);
            if self.settling == 0 {
                self.judge(c, measured, omega, omega_s, within);
            }
            target = match self.state {
                EncoderState::Agrees if !within => held,
                EncoderState::Agrees | EncoderState::EstimateApart => difference,
                EncoderState::Apart | EncoderState::Silent => R::ZERO,
            };
        } else {
            (self.state, self.apart, self.agreeing) = (EncoderState::Silent, LeakyCounter::default(), 0);
        }
        self.settling = self.settling.saturating_sub(1);
        self.difference.add(c.gain, difference - self.difference.value());
        self.correction.add(c.gain, target - held);
    }

    /// Which of them is right.
    #[inline(always)]
    fn judge(&mut self, c: &HandOverConfig<R>, measured: R, omega: R, omega_s: R, within: bool) {
        if self.state == EncoderState::Silent && within {
            self.state = EncoderState::Agrees;
        }
        if self.apart.step(!within, c.calls_apart) {
            let near = measured.abs().times(FAR_BELOW).max(R::from_f64(NEAR_ZERO));
            let lost = omega_s.within(near) && !measured.within(omega.abs() + c.band.half());
            self.state = if lost { EncoderState::EstimateApart } else { EncoderState::Apart };
            // The verdict of the next 20 ms is one of its own.
            self.apart = LeakyCounter::default();
        }
        if !within {
            self.agreeing = 0;
        } else if self.state == EncoderState::EstimateApart || !measured.within(c.band) {
            self.agreeing = self.agreeing.saturating_add(1);
            if self.agreeing >= c.calls_return {
                self.state = EncoderState::Agrees;
            }
        }
    }

    /// What the speed control adds to the estimated speed.
    #[inline(always)]
    pub fn correction(&self) -> R {
        self.correction.value()
    }

    /// Filtered difference, measured less estimated speed.
    pub fn difference(&self) -> R {
        self.difference.value()
    }

    /// Which of them is right.
    #[inline(always)]
    pub fn state(&self) -> EncoderState {
        self.state
    }

    /// The fault of an encoder that is apart, if that is one.
    #[inline(always)]
    pub fn trip(&self, c: &HandOverConfig<R>) -> Option<Trip<R>> {
        let apart = c.fault && matches!(self.state, EncoderState::Apart | EncoderState::Silent);
        apart.then(|| Trip::new(Fault::EncoderApart, self.difference.value(), c.band))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const C: HandOverConfig<f64> =
        HandOverConfig { band: 0.03, gain: 0.004, calls_apart: 100, calls_return: 1000, control: true, fault: true };

    /// A drive that has settled.
    fn started() -> HandOver<f64> {
        let mut h = HandOver::default();
        assert_eq!(h.state(), EncoderState::Silent);
        h.start(&C);
        calls(&mut h, 1000, 0.0, 0.0, 0.0);
        h
    }

    /// State after so many calls with measured speed, estimated speed and stator frequency.
    fn calls(h: &mut HandOver<f64>, n: u32, measured: f64, omega: f64, omega_s: f64) -> EncoderState {
        for _ in 0..n {
            h.step(&C, Some(measured), omega, omega_s);
        }
        h.state()
    }

    #[test]
    fn the_controlled_speed_is_the_measured_one_while_they_agree() {
        let mut h = started();
        assert_eq!(calls(&mut h, 5000, 0.31, 0.3, 0.33), EncoderState::Agrees);
        assert!((h.correction() - 0.01).abs() < 1e-6 && (h.difference() - 0.01).abs() < 1e-6);
        assert_eq!(h.trip(&C), None);
    }

    #[test]
    fn a_counter_that_stands_reaches_the_controlled_speed_by_no_more_than_the_error_of_the_estimate() {
        for omega in [0.3, -1.0] {
            let mut h = started();
            calls(&mut h, 5000, omega + 0.01, omega, omega);
            let mut least = f64::MAX;
            for k in 0..3000 {
                // As the loop falls to zero.
                let x = 0.0314 * f64::from(k);
                h.step(&C, Some(omega * (1.0 + x) * (-x).exp()), omega, omega);
                least = least.min(h.correction());
            }
            assert!(h.state() == EncoderState::Apart && h.correction().abs() < 1e-5);
            assert!(least > -0.001, "{least}");
            let trip = h.trip(&C).unwrap();
            assert!(trip.cause == Fault::EncoderApart && (trip.value + omega).abs() < 0.01, "{trip:?}");
            assert_eq!(h.trip(&HandOverConfig { fault: false, ..C }), None);
        }
    }

    #[test]
    fn the_encoder_is_blamed_for_standing_and_turning_backwards_and_the_estimate_for_a_shaft_that_leaves_it() {
        for (measured, omega, omega_s, state) in [
            (0.0, 0.05, 0.08, EncoderState::Apart),
            (0.0, 0.04, 0.03, EncoderState::Apart),
            (-0.04, 0.04, 0.03, EncoderState::Apart),
            (0.6, 0.3, 0.33, EncoderState::Apart),
            (-0.1, 0.0, 0.03, EncoderState::EstimateApart),
            (0.1, 0.02, -0.01, EncoderState::EstimateApart),
            (2.3, 0.02, 0.09, EncoderState::EstimateApart),
            (1.2, 0.3, 0.33, EncoderState::Apart),
        ] {
            for sign in [1.0, -1.0] {
                let mut h = started();
                assert_eq!(calls(&mut h, 100, sign * measured, sign * omega, sign * omega_s), EncoderState::Agrees);
                let got = calls(&mut h, 1, sign * measured, sign * omega, sign * omega_s);
                assert_eq!(got, state, "{measured} {omega} {omega_s}");
            }
        }
        // Too many counts at first: the estimate's word counts where the voltage carries the frequency.
        let mut h = started();
        assert_eq!(calls(&mut h, 500, 0.08, 0.04, 0.04), EncoderState::EstimateApart);
        assert_eq!(calls(&mut h, 500, 0.4, 0.2, 0.2), EncoderState::Apart);
    }

    #[test]
    fn a_standstill_proves_nothing_and_a_turning_encoder_comes_back() {
        let mut h = started();
        assert_eq!(calls(&mut h, 200, 0.0, 0.3, 0.3), EncoderState::Apart);
        assert_eq!(calls(&mut h, 100_000, 0.0, 0.0, 0.0), EncoderState::Apart);
        assert_eq!(calls(&mut h, 999, 0.1, 0.1, 0.1), EncoderState::Apart);
        assert_eq!(calls(&mut h, 1, 0.1, 0.1, 0.1), EncoderState::Agrees);
        // A field that was lost and found again: the encoder was never in doubt.
        assert_eq!(calls(&mut h, 200, 0.1, 0.0, 0.0), EncoderState::EstimateApart);
        assert!(h.correction() > 0.03, "beyond the band: {}", h.correction());
        assert_eq!(calls(&mut h, 1000, 0.0, 0.0, 0.0), EncoderState::Agrees);
    }

    #[test]
    fn a_counter_that_falls_silent_leaves_a_sensorless_drive() {
        let mut h = started();
        calls(&mut h, 5000, 0.31, 0.3, 0.3);
        for _ in 0..5000 {
            h.step(&C, None, 0.3, 0.3);
        }
        assert!(h.state() == EncoderState::Silent && h.correction().abs() < 1e-6 && h.trip(&C).is_some());
        // What it shows first is that of a loop that begins.
        assert_eq!(calls(&mut h, 50, 0.0, 0.3, 0.3), EncoderState::Silent);
        assert_eq!(calls(&mut h, 1, 0.3, 0.3, 0.3), EncoderState::Agrees);
    }

    #[test]
    fn a_start_keeps_the_verdict_and_nothing_else() {
        let mut h = started();
        calls(&mut h, 5000, 0.31, 0.3, 0.3);
        calls(&mut h, 105, 0.0, 0.3, 0.3);
        h.start(&C);
        assert_eq!((h.state(), h.correction(), h.difference()), (EncoderState::Apart, 0.0, 0.0));
        // An estimate that settles is none that is wrong, nor is the encoder.
        let mut h = started();
        h.start(&C);
        assert_eq!(calls(&mut h, 1000, 0.3, 0.2, 0.25), EncoderState::Agrees);
        assert_eq!(h.correction(), 0.0);
        assert_eq!(calls(&mut h, 101, 0.3, 0.2, 0.25), EncoderState::Apart);
    }
}
