//! Second-order Butterworth low-pass, and the same low-pass of the second derivative: the two agree
//! exactly where one signal is the second derivative of the other. Used by the detectors.

use super::butterworth::Section;
use std::f64::consts::{PI, SQRT_2};

/// Second-order low-pass, causal, one sample at a time.
#[derive(Clone, Copy, Debug)]
pub struct LowPass {
    section: Section,
}

impl LowPass {
    /// Corner (-3 dB) at `corner_hz`; kept below half the sampling rate.
    pub fn new(corner_hz: f64, sample_rate_hz: f64) -> Self {
        Self::design(corner_hz, sample_rate_hz, |k| [k * k, 2.0 * k * k, k * k])
    }

    /// The low-pass of the second derivative of its input, per s2: numerator `s^2` in place of `w^2`, the
    /// derivative being that of the bilinear transform.
    pub fn of_second_derivative(corner_hz: f64, sample_rate_hz: f64) -> Self {
        Self::design(corner_hz, sample_rate_hz, |k| {
            let w_squared = (2.0 * sample_rate_hz * k).powi(2);
            [w_squared, -2.0 * w_squared, w_squared]
        })
    }

    fn design(corner_hz: f64, sample_rate_hz: f64, numerator: impl Fn(f64) -> [f64; 3]) -> Self {
        let k = (PI * corner_hz.min(0.49 * sample_rate_hz) / sample_rate_hz).tan();
        let norm = 1.0 / (1.0 + SQRT_2 * k + k * k);
        let a = [2.0 * (k * k - 1.0) * norm, (1.0 - SQRT_2 * k + k * k) * norm];
        Self { section: Section { b: numerator(k).map(|b| b * norm), a, state: [0.0; 2] } }
    }

    /// The next output for the next input.
    pub fn process(&mut self, input: f64) -> f64 {
        self.section.process(input)
    }

    /// Forgets all past input.
    pub fn reset(&mut self) {
        self.section.state = [0.0; 2];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// Amplitude after the start has died away.
    fn gain(mut filter: LowPass, frequency_hz: f64) -> f64 {
        let sine = (0..8192).map(|k| (TAU * frequency_hz * f64::from(k) / 2048.0).sin());
        sine.map(|x| filter.process(x)).skip(4096).fold(0.0, |peak: f64, y| peak.max(y.abs()))
    }

    #[test]
    fn the_corner_is_where_it_should_be() {
        let filter = LowPass::new(30.0, 2048.0);
        assert!((gain(filter, 1.0) - 1.0).abs() < 1e-4);
        assert!((gain(filter, 30.0) - 0.5_f64.sqrt()).abs() < 1e-3);
        assert!((gain(filter, 300.0) - 0.01).abs() < 2e-3);
    }

    #[test]
    fn the_second_derivative_passes_alike() {
        let (plain, twice) = (LowPass::new(10.0, 2048.0), LowPass::of_second_derivative(10.0, 2048.0));
        for frequency_hz in [0.5, 3.0, 10.0, 30.0] {
            let w = TAU * frequency_hz;
            let ratio = gain(twice, frequency_hz) / (w * w * gain(plain, frequency_hz));
            assert!((ratio - 1.0).abs() < 3e-3, "{frequency_hz} Hz: {ratio}");
        }
    }
}
