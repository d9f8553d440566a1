//! Zero-phase filtering of whole channels in the frequency domain.
//!
//! Used offline only, where the future is known: differentiation, integration and the fusing of
//! channels are exact multiplications there. The ends are extended by odd reflection, so that a
//! channel that starts or ends in motion does not ring.

use crate::signal::hann;
use realfft::{RealFftPlanner, num_complex::Complex64};
use std::f64::consts::TAU;

/// A real channel as its one-sided spectrum.
pub struct Spectrum {
    /// Bins from 0 to the Nyquist frequency.
    pub bins: Vec<Complex64>,
    samples: usize,
    padding: usize,
    length: usize,
    sample_rate_hz: f64,
}

impl Spectrum {
    /// Spectrum of a channel sampled at `sample_rate_hz`, extended at both ends by up to two
    /// seconds of odd reflection. All channels of one length give bins of the same frequencies.
    pub fn of(channel: &[f64], sample_rate_hz: f64) -> Self {
        let samples = channel.len();
        let padding = ((2.0 * sample_rate_hz) as usize).min(samples.saturating_sub(1));
        let length = fast_length(samples + 2 * padding + padding / 4);
        let mut extended = Vec::with_capacity(length);
        let (first, last) = match (channel.first(), channel.last()) {
            (Some(first), Some(last)) => (*first, *last),
            _ => (0.0, 0.0),
        };
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

    fn of_extended(mut extended: Vec<f64>, samples: usize, padding: usize, sample_rate_hz: f64) -> Self {
        let length = extended.len();
        let plan = RealFftPlanner::<f64>::new().plan_fft_forward(length);
        let mut bins = plan.make_output_vec();
        // The lengths match by construction, so the transform cannot refuse.
        let _ = plan.process(&mut extended, &mut bins);
        Self { bins, samples, padding, length, sample_rate_hz }
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
        let plan = RealFftPlanner::<f64>::new().plan_fft_inverse(self.length);
        // The inverse of a real channel has real ends; rounding may have left an imaginary part.
        for end in [0, self.bins.len() - 1] {
            self.bins[end].im = 0.0;
        }
        let mut extended = plan.make_output_vec();
        let _ = plan.process(&mut self.bins, &mut extended);
        let scale = 1.0 / self.length as f64;
        extended[self.padding..self.padding + self.samples].iter().map(|x| x * scale).collect()
    }
}

/// A copy for another factor.
impl Clone for Spectrum {
    fn clone(&self) -> Self {
        Self { bins: self.bins.clone(), ..*self }
    }
}

/// The next even length with no prime factor above 5.
fn fast_length(at_least: usize) -> usize {
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

/// RMS that white noise would have over the whole band, judged from the band between two
/// fractions of the Nyquist frequency, by the median of the bins (lines do not count).
pub fn white_noise_rms(spectrum: &Spectrum, low: f64, high: f64) -> f64 {
    let nyquist = spectrum.sample_rate_hz / 2.0;
    let mut power: Vec<f64> =
        spectrum.bins[spectrum.band(low * nyquist, high * nyquist)].iter().map(|z| z.norm_sqr()).collect();
    if power.is_empty() {
        return 0.0;
    }
    let middle = power.len() / 2;
    let (_, median, _) = power.select_nth_unstable_by(middle, f64::total_cmp);
    // |X|^2 of white noise is exponential with mean N sigma^2, and its median is ln 2 of the mean.
    let noisy = spectrum.samples + 2 * spectrum.padding;
    (*median / std::f64::consts::LN_2 / noisy as f64).sqrt()
}

/// Samples of a stretch of [`stretches_noise_rms`], and stretches at most.
const STRETCH: usize = 4096;
const STRETCHES: usize = 32;

/// Parts of the upper band, over the Nyquist frequency: the quietest but one tells the noise, which a harmonic may fill in another, or a
/// filter have taken out.
const PARTS_OF_BAND: [(f64, f64); 5] = [(0.6, 0.67), (0.67, 0.74), (0.74, 0.81), (0.81, 0.88), (0.88, 0.95)];

/// Expected value of the second of five normal deviates, and its standard deviation (order statistics: David and Nagaraja 2003).
const SECOND_OF_FIVE: [f64; 2] = [-0.495, 0.56];

/// Stretches of a channel that overlap by half, so many samples each: every how many are looked at, and how many that is.
fn stretches(samples: usize) -> (usize, usize, usize) {
    let length = STRETCH.min(samples);
    let there = samples.saturating_sub(length) / (length / 2).max(1) + 1;
    let every = there.div_ceil(STRETCHES);
    (length, every, there.div_ceil(every))
}

/// Standard deviation of what one part of the band tells of the noise of a channel with so many samples, over the noise: a median of
/// powers, of bins that the taper makes some alike, and of stretches that overlap.
fn part_sigma(samples: usize) -> f64 {
    let (length, _, looked_at) = stretches(samples);
    let bins = (PARTS_OF_BAND[0].1 - PARTS_OF_BAND[0].0) * length as f64 / 2.0;
    let independent = bins / 1.5 * (1.0 + 0.5 * (looked_at as f64 - 1.0));
    0.5 / std::f64::consts::LN_2 / independent.max(1.0).sqrt()
}

/// Standard deviation of [`stretches_noise_rms`] of a channel with so many samples, over the noise.
pub fn stretches_noise_sigma(samples: usize) -> f64 {
    SECOND_OF_FIVE[1] * part_sigma(samples)
}

/// The same from the upper band of stretches of a channel, the median over them: a jump, or a test that follows another, belongs to one.
pub fn stretches_noise_rms(channel: &[f64], sample_rate_hz: f64) -> f64 {
    let (length, every, _) = stretches(channel.len());
    let plan = RealFftPlanner::<f64>::new().plan_fft_forward(length.max(1));
    // Tapered, a stretch begins and ends with nothing; 1.5 is the mean square of the window.
    let tapered = |chunk: &[f64]| {
        let mean = chunk.iter().sum::<f64>() / length as f64;
        let mut tapered: Vec<f64> = chunk.iter().zip(hann(length)).map(|(x, w)| (x - mean) * w).collect();
        let mut bins = plan.make_output_vec();
        let _ = plan.process(&mut tapered, &mut bins);
        let spectrum = Spectrum { bins, samples: length, padding: 0, length, sample_rate_hz };
        PARTS_OF_BAND.map(|(low, high)| white_noise_rms(&spectrum, low, high) / 1.5_f64.sqrt())
    };
    let stretches = channel.windows(length.max(1)).step_by((length / 2).max(1)).step_by(every);
    let told: Vec<_> = stretches.map(tapered).collect();
    let mut parts = [0, 1, 2, 3, 4].map(|part| {
        let mut of_part: Vec<f64> = told.iter().map(|parts| parts[part]).collect();
        of_part.sort_by(f64::total_cmp);
        let middle = [of_part.len().saturating_sub(1) / 2, of_part.len() / 2];
        0.5 * middle.into_iter().filter_map(|i| of_part.get(i)).sum::<f64>()
    });
    parts.sort_by(f64::total_cmp);
    parts[1] / (1.0 + SECOND_OF_FIVE[0] * part_sigma(channel.len())).max(0.5)
}

/// Stiffness over mass (1/s2) that a force over the mass and the displacement that it makes show together.
pub fn held_1_s2(force_m_s2: &[f64], displacement_m: &[f64], sample_rate_hz: f64) -> f64 {
    let [force, motion] = [force_m_s2, displacement_m].map(|channel| Spectrum::of(channel, sample_rate_hz));
    let (mut sum, mut power) = (0.0, 0.0);
    for (bin, (f, d)) in force.bins.iter().zip(&motion.bins).enumerate().skip(1) {
        let w = motion.omega_rad_s(bin);
        sum += ((f + d * (w * w)) * d.conj()).re;
        power += d.norm_sqr();
    }
    (sum / power.max(f64::MIN_POSITIVE)).max(0.0)
}

/// Part of the band, up to its end, in which a band-limited channel has next to nothing, and what share of its power that is at most.
const UPPER: f64 = 0.8;
const NEXT_TO_NOTHING: f64 = 0.02;

/// What a solver that joins samples by straight lines is to be given so that the mass that it drives moves, at each sample, as the
/// band-limited signal that was sampled would move it: lines weaken a frequency f by sinc(f/rate)^2, and what they add around multiples of
/// the rate is seen at f again, when the motion is sampled, as a mass answers it there, by its inertia, over how it answers f, held by a
/// stiffness over the mass (1/s2) (Unser 2000, Sampling - 50 years after Shannon). A channel that fills the whole band is no sampled band-limited signal, and is left as it is.
pub fn along_straight_lines(channel: &[f64], sample_rate_hz: f64, held_1_s2: f64) -> Vec<f64> {
    let spectrum = Spectrum::of(channel, sample_rate_hz);
    let power = |bins: &[Complex64]| bins.iter().map(|z| z.norm_sqr()).sum::<f64>();
    let upper = (UPPER * spectrum.bins.len() as f64) as usize;
    if power(&spectrum.bins[upper..]) > NEXT_TO_NOTHING * power(&spectrum.bins[1..]) {
        return channel.to_vec();
    }
    let passed = |w: f64| {
        let x = 0.5 * w / sample_rate_hz;
        if x == 0.0 {
            return 1.0;
        }
        let sinc = (x.sin() / x).powi(2);
        // The sum of sinc(f/rate + k)^2 over (1 + k rate/f)^2, all k but 0.
        let others = (1.0 - 2.0 / 3.0 * x.sin().powi(2)) / sinc - sinc;
        sinc + others * (1.0 - held_1_s2 / (w * w))
    };
    spectrum.multiply(|w| Complex64::from(1.0 / passed(w))).channel()
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
    fn a_mass_driven_along_straight_lines_moves_as_the_signal_would_move_it() {
        // A unit mass that nothing holds, from sample to sample in closed form; its steady motion against -sin/w2.
        let (rate, n) = (100.0, 4000);
        for turn in [0.1, 0.8, 1.9] {
            let x: Vec<f64> = (0..n).map(|i| (turn * f64::from(i)).sin()).collect();
            let size = |x: &[f64]| {
                let second: Vec<f64> =
                    x.windows(3).map(|w| (w[0] + 4.0 * w[1] + w[2]) / 6.0 / (rate * rate)).collect();
                // Second differences of the motion; those of the signal's are -(2 sin(turn/2)/w)^2 of it.
                let (sum, of) = (500..3500).fold((0.0, 0.0), |(sum, of), i| {
                    let sine = (turn * (i as f64 + 1.0)).sin();
                    (sum + second[i] * sine, of + sine * sine)
                });
                sum / of / (2.0 * (0.5 * turn).sin() / (turn * rate)).powi(2)
            };
            let left_alone = size(&x);
            assert!(left_alone < 1.0 - 0.06 * turn * turn, "{turn}: {left_alone}");
            let made_up_for = size(&along_straight_lines(&x, rate, 0.0));
            assert!((made_up_for - 1.0).abs() < 1e-3, "{turn}: {made_up_for}");
        }
        let filled: Vec<f64> = (0..1000).map(|i| f64::from(i * 7919 % 1009) - 504.0).collect();
        assert_eq!(along_straight_lines(&filled, rate, 0.0), filled);
    }

    #[test]
    fn stretches_tell_noise_beside_a_strong_signal_and_jumps() {
        use rand::{SeedableRng, prelude::Distribution};
        let mut random = rand_pcg::Pcg64::seed_from_u64(3);
        let normal = rand_distr::Normal::new(0.0, 1e-3).expect("valid");
        let x: Vec<f64> = (0..32_768)
            .map(|i| (f64::from(i) * 0.7).sin() + f64::from(i / 10_000) + normal.sample(&mut random))
            .collect();
        let rms = stretches_noise_rms(&x, 600.0);
        assert!((rms / 1e-3 - 1.0).abs() < 0.05, "{rms}");
    }

    #[test]
    fn noise_of_a_short_channel_is_told_as_well_as_is_said() {
        use rand::{SeedableRng, prelude::Distribution};
        let mut random = rand_pcg::Pcg64::seed_from_u64(4);
        for samples in [1500, 7645, 30_000] {
            let sigma = stretches_noise_sigma(samples);
            let told: Vec<f64> = (0..60)
                .map(|_| {
                    let mut noise = || -> f64 { rand_distr::StandardNormal.sample(&mut random) };
                    let x: Vec<f64> =
                        (0..samples).map(|i| 100.0 * (i as f64 * 0.07).sin() + noise()).collect();
                    stretches_noise_rms(&x, 254.0) - 1.0
                })
                .collect();
            let mean = told.iter().sum::<f64>() / told.len() as f64;
            let rms = (told.iter().map(|x| x * x).sum::<f64>() / told.len() as f64).sqrt();
            assert!(mean.abs() < 0.5 * sigma, "{samples}: {mean} {sigma}");
            assert!((0.7..1.4).contains(&(rms / sigma)), "{samples}: {rms} {sigma}");
        }
    }

    #[test]
    fn noise_is_judged_beside_lines() {
        use rand::{SeedableRng, prelude::Distribution};
        let mut random = rand_pcg::Pcg64::seed_from_u64(3);
        let normal = rand_distr::Normal::new(0.0, 0.02).expect("valid");
        let x: Vec<f64> = (0..40_000).map(|i| (i as f64 * 0.01).sin() + normal.sample(&mut random)).collect();
        let rms = white_noise_rms(&Spectrum::of(&x, 2048.0), 0.3, 0.9);
        assert!((rms / 0.02 - 1.0).abs() < 0.05, "{rms}");
    }
}
