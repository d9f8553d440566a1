//! `compare`: where a model fails against a record.

use super::reading::ReadArgs;
use super::{CliError, Outcome};
use crate::compare::{Comparison, Method, Slice, compare};
use crate::config::builtin;
use crate::model::ModelSpec;
use crate::record::quality;
use std::fmt::Write;

/// Compare a record with a model: by step, regime, phase and amplitude, against the noise floor.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    record: ReadArgs,
    /// Model file, or the name of a built-in model
    #[arg(long)]
    model: String,
    /// Print one JSON object on standard output
    #[arg(long)]
    json: bool,
}

/// Runs it.
///
/// # Errors
/// [`CliError`] for a bad model file, a record that cannot be read or lacks what its kind needs.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    let source = builtin::find("models", &args.model).map_err(|error| CliError::Usage(error.into()))?;
    let spec: ModelSpec = source.parse().map_err(|error| CliError::Usage(error.into()))?;
    let record = args.record.open()?;
    let comparison = compare(&record, &spec).map_err(|error| {
        // A bad record is named as such even where it cannot be compared.
        let findings = quality::examine(&record);
        let texts: Vec<String> = findings.into_iter().map(|finding| finding.text).collect();
        CliError::failed(format!("{error}{}{}", if texts.is_empty() { "" } else { "; " }, texts.join("; ")))
    })?;
    if args.json {
        println!("{}", serde_json::to_string(&comparison).map_err(CliError::failed)?);
    } else {
        print!("{}", text(&comparison).map_err(CliError::failed)?);
    }
    for note in comparison.notes.iter().filter(|note| !record.notes.contains(note)) {
        eprintln!("note: {note}");
    }
    Ok(Outcome::Done)
}

fn number(x: Option<f64>) -> String {
    x.map_or_else(|| "-".to_owned(), |x| format!("{x:.4}"))
}

fn percent(x: Option<f64>) -> String {
    x.map_or_else(|| "-".to_owned(), |x| format!("{:.1}", 100.0 * x))
}

/// The comparison as tables.
fn text(comparison: &Comparison) -> Result<String, std::fmt::Error> {
    let mut out = String::new();
    let error = &comparison.error;
    writeln!(out, "{} against model {}", comparison.record, comparison.model)?;
    match comparison.method {
        Method::FromRest => writeln!(out, "simulated from rest")?,
        Method::WarmStart { from_s } => {
            writeln!(out, "simulated from the measured motion at {from_s:.3} s on")?
        }
        Method::ShortHorizons { horizon_s } => writeln!(out, "simulated over horizons of {horizon_s:.4} s")?,
        Method::Imposed => writeln!(out, "measured motion imposed, force compared")?,
    }
    if let Some([low, high]) = comparison.band_hz {
        writeln!(out, "both sides band-passed {low:.3}-{high:.1} Hz")?;
    }
    for finding in &comparison.quality {
        let channel = finding.channel.map(|channel| format!(", {channel}")).unwrap_or_default();
        writeln!(out, "the record ({:?}{channel}): {}", finding.severity, finding.text)?;
    }
    writeln!(out, "\n{:<22}{:>10}{:>14}", "", "NRMSE", "noise floor")?;
    if error.nrmse_force.is_some() {
        writeln!(out, "{:<22}{:>10}{:>14}", "force", number(error.nrmse_force), number(error.noise_floor_a))?;
    } else {
        writeln!(out, "{:<22}{:>10}{:>14}", "A", number(error.nrmse_a), number(error.noise_floor_a))?;
        writeln!(out, "{:<22}{:>10}{:>14}", "D", number(error.nrmse_d), number(error.noise_floor_d))?;
    }
    writeln!(out, "\n{}", comparison.sentence)?;
    steps(&mut out, comparison)?;
    for (title, slices) in [
        ("regime", &comparison.regimes),
        ("direction", &comparison.directions),
        ("phase of the cycle", &comparison.phases),
        ("amplitude", &comparison.amplitudes),
        ("time", &comparison.times),
    ] {
        table(&mut out, title, slices)?;
    }
    Ok(out)
}

fn steps(out: &mut String, comparison: &Comparison) -> std::fmt::Result {
    if comparison.steps.is_empty() {
        return Ok(());
    }
    writeln!(
        out,
        "\n{:>5} {:<9}{:>9}{:>9}{:>9}{:>10}{:>10}{:>10}{:>10}{:>10}",
        "step", "way", "Hz", "nrmse A", "nrmse D", "A m/s2", "model", "E mm", "model", "force N"
    )?;
    for step in &comparison.steps {
        let way = match step.direction {
            Some(crate::sweep::Direction::Forward) => "forward",
            Some(crate::sweep::Direction::Backward) => "backward",
            None => "-",
        };
        let milli = |x: Option<f64>| x.map_or_else(|| "-".to_owned(), |x| format!("{:.4}", 1e3 * x));
        writeln!(
            out,
            "{:>5} {way:<9}{:>9}{:>9}{:>9}{:>10}{:>10}{:>10}{:>10}{:>10}",
            step.index,
            step.frequency_hz.map_or_else(|| "-".to_owned(), |f| format!("{f:.3}")),
            number(step.nrmse_a),
            number(step.nrmse_d),
            number(step.a_max_m_s2),
            number(step.model_a_max_m_s2),
            milli(step.excursion_m),
            milli(step.model_excursion_m),
            step.force_residual_n.map_or_else(|| "-".to_owned(), |f| format!("{f:.3}")),
        )?;
    }
    Ok(())
}

fn table(out: &mut String, title: &str, slices: &[Slice]) -> std::fmt::Result {
    if slices.is_empty() {
        return Ok(());
    }
    writeln!(
        out,
        "\n{title:<28}{:>9}{:>9}{:>9}{:>12}{:>12}{:>12}",
        "samples %", "nrmse A", "nrmse D", "of A %", "of D %", "of force %"
    )?;
    for slice in slices {
        writeln!(
            out,
            "{:<28}{:>9}{:>9}{:>9}{:>12}{:>12}{:>12}",
            slice.name,
            percent(Some(slice.share_of_samples)),
            number(slice.nrmse_a),
            number(slice.nrmse_d),
            percent(slice.share_of_misfit_a),
            percent(slice.share_of_misfit_d),
            percent(slice.share_of_misfit_force),
        )?;
    }
    Ok(())
}
