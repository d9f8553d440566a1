//! Second-order Butterworth band-pass as two biquads, designed by the pre-warped bilinear transform.
//!
//! Second order means two poles at each edge (12 dB an octave), as in `scipy.signal.butter(2, ...)`.
//! Analogue prototype and transforms: Oppenheim and Schafer, Discrete-Time Signal Processing, 3rd ed.,
//! sections 7.2-7.3 and appendix B.

use super::{BAND_HIGH_HZ, BAND_LOW_HZ};
use nalgebra::Complex;
use std::f64::consts::{FRAC_PI_4, PI, TAU};

/// One second-order section, transposed direct form II.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Section {
    /// Numerator, powers 0, -1, -2 of z.
    pub(super) b: [f64; 3],
    /// Denominator, powers -1, -2 of z (that of 0 is 1).
    pub(super) a: [f64; 2],
    pub(super) state: [f64; 2],
}

impl Section {
    pub(super) fn process(&mut self, x: f64) -> f64 {
        let y = self.b[0] * x + self.state[0];
        self.state[0] = self.b[1] * x - self.a[0] * y + self.state[1];
        self.state[1] = self.b[2] * x - self.a[1] * y;
        y
    }

    fn response(&self, z: Complex<f64>) -> Complex<f64> {
        let q = z.inv();
        let one = Complex::new(1.0, 0.0);
        (one * self.b[0] + q * self.b[1] + q * q * self.b[2]) / (one + q * self.a[0] + q * q * self.a[1])
    }
}

/// Second-order Butterworth band-pass, causal, one sample at a time.
#[derive(Clone, Copy, Debug)]
pub struct BandPass {
    /// The lower edge: both zeros at zero frequency.
    low: Section,
    /// The upper edge: both zeros at half the sampling rate.
    high: Section,
    sample_rate_hz: f64,
}

impl BandPass {
    /// Pass band `low_hz` to `high_hz` (-3 dB) at `sample_rate_hz`. Edges are kept inside
    /// (0, `sample_rate_hz`/2) and in order; configuration is checked before it comes here.
    pub fn new(low_hz: f64, high_hz: f64, sample_rate_hz: f64) -> Self {
        let top_hz = high_hz.clamp(1e-6 * sample_rate_hz, 0.499 * sample_rate_hz);
        let bottom_hz = low_hz.clamp(1e-7 * sample_rate_hz, 0.99 * top_hz);
        // Angular frequencies in units of twice the sampling rate: s = (z - 1)/(z + 1).
        let warp = |hz: f64| (PI * hz / sample_rate_hz).tan();
        let (w1, w2) = (warp(bottom_hz), warp(top_hz));
        let (centre_squared, width) = (w1 * w2, w2 - w1);
        // One pole of the low-pass prototype in the upper half plane gives two of the band-pass; the
        // conjugates follow.
        let prototype = Complex::from_polar(1.0, 3.0 * FRAC_PI_4);
        let half = prototype * (0.5 * width);
        let root = (half * half - Complex::new(centre_squared, 0.0)).sqrt();
        let (p, q) = (half + root, half - root);
        let (slow, fast) = if p.norm() < q.norm() { (p, q) } else { (q, p) };
        let centre = Complex::from_polar(1.0, 2.0 * centre_squared.sqrt().atan());
        Self {
            low: section(slow, [1.0, -2.0, 1.0], centre),
            high: section(fast, [1.0, 2.0, 1.0], centre),
            sample_rate_hz,
        }
    }

    /// The paper's band-pass, 0.16-30 Hz.
    pub fn paper(sample_rate_hz: f64) -> Self {
        Self::new(BAND_LOW_HZ, BAND_HIGH_HZ, sample_rate_hz)
    }

    /// The next output for the next input.
    pub fn process(&mut self, input: f64) -> f64 {
        self.high.process(self.low.process(input))
    }

    /// Forgets all past input.
    pub fn reset(&mut self) {
        self.low.state = [0.0; 2];
        self.high.state = [0.0; 2];
    }

    /// Complex response at a frequency in Hz.
    pub fn response(&self, frequency_hz: f64) -> Complex<f64> {
        let z = Complex::from_polar(1.0, TAU * frequency_hz / self.sample_rate_hz);
        self.low.response(z) * self.high.response(z)
    }
}

/// The section with an analogue pole and its conjugate, scaled to unit magnitude at `centre` (on the
/// unit circle): a Butterworth band-pass passes its centre with gain 1.
fn section(pole: Complex<f64>, zeros: [f64; 3], centre: Complex<f64>) -> Section {
    let one = Complex::new(1.0, 0.0);
    let z = (one + pole) / (one - pole);
    let mut section = Section { b: zeros, a: [-2.0 * z.re, z.norm_sqr()], state: [0.0; 2] };
    let gain = section.response(centre).norm();
    section.b = section.b.map(|b| b / gain);
    section
}

/// The same band-pass for several channels, so that all of them are delayed alike.
#[derive(Clone, Copy, Debug)]
pub struct FilterBank<const N: usize> {
    filters: [BandPass; N],
}

impl<const N: usize> FilterBank<N> {
    /// N copies of a filter at rest.
    pub fn new(filter: BandPass) -> Self {
        Self { filters: [filter; N] }
    }

    /// The next outputs for the next inputs.
    pub fn process(&mut self, inputs: &[f64; N]) -> [f64; N] {
        let mut outputs = [0.0; N];
        for ((output, input), filter) in outputs.iter_mut().zip(inputs).zip(&mut self.filters) {
            *output = filter.process(*input);
        }
        outputs
    }

    /// Forgets all past input.
    pub fn reset(&mut self) {
        self.filters.iter_mut().for_each(BandPass::reset);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// SciPy 1.17.1:
    /// `sos = scipy.signal.butter(2, [0.16, 30.0], 'bandpass', fs=2048.0, output='sos')`
    /// `w, h = scipy.signal.freqz_sos(sos, worN=f, fs=2048.0)`, rows (f, h.real, h.imag).
    const SCIPY_RESPONSE: [(f64, f64, f64); 10] = [
        (0.05, -8.655455001451301e-02, 4.214414203015969e-02),
        (0.16, -2.044974563419e-10, 7.071067814946863e-01),
        (0.5, 8.992145855545085e-01, 4.275944607845504e-01),
        (1.3, 9.935266283991112e-01, 1.134172222622766e-01),
        (2.19089023, 9.999999973745016e-01, 7.252955520844349e-05),
        (5.0, 9.813723721555252e-01, -1.912420597960935e-01),
        (15.0, 7.163697736137017e-01, -6.569581348929163e-01),
        (30.0, 2.950855618003989e-16, -7.071067811865439e-01),
        (100.0, -7.952402427186273e-02, -3.654580651908566e-02),
        (400.0, -4.212452912997973e-03, -3.891196780724785e-04),
    ];

    #[test]
    fn the_response_is_that_of_scipy() {
        let filter = BandPass::paper(2048.0);
        for (hz, re, im) in SCIPY_RESPONSE {
            let difference = (filter.response(hz) - Complex::new(re, im)).norm();
            assert!(difference < 2e-9, "{hz} Hz: off by {difference:e}");
        }
    }

    /// `n = numpy.arange(4096); x = (n < 10) + 0.3*numpy.sin(2*numpy.pi*1.7*n/2048.0)`,
    /// `y = scipy.signal.sosfilt(sos, x)`, rows (i, y[i]).
    const SCIPY_OUTPUT: [(usize, f64); 8] = [
        (0, 1.966662356862454e-3),
        (1, 9.581919369807134e-03),
        (9, 2.475104144961104e-01),
        (10, 2.866866885757856e-01),
        (100, 1.174030354311385e-01),
        (1000, -2.861159167019331e-01),
        (2500, 1.377822083929625e-01),
        (4095, 1.628374011085571e-01),
    ];

    #[test]
    fn the_output_is_that_of_scipy() {
        let mut filter = BandPass::paper(2048.0);
        let output: Vec<f64> = (0..4096)
            .map(|n| {
                let sine = 0.3 * (TAU * 1.7 * f64::from(n) / 2048.0).sin();
                filter.process(f64::from(u8::from(n < 10)) + sine)
            })
            .collect();
        for (i, expected) in SCIPY_OUTPUT {
            assert!((output[i] - expected).abs() < 1e-9, "{i}: {} for {expected}", output[i]);
        }
    }

    #[test]
    fn a_constant_vanishes_and_stays_away() {
        let mut filter = BandPass::paper(2048.0);
        let minute = 60 * 2048;
        let last = (0..minute).map(|_| filter.process(9.81)).last().expect("samples");
        assert!(last.abs() < 1e-8, "{last:e}");
    }
}
