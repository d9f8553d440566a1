//! What a force shows that no motion answers: an upper bound of its noise where it fills the whole band.

use super::spectral::{at_least, cut_up, parts_of_band};
use crate::signal::Spectrum;
use nalgebra::{Matrix3, Vector3};
use realfft::num_complex::Complex64;
use std::ops::Range;

/// Inputs that a force is laid against: a motion, its square and its cube, as a force that bends with it shows.
const INPUTS: usize = 3;
/// Stretches for each of them below which they say little: any three answer to three of anything.
const FEWEST: usize = 4;
/// A bound counts where it is clearly less than what it bounds.
const CLEARLY_LESS: f64 = 0.8;

/// Noise of a force that was told by the quiet parts of its spectrum, or less where what answers it (as many samples, or none) shows that
/// those are not quiet: what both show together is no noise.
pub(super) fn beside_answers(told: f64, force: &[f64], answers: &[&[f64]], sample_rate_hz: f64) -> f64 {
    let bounds = answers.iter().filter_map(|answer| unanswered_rms(force, answer, sample_rate_hz));
    let bound = at_least(bounds.fold(f64::INFINITY, f64::min), force);
    if bound < CLEARLY_LESS * told { bound } else { told }
}

/// RMS, as of white noise over the whole band, of what a force does not share with a motion, its square and its cube, in the part of the
/// band where that is least: the median over the part's bins of the force's power given theirs, by the method of the reversed path (Bendat
/// and Piersol, Random Data, 4th ed. 2010, ch. 7 and 13). None where the channels are too short to average over. Other bends of the
/// restoring force and the motion's own noise only raise it.
fn unanswered_rms(force: &[f64], motion: &[f64], sample_rate_hz: f64) -> Option<f64> {
    let count = cut_up(force).count();
    if motion.len() != force.len() || count < FEWEST * INPUTS {
        return None;
    }
    let spectrum = |channel: &[f64]| Spectrum::tapered(channel, sample_rate_hz);
    let spectra: Vec<[Spectrum; INPUTS + 1]> = cut_up(force)
        .zip(cut_up(motion))
        .map(|(force, motion)| {
            let power = |exponent| motion.iter().map(|d| d.powi(exponent)).collect::<Vec<f64>>();
            [spectrum(force), spectrum(motion), spectrum(&power(2)), spectrum(&power(3))]
        })
        .collect();
    let first = &spectra.first()?[0];
    let count = count as f64;
    // Each number that is fitted takes a stretch away; the median of a sum of squares is a little below its mean.
    let mean = first.white_noise_power(1.0) * (count - INPUTS as f64) * (1.0 - 1.0 / (9.0 * count)).powi(3);
    let of_part = |(low, high): (f64, f64)| {
        let nyquist_hz = sample_rate_hz / 2.0;
        let bins = first.band(low * nyquist_hz, high * nyquist_hz);
        let mut left: Vec<f64> = bins.map(|bin| unexplained(&spectra, bin)).collect();
        left.sort_by(f64::total_cmp);
        left.get(left.len() / 2).map(|middle| (middle.max(0.0) / mean).sqrt())
    };
    parts_of_band().filter_map(of_part).min_by(f64::total_cmp)
}

/// Power of the first channel in a bin that the others leave, summed over the stretches.
fn unexplained(spectra: &[[Spectrum; INPUTS + 1]], bin: usize) -> f64 {
    let (mut own, mut with) = (0.0, Vector3::<Complex64>::zeros());
    let mut among = Matrix3::<Complex64>::zeros();
    for channels in spectra {
        let [force, inputs @ ..] = channels.each_ref().map(|channel| channel.bins[bin]);
        own += force.norm_sqr();
        let inputs = Vector3::from(inputs);
        with += inputs.map(|x| x.conj()) * force;
        among += inputs.map(|x| x.conj()) * inputs.transpose();
    }
    // In units of each input, which are far from each other.
    let scale = among.diagonal().map(|power| power.re.max(f64::MIN_POSITIVE).sqrt().recip());
    for row in 0..INPUTS {
        with[row] *= scale[row];
        for column in 0..INPUTS {
            among[(row, column)] *= scale[row] * scale[column];
        }
    }
    let Some(factors) = among.cholesky() else { return own };
    own - factors.solve(&with).iter().zip(&with).map(|(x, b)| (x.conj() * b).re).sum::<f64>()
}

/// Coherence of two channels in a part of the band (over half the sampling rate): the median over its bins, 0 for channels that are too short to
/// average over (Bendat and Piersol, Random Data, 4th ed. 2010, ch. 5).
pub(super) fn shared(one: &[f64], other: &[f64], band: Range<f64>) -> f64 {
    if other.len() != one.len() || cut_up(one).count() < FEWEST {
        return 0.0;
    }
    let both = cut_up(one).zip(cut_up(other));
    let pairs: Vec<[Spectrum; 2]> =
        both.map(|(one, other)| [one, other].map(|x| Spectrum::tapered(x, 1.0))).collect();
    let of_bin = |bin: usize| {
        let sums = pairs.iter().fold((0.0, 0.0, Complex64::ZERO), |(x, y, xy), [of_x, of_y]| {
            let (a, b) = (of_x.bins[bin], of_y.bins[bin]);
            (x + a.norm_sqr(), y + b.norm_sqr(), xy + a * b.conj())
        });
        sums.2.norm_sqr() / (sums.0 * sums.1).max(f64::MIN_POSITIVE)
    };
    let mut each: Vec<f64> = pairs[0][0].band(0.5 * band.start, 0.5 * band.end).map(of_bin).collect();
    each.sort_by(f64::total_cmp);
    each.get(each.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, prelude::Distribution};

    /// Forces that fill the band on a mass on a spring that stiffens with the square of its motion by so much, and the noise of both.
    fn told(bend: f64, of_force: f64, of_motion: f64) -> f64 {
        let mut random = rand_pcg::Pcg64::seed_from_u64(3);
        let mut normal = || -> f64 { rand_distr::StandardNormal.sample(&mut random) };
        let n = 60_000;
        // A motion of 0.2 of the sampling rate and what moves it, exactly, by the sampled equation itself.
        let (mut d, mut force) = (vec![0.0; n + 1], vec![0.0; n]);
        for i in 1..n {
            force[i] = normal();
            d[i + 1] = force[i] + 0.55 * d[i] - 0.9 * d[i - 1] - bend * d[i].powi(3);
        }
        let seen: Vec<f64> = force.iter().map(|f| f + of_force * normal()).collect();
        let motion: Vec<f64> = d[..n].iter().map(|d| d + of_motion * normal()).collect();
        beside_answers(1.0, &seen, &[&motion, &[]], 100.0)
    }

    #[test]
    fn what_a_motion_answers_is_no_noise() {
        for bend in [0.0, 1e-3] {
            let noise = told(bend, 0.02, 1e-3);
            assert!((0.019..0.021).contains(&noise), "{bend}: {noise}");
        }
        // A motion that is not seen tells nothing.
        assert_eq!(told(0.0, 0.02, 1e3), 1.0);
        assert_eq!(beside_answers(0.3, &[1.0; 100], &[&[1.0; 100]], 100.0), 0.3);
    }
}
