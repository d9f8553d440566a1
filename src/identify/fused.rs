//! Displacement, velocity and acceleration of a record that has a displacement sensor, accelerometers, or both: fused, differentiated or
//! integrated with zero phase, each with its noise. Called when a motion is made ready, and by the kinematics.

use super::motion::Motion;
use super::ramps::Ramps;
use super::together::Source;
use crate::parallel;
use crate::record::Record;
use crate::signal::Spectrum;
use realfft::num_complex::Complex64;
use std::f64::consts::PI;

/// Where a displacement's noise reaches its signal it is faded out over so much of that frequency.
const FADES_OVER: f64 = 0.6;
/// Bins that are looked at together at least: of noise alone, four stand above four times their mean once in ten thousand.
const LEAST_BINS: usize = 16;

/// Displacement and its derivatives with their noise.
pub(super) struct Fused {
    pub(super) displacement_m: Vec<f64>,
    pub(super) velocity_m_s: Vec<f64>,
    pub(super) acceleration_m_s2: Vec<f64>,
    pub(super) displacement_noise_m: f64,
    pub(super) velocity_noise_m_s: f64,
    pub(super) acceleration_noise_m_s2: f64,
    /// Whether each sample of the velocity is told, of what is imposed; else nothing.
    pub(super) velocity_is_told: Vec<bool>,
    /// Whether each sample is held where it is, of what is imposed; else nothing.
    pub(super) is_held: Vec<bool>,
}

impl Fused {
    /// Of a motion at constant velocities: nothing is known of the accelerations where it turns.
    pub(super) fn of_ramps(ramps: Ramps) -> Self {
        Self {
            acceleration_m_s2: vec![0.0; ramps.displacement_m.len()],
            velocity_is_told: ramps.velocity_is_told,
            is_held: Vec::new(),
            acceleration_noise_m_s2: 0.0,
            displacement_m: ramps.displacement_m,
            velocity_m_s: ramps.velocity_m_s,
            displacement_noise_m: ramps.displacement_noise_m,
            velocity_noise_m_s: ramps.velocity_noise_m_s,
        }
    }

    pub(super) fn motion(self, record: &Record) -> Motion {
        Motion {
            fastest_hz: 0.0,
            kind: record.kind,
            mass_kg: 1.0,
            sample_rate_hz: record.sample_rate_hz,
            sources: vec![Source {
                start_s: record.time_s.first().copied().unwrap_or(0.0),
                ..Source::default()
            }],
            displacement_m: self.displacement_m,
            velocity_m_s: self.velocity_m_s,
            velocity_is_told: self.velocity_is_told,
            is_held: self.is_held,
            restoring_m_s2: Vec::new(),
            drive_m_s2: Vec::new(),
            seen_drive_m_s2: Vec::new(),
            laser_m: Vec::new(),
            windows: Vec::new(),
            table_crossover_rad_s: 0.0,
            table_gain_sigma: 0.0,
            sees_acceleration: true,
            drive_noise_m_s2: 0.0,
            restoring_noise_m_s2: 0.0,
            laser_noise_m: 0.0,
            displacement_noise_m: self.displacement_noise_m,
            velocity_noise_m_s: self.velocity_noise_m_s,
            instruments: None,
        }
    }
}

/// Wiener fusion: weight of the displacement `1/(1 + (w/wc)^4)`, `wc = (sa/sd)^(1/2)`.
pub(super) fn fuse(displacement: &[f64], sd: f64, acceleration: &[f64], sa: f64, rate: f64) -> Fused {
    let crossover = (sa.max(1e-300) / sd.max(1e-300)).sqrt();
    let low = |w: f64| 1.0 / (1.0 + (w / crossover).powi(4));
    let mut laser = Spectrum::of(displacement, rate);
    let inertial = Spectrum::of_second_derivative(acceleration, rate)
        .multiply(|w| if w > 0.0 { Complex64::from(-(1.0 - low(w)) / (w * w)) } else { Complex64::ZERO });
    laser = laser.multiply(|w| Complex64::from(low(w))).add(&inertial);
    derivatives(&laser, |w| {
        let sum = sd.powi(2) * low(w).powi(2);
        if w > 0.0 { sum + (sa * (1.0 - low(w)) / (w * w)).powi(2) } else { sum }
    })
}

/// Displacement alone: low-passed above where its noise reaches the signal, then differentiated. What is below is left as it is: a gain that
/// falls along a narrow band makes a growing motion one of other amplitudes, as a memory would.
pub(super) fn differentiate(displacement: &[f64], sd: f64, rate: f64) -> Fused {
    differentiated(&Spectrum::of(displacement, rate), cut_rad_s(displacement, sd, rate), sd)
}

/// Angular frequency above which a displacement is low-passed. What joins the ends beyond the record has corners of its own.
pub(super) fn cut_rad_s(displacement: &[f64], sd: f64, rate: f64) -> f64 {
    signal_end_rad_s(&Spectrum::eased(displacement, rate), sd)
}

/// What passes a low-pass that begins at a frequency.
pub(super) fn passes(w: f64, cut: f64) -> f64 {
    let beyond = ((w / cut - 1.0) / FADES_OVER).clamp(0.0, 1.0);
    (0.5 * PI * beyond).cos().powi(2)
}

/// A displacement of that spectrum and a noise (m rms a sample), low-passed and differentiated.
pub(super) fn differentiated(spectrum: &Spectrum, cut: f64, sd: f64) -> Fused {
    let low = move |w: f64| passes(w, cut);
    derivatives(&spectrum.clone().multiply(|w| Complex64::from(low(w))), |w| (sd * low(w)).powi(2))
}

/// Acceleration alone: integrated above 0.3 of the frequency below which a hundredth of its power lies.
pub(super) fn integrate(acceleration: &[f64], sa: f64, rate: f64) -> Fused {
    let spectrum = Spectrum::fading(acceleration, rate);
    let total: f64 = spectrum.bins.iter().skip(1).map(|z| z.norm_sqr()).sum();
    let mut sum = 0.0;
    let main = (1..spectrum.bins.len()).find(|&bin| {
        sum += spectrum.bins[bin].norm_sqr();
        sum > 0.01 * total
    });
    let low_cut = 0.3 * spectrum.omega_rad_s(main.unwrap_or(1)).max(1e-9);
    let high = move |w: f64| {
        let h = (w / low_cut).powi(6);
        h / (1.0 + h)
    };
    let weight = move |w: f64| if w > 0.0 { -high(w) / (w * w) } else { 0.0 };
    derivatives(&spectrum.multiply(|w| Complex64::from(weight(w))), |w| (sa * weight(w)).powi(2))
}

/// The channel, its first and second derivative, and their noise from a density a bin.
fn derivatives(spectrum: &Spectrum, density: impl Fn(f64) -> f64 + Sync) -> Fused {
    let bins = spectrum.bins.len();
    let derived = parallel::map(&[0, 1, 2], parallel::cores(), |&order: &i32| {
        let at = |b: usize| spectrum.omega_rad_s(b);
        let sum: f64 = (0..bins).map(at).map(|w| density(w) * w.powi(2 * order)).sum();
        let derived = match order {
            0 => spectrum.clone(),
            1 => spectrum.clone().multiply(|w| Complex64::new(0.0, w)),
            _ => spectrum.clone().multiply(|w| Complex64::from(-w * w)),
        };
        (derived.channel(), (sum / bins as f64).sqrt())
    });
    let [displacement, velocity, acceleration] = <[_; 3]>::try_from(derived).unwrap_or_default();
    Fused {
        displacement_m: displacement.0,
        velocity_m_s: velocity.0,
        acceleration_m_s2: acceleration.0,
        displacement_noise_m: displacement.1,
        velocity_noise_m_s: velocity.1,
        acceleration_noise_m_s2: acceleration.1,
        velocity_is_told: Vec::new(),
        is_held: Vec::new(),
    }
}

/// Highest angular frequency at which the smoothed spectrum stands above the noise.
fn signal_end_rad_s(spectrum: &Spectrum, noise: f64) -> f64 {
    let floor = 4.0 * spectrum.white_noise_power(noise);
    let width = (spectrum.bins.len() / 400).max(LEAST_BINS);
    let above =
        |chunk: &[Complex64]| chunk.iter().map(|z| z.norm_sqr()).sum::<f64>() > floor * chunk.len() as f64;
    let end = spectrum.bins.chunks(width).rposition(above).map_or(width, |i| (i + 1) * width);
    spectrum.omega_rad_s(end.min(spectrum.bins.len() - 1)).max(spectrum.omega_rad_s(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn a_motion_that_ends_anywhere_is_known_up_to_there() {
        let (rate, w) = (2048.0, TAU * 1.3);
        for turn in [0.3, 1.2, 2.5, 4.0] {
            let n = 20_000 + (turn / w * rate) as usize;
            let at = |i: usize, derivative: f64| (w * i as f64 / rate + derivative * 0.25 * TAU).sin();
            let displacement: Vec<f64> = (0..n).map(|i| 0.01 * at(i, 0.0)).collect();
            // The accelerometer has a zero of its own.
            let acceleration: Vec<f64> = displacement.iter().map(|d| 2.0 - w * w * d).collect();
            let fused = fuse(&displacement, 30e-6, &acceleration, 0.01, rate);
            let off = |i: &usize| (fused.velocity_m_s[*i] - 0.01 * w * at(*i, 1.0)).abs();
            let most = (n - 1000..n).map(|i| off(&i)).fold(0.0, f64::max);
            assert!(most < 1e-2 * 0.01 * w, "{turn}: {most}");
        }
    }

    #[test]
    fn an_acceleration_that_ends_anywhere_is_integrated_without_running_away() {
        let (rate, w) = (610.0, TAU * 68.0);
        for samples in [6000, 6001, 6002, 6003, 6004] {
            let acceleration: Vec<f64> =
                (0..samples).map(|i| -w * w * (w * f64::from(i) / rate + 0.7).sin()).collect();
            let fused = integrate(&acceleration, 1e-3, rate);
            let off = |i: usize| (fused.displacement_m[i] - (w * i as f64 / rate + 0.7).sin()).abs();
            let [inner, outer] = [50..samples as usize - 50, 0..samples as usize]
                .map(|range| range.map(off).fold(0.0, f64::max));
            assert!(inner < 0.03 && outer < 0.5, "{samples}: {inner} {outer}");
        }
    }
}
