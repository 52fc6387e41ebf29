//! Magnetising curve, rotor resistance and stator resistance: steps between direct currents, each held until the flux
//! has (nearly) settled.
//!
//! Along one axis at standstill the Γ circuit is one scalar differential equation. With the magnetising current
//! `g(ψ) = ψ/L_u (1 + c |ψ/ψ_N|^S)` at a constant stator current `i`
//!
//! ```text
//! (1 + L_l g'(ψ)) dψ/dt = R_r (i - g(ψ))        ψ - L_l (i - g(ψ)) continuous where i steps
//! u = R i + (1 + d) u_l(i) + δ_k + dψ/dt        R = R_s + r_d
//! ```
//!
//! Settled, `u` is the resistance and the bridge; the integral of the rest is the static flux linkage of the level; where
//! the flux passes through zero `dψ/dt` is `R_r i`, whatever the curve. The levels alternate in sign and fall, so
//! that every reversal passes the whole curve up to its level. Only mean voltages of [`WINDOWS`] windows a level are
//! kept; a window's mean of `dψ/dt` is a difference of flux, without any approximation.
//!
//! **Deep bars.** With several branches in the rotor the same equations hold for currents that are slow against the
//! branches' own time constants, with the leakage `L_l = Σ (R_r/R_k)² L_k` of low frequency, which is larger than that
//! of high frequency. Its ratio to the measured one is a parameter of the fit, and the first window of a level, in which
//! the branches settle, does not count. The rotor resistance found is that of slip frequency, not of the skin effect.
//!
//! **The flux of a reversal.** What follows a step is, with a constant inductance, an exponential function: it has an
//! amplitude and a time constant, `R_r (L_s/(L_s + L_l))²` and `L_s²/(L_s + L_l)` over that, for three unknowns `R_r`, `L_s`,
//! `L_l`. Only saturation, which makes the time constant depend on the flux, tells them apart, and a ratio of the leakages
//! that is off by `δ` makes an error of `2 δ L_l/L_s` of `R_r`. The third equation is the flux linkage from the level before
//! to the end of the first window, in which everything has settled that is fast,
//!
//! ```text
//! ψ_1 - ψ_0 = ∫ (u - R i - (1 + d) u_l(i) - δ_k) dt        to (i_1 - i_0) L_s at the end of the level
//! ```
//!
//! The loss of the bridge until then is 0.25 to 0.4 pu of flux, and while the current changes, at a constant rate, it is
//! that of its curve at currents that are known roughly: the equation is believed to [`SIGMA_PSI`], which is worth a tenth
//! of the leakage. A motor that saturates does not need it.
//!
//! The fit solves the equation for `R`, `R_r`, `L_u`, `c`, `S`, `d`, that ratio and a small remainder `δ_k` of the bridge at
//! each level by damped least squares.
//!
//! **Assumes** a curve of this form, a constant temperature, no remanence. With little saturation at the largest
//! level `S` stays near its prior and says nothing.

use super::excitation::{Command, Sample};
use crate::scalar::{Integrator, Real};

/// Windows of a level.
pub const WINDOWS: usize = 16;
/// Levels.
pub const LEVELS: usize = 6;
/// Prior of the saturated part at rated flux and of the exponent, with their standard deviations.
const PRIOR_C: (f64, f64) = (0.4, 0.6);
const PRIOR_S: (f64, f64) = (7.0, 3.0);
/// Relative standard deviation of the nameplate's resistances and inductance in this fit: hardly any weight.
const PRIOR_PLATE: f64 = 1.0;
/// Least standard deviation of `d`, beside what the fit of the bridge leaves.
const PRIOR_D: f64 = 0.005;
/// Prior of the logarithm of the leakage inductance at low frequency over that at high frequency.
const PRIOR_BAR: (f64, f64) = (0.2, 0.4);
/// Standard deviation assumed of a window's voltage, per unit.
const SIGMA_U: f64 = 3e-5;
/// Standard deviation assumed of the flux that a reversal moves, per unit: some per cent of the bridge's loss until it has
/// been read. What was left of it in drawn machines whose fit did not contain it was 0.002 to 0.02.
pub(super) const SIGMA_PSI: f64 = 2e-2;
/// Steps of the differential equation in a window.
const STEPS: u32 = 6;
/// Standard deviation of what the curve of the bridge leaves at each level, per unit.
const PRIOR_LEVEL: f64 = 3e-4;
/// Parameters of the equation; with what is left at each level, those of the fit.
const P: usize = 7;
const N: usize = P + LEVELS;

/// Levels as current per unit: the largest first, falling, alternating; `i_0` is the rated magnetising current.
#[must_use]
pub fn levels(i_0: f64) -> [f64; LEVELS] {
    let i = |k: f64| (k * i_0).min(1.0);
    [1.0, -1.0, i(1.5), -i(1.0), i(0.7), -i(0.4)]
}

/// Timing, in periods.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MagnetisingConfig<R: Real> {
    pub levels: [R; LEVELS],
    /// From a step of the current to the first window.
    pub settle: u32,
    /// Of a window.
    pub window: u32,
    /// One over each.
    pub inv_settle: R,
    /// One over the window.
    pub inv_window: R,
}

impl<R: Real> MagnetisingConfig<R> {
    /// Periods of the whole procedure.
    pub fn duration(&self) -> u32 {
        (self.settle + WINDOWS as u32 * self.window) * LEVELS as u32
    }
}

/// Record of a level.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Level<R: Real> {
    /// Mean voltage of each window, and before the first one.
    pub u: [R; WINDOWS],
    pub u_settling: R,
    /// Mean current of the windows, and before the first one.
    pub i: R,
    pub i_settling: R,
}

/// State and record.
#[derive(Clone, Copy, Debug)]
pub(super) struct Magnetising<R: Real> {
    tick: u32,
    /// Levels done.
    pub level: usize,
    window: usize,
    u: Integrator<R>,
    i: Integrator<R>,
    pub record: [Level<R>; LEVELS],
}

impl<R: Real> Magnetising<R> {
    pub fn new() -> Self {
        Self {
            tick: 0,
            level: 0,
            window: 0,
            u: Integrator::default(),
            i: Integrator::default(),
            record: [Level::default(); LEVELS],
        }
    }

    /// One period; `None` at the end.
    pub fn step(&mut self, c: &MagnetisingConfig<R>, x: &Sample<R>) -> Option<Command<R>> {
        let i = (x.i + x.i_last).half();
        let record = &mut self.record[self.level];
        let settling = self.tick < c.settle;
        let weight = if settling { c.inv_settle } else { c.inv_window };
        self.u.add(weight, x.u);
        self.i.add(weight, i);
        self.tick += 1;
        let (u_mean, i_mean) = (self.u.value(), self.i.value());
        let complete = if settling {
            if self.tick == c.settle {
                (record.u_settling, record.i_settling) = (u_mean, i_mean);
            }
            self.tick == c.settle
        } else if self.tick == c.settle + c.window * (self.window as u32 + 1) {
            record.u[self.window] = u_mean;
            record.i += i_mean * R::from_f64(1.0 / WINDOWS as f64);
            self.window += 1;
            true
        } else {
            false
        };
        if complete {
            self.u.set(R::ZERO);
            self.i.set(R::ZERO);
        }
        if self.window == WINDOWS {
            (self.tick, self.window) = (0, 0);
            self.level += 1;
            if self.level == LEVELS {
                return None;
            }
        }
        Some(Command::Current(c.levels[self.level], R::ZERO))
    }
}

/// A level in double precision, per unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Reading {
    pub u: [f64; WINDOWS],
    pub u_settling: f64,
    pub i: f64,
    pub i_settling: f64,
    /// Loss of the bridge, and its mean before the first window.
    pub loss: f64,
    pub loss_settling: f64,
}

impl Reading {
    /// From the record of a level; `before`: current of the level before it, `rise`: part of the time before the first
    /// window in which the current changes.
    pub fn new<R: Real>(level: &Level<R>, before: f64, rise: f64, loss: impl Fn(f64) -> f64) -> Self {
        const POINTS: u32 = 32;
        let (i, i_settling) = (level.i.to_f64(), level.i_settling.to_f64());
        let late = late(i, i_settling, before);
        let ramp = (0..POINTS).map(|k| loss(before + (i - before) * (f64::from(k) + 0.5) / f64::from(POINTS)));
        let ramp = ramp.sum::<f64>() / f64::from(POINTS);
        let half = (0.5 * rise).min(late).min(1.0 - late);
        let loss_settling = (late - half) * loss(before) + 2.0 * half * ramp + (1.0 - late - half) * loss(i);
        let u = level.u.map(R::to_f64);
        Self { u, u_settling: level.u_settling.to_f64(), i, i_settling, loss: loss(i), loss_settling }
    }
}

/// Part of the time before the first window after which a sudden step would have had the same mean current.
fn late(i: f64, i_settling: f64, before: f64) -> f64 {
    let change = i - before;
    if change.abs() > 1e-3 { ((i - i_settling) / change).clamp(0.0, 1.0) } else { 0.0 }
}

/// Magnetising curve and resistances, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MagnetisingCurve {
    /// `R_s + r_d`.
    pub r: f64,
    /// Rotor resistance of the Γ circuit.
    pub r_r: f64,
    /// Unsaturated stator inductance.
    pub l_u: f64,
    /// Saturated part at rated flux, and exponent.
    pub c: f64,
    /// The exponent.
    pub s: f64,
    /// Factor of the bridge's loss less one.
    pub d: f64,
    /// Leakage inductance at slip frequency relative to that at high frequency: 1 without deep bars.
    pub bar: f64,
    /// Standard deviations: relative of `r`, `r_r`, `l_u`, absolute of `c`, `s`, `d`, relative of `bar`.
    pub deviation: [f64; P],
    /// Relative one of the inductance at rated flux.
    pub deviation_rated: f64,
    /// Root mean square of the residuals, per unit.
    pub residual: f64,
    /// Largest flux reached, per unit.
    pub psi_max: f64,
}

impl MagnetisingCurve {
    /// Magnetising current and its derivative.
    fn current(&self, psi: f64) -> (f64, f64) {
        let bend = if self.c > 0.0 { self.c * libm::pow(psi.abs().max(1e-9), self.s) } else { 0.0 };
        (psi / self.l_u * (1.0 + bend), (1.0 + (self.s + 1.0) * bend) / self.l_u)
    }

    /// Stator inductance at a flux.
    #[must_use]
    pub fn inductance(&self, psi: f64) -> f64 {
        self.l_u / (1.0 + self.c * libm::pow(psi.abs(), self.s))
    }

    /// Leakage inductance of the Γ circuit at slip frequency, for the total leakage `l_sigma` at high frequency and small flux,
    /// `1/L_σ = 1/L_u + 1/L_l`.
    pub(super) fn leakage(&self, l_sigma: f64) -> f64 {
        self.bar / (1.0 / l_sigma - 1.0 / self.l_u).max(0.1 / l_sigma)
    }
}

/// A trajectory of the flux.
#[derive(Clone, Copy)]
struct Trajectory {
    curve: MagnetisingCurve,
    /// Leakage inductance of the Γ circuit.
    l_l: f64,
    psi: f64,
    i: f64,
}

impl Trajectory {
    fn new(p: &[f64; N], l_sigma: f64) -> Self {
        let [r, r_r, l_u, c, s, d, bar, ..] = *p;
        let (r, r_r, l_u, bar) = (libm::exp(r), libm::exp(r_r), libm::exp(l_u), libm::exp(bar));
        let curve = MagnetisingCurve {
            r,
            r_r,
            l_u,
            c: c.max(0.0),
            s: s.clamp(1.0, 20.0),
            d,
            bar,
            deviation: [0.0; P],
            deviation_rated: 0.0,
            residual: 0.0,
            psi_max: 0.0,
        };
        Self { curve, l_l: curve.leakage(l_sigma), psi: 0.0, i: 0.0 }
    }

    /// The current steps, the rotor flux does not.
    fn step(&mut self, i: f64) {
        let rotor = self.psi - self.l_l * (self.i - self.curve.current(self.psi).0);
        for _ in 0..20 {
            let (g, slope) = self.curve.current(self.psi);
            let e = self.psi - self.l_l * (i - g) - rotor;
            self.psi -= (e / (1.0 + self.l_l * slope)).clamp(-0.2, 0.2);
        }
        self.i = i;
    }

    fn rate(&self, psi: f64) -> f64 {
        let (g, slope) = self.curve.current(psi);
        self.curve.r_r * (self.i - g) / (1.0 + self.l_l * slope)
    }

    /// Advances by a duration; returns the change of the flux.
    fn advance(&mut self, tau: f64) -> f64 {
        let h = tau / f64::from(STEPS);
        let before = self.psi;
        for _ in 0..STEPS {
            let x = self.psi;
            let k1 = self.rate(x);
            let k2 = self.rate(x + 0.5 * h * k1);
            let k3 = self.rate(x + 0.5 * h * k2);
            let k4 = self.rate(x + h * k3);
            self.psi = (x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)).clamp(-10.0, 10.0);
        }
        self.psi - before
    }

    /// Begins a level; `settle`: time from the command to the first window. Returns the change of the flux.
    fn begin(&mut self, level: &Reading, settle: f64) -> f64 {
        let before = self.psi;
        let late = late(level.i, level.i_settling, self.i);
        self.advance(late * settle);
        self.step(level.i);
        self.advance((1.0 - late) * settle);
        self.psi - before
    }

    /// Mean voltage of a window.
    fn window(&mut self, level: &Reading, tau: f64) -> f64 {
        self.constant(level.i, level.loss) + self.advance(tau) / tau
    }

    /// Voltage of the resistance and of the bridge.
    fn constant(&self, i: f64, loss: f64) -> f64 {
        self.curve.r * i + (1.0 + self.curve.d) * loss
    }

    /// Volt-seconds of the time before the first window.
    fn settling(&mut self, level: &Reading, settle: f64) -> f64 {
        let flux = self.begin(level, settle);
        settle * self.constant(level.i_settling, level.loss_settling) + flux
    }
}

/// What the fit begins with, per unit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Guess {
    pub r: f64,
    pub r_r: f64,
    pub l_s: f64,
    pub l_sigma: f64,
    /// Standard deviation of the bridge's loss, relative.
    pub loss: f64,
    /// Durations until the first window and of a window, times `ω_sR`.
    pub settle: f64,
    pub window: f64,
    /// Standard deviation of the flux that a reversal moves: [`SIGMA_PSI`].
    pub sigma_psi: f64,
}

/// Fit of the levels that were read.
pub(super) fn fit(guess: &Guess, levels: &[Reading]) -> MagnetisingCurve {
    let equation = [
        (libm::log(guess.r), PRIOR_PLATE),
        (libm::log(guess.r_r), PRIOR_PLATE),
        (libm::log(guess.l_s * 1.2), PRIOR_PLATE),
        PRIOR_C,
        PRIOR_S,
        (0.0, libm::hypot(PRIOR_D, guess.loss)),
        PRIOR_BAR,
    ];
    let prior: [(f64, f64); N] = core::array::from_fn(|k| equation.get(k).copied().unwrap_or((0.0, PRIOR_LEVEL)));
    let mut p = prior.map(|x| x.0);
    let mut damping = 1e-2;
    let (mut normal, mut cost) = normal_equations(guess, levels, &prior, &p);
    for _ in 0..40 {
        let Some(next) = next(&normal, damping, p) else { break };
        let (n, c) = normal_equations(guess, levels, &prior, &next);
        if c < cost {
            let gain = cost - c;
            (normal, p) = (n, next);
            cost = c;
            damping = (damping * 0.2).max(1e-9);
            if gain < 1e-6 * cost {
                break;
            }
        } else {
            damping *= 8.0;
            if damping > 1e8 {
                break;
            }
        }
    }
    let mut curve = Trajectory::new(&p, guess.l_sigma).curve;
    let (residual, psi_max) = residuals(guess, levels, &p);
    (curve.residual, curve.psi_max) = (residual, psi_max);
    // The residuals say how good the model is: they scale the deviations.
    let scale = (residual / SIGMA_U).max(1.0);
    for k in 0..P {
        let mut unit = [0.0; N];
        unit[k] = 1.0;
        curve.deviation[k] = solve(&normal.0, &unit).map_or(prior[k].1, |x| scale * libm::sqrt(x[k].max(0.0)));
    }
    // ln L_s = ln L_u - ln(1 + c)
    let mut gradient = [0.0; N];
    (gradient[2], gradient[3]) = (1.0, -1.0 / (1.0 + curve.c));
    curve.deviation_rated = solve(&normal.0, &gradient).map_or(0.5, |x| {
        let variance: f64 = (0..N).map(|k| gradient[k] * x[k]).sum();
        scale * libm::sqrt(variance.max(0.0))
    });
    curve
}

/// Whether a window of a level counts: not while the rotor's branches settle, and of the first level, before which the
/// flux is not known, only the settled end.
fn counts(level: usize, window: usize) -> bool {
    window > 0 && (level > 0 || window >= WINDOWS / 2)
}

/// Ranges of the saturated part, of the exponent and of the logarithm of the ratio of the leakages.
const RANGES: [(usize, f64, f64); 3] = [(3, 0.0, 5.0), (4, 1.0, 20.0), (6, -0.1, 1.0)];

/// A damped step. A parameter at the end of its range which the step would leave stays there, and the others take the step
/// that is best without it.
fn next((a, b): &Normal, damping: f64, p: [f64; N]) -> Option<[f64; N]> {
    let (mut a, mut b) = (*a, *b);
    for k in 0..N {
        a[k][k] *= 1.0 + damping;
    }
    loop {
        let step = solve(&a, &b)?;
        let outward = RANGES
            .into_iter()
            .find(|&(k, low, high)| (p[k] <= low && step[k] > 0.0) || (p[k] >= high && step[k] < 0.0));
        let Some((held, ..)) = outward else {
            let mut next: [f64; N] = core::array::from_fn(|k| p[k] - step[k].clamp(-1.0, 1.0));
            for (k, low, high) in RANGES {
                next[k] = next[k].clamp(low, high);
            }
            return Some(next);
        };
        for k in 0..N {
            (a[held][k], a[k][held]) = (0.0, 0.0);
        }
        (a[held][held], b[held]) = (1.0, 0.0);
    }
}

type Normal = ([[f64; N]; N], [f64; N]);

/// Gauss-Newton matrix and gradient at `p`, and the cost: one trajectory for each parameter beside that of `p`.
fn normal_equations(guess: &Guess, levels: &[Reading], prior: &[(f64, f64); N], p: &[f64; N]) -> (Normal, f64) {
    const DELTA: f64 = 1e-4;
    let mut all = [Trajectory::new(p, guess.l_sigma); P + 1];
    for k in 0..P {
        let mut q = *p;
        q[k] += DELTA;
        all[k + 1] = Trajectory::new(&q, guess.l_sigma);
    }
    let (mut a, mut b, mut cost) = ([[0.0; N]; N], [0.0; N], 0.0);
    let mut add = |e: f64, d: &[f64; N], w: f64| {
        cost += w * e * e;
        for i in 0..N {
            b[i] += w * e * d[i];
            for j in 0..N {
                a[i][j] += w * d[i] * d[j];
            }
        }
    };
    let w = 1.0 / (SIGMA_U * SIGMA_U);
    for (at, level) in levels.iter().enumerate() {
        let slopes = |model: &[f64; P + 1], of_level: f64| {
            let mut d = [0.0; N];
            for k in 0..P {
                d[k] = (model[k + 1] - model[0]) / DELTA;
            }
            d[P + at] = of_level;
            d
        };
        let settling = all.each_mut().map(|t| t.settling(level, guess.settle));
        for (window, u) in level.u.into_iter().enumerate() {
            let model = all.each_mut().map(|t| t.window(level, guess.window));
            if counts(at, window) {
                add(model[0] + p[P + at] - u, &slopes(&model, 1.0), w);
            } else if at > 0 {
                // The flux of the reversal.
                let model = core::array::from_fn(|k| settling[k] + guess.window * model[k]);
                let tau = guess.settle + guess.window;
                let e = model[0] + tau * p[P + at] - guess.settle * level.u_settling - guess.window * u;
                add(e, &slopes(&model, tau), 1.0 / (guess.sigma_psi * guess.sigma_psi));
            }
        }
    }
    for k in 0..N {
        let mut d = [0.0; N];
        d[k] = 1.0;
        add(p[k] - prior[k].0, &d, 1.0 / (prior[k].1 * prior[k].1));
    }
    ((a, b), cost)
}

/// Root mean square of the residuals, and the largest flux.
fn residuals(guess: &Guess, levels: &[Reading], p: &[f64; N]) -> (f64, f64) {
    let mut t = Trajectory::new(p, guess.l_sigma);
    let (mut sum, mut n, mut psi_max) = (0.0, 0.0, 0.0f64);
    for (at, level) in levels.iter().enumerate() {
        t.begin(level, guess.settle);
        for (window, u) in level.u.into_iter().enumerate() {
            let e = t.window(level, guess.window) + p[P + at] - u;
            if counts(at, window) {
                sum += e * e;
                n += 1.0;
            }
            psi_max = psi_max.max(t.psi.abs());
        }
    }
    (libm::sqrt(sum / f64::max(n, 1.0)), psi_max)
}

/// Solution of a symmetric positive definite system by Cholesky's decomposition.
fn solve(a: &[[f64; N]; N], b: &[f64; N]) -> Option<[f64; N]> {
    let m = nalgebra::SMatrix::<f64, N, N>::from_fn(|i, j| a[i][j]);
    let x = m.cholesky()?.solve(&nalgebra::SVector::<f64, N>::from_row_slice(b));
    x.iter().all(|x| x.is_finite()).then(|| core::array::from_fn(|k| x[k]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Readings of a machine without noise: `R`, `R_r`, `L_u`, `c`, `S`, `L_σ` and the ratio of the leakages.
    fn readings([r, r_r, l_u, c, s, l_sigma, bar]: [f64; 7], settle: f64, window: f64) -> [Reading; LEVELS] {
        let mut p = [0.0; N];
        p[..P].copy_from_slice(&[libm::log(r), libm::log(r_r), libm::log(l_u), c, s, 0.0, libm::log(bar)]);
        let mut machine = Trajectory::new(&p, l_sigma);
        let mut before = 0.0;
        levels((1.0 + c) / l_u).map(|i| {
            let i_settling = 0.1 * before + 0.9 * i;
            before = i;
            let mut reading = Reading { i, i_settling, ..Reading::default() };
            reading.u_settling = machine.settling(&reading, settle) / settle;
            reading.u = core::array::from_fn(|_| machine.window(&reading, window));
            reading
        })
    }

    /// Largest errors of `R_r` and of the inductance at rated flux, relative, for ratios of the leakages from that of a
    /// simple cage to that of deep bars.
    fn errors(c: f64, sigma_psi: f64) -> (f64, f64) {
        let (l_u, l_sigma) = (2.3 * (1.0 + c), 0.17);
        let (settle, window) = (5.0, 20.0);
        let guess = Guess { r: 0.05, r_r: 0.05, l_s: 2.0, l_sigma, loss: 0.01, settle, window, sigma_psi };
        [1.0, 1.15, 1.3].into_iter().fold((0.0f64, 0.0f64), |(r_r, l_s), bar| {
            let found = fit(&guess, &readings([0.045, 0.04, l_u, c, 7.0, l_sigma, bar], settle, window));
            assert!(found.residual < SIGMA_U, "{}", found.residual);
            (r_r.max((found.r_r / 0.04 - 1.0).abs()), l_s.max((found.inductance(1.0) / 2.3 - 1.0).abs()))
        })
    }

    #[test]
    fn a_motor_with_and_without_saturation_is_found() {
        for c in [0.0, 0.02, 0.1, 0.4, 0.8] {
            let (r_r, l_s) = errors(c, SIGMA_PSI);
            assert!(r_r < 0.005 && l_s < 0.005, "{c}: {r_r} {l_s}");
        }
    }

    #[test]
    fn only_the_flux_of_the_reversals_tells_rotor_resistance_and_leakage_apart_where_nothing_saturates() {
        let (r_r, l_s) = errors(0.0, 1e3);
        assert!(r_r > 0.02 && l_s > 0.01, "{r_r} {l_s}");
        let (r_r, l_s) = errors(0.4, 1e3);
        assert!(r_r < 0.005 && l_s < 0.005, "{r_r} {l_s}");
    }
}
