//! Bumper pressed against a stop before it is touched.

use super::{Effect, Parameter, Place};

/// `bumper-preload`.
pub static EFFECT: Effect = Effect {
    name: "bumper-preload",
    place: Place::Bumper,
    equation: "F = F0 + Kb p + Cb p' in contact; the tip rests against a stop",
    source: "S. F. Masri, T. K. Caughey, J. Appl. Mech. 33 (1966) 586 (preloaded stops)",
    states: "",
    regime: "contact",
    shows: "a jump of F0 in A at first contact",
    experiment: "slow impacts; static squeeze",
    piecewise_linear: true,
    parameters: |s| {
        vec![Parameter::not_negative("f0_n", "N", "preload", (1e-2 * s.force_n, s.force_n), 0.1 * s.force_n)]
    },
    install: |values, system| {
        system.bumper.preload_n += values.get("f0_n");
        Ok(())
    },
};
