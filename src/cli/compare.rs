//! `compare`: where a model fails against a record.

use super::reading::{ReadArgs, say_new};
use super::{CliError, Outcome};
use crate::compare::{Comparison, compare};
use crate::record::quality;
use crate::report::Table;
use crate::report::comparison::{method, page, tables};
use std::path::PathBuf;

/// Compare a record with a model: by step, regime, phase and amplitude, against the noise floor.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    record: ReadArgs,
    /// Model file, or the name of a built-in model
    #[arg(long)]
    model: String,
    /// Write a page with all figures: curves, loops, phase portraits, residual force
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Print one JSON object on standard output
    #[arg(long)]
    json: bool,
}

/// Runs it.
///
/// # Errors
/// [`CliError`] for a bad model file, a record that cannot be read or lacks what its kind needs.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    let spec = super::reading::read_model(&args.model)?;
    let record = args.record.open()?;
    let comparison = compare(&record, &spec).map_err(|error| {
        // A bad record is named as such even where it cannot be compared.
        let findings = quality::examine(&record);
        let texts: Vec<String> = findings.into_iter().map(|finding| finding.text).collect();
        CliError::failed(format!("{error}{}{}", if texts.is_empty() { "" } else { "; " }, texts.join("; ")))
    })?;
    if let Some(path) = &args.report {
        page(&comparison).and_then(|page| page.write(path)).map_err(CliError::failed)?;
        eprintln!("report: {}", path.display());
    }
    if args.json {
        println!("{}", serde_json::to_string(&comparison).map_err(CliError::failed)?);
    } else {
        print!("{}", text(&comparison));
    }
    say_new(&comparison.notes, &record);
    Ok(Outcome::Done)
}

/// The comparison as tables.
fn text(comparison: &Comparison) -> String {
    let mut out = format!("{} against model {}\n", comparison.record, comparison.model);
    out.push_str(&format!("{}\n", method(comparison)));
    for finding in &comparison.quality {
        let channel = finding.channel.map(|channel| format!(", {channel}")).unwrap_or_default();
        out.push_str(&format!("the record ({:?}{channel}): {}\n", finding.severity, finding.text));
    }
    let mut add = |table: &Table| {
        if !table.is_empty() {
            out.push('\n');
            out.push_str(&table.text());
        }
    };
    add(&tables::summary(comparison));
    add(&tables::steps(comparison));
    tables::groups(comparison).iter().for_each(|(_, table)| add(table));
    // Last, where a terminal shows it.
    out.push_str(&format!("\n{}\n", comparison.sentence));
    out
}
