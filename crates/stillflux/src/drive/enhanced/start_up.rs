//! Start-up of the enhanced scheme, at standstill or in a rotating machine (flying start).
//!
//! It begins with 8 ms without current, in which a flux that turns is found by the voltage that it induces
//! ([`crate::estimate::catch`]); where this voltage is too small to tell its direction through the errors of the bridge, and
//! after a stop of less than `fresh_time`, the current turns for 10 ms and more, which shows it. With a flux, and after such
//! a stop also without, the filter follows it from then on, the largest current builds it up to rated, and control begins:
//! what was identified is fresh. A flux of the stop that induces nothing has the direction of the stop, turned by the speed
//! then, after a pause within which a slow shaft cannot have turned it elsewhere, or where the shaft stood; of a shaft that has come to
//! rest since, the middle of the angle. Else the current turns until the flux shows, or has decayed. Without the feature `restart` the current stays at zero until then.
//!
//! Without data that are fresh (after a fault, after a start that was stopped, beyond `fresh_time`) a flux at rest is not found:
//! the current stays at zero until what the bridge may have left has decayed ([`Start::Decaying`]). Otherwise:
//!
//! 1. The current alternates along the three axes, 0.2 s at 10 kHz, which shows how the legs of the bridge differ
//!    ([`crate::estimate::legs`]), and whether the machine is at rest. In a machine that certainly rotates it ends
//!    after a third. In one that is not found at rest the start-up begins again, since the flux that is left turns: the
//!    search would take it for what its current builds up. Without `identify_legs` this is left out. In the end the current
//!    is zero and current control without integrators: without current the bridge does not apply the voltage that they
//!    would hold against the dead time, up to half of its loss.
//! 2. Speed search ([`crate::estimate::search`]), 10 ms, longer in large machines at rest. A current along the a-axis
//!    builds up `ψ_R`, which the rotor turns. The filter integrates without corrections, from the first voltage that drives the
//!    current on. The circle of the flux of a machine that turns ([`crate::estimate`]'s `circle`, with the feature `restart`)
//!    shows the error of the voltage as well, which the filter takes for resistance and inverter model.
//! 3. Rotating: the current follows the direction of `ψ̂_R` for the time in which the boosted current builds up rated
//!    flux, or until `|ω_s ψ_s|` is 0.9 of the largest voltage, then control begins. If `|ψ̂_s|` is below half of rated then, the rotation is rejected: the voltage error
//!    of the inverter model was taken for a rotation, and the start-up goes on as at standstill.
//! 4. Standstill: the current keeps its direction, since a current that follows an estimate with an error of the angle
//!    makes torque on a free shaft. From its first voltage on the filter identifies rotor resistance, magnetising curve,
//!    stator resistance, `v` and knee ([`Filter::begin_direct`]), which steps of the current separate
//!    ([`crate::control::levels`]): from 7/16 of the magnetisation time on, with a settled flux, to reduced currents, then to the
//!    boosted one, which brings the flux back. Where the filter has not followed the flux there, after a rotation that was
//!    rejected or in a repetition, it begins at the settled one. With two current sensors the reduced currents also show the difference
//!    of their gains ([`crate::estimate::pair`]); where it is a new one the last three quarters are repeated, since
//!    everything identified in them was falsified by it.
//! 5. A shaft that something else turns more slowly than the search sees drags the flux across the current. From 45° on the
//!    start-up goes on with 3, below that the filter is initialised where the flux is
//!    ([`crate::estimate`]'s `slow_turn`, with the feature `restart`).

use super::progress::Step;
#[cfg(feature = "restart")]
use super::turned_by;
use super::{EnhancedEstimators, Start, remaining};
use crate::config::DriveConfig;
use crate::control::levels::{Level, SETTLED};
#[cfg(any(feature = "legs", feature = "modes"))]
use crate::drive::estimators::PeriodInput;
#[cfg(feature = "legs")]
use crate::drive::estimators::PeriodOutput;
use crate::drive::estimators::{CurrentControl, Estimators, FieldQuantities};
#[cfg(feature = "restart")]
use crate::estimate::catch::CatchConfig;
use crate::estimate::catch::{Catch, Direction, Found};
#[cfg(feature = "legs")]
use crate::estimate::legs::Alternation;
#[cfg(feature = "modes")]
use crate::estimate::pair::{HALF_MAX, Pair};
use crate::estimate::search;
#[cfg(feature = "legs")]
use crate::estimate::search::{ROTATING, SpeedSearch};
#[cfg(feature = "restart")]
use crate::estimate::slow_turn::SlowTurn;
use crate::scalar::Real;
use crate::space::{AlphaBeta, Dq, Rotator};

/// Speed from which on the speed search prevails over a comparison of the legs that has found the machine at rest.
/// Allowance: what a search at rest takes for a rotation is below it.
#[cfg(feature = "legs")]
const PREVAILS: f64 = 0.1;
/// Flux of the stop, less its decay, below which a machine in which nothing is induced is taken as one without, and below
/// which nothing is looked for.
const RESIDUAL: f64 = 0.15;
const GONE: f64 = if cfg!(feature = "restart") { 0.02 } else { RESIDUAL };
/// Least component of the flux that is found along the known one, relative to the known one: 26° apart where their magnitudes are
/// equal, and 73° in a machine that is taken to stand still. Allowances.
#[cfg(feature = "restart")]
const ASIDE: (f64, f64) = (0.9, 0.3);
/// Blocks in which the current falls after its last turn.
#[cfg(feature = "restart")]
const FALL: u32 = 2;
/// Least known flux that counts: the voltage of the bridge without current is wrong by 0.03 to 0.05 for 8 ms, which adds up to 0.13.
#[cfg(feature = "restart")]
const SEEN: f64 = 0.3;
/// Flux that is multiplied by [`SCALE`] before its direction is taken: [`Rotator::of`] takes that of a vector near zero as 0.
const FAINT: f64 = 0.1;
const SCALE: f64 = 16.0;
/// Part of the leakage flux of the current that counts as the flux to follow where that is small. Allowance: twice the tolerance of `L_σ`.
#[cfg(feature = "restart")]
const STAYS: f64 = 0.2;
/// Standard deviation of a flux that builds up behind a small one, per unit, when it is first corrected: as long as it is below
/// a tenth the filter integrates what the voltage of a current that jumps to its direction, and the leakage, have of errors.
/// Allowance: 0.02 to 0.08 were seen at 160 kW.
const UNSEEN: f64 = 0.03;
/// The same of a flux that a slow rotation has turned from the current of the start ([`crate::estimate::slow_turn`]). Allowance:
/// what an error of the rotor resistance by 30 % leaves.
#[cfg(feature = "restart")]
const DRAGGED: f64 = 0.1;
/// Least rotor flux whose direction, 27° and more from that of the current, shows that a machine turns that was taken to have no flux.
const SHOWS_ROTATION: f64 = 0.3;
/// Rotor flux, relative to rated stator flux, with which control begins.
const BUILT_UP: f64 = 0.85;
/// Induced voltage, relative to the largest fundamental voltage, with which control begins before that: a tenth is left for
/// current control.
const VOLTAGE_USE: f64 = 0.9;
/// Period of a start-up in which the voltage for the reference of its first one is that applied between the last two samples.
/// What was commanded before, without current, was not applied, and must not be integrated.
const DRIVEN: u32 = 3;
/// Difference of the gains of two current sensors below which nothing is repeated.
#[cfg(feature = "modes")]
const KNOWN_DIFFERENCE: f64 = 1e-3;

impl<R: Real> EnhancedEstimators<R> {
    /// Before the estimation of a start-up period: its current reference, and initialisation of the filter.
    #[cold]
    #[inline(never)]
    pub(super) fn prepare(&mut self, c: &DriveConfig<R>, i_s: &AlphaBeta<R>) -> Dq<R> {
        let (step, stage) = self.progress.now();
        if (step, stage) == (Step::Catch, 1) {
            self.filter.start(&c.enhanced.filter, i_s);
            self.catch = Catch::new(self.filter.i_s());
        }
        if step == Step::Catch {
            #[cfg(feature = "restart")]
            if stage > c.enhanced.catch.periods_without_current() && self.catch.is_turning() {
                return c.magnetising_current(u32::MAX);
            }
            return Dq::default();
        }
        if matches!(self.start, Start::Caught | Start::Empty) {
            if self.start == Start::Empty && stage <= DRIVEN {
                self.filter.start(&c.enhanced.filter, &AlphaBeta::default());
            }
            // The search is made for the boosted current.
            let searching = self.start == Start::Empty && self.search.is_searching();
            // The leakage of a current that builds up a small flux is not to hide it.
            let faint = cfg!(feature = "restart")
                && self.start == Start::Caught
                && self.filter.magnitude() < R::from_f64(RESIDUAL);
            return if searching || faint { c.magnetising_current(stage) } else { Dq::new(c.i_quick, R::ZERO) };
        }
        let mut i_ref = c.magnetising_current(stage);
        if cfg!(feature = "restart") && self.is_searching() {
            // Of the boosted current until it is decided, however long the circle takes.
            i_ref = c.magnetising_current(0);
        } else if !self.search.found_rotation() {
            i_ref = match c.enhanced.levels.at(stage, (c.magnetise_periods / 16).max(1)) {
                Level::Full => i_ref,
                Level::Part(part) => i_ref * part,
                Level::Boosted => c.magnetising_current(0),
            };
        }
        if stage <= DRIVEN {
            self.filter.start(&c.enhanced.filter, &AlphaBeta::default());
            self.filter.begin_direct(&c.enhanced.filter);
        } else if !self.search.found_rotation() {
            // At standstill the settled flux follows from the current.
            if stage == settled(c) {
                let omega = self.settle(c);
                self.speed_estimator.start(&self.filter.rotor_flux(&c.enhanced.filter), omega);
            } else if stage == c.magnetise_periods {
                self.filter.end_direct(&c.enhanced.filter);
            }
        }
        i_ref
    }

    /// A period of the catch: the flux that the machine has, and at the end what the start-up goes on with.
    #[cold]
    #[inline(never)]
    #[cfg_attr(not(feature = "restart"), allow(unused_variables))]
    pub(super) fn catch_flux(&mut self, c: &DriveConfig<R>, u_s: &AlphaBeta<R>, i_ref: R) -> FieldQuantities<R> {
        let (_, stage) = self.progress.now();
        let i_s = self.filter.i_s();
        let psi_r = self.filter.rotor_flux(&c.enhanced.filter);
        #[cfg(feature = "restart")]
        let output = if stage > c.enhanced.catch.periods_without_current() {
            self.with_turning_current(c, (i_s, psi_r), i_ref, stage - c.enhanced.catch.periods_without_current())
        } else {
            self.without_current(c, (u_s, i_s, psi_r), stage)
        };
        #[cfg(not(feature = "restart"))]
        let output = self.without_current(c, (u_s, i_s, psi_r), stage);
        if self.progress.ends_catch() {
            self.conclude_catch(c, stage, &i_s);
        }
        output
    }

    /// Current control in a period of the catch: it begins anew while the current falls after its last turn. What the integrators hold is
    /// for the current that has turned; they would drive one for some milliseconds, which the search that follows would take for a
    /// flux across its own.
    #[inline(always)]
    #[cfg_attr(not(feature = "restart"), allow(unused_variables, clippy::unused_self))]
    pub(super) fn current_control_of_catch(&self, c: &DriveConfig<R>) -> CurrentControl {
        #[cfg(feature = "restart")]
        if self.progress.now().1 > c.enhanced.catch.periods_without_current() && !self.catch.is_turning() {
            return CurrentControl::BeginsAnew;
        }
        CurrentControl::Continues
    }

    /// A period in which the current is to be zero.
    #[inline(always)]
    fn without_current(
        &mut self,
        c: &DriveConfig<R>,
        (u_s, i_s, psi_r): (&AlphaBeta<R>, AlphaBeta<R>, AlphaBeta<R>),
        stage: u32,
    ) -> FieldQuantities<R> {
        // Not after a comparison of the legs, with which the start-up begins again.
        #[cfg(feature = "legs")]
        let blocked = !self.progress.have_compared();
        #[cfg(not(feature = "legs"))]
        let blocked = true;
        let (field, psi_s, omega_s) = self.catch.step(&c.enhanced.catch, (stage, blocked), (u_s, i_s, psi_r));
        // Current control feeds jω_s ψ_s forward: with ω_s = ±1 that is the induced voltage.
        FieldQuantities { field, psi_s, omega_s, r_s: R::ZERO, i_dq: field.to_field(&i_s) }
    }

    /// A period in which the current turns, counted from one; `i_ref`: its magnitude.
    #[cfg(feature = "restart")]
    #[inline(always)]
    fn with_turning_current(
        &mut self,
        c: &DriveConfig<R>,
        (i_s, psi_r): (AlphaBeta<R>, AlphaBeta<R>),
        i_ref: R,
        period: u32,
    ) -> FieldQuantities<R> {
        let field = self.catch.turn(&c.enhanced.catch, period, psi_r);
        let psi_s = self.filter.sigma_l_s(&c.enhanced.filter) * i_ref;
        // Without the current that turns the field stands: a voltage that is turned ahead in the positive direction drives the
        // flux of a machine that turns in the other one.
        let omega_s = if self.catch.is_turning() { c.enhanced.catch.omega_p } else { R::ZERO };
        let r_s = self.filter.r_s();
        FieldQuantities { field, psi_s, omega_s, r_s, i_dq: field.to_field(&i_s) }
    }

    /// At the end of the catch: what the start-up goes on with, or how much longer it takes.
    #[cfg_attr(feature = "restart", cold, inline(never))]
    fn conclude_catch(&mut self, c: &DriveConfig<R>, stage: u32, i_s: &AlphaBeta<R>) {
        let above = |psi_r: &AlphaBeta<R>, least: f64| psi_r.norm_sq() > R::from_f64(least * least);
        let kept = match self.start {
            Start::Fresh(psi_r, direction) => {
                // Less what has decayed since the current began to turn.
                let psi_r = psi_r * remaining(c, stage.saturating_sub(c.enhanced.catch.periods_without_current()));
                above(&psi_r, GONE).then_some((psi_r, direction))
            }
            _ => None,
        };
        let flux = match self.remaining_flux(c, stage, kept, above) {
            // A flux at rest induces too little to be found, but would falsify the comparison of the legs and the search.
            Ok(None) if stage < self.decayed_at() => {
                #[cfg(feature = "restart")]
                self.catch.set_turning(false);
                self.progress.catch_until(self.decayed_at());
                return;
            }
            Ok(flux) => flux,
            Err(longer) => {
                self.progress.extend_catch(longer);
                return;
            }
        };
        self.start = match (flux, self.start) {
            (Some((psi_r, omega)), start) => {
                let deviation = match start {
                    Start::Fresh(_, direction) if direction.is_taken() => R::ZERO,
                    _ => c.enhanced.catch.deviation(&psi_r, omega),
                };
                self.filter.catch(&c.enhanced.filter, psi_r, i_s, deviation);
                self.speed_estimator.start(&psi_r, omega);
                self.speed.set_synchronous(omega);
                Start::Caught
            }
            (None, Start::Fresh(..)) => Start::Empty,
            _ => {
                #[cfg(feature = "legs")]
                if c.enhanced.legs.is_on() {
                    self.progress.compare_legs();
                }
                Start::Unknown
            }
        };
    }

    /// Period of the start-up in which a flux that may be left has decayed.
    fn decayed_at(&self) -> u32 {
        if let Start::Decaying(until) = self.start { until } else { 0 }
    }

    /// Rotor flux and speed, if there is a flux, or the periods that it takes to know.
    #[cfg(not(feature = "restart"))]
    fn remaining_flux(
        &mut self,
        c: &DriveConfig<R>,
        _: u32,
        kept: Option<(AlphaBeta<R>, Direction<R>)>,
        _: impl Fn(&AlphaBeta<R>, f64) -> bool,
    ) -> Result<Option<(AlphaBeta<R>, R)>, u32> {
        match (self.catch.found(&c.enhanced.catch, kept), kept) {
            (Found::Flux(psi_r, omega), _) => Ok(Some((psi_r, omega))),
            (Found::Nothing, Some((psi_r, direction))) if direction.is_taken() => Ok(Some((psi_r, R::ZERO))),
            (Found::Nothing, None) => Ok(None),
            _ => Err(c.enhanced.catch.block),
        }
    }

    /// Rotor flux and speed that replace those that the turning current has found, where these lie far from the flux that the stop
    /// has left, `stopped`: the torque of the turning current may have changed the speed of a light shaft, which the search takes
    /// for constant.
    ///
    /// With a known direction at the restart the flux is `stopped` and the integral of the induced voltage since, whatever the speed
    /// did. In a machine that stood at the stop, and in which the found flux hardly turns, it is where it was.
    #[cfg(feature = "restart")]
    #[cold]
    #[inline(never)]
    fn known_flux(
        &self,
        c: &DriveConfig<R>,
        stage: u32,
        (found, omega): (AlphaBeta<R>, R),
        (stopped, direction): (AlphaBeta<R>, Direction<R>),
    ) -> Option<(AlphaBeta<R>, R)> {
        let r = R::from_f64;
        let (known, aside, omega) = match direction {
            Direction::Known => {
                let known = stopped + self.filter.rotor_flux(&c.enhanced.filter);
                (known, ASIDE.0, self.catch.speed_of(&known))
            }
            Direction::IfStanding if turned_by(c, omega, stage).within(R::HALF) => {
                (stopped * remaining(c, stage), ASIDE.1, R::ZERO)
            }
            _ => return None,
        };
        let square = known.norm_sq();
        (found.dot(&known) < square * r(aside) && square > r(SEEN * SEEN)).then_some((known, omega))
    }

    /// Rotor flux and speed, if there is a flux, or the periods that it takes to know: without current, then with one that
    /// turns, then again without.
    #[cfg(feature = "restart")]
    fn remaining_flux(
        &mut self,
        c: &DriveConfig<R>,
        stage: u32,
        kept: Option<(AlphaBeta<R>, Direction<R>)>,
        above: impl Fn(&AlphaBeta<R>, f64) -> bool,
    ) -> Result<Option<(AlphaBeta<R>, R)>, u32> {
        let CatchConfig { block, turn, rise, .. } = c.enhanced.catch;
        let first = stage <= c.enhanced.catch.periods_without_current();
        let turning = !first && self.catch.is_turning();
        let found = match (first, turning) {
            (true, _) => self.catch.found(&c.enhanced.catch, kept),
            (_, true) => self.catch.found_turning(&c.enhanced.catch, kept),
            _ => Found::Nothing,
        };
        // A machine in which the comparison of the legs has left a flux certainly turns.
        #[cfg(feature = "legs")]
        let left = self.progress.have_compared();
        #[cfg(not(feature = "legs"))]
        let left = false;
        if let (true, Found::Flux(psi_r, omega), Start::Fresh(stopped, direction)) = (turning, found, self.start)
            && let Some(known) = self.known_flux(c, stage, (psi_r, omega), (stopped, direction))
        {
            return Ok(Some(known));
        }
        match (found, kept) {
            (Found::Flux(psi_r, omega), _) => return Ok(Some((psi_r, omega))),
            (Found::Nothing, Some((psi_r, direction))) if turning && direction.is_taken() => {
                return Ok(Some((psi_r, R::ZERO)));
            }
            (Found::Nothing, None) if first && !left => return Ok(None),
            (Found::Nothing, _) if !first && !turning => return Ok(None),
            _ => {}
        }
        // A flux that is small, and not found, ends with the current.
        let goes_on = first || kept.map_or(found == Found::Uncertain, |(psi_r, _)| above(&psi_r, RESIDUAL));
        self.catch.set_turning(goes_on);
        Err(match kept {
            _ if first => block * (rise + 2 * turn),
            _ if goes_on => block * turn,
            // What the comparison of the legs has left, too small to be followed, is not to be there in the search.
            None if left => c.magnetise_periods / 4,
            _ => block * FALL,
        })
    }

    /// Whether a current along the a-axis still has to show whether the machine turns.
    pub(super) fn is_searching(&self) -> bool {
        self.start != Start::Caught && self.search.is_searching()
    }

    /// After the catch, a period of the search for the speed; returns what [`Self::build_up`] does.
    #[cold]
    #[inline(never)]
    pub(super) fn search_speed(
        &mut self,
        c: &DriveConfig<R>,
        stage: u32,
        #[cfg(feature = "restart")] loss: R,
    ) -> (Rotator<R>, Dq<R>, bool) {
        let (i_s, psi_r) = (self.filter.i_s(), self.filter.rotor_flux(&c.enhanced.filter));
        let (r_r, before) = (c.speed.r_r * self.rotor, self.speed.psi_r);
        self.speed.psi_r = psi_r;
        let ahead = Rotator::default().to_field(&i_s);
        #[cfg(feature = "legs")]
        let turns = self.progress.have_compared() && !self.at_rest;
        #[cfg(all(feature = "restart", not(feature = "legs")))]
        let turns = false;
        let (config, fluxes) = (&c.enhanced.search, (before, psi_r));
        #[cfg(feature = "restart")]
        let found =
            self.probe.circle(|circle| self.search.by_circle(config, (circle, turns), stage, r_r, fluxes, &i_s));
        #[cfg(not(feature = "restart"))]
        let found = self.search.by_search(config, stage, r_r, fluxes, &i_s);
        #[cfg_attr(not(feature = "legs"), allow(unused_mut))]
        if let Some(mut found) = found {
            // In a machine that turns what is left of a flux may cancel what the search builds up: once it has decayed.
            #[cfg(feature = "legs")]
            if found.omega == R::ZERO && turns && !self.searched_again {
                self.searched_again = true;
                self.search = SpeedSearch::new();
                self.progress.wait(c.magnetise_periods / 4);
                return (Rotator::default(), ahead, false);
            }
            #[cfg(feature = "legs")]
            if self.at_rest {
                if !found.is_by_circle() && found.omega.within(R::from_f64(PREVAILS)) {
                    // The comparison of the legs has seen it for far longer.
                    self.search.reject();
                    (found.omega, found.psi_r) = (R::ZERO, None);
                } else {
                    // At a few speeds its mean passes zero, and what it found then are no legs.
                    self.legs = *c.inverter.legs();
                }
            }
            if self.search.found_rotation() {
                self.filter.end_direct(&c.enhanced.filter);
            }
            #[cfg(feature = "restart")]
            if found.error.is_some() {
                self.progress.build_up_after(DRIVEN);
            }
            #[cfg(feature = "restart")]
            self.follow(c, (&i_s, psi_r), &found, loss, R::from_f64(UNSEEN));
            #[cfg(not(feature = "restart"))]
            self.follow(c, (&i_s, psi_r), &found, R::from_f64(UNSEEN));
        }
        (Rotator::default(), ahead, stage >= c.magnetise_periods)
    }

    /// After a search: the filter begins at the flux that it has found, known to a standard deviation, with the resistance and the
    /// inverter model that explain the error of the voltage, and the estimate of the speed at the speed found.
    #[cfg_attr(feature = "restart", cold, inline(never))]
    #[cfg_attr(not(feature = "restart"), inline(always))]
    fn follow(
        &mut self,
        c: &DriveConfig<R>,
        (i_s, psi_r): (&AlphaBeta<R>, AlphaBeta<R>),
        found: &search::Found<R>,
        #[cfg(feature = "restart")] loss: R,
        deviation: R,
    ) {
        let config = &c.enhanced.filter;
        if let Some(psi_r) = found.psi_r {
            self.filter.place(config, psi_r, i_s, deviation);
        }
        #[cfg(feature = "restart")]
        if let Some(error) = found.error {
            self.filter.explain(config, error, loss);
        }
        self.speed_estimator.start(&found.psi_r.unwrap_or(psi_r), found.omega);
        self.speed.set_synchronous(found.omega);
    }

    /// At the settled flux of the direct current, where the filter has not followed it there or something turns the shaft: begins
    /// anew. Returns the speed.
    fn settle(&mut self, c: &DriveConfig<R>) -> R {
        let (config, psi_s) = (&c.enhanced.filter, c.flux_control.psi_rated);
        #[cfg(feature = "restart")]
        if let Some((part, omega)) = self.slow_turn.dragged(&c.enhanced.slow_turn) {
            self.filter.settle(config, psi_s);
            let i_s = self.filter.i_s();
            let psi_r = part * self.filter.rotor_flux(config).re();
            self.filter.place(config, psi_r, &i_s, R::from_f64(DRAGGED));
            return omega;
        }
        if self.filter.is_direct() {
            self.filter.forget_across(config);
        } else {
            self.filter.settle(config, psi_s);
            self.filter.begin_direct(config);
        }
        R::ZERO
    }

    /// Whether a slow rotation has turned the settled flux from the current.
    #[cfg_attr(not(feature = "restart"), allow(unused_variables, clippy::unused_self))]
    fn is_dragged(&self, c: &DriveConfig<R>) -> bool {
        #[cfg(feature = "restart")]
        return self.slow_turn.dragged(&c.enhanced.slow_turn).is_some();
        #[cfg(not(feature = "restart"))]
        false
    }

    /// A period of the build-up in a machine that the search has not found to turn: whether it turns more slowly. The start-up
    /// then goes on as after a search that has found it.
    #[cfg(feature = "restart")]
    #[cold]
    #[inline(never)]
    pub(super) fn watch_for_rotation(&mut self, c: &DriveConfig<R>, stage: u32, loss: &AlphaBeta<R>) {
        if stage <= DRIVEN {
            self.slow_turn = SlowTurn::default();
        }
        let most = settled(c).min(c.enhanced.slow_turn.periods);
        if self.start != Start::Unknown || self.search.found_rotation() || stage >= most {
            return;
        }
        // Once: what a repetition adds up is of another difference of the gains.
        #[cfg(feature = "modes")]
        if self.progress.has_repeated() {
            return;
        }
        let (filter, config) = (&self.filter, &c.enhanced.filter);
        let u_i = filter.u_i() + filter.explained(loss);
        let sigma_l_s = filter.sigma_l_s(config);
        let found = self.slow_turn.step(&c.enhanced.slow_turn, stage, &u_i, &filter.i_s(), sigma_l_s);
        if self.search.is_searching() {
            return;
        }
        if let Some(mut found) = found {
            self.search.turns();
            self.progress.build_up_after(DRIVEN);
            // A smaller machine's flux saturates by then, which the rotor equation here does not contain.
            found.error = found.error.filter(|_| c.enhanced.search.is_large());
            let (i_s, psi_r) = (self.filter.i_s(), self.filter.rotor_flux(config));
            self.follow(c, (&i_s, psi_r), &found, loss.re(), R::from_f64(DRAGGED));
        }
    }

    /// After the catch and the search: the speed, the direction that the current takes with the current in its coordinates,
    /// and whether the flux has built up.
    #[cold]
    #[inline(never)]
    pub(super) fn build_up(&mut self, c: &DriveConfig<R>, stage: u32, u_dc: R) -> (Rotator<R>, Dq<R>, bool) {
        // A machine at rest has none before its flux has settled: that of a small flux is the noise of current control, to which
        // it is fed forward, and in machines with a large leakage the two oscillate at a low control frequency.
        let rests = self.start == Start::Unknown && !self.search.found_rotation() && stage < settled(c);
        if !rests && stage.is_multiple_of(c.speed_periods()) {
            self.update_speed(c);
        }
        let i_s = self.filter.i_s();
        let psi_r = self.filter.rotor_flux(&c.enhanced.filter);
        let (mut field, mut periods) = (Rotator::default(), c.magnetise_periods);
        // The start-up ends at the limit of the voltage, where current control would fail; field weakening goes on from there.
        let follows = self.follows_flux();
        let induced = self.filter.magnitude() * self.speed.omega_s;
        let at_limit = follows && !induced.within(u_dc * c.u_use * R::from_f64(VOLTAGE_USE));
        // That of the rotor: the leakage flux of the largest current, up to a quarter of rated, goes with it.
        let enough = c.flux_control.psi_rated * R::from_f64(BUILT_UP);
        let built_up = psi_r.norm_sq() >= enough * enough;
        if matches!(self.start, Start::Caught | Start::Empty) {
            // The rest of a flux can hide a rotation from the search; the flux that builds up then lies aside of its current.
            if psi_r.norm_sq() > R::from_f64(SHOWS_ROTATION * SHOWS_ROTATION) && psi_r.re() < psi_r.im().abs() * R::TWO
            {
                self.start = Start::Caught;
            }
            if self.follows_flux() {
                field = self.direction(c, &psi_r);
            }
            if stage >= c.boost_periods && self.filter.magnitude() < c.flux_control.psi_rated.half() {
                // No flux after the time that it takes: nothing that was assumed holds.
                self.search.reject();
                self.start = Start::Unknown;
                return (Rotator::default(), Rotator::default().to_field(&i_s), false);
            }
            return (field, field.to_field(&i_s), built_up || at_limit || stage >= c.boost_periods);
        } else if self.search.found_rotation() {
            field = self.direction(c, &psi_r);
            periods = c.boost_periods;
            // Without flux by then the current did not follow it: the rotation was an error of the voltage.
            if stage >= periods && self.filter.magnitude() < c.flux_control.psi_rated.half() {
                self.search.reject();
                periods = c.magnetise_periods;
            }
            // There was a flux when the current began to follow it.
            if built_up && self.is_dragged(c) {
                periods = 0;
            }
        }
        (field, field.to_field(&i_s), at_limit || stage >= periods)
    }

    /// Direction that the current takes in following the flux.
    #[cfg_attr(feature = "restart", cold, inline(never))]
    #[cfg_attr(not(feature = "restart"), allow(unused_variables, clippy::unused_self), inline(always))]
    fn direction(&self, c: &DriveConfig<R>, psi_r: &AlphaBeta<R>) -> Rotator<R> {
        #[cfg(feature = "restart")]
        return direction(psi_r, || self.filter.i_s() * self.filter.sigma_l_s(&c.enhanced.filter));
        #[cfg(not(feature = "restart"))]
        direction(psi_r)
    }

    /// Whether the current follows the direction of the flux.
    #[cold]
    #[inline(never)]
    pub(super) fn follows_flux(&self) -> bool {
        self.start == Start::Caught || self.search.found_rotation()
    }

    /// Gains of two current sensors, in the last three quarters of the magnetisation at standstill; whether this is a
    /// period of them. The current is controlled without the filter's offset then: as that moves, the flux would.
    #[cfg(feature = "modes")]
    #[cold]
    #[inline(never)]
    pub(super) fn compare_gains(&mut self, c: &DriveConfig<R>, x: &PeriodInput<'_, R>, i_ref: R, stage: u32) -> bool {
        let begin = c.magnetise_periods / 2;
        if stage <= begin / 2 || self.start != Start::Unknown || self.search.found_rotation() {
            self.pair = Pair::default();
            return false;
        }
        let by_knee = x.voltage.loss.by_knee();
        let u = x.u_s.re() + by_knee[1].abs() + by_knee[2].abs();
        self.pair.add(c.enhanced.pair_weight, [i_ref, u, x.u_s.im()], stage > begin);
        // Once in a start: what the repetition identifies is right for this difference.
        if stage == c.magnetise_periods && !self.progress.has_repeated() {
            let left = self.pair.difference();
            if !left.within(R::from_f64(KNOWN_DIFFERENCE)) {
                let known = self.half_difference;
                self.half_difference = (known + left.half()).limit(R::from_f64(HALF_MAX));
                #[cfg(feature = "legs")]
                if self.at_rest {
                    let (found, i) = (self.half_difference - known, c.magnetising_current(0).re());
                    self.legs = c.enhanced.legs.without_difference(&self.legs, found + found, i, x.u_dc);
                }
                self.progress.repeat_after(begin / 2);
                self.pair = Pair::default();
            }
        }
        true
    }

    /// One period of the comparison of the legs; after the last one the start-up goes on with the speed search.
    #[cfg(feature = "legs")]
    #[cold]
    #[inline(never)]
    pub(super) fn compare_legs(
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
        let [all, first] = config.periods();
        let (alternation, rotates, result) = self.probe.legs(|probe| {
            let alternation = probe.step(config, period - 1, &x.u_s, &i_s, i_a + i_b + i_c);
            let rests = period == all && probe.is_at_rest(R::from_f64(ROTATING));
            let result = rests.then(|| probe.result(config, &self.legs, &self.balance, i, x.u_dc));
            (alternation, period == first && probe.rotates(), result)
        });
        let Alternation { axis, part } = alternation;
        *i_dq_ref = Dq::new(i * part, R::ZERO);
        let mut turns = rotates;
        if period == all {
            self.at_rest = result.is_some();
            if let Some(legs) = result {
                self.legs = legs;
                self.knee.set_legs(&self.legs, x.u_dc);
            }
            turns = !self.at_rest;
            self.progress.build_up_after(0);
        }
        if turns {
            // The flux that the alternation has left turns with the shaft: the start-up begins again and catches it.
            self.progress.begin_anew(c.enhanced.catch.periods_without_current());
        }
        let field = FieldQuantities {
            field: axis,
            psi_s: R::ZERO,
            omega_s: R::ZERO,
            r_s: config.resistance(),
            i_dq: axis.to_field(&i_s),
        };
        let current_control =
            if period + config.settled() > all { CurrentControl::BeginsAnew } else { CurrentControl::Continues };
        PeriodOutput { field, complete: false, current_control }
    }
}

/// Period of a start-up at standstill in which the flux has settled.
fn settled<R: Real>(c: &DriveConfig<R>) -> u32 {
    c.magnetise_periods / 16 * SETTLED
}

/// Direction of a flux that may be small: as much as a direct current of the search builds up in a large machine that turns
/// fast, `2 r_R i/ω`, 0.007 pu at 160 kW and rated speed. The current follows it, and with a leakage `σl_s` that is told too large a small
/// flux `ψ_R - Δσl_s i` would point away from the current and turn it to and fro: with the feature
/// `restart` a part of the `leakage` flux `σl_s i` stays.
#[cfg_attr(not(feature = "restart"), cold, inline(never))]
fn direction<R: Real>(
    psi_r: &AlphaBeta<R>,
    #[cfg(feature = "restart")] leakage: impl Fn() -> AlphaBeta<R>,
) -> Rotator<R> {
    let small = psi_r.norm_sq() < R::from_f64(FAINT * FAINT);
    #[cfg(feature = "restart")]
    let follows = || *psi_r + leakage() * R::from_f64(STAYS);
    #[cfg(not(feature = "restart"))]
    let follows = || *psi_r;
    Rotator::of(&if small { follows() * R::from_f64(SCALE) } else { *psi_r }).0
}

#[cfg(all(test, feature = "restart"))]
mod tests {
    use super::*;

    #[test]
    fn a_flux_that_a_large_machine_has_at_first_has_a_direction() {
        for psi in [0.002, 0.007, 0.05, 0.5, 3.0] {
            let e = direction(&AlphaBeta::new(-0.6 * psi, 0.8 * psi), AlphaBeta::default).axis();
            assert!((e.re() + 0.6_f64).abs() < 1e-9 && (e.im() - 0.8).abs() < 1e-9, "{psi}: {e:?}");
        }
    }

    /// A current that follows a flux which turns by 0.08 rad in a period, with what the error of the leakage leaves of its own.
    #[test]
    fn a_current_follows_a_small_flux_although_the_leakage_is_told_too_large() {
        let leakage = 0.1;
        for (psi, told) in [(0.007, 0.15), (0.03, 0.15), (0.03, -0.2), (0.09, 0.15)] {
            let mut current = Rotator::<f64>::default();
            let mut angle = 0.0f64;
            for _ in 0..400 {
                angle += 0.08;
                let flux = AlphaBeta::new(psi * angle.cos(), psi * angle.sin());
                current = direction(&(flux - current.axis() * (told * leakage)), || current.axis() * leakage);
            }
            let along = current.cos * angle.cos() + current.sin * angle.sin();
            assert!(along > 0.8, "{psi}, {told}: {along}");
        }
    }
}
