//! The magnitudes of a rig, from which prior ranges and starting values of effects are derived, so
//! that nothing in the catalogue assumes a specimen of half a tonne and centimetres.

use super::ModelSpec;
use std::f64::consts::TAU;

/// Typical magnitudes of one specimen and its motion. Identification fills them from a record;
/// [`Scales::of_spec`] guesses them from a model alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scales {
    /// Moving mass, kg.
    pub mass_kg: f64,
    /// Amplitude of the relative displacement, m.
    pub displacement_m: f64,
    /// Amplitude of the relative velocity, m/s.
    pub velocity_m_s: f64,
    /// Amplitude of the absolute acceleration, m/s2.
    pub acceleration_m_s2: f64,
    /// Amplitude of the restoring force, N.
    pub force_n: f64,
    /// Frequency of the main oscillation, Hz.
    pub frequency_hz: f64,
    /// Frequency up to which a record moves, Hz; 0 where every model holds so far.
    pub fastest_hz: f64,
    /// Duration of a record, s.
    pub duration_s: f64,
    /// Sample period, s.
    pub sample_period_s: f64,
    /// Total clearance, m; `None` without bumpers.
    pub total_gap_m: Option<f64>,
    /// Stiffness of one bumper, N/m; `None` without bumpers.
    pub bumper_stiffness_n_m: Option<f64>,
    /// Largest penetration of a bumper, m; `None` without bumpers.
    pub penetration_m: Option<f64>,
}

impl Scales {
    /// Magnitudes guessed from the model alone: a motion that fills the gap (or reaches the first
    /// knee) and half as much again.
    pub fn of_spec(spec: &ModelSpec, sample_period_s: f64) -> Self {
        let knee = spec.isolator.breakpoints_m.first().copied();
        let half_gap = spec.bumper.as_ref().map(|b| 0.5 * b.total_gap_m).filter(|gap| *gap > 0.0);
        let displacement_m = 1.5 * half_gap.or(knee).unwrap_or(0.01);
        let stiffness = spec.isolator.stiffness_n_m.first().copied().unwrap_or(0.0);
        let bumper = spec.bumper.as_ref().map_or(0.0, |b| b.stiffness_n_m);
        let stiffest = if stiffness > 0.0 { stiffness } else { bumper };
        let frequency_hz = if stiffest > 0.0 { (stiffest / spec.mass_kg).sqrt() / TAU } else { 1.0 };
        let velocity_m_s = displacement_m * frequency_hz * TAU;
        let acceleration_m_s2 = velocity_m_s * frequency_hz * TAU;
        Self {
            mass_kg: spec.mass_kg,
            displacement_m,
            velocity_m_s,
            acceleration_m_s2,
            force_n: spec.mass_kg * acceleration_m_s2,
            frequency_hz,
            fastest_hz: 0.0,
            duration_s: 500.0 / frequency_hz,
            sample_period_s,
            total_gap_m: spec.bumper.as_ref().map(|b| b.total_gap_m),
            bumper_stiffness_n_m: spec.bumper.as_ref().map(|b| b.stiffness_n_m),
            penetration_m: spec.bumper.as_ref().map(|_| displacement_m / 3.0),
        }
    }

    /// Force over displacement, N/m.
    pub fn stiffness_n_m(&self) -> f64 {
        self.force_n / self.displacement_m
    }

    /// Force over velocity, N s/m.
    pub fn damping_n_s_m(&self) -> f64 {
        self.force_n / self.velocity_m_s
    }

    /// Angular frequency of the main oscillation, rad/s.
    pub fn angular_frequency_rad_s(&self) -> f64 {
        TAU * self.frequency_hz
    }

    /// Stiffness of one bumper, or of the specimen where there is none, N/m.
    pub fn contact_stiffness_n_m(&self) -> f64 {
        self.bumper_stiffness_n_m.filter(|k| *k > 0.0).unwrap_or_else(|| self.stiffness_n_m())
    }

    /// Largest penetration of a bumper, or a third of the motion where there is none, m.
    pub fn contact_depth_m(&self) -> f64 {
        self.penetration_m.filter(|p| *p > 0.0).unwrap_or(self.displacement_m / 3.0)
    }

    /// Coefficient of a contact `F = kh p^n` that presses as the linear bumper does at the usual penetration, N/m^n.
    pub fn contact_coefficient(&self, n: f64) -> f64 {
        self.contact_stiffness_n_m() * self.contact_depth_m().powf(1.0 - n)
    }
}
