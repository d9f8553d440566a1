//! `stop`: brings the table of a running daemon to rest.

use super::client::Reach;
use super::{CliError, Outcome};

/// Bring the table of a running daemon to rest.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    reach: Reach,
}

/// Runs the subcommand.
///
/// # Errors
/// No daemon answers, or it refuses.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    // Every viewer may stop.
    let now = args.reach.client(false)?.post("/api/v1/session/stop", None)?;
    if args.reach.json {
        println!("{now}");
    } else {
        println!("{}", now["state"].as_str().unwrap_or("asked to stop"));
    }
    Ok(Outcome::Done)
}
