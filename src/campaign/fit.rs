//! Fitting a model to the peaks of all cells at once: what may move, how a cell is predicted, where a fit
//! ends. [`super::diagnose`] and [`super::optimise`] call it.
//!
//! A fit looks at the steps about an observed peak alone: first for as many cycles as they need to settle and
//! with a pseudo-resonance that moves smoothly between the steps of the sweep, so that slopes mean something;
//! then on the steps themselves with all their cycles. What is quoted comes from the whole sweep.

use super::ideal::{self, Settings};
pub use super::numbers::Correction;
use super::numbers::{self, Number};
use super::peaks::{LogError, Peaks};
use super::search::search;
use super::spec::{CaseKey, Configuration, mount};
use crate::identify::least_squares::{self, Free};
use crate::model::effects;
use crate::model::{EffectSpec, ModelSpec};
use crate::sweep::{Direction, Step};
use nalgebra::DMatrix;

/// Errors beyond so many standard deviations lose their pull in a robust fit.
const ROBUST: f64 = 2.5;
/// Steps of the sweep within so many Hz of an observed peak are looked at first.
const NEAR_HZ: f64 = 0.55;
/// Sizes at which an effect is looked at: logarithms of the factor on its starting value.
const SIZES: [f64; 4] = [-1.0, 0.0, 1.0, 2.0];
/// By so much the search is shorter where only the general solver will do.
const GENERAL_TRIALS: usize = 4;
/// By so many fewer starts there, too.
const GENERAL_STARTS: usize = 2;

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
    /// How peaks are computed while a fit follows slopes.
    pub swift: Settings,
    /// How peaks are computed where the steps of the sweep are searched.
    pub stepped: Settings,
    /// How the peaks that are quoted are computed.
    pub precise: Settings,
    /// Scatter of A_max, E_max and nu_R (logarithms) that residuals are measured in.
    pub scatter: [f64; 3],
    /// Errors far beyond the scatter lose their pull.
    pub robust: bool,
}

/// How closely a fit looks at the peaks of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// Short steps, the pseudo-resonance between them: smooth.
    Smooth,
    /// The steps of the sweep.
    Stepped,
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
    /// What was minimised, priors included.
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
        let near = steps(case, (0.7 * hz).max(hz - NEAR_HZ), (1.35 * hz + 0.1).min(hz + NEAR_HZ));
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
            free.push(numbers::common_factor(2.0));
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
            swift: Settings { tolerance: 1e-3, cycles: 6, counted: 2.0 },
            stepped: Settings { tolerance: 1e-4, ..Settings::default() },
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
            if number.is_common() {
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

    /// [`Problem::predict`] from the steps about the observed peak.
    fn glimpse(&self, x: &[f64], cell: &Cell, look: Look) -> Option<Peaks> {
        let model = self.model(x, &cell.case);
        let resonance = self.configuration.resonance();
        let settings = if look == Look::Smooth { &self.swift } else { &self.stepped };
        let states = |steps: &[Step]| ideal::steady_states(&model, steps, settings).ok();
        // A peak at the border of the steps about the observed one lies elsewhere.
        let near = states(&cell.near).filter(|states| ideal::peak_inside(states));
        let states = near.or_else(|| states(&cell.all))?;
        let mut peaks = ideal::peaks(&states, Direction::Forward, resonance)?;
        if look == Look::Smooth {
            peaks.nu_r = ideal::smooth_nu(&states, resonance);
        }
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

    /// Errors in units of their scatter, three a cell; `false` where a model cannot be solved.
    pub(super) fn residuals(&self, x: &[f64], cells: &[&Cell], look: Look, r: &mut Vec<f64>) -> bool {
        let Some(errors) = self.errors_by(cells, |cell| self.glimpse(x, cell, look)) else { return false };
        r.clear();
        for (error, cell) in errors.iter().zip(cells) {
            for ((value, scatter), counts) in error.values().iter().zip(self.scatter).zip(cell.counts) {
                let z = if counts { value / scatter } else { 0.0 };
                r.push(if self.robust { ROBUST * (z / ROBUST).atan() } else { z });
            }
        }
        true
    }

    /// What a fit minimises, without the priors: squares in units of the scatter.
    pub fn cost(&self, x: &[f64], cells: &[&Cell], look: Look) -> f64 {
        let mut r = Vec::new();
        let sound = self.residuals(x, cells, look, &mut r);
        if sound { least_squares::sum_of_squares(&r) } else { f64::INFINITY }
    }

    /// Where every fit starts: the campaign's model, effects at their starting values.
    pub fn start(&self) -> Vec<f64> {
        self.numbers.iter().map(|number| number.free.start).collect()
    }

    /// Fits to cells, cold: a coarse look at the stiffnesses together, the isolator's damping and the strength of
    /// the first effect; from the best of it damped Gauss-Newton on everything; from where that leaves least a
    /// search over what the steps of the sweep hide.
    pub fn fit(&self, cells: &[&Cell], effort: Effort) -> Option<Fitted> {
        let most = if self.is_closed() { effort.starts } else { effort.starts / GENERAL_STARTS };
        let starts = self.best_looks(cells, self.looks(), most);
        self.fit_from(cells, starts, effort)
    }

    /// The least of every group of starts, of those the best few.
    fn best_looks(&self, cells: &[&Cell], groups: Vec<Vec<Vec<f64>>>, most: usize) -> Vec<Vec<f64>> {
        let prior = |x: &[f64]| least_squares::prior_sum(&self.free_from(x.to_vec()), x);
        let best_look = |looks: Vec<Vec<f64>>| {
            let looked = looks.into_iter().map(|x| (self.cost(&x, cells, Look::Smooth) + prior(&x), x));
            looked.min_by(|a, b| a.0.total_cmp(&b.0))
        };
        let mut looks: Vec<(f64, Vec<f64>)> = groups.into_iter().filter_map(best_look).collect();
        looks.sort_by(|a, b| a.0.total_cmp(&b.0));
        looks.into_iter().take(most.max(1)).map(|(_, x)| x).collect()
    }

    /// Starts worth a look, in groups of which the best each is worth a descent: a dry loss takes the place of
    /// viscous damping, so that effects are tried at several sizes and without one the damping is.
    fn looks(&self) -> Vec<Vec<Vec<f64>>> {
        let any = |part: &str| self.numbers.iter().any(|number| number.free.key.contains(part));
        let common = self.numbers.iter().any(Number::is_common);
        let stiff: &[f64] = if common { &[-0.3, 0.0, 0.3, 0.6, 0.9] } else { &[0.0] };
        let damping: &[f64] = if any("isolator.damping") { &[-1.2, -0.4, 0.0] } else { &[0.0] };
        let at = |k: f64, c: f64| -> Vec<f64> {
            let place = |number: &Number| match number.free.key.as_str() {
                _ if number.is_common() => k,
                key if key.contains("isolator.damping") => c,
                _ => number.free.start,
            };
            self.numbers.iter().map(place).collect()
        };
        let base: Vec<Vec<Vec<f64>>> =
            damping.iter().map(|c| stiff.iter().map(|k| at(*k, *c)).collect()).collect();
        match self.strength() {
            Some(_) => {
                let base = base.concat();
                let sized = |size: &f64| base.iter().map(|x| self.at_size(x, *size)).collect();
                SIZES.iter().map(sized).collect()
            }
            None => base,
        }
    }

    /// The number that says how strong the first effect is.
    fn strength(&self) -> Option<usize> {
        self.numbers.iter().position(|number| number.free.key.starts_with("effect "))
    }

    /// Numbers with the first effect so many times (as a logarithm) as strong as where it starts; what may have
    /// either sign turns round for negative sizes.
    pub(super) fn at_size(&self, x: &[f64], size: f64) -> Vec<f64> {
        let mut x = x.to_vec();
        if let Some(i) = self.strength() {
            let number = &self.numbers[i];
            let value = if number.is_factor() {
                number.free.start + size
            } else {
                number.free.start * if size < 0.0 { -1.0 } else { 1.0 + size }
            };
            x[i] = value.clamp(number.free.bounds.0, number.free.bounds.1);
        }
        x
    }

    /// The free numbers with starts of one's own.
    pub(super) fn free_from(&self, start: Vec<f64>) -> Vec<Free> {
        let with_start = |(number, x): (&Number, f64)| Free { start: x, ..number.free.clone() };
        self.numbers.iter().zip(start).map(with_start).collect()
    }

    fn settings(effort: Effort) -> least_squares::Settings {
        least_squares::Settings {
            iterations: effort.iterations,
            tolerance: 3e-4,
            difference: effort.difference,
        }
    }

    /// Where Gauss-Newton comes to from a start, and its covariance there.
    fn descend(&self, cells: &[&Cell], start: Vec<f64>, effort: Effort) -> Option<(Vec<f64>, DMatrix<f64>)> {
        let free = self.free_from(start);
        let residuals = |x: &[f64], r: &mut Vec<f64>| self.residuals(x, cells, Look::Smooth, r);
        let fit = least_squares::fit(&free, Self::settings(effort), residuals)?;
        Some((fit.values.clone(), fit.covariance(&free, 1.0)))
    }

    /// [`Problem::fit`] from starts of one's own.
    pub fn fit_from(&self, cells: &[&Cell], starts: Vec<Vec<f64>>, effort: Effort) -> Option<Fitted> {
        let costed = |(x, covariance): (Vec<f64>, DMatrix<f64>)| {
            let prior = least_squares::prior_sum(&self.free_from(x.clone()), &x);
            (self.cost(&x, cells, Look::Stepped) + prior, x, covariance)
        };
        let ends = starts.into_iter().filter_map(|x| self.descend(cells, x, effort)).map(costed);
        let (_, start, covariance) = ends.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let free = self.free_from(start.clone());
        let trials = if self.is_closed() { effort.trials } else { effort.trials / GENERAL_TRIALS };
        let mut objective = |x: &[f64]| self.cost(x, cells, Look::Stepped);
        let (x, cost) = search(&free, start, &covariance, trials, &mut objective);
        let still = Effort { iterations: 0, ..effort };
        let covariance = if trials > 0 { self.descend(cells, x.clone(), still)?.1 } else { covariance };
        let sigma = (0..x.len()).map(|i| covariance[(i, i)].max(0.0).sqrt()).collect();
        Some(Fitted { x, sigma, covariance, cost })
    }

    /// The model is solved in closed form, some ten times as fast as otherwise.
    fn is_closed(&self) -> bool {
        let freed = |name: &&str| effects::find(name).is_ok_and(|effect| effect.piecewise_linear);
        effects::are_piecewise_linear(&self.configuration.model.effects)
            && self.freedom.effects.iter().all(freed)
    }

    /// RMS of the logarithmic errors that count.
    pub fn rms(&self, x: &[f64], cells: &[&Cell]) -> Option<f64> {
        Some(counted_rms(&self.errors(x, cells)?, cells))
    }
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
    /// Places of the search afterwards.
    pub trials: usize,
    /// Starts of the coarse look that Gauss-Newton is tried from.
    pub starts: usize,
}

impl Effort {
    /// For what is quoted of all cells.
    pub const FULL: Self = Self { iterations: 20, difference: 0.04, trials: 600, starts: 5 };
    /// For each gap left out.
    pub const HELD_OUT: Self = Self { iterations: 12, difference: 0.04, trials: 300, starts: 3 };
    /// For telling candidates apart.
    pub const QUICK: Self = Self { iterations: 5, difference: 0.04, trials: 0, starts: 1 };
}
