//! What `identify`, `effect` and `diagnose` fit, how the first two print what they found, and the model files that all three write.

use super::CliError;
use crate::config::Check;
use crate::diagnose::{DiagnoseError, fitness};
use crate::identify::refit::FittedNumber;
use crate::model::ModelSpec;
use crate::record::Record;
use std::path::Path;

/// Refuses to fit a model to a record, its faults mended, that is not fit for it, unless it is to be used anyway.
///
/// # Errors
/// [`CliError::Failed`] with what is wrong, and what to do.
pub fn refuse_unfit(record: &Record, model: &ModelSpec, anyway: bool) -> Result<(), CliError> {
    fitness(record, model, anyway).map(drop).map_err(failed)
}

/// A diagnosis that failed; of a record that is not fit for it, with what to do.
pub fn failed(error: DiagnoseError) -> CliError {
    match error {
        DiagnoseError::Unfit { .. } => CliError::failed(format!(
            "{error}; if it was read wrongly, name its columns with their sign and unit (`--map`); --anyway shows what comes of it as it is"
        )),
        error => CliError::failed(error),
    }
}

/// Refuses to replace a file, unless that is wanted.
///
/// # Errors
/// [`CliError::Usage`] that names it.
pub fn refuse_existing(output: &Path, force: bool) -> Result<(), CliError> {
    if output.exists() && !force {
        return Err(CliError::usage(format!("{} exists; `--force` replaces it", output.display())));
    }
    Ok(())
}

/// Refuses a model that there cannot be.
///
/// # Errors
/// [`CliError::Usage`] with the number that is wrong.
pub fn refuse_invalid(model: &ModelSpec) -> Result<(), CliError> {
    model.check().map_err(|(key, reason)| CliError::usage(format!("{key}: {reason}")))
}

/// Writes a model file, and says so.
///
/// # Errors
/// As of [`refuse_invalid`]; a file that cannot be written.
pub fn write_model(model: &ModelSpec, output: &Path) -> Result<(), CliError> {
    refuse_invalid(model)?;
    let text = toml::to_string(model).map_err(CliError::failed)?;
    std::fs::write(output, text)
        .map_err(|error| CliError::failed(format!("cannot write {}: {error}", output.display())))?;
    eprintln!("wrote {}", output.display());
    Ok(())
}

/// One line for each number.
pub fn print_numbers(numbers: &[FittedNumber]) {
    for number in numbers {
        let (FittedNumber { key, nominal, value, low95, high95, .. }, remark) = (number, number.remark());
        println!("{key:<28} {nominal:>14.6} -> {value:>14.6}  (95 %: {low95:.6} to {high95:.6}{remark})");
    }
}

/// Errors of the held-out steps, those that are known, each behind its name.
pub fn print_errors(errors: &[(&str, Option<f64>)]) {
    let told = errors.iter().filter_map(|(name, error)| Some(format!("{name} {:.3} %", 100.0 * (*error)?)));
    let told: Vec<_> = told.collect();
    if !told.is_empty() {
        println!("held-out error: {}", told.join(", "));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::testing::imposed;
    use crate::model::testing::b1_g2;

    #[test]
    fn a_record_of_the_wrong_sign_is_fitted_to_only_when_asked_for() {
        let model = ModelSpec { bumper: None, ..b1_g2() };
        let mut record = imposed(&model, 7);
        assert!(refuse_unfit(&record, &model, false).is_ok());
        record.force_n.iter_mut().for_each(|force| *force = -*force);
        let refused = refuse_unfit(&record, &model, false).expect_err("turned").to_string();
        assert!(refused.contains("wrong sign") && refused.contains("--anyway"), "{refused}");
        assert!(refuse_unfit(&record, &model, true).is_ok());
    }
}
