//! The enhanced scheme: filter ([`crate::estimate::kalman`]), correction of the current sensors' gains
//! ([`crate::estimate::balance`]), flux shift ([`crate::control::shift`]), and start-up.
//!
//! **Start-up**, at standstill or in a rotating machine: [`start_up`].

#[cfg(any(feature = "legs", feature = "restart"))]
mod probe;
mod progress;
mod start_up;

use super::estimators::{CurrentControl, Estimated, Estimators, FieldQuantities, PeriodInput, PeriodOutput, StartUp};
use super::interface::Memory;
use crate::config::{BALANCE_PERIODS, DriveConfig};
#[cfg(feature = "dither")]
use crate::control::dither::Dither;
use crate::control::flux::weight_by_frequency;
use crate::control::shift::FluxShift;
#[cfg(feature = "supervision")]
use crate::control::sides::{self, Sides};
use crate::estimate::balance::Balance;
use crate::estimate::catch::{Catch, Direction, LEAST};
use crate::estimate::kalman::{Filter, Input, Learned};
#[cfg(feature = "modes")]
use crate::estimate::pair::Pair;
use crate::estimate::search::SpeedSearch;
#[cfg(feature = "restart")]
use crate::estimate::slow_turn::SlowTurn;
use crate::estimate::speed::{SpeedConfig, SpeedEstimate, SpeedEstimator};
use crate::inverter::Knee;
#[cfg(feature = "legs")]
use crate::inverter::Legs;
use crate::scalar::Real;
use crate::space::{AlphaBeta, Dq, Rotator};
#[cfg(any(feature = "legs", feature = "restart"))]
use probe::Probe;
use progress::{Progress, Step};

/// Angle up to which the flux may have turned in a pause with its direction still taken as known, rad.
const DIRECTION: f64 = 0.5;
/// Pause up to which its direction is known at any speed, in blocks of the catch of 1 ms: where a load changes the speed of a light shaft
/// by 10 pu/s, the flux is 0.15 rad (at 50 Hz) from where the speed of the stop has turned it.
const PAUSE_BLOCKS: u32 = 10;
/// Frequency by which the speed estimator's loop has to turn faster than the estimated speed before the voltage that is fed forward follows it.
/// An acceleration by a load makes 0.03 to 0.15 pu; with none a light load that drags the flux of a standing field away finds it softer: a
/// drawn drive of 59 kW is lost so in 9 of 24 realisations, with this in 3, as without the loop's frequency.
const AHEAD: f64 = 0.005;
/// Least weight of the flux control in regeneration near zero stator frequency.
const REGENERATING: f64 = 0.12;
/// Stator frequency against the torque up to which the field may be about to pass zero frequency.
const CROSSING: f64 = 0.0025;

/// Part of a free rotor flux that is left after a number of periods, `e⁻ˣ`.
#[inline(never)]
fn remaining<R: Real>(c: &DriveConfig<R>, periods: u32) -> R {
    let x = c.enhanced.decay.periods(periods).min(R::from_f64(10.0));
    let root = (R::ONE + x.quarter() * (R::ONE + x.quarter().half())).recip();
    root * root * root * root
}

/// Angle by which a speed turns within a number of periods, rad.
#[inline(never)]
fn turned_by<R: Real>(c: &DriveConfig<R>, omega: R, periods: u32) -> R {
    (c.enhanced.filter.t_s * omega * R::from_f64(64.0)).periods(periods)
}

/// What a start-up knows of the machine.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
enum Start<R: Real> {
    /// Nothing.
    Unknown,
    /// Nothing, and the last run, or start, may have left a flux. It has decayed in this period of the start-up.
    Decaying(u32),
    /// Its parameters are fresh; the rotor flux that it has if its speed is that of the stop, and how well that tells its direction.
    Fresh(AlphaBeta<R>, Direction<R>),
    /// Its parameters are fresh, and it has no flux.
    Empty,
    /// It has a flux, and the filter follows it.
    Caught,
}

/// State of the estimators.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct EnhancedEstimators<R: Real> {
    filter: Filter<R>,
    balance: Balance<R>,
    #[cfg(feature = "modes")]
    pair: Pair<R>,
    /// Half of the difference of the gains of two current sensors.
    #[cfg(feature = "modes")]
    half_difference: R,
    shift: FluxShift<R>,
    speed_estimator: SpeedEstimator<R>,
    speed: SpeedEstimate<R>,
    search: SpeedSearch<R>,
    #[cfg(feature = "restart")]
    slow_turn: SlowTurn<R>,
    catch: Catch<R>,
    progress: Progress,
    start: Start<R>,
    /// Curve of the inverter model with the knee of the filter.
    knee: Knee<R>,
    /// What a start-up measures at present.
    #[cfg(any(feature = "legs", feature = "restart"))]
    probe: Probe<R>,
    /// Differences of the legs.
    #[cfg(feature = "legs")]
    legs: Legs<R>,
    /// Their comparison has found the machine at rest.
    #[cfg(feature = "legs")]
    at_rest: bool,
    /// The speed search has been repeated, after it contradicted that measurement.
    #[cfg(feature = "legs")]
    searched_again: bool,
    #[cfg(feature = "supervision")]
    sides: Sides<R>,
    /// Magnetising curve when the field last turned: of a flux that has collapsed the filter makes an error of the curve.
    #[cfg(feature = "supervision")]
    curve: (R, R),
    #[cfg(feature = "dither")]
    dither: Dither<R>,
    /// Torque reference, for the next step of the flux shift.
    torque_ref: R,
    /// Rotor resistance at its temperature and at the present saturation, relative to the parameter.
    rotor: R,
}

impl<R: Real> EnhancedEstimators<R> {
    /// Estimators with the priors of the machine's parameters.
    pub fn new(c: &DriveConfig<R>) -> Self {
        Self {
            filter: Filter::new(&c.enhanced.filter),
            balance: Balance::default(),
            #[cfg(feature = "modes")]
            pair: Pair::default(),
            #[cfg(feature = "modes")]
            half_difference: R::ZERO,
            shift: FluxShift::default(),
            speed_estimator: SpeedEstimator::default(),
            speed: SpeedEstimate::default(),
            search: SpeedSearch::new(),
            #[cfg(feature = "restart")]
            slow_turn: SlowTurn::default(),
            catch: Catch::new(AlphaBeta::default()),
            progress: Progress::new(0),
            start: Start::Unknown,
            knee: *c.inverter.nominal(),
            #[cfg(any(feature = "legs", feature = "restart"))]
            probe: Probe::default(),
            #[cfg(feature = "legs")]
            legs: *c.inverter.legs(),
            #[cfg(feature = "legs")]
            at_rest: false,
            #[cfg(feature = "legs")]
            searched_again: false,
            #[cfg(feature = "supervision")]
            sides: Sides::default(),
            #[cfg(feature = "supervision")]
            curve: (R::ONE, R::ZERO),
            #[cfg(feature = "dither")]
            dither: Dither::default(),
            torque_ref: R::ZERO,
            rotor: R::ONE,
        }
    }
}

#[cfg(feature = "supervision")]
impl<R: Real> EnhancedEstimators<R> {
    /// On which side of the current the flux lies, where the field stands ([`crate::control::sides`]).
    #[inline(always)]
    fn find_side(&mut self, c: &DriveConfig<R>) {
        let stands = sides::stands(self.speed.omega_s, self.filter.load_of_late());
        if !stands {
            self.curve = self.filter.magnetising_curve();
        }
        if !stands && self.sides.is_idle() {
            return;
        }
        self.try_sides(c, stands);
    }

    #[cold]
    #[inline(never)]
    fn try_sides(&mut self, c: &DriveConfig<R>, stands: bool) {
        if !(self.sides.is_trying() || stands && sides::is_unknown(self.filter.sigma())) {
            self.sides.interrupt();
            return;
        }
        let x = self.filter.standing_field(&c.enhanced.filter, self.curve, self.speed.omega_m);
        if let Some(turn) = self.sides.step(&c.enhanced.sides, &x) {
            self.filter.turn_flux(&c.enhanced.filter, &turn);
            self.speed_estimator.start(&self.filter.rotor_flux(&c.enhanced.filter), self.speed.omega_m);
        }
    }
}

impl<R: Real> Estimators<R> for EnhancedEstimators<R> {
    fn forget_offset(&mut self, c: &DriveConfig<R>) {
        self.filter.forget_offset(&c.enhanced.filter);
        self.balance.forget_offset();
    }

    fn begin(&mut self, c: &DriveConfig<R>, pause: Option<u32>, periods_blocked: u32) {
        let r = R::from_f64;
        let unknown = match c.enhanced.decay_periods.saturating_sub(periods_blocked) {
            0 => Start::Unknown,
            until => Start::Decaying(until),
        };
        self.start = pause.map_or(unknown, |pause| {
            let mut psi_r = self.filter.rotor_flux(&c.enhanced.filter) * remaining(c, pause);
            // It turns with the rotor, whose speed of the stop is the best guess where nothing is induced.
            let turned = |omega: R| turned_by(c, omega, pause);
            let omega = self.speed.omega_m;
            let within =
                turned(omega.abs().max(r(LEAST))) <= r(DIRECTION) || pause <= PAUSE_BLOCKS * c.enhanced.catch.block;
            let mut angle = turned(omega);
            let direction = match angle.within(r(6.0)) {
                true if within => Direction::Known,
                true if angle.within(r(DIRECTION)) => Direction::IfStanding,
                // A shaft that coasts has turned by some part of this angle.
                true => Direction::IfSteady(omega, angle),
                false => Direction::Unknown,
            };
            angle = angle.limit(r(6.0));
            while !angle.within(R::ZERO) {
                let part = angle.limit(R::HALF);
                angle -= part;
                psi_r = Rotator::default().turned(part).turn(&psi_r);
            }
            Start::Fresh(psi_r, direction)
        });
        self.search = SpeedSearch::new();
        self.progress = Progress::new(c.enhanced.catch.periods_without_current());
        #[cfg(feature = "legs")]
        {
            (self.at_rest, self.searched_again) = (false, false);
        }
        #[cfg(any(feature = "legs", feature = "restart"))]
        {
            self.probe = Probe::default();
        }
        self.shift = FluxShift::default();
        #[cfg(feature = "supervision")]
        {
            self.sides = Sides::default();
        }
        self.torque_ref = R::ZERO;
        self.speed = SpeedEstimate::default();
    }

    #[inline(always)]
    fn period(
        &mut self,
        c: &DriveConfig<R>,
        x: &PeriodInput<'_, R>,
        i_dq_ref: &mut Dq<R>,
        start_up: Option<StartUp>,
    ) -> PeriodOutput<R> {
        // Without flux the filter integrates, but corrects nothing.
        let mut integrate_only = false;
        if start_up.is_some() {
            let (step, stage) = self.progress.advance();
            #[cfg(feature = "legs")]
            if step == Step::Legs {
                // A copy: the input itself then stays in registers.
                let x = *x;
                return self.compare_legs(c, &x, i_dq_ref, stage);
            }
            let (i_s, [i_a, i_b, i_c]) = (x.i_s, x.i_abc);
            self.balance.fit(&c.enhanced.balance, &i_s, i_a + i_b + i_c);
            *i_dq_ref = self.prepare(c, &i_s);
            if (step, stage) == (Step::Catch, 1) {
                // The speed estimator runs in odd periods, and takes less time than what runs in even ones.
                self.filter.align(x.period);
            }
            integrate_only = self.is_searching();
        }
        #[cfg(feature = "supervision")]
        {
            integrate_only |= self.sides.is_trying();
        }
        let i_m = self.balance.remove(&x.i_s);
        let mut omega_s = self.speed.omega_turn;
        let input = Input { u_s: x.u_s, loss: &x.voltage.loss, i_m, i_ref: i_dq_ref, omega_s: self.speed.omega_s };
        let (mut field, mut psi_s, mut i_dq) = self.filter.step(&c.enhanced.filter, &input, integrate_only);
        // What follows from quantities that change slowly takes its turn.
        match x.period % BALANCE_PERIODS {
            4 => {
                let (i_s, [i_a, i_b, i_c]) = (x.i_s, x.i_abc);
                self.balance.fit(&c.enhanced.balance, &i_s, i_a + i_b + i_c);
                if let Some(of_sum) = self.balance.rest().filter(|_| start_up.is_none()) {
                    self.filter.doubt_offset(&c.enhanced.filter, of_sum, i_dq_ref.im());
                }
            }
            #[cfg(feature = "legs")]
            0 => self.knee.set_legs(&self.legs, x.u_dc),
            6 => {
                c.inverter.follow(&mut self.knee, self.filter.knee());
                self.rotor = self.filter.rotor_resistance(&c.enhanced.filter);
            }
            _ => {}
        }
        let (mut complete, mut current_control) = (false, CurrentControl::Continues);
        if start_up.is_some() {
            let (step, stage) = self.progress.now();
            if step == Step::Catch {
                let u_s = x.u_s;
                return PeriodOutput {
                    // Before the period, at the end of which the current may begin to fall.
                    current_control: self.current_control_of_catch(c),
                    field: self.catch_flux(c, &u_s, i_dq_ref.re()),
                    complete: false,
                };
            }
            let i;
            #[cfg(feature = "restart")]
            let loss = x.voltage.loss.vector();
            #[cfg(feature = "restart")]
            self.watch_for_rotation(c, stage, &loss);
            (field, i, complete) = if self.is_searching() {
                #[cfg(feature = "restart")]
                let step = self.search_speed(c, stage, loss.re());
                #[cfg(not(feature = "restart"))]
                let step = self.search_speed(c, stage);
                step
            } else {
                self.build_up(c, stage, x.u_dc)
            };
            if self.follows_flux() {
                current_control = CurrentControl::FollowsFlux;
            }
            i_dq = Dq::new(i.re(), i.im());
            (psi_s, omega_s) = (self.filter.magnitude(), self.speed.omega_s);
            #[cfg(feature = "modes")]
            if c.two_sensors() {
                let repeated = self.progress.has_repeated();
                if self.compare_gains(c, x, i_dq_ref.re(), stage) {
                    i_dq = Dq::new(i_m.re(), i_m.im());
                    complete &= self.progress.has_repeated() == repeated;
                }
            }
        }
        #[cfg(feature = "supervision")]
        if complete {
            self.curve = self.filter.magnetising_curve();
        }
        let r_s = self.filter.r_s();
        PeriodOutput { field: FieldQuantities { field, psi_s, omega_s, r_s, i_dq }, complete, current_control }
    }

    #[cfg(feature = "supervision")]
    #[cold]
    #[inline(never)]
    fn turn_to_current(&mut self, c: &DriveConfig<R>) {
        self.filter.turn_to_current(&c.enhanced.filter);
        self.speed.set_synchronous(self.speed.omega_s);
        self.speed_estimator.start(&self.filter.rotor_flux(&c.enhanced.filter), self.speed.omega_s);
    }

    #[cfg(feature = "restart")]
    #[inline(always)]
    fn blocks(&self, at: StartUp) -> bool {
        at.stage == 2 && self.catch.is_surge()
    }

    fn idle(&mut self, i_s: &AlphaBeta<R>) {
        self.filter.rest(i_s);
    }

    #[inline(never)]
    fn update_speed(&mut self, c: &DriveConfig<R>) {
        let (psi_r, i_s) = (self.filter.rotor_flux(&c.enhanced.filter), self.filter.i_s());
        self.speed = self.speed_estimator.step(&SpeedConfig { r_r: c.speed.r_r * self.rotor, ..c.speed }, &psi_r, &i_s);
        // What the loop turns faster by than the estimated speed is noise where it is little.
        let ahead = self.speed.omega_turn - self.speed.omega_s;
        self.speed.omega_turn = self.speed.omega_s + (ahead - ahead.limit(R::from_f64(AHEAD)));
    }

    #[inline(always)]
    fn adapt(&mut self, c: &DriveConfig<R>, _: &Dq<R>) {
        self.filter.confine(&c.enhanced.filter);
        #[cfg(feature = "supervision")]
        self.find_side(c);
        let of_parameters = [self.filter.leakage(), self.rotor];
        self.shift.step(&c.enhanced.shift, self.speed.omega_m, self.torque_ref, of_parameters);
    }

    #[cfg(feature = "dither")]
    #[inline(always)]
    fn dither(&mut self, c: &DriveConfig<R>, torque: R) -> Option<R> {
        // The trial of a side is judged by a flux that nothing else moves.
        #[cfg(feature = "supervision")]
        if self.sides.is_trying() {
            return None;
        }
        self.dither.step(&c.enhanced.dither, self.speed.omega_s, torque)
    }

    #[inline(always)]
    fn flux_factor(&mut self, _: &DriveConfig<R>, torque: R) -> R {
        self.torque_ref = torque;
        self.shift.factor()
    }

    #[inline(always)]
    fn speed(&self) -> &SpeedEstimate<R> {
        &self.speed
    }

    #[inline(always)]
    fn psi_s(&self) -> R {
        self.filter.magnitude()
    }

    /// `ψ* + w (|ψ̂_s| - ψ*)` with `|ψ̂_s|` limited to 0.5 … 1.5 of `ψ*` and the weight `w` by the variance of
    /// `|ψ̂_s|`; flux control has the weight `w` at every stator frequency, except in regeneration beyond [`CROSSING`]:
    /// there it falls below `|ω_s|` = 0.06 to 0.12 of it, since an error of `r̂_s` appears in `|ψ̂_s|` with the sign
    /// for which flux control is unstable. Not while the flux is shifted: the reference leads over zero frequency then,
    /// within a second, and a flux that does not follow it would stay there.
    ///
    /// The magnetising current without load takes the flux with the weight of flux control. An `i_d` of `ψ/l_s` keeps what there is, and
    /// with an `l_s` a seventh below the real one makes more of it: with the whole of `ψ̂_s` a flux that 0.12 of its control does not
    /// hold rose to 1.4 of rated.
    #[inline(always)]
    fn present_flux(&self, psi_ref: R) -> (R, R, R) {
        let SpeedEstimate { omega_s, omega_r, .. } = self.speed;
        let against = if omega_r < R::ZERO { omega_s } else { -omega_s };
        let regenerating = against > R::from_f64(CROSSING) && self.shift.factor() >= R::ONE;
        let weight = self.filter.magnitude_weight();
        let gain = if regenerating { weight_by_frequency(omega_s).max(R::from_f64(REGENERATING)) } else { R::ONE };
        let apart = weight * (self.filter.magnitude() - psi_ref).limit(psi_ref.half());
        (psi_ref + apart, psi_ref + apart * gain, weight * gain)
    }

    /// `|ψ̂_s|`. A flux below `psi` counts with its full amount: taken too small it costs torque, taken too large the
    /// flux collapses.
    #[inline(always)]
    fn pull_out_flux(&self, psi: R) -> R {
        psi.min(self.filter.magnitude()).max(psi.half())
    }

    #[inline(always)]
    fn inv_leakage(&self) -> Option<R> {
        Some(self.filter.leakage().recip())
    }

    #[inline(always)]
    fn inverter<'a>(&'a self, _: &'a DriveConfig<R>) -> (R, &'a Knee<R>) {
        (R::ONE + self.filter.v(), &self.knee)
    }

    #[cfg(feature = "modes")]
    #[inline(always)]
    fn half_difference(&self) -> R {
        self.half_difference
    }

    #[inline(always)]
    fn nis(&self) -> R {
        self.filter.nis()
    }

    #[inline(always)]
    fn flux_falls(&self) -> bool {
        self.filter.innovation() > R::ZERO
    }

    #[inline(always)]
    fn confidence(&self) -> R {
        self.filter.confidence()
    }

    fn sensed(&self, _: &DriveConfig<R>) -> AlphaBeta<R> {
        let i_m = self.filter.i_s() + self.filter.b();
        // Small as the image is, that of the current with it and that of the current without it are the same.
        i_m + (i_m - self.balance.remove(&i_m))
    }

    /// There is no parallel path; its flux is that of the filter.
    fn estimated(&self, c: &DriveConfig<R>) -> Estimated<R> {
        let f = &self.filter;
        Estimated {
            flux: f.estimate(),
            speed: self.speed,
            psi_1: f.value(),
            u_off: f.b() * -f.r_s(),
            i_s: f.i_s(),
            r_s: f.r_s(),
            r_r: c.speed.r_r * self.rotor,
            epsilon: R::ZERO,
            innovation: f.innovation(),
            nis: f.nis(),
            angle_deviation: f.sigma(),
            confidence: f.confidence(),
        }
    }

    fn memory(&self, _: &DriveConfig<R>, i_off: [R; 3]) -> Memory<R> {
        let Learned { b, r_s, v: loss_error, knee, leakage, gamma: inv_l_m } = self.filter.learned();
        Memory {
            u_off: b * -r_s,
            r_s,
            i_off,
            loss_error,
            knee,
            leakage,
            inv_l_m,
            #[cfg(feature = "legs")]
            legs: self.legs,
        }
    }

    fn restore(&mut self, c: &DriveConfig<R>, memory: &Memory<R>, u_off: AlphaBeta<R>) {
        // The offset of the filter is that beyond the offsets read at standstill: a new reading replaces both.
        let Memory { loss_error: v, knee, leakage, inv_l_m: gamma, .. } = *memory;
        let r_s = Filter::admissible_resistance(&c.enhanced.filter, memory.r_s);
        let b = if c.calibrate_offset { AlphaBeta::default() } else { u_off * -r_s.recip() };
        self.filter.restore(&c.enhanced.filter, &Learned { b, r_s, v, knee, leakage, gamma });
        #[cfg(feature = "legs")]
        {
            self.legs = memory.legs.limited();
        }
        c.inverter.follow(&mut self.knee, self.filter.knee());
    }
}
