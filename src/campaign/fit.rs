//! Fitting a model to the peaks of all cells at once: what may move, how a cell is predicted, where a fit
//! ends. [`super::diagnose`] and [`super::optimise`] call it.
//!
//! A fit looks at the steps about an observed peak alone, for as many cycles as they need to settle; what is
//! quoted comes from the whole sweep.

use super::ideal::{self, Settings};
pub use super::numbers::Correction;
use super::numbers::{self, Number};
use super::peaks::{LogError, Peaks};
use super::spec::{CaseKey, Configuration, mount};
use crate::identify::least_squares::{self, Free};
use crate::model::effects;
use crate::model::{EffectSpec, ModelSpec};
use crate::sweep::{Direction, Step};
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

/// Errors beyond so many standard deviations lose their pull in a robust fit.
const ROBUST: f64 = 2.5;

/// One cell: a case and what was observed.
#[derive(Clone, Debug)]
pub struct Cell {
    /// The case.
    pub case: CaseKey,
    /// Observed peaks.
    pub observed: Peaks,
    /// Which of A_max, E_max and nu_R count.
    pub counts: [bool; 3],
    near: Vec<Step>,
    all: Vec<Step>,
}

/// What a fit may move.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Freedom {
    /// One factor on all stiffnesses, and nothing else.
    pub common_stiffness: bool,
    /// Nothing of the base model.
    pub fixed: bool,
    /// Effects added.
    pub effects: Vec<&'static str>,
    /// Corrections of the observation.
    pub corrections: Vec<Correction>,
}

impl Freedom {
    /// `coulomb-friction + peak-floor`, or what is moved without either.
    pub fn name(&self) -> String {
        let parts: Vec<&str> =
            self.effects.iter().copied().chain(self.corrections.iter().map(|c| c.name())).collect();
        match (parts.is_empty(), self.fixed, self.common_stiffness) {
            (false, _, _) => parts.join(" + "),
            (_, true, _) => "as it stands".to_owned(),
            (_, _, true) => "one factor on all stiffnesses".to_owned(),
            _ => "re-identified".to_owned(),
        }
    }
}

/// A model with free numbers, against cells.
pub struct Problem<'a> {
    configuration: &'a Configuration,
    freedom: Freedom,
    /// The free numbers.
    pub numbers: Vec<Number>,
    /// How peaks are computed while a fit is looking.
    pub swift: Settings,
    /// How the peaks that are quoted are computed.
    pub precise: Settings,
    /// Scatter of A_max, E_max and nu_R (logarithms) that residuals are measured in.
    pub scatter: [f64; 3],
    /// Errors far beyond the scatter lose their pull.
    pub robust: bool,
}

/// Where a fit ended.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// Values of the fit, in the order of the numbers.
    pub x: Vec<f64>,
    /// Standard deviations of the same.
    pub sigma: Vec<f64>,
    /// Their covariance, numbers by numbers.
    pub covariance: DMatrix<f64>,
    /// RMS of the logarithmic errors over the cells it was fitted to.
    pub rms: f64,
    /// What was minimised.
    pub cost: f64,
}

/// Cells of a set of peaks; cases without are left out.
pub fn cells(configuration: &Configuration, peaks: &[super::peaks::CasePeaks]) -> Vec<Cell> {
    let steps = |case: &CaseKey, low: f64, high: f64| -> Vec<Step> {
        let all = ideal::steps_of(&configuration.sweep, case.acceleration_g, (low, high));
        all.into_iter().filter(|step| step.direction == Direction::Forward).collect()
    };
    let cell = |(case, peaks): (&CaseKey, &super::peaks::CasePeaks)| {
        let observed = peaks.forward?;
        let hz = observed.nu_r * configuration.spec.reference_hz;
        let near = steps(case, 0.7 * hz, 1.35 * hz + 0.1);
        Some(Cell {
            case: case.clone(),
            observed,
            counts: [true; 3],
            near,
            all: steps(case, 0.0, f64::INFINITY),
        })
    };
    configuration.cases.iter().zip(peaks).filter_map(cell).collect()
}

impl<'a> Problem<'a> {
    /// The campaign's model with this freedom, for the bumpers of the cells.
    pub fn new(configuration: &'a Configuration, cells: &[Cell], freedom: Freedom) -> Self {
        let mut free = Vec::new();
        if freedom.common_stiffness {
            free.push(numbers::factor("factor on all stiffnesses", "1", 1.0, 2.0));
        } else if !freedom.fixed {
            numbers::base_numbers(configuration, cells, &mut free);
        }
        let scales = numbers::scales(configuration, cells);
        for name in &freedom.effects {
            let Ok(effect) = effects::find(name) else { continue };
            let own = numbers::effect_parameters(effect, &scales);
            free.extend(own.iter().map(|p| numbers::effect_number(name, p)));
        }
        let reference_hz = configuration.spec.reference_hz;
        for correction in &freedom.corrections {
            let mut number = correction.number(correction.name(), reference_hz);
            number.name = format!("{} {}", correction.name(), number.name);
            free.push(number);
        }
        Self {
            configuration,
            freedom,
            numbers: free,
            swift: Settings { tolerance: 1e-4, cycles: 6, counted: 2.0 },
            precise: Settings::default(),
            scatter: [0.08; 3],
            robust: false,
        }
    }

    /// The model of a case with the values of the fit put in.
    pub fn model(&self, x: &[f64], case: &CaseKey) -> ModelSpec {
        let mut model = self.configuration.model.clone();
        let mut bumper = self.configuration.bumper_of(case);
        let name = &self.configuration.spec.bumper[case.bumper].name;
        let mut added: Vec<EffectSpec> = self
            .freedom
            .effects
            .iter()
            .map(|name| EffectSpec {
                name: (*name).to_owned(),
                expression: None,
                parameters: Default::default(),
            })
            .collect();
        for (number, x) in self.numbers.iter().zip(x) {
            let value = number.value(*x);
            let key = number.free.key.as_str();
            if key == "common" {
                model.isolator.stiffness_n_m.iter_mut().for_each(|k| *k *= value);
                bumper.iter_mut().for_each(|bumper| bumper.stiffness_n_m *= value);
            } else if let Some(key) = key.strip_prefix("base ") {
                // Keys were made from this very model.
                let _ = model.set(key, value);
            } else if let Some((owner, what)) =
                key.strip_prefix("bumper ").and_then(|rest| rest.split_once(' '))
            {
                if let Some(bumper) = bumper.as_mut().filter(|_| owner == name) {
                    match what {
                        "stiffness_n_m" => bumper.stiffness_n_m = value,
                        _ => bumper.damping_n_s_m = value,
                    }
                }
            } else if let Some((owner, what)) =
                key.strip_prefix("effect ").and_then(|rest| rest.split_once(' '))
                && let Some(effect) = added.iter_mut().find(|effect| effect.name == owner)
            {
                effect.parameters.insert(what.to_owned(), value);
            }
        }
        model.effects.extend(added);
        mount(&mut model, bumper);
        model
    }

    /// Predicted peaks of a cell over all steps and cycles, corrections of the observation included.
    pub fn predict(&self, x: &[f64], cell: &Cell) -> Option<Peaks> {
        let model = self.model(x, &cell.case);
        self.corrected(x, self.peaks(&model, &cell.all, &self.precise)?)
    }

    /// [`Problem::predict`] from short steps about the observed peak.
    fn glimpse(&self, x: &[f64], cell: &Cell) -> Option<Peaks> {
        let model = self.model(x, &cell.case);
        let reference_hz = self.configuration.spec.reference_hz;
        let inside = |peaks: &Peaks| {
            let hz = peaks.nu_r * reference_hz;
            let edge = |step: Option<&Step>| step.is_some_and(|step| (step.frequency_hz - hz).abs() < 1e-9);
            !edge(cell.near.first()) && !edge(cell.near.last())
        };
        // A peak at the border of the steps about the observed one lies elsewhere.
        let peaks = match self.peaks(&model, &cell.near, &self.swift).filter(inside) {
            Some(peaks) => peaks,
            None => self.peaks(&model, &cell.all, &self.swift)?,
        };
        self.corrected(x, peaks)
    }

    fn peaks(&self, model: &ModelSpec, steps: &[Step], settings: &Settings) -> Option<Peaks> {
        let states = ideal::steady_states(model, steps, settings).ok()?;
        ideal::peaks(&states, Direction::Forward, self.configuration.resonance())
    }

    fn corrected(&self, x: &[f64], mut peaks: Peaks) -> Option<Peaks> {
        for (number, x) in self.numbers.iter().zip(x) {
            let value = number.value(*x);
            match number.free.key.as_str() {
                "acceleration-gain" => peaks.a_max_m_s2 *= value,
                "peak-floor" => peaks.a_max_m_s2 += value,
                "reference-frequency" => peaks.nu_r *= self.configuration.spec.reference_hz / value,
                _ => {}
            }
        }
        Some(peaks)
    }

    /// Logarithmic errors of all cells, prediction over observation; `None` where a model cannot be solved.
    pub fn errors(&self, x: &[f64], cells: &[&Cell]) -> Option<Vec<LogError>> {
        self.errors_by(cells, |cell| self.predict(x, cell))
    }

    fn errors_by(&self, cells: &[&Cell], predict: impl Fn(&Cell) -> Option<Peaks>) -> Option<Vec<LogError>> {
        let error = |cell: &&Cell| Some(LogError::of(&predict(cell)?, &cell.observed));
        let errors: Option<Vec<LogError>> = cells.iter().map(error).collect();
        errors.filter(|errors| errors.iter().all(|e| e.values().iter().all(|v| v.is_finite())))
    }

    fn residuals(&self, x: &[f64], cells: &[&Cell], r: &mut Vec<f64>) -> bool {
        let Some(errors) = self.errors_by(cells, |cell| self.glimpse(x, cell)) else { return false };
        r.clear();
        for (error, cell) in errors.iter().zip(cells) {
            for ((value, scatter), counts) in error.values().iter().zip(self.scatter).zip(cell.counts) {
                let z = if counts { value / scatter } else { 0.0 };
                r.push(if self.robust { ROBUST * (z / ROBUST).atan() } else { z });
            }
        }
        true
    }

    /// What a fit minimises, without the priors: squares in units of the scatter, as it sees them on its way.
    pub fn cost(&self, x: &[f64], cells: &[&Cell]) -> f64 {
        let mut r = Vec::new();
        if self.residuals(x, cells, &mut r) { least_squares::sum_of_squares(&r) } else { f64::INFINITY }
    }

    /// Where every fit starts: the campaign's model, effects at their starting values.
    pub fn start(&self) -> Vec<f64> {
        self.numbers.iter().map(|number| number.free.start).collect()
    }

    /// Fits to cells, cold: a coarse look at the stiffnesses together, the isolator's damping and the strength of
    /// the first effect; from the best of it damped Gauss-Newton on everything, with differences wide enough to
    /// see through the steps of the sweep; then a random search over what they hide.
    pub fn fit(&self, cells: &[&Cell], effort: Effort) -> Option<Fitted> {
        let best_look = |looks: Vec<Vec<f64>>| {
            let looked = looks.into_iter().map(|x| (self.cost(&x, cells), x));
            looked.min_by(|a, b| a.0.total_cmp(&b.0))
        };
        let mut looks: Vec<(f64, Vec<f64>)> = self.looks().into_iter().filter_map(best_look).collect();
        looks.sort_by(|a, b| a.0.total_cmp(&b.0));
        let starts = looks.into_iter().take(effort.starts.max(1));
        // What Gauss-Newton leaves says little about what is hidden there: each end is searched for a while.
        let brief = Effort { trials: if effort.starts > 1 { effort.trials / 4 } else { 0 }, ..effort };
        let ends =
            starts.filter_map(|(_, x)| self.search_from(cells, self.descend(cells, x, effort)?, brief));
        let best = ends.min_by(|a, b| a.1.total_cmp(&b.1))?;
        self.finish(cells, best.0, effort)
    }

    /// Starts worth a look, in groups of which the best each is worth a descent: a dry loss takes the place of
    /// viscous damping, so that effects are tried at several sizes and without one the damping is.
    fn looks(&self) -> Vec<Vec<Vec<f64>>> {
        let strength = self.numbers.iter().position(|n| n.free.key.starts_with("effect ") && n.is_factor());
        let any = |part: &str| self.numbers.iter().any(|number| number.free.key.contains(part));
        let stiff: &[f64] =
            if any("stiffness") || any("common") { &[-0.3, 0.0, 0.3, 0.6, 0.9] } else { &[0.0] };
        let damping: &[f64] = if any("isolator.damping") { &[-1.4, -0.7, 0.0] } else { &[0.0] };
        let at = |k: f64, c: f64, size: f64| -> Vec<f64> {
            let place = |(i, number): (usize, &Number)| {
                let key = number.free.key.as_str();
                let x = if number.is_stiffness() {
                    k
                } else if key.contains("isolator.damping") {
                    c
                } else if Some(i) == strength {
                    size
                } else {
                    number.free.start
                };
                x.clamp(number.free.bounds.0, number.free.bounds.1)
            };
            self.numbers.iter().enumerate().map(place).collect()
        };
        let sizes = |size: f64| damping.iter().flat_map(|c| stiff.iter().map(|k| at(*k, *c, size))).collect();
        match strength {
            Some(_) => [0.0, 1.0, 2.0].map(sizes).into(),
            None => damping.iter().map(|c| stiff.iter().map(|k| at(*k, *c, 0.0)).collect()).collect(),
        }
    }

    fn free_from(&self, start: Vec<f64>) -> Vec<Free> {
        let with_start = |(number, x): (&Number, f64)| Free { start: x, ..number.free.clone() };
        self.numbers.iter().zip(start).map(with_start).collect()
    }

    fn settings(effort: Effort) -> least_squares::Settings {
        least_squares::Settings {
            iterations: effort.iterations,
            tolerance: 1e-3,
            difference: effort.difference,
        }
    }

    /// Where Gauss-Newton comes to from a start, and what it leaves.
    fn descend(&self, cells: &[&Cell], start: Vec<f64>, effort: Effort) -> Option<Vec<f64>> {
        let free = self.free_from(start);
        let mut residuals = |x: &[f64], r: &mut Vec<f64>| self.residuals(x, cells, r);
        least_squares::fit(&free, Self::settings(effort), &mut residuals).map(|fit| fit.values)
    }

    /// The random search about a place: where it ends, and what is left there.
    fn search_from(&self, cells: &[&Cell], start: Vec<f64>, effort: Effort) -> Option<(Vec<f64>, f64)> {
        let covariance = self.covariance(cells, &start, effort)?;
        let free = self.free_from(start.clone());
        let mut residuals = |x: &[f64], r: &mut Vec<f64>| self.residuals(x, cells, r);
        Some(search(&free, start, &covariance, effort.trials, &mut residuals))
    }

    /// Covariance of the numbers at a place.
    fn covariance(&self, cells: &[&Cell], x: &[f64], effort: Effort) -> Option<DMatrix<f64>> {
        let free = self.free_from(x.to_vec());
        let mut residuals = |x: &[f64], r: &mut Vec<f64>| self.residuals(x, cells, r);
        let still = least_squares::Settings { iterations: 0, ..Self::settings(effort) };
        Some(least_squares::fit(&free, still, &mut residuals)?.covariance(&free, 1.0))
    }

    /// The random search from a place, and the spread of the numbers where it ends.
    fn finish(&self, cells: &[&Cell], start: Vec<f64>, effort: Effort) -> Option<Fitted> {
        let (x, cost) = self.search_from(cells, start, effort)?;
        let covariance = self.covariance(cells, &x, effort)?;
        let sigma = (0..x.len()).map(|i| covariance[(i, i)].max(0.0).sqrt()).collect();
        let rms = self.rms(&x, cells)?;
        Some(Fitted { x, sigma, covariance, rms, cost })
    }

    /// [`Problem::fit`] from a start of one's own.
    pub fn fit_from(&self, cells: &[&Cell], start: Vec<f64>, effort: Effort) -> Option<Fitted> {
        self.finish(cells, self.descend(cells, start, effort)?, effort)
    }

    /// RMS of the logarithmic errors that count.
    pub fn rms(&self, x: &[f64], cells: &[&Cell]) -> Option<f64> {
        Some(counted_rms(&self.errors(x, cells)?, cells))
    }
}

/// Random trials about a start, at first as wide in every direction as the fit leaves it open, then as what
/// succeeds teaches: they see what the steps of the sweep hide from slopes. The (1+1) strategy with adapted
/// covariance of C. Igel, T. Suttorp and N. Hansen, GECCO 2006, 453.
fn search(
    free: &[Free],
    start: Vec<f64>,
    covariance: &DMatrix<f64>,
    trials: usize,
    residuals: &mut impl FnMut(&[f64], &mut Vec<f64>) -> bool,
) -> (Vec<f64>, f64) {
    let n = free.len();
    let mut r = Vec::new();
    let mut cost = |x: &[f64]| -> f64 {
        if !residuals(x, &mut r) {
            return f64::INFINITY;
        }
        let prior = |(free, x): (&Free, &f64)| ((x - free.prior.0) / free.prior.1).powi(2);
        least_squares::sum_of_squares(&r) + free.iter().zip(x).map(prior).sum::<f64>()
    };
    let mut best = start;
    let mut least = cost(&best);
    if n == 0 {
        return (best, least);
    }
    let size = n as f64;
    let (wanted, memory, damping) = (2.0 / 11.0, 1.0 / 12.0, 1.0 + 0.5 * size);
    let (path_rate, rate) = (2.0 / (size + 2.0), 2.0 / (size * size + 6.0));
    let mut shape = covariance.clone();
    let mut root = root_of(&shape);
    let (mut success, mut reach, mut path) = (wanted, 0.5, DVector::zeros(n));
    let mut random = rand_pcg::Pcg64::seed_from_u64(20_200_608);
    for _ in 0..trials {
        let step = &root * DVector::from_fn(n, |_, _| StandardNormal.sample(&mut random));
        let moved =
            |((free, x), step): ((&Free, &f64), &f64)| (x + reach * step).clamp(free.bounds.0, free.bounds.1);
        let trial: Vec<f64> = free.iter().zip(&best).zip(step.iter()).map(moved).collect();
        let value = cost(&trial);
        let better = value < least;
        success = (1.0 - memory) * success + if better { memory } else { 0.0 };
        reach *= ((success - wanted) / (damping * (1.0 - wanted))).exp();
        if !better {
            continue;
        }
        (best, least) = (trial, value);
        path *= 1.0 - path_rate;
        let mut kept = 1.0 - rate;
        if success < 0.44 {
            path += f64::sqrt(path_rate * (2.0 - path_rate)) * step;
        } else {
            kept += rate * path_rate * (2.0 - path_rate);
        }
        shape = kept * shape + rate * &path * path.transpose();
        root = root_of(&shape);
    }
    (best, least)
}

/// A root of a covariance; of its diagonal where rounding has made it none.
fn root_of(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    covariance.clone().cholesky().map_or_else(
        || DMatrix::from_diagonal(&covariance.diagonal().map(|v| v.max(0.0).sqrt())),
        |cholesky| cholesky.l(),
    )
}

/// RMS of the errors that count.
pub fn counted_rms(errors: &[LogError], cells: &[&Cell]) -> f64 {
    let values = errors.iter().zip(cells).flat_map(|(error, cell)| {
        error.values().into_iter().zip(cell.counts).filter(|(_, counts)| *counts).map(|(value, _)| value)
    });
    let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + value * value, count + 1));
    (sum / count.max(1) as f64).sqrt()
}

/// How long a fit may look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effort {
    /// Gauss-Newton steps.
    pub iterations: usize,
    /// Difference of its slopes, in logarithms of factors.
    pub difference: f64,
    /// Random trials afterwards.
    pub trials: usize,
    /// Starts of the coarse look that Gauss-Newton is tried from.
    pub starts: usize,
}

impl Effort {
    /// For figures that are quoted.
    pub const FULL: Self = Self { iterations: 10, difference: 0.08, trials: 600, starts: 3 };
    /// For telling candidates apart.
    pub const QUICK: Self = Self { iterations: 4, difference: 0.08, trials: 60, starts: 1 };
}
