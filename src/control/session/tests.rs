use super::*;
use crate::control::Onboard;
use crate::model::{Response, Specimen};
use crate::record::samples::SampleReader;
use crate::rig::RigSpec;
use crate::rig::simulated::{FaultSwitches, SimulatedRig, SimulatedSpec, chain_delay_s};
use crate::safety::SafetySpec;
use crate::stream::{Command, OperatorEnd, split};
use crate::sweep::{Schedule, SweepSpec};

/// A mass that stays where the table is: enough to see the plumbing.
struct Rigid {
    a: f64,
}

impl Specimen for Rigid {
    fn reset(&mut self) {
        self.a = 0.0;
    }

    fn step(&mut self, table_acceleration_m_s2: f64) -> Response {
        self.a = table_acceleration_m_s2;
        Response { mass_acceleration_m_s2: self.a, ..Response::default() }
    }

    fn impose(&mut self, _d: f64, _v: f64) -> Response {
        Response::default()
    }
}

fn guard() -> Guard {
    let spec = SafetySpec::built_in().expect("valid");
    let delay_s = chain_delay_s(&SimulatedSpec::default(), 2048.0);
    let known = crate::safety::Setup {
        sample_rate_hz: 2048.0,
        chain_delay_s: delay_s,
        capacity: RigSpec::default().capacity(),
        total_gap_m: None,
        bumper_stiffness_n_m: None,
    };
    Guard::new(&spec, &known)
}

fn plan(out: &std::path::Path, pace: Pace, seed: u64, low_hz: f64, high_hz: f64) -> Plan {
    let sweep = SweepSpec::paper().restricted(low_hz, high_hz).expect("in range");
    let schedule = Schedule::new(&sweep).expect("schedule");
    let rig = SimulatedRig::new(&SimulatedSpec::default(), Box::new(Rigid { a: 0.0 }), 500.0, 2048.0, seed);
    Plan {
        out: out.to_owned(),
        manifest: Manifest::new("test", 2048.0),
        rig: Box::new(rig),
        generator: Generator::new(&schedule, 2048.0),
        model: Onboard::new(Box::new(Rigid { a: 0.0 }), &RigSpec::default()),
        guard: Some(guard()),
        pace,
        depths: Depths::default(),
    }
}

#[test]
fn a_virtual_run_loses_nothing_and_repeats_itself() {
    let out = tempfile::tempdir().expect("folder");
    let run = |seed| {
        let session = start(plan(out.path(), Pace::Virtual, seed, 4.8, 5.0)).expect("started");
        session.wait(|_| {}).expect("ended")
    };
    let (first, again, other) = (run(1), run(1), run(2));
    assert_eq!(first.ending, Ending::Done);
    assert_eq!(first.manifest.lost.samples, 0);
    assert!(first.manifest.clean);
    assert_eq!(first.steps.len(), 6);
    assert_eq!(first.manifest.samples_sha256, again.manifest.samples_sha256);
    assert_ne!(first.manifest.samples_sha256, other.manifest.samples_sha256);
    let reader = SampleReader::open(&first.folder.samples()).expect("opens");
    let rows = reader.read(0, reader.rows()).expect("reads");
    assert!(rows.windows(2).all(|pair| pair[1].sample.sequence == pair[0].sample.sequence + 1));
    for step in &first.steps {
        // The mass moves with the table, which follows its command within 1.5 % at 5 Hz.
        assert!((step.table_amplitude_ratio - 1.0).abs() < 0.015, "{step:?}");
        let counted = rows.iter().filter(|row| row.step == step.index as i32).count() as f64;
        assert!((counted - 10.0 / step.frequency_hz * 2048.0).abs() <= 1.0, "{counted}");
    }
}

#[test]
fn a_wall_clock_run_loses_no_sample_and_takes_its_time() {
    let out = tempfile::tempdir().expect("folder");
    let pace = Pace::Wall { cpu: None, require_realtime: false };
    let started = std::time::Instant::now();
    let session = start(plan(out.path(), pace, 1, 5.0, 5.0)).expect("started");
    let finished = session.wait(|_| {}).expect("ended");
    let wall_s = started.elapsed().as_secs_f64();
    let reader = SampleReader::open(&finished.folder.samples()).expect("opens");
    let rows = reader.read(0, reader.rows()).expect("reads");
    assert_eq!(finished.manifest.lost.samples, 0, "{:?}", finished.manifest.lost);
    assert!(rows.windows(2).all(|pair| pair[1].sample.sequence == pair[0].sample.sequence + 1));
    let expected_s = rows.len() as f64 / 2048.0;
    assert!(wall_s > expected_s - 0.1, "{wall_s} s for {expected_s} s");
    let events = std::fs::read_to_string(finished.folder.events()).expect("events");
    let slips = events.lines().filter(|line| line.contains("\"slip\"")).count() as u64;
    assert_eq!(slips, finished.timing.slips);
}

#[test]
fn a_stop_on_request_ends_the_run_and_is_told() {
    let out = tempfile::tempdir().expect("folder");
    let pace = Pace::Wall { cpu: None, require_realtime: false };
    let mut session = start(plan(out.path(), pace, 1, 1.0, 2.0)).expect("started");
    session.ask(Request::Stop).expect("room");
    let finished = session.wait(|_| {}).expect("ended");
    assert_eq!(finished.ending, Ending::Stopped);
    assert!(!finished.manifest.clean);
}

/// Runs in virtual time, does something to the rig or the run after two seconds, and gives the commands.
fn disturbed(disturb: impl FnOnce(&FaultSwitches, &mut OperatorEnd<Request>)) -> (Vec<Command>, Vec<Event>) {
    let out = tempfile::tempdir().expect("folder");
    let mut plan = plan(out.path(), Pace::Virtual, 1, 1.0, 1.2);
    let spec = SimulatedSpec::default();
    let rig = SimulatedRig::new(&spec, Box::new(Rigid { a: 0.0 }), 500.0, 2048.0, 1);
    let faults = rig.faults();
    plan.rig = Box::new(rig);
    let (end, mut recorder, _view, mut operator) = split::<Event, Request>(plan.depths);
    let mut controller = Controller::new(Parts {
        rig: plan.rig,
        generator: plan.generator,
        model: plan.model,
        guard: plan.guard,
        end,
        sample_rate_hz: 2048.0,
    });
    let (mut commands, mut events, mut rows) = (Vec::new(), Vec::new(), Vec::with_capacity(64));
    let mut disturb = Some(disturb);
    for cycle in 0.. {
        if cycle == 4 * 2048
            && let Some(disturb) = disturb.take()
        {
            disturb(&faults, &mut operator);
        }
        let ending = controller.step(VirtualClock.tick());
        commands.push(controller.last_command());
        rows.clear();
        recorder.take_rows(&mut rows);
        while let Some(event) = recorder.take_event() {
            events.push(event);
        }
        if ending.is_some() {
            break;
        }
    }
    (commands, events)
}

/// Largest step of the commanded acceleration, as jerk, m/s3; and the last command.
fn smoothness(commands: &[Command]) -> (f64, Command) {
    let jerk = commands
        .windows(2)
        .map(|pair| (pair[1].acceleration_m_s2 - pair[0].acceleration_m_s2).abs() * 2048.0)
        .fold(0.0, f64::max);
    (jerk, commands.last().copied().unwrap_or_default())
}

#[test]
fn a_stop_is_smooth_and_ends_at_rest() {
    let (commands, events) = disturbed(|_, operator| operator.ask(Request::Stop).expect("room"));
    let (jerk, last) = smoothness(&commands);
    assert!(jerk < 61.0, "{jerk} m/s3");
    assert!(last.velocity_m_s.abs() < 1e-9 && last.acceleration_m_s2.abs() < 1e-9, "{last:?}");
    // Stop, pause and the slow return from up to 12 mm.
    assert!(commands.len() < 4 * 2048 + 3 * 2048, "{} periods", commands.len());
    assert!(last.displacement_m.abs() < 0.2e-3, "{last:?}");
    assert!(matches!(events.last(), Some(Event::End { ending: Ending::Stopped, .. })));
}

#[test]
fn faults_of_the_rig_abort_with_their_cause_and_a_smooth_command() {
    use crate::rig::simulated::{Channel, Fault};
    let expected = [
        (Fault::Dropout, "stale-sample", 105),
        (Fault::DriveTrip, "device-status", 4),
        (Fault::BusOff, "device-status", 4),
        (Fault::NotANumber(Channel::RelativeDisplacement), "not-a-number", 4),
        (Fault::FrozenFeedback, "following-error", 40),
    ];
    for (fault, cause, periods) in expected {
        let (commands, events) = disturbed(|faults, _| faults.set(fault, true));
        let told = events.iter().find_map(|event| match event {
            Event::Abort { cycle, cause, .. } => Some((*cycle, cause.name())),
            _ => None,
        });
        let (cycle, name) = told.expect("aborted");
        assert_eq!(name, cause, "{fault:?}");
        assert!(cycle <= 4 * 2048 + periods, "{fault:?}: {cycle}");
        let (jerk, last) = smoothness(&commands);
        assert!(jerk < 61.0, "{fault:?}: {jerk} m/s3");
        assert!(last.velocity_m_s.abs() < 1e-9, "{fault:?}: {last:?}");
        assert!(matches!(events.last(), Some(Event::End { ending: Ending::Aborted, .. })), "{fault:?}");
    }
}

#[test]
fn a_shallow_ring_in_virtual_time_still_loses_nothing() {
    let out = tempfile::tempdir().expect("folder");
    let mut plan = plan(out.path(), Pace::Virtual, 1, 4.9, 5.0);
    plan.depths.record = LEAST_ROOM + 10;
    let finished = start(plan).expect("started").wait(|_| {}).expect("ended");
    assert_eq!(finished.manifest.lost.samples, 0);
}
