//! Fundamental and harmonics of whole cycles, by projection with a turning phasor.

use crate::signal::{HARMONICS, project};
use serde::Serialize;

/// One harmonic of a channel: measured, modelled, and what is left between them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct HarmonicMisfit {
    /// 1 for the fundamental.
    pub order: usize,
    /// Measured amplitude, unit of the channel.
    pub measured: f64,
    /// Amplitude of the model.
    pub model: f64,
    /// Amplitude of the difference, phase included.
    pub residual: f64,
    /// Model against measurement, rad; positive when the model leads.
    pub phase_error_rad: f64,
}

/// Harmonics of a measured channel and its model over the same whole cycles.
pub fn misfit(
    measured: &[f64],
    model: &[f64],
    frequency_hz: f64,
    sample_rate_hz: f64,
) -> Vec<HarmonicMisfit> {
    let a = project::<HARMONICS>(measured, frequency_hz, sample_rate_hz, 0.0);
    let b = project::<HARMONICS>(model, frequency_hz, sample_rate_hz, 0.0);
    a.iter()
        .zip(&b)
        .enumerate()
        .map(|(i, (measured, model))| HarmonicMisfit {
            order: i + 1,
            measured: measured.norm(),
            model: model.norm(),
            residual: (measured - model).norm(),
            phase_error_rad: (model * measured.conj()).arg(),
        })
        .collect()
}
