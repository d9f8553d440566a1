//! What keeps the rig from surprising the person beside it: detectors, action ladder, supervisor, stops, watchdog.
//! The control step shows every sample ([`Observation`]) and period ([`Period`]) to the [`Guard`], which owns the
//! [`Watch`] over all detectors, the [`Supervisor`] and the stop trajectories; what is found is answered by the highest
//! [`Action`] of `config/safety.toml`. Requirements, code and tests share the numbers `SR-nn` of `docs/safety.md`.

pub mod action;
pub mod context;
pub mod detect;
pub mod guard;
pub mod judge;
pub mod observation;
mod rejoin;
pub mod spec;
pub mod stop;
pub mod supervisor;
pub mod watch;
pub mod watchdog;

pub use action::{Action, Clear};
pub use guard::{Ask, Begin, Guard, Outcome};
pub use judge::{Estimate, Level, Reading};
pub use observation::{Observation, Period, Setup};
pub use spec::{Detection, DetectorId, Row, SafetySpec, Stops, Supervision};
pub use stop::{Decay, MinimumJerkStop, Return};
pub use supervisor::{Order, Refusal, Rules, State, Supervisor};
pub use watch::{DetectorSet, Findings, Watch};
pub use watchdog::{Heart, StopLine, Watchdog};

/// Record of all channels that is kept apart before and after the first-out cause, s each (SR-12).
pub const SNAPSHOT_S: f64 = 5.0;
