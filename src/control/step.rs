//! The control step: acquire, condition, predict, watch, decide, command, publish. It owns all it
//! touches, talks to the rest through rings only, and neither allocates, frees, locks, logs nor waits.
//! Called by the control thread (wall time) or by the loop of virtual time, once a tick.

use super::chain::{Chain, Conditioned};
use super::clock::{Tick, now_ns};
use super::event::{Ending, Event};
use super::guard::{Cause, Guard};
use super::reference::References;
use super::stop::StopTrajectory;
use super::timing::{Phase, StepTimes, Timing, TimingReport};
use crate::model::{Response, Specimen};
use crate::rig::{Rig, RigFault};
use crate::stream::{Command, ControlEnd, Row, Sample};
use crate::sweep::{CommandPoint, Generator, Segment};

/// Samples that one step can take; more stay with the rig until the next one.
const MOST_SAMPLES: usize = 4096;
/// Periods for which recording goes on once the table is at rest.
const TAIL_PERIODS: u64 = 512;

/// Periods between two reports of the live error.
const LIVE_PERIODS: u64 = 512;

/// What the operator's side may ask of the control thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Request {
    /// Stay in the present step once its counted cycles are done.
    Hold,
    /// End a hold.
    Resume,
    /// Bring the table to rest and end.
    Stop,
}

/// What a controller is made of.
pub struct Parts {
    /// The rig.
    pub rig: Box<dyn Rig>,
    /// The command.
    pub generator: Generator,
    /// The onboard model, made for one step a sample period.
    pub model: Box<dyn Specimen>,
    /// The control thread's end of the rings.
    pub end: ControlEnd<Event, Request>,
    /// Sampling and control rate, Hz.
    pub sample_rate_hz: f64,
}

/// The control step with all it owns.
pub struct Controller {
    rig: Box<dyn Rig>,
    generator: Generator,
    model: Box<dyn Specimen>,
    end: ControlEnd<Event, Request>,
    chain: Chain,
    references: References,
    rows: Vec<Row>,
    guard: Guard,
    stop: Option<(StopTrajectory, Ending)>,
    acceleration_limit_m_s2: f64,
    sample_rate_hz: f64,
    timing: Timing,
    times: StepTimes,
    last_times: StepTimes,
    lap_ns: u64,
    cycle: u64,
    next_sequence: Option<u64>,
    last_fault: Option<RigFault>,
    tail: u64,
    ending: Option<Ending>,
    tripped: Option<Cause>,
    now: Instant,
}

/// The sample that the phases work on.
#[derive(Clone, Copy)]
struct Instant {
    sample: Sample,
    reference: CommandPoint,
    conditioned: Conditioned,
    response: Response,
}

impl Controller {
    /// Puts the parts together; everything that the step needs is allocated here.
    pub fn new(parts: Parts) -> Self {
        let rest = CommandPoint {
            command: Command::default(),
            jerk_m_s3: 0.0,
            phase: None,
            segment: Segment::StartRamp,
        };
        let schedule = parts.generator.schedule();
        let amplitude = |step: &crate::sweep::Step| step.acceleration_amplitude_m_s2;
        let acceleration_limit_m_s2 = schedule.steps().iter().map(amplitude).fold(0.0, f64::max);
        let chain = Chain::new(parts.sample_rate_hz, schedule);
        let guard = Guard::new(parts.rig.chain_delay_s(), parts.sample_rate_hz);
        Self {
            chain,
            guard,
            stop: None,
            acceleration_limit_m_s2,
            sample_rate_hz: parts.sample_rate_hz,
            rig: parts.rig,
            generator: parts.generator,
            model: parts.model,
            end: parts.end,
            references: References::new(rest),
            rows: Vec::with_capacity(MOST_SAMPLES),
            timing: Timing::new(),
            times: StepTimes::default(),
            last_times: StepTimes::default(),
            lap_ns: 0,
            cycle: 0,
            next_sequence: None,
            last_fault: None,
            tail: 0,
            ending: None,
            tripped: None,
            now: Instant {
                sample: Sample::default(),
                reference: rest,
                conditioned: Conditioned::default(),
                response: Response::default(),
            },
        }
    }

    /// One control period. Returns how the run ended, once it has.
    pub fn step(&mut self, tick: Tick) -> Option<Ending> {
        self.begin(tick);
        while self.acquire() {
            self.condition();
            self.predict();
            self.watch();
            self.decide();
            self.keep();
        }
        self.miss(tick.periods);
        self.command();
        self.publish();
        self.finish(tick)
    }

    /// Rows that can still be published before the recorder's ring is full.
    pub fn record_room(&self) -> usize {
        self.end.record_room()
    }

    /// The newest command.
    pub fn last_command(&self) -> Command {
        self.references.last().command
    }

    /// Timing so far.
    pub fn timing(&self) -> TimingReport {
        self.timing.report()
    }

    fn lap(&mut self, phase: Phase) {
        let now = now_ns();
        self.times.add(phase, now.saturating_sub(self.lap_ns));
        self.lap_ns = now;
    }

    /// Opens the period: tells a slip, lets virtual rigs follow, keeps the phase of the command.
    fn begin(&mut self, tick: Tick) {
        self.lap_ns = now_ns();
        self.times = StepTimes::default();
        self.times.add(Phase::WakeUp, tick.latency_ns);
        let skipped = tick.periods - 1;
        if skipped > 0 {
            self.timing.slip(skipped);
            let phase = if tick.overslept_by_work { self.last_times.longest() } else { Phase::WakeUp };
            let late_us = tick.latency_ns as f64 / 1e3;
            self.end.event(Event::Slip { cycle: self.cycle, periods: skipped, late_us, phase });
            if self.stop.is_some() {
                self.skip_stopping(skipped);
            } else {
                self.references.skip(skipped, &mut self.generator);
            }
            self.cycle += skipped;
        }
        for _ in 0..tick.periods {
            self.rig.advance();
        }
        self.lap(Phase::Simulate);
    }

    /// Skipped periods of a stop, which lasts 3 s at most.
    fn skip_stopping(&mut self, periods: u64) {
        for _ in 0..periods.min(3 * self.sample_rate_hz as u64) {
            let point = self.next_point();
            self.references.push(point);
        }
    }

    /// Takes the oldest sample that waits.
    fn acquire(&mut self) -> bool {
        if self.rows.len() >= MOST_SAMPLES {
            return false;
        }
        match self.rig.read() {
            Ok(Some(sample)) => {
                self.last_fault = None;
                self.note_gap(&sample);
                self.now.sample = sample;
                self.now.reference = self.references.of(sample.sequence);
                self.lap(Phase::Acquire);
                true
            }
            Ok(None) => {
                self.drained();
                false
            }
            Err(fault) => {
                self.fault(fault);
                self.drained();
                false
            }
        }
    }

    /// Nothing more waits: the last sample taken in this period tells how the DAQ's clock lies.
    fn drained(&mut self) {
        if !self.rows.is_empty() {
            self.references.newest(self.now.sample.sequence);
        }
        self.lap(Phase::Acquire);
    }

    /// Filters what was measured.
    fn condition(&mut self) {
        self.now.conditioned = self.chain.condition(&self.now.sample.channels);
        self.lap(Phase::Condition);
    }

    /// Lets the onboard model follow the measured table acceleration and compares.
    fn predict(&mut self) {
        self.now.response = self.model.step(self.now.sample.channels.table_acceleration_m_s2);
        if let Some(step) = self.chain.compare(&self.now.reference, &self.now.conditioned, &self.now.response)
        {
            self.end.event(Event::Step(step));
        }
        if let Some(index) = self.chain.settled(&self.now.reference) {
            self.generator.settled(index);
        }
        self.lap(Phase::Predict);
    }

    /// Shows the sample to the detectors.
    fn watch(&mut self) {
        self.tripped = self.guard.look(&self.now.sample, &self.now.reference);
        self.lap(Phase::Watch);
    }

    /// Ends the run when a limit was exceeded; the first cause stays.
    fn decide(&mut self) {
        if let Some(cause) = self.tripped.take() {
            self.abort(cause);
        }
        self.lap(Phase::Decide);
    }

    /// Keeps the row of this sample for publishing.
    fn keep(&mut self) {
        self.rows.push(Row {
            sample: self.now.sample,
            command: self.now.reference.command,
            step: self.now.reference.counted_step(),
            model_displacement_m: self.now.response.relative_displacement_m,
            model_acceleration_m_s2: self.now.response.mass_acceleration_m_s2,
            model_regime: self.now.response.regime,
            supervisor_state: 0,
            lost_before: 0,
        });
    }

    /// Gives the one command of this period.
    fn command(&mut self) {
        let mut obeyed = None;
        while let Some(request) = self.end.request() {
            self.obey(request);
            obeyed = Some(request);
        }
        let point = self.next_point();
        self.references.push(point);
        if let Err(fault) = self.rig.write(&point.command) {
            self.fault(fault);
        }
        if let Some(request) = obeyed {
            self.end.event(Event::Obeyed { cycle: self.cycle, request, at_ns: now_ns() });
        }
        self.lap(Phase::Command);
    }

    /// Hands rows over to the recorder and the live view.
    fn publish(&mut self) {
        for row in &self.rows {
            self.end.publish(row);
        }
        self.rows.clear();
        self.lap(Phase::Publish);
    }

    /// Closes the period and finds out whether the run is over.
    fn finish(&mut self, tick: Tick) -> Option<Ending> {
        self.timing.record(&self.times, tick.period_error_ns);
        self.last_times = self.times;
        self.cycle += 1;
        if self.cycle.is_multiple_of(LIVE_PERIODS) {
            let error = self.chain.live_error();
            self.end.event(Event::Live { cycle: self.cycle, error });
        }
        if let Some((trajectory, ending)) = &self.stop {
            let ending = *ending;
            self.tail += u64::from(trajectory.is_done());
            if self.tail > TAIL_PERIODS {
                self.end_run(ending);
            }
        } else if self.ending.is_none() && self.generator.is_done() {
            self.tail += 1;
            if self.tail > TAIL_PERIODS {
                self.end_run(Ending::Done);
            }
        }
        self.ending
    }

    fn end_run(&mut self, ending: Ending) {
        if self.ending.is_none() {
            self.ending = Some(ending);
            let error = self.chain.error();
            self.end.event(Event::End { cycle: self.cycle, ending, error });
        }
    }

    fn obey(&mut self, request: Request) {
        match request {
            Request::Hold => self.generator.hold_at_step_end(),
            Request::Resume => self.generator.resume(),
            Request::Stop => self.begin_stop(Ending::Stopped),
        }
    }

    /// Periods without any sample are watched as well.
    fn miss(&mut self, periods: u64) {
        if self.rows.is_empty()
            && let Some(cause) = self.guard.silence(periods)
        {
            self.abort(cause);
        }
    }

    /// The command of this period: the sweep's, or that of the stop which has begun.
    fn next_point(&mut self) -> CommandPoint {
        match &mut self.stop {
            Some((trajectory, _)) => CommandPoint {
                command: trajectory.next_command(),
                jerk_m_s3: 0.0,
                phase: None,
                segment: Segment::Done,
            },
            None => self.generator.next_point(),
        }
    }

    /// Stops the table from where its command is now; a stop that has begun goes on.
    fn begin_stop(&mut self, ending: Ending) {
        if self.stop.is_none() && self.ending.is_none() {
            let from = self.references.last().command;
            let trajectory = StopTrajectory::new(from, self.acceleration_limit_m_s2, self.sample_rate_hz);
            self.stop = Some((trajectory, ending));
        }
    }

    fn abort(&mut self, cause: Cause) {
        if matches!(self.stop, Some((_, Ending::Aborted))) || self.ending.is_some() {
            return;
        }
        self.end.event(Event::Abort { cycle: self.cycle, sequence: self.now.sample.sequence, cause });
        self.begin_stop(Ending::Aborted);
        if let Some((_, ending)) = &mut self.stop {
            *ending = Ending::Aborted;
        }
        // A drive that is down or out of reach must stop by itself as well.
        if cause == Cause::DeviceStatus {
            self.rig.quick_stop();
        }
    }

    /// Tells a fault of the rig once, until it is gone.
    fn fault(&mut self, fault: RigFault) {
        if fault == RigFault::EndOfRecord {
            self.end_run(Ending::Done);
        } else if self.last_fault != Some(fault) {
            self.last_fault = Some(fault);
            self.end.event(Event::RigFault { cycle: self.cycle, fault });
        }
    }

    /// Tells samples that the DAQ never delivered.
    fn note_gap(&mut self, sample: &Sample) {
        if let Some(expected) = self.next_sequence {
            let missing = sample.sequence.saturating_sub(expected);
            if missing > 0 {
                let after = expected.saturating_sub(1);
                self.end.event(Event::DaqGap { cycle: self.cycle, after, missing });
            }
        }
        self.next_sequence = Some(sample.sequence + 1);
    }
}
