//! A controller over a simulated rig whose insides stay visible, in virtual time and without a recorder.

use shaketable::config::Case;
use shaketable::control::setup::{Setup, model_of_case};
use shaketable::control::{Controller, Ending, Event, Parts, Request, Tick};
use shaketable::rig::simulated::{FaultSwitches, SimulatedRig};
use shaketable::rig::{Rig, RigFault, RigSpec};
use shaketable::safety::Guard;
use shaketable::stream::{Command, Depths, OperatorEnd, RecorderEnd, Row, Sample, split};
use shaketable::sweep::{Generator, SweepSpec};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The rig in the controller's hands, telling on the side when its drive folds back.
pub struct Shown {
    rig: SimulatedRig,
    folded: Arc<AtomicBool>,
}

impl Rig for Shown {
    fn read(&mut self) -> Result<Option<Sample>, RigFault> {
        self.rig.read()
    }
    fn write(&mut self, command: &Command) -> Result<(), RigFault> {
        self.rig.write(command)
    }
    fn quick_stop(&mut self) {
        self.rig.quick_stop();
    }
    fn advance(&mut self) {
        self.rig.advance();
        if self.rig.folded() {
            self.folded.store(true, Ordering::Relaxed);
        }
    }
    fn chain_delay_s(&self) -> f64 {
        self.rig.chain_delay_s()
    }
}

/// A run as its pieces.
pub struct Bench {
    pub controller: Controller,
    pub faults: FaultSwitches,
    pub operator: OperatorEnd<Request>,
    pub events: Vec<Event>,
    pub rows: u64,
    pub cycle: u64,
    folded: Arc<AtomicBool>,
    recorder: RecorderEnd<Event>,
    taken: Vec<Row>,
}

/// What a run is asked to be.
pub fn setup(case: &str, rig: RigSpec, sweep: SweepSpec, seed: u64) -> Setup {
    let case: Case = case.parse().expect("a case");
    let model = model_of_case(&case);
    let sweep = SweepSpec { acceleration_g: case.acceleration_g, ..sweep };
    Setup {
        rig,
        sweep,
        specimen: model.clone(),
        model,
        case: Some(case),
        safety: None,
        seed,
        name: "safety".into(),
    }
}

impl Bench {
    /// Ready for its first period; `prepare` may move the rig before, `guard` may change what watches it.
    pub fn new(setup: &Setup, prepare: impl Fn(&mut SimulatedRig), guard: impl Fn(Guard) -> Guard) -> Self {
        let mut rig = setup.simulated_rig().expect("built");
        prepare(&mut rig);
        let rate = setup.rig.sample_rate_hz;
        let guard = guard(setup.guard(rig.chain_delay_s()).expect("valid"));
        let (end, recorder, _view, operator) = split::<Event, Request>(Depths::for_rate(rate));
        let (faults, folded) = (rig.faults(), Arc::new(AtomicBool::new(false)));
        let parts = Parts {
            rig: Box::new(Shown { rig, folded: folded.clone() }),
            generator: Generator::new(&setup.schedule().expect("schedule"), rate),
            model: setup.onboard().expect("model"),
            guard: Some(guard),
            end,
            sample_rate_hz: rate,
        };
        Self {
            controller: Controller::new(parts),
            faults,
            operator,
            events: Vec::new(),
            rows: 0,
            cycle: 0,
            folded,
            recorder,
            taken: Vec::with_capacity(8192),
        }
    }

    /// One control period; how the run ended, once it has.
    pub fn step(&mut self) -> Option<Ending> {
        self.step_after(1)
    }

    /// The same after so many periods, all but the last of which went by without the control thread.
    pub fn step_after(&mut self, periods: u64) -> Option<Ending> {
        let latency_ns = (periods - 1) * 488_281;
        let ending = self.controller.step(Tick { periods, latency_ns, ..Tick::default() });
        self.cycle += 1;
        if self.cycle.is_multiple_of(512) || periods > 1 || ending.is_some() {
            self.drain();
        }
        ending
    }

    /// Empties the rings.
    pub fn drain(&mut self) {
        self.taken.clear();
        self.rows += self.recorder.take_rows(&mut self.taken) as u64;
        while let Some(event) = self.recorder.take_event() {
            if !matches!(event, Event::Live { .. }) {
                self.events.push(event);
            }
        }
    }

    /// Whether the drive has ever folded back.
    pub fn folded(&self) -> bool {
        self.folded.load(Ordering::Relaxed)
    }
}

/// Lets as many workers as there are processors, or as `WORKERS` says, do the jobs; results in order.
pub fn in_parallel<J: Sync, R: Send>(jobs: &[J], work: impl Fn(&J) -> R + Sync) -> Vec<R> {
    let asked = std::env::var("WORKERS").ok().and_then(|n| n.parse().ok());
    shaketable::parallel::map(jobs, asked.unwrap_or_else(shaketable::parallel::cores), work)
}
