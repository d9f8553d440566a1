//! Which samples of a record count, and where in the cycle of the excitation each of them lies.

use crate::record::{Kind, Record};
use crate::signal::{STEADY_CYCLES, fundamental_hz, step_cycles_hz};
use crate::sweep::Direction;
use std::f64::consts::TAU;
use std::ops::Range;

/// Samples per cycle at which the frequency of a step is fitted: enough for five harmonics.
const FIT_SAMPLES_PER_CYCLE: f64 = 64.0;

/// A stretch of counted samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    /// Index of the step; -1 for a record without steps.
    pub step: i32,
    /// All samples of the step.
    pub whole: Range<usize>,
    /// The counted ones: whole cycles at the end of the step.
    pub counted: Range<usize>,
    /// Frequency of the excitation, Hz, where it is periodic.
    pub frequency_hz: Option<f64>,
    /// Phase of the excitation's `sin` at the first counted sample, rad.
    pub phase_rad: f64,
    /// Rising or falling frequency, seen against the neighbouring steps.
    pub direction: Option<Direction>,
}

impl Window {
    /// Phase of a sample within its cycle, 0 to 1; `None` where the excitation is not periodic.
    pub fn cycle_place(&self, sample: usize, sample_rate_hz: f64) -> Option<f64> {
        let cycles = self.frequency_hz? * (sample as f64 - self.counted.start as f64) / sample_rate_hz;
        Some((cycles + self.phase_rad / TAU).rem_euclid(1.0))
    }

    /// Samples of one cycle (of the whole window where nothing is periodic).
    pub fn cycle_samples(&self, sample_rate_hz: f64) -> usize {
        let samples = self.frequency_hz.map_or(self.counted.len() as f64, |f| sample_rate_hz / f);
        (samples as usize).max(1)
    }
}

/// The counted stretches of a record.
///
/// `base` and `force`: the last [`STEADY_CYCLES`] whole cycles of each step, half of it when it has
/// fewer than twice as many. `component`: each step but its first cycle, since an imposed motion
/// needs no settling. Without steps: the whole record after a twentieth of it.
pub fn windows(record: &Record) -> Vec<Window> {
    let mut windows: Vec<Window> =
        record.step_ranges().into_iter().filter_map(|(step, whole)| of_step(record, step, whole)).collect();
    if windows.is_empty() {
        let n = record.len();
        let whole = 0..n;
        return vec![Window {
            step: -1,
            whole,
            counted: (n / 20)..n,
            frequency_hz: None,
            phase_rad: 0.0,
            direction: None,
        }];
    }
    direct(&mut windows);
    windows
}

fn of_step(record: &Record, step: i32, whole: Range<usize>) -> Option<Window> {
    let rate = record.sample_rate_hz;
    let input = record.input().get(whole.clone())?;
    let frequency_hz = frequency(input, rate, record.kind)?;
    let cycle = rate / frequency_hz;
    let cycles = (whole.len() as f64 / cycle + 0.02).floor();
    let steady = STEADY_CYCLES as f64;
    let kept = match record.kind {
        Kind::Component => (cycles - 1.0).max(1.0),
        _ if cycles >= 2.0 * steady => steady,
        _ => (0.5 * cycles).floor(),
    };
    if kept < 1.0 || cycles < 1.0 {
        return None;
    }
    let length = ((kept * cycle).round() as usize).min(whole.len());
    let counted = whole.end - length..whole.end;
    let phase_rad = phase(record.input().get(counted.clone())?, frequency_hz, rate);
    Some(Window { step, whole, counted, frequency_hz: Some(frequency_hz), phase_rad, direction: None })
}

/// Frequency of a step, Hz, fitted on block means of it.
fn frequency(input: &[f64], rate: f64, kind: Kind) -> Option<f64> {
    let mean = input.iter().sum::<f64>() / input.len().max(1) as f64;
    let coarse = step_cycles_hz(kind, input, rate)?;
    let block = ((rate / (FIT_SAMPLES_PER_CYCLE * coarse)) as usize).max(1);
    let means: Vec<f64> =
        input.chunks_exact(block).map(|piece| piece.iter().sum::<f64>() / block as f64 - mean).collect();
    fundamental_hz(&means, rate / block as f64).filter(|f| (f / coarse - 1.0).abs() < 0.2).or(Some(coarse))
}

/// Phase of a sine at the first sample of whole cycles of it, rad.
fn phase(samples: &[f64], frequency_hz: f64, rate: f64) -> f64 {
    let [h] = crate::signal::project::<1>(samples, frequency_hz, rate, 0.0);
    h.arg() + 0.25 * TAU
}

/// Tells forward from backward steps by their neighbours; the turning point belongs to what follows.
fn direct(windows: &mut [Window]) {
    let hz: Vec<f64> = windows.iter().filter_map(|window| window.frequency_hz).collect();
    if hz.len() != windows.len() || hz.len() < 2 {
        return;
    }
    let compare = |from: f64, to: f64| match to / from {
        ratio if ratio > 1.001 => Some(Direction::Forward),
        ratio if ratio < 0.999 => Some(Direction::Backward),
        _ => None,
    };
    for i in 0..hz.len() {
        let before = i.checked_sub(1).and_then(|j| compare(hz[j], hz[i]));
        let after = hz.get(i + 1).and_then(|next| compare(hz[i], *next));
        windows[i].direction = before.or(after);
    }
}
