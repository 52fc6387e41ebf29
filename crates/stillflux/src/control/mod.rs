//! Stator-flux-oriented control: current, flux and speed controllers, flux shift, field weakening,
//! modulator.

pub mod current;
pub mod flux;
pub mod modulator;
pub mod shift;
pub mod speed;
pub mod weakening;
