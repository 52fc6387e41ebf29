//! Model of the filter: states, transition, innovation, and their derivatives.
//!
//! Over one block of length `Δ` (normalised time), with the measured current `i_m`, the voltage `u_s` that the
//! inverter model believes was applied and its correction `u_l` (see [`super::Input`]), and `i = i_m - b`:
//!
//! ```text
//! f:   ψ_s⁺ = ψ_s + Δ (u_s - v u_l - r_s i)                         stator voltage equation
//!      m⁺   = m + r_R Δ (i·n - i_μ(m)),    i_μ(m) = γ m g(m)/l_M    rotor equation along n
//!      b, r_s, v, γ, c                                              random walks
//! h:   |ψ_R| - m = 0,    ψ_R = ψ_s - σl_s i,    n = ψ_R/|ψ_R|
//! ```
//!
//! `g(m) = 1 - c + c (m/m_N)^S` is the magnetising curve: `c` is the saturated part of the magnetising current at
//! the rated rotor flux `m_N`, `S` the exponent of the machine's curve. With `t = jn` and the current components
//! `i_d = i·n`, `i_q = i·t` the derivatives are
//!
//! ```text
//! F:   ∂ψ_s⁺/∂b = Δ r_s I,   ∂ψ_s⁺/∂r_s = -Δ i,   ∂ψ_s⁺/∂v = -Δ u_l
//!      ∂m⁺/∂ψ_s = r_R Δ (i_q/|ψ_R|) tᵀ                              the flux turns, i·n changes
//!      ∂m⁺/∂b   = -r_R Δ nᵀ
//!      ∂m⁺/∂m   = 1 - (r_R Δ/l_M) γ d(m g)/dm,   d(m g)/dm = g + S c (m/m_N)^S
//!      ∂m⁺/∂γ   = -(r_R Δ/l_M) m g,   ∂m⁺/∂c = -(r_R Δ/l_M) γ m ((m/m_N)^S - 1)
//! H:   ∂h/∂ψ_s  = nᵀ,   ∂h/∂m = -1
//! ```
//!
//! The covariance is that of *scaled* states, each in units of a typical deviation ([`Model::scale`]), so that it
//! fits fixed point; the rows below are scaled accordingly.

use super::covariance::{Column, N};
use crate::base::{Base, PerUnit, rounded};
use crate::params::{Inverter, Machine};
use crate::scalar::Real;
use crate::space::{AlphaBeta, Rotator};
use crate::words::words;

/// Stator flux `ψ̂_s`, two components.
pub(super) const PSI: usize = 0;
/// Magnitude `m` of the rotor flux by the current model.
pub(super) const M: usize = 2;
/// Offset `b` of the current sensors, two components.
pub(super) const B: usize = 3;
/// Stator resistance `r_s`.
pub(super) const RS: usize = 5;
/// Relative error `v` of the inverter model's voltage.
pub(super) const V: usize = 6;
/// Reciprocal of the magnetising inductance, relative to its prior: `γ`.
pub(super) const GAMMA: usize = 7;
/// Saturated part `c` of the magnetising current.
pub(super) const C: usize = 8;

/// Scales of the states, per unit; that of `r_s` is relative to `r_s`.
pub(super) const SCALE_PSI: f64 = 0.05;
pub(super) const SCALE_B: f64 = 0.01;
pub(super) const SCALE_R: f64 = 0.05;
pub(super) const SCALE_V: f64 = 0.1;
pub(super) const SCALE_GAMMA: f64 = 0.05;
pub(super) const SCALE_C: f64 = 0.1;

/// A value for each state.
#[inline(always)]
pub(super) fn by_state<T: Copy>(psi: T, m: T, b: T, r_s: T, v: T, gamma: T, c: T) -> [T; N] {
    let mut x = [psi; N];
    (x[M], x[B], x[B + 1], x[RS], x[V], x[GAMMA], x[C]) = (m, b, b, r_s, v, gamma, c);
    x
}

/// Parameters of the model, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct Model<R: Real> {
    /// Leakage inductance.
    pub sigma_l_s: R,
    /// Stator resistance of the data sheet, with `r_d`: scale of its state.
    pub r_s: R,
    /// Magnetising inductance at rated flux.
    pub l_m: R,
    /// Length `Δ` of a block, `r_R Δ` and `r_R Δ/l_M = Δ/τ_r`.
    pub delta: R,
    pub r_r_block: R,
    pub decay: R,
    /// Reciprocal of the rated rotor flux.
    pub inv_m_rated: R,
}
words!(Model: sigma_l_s, r_s, l_m, delta, r_r_block, decay, inv_m_rated);

/// The magnetising curve at one flux.
#[derive(Clone, Copy, Debug)]
pub(super) struct Curve<R: Real> {
    /// `m g(m)`: magnetising current times `l_M/γ`.
    pub m_g: R,
    /// Its slope `d(m g)/dm`.
    pub slope: R,
    /// Its derivative by `c` over `m`, `(m/m_N)^S - 1`.
    pub bend: R,
}

/// Where a block is linearised: averages and model values of the block before.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct OperatingPoint<R: Real> {
    /// Direction of the rotor flux.
    pub n: Rotator<R>,
    /// `1/|ψ_R|`.
    pub inv_psi_r: R,
    /// Current reference, stator coordinates. The reference, not the measurement: a noisy regressor would pass
    /// for excitation.
    pub i_s: AlphaBeta<R>,
    /// Voltage of the inverter model.
    pub u_l: AlphaBeta<R>,
    /// `r_R Δ i_q/|ψ_R|`: change of `m` in a block per turn of the flux.
    pub turn: R,
    /// `m`, `m g(m)`, and `γ d(m g)/dm`.
    pub m: R,
    pub m_g: R,
    pub slope: R,
    /// `(m/m_N)^S - 1`.
    pub bend: R,
    /// Distance from the steady state, `l_M (i·n - i_μ)`, times [`super::noise::TRANSIENT`], scaled as a flux.
    pub transient: R,
    pub omega_s: R,
    /// The rotor flux is large enough for its direction to mean something.
    pub valid: bool,
}

impl<R: Real> Model<R> {
    /// Of validated parameters, for blocks of `seconds` at a flux reference `psi_ref`.
    pub fn new(machine: &Machine, inverter: &Inverter, pu: &PerUnit<R>, psi_ref: f64, seconds: f64) -> Self {
        let r = rounded::<R>;
        let b = Base::new(machine);
        let delta = b.omega * seconds;
        let r_r = machine.R_R / b.z;
        let l_m = machine.L_M / b.l;
        Self {
            sigma_l_s: pu.sigma_l_s,
            r_s: r((machine.R_s + inverter.r_d) / b.z),
            l_m: r(l_m),
            delta: r(delta),
            r_r_block: r(r_r * delta),
            decay: r(r_r / l_m * delta),
            inv_m_rated: r(machine.L_s() / (machine.L_M * psi_ref)),
        }
    }

    /// Sizes of the scaled states.
    #[inline(always)]
    pub fn scale(&self) -> Column<R> {
        let r = R::from_f64;
        let r_s = self.r_s * r(SCALE_R);
        by_state(r(SCALE_PSI), r(SCALE_PSI), r(SCALE_B), r_s, r(SCALE_V), r(SCALE_GAMMA), r(SCALE_C))
    }

    /// The magnetising curve at flux `m` and saturation `c`.
    #[inline(always)]
    pub fn curve(&self, m: R, c: R) -> Curve<R> {
        let x = (m * self.inv_m_rated).min(R::from_f64(1.3));
        let x2 = x * x;
        let x8 = x2 * x2 * (x2 * x2);
        let g = R::ONE - c + c * x8;
        Curve { m_g: m * g, slope: g + R::from_f64(8.0) * (c * x8), bend: x8 - R::ONE }
    }

    /// What `m` gains in a block at the field current `i_d = i·n` and `m_steady = γ m g(m)`.
    #[inline(always)]
    pub fn rotor_increment(&self, i_d: R, m_steady: R) -> R {
        self.r_r_block * i_d - self.decay * m_steady
    }

    /// Row of `m` in `F`: coefficient of `m` itself.
    #[inline(always)]
    pub fn rotor_own(&self, at: &OperatingPoint<R>) -> R {
        R::ONE - self.decay * at.slope
    }

    /// Row of `m` in `F`: the other states.
    #[inline(always)]
    pub fn rotor_row(&self, at: &OperatingPoint<R>, gamma: R) -> [(usize, R); 6] {
        let r = R::from_f64;
        let by_b = self.r_r_block * r(SCALE_B / SCALE_PSI);
        let by_gamma = self.decay * r(SCALE_GAMMA / SCALE_PSI);
        let by_c = self.decay * r(SCALE_C / SCALE_PSI);
        [
            (PSI, -at.turn * at.n.sin),
            (PSI + 1, at.turn * at.n.cos),
            (B, -by_b * at.n.cos),
            (B + 1, -by_b * at.n.sin),
            (GAMMA, -by_gamma * at.m_g),
            (C, -by_c * (gamma * at.m * at.bend)),
        ]
    }

    /// Row of one component of `ψ_s` in `F`, given that component of `i` and `u_l`: coefficients of the same
    /// component of `b`, of `r_s` and of `v`; that of the component itself is one.
    #[inline(always)]
    pub fn flux_row(&self, i: R, u_l: R, r_s: R) -> [R; 3] {
        let r = R::from_f64;
        let by_b = self.delta * r(SCALE_B / SCALE_PSI);
        let by_r_s = self.delta * self.r_s * r(SCALE_R / SCALE_PSI);
        let by_v = self.delta * r(SCALE_V / SCALE_PSI);
        [by_b * r_s, -by_r_s * i, -by_v * u_l]
    }

    /// `H`, the row of the measurement `h = |ψ_R| - m`.
    #[inline(always)]
    pub fn measurement_row(at: &OperatingPoint<R>) -> [(usize, R); 3] {
        [(PSI, at.n.cos), (PSI + 1, at.n.sin), (M, -R::ONE)]
    }

    /// Innovation `0 - h`, scaled as a flux.
    #[inline(always)]
    pub fn innovation(m: R, psi_r: R) -> R {
        (m - psi_r) * R::from_f64(1.0 / SCALE_PSI)
    }
}
