//! The command line, one file a subcommand.
//!
//! Exit codes: 0 done, 1 failed, 2 bad usage or configuration, 3 aborted by safety.

/// `print!` of the command line: a reader that went away (`| head`) ends the printing, not the program.
macro_rules! print {
    ($($text:tt)*) => {{
        use std::io::Write as _;
        // Standard output that is closed or full leaves nobody to tell.
        let _ = write!(std::io::stdout().lock(), $($text)*);
    }};
}

/// `println!` of the command line, as `print!` above.
macro_rules! println {
    () => { print!("\n") };
    ($format:literal $($rest:tt)*) => { print!("{}\n", format_args!($format $($rest)*)) };
}

pub mod bench;
pub mod campaign;
pub mod client;
pub mod compare;
pub mod completions;
pub mod diagnose;
pub mod doctor;
pub mod effect;
pub mod emulate;
pub mod export;
pub mod fitted;
pub mod hold;
pub mod identify;
pub mod import;
pub mod parts;
pub mod reading;
pub mod recover;
pub mod replay;
pub mod run;
pub mod runs;
pub mod serve;
pub mod simulate;
pub mod start;
pub mod status;
pub mod stop;
pub mod watch;

use clap::Parser;
use std::process::ExitCode;

/// Controller of a shaking table, and the bench on which a model is compared with measurements.
#[derive(Parser)]
#[command(name = "shaketable", version, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

/// What can be asked for; a variant a file.
#[derive(clap::Subcommand)]
enum Command {
    /// Drive a sweep on the table, record it, compare it with the onboard model.
    Run(run::Args),
    /// Tell where a model fails against a record.
    Compare(compare::Args),
    /// Start the daemon with its page.
    Serve(serve::Args),
    /// Show how the bench of a running daemon stands.
    Status(status::Args),
    /// Check, arm and start what is set up in a running daemon.
    Start(start::Args),
    /// Bring the table of a running daemon to rest.
    Stop(stop::Args),
    /// Keep the sweep of a running daemon in its step, or let it go on.
    Hold(hold::Args),
    /// Follow a running daemon until its run has ended.
    Watch(watch::Args),
    /// Print completions for a shell.
    Completions(completions::Args),
    /// Write the manual pages.
    Man(completions::ManArgs),
    /// List recorded runs, or check one.
    Runs(runs::Args),
    /// Close an interrupted run with what is there.
    Recover(recover::Args),
    /// Many cases as one study: run, report, compare, diagnose, optimise.
    Campaign(campaign::Args),
    /// Check what real-time operation needs on this machine.
    Doctor(doctor::Args),
    /// Read a foreign data file, name its channels and units, write it as a record.
    Import(import::Args),
    /// Write a record in the format of another tool.
    Export(export::Args),
    /// Emulate the devices of a rig: DAQ on a pseudo terminal, drive on a CAN interface.
    Emulate(emulate::Args),
    /// Measure what this machine gets: control thread, model, comparison, diagnosis.
    Bench(bench::Args),
    /// Response of a model to a sweep on an ideal table.
    Simulate(simulate::Args),
    /// List, show, add or remove effects of a model.
    Effect(effect::Args),
    /// Re-fit the parameters of a model to a record.
    Identify(identify::Args),
    /// Find out which physical effect a model lacks, from a record.
    Diagnose(diagnose::Args),
    /// Play a recorded run through the whole chain again.
    Replay(replay::Args),
}

/// How a subcommand ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All done.
    Done,
    /// Ended by the safety supervisor.
    Aborted,
}

/// Why a subcommand could not do what was asked.
#[derive(Debug)]
pub enum CliError {
    /// Bad usage or configuration: exit code 2.
    Usage(miette::Report),
    /// Anything else: exit code 1.
    Failed(miette::Report),
}

impl CliError {
    /// A usage error from a message.
    pub fn usage(message: impl std::fmt::Display) -> Self {
        Self::Usage(miette::miette!("{message}"))
    }

    /// A failure from a message.
    pub fn failed(message: impl std::fmt::Display) -> Self {
        Self::Failed(miette::miette!("{message}"))
    }
}

impl std::fmt::Display for CliError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Usage(report) | Self::Failed(report) => write!(f, "{report}"),
        }
    }
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = match cli.command {
        Command::Run(args) => run::execute(args),
        Command::Compare(args) => compare::execute(args),
        Command::Serve(args) => serve::execute(args),
        Command::Status(args) => status::execute(args),
        Command::Start(args) => start::execute(args),
        Command::Stop(args) => stop::execute(args),
        Command::Hold(args) => hold::execute(args),
        Command::Watch(args) => watch::execute(args),
        Command::Completions(args) => completions::execute(args),
        Command::Man(args) => completions::man(args),
        Command::Runs(args) => runs::execute(args),
        Command::Recover(args) => recover::execute(args),
        Command::Campaign(args) => campaign::execute(args),
        Command::Doctor(args) => doctor::execute(args),
        Command::Import(args) => import::execute(args),
        Command::Export(args) => export::execute(args),
        Command::Emulate(args) => emulate::execute(args),
        Command::Bench(args) => bench::execute(args),
        Command::Replay(args) => replay::execute(args),
        Command::Identify(args) => identify::execute(args),
        Command::Diagnose(args) => diagnose::execute(args),
        Command::Simulate(args) => simulate::execute(args),
        Command::Effect(args) => effect::execute(args),
    };
    match result {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Aborted) => ExitCode::from(3),
        Err(CliError::Failed(report)) => {
            eprintln!("{report:?}");
            ExitCode::from(1)
        }
        Err(CliError::Usage(report)) => {
            eprintln!("{report:?}");
            ExitCode::from(2)
        }
    }
}
