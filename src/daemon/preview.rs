//! What a sweep asks of the table, as the page and the interface show it, and what the onboard model expects
//! of it (the dry run).

use crate::control::StepDirection;
use crate::control::setup::{Setup, SetupError};
use crate::model::{ModelError, Options, simulate_sweep};
use crate::sweep::{Preview, PreviewRow, Step};
use serde::Serialize;
use utoipa::ToSchema;

/// Use of one of the table's limits.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Use {
    /// What is limited.
    pub quantity: &'static str,
    /// Unit of the two values.
    pub unit: &'static str,
    /// What the sweep asks at most.
    pub asked: f64,
    /// What the table gives.
    pub allowed: f64,
    /// Their ratio.
    pub used: f64,
    /// Where it asks for most.
    pub frequency_hz: f64,
    /// In a step, on the way into it, in a ramp.
    pub place: &'static str,
}

/// Peaks of one segment of the command.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub struct Asked {
    /// Index of the step.
    pub index: u32,
    /// Its frequency, Hz.
    pub frequency_hz: f64,
    /// Its direction.
    #[schema(value_type = String)]
    pub direction: StepDirection,
    /// Step, transition or ramp.
    pub place: &'static str,
    /// Displacement, m.
    pub displacement_m: f64,
    /// Velocity, m/s.
    pub velocity_m_s: f64,
    /// Acceleration, m/s2.
    pub acceleration_m_s2: f64,
    /// Jerk, m/s3.
    pub jerk_m_s3: f64,
    /// Force, N.
    pub force_n: f64,
}

/// A sweep against the table.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Asks {
    /// It stays within the table's limits.
    pub fits: bool,
    /// The first limit that it exceeds, in words.
    pub refused: Option<String>,
    /// Number of steps.
    pub steps: usize,
    /// From rest to rest, s.
    pub duration_s: f64,
    /// The limits and how far they are used.
    pub uses: Vec<Use>,
    /// All segments.
    pub rows: Vec<Asked>,
}

/// What the onboard model expects of one step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub struct Expected {
    /// Index of the step.
    pub index: u32,
    /// Its frequency, Hz.
    pub frequency_hz: f64,
    /// Its direction.
    #[schema(value_type = String)]
    pub direction: StepDirection,
    /// Peak acceleration of the mass, m/s2.
    pub a_max_m_s2: f64,
    /// Excursion, m.
    pub excursion_m: f64,
}

/// The limits and how far they are used.
pub fn uses(preview: &Preview) -> Vec<Use> {
    let used = |quantity: &crate::sweep::Quantity| {
        let (asked, row) = preview.worst(quantity)?;
        let allowed = (quantity.allowed)(preview.capacity());
        Some(Use {
            quantity: quantity.name,
            unit: quantity.unit,
            asked: asked * quantity.scale,
            allowed: allowed * quantity.scale,
            used: asked / allowed,
            frequency_hz: row.step.frequency_hz,
            place: row.place,
        })
    };
    Preview::quantities().iter().filter_map(used).collect()
}

/// What a sweep asks.
///
/// # Errors
/// [`SetupError`] when the sweep itself is refused; that it exceeds the table is in the answer.
pub fn asks(setup: &Setup) -> Result<Asks, SetupError> {
    let preview = setup.preview()?;
    let schedule = setup.schedule()?;
    let refused = preview.check().err().map(|error| error.to_string());
    let row = |row: &PreviewRow| Asked {
        index: row.step.index,
        frequency_hz: row.step.frequency_hz,
        direction: row.step.direction.into(),
        place: row.place,
        displacement_m: row.peak.displacement_m,
        velocity_m_s: row.peak.velocity_m_s,
        acceleration_m_s2: row.peak.acceleration_m_s2,
        jerk_m_s3: row.peak.jerk_m_s3,
        force_n: row.force_n,
    };
    Ok(Asks {
        fits: refused.is_none(),
        refused,
        steps: schedule.steps().len(),
        duration_s: schedule.duration_s(),
        uses: uses(&preview),
        rows: preview.rows().iter().map(row).collect(),
    })
}

/// What a model expects of the steps of a sweep, on an ideal table.
///
/// # Errors
/// [`ModelError`] when the model cannot be solved.
pub fn expected(
    model: &crate::model::ModelSpec,
    steps: &[Step],
    sample_rate_hz: f64,
) -> Result<Vec<Expected>, ModelError> {
    let response = simulate_sweep(
        model,
        steps,
        1.0 / sample_rate_hz,
        &Options { tolerance: 1e-6 },
        &mut |_, _, _, _| {},
    )?;
    let pair = steps.iter().zip(&response.peaks);
    Ok(pair
        .map(|(step, peaks)| Expected {
            index: step.index,
            frequency_hz: step.frequency_hz,
            direction: step.direction.into(),
            a_max_m_s2: peaks.a_max_m_s2,
            excursion_m: peaks.excursion_m(),
        })
        .collect())
}
