//! Bumpers that do not stand at equal distances.

use super::{Effect, Parameter, Place};

/// `gap-asymmetry`.
pub static EFFECT: Effect = Effect {
    name: "gap-asymmetry",
    place: Place::Bumper,
    equation: "right gap G/2 - s, left gap G/2 + s",
    source: "U. Andreaus, M. De Angelis, Struct. Control Health Monit. 2020, e2517 (gaps set by screws)",
    states: "",
    regime: "contact, one side more",
    shows: "D_max and -D_min differ; even harmonics",
    experiment: "D_max and D_min apart; another gap",
    piecewise_linear: true,
    parameters: |s| {
        vec![Parameter::either(
            "s_m",
            "m",
            "shift of the rest position to the right",
            0.25 * s.total_gap_m.unwrap_or(s.displacement_m),
            0.02 * s.total_gap_m.unwrap_or(s.displacement_m),
        )]
    },
    install: |values, system| {
        system.gap_right_m -= values.get("s_m");
        system.gap_left_m += values.get("s_m");
        Ok(())
    },
};
