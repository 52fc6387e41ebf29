//! Leakage that saturates, and the rotor's slots: parameters. [`crate::machine::Circuit`] integrates them.
//!
//! With `psi_l = psi_s - psi_r` and the energy of the field as the one source of currents and torque,
//!
//! ```text
//! W += 3/2 [ k |psi_l|⁴/(4 L_l) + p cos(Z theta) |psi_s|²/(2 L_u) + l Re(psi_l² e^{-j Z theta})/(2 L_l) ]
//! i_l = ((1 + k |psi_l|²) psi_l + l e^{j Z theta} psi_l*)/L_l           i_s = psi_s/L_s + p cos(Z theta) psi_s/L_u + i_l
//! psi_r' = R_r i_l + j omega psi_r
//! T = 3/2 [ n_p (psi_r x i_l) + Z p sin(Z theta) |psi_s|²/(2 L_u) - Z l Im(psi_l² e^{-j Z theta})/(2 L_l) ]
//! ```
//!
//! `theta` is the shaft's mechanical angle, so the books balance also with the ripple of the torque: what
//! `-∂W/∂theta` gives to the shaft the field loses.
//!
//! **Leakage saturation** (`k`): bridges over closed slots and tips of the teeth. The leakage is `L_l/(1 + k |psi_l|²)`;
//! `k` follows from the share that is lost at a given current.
//!
//! **Permeance ripple** (`p`): the air gap's mean permeance as `Z` slots pass, stronger where stator and rotor slots
//! have a common divisor. In a field of frequency `f_s` it shows as currents of `Z f_m ± f_s`, the rotor slot harmonics,
//! and as cogging `3/4 Z p |psi_s|²/L_u`: 0.5 % and 28 slots give 3 % of rated torque at 2.2 kW.
//!
//! **Slot ripple of the leakage** (`l`): zigzag leakage differs along and across the slots. A saliency that turns with
//! the slots, a current of `Z f_m - f_s` in proportion to the load.
//!
//! With a deep bar both leakage terms are those of the rotor's first branch.
#![allow(non_snake_case)]

use std::f64::consts::SQRT_2;
use stillflux::params::{Machine, ParamError, check};

/// Saturation of the leakage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeakageSaturation {
    /// Share of the leakage inductance that is lost at [`Self::current`].
    pub share: f64,
    /// Peak rotor current, A.
    pub current: f64,
}

/// Slots of the rotor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlotRipple {
    /// Number of slots `Z` around the rotor.
    pub slots: u32,
    /// Relative amplitude `p` of the air gap's permeance.
    pub permeance: f64,
    /// Relative amplitude `l` of the inverse leakage inductance.
    pub leakage: f64,
}

impl LeakageSaturation {
    /// Checks every field against its admissible range.
    ///
    /// # Errors
    /// The first field found outside its range. The current is at least half the rated one: the law is that of a
    /// leakage which saturates beyond rated load, and a power of the current far beyond.
    pub fn validate(&self, machine: &Machine) -> Result<(), ParamError> {
        check("leakage_saturation share", self.share, 0.0, 0.6, "")?;
        check("leakage_saturation current", self.current, 0.5 * SQRT_2 * machine.I_N, 1e6, "A")
    }

    /// `k` in 1/(V·s)²: with `x = share/(1 - share)`, `k |psi_l|² = x` at `|psi_l| = (1 - share) L_l current`.
    pub(crate) fn k(&self, machine: &Machine) -> f64 {
        let psi = (1.0 - self.share) * machine.to_gamma().L_l * self.current;
        self.excess() / (psi * psi)
    }

    /// By how much the inverse inductance exceeds that of small currents.
    pub(crate) fn excess(&self) -> f64 {
        self.share / (1.0 - self.share)
    }
}

impl SlotRipple {
    /// Checks every field against its admissible range.
    ///
    /// # Errors
    /// The first field found outside its range.
    pub fn validate(&self) -> Result<(), ParamError> {
        check("slot_ripple slots", f64::from(self.slots), 1.0, 500.0, "")?;
        check("slot_ripple permeance", self.permeance, 0.0, 0.2, "")?;
        check("slot_ripple leakage", self.leakage, 0.0, 0.3, "")
    }
}
