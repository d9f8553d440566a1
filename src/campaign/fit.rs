//! Fitting a model to the peaks of all cells at once: what may move, how a cell is predicted, where a fit
//! ends. [`super::diagnose`] and [`super::optimise`] call it.
//!
//! Every number moves as a logarithm of its factor on the campaign's model, so that a fit always starts cold
//! from that model and the scatter of the table (some per cent) is its natural unit. Mass stays where it is:
//! peaks are kinematic and fix F/M alone.

use super::ideal::{self, Settings};
use super::peaks::{LogError, Peaks};
use super::spec::{CaseKey, Configuration, mount};
use crate::identify::least_squares::{self, Free};
use crate::model::effects::{self, Effect, Parameter, Sign};
use crate::model::{EffectSpec, ModelSpec, Scales};
use crate::sweep::{Direction, Step};
use rand::{Rng, SeedableRng};
use serde::Serialize;

/// Errors beyond so many standard deviations lose their pull in a robust fit.
const ROBUST: f64 = 2.5;
/// Standard deviation of the prior of a stiffness, knee or bumper number (logarithm of its factor).
const LOOSE: f64 = 0.7;
/// The same of the isolator's damping, which a dry loss may replace altogether.
const DAMPING: f64 = 2.0;

/// A correction of the peaks themselves: not of the specimen, but of how it was observed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Correction {
    /// All accelerations times a gain.
    AccelerationGain,
    /// A constant on top of every acceleration peak (noise, cross-axis, rattle).
    PeakFloor,
    /// f_R is not what nu was divided by.
    ReferenceFrequency,
}

impl Correction {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::AccelerationGain, Self::PeakFloor, Self::ReferenceFrequency];

    /// Public name.
    pub fn name(self) -> &'static str {
        match self {
            Self::AccelerationGain => "acceleration-gain",
            Self::PeakFloor => "peak-floor",
            Self::ReferenceFrequency => "reference-frequency",
        }
    }

    /// Name, unit, start, prior standard deviation, bounds of its parameter.
    fn number(self, key: &str, reference_hz: f64) -> Number {
        let free = |start: f64, scale: f64, sigma: f64, bounds: (f64, f64)| Free {
            key: key.to_owned(),
            start,
            scale,
            prior: (start, sigma),
            bounds,
        };
        match self {
            Self::AccelerationGain => {
                Number::new("gain", "1", Kind::Factor(1.0), free(0.0, 1.0, 0.3, (-1.0, 1.0)))
            }
            Self::PeakFloor => {
                Number::new("floor_m_s2", "m/s2", Kind::Value, free(0.0, 1.0, 0.5, (0.0, 3.0)))
            }
            Self::ReferenceFrequency => {
                Number::new("f_r_hz", "Hz", Kind::Factor(reference_hz), free(0.0, 1.0, 0.2, (-1.0, 1.0)))
            }
        }
    }
}

/// What the fit's number stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    /// `nominal * exp(x)`.
    Factor(f64),
    /// x itself.
    Value,
}

/// One free number with its public name and unit.
#[derive(Clone, Debug, PartialEq)]
pub struct Number {
    /// Name, `bumper B1 stiffness_n_m`.
    pub name: String,
    /// Unit.
    pub unit: String,
    kind: Kind,
    /// The fit's view.
    pub free: Free,
}

impl Number {
    fn new(name: &str, unit: &str, kind: Kind, free: Free) -> Self {
        Self { name: name.to_owned(), unit: unit.to_owned(), kind, free }
    }

    /// The number itself, SI.
    pub fn value(&self, x: f64) -> f64 {
        match self.kind {
            Kind::Factor(nominal) => nominal * x.exp(),
            Kind::Value => x,
        }
    }
}

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
    pub covariance: nalgebra::DMatrix<f64>,
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
        let mut numbers = Vec::new();
        if freedom.common_stiffness {
            numbers.push(factor("factor on all stiffnesses", "1", 1.0, 2.0));
        } else if !freedom.fixed {
            base_numbers(configuration, cells, &mut numbers);
        }
        let scales = scales(configuration, cells);
        for name in &freedom.effects {
            let Ok(effect) = effects::find(name) else { continue };
            numbers.extend(effect_parameters(effect, &scales).iter().map(|p| effect_number(name, p)));
        }
        let reference_hz = configuration.spec.reference_hz;
        for correction in &freedom.corrections {
            let mut number = correction.number(correction.name(), reference_hz);
            number.name = format!("{} {}", correction.name(), number.name);
            numbers.push(number);
        }
        Self {
            configuration,
            freedom,
            numbers,
            swift: Settings { sample_rate_hz: 100.0, tolerance: 1e-4, ..Settings::default() },
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

    /// [`Problem::predict`] from coarser samples of the steps about the observed peak.
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

    /// Where every fit starts: the campaign's model, effects at their starting values.
    pub fn start(&self) -> Vec<f64> {
        self.numbers.iter().map(|number| number.free.start).collect()
    }

    /// Fits to cells, cold: first one factor on all stiffnesses, then damped Gauss-Newton on everything with
    /// differences wide enough to see through the steps of the sweep, then a random search (Rechenberg 1973,
    /// 1/5 rule) over what they hide.
    pub fn fit(&self, cells: &[&Cell], effort: Effort) -> Option<Fitted> {
        let mut start = self.start();
        let stiff = |number: &Number| number.free.key.contains("stiffness");
        if self.numbers.iter().any(stiff) {
            let mut r = Vec::new();
            let mut best = (f64::INFINITY, 0.0);
            for factor in [-0.3, 0.0, 0.3, 0.6, 0.9] {
                let x: Vec<f64> = self
                    .numbers
                    .iter()
                    .zip(&start)
                    .map(|(n, x)| if stiff(n) { factor } else { *x })
                    .collect();
                let cost = if self.residuals(&x, cells, &mut r) {
                    least_squares::sum_of_squares(&r)
                } else {
                    f64::INFINITY
                };
                if cost < best.0 {
                    best = (cost, factor);
                }
            }
            for (number, x) in self.numbers.iter().zip(&mut start) {
                *x = if stiff(number) { best.1 } else { *x };
            }
        }
        self.fit_from(cells, start, effort)
    }

    /// [`Problem::fit`] from a start of one's own.
    pub fn fit_from(&self, cells: &[&Cell], start: Vec<f64>, effort: Effort) -> Option<Fitted> {
        let with_start = |(number, x): (&Number, f64)| Free { start: x, ..number.free.clone() };
        let free: Vec<Free> = self.numbers.iter().zip(start).map(with_start).collect();
        let mut residuals = |x: &[f64], r: &mut Vec<f64>| self.residuals(x, cells, r);
        let settings = least_squares::Settings {
            iterations: effort.iterations,
            tolerance: 1e-3,
            difference: effort.difference,
        };
        let fit = least_squares::fit(&free, settings, &mut residuals)?;
        let covariance = fit.covariance(&free, 1.0);
        let sigma = (0..free.len()).map(|i| covariance[(i, i)].max(0.0).sqrt()).collect();
        let (x, cost) = self.search(&free, fit.values.clone(), effort.trials, &mut residuals);
        let rms = self.rms(&x, cells)?;
        Some(Fitted { x, sigma, covariance, rms, cost })
    }

    /// RMS of the logarithmic errors that count.
    pub fn rms(&self, x: &[f64], cells: &[&Cell]) -> Option<f64> {
        Some(counted_rms(&self.errors(x, cells)?, cells))
    }

    fn search(
        &self,
        free: &[Free],
        start: Vec<f64>,
        trials: usize,
        residuals: &mut impl FnMut(&[f64], &mut Vec<f64>) -> bool,
    ) -> (Vec<f64>, f64) {
        let mut r = Vec::new();
        let mut cost = |x: &[f64]| -> f64 {
            if !residuals(x, &mut r) {
                return f64::INFINITY;
            }
            let prior = |(free, x): (&Free, &f64)| ((x - free.prior.0) / free.prior.1).powi(2);
            least_squares::sum_of_squares(&r) + free.iter().zip(x).map(prior).sum::<f64>()
        };
        let mut random = rand_pcg::Pcg64::seed_from_u64(20_200_608);
        let normal = |random: &mut rand_pcg::Pcg64| -> f64 {
            (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
        };
        let (mut best, mut reach) = (start, 0.05);
        let mut least = cost(&best);
        for _ in 0..trials {
            let trial: Vec<f64> = free
                .iter()
                .zip(&best)
                .map(|(free, x)| {
                    (x + reach * free.scale * normal(&mut random)).clamp(free.bounds.0, free.bounds.1)
                })
                .collect();
            let value = cost(&trial);
            if value < least {
                (best, least) = (trial, value);
                reach *= 1.5;
            } else {
                reach *= 0.9;
            }
            reach = reach.clamp(2e-3, 0.3);
        }
        (best, least)
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
    /// Random trials afterwards.
    pub trials: usize,
}

impl Effort {
    /// For figures that are quoted.
    pub const FULL: Self = Self { iterations: 12, difference: 0.04, trials: 150 };
    /// For telling candidates apart.
    pub const QUICK: Self = Self { iterations: 4, difference: 0.04, trials: 30 };
}

fn factor(name: &str, unit: &str, nominal: f64, sigma: f64) -> Number {
    let key = if name.starts_with("factor") { "common" } else { name };
    let free = Free { key: key.to_owned(), start: 0.0, scale: 1.0, prior: (0.0, sigma), bounds: (-5.0, 5.0) };
    Number::new(name, unit, Kind::Factor(nominal), free)
}

/// Isolator and every bumper that some cell has.
fn base_numbers(configuration: &Configuration, cells: &[Cell], numbers: &mut Vec<Number>) {
    let model = &configuration.model;
    for key in model.parameter_keys() {
        let Ok(nominal) = model.get(&key) else { continue };
        if !key.starts_with("isolator.") || nominal == 0.0 {
            continue;
        }
        let unit = if key.contains("stiffness") {
            "N/m"
        } else if key.contains("break") {
            "m"
        } else {
            "N s/m"
        };
        let sigma = if key.contains("damping") { DAMPING } else { LOOSE };
        numbers.push(factor(&format!("base {key}"), unit, nominal, sigma));
    }
    for (i, bumper) in configuration.spec.bumper.iter().enumerate() {
        let (Some(k), Some(c)) = (bumper.stiffness_n_m, bumper.damping_n_s_m) else { continue };
        if !cells.iter().any(|cell| cell.case.bumper == i) {
            continue;
        }
        numbers.push(factor(&format!("bumper {} stiffness_n_m", bumper.name), "N/m", k, LOOSE));
        if c > 0.0 {
            numbers.push(factor(&format!("bumper {} damping_n_s_m", bumper.name), "N s/m", c, LOOSE));
        }
    }
}

/// Magnitudes of the campaign: of the first case with a bumper, or of the first.
pub fn scales(configuration: &Configuration, cells: &[Cell]) -> Scales {
    let case = cells.iter().find(|cell| cell.case.gap.is_some()).or(cells.first()).map(|cell| &cell.case);
    let model = case.map_or_else(|| configuration.model.clone(), |case| configuration.model_of(case));
    Scales::of_spec(&model, 1.0 / crate::units::SAMPLE_RATE_HZ)
}

/// The parameters of an effect that a fit moves: those that must be given.
pub fn effect_parameters(effect: &Effect, scales: &Scales) -> Vec<Parameter> {
    (effect.parameters)(scales).into_iter().filter(|parameter| parameter.default.is_none()).collect()
}

fn effect_number(effect: &str, parameter: &Parameter) -> Number {
    let key = format!("effect {effect} {}", parameter.name);
    let (low, high) = parameter.prior;
    let positive = parameter.sign != Sign::Either && parameter.start > 0.0;
    let (kind, free) = if positive {
        let (l, h) = ((low.max(1e-4 * high) / parameter.start).ln(), (high / parameter.start).ln());
        let most = (parameter.at_most / parameter.start).ln();
        let free = Free {
            key,
            start: 0.0,
            scale: 1.0,
            prior: (0.5 * (l + h), (0.5 * (h - l)).max(0.3)),
            bounds: (l - 2.0, (h + 2.0).min(most)),
        };
        (Kind::Factor(parameter.start), free)
    } else {
        let reach = high.abs().max(low.abs());
        let start = if parameter.start == 0.0 { 0.2 * reach } else { parameter.start };
        let free = Free {
            key,
            start,
            scale: reach,
            prior: (0.0, reach),
            bounds: (-3.0 * reach, (3.0 * reach).min(parameter.at_most)),
        };
        (Kind::Value, free)
    };
    Number::new(&format!("{effect} {}", parameter.name), parameter.unit, kind, free)
}
