//! Spring and dashpot in series beside the main spring: relaxation (Maxwell 1867, Zener 1948).

use super::{Effect, Parameter, Place};
use crate::model::cubic::Cubic;
use crate::model::system::{Point, Relaxation, Term};

/// `maxwell-branch`.
pub static EFFECT: Effect = Effect {
    name: "maxwell-branch",
    place: Place::Isolator,
    equation: "F = km u, u' = v - u/tau",
    source: "J. C. Maxwell 1867; C. Zener, Elasticity and Anelasticity of Metals, 1948 (with the main spring)",
    states: "u (m)",
    regime: "all",
    shows: "stiffness rises and loss peaks around w tau = 1",
    experiment: "wide frequency range, or step relaxation",
    piecewise_linear: false,
    parameters: |s| {
        vec![
            Parameter::not_negative(
                "km_n_m",
                "N/m",
                "stiffness of the branch",
                (1e-2 * s.stiffness_n_m(), 10.0 * s.stiffness_n_m()),
                0.1 * s.stiffness_n_m(),
            ),
            Parameter::positive(
                "tau_s",
                "s",
                "relaxation time",
                (0.03 / s.angular_frequency_rad_s(), 30.0 / s.angular_frequency_rad_s()),
                1.0 / s.angular_frequency_rad_s(),
            ),
        ]
    },
    install: |values, system| {
        let (km, tau) = (values.get("km_n_m"), values.get("tau_s"));
        system.isolator_terms.push(Box::new(Maxwell {
            km,
            rate: 1.0 / tau,
            relaxation: Relaxation::new(1.0 / tau, system.sample_period_s),
        }));
        Ok(())
    },
};

struct Maxwell {
    km: f64,
    /// 1/tau, 1/s.
    rate: f64,
    relaxation: Relaxation,
}

impl Term for Maxwell {
    fn states(&self) -> usize {
        1
    }

    fn force(&self, at: &Point, state: &[f64], rate: &mut [f64]) -> f64 {
        rate[0] = at.velocity_m_s - self.rate * state[0];
        self.km * state[0]
    }

    fn follow(&self, course: &Cubic, state: &mut [f64]) {
        state[0] = self.relaxation.after(state[0], course);
    }

    fn tangent_n_m(&self) -> f64 {
        self.km
    }
}
