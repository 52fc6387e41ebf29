//! Differences between the legs of the bridge, from a direct current that alternates at standstill. Per unit.
//!
//! Delays of the switches make the pulse of leg *k* longer than commanded, by `t_k + d_k sign i_k` of the period
//! ([`crate::inverter`]). The filter has no state for it: a constant voltage acts like an offset of the current sensors,
//! but without that offset's effect on `ψ_R = ψ_s - l (i_m - b)`, and unequal dead times act like nothing that it models. At
//! standstill all of it shows. With the current `±I n_k` along the axis of each phase, one after the other, and the
//! voltage `u` of the inverter model,
//!
//! ```text
//! ε = u - σl_s di/dτ - (r_s + r_R) i + ψ_R/τ_r = -u_dc 2/3 Σ_j (t_j + d_j sign i_j) n_j,      dψ_R/dτ = r_R i - ψ_R/τ_r
//! even:    t = -<ε>/u_dc                           mean of both polarities;  t, d: space vectors of the three legs
//! odd:     d = (2/3) Σ_k t_k <±ε·t_k>/u_dc         t_k ⊥ n_k
//! ```
//!
//! Across the current legs *k* + 1 and *k* + 2 carry equal currents: neither threshold, dead time and knee, as far as they
//! are common to the legs, nor the resistance are in the odd part. They, and the flux that builds up and decays, change
//! their sign with the current and are not in the even part, except for the transient with which the flux of a
//! direction begins at zero instead of within its alternation: of that the error of the parameters is left.
//!
//! Unequal gains of three current sensors turn the real current out of the direction of the measured one, by `I x·t_k/3`
//! ([`super::balance`]). The sum of the measured currents shows `x` at the same time, and its `(r_s + r_R) I x/3`
//! is taken off. One shunt has one gain. With two sensors, of gains that differ by `Δ`, there is no sum. The real current is
//! `Δ a_k I` off the direction *k* ([`super::pair`]), and the odd part is wrong by what that turns its voltage,
//!
//! ```text
//! δd = -(2/3) Σ_k t_k a_k Δ (r_s + r_R) I/u_dc = (1/2, -1/(2√3)) Δ (r_s + r_R) I/u_dc,      a = (1, 1, -1/2)/√3
//! ```
//!
//! 37 ns for 2 % at 2.2 kW. Other than the legs, `Δ` shows in how the voltage changes with the amount of the current: what is
//! found of it later in the start corrects the odd part.
//!
//! | half plateaus of a direction | 1 | 2 | 2 | 1 |
//! |---|---|---|---|---|
//! | current | `+I` | `-I` | `+I` | `-I` |
//!
//! **Saliency.** Leakage that differs along and across the rotor's slots, by `λ`, leaves a flux across the current, which
//! decays as the rotor flux does. Where the current reverses it jumps by `Λ`, so that
//!
//! ```text
//! <±ε·t_k> = -u_dc d·t_k - Λ_k/τ_r,      Λ_k = ∫ε·t_k dτ over the reversal,     |Λ_k| ≤ 2λ σl_s I
//! ```
//!
//! `Λ_k` is the integral with the weight `v` over `x`, the time from the reversal in half plateaus. As `∫v dx` is zero and
//! `v` is even, neither constant voltages nor those with the sign of the current are in it:
//!
//! ```text
//! v = max(1 - 3/2 x, 8/3 x - 4)     x < 3/2
//! ```
//!
//! The machine has no flux before, and the current goes back to zero at the end.
//!
//! Only the middle of the two long plateaus is read, with a triangular weight: the noise of the current at the ends of
//! the window, times `σl_s`, would otherwise be most of the error. The rotor flux passes zero there, so that a slow
//! rotation induces nothing on average.
//!
//! **Rotation.** In a machine that turns `ε` contains `jω ψ_R`. The flux alternates, so that the differences of the legs
//! are not in
//!
//! ```text
//! ω = Σ ψ_R × ε/Σ |ψ_R|²
//! ```
//!
//! With the angle by which the shaft turns in half a plateau the flux falls behind, and at a few speeds this mean passes
//! zero (at 0.3 of 50 Hz with 10 ms): the speed search, which follows, has the last word.
//!
//! **Validity.** Standstill. Currents of the legs (`I` and `I/2`) above the knee.

use super::balance::Balance;
use crate::base::{PerUnit, rounded};
use crate::inverter::Legs;
use crate::scalar::{Integrator, Real};
#[cfg(feature = "modes")]
use crate::space::SQRT_3;
use crate::space::{AlphaBeta, HALF_SQRT_3, Rotator};
use crate::words::words;

/// Half plateaus of a direction, and directions.
const HALVES: u32 = 6;
const DIRECTIONS: u32 = 3;
/// Half plateaus of the whole: the last one is without current.
const PLATEAUS: u32 = DIRECTIONS * HALVES + 1;
/// Current that alternates, relative to that of the build-up: the shaft of a salient machine, which is free, turns by its square.
const CURRENT: f64 = 0.5;
/// Half width of the window, in parts of a half plateau.
const WINDOW: (u32, u32) = (3, 5);
/// Gain of the sums of which the quotient counts: the reciprocal of some thousand periods.
const MEAN: f64 = 1.0 / 2048.0;

/// Half of a plateau, s and in time constants of current control; and in rotor time constants, of which the flux is
/// half as much of rated: with less the voltage errors of the bridge are a rotation.
const HALF: f64 = 0.01;
const SETTLE: f64 = 20.0;
const FLUX: f64 = 0.03;
/// The longest, in rotor time constants: with slower alternations a free shaft begins to turn, as a machine on one phase does.
const SLOWEST: f64 = 0.25;
/// The least of those, in time constants of current control. Where the window begins, with the weight zero, a tenth of the reversal is left. Its voltage is
/// not in `ε` but for the error of the leakage, and that is along the current and changes its sign. With 12, motors of 0.2 to 0.8 kW with rotor
/// time constants of 15 to 32 ms at 8 and 10 kHz were not measured, and delays that differ by 25 ns lost some of them with every parameter right.
const LEAST: f64 = 6.0;
/// Speed found in the first direction above which the comparison ends: below it what looks like a rotation may be unequal
/// legs.
const CERTAINLY_ROTATING: f64 = 0.3;

/// Half of a plateau with a rotor time constant in s, at a bandwidth of current control in Hz; s. 0: current control is too slow
/// for one.
pub(crate) fn half_plateau(tau_r: f64, current_bandwidth: f64) -> f64 {
    let tau_c = 1.0 / (core::f64::consts::TAU * current_bandwidth);
    let half = HALF.max(FLUX * tau_r).max(SETTLE * tau_c).min(SLOWEST * tau_r);
    if half < LEAST * tau_c { 0.0 } else { half }
}

/// Duration of the comparison with a rotor time constant in s, s; 0: current control is too slow for it.
pub(crate) fn legs_time(tau_r: f64, current_bandwidth: f64) -> f64 {
    f64::from(PLATEAUS) * half_plateau(tau_r, current_bandwidth)
}

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct LegsConfig<R: Real> {
    /// Periods of half a plateau; 0: off.
    half: u32,
    /// 64 times the weight of a step of the triangle: the six windows together have the weight one.
    weight: R,
    /// `r_s + r_R`.
    r: R,
    /// `σl_s/T_s`.
    l: R,
    /// `r_R T_s`, `1/τ_r` and `T_s/τ_r`.
    build_up: R,
    inv_tau_r: R,
    decay: R,
    /// 64 times the weight of the reversal, of which a period is `1/half`.
    reversal: R,
}
words!(LegsConfig: half, weight, r, l, build_up, inv_tau_r, decay, reversal);

impl<R: Real> LegsConfig<R> {
    /// For half plateaus of `half` periods.
    #[must_use]
    pub fn new(pu: &PerUnit, half: u32) -> Self {
        let of = f64::from(window(half).max(1));
        let r = rounded::<R>;
        Self {
            half,
            weight: r(64.0 / (6.0 * of * of)),
            r: r(pu.r_s + pu.r_r),
            // Limited for fixed point.
            l: r((pu.sigma_l_s / pu.t_s).min(100.0)),
            build_up: r(pu.r_r * pu.t_s),
            inv_tau_r: r(1.0 / pu.tau_r),
            decay: r(pu.t_s / pu.tau_r),
            reversal: r(64.0 / 3.0 * pu.t_s / pu.tau_r / f64::from(half.max(1))),
        }
    }

    /// Periods of the whole measurement, and of its first direction.
    pub fn periods(&self) -> [u32; 2] {
        [PLATEAUS, HALVES].map(|halves| halves * self.half)
    }

    /// Whether it is measured at all.
    pub fn is_on(&self) -> bool {
        self.half > 0
    }

    /// Periods before the end in which the current has come to rest.
    pub fn settled(&self) -> u32 {
        self.half / 2
    }

    /// `r_s + r_R`.
    pub fn resistance(&self) -> R {
        self.r
    }

    /// Differences that were found with two sensors whose gains differ by `difference` more than was known then; `i` is the
    /// current of the build-up.
    #[cfg(feature = "modes")]
    #[must_use]
    pub fn without_difference(&self, legs: &Legs<R>, difference: R, i: R, u_dc: R) -> Legs<R> {
        let r = R::from_f64;
        let turned = self.r * (i * r(CURRENT)) * difference * u_dc.recip();
        let odd = legs.odd - AlphaBeta::new(turned.half(), turned * r(-0.5 / SQRT_3));
        Legs { even: legs.even, odd }.limited()
    }

    /// Direction of the current in a period, and its part of the current of the build-up.
    fn direction(&self, period: u32) -> (Rotator<R>, R) {
        let r = R::from_f64;
        let halves = period / self.half.max(1);
        let (of, half) = (halves / HALVES, halves % HALVES);
        let axis = axis(of);
        let part = match (of, half) {
            (DIRECTIONS, _) => R::ZERO,
            (_, 1 | 2 | 5) => -r(CURRENT),
            _ => r(CURRENT),
        };
        (axis, part)
    }

    /// Weight of a period, and that of the reversal.
    fn weight(&self, period: u32) -> [R; 2] {
        if period >= DIRECTIONS * HALVES * self.half {
            return [R::ZERO; 2];
        }
        // Not the remainder of a product, which might wrap to zero.
        let half = self.half.max(1);
        let within = period - period / half / HALVES * HALVES * half;
        // The centres of the long plateaus are 2 and 4 half plateaus from the beginning.
        let from_centre = [2, 4].map(|k| within.abs_diff(k * self.half));
        let reversal = of_reversal(self.half, within.abs_diff(3 * self.half), self.reversal);
        [self.weight.periods(window(self.half).saturating_sub(from_centre[0].min(from_centre[1]))), reversal]
    }
}

/// Half width of the window, in periods.
pub(crate) fn window(half: u32) -> u32 {
    half * WINDOW.0 / WINDOW.1
}

/// Axis of a phase.
pub(crate) fn axis<R: Real>(phase: u32) -> Rotator<R> {
    let r = R::from_f64;
    match phase {
        0 => Rotator::default(),
        1 => Rotator { cos: r(-0.5), sin: r(HALF_SQRT_3) },
        _ => Rotator { cos: r(-0.5), sin: r(-HALF_SQRT_3) },
    }
}

/// `v` at a number of periods from a reversal, for half plateaus of `half` periods, times `half weight/64`.
pub(crate) fn of_reversal<R: Real>(half: u32, from: u32, weight: R) -> R {
    if from >= half * 3 / 2 {
        return R::ZERO;
    }
    let [one, x] = [half, from].map(|periods| weight.periods(periods));
    (one - x * R::from_f64(1.5)).max(x * R::from_f64(8.0 / 3.0) - one * R::from_f64(4.0))
}

/// Adds `gain · x` to both components.
#[inline(never)]
pub(crate) fn add<R: Real>(to: &mut [Integrator<R>; 2], gain: R, x: &AlphaBeta<R>) {
    to[0].add(gain, x.re());
    to[1].add(gain, x.im());
}

pub(crate) fn vector<R: Real>(x: &[Integrator<R>; 2]) -> AlphaBeta<R> {
    AlphaBeta::new(x[0].value(), x[1].value())
}

/// What a period of the measurement asks for.
#[derive(Clone, Copy, Debug)]
pub struct Alternation<R: Real> {
    /// Direction of the current.
    pub axis: Rotator<R>,
    /// Its amount with its sign, relative to that of the build-up.
    pub part: R,
}

/// State.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct LegsProbe<R: Real> {
    /// Rotor flux, and the current of the latest period.
    psi_r: [Integrator<R>; 2],
    i_s: AlphaBeta<R>,
    /// Means of the voltage, of its part across the current in the direction of the current, and of the sum of the
    /// currents likewise.
    even: [Integrator<R>; 2],
    odd: [Integrator<R>; 2],
    sum: [Integrator<R>; 2],
    /// Means of `ψ_R × ε` and `|ψ_R|²`.
    turning: Integrator<R>,
    square: Integrator<R>,
}

impl<R: Real> LegsProbe<R> {
    /// The rotor flux one period later, at a current; returns the one before.
    fn build_up(&mut self, c: &LegsConfig<R>, i_s: &AlphaBeta<R>) -> AlphaBeta<R> {
        let psi_r = vector(&self.psi_r);
        add(&mut self.psi_r, c.build_up, i_s);
        add(&mut self.psi_r, -c.decay, &psi_r);
        self.i_s = *i_s;
        psi_r
    }

    /// One period, counted from zero: voltage of the inverter model and current between the last two samples, and sum of
    /// the currents. Returns what the current is to be next.
    pub fn step(
        &mut self,
        c: &LegsConfig<R>,
        period: u32,
        u_s: &AlphaBeta<R>,
        i_s: &AlphaBeta<R>,
        sum: R,
    ) -> Alternation<R> {
        let (axis, part) = c.direction(period);
        let [w, reversal] = c.weight(period);
        let i_last = self.i_s;
        let psi_r = self.build_up(c, i_s);
        let u = *u_s - (*i_s - i_last) * c.l - *i_s * c.r + psi_r * c.inv_tau_r;
        self.turning.add(R::from_f64(MEAN), psi_r.cross(&u));
        self.square.add(R::from_f64(MEAN), psi_r.norm_sq());
        let signed = w * part * R::from_f64(1.0 / CURRENT);
        let across = axis.axis().cross(&u);
        add(&mut self.even, w, &u);
        add(&mut self.odd, signed + reversal, &AlphaBeta::new(-axis.sin * across, axis.cos * across));
        add(&mut self.sum, signed, &(axis.axis() * sum));
        Alternation { axis, part }
    }

    /// Whether the machine certainly rotates, after the first direction.
    pub fn rotates(&self) -> bool {
        !self.is_at_rest(R::from_f64(CERTAINLY_ROTATING))
    }

    /// Whether the machine turned slower than `omega`.
    pub fn is_at_rest(&self, omega: R) -> bool {
        self.turning.value().abs() < omega * self.square.value()
    }

    /// The differences, where `legs` are those that the inverter model has, at a dc link, and `i` is the current of the build-up.
    #[must_use]
    pub fn result(&self, c: &LegsConfig<R>, legs: &Legs<R>, balance: &Balance<R>, i: R, u_dc: R) -> Legs<R> {
        let i = i * R::from_f64(CURRENT);
        let inv_u_dc = u_dc.recip();
        let even = legs.even - vector(&self.even) * inv_u_dc;
        // I x/3 of the sensors, less what is removed from the currents.
        let gains = vector(&self.sum) * R::from_f64(2.0 / 3.0) - balance.image() * i;
        let odd = legs.odd + (vector(&self.odd) * R::TWO - gains * c.r) * inv_u_dc;
        Legs { even, odd }.limited()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::{Inverter, Machine};
    use crate::scalar::Q;

    const LEGS: [[f64; 2]; 3] = [[6e-4, -2e-4], [-5e-4, 1e-4], [-1e-4, 9e-4]];

    /// What is found of [`LEGS`] in a machine that turns at `omega`, with three sensors of these gains or the first two of
    /// them, and whether it is at rest.
    fn found<R: Real>(gains: [f64; 3], two: bool, omega: f64) -> (Legs<R>, bool) {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let pu = PerUnit::new(&machine, &inverter).unwrap();
        let config = LegsConfig::<R>::new(&pu, 100);
        let (r, i_0, u_dc) = (R::from_f64, 0.6, pu.u_dc);
        let mut probe = LegsProbe::<R>::default();
        let mut psi_r = AlphaBeta::<f64>::default();
        let (mut axis, mut target, mut i) = (AlphaBeta::<f64>::new(1.0, 0.0), 0.0, 0.0);
        let image = AlphaBeta::<f64>::from_phases(gains.map(|g| 0.5 * (g - 1.0)));
        for period in 0..config.periods()[0] {
            i += 0.2 * (target - i);
            // The measured current is on the axis, the real one turned out of it by the gains.
            let on_axis = axis * i;
            let off = AlphaBeta::new(
                image.dot(&AlphaBeta::new(on_axis.re(), -on_axis.im())),
                -on_axis.cross(&AlphaBeta::new(image.re(), -image.im())),
            );
            let i_s = if two {
                let [a, b] = [0, 1].map(|k| on_axis.to_phases()[k] / gains[k]);
                AlphaBeta::from_phases([a, b, -a - b])
            } else {
                on_axis - off
            };
            let turned = AlphaBeta::new(-psi_r.im(), psi_r.re());
            let d_psi = i_s * pu.r_r - psi_r * (1.0 / pu.tau_r) + turned * omega;
            let phases = i_s.to_phases();
            // By unequal legs, and by a dead time that the model has too small.
            let lost = [0, 1, 2].map(|k| {
                let [plus, minus] = LEGS[k];
                if phases[k] > 0.0 { 2e-3 - plus * u_dc } else { -2e-3 - minus * u_dc }
            });
            let u_s = i_s * pu.r_s + d_psi + AlphaBeta::from_phases(lost);
            psi_r += d_psi * pu.t_s;
            let mut measured = [0, 1, 2].map(|k| phases[k] * gains[k]);
            if two {
                measured[2] = -(measured[0] + measured[1]);
            }
            let sum = r(measured.iter().sum());
            let [u_s, i_s] = [u_s, AlphaBeta::from_phases(measured)].map(|x| AlphaBeta::new(r(x.re()), r(x.im())));
            let next = probe.step(&config, period, &u_s, &i_s, sum);
            let of = next.axis.axis();
            axis = AlphaBeta::new(of.re().to_f64(), of.im().to_f64());
            target = i_0 * next.part.to_f64();
        }
        let mut legs = probe.result(&config, &Legs::default(), &Balance::default(), r(i_0), r(u_dc));
        #[cfg(feature = "modes")]
        if two {
            legs = config.without_difference(&legs, r(gains[0] - gains[1]), r(i_0), r(u_dc));
        }
        (legs, probe.is_at_rest(r(0.03)))
    }

    fn error<R: Real>(legs: &Legs<R>) -> f64 {
        let want = Legs::<f64>::new(&LEGS);
        [(legs.even, want.even), (legs.odd, want.odd)]
            .map(|(x, y)| (x.re().to_f64() - y.re()).hypot(x.im().to_f64() - y.im()))
            .into_iter()
            .fold(0.0, f64::max)
    }

    fn is_found<R: Real>() {
        for gains in [[1.0; 3], [1.01, 0.995, 0.995]] {
            let (legs, at_rest) = found::<R>(gains, false, 0.0);
            assert!(at_rest && error(&legs) < 2e-5, "{}, {gains:?}: {legs:?}", R::NAME);
        }
    }

    /// With two sensors the difference of their gains is found after the legs.
    #[cfg(feature = "modes")]
    #[test]
    fn plateaus_are_long_against_current_control_and_short_against_the_rotor_time_constant() {
        // Of 10 ms, of a large machine longer; at a quarter of a short rotor time constant, if current control settles within it.
        for (tau_r, bandwidth, half) in
            [(0.1, 300.0, 0.0106), (1.3, 300.0, 0.039), (0.023, 300.0, 0.00575), (0.012, 300.0, 0.0), (0.1, 36.0, 0.0)]
        {
            let found = half_plateau(tau_r, bandwidth);
            assert!((found - half).abs() < 1e-4, "{tau_r} {bandwidth}: {found}");
            assert!((legs_time(tau_r, bandwidth) - 19.0 * found).abs() < 1e-9);
        }
    }

    #[test]
    fn two_sensors_show_the_legs_once_the_difference_of_their_gains_is_known() {
        for gains in [[1.0; 3], [1.01, 0.99, 1.0], [0.995, 1.005, 1.0]] {
            let (legs, at_rest) = found::<f32>(gains, true, 0.0);
            assert!(at_rest && error(&legs) < 2e-5, "{gains:?}: {legs:?}");
        }
    }

    #[test]
    fn unequal_legs_are_found_in_every_arithmetic_also_with_unequal_sensors() {
        is_found::<f64>();
        is_found::<f32>();
        is_found::<Q>();
    }

    #[test]
    fn a_machine_that_turns_is_not_taken_for_one_at_rest() {
        for omega in [0.005, -0.01] {
            let (legs, at_rest) = found::<f32>([1.0; 3], false, omega);
            assert!(at_rest && error(&legs) < 1e-4, "{omega}: {legs:?}");
        }
        for omega in [0.06, -0.1, 0.2, -0.4, 1.0] {
            assert!(!found::<f32>([1.0; 3], false, omega).1, "{omega}");
        }
    }
}
