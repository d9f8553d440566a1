//! What a fit found, as `identify` and `effect add` print it.

use crate::identify::refit::FittedNumber;

/// One line for each number.
pub fn print_numbers(numbers: &[FittedNumber]) {
    for FittedNumber { key, nominal, value, low95, high95 } in numbers {
        println!("{key:<28} {nominal:>14.6} -> {value:>14.6}  (95 %: {low95:.6} to {high95:.6})");
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
