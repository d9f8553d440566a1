//! The exact propagator of piecewise-linear models. Sampled input (first-order hold) is advanced from
//! sample to sample by the exact transition of the linear system, and where an event may lie inside a
//! sample its power series is searched to the last bits; [`super::build`] chooses it by itself. Ideal
//! sweeps go from event to event in closed form, with bounds of the curvature that let no event pass.

mod form;
mod input;
mod local;
mod piece;
mod propagator;
#[cfg(test)]
mod reference;
mod segment;
mod sweep;
#[cfg(test)]
mod tests;
mod vibration;
mod zeros;

pub(in crate::model) use form::Form;
pub use input::{Input, Wave};
pub use propagator::{Exact, Sampled};
pub(in crate::model) use segment::{Closed, Instant, ROW, Tables, Turns};
pub(in crate::model) use sweep::Stretch;
pub(in crate::model) use zeros::zeros;
