//! Stator-flux-oriented control: current, flux and speed controllers, flux shift, field weakening, ramp, derating,
//! way out of a false equilibrium, control of the dc link, modulator.

pub mod current;
#[cfg(feature = "dclink")]
pub mod dclink;
pub mod flux;
pub mod modulator;
pub mod overload;
pub mod ramp;
#[cfg(feature = "supervision")]
pub mod realign;
pub mod shift;
pub mod speed;
pub mod weakening;
