//! What keeps the rig from surprising the person beside it: detectors, action ladder and first-out
//! cause. The control step shows every sample ([`Observation`]) and period ([`Period`]) to the
//! [`Watch`]; what it finds is answered by the highest [`Action`] of `config/safety.toml`.

pub mod action;
pub mod context;
pub mod detect;
pub mod judge;
pub mod observation;
pub mod spec;
pub mod watch;

pub use action::{Action, Clear};
pub use judge::{Estimate, Level, Reading};
pub use observation::{Observation, Period, Setup};
pub use spec::{Detection, DetectorId, Row, SafetySpec, Stops};
pub use watch::{DetectorSet, Findings, Watch};
