//! What a solver that joins samples by straight lines is to be given.

use crate::signal::Spectrum;
use nalgebra::{Matrix3, Vector3};
use realfft::num_complex::Complex64;

/// Stiffness over mass (1/s2) that a force over the mass and the displacement that it makes show together.
fn held_1_s2(force: &Spectrum, motion: &Spectrum) -> f64 {
    let (mut sum, mut power) = (0.0, 0.0);
    for (bin, (f, d)) in force.bins.iter().zip(&motion.bins).enumerate().skip(1) {
        let w = motion.omega_rad_s(bin);
        sum += ((f + d * (w * w)) * d.conj()).re;
        power += d.norm_sqr();
    }
    (sum / power.max(f64::MIN_POSITIVE)).max(0.0)
}

/// What mass, dashpot and spring leave of a force, of which so much passes at each angular frequency (rad/s), where a mass is most of what
/// answers: squares, over the square of the frequency, so that the displacement's noise is alike all over.
fn unlike_a_mass(force: &Spectrum, motion: &Spectrum, passed: impl Fn(f64) -> f64) -> f64 {
    let first = (LIKE_A_MASS * force.bins.len() as f64) as usize;
    let mut normal = Matrix3::<f64>::zeros();
    let (mut right, mut power) = (Vector3::<f64>::zeros(), 0.0);
    for (bin, (f, d)) in force.bins.iter().zip(&motion.bins).enumerate().skip(first.max(1)) {
        let w = motion.omega_rad_s(bin);
        let f = f * passed(w) / (w * w);
        let columns = [*d, d * Complex64::i() / w, d / (w * w)];
        for (row, one) in columns.iter().enumerate() {
            right[row] += (one.conj() * f).re;
            for (column, other) in columns.iter().enumerate() {
                normal[(row, column)] += (one.conj() * other).re;
            }
        }
        power += f.norm_sqr();
    }
    // In units of each column, which are far from each other.
    let scale = normal.diagonal().map(|x| x.max(f64::MIN_POSITIVE).sqrt().recip());
    let (normal, right) = (normal.component_mul(&(scale * scale.transpose())), right.component_mul(&scale));
    let left = normal.cholesky().map_or(power, |factors| power - factors.solve(&right).dot(&right));
    left / power.max(f64::MIN_POSITIVE)
}

/// Part of the band, up to its end, in which a band-limited channel has little, and how much that is at most, over the mean of the band.
const UPPER: f64 = 0.95;
const LITTLE: f64 = 0.2;
/// Part of the band from which on a mass tells whether lines drove it.
const LIKE_A_MASS: f64 = 0.2;

/// What a solver that joins samples of a force over the mass by straight lines is to be given so that the mass that it drives moves, at each
/// sample, as the band-limited signal that was sampled would move it: lines weaken a frequency f by sinc(f/rate)^2, and what they add around
/// multiples of the rate is seen at f again, when the motion is sampled, as a mass answers it there, by its inertia, over how it answers f,
/// held by a spring (Unser 2000, Sampling - 50 years after Shannon). A force that fills the band up to its very end may be lines, or nearly:
/// it is left as it is where the displacement (m, none where there is none) answers it so rather.
pub(super) fn along_straight_lines(
    force_m_s2: &[f64],
    displacement_m: &[f64],
    sample_rate_hz: f64,
) -> Vec<f64> {
    let spectrum = Spectrum::of(force_m_s2, sample_rate_hz);
    let motion =
        (displacement_m.len() == force_m_s2.len()).then(|| Spectrum::of(displacement_m, sample_rate_hz));
    let held_1_s2 = motion.as_ref().map_or(0.0, |motion| held_1_s2(&spectrum, motion));
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
    let level = |bins: &[Complex64]| bins.iter().map(|z| z.norm_sqr()).sum::<f64>() / bins.len() as f64;
    let upper = (UPPER * spectrum.bins.len() as f64) as usize;
    let are_lines =
        |motion| unlike_a_mass(&spectrum, motion, passed) < unlike_a_mass(&spectrum, motion, |_| 1.0);
    let fills = level(&spectrum.bins[upper..]) > LITTLE * level(&spectrum.bins[1..]);
    if fills && motion.as_ref().is_none_or(are_lines) {
        return force_m_s2.to_vec();
    }
    spectrum.multiply(|w| Complex64::from(1.0 / passed(w))).channel()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::system::Oscillation;
    use rand::{SeedableRng, prelude::Distribution};
    use std::f64::consts::TAU;

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
            let made_up_for = size(&along_straight_lines(&x, &[], rate));
            assert!((made_up_for - 1.0).abs() < 1e-3, "{turn}: {made_up_for}");
        }
    }

    #[test]
    fn a_force_that_fills_the_band_is_lines_where_the_mass_moves_so() {
        let (rate, n) = (100.0, 20_000);
        let mut random = rand_pcg::Pcg64::seed_from_u64(7);
        let force: Vec<f64> = (0..n).map(|_| rand_distr::StandardNormal.sample(&mut random)).collect();
        // Of a mass on a spring of 8 Hz: along lines, by the exact steps; along the band-limited signal, by its spectrum.
        let held = (TAU * 8.0).powi(2);
        let spring = Oscillation::new(held, 2.0, 1.0 / rate);
        let mut state = (0.0, 0.0);
        let by_lines: Vec<f64> = force
            .windows(2)
            .map(|two| {
                let before = state.0;
                state = spring.after(state.0, state.1, two[0], two[1]);
                before
            })
            .chain([0.0])
            .collect();
        let own = |w: f64| Complex64::new(held - w * w, 2.0 * w).inv();
        let limited = Spectrum::of(&force, rate).multiply(own).channel();
        let seen = |motion: &[f64]| along_straight_lines(&force, motion, rate);
        assert_eq!(seen(&by_lines), force);
        let made_up_for = seen(&limited);
        // What is made up for moves the mass by lines as the signal did.
        let mut state = (limited[0], (limited[1] - limited[0]) * rate);
        let (mut left, mut power) = (0.0, 0.0);
        for (i, two) in made_up_for.windows(2).enumerate() {
            if i > 2000 {
                left += (state.0 - limited[i]).powi(2);
                power += limited[i].powi(2);
            }
            state = spring.after(state.0, state.1, two[0], two[1]);
        }
        assert!(left < 1e-4 * power, "{}", (left / power).sqrt());
        // Nothing tells of a force alone.
        assert_eq!(seen(&[]), force);
    }
}
