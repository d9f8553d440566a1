//! Zero-phase filtering of whole channels in the frequency domain.
//!
//! Used offline only, where the future is known: differentiation, integration and the fusing of
//! channels are exact multiplications there. The ends are extended by odd reflection, so that a
//! channel that starts or ends in motion does not ring.

use super::hann;
use realfft::{RealFftPlanner, num_complex::Complex64};
use std::f64::consts::{PI, TAU};
use std::sync::{Arc, Mutex, PoisonError};

/// Mean square of the window of [`Spectrum::tapered`].
pub const TAPERED: f64 = 1.5;

/// Share of a channel over which [`Spectrum::eased`] lets it rise, and fall.
const EASING: f64 = 0.05;
/// Mean square of the window of [`Spectrum::eased`].
pub const EASED: f64 = 1.0 - 2.0 * EASING * (1.0 - 3.0 / 8.0);
/// Mean fourth power of that window.
pub const EASED_FOURTH: f64 = 1.0 - 2.0 * EASING * (1.0 - 35.0 / 128.0);

/// So many lengths keep their plans: a record's channels have few, and the tables of a long one take as much memory as a channel.
const KEPT: usize = 4;

/// Planners of the lengths last asked for, the newest first; each keeps the plans that it has made.
static PLANNERS: Mutex<Vec<(usize, RealFftPlanner<f64>)>> = Mutex::new(Vec::new());

/// How channels of a length are transformed, there or back.
fn planned<T: ?Sized>(length: usize, plan: fn(&mut RealFftPlanner<f64>, usize) -> Arc<T>) -> Arc<T> {
    let mut kept = PLANNERS.lock().unwrap_or_else(PoisonError::into_inner);
    match kept.iter().position(|(of, _)| *of == length) {
        Some(i) => kept[..=i].rotate_right(1),
        None => kept.insert(0, (length, RealFftPlanner::new())),
    }
    kept.truncate(KEPT);
    plan(&mut kept[0].1, length)
}

/// A real channel as its one-sided spectrum.
pub struct Spectrum {
    /// Bins from 0 to the Nyquist frequency.
    pub bins: Vec<Complex64>,
    samples: usize,
    padding: usize,
    length: usize,
    sample_rate_hz: f64,
    /// Mean square of the window it is seen under.
    window: f64,
}

impl Spectrum {
    /// Spectrum of a channel sampled at `sample_rate_hz`, extended at both ends by up to two
    /// seconds of odd reflection. All channels of one length give bins of the same frequencies.
    pub fn of(channel: &[f64], sample_rate_hz: f64) -> Self {
        let ends = channel.first().zip(channel.last()).map_or((0.0, 0.0), |(first, last)| (*first, *last));
        Self::reflected(channel, sample_rate_hz, ends)
    }

    /// The same of the second derivative of such a channel, reflected about zero: what a channel that is reflected about where it ends
    /// has for one. Both, put together, have no errors of their own where a record ends in motion. The zero is the mean: a sensor may have
    /// its own, and what moves to and fro has next to none.
    pub fn of_second_derivative(channel: &[f64], sample_rate_hz: f64) -> Self {
        let mean = channel.iter().sum::<f64>() / channel.len().max(1) as f64;
        Self::reflected(channel, sample_rate_hz, (mean, mean))
    }

    /// Spectrum of a channel that is reflected about so much at its beginning and its end.
    fn reflected(channel: &[f64], sample_rate_hz: f64, (first, last): (f64, f64)) -> Self {
        let samples = channel.len();
        let padding = ((2.0 * sample_rate_hz) as usize).min(samples.saturating_sub(1));
        let length = fast_length(samples + 2 * padding + padding / 4);
        let mut extended = Vec::with_capacity(length);
        extended.extend((1..=padding).rev().map(|i| 2.0 * first - channel[i]));
        extended.extend_from_slice(channel);
        extended.extend((1..=padding).map(|i| 2.0 * last - channel[samples - 1 - i]));
        // The rest joins the two ends smoothly, and long enough: a channel that ends elsewhere than it began has no noise from that.
        let (tail, head) =
            (extended.last().copied().unwrap_or(0.0), extended.first().copied().unwrap_or(0.0));
        let fill = length - extended.len();
        extended.extend((0..fill).map(|i| {
            let u = (i as f64 + 1.0) / (fill as f64 + 1.0);
            tail + (head - tail) * u * u * (3.0 - 2.0 * u)
        }));
        Self::of_extended(extended, samples, padding, sample_rate_hz)
    }

    /// The same of a channel that is to be integrated: reflected about zero at both ends and faded out there. Reflected about where it
    /// happens to be when the record ends, an oscillation would have a mean beyond, and its integral would run away.
    pub fn fading(channel: &[f64], sample_rate_hz: f64) -> Self {
        let samples = channel.len();
        let padding = ((2.0 * sample_rate_hz) as usize).min(samples.saturating_sub(1));
        let length = fast_length(samples + 2 * padding);
        let fade = |i: usize| 0.5 * (1.0 + (std::f64::consts::PI * i as f64 / (padding as f64 + 1.0)).cos());
        let mut extended = Vec::with_capacity(length);
        extended.extend((1..=padding).rev().map(|i| -fade(i) * channel[i]));
        extended.extend_from_slice(channel);
        extended.extend((1..=padding).map(|i| -fade(i) * channel[samples - 1 - i]));
        extended.resize(length, 0.0);
        Self::of_extended(extended, samples, padding, sample_rate_hz)
    }

    /// Spectrum of a piece of a channel as it is: what goes around beyond its ends is for the caller to make nothing of.
    pub fn of_piece(channel: &[f64], sample_rate_hz: f64) -> Self {
        Self::of_extended(channel.to_vec(), channel.len(), 0, sample_rate_hz)
    }

    /// The same under a Hann window, without its mean: where the motion is and how much noise, without the ends' leakage. Powers are
    /// [`TAPERED`] times those of the channel. All channels of one length give bins of the same frequencies.
    pub fn tapered(channel: &[f64], sample_rate_hz: f64) -> Self {
        Self::under((hann(channel.len()), TAPERED), channel, sample_rate_hz)
    }

    /// The same under a window that is flat but for cosines at its ends (Tukey 1967): where one channel answers to another, it does so
    /// without what a window that grows or falls adds to its damping. Powers are [`EASED`] times those of the channel.
    pub fn eased(channel: &[f64], sample_rate_hz: f64) -> Self {
        let samples = channel.len();
        let ramp = EASING * samples as f64;
        let window = (0..samples).map(|i| {
            let from_end = i.min(samples - 1 - i) as f64 + 0.5;
            if from_end < ramp { 0.5 - 0.5 * (PI * from_end / ramp).cos() } else { 1.0 }
        });
        Self::under((window, EASED), channel, sample_rate_hz)
    }

    /// Without its mean, under a window and its mean square.
    fn under(
        (window, mean_square): (impl Iterator<Item = f64>, f64),
        channel: &[f64],
        sample_rate_hz: f64,
    ) -> Self {
        let samples = channel.len();
        let mean = channel.iter().sum::<f64>() / samples.max(1) as f64;
        let mut seen: Vec<f64> = channel.iter().zip(window).map(|(x, w)| (x - mean) * w).collect();
        seen.resize(fast_length(samples), 0.0);
        Self { window: mean_square, ..Self::of_extended(seen, samples, 0, sample_rate_hz) }
    }

    fn of_extended(mut extended: Vec<f64>, samples: usize, padding: usize, sample_rate_hz: f64) -> Self {
        let length = extended.len();
        let plan = planned(length, RealFftPlanner::plan_fft_forward);
        let mut bins = plan.make_output_vec();
        // The lengths match by construction, so the transform cannot refuse.
        let _ = plan.process(&mut extended, &mut bins);
        Self { bins, samples, padding, length, sample_rate_hz, window: 1.0 }
    }

    /// Number of samples of the channel.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// Sampling rate of the channel, Hz.
    pub fn sample_rate_hz(&self) -> f64 {
        self.sample_rate_hz
    }

    /// Angular frequency of a bin, rad/s.
    pub fn omega_rad_s(&self, bin: usize) -> f64 {
        TAU * self.sample_rate_hz * bin as f64 / self.length as f64
    }

    /// Range of bins between two frequencies, Hz.
    pub fn band(&self, low_hz: f64, high_hz: f64) -> std::ops::Range<usize> {
        let bin = |f: f64| (f * self.length as f64 / self.sample_rate_hz).round().max(0.0) as usize;
        let end = bin(high_hz).min(self.bins.len());
        bin(low_hz).min(end)..end
    }

    /// Multiplies every bin by a function of its angular frequency (rad/s).
    pub fn multiply(mut self, factor: impl Fn(f64) -> Complex64) -> Self {
        for bin in 0..self.bins.len() {
            let omega_rad_s = self.omega_rad_s(bin);
            self.bins[bin] *= factor(omega_rad_s);
        }
        self
    }

    /// Adds another spectrum of the same length.
    #[expect(clippy::should_implement_trait, reason = "takes the other by reference, reads in a chain")]
    pub fn add(mut self, other: &Self) -> Self {
        for (bin, value) in self.bins.iter_mut().zip(&other.bins) {
            *bin += value;
        }
        self
    }

    /// Back to the channel, padding removed.
    pub fn channel(mut self) -> Vec<f64> {
        let range = self.padding..self.padding + self.samples;
        self.inverse()[range].iter().map(|x| x / self.length as f64).collect()
    }

    /// Inverse transform of all bins, without its scale.
    fn inverse(&mut self) -> Vec<f64> {
        let plan = planned(2 * (self.bins.len() - 1), RealFftPlanner::plan_fft_inverse);
        // The inverse of a real channel has real ends; rounding may have left an imaginary part.
        for end in [0, self.bins.len() - 1] {
            self.bins[end].im = 0.0;
        }
        let mut extended = plan.make_output_vec();
        let _ = plan.process(&mut self.bins, &mut extended);
        extended
    }

    /// Back to the channel up to a frequency alone, Hz: its samples at about twice that, their rate, Hz, and by how much the first is later
    /// than the channel's first, s.
    pub fn up_to(mut self, end_hz: f64) -> (Vec<f64>, f64, f64) {
        let bins = self.band(0.0, end_hz).end.clamp(2, self.bins.len());
        let length = 2 * (bins - 1);
        let ratio = length as f64 / self.length as f64;
        self.bins.truncate(bins);
        let extended = self.inverse();
        let scale = 1.0 / self.length as f64;
        let first = (self.padding as f64 * ratio).ceil() as usize;
        let last = ((self.padding + self.samples - 1) as f64 * ratio).floor() as usize;
        let rate_hz = self.sample_rate_hz * ratio;
        let shift_s = first as f64 / rate_hz - self.padding as f64 / self.sample_rate_hz;
        (extended[first..=last].iter().map(|x| x * scale).collect(), rate_hz, shift_s)
    }

    /// RMS that white noise of the channel would have over the whole band, judged from the band between two fractions of the Nyquist
    /// frequency, by the median of the bins (lines do not count).
    pub fn white_noise_rms(&self, low: f64, high: f64) -> f64 {
        let nyquist = self.sample_rate_hz / 2.0;
        let mut power: Vec<f64> =
            self.bins[self.band(low * nyquist, high * nyquist)].iter().map(|z| z.norm_sqr()).collect();
        if power.is_empty() {
            return 0.0;
        }
        let middle = power.len() / 2;
        let (_, median, _) = power.select_nth_unstable_by(middle, f64::total_cmp);
        // |X|^2 of white noise is exponential with mean N sigma^2, and its median is ln 2 of the mean.
        (*median / std::f64::consts::LN_2 / self.noisy()).sqrt() / self.window.sqrt()
    }

    /// Mean power of a bin that shows nothing but white noise of the channel, rms: N sigma^2 of the window's mean square.
    pub fn white_noise_power(&self, rms: f64) -> f64 {
        self.noisy() * self.window * rms * rms
    }

    /// Samples that have noise of their own, or that of others as their reflection.
    fn noisy(&self) -> f64 {
        (self.samples + 2 * self.padding) as f64
    }
}

/// A copy for another factor.
impl Clone for Spectrum {
    fn clone(&self) -> Self {
        Self { bins: self.bins.clone(), ..*self }
    }
}

/// The next even length with no prime factor above 5.
pub fn fast_length(at_least: usize) -> usize {
    let mut length = at_least.max(2).next_multiple_of(2);
    loop {
        let mut rest = length;
        for prime in [2, 3, 5] {
            while rest.is_multiple_of(prime) {
                rest /= prime;
            }
        }
        if rest == 1 {
            return length;
        }
        length += 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differentiation_is_exact_for_a_sine_that_is_cut_anywhere() {
        let rate = 512.0;
        let w = TAU * 1.3;
        let x: Vec<f64> = (0..6000).map(|i| (w * i as f64 / rate).sin()).collect();
        let v = Spectrum::of(&x, rate).multiply(|omega| Complex64::new(0.0, omega)).channel();
        for (i, v) in v.iter().enumerate().take(4500).skip(1500) {
            let exact = w * (w * i as f64 / rate).cos();
            assert!((v - exact).abs() < 2e-3 * w, "{i}: {v} {exact}");
        }
    }

    #[test]
    fn noise_is_judged_beside_lines() {
        use rand::{SeedableRng, prelude::Distribution};
        let mut random = rand_pcg::Pcg64::seed_from_u64(3);
        let normal = rand_distr::Normal::new(0.0, 0.02).expect("valid");
        let x: Vec<f64> = (0..40_000).map(|i| (i as f64 * 0.01).sin() + normal.sample(&mut random)).collect();
        let rms = Spectrum::of(&x, 2048.0).white_noise_rms(0.3, 0.9);
        assert!((rms / 0.02 - 1.0).abs() < 0.05, "{rms}");
        let tapered = Spectrum::tapered(&x, 2048.0).white_noise_rms(0.3, 0.9);
        assert!((tapered / 0.02 - 1.0).abs() < 0.05, "{tapered}");
    }
}
