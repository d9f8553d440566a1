//! `shaketable replay`: plays a record through the whole chain again, into a run folder of its own.

use super::reading::ReadArgs;
use super::{CliError, Outcome};
use crate::config::builtin::find;
use crate::control::recorded::of_record;
use crate::control::session::{self, Finished, Plan};
use crate::control::setup::Setup;
use crate::record::salvage::readable_rows;
use crate::record::{Kind, RunFolder};
use crate::stream::Row;
use crate::sweep::{Generator, SweepSpec};
use std::path::PathBuf;

/// Play a record through filters, model and statistics again.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    read: ReadArgs,
    /// Onboard model, by name or file: of a run in place of the recorded one, needed for a data file.
    #[arg(long)]
    model: Option<String>,
    /// Folder below which the new run folder is made.
    #[arg(long, default_value = "runs")]
    out: PathBuf,
    /// Print one JSON object on standard output.
    #[arg(long)]
    json: bool,
}

/// Runs the subcommand.
///
/// # Errors
/// A record that cannot be read, or a configuration that is refused.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    let (plan, rows, damage) = match args.read.record.is_dir() {
        true => of_run(&args)?,
        false => (of_file(&args)?, Vec::new(), None),
    };
    let started = std::time::Instant::now();
    let session = session::start(plan).map_err(CliError::failed)?;
    let finished = session.wait(|_| {}).map_err(CliError::failed)?;
    super::run::write_report(&finished.folder, &finished.steps);
    let identical = match rows.is_empty() {
        true => None,
        false => Some(same(&rows, &finished)?),
    };
    report(&args, &finished, identical, damage.as_deref(), started.elapsed().as_secs_f64());
    Ok(Outcome::Done)
}

/// A run folder under its own configuration and the commands of then.
fn of_run(args: &Args) -> Result<(Plan, Vec<Row>, Option<String>), CliError> {
    let folder = RunFolder::open(&args.read.record).map_err(CliError::usage)?;
    let recorded = folder.manifest().map_err(CliError::failed)?;
    let (rows, damage) = readable_rows(&folder).map_err(CliError::failed)?;
    let mut setup = Setup::of_run(&recorded).map_err(CliError::failed)?;
    if let Some(model) = &args.model {
        setup.model = super::reading::read_model(model)?;
    }
    setup.name = format!("replay-{}", recorded.name);
    let samples = rows.iter().map(|row| row.sample).collect();
    let command = setup.recorded_command(&rows).map_err(CliError::failed)?;
    let plan = setup.replay_plan(samples, command, &args.out).map_err(CliError::failed)?;
    Ok((plan, rows, damage))
}

/// A data file as if the simulated rig had delivered it.
fn of_file(args: &Args) -> Result<Plan, CliError> {
    let Some(model) = &args.model else {
        return Err(CliError::usage("a data file names no model; give `--model`"));
    };
    let model = super::reading::read_model(model)?;
    let record = args.read.open()?;
    if record.kind != Kind::Base {
        let kind = record.kind.name();
        return Err(CliError::usage(format!(
            "a {kind} record is not from a shaking table and cannot be replayed"
        )));
    }
    let mut rig: crate::rig::RigSpec = find("rigs", "simulated")
        .and_then(|source| source.parse())
        .map_err(|error| CliError::Usage(error.into()))?;
    rig.sample_rate_hz = record.sample_rate_hz;
    let name = args.read.record.file_stem().map_or("record".into(), |stem| stem.to_string_lossy());
    let name = format!("replay-{name}");
    let specimen = model.clone();
    let setup =
        Setup { rig, sweep: SweepSpec::paper(), model, specimen, case: None, safety: None, seed: 0, name };
    let (schedule, mut points, samples) = of_record(&record);
    // A sample stands under the command of the period before.
    let points = points.split_off(points.len().min(1));
    let command = Generator::recorded(&schedule, record.sample_rate_hz, points);
    setup.replay_plan(samples, command, &args.out).map_err(CliError::failed)
}

/// Whether the rows are the recorded ones, bit by bit. How many a full ring had dropped before each is not theirs to
/// repeat, nor is the supervisor's state: nothing moves, so nothing is supervised.
fn same(rows: &[Row], finished: &Finished) -> Result<bool, CliError> {
    let (again, _) = readable_rows(&finished.folder).map_err(CliError::failed)?;
    let rate = finished.manifest.sample_rate_hz;
    let bytes = |row: &Row| {
        let mut bytes = Vec::with_capacity(crate::record::samples::ROW_BYTES);
        crate::record::samples::encode(
            &Row { lost_before: 0, supervisor_state: 0, ..*row },
            rate,
            &mut bytes,
        );
        bytes
    };
    Ok(again.len() == rows.len() && again.iter().zip(rows).all(|(a, b)| bytes(a) == bytes(b)))
}

fn report(args: &Args, finished: &Finished, identical: Option<bool>, damage: Option<&str>, wall_s: f64) {
    if args.json {
        let object = serde_json::json!({
            "run_dir": finished.folder.path().display().to_string(),
            "outcome": finished.ending,
            "samples": finished.manifest.samples,
            "identical": identical,
            "steps": finished.steps,
            "error": finished.model_error,
            "damage": damage,
            "wall_s": wall_s,
        });
        println!("{object}");
        return;
    }
    let bytes = match identical {
        Some(true) => "identical to the record, byte by byte",
        Some(false) => "different from the record",
        None => "played back",
    };
    println!("{} samples in {wall_s:.1} s: {bytes}", finished.manifest.samples);
    println!(
        "model error (NRMSE): A {:.2} %, D {:.2} %",
        100.0 * finished.model_error.nrmse_a,
        100.0 * finished.model_error.nrmse_d
    );
    println!("run folder: {}", finished.folder.path().display());
}
