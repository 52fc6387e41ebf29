//! Supervision: what watches a drive while its bridge switches, one monitor a file.
//!
//! | monitor | finds | every |
//! |---|---|---|
//! | [`plausibility`] | flux off its circle, speed beyond reach, low confidence | fourth period |
//! | [`phases`] | open phase, current that does not follow its reference | fourth period |
//! | [`channels`] | stuck, saturated, inverted current channel | fourth period |
//! | [`innovation`] | a lost field near zero frequency, a flux that collapses there | fourth period |
//! | [`stall`] | torque at its limit, speed not following; a field lost at low speed | fourth period |
//! | [`timing`] | missed and doubled calls | period, if the caller gives a cycle stamp |
//!
//! Measurements themselves are checked in every period by the sequence of the drive. A monitor takes values and returns
//! a [`Trip`]; what follows from it is the drive's. All but the plausibility are the feature `supervision`.

pub mod fault;
pub mod leaky;
pub mod plausibility;

#[cfg(feature = "supervision")]
pub mod channels;
#[cfg(feature = "supervision")]
pub mod innovation;
#[cfg(feature = "supervision")]
pub mod phases;
#[cfg(feature = "supervision")]
pub mod stall;
#[cfg(feature = "supervision")]
pub mod timing;

pub use fault::{Fault, FaultReport, Quantity, Trip};

use crate::scalar::Real;
use crate::space::{Dq, Rotator};
use crate::words::words;
#[cfg(feature = "supervision")]
use channels::{ChannelConfig, Channels};
#[cfg(feature = "supervision")]
use innovation::{Innovation, InnovationConfig};
#[cfg(feature = "supervision")]
use phases::{PhaseConfig, Phases};
use plausibility::{Plausibility, PlausibilityConfig};
#[cfg(feature = "supervision")]
use stall::Stall;
#[cfg(feature = "supervision")]
use timing::Timing;

/// Settings of the monitors.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct SupervisionConfig<R: Real> {
    pub plausibility: PlausibilityConfig<R>,
    #[cfg(feature = "supervision")]
    pub phases: PhaseConfig<R>,
    #[cfg(feature = "supervision")]
    pub channels: ChannelConfig<R>,
    #[cfg(feature = "supervision")]
    pub innovation: InnovationConfig<R>,
    /// Calls without an approach that are a stall; `u32::MAX`: never.
    #[cfg(feature = "supervision")]
    pub stall_calls: u32,
}
words! {
    SupervisionConfig:
    plausibility,
    #[cfg(feature = "supervision")] phases,
    #[cfg(feature = "supervision")] channels,
    #[cfg(feature = "supervision")] innovation,
    #[cfg(feature = "supervision")] stall_calls,
}

/// Currents of a period: what the bridge and its sensors are judged by.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(not(feature = "supervision"), allow(dead_code, reason = "for the monitors of the feature"))]
pub(crate) struct Currents<'a, R: Real> {
    /// Phase currents less their offsets.
    pub i_abc: &'a [R; 3],
    /// Current and its reference in field coordinates, and the direction of the field.
    pub i_dq: &'a Dq<R>,
    pub i_dq_ref: &'a Dq<R>,
    pub field: &'a Rotator<R>,
    /// Stator frequency under control.
    pub omega_s: Option<R>,
}

/// Estimate and references of a period under control.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(not(feature = "supervision"), allow(dead_code, reason = "for the monitors of the feature"))]
pub(crate) struct Tracking<R: Real> {
    /// `|ψ̂_s|` and `ψ*`.
    pub psi_s: R,
    pub psi_ref: R,
    pub omega_m: R,
    pub omega_s: R,
    /// Normalised innovation squared of the filter, and whether the flux of the voltage is less than that of the current.
    pub nis: R,
    pub flux_falls: bool,
    /// Reference of the speed less the estimate, under speed control.
    pub speed_deviation: R,
    /// The torque reference is at its limit, under speed control; `None`: the field is being realigned, or half of the torque is
    /// the limit for a test of it, or the dc link limits the torque.
    pub torque_limited: Option<bool>,
}

/// State of the monitors.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct Supervision<R: Real> {
    plausibility: Plausibility,
    #[cfg(feature = "supervision")]
    phases: Phases<R>,
    #[cfg(feature = "supervision")]
    channels: Channels,
    #[cfg(feature = "supervision")]
    innovation: Innovation<R>,
    #[cfg(feature = "supervision")]
    stall: Stall<R>,
    #[cfg(feature = "supervision")]
    pub timing: Timing,
    #[cfg(not(feature = "supervision"))]
    arithmetic: core::marker::PhantomData<R>,
}

impl<R: Real> Supervision<R> {
    /// Nothing seen yet.
    pub fn new() -> Self {
        Self {
            plausibility: Plausibility::default(),
            #[cfg(feature = "supervision")]
            phases: Phases::default(),
            #[cfg(feature = "supervision")]
            channels: Channels::default(),
            #[cfg(feature = "supervision")]
            innovation: Innovation::default(),
            #[cfg(feature = "supervision")]
            stall: Stall::default(),
            #[cfg(feature = "supervision")]
            timing: Timing::default(),
            #[cfg(not(feature = "supervision"))]
            arithmetic: core::marker::PhantomData,
        }
    }

    /// A start-up begins: what was seen before does not count, but for the calls that were missed.
    pub fn begin(&mut self) {
        #[cfg(feature = "supervision")]
        let timing = self.timing;
        *self = Self::new();
        #[cfg(feature = "supervision")]
        {
            self.timing = timing;
        }
    }

    /// Phases and channels, in the start-up and under control.
    #[inline(always)]
    #[cfg_attr(not(feature = "supervision"), allow(unused_variables, clippy::unused_self))]
    pub fn currents(&mut self, c: &SupervisionConfig<R>, x: &Currents<'_, R>) -> Option<Trip<R>> {
        #[cfg(feature = "supervision")]
        {
            let trip = self.channels.step(&c.channels, x.i_abc);
            trip.or_else(|| self.phases.step(&c.phases, x.i_dq, x.i_dq_ref, x.field, x.omega_s))
        }
        #[cfg(not(feature = "supervision"))]
        None
    }

    /// Estimate and speed under control; `confidence` is asked for if it counts.
    #[inline(always)]
    pub fn tracking(
        &mut self,
        c: &SupervisionConfig<R>,
        x: &Tracking<R>,
        confidence: impl FnOnce() -> R,
    ) -> Option<Trip<R>> {
        let trip = self.plausibility.step(&c.plausibility, (x.psi_s, x.psi_ref), x.omega_m, confidence);
        #[cfg(feature = "supervision")]
        let trip = trip
            .or_else(|| self.innovation.step(&c.innovation, x.nis, x.flux_falls, x.omega_s))
            .or_else(|| self.stall.step(c.stall_calls, x.torque_limited, x.speed_deviation, x.omega_m));
        trip
    }
}

#[cfg(all(test, feature = "supervision"))]
mod tests {
    use super::*;

    #[test]
    fn a_start_forgets_what_was_seen_but_for_the_calls_that_were_missed() {
        let mut supervision = Supervision::<f64>::new();
        for stamp in [1, 2, 4] {
            supervision.timing.step::<f64>(stamp, true);
        }
        let c = InnovationConfig { gain: 0.1, gain_falling: 0.1 };
        supervision.innovation.step(&c, 4.0, false, 0.0);
        let timing = supervision.timing;
        supervision.begin();
        assert_eq!(supervision.innovation, Innovation::default());
        // The stamps go on.
        assert_eq!(supervision.timing, timing);
    }
}
