//! `shaketable run`: drives a sweep on the rig, shows it, leaves a run folder.

pub(crate) mod hardware;
mod interrupt;
mod show;

use super::reading::read_model;
use super::{CliError, Outcome};
use crate::config::builtin::find;
use crate::config::{Case, ConfigError};
use crate::control::session::{self, Finished, Pace, Plan, Session};
use crate::control::setup::{Setup, SetupError, model_of_case};
use crate::control::{Ending, Nrmse, StepSummary, TimingReport};
use crate::diagnose::next_test::{NextTest, SweepProposal};
use crate::identify::together::Setting;
use crate::model::ModelSpec;
use crate::record::RunFolder;
use crate::record::recorder::Notice;
use crate::report::preview::preview_svg;
use crate::report::{Table, of_run};
use crate::rig::RigSpec;
use crate::rig::hardware::HardwareMonitor;
use crate::safety::SafetySpec;
use crate::sweep::SweepSpec;
use interrupt::Interrupts;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

/// Drive a sweep on the table and record it.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Rig, by name or file.
    #[arg(long, default_value = "simulated")]
    rig: String,
    /// Sweep, by name or file.
    #[arg(long, default_value = "andreaus-2020")]
    sweep: String,
    /// Onboard model, by name or file; without it that of the case.
    #[arg(long)]
    model: Option<String>,
    /// Case of the paper: bumper, gap and table acceleration in g, as in B1-G2-0.05.
    #[arg(long, default_value = "B1-G2-0.05")]
    case: Case,
    /// Peak table acceleration in g, in place of the case's.
    #[arg(long, allow_negative_numbers = true)]
    ag: Option<f64>,
    /// What really stands on the simulated table, by name or file; without it the onboard model.
    #[arg(long)]
    specimen: Option<String>,
    /// Do the test that a diagnosis proposed: a file with what `diagnose --json` printed. Takes the place of --sweep and
    /// --ag, and changes gap or bumpers of the model (and of what stands on the simulated table) as proposed.
    #[arg(long, value_name = "FILE.json", conflicts_with_all = ["sweep", "ag", "steps"])]
    next_test: Option<PathBuf>,
    /// Safety file: detectors, action ladder, stops.
    #[arg(long, default_value = "default")]
    safety: String,
    /// Only the steps within this range of frequencies in Hz, as in 2.0..3.0.
    #[arg(long, value_parser = parse_range)]
    steps: Option<(f64, f64)>,
    /// Seed of the simulated rig's noise; the same seed gives the same samples.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Run by the clock on the wall instead of in virtual time.
    #[arg(long)]
    real_time: bool,
    /// With --real-time: refuse to run when the real-time set-up is not complete.
    #[arg(long, requires = "real_time")]
    require_realtime: bool,
    /// With --real-time: CPU to pin the control thread to; without it the last one.
    #[arg(long, requires = "real_time")]
    cpu: Option<usize>,
    /// Show what the sweep asks of the table, and do not move it.
    #[arg(long)]
    preview: bool,
    /// With --preview: write it as a figure to this file as well.
    #[arg(long, requires = "preview", value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Folder below which the run folder is made.
    #[arg(long, default_value = "runs")]
    out: PathBuf,
    /// Name of the run; without it that of the case or the model.
    #[arg(long)]
    name: Option<String>,
    /// Print one JSON object on standard output, everything else on standard error.
    #[arg(long)]
    json: bool,
}

/// A range of frequencies, `2.0..3.0`, Hz.
fn parse_range(text: &str) -> Result<(f64, f64), String> {
    let wrong = || format!("`{text}` is no range of frequencies; write 2.0..3.0 (Hz)");
    let (low, high) = text.split_once("..").ok_or_else(wrong)?;
    let low: f64 = low.trim().parse().map_err(|_| wrong())?;
    let high: f64 = high.trim_start_matches('=').trim().parse().map_err(|_| wrong())?;
    if low.is_finite() && high.is_finite() && 0.0 < low && low <= high {
        Ok((low, high))
    } else {
        Err(wrong())
    }
}

/// The object that `--json` prints.
#[derive(Debug, serde::Serialize)]
struct Report<'a> {
    run_dir: String,
    outcome: Ending,
    cause: Option<&'a str>,
    clean: bool,
    samples: u64,
    lost_samples: u64,
    slips: u64,
    wall_s: f64,
    samples_sha256: Option<&'a str>,
    real_time: Option<String>,
    steps: &'a [StepSummary],
    error: Nrmse,
    timing: &'a TimingReport,
}

/// Runs the subcommand.
///
/// # Errors
/// Bad configuration, a sweep beyond the table, a rig or a disk that fails.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    let setup = setup(&args)?;
    let preview = setup.preview().map_err(refused)?;
    if args.preview {
        if let Some(path) = &args.svg {
            let figure =
                preview_svg(&setup.schedule().map_err(refused)?, &preview).map_err(CliError::failed)?;
            std::fs::write(path, figure)
                .map_err(|error| CliError::failed(format!("cannot write {}: {error}", path.display())))?;
        }
        return show::preview(&preview, args.json);
    }
    let cpu = args.cpu.or_else(|| std::thread::available_parallelism().ok().map(|n| n.get() - 1));
    // Real devices go by the clock on the wall, whatever was asked.
    let pace = match args.real_time || setup.rig.hardware.is_some() {
        true => Pace::Wall { cpu, require_realtime: args.require_realtime },
        false => Pace::Virtual,
    };
    let started = std::time::Instant::now();
    let mut progress = show::Progress::new(&setup.schedule().map_err(refused)?, setup.rig.sample_rate_hz);
    let finished = drive_listening(&setup, &args.out, pace, &mut progress)?;
    progress.finish();
    let table = write_report(&finished.folder, &finished.steps);
    let wall_s = started.elapsed().as_secs_f64();
    if args.json {
        print_json(&finished, wall_s)?;
    } else {
        let table = table.unwrap_or_else(|| of_run::final_table(&setup, &finished.steps).0);
        show::summary(&setup, &finished, &table, wall_s);
    }
    match finished.ending {
        Ending::Done | Ending::Stopped => Ok(Outcome::Done),
        Ending::Aborted => Ok(Outcome::Aborted),
        Ending::Failed | Ending::Interrupted => {
            Err(CliError::failed(finished.manifest.cause.as_deref().unwrap_or("the run failed")))
        }
    }
}

/// Drives a run to its end on the rig of its set-up, and closes its folder.
///
/// # Errors
/// A refused configuration, a rig or a disk that fails; a run that fails on the way is a [`Finished`].
pub(super) fn drive(
    setup: &Setup,
    out: &Path,
    pace: Pace,
    show: &mut dyn FnMut(&Notice),
) -> Result<Finished, CliError> {
    let (plan, links) = connect(setup, out, pace)?;
    finish(session::start(plan).map_err(CliError::failed)?, links, show)
}

/// As [`drive`], and stops the table at Ctrl-C.
fn drive_listening(
    setup: &Setup,
    out: &Path,
    pace: Pace,
    progress: &mut show::Progress,
) -> Result<Finished, CliError> {
    // In virtual time the run is over before a question is answered.
    let follows = matches!(pace, Pace::Wall { .. });
    let (plan, links) = connect(setup, out, pace)?;
    let interrupts = Interrupts::listen().map_err(CliError::failed)?;
    let session = session::start(plan).map_err(CliError::failed)?;
    interrupts.stop(session.operator()).map_err(CliError::failed)?;
    if follows {
        progress.follow(session.folder().path());
    }
    finish(session, links, &mut |notice| progress.notice(notice))
}

/// Waits for the end of a run, and looks at the links of real devices.
fn finish(
    session: Session,
    links: Option<HardwareMonitor>,
    show: &mut dyn FnMut(&Notice),
) -> Result<Finished, CliError> {
    if let Some(state) = &session.manifest().real_time {
        eprintln!("{}", state.line());
    }
    let finished = session.wait(show).map_err(CliError::failed)?;
    match &links {
        Some(links) => hardware::close(links, finished),
        None => Ok(finished),
    }
}

/// The plan on the rig that was asked for; with real devices a monitor of their links.
fn connect(setup: &Setup, out: &Path, pace: Pace) -> Result<(Plan, Option<HardwareMonitor>), CliError> {
    let Some(devices) = &setup.rig.hardware else {
        return Ok((setup.plan(out, pace).map_err(refused)?.0, None));
    };
    let (plan, links, preflight) = setup.hardware_plan(devices, out, pace).map_err(|error| match error {
        SetupError::Hardware(_) => CliError::failed(error),
        other => refused(other),
    })?;
    eprint!("{preflight}");
    Ok((plan, Some(links)))
}

/// Reads every configuration that the arguments name.
fn setup(args: &Args) -> Result<Setup, CliError> {
    let usage = |error: ConfigError| CliError::Usage(error.into());
    let rig: RigSpec = find("rigs", &args.rig).and_then(|source| source.parse()).map_err(usage)?;
    let mut sweep: SweepSpec =
        find("sweeps", &args.sweep).and_then(|source| source.parse()).map_err(usage)?;
    let mut case = args.case;
    if let Some(ag) = args.ag {
        if !(1e-4..=2.0).contains(&ag) {
            return Err(CliError::usage(format!("--ag {ag} g; allowed: 0.0001 to 2 g")));
        }
        case.acceleration_g = ag;
    }
    sweep.acceleration_g = case.acceleration_g;
    if let Some((low, high)) = args.steps {
        sweep = sweep.restricted(low, high).map_err(CliError::usage)?;
    }
    let mut model = match &args.model {
        Some(name) => read_model(name)?,
        None => model_of_case(&case),
    };
    let mut specimen = match args.specimen.as_ref().or(rig.specimen.as_ref()) {
        Some(name) => read_model(name)?,
        None => model.clone(),
    };
    let named_case = (args.model.is_none() && args.next_test.is_none()).then_some(case);
    if let Some(path) = &args.next_test {
        let proposal = next_test(path)?;
        sweep = proposal.sweep(&sweep);
        let setting = proposal.setting(&model);
        (model, specimen) = (setting.of(&model), setting.of(&specimen));
        if rig.hardware.is_some() {
            by_hand(&setting, &model)?;
        }
    }
    let safety: SafetySpec = find("safety", &args.safety).and_then(|source| source.parse()).map_err(usage)?;
    if safety.supervision.operator_link {
        return Err(CliError::usage(format!(
            "{} asks for an operator's link (supervision.operator_link), and `run` hears none: \
             `shaketable serve --safety {}` does, with `shaketable watch --heartbeat` as the link",
            args.safety, args.safety
        )));
    }
    let name = args.name.clone().unwrap_or_else(|| match &named_case {
        Some(case) => case.to_string(),
        None => model.name.clone(),
    });
    let safety = Some(safety);
    Ok(Setup { rig, sweep, model, specimen, case: named_case, safety, seed: args.seed, name })
}

/// The test that a diagnosis proposed.
fn next_test(path: &Path) -> Result<SweepProposal, CliError> {
    let refused = |reason: String| CliError::usage(format!("{}: {reason}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|error| refused(error.to_string()))?;
    let test = NextTest::parse(&text).map_err(refused)?;
    eprintln!("next test: {} - {}", test.title, test.reason);
    test.sweep.ok_or_else(|| refused(format!("this test is done by hand: {}", test.title)))
}

/// Has the operator change gap or bumpers of a real specimen.
fn by_hand(setting: &Setting, model: &ModelSpec) -> Result<(), CliError> {
    if *setting == Setting::default() {
        return Ok(());
    }
    let what = match &model.bumper {
        Some(bumper) => format!("set the total gap to {:.2} mm", 1e3 * bumper.total_gap_m),
        None => "take the bumpers off".to_owned(),
    };
    if !std::io::stdin().is_terminal() {
        return Err(CliError::usage(format!("an operator at a terminal has to {what} first")));
    }
    eprint!("Before the table moves: {what}. Done? [Enter: go, anything else: leave it] ");
    let mut line = String::new();
    std::io::stdin().read_line(&mut line).map_err(CliError::failed)?;
    if line.trim().is_empty() && line.ends_with('\n') {
        return Ok(());
    }
    Err(CliError::failed("the specimen was not changed"))
}

/// Writes the report of a run; a report that fails is told and does not undo the run.
pub(super) fn write_report(folder: &RunFolder, steps: &[StepSummary]) -> Option<Table> {
    match of_run::write(folder, steps) {
        Ok((_, table)) => Some(table),
        Err(error) => {
            eprintln!("no report: {error}");
            None
        }
    }
}

/// A refused configuration is a usage error.
fn refused(error: SetupError) -> CliError {
    CliError::usage(error)
}

fn print_json(finished: &Finished, wall_s: f64) -> Result<(), CliError> {
    let manifest = &finished.manifest;
    let report = Report {
        run_dir: finished.folder.path().display().to_string(),
        outcome: finished.ending,
        cause: manifest.cause.as_deref(),
        clean: manifest.clean,
        samples: manifest.samples,
        lost_samples: manifest.lost.samples,
        slips: finished.timing.slips,
        wall_s,
        samples_sha256: manifest.samples_sha256.as_deref(),
        real_time: manifest.real_time.as_ref().map(|state| state.line()),
        steps: &finished.steps,
        error: finished.model_error,
        timing: &finished.timing,
    };
    println!("{}", serde_json::to_string(&report).map_err(CliError::failed)?);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read_or_refused() {
        assert_eq!(parse_range("2.0..3.0"), Ok((2.0, 3.0)));
        assert_eq!(parse_range("0.5..=5"), Ok((0.5, 5.0)));
        for wrong in ["2.0", "3..2", "a..b", "..", "-1..2", "1..inf"] {
            assert!(parse_range(wrong).is_err(), "{wrong}");
        }
    }
}
