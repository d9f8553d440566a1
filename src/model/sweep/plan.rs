//! Where steps and samples of an ideal sweep lie on the time axis.

use super::PEAK_CYCLES;
use crate::sweep::Step;

/// Places of the steps on the time axis of samples.
pub struct Plan<'a> {
    /// Steps.
    pub steps: &'a [Step],
    /// Begin of each, s.
    pub starts: Vec<f64>,
    /// End of the last, s.
    pub end: f64,
    /// Sample period, s.
    pub dt: f64,
    /// Cycles at the end of a step from which its peaks are taken.
    pub counted: f64,
}

impl<'a> Plan<'a> {
    /// Lays the steps out.
    pub fn new(steps: &'a [Step], dt: f64) -> Self {
        Self::counting(steps, dt, PEAK_CYCLES)
    }

    /// [`Plan::new`] with peaks from so many cycles.
    pub fn counting(steps: &'a [Step], dt: f64, counted: f64) -> Self {
        let mut starts = Vec::with_capacity(steps.len());
        let mut end = 0.0;
        for step in steps {
            starts.push(end);
            end += f64::from(step.cycles) / step.frequency_hz;
        }
        Self { steps, starts, end, dt, counted }
    }

    /// Number of samples.
    pub fn samples(&self) -> usize {
        (self.end / self.dt * (1.0 + 1e-14)) as usize + 1
    }

    /// End of a step, s.
    pub fn end_of(&self, index: usize) -> f64 {
        self.starts.get(index + 1).copied().unwrap_or(self.end)
    }

    /// Peaks are taken from here on, s.
    pub(super) fn counted_from(&self, index: usize) -> f64 {
        let step = &self.steps[index];
        self.end_of(index) - self.counted.min(f64::from(step.cycles)) / step.frequency_hz
    }

    /// First sample from which peaks of a step are taken.
    pub(super) fn first_counted(&self, index: usize) -> usize {
        ((self.counted_from(index) - 1e-12) / self.dt).ceil().max(0.0) as usize
    }
}
