//! Stator-flux-oriented control: current, flux and speed controllers, modulator.

pub mod current;
pub mod flux;
pub mod modulator;
pub mod speed;
