//! The two schemes behind one face: what a drive asks of its estimators, whichever they are.

use crate::config::DriveConfig;
use crate::estimate::balance::Balance;
use crate::estimate::confidence::Confidence;
use crate::estimate::filter::{Filter, FilterConfig, Input};
use crate::estimate::flux::{FluxEstimate, FluxEstimator};
use crate::estimate::resistance::ResistanceEstimator;
use crate::scalar::Real;
use crate::space::{AlphaBeta, Dq, Rotator};

/// The published scheme: Figs. 4, 7, 12, and the confidence model on top.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct Published<R: Real> {
    pub flux: FluxEstimator<R>,
    pub resistance: ResistanceEstimator<R>,
    pub confidence: Confidence<R>,
}

/// The enhanced scheme: one filter, and the balance of the current sensors.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct Enhanced<R: Real> {
    pub filter: Filter<R>,
    pub balance: Balance<R>,
}

/// The estimators of a drive.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
#[allow(clippy::large_enum_variant)]
pub(crate) enum Observer<R: Real> {
    Published(Published<R>),
    Enhanced(Enhanced<R>),
}

/// What the controllers need in every period.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen<R: Real> {
    /// Field angle.
    pub field: Rotator<R>,
    /// `|ψ̂_s|`.
    pub magnitude: R,
    /// Stator resistance.
    pub r_s: R,
    /// Current without the offset that the estimators have found, stator and field coordinates.
    pub i_s: AlphaBeta<R>,
    pub i_dq: Dq<R>,
}

/// A sample and what was applied before it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Applied<R: Real> {
    /// Current vector and sum of the three currents, as measured.
    pub i_s: AlphaBeta<R>,
    pub sum: R,
    /// Voltage between the last two samples, and the part that the inverter model took.
    pub u_s: AlphaBeta<R>,
    pub u_l: AlphaBeta<R>,
}

impl<R: Real> Observer<R> {
    /// Estimators that know the priors: those of the configuration's scheme.
    pub fn new(c: &DriveConfig<R>) -> Self {
        match &c.filter {
            Some(f) => Self::Enhanced(Enhanced { filter: Filter::new(f), balance: Balance::default() }),
            None => {
                let mut resistance = ResistanceEstimator::default();
                resistance.start(c.pu.r_s);
                Self::Published(Published {
                    flux: FluxEstimator::default(),
                    resistance,
                    confidence: Confidence::default(),
                })
            }
        }
    }

    /// Stator flux.
    #[inline(always)]
    pub fn psi_s(&self) -> AlphaBeta<R> {
        match self {
            Self::Published(o) => o.flux.value(),
            Self::Enhanced(o) => o.filter.value(),
        }
    }

    /// `|ψ̂_s|`.
    #[inline(always)]
    pub fn magnitude(&self) -> R {
        match self {
            Self::Published(o) => o.flux.magnitude(),
            Self::Enhanced(o) => o.filter.magnitude(),
        }
    }

    /// What the inverter model's voltage has to be multiplied by.
    #[inline(always)]
    pub fn loss_gain(&self) -> R {
        match self {
            Self::Published(_) => R::ONE,
            Self::Enhanced(o) => R::ONE + o.filter.v(),
        }
    }

    /// Flux estimator outputs.
    pub fn flux(&self) -> FluxEstimate<R> {
        match self {
            Self::Published(o) => o.flux.estimate(),
            Self::Enhanced(o) => o.filter.estimate(),
        }
    }

    /// Stator resistance.
    pub fn r_s(&self) -> R {
        match self {
            Self::Published(o) => o.resistance.r_s(),
            Self::Enhanced(o) => o.filter.r_s(),
        }
    }

    /// Offset voltage; of a current offset `b` it is `-r_s b`.
    pub fn u_off(&self) -> AlphaBeta<R> {
        match self {
            Self::Published(o) => o.flux.offset.u_off(),
            Self::Enhanced(o) => o.filter.b() * -o.filter.r_s(),
        }
    }

    /// Trajectory of the parallel path; the enhanced scheme has none and repeats the flux.
    pub fn psi_1(&self) -> AlphaBeta<R> {
        match self {
            Self::Published(o) => o.flux.offset.psi_1(),
            Self::Enhanced(o) => o.filter.value(),
        }
    }

    /// Residual: ε of (15), or that of the filter.
    pub fn residual(&self) -> R {
        match self {
            Self::Published(o) => o.resistance.epsilon(),
            Self::Enhanced(o) => o.filter.residual(),
        }
    }

    /// Confidence in the field angle.
    pub fn confidence(&self) -> R {
        match self {
            Self::Published(o) => o.confidence.value(),
            Self::Enhanced(o) => o.filter.confidence(),
        }
    }
}

impl<R: Real> Published<R> {
    /// One period under control.
    #[inline(always)]
    pub fn step(&mut self, c: &DriveConfig<R>, i_s: &AlphaBeta<R>, u_s: &AlphaBeta<R>, psi_ref: R) -> Seen<R> {
        let r_s = self.resistance.r_s();
        self.flux.step(&c.flux, u_s, i_s, r_s, psi_ref);
        let field = self.flux.field();
        // What û_off stands for is first of all an offset of the current sensors, û_off = -r_s i_off. The flux
        // estimator has it removed already; control and inverter model get the current without it.
        let i_s = *i_s + self.flux.offset.u_off() * c.inv_r_s;
        Seen { field, magnitude: self.flux.magnitude(), r_s, i_s, i_dq: field.to_field(&i_s) }
    }
}

impl<R: Real> Enhanced<R> {
    /// One period; `blind` while the machine has no flux.
    #[inline(always)]
    pub fn period(
        &mut self,
        f: &FilterConfig<R>,
        c: &DriveConfig<R>,
        x: &Applied<R>,
        i_ref: &Dq<R>,
        omega_s: R,
        blind: bool,
    ) -> Seen<R> {
        let i_m = self.balance.step(&c.balance, &x.i_s, x.sum);
        self.filter.step(f, &Input { u_s: x.u_s, u_l: x.u_l, i_m, i_ref: *i_ref, omega_s }, blind);
        let o = &self.filter;
        Seen { field: o.field(), magnitude: o.magnitude(), r_s: o.r_s(), i_s: o.i_s(), i_dq: o.i_dq() }
    }

    /// The same where instructions do not count.
    #[cold]
    #[inline(never)]
    pub fn step(
        &mut self,
        f: &FilterConfig<R>,
        c: &DriveConfig<R>,
        x: &Applied<R>,
        i_ref: &Dq<R>,
        omega_s: R,
        blind: bool,
    ) -> Seen<R> {
        self.period(f, c, x, i_ref, omega_s, blind)
    }
}

impl<R: Real> Default for Seen<R> {
    fn default() -> Self {
        Self {
            field: Rotator::default(),
            magnitude: R::ZERO,
            r_s: R::ZERO,
            i_s: AlphaBeta::default(),
            i_dq: Dq::default(),
        }
    }
}
