//! Side of the current on which the rotor flux lies while the field stands: tried out, one after the other. Per unit.
//!
//! While the field stands the current is a direct current. A light load then turns the shaft slowly, and the shaft drags the
//! rotor flux out of the current,
//!
//! ```text
//! ψ_R = L_M i/(1 - jω τ_r):    tan δ = ω τ_r,    |ψ_R| = L_M i cos δ
//! ```
//!
//! with a torque of up to `3/4 n_p L_M i_d²` at 45°: a light load finds its equilibrium there, and the voltage shows none of it
//! once it is reached. The current model has the same flux at `δ` and at `-δ`, and an estimate may settle on either, or stay
//! along the current. Two signs tell of it, each of a field that stands while its angle is not known:
//!
//! ```text
//! collapsed:  i_μ(|ψ̂_R|) < COLLAPSED i_d for N calls, in which |ψ̂_R| does not rise: the voltage has shown that the flux falls
//! against:    ω̂ and T̂ of opposite sign for M calls, and not small: a shaft that turns against the torque of its drive
//! ```
//!
//! The flux is then turned, and only integrated for `P` calls: to `δ` on one side of the current, `cos δ = i_μ(|ψ̂_R|)/i_d`, where
//! it has collapsed, or from its side of the current to the other where the shaft turns against the torque. The current follows
//! the estimated flux. To its step the true flux answers alike on whatever side it lies, as a linear system at constant speed does,
//!
//! ```text
//! Δψ_R = L_M Δi_s (1 - e⁻ᴾ):    |ψ̂_R| rises by (1 - cos δ)(1 - e⁻ᴾ) of it, the part along the estimate
//! ```
//!
//! and what tells the sides is the motion of the shaft in the torque of the turned current: a flux that the shaft turns by `θ`
//! changes the estimated one by `θ sin 2δ` where that lies `2δ` from it, on the wrong side, and by nothing on the right one.
//!
//! ```text
//! kept:     -(1 - cos δ) RESPONSE/2 < Δ|ψ̂_R|/|ψ̂_R| < (1 - cos δ) RESPONSE + RISES
//! ```
//!
//! A flux along the current whose magnetising current is told too small by as much answers as the right one does: a trial does not
//! tell the two apart.
//!
//! A flux that is not kept is turned to the other side for another `P`, and then, as one that was mirrored, back to where it was:
//! `i_μ` has an error of `L_M`, or the angle was not what was wrong.
//!
//! The first side of a flux that has collapsed is the one that lets it lag behind the phase zero ahead of the current
//! ([`stands_before_a_zero`]): a current that the error of the bridge's curve holds at a zero stands before it in the direction
//! in which its flux is dragged.
//!
//! `N` is 0.3, `M` 0.21 and `P` 0.25 rotor time constants, `M` at least the time in which a speed loop catches a shaft that a load
//! turns against the torque. Validity: the enhanced scheme, whose filter knows that it does not know
//! the angle; at light loads, where the innovation does not show it.

use crate::scalar::{Real, likely};
use crate::space::{AlphaBeta, Rotator};
use crate::words::words;

/// Stator frequency of a field that stands, per unit.
const STANDS: f64 = 0.004;
/// Recent torque current over the magnetising one, below which the innovation does not show the angle.
const UNLOADED: f64 = 0.25;
/// Deviation of an angle that is not known, rad: for a flux that has collapsed, and for one that may be on the other side of the
/// current. All thresholds here are allowances.
const SIGMA_UNKNOWN: f64 = 0.14;
const SIGMA_MIRRORED: f64 = 0.25;
/// Magnetising current of the flux over the current along it, below which the flux counts as collapsed: `cos 22°`.
const COLLAPSED: f64 = 0.93;
/// Least cosine of the angle between current and flux that is tried.
const COS_MIN: f64 = 0.5;
/// Part of the flux by which it may rise while it counts as collapsed, and in a trial beyond what it rises by where it is right.
const COLLAPSED_RISES: f64 = 0.005;
const RISES: f64 = 0.04;
/// `1 - e⁻ᴾ`, the part of the way to its steady state that a flux goes in a trial.
const RESPONSE: f64 = 0.22;
/// Speed, per unit, and torque current over magnetising current, from which on a shaft turns against the torque.
const SPEED_AGAINST: f64 = 1.5e-3;
const LOAD_AGAINST: f64 = 0.03;
/// Coefficient of the means of flux, currents and speed.
const SMOOTH: f64 = 1.0 / 16.0;
/// Calls until the next suspicion, in units of those of the suspicion.
const PAUSE: u32 = 3;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SidesConfig {
    /// Calls of a flux that has collapsed, `N`, and of a shaft that turns against the torque, `M`; `u32::MAX`: never.
    pub collapse: u32,
    pub against: u32,
    /// Calls of a trial, `P`.
    pub trial: u32,
}
words!(struct SidesConfig: collapse, against, trial);

/// What is under way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
enum Stage {
    /// Nothing but the suspicion.
    #[default]
    Watching,
    /// The trial of the first side of a flux that has collapsed, and of the second one.
    First,
    Second,
    /// The trial of the other side of a flux that has not.
    Mirrored,
    /// The time after a trial.
    Pausing,
}

/// State.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Sides<R: Real> {
    stage: Stage,
    /// Calls since it began, or of a flux that has collapsed; calls of a shaft that turns against the torque.
    calls: u32,
    against: u32,
    /// `|ψ̂_R|` when it began.
    psi_r: R,
    /// Means.
    mean: Quantities<R>,
    /// Angle of the first turn.
    turn: Rotator<R>,
}

/// What makes a suspicion, of a field that stands.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Quantities<R: Real> {
    /// Magnetising current of the flux, current along it and across it, all times `l_M`.
    pub magnetised: R,
    pub along: R,
    pub across: R,
    /// Stator current.
    pub i_s: AlphaBeta<R>,
    /// Speed.
    pub omega_m: R,
}

impl<R: Real> Quantities<R> {
    /// Means over some calls, without the ripple of the currents.
    fn follow(&mut self, x: &Self) {
        let smooth = |mean: &mut R, value: R| *mean += (value - *mean) * R::from_f64(SMOOTH);
        smooth(&mut self.magnetised, x.magnetised);
        smooth(&mut self.along, x.along);
        smooth(&mut self.across, x.across);
        self.i_s += (x.i_s - self.i_s) * R::from_f64(SMOOTH);
        smooth(&mut self.omega_m, x.omega_m);
    }

    /// `cos δ` of a flux that has collapsed, given the part of the current along it.
    fn cosine(&self, part: R) -> R {
        (self.magnetised * self.along.recip() * part).max(R::from_f64(COS_MIN)).min(R::ONE)
    }
}

/// A field that stands.
#[derive(Clone, Copy, Debug)]
pub struct StandingField<R: Real> {
    /// Magnitude of the rotor flux.
    pub psi_r: R,
    /// Deviation of its angle, rad.
    pub sigma: R,
    /// Present values.
    pub now: Quantities<R>,
}

impl<R: Real> Sides<R> {
    /// Whether a side is tried out: the flux is only integrated.
    #[inline(always)]
    pub fn is_trying(&self) -> bool {
        !matches!(self.stage, Stage::Watching | Stage::Pausing)
    }

    /// Whether there is nothing that a field which does not stand has to end.
    #[inline(always)]
    pub fn is_idle(&self) -> bool {
        likely(self.stage == Stage::Watching && self.calls == 0 && self.against == 0)
    }

    /// The field does not stand, or its angle is known: a trial goes on, a suspicion ends.
    pub fn interrupt(&mut self) {
        if !self.is_trying() {
            *self = Self::default();
        }
    }

    /// One call with a field that stands: by which angle the flux has to be turned.
    pub fn step(&mut self, c: &SidesConfig, x: &StandingField<R>) -> Option<Rotator<R>> {
        if self.stage != Stage::Watching {
            self.calls += 1;
        }
        match self.stage {
            Stage::Watching => {
                self.mean.follow(&x.now);
                let turn = self.mirrored(c, x).or_else(|| self.collapsed(c, x));
                if let Some(turn) = turn {
                    self.turn = turn;
                }
                turn
            }
            Stage::Pausing => {
                if self.calls >= c.collapse.saturating_mul(PAUSE) {
                    self.begin(Stage::Watching, x.psi_r);
                }
                None
            }
            _ if self.calls < c.trial => None,
            stage => {
                let kept = self.is_kept(x.psi_r);
                self.begin(if stage == Stage::First && !kept { Stage::Second } else { Stage::Pausing }, x.psi_r);
                match stage {
                    _ if kept => None,
                    Stage::First => Some(self.turn.turned_by(&self.turn).reversed()),
                    Stage::Second => Some(self.turn),
                    _ => Some(self.turn.reversed()),
                }
            }
        }
    }

    fn begin(&mut self, stage: Stage, psi_r: R) {
        (self.stage, self.calls, self.against, self.psi_r) = (stage, 0, 0, psi_r);
    }

    /// Whether a flux that was turned may be the true one.
    fn is_kept(&self, psi_r: R) -> bool {
        let answer = (R::ONE - self.turn.cos) * R::from_f64(RESPONSE);
        psi_r > self.psi_r * (R::ONE - answer.half()) && psi_r < self.psi_r * (R::from_f64(1.0 + RISES) + answer)
    }

    /// The turn to the other side of the current, where the shaft turns against the torque.
    fn mirrored(&mut self, c: &SidesConfig, x: &StandingField<R>) -> Option<Rotator<R>> {
        let Quantities { along, across, omega_m, .. } = self.mean;
        // A current against the flux has no side of it.
        let small = omega_m.within(R::from_f64(SPEED_AGAINST))
            || along <= R::ZERO
            || across.within(along * R::from_f64(LOAD_AGAINST));
        if !small && (omega_m < R::ZERO) != (across < R::ZERO) {
            self.against = self.against.saturating_add(1);
        } else {
            self.against = self.against.saturating_sub(1);
        }
        if self.against < c.against || x.sigma < R::from_f64(SIGMA_MIRRORED) {
            return None;
        }
        // To the current, and beyond it by as much, or by the angle at which the flux would have collapsed so far.
        let tan = (across * along.recip()).limit(R::ONE);
        let cos = (R::ONE + tan * tan).rsqrt();
        let to_current = Rotator { cos, sin: tan * cos };
        let beyond = angle_of(self.mean.cosine(cos).min(cos), to_current.sin < R::ZERO);
        self.begin(Stage::Mirrored, x.psi_r);
        Some(to_current.turned_by(&beyond))
    }

    /// The turn to the first side of the current, where the flux has collapsed.
    fn collapsed(&mut self, c: &SidesConfig, x: &StandingField<R>) -> Option<Rotator<R>> {
        let Quantities { magnetised, along, .. } = self.mean;
        if magnetised >= along * R::from_f64(COLLAPSED) {
            self.calls = self.calls.saturating_sub(1);
            return None;
        }
        if self.calls == 0 || x.psi_r > self.psi_r * R::from_f64(1.0 + COLLAPSED_RISES) {
            (self.calls, self.psi_r) = (0, x.psi_r);
        }
        self.calls += 1;
        if self.calls < c.collapse {
            return None;
        }
        self.begin(Stage::First, x.psi_r);
        Some(angle_of(self.mean.cosine(R::ONE), stands_before_a_zero(&self.mean.i_s)))
    }
}

/// Whether a field stands, given its frequency and the largest recent torque current over the magnetising one.
#[inline(always)]
pub fn stands<R: Real>(omega_s: R, load: R) -> bool {
    omega_s.within(R::from_f64(STANDS)) && load < R::from_f64(UNLOADED)
}

/// Whether an angle with this deviation, rad, is not known.
#[inline(always)]
pub fn is_unknown<R: Real>(sigma: R) -> bool {
    sigma > R::from_f64(SIGMA_UNKNOWN)
}

/// The angle of a cosine.
fn angle_of<R: Real>(cos: R, negative: bool) -> Rotator<R> {
    let sin = (R::ONE - cos * cos).max(R::ZERO).sqrt();
    Rotator { cos, sin: if negative { -sin } else { sin } }
}

/// Whether the zero of a phase current that is nearest to a current lies ahead of it, in the positive direction.
fn stands_before_a_zero<R: Real>(i_s: &AlphaBeta<R>) -> bool {
    let [a, b, c] = i_s.to_phases();
    // A phase current, and √3 times the component across its axis.
    let by_phase = [(a, b - c), (b, c - a), (c, a - b)];
    let nearest = by_phase.into_iter().reduce(|x, y| if y.0.abs() < x.0.abs() { y } else { x });
    nearest.is_some_and(|(along, across)| (along < R::ZERO) == (across < R::ZERO))
}

#[cfg(test)]
mod tests {
    extern crate std;
    use std::vec::Vec;

    use super::*;

    const C: SidesConfig = SidesConfig { collapse: 60, against: 42, trial: 50 };
    /// Rotor time constant in calls, and `l_M`.
    const TAU_R: f64 = 200.0;
    const L_M: f64 = 2.5;

    /// A machine whose field stands; its current lies along the estimated flux, which is held while nothing is tried, and only
    /// integrated in a trial. The load of the shaft is the torque of the beginning.
    struct Rig {
        sides: Sides<f64>,
        /// Speed in units of `1/τ_r`, and what the torque `ψ_R × L_M i_s` adds to it in a call.
        speed: f64,
        by_torque: f64,
        load: f64,
        /// Error of the voltage along the estimated flux, as a decay of that in `τ_r`.
        drifts: f64,
        /// Rotor flux, the estimated one, and the angle of the current against that.
        psi_r: AlphaBeta<f64>,
        estimate: AlphaBeta<f64>,
        phi: f64,
        /// `L_M` of the machine over that of the parameters.
        told: f64,
        sigma: f64,
        omega_m: f64,
    }

    impl Rig {
        /// In the steady state of a current in a direction, along the estimated flux.
        fn new(speed: f64, direction: f64) -> Self {
            let (cos, delta) = (1.0 / speed.hypot(1.0), speed.atan());
            let at = |angle: f64| AlphaBeta::new(cos * angle.cos(), cos * angle.sin());
            Self {
                sides: Sides::default(),
                speed,
                by_torque: 0.0,
                load: cos * delta.sin(),
                drifts: 0.0,
                psi_r: at(direction + delta),
                estimate: at(direction),
                phi: 0.0,
                told: 1.0,
                sigma: 0.5,
                omega_m: 0.0,
            }
        }

        /// Angle of the estimated flux.
        fn angle(&self) -> f64 {
            self.estimate.im().atan2(self.estimate.re())
        }

        /// Error of that angle, degrees.
        fn error(&self) -> f64 {
            self.psi_r.cross(&self.estimate).atan2(self.psi_r.dot(&self.estimate)).to_degrees()
        }

        /// Calls; in which of them the flux was turned, and by how many degrees.
        fn run(&mut self, c: &SidesConfig, calls: u32) -> Vec<(u32, f64)> {
            let mut turns = Vec::new();
            for k in 0..calls {
                let (sin, cos) = (self.angle() + self.phi).sin_cos();
                let i_s = AlphaBeta::new(cos / L_M, sin / L_M);
                let dragged = AlphaBeta::new(-self.psi_r.im(), self.psi_r.re()) * self.speed;
                let slope = (i_s * L_M - self.psi_r + dragged) * (1.0 / TAU_R);
                self.speed += self.by_torque * (self.psi_r.cross(&(i_s * L_M)) + self.load);
                self.psi_r += slope;
                let trying = self.sides.is_trying();
                if trying {
                    self.estimate += slope;
                }
                let psi_r = self.estimate.norm_sq().sqrt();
                let follows = if trying { 1.0 } else { self.psi_r.norm_sq().sqrt() / psi_r };
                self.estimate = self.estimate * (follows * (1.0 - self.drifts / TAU_R));
                let psi_r = self.estimate.norm_sq().sqrt();
                let now = Quantities {
                    magnetised: psi_r * self.told,
                    along: self.phi.cos(),
                    across: self.phi.sin(),
                    i_s,
                    omega_m: self.omega_m,
                };
                if let Some(turn) = self.sides.step(c, &StandingField { psi_r, sigma: self.sigma, now }) {
                    self.estimate = turn.turn(&self.estimate);
                    turns.push((k, turn.sin.atan2(turn.cos).to_degrees()));
                }
            }
            turns
        }
    }

    /// Calls of the suspicion and of so many trials.
    fn trials(number: u32) -> u32 {
        C.collapse + number * C.trial
    }

    #[test]
    fn a_flux_that_has_collapsed_is_found_on_either_side_of_the_current() {
        for speed in [0.42, 0.45] {
            // The current before a zero and behind one: the first side is the right one in one of the two.
            for (sign, degrees) in [(1.0, 89.0), (1.0, 91.0), (-1.0, 89.0), (-1.0, 91.0)] {
                let mut rig = Rig { by_torque: 0.04, ..Rig::new(sign * speed, f64::to_radians(degrees)) };
                assert!((rig.error().abs() - speed.atan().to_degrees()).abs() < 0.1);
                let first = (sign < 0.0) == (degrees < 90.0);
                let turns = rig.run(&C, trials(if first { 1 } else { 2 }));
                assert_eq!(turns.len(), if first { 1 } else { 2 }, "{sign} {degrees}: {turns:?}");
                assert_eq!(turns[0].0, C.collapse - 1);
                assert!(rig.error().abs() < 5.0, "{sign} {degrees}: {}°, {turns:?}", rig.error());
                assert_eq!(rig.sides.stage, Stage::Pausing);
            }
        }
    }

    #[test]
    fn at_constant_speed_a_flux_answers_alike_on_either_side() {
        let rise = |sign: f64| {
            let mut rig = Rig::new(sign * 0.42, 1.5);
            assert_eq!(rig.run(&C, C.collapse).len(), 1);
            let before = rig.estimate.norm_sq().sqrt();
            rig.run(&C, C.trial - 1);
            rig.estimate.norm_sq().sqrt() / before - 1.0
        };
        // (1 - cos δ)(1 - e⁻ᴾ), and the square of the angle by which the flux is dragged meanwhile.
        assert!((0.01..0.025).contains(&rise(-1.0)), "{}", rise(-1.0));
        assert!((rise(1.0) - rise(-1.0)).abs() < 0.01, "{} {}", rise(1.0), rise(-1.0));
    }

    #[test]
    fn a_flux_that_falls_on_either_side_is_turned_back() {
        for degrees in [89.0, 91.0, 200.0] {
            let mut rig = Rig { told: 0.9, drifts: 0.5, ..Rig::new(0.0, f64::to_radians(degrees)) };
            let turns = rig.run(&C, 200);
            assert_eq!(turns.len(), 3, "{turns:?}");
            assert!(turns.iter().map(|turn| turn.1).sum::<f64>().abs() < 1e-6, "{turns:?}");
            assert!(rig.run(&C, 100).is_empty(), "not again at once");
        }
    }

    #[test]
    fn the_flux_of_a_shaft_that_turns_against_its_torque_is_mirrored_about_the_current() {
        for sign in [1.0, -1.0] {
            let at = |sigma, omega_m| {
                let mut rig = Rig { sigma, omega_m, ..Rig::new(sign * 0.1, 0.3) };
                // The estimate is as far from the current as the flux, on the other side.
                rig.estimate = Rotator { cos: 0.1_f64.cos(), sin: -sign * 0.1_f64.sin() }.turn(&rig.estimate);
                rig.phi = sign * 0.1;
                let turns = rig.run(&C, 100);
                (turns, rig.error())
            };
            let (turns, error) = at(0.5, -sign * 0.003);
            assert_eq!(turns.len(), 1, "{turns:?}");
            assert!((turns[0].1 - sign * 0.2_f64.to_degrees()).abs() < 1.5 && error.abs() < 3.0, "{turns:?} {error}");
            assert!(at(0.1, -sign * 0.003).0.is_empty(), "an angle that is known");
            assert!(at(0.5, sign * 0.003).0.is_empty(), "a shaft that follows its torque");
            assert!(at(0.5, -sign * 0.001).0.is_empty(), "a shaft that all but stands");
        }
    }

    #[test]
    fn a_flux_against_which_the_current_lies_is_not_turned() {
        for degrees in [91.0, 150.0, 180.0] {
            let mut rig = Rig { phi: f64::to_radians(degrees), omega_m: -0.003, ..Rig::new(0.0, 0.3) };
            let turns = rig.run(&C, 45);
            assert!(turns.is_empty(), "{degrees}: {turns:?}");
        }
    }

    #[test]
    fn without_the_setting_nothing_is_turned() {
        let never = SidesConfig { collapse: u32::MAX, against: u32::MAX, ..C };
        let mut rig = Rig { omega_m: 0.01, phi: -0.2, ..Rig::new(0.8, 1.5) };
        assert!(rig.run(&never, 2000).is_empty() && !rig.sides.is_trying());
    }

    #[test]
    fn a_zero_lies_ahead_within_the_half_of_a_sector_before_it() {
        for sector in 0..6 {
            for (degrees, ahead) in [(1.0, false), (20.0, false), (40.0, true), (59.0, true)] {
                let (sin, cos) = f64::to_radians(30.0 + 60.0 * f64::from(sector) + degrees).sin_cos();
                assert_eq!(stands_before_a_zero(&AlphaBeta::new(cos, sin)), ahead, "{sector} {degrees}");
            }
        }
    }
}
