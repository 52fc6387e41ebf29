//! Integration of the circuit over one segment: Runge-Kutta steps, Taylor steps where segments are short.
#![allow(non_snake_case)]

use super::{AXIS, BRANCHED, Circuit, FULL, Field, LINEAR, State, V2, axpy, dot};
use crate::mechanics::Shaft;

/// The saturation term about the start of a step, a series in `|psi_s|²`: within a step the flux moves by
/// per mille, so four products replace a square root on the longest chain of dependent operations.
struct Near {
    x: f64,
    c: [f64; 5],
}

/// One integration step: the state reached and `∫ i dt` on the way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step {
    pub x: State,
    pub int_i: V2,
}

/// Derivatives of current, rotor flux and speed at the start of a short segment; see [`Circuit::taylor`].
pub(crate) struct Series {
    u: V2,
    K: [f64; 3],
    /// `i_s` and its derivatives, from the third those of the nodes' oscillation alone.
    i: [V2; 5],
    /// Derivatives of `psi_r`.
    r: [V2; 3],
    /// Those of the further branches.
    x: [[V2; 3]; 2],
    /// Acceleration.
    a: f64,
}

impl Series {
    /// `∫ i_s dt` after `h`.
    #[inline(always)]
    pub fn charge<const NODES: bool>(&self, h: f64) -> V2 {
        [0, 1].map(|n| {
            let i = |k: usize| self.i[k][n];
            let late = if NODES { h * (i(3) * (1.0 / 24.0) + h * i(4) * (1.0 / 120.0)) } else { 0.0 };
            h * (i(0) + h * (i(1) * 0.5 + h * (i(2) * (1.0 / 6.0) + late)))
        })
    }

    /// Time after which phase `k` has carried the charge `q`: reversion of the series, then Newton's iteration.
    #[inline(always)]
    pub fn time_of(&self, k: usize, q: f64) -> f64 {
        let i = self.i.map(|i| AXIS[k][0] * i[0] + AXIS[k][1] * i[1]);
        let (a1, a2, a3, a4) = (i[1] * 0.5, i[2] * (1.0 / 6.0), i[3] * (1.0 / 24.0), i[4] * (1.0 / 120.0));
        let inv = 1.0 / i[0];
        let t = q * inv;
        let (r1, r2) = (a1 * inv * t, a2 * inv * t * t);
        let mut t = t * (1.0 - r1 * (1.0 - 2.0 * r1) - r2);
        for _ in 0..4 {
            let got = t * (i[0] + t * (a1 + t * (a2 + t * (a3 + t * a4))));
            let slope = i[0] + t * (2.0 * a1 + t * (3.0 * a2 + t * (4.0 * a3 + t * 5.0 * a4)));
            let dt = (q - got) / slope;
            t += dt;
            // The next correction is of the order of the square of this one.
            if dt.abs() < 1e-5 * t.abs() {
                break;
            }
        }
        t
    }
}

impl Circuit {
    #[inline(always)]
    fn near(&self, psi_s: V2, b: f64) -> Near {
        let (x, p, a) = (dot(psi_s, psi_s), b - self.b_0, self.binomial);
        // The cube of it is a number, and with a flux of 1e-30 nothing saturates.
        let r = 1.0 / x.max(1e-60);
        let (p1, r2) = (p * r, r * r);
        Near { x, c: [p, a[0] * p1, a[1] * p1 * r, a[2] * p1 * r2, a[3] * p1 * r * r2] }
    }

    /// [`Self::saturating`] by the series where it is exact to 1e-10 of it, i.e. 1e-12 of the current.
    #[inline(always)]
    fn saturating_near(&self, n: &Near, x: f64) -> f64 {
        let (d, c) = (x - n.x, &n.c);
        if d.abs() < 0.02 * n.x {
            let d2 = d * d;
            (c[0] + c[1] * d) + d2 * ((c[2] + c[3] * d) + d2 * c[4])
        } else {
            self.saturating(x)
        }
    }

    /// Classical Runge-Kutta step of length `h` from `x` (with its field `f`); `dpsi_s` is the stator equation.
    ///
    /// At `h <= 50 µs` the local error is below 1e-10 of the state: `(h (1/tau_sigma + omega_s))^5/120`.
    #[inline(always)]
    pub fn rk4<const KIND: u8>(
        &self,
        shaft: &Shaft,
        x: &State,
        f1: &Field,
        h: f64,
        dpsi_s: impl Fn(&State, &Field) -> V2,
    ) -> Step {
        let branches = |p: [V2; 2], k: f64, d: &[V2; 2]| {
            if KIND >= BRANCHED { [axpy(p[0], k, d[0]), axpy(p[1], k, d[1])] } else { p }
        };
        // The slots' angle halfway and at the end at constant speed.
        let half = if KIND == FULL { self.gap.turn([1.0, 0.0], 0.5 * h * x.omega) } else { [1.0, 0.0] };
        let by = |v: V2, r: V2| if KIND == FULL { [v[0] * r[0] - v[1] * r[1], v[0] * r[1] + v[1] * r[0]] } else { v };
        let middle = by(x.slot, half);
        let end = by(middle, half);
        let nudge = |slot: V2, dtheta: f64| if KIND == FULL { self.gap.nudge(slot, dtheta) } else { slot };
        let at = |k: f64, s: V2, f: &Field, a: f64, slot: V2| State {
            psi_s: axpy(x.psi_s, k, s),
            psi_r: axpy(x.psi_r, k, f.dpsi_r),
            psi_x: branches(x.psi_x, k, &f.dpsi_x),
            omega: x.omega + k * a,
            theta: x.theta,
            slot,
        };
        let near = if KIND != LINEAR { self.near(x.psi_s, f1.b) } else { Near { x: 0.0, c: [0.0; 5] } };
        let field = |x: &State| {
            let b =
                if KIND != LINEAR { self.b_0 + self.saturating_near(&near, dot(x.psi_s, x.psi_s)) } else { self.b_0 };
            self.field_at::<KIND>(x, b)
        };
        let (s1, a1) = (dpsi_s(x, f1), shaft.accel(f1.torque, x.omega));
        let x2 = at(0.5 * h, s1, f1, a1, middle);
        let f2 = field(&x2);
        let (s2, a2) = (dpsi_s(&x2, &f2), shaft.accel(f2.torque, x2.omega));
        let x3 = at(0.5 * h, s2, &f2, a2, nudge(middle, 0.25 * h * h * a1));
        let f3 = field(&x3);
        let (s3, a3) = (dpsi_s(&x3, &f3), shaft.accel(f3.torque, x3.omega));
        let x4 = at(h, s3, &f3, a3, nudge(end, 0.5 * h * h * a2));
        let f4 = field(&x4);
        let (s4, a4) = (dpsi_s(&x4, &f4), shaft.accel(f4.torque, x4.omega));
        let k = h * (1.0 / 6.0);
        let mean = |a: V2, b: V2, c: V2, d: V2| [a[0] + 2.0 * (b[0] + c[0]) + d[0], a[1] + 2.0 * (b[1] + c[1]) + d[1]];
        let i = mean(f1.i, f2.i, f3.i, f4.i);
        let dtheta = h * (x.omega + k * (a1 + a2 + a3));
        Step {
            x: State {
                psi_s: axpy(x.psi_s, k, mean(s1, s2, s3, s4)),
                psi_r: axpy(x.psi_r, k, mean(f1.dpsi_r, f2.dpsi_r, f3.dpsi_r, f4.dpsi_r)),
                psi_x: branches(
                    x.psi_x,
                    k,
                    &[0, 1].map(|n| mean(f1.dpsi_x[n], f2.dpsi_x[n], f3.dpsi_x[n], f4.dpsi_x[n])),
                ),
                omega: x.omega + k * (a1 + 2.0 * (a2 + a3) + a4),
                theta: x.theta + dtheta,
                slot: nudge(end, h * k * (a1 + a2 + a3)),
            },
            int_i: [k * i[0], k * i[1]],
        }
    }

    /// Derivatives at the start of a segment with the voltage `u - K q`, `q = ∫ i_s dt`, `K` as (αα, αβ, ββ);
    /// without `NODES` it is not read.
    #[inline(always)]
    pub fn series<const KIND: u8, const NODES: bool>(
        &self,
        shaft: &Shaft,
        x: &State,
        f: &Field,
        u: V2,
        K: &[f64; 3],
    ) -> Series {
        let t = self.tangent_from::<KIND>(x, f.b);
        let tangent = |v: V2| t.apply::<KIND>(v);
        let k = |v: V2| if NODES { [K[0] * v[0] + K[1] * v[1], K[1] * v[0] + K[2] * v[1]] } else { [0.0; 2] };
        let w = self.n_p * x.omega;
        let s1 = axpy(u, -self.R, f.i);
        let i1 = axpy(tangent(s1), -1.0, self.taken::<KIND>(x, f));
        let a = shaft.accel(f.torque, x.omega);
        let s2 = axpy([-k(f.i)[0], -k(f.i)[1]], -self.R, i1);
        let r = f.dpsi_r;
        let turn = self.n_p * a;
        let mut r2 = [
            self.k_r * (s1[0] - r[0]) - w * r[1] - turn * x.psi_r[1],
            self.k_r * (s1[1] - r[1]) + w * r[0] + turn * x.psi_r[0],
        ];
        let (leak, dl) = (self.gap.leak(x), axpy(s1, -1.0, r));
        if KIND == FULL {
            r2 = axpy(r2, self.gap.R_r, self.gap.leak_rate(x, &leak, dl));
        }
        let mut r3 = [self.k_r * (s2[0] - r2[0]) - w * r2[1], self.k_r * (s2[1] - r2[1]) + w * r2[0]];
        let mut branches = [[[0.0; 2]; 3]; 2];
        if KIND >= BRANCHED {
            for n in 0..2 {
                let (c, p, d) = (&self.x[n], x.psi_x[n], f.dpsi_x[n]);
                let (w, turn) = (c.turns * x.omega, c.turns * a);
                let d2 = [c.k * (s1[0] - d[0]) - w * d[1] - turn * p[1], c.k * (s1[1] - d[1]) + w * d[0] + turn * p[0]];
                let d3 = [c.k * (s2[0] - d2[0]) - w * d2[1], c.k * (s2[1] - d2[1]) + w * d2[0]];
                branches[n] = [d, d2, d3];
            }
        }
        let mut i2 = axpy(tangent(s2), -1.0, self.inward::<KIND>(r2, &[branches[0][1], branches[1][1]]));
        if KIND != LINEAR {
            // Change of the tangent: its derivative along psi_s'.
            let g = dot(x.psi_s, s1);
            let radial = t.q * (dot(s1, s1) + (self.S - 2.0) * g * g / dot(x.psi_s, x.psi_s).max(1e-30));
            i2 = axpy(axpy(i2, 2.0 * t.q * g, s1), radial, x.psi_s);
        }
        if KIND == FULL {
            let (leakage, all) = self.gap.curvature(x, &leak, dl, s1, a);
            i2 = axpy(axpy(i2, -1.0, leak.apply(r2)), 1.0, all);
            r3 = axpy(r3, self.gap.R_r, axpy(leakage, 1.0, leak.apply(axpy(s2, -1.0, r2))));
        }
        let minus = |v: V2| [-v[0], -v[1]];
        let (i3, i4) = if NODES { (tangent(minus(k(i1))), tangent(minus(k(i2)))) } else { ([0.0; 2], [0.0; 2]) };
        Series { u, K: *K, i: [f.i, i1, i2, i3, i4], r: [r, r2, r3], x: branches, a }
    }

    /// Taylor step of a short segment: third order, and sixth in the oscillation of floating nodes, which grows by
    /// `(h omega_0)^8/5040` a step: nothing beside its damping.
    ///
    /// The local error is `(h rate)^4/24` of the state, below 1e-10 at `h rate <= 5e-3`, and for the nodes
    /// `(h omega_0)^6/720` of their swing. One evaluation of the field follows where Runge-Kutta needs four.
    #[inline(always)]
    pub fn taylor<const KIND: u8, const NODES: bool>(&self, shaft: &Shaft, x: &State, s: &Series, h: f64) -> Step {
        let q = s.charge::<NODES>(h);
        let mut psi_s = [x.psi_s[0] + h * s.u[0] - self.R * q[0], x.psi_s[1] + h * s.u[1] - self.R * q[1]];
        if NODES {
            // ∫ q dt
            let Q = [0, 1].map(|n| {
                let i = |k: usize| s.i[k][n];
                let late = h * (i(3) * (1.0 / 120.0) + h * i(4) * (1.0 / 720.0));
                h * h * (i(0) * 0.5 + h * (i(1) * (1.0 / 6.0) + h * (i(2) * (1.0 / 24.0) + late)))
            });
            psi_s = [psi_s[0] - s.K[0] * Q[0] - s.K[1] * Q[1], psi_s[1] - s.K[1] * Q[0] - s.K[2] * Q[1]];
        }
        let flux =
            |p: V2, d: &[V2; 3]| [0, 1].map(|n| p[n] + h * (d[0][n] + h * (d[1][n] * 0.5 + h * d[2][n] * (1.0 / 6.0))));
        let psi_r = flux(x.psi_r, &s.r);
        let mut psi_x = x.psi_x;
        let mut torque = self.k_T * (psi_r[0] * psi_s[1] - psi_r[1] * psi_s[0]);
        if KIND >= BRANCHED {
            psi_x = [flux(psi_x[0], &s.x[0]), flux(psi_x[1], &s.x[1])];
            torque += self.bar_torque(psi_x[1], psi_s);
        }
        let mut y = State { psi_s, psi_r, psi_x, ..*x };
        if KIND == FULL {
            y.slot = self.gap.turn(x.slot, h * (x.omega + 0.5 * h * s.a));
            torque += 1.5 * self.gap.torque(&y, &self.gap.leak(&y), self.n_p);
        }
        let a = shaft.accel(torque, x.omega + h * s.a);
        let dw = 0.5 * h * (s.a + a);
        (y.omega, y.theta) = (x.omega + dw, x.theta + h * (x.omega + 0.5 * dw));
        Step { x: y, int_i: q }
    }
}
