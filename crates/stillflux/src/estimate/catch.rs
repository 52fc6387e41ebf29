//! Catching a machine that rotates with a flux of its own: restart after a short pause. Per unit.
//!
//! ```text
//! i* = 0:   e = dψ_R/dτ = (jω - 1/τ_r) ψ_R,      ψ_R = -j e/ω
//! ω = Σ e_k-1 × e_k/(T Σ |e_k-1|²)          |ω| > 0.7
//! |ω| = |e|/|ψ_R|                           else, with the flux of the stop, less its decay, if it is known
//! ω = arcsin(e_4 × e_8/|e_4||e_8|)/4T       else
//! ```
//!
//! Without current the voltage of the machine is the one that its rotor flux induces. Current control at zero finds it:
//! the latest voltage less that of the leakage, `ê = u - σl_s Δi/t_s`, is fed forward, which ends the surge of the first
//! periods after two delays. Eight blocks of `T` = 1 ms; the first three pass with the surge, the others give `e` as the
//! difference of the integrated flux.
//!
//! **Validity.** `|e|` above the error of the inverter model, 0.06: a rated flux that turns faster than 0.06 pu. The decay of the flux within
//! the blocks is neglected.

use crate::scalar::Real;
use crate::space::{AlphaBeta, Dq, Rotator};
use crate::words::words;

/// Blocks, and those before the current is back at zero.
pub(crate) const BLOCKS: u32 = 8;
const SURGE: u32 = 3;
/// Least induced voltage.
const LEAST: f64 = 0.06;
/// Speed up to which the angle over four blocks is below a quarter turn.
const SLOW: f64 = 0.7;
/// Least speed.
const TURNING: f64 = 0.03;
/// Largest flux that is taken for one.
const LARGEST: f64 = 1.5;

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
}
words!(CatchConfig: block, t_block, inv_t_block, leakage);

/// State.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct Catch<R: Real> {
    /// Integrated rotor flux at the beginning of the block, and the voltage induced in the last one.
    psi_r: AlphaBeta<R>,
    e: AlphaBeta<R>,
    /// That in the first block after the surge.
    first: AlphaBeta<R>,
    numerator: R,
    denominator: R,
    i_s: AlphaBeta<R>,
}

impl<R: Real> Catch<R> {
    /// Begins at a current.
    pub fn new(i_s: AlphaBeta<R>) -> Self {
        let zero = AlphaBeta::default();
        Self { psi_r: zero, e: zero, first: zero, numerator: R::ZERO, denominator: R::ZERO, i_s }
    }

    /// One period, counted from one, with the voltage applied before the sample, the current, and the integrated rotor
    /// flux. Returns field axis and flux for which current control at zero and `ω_s` = 1 feeds `ê` forward.
    pub fn step(
        &mut self,
        c: &CatchConfig<R>,
        period: u32,
        (u_s, i_s, psi_r): (&AlphaBeta<R>, AlphaBeta<R>, AlphaBeta<R>),
    ) -> (Rotator<R>, R) {
        let e = if period > 2 { *u_s - (i_s - self.i_s) * c.leakage } else { AlphaBeta::default() };
        self.i_s = i_s;
        if period.is_multiple_of(c.block) {
            let block = period / c.block.max(1);
            let mean = (psi_r - self.psi_r) * c.inv_t_block;
            if block == SURGE + 1 {
                self.first = mean;
            } else if block > SURGE {
                self.numerator += self.e.cross(&mean);
                self.denominator += self.e.norm_sq();
            }
            (self.psi_r, self.e) = (psi_r, mean);
        }
        // jω_s ψ_s is fed forward.
        if e.norm_sq() > R::from_f64(1e-4) {
            let (direction, magnitude) = Rotator::of(&e);
            let axis = AlphaBeta::new(direction.axis().im(), -direction.axis().re());
            (Rotator::of(&axis).0, magnitude.min(R::TWO))
        } else {
            (Rotator::default(), R::ZERO)
        }
    }

    /// Rotor flux and speed at the end, if there was an induced voltage; `known`: magnitude of the flux.
    pub fn found(&self, c: &CatchConfig<R>, known: Option<R>) -> Option<(AlphaBeta<R>, R)> {
        let r = R::from_f64;
        let least = r(LEAST);
        let square = self.e.norm_sq();
        if square < least * least || self.denominator < least * least {
            return None;
        }
        let over_one = (self.numerator * self.denominator.recip() * c.inv_t_block).limit(r(2.5));
        let sine = (self.first.cross(&self.e) * square.recip()).limit(R::ONE);
        let over_four = sine * (R::ONE + sine * sine * r(1.0 / 6.0)) * c.inv_t_block.quarter();
        let slow = over_one.within(r(SLOW));
        let omega = match known {
            Some(psi_r) if slow => {
                let omega = (square.sqrt() * psi_r.recip()).min(R::ONE);
                if sine < R::ZERO { -omega } else { omega }
            }
            None if slow => over_four,
            _ => over_one,
        };
        if omega.within(r(TURNING)) {
            return None;
        }
        // Half a block has passed since the mean.
        let turn = (omega * c.t_block).half();
        let e = Rotator::default().turned(turn.limit(R::HALF)).to_stator(&Dq::new(self.e.re(), self.e.im()));
        let inverse = omega.recip();
        let psi_r = AlphaBeta::new(e.im() * inverse, -e.re() * inverse);
        (psi_r.norm_sq() < r(LARGEST * LARGEST)).then_some((psi_r, omega))
    }
}
