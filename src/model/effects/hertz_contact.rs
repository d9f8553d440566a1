//! Contact stiffness of curved bodies in place of a linear bumper (Hertz 1882).

use super::{Effect, Parameter, Place};
use crate::model::ModelError;

/// `hertz-contact`.
pub static EFFECT: Effect = Effect {
    name: "hertz-contact",
    place: Place::Bumper,
    equation: "F = kh p^n in place of Kb p",
    source: "H. Hertz, J. reine angew. Math. 92 (1882) 156; W. Goldsmith, Impact, 1960",
    states: "",
    regime: "contact",
    shows: "contact starts softly; contact time falls as v^(1 - n)/(1 + n), v^-1/5 for n = 3/2",
    experiment: "impacts at several A_G; static squeeze",
    piecewise_linear: false,
    parameters: |s| {
        vec![
            Parameter::not_negative(
                "kh",
                "N/m^n",
                "stiffness coefficient",
                (
                    0.05 * s.contact_stiffness_n_m() * s.contact_depth_m().powf(-0.5),
                    20.0 * s.contact_stiffness_n_m() * s.contact_depth_m().powf(-0.5),
                ),
                s.contact_stiffness_n_m() * s.contact_depth_m().powf(-0.5),
            ),
            Parameter::positive("n", "1", "exponent, 1.5 for spheres", (1.05, 3.0), 1.5)
                .linear()
                .at_most(10.0),
        ]
    },
    install: |values, system| {
        let n = values.get("n");
        if n < 1.0 {
            return Err(ModelError::invalid(values.key("n"), format!("{n}; allowed: 1 to 10")));
        }
        system.bumper.linear_n_m = 0.0;
        (system.bumper.hertz, system.bumper.exponent) = (values.get("kh"), n);
        Ok(())
    },
};
