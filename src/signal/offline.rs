//! The signal chain over a record in memory: same filters, same analyzer, only that the phase comes
//! from the measured table acceleration where the command is not known.

use super::analyzer::{CyclePlace, StepAnalyzer, StepResult};
use super::butterworth::{BandPass, FilterBank};
use super::{BAND_HIGH_HZ, BAND_LOW_HZ};
use crate::record::{Kind, Record};
use nalgebra::Complex;
use std::f64::consts::TAU;

/// The steady state of one step of a record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordStep {
    /// First sample of the step.
    pub first: usize,
    /// One past its last sample.
    pub end: usize,
    /// Frequency found in the table acceleration, Hz.
    pub frequency_hz: f64,
    /// Channels: table acceleration, mass acceleration A (mean of both), relative displacement D; all
    /// band-passed. Phases are against the fundamental of the table acceleration.
    pub result: StepResult<3>,
}

/// Band-passes a whole channel from rest at its first sample, 0.16-30 Hz.
pub fn band_pass(samples: &[f64], sample_rate_hz: f64) -> Vec<f64> {
    let mut filter = BandPass::new(BAND_LOW_HZ, BAND_HIGH_HZ, sample_rate_hz);
    samples.iter().map(|&sample| filter.process(sample)).collect()
}

/// Steady states of all steps of a `base` record (its `step` column), over the last `keep` cycles of
/// each. Steps of which no whole cycle is there are left out.
pub fn analyse_record(record: &Record, keep: usize) -> Vec<RecordStep> {
    let length = record.table_acceleration_m_s2.len();
    let second = |i: usize| record.mass_acceleration_2_m_s2.get(i);
    let mut bank = FilterBank::<3>::new(BandPass::paper(record.sample_rate_hz));
    let filtered: Vec<[f64; 3]> = (0..length)
        .map(|i| {
            let first = record.mass_acceleration_1_m_s2.get(i).copied().unwrap_or(0.0);
            let mass = second(i).map_or(first, |second| 0.5 * (first + second));
            let relative = record.relative_displacement_m.get(i).copied().unwrap_or(0.0);
            bank.process(&[record.table_acceleration_m_s2[i], mass, relative])
        })
        .collect();
    windows(&record.step).filter_map(|window| analyse_step(record, &filtered, window, keep)).collect()
}

/// Runs of equal, non-negative step indices: (index, first, end).
fn windows(step: &[i32]) -> impl Iterator<Item = (u32, usize, usize)> {
    let mut first = 0;
    step.chunk_by(|a, b| a == b).filter_map(move |run| {
        let start = first;
        first += run.len();
        u32::try_from(run[0]).ok().map(|index| (index, start, start + run.len()))
    })
}

fn analyse_step(
    record: &Record,
    filtered: &[[f64; 3]],
    (index, first, end): (u32, usize, usize),
    keep: usize,
) -> Option<RecordStep> {
    let end = end.min(filtered.len());
    let table: Vec<f64> = filtered.get(first..end)?.iter().map(|values| values[0]).collect();
    let (frequency_hz, phase_rad) = fundamental(&table, record.sample_rate_hz)?;
    let mut analyzer = StepAnalyzer::<3>::new(keep);
    let per_sample = frequency_hz / record.sample_rate_hz;
    // Count from the first zero of the phase inside the window.
    let offset = (phase_rad / TAU).rem_euclid(1.0);
    let start = (1.0 - offset) % 1.0;
    for (i, values) in filtered[first..end].iter().enumerate() {
        let cycles = i as f64 * per_sample - start;
        if cycles >= 0.0 {
            analyzer.push(Some(CyclePlace { index, cycles, counted: true }), values);
        }
    }
    let result = analyzer.push(None, filtered.get(end).or_else(|| filtered.last())?)?;
    Some(RecordStep { first, end, frequency_hz, result })
}

/// Frequency (Hz) of the largest sine in a piece of a signal; `None` when it has less than about one
/// and a half cycles or no sine at all.
pub fn fundamental_hz(samples: &[f64], sample_rate_hz: f64) -> Option<f64> {
    fundamental(samples, sample_rate_hz).map(|(hz, _)| hz)
}

/// Drift of the phase below which the frequency is what rounding leaves of it, rad.
const SETTLED_RAD: f64 = 1e-12;

/// Frequency (Hz) and phase (rad, of a sine, at the first sample).
///
/// Rising crossings of a level zone give a first value; the drift of the phase between the Hann-windowed
/// halves, taken about it, polishes it.
pub(crate) fn fundamental(samples: &[f64], sample_rate_hz: f64) -> Option<(f64, f64)> {
    let mut hz = crossing_hz(samples, sample_rate_hz)?;
    let half = samples.len() / 2;
    for _ in 0..6 {
        let (a, b) = (
            phasor(&samples[..half], 0, hz, sample_rate_hz),
            phasor(&samples[half..], half, hz, sample_rate_hz),
        );
        let drift_rad = (b * a.conj()).arg();
        hz += drift_rad / TAU * sample_rate_hz / half as f64;
        if drift_rad.abs() < SETTLED_RAD {
            break;
        }
    }
    let whole = phasor(samples, 0, hz, sample_rate_hz);
    let valid = hz.is_finite() && hz > 0.0 && hz < 0.5 * sample_rate_hz && whole.norm() > 0.0;
    valid.then(|| (hz, whole.arg() + 0.25 * TAU))
}

/// How far apart two ways to tell a frequency may be.
const ALIKE: f64 = 0.05;

/// Cycles a second of a steady motion (Hz) from upward crossings of its mean with a hysteresis of half the RMS; `None` with
/// fewer than two.
pub(crate) fn cycles_hz(channel: &[f64], sample_rate_hz: f64) -> Option<f64> {
    rate_of(rising(channel, 0.5).map(|crossing| crossing.below), sample_rate_hz)
}

/// The same of what moves a step of a record of such a kind.
pub(crate) fn step_cycles_hz(kind: Kind, input: &[f64], sample_rate_hz: f64) -> Option<f64> {
    match kind {
        Kind::Base => table_cycles_hz(input, sample_rate_hz),
        Kind::Force | Kind::Component => cycles_hz(input, sample_rate_hz),
    }
}

/// The same of a table's acceleration. Impacts that kick the table cross it between, but hardly its velocity: where the two tell
/// different frequencies, that counts at which the table goes farther.
fn table_cycles_hz(acceleration_m_s2: &[f64], sample_rate_hz: f64) -> Option<f64> {
    let n = acceleration_m_s2.len();
    let mean = acceleration_m_s2.iter().sum::<f64>() / n.max(1) as f64;
    let mut velocity = 0.0;
    let velocity: Vec<f64> = acceleration_m_s2
        .iter()
        .map(|a| {
            velocity += a - mean;
            velocity
        })
        .collect();
    let told = [acceleration_m_s2, &velocity].map(|channel| cycles_hz(channel, sample_rate_hz));
    let [Some(hz), Some(other_hz)] = told else { return told[0].or(told[1]) };
    let goes = |hz: f64| phasor(acceleration_m_s2, 0, hz, sample_rate_hz).norm() / (hz * hz);
    let kicked = (other_hz / hz - 1.0).abs() > ALIKE && goes(other_hz) > goes(hz);
    Some(if kicked { other_hz } else { hz })
}

/// Frequency from the first to the last rising crossing of the zero of a signal, with a hysteresis of a
/// third of its largest value.
fn crossing_hz(samples: &[f64], sample_rate_hz: f64) -> Option<f64> {
    let level = samples.iter().fold(0.0f64, |top, sample| top.max(sample.abs())) / 3.0;
    rate_of(rising_about(samples, 0.0, level).map(|crossing| crossing.above), sample_rate_hz)
}

/// Crossings a second from the first to the last one; `None` with fewer than two.
fn rate_of(mut crossings: impl Iterator<Item = usize>, sample_rate_hz: f64) -> Option<f64> {
    let first = crossings.next()?;
    let (count, last) = crossings.fold((0u32, first), |(count, _), crossing| (count + 1, crossing));
    (count > 0).then(|| f64::from(count) * sample_rate_hz / (last - first) as f64)
}

/// A rising crossing of the middle of a channel.
pub(crate) struct Rising {
    /// Last sample below the middle.
    pub below: usize,
    /// First sample above the level zone.
    pub above: usize,
}

/// Rising crossings of the mean of a channel with a hysteresis of a share of its RMS about it to either side.
pub(crate) fn rising(channel: &[f64], share_of_rms: f64) -> impl Iterator<Item = Rising> {
    let n = channel.len().max(1) as f64;
    let mean = channel.iter().sum::<f64>() / n;
    let rms = (channel.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt();
    rising_about(channel, mean, share_of_rms * rms)
}

/// The same of any middle, with any hysteresis.
fn rising_about(channel: &[f64], middle: f64, level: f64) -> impl Iterator<Item = Rising> {
    let (mut low, mut below) = (false, 0);
    channel.iter().enumerate().filter_map(move |(i, x)| {
        let x = x - middle;
        if x < 0.0 {
            below = i;
        }
        let crosses = low && x > level;
        low = x < -level || low && !crosses;
        crosses.then_some(Rising { below, above: i })
    })
}

/// Hann-windowed sum of `y exp(-i w n)` from sample `offset` on.
fn phasor(samples: &[f64], offset: usize, hz: f64, sample_rate_hz: f64) -> Complex<f64> {
    let w = TAU * hz / sample_rate_hz;
    let turn = Complex::from_polar(1.0, -w);
    let mut unit = Complex::from_polar(1.0, -w * offset as f64);
    let windowed = samples.iter().zip(hann(samples.len())).map(|(&sample, weight)| {
        let now = unit * (weight * sample);
        unit *= turn;
        now
    });
    windowed.sum()
}

/// `2/n sum y exp(-i h phi)`, `phi` from `phase_rad` at the first sample on, for h = 1..=N.
pub fn project<const N: usize>(
    samples: &[f64],
    frequency_hz: f64,
    sample_rate_hz: f64,
    phase_rad: f64,
) -> [Complex<f64>; N] {
    let turn = Complex::from_polar(1.0, -TAU * frequency_hz / sample_rate_hz);
    let mut unit = Complex::from_polar(1.0, -phase_rad);
    let mut sums = [Complex::new(0.0, 0.0); N];
    for sample in samples {
        let mut power = unit;
        for sum in &mut sums {
            *sum += power * *sample;
            power *= unit;
        }
        unit *= turn;
    }
    let scale = 2.0 / samples.len().max(1) as f64;
    sums.map(|sum| sum * scale)
}

/// Hann weights `1 - cos(2 pi (i + 1/2)/n)` for i = 0..n, their mean is 1. By a turning phasor: a cosine
/// a sample would cost more than all else; the error grows by one rounding a sample.
pub fn hann(length: usize) -> impl Iterator<Item = f64> {
    let step = TAU / length.max(1) as f64;
    let turn = Complex::from_polar(1.0, step);
    let mut unit = Complex::from_polar(1.0, 0.5 * step);
    (0..length).map(move |_| {
        let weight = 1.0 - unit.re;
        unit *= turn;
        weight
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::{Generator, Schedule, SweepSpec};
    use crate::units::SAMPLE_RATE_HZ;

    /// An ideal table with a specimen that follows it as A = 2 a, D = 0.03 x: what the analysis must
    /// give is known in closed form, but for the filter, whose response is.
    fn record() -> (Record, Schedule) {
        let spec = SweepSpec { cycles: 8, ..SweepSpec::paper() }.restricted(0.8, 1.4).expect("steps");
        let schedule = Schedule::new(&spec).expect("valid");
        let mut generator = Generator::new(&schedule, SAMPLE_RATE_HZ);
        let mut record = Record {
            source: "ideal".into(),
            kind: Kind::Base,
            sample_rate_hz: SAMPLE_RATE_HZ,
            time_s: Vec::new(),
            table_displacement_m: Vec::new(),
            table_acceleration_m_s2: Vec::new(),
            mass_acceleration_1_m_s2: Vec::new(),
            mass_acceleration_2_m_s2: Vec::new(),
            relative_displacement_m: Vec::new(),
            force_n: Vec::new(),
            displacement_m: Vec::new(),
            acceleration_m_s2: Vec::new(),
            step: Vec::new(),
            notes: Vec::new(),
        };
        while !generator.is_done() {
            record.time_s.push(generator.time_s());
            let point = generator.next_point();
            let a = point.command.acceleration_m_s2;
            record.table_displacement_m.push(point.command.displacement_m);
            record.table_acceleration_m_s2.push(a);
            record.mass_acceleration_1_m_s2.push(2.5 * a);
            record.mass_acceleration_2_m_s2.push(1.5 * a);
            record.relative_displacement_m.push(0.03 * point.command.displacement_m);
            record.step.push(point.counted_step());
        }
        (record, schedule)
    }

    #[test]
    fn a_record_gives_the_peaks_of_its_steps() {
        let (record, schedule) = record();
        let steps = analyse_record(&record, 3);
        assert_eq!(steps.len(), schedule.steps().len());
        let filter = BandPass::paper(SAMPLE_RATE_HZ);
        for (found, step) in steps.iter().zip(schedule.steps()) {
            assert_eq!(found.result.index, step.index);
            assert!((found.frequency_hz / step.frequency_hz - 1.0).abs() < 1e-4, "{found:?}");
            let gain = filter.response(step.frequency_hz).norm();
            let [table, mass, relative] = &found.result.channels;
            let ag = step.acceleration_amplitude_m_s2;
            // the high-pass still remembers the transition before the step by a few parts in a thousand
            assert!((table.harmonics[0].amplitude / (ag * gain) - 1.0).abs() < 3e-3);
            assert!(table.harmonics[0].phase_rad.abs() < 5e-3, "the reference itself");
            assert!((mass.peak() / (2.0 * ag * gain) - 1.0).abs() < 5e-3);
            let excursion_m = 0.06 * step.displacement_amplitude_m * gain;
            assert!((relative.excursion() / excursion_m - 1.0).abs() < 5e-3);
        }
    }

    #[test]
    fn a_frequency_is_found_in_noise_and_harmonics() {
        let samples: Vec<f64> = (0..8192)
            .map(|i| {
                let phi = TAU * 1.3717 * f64::from(i) / 1024.0;
                (phi + 0.3).sin() + 0.2 * (3.0 * phi).sin() + 0.05 * (f64::from(i) * 12.9898).sin()
            })
            .collect();
        let hz = fundamental_hz(&samples, 1024.0).expect("a sine");
        assert!((hz - 1.3717).abs() < 2e-4, "{hz}");
        assert_eq!(fundamental_hz(&[0.0; 100], 1024.0), None);
    }

    #[test]
    fn kicks_of_impacts_are_no_cycles_of_the_table() {
        let (rate, hz) = (2048.0, 2.4);
        let table = |kick: f64| -> Vec<f64> {
            let at = |i: i32| {
                let cycles = hz * f64::from(i) / rate;
                // Two bumpers, and one from which the mass bounces twice.
                let kicked = |from: f64| (from..from + 0.02).contains(&cycles.fract());
                let kicks = if kicked(0.1) || kicked(0.2) { -kick } else { 0.0 };
                0.49 * (TAU * cycles).sin() + kicks + if kicked(0.65) { kick } else { 0.0 }
            };
            (0..(10.0 * rate / hz) as i32).map(at).collect()
        };
        let kicked = table(2.0);
        let by_acceleration = cycles_hz(&kicked, rate).expect("cycles");
        assert!(by_acceleration > 1.5 * hz, "{by_acceleration} Hz");
        let found = table_cycles_hz(&kicked, rate).expect("cycles");
        assert!((found / hz - 1.0).abs() < 0.01, "{found} Hz");
        // What nothing kicks is told by its acceleration.
        let still = table(0.0);
        assert_eq!(table_cycles_hz(&still, rate), cycles_hz(&still, rate));
    }
}
