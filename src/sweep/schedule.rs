//! The steps of a sweep in order, with their nominal times.

use super::motion::Glide;
use super::spec::{Settling, SweepDirection, SweepSpec, Transition};
use super::{Direction, SweepError};
use crate::config::Check;
use std::f64::consts::TAU;

/// One step: a pure sine of constant peak acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Index in the whole schedule, from 0.
    pub index: u32,
    /// Sweep direction.
    pub direction: Direction,
    /// Frequency f_k, Hz.
    pub frequency_hz: f64,
    /// Peak acceleration A_G, m/s2.
    pub acceleration_amplitude_m_s2: f64,
    /// Displacement amplitude X_k = A_G/(2 pi f_k)^2, m.
    pub displacement_amplitude_m: f64,
    /// Counted cycles.
    pub cycles: u32,
    /// Nominal start of the first cycle, s since the start of the command (no settling, no hold).
    pub start_s: f64,
    /// Nominal end of the last cycle, s.
    pub end_s: f64,
}

/// The whole command as a list of steps joined by transitions.
#[derive(Clone, Debug, PartialEq)]
pub struct Schedule {
    pub(super) steps: Vec<Step>,
    pub(super) transition: Transition,
    pub(super) transition_cycles: u32,
    pub(super) ramp_cycles: u32,
    pub(super) settling: Option<Settling>,
    duration_s: f64,
}

impl Schedule {
    /// Lays out a sweep.
    ///
    /// # Errors
    /// [`SweepError::Invalid`] for a specification that [`Check`] refuses.
    pub fn new(spec: &SweepSpec) -> Result<Self, SweepError> {
        let invalid = |(key, reason)| SweepError::Invalid { key, reason };
        spec.check().map_err(invalid)?;
        let forward_hz = spec.forward_hz().map_err(invalid)?;
        let mut schedule = Self {
            steps: Vec::with_capacity(2 * forward_hz.len()),
            transition: spec.transition,
            transition_cycles: spec.transition_cycles,
            ramp_cycles: spec.ramp_cycles,
            settling: spec.settling,
            duration_s: 0.0,
        };
        let cycles = |i: usize| spec.cycles_per_step.as_ref().map_or(spec.cycles, |list| list[i]);
        let amplitude = spec.acceleration_m_s2();
        if spec.direction != SweepDirection::Backward {
            for (i, &hz) in forward_hz.iter().enumerate() {
                schedule.push(Direction::Forward, hz, cycles(i), amplitude);
            }
        }
        if spec.direction != SweepDirection::Forward {
            for (i, &hz) in forward_hz.iter().enumerate().rev() {
                schedule.push(Direction::Backward, hz, cycles(i), amplitude);
            }
        }
        schedule.duration_s = schedule.steps.last().map_or(0.0, |last| last.end_s + schedule.ramp_s(last));
        Ok(schedule)
    }

    /// The steps that were found in a record, in its order, with nothing between them.
    pub fn of_steps(steps: Vec<Step>) -> Self {
        let duration_s = steps.last().map_or(0.0, |last| last.end_s);
        Self {
            steps,
            transition: Transition::None,
            transition_cycles: 0,
            ramp_cycles: 0,
            settling: None,
            duration_s,
        }
    }

    fn push(&mut self, direction: Direction, frequency_hz: f64, cycles: u32, amplitude_m_s2: f64) {
        let w = TAU * frequency_hz;
        let mut step = Step {
            index: self.steps.len() as u32,
            direction,
            frequency_hz,
            acceleration_amplitude_m_s2: amplitude_m_s2,
            displacement_amplitude_m: amplitude_m_s2 / (w * w),
            cycles,
            start_s: 0.0,
            end_s: 0.0,
        };
        step.start_s = match self.steps.last() {
            None => self.ramp_s(&step),
            Some(before) => before.end_s + self.glide(before, &step).map_or(0.0, |glide| glide.duration_s),
        };
        step.end_s = step.start_s + f64::from(cycles) / frequency_hz;
        self.steps.push(step);
    }

    /// The transition between two steps; `None` when they follow each other directly.
    pub(super) fn glide(&self, from: &Step, to: &Step) -> Option<Glide> {
        (self.transition == Transition::Smooth && from.frequency_hz != to.frequency_hz).then(|| {
            let amplitude = to.acceleration_amplitude_m_s2;
            Glide::new(from.frequency_hz, to.frequency_hz, self.transition_cycles, amplitude)
        })
    }

    /// Duration of the ramp before or after a step, s; zero without smooth transitions.
    pub(super) fn ramp_s(&self, step: &Step) -> f64 {
        match self.transition {
            Transition::Smooth => f64::from(self.ramp_cycles) / step.frequency_hz,
            Transition::None => 0.0,
        }
    }

    /// The steps in order.
    pub fn steps(&self) -> &[Step] {
        &self.steps
    }

    /// Nominal duration from rest to rest, s: with `settling`, if every step settled at once.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Longest duration, s: with `settling`, if no step ever settled (holds not counted).
    pub fn longest_duration_s(&self) -> f64 {
        let waiting = self.settling.map_or(0.0, |settling| f64::from(settling.max_cycles));
        self.duration_s + self.steps.iter().map(|step| waiting / step.frequency_hz).sum::<f64>()
    }

    /// How steps are joined.
    pub fn transition(&self) -> Transition {
        self.transition
    }

    /// The rule of waiting for the steady state, if there is one.
    pub fn settling(&self) -> Option<Settling> {
        self.settling
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paper_schedule_has_92_steps_and_483_seconds() {
        let ideal = SweepSpec { transition: Transition::None, ..SweepSpec::paper() };
        let schedule = Schedule::new(&ideal).expect("valid");
        assert_eq!(schedule.steps().len(), 92);
        // 2 x 10 x sum of 1/f_k, f_k = 0.5 .. 5.0 Hz
        let cycles: f64 = (5..=50).map(|k| 200.0 / f64::from(k)).sum();
        assert!((schedule.duration_s() - cycles).abs() < 1e-9);
        assert!((483.0..484.0).contains(&schedule.duration_s()));
        let first = schedule.steps()[0];
        assert!((first.displacement_amplitude_m - 0.0497).abs() < 5e-5);
        assert_eq!(schedule.steps()[45].frequency_hz, 5.0);
        assert_eq!(schedule.steps()[46].frequency_hz, 5.0);
        assert_eq!(schedule.steps()[46].direction, Direction::Backward);

        let smooth = Schedule::new(&SweepSpec::paper()).expect("valid");
        // a cycle at the mean frequency between each pair of steps, two cycles of 0.5 Hz at each end
        let glides: f64 = (5..50).map(|k| 2.0 * 20.0 / f64::from(2 * k + 1)).sum();
        assert!((smooth.duration_s() - cycles - glides - 8.0).abs() < 1e-9);
    }

    #[test]
    fn backward_keeps_the_cycles_of_its_frequencies() {
        let spec = SweepSpec {
            frequencies_hz: Some(vec![1.0, 2.0]),
            start_hz: None,
            stop_hz: None,
            step_hz: None,
            cycles_per_step: Some(vec![3, 7]),
            direction: SweepDirection::Backward,
            ..SweepSpec::paper()
        };
        let schedule = Schedule::new(&spec).expect("valid");
        let got: Vec<_> = schedule.steps().iter().map(|s| (s.frequency_hz, s.cycles)).collect();
        assert_eq!(got, [(2.0, 7), (1.0, 3)]);
    }
}
