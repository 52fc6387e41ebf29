//! Catching a machine that rotates with a flux of its own: restart after a short pause. Per unit.
//!
//! ```text
//! i* = 0:   e = dψ_R/dτ = (jω - 1/τ_r) ψ_R,      ψ_R = -j e/ω
//! ω = Σ e_k-1 × e_k/(T Σ |e_k-1|²)          |ω| > 0.7
//! |ω| = |e|/|ψ_R|                           else, with the flux of the stop, less its decay, if it is known
//! ω = arcsin(e_4 × e_n/|e_n|²)/(n - 4)T  else
//! ```
//!
//! Without current the voltage of the machine is the one that its rotor flux induces. Current control at zero finds it:
//! the latest voltage less that of the leakage, `ê = u - σl_s Δi/t_s`, is fed forward, which ends the surge of the first
//! periods after two delays. With the feature `restart` the bridge is blocked in the second period if the first one, without
//! voltage, has driven the current on: else the surge would last for three, 2.4 to 3.1 times the rated current with a rated
//! flux and 40 periods a turn. What it shows of `e` is fed forward from the next period on.
//!
//! Eight blocks of `T` = 1 ms; the first three pass with the surge, the others give `e` as the difference of the integrated flux.
//!
//! The sign of `ω` taken wrong would be a flux of the opposite direction. The error of the inverter model turns `e` by up
//! to some tenths of a radian, which is more than a slow flux turns within four blocks: `n` = 8 is raised until `e` has
//! turned by 0.4. A flux of the stop whose direction is known decides at once, where it lies across `e`.
//!
//! With the feature `restart` the current turns where `|e|` is below 0.2 ([`super::turning`]).
//!
//! **Validity.** `|e|` above the error of the inverter model, 0.06: a rated flux that turns faster than 0.06 pu. The decay of the flux within
//! the blocks is neglected.

use crate::base::{PerUnit, rounded};
use crate::scalar::Real;
use crate::space::{AlphaBeta, Dq, Rotator};
use crate::words::words;

/// Blocks, and those before the current is back at zero.
pub(crate) const BLOCKS: u32 = 8;
const SURGE: u32 = 3;
/// Induced voltage from which on it shows the direction of the flux; below it the current turns, with the feature `restart`.
const STRONG: f64 = 0.2;
/// Normalised time of a turn of the current: in half of it a machine at 1.25 pu turns by `3/4`.
#[cfg(feature = "restart")]
const TURN: f64 = 1.2;
/// Time in which the current rises and settles before the first turn that counts, of `τ_r`, and its limits in blocks. Allowances: in large
/// machines at a low control frequency the current still settles after 2 ms, and the leakage takes its change for a flux; in small ones the
/// flux decays meanwhile.
#[cfg(feature = "restart")]
const RISE: f64 = 0.03;
#[cfg(feature = "restart")]
const RISE_BLOCKS: (f64, f64) = (2.0, 5.0);
/// Least induced voltage.
pub(crate) const LEAST: f64 = 0.06;
/// Speed up to which the angle over four blocks is below a quarter turn.
const SLOW: f64 = 0.7;
/// Angle by which `e` has certainly turned, and the blocks after which it is taken for certain.
const SURE: f64 = 0.4;
const LONGEST: u32 = 40;
/// Factor on the older blocks, beyond the first eight, in the speed's sums.
const FORGET: f64 = 0.75;
/// Constant error of the voltage, per unit, that is not zero in the mean over a turn of the current: 0.0026 at 160 kW and 4 kHz. A flux that
/// hardly turns in a machine with a large `τ_r` induces no more.
pub(super) const VOLTAGE_ERROR: f64 = 0.003;
/// Largest deviation of a flux that was found by what it induces, relative to the flux: 45°.
const DEVIATION_MOST: f64 = 0.7;
/// Least speed.
pub(super) const TURNING: f64 = 0.03;
/// Largest flux that is taken for one.
pub(super) const LARGEST: f64 = 1.5;

/// What the induced voltage shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Found<R: Real> {
    /// No flux that turns.
    Nothing,
    /// A flux that turns, but not yet in which direction.
    Uncertain,
    /// Rotor flux and speed.
    Flux(AlphaBeta<R>, R),
}

/// How well the flux of the stop, turned by the speed of the stop, tells the direction of the present one.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) enum Direction<R: Real> {
    /// It does not.
    Unknown,
    /// It does if the shaft has kept this speed, that of the stop, which has turned the flux by this angle, rad: what it induces
    /// shows that.
    IfSteady(R, R),
    /// It does if the shaft hardly turns, as at the stop.
    IfStanding,
    /// It does: the pause was too short for another one.
    Known,
}

impl<R: Real> Direction<R> {
    /// Whether it is taken as it is.
    #[inline(always)]
    pub fn is_taken(&self) -> bool {
        matches!(self, Self::IfStanding | Self::Known)
    }
}

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct CatchConfig<R: Real> {
    /// Control periods of a block, its duration and the reciprocal.
    pub block: u32,
    pub t_block: R,
    pub inv_t_block: R,
    /// `σl_s/t_s`.
    pub leakage: R,
    /// Blocks in which the current rises before it turns, those of a turn, the angle of a period, and `ω_p`.
    #[cfg(feature = "restart")]
    pub rise: u32,
    #[cfg(feature = "restart")]
    pub turn: u32,
    #[cfg(feature = "restart")]
    pub advance: R,
    #[cfg(feature = "restart")]
    pub omega_p: R,
    /// `1/τ_r`.
    #[cfg(feature = "restart")]
    pub inv_tau_r: R,
}
#[cfg(feature = "restart")]
words!(CatchConfig: block, t_block, inv_t_block, leakage, rise, turn, advance, omega_p, inv_tau_r);
#[cfg(not(feature = "restart"))]
words!(CatchConfig: block, t_block, inv_t_block, leakage);

impl<R: Real> CatchConfig<R> {
    /// Blocks of at least a time in s at a control frequency in Hz.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn new(pu: &PerUnit, least: f64, f_c: f64) -> Self {
        // At least 0.0125 of normalised time, whose reciprocal fits fixed point.
        let block = libm::round(least * f_c).max(libm::ceil(0.0125 / pu.t_s));
        let t_block = block * pu.t_s;
        // At least 12 periods.
        #[cfg(feature = "restart")]
        let turn = libm::round(TURN / t_block).max(libm::ceil(12.0 / block));
        #[cfg(feature = "restart")]
        let rise = (libm::round(RISE * pu.tau_r / t_block)).clamp(RISE_BLOCKS.0, RISE_BLOCKS.1);
        #[cfg(feature = "restart")]
        let advance = core::f64::consts::TAU / (turn * block);
        Self {
            block: block as u32,
            t_block: rounded(t_block),
            inv_t_block: rounded(1.0 / t_block),
            // Limited for fixed point: with periods shorter than a hundredth of the leakage the surge ends later.
            leakage: rounded((pu.sigma_l_s / pu.t_s).min(100.0)),
            #[cfg(feature = "restart")]
            rise: rise as u32,
            #[cfg(feature = "restart")]
            turn: turn as u32,
            #[cfg(feature = "restart")]
            advance: rounded(advance),
            #[cfg(feature = "restart")]
            omega_p: rounded(advance / pu.t_s),
            #[cfg(feature = "restart")]
            inv_tau_r: rounded(1.0 / pu.tau_r),
        }
    }

    /// Control periods without current, with which the catch begins.
    #[inline(always)]
    pub fn periods_without_current(&self) -> u32 {
        self.block * BLOCKS
    }

    /// Standard deviation of a flux that was found by what it induces, `Δu/|jω - 1/τ_r|` with an error `Δu` of the voltage, per unit.
    #[cold]
    #[inline(never)]
    pub fn deviation(&self, psi_r: &AlphaBeta<R>, omega: R) -> R {
        let r = R::from_f64;
        #[cfg(feature = "restart")]
        let rate = omega.abs().max(self.inv_tau_r);
        #[cfg(not(feature = "restart"))]
        let rate = omega.abs();
        // The reciprocal fits fixed point.
        let by_voltage = r(64.0 * VOLTAGE_ERROR) * (rate * r(64.0)).max(r(0.1)).recip();
        by_voltage.min(psi_r.norm_sq().sqrt() * r(DEVIATION_MOST))
    }
}

/// State.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct Catch<R: Real> {
    /// Integrated rotor flux at the beginning of the block or turn, and the voltage induced in the last one.
    pub(super) psi_r: AlphaBeta<R>,
    pub(super) e: AlphaBeta<R>,
    /// That in the first block after the surge, or in the latest without one to speak of; and the blocks since then. Before, the
    /// voltage that has driven a surge, or zero. Where the current turns, the integrated flux at the beginning of the first turn,
    /// and the turns since then.
    pub(super) first: AlphaBeta<R>,
    pub(super) blocks: u32,
    /// Sums of the speed. Before there are any, the first has the sign of the rotation after a surge; where the current turns, it is
    /// the swept area.
    pub(super) numerator: R,
    denominator: R,
    /// Current of the period before, or the direction of the one that turns.
    pub(super) i_s: AlphaBeta<R>,
}

impl<R: Real> Catch<R> {
    /// Begins at a current.
    pub fn new(i_s: AlphaBeta<R>) -> Self {
        let zero = AlphaBeta::default();
        Self { psi_r: zero, e: zero, first: zero, blocks: 0, numerator: R::ZERO, denominator: R::ZERO, i_s }
    }

    /// One period, counted from one, with the voltage applied before the sample, the current, and the integrated rotor
    /// flux. Returns field axis, flux and `ω_s` = ±1 for which current control at zero feeds `ê` forward, ahead in its direction.
    /// `blocked`: the bridge was, before the first period.
    #[cfg_attr(not(feature = "restart"), allow(unused_variables))]
    pub fn step(
        &mut self,
        c: &CatchConfig<R>,
        (period, blocked): (u32, bool),
        (u_s, i_s, psi_r): (&AlphaBeta<R>, AlphaBeta<R>, AlphaBeta<R>),
    ) -> (Rotator<R>, R, R) {
        let r = R::from_f64;
        // Less the voltage of the leakage.
        let driven = (self.i_s - i_s) * c.leakage;
        let e = match period {
            // Without voltage from the first sample to the second.
            #[cfg(feature = "restart")]
            2 if blocked && driven.norm_sq() > r(STRONG * STRONG) => {
                self.first = driven;
                driven
            }
            // Blocked from the second to the third.
            #[cfg(feature = "restart")]
            3 if self.is_surge() => self.first,
            ..=2 => AlphaBeta::default(),
            _ => *u_s + driven,
        };
        #[cfg(feature = "restart")]
        if period == 4 && self.is_surge() {
            self.numerator = self.first.cross(&e);
        }
        self.i_s = i_s;
        if period.is_multiple_of(c.block) {
            let block = period / c.block.max(1);
            let mean = (psi_r - self.psi_r) * c.inv_t_block;
            if block == SURGE + 2 {
                self.numerator = R::ZERO;
            }
            if block == SURGE + 1 || (block > BLOCKS && mean.norm_sq() < r(LEAST * LEAST)) {
                (self.first, self.blocks) = (mean, 0);
            } else if block > SURGE {
                self.blocks += 1;
            }
            if block > SURGE + 1 {
                if block > BLOCKS {
                    // The speed may have changed since.
                    self.numerator *= r(FORGET);
                    self.denominator *= r(FORGET);
                }
                self.numerator += self.e.cross(&mean);
                self.denominator += self.e.norm_sq();
            }
            (self.psi_r, self.e) = (psi_r, mean);
        }
        let square = e.norm_sq();
        // The sign of a small voltage is that of its noise.
        let back = self.numerator < R::ZERO && square > r(STRONG * STRONG);
        let omega_s = if back { -R::ONE } else { R::ONE };
        // jω_s ψ_s is fed forward.
        if square > R::from_f64(1e-4) {
            let (direction, magnitude) = Rotator::of(&e);
            let axis = AlphaBeta::new(direction.axis().im(), -direction.axis().re()) * omega_s;
            (Rotator::of(&axis).0, magnitude.min(R::TWO), omega_s)
        } else {
            (Rotator::default(), R::ZERO, omega_s)
        }
    }

    /// From the second period to the end of the surge: whether the machine has driven the current on without voltage, for which the
    /// bridge is blocked from the second sample to the third.
    #[cfg(feature = "restart")]
    #[inline(always)]
    pub fn is_surge(&self) -> bool {
        self.first != AlphaBeta::default()
    }

    /// What there is by now; `known`: flux of the stop, and how well its direction is known.
    #[cfg_attr(feature = "restart", cold, inline(never))]
    pub fn found(&self, c: &CatchConfig<R>, known: Option<(AlphaBeta<R>, Direction<R>)>) -> Found<R> {
        let r = R::from_f64;
        let least = r(LEAST);
        let square = self.e.norm_sq();
        #[cfg(feature = "restart")]
        if square < r(STRONG * STRONG) && (known.is_some() || square > least * least) {
            return Found::Uncertain;
        }
        if square < least * least || self.denominator < least * least {
            return Found::Nothing;
        }
        let over_one = (self.numerator * self.denominator.recip() * c.inv_t_block).limit(r(2.5));
        let sine = (self.first.cross(&self.e) * square.recip()).limit(R::ONE);
        let slow = over_one.within(r(SLOW));
        let mut sign = sine;
        if slow && sine.within(r(SURE)) && self.blocks < LONGEST {
            match known {
                Some((psi_r, Direction::IfStanding | Direction::Known))
                    if psi_r.dot(&self.e).abs() < psi_r.cross(&self.e).abs() =>
                {
                    sign = psi_r.cross(&self.e);
                }
                _ => return Found::Uncertain,
            }
        }
        let omega = match known {
            Some((psi_r, _)) if slow => {
                let omega = (square.sqrt() * psi_r.norm_sq().sqrt().recip()).min(R::ONE);
                if sign < R::ZERO { -omega } else { omega }
            }
            None if slow => {
                let turned = sine * (R::ONE + sine * sine * r(1.0 / 6.0));
                turned * c.inv_t_block * R::ONE.periods(self.blocks).recip() * r(1.0 / 64.0)
            }
            _ => over_one,
        };
        if omega.within(r(TURNING)) {
            return Found::Nothing;
        }
        // Half a block has passed since the mean.
        let turn = (omega * c.t_block).half();
        let e = Rotator::default().turned(turn.limit(R::HALF)).to_stator(&Dq::new(self.e.re(), self.e.im()));
        let inverse = omega.recip();
        let psi_r = AlphaBeta::new(e.im() * inverse, -e.re() * inverse);
        if psi_r.norm_sq() < r(LARGEST * LARGEST) { Found::Flux(psi_r, omega) } else { Found::Nothing }
    }
}
