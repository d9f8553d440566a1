//! The controller of a structural-dynamics shaking table, and the bench on which a specimen model
//! is compared with what was measured.
//!
//! Two worlds meet here. The control thread ([`control`]) is a plain function that reads a sample,
//! watches it and writes a command; everything else (recording, identification, diagnosis, the
//! command line) runs beside it and talks to it through lock-free rings ([`stream`]) only.
//!
//! SI units everywhere; the unit stands in the name of every plain number.

#![deny(unsafe_op_in_unsafe_fn)]
#![warn(missing_docs)]

pub mod campaign;
pub mod cli;
pub mod compare;
pub mod config;
pub mod control;
pub mod daemon;
pub mod diagnose;
pub mod identify;
pub mod model;
pub mod parallel;
pub mod record;
pub mod report;
pub mod rig;
pub mod safety;
pub mod signal;
pub mod stream;
pub mod sweep;
pub mod units;
