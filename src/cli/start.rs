//! `start`: checks, arms and starts what is set up in a running daemon.

use super::client::Reach;
use super::{CliError, Outcome};
use serde_json::{Value, json};
use std::io::{BufRead, IsTerminal, Write};

/// Check, arm and start what is set up in a running daemon.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Do not ask: whoever calls this confirms zeros and noise.
    #[arg(long)]
    confirm: bool,
    #[command(flatten)]
    reach: Reach,
}

/// Runs the subcommand.
///
/// # Errors
/// No daemon answers, it refuses, the checks fail, or nobody confirms them.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    let client = args.reach.client(true)?;
    let checked = client.post("/api/v1/session/pre-flight", None)?;
    show(&checked);
    if checked["passed"] != json!(true) {
        return Err(CliError::failed("the checks before the run have not passed"));
    }
    if !args.confirm && !confirmed()? {
        client.post("/api/v1/session/disarm", None)?;
        return Err(CliError::failed("not confirmed: nothing was started"));
    }
    client.post("/api/v1/session/arm", Some(&json!({ "pre_flight": checked["id"] })))?;
    let started = client.post("/api/v1/session/start", None)?;
    if args.reach.json {
        println!("{started}");
    } else {
        println!("started {}", started["id"].as_str().unwrap_or_default());
    }
    Ok(Outcome::Done)
}

fn show(checked: &Value) {
    let list = |key: &str| checked[key].as_array().cloned().unwrap_or_default();
    for line in list("lines") {
        let mark = if line["ok"] == json!(true) { "ok" } else { "NOT OK" };
        let text = |key: &str| line[key].as_str().unwrap_or_default().to_owned();
        eprintln!("{mark:<7} {:<32} {}", text("name"), text("found"));
    }
    for channel in list("channels") {
        eprintln!(
            "        {:<24} zero {:>10.3e} {:<4}  noise {:>9.2e} {2}",
            channel["channel"].as_str().unwrap_or_default(),
            channel["zero"].as_f64().unwrap_or(f64::NAN),
            channel["unit"].as_str().unwrap_or_default(),
            channel["noise"].as_f64().unwrap_or(f64::NAN),
        );
    }
}

fn confirmed() -> Result<bool, CliError> {
    if !std::io::stdin().is_terminal() {
        return Err(CliError::usage("nobody is there to confirm zeros and noise; --confirm does"));
    }
    eprint!("Are these zeros and this noise right, and is nobody near the table? [y/N] ");
    std::io::stderr().flush().map_err(CliError::failed)?;
    let mut answer = String::new();
    std::io::stdin().lock().read_line(&mut answer).map_err(CliError::failed)?;
    Ok(matches!(answer.trim(), "y" | "Y" | "yes"))
}
