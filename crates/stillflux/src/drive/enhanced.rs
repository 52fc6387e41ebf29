//! The enhanced scheme: filter ([`crate::estimate::kalman`]), correction of the current sensors' gains
//! ([`crate::estimate::balance`]), flux shift ([`crate::control::shift`]), and start-up.
//!
//! **Start-up**, at standstill or in a rotating machine (flying start). It begins with 8 ms without current, in which a
//! flux that turns is found by the voltage that it induces ([`super::catch`]). With one, and after a stop of less than
//! `fresh_time` also without, the filter follows the flux from then on, the largest current builds it up to rated, and
//! control begins: what was identified is fresh. A flux of the stop that induces nothing has the direction of the stop,
//! turned by the speed then, after a pause within which a slow shaft cannot have turned it elsewhere, or where the shaft
//! stood. Else its direction is not known: the current stays at zero until it has decayed, or induces a voltage.
//! Otherwise:
//!
//! 1. The current alternates along the three axes, 0.2 s at 10 kHz, which shows how the legs of the bridge differ
//!    ([`crate::estimate::legs`]), and whether the machine is at rest. In a machine that certainly rotates it ends
//!    after a third, and the start-up begins again, since the flux that is left turns. Without `identify_legs` this is left
//!    out.
//! 2. Speed search ([`crate::estimate::search`]), 10 ms, longer in large machines at rest. A current along the a-axis
//!    builds up `ψ_R`, which the rotor turns. The filter integrates without corrections.
//! 3. Rotating: the current follows the direction of `ψ̂_R` for the time in which the boosted current builds up rated
//!    flux, then control begins. If `|ψ̂_s|` is below half of rated then, the rotation is rejected: the voltage error
//!    of the inverter model was taken for a rotation, and the start-up goes on as at standstill.
//! 4. Standstill: the current keeps its direction, since a current that follows an estimate with an error of the angle
//!    makes torque on a free shaft. After 9/16 of the magnetisation time the filter is initialised at the settled flux.
//!    From then on it identifies resistance, `v` and knee, which two reduced currents separate: 0.7 of the magnetising
//!    current for 1/16 and 0.4 for 3/16 of the time. The boosted current then brings the flux back, and at the end the
//!    filter is told that it is where it was ([`Filter::settle_again`]): how the flux fell and rose meanwhile depends on
//!    `r_R`, where it ends does not, and the integral of `u - r_s i` over the whole is known. Without this the error of
//!    `r̂_s` is as large as half of that of `r_R`. With two current sensors the reduced currents also show the difference
//!    of their gains ([`crate::estimate::pair`]); where it is a new one the last three quarters are repeated, since
//!    everything identified in them was falsified by it.
//!
//! A machine that begins to turn during a pause with its flux left, below 0.06 pu, is not covered.

use super::estimators::{Estimated, Estimators, FieldQuantities, PeriodInput, PeriodOutput, StartUp};
use super::interface::Memory;
use crate::config::{BALANCE_PERIODS, BOOST, DriveConfig, REDUCED, SMALL, SPEED_PERIODS};
use crate::control::flux::weight_by_frequency;
use crate::control::shift::FluxShift;
use crate::estimate::balance::Balance;
use crate::estimate::catch::{BLOCKS, Catch, Found, LEAST};
use crate::estimate::kalman::{Filter, Input, Learned};
#[cfg(feature = "legs")]
use crate::estimate::legs::{Alternation, LegsProbe};
#[cfg(feature = "modes")]
use crate::estimate::pair::{HALF_MAX, Pair};
#[cfg(feature = "legs")]
use crate::estimate::search::ROTATING;
use crate::estimate::search::SpeedSearch;
use crate::estimate::speed::{SpeedConfig, SpeedEstimate, SpeedEstimator};
use crate::inverter::Knee;
#[cfg(feature = "legs")]
use crate::inverter::Legs;
use crate::scalar::{Real, likely};
use crate::space::{AlphaBeta, Dq, Rotator};

/// Speed from which on the speed search prevails over a comparison of the legs that has found the machine at rest.
/// Allowance: what a search at rest takes for a rotation is below it.
#[cfg(feature = "legs")]
const PREVAILS: f64 = 0.1;
/// Flux of the stop, less its decay, below which a machine in which nothing is induced is taken as one without.
const RESIDUAL: f64 = 0.15;
/// Largest uncertainty of its direction, rad, and speed of the stop of a shaft that is taken as one that is held.
const DIRECTION: f64 = 0.5;
const STANDING: f64 = 0.035;
/// Rotor flux, relative to rated stator flux, with which control begins.
const BUILT_UP: f64 = 0.85;
/// Least weight of the flux control in regeneration near zero stator frequency.
const REGENERATING: f64 = 0.12;
/// Stator frequency against the torque up to which the flux shift must be able to lower the flux: it leads over zero.
const CROSSING: f64 = 0.0025;
/// Difference of the gains of two current sensors below which nothing is repeated.
#[cfg(feature = "modes")]
const KNOWN_DIFFERENCE: f64 = 1e-3;

/// What a start-up knows of the machine.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
enum Start<R: Real> {
    /// Nothing.
    Unknown,
    /// Its parameters are fresh; the rotor flux that it has if its speed is that of the stop, and whether that tells its
    /// direction.
    Fresh(AlphaBeta<R>, bool),
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
    /// Periods by which the start-up has gone back after such a difference was found.
    #[cfg(feature = "modes")]
    gone_back: u32,
    shift: FluxShift<R>,
    speed_estimator: SpeedEstimator<R>,
    speed: SpeedEstimate<R>,
    search: SpeedSearch<R>,
    catch: Catch<R>,
    /// Periods that it takes.
    catch_periods: u32,
    start: Start<R>,
    /// Curve of the inverter model with the knee of the filter.
    knee: Knee<R>,
    /// Differences of the legs, and their measurement in a start-up.
    #[cfg(feature = "legs")]
    legs: Legs<R>,
    #[cfg(feature = "legs")]
    legs_probe: LegsProbe<R>,
    /// That measurement has found the machine at rest.
    #[cfg(feature = "legs")]
    at_rest: bool,
    /// Its present period, while it is under way.
    #[cfg(feature = "legs")]
    alternation: Option<u32>,
    /// Periods by which it has delayed the start-up.
    #[cfg(feature = "legs")]
    put_off: u32,
    /// Torque reference, for the next step of the flux shift.
    torque_ref: R,
    /// Rotor resistance at its temperature, relative to the parameter.
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
            #[cfg(feature = "modes")]
            gone_back: 0,
            shift: FluxShift::default(),
            speed_estimator: SpeedEstimator::default(),
            speed: SpeedEstimate::default(),
            search: SpeedSearch::new(),
            catch: Catch::new(AlphaBeta::default()),
            catch_periods: 0,
            start: Start::Unknown,
            knee: *c.inverter.nominal(),
            #[cfg(feature = "legs")]
            legs: *c.inverter.legs(),
            #[cfg(feature = "legs")]
            legs_probe: LegsProbe::default(),
            #[cfg(feature = "legs")]
            at_rest: false,
            #[cfg(feature = "legs")]
            alternation: None,
            #[cfg(feature = "legs")]
            put_off: 0,
            torque_ref: R::ZERO,
            rotor: R::ONE,
        }
    }

    /// Before the estimation of a start-up period: its current reference, and initialisation of the filter.
    #[cold]
    #[inline(never)]
    fn prepare(&mut self, c: &DriveConfig<R>, i_s: &AlphaBeta<R>, stage: u32) -> Dq<R> {
        if stage <= 1 {
            self.filter.start(&c.enhanced.filter, i_s);
            self.catch = Catch::new(self.filter.i_s());
            self.catch_periods = c.enhanced.catch.block * BLOCKS;
        }
        if stage <= self.catch_periods {
            return Dq::default();
        }
        let stage = stage - self.catch_periods;
        if matches!(self.start, Start::Caught | Start::Empty) {
            if self.start == Start::Empty && stage <= 1 {
                self.filter.start(&c.enhanced.filter, i_s);
            }
            // The search is made for the boosted current.
            let searching = self.start == Start::Empty && self.search.is_searching();
            return if searching { c.magnetising_current(stage) } else { Dq::new(c.i_quick, R::ZERO) };
        }
        let mut i_ref = c.magnetising_current(stage);
        // The voltage of the resistance is proportional to the current, that of the inverter is not.
        if !self.search.found_rotation() {
            let sixteenth = (c.magnetise_periods / 16).max(1);
            let recovering = stage < 13 * sixteenth + c.enhanced.recovery_periods;
            i_ref = i_ref
                * R::from_f64(match stage / sixteenth {
                    9 => REDUCED,
                    10..=12 => SMALL,
                    13..=15 if recovering => BOOST,
                    _ => 1.0,
                });
        }
        if stage <= 1 {
            self.filter.start(&c.enhanced.filter, i_s);
        } else if !self.search.found_rotation() {
            // At standstill the settled flux follows from the current.
            if stage == c.magnetise_periods / 16 * 9 {
                self.filter.settle(&c.enhanced.filter, c.flux_control.psi_rated);
                self.speed_estimator.start(&self.filter.rotor_flux(&c.enhanced.filter), R::ZERO);
            } else if stage == c.magnetise_periods {
                self.filter.settle_again(&c.enhanced.filter, c.flux_control.psi_rated);
            }
        }
        i_ref
    }

    /// A period without current: the flux that the machine has, and at the end what the start-up goes on with.
    #[cold]
    #[inline(never)]
    fn catch_flux(&mut self, c: &DriveConfig<R>, u_s: &AlphaBeta<R>, stage: u32) -> FieldQuantities<R> {
        let (filter, config) = (&mut self.filter, &c.enhanced.filter);
        let (i_s, psi_r) = (filter.i_s(), filter.rotor_flux(config));
        let (field, psi_s) = self.catch.step(&c.enhanced.catch, stage, (u_s, i_s, psi_r));
        if stage == self.catch_periods {
            let block = c.enhanced.catch.block;
            let least = R::from_f64(RESIDUAL * RESIDUAL);
            let kept = match self.start {
                Start::Fresh(psi_r, directed) if psi_r.norm_sq() > least => Some((psi_r, directed)),
                _ => None,
            };
            let flux = match (self.catch.found(&c.enhanced.catch, kept), kept) {
                (Found::Flux(psi_r, omega), _) => Some((psi_r, omega)),
                (Found::Nothing, Some((psi_r, true))) => Some((psi_r, R::ZERO)),
                (Found::Nothing, None) => None,
                (Found::Uncertain, _) | (Found::Nothing, Some(_)) => {
                    self.catch_periods += block;
                    if let Some((psi_r, directed)) = kept {
                        let decay = (c.enhanced.decay.periods(block)).min(R::HALF);
                        self.start = Start::Fresh(psi_r * (R::ONE - decay), directed);
                    }
                    return FieldQuantities { field, psi_s, omega_s: R::ONE, r_s: R::ZERO, i_dq: field.to_field(&i_s) };
                }
            };
            self.start = match (flux, self.start) {
                (Some((psi_r, omega)), _) => {
                    filter.catch(config, psi_r, &i_s);
                    self.speed_estimator.start(&psi_r, omega);
                    (self.speed.omega_m, self.speed.omega_s) = (omega, omega);
                    Start::Caught
                }
                (None, Start::Fresh(..)) => Start::Empty,
                _ => {
                    #[cfg(feature = "legs")]
                    {
                        self.alternation = (c.enhanced.legs.is_on() && self.put_off == 0).then_some(0);
                    }
                    Start::Unknown
                }
            };
        }
        FieldQuantities { field, psi_s, omega_s: R::ONE, r_s: R::ZERO, i_dq: field.to_field(&i_s) }
    }

    /// After it: the speed, the direction that the current takes with the current in its coordinates, and whether the
    /// flux has built up.
    #[cold]
    #[inline(never)]
    fn build_up(&mut self, c: &DriveConfig<R>, at: StartUp) -> (Rotator<R>, Dq<R>, bool) {
        let searching = self.start != Start::Caught && self.search.is_searching();
        if !searching && at.stage.is_multiple_of(SPEED_PERIODS) {
            self.update_speed(c);
        }
        let i_s = self.filter.i_s();
        let psi_r = self.filter.rotor_flux(&c.enhanced.filter);
        let (mut field, mut periods) = (Rotator::default(), c.magnetise_periods);
        if searching {
            let (r_r, before) = (c.speed.r_r * self.rotor, self.speed.psi_r);
            self.speed.psi_r = psi_r;
            #[cfg_attr(not(feature = "legs"), allow(unused_mut))]
            if let Some(mut omega) = self.search.step(&c.enhanced.search, at.stage, r_r, (before, psi_r), &i_s) {
                #[cfg(feature = "legs")]
                if self.at_rest {
                    if omega.within(R::from_f64(PREVAILS)) {
                        // The comparison of the legs has seen it for far longer.
                        self.search.reject();
                        omega = R::ZERO;
                    } else {
                        // At a few speeds its mean passes zero, and what it found then are no legs.
                        self.legs = *c.inverter.legs();
                    }
                }
                self.speed_estimator.start(&psi_r, omega);
                (self.speed.omega_m, self.speed.omega_s) = (omega, omega);
            }
        } else if matches!(self.start, Start::Caught | Start::Empty) {
            if self.start == Start::Caught || self.search.found_rotation() {
                field = Rotator::of(&psi_r).0;
            }
            // That of the rotor: the leakage flux of the largest current, up to a quarter of rated, goes with it.
            let enough = c.flux_control.psi_rated * R::from_f64(BUILT_UP);
            let built_up = psi_r.norm_sq() >= enough * enough;
            if at.stage >= c.boost_periods && self.filter.magnitude() < c.flux_control.psi_rated.half() {
                // No flux after the time that it takes: nothing that was assumed holds.
                self.search.reject();
                self.start = Start::Unknown;
                return (Rotator::default(), Rotator::default().to_field(&i_s), false);
            }
            return (field, field.to_field(&i_s), built_up || at.stage >= c.boost_periods);
        } else if self.search.found_rotation() {
            field = Rotator::of(&psi_r).0;
            periods = c.boost_periods;
            // Without flux by then the current did not follow it: the rotation was an error of the voltage.
            if at.stage >= periods && self.filter.magnitude() < c.flux_control.psi_rated.half() {
                self.search.reject();
                periods = c.magnetise_periods;
            }
        }
        (field, field.to_field(&i_s), at.stage >= periods)
    }

    /// Gains of two current sensors, in the last three quarters of the magnetisation at standstill; whether this is a
    /// period of them. The current is controlled without the filter's offset then: as that moves, the flux would.
    #[cfg(feature = "modes")]
    #[cold]
    #[inline(never)]
    fn compare_gains(&mut self, c: &DriveConfig<R>, x: &PeriodInput<'_, R>, i_ref: R, stage: u32) -> bool {
        let begin = c.magnetise_periods / 2;
        if stage <= begin / 2 || self.start != Start::Unknown || self.search.found_rotation() {
            self.pair = Pair::default();
            return false;
        }
        let by_knee = x.u_loss.by_knee();
        let u = x.u_s.re() + by_knee[1].abs() + by_knee[2].abs();
        self.pair.add(c.enhanced.pair_weight, [i_ref, u, x.u_s.im()], stage > begin);
        // Once in a start: what the repetition identifies is right for this difference.
        if stage == c.magnetise_periods && self.gone_back == 0 {
            let left = self.pair.difference();
            if !left.within(R::from_f64(KNOWN_DIFFERENCE)) {
                self.half_difference = (self.half_difference + left.half()).limit(R::from_f64(HALF_MAX));
                self.gone_back = c.magnetise_periods - begin / 2;
                self.pair = Pair::default();
            }
        }
        true
    }

    /// One period of the comparison of the legs; after the last one the start-up goes on with the speed search.
    #[cfg(feature = "legs")]
    #[cold]
    #[inline(never)]
    fn compare_legs(
        &mut self,
        c: &DriveConfig<R>,
        x: &PeriodInput<'_, R>,
        i_dq_ref: &mut Dq<R>,
        period: u32,
    ) -> PeriodOutput<R> {
        let config = &c.enhanced.legs;
        let i_s = self.balance.remove(&x.i_s);
        self.filter.rest(&i_s);
        let i = c.magnetising_current(0).re();
        let [i_a, i_b, i_c] = x.i_abc;
        let Alternation { axis, part } = self.legs_probe.step(config, period, &x.u_s, &i_s, i_a + i_b + i_c);
        *i_dq_ref = Dq::new(i * part, R::ZERO);
        self.alternation = Some(period + 1);
        self.put_off += 1;
        let [all, first] = config.periods();
        if period + 1 == first && self.legs_probe.rotates() {
            self.alternation = None;
            // The flux that the alternation has left turns with the shaft: the start-up begins again and catches it.
            self.put_off += self.catch_periods;
        } else if period + 1 == all {
            self.at_rest = self.legs_probe.is_at_rest(R::from_f64(ROTATING));
            if self.at_rest {
                self.legs = self.legs_probe.result(config, &self.legs, &self.balance, i, x.u_dc);
                self.knee.set_legs(&self.legs, x.u_dc);
            }
            self.alternation = None;
        }
        let field = FieldQuantities {
            field: axis,
            psi_s: R::ZERO,
            omega_s: R::ZERO,
            r_s: config.resistance(),
            i_dq: axis.to_field(&i_s),
        };
        PeriodOutput { field, complete: false }
    }
}

impl<R: Real> Estimators<R> for EnhancedEstimators<R> {
    fn begin(&mut self, c: &DriveConfig<R>, pause: Option<u32>) {
        let r = R::from_f64;
        self.start = pause.map_or(Start::Unknown, |pause| {
            // A free rotor flux decays, by e⁻ˣ.
            let x = c.enhanced.decay.periods(pause).min(r(10.0));
            let root = (R::ONE + x.quarter() * (R::ONE + x.quarter().half())).recip();
            let mut psi_r = self.filter.rotor_flux(&c.enhanced.filter) * (root * root * root * root);
            // It turns with the rotor, whose speed of the stop is the best guess where nothing is induced.
            let turned = |omega: R| (c.t_s * omega * r(64.0)).periods(pause);
            let omega = self.speed.omega_m;
            let within = turned(r(LEAST)) <= psi_r.norm_sq().sqrt() * r(DIRECTION);
            let mut angle = turned(omega);
            let directed = angle.within(r(6.0)) && (within || omega.within(r(STANDING)));
            angle = angle.limit(r(6.0));
            while !angle.within(R::ZERO) {
                let part = angle.limit(R::HALF);
                angle -= part;
                psi_r = Rotator::default().turned(part).to_stator(&Dq::new(psi_r.re(), psi_r.im()));
            }
            Start::Fresh(psi_r, directed)
        });
        self.search = SpeedSearch::new();
        #[cfg(feature = "modes")]
        {
            self.gone_back = 0;
        }
        #[cfg(feature = "legs")]
        {
            (self.alternation, self.put_off, self.at_rest) = (None, 0, false);
            self.legs_probe = LegsProbe::default();
        }
        self.shift = FluxShift::default();
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
        let mut blind = false;
        #[cfg(feature = "legs")]
        if let (Some(_), Some(period)) = (start_up, self.alternation) {
            // A copy: the input itself then stays in registers.
            let x = *x;
            return self.compare_legs(c, &x, i_dq_ref, period);
        }
        #[cfg(feature = "legs")]
        let start_up = start_up.map(|at| StartUp { stage: at.stage - self.put_off });
        #[cfg(feature = "modes")]
        let start_up = start_up.map(|at| StartUp { stage: at.stage - self.gone_back });
        if let Some(at) = start_up {
            let i_s = x.i_s;
            *i_dq_ref = self.prepare(c, &i_s, at.stage);
            if at.stage <= 1 {
                // The speed estimator runs in odd periods, and takes less time than what runs in even ones.
                self.filter.align(x.period);
            }
            blind = self.start != Start::Caught && self.search.is_searching();
        }
        let i_ref = *i_dq_ref;
        let i_m = self.balance.remove(&x.i_s);
        let input = Input { u_s: x.u_s, loss: x.u_loss, i_m, i_ref, omega_s: self.speed.omega_s };
        let mut i_dq = self.filter.step(&c.enhanced.filter, &input, blind);
        // What follows from quantities that change slowly takes its turn.
        match x.period % BALANCE_PERIODS {
            4 => {
                let (i_s, [i_a, i_b, i_c]) = (x.i_s, x.i_abc);
                self.balance.fit(&c.enhanced.balance, &i_s, i_a + i_b + i_c);
            }
            #[cfg(feature = "legs")]
            0 => self.knee.set_legs(&self.legs, x.u_dc),
            6 => {
                c.inverter.follow(&mut self.knee, self.filter.knee());
                if !likely(!c.enhanced.filter.follows_temperature()) {
                    self.rotor = self.filter.rotor_resistance(&c.enhanced.filter);
                }
            }
            _ => {}
        }
        let (mut field, mut complete) = (self.filter.field(), false);
        if let Some(at) = start_up {
            let catch_periods = self.catch_periods;
            if at.stage <= catch_periods {
                let u_s = x.u_s;
                return PeriodOutput { field: self.catch_flux(c, &u_s, at.stage), complete: false };
            }
            let i;
            (field, i, complete) = self.build_up(c, StartUp { stage: at.stage - catch_periods });
            i_dq = Dq::new(i.re(), i.im());
            #[cfg(feature = "modes")]
            if c.two_sensors() {
                let gone_back = self.gone_back;
                if self.compare_gains(c, x, i_ref.re(), at.stage - catch_periods) {
                    i_dq = Dq::new(i_m.re(), i_m.im());
                    complete &= self.gone_back == gone_back;
                }
            }
        }
        let (psi_s, omega_s, r_s) = (self.filter.magnitude(), self.speed.omega_s, self.filter.r_s());
        PeriodOutput { field: FieldQuantities { field, psi_s, omega_s, r_s, i_dq }, complete }
    }

    fn idle(&mut self, i_s: &AlphaBeta<R>) {
        self.filter.rest(i_s);
    }

    #[inline(never)]
    fn update_speed(&mut self, c: &DriveConfig<R>) {
        let (psi_r, i_s) = (self.filter.rotor_flux(&c.enhanced.filter), self.filter.i_s());
        self.speed = self.speed_estimator.step(&SpeedConfig { r_r: c.speed.r_r * self.rotor, ..c.speed }, &psi_r, &i_s);
    }

    #[inline(always)]
    fn adapt(&mut self, c: &DriveConfig<R>, _: &Dq<R>) {
        self.filter.confine(&c.enhanced.filter);
        let of_parameters = [self.filter.leakage(), self.rotor];
        self.shift.step(&c.enhanced.shift, self.speed.omega_m, self.torque_ref, of_parameters);
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
    /// for which flux control is unstable.
    #[inline(always)]
    fn present_flux(&self, psi_ref: R) -> (R, R) {
        let SpeedEstimate { omega_s, omega_r, .. } = self.speed;
        let against = if omega_r < R::ZERO { omega_s } else { -omega_s };
        let regenerating = against > R::from_f64(CROSSING);
        let weight = self.filter.magnitude_weight();
        let gain = if regenerating { weight_by_frequency(omega_s).max(R::from_f64(REGENERATING)) } else { R::ONE };
        let psi = self.filter.magnitude().clamp(psi_ref.half(), psi_ref * R::from_f64(1.5));
        (psi_ref + weight * (psi - psi_ref), weight * gain)
    }

    /// `|ψ̂_s|` over the relative leakage. A flux below `psi` counts with its full amount: taken too small it costs
    /// torque, taken too large the flux collapses.
    #[inline(always)]
    fn pull_out_flux(&self, psi: R) -> R {
        psi.min(self.filter.magnitude()).max(psi.half()) * self.filter.leakage().recip()
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
    fn confidence(&self) -> R {
        self.filter.confidence()
    }

    /// There is no parallel path; its flux is that of the filter.
    fn estimated(&self) -> Estimated<R> {
        let f = &self.filter;
        Estimated {
            flux: f.estimate(),
            speed: self.speed,
            psi_1: f.value(),
            u_off: f.b() * -f.r_s(),
            i_s: f.i_s(),
            r_s: f.r_s(),
            epsilon: R::ZERO,
            innovation: f.innovation(),
            nis: f.nis(),
            angle_deviation: f.sigma(),
            confidence: f.confidence(),
        }
    }

    fn memory(&self, i_off: [R; 3]) -> Memory<R> {
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
        let b = if c.calibrate_offset { AlphaBeta::default() } else { u_off * -memory.r_s.recip() };
        let Memory { r_s, loss_error: v, knee, leakage, inv_l_m: gamma, .. } = *memory;
        self.filter.restore(&c.enhanced.filter, &Learned { b, r_s, v, knee, leakage, gamma });
        #[cfg(feature = "legs")]
        {
            self.legs = memory.legs.limited();
        }
        c.inverter.follow(&mut self.knee, self.filter.knee());
    }
}
