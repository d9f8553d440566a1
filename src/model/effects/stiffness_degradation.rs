//! Isolator that softens with use: scragging, Mullins effect, self-heating (Mullins 1947).

use super::{Effect, Parameter, Place};
use crate::model::system::Degradation;

/// `stiffness-degradation`.
pub static EFFECT: Effect = Effect {
    name: "stiffness-degradation",
    place: Place::Isolator,
    equation: "k(t) = k (1 - delta (1 - exp(-t/tau))), all slopes alike",
    source: "L. Mullins, J. Rubber Res. 16 (1947) 275; ISO 22762-1 (scragging)",
    states: "",
    regime: "all, with time",
    shows: "the same frequency gives another response on the way back: forward and backward curves part",
    experiment: "repeat or reverse the sweep",
    piecewise_linear: false,
    parameters: |s| {
        vec![
            Parameter::either("delta", "1", "share of the stiffness lost in the end", 0.5, 0.1).at_most(1.0),
            Parameter::positive(
                "tau_s",
                "s",
                "time constant",
                (0.02 * s.duration_s, 3.0 * s.duration_s),
                0.3 * s.duration_s,
            ),
        ]
    },
    install: |values, system| {
        system.degradation =
            Some(Degradation { delta: values.get("delta"), rate: 1.0 / values.get("tau_s") });
        Ok(())
    },
};
