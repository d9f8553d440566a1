//! The control thread stalls or dies while the table moves: the drive stops by what does not hang on that thread. The
//! plant moves on a thread of its own here, as a real one does.

use crate::bench::setup;
use shaketable::control::Ending;
use shaketable::control::session::{Pace, SessionError, start};
use shaketable::control::setup::Setup;
use shaketable::rig::simulated::SimulatedRig;
use shaketable::rig::{Rig, RigFault, RigSpec};
use shaketable::safety::{DetectorId, SafetySpec, StopLine};
use shaketable::stream::{Command, Sample};
use shaketable::sweep::SweepSpec;
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

const RUN: u8 = 0;
const STALL: u8 = 1;
const DIE: u8 = 2;
const END: u8 = 3;

/// A plant that moves by the clock on the wall, whoever commands it.
#[derive(Clone)]
struct Plant {
    rig: Arc<Mutex<SimulatedRig>>,
    order: Arc<AtomicU8>,
    line: Option<StopLine>,
    delay_s: f64,
}

impl Plant {
    fn rig(&self) -> MutexGuard<'_, SimulatedRig> {
        self.rig.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn order(&self) -> u8 {
        self.order.load(Ordering::Acquire)
    }

    fn give(&self, order: u8) {
        self.order.store(order, Ordering::Release);
    }

    /// Advances with the time that has passed, at most 4 ms at once.
    fn live(&self) {
        let (begin, mut done) = (Instant::now(), 0_u64);
        let mut lost = 0;
        while self.order() != END {
            let due = (begin.elapsed().as_secs_f64() * 2048.0) as u64 - lost;
            let steps = (due - done).min(8);
            // A machine that is busy elsewhere must not make the plant jump ahead of its controller.
            lost += due - done - steps;
            let mut rig = self.rig();
            (0..steps).for_each(|_| rig.advance());
            drop(rig);
            done += steps;
            std::thread::park_timeout(Duration::from_micros(300));
        }
    }

    fn speed_m_s(&self) -> f64 {
        self.rig().true_table_motion().1.abs()
    }
}

impl Rig for Plant {
    fn read(&mut self) -> Result<Option<Sample>, RigFault> {
        while self.order() == STALL {
            std::thread::park_timeout(Duration::from_millis(1));
        }
        assert_ne!(self.order(), DIE, "dies on purpose");
        self.rig().read()
    }
    fn write(&mut self, command: &Command) -> Result<(), RigFault> {
        self.rig().write(command)
    }
    fn quick_stop(&mut self) {
        self.rig().quick_stop();
    }
    fn chain_delay_s(&self) -> f64 {
        self.delay_s
    }
    fn stop_line(&self) -> Option<StopLine> {
        self.line.clone()
    }
}

fn wait_for(what: &str, condition: impl Fn() -> bool) {
    let begin = Instant::now();
    while !condition() {
        assert!(begin.elapsed() < Duration::from_secs(60), "{what}");
        std::thread::park_timeout(Duration::from_millis(1));
    }
}

/// Waits until the table has not moved for a while.
fn wait_for_rest(plant: &Plant) {
    let still_since = std::cell::Cell::new(Instant::now());
    wait_for("the table comes to rest", || {
        if plant.speed_m_s() > 1e-3 {
            still_since.set(Instant::now());
        }
        still_since.get().elapsed() > Duration::from_millis(300)
    });
}

/// Starts a run, lets it move, gives the order, and waits for the table to be at rest.
fn after(order: u8, command_timeout_s: f64, with_line: bool) -> (Plant, Result<Ending, SessionError>) {
    let out = tempfile::tempdir().expect("folder");
    let mut rig = RigSpec::default();
    rig.table.command_timeout_s = command_timeout_s;
    let sweep = SweepSpec::paper().restricted(0.9, 1.1).expect("in range");
    let setup = setup("B1-G2-0.05", rig, sweep, 1);
    let pace = Pace::Wall { cpu: None, require_realtime: false };
    let (mut plan, _faults) = setup.plan(out.path(), pace).expect("fits");
    let rig = setup.simulated_rig().expect("built");
    let (line, delay_s) = (rig.stop_line().filter(|_| with_line), rig.chain_delay_s());
    let plant = Plant { rig: Arc::new(Mutex::new(rig)), order: Arc::default(), line, delay_s };
    plan.rig = Box::new(plant.clone());
    // How late a busy machine wakes the thread, and what that makes of the samples, is not what is tested here.
    let mut spec = SafetySpec::built_in().expect("valid");
    for id in DetectorId::ALL.into_iter().filter(|id| *id != DetectorId::DeviceStatus) {
        spec.row_mut(id).disabled = Some("the machine of this test is busy".into());
    }
    let setup = Setup { safety: Some(spec), ..setup.clone() };
    plan.guard = Some(setup.guard(delay_s).expect("valid"));
    let living = plant.clone();
    let life = std::thread::spawn(move || living.live());
    let session = start(plan).expect("started");
    wait_for("the table moves", || plant.speed_m_s() > 0.02);
    plant.give(order);
    wait_for_rest(&plant);
    if order == STALL {
        // The thread comes back and finds a drive that no longer follows.
        plant.give(RUN);
    }
    let rested_at_m = plant.rig().true_table_motion().0;
    let ended = session.wait(|_| {}).map(|finished| finished.ending);
    let moved_m = (plant.rig().true_table_motion().0 - rested_at_m).abs();
    assert!(moved_m < 1e-3, "moved again by {moved_m} m");
    plant.give(END);
    life.join().expect("the plant");
    (plant, ended)
}

// SR-13
#[test]
fn a_stalled_control_thread_is_noticed_by_the_watchdog() {
    // The drive's own time-out is out of the way.
    let (plant, ended) = after(STALL, 3600.0, true);
    assert!(plant.line.is_some_and(|line| line.is_open()));
    assert_eq!(ended.expect("closed"), Ending::Aborted);
}

// SR-13
#[test]
fn a_dead_control_thread_is_noticed_by_the_watchdog() {
    let (plant, ended) = after(DIE, 3600.0, true);
    assert!(plant.line.is_some_and(|line| line.is_open()));
    assert!(matches!(ended, Err(SessionError::Died("control"))));
}

// SR-13
#[test]
fn without_a_watchdog_the_drive_stops_by_its_own_time_out() {
    let (_, ended) = after(STALL, 0.1, false);
    assert_eq!(ended.expect("closed"), Ending::Aborted);
}
