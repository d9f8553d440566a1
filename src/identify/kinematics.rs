//! Are the instruments sound? Answered from kinematics alone, whatever the model is.
//!
//! The laser sees D, the accelerometers A and a_table, and `D'' = A - a_table` must hold. Per
//! accelerometer `D = alpha A + beta a_table`, integrated twice and band-passed alike, is fitted
//! with a delay of each side; samples near the ends of the record do not count. Gains come out to
//! about 1e-4 and delays to some microseconds. The common gain of all accelerometers cannot be
//! told from the laser's.

use super::least_squares::{self, Free, Settings, dot};
use super::spectral::{Spectrum, white_noise_rms};
use crate::model::elementary::sin_cos;
use crate::parallel;
use crate::record::Record;
use realfft::num_complex::Complex64;

/// What an instrument may deviate before it is a finding (relative half-widths).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerances {
    /// Gain of an accelerometer.
    pub accelerometer_gain: f64,
    /// Table acceleration seen by an accelerometer on the mass.
    pub leak: f64,
    /// Gain of the laser.
    pub laser_gain: f64,
    /// Delay of one channel against the others, s.
    pub delay_s: f64,
}

impl Default for Tolerances {
    fn default() -> Self {
        Self { accelerometer_gain: 0.005, leak: 0.005, laser_gain: 0.001, delay_s: 5e-5 }
    }
}

/// One number with its standard error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Best value.
    pub value: f64,
    /// Standard error.
    pub sigma: f64,
}

/// One accelerometer on the mass against laser and table.
#[derive(Clone, Copy, Debug, Default)]
pub struct Accelerometer {
    /// Gain relative to laser and table.
    pub gain: Estimate,
    /// Delay relative to the table's accelerometer, s.
    pub delay_s: Estimate,
    /// Share of the table acceleration that leaks in (or table gain), relative.
    pub leak: Estimate,
    /// White noise, m/s2 rms.
    pub noise_m_s2: f64,
}

/// The instruments of a record.
#[derive(Clone, Debug, Default)]
pub struct Instruments {
    /// Both accelerometers.
    pub accelerometers: [Accelerometer; 2],
    /// Gain of the laser against the mean of all accelerations, tolerances taken as priors.
    pub laser_gain: Estimate,
    /// Delay of the laser against the table's accelerometer, s.
    pub laser_delay_s: Estimate,
    /// White noise of the laser, m rms.
    pub laser_noise_m: f64,
    /// White noise of the table's accelerometer, m/s2 rms.
    pub table_noise_m_s2: f64,
    /// Misfit of the kinematic relation against its own noise, 1 when sound.
    pub misfit: f64,
}

impl Instruments {
    /// Unit gains and no delays, with the noise of the record: where it is too short to tell more.
    pub fn assumed_sound(record: &Record) -> Self {
        let rate = record.sample_rate_hz;
        let noise = |channel: &[f64]| noise_under_taper(&tapered(channel, rate));
        let sound = |channel: &[f64]| Accelerometer {
            gain: Estimate { value: 1.0, sigma: 0.0 },
            noise_m_s2: noise(channel),
            ..Accelerometer::default()
        };
        Self {
            accelerometers: [
                sound(&record.mass_acceleration_1_m_s2),
                sound(&record.mass_acceleration_2_m_s2),
            ],
            laser_gain: Estimate { value: 1.0, sigma: 0.0 },
            laser_noise_m: noise(&record.relative_displacement_m),
            table_noise_m_s2: noise(&record.table_acceleration_m_s2),
            misfit: 1.0,
            ..Self::default()
        }
    }
}

/// Two accelerometers that differ by less, over what they show at high frequencies, are one.
const LEAST: f64 = 0.05;

/// Estimates gains, delays, leaks and noise of a base record.
///
/// `None` when the record is not of that kind or too short to tell.
pub fn examine(record: &Record, tolerances: Tolerances) -> Option<Instruments> {
    let n = record.relative_displacement_m.len();
    let rate = record.sample_rate_hz;
    let second = if record.mass_acceleration_2_m_s2.len() == n {
        &record.mass_acceleration_2_m_s2
    } else {
        &record.mass_acceleration_1_m_s2
    };
    if n < 64 || record.table_acceleration_m_s2.len() != n || record.mass_acceleration_1_m_s2.len() != n {
        return None;
    }
    let channels = [
        &record.relative_displacement_m,
        &record.table_acceleration_m_s2,
        &record.mass_acceleration_1_m_s2,
        second,
    ];
    let seen = parallel::map(&channels, parallel::cores(), |channel| {
        let tapered = tapered(channel, rate);
        (Spectrum::of(channel, rate), noise_under_taper(&tapered), tapered)
    });
    let [(laser, laser_noise_m, tapered_laser), (table, table_noise_m_s2, _), one, two] =
        seen.try_into().ok()?;
    // The jumps of impacts and friction are in both accelerometers alike, their noise is not.
    let apart: Vec<f64> =
        record.mass_acceleration_1_m_s2.iter().zip(second).map(|(one, two)| one - two).collect();
    let (both, apart) = (one.1.hypot(two.1), noise_under_taper(&tapered(&apart, rate)));
    // Channels that are the same come from one sensor.
    let own = if apart > LEAST * both { (apart / both).min(1.0) } else { 1.0 };
    let mass_noise_m_s2 = [one.1, two.1].map(|noise| own * noise);
    let acceleration_noise_m_s2 = table_noise_m_s2.hypot(mass_noise_m_s2[0].max(mass_noise_m_s2[1]));
    let band = Band::of(&tapered_laser, laser_noise_m, acceleration_noise_m_s2)?;
    let related =
        parallel::map(&[one.0, two.0], parallel::cores(), |mass| Relation::fit(&laser, &table, mass, &band));
    let relations: [Relation; 2] = related.into_iter().collect::<Option<Vec<_>>>()?.try_into().ok()?;
    let mut found = share_gains(&relations, tolerances)?;
    found.laser_noise_m = laser_noise_m;
    found.table_noise_m_s2 = table_noise_m_s2;
    for (accelerometer, noise) in found.accelerometers.iter_mut().zip(mass_noise_m_s2) {
        accelerometer.noise_m_s2 = noise;
    }
    found.misfit = relations[0].rms.max(relations[1].rms) / band.expected_rms(&laser).max(1e-300);
    Some(found)
}

/// Mean square of the window under which noise is measured.
pub const HANN_MEAN_SQUARE: f64 = 1.5;

/// Spectrum under a Hann window, which shows where the motion is without the ends' leakage.
pub fn tapered(channel: &[f64], rate: f64) -> Spectrum {
    let mean = channel.iter().sum::<f64>() / channel.len().max(1) as f64;
    let window = |i: usize| 1.0 - (std::f64::consts::TAU * i as f64 / channel.len() as f64).cos();
    let windowed: Vec<f64> = channel.iter().enumerate().map(|(i, x)| (x - mean) * window(i)).collect();
    Spectrum::of(&windowed, rate)
}

/// White noise of a channel, rms, from its tapered spectrum.
fn noise_under_taper(tapered: &Spectrum) -> f64 {
    white_noise_rms(tapered, 0.5, 0.9) / HANN_MEAN_SQUARE.sqrt()
}

/// The band in which the relation is tested, and the samples far enough from the ends.
struct Band {
    low_rad_s: f64,
    high_rad_s: f64,
    interior: std::ops::Range<usize>,
    stride: usize,
    laser_noise_m: f64,
    acceleration_noise_m_s2: f64,
}

impl Band {
    /// From half the frequency below which 1 % of the motion lies to where the laser's noise
    /// reaches the motion.
    fn of(laser: &Spectrum, laser_noise_m: f64, acceleration_noise_m_s2: f64) -> Option<Self> {
        let power: Vec<f64> = laser.bins.iter().map(|z| z.norm_sqr()).collect();
        let first = laser.band(0.0, 1e300).start + 2;
        let floor = 4.0 * laser.bins.len() as f64 * 2.0 * laser_noise_m * laser_noise_m;
        let total: f64 = power.get(first..)?.iter().filter(|p| **p > floor).sum();
        let mut sum = 0.0;
        let mut low = None;
        let mut high = first;
        for (bin, p) in power.iter().enumerate().skip(first).filter(|(_, p)| **p > floor) {
            sum += p;
            if low.is_none() && sum > 0.01 * total {
                low = Some(bin);
            }
            if sum < 0.9999 * total {
                high = bin;
            }
        }
        let low_rad_s = 0.5 * laser.omega_rad_s(low?);
        let high_rad_s = (1.5 * laser.omega_rad_s(high)).max(4.0 * low_rad_s);
        let edge = (8.0 / low_rad_s * laser.sample_rate_hz()) as usize;
        let samples = laser.samples();
        if samples < 3 * edge {
            return None;
        }
        let stride = ((laser.sample_rate_hz() * std::f64::consts::PI / (2.0 * high_rad_s)) as usize).max(1);
        Some(Self {
            low_rad_s,
            high_rad_s,
            interior: edge..samples - edge,
            stride,
            laser_noise_m,
            acceleration_noise_m_s2,
        })
    }

    /// High-pass of fourth order (it swallows a double integration) and low-pass, times what makes
    /// the noise of the relation white with unit variance a sample: 1/m.
    fn gain(&self, w: f64) -> f64 {
        let h = (w / self.low_rad_s).powi(4);
        let density = self.laser_noise_m.powi(2) + (self.acceleration_noise_m_s2 / (w * w)).powi(2);
        h / (1.0 + h) / (1.0 + (w / self.high_rad_s).powi(8)) / density.sqrt().max(1e-12)
    }

    /// A channel filtered by the band times a factor, thinned to the interior.
    fn series(&self, spectrum: &Spectrum, factor: impl Fn(f64) -> Complex64) -> Vec<f64> {
        let filtered = spectrum
            .clone()
            .multiply(|w| if w > 0.0 { factor(w) * self.gain(w) } else { Complex64::ZERO })
            .channel();
        filtered[self.interior.clone()].iter().step_by(self.stride).copied().collect()
    }

    /// What the noise of laser and accelerometers leaves in the filtered relation, rms.
    fn expected_rms(&self, laser: &Spectrum) -> f64 {
        let power = |bin: usize| {
            let w = laser.omega_rad_s(bin);
            let density = self.laser_noise_m.powi(2) + (self.acceleration_noise_m_s2 / (w * w)).powi(2);
            self.gain(w).powi(2) * density
        };
        ((1..laser.bins.len()).map(power).sum::<f64>() / laser.bins.len() as f64).sqrt()
    }
}

/// `D = alpha A(t - dtA) + beta a_table(t - dtT)`, integrated twice, for one accelerometer.
struct Relation {
    alpha: Estimate,
    beta: Estimate,
    accelerometer_shift_s: Estimate,
    table_shift_s: Estimate,
    rms: f64,
}

impl Relation {
    fn fit(laser: &Spectrum, table: &Spectrum, mass: &Spectrum, band: &Band) -> Option<Self> {
        let d = band.series(laser, |_| Complex64::ONE);
        let (mut shift_a, mut shift_t) = (0.0, 0.0);
        let mut last = None;
        for _ in 0..3 {
            let twice = |shift: f64| {
                move |w: f64| {
                    let (sin, cos) = sin_cos(w * shift);
                    Complex64::new(-cos, sin) / (w * w)
                }
            };
            let rate = |shift: f64| {
                move |w: f64| {
                    let (sin, cos) = sin_cos(w * shift);
                    Complex64::new(-sin, -cos) / w
                }
            };
            let columns = [
                band.series(mass, twice(shift_a)),
                band.series(table, twice(shift_t)),
                band.series(mass, rate(shift_a)),
                band.series(table, rate(shift_t)),
            ];
            let (x, covariance, rms) = regress(&columns, &d)?;
            // A shift by dt is -dt times the derivative.
            let (da, dt) = (-x[2] / x[0], -x[3] / x[1]);
            shift_a += da;
            shift_t += dt;
            let estimate =
                |value: f64, j: usize, scale: f64| Estimate { value, sigma: covariance[j].sqrt() / scale };
            last = Some(Self {
                alpha: estimate(x[0], 0, 1.0),
                beta: estimate(x[1], 1, 1.0),
                accelerometer_shift_s: estimate(shift_a, 2, x[0].abs()),
                table_shift_s: estimate(shift_t, 3, x[1].abs()),
                rms,
            });
            if da.abs().max(dt.abs()) < 1e-7 {
                break;
            }
        }
        last.filter(|r| r.alpha.value.is_finite() && r.beta.value.is_finite())
    }
}

/// Least squares of four columns: coefficients, their variances, RMS of what is left.
fn regress(columns: &[Vec<f64>; 4], target: &[f64]) -> Option<([f64; 4], [f64; 4], f64)> {
    use nalgebra::{Matrix4, Vector4};
    let scale: [f64; 4] = std::array::from_fn(|j| dot(&columns[j], &columns[j]).sqrt().max(1e-300));
    let normal = Matrix4::from_fn(|i, j| dot(&columns[i], &columns[j]) / (scale[i] * scale[j]));
    let right = Vector4::from_fn(|j, _| dot(&columns[j], target) / scale[j]);
    let inverse = normal.try_inverse()?;
    let x = inverse * right;
    let left = (dot(target, target) - x.dot(&right)).max(0.0) / (target.len() as f64 - 4.0).max(1.0);
    Some((
        std::array::from_fn(|j| x[j] / scale[j]),
        std::array::from_fn(|j| inverse[(j, j)] * left / (scale[j] * scale[j])),
        left.sqrt(),
    ))
}

/// Lays each ratio at a door: `alpha = gL/g_i`, `-beta = gL (1 + leak_i/g_i)`, with the tolerances
/// as wide priors that decide only what the record cannot.
fn share_gains(relations: &[Relation; 2], tolerances: Tolerances) -> Option<Instruments> {
    let number = |key: &str, start: f64, sigma: f64| Free {
        key: key.into(),
        start,
        scale: 1e-2,
        prior: (start, sigma),
        bounds: (start - 0.95, start + 9.0),
    };
    let free = [
        number("laser gain", 1.0, 20.0 * tolerances.laser_gain),
        number("gain 1", 1.0, 4.0 * tolerances.accelerometer_gain),
        number("gain 2", 1.0, 4.0 * tolerances.accelerometer_gain),
        number("leak 1", 0.0, 0.5 * tolerances.leak),
        number("leak 2", 0.0, 0.5 * tolerances.leak),
    ];
    let fit = least_squares::fit(&free, Settings { iterations: 30, ..Settings::default() }, |x, r| {
        r.clear();
        for (i, relation) in relations.iter().enumerate() {
            let (gain, leak) = (x[1 + i], x[3 + i]);
            r.push((x[0] / gain - relation.alpha.value) / relation.alpha.sigma.max(1e-5));
            r.push((x[0] * (1.0 + leak / gain) + relation.beta.value) / relation.beta.sigma.max(1e-5));
        }
        true
    })?;
    let covariance = fit.covariance(&free, 1.0);
    let get = |j: usize| Estimate { value: fit.values[j], sigma: covariance[(j, j)].max(0.0).sqrt() };
    let [one, two] = relations;
    let accelerometer = |i: usize, relation: &Relation| Accelerometer {
        gain: get(1 + i),
        leak: get(3 + i),
        delay_s: Estimate {
            value: relation.table_shift_s.value - relation.accelerometer_shift_s.value,
            sigma: relation.table_shift_s.sigma.hypot(relation.accelerometer_shift_s.sigma),
        },
        noise_m_s2: 0.0,
    };
    Some(Instruments {
        accelerometers: [accelerometer(0, one), accelerometer(1, two)],
        laser_gain: get(0),
        laser_delay_s: Estimate {
            value: 0.5 * (one.table_shift_s.value + two.table_shift_s.value),
            sigma: one.table_shift_s.sigma.min(two.table_shift_s.sigma),
        },
        ..Instruments::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Kind;
    use rand::{SeedableRng, prelude::Distribution};
    use std::f64::consts::TAU;

    /// D is given in closed form, A follows from kinematics.
    fn record(laser_gain: f64, laser_delay_s: f64, gain_1: f64, leak_2: f64) -> Record {
        let rate = 1024.0;
        let mut random = rand_pcg::Pcg64::seed_from_u64(11);
        let normal = rand_distr::Normal::new(0.0, 1.0).expect("valid");
        let n = 60 * 1024;
        let motion = |t: f64| {
            // Two components with phases of their own, so that A and a_table are not collinear.
            let p = std::f64::consts::TAU * (0.6 * t + 0.03 * t * t);
            let w = std::f64::consts::TAU * (0.6 + 0.06 * t);
            let k = std::f64::consts::TAU * 0.06;
            let x = 0.01 * (p - 0.4).sin() + 0.002 * (3.0 * p).sin();
            let a = 0.01 * (k * (p - 0.4).cos() - w * w * (p - 0.4).sin())
                + 0.002 * (3.0 * k * (3.0 * p).cos() - 9.0 * w * w * (3.0 * p).sin());
            (x, a, 0.5 * p.sin())
        };
        let mut out = Record::empty("test", crate::record::Kind::Base, rate);
        out.time_s = (0..n).map(|i| i as f64 / rate).collect();
        for i in 0..n {
            let t = i as f64 / rate;
            let (_, a_rel, table) = motion(t);
            let mut noise = |s: f64| s * normal.sample(&mut random);
            out.table_acceleration_m_s2.push(table + noise(0.01));
            out.mass_acceleration_1_m_s2.push(gain_1 * (a_rel + table) + noise(0.01));
            out.mass_acceleration_2_m_s2.push(a_rel + table + leak_2 * table + noise(0.01));
            out.relative_displacement_m.push(laser_gain * motion(t - laser_delay_s).0 + noise(3e-5));
        }
        out
    }

    #[test]
    fn a_late_laser_and_a_leak_are_measured() {
        let found = examine(&record(1.0, 4e-4, 1.0, 0.002), Tolerances::default()).expect("base record");
        let within = |e: Estimate, truth: f64| (e.value - truth).abs() < 3.5 * e.sigma && e.sigma < 0.003;
        assert!(within(found.laser_delay_s, 4e-4) && found.laser_delay_s.sigma < 3e-5, "{found:?}");
        assert!(within(found.accelerometers[1].leak, 0.002), "{found:?}");
        assert!(within(found.accelerometers[0].leak, 0.0), "{found:?}");
        assert!(within(found.accelerometers[0].delay_s, 0.0), "{found:?}");
        assert!((0.8..1.3).contains(&found.misfit), "{found:?}");
        assert!((found.laser_noise_m / 3e-5 - 1.0).abs() < 0.1, "{found:?}");
    }

    #[test]
    fn a_gain_is_laid_at_the_right_door() {
        let laser = examine(&record(1.03, 0.0, 1.0, 0.0), Tolerances::default()).expect("base record");
        assert!((laser.laser_gain.value - 1.03).abs() < 3e-3, "{laser:?}");
        let one = examine(&record(1.0, 0.0, 1.03, 0.0), Tolerances::default()).expect("base record");
        assert!((one.accelerometers[0].gain.value - 1.03).abs() < 3e-3, "{one:?}");
        assert!((one.laser_gain.value - 1.0).abs() < 2e-3, "{one:?}");
    }

    #[test]
    fn jumps_that_both_accelerometers_show_are_no_noise() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(9);
        let normal = rand_distr::StandardNormal;
        let mut noise = |s: f64| -> f64 {
            let z: f64 = normal.sample(&mut random);
            s * z
        };
        let mut record = Record::empty("jumps", Kind::Base, 1000.0);
        let mut jump = 0.0;
        for i in 0..20_000 {
            let t = f64::from(i) / 1000.0;
            let (sin, table) = ((TAU * 2.0 * t).sin(), noise(0.01));
            // Now and then, as no line of the spectrum is.
            if noise(1.0) > 2.0 {
                jump = 0.5 - jump;
            }
            record.time_s.push(t);
            record.table_acceleration_m_s2.push(table);
            record.mass_acceleration_1_m_s2.push(sin + jump + noise(0.01));
            record.mass_acceleration_2_m_s2.push(sin + jump + noise(0.01));
            record.relative_displacement_m.push(-sin / (TAU * 2.0).powi(2) + noise(3e-5));
        }
        let of = |record: &Record| {
            examine(record, Tolerances::default()).expect("long enough").accelerometers.map(|a| a.noise_m_s2)
        };
        for noise in of(&record) {
            assert!((noise / 0.01 - 1.0).abs() < 0.1, "{noise}");
        }
        // One sensor in both channels tells nothing of its noise.
        record.mass_acceleration_2_m_s2.clone_from(&record.mass_acceleration_1_m_s2);
        assert!(of(&record)[0] > 0.01);
    }
}
