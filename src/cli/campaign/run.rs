//! `campaign run` and `campaign merge`.

use super::{Place, refused};
use crate::campaign::runner::{Answer, Progress};
use crate::campaign::{CampaignError, CaseKey, Configuration, Options, Store, Summary};
use crate::cli::{CliError, Outcome};
use crate::control::session::Pace;
use crate::control::setup::Setup;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::{BufRead, IsTerminal, Write};
use std::path::PathBuf;

/// Run every case that has no result yet.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    place: Place,
    /// Only part i of n of the cases, as in 1/2; the parts may run on different machines.
    #[arg(long, value_parser = parse_shard)]
    shard: Option<(usize, usize)>,
    /// Runs at a time on a simulated rig; without it one a core.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Only these cases, as in B1-G2-0.05; may be given several times.
    #[arg(long = "case")]
    cases: Vec<String>,
    /// Run again what was aborted or left out.
    #[arg(long)]
    retry: bool,
    /// Ask the operator before each change of bumper or gap, on a simulated rig too.
    #[arg(long)]
    confirm: bool,
    /// Say what would be run, and run nothing.
    #[arg(long)]
    preview: bool,
    /// Print one JSON object on standard output, everything else on standard error.
    #[arg(long)]
    json: bool,
}

/// Take the results of other folders over.
#[derive(Debug, clap::Args)]
pub struct MergeArgs {
    /// Folder that takes the results; it is made when it does not exist.
    into: PathBuf,
    /// Folders of the same campaign.
    #[arg(required = true)]
    from: Vec<PathBuf>,
}

/// Part i of n, `1/2`.
fn parse_shard(text: &str) -> Result<(usize, usize), String> {
    let wrong = || format!("`{text}` is no part; write 1/2 (part 1 of 2)");
    let (part, parts) = text.split_once('/').ok_or_else(wrong)?;
    let (part, parts): (usize, usize) =
        (part.trim().parse().map_err(|_| wrong())?, parts.trim().parse().map_err(|_| wrong())?);
    if (1..=parts).contains(&part) { Ok((part, parts)) } else { Err(wrong()) }
}

/// Runs the campaign.
///
/// # Errors
/// Bad configuration; runs that failed, which are named.
pub(super) fn execute(args: Args) -> Result<Outcome, CliError> {
    let (configuration, store) = args.place.open()?;
    if let Some(label) = args.cases.iter().find(|label| configuration.case(label).is_none()) {
        let known: Vec<&str> = configuration.cases.iter().map(|case| case.label.as_str()).collect();
        return Err(CliError::usage(format!("no case `{label}`; the campaign has {}", known.join(", "))));
    }
    if args.preview {
        return Ok(preview(&configuration));
    }
    let real = configuration.rig.hardware.is_some();
    let asks = real || args.confirm;
    if asks && !std::io::stdin().is_terminal() && real {
        return Err(CliError::usage(
            "a real rig needs an operator at a terminal who confirms bumpers and gaps",
        ));
    }
    let cores = crate::parallel::cores();
    let options = Options {
        shard: args.shard,
        jobs: if asks { 1 } else { args.jobs.map_or(cores, usize::from) },
        retry: args.retry,
        only: args.cases.clone(),
    };
    let bar = Bar::new();
    let started = std::time::Instant::now();
    let ask = |case: &CaseKey, configuration: &Configuration| {
        if asks { bar.0.suspend(|| confirm(case, configuration)) } else { Answer::Go }
    };
    let drive = |setup: &Setup,
                 out: &std::path::Path,
                 show: &mut dyn FnMut(&crate::record::recorder::Notice)| {
        let pace =
            if real { Pace::Wall { cpu: Some(cores - 1), require_realtime: false } } else { Pace::Virtual };
        let finished = crate::cli::run::drive(setup, out, pace, show)
            .map_err(|error| CampaignError::Run { case: setup.name.clone(), reason: error.to_string() })?;
        crate::cli::run::write_report(&finished.folder, &finished.steps);
        Ok(finished)
    };
    let summary =
        crate::campaign::run(&configuration, &store, &options, &drive, &ask, &|progress| bar.show(progress))
            .map_err(refused)?;
    bar.0.finish_and_clear();
    close(&args, &store, &summary, started.elapsed().as_secs_f64())
}

fn close(args: &Args, store: &Store, summary: &Summary, wall_s: f64) -> Result<Outcome, CliError> {
    let line = format!(
        "{} run in {wall_s:.1} s, {} had a result; {} aborted by safety, {} left out, {} missing; results in {}",
        summary.ran,
        summary.there,
        summary.aborted,
        summary.not_run,
        summary.missing.len(),
        store.path().display()
    );
    if args.json {
        let mut object = serde_json::to_value(summary).map_err(CliError::failed)?;
        object["wall_s"] = wall_s.into();
        object["dir"] = store.path().display().to_string().into();
        println!("{object}");
        eprintln!("{line}");
    } else {
        println!("{line}");
    }
    if summary.missing.is_empty() {
        Ok(Outcome::Done)
    } else {
        Err(CliError::failed(format!("without a result:\n  {}", summary.missing.join("\n  "))))
    }
}

/// What would be run, and what has to be changed on the way.
fn preview(configuration: &Configuration) -> Outcome {
    let mut mounted = String::new();
    for case in &configuration.cases {
        if case.device != mounted {
            println!("# {}", instruction(case, configuration));
            mounted.clone_from(&case.device);
        }
        println!("{}", case.label);
    }
    Outcome::Done
}

/// What has to stand on the table for a case.
fn instruction(case: &CaseKey, configuration: &Configuration) -> String {
    let bumper = &configuration.spec.bumper[case.bumper];
    let about = bumper.about.as_ref().map_or(String::new(), |about| format!(" ({about})"));
    match configuration.total_gap_m(case) {
        Some(gap_m) => format!(
            "bumpers {}{about}, total gap {:.2} mm: {:.2} mm on each side",
            bumper.name,
            1e3 * gap_m,
            0.5e3 * gap_m
        ),
        None => format!("no bumpers within reach ({})", bumper.name),
    }
}

/// Asks until there is an answer; the end of input ends the campaign.
fn confirm(case: &CaseKey, configuration: &Configuration) -> Answer {
    loop {
        eprint!(
            "{}. Ready? [Enter: go, s: leave {} out, q: quit] ",
            instruction(case, configuration),
            case.label
        );
        // A prompt that cannot be flushed is still answered.
        let _ = std::io::stderr().flush();
        let mut line = String::new();
        match std::io::stdin().lock().read_line(&mut line) {
            Ok(0) | Err(_) => return Answer::Quit,
            Ok(_) => {}
        }
        match line.trim() {
            "" | "y" | "yes" => return Answer::Go,
            "s" => return Answer::Skip,
            "q" => return Answer::Quit,
            _ => {}
        }
    }
}

/// Progress over all steps of all runs, with the time left.
struct Bar(ProgressBar);

impl Bar {
    fn new() -> Self {
        let bar = ProgressBar::new(0);
        let style = ProgressStyle::with_template("{bar:30} {percent:>3} %  {msg}  ETA {eta}")
            .unwrap_or_else(|_| ProgressStyle::default_bar());
        bar.set_style(style);
        Self(bar)
    }

    fn show(&self, progress: Progress) {
        match progress {
            Progress::Planned { runs, there, steps } => {
                self.0.set_length((runs * steps) as u64);
                self.0.println(format!("{runs} runs to make, {there} have a result"));
            }
            Progress::Begins(name) => self.0.set_message(name),
            Progress::Step => self.0.inc(1),
            Progress::Ends(name, state, left) => {
                self.0.inc(left as u64);
                if state != "done" {
                    self.0.println(format!("{name}: {state}"));
                }
            }
            Progress::Adopted(name) => self.0.println(format!("{name}: finished earlier, taken over")),
        }
    }
}

/// Merges folders.
///
/// # Errors
/// Folders of different campaigns, or that disagree about a case.
pub(super) fn merge(args: MergeArgs) -> Result<Outcome, CliError> {
    let target = Store::at(&args.into);
    let mut new = 0;
    for (i, from) in args.from.iter().enumerate() {
        let source = Store::at(from);
        if i == 0 && target.spec().is_err() {
            target.prepare(&source.configuration().map_err(refused)?).map_err(refused)?;
        }
        new += target.merge(&source).map_err(refused)?;
    }
    println!("{new} results taken over into {}", args.into.display());
    Ok(Outcome::Done)
}
