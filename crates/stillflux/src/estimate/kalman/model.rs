//! Model of the filter: states, transition, innovation, and their derivatives.
//!
//! Per unit. Over one block of length `Δ` (normalised time), with the measured current `i_m`, `i = i_m - b`, the
//! applied voltage `u_s` by the inverter model at the present estimates `v̂`, `k̂`, its loss `u_l` (contained in `u_s`)
//! and `u_k = ∂u_l/∂ln k` for the knee `k` of its curve ([`crate::inverter`]):
//!
//! ```text
//! f:   ψ_s⁺ = ψ_s + Δ (u_s - ε_v u_l - ε_k u_k - r_s i)             stator voltage equation
//!      m⁺   = m + r_R Δ (i·n - i_μ(m)),    i_μ(m) = γ m g(m)/l_M    rotor equation along n
//!      b, r_s, ε_v = ln ((1 + v)/(1 + v̂)), ε_k = ln (k/k̂), ε_l = ln (l/l̂), γ, c     random walks
//! h:   |ψ_R| - m = 0,    ψ_R = ψ_s - l i,    n = ψ_R/|ψ_R|
//! ```
//!
//! `g(m) = 1 - c + c (m/m_N)^S` is the magnetising curve: `c` is the saturated part of the magnetising current at
//! the rated rotor flux `m_N`, `S` the exponent of the machine's curve. It is followed up to `(m/m_N)^S = 8`; `g` is
//! constant beyond. `l` is the leakage inductance `σl_s`, `Δi` the change of the current over the block. With `t = jn` and the current components `i_d = i·n`, `i_q = i·t` the derivatives are
//!
//! ```text
//! F:   ∂χ⁺/∂b = Δ r_s I,   ∂χ⁺/∂r_s = -Δ i,   ∂χ⁺/∂ε_v = -Δ u_l,   ∂χ⁺/∂ε_k = -Δ u_k,   ∂χ⁺/∂ε_l = -l̂ Δi
//!      ∂m⁺/∂χ = r_R Δ (i_q/|ψ_R|) tᵀ                                rotation of n in i·n
//!      ∂m⁺/∂b = -r_R Δ nᵀ
//!      ∂m⁺/∂m = 1 - (r_R Δ/l_M) γ d(m g)/dm,   d(m g)/dm = g + S c (m/m_N)^S
//!      ∂m⁺/∂γ = -(r_R Δ/l_M) m g,   ∂m⁺/∂c = -(r_R Δ/l_M) γ m ((m/m_N)^S - 1)
//! H:   ∂h/∂χ  = nᵀ,   ∂h/∂m = -1
//! ```
//!
//! `|i_q|/|ψ_R|` is limited to 2 there. `i` in `∂χ⁺/∂r_s` and `Δi` are those of the current *reference*: noise of a
//! measured regressor would act as excitation. `1 + v̂`, `k̂` and `l̂` are factors, and `ε_v`, `ε_k` and `ε_l` errors about
//! the present estimates: a correction `δε` multiplies `1 + v̂`, `k̂` or `l̂` by `1 + δε`, after which `ε` is zero again. Above
//! a stator frequency the derivatives by `r_s`, `ε_v` and `ε_k` are zero (consider states, [`super::schedule`]).
//!
//! The covariance is not that of `ψ_s` but of `χ = ψ_R + l̂ i_m`, the stator flux computed from `ψ_R` with the measured
//! current and the present estimate of the leakage. `ψ_R = ψ_s - l (i_m - b)` depends on offset and leakage, `ψ_R = χ -
//! l̂ i_m` on neither: with `χ` as state they are neither in `H` nor in `∂m⁺/∂χ`. From `ψ_s = χ + (l - l̂) i_m - l b`
//! follows `dχ = dψ_s - ε_l l̂ di_m`: an error of the leakage becomes visible where the current changes, with the load or
//! with the rotation of the field. A correction is converted by `δψ_s = δχ + l̂ i δε_l - l̂ δb` ([`super::Filter`]).
//!
//! The covariance is that of *scaled* states, each in units of a typical deviation (the scales below), so that it
//! fits fixed point; the rows below are scaled accordingly.

use super::covariance::N;

use crate::base::{PerUnit, rounded};
use crate::inverter::Distortion;
use crate::params::Machine;
use crate::scalar::Real;
use crate::space::{AlphaBeta, Rotator};
use crate::words::words;

/// `χ = ψ_R + l̂ i_m`, two components.
pub(super) const PSI: usize = 0;
/// Magnitude `m` of the rotor flux by the current model.
pub(super) const M: usize = 2;
/// Offset `b` of the current sensors, two components.
pub(super) const B: usize = 3;
/// Stator resistance `r_s`.
pub(super) const RS: usize = 5;
/// Relative error of the inverter model's voltage: `ε_v`.
pub(super) const V: usize = 6;
/// Knee of the inverter model: `ε_k`.
pub(super) const KNEE: usize = 7;
/// Leakage inductance `σl_s`: `ε_l`.
pub(super) const LEAKAGE: usize = 8;
/// In its place at a start, rotor resistance: `ε_r` ([`super::direct`]).
pub(super) const ROTOR: usize = LEAKAGE;
/// Reciprocal of the magnetising inductance, relative to the parameter: `γ`.
pub(super) const GAMMA: usize = 9;
/// Saturated part `c` of the magnetising current.
pub(super) const C: usize = 10;

/// Largest saturated part of the magnetising current.
pub(super) const C_MAX: f64 = 0.5;

/// Standard deviation of the innovation due to the magnetising curve, relative to the distance of `m` from its steady
/// state. Allowance.
pub(super) const TRANSIENT: f64 = 0.1;

/// Scales of the states: fluxes and offset per unit; `r_s` relative to its parameter; the others as they are.
pub(super) const SCALE_PSI: f64 = 0.05;
pub(super) const SCALE_B: f64 = 0.01;
pub(super) const SCALE_R: f64 = 0.05;
pub(super) const SCALE_V: f64 = 0.1;
pub(super) const SCALE_K: f64 = 0.2;
pub(super) const SCALE_LEAKAGE: f64 = 0.1;
pub(super) const SCALE_ROTOR: f64 = 0.1;
pub(super) const SCALE_GAMMA: f64 = 0.05;
pub(super) const SCALE_C: f64 = 0.1;

/// Stator frequency, per unit, above which resistance, inverter error and knee are consider states: their voltage is
/// smaller than the error of the voltage itself. So is the leakage, which would take their errors for its own: at 4 kW,
/// 0.6 pu and rated torque with `r̂_s` 6 % too high it went to its limit within 40 s and turned the rotor flux by 9.5°.
pub(super) const OMEGA_HELD: f64 = 0.2;

/// The same where the resistance is a thermometer ([`crate::estimate::temperature`]). The winding warms while it is held,
/// and a motor that runs at 0.2 pu of speed under load has a stator frequency of 0.21 to 0.27. The four are corrected
/// together: the resistance alone took for its own what the start had left of the others' errors, 7 % of its value at 48 V
/// under one of five realisations of the noise. An error of the voltage that is proportional to it, `δu`, is one of `δr_s/r_s = δu ω_s ψ/(2 i_q r_s)`: with `r_s` = 0.1 and half a per
/// cent of the dc link 1 % at 0.35.
const OMEGA_HELD_WARM: f64 = 0.35;

/// A value for each state; both components of a vector have the same.
#[inline(always)]
pub(super) fn by_state<T: Copy>([psi, m, b, r_s, v, knee, leakage, gamma, c]: [T; 9]) -> [T; N] {
    let mut x = [psi; N];
    (x[M], x[B], x[B + 1], x[RS], x[V], x[KNEE], x[LEAKAGE], x[GAMMA], x[C]) =
        (m, b, b, r_s, v, knee, leakage, gamma, c);
    x
}

/// Parameters of the model, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct Model<R: Real> {
    /// Leakage inductance of the parameters.
    pub sigma_l_s: R,
    /// Stator resistance of the parameters, with `r_d`: scale of its state.
    pub r_s: R,
    /// Magnetising inductance at rated flux.
    pub l_m: R,
    /// Length `Δ` of a block (normalised time), `r_R Δ` and `r_R Δ/l_M = Δ/τ_r`.
    pub delta: R,
    pub r_r_block: R,
    pub decay: R,
    /// Reciprocal of the rated rotor flux.
    pub inv_m_rated: R,
    /// `2λ/(1 + 2λ)` with `λ = L_σ/L_M`, 0 without a saturation curve: [`Model::rotor_saturation`].
    by_saturation: R,
    /// Exponent `S` of the magnetising curve, and the largest `m/m_N` for which it is followed.
    exponent: u32,
    x_max: R,
    /// Stator frequency above which resistance, inverter error, knee and leakage are held ([`super::schedule`]).
    pub omega_held: R,
}
words!(Model: sigma_l_s, r_s, l_m, delta, r_r_block, decay, inv_m_rated, by_saturation, exponent, x_max, omega_held);

/// The magnetising curve `i_μ = (m/L_M) (1 - c + c (m/m_N)^S)` of a machine.
#[derive(Clone, Copy, Debug)]
pub(super) struct Saturated {
    /// Saturated part of the magnetising current at rated flux.
    pub c: f64,
    /// Exponent, a whole number.
    pub exponent: f64,
    /// Whether both follow from the machine's saturation curve.
    pub known: bool,
}

impl Saturated {
    /// For machines without a saturation curve among their parameters. Allowance.
    const TYPICAL: Self = Self { c: 0.15, exponent: 8.0, known: false };

    /// From the curve of the Γ form, `i = ψ_s (1 + k (ψ_s/ψ_N)^S)/L_u`, with `1 + k = L_u/L_s` at rated flux.
    ///
    /// The filter's curve is one over the *rotor* flux `m = ψ_s - L_σ i`. It has the same inductance without
    /// saturation, `L_u - L_σ`, which gives `c`, and the same elasticity `E = (di/dm)(m/i)` at rated flux, which is
    /// `1 + S c`. Since `m` grows more slowly than `ψ_s`, its exponent is larger than that of the Γ form. Where a large leakage and a
    /// steep curve leave hardly any growth, or none, it is the largest.
    pub fn of(machine: &Machine) -> Self {
        let Some(s) = &machine.saturation else { return Self::TYPICAL };
        let k = s.L_u / machine.L_s() - 1.0;
        let unsaturated = s.L_u - machine.L_sigma;
        let di = (1.0 + (s.S + 1.0) * k) / s.L_u;
        let dm = 1.0 - machine.L_sigma * di;
        let c = 1.0 - machine.L_M / unsaturated;
        // No saturation: the typical exponent, and `c` within its limits.
        if !(k > 0.0 && c > 0.01) {
            return Self { c: c.clamp(0.0, C_MAX), ..Self::TYPICAL };
        }
        let exponent = libm::round((di / dm.max(LEAST_RISE) * machine.L_M - 1.0) / c);
        Self { c: c.min(C_MAX), exponent: exponent.clamp(1.0, 20.0), known: true }
    }
}

/// `1/x` where it seldom runs: one copy in the code for all.
#[cold]
#[inline(never)]
pub(super) fn reciprocal<R: Real>(x: R) -> R {
    x.recip()
}

/// Least growth of `m` with `ψ_s` at rated flux from which an exponent follows.
const LEAST_RISE: f64 = 0.1;
/// Largest `(m/m_N)^S` that the curve follows: keeps it within fixed point.
const SATURATED_MAX: f64 = 8.0;

/// Magnetising curve at the operating point, with `γ`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct Magnetisation<R: Real> {
    /// `m g(m)`, and `γ d(m g)/dm`.
    pub m_g: R,
    pub slope: R,
    /// `m ((m/m_N)^S - 1)`.
    pub bend: R,
}

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

/// Mean currents of a block, and its values at the end, per unit.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockMeans<R: Real> {
    /// Direction of the rotor flux and `1/|ψ_R|`.
    pub n: Rotator<R>,
    pub inv_psi_r: R,
    /// Mean current in coordinates of the rotor flux.
    pub i_d: R,
    pub i_q: R,
    /// Current reference, stator coordinates, and its change over the block times `l̂`.
    pub i_s: AlphaBeta<R>,
    pub d_leakage_flux: AlphaBeta<R>,
    /// Voltage of the inverter model.
    pub loss: Distortion<R>,
    /// Stator frequency.
    pub omega_s: R,
    /// The load is steady ([`super::load`]).
    pub steady: bool,
}

/// Operating point about which the next block is linearised, per unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct OperatingPoint<R: Real> {
    /// Direction of the rotor flux.
    pub n: Rotator<R>,
    /// `1/|ψ_R|`.
    pub inv_psi_r: R,
    /// Current reference, stator coordinates: noise of a measured current as regressor would act as excitation.
    pub i_s: AlphaBeta<R>,
    /// Its change over the block, times `l̂`.
    pub d_leakage_flux: AlphaBeta<R>,
    /// Voltage of the inverter model.
    pub loss: Distortion<R>,
    /// `r_R Δ i_q/|ψ_R|`: `∂m⁺/∂χ` along `t`.
    pub turn: R,
    pub magnetisation: Magnetisation<R>,
    /// Distance from the steady state, `l_M (i·n - i_μ)`, times [`TRANSIENT`], scaled as a flux.
    pub transient: R,
    pub omega_s: R,
    /// The load is steady ([`super::load`]).
    pub steady: bool,
}

impl<R: Real> Model<R> {
    /// From validated parameters, for blocks of `seconds` at a flux reference `psi_ref`.
    pub fn new(machine: &Machine, pu: &PerUnit, psi_ref: f64, seconds: f64) -> Self {
        let r = rounded::<R>;
        let delta = pu.base.omega * seconds;
        let Saturated { exponent, known, .. } = Saturated::of(machine);
        let leakage = if known { 2.0 * pu.sigma_l_s / pu.l_m } else { 0.0 };
        Self {
            sigma_l_s: r(pu.sigma_l_s),
            r_s: r(pu.r_s),
            l_m: r(pu.l_m),
            delta: r(delta),
            r_r_block: r(pu.r_r * delta),
            decay: r(pu.r_r / pu.l_m * delta),
            inv_m_rated: r(pu.l_s / (pu.l_m * psi_ref)),
            by_saturation: r(leakage / (1.0 + leakage)),
            exponent: exponent as u32,
            x_max: r(libm::pow(SATURATED_MAX, 1.0 / exponent)),
            omega_held: r(OMEGA_HELD),
        }
    }

    /// The same where the stator resistance is a thermometer.
    pub fn with_thermometer(self) -> Self {
        Self { omega_held: rounded(OMEGA_HELD_WARM), ..self }
    }

    /// The magnetising curve at flux `m` and saturation `c`.
    #[inline(always)]
    pub fn curve(&self, m: R, c: R) -> Curve<R> {
        let mut square = (m * self.inv_m_rated).min(self.x_max);
        let (mut power, mut left) = (R::ONE, self.exponent);
        while left != 0 {
            if left & 1 != 0 {
                power *= square;
            }
            square *= square;
            left >>= 1;
        }
        let g = R::ONE - c + c * power;
        Curve { m_g: m * g, slope: g + self.exponent() * (c * power), bend: power - R::ONE }
    }

    /// `S` as a factor.
    fn exponent(&self) -> R {
        R::from_f64(64.0).periods(self.exponent)
    }

    /// `r_R` of the inverse-Γ circuit at a flux over that at rated flux. The cage's resistance `R_Γ` and leakage `L_l` do not
    /// saturate; what follows from them with the inductance `L_s` of the stator does,
    ///
    /// ```text
    /// R_R = R_Γ/(1 + L_l/L_s)²  ⇒  R_R/R_R,N ≈ 1 + 2λ/(1 + 2λ) (1 - g),    λ = L_σ/L_M,  g = L_M,N/L_M
    /// ```
    ///
    /// 3.6 % at 2.2 kW and 0.85 of rated flux. Of a machine half of whose leakage is in its stator it is half of that.
    #[inline(always)]
    pub fn rotor_saturation(&self, at: &OperatingPoint<R>, m: R) -> R {
        R::ONE + self.by_saturation * ((m - at.magnetisation.m_g) * at.inv_psi_r).limit(R::HALF)
    }

    /// `r_R` in `dm/dτ = r_R (i - i_μ(m))` along a direct current, relative to that of the parameters, at the slope of the curve,
    /// `s = γ d(m g)/dm`. In the circuit of [`Model::rotor_saturation`] `dψ_r/dτ = R_Γ (i - i_m(ψ_s))` with `ψ_r = ψ_s - L_l (i -
    /// i_m(ψ_s))`, and `ψ_s = m + L_σ i`, where `i_μ(m)` is the steady state `i_m(m + L_σ i_μ)`:
    ///
    /// ```text
    /// i - i_m = (i - i_μ)/(1 + L_σ s/L_M),    dψ_s/dψ_r = 1/(1 + L_l di_m/dψ_s)
    /// ⇒  dm/dτ = R_Γ/(1 + (L_σ + L_l) s/L_M) (i - i_μ)
    /// ⇒  R_R/R_R,N = (1 + κ)/(1 + κ s),    κ = (L_σ + L_l)/L_M ≈ 2λ
    /// ```
    ///
    /// At 2.2 kW 0.8 at rated flux, where the inductance for a change is less than half of `L_M`, and 1.04 at half of it.
    #[cold]
    #[inline(never)]
    pub fn transient_saturation(&self, slope: R) -> R {
        reciprocal(R::ONE + self.by_saturation * (slope - R::ONE))
    }

    /// Slope of the magnetising curve at rated flux, `1 + S c`.
    pub fn rated_slope(&self, c: R) -> R {
        R::ONE + self.exponent() * c
    }

    /// The same with `γ`, as the derivatives need it.
    #[inline(always)]
    pub fn magnetisation(&self, m: R, gamma: R, c: R) -> Magnetisation<R> {
        let curve = self.curve(m, c);
        Magnetisation { m_g: curve.m_g, slope: gamma * curve.slope, bend: m * curve.bend }
    }

    /// The next operating point, and the increment of `m` in this block, `r_R Δ (i·n - i_μ(m))`; `rotor`: rotor resistance,
    /// relative to that of the parameters.
    #[inline(always)]
    pub fn operating_point(
        &self,
        x: &BlockMeans<R>,
        magnetisation: Magnetisation<R>,
        gamma: R,
        rotor: R,
    ) -> (OperatingPoint<R>, R) {
        let m_steady = gamma * magnetisation.m_g;
        let point = OperatingPoint {
            n: x.n,
            inv_psi_r: x.inv_psi_r,
            i_s: x.i_s,
            d_leakage_flux: x.d_leakage_flux,
            loss: x.loss,
            turn: rotor * self.r_r_block * (x.i_q * x.inv_psi_r).limit(R::TWO),
            magnetisation,
            transient: (x.i_d * self.l_m - m_steady) * R::from_f64(TRANSIENT / SCALE_PSI),
            omega_s: x.omega_s,
            steady: x.steady,
        };
        (point, rotor * (self.r_r_block * x.i_d - self.decay * m_steady))
    }

    /// Torque current over magnetising current, for a torque current and `1/|ψ_R|`.
    #[inline(always)]
    pub fn load(&self, i_q: R, inv_psi_r: R) -> R {
        i_q * inv_psi_r * self.l_m
    }

    /// Row of `m` in `F`: coefficient of `m` itself.
    #[inline(always)]
    pub fn rotor_own(&self, at: &OperatingPoint<R>, rotor: R) -> R {
        R::ONE - rotor * self.decay * at.magnetisation.slope
    }

    /// Row of `m` in `F`: the other states, without the rotor resistance ([`Model::by_rotor`]).
    #[inline(always)]
    pub fn rotor_row(&self, at: &OperatingPoint<R>, gamma: R, rotor: R) -> [(usize, R); 6] {
        let r = R::from_f64;
        let q = &at.magnetisation;
        let decay = rotor * self.decay;
        let by_b = rotor * self.r_r_block * r(SCALE_B / SCALE_PSI);
        let by_gamma = decay * r(SCALE_GAMMA / SCALE_PSI);
        let by_c = decay * r(SCALE_C / SCALE_PSI);
        [
            (PSI, -at.turn * at.n.sin),
            (PSI + 1, at.turn * at.n.cos),
            (B, -by_b * at.n.cos),
            (B + 1, -by_b * at.n.sin),
            (GAMMA, -by_gamma * q.m_g),
            (C, -by_c * (gamma * q.bend)),
        ]
    }

    /// `∂m⁺/∂ε_r`.
    pub fn by_rotor(&self, at: &OperatingPoint<R>, rotor: R) -> R {
        rotor * self.decay * at.transient * R::from_f64(SCALE_ROTOR / TRANSIENT)
    }

    /// Row of one component of `χ` in `F`, given that component of `i`, `u_l`, `u_k` and `l̂ Δi`: coefficients of the
    /// same component of `b`, of `r_s`, `ε_v`, `ε_k` and `ε_l`; that of the component itself is one.
    #[inline(always)]
    pub fn flux_row(&self, i: R, u_l: R, u_k: R, d_leakage_flux: R, r_s: R) -> [R; 5] {
        let r = R::from_f64;
        let by_b = self.delta * r(SCALE_B / SCALE_PSI);
        let by_r_s = self.delta * self.r_s * r(SCALE_R / SCALE_PSI);
        let by_v = self.delta * r(SCALE_V / SCALE_PSI);
        let by_k = self.delta * r(SCALE_K / SCALE_PSI);
        [by_b * r_s, -by_r_s * i, -by_v * u_l, -by_k * u_k, -r(SCALE_LEAKAGE / SCALE_PSI) * d_leakage_flux]
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
