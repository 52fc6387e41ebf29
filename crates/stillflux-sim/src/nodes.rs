//! Node capacitance of the legs: potential of a leg while none of its devices conducts. SI.
//!
//! ```text
//! C v_k' = -i_k                     no device conducts, v_lo < v_k < v_hi
//! v_k = v_lo, i_k > 0               a device conducts: switch or diode
//! v_k = v_hi, i_k < 0
//! ```
//!
//! `[v_lo, v_hi]` is that of [`crate::bridge`]; `C` is the total of one leg (`Inverter::c_out`), equal in all
//! legs. `i_k > 0` flows to the machine. The machine sees `v_k`, conducting or not, less `r_d i_k`: the
//! capacitance lies across the devices' forward characteristic, `r_d` between it and the machine.
//!
//! * A rail that moves away (a switch turns off) releases the node; it ramps with its current, which may
//!   pass through zero, until it reaches a rail: that of the diode within the dead time, or with reversed current
//!   that of its own switch.
//! * A rail that moves across the node (a switch turns on) charges it instantly. The switch dissipates
//!   the difference between the energy from the link, `Q u_dc` or 0, and that stored in the capacitance.
//! * A conducting leg's current that reaches zero releases the node at its rail. While a switch is on, the two
//!   rails are `2 u_th` apart.
//! * The common part of three floating potentials is held by their charge: `i_a + i_b + i_c = 0`.
//!
//! With `q = ∫ i_s dt` since the start of a segment, floating legs `F` and `e_k` their axes,
//! `u_s = u_0 - K q`, `K = 2/(3 C) Σ_F e_k e_k^T`: [`Nodes::feed`]. With the machine it is an oscillator of at most
//! `omega_0² = (∂i/∂psi)/C`; a step of at most `0.3/omega_0` ([`crate::machine::Circuit::taylor`]) errs by 1e-6 of the
//! swing, and the charge is exact.
//!
//! **Gates blocked for long.** The nodes ring about the induced voltage until the windings' resistance has damped it,
//! some 0.1 s. Below 1e-4 of `u_dc` they follow the induced voltage and the phase current, some 0.1 mA, is
//! neglected: [`Nodes::follow`]. What their stored energy then changes by is booked as charging.
#![allow(non_snake_case)]

use crate::bridge::{Bridge, Feed, phase};
use crate::machine::{Circuit, Energy, Field, Series, State, V2, axpy, dot, phases, space_vector};

/// Longest step in units of `1/omega_0`.
const STEP: f64 = 0.3;
/// Amplitude of ringing, relative to the link voltage, below which it is neglected.
const STILL: f64 = 1e-4;

/// Potentials of the legs' nodes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Nodes {
    /// Capacitance, F.
    pub C: f64,
    inv_C: f64,
    /// Potentials at the start of the segment, V; kept up to date by [`Self::settle`] and [`Self::discharge`].
    pub v: [f64; 3],
    /// A node this close to a rail has reached it, V.
    pub tol: f64,
    /// Currents below it count as zero, A.
    pub zero: f64,
}

impl Nodes {
    /// Nodes halfway between the rails, as of a bridge that has never switched.
    pub fn new(C: f64, u_dc: f64, zero: f64) -> Self {
        Self { C, inv_C: 1.0 / C, v: [0.5 * u_dc; 3], tol: 1e-8 * u_dc, zero }
    }

    /// Stored energy, J.
    pub fn energy(&self) -> f64 {
        0.5 * self.C * self.v.iter().map(|v| v * v).sum::<f64>()
    }

    /// Sets the nodes to the potentials of the present gates and current signs, whatever was before.
    pub fn place(&mut self, b: &Bridge) {
        for k in 0..3 {
            let (lo, hi) = (b.lo(k), b.hi(k));
            self.v[k] = match b.sign[k] {
                s if s > 0.0 => lo,
                s if s < 0.0 => hi,
                _ => self.v[k].max(lo).min(hi),
            };
        }
    }

    /// After a change of gates, link voltage or current signs: charges what a rail has crossed, releases what a
    /// rail has left.
    #[inline(always)]
    pub fn settle(&mut self, b: &mut Bridge, i: V2, energy: &mut Option<Energy>) {
        for k in 0..3 {
            let (lo, hi) = (b.lo(k), b.hi(k));
            let v = self.v[k];
            let settled = match b.sign[k] {
                s if s > 0.0 => v == lo,
                s if s < 0.0 => v == hi,
                _ => v - lo > self.tol && hi - v > self.tol,
            };
            if settled {
                continue;
            }
            self.settle_leg(b, i, k, lo, hi, energy);
        }
    }

    #[inline(never)]
    fn settle_leg(&mut self, b: &mut Bridge, i: V2, k: usize, lo: f64, hi: f64, energy: &mut Option<Energy>) {
        let to = self.v[k].max(lo).min(hi);
        if let Some(e) = energy {
            // Through the upper device, on or diode, the charge comes from the link; else from its negative rail.
            let upper = to > 0.5 * b.u_dc;
            let link = if upper { self.C * (to - self.v[k]) * b.u_dc } else { 0.0 };
            e.link += link;
            e.charging += link - 0.5 * self.C * (to * to - self.v[k] * self.v[k]);
        }
        self.v[k] = to;
        let i = phase(i, k);
        b.sign[k] = if hi - lo <= self.tol {
            // No room to float: the leg conducts, whatever the sign.
            if i < 0.0 { -1.0 } else { 1.0 }
        } else if to - lo <= self.tol && i > self.zero {
            1.0
        } else if hi - to <= self.tol && i < -self.zero {
            -1.0
        } else {
            0.0
        };
        if b.sign[k] > 0.0 {
            self.v[k] = lo;
        } else if b.sign[k] < 0.0 {
            self.v[k] = hi;
        }
    }

    /// What the bridge feeds to the machine from the present potentials.
    #[inline(always)]
    pub fn feed(&self, b: &Bridge) -> Feed {
        let u = space_vector(self.v);
        if b.sign[0] != 0.0 && b.sign[1] != 0.0 && b.sign[2] != 0.0 {
            return Feed::Voltage(u);
        }
        let on = b.sign.map(|s| if s == 0.0 { self.inv_C } else { 0.0 });
        // Space vector of the floating legs' share of q: symmetric, (αα, αβ, ββ).
        let K =
            [(4.0 * on[0] + on[1] + on[2]) * (1.0 / 6.0), (on[2] - on[1]) * (0.5 / 3f64.sqrt()), 0.5 * (on[1] + on[2])];
        Feed::Nodes(u, K)
    }

    /// Longest step of the oscillator.
    #[inline(always)]
    pub fn longest_step<const KIND: u8>(&self, c: &Circuit, x: &State, f: &Field) -> f64 {
        STEP * (self.C / c.tangent_from::<KIND>(x, f.b).largest::<KIND>()).sqrt()
    }

    /// The floating leg that reaches a rail first within `h`, and when, by the series of the oscillator; `None` if
    /// none does or a current reverses before. An estimate of the segment's length.
    #[inline(always)]
    pub fn ramp(&self, b: &Bridge, f: &Field, series: &Series, h: f64) -> Option<(usize, f64)> {
        let i = phases(f.i);
        let (mut leg, mut first) = (None, h);
        for k in 0..3 {
            if b.sign[k] != 0.0 {
                continue;
            }
            let way = if i[k] > 0.0 { self.v[k] - b.lo(k) } else { self.v[k] - b.hi(k) } * self.C;
            // Not even with a current that grows by half.
            if way.abs() > 1.5 * i[k].abs() * first || way == 0.0 {
                continue;
            }
            let t = series.time_of(k, way);
            if t > 0.0 && t < first {
                (leg, first) = (Some((k, t)), t);
            }
        }
        leg
    }

    /// Whether all nodes float, have ceased to ring, and will not reach a rail while the induced voltage turns.
    pub fn still<const KIND: u8>(&self, b: &Bridge, c: &Circuit, x: &State, f: &Field) -> bool {
        if b.sign != [0.0; 3] {
            return false;
        }
        // The voltage at which the current keeps its value, turning with the rotor, and the current this takes.
        let e = axpy(c.open::<KIND>(x, f), c.R, f.i);
        let k = self.C * c.n_p * x.omega;
        let du = axpy(space_vector(self.v), -1.0, e);
        // Exactly zero after an interval without ringing.
        let di = if f.i == [0.0; 2] { [0.0; 2] } else { [f.i[0] - k * e[1], f.i[1] + k * e[0]] };
        let mean = (self.v[0] + self.v[1] + self.v[2]) / 3.0;
        let room = [0, 1, 2].map(|k| (mean - b.lo(k)).min(b.hi(k) - mean)).into_iter().fold(f64::INFINITY, f64::min);
        dot(du, du) + dot(di, di) / (f.b * self.C) < (STILL * b.u_dc).powi(2)
            && 1.01 * dot(e, e).sqrt() + 0.01 * b.u_dc < room
    }

    /// Sets floating nodes to the induced voltage `e`, without changing their common part.
    pub fn follow(&mut self, e: V2, energy: &mut Option<Energy>) {
        let (before, e) = (self.energy(), phases(e));
        let mean = (self.v[0] + self.v[1] + self.v[2]) / 3.0;
        self.v = [0, 1, 2].map(|k| mean + e[k]);
        if let Some(books) = energy {
            books.charging += before - self.energy();
        }
    }

    /// Takes the charge `∫ i_s dt` out of the floating nodes.
    #[inline(always)]
    pub fn discharge(&mut self, b: &Bridge, q: V2) {
        let q = phases(q);
        for k in 0..3 {
            if b.sign[k] == 0.0 {
                self.v[k] -= self.inv_C * q[k];
            }
        }
    }

    /// Potential of floating node `k` once the charge `q` has left.
    #[inline(always)]
    pub fn potential(&self, k: usize, q: V2) -> f64 {
        self.v[k] - self.inv_C * phase(q, k)
    }
}
