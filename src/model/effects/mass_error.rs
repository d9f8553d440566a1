//! The mass is not what was weighed.

use super::{Effect, Parameter, Place};
use crate::model::ModelError;

/// `mass-error`.
pub static EFFECT: Effect = Effect {
    name: "mass-error",
    place: Place::Rig,
    equation: "M + dM in place of M",
    source: "weighing",
    states: "",
    regime: "all",
    shows: "every force over mass off by one factor",
    experiment: "static pull; a known added mass",
    piecewise_linear: true,
    parameters: |s| {
        vec![Parameter::either(
            "dm_kg",
            "kg",
            "what the mass was underestimated by",
            0.3 * s.mass_kg,
            0.02 * s.mass_kg,
        )]
    },
    install: |values, system| {
        let mass = system.mass_kg + values.get("dm_kg");
        if mass <= 0.0 {
            return Err(ModelError::invalid(
                values.key("dm_kg"),
                format!("leaves a mass of {mass} kg; allowed: above 0 kg"),
            ));
        }
        system.mass_kg = mass;
        Ok(())
    },
};
