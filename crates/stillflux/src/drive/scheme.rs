//! Static selection of the estimators of a scheme, among those that the build contains.

#[cfg(feature = "enhanced")]
use super::enhanced::EnhancedEstimators;
use super::estimators::Estimators;
use super::interface::Memory;
#[cfg(feature = "paper")]
use super::paper::PaperEstimators;
use crate::config::DriveConfig;
#[cfg(all(feature = "paper", feature = "enhanced"))]
use crate::config::Scheme;
use crate::estimate::offset::U_OFF_MAX;
use crate::scalar::Real;

/// Estimators of the scheme that a drive runs. A scheme that is left out of the build (feature `paper` or `enhanced`)
/// is a variant that does not exist.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
#[allow(clippy::large_enum_variant)]
pub(super) enum SchemeEstimators<R: Real> {
    #[cfg(feature = "paper")]
    Paper(PaperEstimators<R>),
    #[cfg(feature = "enhanced")]
    Enhanced(EnhancedEstimators<R>),
}

/// Evaluates `$body` with `$e` bound to the estimators of the drive's scheme.
macro_rules! with_estimators {
    ($scheme:expr, $e:ident => $body:expr) => {
        match $scheme {
            #[cfg(feature = "paper")]
            $crate::drive::scheme::SchemeEstimators::Paper($e) => $body,
            #[cfg(feature = "enhanced")]
            $crate::drive::scheme::SchemeEstimators::Enhanced($e) => $body,
        }
    };
}
pub(super) use with_estimators;

impl<R: Real> SchemeEstimators<R> {
    /// Estimators of the configured scheme, with the parameters of the machine.
    pub fn new(c: &DriveConfig<R>) -> Self {
        // In a build of one scheme there is nothing to ask: `DriveConfig::new` refuses the other one.
        #[cfg(all(feature = "paper", feature = "enhanced"))]
        if c.scheme == Scheme::Paper {
            return Self::Paper(PaperEstimators::new(c));
        }
        #[cfg(feature = "enhanced")]
        return Self::Enhanced(EnhancedEstimators::new(c));
        #[cfg(not(feature = "enhanced"))]
        Self::Paper(PaperEstimators::new(c))
    }

    /// Restores what an earlier run stored, each value within its limits.
    pub fn restore(&mut self, c: &DriveConfig<R>, memory: &Memory<R>) {
        let u_off = memory.u_off.limit_components(R::from_f64(U_OFF_MAX));
        with_estimators!(self, e => e.restore(c, memory, u_off));
    }
}
