//! Every fault of the simulated rig in every state of the supervisor: where it ends, for which cause, and that the
//! command stays within the capacity of the rig, that nothing starts again and that the record says so.

use crate::bench::{Bench, in_parallel, setup};
use crate::pages::{section, write_section};
use rand::{Rng as _, SeedableRng};
use rand_pcg::Pcg64Mcg;
use shaketable::control::{Ending, Event, Request};
use shaketable::rig::simulated::{Channel, Fault, SimulatedRig};
use shaketable::rig::{Rig, RigSpec};
use shaketable::safety::{Begin, State};
use shaketable::stream::Command;
use shaketable::sweep::SweepSpec;
use std::collections::BTreeMap;

const FAULTS: [(&str, Fault); 14] = [
    ("frozen feedback", Fault::FrozenFeedback),
    ("dropout", Fault::Dropout),
    ("late burst of 33", Fault::LateBurst),
    ("repeated sample", Fault::RepeatedSample),
    ("NaN: table displacement", Fault::NotANumber(Channel::TableDisplacement)),
    ("NaN: laser", Fault::NotANumber(Channel::RelativeDisplacement)),
    ("stuck: table displacement", Fault::Stuck(Channel::TableDisplacement)),
    ("stuck: mass accelerometer", Fault::Stuck(Channel::MassAcceleration1)),
    ("stuck: laser", Fault::Stuck(Channel::RelativeDisplacement)),
    (
        "swapped: table and mass accelerometer",
        Fault::Swapped(Channel::TableAcceleration, Channel::MassAcceleration1),
    ),
    (
        "swapped: laser and table displacement",
        Fault::Swapped(Channel::RelativeDisplacement, Channel::TableDisplacement),
    ),
    ("bus off", Fault::BusOff),
    ("serial garbage", Fault::SerialGarbage),
    ("drive trip", Fault::DriveTrip),
];

/// Where the table stands before a run that has to centre it, m.
const OFF_CENTRE_M: f64 = 0.02;
const AFTER_PERIODS: u64 = 16 * 2048;
const AT_REST_PERIODS: u64 = 3 * 2048;

/// How one injection went.
#[derive(Clone, Debug)]
struct Injected {
    end: State,
    cause: Option<&'static str>,
    decision_periods: Option<u64>,
}

impl Injected {
    fn word(&self) -> String {
        self.cause.map_or(self.end.name().to_owned(), |cause| format!("{}: {cause}", self.end.name()))
    }
}

/// Moves a fresh rig off its centre, slowly.
fn displace(rig: &mut SimulatedRig) {
    let periods = 4096;
    for k in 0..=periods + 512 {
        let u = (f64::from(k) / f64::from(periods)).min(1.0);
        let displacement_m = OFF_CENTRE_M * u * u * u * (10.0 + u * (6.0 * u - 15.0));
        rig.advance();
        while let Ok(Some(_)) = rig.read() {}
        let command = Command { displacement_m, ..Command::default() };
        rig.write(&command).expect("a healthy rig");
    }
}

/// A run whose command is judged at every period.
struct Watched {
    bench: Bench,
    last: Option<Command>,
    latched: bool,
}

impl Watched {
    fn new(state: State, seed: u64) -> Self {
        let sweep = SweepSpec::paper().restricted(1.0, 1.2).expect("in range");
        let setup = setup("B2-G2-0.05", RigSpec::default(), sweep, seed);
        let prepare = |rig: &mut SimulatedRig| {
            if state == State::Centring {
                displace(rig);
            }
        };
        let bench = Bench::new(&setup, prepare, |guard| guard.beginning(Begin::OnRequest));
        Self { bench, last: None, latched: false }
    }

    fn state(&self) -> State {
        self.bench.controller.state().expect("guarded")
    }

    fn ask(&mut self, requests: &[Request]) {
        for request in requests {
            self.bench.operator.ask(*request).expect("room");
        }
    }

    /// One period. SR-14: inside stroke, velocity, acceleration and jerk; nothing starts after a latch.
    fn step(&mut self) -> Option<Ending> {
        let (before, cause) = (self.state(), self.bench.controller.cause());
        let ending = self.bench.step();
        let (capacity, now) = (RigSpec::default().capacity(), self.bench.controller.last_point());
        let command = now.command;
        assert!(command.displacement_m.abs() <= capacity.displacement_m, "{command:?}");
        assert!(command.velocity_m_s.abs() <= capacity.velocity_m_s, "{command:?}");
        assert!(command.acceleration_m_s2.abs() <= capacity.acceleration_m_s2, "{command:?}");
        if let Some(last) = self.last {
            let jerk = (command.acceleration_m_s2 - last.acceleration_m_s2) * 2048.0;
            assert!(jerk.abs() <= capacity.jerk_m_s3, "{jerk} m/s3");
            let jump_m = (command.displacement_m - last.displacement_m).abs();
            assert!(jump_m <= capacity.velocity_m_s / 2048.0, "{jump_m} m");
        }
        self.last = Some(command);
        // SR-09: the period that decides is the first whose command is no longer the sweep's.
        if cause.is_none() && self.bench.controller.cause().is_some() && before.moves() {
            assert!(now.phase.is_none(), "{now:?}");
        }
        self.latched |= matches!(self.state(), State::Aborting | State::Aborted);
        let follows =
            matches!(self.state(), State::Running | State::Holding | State::Armed | State::Centring);
        assert!(!(self.latched && follows), "{:?} after a latch", self.state());
        ending
    }

    fn steps(&mut self, periods: u64) {
        for _ in 0..periods {
            assert_eq!(self.step(), None);
        }
    }

    /// Goes to a state and a random instant in it.
    fn reach(&mut self, state: State, rng: &mut Pcg64Mcg) {
        use Request::{Arm, Hold, Reset, Start, Stop};
        // Being taken over at a measured place shakes the table by the sensor's noise; until it is at rest, arming is refused.
        self.steps(200);
        if state == State::Faulted {
            self.steps(rng.random_range(1..500));
            return;
        }
        self.ask(&[Reset]);
        self.steps(2);
        if state != State::Idle {
            self.ask(&[Arm]);
            self.steps(2);
        }
        if !matches!(state, State::Idle | State::Centring | State::Armed) {
            self.ask(&[Start]);
            self.steps(6144 + rng.random_range(0..2048));
        }
        let most = match state {
            State::Centring => 2200,
            State::Running => 8192,
            State::Holding => {
                self.ask(&[Hold]);
                6144
            }
            State::Stopping => {
                self.ask(&[Stop]);
                1500
            }
            State::Aborting | State::Aborted => {
                let nan = Fault::NotANumber(Channel::TableAcceleration);
                self.bench.faults.set(nan, true);
                self.steps(8);
                self.bench.faults.set(nan, false);
                while state == State::Aborted && self.state() != State::Aborted {
                    self.steps(1);
                }
                if state == State::Aborted { 4000 } else { 1000 }
            }
            _ => 2000,
        };
        self.steps(rng.random_range(1..most));
    }
}

fn inject(state: State, fault: Fault, seed: u64) -> Injected {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut watched = Watched::new(state, seed);
    watched.reach(state, &mut rng);
    watched.bench.drain();
    assert_eq!(watched.state(), state, "seed {seed}: {:?}", watched.bench.events);
    let (moves, known) = (state.moves(), watched.bench.controller.cause());
    watched.bench.faults.set(fault, true);
    let (mut decision_periods, mut ending) = (None, None);
    for n in 1..=if moves { AFTER_PERIODS } else { AT_REST_PERIODS } {
        ending = watched.step();
        if decision_periods.is_none() && known.is_none() && watched.bench.controller.cause().is_some() {
            decision_periods = Some(n);
        }
        if ending.is_some() {
            break;
        }
    }
    let (end, cause) = (watched.state(), watched.bench.controller.cause().map(|id| id.name()));
    assert!(!matches!(end, State::Aborting | State::Stopping), "{fault:?} in {state:?}: never at rest");
    watched.bench.drain();
    let told = watched.bench.events.iter().filter_map(|event| match event {
        Event::Abort { cause, .. } => Some(cause.name()),
        _ => None,
    });
    let told: Vec<_> = told.collect();
    assert_eq!(told, cause.into_iter().collect::<Vec<_>>(), "{fault:?} in {state:?}: on record");
    let last = watched.last.unwrap_or_default();
    if moves && cause.is_some() {
        assert_eq!(ending, Some(Ending::Aborted), "{fault:?} in {state:?}");
        assert!(last.velocity_m_s.abs() < 1e-9 && last.acceleration_m_s2.abs() < 1e-9, "{last:?}");
    }
    Injected { end, cause, decision_periods }
}

/// How often each fault in each state ended in which way.
type Tally = BTreeMap<(usize, State), BTreeMap<String, u64>>;

/// All of a table: by fault, by state, what happened how often.
fn table(instants: u64) -> (String, Tally) {
    let mut jobs = Vec::new();
    for fault in 0..FAULTS.len() {
        for state in State::ALL {
            jobs.extend((0..instants).map(|n| (fault, state, 7919 * n + 31 * fault as u64 + state as u64)));
        }
    }
    let results = in_parallel(&jobs, |(fault, state, seed)| inject(*state, FAULTS[*fault].1, *seed));
    let mut cells: BTreeMap<(usize, State), BTreeMap<String, u64>> = BTreeMap::new();
    let mut slowest = [0; FAULTS.len()];
    for ((fault, state, _), result) in jobs.iter().zip(&results) {
        *cells.entry((*fault, *state)).or_default().entry(result.word()).or_default() += 1;
        if *state == State::Running {
            slowest[*fault] = slowest[*fault].max(result.decision_periods.unwrap_or(0));
        }
    }
    let mut text = format!("{instants} random instants a cell.\n\n| fault |");
    State::ALL.iter().for_each(|state| text += &format!(" {} |", state.name()));
    text += " onset to decision while running, worst, ms |\n|---|";
    text += &"---|".repeat(State::ALL.len() + 1);
    text += "\n";
    for (i, (name, _)) in FAULTS.iter().enumerate() {
        text += &format!("| {name} |");
        for state in State::ALL {
            let cell = &cells[&(i, state)];
            let words: Vec<String> = match cell.len() {
                1 => cell.keys().cloned().collect(),
                _ => cell.iter().map(|(word, n)| format!("{word} ({n})")).collect(),
            };
            text += &format!(" {} |", words.join("; "));
        }
        text += &match slowest[i] {
            0 => " - |\n".to_owned(),
            n => format!(" {:.1} |\n", n as f64 / 2.048),
        };
    }
    (text, cells)
}

// SR-09, SR-14
#[test]
fn faults_end_in_the_stated_state_for_the_stated_cause() {
    let stated = section("faults");
    let (_, cells) = table(1);
    for ((fault, state), words) in cells {
        let name = FAULTS[fault].0;
        let line = stated.lines().find(|line| line.starts_with(&format!("| {name} |"))).expect("a row");
        let column = State::ALL.iter().position(|other| *other == state).expect("a state") + 2;
        let cell = line.split('|').nth(column).expect("a column");
        for word in words.keys() {
            let listed =
                cell.split(';').any(|entry| entry.split(" (").next().map(str::trim) == Some(word.as_str()));
            assert!(listed, "{name} in {state:?}: `{word}` is not in docs/safety.md: {cell}");
        }
    }
}

#[test]
#[ignore = "writes the table of docs/safety.md: minutes in release"]
fn the_table_of_faults_and_states() {
    let instants = std::env::var("INSTANTS").ok().and_then(|n| n.parse().ok()).unwrap_or(100);
    let (text, _) = table(instants);
    println!("{text}");
    if std::env::var_os("WRITE_DOCS").is_some() {
        write_section("faults", &text);
    }
}
