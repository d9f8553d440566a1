//! The exact propagator of piecewise-linear models: within a regime the motion under a first-order
//! hold or a sine is advanced from sample to sample by the exact transition of the linear system,
//! and where an event may lie inside a sample its power series is searched to the last bits.
//! [`super::build`] chooses it by itself; the sweep simulation drives it with ideal sines.

mod input;
mod piece;
mod propagator;
#[cfg(test)]
mod tests;

pub use input::{Input, Wave};
pub use propagator::Exact;
