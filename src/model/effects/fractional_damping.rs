//! A springpot (Caputo 1967, Bagley and Torvik 1983) by its diffusive form:
//! D^alpha d = sin(pi alpha)/pi * integral over w of w^(alpha-1) phi(w, t), phi' = v - w phi, with the
//! integral over ln w by the trapezoid rule, whose two endless tails are summed in closed form. At 2048 Hz the force for a sine is within 0.15 %
//! from 0.05 to 15 Hz, and within 2 % up to 50 Hz.

use super::{Effect, Parameter, Place};
use crate::model::cubic::Cubic;
use crate::model::system::{Point, Relaxation, Term};
use std::f64::consts::PI;

/// `fractional-damping`.
pub static EFFECT: Effect = Effect {
    name: "fractional-damping",
    place: Place::Isolator,
    equation: "F = ca D^alpha d (springpot, Caputo, from rest)",
    source: "M. Caputo, Geophys. J. R. Astr. Soc. 13 (1967) 529; R. L. Bagley, P. J. Torvik, J. Rheol. 27 (1983) 201; K. Diethelm, Numer. Algorithms 47 (2008) 361 (diffusive form)",
    states: "10 relaxing states (m)",
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

/// Relaxation rates carried as states, from a quarter of the sampling rate down over so many nepers (4.4 decades): slower relaxation
/// than that looks like a spring.
const RATES: usize = 10;
const HIGHEST: f64 = 0.25;
const RANGE: f64 = 4.4 * std::f64::consts::LN_10;

/// The springpot of one sample period.
pub(in crate::model) struct SpringPot {
    /// Relaxation rates, 1/s.
    pub(in crate::model) rates: [f64; RATES],
    /// Force per state, N/m.
    pub(in crate::model) weights: [f64; RATES],
    /// Rates below the lowest: they have not relaxed yet, a spring. N/m.
    pub(in crate::model) stiffness: f64,
    /// Rates above the highest: they have relaxed already, a dashpot. N s/m.
    pub(in crate::model) damping: f64,
    relaxations: [Relaxation; RATES],
}

impl SpringPot {
    /// For ca (N s^alpha/m), alpha and a sample period (s).
    pub(in crate::model) fn new(ca: f64, alpha: f64, sample_period_s: f64) -> Self {
        let step = RANGE / (RATES - 1) as f64;
        let highest = HIGHEST / sample_period_s;
        let rates: [f64; RATES] = std::array::from_fn(|i| highest * (-step * (RATES - 1 - i) as f64).exp());
        let front = ca * (PI * alpha).sin() / PI;
        let mut weights = rates.map(|rate| front * step * rate.powf(alpha));
        // Beyond both ends the rule goes on without end, a geometric series. To second order in frequency over rate what lies there is a
        // spring, or a dashpot, and more of the last rate.
        let beyond = |order: f64| 1.0 / (step * order).exp_m1();
        let (first, last) = (weights[0], weights[RATES - 1]);
        let (slower, faster) = (first * beyond(1.0 + alpha), last * beyond(2.0 - alpha));
        weights[0] += slower;
        weights[RATES - 1] += faster;
        let stiffness = first * beyond(alpha) - slower;
        let damping = (last * beyond(1.0 - alpha) - faster) / highest;
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

    fn follow(&self, course: &Cubic, state: &mut [f64]) {
        for (u, relaxation) in state.iter_mut().zip(&self.relaxations) {
            *u = relaxation.after(*u, course);
        }
    }

    fn tangent_n_m(&self) -> f64 {
        self.weights.iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realfft::num_complex::Complex64;

    #[test]
    fn the_force_for_a_sine_is_that_of_the_fractional_derivative() {
        let ca = 500.0;
        for alpha in [0.05, 0.2, 0.5, 0.8, 0.95] {
            let pot = SpringPot::new(ca, alpha, 1.0 / 2048.0);
            assert!(pot.stiffness > 0.0 && pot.damping > 0.0 && pot.weights.iter().all(|w| *w > 0.0));
            for (hz, permitted) in
                [(0.05, 1.5e-3), (0.3, 1.5e-3), (1.1, 1.5e-3), (4.0, 1.5e-3), (15.0, 1.5e-3), (50.0, 0.02)]
            {
                let s = Complex64::new(0.0, 2.0 * PI * hz);
                let states = pot.rates.iter().zip(&pot.weights).map(|(rate, weight)| weight * s / (s + rate));
                let force = states.sum::<Complex64>() + pot.stiffness + pot.damping * s;
                let off = (force / (ca * s.powf(alpha)) - 1.0).norm();
                assert!(off < permitted, "alpha {alpha} at {hz} Hz: {off}");
            }
        }
    }
}
