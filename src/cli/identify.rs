//! `shaketable identify`: re-fit a model's own numbers to a record.

use super::reading::{ReadArgs, say_new};
use super::{CliError, Outcome};
use crate::diagnose::out_there::out_there;
use crate::diagnose::search::{Effort, Searcher};
use crate::identify::kinematics::Tolerances;
use crate::identify::motion::Motion;
use crate::identify::problem::Part;
use crate::identify::readied;
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
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// Re-fits.
///
/// # Errors
/// A record or model that cannot be read, or does not go together; an output that cannot be
/// written.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    let nominal = super::reading::read_model(&args.model)?;
    let opened = args.read.open()?;
    let record = readied(&opened);
    say_new(&record.notes, &opened);
    let motion = Motion::of(&record, nominal.mass_kg, Tolerances::default()).map_err(CliError::failed)?;
    let searcher = Searcher::new(&motion, &nominal, Effort::default());
    let Some(trial) = searcher.base(&nominal) else {
        return Err(CliError::failed(format!(
            "the model `{}` gives no finite response to this record",
            nominal.name
        )));
    };
    let trial = out_there(&record, &nominal, trial);
    let before = searcher.problem().output_error(&nominal, 0.0, Part::HeldOut).map(|e| e.nrmse());
    let after = searcher.held_out_error(&trial);
    let floor = after.map(|e| e.noise_floor(&motion));
    let rows: Vec<(String, f64, f64, f64, f64)> = trial
        .refit
        .numbers
        .numbers
        .iter()
        .filter_map(|n| {
            let (value, low, high) = trial.refit.interval(&n.key)?;
            Some((n.key.clone(), nominal.get(&n.key).ok()?, value, low, high))
        })
        .collect();
    if let Some(path) = &args.output {
        let text = toml::to_string(&trial.refit.spec).map_err(CliError::failed)?;
        std::fs::write(path, text).map_err(|e| CliError::failed(format!("{}: {e}", path.display())))?;
    }
    if args.json {
        let parameters: serde_json::Map<String, serde_json::Value> = rows
            .iter()
            .map(|(key, nominal, value, low, high)| {
                (
                    key.clone(),
                    serde_json::json!({"nominal": nominal, "value": value, "low95": low, "high95": high}),
                )
            })
            .collect();
        let out = serde_json::json!({
            "parameters": parameters,
            "error_before": before,
            "error_after": after.map(|e| e.nrmse()),
            "noise_floor": floor,
            "model": trial.refit.spec,
            "notes": record.notes,
        });
        println!("{out}");
    } else {
        for (key, nominal, value, low, high) in &rows {
            println!("{key:<28} {nominal:>14.6} -> {value:>14.6}  (95 %: {low:.6} to {high:.6})");
        }
        println!(
            "held-out error {:.3} % -> {:.3} %, noise floor {:.3} %",
            100.0 * before.unwrap_or(f64::NAN),
            100.0 * after.map_or(f64::NAN, |e| e.nrmse()),
            100.0 * floor.unwrap_or(f64::NAN)
        );
    }
    Ok(Outcome::Done)
}
