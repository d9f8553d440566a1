//! Parameters of an effect: unit, allowed values, prior range, starting value.

use crate::model::{EffectSpec, ModelSpec};

/// Which signs a parameter may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sign {
    /// Above zero.
    Positive,
    /// Zero or above.
    NotNegative,
    /// Any.
    Either,
}

/// One parameter of an effect, for a rig of given magnitudes.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Parameter {
    /// Public name with the unit as suffix.
    pub name: &'static str,
    /// Unit, `1` for a plain number.
    pub unit: &'static str,
    /// What it is.
    pub about: &'static str,
    /// Range (95 %) in which it is sought; of the magnitude when the sign is open.
    pub prior: (f64, f64),
    /// Value a fit starts from.
    pub start: f64,
    /// Spread evenly over magnitudes rather than values.
    pub log_scale: bool,
    /// Which signs it may have.
    pub sign: Sign,
    /// Smallest allowed value, where the sign alone does not tell.
    pub at_least: f64,
    /// Largest allowed value.
    pub at_most: f64,
    /// Value when it is left out; `None` when it must be given.
    pub default: Option<f64>,
    /// The effect vanishes as it grows, as that of a stiffness in series does.
    pub in_series: bool,
    /// A choice of who writes the model, which no fit moves.
    pub chosen: bool,
}

impl Parameter {
    /// A positive parameter sought over magnitudes, from `prior.0` to `prior.1`.
    pub fn positive(
        name: &'static str,
        unit: &'static str,
        about: &'static str,
        prior: (f64, f64),
        start: f64,
    ) -> Self {
        let (log_scale, sign) = (true, Sign::Positive);
        let (at_least, at_most) = (f64::MIN, f64::MAX);
        let (default, in_series, chosen) = (None, false, false);
        Self {
            name,
            unit,
            about,
            prior,
            start,
            log_scale,
            sign,
            at_least,
            at_most,
            default,
            in_series,
            chosen,
        }
    }

    /// As [`Parameter::positive`], zero allowed.
    pub fn not_negative(
        name: &'static str,
        unit: &'static str,
        about: &'static str,
        prior: (f64, f64),
        start: f64,
    ) -> Self {
        Self { sign: Sign::NotNegative, ..Self::positive(name, unit, about, prior, start) }
    }

    /// A parameter of either sign within plus and minus `reach`.
    pub fn either(
        name: &'static str,
        unit: &'static str,
        about: &'static str,
        reach: f64,
        start: f64,
    ) -> Self {
        Self {
            log_scale: false,
            sign: Sign::Either,
            prior: (-reach, reach),
            ..Self::positive(name, unit, about, (0.0, reach), start)
        }
    }

    /// Sought evenly over values.
    pub fn linear(self) -> Self {
        Self { log_scale: false, ..self }
    }

    /// May be left out of the file.
    pub fn optional(self, default: f64) -> Self {
        Self { default: Some(default), start: default, ..self }
    }

    /// The effect vanishes as it grows.
    pub fn in_series(self) -> Self {
        Self { in_series: true, ..self }
    }

    /// No fit moves it.
    pub fn chosen(self) -> Self {
        Self { chosen: true, ..self }
    }

    /// Refused below `at_least`.
    pub fn at_least(self, at_least: f64) -> Self {
        Self { at_least, ..self }
    }

    /// Refused above `at_most`.
    pub fn at_most(self, at_most: f64) -> Self {
        Self { at_most, ..self }
    }

    /// Refuses an impossible value.
    pub(super) fn check(&self, value: f64) -> Result<(), String> {
        let (low_ok, low) = match self.sign {
            Sign::Positive => (value > 0.0, "above 0"),
            Sign::NotNegative => (value >= 0.0, "0"),
            Sign::Either if self.at_least > f64::MIN => (value >= self.at_least, ""),
            Sign::Either => (true, "any finite value"),
        };
        let low = if low.is_empty() { self.at_least.to_string() } else { low.to_owned() };
        if value.is_finite() && low_ok && value <= self.at_most {
            return Ok(());
        }
        let unit = unit_behind(self.unit);
        let end = match (self.sign, self.at_most < f64::MAX) {
            (Sign::Either, false) => String::new(),
            (Sign::Either, true) if self.at_least == f64::MIN => {
                format!(" up to {}{unit}", self.at_most)
            }
            (Sign::Positive, false) => unit.clone(),
            (Sign::NotNegative, false) => format!("{unit} or more"),
            (_, true) => format!(" to {}{unit}", self.at_most),
        };
        Err(format!("{value}{unit}; allowed: {low}{end}"))
    }
}

/// What stands behind a number of this unit: a space and the unit, nothing for `1` or none.
pub fn unit_behind(unit: &str) -> String {
    if matches!(unit, "" | "1") { String::new() } else { format!(" {unit}") }
}

/// The values of one effect as its file gives them, defaults filled in.
pub struct Values<'a> {
    index: usize,
    spec: &'a EffectSpec,
    parameters: &'a [Parameter],
    model: &'a ModelSpec,
}

impl<'a> Values<'a> {
    pub(super) fn new(
        index: usize,
        spec: &'a EffectSpec,
        parameters: &'a [Parameter],
        model: &'a ModelSpec,
    ) -> Self {
        Self { index, spec, parameters, model }
    }

    /// Value of a parameter of this effect, its default when the file leaves it out.
    pub fn get(&self, name: &str) -> f64 {
        self.spec.parameters.get(name).copied().unwrap_or_else(|| {
            self.parameters.iter().find(|p| p.name == name).and_then(|p| p.default).unwrap_or(0.0)
        })
    }

    /// The effect as the file has it.
    pub fn spec(&self) -> &'a EffectSpec {
        self.spec
    }

    /// The whole model.
    pub fn model(&self) -> &'a ModelSpec {
        self.model
    }

    /// Dotted key of one of its entries.
    pub fn key(&self, name: &str) -> String {
        format!("effect[{}].{name}", self.index)
    }
}
