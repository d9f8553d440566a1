//! `shaketable recover`: closes the folder of a run whose process died, with what is there.

use super::{CliError, Outcome};
use crate::record::RunFolder;
use crate::record::recover::{RecoverError, recover};
use std::path::PathBuf;

/// Close an interrupted run: step results, losses and report from the samples that are there.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Run folder.
    run: PathBuf,
    /// Print one JSON object on standard output.
    #[arg(long)]
    json: bool,
}

/// Runs the subcommand.
///
/// # Errors
/// A run that goes on, or a folder that cannot be read or written.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    let folder = RunFolder::open(&args.run).map_err(CliError::usage)?;
    let recovered = recover(&folder).map_err(|error| match error {
        RecoverError::Running(_) => CliError::usage(error),
        _ => CliError::failed(error),
    })?;
    super::run::write_report(&folder, &recovered.steps);
    let manifest = &recovered.manifest;
    if args.json {
        let object = serde_json::json!({
            "run_dir": folder.path().display().to_string(),
            "outcome": manifest.state,
            "samples": manifest.samples,
            "lost_samples": manifest.lost.samples,
            "steps": recovered.steps,
            "error": recovered.error,
            "damage": recovered.damage,
            "rows_differing": recovered.differing,
            "recovered": manifest.recovered,
        });
        println!("{object}");
        return Ok(Outcome::Done);
    }
    println!("{}: {}", manifest.name, manifest.state.name());
    println!(
        "{} samples ({:.1} s), {} lost before the end, {} finished steps",
        manifest.samples,
        manifest.samples as f64 / manifest.sample_rate_hz,
        manifest.lost.samples,
        recovered.steps.len()
    );
    if let Some(said) = &manifest.recovered {
        println!("{said}");
    }
    println!("run folder: {}", folder.path().display());
    Ok(Outcome::Done)
}
