//! Dry friction of the bearings with true sticking (Coulomb 1785; Den Hartog 1931), or turned round smoothly over a velocity, as creep
//! of a bearing's seat and lubricant have it (survey of such laws: Pennestri et al. 2016).

use super::{Effect, Parameter, Place};
use crate::model::system::{Point, Term};

/// `coulomb-friction`.
pub static EFFECT: Effect = Effect {
    name: "coulomb-friction",
    place: Place::Bearings,
    equation: "F = Fc sign(v); sticks while the rest of the forces stay within Fc; with vt F = Fc tanh(v/vt), which creeps",
    source: "C. A. de Coulomb 1785; J. P. Den Hartog, Trans. ASME 53 (1931) APM-107; E. Pennestri et al., Nonlinear Dyn. 83 (2016) 1785",
    states: "",
    regime: "all; sticks at rest",
    shows: "free decay falls linearly; flat steps of D at reversals; a jump of 2 Fc in A(D) at v = 0",
    experiment: "free decay, or low A_G and slow cycles",
    piecewise_linear: true,
    parameters: |s| {
        vec![
            Parameter::not_negative(
                "fc_n",
                "N",
                "friction force",
                (1e-3 * s.force_n, 0.5 * s.force_n),
                0.02 * s.force_n,
            ),
            Parameter::not_negative(
                TURNING,
                "m/s",
                "velocity over which the force turns round; it sticks when left out",
                (0.0, 0.1 * s.velocity_m_s),
                0.01 * s.velocity_m_s,
            )
            .optional(0.0),
        ]
    },
    install: |values, system| {
        let (force_n, over_m_s) = (values.get("fc_n"), values.get(TURNING));
        if over_m_s > 0.0 {
            system.mass_terms.push(Box::new(Smooth { force_n, over_m_s }));
        } else {
            system.add_friction(force_n, force_n, f64::INFINITY, 2.0);
        }
        Ok(())
    },
};

/// Key of the velocity over which the force turns round.
pub const TURNING: &str = "vt_m_s";

struct Smooth {
    force_n: f64,
    over_m_s: f64,
}

impl Term for Smooth {
    fn force(&self, at: &Point, _: &[f64], _: &mut [f64]) -> f64 {
        self.force_n * (at.velocity_m_s / self.over_m_s).tanh()
    }
}
