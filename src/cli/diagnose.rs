//! `shaketable diagnose`: what is missing from the model, and the next test.

use super::fitted::{failed, refuse_existing, write_model};
use super::reading::ReadingArgs;
use super::{CliError, Outcome, parts};
use crate::diagnose::live::evidence;
use crate::diagnose::{Options, diagnose_together};
use crate::model::{ModelSpec, effects};
use crate::record::Record;
use crate::report::diagnosis::page;
use std::path::PathBuf;

/// Find out which physical effect a model lacks, from one record or several of the same specimen.
#[derive(clap::Args)]
pub struct Args {
    /// Run folders or data files (Parquet, CSV, HDF5, MAT v7.3, UFF58) of one specimen
    #[arg(required = true, value_name = "RECORD")]
    records: Vec<PathBuf>,
    #[command(flatten)]
    reading: ReadingArgs,
    /// Model file, or the name of a model that comes with the program; once for all records, or once for each,
    /// where gap or bumpers were changed between them (the first with bumpers).
    #[arg(long, required = true)]
    model: Vec<String>,
    /// Only what each candidate adds, from the force along the measured motion: seconds and no verdict. For a run that still
    /// goes on; works at low priority.
    #[arg(long, conflicts_with = "report")]
    evidence: bool,
    /// Diagnose a record that is too short, saturated, of wrong sign or unit, ... all the same. Its faults are told as notes.
    #[arg(long)]
    anyway: bool,
    /// Do not try this effect, of which you know that it is not there; may be given several times.
    #[arg(long, value_name = "EFFECT", conflicts_with = "evidence")]
    without: Vec<String>,
    /// Write the model that was found: re-identified, with what is named, or with the drafted force.
    #[arg(short, long, value_name = "NEW.toml", conflicts_with = "evidence")]
    output: Option<PathBuf>,
    /// Replace the model file that is there.
    #[arg(long, requires = "output")]
    force: bool,
    /// Write a page with the error ladder, all tables and the shape of the missing force.
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// Diagnoses.
///
/// # Errors
/// A record or model that cannot be read, or does not go together.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    if args.model.len() != 1 && args.model.len() != args.records.len() {
        return Err(CliError::usage(format!(
            "{} models for {} records; give one for all, or one for each",
            args.model.len(),
            args.records.len()
        )));
    }
    if let Some(output) = &args.output {
        refuse_existing(output, args.force)?;
    }
    let names = args.records.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ");
    let models: Vec<ModelSpec> =
        args.model.iter().map(|name| super::reading::read_model(name)).collect::<Result<_, _>>()?;
    let open = |path: PathBuf| args.reading.clone().of(path).open();
    let records: Vec<Record> = args.records.into_iter().map(open).collect::<Result<_, _>>()?;
    if args.evidence {
        return show_evidence(&records, &models, args.json);
    }
    let tests: Vec<(&Record, &ModelSpec)> = records.iter().zip(models.iter().cycle()).collect();
    let known = |name: &String| effects::find(name).map(|effect| effect.name).map_err(CliError::usage);
    let without = args.without.iter().map(known).collect::<Result<_, _>>()?;
    let options = Options { anyway: args.anyway, without, ..Options::default() };
    let answer = parts::shown(|| diagnose_together(&tests, &options)).map_err(failed)?;
    if let Some(path) = &args.output {
        write_model(&answer.model, path)?;
    }
    if let Some(path) = &args.report {
        let title = format!("What is missing: {names} against {}", models[0].name);
        page(&title, &answer).and_then(|page| page.write(path)).map_err(CliError::failed)?;
        eprintln!("report: {}", path.display());
    }
    if args.json {
        let text = serde_json::to_string(&answer).map_err(CliError::failed)?;
        println!("{text}");
    } else {
        print!("{}", answer.text());
    }
    Ok(Outcome::Done)
}

/// Evidence of one record.
fn show_evidence(records: &[Record], models: &[ModelSpec], json: bool) -> Result<Outcome, CliError> {
    let ([record], [model]) = (records, models) else {
        return Err(CliError::usage("--evidence takes one record and one model"));
    };
    // Beside a moving table; without the right to step back it works all the same.
    let _ = rustix::process::nice(10);
    let found = evidence(record, model).map_err(CliError::failed)?;
    if json {
        println!("{}", serde_json::to_string(&found).map_err(CliError::failed)?);
    } else {
        println!("after {} steps:", found.steps);
        for candidate in &found.candidates {
            println!("{:<24} {:>+9.1} nats", candidate.name, candidate.evidence_nats);
        }
        if found.candidates.is_empty() {
            println!("{}", found.line());
        }
    }
    Ok(Outcome::Done)
}
