//! Rate-independent hysteresis of Bouc (1967) and Wen (1976).

use super::{Effect, Parameter, Place};
use crate::model::cubic::Cubic;
use crate::model::system::{Point, Term};

/// `bouc-wen-hysteresis`.
pub static EFFECT: Effect = Effect {
    name: "bouc-wen-hysteresis",
    place: Place::Isolator,
    equation: "F = kh z, z' = v (1 - (beta sign(v z) + gamma) |z/dy|^n)",
    source: "R. Bouc 1967; Y.-K. Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249",
    states: "z (m)",
    regime: "all",
    shows: "closed, rate-independent loops A(D) with rounded corners; softening with amplitude",
    experiment: "slow cycles at several A_G",
    piecewise_linear: false,
    parameters: |s| {
        vec![
            Parameter::not_negative(
                "kh_n_m",
                "N/m",
                "stiffness of the hysteretic part",
                (1e-2 * s.stiffness_n_m(), 10.0 * s.stiffness_n_m()),
                0.2 * s.stiffness_n_m(),
            ),
            Parameter::positive(
                "dy_m",
                "m",
                "yield displacement",
                (1e-2 * s.displacement_m, s.displacement_m),
                0.2 * s.displacement_m,
            ),
            Parameter::positive("n", "1", "sharpness of the yield", (1.0, 10.0), 1.0)
                .optional(1.0)
                .at_most(100.0),
            // Only their sum over dy^n counts beside their ratio.
            Parameter::either("beta", "1", "loading shape, 1 - gamma when left out", 2.0, 0.5).optional(0.5),
            Parameter::either("gamma", "1", "unloading shape", 2.0, 0.5).optional(0.5),
        ]
    },
    install: |values, system| {
        let [kh, dy, n] = ["kh_n_m", "dy_m", "n"].map(|name| values.get(name));
        let gamma = values.get("gamma");
        let beta = values.spec().parameters.get("beta").copied().unwrap_or(1.0 - gamma);
        system.isolator_terms.push(Box::new(BoucWen {
            kh,
            inverse_dy: 1.0 / dy,
            n,
            beta,
            gamma,
            integer: n.fract() == 0.0,
        }));
        Ok(())
    },
};

struct BoucWen {
    kh: f64,
    inverse_dy: f64,
    n: f64,
    beta: f64,
    gamma: f64,
    /// An integer power needs no logarithm.
    integer: bool,
}

/// Steps for a yield displacement, and for the way of one sample at most; a sharp yield, within dy/n, takes more of both.
const STEPS: f64 = 10.0;
const MOST_STEPS: f64 = 64.0;
const SHARP: f64 = 5.0;

impl BoucWen {
    /// dz/dd while moving with the sign of `v`.
    fn slope(&self, z: f64, v: f64) -> f64 {
        let reach = (z * self.inverse_dy).abs();
        let power = if self.integer { reach.powi(self.n as i32) } else { reach.powf(self.n) };
        let shape = if v * z >= 0.0 { self.beta + self.gamma } else { self.gamma - self.beta };
        1.0 - shape * power
    }

    /// z after a way that does not turn: steps of Heun's, each a tenth of dy or of a sharp yield.
    fn moved(&self, mut z: f64, way_m: f64) -> f64 {
        let sharper = (self.n / SHARP).max(1.0);
        let steps = (STEPS * sharper * way_m.abs() * self.inverse_dy).ceil().min(MOST_STEPS * sharper);
        let h = way_m / steps.max(1.0);
        for _ in 0..steps as usize {
            let first = self.slope(z, h);
            z += 0.5 * h * (first + self.slope(z + h * first, h));
        }
        z
    }
}

impl Term for BoucWen {
    fn states(&self) -> usize {
        1
    }

    fn turns(&self) -> bool {
        true
    }

    fn force(&self, at: &Point, state: &[f64], rate: &mut [f64]) -> f64 {
        rate[0] = at.velocity_m_s * self.slope(state[0], at.velocity_m_s);
        self.kh * state[0]
    }

    fn follow(&self, course: &Cubic, state: &mut [f64]) {
        // z depends on the way alone, out to where the motion turns and back.
        let turn = course.turns_at_m().unwrap_or(course.to.0);
        state[0] = self.moved(state[0], turn - course.from.0);
        state[0] = self.moved(state[0], course.to.0 - turn);
    }

    fn tangent_n_m(&self) -> f64 {
        self.kh
    }
}
