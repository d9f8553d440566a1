//! `campaign report` and `campaign compare`.

use super::{Place, optimise, refused};
use crate::campaign::design_map::DesignMap;
use crate::campaign::peaks::{LogError, rms};
use crate::campaign::tables::{Origin, Study};
use crate::campaign::{report, spec::read_published};
use crate::cli::{CliError, Outcome};
use crate::report::Table;

/// Write page, figures and tables.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    place: Place,
    /// Only this figure, as an SVG on standard output (names as in figures/, without .svg).
    #[arg(long)]
    figure: Option<String>,
    /// Leave the design map out where none was made yet by `campaign optimise`.
    #[arg(long)]
    no_design_map: bool,
    /// Print one JSON object on standard output.
    #[arg(long)]
    json: bool,
}

/// Measure a campaign against a published table.
#[derive(Debug, clap::Args)]
pub struct CompareArgs {
    #[command(flatten)]
    place: Place,
    /// Published table, by name or CSV file; without it that of the campaign.
    #[arg(long)]
    published: Option<String>,
    /// Print one JSON object on standard output.
    #[arg(long)]
    json: bool,
}

/// Writes the report.
///
/// # Errors
/// No result yet; files that cannot be read or written; an unknown figure.
pub(super) fn execute(args: Args) -> Result<Outcome, CliError> {
    let (configuration, store) = args.place.open()?;
    let results = store.results(&configuration).map_err(refused)?;
    let study = Study::new(configuration, &results);
    if let Some(name) = &args.figure {
        return one(&study, name);
    }
    let map = if args.no_design_map || results.is_empty() {
        DesignMap::kept(&store).map_err(refused)?
    } else {
        optimise::kept_or_made(&study, &store)?
    };
    let written = report::write(&store, &study, &results, map.as_ref()).map_err(refused)?;
    if args.json {
        println!("{}", serde_json::to_value(&written).map_err(CliError::failed)?);
    } else {
        println!("{} figures, {} tables", written.figures.len(), written.tables.len());
        println!("report: {}", written.page.display());
    }
    Ok(Outcome::Done)
}

/// One figure on standard output.
fn one(study: &Study, name: &str) -> Result<Outcome, CliError> {
    let (all, maps) = (report::all_figures(study), report::all_maps(study));
    if let Some(figure) = all.iter().find(|figure| figure.name == name) {
        println!("{}", figure.chart.svg().map_err(CliError::failed)?);
    } else if let Some((_, map, _)) = maps.iter().find(|(known, _, _)| known == name) {
        println!("{}", map.svg().map_err(CliError::failed)?);
    } else {
        let known = all.iter().map(|f| f.name.as_str()).chain(maps.iter().map(|(name, _, _)| name.as_str()));
        return Err(CliError::usage(format!(
            "no figure `{name}`; there are {}",
            known.collect::<Vec<_>>().join(", ")
        )));
    }
    Ok(Outcome::Done)
}

/// Compares peaks with a published table.
///
/// # Errors
/// No result yet, or no published value for any case.
pub(super) fn compare(args: CompareArgs) -> Result<Outcome, CliError> {
    let (mut configuration, store) = args.place.open()?;
    if let Some(name) = &args.published {
        configuration.published = read_published(name).map_err(refused)?;
    }
    let results = store.results(&configuration).map_err(refused)?;
    let study = Study::new(configuration, &results);
    let errors = study.errors(Origin::Measured, Origin::Published);
    if errors.is_empty() {
        return Err(CliError::failed("no case has both a result and a published value"));
    }
    let all: Vec<LogError> = errors.iter().map(|(_, error)| *error).collect();
    let mean = |pick: fn(&LogError) -> f64| all.iter().map(pick).sum::<f64>() / all.len() as f64;
    if args.json {
        let cell = |(case, error): &(usize, LogError)| {
            serde_json::json!({
                "case": study.configuration.cases[*case].label,
                "measured": study.forward(Origin::Measured, *case),
                "model": study.forward(Origin::Model, *case),
                "published": study.forward(Origin::Published, *case),
                "log_error": error,
            })
        };
        let cells: Vec<_> = errors.iter().map(cell).collect();
        let object = serde_json::json!({
            "rms_log_error": rms(&all),
            "mean_log_error": { "a_max": mean(|e| e.a_max), "excursion": mean(|e| e.excursion), "nu_r": mean(|e| e.nu_r) },
            "cells": cells,
        });
        println!("{object}");
        return Ok(Outcome::Done);
    }
    let mut table = Table::new(["case", "A_max", "E_max", "nu_R (ln error, %)"]);
    for (case, error) in &errors {
        let cells = error.values().map(|value| format!("{:+.1}", 100.0 * value));
        table.push([study.configuration.cases[*case].label.clone()].into_iter().chain(cells));
    }
    println!("{}", table.text());
    println!(
        "RMS {:.1} % over {} cells; mean A_max {:+.1} %, E_max {:+.1} %, nu_R {:+.1} %",
        100.0 * rms(&all),
        all.len(),
        100.0 * mean(|e| e.a_max),
        100.0 * mean(|e| e.excursion),
        100.0 * mean(|e| e.nu_r)
    );
    Ok(Outcome::Done)
}
