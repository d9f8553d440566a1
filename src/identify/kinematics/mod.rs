//! Are the instruments sound? Answered from kinematics alone, whatever the model is.
//!
//! The laser sees D, the accelerometers A and a_table, and `D'' = A - a_table` must hold. Per
//! accelerometer `D = alpha A + beta a_table`, integrated twice and band-passed alike, is fitted
//! with a delay of each side; samples near the ends of the record do not count. Gains come out to
//! about 1e-4 and delays to some microseconds. The common gain of all accelerometers cannot be
//! told from the laser's. Of an applied force, `D'' = A` alone is asked (`applied`).

mod applied;
mod band;
mod yaw;

use band::Band;
pub use yaw::Yaw;

use super::least_squares::{self, Free, Settings, dot};
use super::response::beside_jumps_of_few_samples;
use super::spectral::noise_of_whole;
use crate::model::elementary::sin_cos;
use crate::parallel;
use crate::record::{Kind, Record};
use crate::signal::Spectrum;
use nalgebra::{Matrix2, Matrix4, SMatrix, SVector, Vector4};
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

/// Share of a sample from which on a delay counts.
pub(crate) const OF_A_SAMPLE: f64 = 0.1;

impl Estimate {
    /// A delay (s) that is beyond doubt, and more than a share of a sample.
    pub(crate) fn is_late(&self, share: f64, rate_hz: f64) -> bool {
        self.value.abs() > (4.0 * self.sigma).max(share / rate_hz)
    }
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
    /// Rotation of the mass that its accelerometers show.
    pub yaw: Option<Yaw>,
}

impl Instruments {
    /// Unit gains and no delays, with the noise of the record: where it is too short to tell more.
    pub fn assumed_sound(record: &Record) -> Self {
        let rate = record.sample_rate_hz;
        let noise = |channel: &[f64]| noise_of_whole(channel, &Spectrum::tapered(channel, rate));
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

    /// The figures in a sentence, for a record of a kind.
    pub fn told(&self, kind: Kind) -> String {
        let [a, b] = self.accelerometers;
        let (gain, late_us) = (self.laser_gain.value, 1e6 * self.laser_delay_s.value);
        let laser_um = 1e6 * self.laser_noise_m;
        if kind == Kind::Force {
            return format!(
                "instruments: gain of the displacement {gain:.4} and of the acceleration {:.4}, told by their ratio; displacement late by {late_us:.0} us, acceleration by {:.0} us; noise {:.4} m/s2 and {laser_um:.1} um (taken out below tolerance)",
                a.gain.value,
                1e6 * a.delay_s.value,
                a.noise_m_s2,
            );
        }
        format!(
            "instruments: laser gain {gain:.4}, late by {late_us:.0} us; accelerometer gains {:.4} and {:.4}; table acceleration leaks {:.2} % and {:.2} %; noise {:.4} and {:.4} m/s2, laser {laser_um:.1} um (taken out below tolerance)",
            a.gain.value,
            b.gain.value,
            100.0 * a.leak.value,
            100.0 * b.leak.value,
            a.noise_m_s2,
            b.noise_m_s2,
        )
    }

    /// Delay of both accelerometers against the table's, s. Its error is that of the laser and the table, the same in both.
    pub fn accelerometers_late_s(&self) -> Estimate {
        let [one, two] = self.accelerometers.map(|a| a.delay_s);
        Estimate { value: 0.5 * (one.value + two.value), sigma: 0.5 * (one.sigma + two.sigma) }
    }
}

/// Two accelerometers that differ by less, over what they show at high frequencies, are one.
const LEAST: f64 = 0.05;

/// Estimates gains, delays, leaks and noise of a base record; of one of an applied force, gain and delay of its displacement and its
/// acceleration against each other.
///
/// `None` when the record is of no such kind, lacks one of them or is too short to tell.
pub fn examine(record: &Record, tolerances: Tolerances) -> Option<Instruments> {
    match record.kind {
        Kind::Base => on_a_base(record, tolerances),
        Kind::Force => applied::examine(record, tolerances),
        Kind::Component => None,
    }
}

fn on_a_base(record: &Record, tolerances: Tolerances) -> Option<Instruments> {
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
    // Each with how it goes on beyond its ends.
    type Whole = fn(&[f64], f64) -> Spectrum;
    let channels: [(&Vec<f64>, Whole); 4] = [
        (&record.relative_displacement_m, Spectrum::of),
        (&record.table_acceleration_m_s2, Spectrum::of_second_derivative),
        (&record.mass_acceleration_1_m_s2, Spectrum::of_second_derivative),
        (second, Spectrum::of_second_derivative),
    ];
    let seen = parallel::map(&channels, parallel::cores(), |(channel, of)| {
        let tapered = Spectrum::tapered(channel, rate);
        (of(channel, rate), noise_of_whole(channel, &tapered), tapered)
    });
    let [(laser, laser_noise_m, tapered_laser), (table, table_noise_m_s2, _), one, two] =
        seen.try_into().ok()?;
    // The jumps of impacts and friction are in both accelerometers alike, their noise is not.
    let apart: Vec<f64> =
        record.mass_acceleration_1_m_s2.iter().zip(second).map(|(one, two)| one - two).collect();
    let (both, apart) = (one.1.hypot(two.1), noise_of_whole(&apart, &Spectrum::tapered(&apart, rate)));
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
    let rms = relations.iter().map(Relation::rms).fold(0.0, f64::max);
    found.misfit = rms / band.expected_rms(&laser).max(1e-300);
    Some(match yaw::yaw(record, &mass_noise_m_s2) {
        Some(yaw) => found.turned(yaw, tolerances),
        None => found,
    })
}

/// `D = alpha A(t - dtA) + beta a_table(t - dtT)`, integrated twice, for one accelerometer.
struct Relation {
    /// alpha and beta with their covariance.
    gains: ([f64; 2], Matrix2<f64>),
    table_shift_s: Estimate,
    /// Delay of the accelerometer against the table's. Where A is nearly a_table only the sum of both shifts is known well.
    delay_s: Estimate,
    /// What is left of D, in units of its noise.
    left: Vec<f64>,
}

impl Relation {
    /// RMS of what is left.
    fn rms(&self) -> f64 {
        (dot(&self.left, &self.left) / (self.left.len() as f64 - 4.0).max(1.0)).sqrt()
    }

    fn fit(laser: &Spectrum, table: &Spectrum, mass: &Spectrum, band: &Band) -> Option<Self> {
        let d = band.series(laser, |_| Complex64::ONE);
        let (mut shift_a, mut shift_t) = (0.0, 0.0);
        let mut last = None;
        for _ in 0..3 {
            let columns = [
                band.series(mass, twice(shift_a)),
                band.series(table, twice(shift_t)),
                band.series(mass, twice_by_shift(shift_a)),
                band.series(table, twice_by_shift(shift_t)),
            ];
            let (x, covariance, left) = regress(&columns, &d, band.colour)?;
            // A shift by dt is -dt times the derivative.
            let (da, dt) = (-x[2] / x[0], -x[3] / x[1]);
            shift_a += da;
            shift_t += dt;
            let (a, t) = (1.0 / x[0], 1.0 / x[1]);
            let (vary_a, vary_t) = (covariance[(2, 2)] * a * a, covariance[(3, 3)] * t * t);
            let apart = vary_a + vary_t - 2.0 * covariance[(2, 3)] * a * t;
            last = Some(Self {
                gains: ([x[0], x[1]], covariance.fixed_view::<2, 2>(0, 0).into()),
                table_shift_s: Estimate { value: shift_t, sigma: vary_t.sqrt() },
                delay_s: Estimate { value: shift_t - shift_a, sigma: apart.max(0.0).sqrt() },
                left,
            });
            if da.abs().max(dt.abs()) < 1e-7 {
                break;
            }
        }
        last.filter(|r| r.gains.0.iter().all(|gain| gain.is_finite()))
    }
}

/// A channel of a noise as it would be had it not been late. One with the corners of impacts rings when it is shifted by a part of a sample:
/// then only a delay of a good part of one is taken out.
pub(super) fn on_time(channel: &[f64], late: Estimate, noise: f64, rate_hz: f64) -> Vec<f64> {
    let is_smooth = || beside_jumps_of_few_samples(channel, noise).iter().all(|smooth| *smooth);
    if late.is_late(OF_A_SAMPLE, rate_hz) || late.is_late(0.0, rate_hz) && is_smooth() {
        earlier(channel, late.value, rate_hz)
    } else {
        channel.to_vec()
    }
}

/// A channel so much earlier, s.
pub(crate) fn earlier(channel: &[f64], by_s: f64, rate_hz: f64) -> Vec<f64> {
    Spectrum::of(channel, rate_hz).multiply(|w| Complex64::from_polar(1.0, w * by_s)).channel()
}

/// Least squares of a few columns: coefficients, their covariance, what is left.
fn regress<const N: usize>(
    columns: &[Vec<f64>; N],
    target: &[f64],
    colour: f64,
) -> Option<(SVector<f64, N>, SMatrix<f64, N, N>, Vec<f64>)> {
    let scale = SVector::<f64, N>::from_fn(|j, _| dot(&columns[j], &columns[j]).sqrt().max(1e-300));
    let normal = SMatrix::<f64, N, N>::from_fn(|i, j| dot(&columns[i], &columns[j]) / (scale[i] * scale[j]));
    let right = SVector::<f64, N>::from_fn(|j, _| dot(&columns[j], target) / scale[j]);
    let inverse = normal.try_inverse()?;
    let x = (inverse * right).component_div(&scale);
    let left: Vec<f64> = (0..target.len())
        .map(|n| target[n] - columns.iter().zip(x.iter()).map(|(column, x)| x * column[n]).sum::<f64>())
        .collect();
    let variance = colour * dot(&left, &left) / (target.len() as f64 - N as f64).max(1.0);
    let covariance = SMatrix::from_fn(|i, j| inverse[(i, j)] * variance / (scale[i] * scale[j]));
    Some((x, covariance, left))
}

/// A channel integrated twice and shifted by a time, s.
fn twice(shift_s: f64) -> impl Fn(f64) -> Complex64 {
    move |w: f64| {
        let (sin, cos) = sin_cos(w * shift_s);
        Complex64::new(-cos, sin) / (w * w)
    }
}

/// What that changes by with the shift.
fn twice_by_shift(shift_s: f64) -> impl Fn(f64) -> Complex64 {
    move |w: f64| {
        let (sin, cos) = sin_cos(w * shift_s);
        Complex64::new(-sin, -cos) / w
    }
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
    let white = whitening(relations)?;
    let fit = least_squares::fit(&free, Settings { iterations: 30, ..Settings::default() }, |x, r| {
        let off = Vector4::from_fn(|row, _| {
            let (of, gain, leak) = (&relations[row / 2].gains.0, x[1 + row / 2], x[3 + row / 2]);
            if row % 2 == 0 { x[0] / gain - of[0] } else { -x[0] * (1.0 + leak / gain) - of[1] }
        });
        r.clear();
        r.extend((white * off).iter());
        true
    })?;
    let covariance = fit.covariance(&free, 1.0);
    let get = |j: usize| Estimate { value: fit.values[j], sigma: covariance[(j, j)].max(0.0).sqrt() };
    let [one, two] = relations;
    let accelerometer = |i: usize, relation: &Relation| Accelerometer {
        gain: get(1 + i),
        leak: get(3 + i),
        delay_s: relation.delay_s,
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

/// How alike what both relations leave is: the laser's noise and the table's are in both.
fn alike([one, two]: &[Relation; 2]) -> f64 {
    dot(&one.left, &two.left) / (dot(&one.left, &one.left) * dot(&two.left, &two.left)).sqrt().max(1e-300)
}

/// What makes the errors of alpha and beta of both relations white; nobody knows a gain to better than 1e-5. What they share goes by the
/// factors of their covariances, which differ as the gains do: with its mean in their place, errors that are nearly the same had none.
fn whitening(relations: &[Relation; 2]) -> Option<Matrix4<f64>> {
    let [one, two] = relations.each_ref().map(|relation| relation.gains.1);
    let both = one.cholesky()?.l() * two.cholesky()?.l().transpose() * alike(relations).clamp(0.0, 0.999);
    let mut covariance = Matrix4::from_diagonal_element(1e-10);
    for (row, column, block) in [(0, 0, one), (2, 2, two), (0, 2, both), (2, 0, both.transpose())] {
        let mut view = covariance.fixed_view_mut::<2, 2>(row, column);
        view += block;
    }
    covariance.cholesky()?.l().try_inverse()
}

#[cfg(test)]
mod tests {
    use super::*;
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
    fn gains_far_apart_are_told_of_noisy_sensors() {
        let mut record = record(1.0, 0.0, 0.88, 0.0);
        let mut random = rand_pcg::Pcg64::seed_from_u64(12);
        let normal = rand_distr::Normal::new(0.0, 1.0).expect("valid");
        let mut add = |channel: &mut Vec<f64>, rms: f64| {
            channel.iter_mut().for_each(|x| *x += rms * normal.sample(&mut random));
        };
        // The laser hisses so much that both relations leave nearly the same.
        add(&mut record.relative_displacement_m, 5e-4);
        let of = examine(&record, Tolerances::default()).expect("base record");
        let [one, two] = of.accelerometers.map(|a| a.gain.value);
        assert!((one / two - 0.88).abs() < 1e-3, "{one} {two}");
        assert!((two - 1.0).abs() < 0.02, "{two}");
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

    #[test]
    fn a_delay_is_known_no_better_than_it_says_where_the_mass_moves_with_the_table() {
        let normal = rand_distr::Normal::new(0.0, 1.0).expect("valid");
        let deviations = |seed: u64| {
            let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
            let mut noise = |rms: f64| rms * normal.sample(&mut random);
            let mut record = Record::empty("weak", Kind::Base, 512.0);
            for i in 0..30 * 512 {
                let t = f64::from(i) / 512.0;
                // Above its resonance the mass stays where it is, nearly.
                let wave = |hz: f64, phase: f64| (TAU * hz * t + phase).sin();
                let table = 0.4 * wave(1.9, 0.0) + 0.4 * wave(2.7, 1.0);
                let of = |hz: f64| -1.0 / (TAU * hz).powi(2);
                let (slow, fast) = (-0.52 * wave(1.9, -0.1), -0.46 * wave(2.7, 0.95));
                let mass = table + slow + fast;
                record.time_s.push(t);
                record.table_acceleration_m_s2.push(table + noise(0.003));
                record.mass_acceleration_1_m_s2.push(mass + noise(0.01));
                record.mass_acceleration_2_m_s2.push(mass + noise(0.01));
                record.relative_displacement_m.push(of(1.9) * slow + of(2.7) * fast + noise(3e-5));
            }
            let late = examine(&record, Tolerances::default()).expect("long enough").accelerometers_late_s();
            late.value / late.sigma
        };
        let squares: f64 = (0..24).map(deviations).map(|z| z * z).sum();
        let rms = (squares / 24.0).sqrt();
        assert!((0.6..1.4).contains(&rms), "{rms} deviations");
    }
}
