//! The two schemes behind one face: what a drive asks of its estimators, whichever they are. A scheme that is left
//! out of the build (feature `paper` or `enhanced`) is a variant that does not exist.

#[cfg(feature = "enhanced")]
mod enhanced;
#[cfg(feature = "paper")]
mod published;

#[cfg(feature = "enhanced")]
pub(crate) use enhanced::{Applied, Enhanced, EnhancedConfig};
#[cfg(feature = "paper")]
pub(crate) use published::{Published, PublishedConfig};

use crate::config::{DriveConfig, Scheme};
use crate::drive::Memory;
use crate::estimate::flux::FluxEstimate;
use crate::scalar::Real;
use crate::space::{AlphaBeta, Dq, Rotator};

/// Largest offset voltage that is taken back, per unit.
const U_OFF_MAX: f64 = 0.05;

/// The estimators of a drive.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
#[allow(clippy::large_enum_variant)]
pub(crate) enum Observer<R: Real> {
    #[cfg(feature = "paper")]
    Published(Published<R>),
    #[cfg(feature = "enhanced")]
    Enhanced(Enhanced<R>),
}

/// What the controllers need in every period.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Seen<R: Real> {
    /// Field angle.
    pub field: Rotator<R>,
    /// `|ψ̂_s|`.
    pub magnitude: R,
    /// Stator resistance.
    pub r_s: R,
    /// Current without the offset that the estimators have found, field coordinates.
    pub i_dq: Dq<R>,
}

/// Slow inputs of what is adapted.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(not(feature = "paper"), allow(dead_code, reason = "the published scheme adapts by them"))]
pub(crate) struct Slow<R: Real> {
    pub i_dq: Dq<R>,
    pub omega_s: R,
    pub omega_m: R,
}

/// What the estimators of the drive's scheme answer: both have the same questions.
macro_rules! ask {
    ($observer:expr, $o:ident => $answer:expr) => {
        match $observer {
            #[cfg(feature = "paper")]
            Observer::Published($o) => $answer,
            #[cfg(feature = "enhanced")]
            Observer::Enhanced($o) => $answer,
        }
    };
}

impl<R: Real> Observer<R> {
    /// Estimators that know the priors: those of the configuration's scheme.
    pub fn new(c: &DriveConfig<R>) -> Self {
        match c.scheme {
            #[cfg(feature = "paper")]
            Scheme::Paper => Self::Published(Published::new(c)),
            #[cfg(feature = "enhanced")]
            Scheme::Enhanced => Self::Enhanced(Enhanced::new(&c.enhanced)),
            // No configuration is made for a scheme that is not there.
            #[cfg(not(feature = "enhanced"))]
            Scheme::Enhanced => Self::Published(Published::new(c)),
            #[cfg(not(feature = "paper"))]
            Scheme::Paper => Self::Enhanced(Enhanced::new(&c.enhanced)),
        }
    }

    /// A current sample without control.
    pub fn rest(&mut self, i_s: &AlphaBeta<R>) {
        ask!(self, o => o.rest(i_s));
    }

    /// Latest current without its offset.
    #[inline(always)]
    pub fn i_s(&self) -> AlphaBeta<R> {
        ask!(self, o => o.i_s())
    }

    /// Stator flux.
    #[inline(always)]
    pub fn psi_s(&self) -> AlphaBeta<R> {
        ask!(self, o => o.psi_s())
    }

    /// `|ψ̂_s|`.
    #[inline(always)]
    pub fn magnitude(&self) -> R {
        ask!(self, o => o.magnitude())
    }

    /// What the inverter model's voltage has to be multiplied by.
    #[inline(always)]
    pub fn loss_gain(&self) -> R {
        ask!(self, o => o.loss_gain())
    }

    /// Flux estimator outputs.
    pub fn flux(&self) -> FluxEstimate<R> {
        ask!(self, o => o.flux())
    }

    /// Stator resistance.
    pub fn r_s(&self) -> R {
        ask!(self, o => o.r_s())
    }

    /// Offset voltage; of a current offset `b` it is `-r_s b`.
    pub fn u_off(&self) -> AlphaBeta<R> {
        ask!(self, o => o.u_off())
    }

    /// Trajectory of the parallel path; the enhanced scheme has none and repeats the flux.
    pub fn psi_1(&self) -> AlphaBeta<R> {
        ask!(self, o => o.psi_1())
    }

    /// Residual: ε of (15), or that of the filter.
    pub fn residual(&self) -> R {
        ask!(self, o => o.residual())
    }

    /// Confidence in the field angle.
    pub fn confidence(&self) -> R {
        ask!(self, o => o.confidence())
    }

    /// Error of the inverter model and reciprocal of the inductance, both relative.
    pub fn learned(&self) -> (R, R) {
        ask!(self, o => o.learned())
    }

    /// Takes back what an earlier run stored.
    pub fn restore(&mut self, c: &DriveConfig<R>, memory: &Memory<R>) {
        let u_off = memory.u_off.limit_components(R::from_f64(U_OFF_MAX));
        ask!(self, o => o.restore(c, memory, u_off));
    }

    /// A start is under way.
    pub fn begin(&mut self) {
        ask!(self, o => o.begin());
    }

    /// Part of the rated flux that the scheme asks for at a speed and a torque reference.
    #[inline(always)]
    pub fn flux_factor(&mut self, c: &DriveConfig<R>, omega_m: R, torque: R) -> R {
        ask!(self, o => o.flux_factor(c, omega_m, torque))
    }

    /// Tells the stator frequency, as often as the speed estimator runs.
    #[inline(always)]
    pub fn follow(&mut self, c: &DriveConfig<R>, omega_s: R) {
        ask!(self, o => o.follow(c, omega_s));
    }

    /// What runs in every fourth period.
    #[inline(always)]
    pub fn adapt(&mut self, c: &DriveConfig<R>, x: &Slow<R>) {
        ask!(self, o => o.adapt(c, x));
    }
}
