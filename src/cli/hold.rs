//! `hold`: keeps the sweep of a running daemon in its step, or lets it go on.

use super::client::Reach;
use super::{CliError, Outcome};

/// Keep the sweep of a running daemon in its present step, or let it go on.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Let the sweep go on.
    #[arg(long)]
    resume: bool,
    #[command(flatten)]
    reach: Reach,
}

/// Runs the subcommand.
///
/// # Errors
/// No daemon answers, or it refuses.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    let path = if args.resume { "/api/v1/session/resume" } else { "/api/v1/session/hold" };
    let now = args.reach.client(true)?.post(path, None)?;
    if args.reach.json {
        println!("{now}");
    } else {
        println!("{}", now["state"].as_str().unwrap_or("asked"));
    }
    Ok(Outcome::Done)
}
