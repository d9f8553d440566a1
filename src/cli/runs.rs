//! `shaketable runs`: lists the run folders there are, shows one, or checks its hash chain.

#[cfg(feature = "parquet")]
mod query;

use super::{CliError, Outcome};
use crate::record::folder::list;
use crate::record::verify::{Verdict, verify};
use crate::record::{RunFolder, RunState};
use std::path::PathBuf;

/// List recorded runs, or check one.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: Option<What>,
    /// Folder in which the run folders are.
    #[arg(long, default_value = "runs", global = true)]
    out: PathBuf,
    /// Print one JSON object on standard output.
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// List the runs (the default).
    List,
    /// Check the samples of a run against its hash chain.
    Verify {
        /// Run folder.
        run: PathBuf,
    },
    /// Ask a tree of exported runs for steps or peaks.
    #[cfg(feature = "parquet")]
    Query(query::Args),
}

/// Runs the subcommand.
///
/// # Errors
/// A folder that cannot be read, or samples that differ from their hashes.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    match &args.what {
        None | Some(What::List) => list_runs(&args),
        Some(What::Verify { run }) => verify_run(run, args.json),
        #[cfg(feature = "parquet")]
        Some(What::Query(query)) => query::execute(query, args.json),
    }
}

fn list_runs(args: &Args) -> Result<Outcome, CliError> {
    let runs = list(&args.out).map_err(CliError::failed)?;
    if args.json {
        let entries: Vec<_> = runs
            .iter()
            .map(|(path, read)| match read {
                Ok((manifest, state)) => serde_json::json!({
                    "run_dir": path.display().to_string(), "name": manifest.name, "state": state,
                    "clean": manifest.clean, "started_utc": manifest.started_utc,
                    "samples": manifest.samples, "lost_samples": manifest.lost.samples, "case": manifest.case,
                }),
                Err(error) => serde_json::json!({
                    "run_dir": path.display().to_string(), "unreadable": error.to_string(),
                }),
            })
            .collect();
        println!("{}", serde_json::json!({ "runs": entries }));
        return Ok(Outcome::Done);
    }
    println!("{:<25} {:<12} {:>9} {:>6}  {:<16} folder", "started (UTC)", "state", "samples", "lost", "name");
    for (path, read) in &runs {
        match read {
            Ok((manifest, state)) => {
                let mark = if *state == RunState::Done && !manifest.clean { " (not clean)" } else { "" };
                println!(
                    "{:<25} {:<12} {:>9} {:>6}  {:<16} {}{mark}",
                    manifest.started_utc,
                    state.name(),
                    manifest.samples,
                    manifest.lost.samples,
                    manifest.name,
                    path.display()
                );
            }
            Err(error) => println!("{:<25} {:<12} {error}", "", "unreadable"),
        }
    }
    Ok(Outcome::Done)
}

fn verify_run(run: &std::path::Path, json: bool) -> Result<Outcome, CliError> {
    let folder = RunFolder::open(run).map_err(CliError::usage)?;
    let verdict = verify(&folder).map_err(CliError::failed)?;
    if json {
        println!("{}", serde_json::to_string(&verdict).map_err(CliError::failed)?);
    }
    let Verdict { rows, rows_verified, rows_unlinked, .. } = verdict;
    if verdict.intact {
        if !json {
            println!("{rows_verified} rows agree with their hashes");
        }
        if rows_unlinked > 0 {
            eprintln!(
                "the last {rows_unlinked} rows of this interrupted run have no hash yet; \
                 `shaketable recover` closes it"
            );
        }
        return Ok(Outcome::Done);
    }
    let mut wrong = Vec::new();
    for (first, end) in &verdict.broken {
        wrong.push(format!("rows {first} to {} differ from what was written", end - 1));
    }
    if verdict.rows_missing > 0 {
        wrong.push(format!("{} rows are missing at the end", verdict.rows_missing));
    }
    if verdict.events_intact == Some(false) {
        wrong.push("events.jsonl differs from what was written".to_owned());
    }
    wrong.extend(verdict.damage);
    if wrong.is_empty() {
        wrong.push("integrity.txt and run.toml do not belong together".to_owned());
    }
    Err(CliError::failed(format!(
        "{}: {rows_verified} of {rows} rows agree with their hashes; {}",
        run.display(),
        wrong.join("; ")
    )))
}
