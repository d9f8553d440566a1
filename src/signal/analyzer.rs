//! Per-step statistics of several channels, sample by sample: extremes over the last cycles of the
//! step, and synchronous demodulation (mean, fundamental, harmonics 2 to 5) at its frequency.
//!
//! Each cycle is integrated on its own, from one exact whole phase to the next (the ends lie between
//! samples and are interpolated), so that a step whose period is no whole number of samples leaks
//! nothing into its neighbours. The results of the last cycles are then combined.

use crate::sweep::{CommandPoint, Segment};
use nalgebra::Complex;
use std::f64::consts::{PI, TAU};

/// Harmonics that are demodulated, the fundamental included.
pub const HARMONICS: usize = 5;
/// Most cycles that can be combined.
pub const MAX_CYCLES: usize = 16;

/// Where in a step a sample lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CyclePlace {
    /// Index of the step.
    pub index: u32,
    /// Cycles since the step began; its fraction times 2 pi is the phase.
    pub cycles: f64,
    /// The cycle counts: it may enter the result of the step.
    pub counted: bool,
}

impl CyclePlace {
    /// The place of a commanded sample; `None` in ramps and transitions.
    pub fn of(point: &CommandPoint) -> Option<Self> {
        let phase = point.phase.filter(|_| matches!(point.segment, Segment::Step | Segment::Rejoin))?;
        Some(Self { index: phase.index, cycles: phase.phase_rad / TAU, counted: phase.counted })
    }
}

/// `amplitude sin(h phi + phase)`.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Harmonic {
    /// Amplitude, in the unit of the channel.
    pub amplitude: f64,
    /// Phase against the command's `sin(h phi)`, rad, in (-pi, pi].
    pub phase_rad: f64,
}

/// One channel in the steady state of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ChannelResult {
    /// Largest value, in the unit of the channel.
    pub max: f64,
    /// Smallest value.
    pub min: f64,
    /// Mean over the cycles.
    pub mean: f64,
    /// Fundamental and harmonics 2 to 5.
    pub harmonics: [Harmonic; HARMONICS],
}

impl ChannelResult {
    /// Largest magnitude: A_max of an acceleration.
    pub fn peak(&self) -> f64 {
        self.max.max(-self.min)
    }

    /// From lowest to highest: the excursion E_max of a displacement.
    pub fn excursion(&self) -> f64 {
        self.max - self.min
    }

    /// Root of the summed squares of harmonics 2 to 5 over the fundamental.
    pub fn distortion(&self) -> f64 {
        let [first, rest @ ..] = &self.harmonics;
        rest.iter().map(|h| h.amplitude * h.amplitude).sum::<f64>().sqrt() / first.amplitude
    }
}

/// The steady state of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepResult<const N: usize> {
    /// Index of the step.
    pub index: u32,
    /// Cycles that were combined: as many as asked for, or fewer when fewer were complete.
    pub cycles: u32,
    /// The channels in their order.
    pub channels: [ChannelResult; N],
}

/// Sums of one cycle of one channel.
#[derive(Clone, Copy, Debug)]
struct Sums {
    max: f64,
    min: f64,
    mean: f64,
    harmonics: [Complex<f64>; HARMONICS],
}

const EMPTY: Sums = Sums {
    max: f64::NEG_INFINITY,
    min: f64::INFINITY,
    mean: 0.0,
    harmonics: [Complex::new(0.0, 0.0); HARMONICS],
};

/// The last sample, as the left end of the next trapezium.
#[derive(Clone, Copy, Debug)]
struct Last<const N: usize> {
    place: CyclePlace,
    values: [f64; N],
}

/// Statistics of N channels, step by step. Nothing allocates after construction.
#[derive(Clone, Debug)]
pub struct StepAnalyzer<const N: usize> {
    keep: usize,
    ring: Box<[[Sums; N]; MAX_CYCLES]>,
    /// Complete counted cycles of the present step.
    complete: usize,
    /// Half ranges of the last two complete cycles, counted or not, the newer first.
    ranges: [Option<[f64; N]>; 2],
    current: [Sums; N],
    /// The current cycle was entered at its beginning.
    whole: bool,
    last: Option<Last<N>>,
    increment: f64,
}

impl<const N: usize> StepAnalyzer<N> {
    /// An analyzer that combines the last `keep` counted cycles (1 to [`MAX_CYCLES`]) of each step.
    pub fn new(keep: usize) -> Self {
        Self {
            keep: keep.clamp(1, MAX_CYCLES),
            ring: Box::new([[EMPTY; N]; MAX_CYCLES]),
            complete: 0,
            ranges: [None; 2],
            current: [EMPTY; N],
            whole: false,
            last: None,
            increment: 0.0,
        }
    }

    /// Takes the next sample. Returns the result of a step when this sample is the first after its
    /// counted cycles; `None` otherwise, also after a step of which no cycle was complete.
    pub fn push(&mut self, place: Option<CyclePlace>, values: &[f64; N]) -> Option<StepResult<N>> {
        let mut finished = None;
        if let Some(last) = self.last {
            let same_step = place.is_some_and(|place| place.index == last.place.index);
            let next = match place {
                Some(place) if same_step => {
                    self.increment = place.cycles - last.place.cycles;
                    place.cycles
                }
                // Beyond the step the signal still goes on by about the same phase.
                _ => last.place.cycles + self.increment,
            };
            self.advance(&last, next, values);
            let counting = place.is_some_and(|place| same_step && place.counted);
            if last.place.counted && !counting {
                finished = self.result(last.place.index);
            }
            if !same_step || (place.is_some_and(|place| place.counted) && !last.place.counted) {
                self.complete = 0;
            }
            if !same_step {
                self.ranges = [None; 2];
                self.whole = false;
            }
        }
        if let Some(place) = place {
            let entered = self.last.is_none_or(|last| last.place.index != place.index);
            if entered {
                // A step whose first sample is later than a sample or so after phase 0 was joined midway.
                self.whole = place.cycles < 0.1;
                self.start_cycle(place.cycles, values, values);
            }
            self.last = Some(Last { place, values: *values });
        } else {
            self.last = None;
        }
        finished
    }

    /// Forgets the step in progress, as after a gap in the samples.
    pub fn reset(&mut self) {
        self.last = None;
        self.whole = false;
        self.complete = 0;
        self.ranges = [None; 2];
    }

    /// Relative change of a channel's peak-to-peak range from the cycle before last to the last complete
    /// one of this step; `None` until there are two.
    pub fn change(&self, channel: usize) -> Option<f64> {
        let [Some(newer), Some(older)] = self.ranges else { return None };
        let (newer, older) = (newer.get(channel)?, older.get(channel)?);
        (*older > 0.0).then(|| (newer / older - 1.0).abs())
    }

    /// Result over the complete counted cycles of the present step so far.
    pub fn so_far(&self) -> Option<StepResult<N>> {
        self.last.filter(|last| last.place.counted).and_then(|last| self.result(last.place.index))
    }

    /// Goes from the last sample to phase `next` (cycles), closing the cycle if its end is passed.
    fn advance(&mut self, last: &Last<N>, next: f64, values: &[f64; N]) {
        let from = last.place.cycles;
        let end = from.floor() + 1.0;
        if next < end {
            self.trapezium(from, &last.values, next, values);
            return;
        }
        let share = if next > from { (end - from) / (next - from) } else { 1.0 };
        let mut at_end = *values;
        for (value, old) in at_end.iter_mut().zip(&last.values) {
            *value = old + share * (*value - old);
        }
        self.trapezium(from, &last.values, end, &at_end);
        self.close_cycle(last.place.counted);
        // More than one cycle in one sample is a gap: the cycle that follows is not whole.
        self.whole = next < end + 1.0;
        self.start_cycle(next - end, &at_end, values);
        self.trapezium(end, &at_end, next, values);
    }

    /// Opens a cycle `late` cycles after its beginning, with the value there and now.
    fn start_cycle(&mut self, late: f64, at_start: &[f64; N], values: &[f64; N]) {
        self.current = [EMPTY; N];
        for (i, sums) in self.current.iter_mut().enumerate() {
            sums.max = at_start[i];
            sums.min = at_start[i];
        }
        if at_start == values && late > 0.0 {
            // First sample of a step: the short piece since phase 0 is taken as constant.
            self.trapezium(0.0, values, late, values);
        }
    }

    fn close_cycle(&mut self, counted: bool) {
        if !self.whole {
            return;
        }
        self.ranges = [Some(self.current.map(|sums| sums.max - sums.min)), self.ranges[0]];
        if counted {
            self.ring[self.complete % MAX_CYCLES] = self.current;
            self.complete += 1;
        }
    }

    /// Adds the piece between two phases (cycles), over which the integrands run linearly.
    fn trapezium(&mut self, from: f64, old: &[f64; N], to: f64, new: &[f64; N]) {
        let half = 0.5 * (to - from);
        let (e_old, e_new) = (powers(from), powers(to));
        for (i, sums) in self.current.iter_mut().enumerate() {
            sums.max = sums.max.max(new[i]);
            sums.min = sums.min.min(new[i]);
            sums.mean += half * (old[i] + new[i]);
            let (a, b) = (half * old[i], half * new[i]);
            for ((harmonic, p), q) in sums.harmonics.iter_mut().zip(&e_old).zip(&e_new) {
                *harmonic += p * a + q * b;
            }
        }
    }

    fn result(&self, index: u32) -> Option<StepResult<N>> {
        let cycles = self.complete.min(self.keep);
        if cycles == 0 {
            return None;
        }
        let mut total = [EMPTY; N];
        for back in 1..=cycles {
            let cycle = &self.ring[(self.complete - back) % MAX_CYCLES];
            for (sum, one) in total.iter_mut().zip(cycle) {
                sum.max = sum.max.max(one.max);
                sum.min = sum.min.min(one.min);
                sum.mean += one.mean;
                for (h, add) in sum.harmonics.iter_mut().zip(&one.harmonics) {
                    *h += add;
                }
            }
        }
        Some(StepResult { index, cycles: cycles as u32, channels: total.map(|sum| finish(&sum, cycles)) })
    }
}

/// `exp(-2 pi i h cycles)` for each harmonic h.
fn powers(cycles: f64) -> [Complex<f64>; HARMONICS] {
    let (sin, cos) = (TAU * (cycles - cycles.floor())).sin_cos();
    let unit = Complex::new(cos, -sin);
    let mut power = Complex::new(1.0, 0.0);
    std::array::from_fn(|_| {
        power *= unit;
        power
    })
}

/// From sums over whole cycles: `2/n` times the integral of `y exp(-i h phi)` is `-i a exp(i phase)`.
fn finish(sums: &Sums, cycles: usize) -> ChannelResult {
    let share = 1.0 / cycles as f64;
    ChannelResult {
        max: sums.max,
        min: sums.min,
        mean: sums.mean * share,
        harmonics: sums.harmonics.map(|sum| {
            let amplitude = 2.0 * share * sum.norm();
            let turned = sum.arg() + 0.5 * PI;
            Harmonic { amplitude, phase_rad: if turned > PI { turned - TAU } else { turned } }
        }),
    }
}

#[cfg(test)]
#[path = "analyzer_tests.rs"]
mod tests;
