//! `watch`: follows a running daemon until its run has ended.

use super::client::{Reach, lines, progress};
use super::{CliError, Outcome};
use serde_json::Value;
use std::io::{IsTerminal, Write};
use std::time::Duration;

/// How often the status is asked for.
const EVERY: Duration = Duration::from_millis(500);
/// How often a sign of life is sent: several times within the silence that a safety file allows.
const BEAT: Duration = Duration::from_millis(250);

/// Follow a running daemon until its run has ended.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Follow on after the run has ended.
    #[arg(long)]
    forever: bool,
    /// Be the operator's link: send a sign of life four times a second as long as this runs, between runs too. A daemon whose
    /// safety file asks for that link stops the table when it ends.
    #[arg(long)]
    heartbeat: bool,
    #[command(flatten)]
    reach: Reach,
}

/// Runs the subcommand. With `--json` a line is a status.
///
/// # Errors
/// No daemon answers, or it refuses; a run that failed.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    let client = args.reach.client(args.heartbeat)?;
    let mut told = false;
    let terminal = std::io::stderr().is_terminal() && !args.reach.json;
    loop {
        if args.heartbeat {
            let heard = client.post("/api/v1/session/alive", None)?;
            if !std::mem::replace(&mut told, true) && heard["watched"] == false {
                eprintln!("this daemon's safety file watches no operator's link (supervision.operator_link)");
            }
        }
        let status = client.get("/api/v1/status")?;
        if args.reach.json {
            println!("{status}");
        } else if status["run"].is_object() {
            let (begin, end) = if terminal { ("\r\x1b[2K", "") } else { ("", "\n") };
            eprint!("{begin}{}{end}", progress(&status));
            std::io::stderr().flush().map_err(CliError::failed)?;
        }
        if !status["run"].is_object() && !args.forever && !args.heartbeat {
            if !args.reach.json {
                eprintln!();
                print!("{}", lines(&status));
            }
            return ended(&status);
        }
        std::thread::sleep(if args.heartbeat { BEAT } else { EVERY });
    }
}

fn ended(status: &Value) -> Result<Outcome, CliError> {
    match (status["state"].as_str(), status["cause"]["detector"].as_str()) {
        (Some("aborted"), Some("failure")) => {
            Err(CliError::failed(status["cause"]["text"].as_str().unwrap_or("the run failed")))
        }
        (Some("aborted"), _) => Ok(Outcome::Aborted),
        _ => Ok(Outcome::Done),
    }
}
