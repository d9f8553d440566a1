//! Finds stretches of steady frequency and amplitude in the input of a record that does not mark its
//! steps. A record without any (an earthquake, noise, a chirp) is as good: no sample belongs to a step.

use super::Record;
use std::ops::Range;

/// Cycles that make a step at least.
const FEWEST_CYCLES: usize = 3;
/// Share of the samples that stretches hold together at least: fewer are chance, in a chirp or in noise.
const TOGETHER: f64 = 0.2;
/// How far the period of a cycle may be from that of its step, relative.
const PERIOD: f64 = 0.008;
/// The same of the amplitude.
const AMPLITUDE: f64 = 0.08;
/// Deviations by which the period of a stretch runs away where it does.
const TOLD: f64 = 5.0;

/// One cycle of the input between two rising crossings of its mean.
#[derive(Clone, Copy, Debug)]
struct Cycle {
    /// First sample.
    first: usize,
    /// One past its last sample.
    end: usize,
    /// Period, samples.
    period: f64,
    /// Half of the range within.
    amplitude: f64,
}

/// Fills `record.step` and notes how many steps were found.
pub(super) fn find(record: &mut Record) {
    let cycles = cycles(record.input());
    let ends = groups(&cycles).into_iter().filter_map(|group| Some(group.first()?.first..group.last()?.end));
    let mut stretches: Vec<Range<usize>> = ends.collect();
    let moving: usize = cycles.iter().map(|cycle| cycle.end - cycle.first).sum();
    let held: usize = stretches.iter().map(Range::len).sum();
    if (held as f64) < TOGETHER * moving as f64 {
        stretches.clear();
    }
    let mut step = vec![-1; record.len()];
    for (stretch, number) in stretches.iter().zip(0..) {
        step[stretch.clone()].fill(number);
    }
    let count = stretches.len();
    record.step = step;
    record.notes.push(match count {
        0 => "no step column and no stretch of steady frequency: the record is used as a whole".to_owned(),
        1 => "no step column: one stretch of steady frequency was found".to_owned(),
        n => format!("no step column: {n} stretches of steady frequency were found"),
    });
}

/// Cuts the input into cycles. Noise is kept from making crossings by a hysteresis of a third of the
/// local amplitude (peak over the neighbourhood), so that sweeps of any range of amplitude work.
fn cycles(input: &[f64]) -> Vec<Cycle> {
    let mean = input.iter().sum::<f64>() / input.len().max(1) as f64;
    let smooth = smoothed(input, mean);
    let mut crossings: Vec<f64> = Vec::new();
    let peak = smooth.iter().fold(0.0f64, |top, x| top.max(x.abs()));
    // The level follows the amplitude of the last half cycle, from a floor of the whole record.
    let floor = 0.02 * peak;
    let mut level = 0.3 * peak;
    let (mut low, mut half_peak, mut rising) = (false, 0.0f64, None);
    for (i, pair) in smooth.windows(2).enumerate() {
        let (a, b) = (pair[0], pair[1]);
        half_peak = half_peak.max(b.abs());
        if a < 0.0 && b >= 0.0 {
            rising = Some(i as f64 + crossing(&smooth, i));
        }
        if b < -level {
            low = true;
        } else if low && b > level {
            low = false;
            if let Some(at) = rising {
                crossings.push(at);
            }
            level = (0.3 * half_peak).max(floor);
            half_peak = b.abs();
        } else {
            // A falling amplitude is followed down within some cycles.
            level = (level * (1.0 - 1e-4)).max(floor);
        }
    }
    crossings
        .windows(2)
        .filter(|pair| pair[1] - pair[0] >= 4.0)
        .map(|pair| {
            let (first, end) = (pair[0].ceil() as usize, pair[1].ceil() as usize);
            let (low, high) =
                smooth[first..end].iter().fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(*x), h.max(*x)));
            Cycle { first, end, period: pair[1] - pair[0], amplitude: 0.5 * (high - low) }
        })
        .collect()
}

/// Where, after a sample, a channel rises through zero before the next: on the cubic through the four samples around, since a line is a
/// hundredth of a cycle off where those have ten samples, which makes one period another from cycle to cycle.
fn crossing(x: &[f64], i: usize) -> f64 {
    let (a, b) = (x[i], x[i + 1]);
    let by_line = a / (a - b);
    let (Some(before), Some(after)) = (i.checked_sub(1).map(|i| x[i]), x.get(i + 2)) else { return by_line };
    let (curved, other) = (0.5 * (before - 2.0 * a + b), 0.5 * (a - 2.0 * b + after));
    // Newton's form of the cubic beside the line, which it leaves little.
    let beside = |s: f64| s * (s - 1.0) * (curved + (s + 1.0) / 3.0 * (other - curved));
    let mut s = by_line;
    for _ in 0..4 {
        s = (by_line + beside(s) / (a - b)).clamp(0.0, 1.0);
    }
    s
}

/// The input about its mean, smoothed by a running mean of a sixteenth of the shortest plausible cycle.
fn smoothed(input: &[f64], mean: f64) -> Vec<f64> {
    // Crossings with a hysteresis of half the RMS, of whatever frequency, give the typical cycle.
    let rms = (input.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / input.len().max(1) as f64).sqrt();
    let (mut low, mut last, mut periods) = (false, None, Vec::new());
    for (i, x) in input.iter().enumerate() {
        if x - mean < -0.5 * rms {
            low = true;
        } else if low && x - mean > 0.5 * rms {
            low = false;
            if let Some(before) = last.replace(i) {
                periods.push(i - before);
            }
        }
    }
    periods.sort_unstable();
    let short = periods.get(periods.len() / 10).copied().unwrap_or(16);
    let half = (short / 32).min(input.len() / 4);
    let mut sum = 0.0;
    let mut sums = Vec::with_capacity(input.len() + 1);
    sums.push(0.0);
    for x in input {
        sum += x - mean;
        sums.push(sum);
    }
    (0..input.len())
        .map(|i| {
            let half = half.min(i).min(input.len() - 1 - i);
            (sums[i + half + 1] - sums[i - half]) / (2 * half + 1) as f64
        })
        .collect()
}

/// Runs of like cycles.
fn groups(cycles: &[Cycle]) -> Vec<&[Cycle]> {
    let mut found = Vec::new();
    let mut start = 0;
    while start < cycles.len() {
        let mut end = start + 1;
        let (mut period, mut amplitude) = (cycles[start].period, cycles[start].amplitude);
        while end < cycles.len() && cycles[end].first <= cycles[end - 1].end {
            let cycle = cycles[end];
            // One sample of doubt: short cycles are known less well.
            let doubt = PERIOD.max(0.25 / period);
            let alike = (cycle.period / period - 1.0).abs() < doubt
                && (cycle.amplitude / amplitude - 1.0).abs() < AMPLITUDE;
            if !alike {
                break;
            }
            let n = (end - start) as f64;
            period += (cycle.period - period) / (n + 1.0);
            amplitude += (cycle.amplitude - amplitude) / (n + 1.0);
            end += 1;
        }
        let group = &cycles[start..end];
        if group.len() >= FEWEST_CYCLES && !drifts(group) {
            found.push(group);
        }
        start = end;
    }
    found
}

/// Whether the period runs away steadily, as in a chirp: its line over the group changes by more than
/// half the tolerance, and by so many of its deviations.
fn drifts(group: &[Cycle]) -> bool {
    let n = group.len() as f64;
    let mean = group.iter().map(|c| c.period).sum::<f64>() / n;
    let middle = 0.5 * (n - 1.0);
    let (mut kk, mut kp, mut pp) = (0.0, 0.0, 0.0);
    for (k, cycle) in group.iter().enumerate() {
        let (dk, dp) = (k as f64 - middle, cycle.period / mean - 1.0);
        kk += dk * dk;
        kp += dk * dp;
        pp += dp * dp;
    }
    let change = (kp / kk * n).abs();
    // Student's t of the slope.
    let left = (kk * pp - kp * kp).max(f64::MIN_POSITIVE);
    change > 0.5 * PERIOD && kp * kp * (n - 2.0) > TOLD * TOLD * left
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Kind;
    use rand::{SeedableRng, prelude::Distribution};
    use std::f64::consts::TAU;

    /// Stretches found in what turns by so many cycles each sample, with a ten-thousandth of noise.
    fn found(cycles_of_samples: impl Iterator<Item = f64>) -> Vec<usize> {
        let mut random = rand_pcg::Pcg64::seed_from_u64(2);
        let mut phase = 0.0;
        let input: Vec<f64> = cycles_of_samples
            .map(|cycles| {
                phase += TAU * cycles;
                let noise: f64 = rand_distr::StandardNormal.sample(&mut random);
                phase.sin() + 1e-4 * noise
            })
            .collect();
        let mut record = Record { table_acceleration_m_s2: input, ..Record::empty("it", Kind::Base, 1000.0) };
        record.time_s = (0..record.table_acceleration_m_s2.len()).map(|i| i as f64 / 1000.0).collect();
        find(&mut record);
        record.step_ranges().into_iter().map(|(_, range)| range.len()).collect()
    }

    #[test]
    fn a_chirp_has_no_steps_however_few_samples_its_cycles_have() {
        // From a thousand samples a cycle to ten, by a factor of e each so many samples.
        for slow in [6e3, 13e3, 50e3] {
            let samples = (slow * 100_f64.ln()) as usize;
            let chirp = (0..samples).map(|i| 1e-3 * (i as f64 / slow).exp());
            assert_eq!(found(chirp), [0; 0], "{slow}");
        }
        let straight = (0..60_000).map(|i| 0.1 * i as f64 / 60_000.0);
        assert_eq!(found(straight), [0; 0]);
    }

    #[test]
    fn steps_of_few_samples_a_cycle_are_found() {
        let hz = |step: usize| 0.085 + 0.004 * step as f64;
        let sizes = found((0..8).flat_map(|step| std::iter::repeat_n(hz(step), 600)));
        assert_eq!(sizes.len(), 8, "{sizes:?}");
        assert!(sizes.iter().all(|size| (560..=640).contains(size)), "{sizes:?}");
    }
}
