//! Catching a flux that hardly turns, or is small: the current turns, and what depends on it drops out. Per unit.
//!
//! ```text
//! dψ_R/dτ - r_R i = e = (jω - 1/τ_r) ψ_R,      ψ_R = e/(jω - 1/τ_r)
//!
//! i* = I e^(jω_p τ):  e_k = <dψ_R/dτ> over turns k of the current, ω_p about 5;   Δ_k = e_1 + ... + e_k
//!   A = Σ Δ_k-1 × e_k = (n³ - n)/6 ωT_p |e|²     twice the area that the flux has swept over
//!   ω = 2 arg(e_n/Δ_n-1)/nT_p                   |ω| > 0.3, or without a known flux
//!   ω = 6 A/(n³ - n)T_p |e|²                    |e| < 2 |ψ_R|/τ_r, up to 2/τ_r
//!   ω² = |e|²/|ψ_R|² - 1/τ_r²                   else, with the sign of A; all of them once |A| > U |Δ_n|
//! ```
//!
//! Without current ([`super::catch`]) the inverter model is at its worst: the legs have no certain sign of their current, and
//! its error, 0.03 to 0.05, turns `e`. Below |e| = 0.2 that is more than a fifth of a radian.
//!
//! Here the current turns once in `T_p`, far faster than the shaft. All that depends on the current and changes its sign
//! with it, `r_s i`, the loss of the bridge with its knee, the torque and `r_R i`, is zero in the mean over a turn, and the
//! leakage flux is the same at both of its ends. What is left is the noise of the flux at the ends of a turn, 0.0007 of `e`
//! at most. A turn begins where the one before ends, so that it does not add up in `A/|Δ_n|`: six times it is `U` = 0.003.
//! The sign of a slow rotation is certain after
//!
//! ```text
//! nT_p = √(6 U T_p/ψ_R)/|ω|,      0.15 rad of a rotation at rated flux
//! ```
//!
//! A shaft that has come to rest since the stop shows only that: `|e|` below 0.006, twice the error of the voltage that a turn leaves. Its
//! flux lies, to half of the angle, in the middle of what the speed of the stop has turned it by, and where it was.
//!
//! It is not needed where `1/τ_r` prevails: with `|ω|` certainly below 0.4/τ_r the flux is where `-e` is, to 20°. A flux of
//! the stop whose direction is known decides at once, if the speed that it takes for `e` has not turned it since.
//!
//! **Validity.** `|ω|` up to 1.25; a speed that does not pass zero meanwhile.

use super::catch::{BLOCKS, Catch, CatchConfig, Direction, Found, LARGEST, TURNING, VOLTAGE_ERROR};
use crate::scalar::Real;
use crate::space::{AlphaBeta, Dq, Rotator};

/// Voltage over turns: the least, and `U`.
const FAINT: f64 = 0.0015;
const CERTAIN: f64 = 0.003;
/// Speed up to which the known flux tells it better than the angle of a turn.
const BY_FLUX: f64 = 0.3;
/// Largest angle since the beginning by which a flux of known direction has turned, and part of `1/τ_r` that a speed is below
/// which is taken for none.
const KEPT: f64 = 0.3;
const BY_DECAY: f64 = 0.4;
/// Largest angle, rad, that the flux of a shaft which has come to rest may have turned with half of it taken for the truth.
const COASTED: f64 = 1.5;
/// Largest difference between the voltage that is induced and the one that the flux and the speed of the stop would induce, relative to
/// the latter: 24°.
const AGREES: f64 = 0.4;
/// Turns of the current after which a flux that is not known is taken for what it seems, or none; and the most that count.
const LONGEST: u32 = 8;
const MOST: u32 = 64;
/// Of a flux that is not known the least magnitude, three times what an error of the leakage lets the current change of its
/// estimate, and the least angle by which `e` has turned.
const CLEAR: f64 = 0.06;
const TURNED: f64 = 0.25;
/// Scale of small vectors of which the direction counts.
const SCALE: f64 = 16.0;

impl<R: Real> CatchConfig<R> {
    /// `1/T_p`.
    fn inv_t_p(&self) -> R {
        self.omega_p.times(1.0 / core::f64::consts::TAU)
    }
}

impl<R: Real> Catch<R> {
    /// The current begins to turn, or ends.
    pub fn set_turning(&mut self, turning: bool) {
        if !turning {
            self.i_s = AlphaBeta::default();
        } else if !self.is_turning() {
            self.i_s = Rotator::default().axis();
        }
    }

    /// After the blocks without current: whether it turns.
    pub fn is_turning(&self) -> bool {
        self.i_s.norm_sq() > R::HALF
    }

    /// One period with the current that turns, counted from one; its direction.
    #[cold]
    #[inline(never)]
    pub fn turn(&mut self, c: &CatchConfig<R>, period: u32, psi_r: AlphaBeta<R>) -> Rotator<R> {
        if !self.is_turning() {
            return Rotator::default();
        }
        let direction = Rotator::of(&self.i_s).0.turned(c.advance);
        self.i_s = direction.axis();
        let periods = c.block * c.turn;
        let rise = c.block * c.rise;
        if period >= rise && (period - rise).is_multiple_of(periods) {
            if period == rise {
                (self.first, self.blocks, self.numerator) = (psi_r, 0, R::ZERO);
            } else {
                self.blocks += 1;
                self.e = (psi_r - self.psi_r) * (c.inv_t_p() * R::from_f64(SCALE));
                let before = (self.psi_r - self.first) * (c.inv_t_p() * R::from_f64(SCALE));
                self.numerator += before.cross(&self.e);
            }
            self.psi_r = psi_r;
        }
        direction
    }

    /// What there is after a turn of the current, the second at least.
    #[cold]
    #[inline(never)]
    pub fn found_turning(&self, c: &CatchConfig<R>, known: Option<(AlphaBeta<R>, Direction<R>)>) -> Found<R> {
        let r = R::from_f64;
        let n = self.blocks.clamp(2, MOST);
        let of_turns = R::ONE.periods(n) * r(64.0);
        let inv_n = of_turns.recip();
        let (inv_t_p, t_p) = (c.inv_t_p(), (c.t_block * r(64.0)).periods(c.turn));
        let total = (self.psi_r - self.first) * (inv_t_p * r(SCALE));
        let (mean, all) = (total * inv_n, total.norm_sq().sqrt());
        let magnitude = all * inv_n;
        // A shaft that has come to rest since the stop induces too little to tell its direction.
        if let Some((psi_r, Direction::IfSteady(_, angle))) = known
            && angle.within(r(COASTED))
            && magnitude < r(2.0 * VOLTAGE_ERROR * SCALE)
        {
            let back = Rotator::default().turned(-angle.half());
            return Found::Flux(back.turn(&psi_r), R::ZERO);
        }
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
        let Some((psi_r, direction)) = known else {
            if !certain || by_angle.within(r(TURNING)) || (sine.within(r(TURNED)) && n < LONGEST) {
                return if n < LONGEST { Found::Uncertain } else { Found::Nothing };
            }
            return match self.flux(c, &self.e, by_angle, t_p, None) {
                Found::Flux(psi_r, omega) if psi_r.norm_sq() > r(CLEAR * CLEAR) => Found::Flux(psi_r, omega),
                _ => Found::Nothing,
            };
        };
        if certain && !by_angle.within(r(BY_FLUX)) {
            return match self.flux(c, &self.e, by_angle, t_p, None) {
                // Of a speed that changes fast the angle of a turn says nothing, and the flux that follows from it differs.
                Found::Flux(found, _) if !is_like(&found, &psi_r) => Found::Uncertain,
                found => found,
            };
        }
        let (inv_psi, t) = (psi_r.norm_sq().rsqrt(), t_p * of_turns);
        let psi = psi_r.norm_sq() * inv_psi;
        // A and U as speeds.
        let per_area = r(6.0) * (of_turns * of_turns - R::ONE).recip() * inv_t_p * magnitude.recip();
        let (by_area, deviation) = (area * inv_n * magnitude.recip() * per_area, per_area * r(CERTAIN * SCALE));
        if certain {
            let rate = (magnitude * r(1.0 / SCALE) * inv_psi).min(R::ONE);
            let by_flux = (rate * rate - c.inv_tau_r * c.inv_tau_r).max(R::ZERO).sqrt();
            let slow = rate < c.inv_tau_r * R::TWO;
            let omega = if slow { by_area.limit(c.inv_tau_r * R::TWO) } else { with_sign(by_flux, area) };
            return self.flux(c, &mean, omega, t, Some(psi));
        }
        if by_area.abs() + deviation < c.inv_tau_r * r(BY_DECAY) {
            return self.flux(c, &mean, by_area, t, Some(psi));
        }
        let omega = psi_r.cross(&self.e) * (inv_psi * inv_psi * r(1.0 / SCALE));
        let turned = omega * (c.t_block * r(64.0)).periods(BLOCKS + c.rise + n * c.turn);
        let directed = match direction {
            Direction::IfSteady(omega, _) => self.agrees(c, &mean, &psi_r, omega),
            _ => direction.is_taken(),
        };
        if directed && turned.within(r(KEPT)) {
            let axis = Rotator::default().turned(turned);
            return Found::Flux(axis.turn(&psi_r), omega);
        }
        Found::Uncertain
    }

    /// Whether `e`, at [`SCALE`], is what a flux at a speed induces, and that is enough to tell.
    #[cold]
    #[inline(never)]
    fn agrees(&self, c: &CatchConfig<R>, e: &AlphaBeta<R>, psi_r: &AlphaBeta<R>, omega: R) -> bool {
        let r = R::from_f64;
        let expected = (AlphaBeta::new(-psi_r.im(), psi_r.re()) * omega - *psi_r * c.inv_tau_r) * r(SCALE);
        let square = expected.norm_sq();
        square > r(SCALE * SCALE * 4.0 * VOLTAGE_ERROR * VOLTAGE_ERROR)
            && (*e - expected).norm_sq() < square * r(AGREES * AGREES)
    }

    /// Speed of a flux by what the last turn has induced.
    pub fn speed_of(&self, psi_r: &AlphaBeta<R>) -> R {
        (psi_r.cross(&self.e) * R::from_f64(1.0 / SCALE) * psi_r.norm_sq().recip()).limit(R::TWO)
    }

    /// `e/(jω - 1/τ_r)` at the end of the time `t` of which `e`, at [`SCALE`], is the mean, with the magnitude that is known.
    #[cold]
    #[inline(never)]
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

/// Whether a flux has the magnitude of another one, within a factor of two.
fn is_like<R: Real>(psi_r: &AlphaBeta<R>, other: &AlphaBeta<R>) -> bool {
    let (square, of_other) = (psi_r.norm_sq(), other.norm_sq());
    square > of_other.quarter() && square.quarter() < of_other
}

/// A magnitude with the sign of a quantity.
fn with_sign<R: Real>(magnitude: R, sign: R) -> R {
    if sign < R::ZERO { -magnitude } else { magnitude }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::PerUnit;
    use crate::params::{Inverter, Machine};
    use crate::scalar::Q;

    const I: f64 = 0.4;

    /// Flux and speed that are found in a machine with a flux and a speed, and the seconds that it takes. The voltage is wrong
    /// by 0.04 in the direction of the current, as the loss of a bridge that is not known. `turns`: the current does.
    fn search<R: Real>(
        (psi, omega): (f64, f64),
        known: Option<(f64, Direction<f64>)>,
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
            psi_r += own * pu.t_s;
            integral += (own + i * (0.04 / I)) * pu.t_s;
            let turn = c.block * c.turn;
            if period >= c.block * c.rise + 2 * turn && (period - c.block * c.rise).is_multiple_of(turn) {
                let known = known.map(|(part, direction)| {
                    let psi = stop * part;
                    let direction = match direction {
                        Direction::IfSteady(omega, angle) => {
                            Direction::IfSteady(R::from_f64(omega), R::from_f64(angle))
                        }
                        Direction::Known => Direction::Known,
                        _ => Direction::Unknown,
                    };
                    (AlphaBeta::new(R::from_f64(psi.re()), R::from_f64(psi.im())), direction)
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
    fn errors<R: Real>(at: (f64, f64), known: Option<(f64, Direction<f64>)>, turns: bool) -> (f64, f64, f64) {
        let (found, truth, seconds) = search::<R>(at, known, turns);
        let Found::Flux(psi_r, omega) = found else { panic!("{at:?}: {found:?}") };
        let psi_r = AlphaBeta::new(f64::from(psi_r.re().to_f32()), f64::from(psi_r.im().to_f32()));
        (truth.cross(&psi_r).atan2(truth.dot(&psi_r)).abs(), f64::from(omega.to_f32()) - at.1, seconds)
    }

    #[test]
    fn a_current_that_turns_shows_a_slow_flux_and_its_direction_through_the_loss_of_the_bridge() {
        for omega in [0.02, -0.04, 0.1, -0.3, 0.9] {
            for psi in [0.3, 0.8] {
                let known = Some((0.95, Direction::Unknown));
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
        let (angle, ..) = errors::<f64>((0.3, 0.1), Some((0.95, Direction::Unknown)), false);
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
        // After the rise and two turns, 3 and 8 ms.
        let (angle, speed, seconds) = errors::<f64>((0.8, 0.0), Some((1.0, Direction::Known)), true);
        assert!(angle < 0.1 && speed.abs() < 0.01 && seconds < 0.0115, "{angle} rad, {speed}, {seconds} s");
        // Without it the decay shows where the flux is, later.
        let (angle, _, seconds) = errors::<f64>((0.8, 0.0), Some((1.0, Direction::Unknown)), true);
        assert!(angle < 0.1 && seconds > 0.02, "{angle} rad, {seconds} s");
    }

    #[test]
    fn a_flux_that_the_speed_of_the_stop_has_turned_decides_where_it_induces_what_that_speed_would() {
        for omega in [0.03, -0.03] {
            let told = |part: f64| Some((0.9, Direction::IfSteady(part * omega, 2.0)));
            let (angle, _, seconds) = errors::<f64>((0.4, omega), told(1.0), true);
            assert!(angle < 0.1 && seconds < 0.0115, "{omega}: {angle} rad, {seconds} s");
            // A shaft that turns the other way, or hardly any more, is found as without it.
            for part in [-1.0, 0.1] {
                let (angle, _, seconds) = errors::<f64>((0.4, omega), told(part), true);
                assert!(angle < 0.2 && seconds > 0.015, "{omega}, told {part} of it: {angle} rad, {seconds} s");
            }
        }
    }

    #[test]
    fn a_flux_that_induces_nothing_since_the_shaft_has_come_to_rest_lies_in_the_middle_of_what_it_may_have_turned() {
        let told = |angle: f64| Some((0.9, Direction::IfSteady(0.03, angle)));
        for angle in [0.6, -1.2] {
            // The direction that is told is the true one, so that the error is what it is turned back by.
            let (error, speed, seconds) = errors::<f64>((0.15, 0.0), told(angle), true);
            assert!((error - 0.5 * angle.abs()).abs() < 0.05 && speed.abs() < 1e-9, "{angle}: {error} rad, {speed}");
            assert!(seconds < 0.0115, "{angle}: {seconds} s");
        }
        // Not where half of it would say little.
        let (error, _, seconds) = errors::<f64>((0.15, 0.0), told(2.0), true);
        assert!(error < 0.2 && seconds > 0.015, "{error} rad, {seconds} s");
    }
}
