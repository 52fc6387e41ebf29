//! Plant and closed loop.
//!
//! [`Plant`] is the drive's physical side: induction machine, two-level bridge, sensors, shaft, resolved at
//! every switching edge, dead-time end and zero of a phase current. One [`Plant::step`] is one PWM period.
//!
//! The same scenario gives the same bits on every target: transcendental functions come from `libm`, not from the
//! platform's library, which another system has in another version.
#![forbid(unsafe_code)]
#![cfg_attr(not(test), deny(clippy::disallowed_methods))]
#![deny(missing_docs)]

mod adc;
mod branches;
mod bridge;
pub mod commission;
mod coupling;
mod dclink;
mod encoder;
mod link_energy;
mod machine;
mod mechanics;
mod nodes;
mod plant;
mod rectifier;
pub mod replay;
mod rng;
mod shunt;
pub mod simulate;
mod slots;
mod thermal;

pub use adc::{Adc, ChannelFault};
pub use branches::{DeepBar, IronLoss};
pub use bridge::GateDelays;
pub use coupling::Coupling;
pub use dclink::DcLink;
pub use encoder::{Encoder, EncoderFault};
pub use link_energy::LinkEnergy;
pub use machine::Energy;
pub use mechanics::Mechanics;
pub use plant::{Calls, Mode, Plant, PlantParams, Truth};
pub use rectifier::Grid;
pub use shunt::Shunt;
pub use slots::{LeakageSaturation, SlotRipple};
pub use thermal::Thermal;
