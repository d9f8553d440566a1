//! What drives the simulation of a base record: the table's acceleration with as little as possible of the noise of its accelerometer. Below
//! some Hz the table's displacement knows it better, where it was measured; where the table moves periodically, its harmonics alone are
//! taken. Called once when a record is made ready.

use super::motion::{AsMeasured, Motion, Window};
use super::periodic::{periodic, smooth};
use crate::parallel;
use crate::record::{Kind, Record};
use crate::signal::TableNoise;
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::TAU;
use std::ops::Range;

/// A motion with more than this share of its sine beside it is no steady step with kicks, and is taken as it is.
const STEADY: f64 = 0.2;
/// Cycles of so many samples and more are long against what is smoothed.
const LONG: f64 = 320.0;
/// What is left between both sensors of the table below the crossover may have so many times the power of their noise: a displacement sensor
/// that is not linear bends the drive.
const NOISE: f64 = 2.0;
/// Crossovers that are worth it, rad/s, and that second differences stand for a derivative at, rad a sample.
const LOWEST_RAD_S: f64 = 3.0;
const HIGHEST: f64 = 0.1;
/// Shortest step, periods of the crossover over 2 pi.
const SHORTEST: f64 = 10.0;
/// Deviation of gain, lead (s) and zero of the accelerometer (m/s2) beforehand.
const EXPECTED: Vector3<f64> = Vector3::new(0.05, 5e-3, 1.0);
const COLUMNS: usize = 4;
/// Noise up to so many times the frequency of a step moves the mass, in one where it settles and in a steady one.
const SETTLING: f64 = 8.0;
const STEADILY: f64 = 2.0;
/// Parts of a mean over frequencies.
const PARTS: u8 = 16;

/// The acceleration of the table, from both of its sensors.
pub(super) struct Table {
    /// m/s2.
    pub acceleration_m_s2: Vec<f64>,
    /// Frequency at which both sensors are equally noisy, rad/s: below it the displacement tells the motion. 0 for an accelerometer alone.
    pub crossover_rad_s: f64,
    /// Deviation of the gain between both, of the whole record.
    pub gain_sigma: f64,
}

impl Table {
    /// From a record; the noise of the accelerometer is a deviation a sample.
    ///
    /// The most probable motion given both sensors and their white noise, within each of the stretches that a record may be put
    /// together from: Whittaker's smoother, in whose middle the displacement has the weight `1 / (1 + (w / w_c)^4)`, `w_c^2` the ratio of the
    /// noise of both, and the acceleration the rest (Eilers, Analytical Chemistry 75, 2003). Gain and delay of the displacement
    /// are taken to be the accelerometer's (generalised least squares). A displacement that differs by more than noise is left alone.
    pub fn of(record: &Record, accelerometer_noise_m_s2: f64) -> Self {
        fused(record, accelerometer_noise_m_s2).unwrap_or_else(|| Self {
            acceleration_m_s2: record.table_acceleration_m_s2.clone(),
            crossover_rad_s: 0.0,
            gain_sigma: 0.0,
        })
    }
}

fn fused(record: &Record, noise_m_s2: f64) -> Option<Table> {
    let (x, a) = (&record.table_displacement_m, &record.table_acceleration_m_s2);
    let dt = 1.0 / record.sample_rate_hz;
    let noise_m = TableNoise::of(x, a).displacement_m;
    let crossover_rad_s = (noise_m_s2 / noise_m).sqrt();
    let usable = x.len() == a.len() && x.iter().all(|x| x.is_finite()) && crossover_rad_s.is_finite();
    if !usable || !(LOWEST_RAD_S..=HIGHEST / dt).contains(&crossover_rad_s) {
        return None;
    }
    let smoothness = Left { crossover_rad_s }.smoothness(dt);
    // What the displacement says less what the accelerometer does, and what it may be made of: gain, lead and zero of the accelerometer.
    let mut steps: Vec<(usize, [Vec<f64>; 2 * COLUMNS])> = Vec::new();
    for range in stretches(record) {
        if range.len() as f64 * dt * crossover_rad_s < SHORTEST {
            continue;
        }
        let inner = range.start + 1..range.end - 1;
        let of = |value: &dyn Fn(usize) -> f64| inner.clone().map(value).collect::<Vec<f64>>();
        let columns = [
            of(&|n| (x[n - 1] - 2.0 * x[n] + x[n + 1]) / (dt * dt) - a[n]),
            of(&|n| a[n]),
            of(&|n| (a[n + 1] - a[n - 1]) / (2.0 * dt)),
            vec![1.0; inner.len()],
        ];
        let [apart, gain, lead, zero] = columns.clone().map(|column| smoothed(column, smoothness));
        let [c0, c1, c2, c3] = columns;
        steps.push((inner.start, [c0, c1, c2, c3, apart, gain, lead, zero]));
    }
    let mut normal = Matrix3::from_diagonal(&EXPECTED.map(|sigma| (noise_m_s2 / sigma).powi(2)));
    let mut right = Vector3::zeros();
    for (_, columns) in &steps {
        let dot = |i: usize, j: usize| -> f64 {
            columns[i].iter().zip(&columns[COLUMNS + j]).map(|(x, y)| x * y).sum()
        };
        normal += Matrix3::from_fn(|i, j| dot(i + 1, j + 1));
        right += Vector3::from_fn(|i, _| dot(i + 1, 0));
    }
    let inverse = normal.cholesky()?.inverse();
    let found = inverse * right;
    let mut acceleration_m_s2: Vec<f64> = a.iter().map(|a| a + found[2]).collect();
    let (mut squares, mut count) = (0.0, 0);
    for (start, [.., apart, gain, lead, zero]) in &steps {
        for (i, apart) in apart.iter().enumerate() {
            let left = apart - found[0] * gain[i] - found[1] * lead[i] - found[2] * zero[i];
            acceleration_m_s2[start + i] += left;
            squares += left * left;
        }
        count += apart.len();
    }
    // The integral of the weight over all frequencies.
    let expected = noise_m_s2.powi(2) * crossover_rad_s * dt / 8.0_f64.sqrt();
    let agrees = count > 0 && squares <= NOISE * expected * count as f64;
    agrees.then(|| Table {
        acceleration_m_s2,
        crossover_rad_s,
        gain_sigma: noise_m_s2 * inverse[(0, 0)].sqrt(),
    })
}

/// Stretches in which the table's motion goes on: a record is put together where a step follows another one at once; ramps and
/// transitions belong to the steps that they lead to.
fn stretches(record: &Record) -> Vec<Range<usize>> {
    let steps = record.step_ranges();
    let meet = steps.windows(2).filter(|two| two[0].1.end == two[1].1.start).map(|two| two[1].1.start);
    let ends: Vec<usize> = meet.chain([record.table_acceleration_m_s2.len()]).collect();
    std::iter::once(0).chain(ends.iter().copied()).zip(&ends).map(|(start, end)| start..*end).collect()
}

/// Solves `(1 + s D D') z = r`, `D` second differences, in place (Cholesky without roots of a matrix with five diagonals).
fn smoothed(mut r: Vec<f64>, s: f64) -> Vec<f64> {
    let n = r.len();
    // Pivot and the two entries of L below it.
    let mut factor = vec![(1.0, 0.0, 0.0); n];
    for i in 0..n {
        let (d1, l1, _) = if i > 0 { factor[i - 1] } else { (0.0, 0.0, 0.0) };
        let (d2, _, m2) = if i > 1 { factor[i - 2] } else { (0.0, 0.0, 0.0) };
        let m1 = if i > 0 { factor[i - 1].2 } else { 0.0 };
        let pivot = 1.0 + 6.0 * s - d1 * l1 * l1 - d2 * m2 * m2;
        factor[i] = (pivot, (-4.0 * s - d1 * l1 * m1) / pivot, s / pivot);
        if i > 0 {
            r[i] -= l1 * r[i - 1];
        }
        if i > 1 {
            r[i] -= m2 * r[i - 2];
        }
    }
    for i in (0..n).rev() {
        r[i] /= factor[i].0;
        if i + 1 < n {
            r[i] -= factor[i].1 * r[i + 1];
        }
        if i + 2 < n {
            r[i] -= factor[i].2 * r[i + 2];
        }
    }
    r
}

impl Motion {
    /// What drives a simulation has no noise where the table moves periodically, and less where impacts kick it alike in every
    /// cycle; a window tells what noise is left.
    pub(super) fn remove_noise_of_the_table(&mut self) {
        if self.drive_m_s2.is_empty() {
            return;
        }
        let rate = self.sample_rate_hz;
        let of_table = self.drive_noise_m_s2;
        let left = Left { crossover_rad_s: self.table_crossover_rad_s };
        let comes_back = self.kind == Kind::Base;
        let known = parallel::map(&self.windows, parallel::cores(), |window| {
            drive_of(window, &self.drive_m_s2, rate, (of_table, &left), comes_back)
        });
        for (window, known) in self.windows.iter_mut().zip(known) {
            window.wave_noise_m_s2 = of_table * left.at(window.frequency_hz).sqrt();
            window.drive_noise_m_s2 = known.noise_m_s2;
            window.as_measured = known.as_measured;
            let range = window.warm_from..window.range.end;
            self.drive_m_s2[range].iter_mut().zip(known.better).for_each(|(to, drive)| *to = drive);
        }
    }
}

/// What drives a window.
struct Drive {
    /// Noise that is left, m/s2 rms a sample, at the frequencies that the mass follows.
    noise_m_s2: f64,
    /// Where it is known no better than measured.
    as_measured: AsMeasured,
    /// From the beginning of the window's warming up on, m/s2, where anything is known better.
    better: Vec<f64>,
}

/// What drives a window, from what was measured; `of_table` is the noise of the table's accelerometer. What is no table
/// need not come back to where it was: an applied force may have a mean.
fn drive_of(
    window: &Window,
    measured: &[f64],
    rate: f64,
    (of_table, left): (f64, &Left),
    comes_back: bool,
) -> Drive {
    let follows_hz = window.frequency_hz * if window.settling { SETTLING } else { STEADILY };
    let both = of_table * left.up_to(follows_hz).sqrt();
    let range = window.warm_from..window.range.end;
    let all = AsMeasured { noise_m_s2: of_table, stretches: vec![range.clone()] };
    let as_measured = Drive { noise_m_s2: both, as_measured: all, better: Vec::new() };
    if window.settling {
        return as_measured;
    }
    let found = periodic(&measured[range.clone()], window.frequency_hz, rate, |hz| left.at(hz));
    let Some(found) = found else { return as_measured };
    let power = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>();
    if power(&found.rest) > STEADY * STEADY * power(&found.wave) {
        return as_measured;
    }
    // Impacts kick the table alike in every cycle of a steady step.
    let (mut rest, cycles) = match found.alike() {
        Some((alike, cycles)) => (alike, cycles),
        None if !found.white => return as_measured,
        None => (found.rest, 1.0),
    };
    let mut noise = both;
    if found.white {
        // Noise of the accelerometer within the kicks drives the mass slowly, too, unless what the displacement says of slow motion
        // stays in what lies between them.
        let kicked = found.still.iter().filter(|still| !**still).count() as f64 / range.len() as f64;
        let within = of_table * kicked.sqrt();
        noise = noise.min(within);
        let between: Vec<f64> =
            rest.iter().zip(&found.still).map(|(r, still)| if *still { *r } else { 0.0 }).collect();
        rest.iter_mut().zip(&between).for_each(|(rest, between)| *rest -= between);
        if both < within {
            let slow = smoothed(between, left.smoothness(1.0 / rate));
            rest.iter_mut().zip(slow).for_each(|(rest, slow)| *rest += slow);
        }
    }
    // Over whole cycles a table comes back to where it was; what the noise within the kicks has for a mean would push the mass aside.
    let mean_of = |x: &[f64]| x.iter().sum::<f64>() / x.len().max(1) as f64;
    let mean = mean_of(&rest);
    rest.iter_mut().for_each(|rest| *rest -= mean);
    // A solver takes long steps where what drives it is smooth; the impulse of a kick is what counts.
    if rate / window.frequency_hz.max(1e-9) > LONG {
        rest = smooth_but_for_bends(&rest);
    }
    let mut drive: Vec<f64> = found.wave.iter().zip(&rest).map(|(wave, rest)| wave + rest).collect();
    if !comes_back {
        let mean = mean_of(&measured[range]) - mean_of(&drive);
        drive.iter_mut().for_each(|drive| *drive += mean);
    }
    let kicked = found.still.iter().map(|still| !found.white || !still);
    let stretches = stretches_of(kicked, window.warm_from);
    let as_measured = AsMeasured { noise_m_s2: of_table / cycles.sqrt(), stretches };
    Drive { noise_m_s2: noise / cycles.sqrt(), as_measured, better: drive }
}

/// Stretches of those samples that are meant, the first of which has this number.
fn stretches_of(meant: impl Iterator<Item = bool>, first: usize) -> Vec<Range<usize>> {
    let mut stretches: Vec<Range<usize>> = Vec::new();
    for (n, _) in (first..).zip(meant).filter(|(_, meant)| *meant) {
        match stretches.last_mut().filter(|last| last.end == n) {
            Some(last) => last.end = n + 1,
            None => stretches.push(n..n + 1),
        }
    }
    stretches
}

/// Means over a kick's samples that leave bends as they are: what they take from a channel once is given back (twicing: Tukey, Exploratory
/// Data Analysis, 1977). A contact of 40 ms kicks the table by a hundredth less without, which had a bumper of 3 MN/m told 0.06 % too soft.
fn smooth_but_for_bends(channel: &[f64]) -> Vec<f64> {
    let once = smooth(&smooth(channel));
    let twice = smooth(&smooth(&once));
    once.iter().zip(twice).map(|(once, twice)| 2.0 * once - twice).collect()
}

/// How much of the power of the accelerometer's noise both sensors of the table leave.
struct Left {
    crossover_rad_s: f64,
}

impl Left {
    /// At a frequency; all of it where the accelerometer is alone.
    fn at(&self, hz: f64) -> f64 {
        let over = (TAU * hz / self.crossover_rad_s.max(1e-9)).powi(4);
        over / (1.0 + over)
    }

    /// The mean up to one.
    fn up_to(&self, hz: f64) -> f64 {
        let parts = (0..PARTS).map(|i| self.at((f64::from(i) + 0.5) / f64::from(PARTS) * hz));
        parts.sum::<f64>() / f64::from(PARTS)
    }

    /// Weight of second differences that has the displacement tell what is slow.
    fn smoothness(&self, dt_s: f64) -> f64 {
        (self.crossover_rad_s * dt_s).powi(-4)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_distr::StandardNormal;
    use std::f64::consts::PI;

    const RATE_HZ: f64 = 2048.0;
    const STEP: usize = 8192;
    const NOISE_M: f64 = 2e-5;
    const NOISE_M_S2: f64 = 0.02;
    /// Kicks of impacts, m/s2 and s.
    const KICK: (f64, f64) = (0.5, 0.01);

    /// A record of three steps of sines, whose phase and with it the velocity jump from step to step, and the acceleration as it is.
    fn record(bent: f64, seed: u64) -> (Record, Vec<f64>) {
        let random = &mut rand_pcg::Pcg64::seed_from_u64(seed);
        let mut noise = |rms: f64| rms * random.sample::<f64, _>(StandardNormal);
        let mut record = Record::empty("test", Kind::Base, RATE_HZ);
        let mut truth = Vec::new();
        for (step, hz) in [0.6, 0.7, 0.8].into_iter().enumerate() {
            let w = TAU * hz;
            let (mut velocity_m_s, mut kicked_m) = (0.0, 0.0);
            for n in 0..STEP {
                let t = n as f64 / RATE_HZ;
                let kick = if t.rem_euclid(0.9) < KICK.1 { KICK.0 } else { 0.0 };
                velocity_m_s += kick / RATE_HZ;
                kicked_m += velocity_m_s / RATE_HZ;
                let x = 0.02 * (w * t + step as f64).sin() + kicked_m;
                let a = kick - 0.02 * w * w * (w * t + step as f64).sin();
                truth.push(a);
                record.step.push(step as i32);
                record.table_displacement_m.push(1.002 * x + bent * x * x + noise(NOISE_M));
                record.table_acceleration_m_s2.push(a + 0.015 + noise(NOISE_M_S2));
            }
        }
        (record, truth)
    }

    /// RMS of what is left of a difference below 0.8 Hz, over all steps.
    fn slow(one: &[f64], two: &[f64]) -> f64 {
        let apart: Vec<f64> = one.iter().zip(two).map(|(a, b)| a - b).collect();
        let smoothness = (TAU * 0.8 / RATE_HZ).powi(-4);
        let slow = apart.chunks(STEP).flat_map(|step| smoothed(step.to_vec(), smoothness));
        (slow.map(|x| x * x).sum::<f64>() / apart.len() as f64).sqrt()
    }

    #[test]
    fn slow_noise_is_taken_out_although_the_displacement_jumps_from_step_to_step() {
        let (mut before, mut after) = (0.0, 0.0);
        for seed in 0..8 {
            let (record, truth) = record(0.0, seed);
            let found = Table::of(&record, NOISE_M_S2);
            let raw: Vec<f64> = record.table_acceleration_m_s2.iter().map(|a| a - 0.015).collect();
            before += slow(&raw, &truth).powi(2);
            let crossover = found.crossover_rad_s / (NOISE_M_S2 / NOISE_M).sqrt();
            assert!((0.95..1.05).contains(&crossover), "{crossover}");
            // The accelerometer's gain stays, and how well it can be told is told.
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let gain = dot(&found.acceleration_m_s2, &truth) / dot(&truth, &truth) - 1.0;
            assert!(gain.abs() < 4.0 * found.gain_sigma + 1e-5, "{gain} of {}", found.gain_sigma);
            assert!((2e-5..2e-3).contains(&found.gain_sigma), "{}", found.gain_sigma);
            after += slow(&found.acceleration_m_s2, &truth).powi(2);
        }
        // What stays is mostly how well gain and lead of three sines can be told.
        assert!(after < 0.3_f64.powi(2) * before, "{after} of {before} m2/s4");
    }

    #[test]
    fn a_record_without_steps_is_one() {
        let (mut record, truth) = record(0.0, 5);
        for channel in [&mut record.table_displacement_m, &mut record.table_acceleration_m_s2] {
            channel.truncate(STEP);
        }
        record.step.clear();
        let found = Table::of(&record, NOISE_M_S2);
        assert!(found.crossover_rad_s > 0.0);
        let raw: Vec<f64> = record.table_acceleration_m_s2.iter().map(|a| a - 0.015).collect();
        let (before, after) = (slow(&raw, &truth), slow(&found.acceleration_m_s2, &truth));
        assert!(after < 0.3 * before, "{after} of {before} m/s2, {}", found.gain_sigma);
    }

    #[test]
    fn a_ramp_and_a_transition_are_not_told_by_the_accelerometer_alone() {
        let between = [0..STEP / 4, STEP / 2..3 * STEP / 4];
        let mut squares = [[0.0; 2]; 2];
        for seed in 0..8 {
            let (mut record, truth) = record(0.0, seed);
            record.truncate(STEP);
            record.step = (0..STEP).map(|n| (2 * n / STEP) as i32).collect();
            between.iter().for_each(|between| record.step[between.clone()].fill(-1));
            let found = Table::of(&record, NOISE_M_S2);
            let raw: Vec<f64> = record.table_acceleration_m_s2.iter().map(|a| a - 0.015).collect();
            for (squares, between) in squares.iter_mut().zip(&between) {
                let [raw, found] = [&raw, &found.acceleration_m_s2]
                    .map(|of| slow(&of[between.clone()], &truth[between.clone()]).powi(2));
                *squares = [squares[0] + raw, squares[1] + found];
            }
        }
        // Half a second from where the record begins, less is known.
        for [before, after] in squares {
            assert!(after < 0.5_f64.powi(2) * before, "{after} of {before} m2/s4");
        }
    }

    #[test]
    fn a_displacement_that_is_bent_or_missing_is_left_alone() {
        let (mut record, _) = record(0.5, 6);
        for missing in [false, true] {
            let found = Table::of(&record, NOISE_M_S2);
            assert_eq!((found.crossover_rad_s, found.gain_sigma), (0.0, 0.0), "missing: {missing}");
            assert_eq!(found.acceleration_m_s2, record.table_acceleration_m_s2);
            record.table_displacement_m.fill(0.0);
        }
    }

    #[test]
    fn noise_within_kicks_does_not_push_the_mass_aside() {
        let random = &mut rand_pcg::Pcg64::seed_from_u64(8);
        let hz = 1.3;
        // The right bumper kicks the table one way, the left one the other.
        let kick = |phase: f64| match phase {
            p if (0.2..0.24).contains(&p) => 0.12,
            p if (0.7..0.74).contains(&p) => -0.12,
            _ => 0.0,
        };
        let seen: Vec<f64> = (0..(6.0 * RATE_HZ / hz) as usize)
            .map(|n| n as f64 * hz / RATE_HZ)
            .map(|cycles| 0.4 * (TAU * cycles).sin() + kick(cycles.fract()))
            .map(|a| a + NOISE_M_S2 * random.sample::<f64, _>(StandardNormal))
            .collect();
        let window = Window::steady(0, hz, 0, 0..seen.len());
        let Drive { noise_m_s2, as_measured, better } =
            drive_of(&window, &seen, RATE_HZ, (NOISE_M_S2, &Left { crossover_rad_s: 0.0 }), true);
        assert!(noise_m_s2 < 0.5 * NOISE_M_S2, "{noise_m_s2} m/s2");
        let mean = better.iter().sum::<f64>() / better.len() as f64;
        // By white noise in a twelfth of the samples alone it would be off by some 6e-5 m/s2.
        assert!(mean.abs() < 5e-6, "{mean} m/s2");
        // Every kick is known as well as its mean over six cycles, and what lies between them better.
        let expected = NOISE_M_S2 / 6.0_f64.sqrt();
        assert!((as_measured.noise_m_s2 / expected - 1.0).abs() < 0.02, "{}", as_measured.noise_m_s2);
        let is_kicked = |n: usize| kick((n as f64 * hz / RATE_HZ).fract()) != 0.0;
        let meant = |n: usize| as_measured.stretches.iter().any(|stretch| stretch.contains(&n));
        assert!((0..seen.len()).filter(|n| is_kicked(*n)).all(meant), "{:?}", as_measured.stretches);
        let between = (0..seen.len()).filter(|n| !meant(*n)).count();
        assert!(between > 3 * seen.len() / 4, "{between} of {}", seen.len());
    }

    #[test]
    fn a_smoothed_kick_is_as_large_as_before() {
        let kick = |n: usize| if (40..124).contains(&n) { (PI * (n - 40) as f64 / 84.0).sin() } else { 0.0 };
        let seen: Vec<f64> = (0..164).map(kick).collect();
        let (impulse, smooth) = (seen.iter().sum::<f64>(), smooth_but_for_bends(&seen));
        assert!((smooth.iter().sum::<f64>() / impulse - 1.0).abs() < 1e-9);
        // Whose middle a mean over a tenth of it takes 1 % off.
        assert!((smooth[82] - 1.0).abs() < 5e-4, "{}", smooth[82]);
    }

    #[test]
    fn smoothing_solves_its_equations() {
        let (s, random) = (37.0, &mut rand_pcg::Pcg64::seed_from_u64(7));
        for n in 1..40 {
            let z: Vec<f64> = (0..n).map(|_| random.sample(StandardNormal)).collect();
            // D' takes n values to n + 2, as if there were zeros on both sides.
            let at = |i: isize| usize::try_from(i).ok().and_then(|i| z.get(i)).copied().unwrap_or(0.0);
            let bend = |i: isize| at(i - 1) - 2.0 * at(i) + at(i + 1);
            let r = (0..n).map(|i| at(i) + s * (bend(i - 1) - 2.0 * bend(i) + bend(i + 1))).collect();
            for (found, z) in smoothed(r, s).iter().zip(&z) {
                assert!((found - z).abs() < 1e-9, "{found} for {z} of {n}");
            }
        }
    }
}
