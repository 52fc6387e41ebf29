//! Speed, flux and current control of Fig. 3 on the quantities that a scheme estimates, per unit.
//!
//! ```text
//! ψ* = min(κ ψ_N, ψ*_u),    i_q* = T*/ψ,    i_d* by (12) at ψ_0, ψ and i_q*, with the flux controller's correction
//! |T*| ≤ ψ min(0.8 i_q,pull-out(ψ_p), √(i_max² - i_0²), √(i_max² - i_d*²), i_q,u, i_q,δ)
//! ```
//!
//! `ψ` and `ψ_0` (without load) are the fluxes of [`Estimators::present_flux`], `ψ_p` that of [`Estimators::pull_out_flux`] over the leakage relative to
//! the parameters, by which (12) is solved as well; in field weakening it is less by what the flux lags behind its reference beyond
//! 0.15 pu, so that torque gives way to a flux that has to rise. `κ` is that of the flux
//! shift, `ψ*_u` that of field weakening ([`crate::control::weakening`]), `u_max` the largest fundamental voltage: 0.98 of
//! the circle within the hexagon, or with overmodulation 1/0.97 of that circle. The limit
//! keeps 20 % of distance to pull-out. `i_q,u` is the torque current for which there is voltage: where the voltage is
//! at its limit while the drive is motoring it is the one that flows, and a little more so that the limit is felt again
//! as soon as there is voltage. `i_q,δ` is that of the largest load angle in field weakening. The speed controller does not
//! integrate what it limits.

use super::estimators::{Estimators, FieldQuantities};
use super::interface::Reference;
use super::voltage::Voltage;
use crate::config::{DriveConfig, LowConfidence};
use crate::control::current::CurrentController;
use crate::control::flux::{FREQUENCY_HIGH, FluxController, Range};
#[cfg(feature = "encoder")]
use crate::control::handover::{EncoderState, HandOver};
use crate::control::modulator::Duty;
use crate::control::overload::Overload;
use crate::control::ramp::Ramp;
#[cfg(feature = "supervision")]
use crate::control::realign::Realign;
use crate::control::speed::SpeedController;
#[cfg(feature = "supervision")]
use crate::control::swing::Swing;
use crate::control::weakening::{FREE, LAG_ALLOWED, Weakening};
#[cfg(feature = "encoder")]
use crate::estimate::encoder::Encoder;
use crate::estimate::speed::SpeedEstimate;
use crate::inverter::Knee;
use crate::scalar::{Real, likely};
use crate::space::{AlphaBeta, Dq};

/// Part of the largest voltage below which rated flux leaves voltage for any torque current: not yet field weakening.
const NEAR_LIMIT: f64 = 0.6;
/// Torque current, per unit, by which the reference may exceed the one that flows at the voltage limit.
const AHEAD_OF_CURRENT: f64 = 0.1;

/// Part of the range between the torque's limits that counts as being at one of them.
const AT_LIMIT: f64 = 0.01;

/// Controllers, their references, the current that they control, and the voltage that they command.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct Control<R: Real> {
    pub current: CurrentController<R>,
    flux: FluxController<R>,
    weakening: Weakening<R>,
    speed: SpeedController<R>,
    pub i_dq: Dq<R>,
    pub i_dq_ref: Dq<R>,
    pub psi_ref: R,
    /// Torque current for which the current limit leaves room beside `i_d*`.
    i_q_room: R,
    /// Square of the largest current, as the heat of machine and bridge allows it.
    i_max_sq: R,
    /// 1 while the torque is at its upper limit under speed control, -1 at its lower one, else 0.
    pub limited: R,
    ramp: Ramp<R>,
    overload: Overload<R>,
    #[cfg(feature = "supervision")]
    realign: Realign<R>,
    #[cfg(feature = "supervision")]
    swing: Swing<R>,
    pub voltage: Voltage<R>,
    #[cfg(feature = "encoder")]
    pub encoder: Encoder<R>,
    #[cfg(feature = "encoder")]
    pub hand_over: HandOver<R>,
}

impl<R: Real> Control<R> {
    /// Controllers at rest.
    pub fn new() -> Self {
        Self {
            current: CurrentController::default(),
            flux: FluxController::default(),
            weakening: Weakening::default(),
            speed: SpeedController::default(),
            i_dq: Dq::default(),
            i_dq_ref: Dq::default(),
            psi_ref: R::ZERO,
            i_q_room: R::ONE,
            i_max_sq: R::ZERO,
            limited: R::ZERO,
            ramp: Ramp::default(),
            overload: Overload::default(),
            #[cfg(feature = "supervision")]
            realign: Realign::default(),
            #[cfg(feature = "supervision")]
            swing: Swing::default(),
            voltage: Voltage::new(),
            #[cfg(feature = "encoder")]
            encoder: Encoder::default(),
            #[cfg(feature = "encoder")]
            hand_over: HandOver::default(),
        }
    }

    /// A start-up begins, to rated flux: the current controller starts.
    pub fn begin(&mut self, c: &DriveConfig<R>) {
        self.current.start();
        self.weakening.begin(c.flux_control.psi_rated);
        // Those of the run before are not the estimate of this one.
        (self.i_dq, self.i_dq_ref, self.voltage.u_s) = (Dq::default(), Dq::default(), AlphaBeta::default());
    }

    /// The current of a start follows a flux that builds up: the inverter model takes its loss as in field weakening.
    pub fn follow_flux(&mut self) {
        self.weakening.follow_flux();
    }

    /// The start-up is complete: flux and speed controllers start.
    pub fn start(&mut self, c: &DriveConfig<R>, omega_m: R) {
        self.psi_ref = c.flux_control.psi_rated;
        self.flux.start();
        self.weakening.start(c.flux_control.psi_rated);
        self.i_q_room = c.i_q_max;
        if self.i_max_sq == R::ZERO {
            // The first start: later ones go on with the heat of the last run.
            self.i_max_sq = c.i_max_sq;
        }
        self.limited = R::ZERO;
        #[cfg(feature = "supervision")]
        {
            self.realign = Realign::default();
            self.swing = Swing::default();
        }
        #[cfg(feature = "encoder")]
        self.hand_over.start(&c.hand_over);
        self.speed.start(R::ZERO, omega_m);
        self.ramp.start(omega_m);
    }

    /// The encoder's counter, as often as the speed estimator runs and in every state of the drive.
    #[cfg(feature = "encoder")]
    #[inline(always)]
    pub fn track(&mut self, c: &DriveConfig<R>, period: u32) {
        if period & c.speed_mask() == 1
            && let Some(config) = &c.encoder
        {
            self.encoder.step(config, &c.speed);
        }
    }

    /// Comparison of the measured with the estimated speed, after the speed estimator.
    #[cfg(feature = "encoder")]
    #[inline(always)]
    pub fn compare(&mut self, c: &DriveConfig<R>, speed: &SpeedEstimate<R>) {
        if c.encoder.is_some() {
            let measured = (!self.is_silent(c)).then(|| self.encoder.omega());
            self.hand_over.step(&c.hand_over, measured, speed.omega_m, speed.omega_s);
        }
    }

    /// Whether nothing has been read of the encoder for some time.
    #[cfg(feature = "encoder")]
    #[inline(always)]
    pub fn is_silent(&self, c: &DriveConfig<R>) -> bool {
        self.encoder.silent() >= c.hand_over.calls_apart
    }

    /// Speed that is controlled, given the estimated one.
    #[inline(always)]
    #[cfg_attr(not(feature = "encoder"), allow(unused_variables, clippy::unused_self))]
    pub fn controlled_speed(&self, c: &DriveConfig<R>, omega_m: R) -> R {
        #[cfg(feature = "encoder")]
        if c.hand_over.control {
            return omega_m + self.hand_over.correction();
        }
        omega_m
    }

    /// Confidence in the field angle: none against an encoder that turns faster than the estimate.
    #[inline(always)]
    #[cfg_attr(not(feature = "encoder"), allow(clippy::unused_self))]
    pub fn confidence(&self, confidence: impl FnOnce() -> R) -> R {
        #[cfg(feature = "encoder")]
        if self.hand_over.state() == EncoderState::EstimateApart {
            return R::ZERO;
        }
        confidence()
    }

    /// Part of the gains of the speed controller that a swing has left.
    #[inline(always)]
    #[cfg_attr(not(feature = "supervision"), allow(clippy::unused_self))]
    pub fn speed_gain(&self) -> R {
        #[cfg(feature = "supervision")]
        return self.swing.part();
        #[cfg(not(feature = "supervision"))]
        R::ONE
    }

    /// Whether the field has just been realigned, and whether the drive takes torque away to see if it has to be.
    #[inline(always)]
    #[cfg_attr(not(feature = "supervision"), allow(unused_variables, clippy::unused_self))]
    pub fn realigning(&self, c: &DriveConfig<R>) -> (bool, bool) {
        #[cfg(feature = "supervision")]
        return (self.realign.is_settling(&c.realign), self.realign.is_testing(&c.realign));
        #[cfg(not(feature = "supervision"))]
        (false, false)
    }

    /// Heat of machine and bridge.
    pub fn overload(&self) -> [R; 2] {
        self.overload.theta()
    }

    /// Current control: duties for the next period. `inverter`: estimated factor and curve of the inverter model;
    /// `period`: its number, whether the ripple of a leg is computed in it, and whether it is one under control.
    #[inline(always)]
    pub fn duties(
        &mut self,
        c: &DriveConfig<R>,
        x: &FieldQuantities<R>,
        (period, ripple, running): (u32, bool, bool),
        u_dc: R,
        inverter: (R, &Knee<R>),
    ) -> Duty<R> {
        self.i_dq = x.i_dq;
        let i_ref = self.i_dq_ref;
        // The duties act from one to two periods after the sample: references are turned to the middle of that.
        let ahead = x.field.ahead(x.omega_s * c.t_ahead);
        let u_ff = Dq::new(i_ref.re() * x.r_s, i_ref.im() * x.r_s + x.omega_s * x.psi_s);
        let u = self.current.step(&c.current, &i_ref, &self.i_dq, &u_ff, u_dc * c.u_limit);
        let Self { voltage, i_dq, weakening, .. } = self;
        // In a start `omega_s` is not always a frequency.
        let follows = || x.omega_s.within(c.omega_apart) || !running;
        let i_ahead = || ahead.to_stator(&current_ahead(c, weakening, follows, &i_ref, i_dq));
        voltage.command(c, (period, ripple), &ahead.to_stator(&u), i_ahead, u_dc, inverter)
    }

    /// References: flux, torque, i_q* within current limit and pull-out, i_d* of (12).
    // Inlined in floating point, where a call saves and restores registers of the FPU. In fixed point a call takes less flash.
    #[inline(always)]
    pub fn set_references<E: Estimators<R>>(
        &mut self,
        c: &DriveConfig<R>,
        estimators: &mut E,
        reference: &Reference<R>,
        u_dc: R,
    ) {
        if R::FLOATING {
            self.follow_reference(c, estimators, reference, u_dc);
        } else {
            self.follow_reference_by_call(c, estimators, reference, u_dc);
        }
    }

    #[inline(never)]
    fn follow_reference_by_call<E: Estimators<R>>(
        &mut self,
        c: &DriveConfig<R>,
        estimators: &mut E,
        reference: &Reference<R>,
        u_dc: R,
    ) {
        self.follow_reference(c, estimators, reference, u_dc);
    }

    #[inline(always)]
    fn follow_reference<E: Estimators<R>>(
        &mut self,
        c: &DriveConfig<R>,
        estimators: &mut E,
        reference: &Reference<R>,
        u_dc: R,
    ) {
        let speed = *estimators.speed();
        let omega_m = self.controlled_speed(c, speed.omega_m);
        // While the torque is limited the flux is that for all of the torque: a flux for the limited one would keep it limited.
        let torque = if likely(self.limited == R::ZERO) {
            self.i_dq_ref.im() * self.psi_ref
        } else {
            self.limited * c.speed_control.torque_max
        };
        let factor = estimators.flux_factor(c, torque);
        let (u_max, u_sq, psi_rated) = (u_dc * c.u_use, self.current.u_sq(), c.flux_control.psi_rated);
        let psi_weak = self.weakening.most(psi_rated);
        let psi_ref = psi_weak.min(psi_rated * factor);
        self.psi_ref = psi_ref;
        // Torque, pull-out and feedforward by the estimated flux, with the weight that the scheme gives it.
        let (range, (psi, weight), psi_torque, psi_no_load, pull_out);
        if likely(!self.weakening.is_weak(psi_rated)) {
            (psi, psi_no_load, weight) = estimators.present_flux(psi_ref);
            psi_torque = psi;
            pull_out = estimators.pull_out_flux(psi);
            range = if speed.omega_s.within(R::from_f64(FREQUENCY_HIGH)) { Range::Low } else { Range::High };
        } else {
            // At this frequency nothing is known better than the flux that the voltage model integrates. The
            // feedforward is that of the reference, which the flux has to follow.
            (psi, weight) = (c.weakening.at_least(estimators.psi_s()), R::ONE);
            // Near pull-out a flux takes all the current to stay as it is. One that has far to rise gets some of the torque's:
            // with a leakage that is a fifth larger than known the limit above is 0.97 of pull-out.
            let lag = (psi_ref - psi - R::from_f64(LAG_ALLOWED)).max(R::ZERO);
            pull_out = (estimators.pull_out_flux(psi) - lag).max(R::ZERO);
            (psi_torque, psi_no_load) = (psi_ref, psi_ref);
            range = Range::Weakened;
        }
        let inv_leakage = estimators.inv_leakage();
        let mut i_q_max = self.largest_torque_current(c, pull_out, inv_leakage);
        if !likely(!self.weakening.is_weak(psi_rated)) {
            i_q_max = i_q_max.min(c.flux_control.within_load_angle(psi, inv_leakage, self.i_dq_ref.re()));
        }
        let at_limit = u_sq > u_max * u_max;
        if !likely(!at_limit && !self.weakening.limits_torque()) {
            i_q_max = i_q_max.min(self.i_q_by_voltage(c, speed.omega_s, at_limit));
        }
        let mut torque_max = i_q_max * psi;
        if c.low_confidence == LowConfidence::LimitTorque {
            let part = (self.confidence(|| estimators.confidence()) * R::TWO).min(R::ONE);
            torque_max = torque_max.min(c.speed_control.torque_max) * part;
        }
        let (lo, hi) = c.speed_control.limits(torque_max);
        #[cfg(feature = "dclink")]
        let (lo, hi) = c.dclink.limit(u_dc, omega_m, (lo, hi));
        let limited;
        let torque_ref = match *reference {
            Reference::Speed(omega) => {
                let omega = omega.clamp(c.omega_least, c.omega_most);
                let omega = self.ramp.step(&c.ramp, omega, omega_m, self.limited);
                #[cfg(feature = "supervision")]
                if self.realign.step(&c.realign, self.limited, speed.omega_s, speed.omega_r) {
                    estimators.turn_to_current(c);
                }
                #[cfg(feature = "supervision")]
                let (lo, hi) = if self.realign.is_testing(&c.realign) { (lo.half(), hi.half()) } else { (lo, hi) };
                let part = if likely(!self.weakening.is_weak(psi_rated)) {
                    R::ONE
                } else {
                    c.speed_control.part(psi_weak * c.flux_control.inv_psi_rated)
                };
                let part = (part, self.speed_gain());
                let torque = self.speed.step(&c.speed_control, omega, omega_m, part, (lo, hi));
                #[cfg(feature = "supervision")]
                self.swing.step(&c.swing, torque, hi - lo, omega, omega_m);
                let at_limit = (hi - lo).times(AT_LIMIT);
                // Where no torque is allowed there is none that could be lacking.
                limited = if torque >= hi - at_limit {
                    if hi <= lo { R::ZERO } else { R::ONE }
                } else if torque <= lo + at_limit {
                    if hi <= lo { R::ZERO } else { -R::ONE }
                } else {
                    R::ZERO
                };
                torque
            }
            Reference::Torque(torque) => {
                let torque_ref = torque.clamp(lo, hi);
                self.speed.follow(torque_ref, torque, omega_m);
                self.ramp.start(omega_m);
                #[cfg(feature = "supervision")]
                self.realign.without_reference(&c.realign);
                limited = R::ZERO;
                torque_ref
            }
            Reference::Stop => {
                limited = R::ZERO;
                R::ZERO
            }
        };
        self.limited = limited;
        let torque = match estimators.dither(c, torque_ref) {
            None => torque_ref,
            Some(dither) => (torque_ref + dither).clamp(lo, hi),
        };
        let i_q = torque * c.flux_control.reciprocal(psi);
        let i_d = self.flux.step(
            &c.flux_control,
            (psi_torque, psi_no_load, inv_leakage),
            psi_ref - estimators.psi_s(),
            i_q,
            weight,
            range,
        );
        self.i_q_room += (c.i_q_max - self.i_q_room).times(1.0 / 16.0);
        self.i_dq_ref = Dq::new(i_d, i_q);
        if !likely(self.i_dq_ref.norm_sq() <= self.i_max_sq) {
            self.limit_current(c);
        }
    }

    /// Limits by voltage and heat for the next references: the flux at which there is voltage for the torque current that
    /// is wanted, and the largest current.
    #[inline(never)]
    pub fn set_limits<E: Estimators<R>>(&mut self, c: &DriveConfig<R>, estimators: &E, u_dc: R) {
        let i_sq = self.i_dq.norm_sq();
        if let Some(most) = self.overload.step(&c.overload, i_sq, c.i_max_sq) {
            self.i_max_sq = most;
        }
        let (u_max, u_sq) = (u_dc * c.u_use, self.current.u_sq());
        // Nothing to compute where the voltage is far from its limit.
        let near = u_max * R::from_f64(NEAR_LIMIT);
        let psi_rated = c.flux_control.psi_rated;
        if likely(u_sq < near * near) && self.weakening.is_rated(psi_rated) {
            return;
        }
        // The loop of the speed estimator turns at the frequency of the flux also in a ramp of the speed, behind which
        // the estimated speed lags.
        let SpeedEstimate { omega_turn, omega_r, .. } = *estimators.speed();
        let omega = omega_turn - omega_r;
        let most = self.largest_torque_current(c, estimators.pull_out_flux(self.psi_ref), estimators.inv_leakage());
        let i_q = self.speed.demand().limit(c.speed_control.torque_max) * c.flux_control.reciprocal(self.psi_ref);
        let i_q = i_q.limit(most);
        #[cfg(feature = "dclink")]
        let i_q = c.dclink.lasting(i_q, omega);
        let psi = (psi_rated, estimators.psi_s());
        if self.weakening.limit(&c.weakening, omega, i_q, psi, (u_max, u_sq)) {
            self.flux.leave_weakening();
        }
    }

    /// Largest torque current by pull-out, at a flux and a leakage as in [`FluxController::step`], by current limit and heat.
    #[inline(always)]
    fn largest_torque_current(&self, c: &DriveConfig<R>, psi: R, inv_leakage: Option<R>) -> R {
        (c.pull_out_use * inv_leakage.map_or(psi, |x| psi * x)).min(self.i_q_room)
    }

    /// Current references within the current limit, with priority for `i_d*`; the next torque reference is limited to
    /// what is left.
    #[cold]
    #[inline(never)]
    fn limit_current(&mut self, c: &DriveConfig<R>) {
        let (i_dq_ref, room) = within_current(&self.i_dq_ref, self.i_max_sq);
        (self.i_dq_ref, self.i_q_room) = (i_dq_ref, room.min(c.i_q_max));
    }

    /// Largest torque current while the voltage is at its limit, or was of late: braking needs less voltage and is not limited.
    #[cold]
    #[inline(never)]
    fn i_q_by_voltage(&mut self, c: &DriveConfig<R>, omega_s: R, at_limit: bool) -> R {
        let (i_q, i_q_ref) = (self.i_dq.im(), self.i_dq_ref.im());
        let now = if i_q_ref * omega_s <= R::ZERO {
            Some(R::from_f64(FREE))
        } else if at_limit {
            let along = if i_q_ref < R::ZERO { -i_q } else { i_q };
            Some(along.max(R::ZERO) + R::from_f64(AHEAD_OF_CURRENT))
        } else {
            None
        };
        self.weakening.torque_current(&c.weakening, now, c.flux_control.psi_rated)
    }
}

/// A reference within the square of the largest current, and the largest torque current beside its `i_d`, for which a quarter
/// of the current is kept.
fn within_current<R: Real>(i_ref: &Dq<R>, i_max_sq: R) -> (Dq<R>, R) {
    let least = i_max_sq.quarter().quarter();
    let i_d = i_ref.re().limit((i_max_sq - least).sqrt());
    let room = (i_max_sq - i_d * i_d).max(least).sqrt();
    (Dq::new(i_d, i_ref.im().limit(room)), room)
}

/// Current in the middle of the period in which the duties act, by which the inverter model takes its loss: the reference,
/// which is free of noise, where the current follows it closely. An error `δ` of the flux that stands in the stator makes
/// reference and current swing with the stator frequency, and the current follows with a deviation of the part
/// `ω_s/ω_c`. The loss `U` of the bridge has the direction of the current `i`; seen from the stator a part of order
/// `U/(π i)` of that deviation is a direct voltage, which the flux estimate integrates: beyond some frequency `δ` grows. So
/// from `ω_s` = 0.1 `ω_c` on the current itself counts, whose noise does not matter there; within the delay current control
/// corrects a part of its deviation. With the reference an unloaded motor of 250 kW, 87 Hz at 4 kHz, swung at 0.24
/// of rated speed until control was lost, every parameter right.
///
/// In field weakening the current counts at any frequency: without load it is small, so that its deviation from a reference that
/// swings turns it by tens of degrees.
///
/// So it does while the current of a start follows a flux that turns and builds up. An error `δ` of the flux that stands in
/// the stator turns the current by `δ e^(-jωτ)/ψ` against its reference, and the loss `U` of the bridge with it; seen from
/// the stator a part `U δ/2ψ` of that is a direct voltage, which lets `δ` grow within `2ψ/U`. At 160 kW and 4 kHz
/// (`U` = 0.02) that is 30 ms at a tenth of rated flux.
#[inline(always)]
fn current_ahead<R: Real>(
    c: &DriveConfig<R>,
    weakening: &Weakening<R>,
    follows: impl FnOnce() -> bool,
    i_ref: &Dq<R>,
    i_dq: &Dq<R>,
) -> Dq<R> {
    if likely(follows() && weakening.is_rated(c.flux_control.psi_rated)) {
        return *i_ref;
    }
    *i_dq + (*i_ref - *i_dq) * c.part_ahead
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::DriveParams;
    use crate::params::{Inverter, Machine};
    use crate::scalar::Q;

    #[test]
    fn the_inverter_model_takes_the_reference_where_the_current_follows_it_and_the_current_elsewhere() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let c = DriveConfig::<f64>::new(&machine, &inverter, &DriveParams::new(&machine, &inverter)).unwrap();
        let mut weakening = Weakening::default();
        let (i_ref, i) = (Dq::new(0.5, 0.2), Dq::new(0.4, 0.3));
        let at = |weakening: &Weakening<f64>, omega_s: f64| {
            current_ahead(&c, weakening, || omega_s.within(c.omega_apart), &i_ref, &i)
        };
        weakening.start(c.flux_control.psi_rated);
        // A tenth of 300 Hz.
        for omega_s in [0.0, 0.59, -0.59] {
            assert_eq!(at(&weakening, omega_s), i_ref, "{omega_s}");
        }
        let between = i + (i_ref - i) * c.part_ahead;
        assert!(c.part_ahead > 0.2 && c.part_ahead < 0.4);
        for omega_s in [0.61, -0.61, 2.0] {
            assert_eq!(at(&weakening, omega_s), between, "{omega_s}");
        }
        // In the published scheme without field weakening nothing asks for it.
        if cfg!(any(feature = "enhanced", feature = "weakening")) {
            weakening.follow_flux();
            assert_eq!(at(&weakening, 0.0), between, "flux that builds up");
        }
    }

    /// Heat may lower the limit below the direct current that the flux controller asks for.
    fn limits<R: Real>(rounding: f64) {
        let i = |x: f64| R::from_f64(x);
        for most in [0.3, 0.9, 2.5] {
            for (i_d, i_q) in [(0.2, 5.0), (-4.0, -3.0), (1.5, 0.0), (0.0, -3.0), (6.0, 2.0)] {
                let (limited, room) = within_current(&Dq::new(i(i_d), i(i_q)), i(most * most));
                let [d, q, room] = [limited.re(), limited.im(), room].map(R::to_f64);
                assert!(
                    d.hypot(q) < most + rounding && room > 0.25 * most - rounding,
                    "{most}: {i_d}, {i_q} -> {d}, {q}"
                );
                assert!(
                    d * i_d >= 0.0
                        && q * i_q >= 0.0
                        && d.abs() < f64::abs(i_d) + rounding
                        && q.abs() < f64::abs(i_q) + rounding
                );
                assert!((q.abs() - f64::abs(i_q).min(room)).abs() < rounding);
            }
        }
    }

    #[test]
    fn a_current_reference_is_within_its_limit_whatever_its_direct_part_and_keeps_a_quarter_for_the_torque() {
        limits::<f64>(1e-9);
        limits::<f32>(1e-5);
        limits::<Q>(1e-3);
    }
}

#[cfg(all(test, feature = "weakening"))]
mod weakening_tests {
    use super::*;
    use crate::config::DriveParams;
    use crate::drive::estimators::{Estimated, PeriodInput, PeriodOutput, StartUp};
    use crate::drive::interface::Memory;
    use crate::params::{Inverter, Machine};

    /// A scheme that estimates what it is told.
    struct Told {
        speed: SpeedEstimate<f64>,
        psi: f64,
        knee: Knee<f64>,
    }

    impl Estimators<f64> for Told {
        fn forget_offset(&mut self, _: &DriveConfig<f64>) {}
        fn begin(&mut self, _: &DriveConfig<f64>, _: Option<u32>, _: u32) {}
        fn period(
            &mut self,
            _: &DriveConfig<f64>,
            _: &PeriodInput<'_, f64>,
            _: &mut Dq<f64>,
            _: Option<StartUp>,
        ) -> PeriodOutput<f64> {
            unreachable!()
        }
        fn idle(&mut self, _: &AlphaBeta<f64>) {}
        fn update_speed(&mut self, _: &DriveConfig<f64>) {}
        fn adapt(&mut self, _: &DriveConfig<f64>, _: &Dq<f64>) {}
        fn flux_factor(&mut self, _: &DriveConfig<f64>, _: f64) -> f64 {
            1.0
        }
        #[cfg(feature = "supervision")]
        fn turn_to_current(&mut self, _: &DriveConfig<f64>) {}
        fn speed(&self) -> &SpeedEstimate<f64> {
            &self.speed
        }
        fn psi_s(&self) -> f64 {
            self.psi
        }
        fn present_flux(&self, psi_ref: f64) -> (f64, f64, f64) {
            (psi_ref, psi_ref, 1.0)
        }
        fn pull_out_flux(&self, psi: f64) -> f64 {
            psi.min(self.psi).max(0.5 * psi)
        }
        fn inverter<'a>(&'a self, _: &'a DriveConfig<f64>) -> (f64, &'a Knee<f64>) {
            (1.0, &self.knee)
        }
        fn nis(&self) -> f64 {
            0.0
        }
        fn flux_falls(&self) -> bool {
            false
        }
        fn confidence(&self) -> f64 {
            1.0
        }
        fn sensed(&self, _: &DriveConfig<f64>) -> AlphaBeta<f64> {
            unreachable!()
        }
        fn estimated(&self, _: &DriveConfig<f64>) -> Estimated<f64> {
            unreachable!()
        }
        fn memory(&self, _: &DriveConfig<f64>, _: [f64; 3]) -> Memory<f64> {
            unreachable!()
        }
        fn restore(&mut self, _: &DriveConfig<f64>, _: &Memory<f64>, _: AlphaBeta<f64>) {}
    }

    #[test]
    fn in_field_weakening_a_flux_that_falls_takes_the_torque_and_does_not_reverse_it() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let c = DriveConfig::<f64>::new(&machine, &inverter, &DriveParams::new(&machine, &inverter)).unwrap();
        for wanted in [0.5, 0.6, 0.8] {
            let mut control = Control::<f64>::new();
            control.start(&c, 1.5);
            // The frequency at which the voltage makes this flux.
            let omega = 0.97 * 1.65 * c.u_use / wanted;
            let speed = SpeedEstimate { omega_m: omega, omega_s: omega, omega_turn: omega, ..SpeedEstimate::default() };
            let mut estimators = Told { speed, psi: wanted, knee: c.inverter.knee(1.0) };
            control.current.step(&c.current, &Dq::default(), &Dq::default(), &Dq::new(0.0, 0.9), 0.94);
            for _ in 0..200 {
                control.set_limits(&c, &estimators, 1.65);
            }
            for psi in [1.0, 0.5, 0.4, 0.3, 0.2] {
                estimators.psi = psi * wanted;
                for torque in [0.5, -0.5] {
                    control.follow_reference(&c, &mut estimators, &Reference::Torque(torque), 1.65);
                    let i_q = control.i_dq_ref.im();
                    assert!(control.psi_ref < 0.95 && i_q * torque >= 0.0, "{wanted} {psi} {torque}: {i_q}");
                    assert!(psi < 1.0 || i_q != 0.0, "{wanted} {torque}: no torque with the flux that is wanted");
                }
            }
        }
    }
}
