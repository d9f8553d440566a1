//! A specimen model as it stands in its file: plain numbers, no solver.

use super::effects::fractional_damping;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A model file: mass, isolator, bumpers, effects, and how uncertain its numbers are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ModelSpec {
    /// Name shown in reports.
    pub name: String,
    /// Mass, kg.
    pub mass_kg: f64,
    /// The isolator between mass and table.
    pub isolator: IsolatorSpec,
    /// The bumpers; `None` is free flight (B0).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bumper: Option<BumperSpec>,
    /// Effects beside the base model, in the order of the file.
    #[serde(default, rename = "effect", skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<EffectSpec>,
    /// How far off each number may be (relative half-width, 95 %).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<Uncertainty>,
}

/// Odd, piecewise-linear elastic force with linear viscous damping.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct IsolatorSpec {
    /// Slopes, N/m, one more than breakpoints; a single number is accepted.
    #[serde(with = "one_or_many")]
    #[schema(value_type = one_or_many::OneOrMany)]
    pub stiffness_n_m: Vec<f64>,
    /// Displacements where the slope changes, m, rising.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub breakpoints_m: Vec<f64>,
    /// Viscous damping, N s/m.
    pub damping_n_s_m: f64,
}

/// Two equal Kelvin-Voigt bumpers with massless tips and a total clearance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BumperSpec {
    /// Stiffness of one bumper, N/m.
    pub stiffness_n_m: f64,
    /// Damping of one bumper, N s/m.
    pub damping_n_s_m: f64,
    /// Clearance of both sides together, m.
    pub total_gap_m: f64,
}

/// One effect: its public name, its parameters, and the text of an `expression`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct EffectSpec {
    /// Name as in the catalogue.
    pub name: String,
    /// The expression of an `expression` effect.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expression: Option<String>,
    /// Parameters by name, the unit in the name (`fc_n`, `k3_n_m3`).
    #[serde(flatten)]
    pub parameters: BTreeMap<String, f64>,
}

impl EffectSpec {
    /// Whether it is a springpot.
    pub fn is_springpot(&self) -> bool {
        self.name == fractional_damping::EFFECT.name
    }

    /// Lets a springpot that says nothing of it hold for motions up to this frequency, Hz; other effects do so anyway.
    pub fn hold_up_to(&mut self, fastest_hz: f64) {
        if self.is_springpot() && fastest_hz > 0.0 {
            self.parameters.entry(fractional_damping::FASTEST.to_owned()).or_insert(fastest_hz);
        }
    }
}

/// Relative half-widths (95 %) of the base model's numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Uncertainty {
    /// Of the mass.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mass_kg: Option<f64>,
    /// Of the isolator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub isolator: Option<IsolatorUncertainty>,
    /// Of the bumpers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bumper: Option<BumperUncertainty>,
}

/// Relative half-widths (95 %) of the isolator's numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct IsolatorUncertainty {
    /// Of each slope.
    #[serde(default, with = "one_or_many", skip_serializing_if = "Vec::is_empty")]
    #[schema(value_type = one_or_many::OneOrMany)]
    pub stiffness_n_m: Vec<f64>,
    /// Of each breakpoint.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub breakpoints_m: Vec<f64>,
    /// Of the damping.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damping_n_s_m: Option<f64>,
}

/// Relative half-widths (95 %) of the bumpers' numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BumperUncertainty {
    /// Of the stiffness.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness_n_m: Option<f64>,
    /// Of the damping.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damping_n_s_m: Option<f64>,
    /// Of the clearance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub total_gap_m: Option<f64>,
}

/// A list that may be written as a single number.
mod one_or_many {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    /// What a file may say, and what is written: one slope alone is written as a number.
    #[derive(Deserialize, utoipa::ToSchema)]
    #[serde(untagged)]
    pub enum OneOrMany {
        One(f64),
        Many(Vec<f64>),
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(source: D) -> Result<Vec<f64>, D::Error> {
        Ok(match OneOrMany::deserialize(source)? {
            OneOrMany::One(value) => vec![value],
            OneOrMany::Many(values) => values,
        })
    }

    pub fn serialize<S: Serializer>(values: &[f64], sink: S) -> Result<S::Ok, S::Error> {
        match values {
            [value] => value.serialize(sink),
            _ => values.serialize(sink),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_file_survives_a_round_trip() {
        let text = r#"
name = "x"
mass_kg = 500.0
[isolator]
stiffness_n_m = [20e3, 18e3, 2e3]
breakpoints_m = [0.008, 0.040]
damping_n_s_m = 1100.0
[bumper]
stiffness_n_m = 33e3
damping_n_s_m = 300.0
total_gap_m = 0.020
[[effect]]
name = "coulomb-friction"
fc_n = 12.0
[uncertainty]
mass_kg = 0.005
isolator.stiffness_n_m = [0.1, 0.1, 0.2]
bumper = { stiffness_n_m = 0.08 }
"#;
        let model: ModelSpec = toml::from_str(text).expect("valid");
        assert_eq!(model.effects[0].parameters["fc_n"], 12.0);
        let again: ModelSpec = toml::from_str(&toml::to_string(&model).expect("serialises")).expect("valid");
        assert_eq!(model, again);
    }
}
