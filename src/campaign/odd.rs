//! Entries of a table of peaks that fit no smooth trend. [`super::diagnose`] leaves them out, the command line
//! points them out.

use super::fit::{Cell, Effort, Freedom, Problem};
use super::spec::Configuration;
use serde::Serialize;

/// Robust standard deviations beyond which an entry fits no trend.
const ODD: f64 = 4.0;

/// An entry that fits no trend.
#[derive(Clone, Debug, Serialize)]
pub struct Odd {
    /// `B3-G3-0.04`.
    pub case: String,
    /// `a_max`, `excursion` or `nu_r`.
    pub quantity: &'static str,
    /// ln(model / entry) of the robust fit over all bumpers.
    pub log_error: f64,
    /// The same in robust standard deviations.
    pub deviations: f64,
}

/// Entries that fit no smooth trend: a robust fit of the model to all cells, and what lies far beyond its own
/// scatter.
///
/// `freedom` should be the best that is known of the cells: what the model lacks is not to be found odd.
pub fn odd_entries(
    configuration: &Configuration,
    cells: &[Cell],
    freedom: Freedom,
    effort: Effort,
) -> Option<Vec<Odd>> {
    let mut problem = Problem::new(configuration, cells, freedom);
    problem.robust = true;
    let all: Vec<&Cell> = cells.iter().collect();
    let fit = problem.fit(&all, effort)?;
    let errors = problem.errors(&fit.x, &all)?;
    let mut odd = Vec::new();
    for (k, quantity) in ["a_max", "excursion", "nu_r"].into_iter().enumerate() {
        let values: Vec<f64> = errors.iter().map(|e| e.values()[k]).collect();
        let centre = median(values.clone());
        // 1.4826 times the median deviation is the standard deviation of a normal scatter.
        let spread = 1.4826 * median(values.iter().map(|v| (v - centre).abs()).collect());
        for (cell, value) in all.iter().zip(&values) {
            let deviations = (value - centre) / spread.max(0.02);
            if deviations.abs() > ODD {
                odd.push(Odd { case: cell.case.label.clone(), quantity, log_error: *value, deviations });
            }
        }
    }
    odd.sort_by(|a, b| b.deviations.abs().total_cmp(&a.deviations.abs()));
    Some(odd)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => 0.0,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
    }
}

/// The cells without the odd entries: those of a case whose amplitude is odd count for nothing.
pub fn without(cells: &[Cell], odd: &[Odd]) -> Vec<Cell> {
    let counted = |cell: &Cell| {
        let mut cell = cell.clone();
        for odd in odd.iter().filter(|odd| odd.case == cell.case.label) {
            match odd.quantity {
                "nu_r" => cell.counts[2] = false,
                _ => cell.counts = [false; 3],
            }
        }
        cell
    };
    cells.iter().map(counted).collect()
}
