//! The estimators that a drive runs, and what of them is built.

use crate::params::{ParamError, check};
use crate::words::Words;

/// Which estimators a drive runs, of those that the build has (features `paper` and `enhanced`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Scheme {
    /// The published scheme: offset estimator, noise compensator, resistance adaptation.
    Paper,
    /// One extended Kalman filter for flux, offset, resistance, inverter model and magnetising curve; the confidence
    /// follows from its covariance.
    Enhanced,
}

impl Scheme {
    /// The schemes of this build.
    pub const ALL: &[Self] = &[
        #[cfg(feature = "paper")]
        Self::Paper,
        #[cfg(feature = "enhanced")]
        Self::Enhanced,
    ];

    /// The schemes of this build, and the features that a stored configuration depends on, as a word: bit 0 the
    /// published one, bit 1 the enhanced one, bit 2 supervision, bit 3 the variants of the published one, bit 4 the
    /// loss of unequal legs. A stored configuration fits only a build of the same.
    pub const FEATURES: u32 = cfg!(feature = "paper") as u32
        | (cfg!(feature = "enhanced") as u32) << 1
        | (cfg!(feature = "supervision") as u32) << 2
        | (cfg!(feature = "variants") as u32) << 3
        | (cfg!(feature = "legs") as u32) << 4;

    /// An error if the scheme is left out of this build.
    pub(crate) fn check(self) -> Result<(), ParamError> {
        let (first, last) = (f64::from(u8::from(Self::FEATURES & 1 == 0)), f64::from(Self::FEATURES >> 1 & 1));
        check("scheme", f64::from(self as u8), first, last, "")
            .map_err(|e| e.with_note("0 is built with the feature `paper`, 1 with `enhanced`"))
    }
}

impl Default for Scheme {
    /// The enhanced one, if the build has it.
    fn default() -> Self {
        if cfg!(feature = "enhanced") { Self::Enhanced } else { Self::Paper }
    }
}

impl Words for Scheme {
    const BLANK: Self = Self::Paper;
    fn put(&self, out: &mut impl FnMut(u32)) {
        out(*self as u32);
    }
    fn fill(&mut self, from: &mut impl FnMut() -> u32) {
        *self = if from() == Self::Paper as u32 { Self::Paper } else { Self::Enhanced };
    }
}
