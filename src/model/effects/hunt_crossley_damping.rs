//! Bumper damping in proportion to penetration (Hunt and Crossley 1975).

use super::{Effect, Parameter, Place};

/// `hunt-crossley-damping`.
pub static EFFECT: Effect = Effect {
    name: "hunt-crossley-damping",
    place: Place::Bumper,
    equation: "F = mu p p' beside Cb p'",
    source: "K. H. Hunt, F. R. E. Crossley, J. Appl. Mech. 42 (1975) 440",
    states: "",
    regime: "contact",
    shows: "loss grows with depth; no jump of force at first contact",
    experiment: "impacts at several A_G",
    piecewise_linear: false,
    parameters: |s| {
        vec![Parameter::not_negative(
            "mu_n_s_m2",
            "N s/m2",
            "coefficient",
            (
                1e-2 * s.contact_stiffness_n_m() / s.velocity_m_s,
                10.0 * s.contact_stiffness_n_m() / s.velocity_m_s,
            ),
            0.1 * s.contact_stiffness_n_m() / s.velocity_m_s,
        )]
    },
    install: |values, system| {
        system.bumper.hunt_crossley_n_s_m2 += values.get("mu_n_s_m2");
        Ok(())
    },
};
