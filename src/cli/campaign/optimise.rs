//! `campaign optimise`: the design map of both problems.

use super::{diagnose::Whose, refused};
use crate::campaign::Store;
use crate::campaign::design_map::DesignMap;
use crate::campaign::fit::{Cell, cells};
use crate::campaign::optimise::{Space, geometric, linear, optimise};
use crate::campaign::tables::{Origin, Study};
use crate::cli::{CliError, Outcome};
use crate::model::effects;
use indicatif::ProgressBar;

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
    let space = Space {
        stiffness_n_m: geometric(args.stiffness.0, args.stiffness.1, args.grid.0),
        total_gap_m: linear(args.gap.0, args.gap.1, args.grid.1),
        draws: usize::from(args.draws),
        ..Space::default()
    };
    let map = made(&study, args.peaks.origin(), names, space)?;
    let files = map.write(&store).map_err(refused)?;
    if args.json {
        let mut object = serde_json::to_value(&map.optimum).map_err(CliError::failed)?;
        object["files"] = serde_json::to_value(&files).map_err(CliError::failed)?;
        println!("{object}");
    } else {
        println!("model identified to {:.1} % (RMS)", 100.0 * map.optimum.rms);
        println!("{}", map.summary().text());
        for file in &files {
            println!("written: {}", file.display());
        }
    }
    Ok(Outcome::Done)
}

/// Maps designs for a study.
fn made(
    study: &Study,
    origin: Origin,
    effects: Vec<&'static str>,
    space: Space,
) -> Result<DesignMap, CliError> {
    let spec = &study.configuration.spec;
    // Bumpers whose numbers were only assumed would be identified on entries that fit no trend.
    let identified = |cell: &Cell| !spec.bumper[cell.case.bumper].assumed;
    let mut peaks = cells(&study.configuration, study.of(origin));
    peaks.retain(identified);
    if peaks.is_empty() {
        return Err(CliError::failed("no peaks to identify the model on"));
    }
    let bar = ProgressBar::new_spinner();
    let tell = |what: &str| {
        bar.set_message(what.to_owned());
        bar.tick();
    };
    let found = optimise(&study.configuration, &peaks, effects.clone(), &space, &tell);
    bar.finish_and_clear();
    let optimum = found.ok_or_else(|| {
        CliError::failed("nothing to map: the model cannot be simulated, or the campaign names no reference")
    })?;
    let effects = effects.into_iter().map(str::to_owned).collect();
    Ok(DesignMap { origin: origin.name().to_owned(), effects, space, optimum })
}

/// The map that is kept beside the results; where there is none, one of the campaign's own model as
/// `campaign optimise` makes it without options, on the published peaks where there are any.
pub(super) fn kept_or_made(study: &Study, store: &Store) -> Result<Option<DesignMap>, CliError> {
    if let Some(kept) = DesignMap::kept(store).map_err(refused)? {
        return Ok(Some(kept));
    }
    let spec = &study.configuration.spec;
    let has_peaks = |origin: &Origin| {
        let peaks = study.of(*origin).iter().zip(&study.configuration.cases);
        peaks.into_iter().any(|(p, case)| p.forward.is_some() && !spec.bumper[case.bumper].assumed)
    };
    let Some(origin) = [Origin::Published, Origin::Measured].into_iter().find(has_peaks) else {
        return Ok(None);
    };
    if spec.free.is_none() && spec.rigid.is_none() {
        return Ok(None);
    }
    let map = made(study, origin, Vec::new(), Space::default())?;
    map.write(store).map_err(refused)?;
    Ok(Some(map))
}
