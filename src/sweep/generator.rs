//! The command sample by sample.
//!
//! The control step calls [`Generator::next_point`] once a period and passes feedback in through
//! methods: the response has settled, hold at the end of the step, go on. Nothing allocates after
//! construction. Segments start at their exact times between samples, so phases never drift from the
//! schedule.

use super::motion::{Glide, Motion, ramp, steady};
use super::schedule::{Schedule, Step};
use super::{Direction, StepPhase};
use crate::stream::Command;
use std::f64::consts::TAU;

/// Which part of the sweep a sample belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Segment {
    /// From rest to the first step.
    StartRamp,
    /// In a step: settling, counted or held cycles.
    Step,
    /// In a step, but on the way back to its sine after control periods without a command.
    Rejoin,
    /// Between two steps.
    Transition,
    /// From the last step to rest.
    EndRamp,
    /// At rest after the sweep.
    Done,
}

/// The command of one sample and where in the sweep it stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandPoint {
    /// What the table is asked to do.
    pub command: Command,
    /// Commanded jerk, m/s3.
    pub jerk_m_s3: f64,
    /// Step and phase; `None` once the sweep is done.
    pub phase: Option<StepPhase>,
    /// Part of the sweep.
    pub segment: Segment,
}

impl CommandPoint {
    /// Index of the step whose counted cycles this sample belongs to, -1 elsewhere: the `step` column
    /// of a record.
    pub fn counted_step(&self) -> i32 {
        self.phase.filter(|phase| phase.counted).map_or(-1, |phase| phase.index as i32)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    StartRamp,
    Step(usize),
    /// On the way to a step.
    Transition(usize),
    EndRamp,
    Done,
}

/// Produces the command of a [`Schedule`].
#[derive(Clone, Debug)]
pub struct Generator {
    schedule: Schedule,
    sample_period_s: f64,
    sample: u64,
    place: Place,
    start_s: f64,
    end_s: f64,
    glide: Glide,
    counted_from: u32,
    hold: bool,
    recorded: Option<Vec<CommandPoint>>,
}

impl Generator {
    /// A generator of points that are known already, those of a record; it never ends by itself, and
    /// neither settling nor holds change it.
    pub fn recorded(schedule: &Schedule, sample_rate_hz: f64, points: Vec<CommandPoint>) -> Self {
        Self { recorded: Some(points), ..Self::new(schedule, sample_rate_hz) }
    }

    /// A generator at the start of the schedule, one point each 1/`sample_rate_hz`; the first is at time 0.
    pub fn new(schedule: &Schedule, sample_rate_hz: f64) -> Self {
        let mut generator = Self {
            schedule: schedule.clone(),
            sample_period_s: 1.0 / sample_rate_hz,
            sample: 0,
            place: Place::Done,
            start_s: 0.0,
            end_s: f64::INFINITY,
            glide: Glide::new(1.0, 1.0, 1, 0.0),
            counted_from: 0,
            hold: false,
            recorded: None,
        };
        if let Some(first) = schedule.steps().first() {
            generator.place = Place::StartRamp;
            generator.end_s = schedule.ramp_s(first);
        }
        generator
    }

    /// The command of the next sample.
    pub fn next_point(&mut self) -> CommandPoint {
        if let Some(points) = &self.recorded {
            let rest = assemble(Motion::default(), None, Segment::Done);
            let point = points.get(self.sample as usize).copied().unwrap_or(rest);
            self.sample += 1;
            return point;
        }
        let time_s = self.time_s();
        while time_s >= self.end_s {
            self.enter_next();
        }
        self.sample += 1;
        self.point(time_s - self.start_s)
    }

    /// Leaves out `samples` points, as after an overrun: time goes on, the phase is kept.
    pub fn skip(&mut self, samples: u64) {
        self.sample += samples;
    }

    /// Tells that the response to this step is steady: counting starts with the next cycle. Without
    /// effect in any other step, or once counting has started.
    pub fn settled(&mut self, step_index: u32) {
        let Place::Step(i) = self.place else { return };
        let Some(step) = self.schedule.steps.get(i) else { return };
        if step.index != step_index || self.schedule.settling.is_none() {
            return;
        }
        let now_s = (self.time_s() - self.sample_period_s - self.start_s).max(0.0);
        let next_cycle = (now_s * step.frequency_hz).floor() as u32 + 1;
        if next_cycle < self.counted_from {
            self.counted_from = next_cycle;
            self.end_s = self.start_s + f64::from(next_cycle + step.cycles) / step.frequency_hz;
        }
    }

    /// Asks to stay in the present (or the next) step beyond its counted cycles: the table goes on with
    /// the same sine, uncounted, until [`Generator::resume`].
    pub fn hold_at_step_end(&mut self) {
        self.hold = true;
    }

    /// Ends a hold: the sweep goes on at the end of the cycle it is in.
    pub fn resume(&mut self) {
        self.hold = false;
    }

    /// Whether a hold is asked for.
    pub fn holds(&self) -> bool {
        self.hold
    }

    /// Whether the sweep has ended and the table is at rest.
    pub fn is_done(&self) -> bool {
        self.place == Place::Done && self.recorded.is_none()
    }

    /// Time of the next point, s since the start of the command.
    pub fn time_s(&self) -> f64 {
        self.sample as f64 * self.sample_period_s
    }

    /// Nominal time until the table is at rest again, s, if every step still ahead settles at once.
    pub fn remaining_s(&self) -> f64 {
        let steps = &self.schedule.steps;
        let in_segment_s = (self.end_s - self.time_s()).max(0.0);
        let after = |time_s: f64| self.schedule.duration_s() - time_s;
        match self.place {
            Place::StartRamp => after(steps.first().map_or(0.0, |step| step.start_s)) + in_segment_s,
            Place::Step(i) => after(steps.get(i).map_or(0.0, |step| step.end_s)) + in_segment_s,
            Place::Transition(i) => after(steps.get(i).map_or(0.0, |step| step.start_s)) + in_segment_s,
            Place::EndRamp => in_segment_s,
            Place::Done => 0.0,
        }
    }

    /// The schedule this generator follows.
    pub fn schedule(&self) -> &Schedule {
        &self.schedule
    }

    fn enter_next(&mut self) {
        match self.place {
            Place::StartRamp => self.enter_step(0),
            Place::Transition(i) => self.enter_step(i),
            Place::Step(i) => self.leave_step(i),
            Place::EndRamp | Place::Done => {
                self.place = Place::Done;
                self.start_s = self.end_s;
                self.end_s = f64::INFINITY;
            }
        }
    }

    fn enter_step(&mut self, i: usize) {
        let step = self.schedule.steps[i];
        self.place = Place::Step(i);
        self.counted_from = self.schedule.settling.map_or(0, |settling| settling.max_cycles);
        self.start_s = self.end_s;
        self.end_s = self.start_s + f64::from(self.counted_from + step.cycles) / step.frequency_hz;
    }

    fn leave_step(&mut self, i: usize) {
        let step = self.schedule.steps[i];
        if self.hold {
            let cycles = ((self.end_s - self.start_s) * step.frequency_hz).round() + 1.0;
            self.end_s = self.start_s + cycles / step.frequency_hz;
            return;
        }
        let Some(ahead) = self.schedule.steps.get(i + 1) else {
            self.place = Place::EndRamp;
            self.start_s = self.end_s;
            self.end_s = self.start_s + self.schedule.ramp_s(&step);
            return;
        };
        match self.schedule.glide(&step, ahead) {
            Some(glide) => {
                self.glide = glide;
                self.place = Place::Transition(i + 1);
                self.start_s = self.end_s;
                self.end_s = self.start_s + glide.duration_s;
            }
            None => self.enter_step(i + 1),
        }
    }

    fn point(&self, t_s: f64) -> CommandPoint {
        let steps = &self.schedule.steps;
        match self.place {
            Place::StartRamp => self.ramp_point(steps.first(), t_s, Segment::StartRamp),
            Place::EndRamp => self.ramp_point(steps.last(), t_s, Segment::EndRamp),
            Place::Step(i) => self.step_point(&steps[i], t_s),
            Place::Transition(i) => {
                let (motion, phase_rad, w) = self.glide.at(t_s);
                assemble(motion, Some((&steps[i], w / TAU, phase_rad, false)), Segment::Transition)
            }
            Place::Done => assemble(Motion::default(), None, Segment::Done),
        }
    }

    fn step_point(&self, step: &Step, t_s: f64) -> CommandPoint {
        let cycles = step.frequency_hz * t_s;
        let counted =
            cycles >= f64::from(self.counted_from) && cycles < f64::from(self.counted_from + step.cycles);
        // The sine is taken of the phase within the cycle: long dwells lose no digits.
        let motion = steady(
            step.acceleration_amplitude_m_s2,
            TAU * step.frequency_hz,
            TAU * (cycles - cycles.floor()),
        );
        assemble(motion, Some((step, step.frequency_hz, TAU * cycles, counted)), Segment::Step)
    }

    fn ramp_point(&self, step: Option<&Step>, t_s: f64, segment: Segment) -> CommandPoint {
        let Some(step) = step else { return assemble(Motion::default(), None, Segment::Done) };
        let (motion, phase_rad) = ramp(
            step.acceleration_amplitude_m_s2,
            TAU * step.frequency_hz,
            self.schedule.ramp_s(step),
            t_s,
            segment == Segment::StartRamp,
        );
        assemble(motion, Some((step, step.frequency_hz, phase_rad, false)), segment)
    }
}

fn assemble(motion: Motion, place: Option<(&Step, f64, f64, bool)>, segment: Segment) -> CommandPoint {
    CommandPoint {
        command: Command {
            displacement_m: motion.displacement_m,
            velocity_m_s: motion.velocity_m_s,
            acceleration_m_s2: motion.acceleration_m_s2,
        },
        jerk_m_s3: motion.jerk_m_s3,
        phase: place.map(|(step, frequency_hz, phase_rad, counted)| StepPhase {
            index: step.index,
            direction: step.direction,
            frequency_hz,
            acceleration_amplitude_m_s2: step.acceleration_amplitude_m_s2,
            phase_rad,
            counted,
        }),
        segment,
    }
}

impl Direction {
    /// The word shown to operators and written to files.
    pub fn label(self) -> &'static str {
        match self {
            Self::Forward => "forward",
            Self::Backward => "backward",
        }
    }
}

#[cfg(test)]
#[path = "generator_tests.rs"]
mod tests;
