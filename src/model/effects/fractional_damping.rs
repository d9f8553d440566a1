//! A springpot (Caputo 1967, Bagley and Torvik 1983) by its diffusive form:
//! D^alpha d = sin(pi alpha)/pi * integral over w of w^(alpha-1) phi(w, t), phi' = v - w phi, with the
//! integral over ln w by the trapezoid rule and the two tails in closed form.

use super::{Effect, Parameter, Place};
use crate::model::system::{Point, Relaxation, Term};
use std::f64::consts::PI;

/// `fractional-damping`.
pub static EFFECT: Effect = Effect {
    name: "fractional-damping",
    place: Place::Isolator,
    equation: "F = ca D^alpha d (springpot, Caputo, from rest)",
    source: "M. Caputo, Geophys. J. R. Astr. Soc. 13 (1967) 529; R. L. Bagley, P. J. Torvik, J. Rheol. 27 (1983) 201; K. Diethelm, Numer. Algorithms 47 (2008) 361 (diffusive form)",
    states: "15 relaxing states (m)",
    regime: "all",
    shows: "stiffness and loss grow together as f^alpha; long memory",
    experiment: "wide frequency range; relaxation over decades",
    piecewise_linear: false,
    parameters: |s| {
        vec![
            Parameter::not_negative(
                "ca",
                "N s^alpha/m",
                "coefficient",
                (1e-2 * s.stiffness_n_m(), 10.0 * s.stiffness_n_m()),
                0.1 * s.stiffness_n_m(),
            ),
            Parameter::positive("alpha", "1", "order, 0 a spring, 1 a dashpot", (0.05, 0.95), 0.5)
                .linear()
                .at_most(0.98),
        ]
    },
    install: |values, system| {
        system.isolator_terms.push(Box::new(SpringPot::new(
            values.get("ca"),
            values.get("alpha"),
            system.sample_period_s,
        )));
        Ok(())
    },
};

/// Relaxation rates carried as states.
const RATES: usize = 15;

struct SpringPot {
    /// Relaxation rates, 1/s.
    rates: [f64; RATES],
    /// Force per state, N/m.
    weights: [f64; RATES],
    /// Rates below the lowest: they have not relaxed yet, a spring.
    stiffness: f64,
    /// Rates above the highest: they have relaxed already, a dashpot.
    damping: f64,
    relaxations: [Relaxation; RATES],
}

impl SpringPot {
    fn new(ca: f64, alpha: f64, sample_period_s: f64) -> Self {
        // From the sampling rate down over 5 decades: slower relaxation than that looks like a spring.
        let highest = 1.0 / sample_period_s;
        let step = 1e5_f64.ln() / (RATES - 1) as f64;
        let rates = std::array::from_fn(|i| highest * (-step * (RATES - 1 - i) as f64).exp());
        let front = ca * (PI * alpha).sin() / PI;
        let weights = std::array::from_fn(|i| {
            let end = if i == 0 || i == RATES - 1 { 0.5 } else { 1.0 };
            end * front * step * f64::powf(rates[i], alpha)
        });
        let stiffness = front * f64::powf(rates[0], alpha) / alpha;
        let damping = front * f64::powf(highest, alpha - 1.0) / (1.0 - alpha);
        let relaxations = rates.map(|rate| Relaxation::new(rate, sample_period_s));
        Self { rates, weights, stiffness, damping, relaxations }
    }
}

impl Term for SpringPot {
    fn states(&self) -> usize {
        RATES
    }

    fn remembers(&self) -> bool {
        true
    }

    fn force(&self, at: &Point, state: &[f64], rate: &mut [f64]) -> f64 {
        let v = at.velocity_m_s;
        let mut force = self.stiffness * at.displacement_m + self.damping * v;
        let states = state.iter().zip(&self.rates).zip(&self.weights);
        for (of, ((u, decay), weight)) in rate.iter_mut().zip(states) {
            *of = v - decay * u;
            force += weight * u;
        }
        force
    }

    fn follow(&self, from: &Point, to: &Point, state: &mut [f64]) {
        for (u, relaxation) in state.iter_mut().zip(&self.relaxations) {
            *u = relaxation.after(*u, from.velocity_m_s, to.velocity_m_s);
        }
    }

    fn tangent_n_m(&self) -> f64 {
        self.weights.iter().sum()
    }
}
