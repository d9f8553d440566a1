//! Dry friction of the bearings with true sticking (Coulomb 1785; Den Hartog 1931).

use super::{Effect, Parameter, Place};

/// `coulomb-friction`.
pub static EFFECT: Effect = Effect {
    name: "coulomb-friction",
    place: Place::Bearings,
    equation: "F = Fc sign(v); sticks while the rest of the forces stay within Fc",
    source: "C. A. de Coulomb 1785; J. P. Den Hartog, Trans. ASME 53 (1931) APM-107",
    states: "",
    regime: "all; sticks at rest",
    shows: "free decay falls linearly; flat steps of D at reversals; a jump of 2 Fc in A(D) at v = 0",
    experiment: "free decay, or low A_G and slow cycles",
    piecewise_linear: true,
    parameters: |s| {
        vec![Parameter::not_negative(
            "fc_n",
            "N",
            "friction force",
            (1e-3 * s.force_n, 0.5 * s.force_n),
            0.02 * s.force_n,
        )]
    },
    install: |values, system| {
        system.add_friction(values.get("fc_n"), values.get("fc_n"), f64::INFINITY);
        Ok(())
    },
};
