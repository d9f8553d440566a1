//! Rubber that stiffens when it is squeezed (Gent 1992).

use super::{Effect, Parameter, Place};

/// `bumper-stiffening`.
pub static EFFECT: Effect = Effect {
    name: "bumper-stiffening",
    place: Place::Bumper,
    equation: "F = kb3 p^3 beside Kb p",
    source: "A. N. Gent, Engineering with Rubber, 1992 (rubber in compression)",
    states: "",
    regime: "contact, deep",
    shows: "loops A(D) bend upwards towards the end of the penetration",
    experiment: "higher A_G; static squeeze",
    piecewise_linear: false,
    parameters: |s| {
        vec![Parameter::not_negative(
            "kb3_n_m3",
            "N/m3",
            "coefficient",
            (
                1e-2 * s.contact_stiffness_n_m() / s.contact_depth_m().powi(2),
                20.0 * s.contact_stiffness_n_m() / s.contact_depth_m().powi(2),
            ),
            0.3 * s.contact_stiffness_n_m() / s.contact_depth_m().powi(2),
        )]
    },
    install: |values, system| {
        system.bumper.cubic_n_m3 += values.get("kb3_n_m3");
        Ok(())
    },
};
