//! Sensorless induction motor control at very low speed and zero stator frequency.
#![no_std]
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod base;
pub mod config;
pub mod control;
pub mod counts;
pub mod drive;
pub mod estimate;
pub mod inverter;
pub mod params;
pub mod scalar;
pub mod space;
