//! Fundamental and harmonics of whole cycles, by projection with a turning phasor.

use crate::signal::HARMONICS;
use nalgebra::Complex;
use serde::Serialize;
use std::f64::consts::TAU;

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

/// `2/n sum y exp(-i h phi)`, `phi` from `phase_rad` at the first sample on, for h = 1..=N.
pub fn project<const N: usize>(
    samples: &[f64],
    frequency_hz: f64,
    sample_rate_hz: f64,
    phase_rad: f64,
) -> [Complex<f64>; N] {
    let turn = Complex::from_polar(1.0, -TAU * frequency_hz / sample_rate_hz);
    let mut unit = Complex::from_polar(1.0, -phase_rad);
    let mut sums = [Complex::new(0.0, 0.0); N];
    for sample in samples {
        let mut power = unit;
        for sum in &mut sums {
            *sum += power * *sample;
            power *= unit;
        }
        unit *= turn;
    }
    let scale = 2.0 / samples.len().max(1) as f64;
    sums.map(|sum| sum * scale)
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
