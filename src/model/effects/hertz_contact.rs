//! Contact stiffness of curved bodies in place of a linear bumper (Hertz 1882).

use super::{Effect, Parameter, Place};
use crate::model::ModelError;

/// Exponents that are sought.
const LEAST: f64 = 1.05;
const MOST: f64 = 3.0;

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
        // The same stiffness at the usual depth is another coefficient with another exponent: by orders of magnitude.
        let (one, other) = (s.contact_coefficient(LEAST), s.contact_coefficient(MOST));
        vec![
            Parameter::positive(
                "kh",
                "N/m^n",
                "stiffness coefficient",
                (0.5 * one.min(other), 2.0 * one.max(other)),
                s.contact_coefficient(1.5),
            ),
            Parameter::positive("n", "1", "exponent, 1.5 for spheres", (LEAST, MOST), 1.5)
                .linear()
                .at_least(1.0)
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
