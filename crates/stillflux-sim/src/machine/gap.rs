//! What saturating leakage and slots ([`crate::slots`]) add to the circuit: to the leakage current, the tangents and the
//! torque. `e^{j Z theta}` is carried as [`State::slot`] and turned by each step's small angle.
#![allow(non_snake_case)]

use super::state::State;
use super::tangent::apply;
use super::vector::{V2, axpy, dot, turned};
use crate::slots::{LeakageSaturation, SlotRipple};
use stillflux::params::Machine;

/// Coefficients, all zero without.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Gap {
    /// `Z`
    slots: f64,
    /// `p/L_u`
    main: f64,
    /// `l/L_l`
    zigzag: f64,
    /// `k/L_l`
    k: f64,
    /// `R_r` of the rotor's first branch.
    pub R_r: f64,
}

/// Leakage flux and what hangs on it.
#[derive(Clone, Copy)]
pub(crate) struct Leak {
    /// `psi_s - psi_r`
    l: V2,
    /// Current beyond `psi_l/L_l`.
    pub i: V2,
    /// Its tangent (αα, αβ, ββ).
    tangent: [f64; 3],
}

/// `e^{jx} v*`
#[inline(always)]
fn mirrored(e: V2, v: V2) -> V2 {
    [e[0] * v[0] + e[1] * v[1], e[1] * v[0] - e[0] * v[1]]
}

/// `j v`
#[inline(always)]
fn turned_by_quarter(v: V2) -> V2 {
    [-v[1], v[0]]
}

impl Leak {
    /// Tangent of the excess current times `v`.
    #[inline(always)]
    pub fn apply(&self, v: V2) -> V2 {
        apply(&self.tangent, v)
    }
}

impl Gap {
    pub fn new(
        m: &Machine,
        inv_L_l: f64,
        inv_L_u: f64,
        saturation: Option<LeakageSaturation>,
        slots: Option<SlotRipple>,
    ) -> Self {
        let ripple = slots.unwrap_or(SlotRipple { slots: 0, permeance: 0.0, leakage: 0.0 });
        Self {
            slots: f64::from(ripple.slots),
            main: ripple.permeance * inv_L_u,
            zigzag: ripple.leakage * inv_L_l,
            k: saturation.map_or(0.0, |s| s.k(m) * inv_L_l),
            R_r: 0.0,
        }
    }

    pub fn is_some(&self) -> bool {
        self.main != 0.0 || self.zigzag != 0.0 || self.k != 0.0
    }

    /// `e^{j Z theta}`
    pub fn slot(&self, theta: f64) -> V2 {
        let (sin, cos) = libm::sincos(self.slots * theta);
        [cos, sin]
    }

    /// [`Self::slot`] once the shaft has turned on by `dtheta`.
    #[inline(always)]
    pub fn turn(&self, slot: V2, dtheta: f64) -> V2 {
        turned(slot, self.slots * dtheta)
    }

    /// The same for what acceleration adds within a step, some 1e-5 rad.
    #[inline(always)]
    pub fn nudge(&self, slot: V2, dtheta: f64) -> V2 {
        let d = self.slots * dtheta;
        let c = 1.0 - 0.5 * d * d;
        [c * slot[0] - d * slot[1], c * slot[1] + d * slot[0]]
    }

    #[inline(always)]
    pub fn leak(&self, x: &State) -> Leak {
        let l = axpy(x.psi_s, -1.0, x.psi_r);
        let h = self.k * dot(l, l);
        let (c, s, k) = (self.zigzag * x.slot[0], self.zigzag * x.slot[1], 2.0 * self.k);
        let z = mirrored([c, s], l);
        Leak { l, i: axpy(z, h, l), tangent: [h + k * l[0] * l[0] + c, k * l[0] * l[1] + s, h + k * l[1] * l[1] - c] }
    }

    /// Current of the permeance's ripple.
    #[inline(always)]
    pub fn main(&self, x: &State) -> V2 {
        let g = self.main * x.slot[0];
        [g * x.psi_s[0], g * x.psi_s[1]]
    }

    /// What the slots' passing does to the leakage current, per mechanical radian.
    #[inline(always)]
    fn leak_turn(&self, x: &State, leak: &Leak) -> V2 {
        let k = self.zigzag * self.slots;
        let [c, s] = x.slot;
        mirrored([-k * s, k * c], leak.l)
    }

    /// And to the stator current.
    #[inline(always)]
    pub fn turn_rate(&self, x: &State, leak: &Leak) -> V2 {
        axpy(self.leak_turn(x, leak), -self.main * self.slots * x.slot[1], x.psi_s)
    }

    /// `(2/3) T` beyond that of a linear leakage.
    #[inline(always)]
    pub fn torque(&self, x: &State, leak: &Leak, n_p: f64) -> f64 {
        let [c, s] = x.slot;
        let l = leak.l;
        let across = 2.0 * l[0] * l[1] * c - (l[0] * l[0] - l[1] * l[1]) * s;
        n_p * dot(turned_by_quarter(x.psi_r), leak.i)
            + 0.5 * self.slots * (self.main * s * dot(x.psi_s, x.psi_s) - self.zigzag * across)
    }

    /// `(2/3) W` beyond that of linear inductances.
    pub fn energy(&self, x: &State) -> f64 {
        let l = axpy(x.psi_s, -1.0, x.psi_r);
        let l2 = dot(l, l);
        0.25 * self.k * l2 * l2
            + 0.5 * self.main * x.slot[0] * dot(x.psi_s, x.psi_s)
            + 0.5 * self.zigzag * dot(mirrored(x.slot, l), l)
    }

    /// `v -> l e^{j Z theta}/L_l v*` as symmetric matrix (αα, αβ, ββ), and `p cos(Z theta)/L_u`.
    pub fn ripple(&self, slot: V2) -> ([f64; 3], f64) {
        let (c, s) = (self.zigzag * slot[0], self.zigzag * slot[1]);
        ([c, s, -c], self.main * slot[0])
    }

    /// Chord of the leakage's saturation, to add to `1/L_l`.
    pub fn chord(&self, x: &State) -> f64 {
        let l = axpy(x.psi_s, -1.0, x.psi_r);
        self.k * dot(l, l)
    }

    /// First derivative of the leakage current's excess.
    #[inline(always)]
    pub fn leak_rate(&self, x: &State, leak: &Leak, dl: V2) -> V2 {
        axpy(leak.apply(dl), x.omega, self.leak_turn(x, leak))
    }

    /// What the second derivatives of the currents have beyond the tangents times those of the fluxes: (of the leakage
    /// current, of the stator current) from the first derivatives of `psi_l` and `psi_s` and the acceleration.
    #[inline(always)]
    pub fn curvature(&self, x: &State, leak: &Leak, dl: V2, ds: V2, a: f64) -> (V2, V2) {
        let [c, s] = x.slot;
        let (w, accel) = (self.slots * x.omega, self.slots * a);
        let z = self.zigzag;
        // Turning of the slots: first and second derivative of e^{jx}.
        let (e1, e2) = ([-w * s, w * c], [-w * w * c - accel * s, accel * c - w * w * s]);
        let slots = axpy(mirrored(e2, leak.l), 2.0, mirrored(e1, dl));
        let knee = axpy([0.0; 2], 4.0 * self.k * dot(leak.l, dl), dl);
        let knee = axpy(knee, 2.0 * self.k * dot(dl, dl), leak.l);
        let leakage = axpy(knee, z, slots);
        let main = axpy([2.0 * e1[0] * ds[0], 2.0 * e1[0] * ds[1]], e2[0], x.psi_s);
        (leakage, axpy(leakage, self.main, main))
    }

    /// `∂i_s/∂psi_s` beyond that of a linear leakage.
    #[inline(always)]
    pub fn tangent(&self, x: &State, leak: &Leak) -> [f64; 3] {
        let (g, t) = (self.main * x.slot[0], leak.tangent);
        [t[0] + g, t[1], t[2] + g]
    }
}
