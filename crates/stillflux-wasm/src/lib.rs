//! Drive and plant for a web page: a [`session`] that can be changed while it runs, and the functions by which a page
//! calls it ([`exports`]).
//!
//! Core and plant are those of every other build, and compute the same bits.
#![deny(missing_docs)]

pub mod description;
pub mod exports;
pub mod session;
