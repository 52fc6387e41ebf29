//! Speed and flux of a large machine that turns, from what its rotor flux does under a direct current. Per unit.
//!
//! While and after [`super::search`] looks for a rotation the current along the a-axis goes on. The rotor flux goes round a
//! circle, and the integral of the voltage shows it with all that the voltage model does not explain of a direct current, which is
//! constant: errors `e` of resistance and bridge, as large as `r_R i` at 160 kW.
//!
//! ```text
//! dψ_R/dτ = r_R i + (jω - 1/τ_r) ψ_R:     ψ_R = r_R i/(1/τ_r - jω) + A e^(jωτ)
//! ψ̂_R = ψ_R + ψ_0 + e τ
//! ```
//!
//! Means `M_k` of equal blocks `T`, in each of which the circle turns by `φ = ωT` and decays: their second differences contain neither
//! the constant nor the drift,
//!
//! ```text
//! g_k = M_k+1 - 2 M_k + M_k-1 = a_k (z - 1)²/z,     z = e^((jω - 1/τ_r)T),     a_k: mean of the circle in the block
//! φ = arg Σ g_k+1 g_k*
//! e = (M_5 - M_1 - a_5 + a_1)/4T
//! in the end:  A e^(jωτ) = g_5 (jω - 1/τ_r)T (z/(z - 1))³
//! ```
//!
//! Seven blocks; where the flux has turned by less than 26° in one they are taken anew, twice as long.
//!
//! **Validity.** A speed that stays; a rotor flux below the knee of saturation.

use crate::base::{PerUnit, rounded};
use crate::scalar::Real;
use crate::space::{AlphaBeta, Rotator};
use crate::words::words;

/// Blocks.
const BLOCKS: u32 = 7;
/// Normalised time of the shortest block: 1.5 rad at 1.5 pu.
const SHORTEST: f64 = 1.0;
/// Rotor time constant, per unit, and length of the longest block in units of the shortest that a machine above it has: with 16 all blocks
/// take 217 of normalised time and show 0.03 pu, with one 7 and 0.45 pu. At the end of the last block a third of the circle is left, or three
/// quarters. A machine between the two builds up more flux by the end of the search than the errors of the voltage do, but a fast flux may
/// have come back to zero by then. Allowances: with longer blocks from 100 on slow rotations of 11 and 15 kW were lost more often.
const OUTLASTS: [(f64, u32); 2] = [(200.0, 16), (25.0, 1)];
/// Largest and least cosine of `φ`: a flux that has turned by 26°; and 127°, since second differences of white noise alternate, `φ` = 180°.
const SEEN: f64 = 0.9;
const NOISE: f64 = -0.6;
/// Least square of the coherence of the second differences, `|Σ g_k+1 g_k*|/Σ |g_k|²`, which is one without noise. Allowance.
const COHERENT: f64 = 0.64;
/// Least magnitude of them, relative to that of a machine without flux at the beginning. Allowance: what is left of a flux may make it less.
const LARGE: f64 = 0.25;
/// Standard deviation of the error that is found, per unit. Allowance: the loss of the bridge is not quite the same along another axis.
pub(super) const DEVIATION: f64 = 3e-4;
/// Least unit of the flux: its reciprocal fits fixed point.
const UNIT_LEAST: f64 = 0.01;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct CircleConfig<R: Real> {
    /// Periods of the shortest block, and length of the longest in units of it; 0: the search is enough.
    block: u32,
    longest: u32,
    /// The reciprocals of these and of their duration, and that.
    weight: R,
    inv_block: R,
    t_block: R,
    /// `1/τ_r`.
    inv_tau_r: R,
}
words!(CircleConfig: block, longest, weight, inv_block, t_block, inv_tau_r);

impl<R: Real> CircleConfig<R> {
    /// For a machine; not `on`: the search is enough.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn new(pu: &PerUnit, on: bool) -> Self {
        let block = libm::round(SHORTEST / pu.t_s).max(1.0);
        let t_block = block * pu.t_s;
        Self {
            block: block as u32,
            longest: if on {
                OUTLASTS.iter().find(|(tau_r, _)| pu.tau_r > *tau_r).map_or(0, |&(_, length)| length)
            } else {
                0
            },
            weight: rounded(1.0 / block),
            inv_block: rounded(1.0 / t_block),
            t_block: rounded(t_block),
            inv_tau_r: rounded(1.0 / pu.tau_r),
        }
    }

    /// Whether blocks of all lengths are looked at.
    pub fn shows_slow_speeds(&self) -> bool {
        self.longest > 1
    }

    /// Whether it follows the search.
    pub fn is_on(&self) -> bool {
        self.longest > 0
    }
}

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Circle<R: Real> {
    /// Speed.
    pub omega: R,
    /// Rotor flux at the end.
    pub psi_r: AlphaBeta<R>,
    /// Constant error of the voltage, as it is in the derivative of the integrated flux.
    pub error: AlphaBeta<R>,
}

/// State.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct CircleProbe<R: Real> {
    /// Blocks so far, periods of the present one, and the length of a block in units of the shortest; 0: it does not run.
    blocks: u32,
    period: u32,
    length: u32,
    /// Mean of the present block, as far as it goes; that of the last one, and its difference from the one before. In units of the
    /// flux that a block builds up at standstill.
    sum: AlphaBeta<R>,
    mean: AlphaBeta<R>,
    difference: AlphaBeta<R>,
    /// `M_1`, `g_1` and the latest `g_k`.
    first: [AlphaBeta<R>; 2],
    second: AlphaBeta<R>,
    /// `Σ g_k+1 g_k*` and `Σ |g_k|²`.
    turn: AlphaBeta<R>,
    square: R,
}

impl<R: Real> CircleProbe<R> {
    /// Begins.
    pub fn begin(&mut self) {
        *self = Self { length: 1, ..Self::default() };
    }

    /// Whether it runs.
    #[inline(always)]
    pub fn is_running(&self) -> bool {
        self.length > 0
    }

    /// One period, with `r_R i` and the integrated rotor flux. What was found; nothing while it runs, nor in the end in a machine that
    /// does not turn.
    #[cold]
    #[inline(never)]
    pub fn step(&mut self, c: &CircleConfig<R>, driven: R, psi_r: &AlphaBeta<R>) -> Option<Circle<R>> {
        if !self.is_running() {
            return None;
        }
        let r = R::from_f64;
        let length = R::ONE.periods(self.length) * r(64.0);
        let t_block = c.t_block * length;
        let unit = (driven * t_block).max(r(UNIT_LEAST));
        let inv_length = length.recip();
        self.sum += (*psi_r * unit.recip()) * (c.weight * inv_length);
        self.period += 1;
        if self.period < c.block * self.length {
            return None;
        }
        let mean = self.sum;
        let difference = mean - self.mean;
        let second = difference - self.difference;
        self.blocks += 1;
        if self.blocks == 3 {
            self.first = [self.mean, second];
        } else if self.blocks > 3 {
            self.turn += AlphaBeta::new(self.second.dot(&second), self.second.cross(&second));
        }
        if self.blocks >= 3 {
            let square = second.norm_sq();
            self.square += if self.blocks == 3 || self.blocks == BLOCKS { square.half() } else { square };
        }
        let middle = self.mean;
        (self.period, self.sum) = (0, AlphaBeta::default());
        (self.mean, self.difference, self.second) = (mean, difference, second);
        if self.blocks < BLOCKS {
            return None;
        }
        let found = self.found(c, (driven, t_block, unit), c.inv_block * inv_length, middle);
        if found.is_none() && self.length < c.longest {
            *self = Self { length: 2 * self.length, ..Self::default() };
            return None;
        }
        self.length = 0;
        found
    }

    /// What seven blocks show; `middle`: `M_5`.
    fn found(
        &self,
        c: &CircleConfig<R>,
        (driven, t_block, unit): (R, R, R),
        inv_block: R,
        middle: AlphaBeta<R>,
    ) -> Option<Circle<R>> {
        let r = R::from_f64;
        let coherence = self.turn * self.square.max(r(1e-3)).recip();
        let square = coherence.norm_sq();
        let inv = square.max(r(0.01)).rsqrt();
        let (cos, sin) = (coherence.re() * inv, coherence.im() * inv);
        if square < r(COHERENT) || cos > r(SEEN) || cos < r(NOISE) {
            return None;
        }
        // φ to 0.002 by tan(φ/4).
        let half = Rotator { cos: ((R::ONE + cos).half()).sqrt(), sin: ((R::ONE - cos).half()).sqrt() };
        let quarter = half.sin * (R::ONE + half.cos).recip();
        let angle = quarter * r(4.0) * (R::ONE + quarter * quarter * r(0.31)).recip();
        let chord = (R::ONE - cos) * R::TWO;
        let least = r(LARGE) * (driven * t_block * unit.recip()) * chord * angle.recip();
        if self.square < least * least * r(4.0) {
            return None;
        }
        let angle = if sin < R::ZERO { -angle } else { angle };
        let omega = angle * inv_block;
        let decay = t_block * c.inv_tau_r;
        let left = (R::ONE - decay.half()) * (R::ONE + decay.half()).recip();
        let z = AlphaBeta::new(cos * left, sin * left);
        let less = AlphaBeta::new(z.re() - R::ONE, z.im());
        let inverse = AlphaBeta::new(less.re(), -less.im()) * less.norm_sq().recip();
        // z/(z - 1)
        let w = product(&z, &inverse);
        let circle = |second: &AlphaBeta<R>| product(&product(&w, &inverse), second);
        let (first, last) = (self.first[0] - circle(&self.first[1]), middle - circle(&self.second));
        let error = (last - first) * (unit * inv_block).quarter();
        let ahead = product(&product(&w, &w), &product(&w, &self.second));
        let circle = product(&AlphaBeta::new(-decay, angle), &ahead) * unit;
        // r_R i/(1/τ_r - jω); eight times both fit fixed point.
        let rate = AlphaBeta::new(c.inv_tau_r, omega) * r(8.0);
        let centre = rate * (driven * r(8.0) * rate.norm_sq().recip());
        Some(Circle { omega, psi_r: centre + circle, error })
    }
}

/// Product of two complex numbers.
fn product<R: Real>(a: &AlphaBeta<R>, b: &AlphaBeta<R>) -> AlphaBeta<R> {
    Rotator { cos: a.re(), sin: a.im() }.turn(b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::search::tests::large;
    use crate::params::{Inverter, Machine};
    use crate::scalar::Q;

    /// What is found of a machine at a speed, with a rotor flux at the beginning and a constant error of the voltage, and its
    /// true flux in the end.
    fn found<R: Real>(
        (machine, inverter): (Machine, Inverter),
        omega: f64,
        begin: (f64, f64),
        error: (f64, f64),
    ) -> Option<(Circle<R>, [f64; 2])> {
        let pu = PerUnit::new(&machine, &inverter).unwrap();
        let c = CircleConfig::<R>::new(&pu, true);
        assert!(c.is_on());
        let driven = pu.r_r * 1.2 / pu.l_s;
        let mut probe = CircleProbe::default();
        probe.begin();
        let derivative = |[x, y]: [f64; 2]| [driven - x / pu.tau_r - omega * y, omega * x - y / pu.tau_r];
        let forward = |[x, y]: [f64; 2], [dx, dy]: [f64; 2], h: f64| [x + h * dx, y + h * dy];
        let mut psi = [begin.0, begin.1];
        for k in 1..100_000u32 {
            let middle = forward(psi, derivative(psi), pu.t_s / 2.0);
            psi = forward(psi, derivative(middle), pu.t_s);
            let tau = f64::from(k) * pu.t_s;
            let integral = [psi[0] - begin.0 + error.0 * tau, psi[1] - begin.1 + error.1 * tau].map(R::from_f64);
            let end = probe.step(&c, R::from_f64(driven), &AlphaBeta::new(integral[0], integral[1]));
            if !probe.is_running() {
                return end.map(|circle| (circle, psi));
            }
        }
        panic!("never ends");
    }

    fn check<R: Real>(omega: f64, begin: (f64, f64), error: (f64, f64)) {
        check_at::<R>(large(), omega, begin, error);
    }

    fn check_at<R: Real>(machine: (Machine, Inverter), omega: f64, begin: (f64, f64), error: (f64, f64)) {
        let (circle, psi) = found::<R>(machine, omega, begin, error).expect("it turns");
        let x = |v: R| v.to_f64();
        assert!((x(circle.omega) / omega - 1.0).abs() < 0.01, "{omega}: {circle:?}");
        let away = (x(circle.psi_r.re()) - psi[0]).hypot(x(circle.psi_r.im()) - psi[1]);
        assert!(away < 0.001, "{omega}: {away}");
        let of_error = (x(circle.error.re()) - error.0).hypot(x(circle.error.im()) - error.1);
        assert!(of_error < 5e-5, "{omega}: {of_error}");
    }

    #[test]
    fn the_circle_shows_speed_flux_and_the_error_of_the_voltage_whatever_flux_there_was() {
        for omega in [0.033, 0.06, -0.1, 0.2, -0.5, 1.0, -1.5] {
            for begin in [(0.0, 0.0), (0.01, 0.005), (-0.004, 0.01)] {
                for error in [(0.0, 0.0), (0.004, -0.001), (-0.004, 0.0)] {
                    check::<f64>(omega, begin, error);
                    check::<Q>(omega, begin, error);
                }
            }
        }
    }

    #[test]
    fn a_machine_that_does_not_turn_has_no_circle() {
        for error in [(0.0, 0.0), (0.004, -0.001), (-0.004, 0.0)] {
            assert!(found::<f64>(large(), 0.0, (0.0, 0.0), error).is_none());
            assert!(found::<Q>(large(), 0.0, (0.005, 0.0), error).is_none());
        }
    }

    #[test]
    fn a_smaller_machine_shows_a_fast_rotation_alone_and_one_of_a_short_time_constant_none() {
        let (medium, small) =
            (Machine::preset_11k(), Machine { R_R: 4.0 * Machine::preset_2k2().R_R, ..Machine::preset_2k2() });
        for omega in [0.6, -1.0, 1.3] {
            check_at::<f64>((medium, Inverter::preset_11k()), omega, (0.0, 0.0), (0.004, 0.0));
            check_at::<Q>((medium, Inverter::preset_11k()), omega, (0.0, 0.0), (0.004, 0.0));
        }
        assert!(found::<f64>((medium, Inverter::preset_11k()), 0.1, (0.0, 0.0), (0.0, 0.0)).is_none());
        let pu = PerUnit::new(&small, &Inverter::preset_2k2()).unwrap();
        assert!(!CircleConfig::<f64>::new(&pu, true).is_on());
    }
}
