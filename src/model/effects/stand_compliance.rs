//! Stands that give way under the bumpers, each with a mass and a spring of its own; lightly damped, as steel is.

use super::{Effect, Parameter, Place};
use crate::model::system::Stand;

/// `stand-compliance`.
pub static EFFECT: Effect = Effect {
    name: "stand-compliance",
    place: Place::Stand,
    equation: "ms s'' + 2 zeta sqrt(ks ms) s' + ks s = contact force - ms a; the bumper stands on s",
    source: "R. W. Clough, J. Penzien, Dynamics of Structures, 1993 (two degrees of freedom)",
    states: "s, s' of each stand (m, m/s)",
    regime: "contact and after",
    shows: "ringing of the contact force; softer contact than the bumper alone",
    experiment: "accelerometer on the stand",
    piecewise_linear: false,
    parameters: |s| {
        vec![
            Parameter::positive(
                "ks_n_m",
                "N/m",
                "stiffness of a stand",
                (0.3 * s.contact_stiffness_n_m(), 100.0 * s.contact_stiffness_n_m()),
                5.0 * s.contact_stiffness_n_m(),
            )
            .in_series(),
            Parameter::positive(
                "ms_kg",
                "kg",
                "moving mass of a stand",
                (1e-3 * s.mass_kg, 0.5 * s.mass_kg),
                0.02 * s.mass_kg,
            ),
            Parameter::not_negative("zeta", "1", "damping ratio of a stand", (1e-3, 0.2), 0.02)
                .optional(0.02)
                .at_most(1.0),
        ]
    },
    install: |values, system| {
        let (k, m) = (values.get("ks_n_m"), values.get("ms_kg"));
        let damping = 2.0 * values.get("zeta") * (k * m).sqrt();
        system.stand = Some(Stand::new(k, m, damping, &system.bumper, system.sample_period_s));
        Ok(())
    },
};
