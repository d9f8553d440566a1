//! The command to the table: schedule of steps, smooth transitions, ramps, preview.
//!
//! The control step asks a [`Generator`] for one [`CommandPoint`] a period; the run and the
//! command line build a [`Schedule`] from a [`SweepSpec`] and show its [`Preview`] first. With smooth
//! transitions displacement, velocity, acceleration and jerk of the command are continuous from rest
//! to rest, and the counted cycles are pure sines.

mod generator;
mod motion;
mod preview;
mod schedule;
mod spec;

pub use generator::{CommandPoint, Generator, Segment};
pub use motion::Motion;
pub use preview::{Preview, PreviewRow, Quantity};
pub use schedule::{Schedule, Step};
pub use spec::{Settling, SweepDirection, SweepSpec, Transition};

/// Why a sweep was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SweepError {
    /// No step of the sweep lies in the range asked for.
    #[error(
        "no step of the sweep lies within {low_hz}..{high_hz} Hz; it has steps from {first_hz} to {last_hz} Hz"
    )]
    EmptyRange {
        /// Lower end asked for, Hz.
        low_hz: f64,
        /// Upper end asked for, Hz.
        high_hz: f64,
        /// Lowest step there is, Hz.
        first_hz: f64,
        /// Highest step there is, Hz.
        last_hz: f64,
    },
    /// A value out of range.
    #[error("{key}: {reason}")]
    Invalid {
        /// Key as in the sweep file.
        key: String,
        /// What is wrong and what is allowed.
        reason: String,
    },
    /// A step asks more of the table than it can give.
    #[error(
        "step {index} ({frequency_hz} Hz, {place}): {quantity} of {asked:.4} {unit} exceeds the {allowed:.4} {unit} of the rig"
    )]
    BeyondCapacity {
        /// Index of the step, from 0.
        index: u32,
        /// Its frequency, Hz.
        frequency_hz: f64,
        /// Where: in the step, on the way into it, in a ramp.
        place: &'static str,
        /// What exceeds.
        quantity: &'static str,
        /// What the command asks.
        asked: f64,
        /// What the rig gives.
        allowed: f64,
        /// Unit of both.
        unit: &'static str,
    },
}

/// Where in the sweep one sample is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepPhase {
    /// Index of the step in the whole schedule, from 0; in a transition and in the start ramp that of
    /// the step ahead, in the end ramp that of the last step.
    pub index: u32,
    /// Sweep direction of this step.
    pub direction: Direction,
    /// Frequency of the command, Hz: that of the step; within a transition the instantaneous one.
    pub frequency_hz: f64,
    /// Commanded peak acceleration A_G, m/s2.
    pub acceleration_amplitude_m_s2: f64,
    /// Phase of the command within the segment, rad, from 0; `a = A_G sin(phase)` within a step.
    pub phase_rad: f64,
    /// True within the counted cycles; false in ramps, transitions, settling and held cycles.
    pub counted: bool,
}

/// Direction of a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Direction {
    /// Rising frequency.
    Forward,
    /// Falling frequency.
    Backward,
}
