//! From a time column as it was written to a uniform grid: rounding undone, jitter resampled, gaps and
//! missing numbers bridged, all of it said in the notes.

use super::{DataError, Record, Role, content};
use std::path::Path;

/// Part of a sample interval that a time stamp may be off the grid before values are moved.
const JITTER: f64 = 0.02;
/// How much longer than its samples a record may become by bridged gaps.
const MOST_BRIDGED: f64 = 2.0;

/// Puts all channels on a uniform grid from the time column (or the rate given), with the step marks.
pub(super) fn make_uniform(
    path: &Path,
    record: &mut Record,
    step: Option<Vec<f64>>,
    rate_hz: Option<f64>,
) -> Result<(), DataError> {
    if let Some(rate_hz) = rate_hz.filter(|rate| !(rate.is_finite() && *rate > 0.0)) {
        return Err(content(path, format!("a sampling rate of {rate_hz} Hz makes no sense")));
    }
    let step = step.map(marks);
    if record.time_s.is_empty() {
        let Some(rate_hz) = rate_hz else {
            return Err(content(path, "no column `time_s` and no sampling rate (`--rate HZ`)"));
        };
        let length = record.input().len();
        record.time_s = (0..length).map(|i| i as f64 / rate_hz).collect();
        record.sample_rate_hz = rate_hz;
        record.step = step.unwrap_or_default();
        return bridge_missing(path, record);
    }
    let step = sort_out(path, record, step)?;
    let grid = Grid::of(path, &record.time_s)?;
    record.sample_rate_hz = 1.0 / grid.interval_s;
    let samples = record.time_s.len();
    if grid.last >= samples as u64 || grid.worst_off > grid.allowed_off {
        grid.resample(record, step.unwrap_or_default());
    } else {
        record.step = step.unwrap_or_default();
    }
    let start = grid.start_s;
    record.time_s = (0..record.input().len()).map(|i| start + i as f64 * grid.interval_s).collect();
    bridge_missing(path, record)
}

/// Step numbers; what is no whole number belongs to no step.
fn marks(values: Vec<f64>) -> Vec<i32> {
    values.into_iter().map(|v| if v >= 0.0 && v <= f64::from(i32::MAX) { v as i32 } else { -1 }).collect()
}

/// Leaves out rows whose time is no number or does not advance.
fn sort_out(path: &Path, record: &mut Record, step: Option<Vec<i32>>) -> Result<Option<Vec<i32>>, DataError> {
    let mut latest = f64::NEG_INFINITY;
    let keep: Vec<bool> = record
        .time_s
        .iter()
        .map(|&t| {
            let good = t.is_finite() && t > latest;
            if good {
                latest = t;
            }
            good
        })
        .collect();
    let dropped = keep.iter().filter(|good| !**good).count();
    if keep.len() - dropped < 2 || dropped * 2 > keep.len() {
        let reason = format!("time_s does not advance in {dropped} of {} rows", keep.len());
        return Err(content(path, reason));
    }
    if dropped == 0 {
        return Ok(step);
    }
    record.notes.push(format!("{dropped} rows whose time is no number or does not advance were left out"));
    for role in Role::ALL {
        if let Some(channel) = record.channel_mut(role).filter(|channel| !channel.is_empty()) {
            let mut row = keep.iter();
            channel.retain(|_| row.next().copied().unwrap_or(false));
        }
    }
    Ok(step.map(|step| step.into_iter().zip(&keep).filter(|(_, good)| **good).map(|(s, _)| s).collect()))
}

/// The grid that a time column lies on.
struct Grid {
    start_s: f64,
    interval_s: f64,
    /// Place of each sample, in intervals.
    place: Vec<u64>,
    /// Place of the last sample.
    last: u64,
    /// Largest distance of a stamp from its place, in intervals, and how much of it the rounding of
    /// the stamps or clock grain explains.
    worst_off: f64,
    allowed_off: f64,
}

impl Grid {
    fn of(path: &Path, time_s: &[f64]) -> Result<Self, DataError> {
        let mut gaps: Vec<f64> = time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let middle = gaps.len() / 2;
        let typical = *gaps.select_nth_unstable_by(middle, f64::total_cmp).1;
        // Rounded stamps make the middle difference a rounded one: the mean of those near it is not.
        let near: Vec<f64> =
            gaps.iter().copied().filter(|gap| *gap > 0.5 * typical && *gap < 1.5 * typical).collect();
        let mut interval = near.iter().sum::<f64>() / near.len().max(1) as f64;
        let mut place = Vec::with_capacity(time_s.len());
        let mut start = time_s[0];
        for _ in 0..2 {
            place.clear();
            let mut at = 0u64;
            place.push(at);
            for pair in time_s.windows(2) {
                // A stamp may be so far off that its place overflows: that is refused below.
                at = at.saturating_add(((pair[1] - pair[0]) / interval).round().max(1.0) as u64);
                place.push(at);
            }
            (start, interval) = line(&place, time_s);
        }
        let last = place.last().copied().unwrap_or(0);
        if last as f64 > (1.0 + MOST_BRIDGED) * time_s.len() as f64 + 1000.0 {
            let reason = format!(
                "time_s spans {} sampling intervals of {interval:.6e} s but has {} samples",
                last.saturating_add(1),
                time_s.len()
            );
            return Err(content(path, reason));
        }
        let off = |(p, t): (&u64, &f64)| ((t - start) / interval - *p as f64).abs();
        let worst_off = place.iter().zip(time_s).map(off).fold(0.0, f64::max);
        let allowed_off = (0.75 * stamp_grain_s(time_s) / interval).clamp(JITTER, 0.5);
        if let Some(nice) = nice_rate(1.0 / interval) {
            interval = 1.0 / nice;
        }
        // The first stamp itself, but for its rounding.
        let start_s = if (start - time_s[0]).abs() <= allowed_off * interval { time_s[0] } else { start };
        Ok(Self { start_s, interval_s: interval, place, last, worst_off, allowed_off })
    }

    /// Moves every channel to the grid: a cubic through the four samples around (Lagrange), a straight
    /// line across gaps, whose samples belong to no step.
    fn resample(&self, record: &mut Record, step: Vec<i32>) {
        let time = std::mem::take(&mut record.time_s);
        let length = self.last as usize + 1;
        let jitter = self.worst_off > self.allowed_off;
        for role in Role::ALL {
            if let Some(channel) = record.channel_mut(role).filter(|channel| !channel.is_empty()) {
                *channel =
                    if jitter { self.moved(&time, channel, length) } else { self.placed(channel, length) };
            }
        }
        let mut bridged = vec![true; length];
        for place in &self.place {
            bridged[*place as usize] = false;
        }
        let lost = bridged.iter().filter(|gap| **gap).count();
        if !step.is_empty() {
            let mut row = 0;
            record.step = bridged
                .iter()
                .map(|gap| {
                    if *gap {
                        return -1;
                    }
                    row += 1;
                    step.get(row - 1).copied().unwrap_or(-1)
                })
                .collect();
        }
        if lost > 0 {
            record
                .notes
                .push(format!("{lost} samples missing in the time column were filled in by straight lines"));
        }
        if jitter {
            record.notes.push(format!(
                "time stamps are off the grid by up to {:.1} % of an interval: resampled at {:.6} Hz",
                100.0 * self.worst_off,
                1.0 / self.interval_s
            ));
        }
    }

    /// Every sample at its place, straight lines between.
    fn placed(&self, channel: &[f64], length: usize) -> Vec<f64> {
        let mut grid = Vec::with_capacity(length);
        for (places, values) in self.place.windows(2).zip(channel.windows(2)) {
            let run = places[1] - places[0];
            let slope = (values[1] - values[0]) / run as f64;
            grid.extend((0..run).map(|i| values[0] + i as f64 * slope));
        }
        grid.extend(channel.last());
        grid
    }

    /// Every grid point from the samples around it.
    fn moved(&self, time: &[f64], channel: &[f64], length: usize) -> Vec<f64> {
        let mut before = 0;
        (0..length)
            .map(|i| {
                let t = self.start_s + i as f64 * self.interval_s;
                while before + 2 < time.len() && time[before + 1] <= t {
                    before += 1;
                }
                self.value(time, channel, t, before)
            })
            .collect()
    }

    fn value(&self, time: &[f64], channel: &[f64], t: f64, k: usize) -> f64 {
        let last = time.len() - 1;
        let (a, b) = (k, (k + 1).min(last));
        let wide = time[b] - time[a] > 1.5 * self.interval_s;
        let (first, end) = (k.saturating_sub(1), (k + 2).min(last));
        let gap_near = time[end] - time[first] > 4.0 * self.interval_s;
        if wide || gap_near || end - first < 3 {
            let share = if b > a { ((t - time[a]) / (time[b] - time[a])).clamp(0.0, 1.0) } else { 0.0 };
            return channel[a] + share * (channel[b] - channel[a]);
        }
        (first..=end)
            .map(|i| {
                let weight: f64 =
                    (first..=end).filter(|j| *j != i).map(|j| (t - time[j]) / (time[i] - time[j])).product();
                weight * channel[i]
            })
            .sum()
    }
}

/// Least-squares line through (place, time): start and interval.
fn line(place: &[u64], time_s: &[f64]) -> (f64, f64) {
    let n = place.len() as f64;
    let mean_p = place.iter().map(|p| *p as f64).sum::<f64>() / n;
    let mean_t = time_s.iter().sum::<f64>() / n;
    let (mut pp, mut pt) = (0.0, 0.0);
    for (p, t) in place.iter().zip(time_s) {
        let dp = *p as f64 - mean_p;
        pp += dp * dp;
        pt += dp * (t - mean_t);
    }
    let interval = pt / pp;
    (mean_t - mean_p * interval, interval)
}

/// Grain of the stamps, s: of single precision or of the decimals they were written with.
fn stamp_grain_s(time_s: &[f64]) -> f64 {
    let largest = time_s.iter().fold(0.0f64, |top, t| top.max(t.abs()));
    if time_s.iter().all(|t| f64::from(*t as f32) == *t) {
        // The spacing of single-precision numbers there.
        return largest * f64::from(f32::EPSILON);
    }
    for digits in 0..7 {
        let scale = 10f64.powi(digits);
        if time_s.iter().all(|t| (t * scale - (t * scale).round()).abs() < 1e-6) {
            return 1.0 / scale;
        }
    }
    largest * f64::EPSILON
}

/// A rate within a millionth of a number of six digits is that number.
fn nice_rate(rate_hz: f64) -> Option<f64> {
    let scale = 10f64.powi(5 - rate_hz.log10().floor() as i32);
    let nice = (rate_hz * scale).round() / scale;
    (nice > 0.0 && (nice / rate_hz - 1.0).abs() < 1e-6).then_some(nice)
}

/// Replaces what is no number by straight lines between the neighbours.
fn bridge_missing(path: &Path, record: &mut Record) -> Result<(), DataError> {
    for role in Role::ALL {
        let Some(channel) = record.channel_mut(role).filter(|channel| !channel.is_empty()) else { continue };
        let bad = channel.iter().filter(|value| !value.is_finite()).count();
        if bad == 0 {
            continue;
        }
        let length = channel.len();
        if bad * 2 > length {
            let reason = format!("{} has no number in {bad} of {length} samples", role.name());
            return Err(content(path, reason));
        }
        fill(channel);
        let name = role.name();
        record
            .notes
            .push(format!("{bad} samples of {name} were no numbers and were filled in by straight lines"));
    }
    Ok(())
}

fn fill(channel: &mut [f64]) {
    let mut i = 0;
    while i < channel.len() {
        if channel[i].is_finite() {
            i += 1;
            continue;
        }
        let end = (i..channel.len()).find(|&j| channel[j].is_finite()).unwrap_or(channel.len());
        let right = channel.get(end).copied();
        let left = if i > 0 { Some(channel[i - 1]) } else { None };
        let (a, b) = (left.or(right).unwrap_or(0.0), right.or(left).unwrap_or(0.0));
        let run = (end - i + 1) as f64;
        for (j, value) in channel[i..end].iter_mut().enumerate() {
            *value = a + (b - a) * (j as f64 + 1.0) / run;
        }
        i = end;
    }
}
