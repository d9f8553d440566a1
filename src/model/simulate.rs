//! Whole histories in one call: a model driven by sampled table acceleration.
//! Identification, comparison and the command line call it.

use super::{ModelError, ModelSpec, Regime, Response, build};

/// Columns of a simulated history, one entry a sample, SI.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct History {
    /// Relative displacement D, m.
    pub relative_displacement_m: Vec<f64>,
    /// Its rate, m/s.
    pub relative_velocity_m_s: Vec<f64>,
    /// Absolute acceleration of the mass A, m/s2.
    pub mass_acceleration_m_s2: Vec<f64>,
    /// Right contact force, N.
    pub right_contact_force_n: Vec<f64>,
    /// Left contact force, N.
    pub left_contact_force_n: Vec<f64>,
    /// Branch, contact and friction state.
    pub regime: Vec<Regime>,
}

impl History {
    /// Empty columns with room for a number of samples.
    pub fn with_capacity(samples: usize) -> Self {
        Self {
            relative_displacement_m: Vec::with_capacity(samples),
            relative_velocity_m_s: Vec::with_capacity(samples),
            mass_acceleration_m_s2: Vec::with_capacity(samples),
            right_contact_force_n: Vec::with_capacity(samples),
            left_contact_force_n: Vec::with_capacity(samples),
            regime: Vec::with_capacity(samples),
        }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.regime.len()
    }

    /// No samples.
    pub fn is_empty(&self) -> bool {
        self.regime.is_empty()
    }

    /// Appends one response.
    pub fn push(&mut self, response: &Response) {
        self.relative_displacement_m.push(response.relative_displacement_m);
        self.relative_velocity_m_s.push(response.relative_velocity_m_s);
        self.mass_acceleration_m_s2.push(response.mass_acceleration_m_s2);
        self.right_contact_force_n.push(response.right_contact_force_n);
        self.left_contact_force_n.push(response.left_contact_force_n);
        self.regime.push(response.regime);
    }
}

/// Response from rest to a table acceleration (m/s2) sampled every `dt_s` s and running linearly
/// between samples (from 0 one period before the first).
///
/// # Errors
/// [`ModelError`] as [`build`].
pub fn simulate_sampled(
    spec: &ModelSpec,
    dt_s: f64,
    table_acceleration_m_s2: &[f64],
) -> Result<History, ModelError> {
    simulate_from(spec, dt_s, table_acceleration_m_s2, None)
}

/// [`simulate_sampled`] from an initial D (m) and D' (m/s), the table acceleration held before its
/// first value; from rest without.
///
/// # Errors
/// [`ModelError`] as [`build`].
pub fn simulate_from(
    spec: &ModelSpec,
    dt_s: f64,
    table_acceleration_m_s2: &[f64],
    initial: Option<(f64, f64)>,
) -> Result<History, ModelError> {
    let mut specimen = build(spec, dt_s)?;
    if let Some((displacement_m, velocity_m_s)) = initial {
        specimen.impose(displacement_m, velocity_m_s);
    }
    let mut history = History::with_capacity(table_acceleration_m_s2.len());
    for a in table_acceleration_m_s2 {
        history.push(&specimen.step(*a));
    }
    Ok(history)
}
