//! Fitting a model's parameters to records, with intervals.

mod applied;
mod base;
mod coherence;
mod component;
mod fastest;
mod filtered;
mod fused;
mod imposed;
mod jumpless;
pub mod kinematics;
pub mod least_squares;
mod lines;
pub mod motion;
pub mod numbers;
mod output_error;
pub mod periodic;
pub mod problem;
mod ramps;
pub mod refit;
pub mod response;
mod reversals;
pub mod spectral;
mod table;
pub mod together;
mod weighing;
mod windows;

pub use applied::{applied_noise, force_on_time};
pub use component::{answered, imposed_on_component};
pub use fastest::holding;
pub use jumpless::noise_of_whole_beside_jumps;

use crate::record::{Record, mended::mended};
use std::borrow::Cow;

/// A record as models are fitted to it: faults of its chain taken out, and at the rate of its band. What was done is in its notes.
pub fn readied(record: &Record) -> Cow<'_, Record> {
    in_its_band(mended(record))
}

/// A record whose faults were taken out, at the rate of its band.
pub fn in_its_band(record: Cow<'_, Record>) -> Cow<'_, Record> {
    match record {
        Cow::Borrowed(record) => filtered::at_its_rate(record),
        Cow::Owned(record) => Cow::Owned(filtered::at_its_rate(&record).into_owned()),
    }
}
