//! The electromagnetic part: Γ-form flux states in stator coordinates, with or without saturation.
//!
//! ```text
//! psi_s' = u_s - R i_s                          i_s = psi_s/L_s(|psi_s|) + (psi_s - psi_r)/L_l
//! psi_r' = (R_r/L_l) (psi_s - psi_r) + j omega psi_r          T = (3/2) n_p (psi_r x psi_s)/L_l
//! 1/L_s(|psi|) = (1 + (a |psi|)^S)/L_u
//! ```
//!
//! Further short-circuited windings, for eddy currents and deep bars, are those of [`crate::branches`], saturation of the
//! leakage and the slots those of [`crate::slots`].
//!
//! `R` is the winding plus `r_d` of the bridge: the current always passes one device per leg, so the
//! fold is exact. All inverse inductances are formed once; a step divides by nothing.
#![allow(non_snake_case)]

mod energy;
mod gap;
mod state;
mod steps;
mod tangent;
mod vector;

pub use self::energy::Energy;
use self::gap::Gap;
pub(crate) use self::state::{BRANCHED, FULL, Field, LINEAR, SATURATING, State};
pub(crate) use self::steps::{Series, Step};
use self::tangent::{Tangent, apply};
pub(crate) use self::vector::{AXIS, V2, axpy, dot, phases, space_vector, turned};
use crate::branches::{Branch, DeepBar, IronLoss};
use crate::slots::{LeakageSaturation, SlotRipple};
use stillflux::params::Machine;

/// What a machine consists of beyond its data; `None`: left out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Extras {
    pub iron: Option<IronLoss>,
    pub bar: Option<DeepBar>,
    pub leakage: Option<LeakageSaturation>,
    pub slots: Option<SlotRipple>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Circuit {
    /// Stator resistance including the bridge's `r_d`.
    pub R: f64,
    pub R_s: f64,
    pub r_d: f64,
    pub n_p: f64,
    inv_L_l: f64,
    /// `R_r/L_l`
    k_r: f64,
    k_T: f64,
    /// Further branches, iron and bar, and whether there are any.
    x: [Branch; 2],
    branched: bool,
    bar: Option<DeepBar>,
    gap: Gap,
    /// `1/L_u + 1/L_l`
    b_0: f64,
    inv_L_u: f64,
    /// `a^S/L_u`, zero without saturation.
    p_0: f64,
    S: f64,
    /// `S` where it is a whole number; zero asks for `powf`.
    whole: u32,
    /// Binomial coefficients of `S/2`, k = 1 … 4.
    binomial: [f64; 4],
}

impl Circuit {
    pub fn new(m: &Machine, r_d: f64, saturation: bool, extras: &Extras) -> Self {
        let Extras { iron, bar, leakage, slots } = *extras;
        let g = m.to_gamma();
        let sat = m.saturation.filter(|s| saturation && s.a > 0.0);
        let (inv_L_u, p_0, S) =
            sat.map_or((1.0 / g.L_s, 0.0, 2.0), |s| (1.0 / s.L_u, libm::pow(s.a, s.S) / s.L_u, s.S));
        let n_p = f64::from(m.n_p);
        let mut term = 1.0;
        let binomial = [0.0, 1.0, 2.0, 3.0].map(|k| {
            term *= (0.5 * S - k) / (k + 1.0);
            term
        });
        let mut circuit = Self {
            R: m.R_s + r_d,
            R_s: m.R_s,
            r_d,
            n_p,
            inv_L_l: 1.0 / g.L_l,
            k_r: g.R_r / g.L_l,
            k_T: 1.5 * n_p / g.L_l,
            x: [Branch::iron(iron), Branch::default()],
            branched: iron.is_some() || bar.is_some(),
            bar,
            gap: Gap::default(),
            b_0: inv_L_u + 1.0 / g.L_l,
            inv_L_u,
            p_0,
            S,
            whole: if S.fract() == 0.0 { S as u32 } else { 0 },
            binomial,
        };
        circuit.b_0 += circuit.x[0].inv_L;
        if let Some(bar) = bar {
            circuit.inv_L_l = (1.0 - bar.leakage) / g.L_l;
            circuit.k_T = 1.5 * n_p * circuit.inv_L_l;
            circuit.x[1] = Branch { inv_L: bar.leakage / g.L_l, k: 0.0, turns: n_p };
            circuit.set_R_R(m);
        }
        circuit.gap = Gap::new(m, circuit.inv_L_l, inv_L_u, leakage, slots);
        circuit.gap.R_r = circuit.k_r / circuit.inv_L_l;
        circuit
    }

    /// The least that the compiler may assume.
    pub fn kind(&self) -> u8 {
        if self.gap.is_some() {
            FULL
        } else if self.branched {
            BRANCHED
        } else if self.p_0 > 0.0 {
            SATURATING
        } else {
            LINEAR
        }
    }

    /// Sum of the further branches' rates `R/L`, 1/s.
    pub fn branch_rate(&self) -> f64 {
        self.x[0].k + self.x[1].k
    }

    pub fn set_R_s(&mut self, R_s: f64) {
        (self.R_s, self.R) = (R_s, R_s + self.r_d);
    }

    /// Takes `R_R` of the inverse-Γ circuit of machine `m`.
    pub fn set_R_R(&mut self, m: &Machine) {
        let R_r = m.to_gamma().R_r;
        self.k_r = R_r * self.inv_L_l;
        if let Some(bar) = self.bar {
            self.k_r /= 1.0 - bar.conductance;
            self.x[1].k = R_r / bar.conductance * self.x[1].inv_L;
        }
        self.gap.R_r = self.k_r / self.inv_L_l;
    }

    /// `a^S |psi|^S / L_u` from `x = |psi|²`. For odd `S` one square root, no power.
    #[inline(always)]
    fn saturating(&self, x: f64) -> f64 {
        if self.whole == 0 {
            return self.p_0 * libm::pow(x, 0.5 * self.S);
        }
        let mut p = if self.whole & 1 == 1 { self.p_0 * x.sqrt() } else { self.p_0 };
        for _ in 0..self.whole / 2 {
            p *= x;
        }
        p
    }

    #[inline(always)]
    pub fn field<const KIND: u8>(&self, x: &State) -> Field {
        let b = if KIND != LINEAR { self.b_0 + self.saturating(dot(x.psi_s, x.psi_s)) } else { self.b_0 };
        self.field_at::<KIND>(x, b)
    }

    #[inline(always)]
    fn field_at<const KIND: u8>(&self, x: &State, b: f64) -> Field {
        let (s, r, w) = (x.psi_s, x.psi_r, self.n_p * x.omega);
        let mut field = Field {
            b,
            i: [b * s[0] - self.inv_L_l * r[0], b * s[1] - self.inv_L_l * r[1]],
            dpsi_r: [self.k_r * (s[0] - r[0]) - w * r[1], self.k_r * (s[1] - r[1]) + w * r[0]],
            dpsi_x: [[0.0; 2]; 2],
            torque: self.k_T * (r[0] * s[1] - r[1] * s[0]),
        };
        if KIND >= BRANCHED {
            field.torque += self.bar_torque(x.psi_x[1], s);
            for n in 0..2 {
                let (c, p) = (&self.x[n], x.psi_x[n]);
                let w = c.turns * x.omega;
                field.i = axpy(field.i, -c.inv_L, p);
                field.dpsi_x[n] = [c.k * (s[0] - p[0]) - w * p[1], c.k * (s[1] - p[1]) + w * p[0]];
            }
        }
        if KIND == FULL {
            let (gap, leak) = (&self.gap, self.gap.leak(x));
            field.i = axpy(axpy(field.i, 1.0, leak.i), 1.0, gap.main(x));
            field.dpsi_r = axpy(field.dpsi_r, gap.R_r, leak.i);
            field.torque += 1.5 * gap.torque(x, &leak, self.n_p);
        }
        field
    }

    #[inline(always)]
    fn bar_torque(&self, p: V2, s: V2) -> f64 {
        1.5 * self.n_p * self.x[1].inv_L * (p[0] * s[1] - p[1] * s[0])
    }

    /// `Σ psi/L` of the short-circuited windings, from their fluxes or their derivatives.
    #[inline(always)]
    fn inward<const KIND: u8>(&self, r: V2, x: &[V2; 2]) -> V2 {
        let sum = [self.inv_L_l * r[0], self.inv_L_l * r[1]];
        if KIND >= BRANCHED { axpy(axpy(sum, self.x[0].inv_L, x[0]), self.x[1].inv_L, x[1]) } else { sum }
    }

    /// Stator equation `u - R i_s`, in the order with the fewest dependent operations.
    #[inline(always)]
    pub fn stator<const KIND: u8>(&self, x: &State, f: &Field, u: V2) -> V2 {
        if KIND >= BRANCHED {
            return axpy(u, -self.R, f.i);
        }
        let (k_s, k_r) = (self.R * f.b, self.R * self.inv_L_l);
        [u[0] + k_r * x.psi_r[0] - k_s * x.psi_s[0], u[1] + k_r * x.psi_r[1] - k_s * x.psi_s[1]]
    }

    /// `e^{j Z theta}` of the slots, where there are any.
    pub fn slot(&self, theta: f64) -> V2 {
        if self.gap.is_some() { self.gap.slot(theta) } else { [0.0; 2] }
    }

    /// [`Self::field`] of whatever kind this circuit is.
    pub fn any_field(&self, x: &State) -> Field {
        if self.kind() == FULL { self.field::<FULL>(x) } else { self.field::<BRANCHED>(x) }
    }

    /// Rotor flux of the inverse-Γ circuit at this operating point, `psi_s - L_sigma i_s`. Saturation of the leakage
    /// is in `L_sigma`, the slots are not.
    pub fn psi_R(&self, x: &State) -> V2 {
        let b = self.b_0 + self.saturating(dot(x.psi_s, x.psi_s));
        if self.gap.is_some() {
            return axpy(x.psi_s, -1.0 / (b + self.gap.chord(x)), self.field::<FULL>(x).i);
        }
        if self.branched {
            let y = self.inward::<BRANCHED>(x.psi_r, &x.psi_x);
            return [y[0] / b, y[1] / b];
        }
        let k = self.inv_L_l / b;
        [k * x.psi_r[0], k * x.psi_r[1]]
    }

    /// State with this rotor flux of the inverse-Γ circuit: the inverse of [`Self::psi_R`]. No eddy current flows in
    /// the iron, the branches of the rotor have one flux. With `Z v = l e^{j Z theta}/L_l v*` and `m` the ripple of the
    /// permeance,
    ///
    /// ```text
    /// (b + c) psi_R = (c + 1/L_l) psi_r + Z (psi_r - psi_s) + (1/L_fe - m) psi_s,   c = k/L_l |psi_s - psi_r|²
    /// ```
    ///
    /// linear in `psi_r` for a given `c`. What the solution then has as `c` is below the given one for large `c`, not below
    /// it for `c = 0`: bisection between them.
    pub fn state_of(&self, psi_s: V2, psi_R: V2, omega: f64, theta: f64) -> State {
        let b = self.b_0 + self.saturating(dot(psi_s, psi_s));
        let slot = self.slot(theta);
        let (z, m) = self.gap.ripple(slot);
        let given = axpy(apply(&z, psi_s), m - self.x[0].inv_L, psi_s);
        let of_chord = |c: f64| {
            let (a, w) = (c + self.inv_L_l + self.x[1].inv_L, axpy(given, b + c, psi_R));
            let d = 1.0 / (a * a - z[0] * z[0] - z[1] * z[1]);
            let psi_r = [d * ((a - z[0]) * w[0] - z[1] * w[1]), d * ((a + z[0]) * w[1] - z[1] * w[0])];
            State { psi_s, psi_r, psi_x: [psi_s, psi_r], omega, theta, slot }
        };
        let above = |c: f64| self.gap.chord(&of_chord(c)) <= c;
        if above(0.0) {
            return of_chord(0.0);
        }
        let (mut lo, mut hi) = (0.0, self.inv_L_l);
        while !above(hi) && hi.is_finite() {
            (lo, hi) = (hi, 2.0 * hi);
        }
        while hi - lo > 1e-15 * hi {
            let mid = 0.5 * (lo + hi);
            if mid <= lo || mid >= hi {
                break;
            }
            (lo, hi) = if above(mid) { (lo, mid) } else { (mid, hi) };
        }
        of_chord(hi)
    }

    /// No less than the fastest rate of the fluxes around a state, 1/s.
    pub fn rate(&self, x: &State) -> f64 {
        (self.R + self.gap.R_r) * self.tangent::<FULL>(x).largest::<FULL>()
    }

    /// `∂i_s/∂psi_s`.
    #[inline]
    fn tangent<const KIND: u8>(&self, x: &State) -> Tangent {
        let psi = x.psi_s;
        let (b, q) = if KIND != LINEAR {
            let x = dot(psi, psi);
            let p = self.saturating(x);
            (self.b_0 + p, self.S * p / x.max(1e-30))
        } else {
            (self.b_0, 0.0)
        };
        Tangent { b, q, psi, gap: self.gap_of::<KIND>(x) }
    }

    /// [`Self::tangent`] where `b` of the state's field is known.
    #[inline(always)]
    pub fn tangent_from<const KIND: u8>(&self, x: &State, b: f64) -> Tangent {
        let psi = x.psi_s;
        let q = if KIND != LINEAR { self.S * (b - self.b_0) / dot(psi, psi).max(1e-30) } else { 0.0 };
        Tangent { b, q, psi, gap: self.gap_of::<KIND>(x) }
    }

    #[inline(always)]
    fn gap_of<const KIND: u8>(&self, x: &State) -> [f64; 3] {
        if KIND == FULL { self.gap.tangent(x, &self.gap.leak(x)) } else { [0.0; 3] }
    }

    /// What the short-circuited windings and the slots take from `i_s'`, whatever `psi_s'`.
    #[inline(always)]
    fn taken<const KIND: u8>(&self, x: &State, f: &Field) -> V2 {
        let y = self.inward::<KIND>(f.dpsi_r, &f.dpsi_x);
        if KIND == FULL {
            let leak = self.gap.leak(x);
            return axpy(axpy(y, 1.0, leak.apply(f.dpsi_r)), -x.omega, self.gap.turn_rate(x, &leak));
        }
        y
    }

    /// `i_s'` for a given `psi_s'`.
    #[inline]
    pub fn di<const KIND: u8>(&self, x: &State, f: &Field, dpsi_s: V2) -> V2 {
        axpy(self.tangent::<KIND>(x).apply::<KIND>(dpsi_s), -1.0, self.taken::<KIND>(x, f))
    }

    /// One leg without current: `psi_s'`, and the leg's potential for which its current stays zero.
    ///
    /// `u` is the voltage vector with that leg at potential zero. With `e` the phase axis,
    /// `u_s = u + 2/3 v e`, and `e·i_s' = 0` is one linear equation for `v`.
    #[inline]
    pub fn float<const KIND: u8>(&self, x: &State, f: &Field, k: usize, u: V2) -> (V2, f64) {
        let e = AXIS[k];
        let ds = axpy(u, -self.R, f.i);
        let lambda = -dot(e, self.di::<KIND>(x, f, ds)) / self.tangent::<KIND>(x).along::<KIND>(e);
        (axpy(ds, lambda, e), 1.5 * lambda)
    }

    /// No current at all: `psi_s'`, which then also is the terminal voltage (the induced one).
    #[inline]
    pub fn open<const KIND: u8>(&self, x: &State, f: &Field) -> V2 {
        self.tangent::<KIND>(x).solve::<KIND>(self.taken::<KIND>(x, f))
    }

    /// Moves `psi_s` by the rounding (and, saturated, `O(h^5)`) residue that separates a leg's current from zero.
    pub fn clear_leg<const KIND: u8>(&self, x: &mut State, f: &mut Field, k: usize) {
        let e = AXIS[k];
        let along = self.tangent::<KIND>(x).along::<KIND>(e);
        x.psi_s = axpy(x.psi_s, -dot(f.i, e) / along, e);
        *f = self.field::<KIND>(x);
        f.i = axpy(f.i, -dot(f.i, e), e);
    }

    /// The same for all three legs.
    pub fn clear_all<const KIND: u8>(&self, x: &mut State, f: &mut Field) {
        x.psi_s = axpy(x.psi_s, -1.0, self.tangent::<KIND>(x).solve::<KIND>(f.i));
        *f = self.field::<KIND>(x);
        f.i = [0.0; 2];
    }
}
