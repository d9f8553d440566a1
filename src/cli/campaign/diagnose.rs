//! `campaign diagnose`: what the peaks of all cells say about the model.

use super::{Place, refused};
use crate::campaign::Store;
use crate::campaign::diagnose::{Diagnosis, Given, diagnose};
use crate::campaign::fit::{Cell, Effort, cells};
use crate::campaign::ladder::{Depth, Rung};
use crate::campaign::odd::Odd;
use crate::campaign::peaks::repeatability;
use crate::campaign::tables::{Origin, Problem, Study};
use crate::cli::{CliError, Outcome};
use crate::report::Table;
use indicatif::ProgressBar;

/// Identify the model and search for missing effects on peaks alone.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    peaks: Whose,
    /// Only these bumpers, as in B0,B1,B2; without it those whose numbers are not assumed.
    #[arg(long, value_delimiter = ',')]
    bumpers: Vec<String>,
    /// Effects that are fitted in full; those that do well are judged on left-out gaps.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u8).range(1..=30))]
    finalists: u8,
    /// Print one JSON object on standard output.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Of {
    Published,
    Measured,
}

/// A campaign and the peaks in it that a model is identified on.
#[derive(Debug, clap::Args)]
pub(super) struct Whose {
    #[command(flatten)]
    place: Place,
    /// Whose peaks: of the published table, or measured in this campaign.
    #[arg(long = "of", value_enum, default_value = "published")]
    of: Of,
}

impl Whose {
    /// The study of the campaign with the results that these peaks come from, and where it is kept.
    pub(super) fn study(&self) -> Result<(Study, Store), CliError> {
        let (configuration, store) = self.place.open()?;
        let results = match self.of {
            Of::Measured => store.results(&configuration).map_err(refused)?,
            Of::Published => Vec::new(),
        };
        Ok((Study::new(configuration, &results), store))
    }

    pub(super) fn origin(&self) -> Origin {
        match self.of {
            Of::Published => Origin::Published,
            Of::Measured => Origin::Measured,
        }
    }
}

/// Diagnoses.
///
/// # Errors
/// No peaks to judge, or a model that cannot be simulated.
pub(super) fn execute(args: Args) -> Result<Outcome, CliError> {
    let (study, _) = args.peaks.study()?;
    let origin = args.peaks.origin();
    let given = given(&study, &args)?;
    let jobs = crate::parallel::cores();
    let depth = Depth {
        full: Effort::FULL,
        held_out: Effort::HELD_OUT,
        first: Effort::QUICK,
        finalists: usize::from(args.finalists),
        jobs,
    };
    let bar = ProgressBar::new_spinner();
    let began = std::time::Instant::now();
    // Minutes of work: where there is no terminal to draw on, each thing done is a line.
    let tell = |what: &str| {
        if bar.is_hidden() {
            eprintln!("{:6.0} s  {what}", began.elapsed().as_secs_f64());
        }
        bar.set_message(what.to_owned());
        bar.tick();
    };
    let found = diagnose(&study.configuration, &given, depth, &tell);
    let found = found.ok_or_else(|| CliError::failed("the model of the campaign cannot be simulated"))?;
    bar.finish_and_clear();
    if args.json {
        let mut object = serde_json::to_value(&found).map_err(CliError::failed)?;
        object["choices"] = choices(&study, origin, &found.odd);
        object["wall_s"] = began.elapsed().as_secs_f64().into();
        println!("{object}");
    } else {
        show(&found);
        println!("\n{}", choices_text(&study, origin, &found.odd));
    }
    Ok(Outcome::Done)
}

/// The peaks that were asked for.
fn given(study: &Study, args: &Args) -> Result<Given, CliError> {
    let origin = args.peaks.origin();
    let scatter = match args.peaks.of {
        Of::Published => [0.08; 3],
        // The steps of the sweep are what limits nu_R; the peaks repeat within a per cent.
        Of::Measured => [0.01, 0.01, 0.03],
    };
    let all = cells(&study.configuration, study.of(origin));
    let spec = &study.configuration.spec;
    let wanted = |cell: &&Cell| {
        let bumper = &spec.bumper[cell.case.bumper];
        if args.bumpers.is_empty() { !bumper.assumed } else { args.bumpers.contains(&bumper.name) }
    };
    let some: Vec<Cell> = all.iter().filter(wanted).cloned().collect();
    if some.is_empty() {
        return Err(CliError::failed("no peaks to diagnose"));
    }
    let repeats = repeatability(&study.configuration, study.of(origin));
    Ok(Given { cells: some, all, scatter, repeats })
}

fn cases(odd: &[Odd]) -> Vec<String> {
    odd.iter().filter(|odd| odd.quantity != "nu_r").map(|odd| odd.case.clone()).collect()
}

/// The robust choice of each problem, with and without the entries that fit no trend.
fn choices(study: &Study, origin: Origin, odd: &[Odd]) -> serde_json::Value {
    let without = cases(odd);
    let of = |problem: Problem| {
        serde_json::json!({
            "problem": problem,
            "choice": study.robust(origin, problem, &[]),
            "without_odd_entries": study.robust(origin, problem, &without),
        })
    };
    Problem::ALL.into_iter().map(of).collect()
}

fn choices_text(study: &Study, origin: Origin, odd: &[Odd]) -> String {
    let without = cases(odd);
    let line = |problem: Problem| {
        let (all, sound) = (study.robust(origin, problem, &[])?, study.robust(origin, problem, &without)?);
        let stands = if all.device == sound.device { "" } else { ": the choice stands on those entries" };
        Some(format!(
            "{} problem: robust choice {}, without the odd entries {}{stands}",
            problem.name(),
            all.device,
            sound.device
        ))
    };
    Problem::ALL.into_iter().filter_map(line).collect::<Vec<_>>().join("\n")
}

fn show(found: &Diagnosis) {
    println!("verdict: {}", found.verdict);
    if !found.effects.is_empty() {
        println!("effects that do equally well: {}", found.effects.join(", "));
    }
    if !found.corrections.is_empty() {
        println!(
            "corrections of the observation that do equally well, none confirmed: {}",
            found.corrections.join(", ")
        );
    }
    println!("\n{}", ladder_text(found));
    if let Some(best) = found.ladder.get(found.best) {
        println!("{}", numbers_text(best));
    }
    println!("refused:");
    found.refused.iter().for_each(|refused| println!("  {}: {}", refused.name, refused.reason));
    println!("peaks cannot tell:");
    found.cannot_tell.iter().for_each(|line| println!("  {line}"));
    println!("what would settle the rest:");
    found.next.iter().for_each(|line| println!("  {line}"));
    println!("entries that fit no smooth trend:");
    for odd in &found.odd {
        let model = 100.0 * (odd.log_error.exp() - 1.0);
        println!(
            "  {} {}: a model of all cells gives {model:+.0} % ({:+.1} deviations)",
            odd.case, odd.quantity, odd.deviations
        );
    }
}

/// Errors of every rung, in per cent.
fn ladder_text(found: &Diagnosis) -> String {
    let heads =
        ["", "numbers", "RMS (%)", "A", "E", "nu", "gap left out (%)", "mean A", "mean E", "mean nu (%)"];
    let mut table = Table::new(heads);
    let mut push = |name: String, rung: &Rung| {
        let held = rung.held_out.map_or("-".to_owned(), |held| format!("{:.1}", 100.0 * held));
        let of = rung.rms_of.map(|rms| format!("{:.1}", 100.0 * rms));
        let bias = rung.bias.map(|b| format!("{:+.1}", 100.0 * b));
        let head = [name, rung.numbers.to_string(), format!("{:.1}", 100.0 * rung.rms)];
        table.push(head.into_iter().chain(of).chain([held]).chain(bias));
    };
    found.ladder.iter().for_each(|rung| push(rung.name.clone(), rung));
    if let Some(rung) = &found.all_bumpers {
        push(format!("all bumpers without odd entries, {}", rung.name), rung);
    }
    table.text()
}

/// Numbers of a rung with their intervals.
fn numbers_text(rung: &Rung) -> String {
    let mut table = Table::new([rung.name.as_str(), "value", "95 % low", "95 % high", "unit", ""]);
    for p in &rung.parameters {
        let numbers = [p.value, p.low95, p.high95].map(|v| format!("{v:.4e}"));
        let tested = if p.tested { "" } else { "untested" };
        table.push([p.name.clone()].into_iter().chain(numbers).chain([p.unit.clone(), tested.to_owned()]));
    }
    table.text()
}
