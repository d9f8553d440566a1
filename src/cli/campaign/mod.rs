//! `campaign`: many cases as one study - run them, report on them, diagnose and optimise.

mod diagnose;
mod optimise;
mod report;
mod run;

use super::{CliError, Outcome};
use crate::campaign::{CampaignError, CampaignSpec, Configuration, Store};
use crate::config::{ConfigError, builtin::find};
use std::path::{Path, PathBuf};

/// Many cases as one study.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Run every case that has no result yet.
    Run(run::Args),
    /// Write the page with all figures, every figure as SVG, every table as CSV.
    Report(report::Args),
    /// Measure the results against a published table, cell by cell.
    Compare(report::CompareArgs),
    /// Identify the model and search for missing effects on the peaks of all cases at once.
    Diagnose(diagnose::Args),
    /// Map what the model predicts for bumpers and gaps between and beyond those tried.
    Optimise(optimise::Args),
    /// Take the results of other folders over (shards that were run elsewhere).
    Merge(run::MergeArgs),
}

/// Runs the subcommand.
///
/// # Errors
/// As the subcommands.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    match args.command {
        Command::Run(args) => run::execute(args),
        Command::Report(args) => report::execute(args),
        Command::Compare(args) => report::compare(args),
        Command::Diagnose(args) => diagnose::execute(args),
        Command::Optimise(args) => optimise::execute(args),
        Command::Merge(args) => run::merge(args),
    }
}

/// Where a campaign is: its file and its folder.
#[derive(Debug, clap::Args)]
pub(super) struct Place {
    /// Campaign: a file, a name in config/campaigns, or the folder of its results.
    campaign: String,
    /// Folder of the results; without it campaigns/<name>.
    #[arg(long)]
    out: Option<PathBuf>,
}

impl Place {
    /// The campaign and its folder; configurations are read from today's files, or from the folder when it
    /// was named.
    pub(super) fn open(&self) -> Result<(Configuration, Store), CliError> {
        let path = Path::new(&self.campaign);
        if path.is_dir() {
            let store = Store::at(path);
            return Ok((store.configuration().map_err(refused)?, store));
        }
        let spec: CampaignSpec =
            find("campaigns", &self.campaign).and_then(|source| source.parse()).map_err(usage)?;
        let folder = self.out.clone().unwrap_or_else(|| Path::new("campaigns").join(&spec.name));
        Ok((Configuration::load(spec).map_err(refused)?, Store::at(&folder)))
    }
}

fn usage(error: ConfigError) -> CliError {
    CliError::Usage(error.into())
}

/// A refused configuration is a usage error, everything else a failure.
pub(super) fn refused(error: CampaignError) -> CliError {
    match error {
        CampaignError::Config(error) => usage(error),
        CampaignError::Setup { .. } | CampaignError::Model { .. } | CampaignError::Foreign { .. } => {
            CliError::usage(error)
        }
        other => CliError::failed(other),
    }
}
