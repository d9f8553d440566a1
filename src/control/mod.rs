//! The real-time control step, its thread, its clock and its timing report.

pub mod chain;
pub mod clock;
pub mod event;
mod onboard;
pub mod recorded;
mod reference;
pub mod session;
pub mod setup;
pub mod step;
pub mod thread;
pub mod timing;

pub use chain::{Chain, Conditioned};
pub use clock::{Clock, Tick, VirtualClock, WallClock};
pub use event::{Ending, Event, Nrmse, StepDirection, StepSummary};
pub use onboard::Onboard;
pub use step::{Controller, Parts, Request};
pub use timing::{Percentiles, Phase, StepTimes, Timing, TimingReport};
