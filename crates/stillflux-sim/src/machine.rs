//! The electromagnetic part: Γ-form flux states in stator coordinates, with or without saturation.
//!
//! ```text
//! psi_s' = u_s - R i_s                          i_s = psi_s/L_s(|psi_s|) + (psi_s - psi_r)/L_l
//! psi_r' = (R_r/L_l) (psi_s - psi_r) + j omega psi_r          T = (3/2) n_p (psi_r x psi_s)/L_l
//! 1/L_s(|psi|) = (1 + (a |psi|)^S)/L_u
//! ```
//!
//! Further short-circuited windings, for eddy currents and deep bars, are those of [`crate::branches`].
//!
//! `R` is the winding plus `r_d` of the bridge: the current always passes one device per leg, so the
//! fold is exact. All inverse inductances are formed once; a step divides by nothing.
#![allow(non_snake_case)]

use crate::branches::{Branch, DeepBar, IronLoss};
use crate::mechanics::Shaft;
use stillflux::params::Machine;
use stillflux::space::AlphaBeta;

pub(crate) type V2 = [f64; 2];

/// What the compiler may leave out: a circuit without saturation, with it, with further branches.
pub(crate) const LINEAR: u8 = 0;
pub(crate) const SATURATING: u8 = 1;
pub(crate) const BRANCHED: u8 = 2;

#[inline(always)]
pub(crate) fn dot(a: V2, b: V2) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// `x + k y`
#[inline(always)]
pub(crate) fn axpy(x: V2, k: f64, y: V2) -> V2 {
    [x[0] + k * y[0], x[1] + k * y[1]]
}

const S3: f64 = 0.866_025_403_784_438_6;
/// Unit vectors of the three phase axes.
pub(crate) const AXIS: [V2; 3] = [[1.0, 0.0], [-0.5, S3], [-0.5, -S3]];

/// Phase quantities of a space vector.
#[inline(always)]
pub(crate) fn phases(v: V2) -> [f64; 3] {
    AlphaBeta::from(v).to_phases()
}

/// Space vector of three leg potentials; the common part drops out.
#[inline(always)]
pub(crate) fn space_vector(v: [f64; 3]) -> V2 {
    AlphaBeta::from_phases(v).into()
}

/// What is integrated: Γ-form fluxes in V·s, mechanical speed in rad/s.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct State {
    pub psi_s: V2,
    pub psi_r: V2,
    /// Flux of the further branches: iron, bar.
    pub psi_x: [V2; 2],
    pub omega: f64,
}

/// What follows from a state alone, whatever the terminal voltage.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Field {
    /// `1/L_s(|psi_s|) + 1/L_l`
    pub b: f64,
    pub i: V2,
    pub dpsi_r: V2,
    pub dpsi_x: [V2; 2],
    pub torque: f64,
}

/// The saturation term about the start of a step, a series in `|psi_s|²`: within a step the flux moves by
/// per mille, so four products replace a square root on the longest chain of dependent operations.
struct Near {
    x: f64,
    c: [f64; 5],
}

/// One integration step: the state reached, `∫ i dt` and `∫ omega dt` on the way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step {
    pub x: State,
    pub int_i: V2,
    pub dtheta: f64,
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

/// Energies in J summed since tracking was switched on, see [`crate::Plant::track_energy`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energy {
    /// Into the machine's terminals, `∫ 3/2 u·i dt`.
    pub input: f64,
    /// Stator copper loss.
    pub copper_s: f64,
    /// Rotor copper loss.
    pub copper_r: f64,
    /// Eddy current loss of the iron.
    pub iron: f64,
    /// From the air gap into the shaft, `∫ T omega dt`.
    pub shaft: f64,
    /// Out of the dc link. This and the next two only in [`crate::Mode::Switching`], 0 else.
    pub link: f64,
    /// Conduction loss of the bridge, threshold and `r_d`.
    pub conduction: f64,
    /// Charging loss: a switch that turns on charges its leg's node in no time.
    pub charging: f64,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Circuit {
    /// Stator resistance including the bridge's `r_d`.
    pub R: f64,
    pub R_s: f64,
    pub r_d: f64,
    pub L_l: f64,
    pub n_p: f64,
    inv_L_l: f64,
    /// `R_r/L_l`
    k_r: f64,
    k_T: f64,
    /// Further branches, iron and bar, and whether there are any.
    x: [Branch; 2],
    branched: bool,
    bar: Option<DeepBar>,
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
    pub fn new(m: &Machine, r_d: f64, saturation: bool, iron: Option<IronLoss>, bar: Option<DeepBar>) -> Self {
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
            L_l: g.L_l,
            n_p,
            inv_L_l: 1.0 / g.L_l,
            k_r: g.R_r / g.L_l,
            k_T: 1.5 * n_p / g.L_l,
            x: [Branch::iron(iron), Branch::default()],
            branched: iron.is_some() || bar.is_some(),
            bar,
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
        circuit
    }

    /// The least that the compiler may assume.
    pub fn kind(&self) -> u8 {
        if self.branched {
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
    fn near(&self, psi_s: V2, b: f64) -> Near {
        let (x, p, a) = (dot(psi_s, psi_s), b - self.b_0, self.binomial);
        let r = 1.0 / x;
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
        if KIND == BRANCHED {
            field.torque += self.bar_torque(x.psi_x[1], s);
            for n in 0..2 {
                let (c, p) = (&self.x[n], x.psi_x[n]);
                let w = c.turns * x.omega;
                field.i = axpy(field.i, -c.inv_L, p);
                field.dpsi_x[n] = [c.k * (s[0] - p[0]) - w * p[1], c.k * (s[1] - p[1]) + w * p[0]];
            }
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
        if KIND == BRANCHED { axpy(axpy(sum, self.x[0].inv_L, x[0]), self.x[1].inv_L, x[1]) } else { sum }
    }

    /// Stator equation `u - R i_s`, in the order with the fewest dependent operations.
    #[inline(always)]
    pub fn stator<const KIND: u8>(&self, x: &State, f: &Field, u: V2) -> V2 {
        if KIND == BRANCHED {
            return axpy(u, -self.R, f.i);
        }
        let (k_s, k_r) = (self.R * f.b, self.R * self.inv_L_l);
        [u[0] + k_r * x.psi_r[0] - k_s * x.psi_s[0], u[1] + k_r * x.psi_r[1] - k_s * x.psi_s[1]]
    }

    /// Rotor flux of the inverse-Γ circuit at this operating point, `psi_s - L_sigma i_s`.
    pub fn psi_R(&self, x: &State) -> V2 {
        let b = self.b_0 + self.saturating(dot(x.psi_s, x.psi_s));
        if self.branched {
            let y = self.inward::<BRANCHED>(x.psi_r, &x.psi_x);
            return [y[0] / b, y[1] / b];
        }
        let k = self.inv_L_l / b;
        [k * x.psi_r[0], k * x.psi_r[1]]
    }

    /// State with this rotor flux of the inverse-Γ circuit: the inverse of [`Self::psi_R`]. No eddy current flows in
    /// the iron, the branches of the rotor have one flux.
    pub fn state_of(&self, psi_s: V2, psi_R: V2, omega: f64) -> State {
        let b = self.b_0 + self.saturating(dot(psi_s, psi_s));
        let g = b * self.L_l;
        let iron = self.x[0].inv_L * self.L_l;
        let psi_r = if self.branched {
            [g * psi_R[0] - iron * psi_s[0], g * psi_R[1] - iron * psi_s[1]]
        } else {
            [g * psi_R[0], g * psi_R[1]]
        };
        State { psi_s, psi_r, psi_x: [psi_s, psi_r], omega }
    }

    /// Stored magnetic energy, J: `3/2 (∫ |psi|/L_s d|psi| + |psi_s - psi_r|²/(2 L_l))`.
    pub fn magnetic_energy(&self, x: &State) -> f64 {
        let (s2, l) = (dot(x.psi_s, x.psi_s), axpy(x.psi_s, -1.0, x.psi_r));
        let branches: f64 = (0..2)
            .map(|n| {
                let l = axpy(x.psi_s, -1.0, x.psi_x[n]);
                0.5 * self.x[n].inv_L * dot(l, l)
            })
            .sum();
        1.5 * (0.5 * self.inv_L_u * s2
            + self.saturating(s2) * s2 / (self.S + 2.0)
            + 0.5 * self.inv_L_l * dot(l, l)
            + branches)
    }

    /// Tangent `∂i_s/∂psi_s = b + q psi psi^T` as (b, q).
    #[inline]
    fn tangent<const KIND: u8>(&self, psi: V2) -> (f64, f64) {
        if KIND != LINEAR {
            let x = dot(psi, psi);
            let p = self.saturating(x);
            (self.b_0 + p, self.S * p / x.max(1e-30))
        } else {
            (self.b_0, 0.0)
        }
    }

    /// [`Self::tangent`] where `b` of the state's field is known.
    #[inline(always)]
    pub fn tangent_from<const KIND: u8>(&self, psi: V2, b: f64) -> (f64, f64) {
        if KIND != LINEAR { (b, self.S * (b - self.b_0) / dot(psi, psi).max(1e-30)) } else { (b, 0.0) }
    }

    /// `i_s'` for a given `psi_s'`.
    #[inline]
    pub fn di<const KIND: u8>(&self, x: &State, f: &Field, dpsi_s: V2) -> V2 {
        let (b, q) = self.tangent::<KIND>(x.psi_s);
        let k = q * dot(x.psi_s, dpsi_s);
        let y = self.inward::<KIND>(f.dpsi_r, &f.dpsi_x);
        [b * dpsi_s[0] + k * x.psi_s[0] - y[0], b * dpsi_s[1] + k * x.psi_s[1] - y[1]]
    }

    /// One leg without current: `psi_s'`, and the leg's potential for which its current stays zero.
    ///
    /// `u` is the voltage vector with that leg at potential zero. With `e` the phase axis,
    /// `u_s = u + 2/3 v e`, and `e·i_s' = 0` is one linear equation for `v`.
    #[inline]
    pub fn float<const KIND: u8>(&self, x: &State, f: &Field, k: usize, u: V2) -> (V2, f64) {
        let e = AXIS[k];
        let ds = axpy(u, -self.R, f.i);
        let (b, q) = self.tangent::<KIND>(x.psi_s);
        let pe = dot(x.psi_s, e);
        let lambda = -dot(e, self.di::<KIND>(x, f, ds)) / (b + q * pe * pe);
        (axpy(ds, lambda, e), 1.5 * lambda)
    }

    /// No current at all: `psi_s'`, which then also is the terminal voltage (the induced one).
    /// `(b + q psi psi^T) psi_s' = psi_r'/L_l` by Sherman-Morrison.
    #[inline]
    pub fn open<const KIND: u8>(&self, x: &State, f: &Field) -> V2 {
        self.solve_tangent::<KIND>(x.psi_s, self.inward::<KIND>(f.dpsi_r, &f.dpsi_x))
    }

    fn solve_tangent<const KIND: u8>(&self, psi: V2, w: V2) -> V2 {
        let (b, q) = self.tangent::<KIND>(psi);
        let k = -q * dot(psi, w) / (b + q * dot(psi, psi));
        let v = axpy(w, k, psi);
        [v[0] / b, v[1] / b]
    }

    /// Moves `psi_s` by the rounding (and, saturated, `O(h^5)`) residue that separates a leg's current from zero.
    pub fn clear_leg<const KIND: u8>(&self, x: &mut State, f: &mut Field, k: usize) {
        let (e, (b, q)) = (AXIS[k], self.tangent::<KIND>(x.psi_s));
        let (pe, ie) = (dot(x.psi_s, e), dot(f.i, e));
        x.psi_s = axpy(x.psi_s, -ie / (b + q * pe * pe), e);
        *f = self.field::<KIND>(x);
        f.i = axpy(f.i, -dot(f.i, e), e);
    }

    /// The same for all three legs.
    pub fn clear_all<const KIND: u8>(&self, x: &mut State, f: &mut Field) {
        x.psi_s = axpy(x.psi_s, -1.0, self.solve_tangent::<KIND>(x.psi_s, f.i));
        *f = self.field::<KIND>(x);
        f.i = [0.0; 2];
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
            if KIND == BRANCHED { [axpy(p[0], k, d[0]), axpy(p[1], k, d[1])] } else { p }
        };
        let at = |k: f64, s: V2, f: &Field, a: f64| State {
            psi_s: axpy(x.psi_s, k, s),
            psi_r: axpy(x.psi_r, k, f.dpsi_r),
            psi_x: branches(x.psi_x, k, &f.dpsi_x),
            omega: x.omega + k * a,
        };
        let near = if KIND != LINEAR { self.near(x.psi_s, f1.b) } else { Near { x: 0.0, c: [0.0; 5] } };
        let field = |x: &State| {
            let b =
                if KIND != LINEAR { self.b_0 + self.saturating_near(&near, dot(x.psi_s, x.psi_s)) } else { self.b_0 };
            self.field_at::<KIND>(x, b)
        };
        let (s1, a1) = (dpsi_s(x, f1), shaft.accel(f1.torque, x.omega));
        let x2 = at(0.5 * h, s1, f1, a1);
        let f2 = field(&x2);
        let (s2, a2) = (dpsi_s(&x2, &f2), shaft.accel(f2.torque, x2.omega));
        let x3 = at(0.5 * h, s2, &f2, a2);
        let f3 = field(&x3);
        let (s3, a3) = (dpsi_s(&x3, &f3), shaft.accel(f3.torque, x3.omega));
        let x4 = at(h, s3, &f3, a3);
        let f4 = field(&x4);
        let (s4, a4) = (dpsi_s(&x4, &f4), shaft.accel(f4.torque, x4.omega));
        let k = h * (1.0 / 6.0);
        let mean = |a: V2, b: V2, c: V2, d: V2| [a[0] + 2.0 * (b[0] + c[0]) + d[0], a[1] + 2.0 * (b[1] + c[1]) + d[1]];
        let i = mean(f1.i, f2.i, f3.i, f4.i);
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
            },
            int_i: [k * i[0], k * i[1]],
            dtheta: h * (x.omega + k * (a1 + a2 + a3)),
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
        let (b, q) = self.tangent_from::<KIND>(x.psi_s, f.b);
        let tangent = |v: V2| {
            if KIND != LINEAR { axpy([b * v[0], b * v[1]], q * dot(x.psi_s, v), x.psi_s) } else { [b * v[0], b * v[1]] }
        };
        let k = |v: V2| if NODES { [K[0] * v[0] + K[1] * v[1], K[1] * v[0] + K[2] * v[1]] } else { [0.0; 2] };
        let w = self.n_p * x.omega;
        let s1 = axpy(u, -self.R, f.i);
        let i1 = axpy(tangent(s1), -1.0, self.inward::<KIND>(f.dpsi_r, &f.dpsi_x));
        let a = shaft.accel(f.torque, x.omega);
        let s2 = axpy([-k(f.i)[0], -k(f.i)[1]], -self.R, i1);
        let r = f.dpsi_r;
        let turn = self.n_p * a;
        let r2 = [
            self.k_r * (s1[0] - r[0]) - w * r[1] - turn * x.psi_r[1],
            self.k_r * (s1[1] - r[1]) + w * r[0] + turn * x.psi_r[0],
        ];
        let r3 = [self.k_r * (s2[0] - r2[0]) - w * r2[1], self.k_r * (s2[1] - r2[1]) + w * r2[0]];
        let mut branches = [[[0.0; 2]; 3]; 2];
        if KIND == BRANCHED {
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
            let radial = q * (dot(s1, s1) + (self.S - 2.0) * g * g / dot(x.psi_s, x.psi_s).max(1e-30));
            i2 = axpy(axpy(i2, 2.0 * q * g, s1), radial, x.psi_s);
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
        if KIND == BRANCHED {
            psi_x = [flux(psi_x[0], &s.x[0]), flux(psi_x[1], &s.x[1])];
            torque += self.bar_torque(psi_x[1], psi_s);
        }
        let a = shaft.accel(torque, x.omega + h * s.a);
        let dw = 0.5 * h * (s.a + a);
        Step { x: State { psi_s, psi_r, psi_x, omega: x.omega + dw }, int_i: q, dtheta: h * (x.omega + 0.5 * dw) }
    }

    /// The powers of [`Energy`] in W that follow from state and voltage; `conduction` without the thresholds.
    pub fn power(&self, x: &State, f: &Field, dpsi_s: V2) -> Energy {
        let l = axpy(x.psi_s, -1.0, x.psi_r);
        let loss = |n: usize| {
            let l = axpy(x.psi_s, -1.0, x.psi_x[n]);
            1.5 * self.x[n].k * self.x[n].inv_L * dot(l, l)
        };
        Energy {
            input: 1.5 * dot(axpy(dpsi_s, self.R_s, f.i), f.i),
            copper_s: 1.5 * self.R_s * dot(f.i, f.i),
            copper_r: 1.5 * self.k_r * self.inv_L_l * dot(l, l) + loss(1),
            iron: loss(0),
            shaft: f.torque * x.omega,
            conduction: 1.5 * self.r_d * dot(f.i, f.i),
            ..Energy::default()
        }
    }
}

impl Energy {
    pub(crate) fn add(&mut self, k: f64, p: &Energy) {
        self.input += k * p.input;
        self.copper_s += k * p.copper_s;
        self.copper_r += k * p.copper_r;
        self.iron += k * p.iron;
        self.shaft += k * p.shaft;
        self.conduction += k * p.conduction;
    }
}
