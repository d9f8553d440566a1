//! The real-time control step, its thread, its clock and its timing report.

pub mod clock;
pub mod event;
pub mod thread;
pub mod timing;

pub use clock::{Clock, Tick, VirtualClock, WallClock};
pub use event::{Ending, Event, StepDirection, StepSummary};
pub use timing::{Percentiles, Phase, StepTimes, Timing, TimingReport};
