//! Self-commissioning: from the nameplate to the parameters of a drive.
//!
//! [`nameplate`] gives a first machine with the deviation of each value.

pub mod nameplate;

pub use nameplate::{Deviation, Nameplate};
