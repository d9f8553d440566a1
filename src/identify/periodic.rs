//! The table's acceleration in a steady step without the noise of its accelerometer. That noise drives a simulation as if the
//! table had moved: near resonance it shows in the displacement as much as the laser's own noise. Called once a window
//! when a base record is made ready.

use nalgebra::{DMatrix, DVector, SMatrix};
use realfft::num_complex::Complex64;
use std::f64::consts::TAU;

/// Harmonics of a periodic motion that are kept.
const HARMONICS: usize = 5;
/// Deviations by which a harmonic stands out of noise.
const SIGNIFICANT: f64 = 4.5;
/// Corrections of the frequency.
const CORRECTIONS: usize = 4;
/// Parts of a cycle whose means tell noise from motion.
const PARTS: f64 = 8.0;
/// Those means may vary by so much more than white noise has them vary.
const WHITE: f64 = 1.6;

/// The periodic part of a channel about its mean, with about the given frequency; `None` when more than white noise is left, so that the
/// channel has to be taken as it is.
pub fn periodic(channel: &[f64], frequency_hz: f64, rate_hz: f64) -> Option<Vec<f64>> {
    let cycle = rate_hz / frequency_hz.max(1e-9);
    if (channel.len() as f64) < 2.0 * cycle || cycle < 4.0 * HARMONICS as f64 {
        return None;
    }
    let mut w = TAU * frequency_hz / rate_hz;
    let middle = 0.5 * channel.len() as f64;
    for _ in 0..CORRECTIONS {
        // a sin(w t) + b cos(w t) + t (c sin(w t) + d cos(w t)): c and d are what a wrong frequency makes.
        let x = regress(channel, |n| {
            let t = n as f64 - middle;
            let (sin, cos) = (w * t).sin_cos();
            [1.0, sin, cos, t * sin, t * cos]
        })?;
        let power = x[1] * x[1] + x[2] * x[2];
        w += (x[4] * x[1] - x[3] * x[2]) / power.max(1e-300);
    }
    if !(w * rate_hz / TAU / frequency_hz - 1.0).abs().lt(&0.05) {
        return None;
    }
    let row = |n: usize| {
        let first = Complex64::from_polar(1.0, w * (n as f64 - middle));
        let (mut wave, mut row) = (first, [1.0; 1 + 2 * HARMONICS]);
        for pair in row[1..].chunks_exact_mut(2) {
            pair.copy_from_slice(&[wave.im, wave.re]);
            wave *= first;
        }
        row
    };
    let mut x = regress(channel, row)?;
    // A periodic motion comes back to where it was.
    let zero = std::mem::take(&mut x[0]);
    // Noise that falls on a harmonic is of that noise's size; a harmonic of the table stands out.
    let variance = white_variance(channel);
    for pair in x[3..].chunks_exact_mut(2) {
        if pair[0].powi(2) + pair[1].powi(2) < SIGNIFICANT.powi(2) * 2.0 * variance / channel.len() as f64 {
            pair.fill(0.0);
        }
    }
    let smooth: Vec<f64> =
        (0..channel.len()).map(|n| row(n).iter().zip(&x).map(|(a, b)| a * b).sum()).collect();
    let left: Vec<f64> = channel.iter().zip(&smooth).map(|(y, s)| y - zero - s).collect();
    is_white(&left, (cycle / PARTS) as usize).then_some(smooth)
}

/// Variance of white noise on a slow channel, by the differences of neighbours.
fn white_variance(channel: &[f64]) -> f64 {
    let second = channel.windows(3).map(|x| (x[2] - 2.0 * x[1] + x[0]).powi(2)).sum::<f64>();
    second / (6 * channel.len()) as f64
}

/// Means over so many samples vary as those of white noise do, whose variance the differences of neighbours tell.
fn is_white(noise: &[f64], samples: usize) -> bool {
    let samples = samples.max(2);
    let variance = white_variance(noise);
    let parts = noise.chunks_exact(samples);
    let count = parts.len() as f64;
    let of_means = parts.map(|part| (part.iter().sum::<f64>() / samples as f64).powi(2)).sum::<f64>() / count;
    of_means * samples as f64 <= WHITE * variance
}

/// Least squares of a channel on the rows.
fn regress<const N: usize>(channel: &[f64], row: impl Fn(usize) -> [f64; N]) -> Option<[f64; N]> {
    let mut normal = SMatrix::<f64, N, N>::zeros();
    let mut right = [0.0; N];
    for (n, y) in channel.iter().enumerate() {
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
        let smooth = periodic(&seen, 1.3 * 1.005, 2048.0).expect("periodic");
        let rms = (clean.iter().zip(&smooth).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / 9000.0).sqrt();
        assert!(rms < 0.01 * (13.0 / 9000.0_f64).sqrt() * 1.6, "{rms}");
    }

    #[test]
    fn a_motion_that_swells_or_jumps_is_taken_as_it_is() {
        let (_, swells) = noisy(|t| (0.4 + 0.01 * t) * (TAU * 1.3 * t).sin(), 2);
        assert!(periodic(&swells, 1.3, 2048.0).is_none());
        let (_, jumps) = noisy(|t| 0.4 * (TAU * 1.3 * t + if t > 2.0 { 0.05 } else { 0.0 }).sin(), 3);
        assert!(periodic(&jumps, 1.3, 2048.0).is_none());
        let (_, still) = noisy(|_| 0.0, 4);
        assert!(periodic(&still[..1500], 1.3, 2048.0).is_none());
    }
}
