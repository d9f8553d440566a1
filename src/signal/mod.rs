//! Causal, per-sample signal processing: band-pass, steady-state peaks, synchronous demodulation.
//!
//! The control step pushes every sample through a [`FilterBank`] and a [`StepAnalyzer`]; nothing of
//! them allocates after construction. [`analyse_record`] runs the same code over a record that was
//! read from a file. Raw channels are what is stored; everything here is derived from them.

mod analyzer;
mod butterworth;
mod low_pass;
pub(crate) mod offline;
mod spectrum;
mod table_motion;

pub use analyzer::{ChannelResult, CyclePlace, HARMONICS, Harmonic, MAX_CYCLES, StepAnalyzer, StepResult};
pub use butterworth::{BandPass, FilterBank};
pub use low_pass::LowPass;
pub use offline::{RecordStep, analyse_record, band_pass, fundamental_hz, hann, project};
pub(crate) use offline::{cycles_hz, rising, step_cycles_hz};
pub use spectrum::{EASED, EASED_FOURTH, Spectrum, TAPERED, fast_length};
pub use table_motion::{TableMotion, TableNoise, table_acceleration, table_noise};

/// Lower corner of the paper's band-pass, Hz (Andreaus and De Angelis 2020).
pub const BAND_LOW_HZ: f64 = 0.16;
/// Upper corner of the paper's band-pass, Hz.
pub const BAND_HIGH_HZ: f64 = 30.0;
/// Cycles at the end of a step that count as its steady state.
pub const STEADY_CYCLES: usize = 3;
