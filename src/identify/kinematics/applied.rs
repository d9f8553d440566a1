//! Records of an applied force: displacement and acceleration of the mass are those of one motion, `D'' = A`. Which of the two is off cannot be
//! told: what they are out of proportion by is shared by their tolerances, a delay is that of the one that comes later.

use super::band::Band;
use super::{Accelerometer, Estimate, Instruments, Tolerances, regress, twice, twice_by_shift};
use crate::identify::least_squares::dot;
use crate::identify::spectral::noise_of_sensor;
use crate::record::Record;
use crate::signal::Spectrum;
use realfft::num_complex::Complex64;

/// Rounds in which the delay is found, and where they end, s.
const ROUNDS: usize = 6;
const SETTLED_S: f64 = 1e-7;
/// Nobody knows the ratio of two gains better.
const LEAST_SIGMA: f64 = 1e-5;
/// Share of the displacement's power that the relation may leave; where it leaves more, the two do not show one motion.
const UNRELATED: f64 = 0.1;

/// Gain and delay of both sensors against each other, laid at the door of the one that is usually off.
pub(super) fn examine(record: &Record, tolerances: Tolerances) -> Option<Instruments> {
    let (displacement, acceleration) = (&record.displacement_m, &record.acceleration_m_s2);
    let (n, rate) = (displacement.len(), record.sample_rate_hz);
    if n < 64 || acceleration.len() != n {
        return None;
    }
    let [laser_noise_m, noise_m_s2] = [displacement, acceleration].map(|x| noise_of_sensor(x, rate));
    let band = Band::of(&Spectrum::tapered(displacement, rate), laser_noise_m, noise_m_s2)?;
    let [laser, mass] =
        [Spectrum::of(displacement, rate), Spectrum::of_second_derivative(acceleration, rate)];
    let d = band.series(&laser, |_| Complex64::ONE);
    let mut late_s = 0.0;
    let (mut last, mut step_s) = (None, f64::INFINITY);
    for _ in 0..ROUNDS {
        let columns = [band.series(&mass, twice(late_s)), band.series(&mass, twice_by_shift(late_s))];
        let (x, covariance, left) = regress(&columns, &d, band.colour)?;
        // A shift by dt is -dt times the derivative.
        step_s = -x[1] / x[0];
        late_s += step_s;
        last = Some((x[0], covariance[(0, 0)].sqrt(), covariance[(1, 1)].sqrt() / x[0].abs(), left));
        if step_s.abs() < SETTLED_S {
            break;
        }
    }
    let (ratio, ratio_sigma, late_sigma_s, left) = last.filter(|_| step_s.abs() < 1e-2 / rate)?;
    // D = ratio A, as it is measured: the tolerances say whose gain is off.
    let (of_laser, of_mass) = (tolerances.laser_gain.powi(2), tolerances.accelerometer_gain.powi(2));
    let off = (ratio > 0.0).then(|| ratio.ln())? / (of_laser + of_mass);
    let gain = |own: f64, sigma: f64| Estimate { value: (own * off).exp(), sigma };
    // Nothing comes before it happens.
    let late_by = |s: f64| Estimate { value: s.max(0.0), sigma: late_sigma_s };
    let accelerometer = Accelerometer {
        gain: gain(-of_mass, (ratio_sigma / ratio).max(LEAST_SIGMA)),
        delay_s: late_by(-late_s),
        noise_m_s2,
        ..Accelerometer::default()
    };
    let unexplained = dot(&left, &left);
    if unexplained > UNRELATED * dot(&d, &d) {
        return None;
    }
    let squares = unexplained / (left.len() as f64 - 2.0).max(1.0);
    Some(Instruments {
        accelerometers: [accelerometer; 2],
        // The ratio is open, not either gain: it is the accelerometer's.
        laser_gain: gain(of_laser, 0.0),
        laser_delay_s: late_by(late_s),
        laser_noise_m,
        misfit: squares.sqrt() / band.expected_rms(&laser).max(1e-300),
        ..Instruments::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Kind;
    use rand::{SeedableRng, prelude::Distribution};
    use std::f64::consts::TAU;

    const RATE_HZ: f64 = 400.0;

    /// A motion of a few sines, its displacement late and seen with a gain, with noise.
    fn record(late_s: f64, gain: f64, seed: u64) -> Record {
        let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
        let mut noise = |rms: f64| -> f64 {
            let z: f64 = rand_distr::StandardNormal.sample(&mut random);
            rms * z
        };
        let mut record = Record::empty("it", Kind::Force, RATE_HZ);
        let sines = [(1.3, 0.01), (2.9, 0.006), (4.7, 0.002)];
        for i in 0..12_000 {
            let t = f64::from(i) / RATE_HZ;
            let of = |(hz, m): (f64, f64)| m * (TAU * hz * (t - late_s)).sin();
            let at = |(hz, m): (f64, f64)| -m * (TAU * hz).powi(2) * (TAU * hz * t).sin();
            record.time_s.push(t);
            record.displacement_m.push(gain * sines.map(of).iter().sum::<f64>() + noise(2e-5));
            record.acceleration_m_s2.push(sines.map(at).iter().sum::<f64>() + noise(0.01));
            record.force_n.push(0.0);
        }
        record
    }

    #[test]
    fn delay_and_ratio_of_gains_are_known_as_well_as_they_say() {
        let mut deviations = Vec::new();
        for seed in 0..12 {
            let found = examine(&record(1e-3, 1.02, seed), Tolerances::default()).expect("long enough");
            let ratio = found.laser_gain.value / found.accelerometers[0].gain.value;
            assert!((ratio - 1.02).abs() < 1e-3, "{ratio}");
            // By their tolerances it is the accelerometer that is off.
            assert!((found.accelerometers[0].gain.value - 1.0 / 1.019).abs() < 1e-3, "{found:?}");
            assert!((found.laser_delay_s.value - 1e-3).abs() < 1e-4, "{found:?}");
            assert!((0.8..1.2).contains(&found.misfit), "{found:?}");
            deviations.push((found.laser_delay_s.value - 1e-3) / found.laser_delay_s.sigma);
        }
        let rms = (deviations.iter().map(|z| z * z).sum::<f64>() / deviations.len() as f64).sqrt();
        assert!((0.5..1.6).contains(&rms), "{deviations:?}");
    }

    #[test]
    fn the_later_one_is_late() {
        let found = examine(&record(-8e-4, 1.0, 3), Tolerances::default()).expect("long enough");
        assert_eq!(found.laser_delay_s.value, 0.0);
        let late = found.accelerometers_late_s();
        assert!((late.value - 8e-4).abs() < 4.0 * late.sigma && late.sigma < 1e-4, "{late:?}");
    }

    #[test]
    fn without_one_of_both_nothing_is_told() {
        let mut alone = record(0.0, 1.0, 1);
        alone.acceleration_m_s2.clear();
        assert!(examine(&alone, Tolerances::default()).is_none());
    }

    #[test]
    fn two_motions_tell_nothing_of_gains() {
        let mut other = record(0.0, 1.0, 1);
        other.acceleration_m_s2.reverse();
        assert!(examine(&other, Tolerances::default()).is_none());
    }
}
