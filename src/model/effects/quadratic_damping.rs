//! Damping that grows with the square of the velocity: drag of air or fluid (Morison et al. 1950).

use super::{Effect, Parameter, Place};
use crate::model::system::{Point, Term};

/// `quadratic-damping`.
pub static EFFECT: Effect = Effect {
    name: "quadratic-damping",
    place: Place::Isolator,
    equation: "F = c2 v |v|",
    source: "J. R. Morison et al., J. Petrol. Technol. 2 (1950) 149 (drag)",
    states: "",
    regime: "all",
    shows: "loops A(D) thicker in proportion to amplitude squared; equivalent damping grows with A_G",
    experiment: "free flight at several A_G",
    piecewise_linear: false,
    parameters: |s| {
        vec![Parameter::either(
            "c2_n_s2_m2",
            "N s2/m2",
            "coefficient",
            2.0 * s.force_n / s.velocity_m_s.powi(2),
            0.05 * s.force_n / s.velocity_m_s.powi(2),
        )]
    },
    install: |values, system| {
        system.isolator_terms.push(Box::new(Quadratic { c2: values.get("c2_n_s2_m2") }));
        Ok(())
    },
};

struct Quadratic {
    c2: f64,
}

impl Term for Quadratic {
    fn force(&self, at: &Point, _: &[f64], _: &mut [f64]) -> f64 {
        self.c2 * at.velocity_m_s * at.velocity_m_s.abs()
    }
}
