//! What the control thread tells the rest beside the rows: slips, gaps, faults, finished steps.

use super::timing::Phase;
use crate::rig::RigFault;
use crate::safety::{self, DetectorId};
use crate::signal::{HARMONICS, Harmonic};
use crate::sweep::Direction;
use serde::{Deserialize, Serialize};

/// Result of one step of the sweep: steady state of measurement and onboard model over its last
/// cycles, and how far apart they were over all its counted cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StepSummary {
    /// Index of the step, from 0.
    pub index: u32,
    /// Sweep direction.
    pub direction: StepDirection,
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Largest absolute acceleration of the mass, measured, m/s2.
    pub a_max_m_s2: f64,
    /// Excursion (largest minus smallest relative displacement), measured, m.
    pub excursion_m: f64,
    /// Largest absolute acceleration of the mass, onboard model, m/s2.
    pub model_a_max_m_s2: f64,
    /// Excursion of the onboard model, m.
    pub model_excursion_m: f64,
    /// Root-mean-square difference of the accelerations over the standard deviation measured.
    pub nrmse_a: f64,
    /// Root-mean-square difference of the relative displacements over the standard deviation measured.
    pub nrmse_d: f64,
    /// Fundamental of the measured table acceleration over A_G.
    pub table_amplitude_ratio: f64,
    /// Fundamental and harmonics 2 to 5 of the table acceleration, m/s2; phases here and below against
    /// the command's `a = A_G sin(phi)`, after the band-pass.
    #[serde(default)]
    pub table_acceleration: [Harmonic; HARMONICS],
    /// The same of the absolute acceleration of the mass, m/s2.
    #[serde(default)]
    pub mass_acceleration: [Harmonic; HARMONICS],
    /// The same of the relative displacement, m.
    #[serde(default)]
    pub relative_displacement: [Harmonic; HARMONICS],
}

/// Direction of a sweep, with the default that plain-data events need.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StepDirection {
    /// Rising frequency.
    #[default]
    Forward,
    /// Falling frequency.
    Backward,
}

impl From<Direction> for StepDirection {
    fn from(direction: Direction) -> Self {
        match direction {
            Direction::Forward => Self::Forward,
            Direction::Backward => Self::Backward,
        }
    }
}

/// How far the onboard model is from the measurement: root-mean-square difference over the standard
/// deviation measured, both after the band-pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Nrmse {
    /// Of the absolute acceleration of the mass.
    pub nrmse_a: f64,
    /// Of the relative displacement.
    pub nrmse_d: f64,
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ending {
    /// The sweep is done and the table at rest.
    Done,
    /// Stopped on request.
    Stopped,
    /// Ended by the safety supervisor.
    Aborted,
    /// The rig or the recorder failed.
    Failed,
    /// The process ended before the run did.
    Interrupted,
}

/// One event; `cycle` counts control periods from 0.
// Events go through a ring by value: a box would allocate on the control thread.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Event {
    /// The thread came one or more whole periods too late.
    Slip {
        /// Cycle that came too late.
        cycle: u64,
        /// Periods skipped.
        periods: u64,
        /// How late it came, us.
        late_us: f64,
        /// The phase that took the time.
        phase: Phase,
    },
    /// The DAQ's sequence number jumped: samples that never arrived.
    DaqGap {
        /// Cycle in which it showed.
        cycle: u64,
        /// Last number before the gap.
        after: u64,
        /// Samples missing.
        missing: u64,
    },
    /// The rig reported a fault.
    RigFault {
        /// Cycle in which it showed.
        cycle: u64,
        /// Which.
        #[serde(serialize_with = "as_text")]
        fault: RigFault,
    },
    /// A limit was exceeded: the first-out cause of the abort.
    Abort {
        /// Cycle in which it was decided.
        cycle: u64,
        /// Number of the last sample before.
        sequence: u64,
        /// The detector that tripped first.
        cause: DetectorId,
    },
    /// A detector has tripped or warns.
    Finding {
        /// Cycle in which it showed.
        cycle: u64,
        /// Which.
        detector: DetectorId,
        /// Tripped, not only warned.
        tripped: bool,
        /// Its indicator, in the detector's unit.
        value: f64,
    },
    /// The supervisor has gone over to another state.
    Supervisor {
        /// Cycle.
        cycle: u64,
        /// The new state.
        state: safety::State,
    },
    /// What an operator asked for was refused.
    Refused {
        /// Cycle.
        cycle: u64,
        /// Why.
        reason: safety::Refusal,
    },
    /// What the operator's side asked for is in force from this cycle on.
    Obeyed {
        /// Cycle.
        cycle: u64,
        /// What was asked.
        request: super::step::Request,
        /// When its first command went out, ns of the monotonic clock.
        at_ns: u64,
    },
    /// A step of the sweep is finished.
    Step(StepSummary),
    /// The run is over.
    End {
        /// Last cycle.
        cycle: u64,
        /// How.
        ending: Ending,
        /// Onboard model against measurement over all counted cycles.
        error: Nrmse,
    },
    /// How far the onboard model is off at the moment; shown, not recorded.
    Live {
        /// Cycle.
        cycle: u64,
        /// Running error.
        error: Nrmse,
    },
}

fn as_text<S: serde::Serializer>(fault: &RigFault, sink: S) -> Result<S::Ok, S::Error> {
    sink.collect_str(fault)
}
