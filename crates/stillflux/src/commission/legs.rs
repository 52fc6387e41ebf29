//! Differences between the legs of the bridge ([`crate::inverter`]), before there are parameters. Per unit.
//!
//! With a current `±I` along the axis `n_k` of each phase, one after the other, as in the comparison of a start
//! ([`crate::estimate::legs`] has the derivation),
//!
//! ```text
//! ε = u - σl_s di/dτ - (r_s + r_R) i + ψ_R/τ_r = -u_dc 2/3 Σ_j (t_j + d_j sign i_j) n_j      dψ_R/dτ = r_R i - ψ_R/τ_r
//! even:    t = -<ε>/u_dc         odd:    d = (2/3) Σ_k t_k <±ε·t_k>/u_dc         t_k ⊥ n_k
//! ```
//!
//! | half plateaus of a direction | 1 | 2 | 2 | 2 | 1 | 1 |
//! |---|---|---|---|---|---|---|
//! | current | `+I` | `-I` | `+I` | `-I` | `+I` | 0 |
//! | weight | 0 | 1/4 | 1/2 | 1/4 | 0 | 0 |
//!
//! Unlike that of a start it does not know the machine: resistances and leakage of the nameplate are off by a third. What
//! alternates with the current is taken off by the weights, in the mean of both polarities also what the alternation loses
//! with time. With an odd number of plateaus the flux that decays in the first half plateau is that of the last one, with
//! the other sign: the flux ends at zero but for the square of the plateau over the rotor time constant, so that the
//! current along the next axis meets no flux that would turn a free shaft.
//!
//! Across the axis the machine is short-circuited ([`super::excitation`]), and the differences drive a current there, whose
//! voltage is off by the error of the resistance. So the comparison is made [`PASSES`] times, each with those of the one
//! before compensated: an error of a third of the resistance leaves a third of the differences after the first, a ninth
//! of it after the second, and so on. The first ones have a smaller current and the shortest plateaus: with uncompensated
//! differences both components of the flux do not change alike, and leave a torque on average.
//!
//! Nothing that is common to the legs is in either part, so the voltage is that of ideal legs. Unequal gains of the sensors
//! show an odd current `I x/3` across the axis that does not flow, known by the sum of the currents. With two sensors
//! the odd part is not measured. A flux across the current, of leakage that differs along and across the slots, is
//! known by the reversal.
//!
//! The reference goes from one value to the next in a time that is not short against a plateau. It leads by half of
//! that, so that the middle of a reversal is where the weights expect it.
//!
//! **Assumes** a machine at rest and without flux. Currents of the legs, 0.4 and 0.2 pu, above the knee: no larger ones
//! flow before the plate is checked.

use super::excitation::{Command, Sample};
use crate::base::{PerUnit, rounded};
use crate::estimate::legs::{axis, of_reversal, window};
use crate::inverter::Legs;
use crate::params::{Inverter, Machine, ParamError};
use crate::scalar::{Integrator, Real};
use crate::space::AlphaBeta;

/// Half plateaus of a direction, the last of them without current, directions, and how often each is compared.
const HALVES: u32 = 9;
const DIRECTIONS: u32 = 3;
const PASSES: u32 = 4;
/// Current, per unit: in the first comparisons, and in the last one.
const CURRENT: [f64; 2] = [0.2, 0.4];
/// Periods of half a plateau in the first comparisons: not shorter than the change of the reference.
const SHORT: u32 = 64;
/// Standard deviation of a delay that was found, relative to the period of the carrier.
const DEVIATION: f64 = 1e-5;
/// Difference of the legs' currents, relative to one of them, that is taken for one of the delays where the loss depends on
/// the current.
const IMBALANCE: f64 = 0.02;

/// Constants, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ComparisonConfig<R: Real> {
    /// Periods of half a plateau: in the first comparisons, and in the last one.
    half: [u32; 2],
    /// Periods by which the reference leads.
    lead: u32,
    /// 64 times the weight of a step of the triangle, for half of the weight of a direction.
    weight: [R; 2],
    /// 64 times that of the reversal, of which a period is `1/half`.
    reversal: [R; 2],
    /// `r_s + r_R`, and `σl_s/T_s`.
    r: R,
    l: R,
    /// `r_R T_s`, `1/τ_r` and `T_s/τ_r`.
    build_up: R,
    inv_tau_r: R,
    decay: R,
    /// Whether the odd part is measured: not with two sensors.
    odd: bool,
}

impl<R: Real> ComparisonConfig<R> {
    pub fn new(pu: &PerUnit, half: u32, lead: u32) -> Self {
        let r = rounded::<R>;
        let half = [SHORT, half.max(SHORT)];
        let of = half.map(|half| f64::from(window(half)));
        Self {
            half,
            lead,
            weight: of.map(|of| r(64.0 / (6.0 * of * of))),
            reversal: half.map(|half| r(64.0 / 3.0 * pu.t_s / pu.tau_r / f64::from(half))),
            r: r(pu.r_s + pu.r_r),
            // Limited for fixed point.
            l: r((pu.sigma_l_s / pu.t_s).min(100.0)),
            build_up: r(pu.r_r * pu.t_s),
            inv_tau_r: r(1.0 / pu.tau_r),
            decay: r(pu.t_s / pu.tau_r),
            odd: true,
        }
    }

    /// The same with the odd part measured, or not.
    pub fn with_odd(self, odd: bool) -> Self {
        Self { odd, ..self }
    }

    /// Half plateaus and weights of a comparison.
    fn of(pass: u32) -> usize {
        usize::from(pass >= 2)
    }

    /// Periods of a comparison.
    fn periods(&self, pass: u32) -> u32 {
        DIRECTIONS * HALVES * self.half[Self::of(pass)]
    }

    /// Periods of the whole procedure.
    pub fn duration(&self) -> u32 {
        (0..PASSES).map(|pass| self.periods(pass)).sum()
    }

    /// Direction of a period of a comparison or of the next one, and the current along its axis.
    fn reference(&self, mut pass: u32, mut tick: u32) -> (u32, R) {
        if tick >= self.periods(pass) {
            tick -= self.periods(pass);
            pass += 1;
        }
        let halves = tick / self.half[Self::of(pass)].max(1);
        let (of, half) = (halves / HALVES, halves % HALVES);
        let i = match half {
            _ if pass >= PASSES => 0.0,
            8 => 0.0,
            1 | 2 | 5 | 6 => -CURRENT[Self::of(pass)],
            _ => CURRENT[Self::of(pass)],
        };
        // There and back: what a change of the axis does to the shaft, the way back undoes.
        (if pass % 2 == 1 { DIRECTIONS - 1 - of } else { of }, R::from_f64(i))
    }

    /// Weight of a period, and that of the reversal in the middle.
    fn weight(&self, pass: u32, tick: u32) -> [R; 2] {
        let k = Self::of(pass);
        // Not the remainder of a product, which might wrap to zero.
        let half = self.half[k].max(1);
        let within = tick - tick / half / HALVES * HALVES * half;
        let step = |centre: u32| window(half).saturating_sub(within.abs_diff(centre * half));
        let outer = self.weight[k].periods(step(2).max(step(6))).half();
        [self.weight[k].periods(step(4)) + outer, of_reversal(half, within.abs_diff(3 * half), self.reversal[k])]
    }
}

/// Standard deviation of each delay, s. Allowance over what is found on drawn bridges: 1 ns, 4 to 20 ns where the knee is a
/// third of the current.
///
/// # Errors
/// Parameters outside their admissible range.
pub(super) fn deviation(inverter: &Inverter, machine: &Machine) -> Result<f64, ParamError> {
    let knee = PerUnit::new(machine, inverter)?.knee;
    // The tail of the curve at half of the current.
    let by_knee = IMBALANCE * inverter.dead_time * (knee / CURRENT[1]).min(1.0);
    Ok(libm::hypot(DEVIATION / inverter.f_s, by_knee))
}

/// State and record.
#[derive(Clone, Copy, Debug)]
pub(super) struct Comparison<R: Real> {
    /// Comparisons that are complete, and periods of the present one.
    pass: u32,
    tick: u32,
    /// Rotor flux, and the current of the latest period.
    psi_r: [Integrator<R>; 2],
    i_last: AlphaBeta<R>,
    /// Means of the voltage, of its part across the current in the direction of the current, and of the sum of the
    /// currents likewise.
    even: [Integrator<R>; 2],
    odd: [Integrator<R>; 2],
    sum: [Integrator<R>; 2],
    /// What the latest comparison has found.
    pub legs: Legs<R>,
}

fn add<R: Real>(to: &mut [Integrator<R>; 2], gain: R, x: &AlphaBeta<R>) {
    to[0].add(gain, x.re());
    to[1].add(gain, x.im());
}

fn vector<R: Real>(x: &[Integrator<R>; 2]) -> AlphaBeta<R> {
    AlphaBeta::new(x[0].value(), x[1].value())
}

impl<R: Real> Comparison<R> {
    pub fn new() -> Self {
        let zero = [Integrator::default(); 2];
        Self {
            pass: 0,
            tick: 0,
            psi_r: zero,
            i_last: AlphaBeta::default(),
            even: zero,
            odd: zero,
            sum: zero,
            legs: Legs::default(),
        }
    }

    /// One period; `None` at the end. Whether a comparison is complete, and its differences are to be compensated.
    pub fn step(&mut self, c: &ComparisonConfig<R>, x: &Sample<R>) -> (Option<Command<R>>, bool) {
        let (of, i) = c.reference(self.pass, self.tick);
        let [w, reversal] = c.weight(self.pass, self.tick);
        let (n, i_s, psi_r) = (axis::<R>(of), x.i_s, vector(&self.psi_r));
        add(&mut self.psi_r, c.build_up, &i_s);
        add(&mut self.psi_r, -c.decay, &psi_r);
        let i_last = core::mem::replace(&mut self.i_last, i_s);
        let mean = (i_s + i_last) * R::HALF;
        let u = x.u_s - (i_s - i_last) * c.l - mean * c.r + psi_r * c.inv_tau_r;
        let signed = if i < R::ZERO { -w } else { w };
        let across = n.axis().cross(&u);
        let [i_a, i_b, i_c] = x.i_abc;
        add(&mut self.even, w, &u);
        add(&mut self.odd, signed + reversal, &AlphaBeta::new(-n.sin * across, n.cos * across));
        add(&mut self.sum, signed, &(n.axis() * (i_a + i_b + i_c)));
        self.tick += 1;
        let complete = self.tick == c.periods(self.pass);
        if complete {
            self.complete(c, x.u_dc);
        }
        if self.pass == PASSES {
            return (None, complete);
        }
        let (of, i) = c.reference(self.pass, self.tick + c.lead);
        (Some(Command::Along(axis(of), i)), complete)
    }

    /// The differences at a dc link; the next comparison begins.
    fn complete(&mut self, c: &ComparisonConfig<R>, u_dc: R) {
        let [even, odd, sum] = [&self.even, &self.odd, &self.sum].map(vector);
        let inv_u_dc = u_dc.recip();
        let gains = sum * (c.r * R::from_f64(2.0 / 3.0));
        let odd = if c.odd { (odd * R::TWO - gains) * inv_u_dc } else { AlphaBeta::default() };
        self.legs = Legs { even: even * -inv_u_dc, odd }.limited();
        (self.pass, self.tick) = (self.pass + 1, 0);
        for mean in [&mut self.even, &mut self.odd, &mut self.sum] {
            *mean = [Integrator::default(); 2];
        }
    }
}
