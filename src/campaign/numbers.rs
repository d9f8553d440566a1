//! The free numbers of a fit to peaks: isolator and bumpers, parameters of effects, corrections of the
//! observation, each with its prior. [`super::fit`] moves them, [`super::diagnose`] names them.
//!
//! Every number moves as a logarithm of its factor on the campaign's model, so that a fit always starts cold
//! from that model and the scatter of the table (some per cent) is its natural unit. Mass stays where it is:
//! peaks are kinematic and fix F/M alone.

use super::fit::Cell;
use super::spec::Configuration;
use crate::identify::least_squares::Free;
use crate::model::Scales;
use crate::model::effects::{Effect, Parameter, Sign};
use serde::Serialize;

/// Key of the factor on all stiffnesses.
const COMMON: &str = "common";
/// Standard deviation of the prior of a factor on all stiffnesses, of a knee and of a bumper's damping (logarithm).
const LOOSE: f64 = 1.5;
/// The same of one stiffness against the others: a mass or a calibration that is off scales them together, so that
/// what is common to them is left far more room than their ratios, which come from one static test.
const RATIO: f64 = 0.3;
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
    pub(super) fn number(self, key: &str, reference_hz: f64) -> Number {
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

    /// The factor on all stiffnesses.
    pub(super) fn is_common(&self) -> bool {
        self.free.key == COMMON
    }

    /// A stiffness of isolator or bumper, which the factor on all of them multiplies.
    pub(super) fn is_stiffness(&self) -> bool {
        let key = self.free.key.as_str();
        key.contains("stiffness_n_m") && !key.starts_with("effect ")
    }

    /// It moves as the logarithm of a factor.
    pub(super) fn is_factor(&self) -> bool {
        matches!(self.kind, Kind::Factor(_))
    }

    /// The number itself, SI.
    pub fn value(&self, x: f64) -> f64 {
        match self.kind {
            Kind::Factor(nominal) => nominal * x.exp(),
            Kind::Value => x,
        }
    }
}

fn factor(name: &str, unit: &str, nominal: f64, sigma: f64) -> Number {
    let free =
        Free { key: name.to_owned(), start: 0.0, scale: 1.0, prior: (0.0, sigma), bounds: (-5.0, 5.0) };
    Number::new(name, unit, Kind::Factor(nominal), free)
}

/// One factor on the stiffnesses of isolator and bumpers.
pub(super) fn common_factor(sigma: f64) -> Number {
    let mut number = factor("factor on all stiffnesses", "1", 1.0, sigma);
    number.free.key = COMMON.to_owned();
    number
}

/// Isolator and every bumper that some cell has: their stiffnesses by a common factor and their ratios.
pub(super) fn base_numbers(configuration: &Configuration, cells: &[Cell], numbers: &mut Vec<Number>) {
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
        let sigma = match &key {
            key if key.contains("damping") => DAMPING,
            key if key.contains("stiffness") => RATIO,
            _ => LOOSE,
        };
        numbers.push(factor(&format!("base {key}"), unit, nominal, sigma));
    }
    for (i, bumper) in configuration.spec.bumper.iter().enumerate() {
        let (Some(k), Some(c)) = (bumper.stiffness_n_m, bumper.damping_n_s_m) else { continue };
        if !cells.iter().any(|cell| cell.case.bumper == i) {
            continue;
        }
        numbers.push(factor(&format!("bumper {} stiffness_n_m", bumper.name), "N/m", k, RATIO));
        if c > 0.0 {
            numbers.push(factor(&format!("bumper {} damping_n_s_m", bumper.name), "N s/m", c, LOOSE));
        }
    }
    // Last, because it multiplies what the others set.
    numbers.push(common_factor(LOOSE));
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

pub(super) fn effect_number(effect: &str, parameter: &Parameter) -> Number {
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
            bounds: ((-3.0 * reach).max(parameter.at_least), (3.0 * reach).min(parameter.at_most)),
        };
        (Kind::Value, free)
    };
    Number::new(&format!("{effect} {}", parameter.name), parameter.unit, kind, free)
}
