//! Stiffness that changes with the square of the displacement (Duffing 1918).

use super::{Effect, Parameter, Place};
use crate::model::system::{Point, Term};

/// `cubic-stiffness`.
pub static EFFECT: Effect = Effect {
    name: "cubic-stiffness",
    place: Place::Isolator,
    equation: "F = k3 d^3",
    source: "G. Duffing, Erzwungene Schwingungen bei veraenderlicher Eigenfrequenz, 1918",
    states: "",
    regime: "all, large |D|",
    shows: "backbone leans: resonance moves with A_G; third harmonic",
    experiment: "free flight at several A_G",
    piecewise_linear: false,
    parameters: |s| {
        vec![Parameter::either(
            "k3_n_m3",
            "N/m3",
            "coefficient, either sign",
            2.0 * s.force_n / s.displacement_m.powi(3),
            0.05 * s.force_n / s.displacement_m.powi(3),
        )]
    },
    install: |values, system| {
        system.isolator_terms.push(Box::new(Cubic { k3: values.get("k3_n_m3") }));
        Ok(())
    },
};

struct Cubic {
    k3: f64,
}

impl Term for Cubic {
    fn force(&self, at: &Point, _: &[f64], _: &mut [f64]) -> f64 {
        let d = at.displacement_m;
        self.k3 * d * d * d
    }
}
