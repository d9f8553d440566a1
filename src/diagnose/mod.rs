//! Which physical effect is missing from the model: instruments first, then parameters, then
//! effects.

pub mod adding;
mod anew;
mod answer;
mod at_last;
mod by_force;
mod by_response;
pub mod candidates;
mod contest;
pub mod discrimination;
pub mod engine;
mod errors;
pub mod instruments;
mod late;
mod late_force;
mod laws;
mod likeness;
pub mod live;
pub mod missing_force;
pub mod next_test;
pub mod out_there;
mod pairs;
pub mod parts;
pub mod report;
pub mod search;
pub mod shapes;
pub mod structure;
mod summits;
#[cfg(test)]
pub(crate) mod testing;
pub mod thresholds;
pub mod trial;
pub mod verdict;
pub mod whole;

pub use engine::{DiagnoseError, Options, diagnose, diagnose_together, fitness};
pub use report::Diagnosis;
pub use verdict::Verdict;
