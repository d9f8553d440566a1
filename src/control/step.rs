//! The control step: acquire, condition, predict, watch, decide, command, publish. It owns all it
//! touches, talks to the rest through rings only, and neither allocates, frees, locks, logs nor waits (SR-16).
//! Called by the control thread (wall time) or by the loop of virtual time, once a tick.

use super::chain::{Chain, Conditioned};
use super::clock::{Tick, now_ns};
use super::event::{Ending, Event};
use super::onboard::Onboard;
use super::reference::References;
use super::timing::{Phase, StepTimes, Timing, TimingReport};
use crate::model::Response;
use crate::rig::{Rig, RigFault};
use crate::safety::{Ask, DetectorId, Guard, Heart, Observation, Outcome, Period, State};
use crate::stream::{Command, ControlEnd, Row, Sample};
use crate::sweep::{CommandPoint, Generator, Segment};

impl From<Outcome> for Ending {
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Done => Self::Done,
            Outcome::Stopped => Self::Stopped,
            Outcome::Aborted => Self::Aborted,
        }
    }
}

/// Samples that one step can take; more stay with the rig until the next one.
const MOST_SAMPLES: usize = 4096;
/// Periods for which recording goes on once the table is at rest.
const TAIL_PERIODS: u64 = 512;

/// In virtual time every so many periods are timed: nobody waits for them, and reading the clock ten times a
/// period would take a good part of it.
const TIMED_OF_VIRTUAL: u64 = 16;
/// Periods between two reports of the live error.
const LIVE_PERIODS: u64 = 512;
/// Sides on which the rig fails.
const READING: usize = 0;
const COMMANDING: usize = 1;

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
    /// Acknowledge and reset, for a run that begins on request.
    Reset,
    /// Arm where the table is measured to be.
    Arm,
    /// Start the sweep.
    Start,
    /// A sign of life of the operator's side.
    Alive,
}

/// What a controller is made of.
pub struct Parts {
    /// The rig.
    pub rig: Box<dyn Rig>,
    /// The command.
    pub generator: Generator,
    /// The onboard model.
    pub model: Onboard,
    /// Detectors, supervisor and stops; `None` for a replayed record, which moves nothing.
    pub guard: Option<Guard>,
    /// The control thread's end of the rings.
    pub end: ControlEnd<Event, Request>,
    /// Sampling and control rate, Hz.
    pub sample_rate_hz: f64,
}

/// The control step with all it owns.
pub struct Controller {
    rig: Box<dyn Rig>,
    generator: Generator,
    model: Onboard,
    end: ControlEnd<Event, Request>,
    chain: Chain,
    references: References,
    rows: Vec<Row>,
    guard: Option<Guard>,
    heart: Heart,
    told: Option<State>,
    told_cause: Option<DetectorId>,
    skipped: u64,
    rig_fault: Option<RigFault>,
    record_depth: usize,
    timing: Timing,
    times: StepTimes,
    last_times: StepTimes,
    lap_ns: u64,
    timed: bool,
    cycle: u64,
    next_sequence: Option<u64>,
    /// Faults that have been told and still stand: of reading, of commanding.
    told_faults: [Option<RigFault>; 2],
    tail: u64,
    ending: Option<Ending>,
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
        let chain = Chain::new(parts.sample_rate_hz, schedule);
        let record_depth = parts.end.record_room().max(1);
        Self {
            chain,
            guard: parts.guard,
            heart: Heart::default(),
            told: None,
            told_cause: None,
            skipped: 0,
            rig_fault: None,
            record_depth,
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
            timed: true,
            cycle: 0,
            next_sequence: None,
            told_faults: [None; 2],
            tail: 0,
            ending: None,
            now: Instant {
                sample: Sample::default(),
                reference: rest,
                conditioned: Conditioned::default(),
                response: Response::default(),
            },
        }
    }

    /// The heartbeat of this controller, for a watchdog.
    pub fn heart(&self) -> Heart {
        self.heart.clone()
    }

    /// One control period. Returns how the run ended, once it has.
    pub fn step(&mut self, tick: Tick) -> Option<Ending> {
        self.heart.beat();
        self.begin(tick);
        while self.acquire() {
            self.condition();
            self.predict();
            self.watch();
            self.keep();
        }
        self.decide();
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

    /// The newest command and where in the sweep it stands.
    pub fn last_point(&self) -> CommandPoint {
        self.references.last()
    }

    /// The detector that tripped first, if one did.
    pub fn cause(&self) -> Option<DetectorId> {
        self.guard.as_ref().and_then(Guard::cause)
    }

    /// State of the supervisor; `None` without one.
    pub fn state(&self) -> Option<State> {
        self.guard.as_ref().map(Guard::state)
    }

    /// Timing so far.
    pub fn timing(&self) -> TimingReport {
        self.timing.report()
    }

    fn lap(&mut self, phase: Phase) {
        if !self.timed {
            return;
        }
        let now = now_ns();
        self.times.add(phase, now.saturating_sub(self.lap_ns));
        self.lap_ns = now;
    }

    /// Opens the period: tells a slip, lets virtual rigs follow, keeps the phase of the command.
    fn begin(&mut self, tick: Tick) {
        self.timed = tick.period_error_ns.is_some() || self.cycle.is_multiple_of(TIMED_OF_VIRTUAL);
        self.lap_ns = if self.timed { now_ns() } else { 0 };
        self.times = StepTimes::default();
        self.times.add(Phase::WakeUp, tick.latency_ns);
        let skipped = tick.periods - 1;
        self.skipped = skipped;
        if skipped > 0 {
            self.timing.slip(skipped);
            let phase = if tick.overslept_by_work { self.last_times.longest() } else { Phase::WakeUp };
            let late_us = tick.latency_ns as f64 / 1e3;
            self.end.event(Event::Slip { cycle: self.cycle, periods: skipped, late_us, phase });
            self.skip(skipped);
            self.cycle += skipped;
        }
        for _ in 0..tick.periods {
            self.rig.advance();
        }
        self.lap(Phase::Simulate);
    }

    /// Periods without a command: the drive coasts, sweep or stop go on, so that the phase is kept.
    fn skip(&mut self, periods: u64) {
        let forgotten = self.references.forget(periods);
        match &mut self.guard {
            Some(guard) => guard.skip(forgotten, &mut self.generator),
            None => self.generator.skip(forgotten),
        }
        for _ in forgotten..periods {
            let point = match &mut self.guard {
                Some(guard) => guard.coast(&mut self.generator),
                None => self.generator.next_point(),
            };
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
                self.told_faults[READING] = None;
                self.note_gap(&sample);
                self.now.sample = sample;
                if let Some(held) = self.guard.as_mut().and_then(|guard| guard.hold(&sample)) {
                    self.references.begin_at(held);
                }
                self.now.reference = self.references.of(sample.sequence);
                self.lap(Phase::Acquire);
                true
            }
            Ok(None) => {
                self.drained();
                false
            }
            Err(fault) => {
                self.fault(READING, fault);
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

    /// Lets the onboard model follow the measured table and compares.
    fn predict(&mut self) {
        self.now.response = self.model.follow(&self.now.sample);
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
        let Instant { sample, reference, response, .. } = self.now;
        if let Some(guard) = &mut self.guard {
            guard.observe(&Observation { sample, reference, response });
        }
        self.lap(Phase::Watch);
    }

    /// Lets the supervisor decide which command is in force from this period on (SR-09).
    fn decide(&mut self) {
        let free = self.end.record_room() as f64 / self.record_depth as f64;
        let period = Period {
            samples: self.rows.len() as u32,
            skipped: self.skipped,
            recorder_used: 1.0 - free,
            link_age_s: None,
            rig_fault: self.rig_fault.take(),
        };
        if let Some(guard) = &mut self.guard {
            guard.decide(&period, &mut self.generator);
        }
        self.tell();
        self.lap(Phase::Decide);
    }

    /// Tells what the detectors found and how the supervisor stands.
    fn tell(&mut self) {
        let Some(guard) = &mut self.guard else { return };
        let (cycle, sequence) = (self.cycle, self.now.sample.sequence);
        while let Some((detector, tripped)) = guard.news() {
            let value = guard.watch().reading(detector).value;
            self.end.event(Event::Finding { cycle, detector, tripped, value });
        }
        let cause = guard.cause();
        if let Some(cause) = cause.filter(|_| self.told_cause.is_none()) {
            self.end.event(Event::Abort { cycle, sequence, cause });
        }
        self.told_cause = cause;
        let state = guard.state();
        if self.told.replace(state) != Some(state) {
            self.end.event(Event::Supervisor { cycle, state });
        }
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
            supervisor_state: self.guard.as_ref().map_or(0, |guard| guard.state() as u8),
            lost_before: 0,
        });
    }

    /// Gives the one command of this period.
    fn command(&mut self) {
        let mut obeyed = None;
        while let Some(request) = self.end.request() {
            let obeys = self.obey(request);
            // Signs of life come several times a second: only their absence is told.
            obeyed = (obeys && request != Request::Alive).then_some(request).or(obeyed);
        }
        self.tell();
        let point = self.next_point();
        self.references.push(point);
        if self.guard.as_ref().is_some_and(Guard::wants_quick_stop) {
            self.rig.quick_stop();
        }
        let commands = self.guard.as_ref().is_none_or(Guard::commands);
        if commands {
            match self.rig.write(&point.command) {
                Ok(()) => self.told_faults[COMMANDING] = None,
                Err(fault) => self.fault(COMMANDING, fault),
            }
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
        if self.timed {
            self.timing.record(&self.times, tick.period_error_ns);
        }
        self.timing.pass();
        self.last_times = self.times;
        self.cycle += 1;
        if self.cycle.is_multiple_of(LIVE_PERIODS) {
            let error = self.chain.live_error();
            self.end.event(Event::Live { cycle: self.cycle, error });
        }
        let outcome = match &self.guard {
            Some(guard) => guard.outcome(),
            None => self.generator.is_done().then_some(Outcome::Done),
        };
        if let Some(outcome) = outcome {
            self.tail += 1;
            if self.tail > TAIL_PERIODS {
                self.end_run(outcome.into());
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

    /// Does what was asked, or tells why not.
    fn obey(&mut self, request: Request) -> bool {
        let Some(guard) = &mut self.guard else {
            self.obey_unguarded(request);
            return true;
        };
        let ask = match request {
            Request::Hold => Ask::Hold,
            Request::Resume => Ask::Resume,
            Request::Stop => Ask::Stop,
            Request::Reset => Ask::Reset,
            Request::Arm => Ask::Arm,
            Request::Start => Ask::Start,
            Request::Alive => Ask::Alive,
        };
        let outcome = guard.ask(ask, &mut self.generator);
        if let Err(reason) = outcome {
            self.end.event(Event::Refused { cycle: self.cycle, reason });
        }
        outcome.is_ok()
    }

    /// A replayed record can be held up and left, nothing else.
    fn obey_unguarded(&mut self, request: Request) {
        match request {
            Request::Hold => self.generator.hold_at_step_end(),
            Request::Resume => self.generator.resume(),
            Request::Stop => self.end_run(Ending::Stopped),
            Request::Reset | Request::Arm | Request::Start | Request::Alive => {}
        }
    }

    /// The command of this period: the sweep's, or what the supervisor has put in its place.
    fn next_point(&mut self) -> CommandPoint {
        match &mut self.guard {
            Some(guard) => guard.next_point(&mut self.generator),
            None => self.generator.next_point(),
        }
    }

    /// Tells a fault of the rig once, until it is gone.
    fn fault(&mut self, side: usize, fault: RigFault) {
        self.rig_fault = Some(fault);
        if fault == RigFault::EndOfRecord {
            self.end_run(Ending::Done);
        } else if self.told_faults[side] != Some(fault) {
            self.told_faults[side] = Some(fault);
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
