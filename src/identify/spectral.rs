//! Noise of a channel from its spectrum.

use super::motion::{FINEST, rms};
use crate::record::quality::of_rounding;
use crate::signal::Spectrum;

/// Samples of a stretch of [`stretches_noise_rms`], and stretches at most.
const STRETCH: usize = 4096;
const STRETCHES: usize = 32;

/// Parts of the upper band, over the Nyquist frequency: the quietest but one tells the noise, which a harmonic may fill in another, or a
/// filter have taken out.
const PARTS_OF_BAND: [(f64, f64); 5] = [(0.6, 0.67), (0.67, 0.74), (0.74, 0.81), (0.81, 0.88), (0.88, 0.95)];

/// Parts below, where noise is level that a filter takes out of the upper ones: so many in a row, each within such a share of their mean; less is
/// left of it in the upper band by more than such a share.
const LOWER_PARTS: [(f64, f64); 6] =
    [(0.18, 0.25), (0.25, 0.32), (0.32, 0.39), (0.39, 0.46), (0.46, 0.53), (0.53, 0.6)];
const LEVEL_RUN: usize = 3;
const LEVEL_PARTS: f64 = 0.04;
const LOST: f64 = 0.02;

/// All of them, from below.
pub(super) fn parts_of_band() -> impl Iterator<Item = (f64, f64)> {
    LOWER_PARTS.into_iter().chain(PARTS_OF_BAND)
}

/// Expected value of the second of five normal deviates, and its standard deviation (order statistics: David and Nagaraja 2003).
const SECOND_OF_FIVE: [f64; 2] = [-0.495, 0.56];

/// Stretches of a channel that overlap by half, so many samples each: every how many are looked at, and how many that is.
fn stretches(samples: usize) -> (usize, usize, usize) {
    let length = STRETCH.min(samples);
    let there = samples.saturating_sub(length) / (length / 2).max(1) + 1;
    let every = there.div_ceil(STRETCHES);
    (length, every, there.div_ceil(every))
}

/// Those that are looked at.
pub(super) fn cut_up(channel: &[f64]) -> impl Iterator<Item = &[f64]> {
    let (length, every, _) = stretches(channel.len());
    channel.windows(length.max(1)).step_by((length / 2).max(1)).step_by(every)
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
    let (of_upper, of_level) = told_by_stretches(channel, sample_rate_hz);
    of_level.unwrap_or(of_upper)
}

/// Noise that stretches of a channel tell: by the upper band, and by where it is level below the edge of a filter, if one took some of
/// it out of the upper band.
fn told_by_stretches(channel: &[f64], sample_rate_hz: f64) -> (f64, Option<f64>) {
    let parts_of = |stretch: &[f64]| {
        let spectrum = Spectrum::tapered(stretch, sample_rate_hz);
        parts_of_band().map(|(low, high)| spectrum.white_noise_rms(low, high)).collect()
    };
    let told: Vec<Vec<f64>> = cut_up(channel).map(parts_of).collect();
    let parts: Vec<f64> = (0..LOWER_PARTS.len() + PARTS_OF_BAND.len())
        .map(|part| {
            let mut of_part: Vec<f64> = told.iter().map(|parts| parts[part]).collect();
            of_part.sort_by(f64::total_cmp);
            let middle = [of_part.len().saturating_sub(1) / 2, of_part.len() / 2];
            0.5 * middle.into_iter().filter_map(|i| of_part.get(i)).sum::<f64>()
        })
        .collect();
    let mut upper = parts[LOWER_PARTS.len()..].to_vec();
    upper.sort_by(f64::total_cmp);
    let sigma = part_sigma(channel.len());
    let of_upper = upper[1] / (1.0 + SECOND_OF_FIVE[0] * sigma).max(0.5);
    (of_upper, level_below_a_filter(&parts, sigma).filter(|level| of_upper < (1.0 - LOST) * level))
}

/// RMS of noise that is level in some neighbouring parts of the band, no more below them, and less in each above, the more so the higher,
/// as behind a filter against aliases. What moves is nowhere level there: corners of its velocity fall by a third from one part to the next.
fn level_below_a_filter(parts: &[f64], sigma: f64) -> Option<f64> {
    let (bound, slack) = (LEVEL_PARTS.max(3.0 * sigma), 1.0 + 2.0 * sigma);
    (0..parts.len() - LEVEL_RUN).rev().find_map(|first| {
        let (below, rest) = parts.split_at(first);
        let (run, above) = rest.split_at(LEVEL_RUN);
        let level = run.iter().sum::<f64>() / run.len() as f64;
        let is_level = run.iter().all(|part| (part / level - 1.0).abs() < bound);
        let is_top = below.last().is_none_or(|part| *part < level * slack);
        let falls = above.windows(2).all(|pair| pair[1] < pair[0] * slack);
        let lost = above.last().is_some_and(|part| *part < (1.0 - LOST - bound) * level);
        (is_level && is_top && falls && lost).then_some(level)
    })
}

/// Noise of a channel from stretches of it. A converter's steps are noise, too, of which a mass at rest shows nothing.
pub fn noise_of_sensor(x: &[f64], sample_rate_hz: f64) -> f64 {
    at_least(stretches_noise_rms(x, sample_rate_hz), x)
}

/// So much, or what no sensor does better than.
pub(super) fn at_least(noise: f64, x: &[f64]) -> f64 {
    noise.max(FINEST * rms(x)).max(of_rounding(x))
}

/// Stretches that show less than this share of what the whole channel does tell its noise: the rest is not noise.
const CLEARLY_LESS: f64 = 0.8;

/// Noise of a channel from all of it, by its tapered spectrum; from stretches where those show clearly less, as where a mass hits
/// stops during a part of a sweep only, and where they show the edge of a filter.
pub fn noise_of_whole(x: &[f64], tapered: &Spectrum) -> f64 {
    let whole = tapered.white_noise_rms(0.5, 0.9);
    let (of_upper, of_level) = told_by_stretches(x, tapered.sample_rate_hz());
    let stretches = at_least(of_level.unwrap_or(of_upper), x);
    if of_level.is_some() || stretches < CLEARLY_LESS * whole { stretches } else { whole }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realfft::num_complex::Complex64;
    use std::f64::consts::TAU;

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
    fn impacts_in_a_part_of_a_sweep_are_no_noise() {
        use rand::{SeedableRng, prelude::Distribution};
        let mut random = rand_pcg::Pcg64::seed_from_u64(5);
        let normal = rand_distr::Normal::new(0.0, 1e-3).expect("valid");
        // A corner at every impact, in the last third.
        let hit = |i: u32| if i > 20_000 && i % 97 < 48 { 0.3 } else { 0.0 };
        let of = |hit: &dyn Fn(u32) -> f64, random: &mut rand_pcg::Pcg64| -> f64 {
            let x: Vec<f64> = (0..30_000_u32)
                .map(|i| (f64::from(i) * 0.05).sin() + hit(i) + normal.sample(random))
                .collect();
            noise_of_whole(&x, &Spectrum::tapered(&x, 1000.0))
        };
        for told in [of(&|_| 0.0, &mut random), of(&hit, &mut random)] {
            assert!((told / 1e-3 - 1.0).abs() < 0.06, "{told}");
        }
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
    fn noise_is_told_where_a_filter_against_aliases_let_it_through() {
        use rand::{SeedableRng, prelude::Distribution};
        let mut random = rand_pcg::Pcg64::seed_from_u64(6);
        for samples in [9_000_usize, 60_000] {
            let x: Vec<f64> = (0..samples)
                .map(|i| {
                    let noise: f64 = rand_distr::StandardNormal.sample(&mut random);
                    500.0 * (i as f64 * 0.06).sin() + noise
                })
                .collect();
            // Butterworth's fourth order at so much of the sampling rate.
            let told = |share: f64| {
                let low = |w: f64| Complex64::from((1.0 + (w / (TAU * share)).powi(8)).powf(-0.5));
                let seen = Spectrum::of(&x, 1.0).multiply(low).channel();
                let by_whole = noise_of_whole(&seen, &Spectrum::tapered(&seen, 1.0));
                [stretches_noise_rms(&seen, 1.0), by_whole]
            };
            for share in [0.3, 0.35, 0.4, 10.0] {
                let told = told(share);
                let bound = 0.03 + 2.0 * part_sigma(samples);
                assert!(told.iter().all(|told| (told - 1.0).abs() < bound), "{samples} {share}: {told:?}");
            }
        }
        // Corners of a velocity, and what a bumper of few samples makes, are no noise.
        for fall in [1, 2] {
            let parts: Vec<f64> = parts_of_band().map(|(low, _)| low.powi(-fall)).collect();
            assert_eq!(level_below_a_filter(&parts, 0.01), None);
        }
    }
}
