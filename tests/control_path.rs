//! The control step neither allocates, frees, locks nor logs once it runs: not in normal periods, not in
//! an overrun, not under faults of the rig, not while it stops.

use assert_no_alloc::{AllocDisabler, assert_no_alloc};
use shaketable::control::session::Pace;
use shaketable::control::setup::{Setup, model_of_case};
use shaketable::control::{Controller, Ending, Event, Parts, Request, Tick};
use shaketable::rig::RigSpec;
use shaketable::rig::simulated::{Channel, Fault, FaultSwitches};
use shaketable::stream::{Depths, OperatorEnd, RecorderEnd, split};
use shaketable::sweep::SweepSpec;
use std::sync::atomic::{AtomicU64, Ordering};

/// Ends the process on any allocation or release within `assert_no_alloc`.
#[global_allocator]
static GUARD: AllocDisabler = AllocDisabler;

static LOGGED: AtomicU64 = AtomicU64::new(0);

/// Counts whatever is logged.
struct CountingLog;

impl tracing::Subscriber for CountingLog {
    fn enabled(&self, _: &tracing::Metadata<'_>) -> bool {
        true
    }
    fn new_span(&self, _: &tracing::span::Attributes<'_>) -> tracing::span::Id {
        LOGGED.fetch_add(1, Ordering::Relaxed);
        tracing::span::Id::from_u64(1)
    }
    fn record(&self, _: &tracing::span::Id, _: &tracing::span::Record<'_>) {}
    fn record_follows_from(&self, _: &tracing::span::Id, _: &tracing::span::Id) {}
    fn event(&self, _: &tracing::Event<'_>) {
        LOGGED.fetch_add(1, Ordering::Relaxed);
    }
    fn enter(&self, _: &tracing::span::Id) {}
    fn exit(&self, _: &tracing::span::Id) {}
}

struct Bench {
    controller: Controller,
    recorder: RecorderEnd<Event>,
    operator: OperatorEnd<Request>,
    faults: FaultSwitches,
    rows: Vec<shaketable::stream::Row>,
}

fn bench(case: &str, low_hz: f64, high_hz: f64, depths: Depths) -> Bench {
    let case = case.parse().expect("a case");
    let mut sweep = SweepSpec::paper().restricted(low_hz, high_hz).expect("in range");
    sweep.acceleration_g = 0.05;
    let model = model_of_case(&case);
    let setup = Setup {
        rig: RigSpec::default(),
        sweep,
        specimen: model.clone(),
        model,
        case: Some(case),
        safety: None,
        seed: 1,
        name: "guard".into(),
    };
    let (plan, faults) = setup.plan(std::path::Path::new("unused"), Pace::Virtual).expect("fits");
    let (end, recorder, _view, operator) = split::<Event, Request>(depths);
    let controller = Controller::new(Parts {
        rig: plan.rig,
        generator: plan.generator,
        model: plan.model,
        guard: plan.guard,
        end,
        sample_rate_hz: setup.rig.sample_rate_hz,
    });
    Bench { controller, recorder, operator, faults, rows: Vec::with_capacity(16384) }
}

impl Bench {
    /// So many control periods under the guard; returns how the run ended, if it did.
    fn run(&mut self, periods: u64) -> Option<Ending> {
        let mut ending = None;
        for _ in 0..periods {
            ending = assert_no_alloc(|| self.controller.step(Tick { periods: 1, ..Tick::default() }));
            self.rows.clear();
            self.recorder.take_rows(&mut self.rows);
            while self.recorder.take_event().is_some() {}
            if ending.is_some() {
                break;
            }
        }
        ending
    }

    fn overrun(&mut self, periods: u64) -> usize {
        let tick = Tick {
            periods,
            latency_ns: periods * 488_281,
            period_error_ns: Some(1),
            overslept_by_work: true,
        };
        assert_no_alloc(|| self.controller.step(tick));
        self.rows.clear();
        self.recorder.take_rows(&mut self.rows)
    }
}

// SR-16
#[test]
fn nothing_allocates_locks_or_logs_once_the_run_has_begun() {
    tracing::subscriber::set_global_default(CountingLog).expect("the first subscriber");
    let mut bench = bench("B1-G2-0.05", 3.0, 3.2, Depths::default());
    // A whole small sweep, ramps and transitions included, with overruns in it.
    assert_eq!(bench.run(5000), None);
    assert_eq!(bench.overrun(50), 50);
    bench.operator.ask(Request::Hold).expect("room");
    assert_eq!(bench.run(2000), None);
    bench.operator.ask(Request::Resume).expect("room");
    assert_eq!(bench.run(1_000_000), Some(Ending::Done));
    assert_eq!(LOGGED.load(Ordering::Relaxed), 0);
}

#[test]
fn nothing_allocates_under_faults_of_the_rig() {
    for fault in [
        Fault::FrozenFeedback,
        Fault::Dropout,
        Fault::LateBurst,
        Fault::RepeatedSample,
        Fault::NotANumber(Channel::RelativeDisplacement),
        Fault::Stuck(Channel::MassAcceleration1),
        Fault::Swapped(Channel::TableAcceleration, Channel::MassAcceleration1),
        Fault::BusOff,
        Fault::SerialGarbage,
        Fault::DriveTrip,
    ] {
        let mut bench = bench("B4-G1-0.05", 1.0, 1.2, Depths::default());
        bench.run(6000);
        bench.faults.set(fault, true);
        bench.run(6000);
    }
}

#[test]
fn nothing_allocates_when_every_ring_is_full() {
    let depths = Depths { record: 8, live: 8, events: 1, requests: 1 };
    let mut bench = bench("B1-G2-0.05", 3.0, 3.2, depths);
    for _ in 0..3000 {
        assert_no_alloc(|| bench.controller.step(Tick { periods: 1, ..Tick::default() }));
    }
    assert_eq!(bench.recorder.losses().record, 3000 - 8);
}

#[test]
fn nothing_allocates_in_an_overrun_that_aborts() {
    let mut bench = bench("B1-G2-0.05", 3.0, 3.2, Depths::default());
    assert_eq!(bench.run(5000), None);
    assert_eq!(bench.overrun(3000), 3000);
    assert_eq!(bench.run(20_000), Some(Ending::Aborted));
}

#[test]
fn nothing_allocates_in_a_stop() {
    let mut bench = bench("B1-G2-0.05", 3.0, 3.2, Depths::default());
    bench.run(6000);
    bench.operator.ask(Request::Stop).expect("room");
    assert_eq!(bench.run(20_000), Some(Ending::Stopped));
}

/// Run by the test below in a process of its own.
#[test]
#[ignore = "ends its process on purpose"]
fn an_allocation_under_the_guard() {
    assert_no_alloc(|| drop(std::hint::black_box(vec![0u8; 64])));
}

#[test]
fn the_guard_sees_an_allocation() {
    let child = std::process::Command::new(std::env::current_exe().expect("this test"))
        .args(["--exact", "an_allocation_under_the_guard", "--ignored"])
        .output()
        .expect("runs");
    assert!(!child.status.success(), "an allocation went unseen");
}

/// What the guard cannot see: a lock that is free costs no allocation. The sources of the control path
/// must not name one.
#[test]
fn the_sources_of_the_control_path_name_no_lock_and_no_log() {
    let files = [
        "src/control/step.rs",
        "src/control/chain.rs",
        "src/control/reference.rs",
        "src/control/event.rs",
        "src/stream/ring.rs",
        "src/rig/simulated/mod.rs",
        "src/rig/simulated/actuator.rs",
        "src/rig/simulated/sensors.rs",
        "src/rig/simulated/faults.rs",
        "src/sweep/generator.rs",
        "src/signal/analyzer.rs",
        "src/signal/butterworth.rs",
        "src/signal/low_pass.rs",
        "src/safety/context.rs",
        "src/safety/guard.rs",
        "src/safety/judge.rs",
        "src/safety/stop.rs",
        "src/safety/supervisor.rs",
        "src/safety/watch.rs",
    ];
    for file in files {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
        let text = std::fs::read_to_string(&path).expect("a source");
        for word in
            ["Mutex", "RwLock", "Condvar", "OnceLock", ".lock()", "println!", "tracing::", "log::", "sleep("]
        {
            assert!(!text.contains(word), "{file} names {word}");
        }
    }
}
