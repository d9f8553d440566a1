//! `shaketable identify`: re-fit a model's own numbers to a record.

use super::fitted::{print_errors, print_numbers, refuse_existing, refuse_unfit, write_model};
use super::reading::{ReadArgs, say_new};
use super::{CliError, Outcome};
use crate::diagnose::out_there::out_there;
use crate::diagnose::search::{Effort, Searcher};
use crate::identify::kinematics::Tolerances;
use crate::identify::motion::Motion;
use crate::identify::problem::Part;
use crate::identify::refit::FittedNumber;
use crate::identify::{holding, in_its_band};
use crate::record::mended::mended;
use std::path::PathBuf;

/// Re-fit the parameters of a model to a record.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    read: ReadArgs,
    /// Model file, or the name of a model that comes with the program.
    #[arg(long)]
    model: String,
    /// Where to write the re-fitted model.
    #[arg(short, long)]
    output: Option<PathBuf>,
    /// Replace the output if it exists.
    #[arg(long, requires = "output")]
    force: bool,
    /// Fit to a record that is too short, saturated, of wrong sign or unit, ... all the same.
    #[arg(long)]
    anyway: bool,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// Re-fits.
///
/// # Errors
/// A record or model that cannot be read, or does not go together; an output that exists or cannot be
/// written.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    if let Some(output) = &args.output {
        refuse_existing(output, args.force)?;
    }
    let nominal = super::reading::read_model(&args.model)?;
    let opened = args.read.open()?;
    let record = mended(&opened);
    refuse_unfit(&record, &nominal, args.anyway)?;
    let record = in_its_band(record);
    say_new(&record.notes, &opened);
    let nominal = holding(&nominal, [&*record]);
    let motion = Motion::of(&record, nominal.mass_kg, Tolerances::default()).map_err(CliError::failed)?;
    let searcher = Searcher::new(&motion, &nominal, Effort::default());
    let Some(trial) = searcher.base(&nominal) else {
        return Err(CliError::failed(format!(
            "the model `{}` gives no finite response to this record",
            nominal.name
        )));
    };
    let trial = out_there(&record, &motion, &nominal, searcher.bounded(trial));
    let before = searcher.problem().output_error(&nominal, 0.0, Part::HeldOut).map(|e| e.nrmse());
    let after = searcher.held_out_error(&trial);
    let floor = after.map(|e| e.noise_floor(&motion));
    let numbers = trial.refit.fitted(&nominal);
    if let Some(path) = &args.output {
        write_model(&trial.refit.spec, path)?;
    }
    let after = after.map(|e| e.nrmse());
    if args.json {
        let told = |number: FittedNumber| {
            let FittedNumber { key, nominal, value, low95, high95, at_limit } = number;
            let told = serde_json::json!({
                "nominal": nominal, "value": value, "low95": low95, "high95": high95, "at_limit": at_limit,
            });
            (key, told)
        };
        let parameters: serde_json::Map<_, _> = numbers.into_iter().map(told).collect();
        let out = serde_json::json!({
            "parameters": parameters,
            "error_before": before,
            "error_after": after,
            "noise_floor": floor,
            "model": trial.refit.spec,
            "notes": record.notes,
        });
        println!("{out}");
    } else {
        print_numbers(&numbers);
        print_errors(&[("as given", before), ("re-fitted", after), ("noise floor", floor)]);
    }
    Ok(Outcome::Done)
}
