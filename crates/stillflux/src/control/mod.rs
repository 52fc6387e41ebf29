//! Stator-flux-oriented control: current, flux and speed controllers, flux shift, dither, currents of a start, field weakening, ramp, derating,
//! way out of a false equilibrium, gain of a shaft lighter than told, hand-over between measured and estimated speed, control of the dc link, modulator, pulses for a single shunt.

pub mod current;
#[cfg(feature = "dclink")]
pub mod dclink;
#[cfg(all(feature = "enhanced", feature = "dither"))]
pub mod dither;
pub mod flux;
#[cfg(feature = "encoder")]
pub mod handover;
#[cfg(feature = "enhanced")]
pub(crate) mod levels;
pub mod modulator;
#[cfg(feature = "derating")]
pub mod overload;
#[cfg(not(feature = "derating"))]
#[path = "left_out/overload.rs"]
pub mod overload;
#[cfg(feature = "ramp")]
pub mod ramp;
#[cfg(not(feature = "ramp"))]
#[path = "left_out/ramp.rs"]
pub mod ramp;
#[cfg(feature = "supervision")]
pub mod realign;
pub mod shift;
#[cfg(feature = "shunt")]
pub mod shunt;
#[cfg(all(feature = "enhanced", feature = "supervision"))]
pub(crate) mod sides;
pub mod speed;
#[cfg(feature = "supervision")]
pub mod swing;
#[cfg(feature = "weakening")]
pub mod weakening;
#[cfg(not(feature = "weakening"))]
#[path = "left_out/weakening.rs"]
pub mod weakening;
