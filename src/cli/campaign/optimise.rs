//! `campaign optimise`: the design map of both problems.

use super::{diagnose::Whose, refused};
use crate::campaign::fit::{Cell, cells};
use crate::campaign::optimise::{Design, Map, Optimum, Space, geometric, linear, optimise};
use crate::campaign::store::write_whole;
use crate::cli::{CliError, Outcome};
use crate::model::effects;
use crate::report::{HeatMap, Table};
use indicatif::ProgressBar;
use std::path::PathBuf;

/// Map what the model predicts for bumpers and gaps between and beyond those tried.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    peaks: Whose,
    /// Effects added to the model, as `campaign diagnose` names them.
    #[arg(long, value_delimiter = ',')]
    effects: Vec<String>,
    /// Stiffnesses of the bumper, N/m, as LOW..HIGH in equal ratios.
    #[arg(long, default_value = "10e3..6e6", value_parser = range)]
    stiffness: (f64, f64),
    /// Total gaps, m, as LOW..HIGH in equal steps.
    #[arg(long, default_value = "0.005..0.045", value_parser = range)]
    gap: (f64, f64),
    /// Values of either, as STIFFNESSES x GAPS.
    #[arg(long, default_value = "11x9", value_parser = grid)]
    grid: (usize, usize),
    /// Models drawn for the interval of a prediction; fewer than 20 give none.
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u16).range(0..=2000))]
    draws: u16,
    /// Print one JSON object on standard output.
    #[arg(long)]
    json: bool,
}

fn range(text: &str) -> Result<(f64, f64), String> {
    let pair = text.split_once("..").and_then(|(low, high)| Some((low.parse().ok()?, high.parse().ok()?)));
    let sound = |(low, high): &(f64, f64)| *low > 0.0 && high > low && high.is_finite();
    pair.filter(sound).ok_or_else(|| format!("`{text}` is no range LOW..HIGH of positive numbers"))
}

fn grid(text: &str) -> Result<(usize, usize), String> {
    let pair = text.split_once('x').and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
    let sound = |(a, b): &(usize, usize)| (2..=100).contains(a) && (2..=100).contains(b);
    pair.filter(sound).ok_or_else(|| format!("`{text}` is no grid like 11x9, from 2x2 to 100x100"))
}

/// Optimises.
///
/// # Errors
/// No peaks, an unknown effect, a model that cannot be simulated, files that cannot be written.
pub(super) fn execute(args: Args) -> Result<Outcome, CliError> {
    let (study, store) = args.peaks.study()?;
    let names = args.effects.iter().map(|name| effects::find(name).map(|effect| effect.name));
    let names: Vec<&'static str> = names.collect::<Result<_, _>>().map_err(CliError::usage)?;
    let spec = &study.configuration.spec;
    // Bumpers whose numbers were only assumed would be identified on entries that fit no trend.
    let identified = |cell: &Cell| !spec.bumper[cell.case.bumper].assumed;
    let mut peaks = cells(&study.configuration, study.of(args.peaks.origin()));
    peaks.retain(identified);
    if peaks.is_empty() {
        return Err(CliError::failed("no peaks to identify the model on"));
    }
    let space = Space {
        stiffness_n_m: geometric(args.stiffness.0, args.stiffness.1, args.grid.0),
        total_gap_m: linear(args.gap.0, args.gap.1, args.grid.1),
        draws: usize::from(args.draws),
        jobs: crate::parallel::cores(),
    };
    let bar = ProgressBar::new_spinner();
    let tell = |what: &str| {
        bar.set_message(what.to_owned());
        bar.tick();
    };
    let found = optimise(&study.configuration, &peaks, names, &space, &tell);
    bar.finish_and_clear();
    let found = found.ok_or_else(|| {
        CliError::failed("nothing to map: the model cannot be simulated, or the campaign names no reference")
    })?;
    let files = write(&found, &space, store.path())?;
    if args.json {
        let mut object = serde_json::to_value(&found).map_err(CliError::failed)?;
        object["files"] = serde_json::to_value(&files).map_err(CliError::failed)?;
        println!("{object}");
    } else {
        println!("model identified to {:.1} % (RMS)", 100.0 * found.rms);
        println!("{}", summary(&found).text());
        for file in &files {
            println!("written: {}", file.display());
        }
    }
    Ok(Outcome::Done)
}

/// The best design and the best tried device of both problems.
fn summary(found: &Optimum) -> Table {
    let mut table = Table::new([
        "problem",
        "",
        "stiffness (kN/m)",
        "total gap (mm)",
        "worst eta + alpha",
        "95 %",
        "better in",
        "",
    ]);
    for map in &found.maps {
        for design in [&map.best, &map.best_tried] {
            let interval = design.worst_sum_95.map(|[low, high]| format!("{low:.2} to {high:.2}"));
            let share = design.better_than_tried.map(|share| format!("{:.0} % of models", 100.0 * share));
            let border = design.device.is_none() && map.at_border;
            table.push([
                map.problem.name().to_owned(),
                design.device.clone().unwrap_or_else(|| "best of the map".to_owned()),
                format!("{:.0}", 1e-3 * design.stiffness_n_m),
                format!("{:.1}", 1e3 * design.total_gap_m),
                format!("{:.2}", design.worst_sum),
                interval.unwrap_or_default(),
                share.unwrap_or_default(),
                match (design.beyond, border) {
                    (_, true) => "at the border of the map".to_owned(),
                    (true, _) => "beyond what was tried".to_owned(),
                    _ => String::new(),
                },
            ]);
        }
    }
    table
}

/// The maps as figures and one table.
fn write(found: &Optimum, space: &Space, folder: &std::path::Path) -> Result<Vec<PathBuf>, CliError> {
    let (figures, tables) = (folder.join("figures"), folder.join("tables"));
    for made in [&figures, &tables] {
        std::fs::create_dir_all(made)
            .map_err(|error| CliError::failed(format!("{}: {error}", made.display())))?;
    }
    let mut files = Vec::new();
    for map in &found.maps {
        let path = figures.join(format!("design-map-{}.svg", map.problem.name()));
        write_whole(&path, &heat_map(map, space).svg().map_err(CliError::failed)?).map_err(refused)?;
        files.push(path);
    }
    let path = tables.join("design-map.csv");
    write_whole(&path, &csv(found)).map_err(refused)?;
    files.push(path);
    Ok(files)
}

/// Worst sum of both ratios by stiffness and gap, per cent.
fn heat_map(map: &Map, space: &Space) -> HeatMap {
    let columns: Vec<String> = space.stiffness_n_m.iter().map(|k| format!("{:.0}", 1e-3 * k)).collect();
    let row = |designs: &[Design]| designs.iter().map(|d| Some(100.0 * d.worst_sum)).collect();
    let values: Vec<Vec<Option<f64>>> = map.designs.chunks(columns.len().max(1)).map(row).collect();
    let full = values.iter().flatten().flatten().fold(0.0_f64, |top, v| top.max(*v));
    HeatMap {
        rows: space.total_gap_m.iter().map(|gap| format!("{:.1} mm", 1e3 * gap)).collect(),
        groups: vec![(
            format!("{} problem: worst eta + alpha (%) by bumper stiffness (kN/m)", map.problem.name()),
            columns,
            values,
        )],
        full,
        one_sided: true,
        decimals: 0,
    }
}

fn csv(found: &Optimum) -> String {
    let mut out = String::from(
        "problem,device,stiffness_n_m,damping_n_s_m,total_gap_m,beyond,table_acceleration_g,eta,alpha\n",
    );
    for map in &found.maps {
        for design in map.tried.iter().chain(&map.designs) {
            for (level_g, [eta, alpha]) in map.levels_g.iter().zip(&design.ratios) {
                out += &format!(
                    "{},{},{},{},{},{},{level_g},{eta},{alpha}\n",
                    map.problem.name(),
                    design.device.as_deref().unwrap_or_default(),
                    design.stiffness_n_m,
                    design.damping_n_s_m,
                    design.total_gap_m,
                    design.beyond
                );
            }
        }
    }
    out
}
