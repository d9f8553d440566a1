//! `export`: a record into the file formats of other tools; what is wrong with it is said on the way.

use super::reading::ReadArgs;
use super::{CliError, Outcome};
use crate::record::data::{self, Format};
use crate::record::quality;
use std::path::PathBuf;

/// Write a record as Parquet, CSV, HDF5, MAT v7.3 or UFF58.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    read: ReadArgs,
    /// File to write; its name tells the format
    #[cfg_attr(feature = "parquet", arg(short, long, required_unless_present = "tree"))]
    #[cfg_attr(not(feature = "parquet"), arg(short, long, required = true))]
    output: Option<PathBuf>,
    /// Add a run folder to a tree of Parquet files partitioned by date and case
    #[cfg(feature = "parquet")]
    #[arg(long, conflicts_with_all = ["output", "format", "force", "map", "columns", "kind", "rate"])]
    tree: Option<PathBuf>,
    /// Format, where the name does not tell it
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Replace an existing file
    #[arg(long)]
    force: bool,
    /// Print what was written as JSON
    #[arg(long)]
    json: bool,
}

/// Reads, writes, reports.
///
/// # Errors
/// [`CliError::Usage`] when the format is unknown or the file exists, [`CliError::Failed`] otherwise.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    #[cfg(feature = "parquet")]
    if let Some(tree) = &args.tree {
        return add_to_tree(&args, tree);
    }
    let output = args.output.clone().unwrap_or_default();
    let format = args.format.or_else(|| Format::of_name(&output)).ok_or_else(|| {
        CliError::usage(format!("{}: the name tells no format; give `--format`", output.display()))
    })?;
    if output.exists() && !args.force {
        return Err(CliError::usage(format!("{} exists; `--force` replaces it", output.display())));
    }
    let record = args.read.open()?;
    let findings = quality::examine(&record);
    for finding in &findings {
        eprintln!("{:?}: {}", finding.severity, finding.text);
    }
    data::write(&record, &output, format).map_err(CliError::failed)?;
    let channels: Vec<&str> = record.channels().map(|(role, _)| role.name()).collect();
    if args.json {
        let said = serde_json::json!({
            "output": output,
            "kind": record.kind,
            "samples": record.len(),
            "sample_rate_hz": record.sample_rate_hz,
            "channels": channels,
            "steps": record.step_ranges().len(),
            "notes": record.notes,
            "findings": findings,
        });
        println!("{said}");
    } else {
        println!(
            "{}: {} samples at {} Hz, {} steps, channels {}",
            output.display(),
            record.len(),
            record.sample_rate_hz,
            record.step_ranges().len(),
            channels.join(", ")
        );
    }
    Ok(Outcome::Done)
}

#[cfg(feature = "parquet")]
fn add_to_tree(args: &Args, tree: &std::path::Path) -> Result<Outcome, CliError> {
    if !args.read.record.join("run.toml").is_file() {
        return Err(CliError::usage(format!(
            "{}: only run folders have a date and a case; import a data file with `-o`",
            args.read.record.display()
        )));
    }
    let samples = data::add_run(&args.read.record, tree).map_err(CliError::failed)?;
    if args.json {
        println!("{}", serde_json::json!({ "samples": samples }));
    } else {
        println!("{}", samples.display());
    }
    Ok(Outcome::Done)
}
