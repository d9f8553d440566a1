//! `shaketable diagnose`: what is missing from the model, and the next test.

use super::reading::ReadArgs;
use super::{CliError, Outcome};
use crate::diagnose::{Options, diagnose};

/// Find out which physical effect a model lacks, from a record.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    read: ReadArgs,
    /// Model file, or the name of a model that comes with the program.
    #[arg(long)]
    model: String,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// Diagnoses.
///
/// # Errors
/// A record or model that cannot be read, or does not go together.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    let model = super::effect::read_model(&args.model)?;
    let record = args.read.open()?;
    let answer = diagnose(&record, &model, &Options::default()).map_err(CliError::failed)?;
    if args.json {
        let text = serde_json::to_string(&answer).map_err(CliError::failed)?;
        println!("{text}");
    } else {
        print!("{}", answer.text());
    }
    Ok(Outcome::Done)
}
