//! Sensorless induction motor control at very low speed and at zero stator frequency.
//!
//! The system of Holtz and Quan, *Drift- and parameter-compensated flux estimator for persistent
//! zero-stator-frequency operation of sensorless-controlled induction motors* (IEEE Trans. Ind. Appl.,
//! 2003), for microcontrollers: no allocation, no unsafe code, no panic, no trigonometry in the loop, and
//! one source for `f32`, `f64` and fixed point ([`scalar::Q`]).
//!
//! [`drive::Drive`] is the front door, one call per control period. Every block of the paper stands alone
//! in a file of its own and can be used alone: [`inverter`] (4)-(7), [`estimate::flux`] Fig. 7,
//! [`estimate::offset`] Fig. 4 and (9), [`estimate::resistance`] Fig. 12, [`estimate::speed`],
//! [`control`]. Parameters are SI and validated ([`params`], [`config`]); inside, everything is per unit
//! ([`base`]). [`si`] converts measurements, references, estimates and memory for callers in SI.
//!
//! [`supervision`] is what watches the drive, with its fault codes; all but the basic of it is the feature
//! `supervision`, on by default.
//!
//! The features `paper` (the published scheme) and `enhanced` choose the estimators that a build of the drive holds;
//! both are on by default, a product needs one. `additions` is what both have beyond the paper's drive, `commission` adds
//! self-commissioning; the chapter for firmware engineers (`docs/firmware.md`) lists them all, with what a build without them lacks.
//!
//! ```
//! use stillflux::config::{DriveConfig, DriveParams};
//! use stillflux::drive::{Drive, Measurement, Reference};
//! use stillflux::params::{Inverter, Machine};
//!
//! let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
//! let params = DriveParams::new(&machine, &inverter);
//! let mut drive = Drive::<f32>::new(DriveConfig::new(&machine, &inverter, &params)?);
//!
//! // In the interrupt of the current conversion, once per PWM period, in per unit:
//! let measured = Measurement { i_abc: [0.0, 0.0, 0.0], u_dc: 1.65 };
//! let out = drive.step(&measured, &Reference::Speed(0.01));
//! assert!(!out.gates_on, "the drive reads its current offsets first, then magnetises, then runs");
//! assert!(out.duty.iter().all(|d| (0.0..=1.0).contains(d)));
//! # Ok::<(), stillflux::params::ParamError>(())
//! ```
#![no_std]
#![forbid(unsafe_code)]
#![deny(missing_docs)]

#[cfg(test)]
extern crate std;

/// The example of the README is compiled and run.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

#[cfg(not(any(feature = "paper", feature = "enhanced")))]
compile_error!("a drive needs a scheme: enable the feature `paper`, `enhanced` or both");

pub mod base;
#[cfg(feature = "commission")]
pub mod commission;
pub mod config;
pub mod control;
pub mod counts;
pub mod drive;
mod error;
pub mod estimate;
pub mod interrupt;
pub mod inverter;
pub mod page;
pub mod params;
pub mod scalar;
pub mod si;
pub mod space;
pub mod supervision;
pub mod telemetry;
pub mod trace;
pub mod words;
