//! Six-pulse diode rectifier between a grid and the capacitor of the dc link. SI.
//!
//! ```text
//! L i_k' = e_k - R i_k - v_k - v_n,   i_a + i_b + i_c = 0,   C u' = Σ_{i_k > 0} i_k
//! v_k = u (i_k > 0),   0 (i_k < 0),   between them while i_k = 0
//! e_k = (π E/3)/√3 cos(ω t - 2πk/3)
//! ```
//!
//! Ideal diodes: each leg of the rectifier follows the same rule as one of the blocked bridge ([`crate::bridge`]). None
//! conducts until the highest voltage between two lines reaches `u`; a third leg joins the two that do where its potential
//! `(u + 3 e_k)/2` leaves [0, u], and one leaves where its current reaches zero. Both instants are located; between
//! them the implicit midpoint rule steps through a linear circuit and conserves its energy to rounding:
//!
//! ```text
//! W_grid = W_loss + W_inductance + C/2 (u² - u_0²)
//! ```
//!
//! The link's ripple has six times the grid's frequency. `E` is the mean without load current of an ideal rectifier; the
//! capacitor charges to the peak, `π E/3`. Longest step 100 µs, less for a fast grid and a small link: the error of the
//! phase is `(ω h)²/12`, 8e-5 at 50 Hz.
#![allow(non_snake_case)]

use crate::link_energy::LinkEnergy;
use crate::machine::{AXIS, V2, axpy, dot, turned};
use std::f64::consts::{PI, TAU};
use stillflux::params::{ParamError, check};

/// Grid that feeds a rectifier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Frequency, Hz.
    pub frequency: f64,
    /// Inductance of one phase, H.
    pub inductance: f64,
}

impl Grid {
    /// Checks every field against its admissible range.
    pub(crate) fn validate(&self) -> Result<(), ParamError> {
        check("grid frequency", self.frequency, 1.0, 1000.0, "Hz")?;
        check("grid inductance", self.inductance, 1e-6, 0.1, "H")
    }
}

/// Longest step: s, parts of `√(LC)`, parts of a period of the grid.
const H_MAX: f64 = 100e-6;
const OF_OSCILLATION: f64 = 0.3;
const OF_GRID: f64 = 0.02;
/// Most segments of a call beside those of the longest step: past it one is taken as it stands.
const MOST: u32 = 200;

/// State of a rectifier.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rectifier {
    L: f64,
    /// Resistance of a phase.
    R: f64,
    C: f64,
    omega: f64,
    /// Longest step.
    h_max: f64,
    /// `e^{jωt}` of the grid.
    angle: V2,
    i: V2,
    /// Sign of each leg's current; 0: it blocks.
    sign: [f64; 3],
}

/// A step: current and link voltage at its end, and what the grid gave and the resistance took.
#[derive(Clone, Copy)]
struct Step {
    i: V2,
    u: f64,
    grid: f64,
    loss: f64,
}

impl Rectifier {
    pub fn new(grid: Grid, R: f64, C: f64) -> Self {
        let L = grid.inductance;
        let h_max = H_MAX.min(OF_OSCILLATION * (L * C).sqrt()).min(OF_GRID / grid.frequency);
        Self { L, R, C, omega: TAU * grid.frequency, h_max, angle: [1.0, 0.0], i: [0.0; 2], sign: [0.0; 3] }
    }

    /// Peak between two lines of ideal mean voltage `E`.
    pub fn peak(E: f64) -> f64 {
        PI / 3.0 * E
    }

    /// Advances by `dt` from the link voltage `u` and returns that at the end.
    pub fn advance(&mut self, E: f64, mut u: f64, dt: f64, books: &mut LinkEnergy) -> f64 {
        let amplitude = Self::peak(E) / 3f64.sqrt();
        let (mut left, mut segments) = (dt, 0);
        let most = MOST + (dt / self.h_max) as u32;
        while left > 0.0 {
            segments += 1;
            self.join(amplitude, u);
            let mut h = if left > 1.5 * self.h_max { self.h_max } else { left };
            let mut step = self.step(amplitude, u, h);
            let mut event = None;
            if segments < most {
                for what in [Event::Join, Event::Leave(0), Event::Leave(1), Event::Leave(2)] {
                    if self.margin(what, amplitude, h, &step) < 0.0 {
                        h = self.locate(what, amplitude, u, h);
                        step = self.step(amplitude, u, h);
                        event = Some(what);
                    }
                }
            }
            (self.i, u) = (step.i, step.u);
            self.angle = turned(self.angle, self.omega * h);
            books.grid += step.grid;
            books.loss += step.loss;
            left = if left - h > 1e-12 { left - h } else { 0.0 };
            if let Some(Event::Leave(k)) = event {
                self.sign[k] = 0.0;
            }
            self.settle();
        }
        // Against rounding.
        let n = 1.5 - 0.5 * dot(self.angle, self.angle);
        self.angle = [n * self.angle[0], n * self.angle[1]];
        books.inductance = 0.75 * self.L * dot(self.i, self.i);
        u
    }

    fn grid(&self, amplitude: f64, after: f64) -> V2 {
        let e = turned(self.angle, self.omega * after);
        [amplitude * e[0], amplitude * e[1]]
    }

    /// One leg alone cannot conduct; what of the current lies along a leg that blocks is rounding.
    fn settle(&mut self) {
        if self.sign.iter().filter(|s| **s != 0.0).count() < 2 {
            (self.sign, self.i) = ([0.0; 3], [0.0; 2]);
        } else if let Some(d) = self.direction() {
            let along = dot(self.i, d);
            self.i = [along * d[0], along * d[1]];
        }
    }

    /// With one leg blocked the current has one direction.
    fn direction(&self) -> Option<V2> {
        let k = self.sign.iter().position(|s| *s == 0.0)?;
        Some([-AXIS[k][1], AXIS[k][0]])
    }

    /// Lets begin what is due.
    fn join(&mut self, amplitude: f64, u: f64) {
        let e = self.grid(amplitude, 0.0);
        let e = AXIS.map(|a| dot(a, e));
        match self.sign.iter().filter(|s| **s == 0.0).count() {
            3 => {
                let (mut p, mut q) = (0, 0);
                for k in 1..3 {
                    if e[k] > e[p] {
                        p = k;
                    }
                    if e[k] < e[q] {
                        q = k;
                    }
                }
                if e[p] - e[q] >= u {
                    (self.sign[p], self.sign[q]) = (1.0, -1.0);
                }
            }
            1 => {
                for k in 0..3 {
                    if self.sign[k] == 0.0 && 3.0 * e[k].abs() >= u {
                        self.sign[k] = e[k].signum();
                    }
                }
            }
            _ => {}
        }
    }

    /// Distance from an event at the end of a step of length `h`; negative once it has happened.
    fn margin(&self, event: Event, amplitude: f64, h: f64, step: &Step) -> f64 {
        match event {
            Event::Leave(k) if self.sign[k] != 0.0 => self.sign[k] * dot(AXIS[k], step.i),
            Event::Leave(_) => f64::INFINITY,
            Event::Join => {
                let e = self.grid(amplitude, h);
                let e = AXIS.map(|a| dot(a, e));
                match self.sign.iter().filter(|s| **s == 0.0).count() {
                    3 => step.u - (e[0].max(e[1]).max(e[2]) - e[0].min(e[1]).min(e[2])),
                    1 => (0..3).filter(|k| self.sign[*k] == 0.0).map(|k| step.u - 3.0 * e[k].abs()).sum(),
                    _ => f64::INFINITY,
                }
            }
        }
    }

    /// Length of the step that ends at the event, within (0, h]: bisection, a dozen events in a grid period.
    fn locate(&self, event: Event, amplitude: f64, u: f64, h: f64) -> f64 {
        let (mut a, mut b) = (0.0, h);
        while b - a > 1e-12 {
            let m = 0.5 * (a + b);
            if self.margin(event, amplitude, m, &self.step(amplitude, u, m)) < 0.0 {
                b = m;
            } else {
                a = m;
            }
        }
        b
    }

    /// Implicit midpoint rule: with mean current `i` and mean voltage `u`, `S` the space vector of the legs at the
    /// positive rail, `L Δi = h (e - R i - S u)`, `C Δu = h 3/2 S·i`, along [`Self::direction`] if a leg blocks.
    fn step(&self, amplitude: f64, u: f64, h: f64) -> Step {
        if self.sign == [0.0; 3] {
            return Step { i: [0.0; 2], u, grid: 0.0, loss: 0.0 };
        }
        let mut e = self.grid(amplitude, 0.5 * h);
        let mut S = [0.0; 2];
        for k in 0..3 {
            if self.sign[k] > 0.0 {
                S = axpy(S, 2.0 / 3.0, AXIS[k]);
            }
        }
        if let Some(d) = self.direction() {
            let (along, of_s) = (dot(e, d), dot(S, d));
            (e, S) = ([along * d[0], along * d[1]], [of_s * d[0], of_s * d[1]]);
        }
        let half = 0.5 * h;
        let inv = 1.0 / (self.L + half * self.R);
        let alone = [inv * (self.L * self.i[0] + half * e[0]), inv * (self.L * self.i[1] + half * e[1])];
        let c = 1.5 * half / self.C;
        let mean_u = (u + c * dot(S, alone)) / (1.0 + c * inv * half * dot(S, S));
        let i = axpy(alone, -inv * half * mean_u, S);
        Step {
            i: [2.0 * i[0] - self.i[0], 2.0 * i[1] - self.i[1]],
            u: 2.0 * mean_u - u,
            grid: 1.5 * h * dot(e, i),
            loss: 1.5 * h * self.R * dot(i, i),
        }
    }
}

#[derive(Clone, Copy)]
enum Event {
    /// A further leg, or the first two, begin to conduct.
    Join,
    /// A leg's current reaches zero.
    Leave(usize),
}

#[cfg(test)]
mod tests {
    use super::*;

    const H: f64 = 100e-6;

    /// Rectifier on a capacitor from which a constant power is drawn: link voltages of the last grid period of 0.2 s.
    fn loaded(L: f64, R: f64, C: f64, power: f64) -> Vec<f64> {
        let mut r = Rectifier::new(Grid { frequency: 50.0, inductance: L }, R, C);
        let begin = Rectifier::peak(540.0);
        let (mut u, mut books, mut drawn, mut all) = (begin, LinkEnergy::default(), 0.0, vec![]);
        for _ in 0..2000 {
            let before = u;
            u = (u * u - 2.0 * power * H / C).sqrt();
            drawn += 0.5 * C * (before * before - u * u);
            u = r.advance(540.0, u, H, &mut books);
            all.push(u);
        }
        let balance = books.grid - books.loss - books.inductance - drawn - 0.5 * C * (u * u - begin * begin);
        assert!(balance.abs() <= 1e-9 * books.grid.max(1.0), "{balance} of {books:?}");
        all.split_off(1800)
    }

    /// The same by small steps: nodes of 0.5 nF between the diodes, which clamp them to [0, u], no events.
    fn brute_force(L: f64, R: f64, C: f64, power: f64) -> Vec<f64> {
        let (n, mut i, mut u, mut all) = (2500, [0.0; 3], Rectifier::peak(540.0), vec![]);
        let (dt, amplitude, node) = (H / f64::from(n), u / 3f64.sqrt(), 0.5e-9);
        let mut v = [0.5 * u; 3];
        for k in 0..2000 {
            u = (u * u - 2.0 * power * H / C).sqrt();
            for j in 0..n {
                let t = f64::from(k) * H + (f64::from(j) + 0.5) * dt;
                let e = [0.0, 1.0, 2.0].map(|x| amplitude * (TAU * (50.0 * t - x / 3.0)).cos());
                let star = (v[0] + v[1] + v[2]) / 3.0;
                for x in 0..3 {
                    i[x] += dt / L * (e[x] - R * i[x] - v[x] + star);
                }
                for x in 0..3 {
                    v[x] += dt / node * i[x];
                    u += node / C * (v[x] - u).max(0.0);
                    v[x] = v[x].clamp(0.0, u);
                }
            }
            all.push(u);
        }
        all.split_off(1800)
    }

    fn mean(u: &[f64]) -> f64 {
        u.iter().sum::<f64>() / u.len() as f64
    }

    /// Amplitude of harmonic `n` of the grid's period.
    fn harmonic(u: &[f64], n: f64) -> f64 {
        let (mut c, mut s) = (0.0, 0.0);
        for (k, x) in u.iter().enumerate() {
            let (sin, cos) = (TAU * n * k as f64 / u.len() as f64).sin_cos();
            (c, s) = (c + x * cos, s + x * sin);
        }
        2.0 * c.hypot(s) / u.len() as f64
    }

    #[test]
    fn brute_force_rectifier_agrees_with_gaps_and_with_overlap() {
        // Current in separate pulses, and three phases conducting at a time.
        for (L, R, C, power) in [(0.3e-3, 0.2, 0.5e-3, 3e3), (3e-3, 0.1, 1e-3, 8e3)] {
            let (u, want) = (loaded(L, R, C, power), brute_force(L, R, C, power));
            let ripple = want.iter().copied().fold(0.0, f64::max) - want.iter().copied().fold(1e9, f64::min);
            let worst = u.iter().zip(&want).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(ripple > 1.0 && worst < 0.02 * ripple, "{L} H: {worst} V, ripple {ripple} V");
        }
    }

    #[test]
    fn link_ripples_with_six_times_the_frequency_of_the_grid() {
        let u = loaded(0.3e-3, 0.05, 0.5e-3, 3e3);
        let six = harmonic(&u, 6.0);
        assert!(six > 3.0, "{six}");
        for n in [1.0, 2.0, 3.0, 4.0, 5.0, 7.0] {
            assert!(harmonic(&u, n) < 0.02 * six, "{n}: {} of {six}", harmonic(&u, n));
        }
    }

    #[test]
    fn a_small_capacitor_swings_with_the_grid_and_is_not_drawn_below_zero() {
        // 22 kHz of choke and capacitor, a grid of 905 Hz, calls of 0.5 ms: the longest step follows what is fastest.
        let (C, dt) = (34e-6, 0.5e-3);
        let mut r = Rectifier::new(Grid { frequency: 905.0, inductance: 1.6e-6 }, 0.86, C);
        let peak = Rectifier::peak(540.0);
        let (mut u, mut books, mut drawn) = (peak, LinkEnergy::default(), 0.0);
        for k in 0..2000 {
            let before = u;
            // Power both ways; no more than half of what the capacitor has.
            let energy = if k % 7 == 0 { -0.2 } else { 0.5 * 0.5 * C * u * u };
            u = (u * u - 2.0 * energy / C).sqrt();
            drawn += 0.5 * C * (before * before - u * u);
            u = r.advance(540.0, u, dt, &mut books);
            assert!(u > 0.5 * peak && u < 1.5 * peak, "{k}: {u} V");
        }
        let balance = books.grid - books.loss - books.inductance - drawn - 0.5 * C * (u * u - peak * peak);
        assert!(balance.abs() <= 1e-9 * books.grid.abs(), "{balance} of {books:?}");
    }

    #[test]
    fn without_load_the_capacitor_stays_at_the_peak() {
        let u = loaded(0.3e-3, 0.05, 0.5e-3, 0.0);
        assert!((mean(&u) - Rectifier::peak(540.0)).abs() < 1e-6, "{}", mean(&u));
    }
}
