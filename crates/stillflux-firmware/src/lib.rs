//! stillflux on a Cortex-M4F: what the images of `src/bin` share.
//!
//! [`control`] is the content of the control interrupt, [`board`] the one file to replace for a port,
//! [`page`] the parameter page in flash (or [`blob`], in SI), [`exchange`] the processor-in-the-loop protocol.
#![no_std]

pub mod blob;
pub mod board;
pub mod control;
pub mod exchange;
pub mod page;
pub mod violation;
