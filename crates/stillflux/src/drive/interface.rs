//! Inputs and outputs of a drive, per unit ([`crate::base`]); angles in rad.

#[cfg(feature = "encoder")]
use crate::control::handover::EncoderState;
use crate::control::modulator::Duty;
use crate::estimate::flux::FluxEstimate;
use crate::estimate::speed::SpeedEstimate;
#[cfg(feature = "legs")]
use crate::inverter::Legs;
use crate::scalar::{Real, likely};
use crate::space::{AlphaBeta, Dq};
use crate::supervision::Fault;
use crate::words::words;

/// What the drive measures at the start of a period, per unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Measurement<R: Real> {
    /// Phase currents, positive into the machine. With a single shunt its readings: with two legs at the upper rail, with
    /// one, and in the zero vector at the end of the period ([`crate::drive::Drive::pulses`]).
    pub i_abc: [R; 3],
    /// dc-link voltage.
    pub u_dc: R,
}

/// What the encoder of a drive says, per unit.
#[cfg(feature = "encoder")]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct EncoderReading<R: Real> {
    /// Measured speed, in every state of the drive.
    pub omega_m: R,
    /// Measured less estimated speed while the drive runs, with a time constant of 50 ms.
    pub difference: R,
    /// Whether the two agree, and which of them is wrong otherwise.
    pub state: EncoderState,
}

/// What the drive is to do.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub enum Reference<R: Real> {
    /// Gates off.
    #[default]
    Stop,
    /// Speed control, mechanical speed per unit.
    Speed(R),
    /// Torque control, torque per unit.
    Torque(R),
}

impl<R: Real> Reference<R> {
    /// A finite speed or torque reference.
    #[inline]
    pub(super) fn is_admissible(&self) -> bool {
        // A branch for each question: a value that answers both would have to be made first.
        likely(!matches!(self, Self::Stop))
            && match self {
                Self::Stop => false,
                Self::Speed(x) | Self::Torque(x) => likely(x.is_finite()),
            }
    }
}

/// What the drive hands to the modulator's preload registers.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Output<R: Real> {
    /// Duties of the next period, each in [0, 1].
    pub duty: Duty<R>,
    /// `false`: block the bridge at once. A start blocks it for one period where a flux that turns drives the current on.
    pub gates_on: bool,
}

/// State of the sequence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub enum Status {
    /// Gates off, waiting for a reference.
    #[default]
    Stopped,
    /// Reading the current offsets, gates off.
    ReadingOffset,
    /// Building up the flux: at rest along the a-axis, in a shaft that turns where its flux is, which is looked for
    /// before.
    Magnetising,
    /// Under control.
    Running,
    /// Gates off after a fault at `period` (periods since power-up).
    Faulted {
        /// What happened.
        cause: Fault,
        /// Control period in which it happened.
        period: u32,
    },
}

impl Status {
    /// The state as a stable number: 0 stopped, 1 reading offset, 2 magnetising, 3 running, 4 faulted.
    #[must_use]
    pub const fn code(self) -> u32 {
        match self {
            Self::Stopped => 0,
            Self::ReadingOffset => 1,
            Self::Magnetising => 2,
            Self::Running => 3,
            Self::Faulted { .. } => 4,
        }
    }
}

/// What a drive stores at a stop and takes back at a start (the paper's nonvolatile memory).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Memory<R: Real> {
    /// Offset voltage.
    pub u_off: AlphaBeta<R>,
    /// Stator resistance.
    pub r_s: R,
    /// Offsets of the current channels.
    pub i_off: [R; 3],
    /// Error of the inverter model's voltage, relative; 0 in the published scheme.
    pub loss_error: R,
    /// Knee of the inverter model, relative to that of the parameters; 1 in the published scheme.
    pub knee: R,
    /// Leakage inductance, relative to the parameter; 1 in the published scheme.
    pub leakage: R,
    /// Magnetising inductance, reciprocal and relative to the parameter; 1 in the published scheme.
    pub inv_l_m: R,
    /// Differences of the bridge's legs; none in the published scheme, which takes those of the parameters.
    #[cfg(feature = "legs")]
    pub legs: Legs<R>,
}
words!(Memory: u_off, r_s, i_off, loss_error, knee, leakage, inv_l_m, #[cfg(feature = "legs")] legs);

/// Everything the drive estimates, per unit, of the latest period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
#[non_exhaustive]
pub struct Estimate<R: Real> {
    /// Flux estimator outputs.
    pub flux: FluxEstimate<R>,
    /// Speed estimator outputs.
    pub speed: SpeedEstimate<R>,
    /// Trajectory ψ̂_1 of the parallel path.
    pub psi_1: AlphaBeta<R>,
    /// Offset voltage.
    pub u_off: AlphaBeta<R>,
    /// Stator current: measured, less the offsets read at rest and the one that `u_off` stands for.
    pub i_s: AlphaBeta<R>,
    /// Voltage applied between the last two current samples, by the inverter model.
    pub u_s: AlphaBeta<R>,
    /// Current in field coordinates.
    pub i_dq: Dq<R>,
    /// Its reference.
    pub i_dq_ref: Dq<R>,
    /// Flux reference.
    pub psi_ref: R,
    /// Torque `ψ̂_s × i_s`.
    pub torque: R,
    /// Stator resistance (with `r_d`).
    pub r_s: R,
    /// Rotor resistance of the inverse-Γ circuit, which slip and speed are taken from: what the latest start found, with
    /// the warming that `r_s` or the winding's temperature tells, where that is configured, and the saturation of the leakage. That
    /// of the parameters in the published scheme.
    pub r_r: R,
    /// Residual ε of (15); zero in the enhanced scheme.
    pub epsilon: R,
    /// Innovation of the filter, the rotor flux of the current model less that of the voltage model; zero in the
    /// published scheme.
    pub innovation: R,
    /// Normalised innovation squared (NIS): innovation squared over its expected variance, low-passed with the innovation's
    /// sign over one turn of the rated field (20 ms at 50 Hz), so that one that alternates gives less than one that stays.
    /// The expected variance contains allowances: an undisturbed drive has 0.001 to 0.04, above 0.3 the filter assumes a step. Zero in the published scheme.
    pub nis: R,
    /// Standard deviation that the scheme expects of its field angle, rad; π while the drive does not run.
    pub angle_deviation: R,
    /// Confidence in the field angle, 0 to 1; below 0.5 an error of 15° must be expected.
    pub confidence: R,
    /// Part of the gains of the speed controller that a swing has left, 1 without one ([`crate::control::swing`]): the shaft has about
    /// this part of the inertia told.
    pub speed_gain: R,
}
