//! A record in memory, as comparison, identification and diagnosis read it, wherever it came from.

use serde::{Deserialize, Serialize};

/// What was imposed and what was measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Table acceleration in; relative displacement and absolute acceleration out.
    Base,
    /// Applied force in; displacement and/or acceleration out.
    Force,
    /// Imposed displacement in, force out: a damper or a bumper on its own.
    Component,
}

/// Uniformly sampled channels, SI. Every present channel has the length of `time_s`; an absent one
/// is empty.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Where it came from, for messages.
    pub source: String,
    /// What was imposed and what was measured.
    pub kind: Kind,
    /// Sampling rate, Hz.
    pub sample_rate_hz: f64,
    /// Time of each sample, s.
    pub time_s: Vec<f64>,
    /// Table displacement, m (`base`).
    pub table_displacement_m: Vec<f64>,
    /// Table acceleration, m/s2 (`base`).
    pub table_acceleration_m_s2: Vec<f64>,
    /// First accelerometer on the mass, m/s2 (`base`).
    pub mass_acceleration_1_m_s2: Vec<f64>,
    /// Second accelerometer on the mass, m/s2 (`base`).
    pub mass_acceleration_2_m_s2: Vec<f64>,
    /// Relative displacement, m (`base`: laser).
    pub relative_displacement_m: Vec<f64>,
    /// Force, N (`force`: applied; `component`: measured).
    pub force_n: Vec<f64>,
    /// Displacement, m (`force`: measured; `component`: imposed).
    pub displacement_m: Vec<f64>,
    /// Acceleration, m/s2 (`force`: measured).
    pub acceleration_m_s2: Vec<f64>,
    /// Index of the sweep step of each sample, -1 between steps.
    pub step: Vec<i32>,
    /// What was repaired or noticed while reading.
    pub notes: Vec<String>,
}
