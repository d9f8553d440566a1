//! `status`: how the bench of a running daemon stands.

use super::client::{Reach, lines};
use super::{CliError, Outcome};

/// Show how the bench of a running daemon stands.
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
    let status = args.reach.client(false)?.get("/api/v1/status")?;
    if args.reach.json {
        println!("{status}");
    } else {
        print!("{}", lines(&status));
    }
    Ok(Outcome::Done)
}
