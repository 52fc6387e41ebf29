//! stillflux on a Cortex-M4F: what the images of `src/bin` share.
//!
//! [`board`] is the one file to replace for a port, [`blob`] a parameter page in SI beside that of
//! [`stillflux::page`], [`exchange`] the processor-in-the-loop protocol. What the control interrupt calls is
//! [`stillflux::interrupt::CountsDrive`].
#![no_std]

pub mod blob;
pub mod board;
#[cfg(feature = "commission")]
pub mod commissioning;
pub mod exchange;
