//! Where a record is steady: the stretches that models are laid against.

use super::motion::{Motion, Window};
use crate::record::Record;
use realfft::num_complex::Complex64;
use std::f64::consts::TAU;
use std::ops::Range;

/// Steady steps below which a record is cut into equal parts.
const FEWEST_STEPS: usize = 4;
/// Cycles of a step that count, and that warm it up.
const COUNTED: f64 = 4.0;
const WARM: f64 = 3.0;
/// So many at most, where they are as steady, in records of no more samples than it takes to keep a diagnosis short; they become
/// fewer with the length of the record.
const MOST: f64 = 8.0;
const SHORT: f64 = 180_000.0;
/// A cycle is as steady as the last ones when input and displacement differ from them by no more than that, relative.
const STEADY: f64 = 0.02;

/// Steady stretches: the later part of each step in whole cycles, or the record in equal parts.
pub(super) fn cut(record: &Record, motion: &Motion) -> Vec<Window> {
    let n = motion.displacement_m.len();
    let mut windows = Vec::new();
    if record.step.len() == n {
        let mut start = 0;
        while start < n {
            let step = record.step[start];
            let mut end = start + 1;
            while end < n && record.step[end] == step {
                end += 1;
            }
            if step >= 0
                && let Some(window) = steady(step, start..end, motion)
            {
                windows.push(window);
            }
            start = end;
        }
    }
    // A few long stretches leave none to judge by: they are cut into parts instead.
    if windows.len() < FEWEST_STEPS {
        windows = equal_parts(n, motion);
    }
    // Every third stretch judges; the first and last serve the fit, so that it need not extrapolate.
    let last = windows.len().saturating_sub(1);
    for (i, window) in windows.iter_mut().enumerate() {
        window.held_out = i % 3 == 1 && i != last;
    }
    windows
}

/// The last whole cycles of a step, at least four and more where they are as steady (half of a shorter step), warmed up by three
/// before.
fn steady(step: i32, range: Range<usize>, motion: &Motion) -> Option<Window> {
    let rate = motion.sample_rate_hz;
    let input = if motion.drive_m_s2.is_empty() { &motion.displacement_m } else { &motion.drive_m_s2 };
    let frequency_hz = main_frequency_hz(&input[range.clone()], rate)?;
    let cycle = rate / frequency_hz;
    let cycles = (range.len() as f64 / cycle).floor();
    let mut counted = if cycles >= COUNTED + WARM { COUNTED } else { (cycles / 2.0).floor() };
    if counted < 1.0 {
        return None;
    }
    let most = (MOST * SHORT / motion.displacement_m.len() as f64).min(MOST).min(cycles - WARM);
    let back = |count: f64| range.end - (count * cycle).round() as usize;
    let channels = [input, &motion.displacement_m];
    let from_here = back(counted);
    let last = channels.map(|channel| phasor(&channel[from_here..range.end], cycle));
    let like_the_last = |from: usize, to: usize| {
        let turned = Complex64::from_polar(1.0, TAU * (from_here - from) as f64 / cycle);
        channels.iter().zip(&last).all(|(channel, last)| {
            (phasor(&channel[from..to], cycle) * turned - last).norm() < STEADY * last.norm()
        })
    };
    while counted >= COUNTED && counted + 1.0 <= most && like_the_last(back(counted + 1.0), back(counted)) {
        counted += 1.0;
    }
    let start = back(counted);
    let warm_from = start.saturating_sub((WARM * cycle).round() as usize).max(range.start);
    let warm_from = from_the_middle(&motion.displacement_m, warm_from..start, cycle);
    Some(Window {
        step,
        frequency_hz,
        warm_from,
        range: start..range.end,
        held_out: false,
        source: 0,
        drive_noise_m_s2: 0.0,
    })
}

/// Complex amplitude of a channel at a period of so many samples, its phase that at the first sample.
fn phasor(channel: &[f64], cycle: f64) -> Complex64 {
    let mean = channel.iter().sum::<f64>() / channel.len().max(1) as f64;
    let at = |(n, x): (usize, &f64)| (x - mean) * Complex64::from_polar(1.0, -TAU * n as f64 / cycle);
    channel.iter().enumerate().map(at).sum::<Complex64>() * (2.0 / channel.len().max(1) as f64)
}

/// The first passage through zero within a cycle: a model is warmed up from rest in the middle, and what it remembers of a jump
/// from there to elsewhere it forgets slowly.
fn from_the_middle(displacement: &[f64], range: Range<usize>, cycle: f64) -> usize {
    let within = range.start..range.end.min(range.start + cycle.ceil() as usize + 1).min(displacement.len());
    let crosses = |n: &usize| displacement[n - 1] * displacement[*n] <= 0.0;
    within.clone().skip(1).find(crosses).unwrap_or(range.start)
}

/// Thirty equal parts inside a record without steps, each warmed up by the one before.
fn equal_parts(n: usize, motion: &Motion) -> Vec<Window> {
    let parts = (n / 64).clamp(1, 30);
    let length = n / parts;
    let input = if motion.drive_m_s2.is_empty() { &motion.displacement_m } else { &motion.drive_m_s2 };
    let frequency_hz = main_frequency_hz(input, motion.sample_rate_hz).unwrap_or(1.0);
    (usize::from(parts > 4)..parts)
        .map(|i| Window {
            step: i as i32,
            frequency_hz,
            warm_from: (i * length).saturating_sub(2 * length),
            range: i * length..(i + 1) * length,
            held_out: false,
            source: 0,
            drive_noise_m_s2: 0.0,
        })
        .collect()
}

/// Frequency from upward crossings of the mean with a hysteresis of half the RMS; `None` with
/// fewer than two.
fn main_frequency_hz(channel: &[f64], rate: f64) -> Option<f64> {
    let mean = channel.iter().sum::<f64>() / channel.len().max(1) as f64;
    let rms = (channel.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / channel.len().max(1) as f64).sqrt();
    let mut low = false;
    let mut crossings: Vec<f64> = Vec::new();
    let mut below = 0;
    for (i, x) in channel.iter().enumerate() {
        let x = x - mean;
        if x < 0.0 {
            below = i;
        }
        if x < -0.5 * rms {
            low = true;
        } else if low && x > 0.5 * rms {
            low = false;
            crossings.push(below as f64);
        }
    }
    let (first, last) = (crossings.first()?, crossings.last()?);
    (crossings.len() > 1).then(|| (crossings.len() - 1) as f64 * rate / (last - first))
}
