//! Detectors, supervisor and stops together, as the control step calls them: shows samples and periods to the watch,
//! tells the supervisor what was found and asked, and says which command is in force. What the supervisor orders
//! changes the command of the same period; nothing in here goes back to the sweep by itself (SR-14).

use super::observation::{Observation, Period, Setup};
use super::rejoin::Rejoin;
use super::spec::{DetectorId, SafetySpec, Stops};
use super::stop::{Decay, MinimumJerkStop, Return};
use super::supervisor::{Event, Order, Refusal, Rules, State, Supervisor};
use super::watch::{DetectorSet, Findings, Watch};
use crate::rig::Capacity;
use crate::stream::{Command, Sample};
use crate::sweep::{CommandPoint, Generator, Segment};
use std::time::Duration;

/// How far from its command a table at rest may be measured to be for arming, m.
const HELD_M: f64 = 1e-3;
/// A stop or return goes on after periods without a command if the drive is off it by no more than this: m, m/s.
const OFF_M: f64 = 1e-5;
const OFF_M_S: f64 = 1e-3;
/// Time without a command after which a drive stops by itself, s.
const COAST_S: f64 = 0.1;

/// Where the command comes from.
#[derive(Clone, Copy, Debug)]
enum Source {
    Rest,
    Sweep,
    Stop(MinimumJerkStop),
    Decay(Decay),
    Pause,
    Return(Return),
}

/// When the sweep begins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Begin {
    /// As soon as samples come and nothing is wrong: whoever starts the run has asked for reset, arm and start.
    #[default]
    AtOnce,
    /// Reset, arm and start are asked for one by one.
    OnRequest,
}

/// What an operator may ask of the supervisor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ask {
    /// Acknowledge and reset.
    Reset,
    /// Arm where the table is measured to be.
    Arm,
    /// Start the sweep.
    Start,
    /// Stay in the step.
    Hold,
    /// Go on.
    Resume,
    /// Come to rest.
    Stop,
    /// Nothing but a sign of life.
    Alive,
}

/// How a guarded run came to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The sweep has ended.
    Done,
    /// Stopped on request.
    Stopped,
    /// A fault.
    Aborted,
}

/// Watches, supervises, and stops the table.
pub struct Guard {
    watch: Watch,
    supervisor: Supervisor,
    begin: Begin,
    stops: Stops,
    capacity: Capacity,
    period_s: f64,
    operator_link: bool,
    watchdog: Duration,
    still_m_s2: f64,
    now: u64,
    heard: u64,
    source: Source,
    periods: u64,
    last: CommandPoint,
    /// Periods without a command since the last one.
    coasted: u64,
    /// Where the source of commands stood in the last of them.
    passed: Command,
    /// The way back to the sweep, and the periods since it began.
    rejoin: Option<(Rejoin, u64)>,
    amplitude_m_s2: f64,
    measured: Option<Sample>,
    returns: bool,
    quick_stop: bool,
    stop_asked: bool,
    tripped_at: Option<u64>,
    snapshot_periods: u64,
    outcome: Option<Outcome>,
    /// The outcome was noted with no fault latched: one that comes before the record ends still counts.
    ended_well: bool,
    told: Findings,
}

impl Guard {
    /// For a run; faulted until samples show that nothing is wrong.
    pub fn new(spec: &SafetySpec, setup: &Setup) -> Self {
        let periods = |time_s: f64| (time_s * setup.sample_rate_hz).ceil() as u64;
        let times = &spec.supervision;
        let rules =
            Rules { armed_for: periods(times.armed_for_s), reset_fresh: periods(times.reset_fresh_s) };
        let rest = Command::default();
        Self {
            watch: Watch::new(spec, setup),
            supervisor: Supervisor::new(rules),
            begin: Begin::AtOnce,
            stops: spec.stops.clone(),
            capacity: setup.capacity,
            period_s: 1.0 / setup.sample_rate_hz,
            operator_link: times.operator_link,
            watchdog: Duration::from_secs_f64(times.watchdog_s),
            still_m_s2: spec.detection.acceleration_floor_m_s2,
            now: 0,
            heard: 0,
            source: Source::Rest,
            periods: 0,
            last: CommandPoint { command: rest, jerk_m_s3: 0.0, phase: None, segment: Segment::StartRamp },
            coasted: 0,
            passed: rest,
            rejoin: None,
            amplitude_m_s2: spec.detection.acceleration_floor_m_s2,
            measured: None,
            returns: false,
            quick_stop: false,
            stop_asked: false,
            tripped_at: None,
            snapshot_periods: periods(super::SNAPSHOT_S),
            outcome: None,
            ended_well: false,
            told: Findings::default(),
        }
    }

    /// The same, beginning otherwise.
    pub fn beginning(self, begin: Begin) -> Self {
        Self { begin, ..self }
    }

    /// Shows a sample to the detectors.
    pub fn observe(&mut self, observation: &Observation) {
        self.measured = Some(observation.sample);
        self.watch.observe(observation);
    }

    /// SR-05: until it is armed, the table is commanded to be where it was first measured to be. Tells the first sample
    /// from the others: gives the place to be held, once.
    pub fn hold(&mut self, sample: &Sample) -> Option<CommandPoint> {
        if self.measured.is_some() {
            return None;
        }
        let place_m = sample.channels.table_displacement_m;
        if place_m.is_finite() && place_m.abs() > self.stops.centre_tolerance_m {
            self.last.command = Command { displacement_m: place_m, ..Command::default() };
        }
        Some(self.last)
    }

    /// Whether there is anything to command: not before the table has been measured.
    pub fn commands(&self) -> bool {
        self.measured.is_some()
    }

    /// Closes the samples of a period and acts on what was found, in this same period (SR-09).
    pub fn decide(&mut self, period: &Period, generator: &mut Generator) {
        self.now += 1 + period.skipped;
        let link_age_s = self.operator_link.then(|| (self.now - self.heard) as f64 * self.period_s);
        let findings = self.watch.period(&Period { link_age_s, ..*period });
        let present = self.watch.latching(findings.present);
        if findings.action.latches() {
            self.tripped_at.get_or_insert(self.now);
            if !present.is_empty() || !self.supervisor.latched() {
                self.tell(Event::Trip(findings.action), generator);
            }
        } else if findings.action == super::Action::Hold && self.state() == State::Running {
            self.tell(Event::Hold, generator);
        }
        if present.is_empty() && self.supervisor.present() {
            self.tell(Event::Clear, generator);
        }
        self.tell(Event::Time, generator);
        if self.begin == Begin::AtOnce && self.supervisor.state() == State::Faulted && period.samples > 0 {
            self.begin(present, generator);
        }
        self.conclude(generator);
    }

    /// The run was asked for as a whole: what that stands for, once nothing is wrong.
    fn begin(&mut self, present: DetectorSet, generator: &mut Generator) {
        if !present.is_empty() || self.cause().is_some() || self.stop_asked {
            return;
        }
        // Each is refused when it must be, and then the sweep has not begun; the next period asks again.
        for ask in [Ask::Reset, Ask::Arm] {
            if self.ask(ask, generator).is_err() {
                return;
            }
        }
        let _ = self.ask(Ask::Start, generator);
    }

    /// Asks for something on behalf of an operator.
    ///
    /// # Errors
    /// [`Refusal`] of the supervisor; nothing has changed then.
    pub fn ask(&mut self, ask: Ask, generator: &mut Generator) -> Result<(), Refusal> {
        let event = match ask {
            Ask::Alive => {
                self.heard = self.now;
                return Ok(());
            }
            Ask::Reset => {
                self.watch.reset();
                Event::Reset { asked: self.now }
            }
            Ask::Arm => self.arm(),
            Ask::Start => Event::Start,
            Ask::Hold => Event::Hold,
            Ask::Resume => Event::Resume,
            Ask::Stop => {
                self.stop_asked = true;
                Event::Stop
            }
        };
        let order = self.supervisor.handle(self.now, event)?;
        self.obey(order, generator);
        self.conclude(generator);
        Ok(())
    }

    /// What arming rests upon: the newest sample, and that the table neither moves nor is commanded to.
    fn arm(&self) -> Event {
        let Some(sample) = self.measured else { return Event::Arm { at_rest: false, centred: false } };
        let place_m = sample.channels.table_displacement_m;
        let still = sample.channels.table_acceleration_m_s2.abs() <= self.still_m_s2;
        let at_rest = place_m.is_finite() && still && matches!(self.source, Source::Rest);
        let centred = self.last.command.displacement_m.abs() <= self.stops.centre_tolerance_m;
        Event::Arm { at_rest: at_rest && self.holds(place_m), centred }
    }

    /// Whether the table is measured where it is commanded to be.
    fn holds(&self, place_m: f64) -> bool {
        (place_m - self.last.command.displacement_m).abs() <= HELD_M
    }

    fn tell(&mut self, event: Event, generator: &mut Generator) {
        // None of the events told here is ever refused.
        if let Ok(order) = self.supervisor.handle(self.now, event) {
            self.obey(order, generator);
        }
    }

    /// Carries out an order: the next command is the first of the new source.
    fn obey(&mut self, order: Order, generator: &mut Generator) {
        match order {
            Order::None => {}
            Order::Sweep => self.enter(Source::Sweep),
            Order::Hold => generator.hold_at_step_end(),
            Order::Resume => generator.resume(),
            Order::Centre => {
                let from_m = self.last.command.displacement_m;
                self.enter(Source::Return(Return::new(from_m, &self.stops)));
            }
            Order::Stop => {
                // Whoever stops the way to the centre wants no way to the centre.
                self.returns = matches!(self.source, Source::Sweep);
                match Decay::of(&self.last, &self.stops) {
                    Some(decay) if matches!(self.source, Source::Sweep) => self.enter(Source::Decay(decay)),
                    _ => self.stop_at_once(),
                }
            }
            Order::Abort | Order::QuickStop => {
                self.returns = false;
                self.quick_stop |= order == Order::QuickStop;
                match self.source {
                    Source::Rest | Source::Stop(_) | Source::Pause => {}
                    _ => self.stop_at_once(),
                }
            }
        }
    }

    fn stop_at_once(&mut self) {
        let amplitude = match self.source {
            Source::Return(_) => self.stops.return_acceleration_m_s2,
            _ => self.amplitude_m_s2,
        };
        let stop = MinimumJerkStop::new(&self.last.command, amplitude, &self.stops, &self.capacity);
        self.enter(Source::Stop(stop));
    }

    /// The command of the next period.
    pub fn next_point(&mut self, generator: &mut Generator) -> CommandPoint {
        if self.coasted > 0 {
            self.come_back(generator);
        } else {
            let point = self.source_point(generator);
            self.last = self.rejoining(point);
        }
        self.last
    }

    /// A period without a command: the drive goes on along the last one, until it stops by itself; sweep, stop or
    /// return go on beside it, so that the phase is kept.
    pub fn coast(&mut self, generator: &mut Generator) -> CommandPoint {
        let point = self.source_point(generator);
        self.coasted += 1;
        self.passed = point.command;
        let command = if self.coasted as f64 * self.period_s <= COAST_S {
            self.last.command.after(self.period_s)
        } else {
            Command { displacement_m: self.last.command.displacement_m, ..Command::default() }
        };
        self.last = CommandPoint { command, ..off_course(point) };
        self.last
    }

    /// SR-17: the first command after periods without one lies where the drive has gone by itself. From there the sweep
    /// is joined again; a stop or a return from which the drive has strayed becomes a stop from there.
    fn come_back(&mut self, generator: &mut Generator) {
        let point = self.coast(generator);
        self.coasted = 0;
        let off = point.command - self.passed;
        if matches!(self.source, Source::Sweep) {
            self.rejoin = Some((Rejoin::new(&off, &point, &self.stops, &self.capacity), 0));
        } else if off.displacement_m.abs() > OFF_M || off.velocity_m_s.abs() > OFF_M_S {
            self.returns |= matches!(self.source, Source::Return(_));
            self.stop_at_once();
        } else {
            self.last.command = self.passed;
        }
    }

    /// A point of the sweep with what is left of the distance to it.
    fn rejoining(&mut self, point: CommandPoint) -> CommandPoint {
        let Some((rejoin, periods)) = &mut self.rejoin else { return point };
        *periods += 1;
        let time_s = *periods as f64 * self.period_s;
        let off = rejoin.at(time_s);
        if time_s >= rejoin.duration_s() {
            self.rejoin = None;
            return point;
        }
        CommandPoint { command: point.command + off, ..off_course(point) }
    }

    /// Where the source of commands stands in the next period.
    fn source_point(&mut self, generator: &mut Generator) -> CommandPoint {
        self.periods += 1;
        let time_s = self.periods as f64 * self.period_s;
        let rest = Command { velocity_m_s: 0.0, acceleration_m_s2: 0.0, ..self.last.command };
        let command = match self.source {
            Source::Sweep => return self.of_sweep(generator),
            Source::Rest => rest,
            Source::Stop(stop) => {
                if time_s >= stop.duration_s() {
                    self.enter(Source::Pause);
                }
                stop.at(time_s)
            }
            Source::Decay(decay) => {
                if time_s >= decay.duration_s() {
                    self.enter(Source::Pause);
                }
                decay.at(time_s)
            }
            Source::Pause => {
                if time_s >= self.stops.rest_s {
                    self.leave_pause();
                }
                rest
            }
            Source::Return(back) => {
                if time_s >= back.duration_s() {
                    self.enter(Source::Rest);
                }
                back.at(time_s)
            }
        };
        let segment =
            if self.supervisor.state() < State::Running { Segment::StartRamp } else { Segment::Done };
        CommandPoint { command, jerk_m_s3: 0.0, phase: None, segment }
    }

    fn of_sweep(&mut self, generator: &mut Generator) -> CommandPoint {
        let point = generator.next_point();
        if let Some(phase) = point.phase {
            self.amplitude_m_s2 = phase.acceleration_amplitude_m_s2;
        }
        point
    }

    fn leave_pause(&mut self) {
        let from_m = self.last.command.displacement_m;
        let far = self.returns && from_m.abs() > self.stops.centre_tolerance_m;
        self.enter(if far { Source::Return(Return::new(from_m, &self.stops)) } else { Source::Rest });
    }

    /// Periods that pass without a command and are too many to be made up one by one.
    pub fn skip(&mut self, periods: u64, generator: &mut Generator) {
        match self.source {
            Source::Sweep => generator.skip(periods),
            _ => self.periods += periods,
        }
    }

    fn enter(&mut self, source: Source) {
        self.source = source;
        self.periods = 0;
        self.rejoin = None;
    }

    /// Tells the supervisor what has come to rest, and notes how the run ends.
    fn conclude(&mut self, generator: &mut Generator) {
        let before = self.supervisor.state();
        let on_course = self.coasted == 0 && self.rejoin.is_none();
        if before.moves() && matches!(self.source, Source::Rest) && on_course {
            self.tell(Event::Rest, generator);
        } else if matches!(self.source, Source::Sweep) && generator.is_done() && on_course {
            self.enter(Source::Rest);
            self.tell(Event::Done, generator);
        }
        if before == State::Centring && self.supervisor.state() == State::Armed && self.begin == Begin::AtOnce
        {
            let _ = self.ask(Ask::Start, generator);
        }
        let at_once = self.begin == Begin::AtOnce && self.cause().is_some();
        let outcome = match (before, self.supervisor.state()) {
            (_, State::Aborted) => Some(Outcome::Aborted),
            (_, State::Faulted) if at_once || self.ended_well => Some(Outcome::Aborted),
            (State::Running | State::Holding, State::Idle) => Some(Outcome::Done),
            (State::Faulted | State::Stopping | State::Armed | State::Idle, State::Faulted | State::Idle)
                if self.stop_asked =>
            {
                Some(Outcome::Stopped)
            }
            _ => None,
        };
        // SR-02: a fault after the last command latches as well.
        if outcome == Some(Outcome::Aborted) {
            self.outcome = outcome;
        } else if self.outcome.is_none() && outcome.is_some() {
            self.outcome = outcome;
            self.ended_well = self.supervisor.state() == State::Idle;
        }
    }

    /// How the run ended, once the table is at rest and what follows a fault has been recorded.
    pub fn outcome(&self) -> Option<Outcome> {
        let recorded = self.tripped_at.is_none_or(|at| self.now >= at + self.snapshot_periods);
        self.outcome.filter(|_| recorded)
    }

    /// The drive must be told to stop by itself.
    pub fn wants_quick_stop(&self) -> bool {
        self.quick_stop
    }

    /// Time without a heartbeat after which a watchdog must stop the drive.
    pub fn watchdog(&self) -> Duration {
        self.watchdog
    }

    /// How the table stands.
    pub fn state(&self) -> State {
        self.supervisor.state()
    }

    /// The supervisor as it stands.
    pub fn supervisor(&self) -> &Supervisor {
        &self.supervisor
    }

    /// The detector that tripped first.
    pub fn cause(&self) -> Option<DetectorId> {
        self.watch.findings().first
    }

    /// The detectors.
    pub fn watch(&self) -> &Watch {
        &self.watch
    }

    /// The next detector that has tripped or warns and was not told yet; true for a trip.
    pub fn news(&mut self) -> Option<(DetectorId, bool)> {
        let now = self.watch.findings();
        if (now.tripped, now.warned) == (self.told.tripped, self.told.warned) {
            return None;
        }
        let trip = now.tripped.iter().find(|id| !self.told.tripped.has(*id)).map(|id| (id, true));
        let news = trip.or(now.warned.iter().find(|id| !self.told.warned.has(*id)).map(|id| (id, false)));
        match news {
            Some((id, true)) => self.told.tripped = self.told.tripped.with(id, true),
            Some((id, false)) => self.told.warned = self.told.warned.with(id, true),
            // Only something that went away is left.
            None => self.told = now,
        }
        news
    }
}

/// A point at which the table is not on the sweep, though the sweep's phase is kept.
fn off_course(point: CommandPoint) -> CommandPoint {
    let segment = if point.segment == Segment::Step { Segment::Rejoin } else { point.segment };
    CommandPoint { segment, ..point }
}
