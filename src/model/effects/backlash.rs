//! Play in series with the isolator and its own hysteresis (Nordin and Gutman 2002). Friction of the bearings stays beside the joint.

use super::{Effect, Parameter, Place};

/// `backlash`.
pub static EFFECT: Effect = Effect {
    name: "backlash",
    place: Place::Joint,
    equation: "the isolator acts on e = d - joint; |d - e| <= b/2, no force while the joint is open, the element then relaxes on its own",
    source: "M. Nordin, P.-O. Gutman, Automatica 38 (2002) 1633",
    states: "e (m)",
    regime: "all, at reversals",
    shows: "flat stretch of width b in A(D) at every reversal",
    experiment: "slow cycles, small A_G",
    piecewise_linear: false,
    parameters: |s| {
        vec![Parameter::positive(
            "b_m",
            "m",
            "width of the play",
            (1e-3 * s.displacement_m, s.displacement_m),
            0.05 * s.displacement_m,
        )]
    },
    install: |values, system| {
        system.joint_half_width_m = Some(0.5 * values.get("b_m"));
        Ok(())
    },
};
