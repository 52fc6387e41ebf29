//! Interface between the estimators of a scheme and the sequence and controllers of a drive. All quantities per unit,
//! angles in rad.

use super::interface::Memory;
use super::voltage::Voltage;
use crate::config::DriveConfig;
use crate::estimate::flux::FluxEstimate;
use crate::estimate::speed::SpeedEstimate;
use crate::inverter::Knee;
use crate::scalar::Real;
use crate::space::{AlphaBeta, Dq, Rotator};

/// Inputs of the estimators in one period.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(
    not(all(feature = "paper", feature = "enhanced", feature = "legs")),
    allow(dead_code, reason = "not every scheme needs all of it")
)]
pub(super) struct PeriodInput<'a, R: Real> {
    /// Phase currents less the offsets read at standstill, and their space vector.
    pub i_abc: [R; 3],
    pub i_s: AlphaBeta<R>,
    /// Voltage applied between the last two samples, and what was commanded last.
    pub u_s: AlphaBeta<R>,
    pub voltage: &'a Voltage<R>,
    /// dc-link voltage.
    pub u_dc: R,
    /// Flux reference in this interval.
    pub psi_ref: R,
    /// Periods since power-up.
    pub period: u32,
}

/// Inputs of current control from the estimators, every period.
#[derive(Clone, Copy, Debug)]
pub(super) struct FieldQuantities<R: Real> {
    /// Field angle as `e^{jδ̂}`.
    pub field: Rotator<R>,
    /// `|ψ̂_s|`.
    pub psi_s: R,
    /// Stator frequency, by which voltage is fed forward: `omega_s psi_s`. In the published scheme the estimated one, which lags behind a
    /// ramp of the speed by `2 dω/dt / ω_n`; in the enhanced scheme that of the speed estimator's loop, which does not. While the flux of a
    /// turning machine is caught, the sign of the voltage that is fed forward.
    pub omega_s: R,
    /// Stator resistance.
    pub r_s: R,
    /// Stator current less the estimated offset, field coordinates.
    pub i_dq: Dq<R>,
}

/// Progress of a start-up: its period, counted from one.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(
    not(all(feature = "paper", feature = "enhanced")),
    allow(dead_code, reason = "not every scheme needs all of it")
)]
pub(super) struct StartUp {
    pub stage: u32,
}

/// What the estimators deliver in one period.
#[derive(Clone, Copy, Debug)]
pub(super) struct PeriodOutput<R: Real> {
    pub field: FieldQuantities<R>,
    /// The start-up is complete: speed and flux control begin with the next period.
    pub complete: bool,
    pub current_control: CurrentControl,
}

/// What a period of a start-up is to current control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(
    not(all(feature = "enhanced", feature = "legs")),
    allow(dead_code, reason = "not every scheme needs all of it")
)]
pub(super) enum CurrentControl {
    /// Like any other.
    Continues,
    /// Its integrators begin anew: at zero current no leg applies the voltage that they would hold.
    BeginsAnew,
    /// The current follows a flux that turns while it builds up: its loss in the bridge is computed from what flows.
    FollowsFlux,
}

/// Estimates of the latest period.
#[derive(Clone, Copy, Debug)]
pub(super) struct Estimated<R: Real> {
    pub flux: FluxEstimate<R>,
    pub speed: SpeedEstimate<R>,
    pub psi_1: AlphaBeta<R>,
    pub u_off: AlphaBeta<R>,
    pub i_s: AlphaBeta<R>,
    pub r_s: R,
    pub r_r: R,
    pub epsilon: R,
    pub innovation: R,
    pub nis: R,
    pub angle_deviation: R,
    pub confidence: R,
}

/// Estimators of a scheme, with its start-up sequence.
pub(super) trait Estimators<R: Real> {
    /// The offsets of the sensors have been read anew: what the last run found beyond the old ones is in them.
    fn forget_offset(&mut self, c: &DriveConfig<R>);

    /// A start-up begins with the next period; `pause`: periods since the drive ran last, if what it learned then is
    /// fresh; `periods_blocked`: those since the bridge switched last.
    fn begin(&mut self, c: &DriveConfig<R>, pause: Option<u32>, periods_blocked: u32);

    /// One period, of the start-up or under control, with the current reference `i_dq_ref` in field coordinates. A
    /// start-up sets its own.
    fn period(
        &mut self,
        c: &DriveConfig<R>,
        x: &PeriodInput<'_, R>,
        i_dq_ref: &mut Dq<R>,
        start_up: Option<StartUp>,
    ) -> PeriodOutput<R>;

    /// Whether the bridge is to be blocked until the next sample, in a period of the start-up.
    #[inline(always)]
    fn blocks(&self, _: StartUp) -> bool {
        false
    }

    /// A current sample with the bridge blocked.
    fn idle(&mut self, i_s: &AlphaBeta<R>);

    /// Speed estimator, as often as [`DriveConfig::speed_periods`] says.
    fn update_speed(&mut self, c: &DriveConfig<R>);

    /// Slow adaptation, as often as [`DriveConfig::adapt_periods`] says.
    fn adapt(&mut self, c: &DriveConfig<R>, i_dq: &Dq<R>);

    /// Part of the rated flux that the scheme asks for at a torque reference, once a run of the speed control.
    fn flux_factor(&mut self, c: &DriveConfig<R>, torque: R) -> R;

    /// What a scheme adds to a torque reference, within the limits, once a run of the speed control (`control::dither`).
    #[inline(always)]
    fn dither(&mut self, _: &DriveConfig<R>, _torque: R) -> Option<R> {
        None
    }

    /// Half of the difference of the gains of two current sensors, as far as it is identified.
    #[inline(always)]
    fn half_difference(&self) -> R {
        R::ZERO
    }

    /// The flux lies along the current, and the shaft turns with the field ([`crate::control::realign`]).
    #[cfg(feature = "supervision")]
    fn turn_to_current(&mut self, c: &DriveConfig<R>);

    /// Speed and frequencies.
    fn speed(&self) -> &SpeedEstimate<R>;

    /// `|ψ̂_s|`.
    fn psi_s(&self) -> R;

    /// At a flux reference: the flux by which the torque current is computed, `|ψ̂_s|` where the scheme takes it as more accurate than
    /// the reference; the flux by which the magnetising current without load is; and the weight of flux control, 0 to 1.
    fn present_flux(&self, psi_ref: R) -> (R, R, R);

    /// Flux that sets the distance to pull-out, given that of [`Estimators::present_flux`].
    fn pull_out_flux(&self, psi: R) -> R;

    /// Leakage inductance of the parameters over the one that is identified, if it is.
    #[inline(always)]
    fn inv_leakage(&self) -> Option<R> {
        None
    }

    /// Factor of the inverter model's voltage, and its curve over the current.
    fn inverter<'a>(&'a self, c: &'a DriveConfig<R>) -> (R, &'a Knee<R>);

    /// Normalised innovation squared; zero where there is no filter.
    fn nis(&self) -> R;

    /// Whether the flux that follows from the voltage is less than that of the current; not where there is no filter.
    fn flux_falls(&self) -> bool;

    /// Confidence in the field angle.
    fn confidence(&self) -> R;

    /// The latest current vector as the sensors have shown it, less the offsets that were read at standstill.
    fn sensed(&self, c: &DriveConfig<R>) -> AlphaBeta<R>;

    /// Everything that is estimated.
    fn estimated(&self, c: &DriveConfig<R>) -> Estimated<R>;

    /// Data to be kept over a stop, with the offsets `i_off` read at standstill.
    fn memory(&self, c: &DriveConfig<R>, i_off: [R; 3]) -> Memory<R>;

    /// Restores what an earlier run stored; `u_off` is that of `memory`, limited.
    fn restore(&mut self, c: &DriveConfig<R>, memory: &Memory<R>, u_off: AlphaBeta<R>);
}
