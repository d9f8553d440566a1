//! What all detectors need of a sample, computed once: finite channels, the command as the table must
//! have felt it (delayed by the chain), the place in the half-cycle, gaps in the numbers.

use super::observation::{Observation, Setup};
use crate::model::Response;
use crate::stream::{Channels, Sample};
use crate::sweep::{CommandPoint, Segment};
use std::f64::consts::{PI, TAU};

/// Samples of command that are remembered; the chain delay must be shorter.
const REMEMBERED: usize = 256;

/// Speed (m/s) and acceleration (m/s2) from which on the table counts as moving.
const MOVING: (f64, f64) = (1e-3, 1e-2);

/// A sample within the steady sine of a step.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Sine of the phase that the measured motion has.
    pub sin: f64,
    /// Cosine of it.
    pub cos: f64,
    /// A_G, or the floor where that is larger, m/s2.
    pub scale_m_s2: f64,
    /// A step has begun: what was summed before belongs to another one.
    pub fresh: bool,
    /// A half-cycle has ended with the sample before this one.
    pub ended: bool,
}

/// One sample, prepared.
#[derive(Clone, Copy, Debug)]
pub struct Context {
    /// As delivered.
    pub sample: Sample,
    /// Channels with every number that is not finite replaced by the last one that was.
    pub channels: Channels,
    /// Onboard model.
    pub response: Response,
    /// Channels that are not finite.
    pub not_finite: u32,
    /// The command moves the table.
    pub moving: bool,
    /// Measured minus commanded table displacement, m.
    pub following_error_m: f64,
    /// Measured minus commanded table acceleration, m/s2.
    pub table_error_m_s2: f64,
    /// Amplitude of the commanded speed, m/s; 0 outside the sweep.
    pub speed_amplitude_m_s: f64,
    /// Where in a step; `None` in ramps, transitions, stops and at rest.
    pub place: Option<Place>,
    /// Samples missing before this one.
    pub missing: u64,
    /// The number is not above the last one.
    pub repeated: bool,
}

/// Prepares samples.
pub struct Conditioner {
    rate_hz: f64,
    delay_samples: f64,
    floor_m_s2: f64,
    commands: [(f64, f64); REMEMBERED],
    written: usize,
    last_sequence: Option<u64>,
    last: [f64; 5],
    step: Option<u32>,
    half: i64,
    whole: bool,
}

impl Conditioner {
    /// For a rig; `floor_m_s2` bounds the scale from below.
    pub fn new(setup: &Setup, floor_m_s2: f64) -> Self {
        let most = (REMEMBERED - 2) as f64;
        Self {
            rate_hz: setup.sample_rate_hz,
            delay_samples: (setup.chain_delay_s * setup.sample_rate_hz).clamp(0.0, most),
            floor_m_s2,
            commands: [(0.0, 0.0); REMEMBERED],
            written: 0,
            last_sequence: None,
            last: [0.0; 5],
            step: None,
            half: 0,
            whole: false,
        }
    }

    /// Prepares one sample.
    pub fn prepare(&mut self, observation: &Observation) -> Context {
        let Observation { sample, reference, response } = observation;
        let (missing, repeated) = self.number(sample.sequence);
        self.remember(&reference.command, missing, repeated);
        let (channels, not_finite) = self.finite(&sample.channels);
        let (displacement, acceleration) = self.delayed();
        let amplitude = |phase: crate::sweep::StepPhase| {
            phase.acceleration_amplitude_m_s2 / (TAU * phase.frequency_hz.max(1e-3))
        };
        let command = &reference.command;
        Context {
            sample: *sample,
            channels,
            response: *response,
            not_finite,
            moving: command.velocity_m_s.abs() > MOVING.0 || command.acceleration_m_s2.abs() > MOVING.1,
            following_error_m: channels.table_displacement_m - displacement,
            table_error_m_s2: channels.table_acceleration_m_s2 - acceleration,
            speed_amplitude_m_s: reference.phase.map_or(0.0, amplitude),
            place: self.place(reference),
            missing,
            repeated,
        }
    }

    fn number(&mut self, sequence: u64) -> (u64, bool) {
        let Some(last) = self.last_sequence else {
            self.last_sequence = Some(sequence);
            return (0, false);
        };
        if sequence <= last {
            return (0, true);
        }
        self.last_sequence = Some(sequence);
        (sequence - last - 1, false)
    }

    /// Keeps the command of this sample; commands of missing ones lie on a line between.
    fn remember(&mut self, command: &crate::stream::Command, missing: u64, repeated: bool) {
        let new = (command.displacement_m, command.acceleration_m_s2);
        if repeated && self.written > 0 {
            self.commands[(self.written - 1) % REMEMBERED] = new;
            return;
        }
        let old = if self.written == 0 { new } else { self.commands[(self.written - 1) % REMEMBERED] };
        let steps = missing.min(REMEMBERED as u64 - 1) as usize + 1;
        for i in 1..=steps {
            let share = i as f64 / steps as f64;
            let between = (old.0 + share * (new.0 - old.0), old.1 + share * (new.1 - old.1));
            self.commands[self.written % REMEMBERED] = between;
            self.written += 1;
        }
    }

    /// Displacement and acceleration that were commanded one chain delay ago.
    fn delayed(&self) -> (f64, f64) {
        let known = self.written.clamp(1, REMEMBERED) - 1;
        let whole = (self.delay_samples as usize).min(known);
        let share = self.delay_samples - self.delay_samples.floor();
        let at = |back: usize| self.commands[(self.written - 1 - back.min(known)) % REMEMBERED];
        let (near, far) = (at(whole), at(whole + 1));
        (near.0 + share * (far.0 - near.0), near.1 + share * (far.1 - near.1))
    }

    fn finite(&mut self, raw: &Channels) -> (Channels, u32) {
        let mut values = channel_values(raw);
        let mut bad = 0;
        for (value, last) in values.iter_mut().zip(&mut self.last) {
            if value.is_finite() {
                *last = *value;
            } else {
                *value = *last;
                bad += 1;
            }
        }
        let [table_displacement_m, table_acceleration_m_s2, first, second, relative_displacement_m] = values;
        let channels = Channels {
            table_displacement_m,
            table_acceleration_m_s2,
            mass_acceleration_1_m_s2: first,
            mass_acceleration_2_m_s2: second,
            relative_displacement_m,
        };
        (channels, bad)
    }

    /// The place in the half-cycle of the delayed phase. A half-cycle that was entered in its middle is
    /// not told as ended.
    fn place(&mut self, reference: &CommandPoint) -> Option<Place> {
        let phase = reference.phase.filter(|_| reference.segment == Segment::Step);
        let Some(phase) = phase else {
            self.step = None;
            return None;
        };
        let a_sample_rad = TAU * phase.frequency_hz / self.rate_hz;
        let delayed_rad = phase.phase_rad - a_sample_rad * self.delay_samples;
        if delayed_rad < 0.0 {
            self.step = None;
            return None;
        }
        let half = (delayed_rad / PI).floor() as i64;
        let begun = self.step != Some(phase.index);
        let partial = !begun && !self.whole;
        let mut ended = false;
        if begun {
            self.step = Some(phase.index);
            self.whole = delayed_rad - half as f64 * PI <= 1.5 * a_sample_rad;
        } else if half != self.half {
            ended = self.whole;
            self.whole = true;
        }
        self.half = half;
        let (sin, cos) = delayed_rad.sin_cos();
        let scale_m_s2 = phase.acceleration_amplitude_m_s2.abs().max(self.floor_m_s2);
        Some(Place { sin, cos, scale_m_s2, fresh: begun || partial, ended })
    }
}

/// The five channels in their order.
pub fn channel_values(channels: &Channels) -> [f64; 5] {
    [
        channels.table_displacement_m,
        channels.table_acceleration_m_s2,
        channels.mass_acceleration_1_m_s2,
        channels.mass_acceleration_2_m_s2,
        channels.relative_displacement_m,
    ]
}

/// Joins half-cycles in pairs: a full-cycle estimate twice a cycle, none across two steps.
#[derive(Clone, Copy, Debug, Default)]
pub struct Halves<T> {
    now: T,
    before: Option<T>,
}

impl<T: Copy + Default> Halves<T> {
    /// Moves on; gives the last two half-cycles when the second has just ended. The caller then adds the
    /// sample to [`Halves::now`].
    pub fn turn(&mut self, place: &Place) -> Option<(T, T)> {
        if place.fresh {
            *self = Self::default();
        }
        if !place.ended {
            return None;
        }
        let ended = std::mem::take(&mut self.now);
        self.before.replace(ended).map(|before| (before, ended))
    }

    /// Sums of the half-cycle that runs.
    pub fn now(&mut self) -> &mut T {
        &mut self.now
    }

    /// Forgets everything, as when the table leaves a step.
    pub fn clear(&mut self) {
        *self = Self::default();
    }
}

/// Running mean square with exponential forgetting.
#[derive(Clone, Copy, Debug)]
pub struct MeanSquare {
    share: f64,
    value: f64,
}

impl MeanSquare {
    /// With a memory of `memory_s`.
    pub fn new(memory_s: f64, sample_rate_hz: f64) -> Self {
        Self { share: (1.0 / (memory_s * sample_rate_hz)).min(1.0), value: 0.0 }
    }

    /// Adds a value and gives the mean square.
    pub fn add(&mut self, x: f64) -> f64 {
        self.value += self.share * (x * x - self.value);
        self.value
    }

    /// Forgets all.
    pub fn reset(&mut self) {
        self.value = 0.0;
    }
}

/// Events within about the last second.
#[derive(Clone, Copy, Debug)]
pub struct Recent {
    keep: f64,
    level: f64,
}

impl Recent {
    /// At a rate of calls, Hz.
    pub fn new(rate_hz: f64) -> Self {
        Self { keep: (-1.0 / rate_hz).exp(), level: 0.0 }
    }

    /// One call with `events`; gives the weighted number of the last second.
    pub fn add(&mut self, events: u64) -> f64 {
        self.level = self.level * self.keep + events as f64;
        self.level
    }
}
