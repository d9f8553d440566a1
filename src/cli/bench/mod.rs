//! `shaketable bench`: how long a control step takes, how late the control thread wakes beside
//! `cyclictest`, and the highest rate at which it keeps up.

mod compare;
mod cyclictest;
mod diagnose;
mod model;
mod wall;

use super::{CliError, Outcome};
use crate::config::Case;
use crate::control::clock::Clock as _;
use crate::control::setup::{Setup, model_of_case};
use crate::control::{Controller, Event, Parts, Request, TimingReport, VirtualClock};
use crate::rig::RigSpec;
use crate::stream::{Depths, split};
use crate::sweep::{SweepDirection, SweepSpec};

/// The model whose sweep is timed: the paper's, B1-G2.
const PAPERS_MODEL: &str = "andreaus-2020-b1-g2";

/// Measure what this machine gets: control thread, model, comparison, diagnosis.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
    /// Print one JSON object on standard output.
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// The specimen model: a sweep with histories, with peaks only, sampled input, the general solver.
    Model,
    /// A comparison of a whole sweep and its parts.
    Compare,
    /// A diagnosis of a whole sweep through the whole catalogue and its parts.
    Diagnose(diagnose::DiagnoseArgs),
    /// Time of one control step with filters, model, detectors and demodulation on.
    Control {
        /// Control steps that are timed.
        #[arg(long, default_value_t = 400_000)]
        steps: u64,
        /// Case whose specimen and onboard model are stepped.
        #[arg(long, default_value = "B1-G2-0.05")]
        case: Case,
    },
    /// Wake-up latency in wall time beside that of `cyclictest` at the same interval and priority.
    Latency {
        #[command(flatten)]
        wall: wall::WallArgs,
        /// Control rate, Hz.
        #[arg(long, default_value_t = 2048.0)]
        rate: f64,
    },
    /// Slips at rising rates, beside those of `cyclictest` at the same interval.
    Rate {
        #[command(flatten)]
        wall: wall::WallArgs,
        /// Control rates, Hz.
        #[arg(long, value_delimiter = ',', default_value = "2048,4096,8192,12000,16000,20000")]
        rates: Vec<f64>,
    },
}

/// Runs the subcommand.
///
/// # Errors
/// A run that cannot be set up.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    match &args.what {
        What::Model => model::execute(args.json),
        What::Compare => compare::execute(args.json),
        What::Diagnose(what) => diagnose::execute(what, args.json),
        What::Control { steps, case } => control(*steps, case, args.json),
        What::Latency { wall, rate } => wall::latency(wall, *rate, args.json),
        What::Rate { wall, rates } => wall::rates(wall, rates, args.json),
    }
}

/// Rate to which the simulation of the rig is refined at least, Hz.
const SIMULATION_RATE_HZ: f64 = 8192.0;

/// A dwell of `seconds` on the simulated rig at a rate.
fn dwell(case: &Case, rate_hz: f64, seconds: f64) -> Setup {
    let mut rig = RigSpec { sample_rate_hz: rate_hz, ..RigSpec::default() };
    rig.table.substeps = (SIMULATION_RATE_HZ / rate_hz).ceil().max(1.0) as u32;
    let frequency_hz = 2.0;
    let mut sweep = SweepSpec::paper();
    (sweep.start_hz, sweep.stop_hz, sweep.step_hz) = (None, None, None);
    sweep.dwell_hz = Some(frequency_hz);
    sweep.direction = SweepDirection::Forward;
    sweep.cycles = (frequency_hz * seconds).ceil().max(1.0) as u32;
    sweep.acceleration_g = case.acceleration_g;
    let model = model_of_case(case);
    Setup {
        rig,
        sweep,
        specimen: model.clone(),
        model,
        case: Some(*case),
        safety: None,
        seed: 1,
        name: "bench".to_owned(),
    }
}

/// Steps a controller in virtual time and gives its timing.
fn step_times(setup: &Setup, steps: u64) -> Result<TimingReport, CliError> {
    let (plan, _faults) = setup
        .plan(std::path::Path::new("."), crate::control::session::Pace::Virtual)
        .map_err(CliError::usage)?;
    let (end, mut recorder, _view, _operator) = split::<Event, Request>(Depths::default());
    let mut controller = Controller::new(Parts {
        rig: plan.rig,
        generator: plan.generator,
        model: plan.model,
        guard: plan.guard,
        end,
        sample_rate_hz: setup.rig.sample_rate_hz,
    });
    let (mut clock, mut rows) = (VirtualClock, Vec::with_capacity(4096));
    for _ in 0..steps {
        controller.step(clock.tick());
        rows.clear();
        recorder.take_rows(&mut rows);
        while recorder.take_event().is_some() {}
    }
    Ok(controller.timing())
}

fn control(steps: u64, case: &Case, json: bool) -> Result<Outcome, CliError> {
    let rate_hz = crate::units::SAMPLE_RATE_HZ;
    let setup = dwell(case, rate_hz, steps as f64 / rate_hz);
    let timing = step_times(&setup, steps)?;
    if json {
        println!("{}", serde_json::to_string(&timing).map_err(CliError::failed)?);
        return Ok(Outcome::Done);
    }
    println!("{:<12} {:>9} {:>9} {:>9} {:>10}", "us", "p50", "p99", "p99.9", "mean");
    let line = |name: &str, p: &crate::control::Percentiles| {
        println!("{name:<12} {:>9.3} {:>9.3} {:>9.3} {:>10.3}", p.p50_us, p.p99_us, p.p999_us, p.mean_us);
    };
    for phase in &timing.phases {
        line(phase.phase.name(), &phase.times);
    }
    line("step", &timing.step);
    println!(
        "(the step without `simulate`, which a real rig does not need; each phase includes one reading of the clock)"
    );
    Ok(Outcome::Done)
}
