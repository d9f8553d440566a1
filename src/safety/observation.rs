//! What the control step hands over: one [`Observation`] a sample, one [`Period`] a control period, and
//! once, before the run, what is known of rig and specimen ([`Setup`]).

use crate::model::Response;
use crate::rig::{Capacity, RigFault};
use crate::stream::Sample;
use crate::sweep::CommandPoint;

/// One sample and what belongs to it.
#[derive(Clone, Copy, Debug)]
pub struct Observation {
    /// The sample as delivered.
    pub sample: Sample,
    /// Command, step and phase in force when the sample was taken.
    pub reference: CommandPoint,
    /// What the onboard model says of this sample.
    pub response: Response,
}

/// One control period, with or without samples.
#[derive(Clone, Copy, Debug, Default)]
pub struct Period {
    /// Samples taken in this period.
    pub samples: u32,
    /// Periods skipped just before this one.
    pub skipped: u64,
    /// Share of the recorder's ring that is in use, 0 to 1.
    pub recorder_used: f64,
    /// Time since the operator's side was last heard of, s; `None` when no such link is configured.
    pub link_age_s: Option<f64>,
    /// What the rig reported on reading or writing.
    pub rig_fault: Option<RigFault>,
}

/// What detectors and stops must know of rig and specimen.
#[derive(Clone, Copy, Debug)]
pub struct Setup {
    /// Sampling and control rate, Hz.
    pub sample_rate_hz: f64,
    /// Delay from a command to its effect in the measured motion, s.
    pub chain_delay_s: f64,
    /// What the table can give.
    pub capacity: Capacity,
    /// Clearance of both bumpers together, m; `None` without bumpers.
    pub total_gap_m: Option<f64>,
    /// Stiffness of one bumper, N/m; `None` without bumpers.
    pub bumper_stiffness_n_m: Option<f64>,
}

impl Setup {
    /// From a rig's capacity and a specimen's model.
    pub fn new(
        sample_rate_hz: f64,
        chain_delay_s: f64,
        capacity: Capacity,
        model: &crate::model::ModelSpec,
    ) -> Self {
        Self {
            sample_rate_hz,
            chain_delay_s,
            capacity,
            total_gap_m: model.bumper.as_ref().map(|bumper| bumper.total_gap_m),
            bumper_stiffness_n_m: model.bumper.as_ref().map(|bumper| bumper.stiffness_n_m),
        }
    }
}
