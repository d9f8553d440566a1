//! The ladder of a diagnosis on peaks: one rung for everything that may be free, fitted to all cells and, gap by
//! gap, to all but those it is then judged on. [`super::diagnose`] climbs it.

use super::fit::{Cell, Effort, Fitted, Freedom, Problem, counted_rms};
use super::numbers::Number;
use super::peaks::LogError;
use super::spec::Configuration;
use crate::parallel;
use serde::Serialize;

/// Share of its prior width that a number's interval must stay below to count as tested.
const TESTED: f64 = 0.7;

/// How thoroughly to look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Depth {
    /// Of fits to all cells that are quoted.
    pub full: Effort,
    /// Of fits to all but one gap.
    pub held_out: Effort,
    /// Of the first look at every candidate.
    pub first: Effort,
    /// Candidates that are judged on gaps left out.
    pub finalists: usize,
    /// Threads.
    pub jobs: usize,
}

/// One rung of the ladder from the model as it stands.
#[derive(Clone, Debug, Serialize)]
pub struct Rung {
    /// What was free: `re-identified`, `coulomb-friction + peak-floor`.
    pub name: String,
    /// Numbers moved.
    pub numbers: usize,
    /// RMS of the logarithmic errors over the cells fitted to.
    pub rms: f64,
    /// The same over every gap while it was left out; `null` where nothing is fitted.
    pub held_out: Option<f64>,
    /// RMS of the errors of A_max, E_max and nu_R, ln.
    pub rms_of: [f64; 3],
    /// Mean errors of A_max, E_max and nu_R, ln.
    pub bias: [f64; 3],
    /// Values with 95 % intervals.
    pub parameters: Vec<Estimate>,
    /// What was free.
    #[serde(skip)]
    pub(super) freedom: Freedom,
    #[serde(skip)]
    pub(super) squares: Vec<f64>,
    /// Where the fit to all cells ended.
    #[serde(skip)]
    pub(super) x: Vec<f64>,
}

impl Rung {
    /// Its errors in one line.
    pub(super) fn line(&self) -> String {
        let held =
            self.held_out.map_or(String::new(), |held| format!(", gaps left out {:.1} %", 100.0 * held));
        format!("{}: {:.1} %{held}", self.name, 100.0 * self.rms)
    }
}

/// A number with its interval.
#[derive(Clone, Debug, Serialize)]
pub struct Estimate {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Best value.
    pub value: f64,
    /// 2.5 %.
    pub low95: f64,
    /// 97.5 %.
    pub high95: f64,
    /// The interval is far narrower than what was allowed; otherwise peaks say nothing about it.
    pub tested: bool,
}

/// Cells against a campaign's model.
pub(super) struct Study<'a> {
    pub(super) configuration: &'a Configuration,
    pub(super) cells: &'a [Cell],
    pub(super) scatter: [f64; 3],
    pub(super) depth: Depth,
}

impl Study<'_> {
    pub(super) fn problem(&self, freedom: Freedom) -> Problem<'_> {
        let mut problem = Problem::new(self.configuration, self.cells, freedom);
        problem.scatter = self.scatter;
        problem
    }

    /// Fits to all cells, and to all but one gap in turn.
    pub(super) fn rung(&self, freedom: Freedom) -> Option<Rung> {
        let whole = self.wholes(std::slice::from_ref(&freedom)).pop()??;
        self.rungs(&[(freedom, whole)]).pop()
    }

    /// Fits to all cells.
    pub(super) fn wholes(&self, freedoms: &[Freedom]) -> Vec<Option<Fitted>> {
        let all: Vec<&Cell> = self.cells.iter().collect();
        parallel::map(freedoms, self.depth.jobs, |freedom| {
            self.problem(freedom.clone()).fit(&all, self.depth.full)
        })
    }

    /// Rungs of fits to all cells: what they predict of each gap when they have not seen it.
    pub(super) fn rungs(&self, wholes: &[(Freedom, Fitted)]) -> Vec<Rung> {
        let gaps: Vec<usize> = (0..self.configuration.spec.gap.len())
            .filter(|gap| self.cells.iter().any(|cell| cell.case.gap == Some(*gap)))
            .collect();
        let jobs: Vec<(usize, usize)> =
            (0..wholes.len()).flat_map(|f| gaps.iter().map(move |gap| (f, *gap))).collect();
        let fits = parallel::map(&jobs, self.depth.jobs, |(f, left_out)| {
            let problem = self.problem(wholes[*f].0.clone());
            let cells: Vec<&Cell> =
                self.cells.iter().filter(|cell| cell.case.gap != Some(*left_out)).collect();
            problem.fit(&cells, self.depth.held_out)
        });
        let of = |(f, (freedom, whole)): (usize, &(Freedom, Fitted))| {
            let own: Vec<(usize, Option<&Fitted>)> = jobs
                .iter()
                .zip(&fits)
                .filter(|((g, _), _)| *g == f)
                .map(|((_, gap), fit)| (*gap, fit.as_ref()))
                .collect();
            self.assemble(freedom.clone(), whole, &own)
        };
        wholes.iter().enumerate().filter_map(of).collect()
    }

    fn assemble(&self, freedom: Freedom, whole: &Fitted, fits: &[(usize, Option<&Fitted>)]) -> Option<Rung> {
        let problem = self.problem(freedom.clone());
        let all: Vec<&Cell> = self.cells.iter().collect();
        let errors = problem.errors(&whole.x, &all)?;
        let (mut held, mut held_cells) = (Vec::new(), Vec::new());
        for (gap, fit) in fits {
            let test: Vec<&Cell> = self.cells.iter().filter(|cell| cell.case.gap == Some(*gap)).collect();
            held.extend(problem.errors(&(*fit)?.x, &test)?);
            held_cells.extend(test);
        }
        let moved = !problem.numbers.is_empty();
        Some(Rung {
            name: freedom.name(),
            numbers: problem.numbers.len(),
            rms: counted_rms(&errors, &all),
            held_out: (moved && !held.is_empty()).then(|| counted_rms(&held, &held_cells)),
            rms_of: of_each(&errors, &all, rms),
            bias: of_each(&errors, &all, |values| values.iter().sum::<f64>() / values.len().max(1) as f64),
            parameters: estimates(&problem, whole),
            freedom,
            squares: squares(&held, &held_cells),
            x: whole.x.clone(),
        })
    }
}

/// Fall of the mean square from `before` to `after`, in its standard errors over the same cells.
pub(super) fn paired(before: &[f64], after: &[f64]) -> f64 {
    let n = before.len().min(after.len()) as f64;
    if n < 2.0 {
        return 0.0;
    }
    let falls: Vec<f64> = before.iter().zip(after).map(|(b, a)| b - a).collect();
    let mean = falls.iter().sum::<f64>() / n;
    let variance = falls.iter().map(|f| (f - mean).powi(2)).sum::<f64>() / (n - 1.0);
    if variance > 0.0 { mean / (variance / n).sqrt() } else { 0.0 }
}

/// Squared errors that count.
fn squares(errors: &[LogError], cells: &[&Cell]) -> Vec<f64> {
    let of = |(error, cell): (&LogError, &&Cell)| error.values().into_iter().zip(cell.counts);
    errors.iter().zip(cells).flat_map(of).filter(|(_, counts)| *counts).map(|(e, _)| e * e).collect()
}

/// A function of the errors that count, of A_max, E_max and nu_R each.
fn of_each(errors: &[LogError], cells: &[&Cell], of: impl Fn(&[f64]) -> f64) -> [f64; 3] {
    std::array::from_fn(|k| {
        let counted = errors.iter().zip(cells).filter(|(_, cell)| cell.counts[k]);
        of(&counted.map(|(error, _)| error.values()[k]).collect::<Vec<f64>>())
    })
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

/// The numbers of a model. A stiffness is the product of its own factor and the common one; what tells whether it is
/// tested is its own.
fn estimates(problem: &Problem<'_>, fit: &Fitted) -> Vec<Estimate> {
    let common = problem.numbers.iter().position(Number::is_common);
    let one = |(i, number): (usize, &Number)| {
        let (mut x, mut variance) = (fit.x[i], fit.covariance[(i, i)]);
        if let Some(c) = common.filter(|_| number.is_stiffness()) {
            x += fit.x[c];
            variance += fit.covariance[(c, c)] + 2.0 * fit.covariance[(i, c)];
        }
        let reach = 1.96 * variance.max(0.0).sqrt();
        Estimate {
            name: number.name.replacen("base ", "", 1),
            unit: number.unit.clone(),
            value: number.value(x),
            low95: number.value(x - reach),
            high95: number.value(x + reach),
            tested: fit.sigma[i] < TESTED * number.free.prior.1,
        }
    };
    problem.numbers.iter().enumerate().map(one).collect()
}
