//! The table's acceleration in a steady step without the noise of its accelerometer. That noise drives a simulation as if the
//! table had moved: near resonance it shows in the displacement as much as the laser's own noise. Called once a window
//! when a base record is made ready.

use crate::model::elementary::sin_cos;
use nalgebra::{DMatrix, DVector, SMatrix};
use realfft::num_complex::Complex64;
use std::f64::consts::TAU;

/// Harmonics of a periodic motion that are kept.
const HARMONICS: usize = 9;
/// Deviations by which a harmonic stands out of noise.
const SIGNIFICANT: f64 = 4.5;
/// Samples of a cycle, at least, for its zero to be told.
const FEWEST: f64 = 8.0;
/// Corrections of the frequency.
const CORRECTIONS: usize = 4;
/// Parts of a cycle whose means tell noise from motion.
const PARTS: f64 = 8.0;
/// Those means may vary by so much more than white noise has them vary.
const WHITE: f64 = 1.6;
/// An impact kicks the table: means over so many samples that stand out by so many deviations are motion, and so is what lies
/// beside them, as long as it is no more than this share of the stretch.
const KICK: usize = 8;
const KICKS: f64 = 5.0;
const KICKED: f64 = 0.6;
/// Samples in which a table comes back to its course after a kick, some 15 ms.
const RECOVERY: usize = 4 * KICK;
/// Times that kicks are looked for beside what the rest of the stretch says the harmonics are.
const LOOKS: usize = 3;

/// A channel taken apart.
pub struct Periodic {
    /// The significant harmonics.
    pub wave: Vec<f64>,
    /// What is left beside them and the mean: noise, and the kicks of impacts.
    pub rest: Vec<f64>,
    /// Whether each sample lies outside the kicks.
    pub still: Vec<bool>,
    /// Outside the kicks there is white noise alone.
    pub white: bool,
    /// rad a sample.
    angle: f64,
}

/// Takes a channel apart that moves with about the given frequency; `None` when it does not. `share` is the share of the power of white
/// noise that the channel has at a frequency in Hz.
pub fn periodic(
    channel: &[f64],
    frequency_hz: f64,
    rate_hz: f64,
    share: impl Fn(f64) -> f64,
) -> Option<Periodic> {
    let cycle = rate_hz / frequency_hz.max(1e-9);
    if (channel.len() as f64) < 2.0 * cycle || cycle < 4.0 * HARMONICS as f64 {
        return None;
    }
    let middle = 0.5 * channel.len() as f64;
    let all = vec![true; channel.len()];
    let (w, _) = fundamental(channel, frequency_hz, rate_hz)?;
    let variance = white_variance(channel);
    let (mut still, mut look) = (all, 1);
    loop {
        let mut x = regress(channel, &still, |n| harmonics(w * (n as f64 - middle)))?;
        // A periodic motion comes back to where it was.
        let zero = std::mem::take(&mut x[0]);
        // Noise that falls on a harmonic is of that noise's size; a harmonic of the table stands out.
        for (i, pair) in x[3..].chunks_exact_mut(2).enumerate() {
            let of_noise = 2.0 * variance * share((i + 2) as f64 * frequency_hz) / channel.len() as f64;
            if pair[0].powi(2) + pair[1].powi(2) < SIGNIFICANT.powi(2) * of_noise {
                pair.fill(0.0);
            }
        }
        let at = |n: usize| harmonics(w * (n as f64 - middle)).iter().zip(&x).map(|(a, b)| a * b).sum();
        let wave: Vec<f64> = (0..channel.len()).map(at).collect();
        let rest: Vec<f64> = channel.iter().zip(&wave).map(|(y, s)| y - zero - s).collect();
        let kicks = without_kicks(&rest, variance.sqrt());
        if look < LOOKS && kicks != still {
            (still, look) = (kicks, look + 1);
            continue;
        }
        let quiet: Vec<f64> =
            rest.iter().zip(&kicks).map(|(r, still)| if *still { *r } else { 0.0 }).collect();
        let kicked = kicks.iter().filter(|still| !**still).count() as f64;
        let white =
            kicked <= KICKED * channel.len() as f64 && is_white(&quiet, variance, (cycle / PARTS) as usize);
        return Some(Periodic { wave, rest, still: kicks, white, angle: w });
    }
}

/// What a channel that moves with about the given frequency does not come back to, whatever part of a cycle it ends in: its zero. `None`
/// when it does not move so.
pub fn zero(channel: &[f64], frequency_hz: f64, rate_hz: f64) -> Option<f64> {
    let cycle = rate_hz / frequency_hz.max(1e-9);
    let is_told = channel.len() as f64 > 2.0 * cycle && cycle > FEWEST;
    is_told.then(|| fundamental(channel, frequency_hz, rate_hz)).flatten().map(|(_, zero)| zero)
}

/// Angle of the fundamental, rad a sample, and the constant beside it.
fn fundamental(channel: &[f64], frequency_hz: f64, rate_hz: f64) -> Option<(f64, f64)> {
    let (mut w, mut zero) = (TAU * frequency_hz / rate_hz, 0.0);
    let middle = 0.5 * channel.len() as f64;
    let all = vec![true; channel.len()];
    for _ in 0..CORRECTIONS {
        // a sin(w t) + b cos(w t) + t (c sin(w t) + d cos(w t)): c and d are what a wrong frequency makes.
        let x = regress(channel, &all, |n| {
            let t = n as f64 - middle;
            let (sin, cos) = sin_cos(w * t);
            [1.0, sin, cos, t * sin, t * cos]
        })?;
        let power = x[1] * x[1] + x[2] * x[2];
        w += (x[4] * x[1] - x[3] * x[2]) / power.max(1e-300);
        zero = x[0];
    }
    (w * rate_hz / TAU / frequency_hz - 1.0).abs().lt(&0.05).then_some((w, zero))
}

impl Periodic {
    /// What is left beside the harmonics as its mean over the cycles, and the number of these; `None` where the cycles differ by more
    /// than noise. Impacts in a steady step kick the table alike in every cycle.
    pub fn alike(&self) -> Option<(Vec<f64>, f64)> {
        let (rest, phases) = (&self.rest, (TAU / self.angle) as usize);
        let at = |n: usize| {
            let phase = (n as f64 * self.angle / TAU).fract() * phases as f64;
            let first = (phase as usize).min(phases - 1);
            (first, (first + 1) % phases, phase - first as f64)
        };
        let (mut sum, mut weight) = (vec![0.0; phases], vec![0.0; phases]);
        for (n, r) in rest.iter().enumerate() {
            let (first, next, share) = at(n);
            for (phase, share) in [(first, 1.0 - share), (next, share)] {
                sum[phase] += share * r;
                weight[phase] += share;
            }
        }
        let mean = |phase: usize| sum[phase] / f64::max(weight[phase], 1e-9);
        let alike = |n: usize| {
            let (first, next, share) = at(n);
            mean(first) * (1.0 - share) + mean(next) * share
        };
        let alike: Vec<f64> = (0..rest.len()).map(alike).collect();
        let apart: Vec<f64> = rest.iter().zip(&alike).map(|(r, a)| r - a).collect();
        let variance = white_variance(rest);
        let noise = [KICK, (phases as f64 / PARTS) as usize].iter().all(|n| is_white(&apart, variance, *n));
        noise.then(|| (alike, rest.len() as f64 / phases as f64))
    }
}

/// 1 and the harmonics of an angle.
fn harmonics(angle: f64) -> [f64; 1 + 2 * HARMONICS] {
    let (sin, cos) = sin_cos(angle);
    let first = Complex64::new(cos, sin);
    let (mut wave, mut row) = (first, [1.0; 1 + 2 * HARMONICS]);
    for pair in row[1..].chunks_exact_mut(2) {
        pair.copy_from_slice(&[wave.im, wave.re]);
        wave *= first;
    }
    row
}

/// Which samples lie outside the kicks.
fn without_kicks(left: &[f64], noise: f64) -> Vec<bool> {
    let mut still = vec![true; left.len()];
    let mut sum: f64 = left.iter().take(KICK).sum();
    for n in 0..left.len().saturating_sub(KICK) {
        if sum.abs() > KICKS * noise * (KICK as f64).sqrt() {
            still[n.saturating_sub(KICK)..(n + RECOVERY).min(left.len())].fill(false);
        }
        sum += left[n + KICK] - left[n];
    }
    still
}

/// Means over a kick's samples about each.
pub fn smooth(channel: &[f64]) -> Vec<f64> {
    let near = |n: usize| n.saturating_sub(KICK / 2)..(n + KICK / 2 + 1).min(channel.len());
    (0..channel.len()).map(|n| channel[near(n)].iter().sum::<f64>() / near(n).len() as f64).collect()
}

/// Variance of white noise on a slow channel, by the differences of neighbours.
fn white_variance(channel: &[f64]) -> f64 {
    let second = channel.windows(3).map(|x| (x[2] - 2.0 * x[1] + x[0]).powi(2)).sum::<f64>();
    second / (6 * channel.len()) as f64
}

/// Means over so many samples vary as those of white noise do, whose variance the differences of neighbours tell.
fn is_white(noise: &[f64], variance: f64, samples: usize) -> bool {
    let samples = samples.max(2);
    let parts = noise.chunks_exact(samples);
    let count = parts.len() as f64;
    let of_means = parts.map(|part| (part.iter().sum::<f64>() / samples as f64).powi(2)).sum::<f64>() / count;
    of_means * samples as f64 <= WHITE * variance
}

/// Least squares of those samples of a channel that count on the rows.
fn regress<const N: usize>(
    channel: &[f64],
    counts: &[bool],
    row: impl Fn(usize) -> [f64; N],
) -> Option<[f64; N]> {
    let mut normal = SMatrix::<f64, N, N>::zeros();
    let mut right = [0.0; N];
    for (n, y) in channel.iter().enumerate().filter(|(n, _)| counts[*n]) {
        let x = row(n);
        for i in 0..N {
            right[i] += x[i] * y;
            for j in 0..=i {
                normal[(i, j)] += x[i] * x[j];
            }
        }
    }
    normal.fill_upper_triangle_with_lower_triangle();
    // Columns that grow with time beside those that do not: scaled before they are solved.
    let scale: [f64; N] = std::array::from_fn(|i| 1.0 / normal[(i, i)].max(1e-300).sqrt());
    let scaled = DMatrix::from_fn(N, N, |i, j| normal[(i, j)] * scale[i] * scale[j]);
    let solved = scaled.cholesky()?.solve(&DVector::from_fn(N, |i, _| right[i] * scale[i]));
    Some(std::array::from_fn(|i| solved[i] * scale[i]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, prelude::Distribution};

    fn noisy(wave: impl Fn(f64) -> f64, seed: u64) -> (Vec<f64>, Vec<f64>) {
        let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
        let normal = rand_distr::Normal::new(0.0, 0.01).expect("valid");
        let clean: Vec<f64> = (0..9000).map(|n| wave(f64::from(n) / 2048.0)).collect();
        let seen = clean.iter().map(|x| x + normal.sample(&mut random)).collect();
        (clean, seen)
    }

    #[test]
    fn the_noise_of_a_steady_motion_is_taken_out_although_its_frequency_is_known_to_half_a_percent() {
        let (clean, seen) = noisy(|t| 0.4 * (TAU * 1.3 * t).sin() + 0.02 * (TAU * 3.9 * t).cos(), 1);
        let smooth = periodic(&seen, 1.3 * 1.005, 2048.0, |_| 1.0).expect("periodic");
        assert!(smooth.white);
        let smooth = smooth.wave;
        let rms = (clean.iter().zip(&smooth).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / 9000.0).sqrt();
        assert!(rms < 0.01 * (13.0 / 9000.0_f64).sqrt() * 1.6, "{rms}");
    }

    #[test]
    fn a_zero_is_told_whatever_part_of_a_cycle_the_motion_ends_in() {
        for length in [360, 367, 391] {
            let motion =
                |n: i32| 0.3 + (f64::from(n) * 0.14 + 0.4).sin() + 0.02 * (f64::from(n) * 0.42).cos();
            let channel: Vec<f64> = (0..length).map(motion).collect();
            let found = zero(&channel, 0.14 / TAU * 1.003, 1.0).expect("a motion");
            let mean = channel.iter().sum::<f64>() / f64::from(length);
            assert!((found - 0.3).abs() < 1e-3, "{length}: {found}");
            assert!((found - 0.3).abs() < 0.2 * (mean - 0.3).abs() + 5e-4, "{length}: {found}, mean {mean}");
        }
        assert_eq!(zero(&[1.0; 100], 0.01, 1.0), None);
    }

    #[test]
    fn kicks_of_impacts_stay_and_leave_the_sine_as_it_is() {
        let kick = |t: f64| if t.rem_euclid(0.77) < 0.015 { 0.1 } else { 0.0 };
        let (clean, seen) = noisy(|t| 0.4 * (TAU * 1.3 * t).sin() + kick(t), 5);
        let found = periodic(&seen, 1.3, 2048.0, |_| 1.0).expect("periodic");
        assert!(found.white);
        let kept = found.wave.iter().zip(&found.rest).zip(&found.still);
        let smooth = kept.map(|((wave, rest), still)| if *still { *wave } else { wave + rest });
        let apart: Vec<f64> = clean.iter().zip(smooth).map(|(a, b)| a - b).collect();
        // Within the kicks the noise stays, beside them there is as little as without kicks.
        let beside = |n: &usize| (0.06..0.75).contains(&(*n as f64 / 2048.0).rem_euclid(0.77));
        let rms = |of: Vec<f64>| (of.iter().map(|x| x * x).sum::<f64>() / of.len() as f64).sqrt();
        let quiet = rms((0..9000).filter(beside).map(|n| apart[n]).collect());
        assert!(quiet < 0.01 * (13.0 / 9000.0_f64).sqrt() * 1.6, "{quiet}");
        let sum: f64 = apart.iter().sum::<f64>() / 2048.0;
        assert!(sum.abs() < 3.0 * 0.01 * (9000.0 * 0.15_f64).sqrt() / 2048.0, "{sum} m/s");
    }

    #[test]
    fn kicks_that_come_in_every_cycle_are_averaged_and_others_are_not() {
        let kick = |phase: f64| if (0.2..0.26).contains(&phase) { 0.1 } else { 0.0 };
        let (clean, seen) = noisy(|t| 0.4 * (TAU * 1.3 * t).sin() + kick((1.3 * t).fract()), 6);
        let found = periodic(&seen, 1.3, 2048.0, |_| 1.0).expect("periodic");
        let (alike, cycles) = found.alike().expect("the same in each");
        assert!((cycles - 9000.0 * 1.3 / 2048.0).abs() < 0.01, "{cycles}");
        // Less noise by the number of cycles, but for the mean and the harmonics, which are not of it.
        let apart = |rest: &[f64]| {
            let off = clean.iter().zip(&found.wave).zip(rest).map(|((c, w), r)| c - w - r);
            let off: Vec<f64> = off.collect();
            let mean = off.iter().sum::<f64>() / off.len() as f64;
            (off.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / off.len() as f64).sqrt()
        };
        assert!(apart(&alike) < 0.6 * apart(&found.rest), "{} {}", apart(&alike), apart(&found.rest));
        let once = |t: f64| if t.rem_euclid(0.613) < 0.015 { 0.1 } else { 0.0 };
        let (_, seen) = noisy(|t| 0.4 * (TAU * 1.3 * t).sin() + once(t), 7);
        assert!(periodic(&seen, 1.3, 2048.0, |_| 1.0).expect("periodic").alike().is_none());
    }

    #[test]
    fn a_motion_that_swells_or_jumps_is_taken_as_it_is() {
        let (_, swells) = noisy(|t| (0.4 + 0.01 * t) * (TAU * 1.3 * t).sin(), 2);
        assert!(!periodic(&swells, 1.3, 2048.0, |_| 1.0).expect("of that frequency").white);
        let (_, jumps) = noisy(|t| 0.4 * (TAU * 1.3 * t + if t > 2.0 { 0.05 } else { 0.0 }).sin(), 3);
        assert!(!periodic(&jumps, 1.3, 2048.0, |_| 1.0).expect("of that frequency").white);
        let (_, still) = noisy(|_| 0.0, 4);
        assert!(periodic(&still[..1500], 1.3, 2048.0, |_| 1.0).is_none());
    }
}
