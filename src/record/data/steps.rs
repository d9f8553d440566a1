//! Finds stretches of steady frequency and amplitude in the input of a record that does not mark its
//! steps. A record without any (an earthquake, noise, a chirp) is as good: no sample belongs to a step.

use super::Record;

/// Cycles that make a step at least.
const FEWEST_CYCLES: usize = 3;
/// How far the period of a cycle may be from that of its step, relative.
const PERIOD: f64 = 0.008;
/// The same of the amplitude.
const AMPLITUDE: f64 = 0.08;

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
    let mut step = vec![-1; record.len()];
    let mut count = 0;
    for group in groups(&cycles) {
        if let (Some(first), Some(last)) = (group.first(), group.last()) {
            step[first.first..last.end].fill(count);
            count += 1;
        }
    }
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
            rising = Some(i as f64 + a / (a - b));
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
/// half the tolerance, and the line explains most of the scatter.
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
    change > 0.5 * PERIOD && kp * kp > 0.8 * kk * pp
}
