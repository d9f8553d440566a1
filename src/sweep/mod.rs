//! The command to the table: schedule of steps, smooth transitions, ramps, preview.

/// Where in the sweep one sample is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepPhase {
    /// Index of the step in the whole schedule, from 0.
    pub index: u32,
    /// Sweep direction of this step.
    pub direction: Direction,
    /// Frequency of the step, Hz.
    pub frequency_hz: f64,
    /// Commanded peak acceleration A_G, m/s2.
    pub acceleration_amplitude_m_s2: f64,
    /// Phase of the command within the step, rad, from 0; `a = A_G sin(phase)`.
    pub phase_rad: f64,
    /// True within the counted cycles; false in ramps and transitions.
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
