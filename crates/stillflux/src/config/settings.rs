//! Settings of a drive, SI unless marked per unit, with defaults derived from machine and inverter (docs/gains.md) and
//! the admissible range of each. A value outside it is an error that names field, value and range.

mod clocks;
mod defaults;
mod derived;
mod direct_flux;
mod enhanced;
mod paper;
mod scheme;
mod types;
mod validate;

pub use self::clocks::BALANCE_PERIODS;
pub(crate) use self::clocks::{SUPERVISION_PERIODS, adapt_periods, slow_periods, speed_periods};
pub(crate) use self::derived::{BOOST, QUICK};
pub use self::enhanced::EnhancedParams;
pub use self::paper::PaperParams;
pub use self::scheme::Scheme;
pub use self::types::{DriveParams, EncoderMode, LowConfidence};
