//! Whether displacement and force alone speak of a mass that the force drives, or of a component on which the displacement was imposed.

use crate::signal::{Spectrum, hann};
use nalgebra::{DMatrix, DVector};
use realfft::num_complex::Complex64;

/// Fewest samples that say anything.
const FEWEST: usize = 64;
/// Bins over which the power of the displacement is smoothed, and times its noise that it has to be to be motion.
const SMOOTHED: usize = 9;
const MOTION: f64 = 30.0;
/// Inertia's share of the force, rms, from which on a mass is driven, and times the mean square that is left without it. Of 85 simulated
/// components none had more than 0.24, of 12 driven masses none less than 0.44 and 1.6.
const SHARE: f64 = 0.35;
const TIMES: f64 = 1.5;

/// Whether a force drives a mass: part of it then goes with the acceleration, beside what goes with displacement, its cube and
/// velocity. The force of a component has no such part. False where the record does not say.
pub(super) fn drives_a_mass(displacement_m: &[f64], force_n: &[f64]) -> bool {
    inertia(displacement_m, force_n).is_some_and(|[share, times]| share > SHARE && times > TIMES)
}

/// Inertia's share of the force, rms, of the sign of a mass, and the mean square of the force that is left without it over that with it.
fn inertia(displacement_m: &[f64], force_n: &[f64]) -> Option<[f64; 2]> {
    let samples = displacement_m.len().min(force_n.len());
    let sound = |channel: &[f64]| channel.iter().all(|x| x.is_finite());
    if samples < FEWEST || !sound(displacement_m) || !sound(force_n) {
        return None;
    }
    // Times in samples: only shares of the force are told.
    let [moved, force] = [displacement_m, force_n].map(|channel| Spectrum::tapered(&channel[..samples], 1.0));
    let cut_rad = moved.omega_rad_s(end_of_motion(&moved));
    // A channel without what is above the motion, times a factor that goes with the frequency over its end.
    let channel = |spectrum: &Spectrum, by: fn(f64) -> Complex64| {
        let weighed = |w: f64| by(w / cut_rad) / (1.0 + (w / cut_rad).powi(8));
        DVector::from_vec(spectrum.clone().multiply(weighed).channel())
    };
    let force = channel(&force, |_| Complex64::ONE);
    let displacement = channel(&moved, |_| Complex64::ONE);
    let velocity = channel(&moved, |w| Complex64::new(0.0, w));
    let acceleration = channel(&moved, |w| Complex64::from(-w * w));
    // As it was before it was tapered; where it was tapered to nothing it counts for nothing.
    let tapered = hann(samples).zip(&displacement).map(|(w, d)| d.powi(3) / w.max(1e-6).powi(2));
    let cube = DVector::from_iterator(samples, tapered);
    let columns = [displacement, velocity, cube, acceleration].map(|column| column.normalize());
    let left = |columns: &[DVector<f64>]| {
        let along = DMatrix::from_columns(columns);
        let right = along.tr_mul(&force);
        let told = along.tr_mul(&along).cholesky()?.solve(&right);
        Some((force.norm_squared() - told.dot(&right), told))
    };
    let (without, _) = left(&columns[..3])?;
    let (with, told) = left(&columns)?;
    let found = [told[3] / force.norm(), without / with.max(f64::MIN_POSITIVE)];
    found.iter().all(|x| x.is_finite()).then_some(found)
}

/// Highest bin of a displacement's spectrum that stands above its noise, at least one.
fn end_of_motion(spectrum: &Spectrum) -> usize {
    let power: Vec<f64> = spectrum.bins.iter().map(Complex64::norm_sqr).collect();
    let mut upper = power[power.len() / 2..].to_vec();
    let middle = upper.len() / 2;
    let (_, noise, _) = upper.select_nth_unstable_by(middle, f64::total_cmp);
    let stands = |around: &[f64]| around.iter().sum::<f64>() > MOTION * *noise * SMOOTHED as f64;
    power.windows(SMOOTHED).rposition(stands).map_or(power.len() - 1, |bin| bin + SMOOTHED / 2).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Five waves of displacement and the force of mass, dashpot, spring and stop at them, with a little noise.
    fn waves([mass, damping, stiffness, cubic]: [f64; 4]) -> [Vec<f64>; 2] {
        let mut channels = [Vec::new(), Vec::new()];
        let mut noise = 1u32;
        for i in 0..4000 {
            let (mut x, mut v, mut a) = (0.0, 0.0, 0.0);
            for (k, w) in [0.011, 0.03, 0.05, 0.08, 0.11].into_iter().enumerate() {
                let (sine, cosine) = (w * i as f64 + k as f64).sin_cos();
                (x, v, a) = (x + sine, v + w * cosine, a - w * w * sine);
            }
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            channels[0].push(x + 1e-3 * (f64::from(noise) / f64::from(u32::MAX) - 0.5));
            channels[1].push(mass * a + damping * v + stiffness * x + cubic * x.powi(3));
        }
        channels
    }

    #[test]
    fn part_of_the_force_on_a_mass_goes_with_its_acceleration() {
        for of in [[1.0, 0.004, 0.002, 0.0], [1.0, 0.004, 0.0, 0.0], [1.0, 0.01, 0.002, 0.0004]] {
            let [x, f] = waves(of);
            assert!(drives_a_mass(&x, &f), "{of:?}");
        }
    }

    #[test]
    fn a_component_has_no_inertia_whatever_the_sign_of_its_force() {
        for of in [[0.0, 0.004, 0.002, 0.0], [0.0, 0.0, 0.002, 0.001], [0.0, 0.1, 0.0, 0.0]] {
            let [x, f] = waves(of);
            let wrong: Vec<f64> = f.iter().map(|f| -f).collect();
            assert!(!drives_a_mass(&x, &f) && !drives_a_mass(&x, &wrong), "{of:?}");
        }
        // Shaken far below its resonance a mass does not show.
        let [x, f] = waves([1e-3, 0.004, 0.002, 0.0]);
        assert!(!drives_a_mass(&x, &f));
    }

    #[test]
    fn records_that_do_not_say_drive_nothing() {
        assert!(!drives_a_mass(&[], &[]));
        assert!(!drives_a_mass(&[1.0; 100], &[1.0; 100]));
        let [mut x, f] = waves([1.0, 0.004, 0.002, 0.0]);
        x[7] = f64::NAN;
        assert!(!drives_a_mass(&x, &f));
    }
}
