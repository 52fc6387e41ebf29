//! Catching a machine that rotates with a flux of its own: restart after a pause, or a start in a machine that has one. Per
//! unit.
//!
//! ```text
//! dψ_R/dτ - r_R i = e = (jω - 1/τ_r) ψ_R,      ψ_R = e/(jω - 1/τ_r)
//!
//! i* = 0:          e = dψ_R/dτ over blocks of 1 ms, eight of them, of which three pass with the surge
//!   ω = Σ e_k-1 × e_k/(T Σ |e_k-1|²)           |ω| > 0.7
//!   |ω| = |e|/|ψ_R|                            else, with the flux of the stop, less its decay, if it is known
//!   ω = arcsin(e_4 × e_8/|e_4||e_8|)/4T        else
//!
//! i* = I e^(jω_p τ):  e_k = <dψ_R/dτ> over turns k of the current, ω_p about 5;   Δ_k = e_1 + ... + e_k
//!   A = Σ Δ_k-1 × e_k = (n³ - n)/6 ωT_p |e|²     twice the area that the flux has swept over
//!   ω = 2 arg(e_n/Δ_n-1)/nT_p                   |ω| > 0.3, or without a known flux
//!   ω = 6 A/(n³ - n)T_p |e|²                    |e| < 2 |ψ_R|/τ_r
//!   ω² = |e|²/|ψ_R|² - 1/τ_r²                   else, with the sign of A; all of them once |A| > U |Δ_n|
//! ```
//!
//! Without current the voltage of the machine is the one that its rotor flux induces. Current control at zero finds it:
//! the latest voltage less that of the leakage, `ê = u - σl_s Δi/t_s`, is fed forward, which ends the surge of the first
//! periods after two delays. The inverter model is at its worst there: the legs have no certain sign of their current, and
//! its error, 0.03 to 0.05, turns `e`. From |e| = 0.25 on, which that turns by a tenth to a fifth of a radian, it decides.
//!
//! Below, the current turns once in `T_p`, far faster than the shaft. All that depends on the current and changes its sign
//! with it, `r_s i`, the loss of the bridge with its knee, the torque and `r_R i`, is zero in the mean over a turn, and the
//! leakage flux is the same at both of its ends. What is left is the noise of the flux at the ends of a turn, 0.0007 of `e`
//! at most. A turn begins where the one before ends, so that it does not add up in `A/|Δ_n|`: six times it is `U` = 0.003.
//! The sign of a slow rotation is certain after
//!
//! ```text
//! nT_p = √(6 U T_p/ψ_R)/|ω|,      0.15 rad of a rotation at rated flux
//! ```
//!
//! It is not needed where `1/τ_r` prevails: with `|ω|` certainly below 0.4/τ_r the flux is where `-e` is, to 20°. A flux of
//! the stop whose direction is known decides at once, if the speed that it takes for `e` has not turned it since.
//!
//! **Validity.** `|ω|` up to 1.25; a speed that does not pass zero meanwhile.

use crate::base::{PerUnit, rounded};
use crate::scalar::Real;
use crate::space::{AlphaBeta, Dq, Rotator};
use crate::words::words;

/// Blocks without current, and those before the current is back at zero.
pub(crate) const BLOCKS: u32 = 8;
const SURGE: u32 = 3;
/// Blocks before the first turn of the current, in which it rises.
pub(crate) const RISE: u32 = 2;
/// Normalised time of a turn: half of it is what a machine at 1.25 pu turns by `3/4`.
const TURN: f64 = 1.2;
/// Least induced voltage without current that is none of the inverter model.
pub(crate) const LEAST: f64 = 0.06;
/// That from which on it shows the direction of the flux without current; over turns of the current the least, and `U`.
const STRONG: f64 = 0.25;
const FAINT: f64 = 0.0015;
const CERTAIN: f64 = 0.003;
/// Speed up to which the angle over four blocks is below a quarter turn.
const SLOW: f64 = 0.7;
/// Angle by which `e` has certainly turned without current.
const SURE: f64 = 0.4;
/// Speed up to which the known flux tells it better than the angle of a turn.
const BY_FLUX: f64 = 0.3;
/// Largest angle since the beginning by which a flux of known direction has turned, and part of `1/τ_r` that a speed is below
/// which is taken for none.
const KEPT: f64 = 0.3;
const BY_DECAY: f64 = 0.4;
/// Turns of the current after which a flux that is not known is taken for what it seems, or none; and the most that count.
const LONGEST: u32 = 8;
const MOST: u32 = 64;
/// Least speed with a flux that is not known, and the angle by which `e` has turned then.
const TURNING: f64 = 0.03;
const CLEAR: f64 = 0.06;
const TURNED: f64 = 0.25;
/// Largest flux that is taken for one.
const LARGEST: f64 = 1.5;
/// Scale of small vectors of which the direction counts.
const SCALE: f64 = 16.0;

/// What the induced voltage shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Found<R: Real> {
    /// No flux that induces a voltage.
    Nothing,
    /// Perhaps a flux; its direction does not show yet.
    Uncertain,
    /// Rotor flux and speed.
    Flux(AlphaBeta<R>, R),
}

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct CatchConfig<R: Real> {
    /// Control periods of a block, its duration and the reciprocal.
    pub block: u32,
    pub t_block: R,
    pub inv_t_block: R,
    /// `σl_s/t_s`.
    pub leakage: R,
    /// Blocks of a turn of the current, the angle of a period, and `ω_p`.
    pub turn: u32,
    pub advance: R,
    pub omega_p: R,
    /// `1/τ_r`.
    pub inv_tau_r: R,
}
words!(CatchConfig: block, t_block, inv_t_block, leakage, turn, advance, omega_p, inv_tau_r);

impl<R: Real> CatchConfig<R> {
    /// Blocks of at least a time in s at a control frequency in Hz.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn new(pu: &PerUnit, least: f64, f_c: f64) -> Self {
        // At least 0.0125 of normalised time, whose reciprocal fits fixed point.
        let block = libm::round(least * f_c).max(libm::ceil(0.0125 / pu.t_s));
        let t_block = block * pu.t_s;
        // At least 12 periods.
        let turn = libm::round(TURN / t_block).max(libm::ceil(12.0 / block));
        let advance = core::f64::consts::TAU / (turn * block);
        Self {
            block: block as u32,
            t_block: rounded(t_block),
            inv_t_block: rounded(1.0 / t_block),
            // Limited for fixed point: with periods shorter than a hundredth of the leakage the surge ends later.
            leakage: rounded((pu.sigma_l_s / pu.t_s).min(100.0)),
            turn: turn as u32,
            advance: rounded(advance),
            omega_p: rounded(advance / pu.t_s),
            inv_tau_r: rounded(1.0 / pu.tau_r),
        }
    }

    /// `1/T_p`.
    fn inv_t_p(&self) -> R {
        self.omega_p.times(1.0 / core::f64::consts::TAU)
    }
}

/// State.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct Catch<R: Real> {
    /// Integrated rotor flux at the beginning of the block or turn, and the voltage induced in the last one.
    psi_r: AlphaBeta<R>,
    e: AlphaBeta<R>,
    /// That in the first block after the surge; integrated rotor flux at the beginning of the first turn.
    first: AlphaBeta<R>,
    /// Turns of the current.
    count: u32,
    /// `Σ e_k-1 × e_k` and its denominator, without current; `A`, at [`SCALE`], where it turns.
    numerator: R,
    denominator: R,
    /// Current of the period before; the direction of the current where it turns.
    last: AlphaBeta<R>,
}

impl<R: Real> Catch<R> {
    /// Begins at a current.
    pub fn new(i_s: AlphaBeta<R>) -> Self {
        let zero = AlphaBeta::default();
        Self { psi_r: zero, e: zero, first: zero, count: 0, numerator: R::ZERO, denominator: R::ZERO, last: i_s }
    }

    /// One period without current, counted from one, with the voltage applied before the sample, the current, and the
    /// integrated rotor flux. Returns field axis and flux for which current control at zero and `ω_s` = 1 feeds `ê` forward.
    pub fn step(
        &mut self,
        c: &CatchConfig<R>,
        period: u32,
        (u_s, i_s, psi_r): (&AlphaBeta<R>, AlphaBeta<R>, AlphaBeta<R>),
    ) -> (Rotator<R>, R) {
        let e = if period > 2 { *u_s - (i_s - self.last) * c.leakage } else { AlphaBeta::default() };
        self.last = i_s;
        if period.is_multiple_of(c.block) {
            let block = period / c.block.max(1);
            let mean = (psi_r - self.psi_r) * c.inv_t_block;
            if block == SURGE + 1 {
                self.first = mean;
            } else if block > SURGE {
                self.numerator += self.e.cross(&mean);
                self.denominator += self.e.norm_sq();
            }
            (self.psi_r, self.e) = (psi_r, mean);
        }
        // jω_s ψ_s is fed forward.
        if e.norm_sq() > R::from_f64(1e-4) {
            let (direction, magnitude) = Rotator::of(&e);
            let axis = AlphaBeta::new(direction.axis().im(), -direction.axis().re());
            (Rotator::of(&axis).0, magnitude.min(R::TWO))
        } else {
            (Rotator::default(), R::ZERO)
        }
    }

    /// The current begins to turn, or ends.
    pub fn set_turning(&mut self, turning: bool) {
        if !turning {
            self.last = AlphaBeta::default();
        } else if !self.is_turning() {
            self.last = Rotator::default().axis();
        }
    }

    /// After the blocks without current: whether it turns.
    pub fn is_turning(&self) -> bool {
        self.last.norm_sq() > R::HALF
    }

    /// One period with the current that turns, counted from one; its direction.
    pub fn turn(&mut self, c: &CatchConfig<R>, period: u32, psi_r: AlphaBeta<R>) -> Rotator<R> {
        if !self.is_turning() {
            return Rotator::default();
        }
        let direction = Rotator::of(&self.last).0.turned(c.advance);
        self.last = direction.axis();
        let periods = c.block * c.turn;
        let rise = c.block * RISE;
        if period >= rise && (period - rise).is_multiple_of(periods) {
            if period == rise {
                (self.first, self.count, self.numerator) = (psi_r, 0, R::ZERO);
            } else {
                self.count += 1;
                self.e = (psi_r - self.psi_r) * (c.inv_t_p() * R::from_f64(SCALE));
                let before = (self.psi_r - self.first) * (c.inv_t_p() * R::from_f64(SCALE));
                self.numerator += before.cross(&self.e);
            }
            self.psi_r = psi_r;
        }
        direction
    }

    /// What there is after the blocks without current; `known`: flux of the stop, and whether its direction is known.
    pub fn found(&self, c: &CatchConfig<R>, known: Option<(AlphaBeta<R>, bool)>) -> Found<R> {
        let r = R::from_f64;
        let square = self.e.norm_sq();
        if square < r(STRONG * STRONG) {
            let nothing = known.is_none() && square < r(LEAST * LEAST);
            return if nothing { Found::Nothing } else { Found::Uncertain };
        }
        let over_one = (self.numerator * self.denominator.max(r(LEAST * LEAST)).recip() * c.inv_t_block).limit(r(2.5));
        let sine = (self.first.cross(&self.e) * square.recip()).limit(R::ONE);
        let slow = over_one.within(r(SLOW));
        let mut sign = sine;
        if slow && sine.within(r(SURE)) {
            match known {
                Some((psi_r, true)) if psi_r.dot(&self.e).abs() < psi_r.cross(&self.e).abs() => {
                    sign = psi_r.cross(&self.e);
                }
                _ => return Found::Uncertain,
            }
        }
        let known = known.map(|(psi_r, _)| psi_r.norm_sq().sqrt());
        let omega = match known {
            Some(psi) if slow => with_sign((square.sqrt() * psi.recip()).min(R::ONE), sign),
            None if slow => (sine * (R::ONE + sine * sine * r(1.0 / 6.0))) * c.inv_t_block.quarter(),
            _ => over_one,
        };
        self.flux(c, &(self.e * r(SCALE)), omega, c.t_block, known.filter(|_| slow))
    }

    /// What there is after a turn of the current, the second at least.
    pub fn found_turning(&self, c: &CatchConfig<R>, known: Option<(AlphaBeta<R>, bool)>) -> Found<R> {
        let r = R::from_f64;
        let n = self.count.clamp(2, MOST);
        let of_turns = R::ONE.periods(n) * r(64.0);
        let inv_n = of_turns.recip();
        let (inv_t_p, t_p) = (c.inv_t_p(), (c.t_block * r(64.0)).periods(c.turn));
        let total = (self.psi_r - self.first) * (inv_t_p * r(SCALE));
        let (mean, all) = (total * inv_n, total.norm_sq().sqrt());
        let magnitude = all * inv_n;
        if magnitude < r(FAINT * SCALE) {
            return Found::Nothing;
        }
        let area = self.numerator;
        let certain = area.abs() > r(CERTAIN * SCALE) * all;
        let [before, last] = [total - self.e, self.e].map(|e| Rotator::of(&e).0.axis());
        let (sine, cosine) = (before.cross(&last), before.dot(&last));
        // The angle by that of its half: arctan x = x/(1 + 0.28 x²) to 0.005.
        let half = sine * (R::ONE + cosine).max(r(0.1)).recip();
        let half = half * (R::ONE + half * half * r(0.28)).recip();
        let by_angle = half * r(4.0) * inv_t_p * inv_n;
        let Some((psi_r, directed)) = known else {
            if !certain || by_angle.within(r(TURNING)) || (sine.within(r(TURNED)) && n < LONGEST) {
                return if n < LONGEST { Found::Uncertain } else { Found::Nothing };
            }
            return match self.flux(c, &self.e, by_angle, t_p, None) {
                Found::Flux(psi_r, omega) if psi_r.norm_sq() > r(CLEAR * CLEAR) => Found::Flux(psi_r, omega),
                _ => Found::Nothing,
            };
        };
        if certain && !by_angle.within(r(BY_FLUX)) {
            return self.flux(c, &self.e, by_angle, t_p, None);
        }
        let (inv_psi, t) = (psi_r.norm_sq().rsqrt(), t_p * of_turns);
        let psi = psi_r.norm_sq() * inv_psi;
        // A and U as speeds.
        let per_area = r(6.0) * (of_turns * of_turns - R::ONE).recip() * inv_t_p * magnitude.recip();
        let (by_area, deviation) = (area * inv_n * magnitude.recip() * per_area, per_area * r(CERTAIN * SCALE));
        if certain {
            let rate = (magnitude * r(1.0 / SCALE) * inv_psi).min(R::ONE);
            let by_flux = (rate * rate - c.inv_tau_r * c.inv_tau_r).max(R::ZERO).sqrt();
            let omega = if rate < c.inv_tau_r * R::TWO { by_area } else { with_sign(by_flux, area) };
            return self.flux(c, &mean, omega, t, Some(psi));
        }
        if by_area.abs() + deviation < c.inv_tau_r * r(BY_DECAY) {
            return self.flux(c, &mean, by_area, t, Some(psi));
        }
        let omega = psi_r.cross(&self.e) * (inv_psi * inv_psi * r(1.0 / SCALE));
        let turned = omega * (c.t_block * r(64.0)).periods(BLOCKS + RISE + n * c.turn);
        if directed && turned.within(r(KEPT)) {
            let axis = Rotator::default().turned(turned);
            return Found::Flux(axis.to_stator(&Dq::new(psi_r.re(), psi_r.im())), omega);
        }
        Found::Uncertain
    }

    /// `e/(jω - 1/τ_r)` at the end of the time `t` of which `e`, at [`SCALE`], is the mean, with the magnitude that is known.
    fn flux(&self, c: &CatchConfig<R>, e: &AlphaBeta<R>, omega: R, t: R, known: Option<R>) -> Found<R> {
        let r = R::from_f64;
        let (e, magnitude) = Rotator::of(e);
        let e = e.turned((omega * t).half().limit(R::ONE));
        let (conjugate, scaled) = Rotator::of(&(AlphaBeta::new(-c.inv_tau_r, -omega) * r(SCALE)));
        let psi = known.unwrap_or_else(|| magnitude * scaled.max(r(SCALE * TURNING)).recip());
        let along = e.to_stator(&Dq::new(conjugate.axis().re(), conjugate.axis().im()));
        if psi < r(LARGEST) { Found::Flux(along * psi, omega) } else { Found::Nothing }
    }
}

/// A magnitude with the sign of a quantity.
fn with_sign<R: Real>(magnitude: R, sign: R) -> R {
    if sign < R::ZERO { -magnitude } else { magnitude }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::{Inverter, Machine};
    use crate::scalar::Q;

    const I: f64 = 0.4;

    /// Flux and speed that are found in a machine with a flux and a speed, and the seconds that it takes. The voltage is wrong
    /// by 0.04 in the direction of the current, as the loss of a bridge that is not known. `turns`: the current does.
    fn search<R: Real>(
        (psi, omega): (f64, f64),
        known: Option<(f64, bool)>,
        turns: bool,
    ) -> (Found<R>, AlphaBeta<f64>, f64) {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let pu = PerUnit::new(&machine, &inverter).unwrap();
        let c = CatchConfig::<R>::new(&pu, 1e-3, inverter.f_c());
        let mut catch = Catch::<R>::new(AlphaBeta::default());
        catch.set_turning(true);
        let mut psi_r = AlphaBeta::<f64>::new(0.6 * psi, 0.8 * psi);
        let stop = psi_r;
        let mut integral = AlphaBeta::<f64>::default();
        for period in 1..2000u32 {
            let seen = AlphaBeta::new(R::from_f64(integral.re()), R::from_f64(integral.im()));
            let direction = catch.turn(&c, period, seen);
            let direction = if turns { direction } else { Rotator::default() }.axis();
            let part = |x: R| f64::from(x.to_f32());
            let i = AlphaBeta::new(part(direction.re()), part(direction.im())) * I;
            let own = AlphaBeta::new(-psi_r.im(), psi_r.re()) * omega - psi_r * (1.0 / pu.tau_r) + i * pu.r_r;
            psi_r = psi_r + own * pu.t_s;
            integral = integral + (own + i * (0.04 / I)) * pu.t_s;
            let turn = c.block * c.turn;
            if period >= c.block * RISE + 2 * turn && (period - c.block * RISE).is_multiple_of(turn) {
                let known = known.map(|(part, directed)| {
                    let psi = stop * part;
                    (AlphaBeta::new(R::from_f64(psi.re()), R::from_f64(psi.im())), directed)
                });
                let found = catch.found_turning(&c, known);
                if found != Found::Uncertain {
                    return (found, psi_r, f64::from(period) / inverter.f_c());
                }
            }
        }
        panic!("never decided");
    }

    /// Error of the direction, rad, and of the speed.
    fn errors<R: Real>(at: (f64, f64), known: Option<(f64, bool)>, turns: bool) -> (f64, f64, f64) {
        let (found, truth, seconds) = search::<R>(at, known, turns);
        let Found::Flux(psi_r, omega) = found else { panic!("{at:?}: {found:?}") };
        let psi_r = AlphaBeta::new(f64::from(psi_r.re().to_f32()), f64::from(psi_r.im().to_f32()));
        (truth.cross(&psi_r).atan2(truth.dot(&psi_r)).abs(), f64::from(omega.to_f32()) - at.1, seconds)
    }

    #[test]
    fn a_current_that_turns_shows_a_slow_flux_and_its_direction_through_the_loss_of_the_bridge() {
        for omega in [0.02, -0.04, 0.1, -0.3, 0.9] {
            for psi in [0.3, 0.8] {
                let known = Some((0.95, false));
                for (angle, speed, seconds) in
                    [errors::<f64>((psi, omega), known, true), errors::<Q>((psi, omega), known, true)]
                {
                    assert!(angle < 0.2 && speed.abs() < 0.02, "{psi} at {omega}: {angle} rad, {speed}");
                    // √(6 U T_p/ψ)/|ω|, two turns at least.
                    let most = 0.147 / psi.sqrt() / omega.abs() / 314.0;
                    assert!(seconds < 0.01 + 1.3 * most.max(0.008), "{psi} at {omega}: {seconds} s");
                }
            }
        }
        // With a current that keeps its direction the loss is a voltage like any other.
        let (angle, ..) = errors::<f64>((0.3, 0.1), Some((0.95, false)), false);
        assert!(angle > 0.5, "{angle}");
    }

    #[test]
    fn a_flux_that_is_not_known_is_found_by_its_rotation_alone_and_nothing_where_there_is_none() {
        for omega in [0.1, -0.3, 0.9] {
            let (angle, speed, _) = errors::<f64>((0.3, omega), None, true);
            assert!(angle < 0.1 && speed.abs() < 0.03, "{omega}: {angle} rad, {speed}");
        }
        assert_eq!(search::<f64>((0.0, 0.3), None, true).0, Found::Nothing);
        assert_eq!(search::<f64>((0.03, 0.3), None, true).0, Found::Nothing);
    }

    #[test]
    fn a_flux_of_known_direction_decides_at_standstill() {
        let (angle, speed, seconds) = errors::<f64>((0.8, 0.0), Some((1.0, true)), true);
        assert!(angle < 0.1 && speed.abs() < 0.01 && seconds < 0.011, "{angle} rad, {speed}, {seconds} s");
        // Without it the decay shows where the flux is, later.
        let (angle, _, seconds) = errors::<f64>((0.8, 0.0), Some((1.0, false)), true);
        assert!(angle < 0.1 && seconds > 0.02, "{angle} rad, {seconds} s");
    }
}
