//! `shaketable replay`: plays a recorded run through the whole chain again, into a run folder of its own.

use super::{CliError, Outcome};
use crate::control::session;
use crate::control::setup::Setup;
use crate::record::RunFolder;
use crate::record::salvage::readable_rows;
use std::path::PathBuf;

/// Play a recorded run through filters, model and detectors again.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Run folder.
    run: PathBuf,
    /// Onboard model, by name or file, in place of the recorded one.
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
/// A folder that cannot be read, or a recorded configuration that is refused.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    let folder = RunFolder::open(&args.run).map_err(CliError::usage)?;
    let recorded = folder.manifest().map_err(CliError::failed)?;
    let (rows, damage) = readable_rows(&folder).map_err(CliError::failed)?;
    let mut setup = Setup::of_run(&recorded).map_err(CliError::failed)?;
    if let Some(model) = &args.model {
        setup.model = super::run::read_model(model)?;
    }
    setup.name = format!("replay-{}", recorded.name);
    let samples = rows.iter().map(|row| row.sample).collect();
    let plan = setup.replay_plan(samples, &args.out).map_err(CliError::failed)?;
    let started = std::time::Instant::now();
    let session = session::start(plan).map_err(CliError::failed)?;
    let finished = session.wait(|_| {}).map_err(CliError::failed)?;
    super::run::write_report(&finished.folder, &finished.steps);
    let wall_s = started.elapsed().as_secs_f64();
    let identical = finished.manifest.samples_sha256 == recorded.samples_sha256;
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
        return Ok(Outcome::Done);
    }
    let bytes = if identical { "identical to the record, byte by byte" } else { "different from the record" };
    println!("{} samples in {wall_s:.1} s: {bytes}", finished.manifest.samples);
    println!(
        "model error (NRMSE): A {:.2} %, D {:.2} %",
        100.0 * finished.model_error.nrmse_a,
        100.0 * finished.model_error.nrmse_d
    );
    println!("run folder: {}", finished.folder.path().display());
    Ok(Outcome::Done)
}
