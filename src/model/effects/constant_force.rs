//! Tilted table or preloaded isolator.

use super::{Effect, Parameter, Place};

/// `constant-force`.
pub static EFFECT: Effect = Effect {
    name: "constant-force",
    place: Place::Rig,
    equation: "F = F (constant)",
    source: "tilted table: F = M g sin(angle)",
    states: "",
    regime: "all",
    shows: "D and the loop A(D) shifted; even harmonics with bumpers",
    experiment: "static zero; tilt",
    piecewise_linear: true,
    parameters: |s| {
        vec![Parameter::either(
            "f_n",
            "N",
            "force, positive pushes towards negative D",
            0.5 * s.force_n,
            0.02 * s.force_n,
        )]
    },
    install: |values, system| {
        system.constant_n += values.get("f_n");
        Ok(())
    },
};
