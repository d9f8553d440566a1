//! A springpot (Caputo 1967, Bagley and Torvik 1983) by its diffusive form:
//! D^alpha d = sin(pi alpha)/pi * integral over w of w^(alpha-1) phi(w, t), phi' = v - w phi, with the
//! integral over ln w by the trapezoid rule, whose two endless tails are summed in closed form. At 2048 Hz the force for a sine is within 0.15 %
//! from 0.05 to 15 Hz, and within 2 % up to 50 Hz; farther up with more states, where [`FASTEST`] asks for them: a solver's steps are short then.

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
    states: "10 relaxing states (m), 12 at most for faster motions",
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
            Parameter::not_negative(
                FASTEST,
                "Hz",
                "frequency up to which the motion goes; 0: what a 125th of the rate is enough for",
                (0.0, 0.1 / s.sample_period_s),
                0.0,
            )
            .optional(0.0)
            .linear()
            .chosen(),
        ]
    },
    install: |values, system| {
        system.isolator_terms.push(Box::new(SpringPot::new(
            values.get("ca"),
            values.get("alpha"),
            (system.sample_period_s, values.get(FASTEST)),
        )));
        Ok(())
    },
};

/// How high a frequency the force holds for, where the sampling rate alone does not tell.
pub const FASTEST: &str = "fastest_hz";
/// Relaxation rates carried as states, from a quarter of the sampling rate down over so many nepers (4.4 decades): slower relaxation
/// than that looks like a spring.
const RATES: usize = 10;
const HIGHEST: f64 = 0.25;
const RANGE: f64 = 4.4 * std::f64::consts::LN_10;
/// So many more at most, as far apart, and the highest rate over the angular frequency of a motion: stiffness, dashpot and order make up for each other about
/// a resonance, and a force that is 0.1 % off there moves them by tenths.
const MORE: usize = 2;
const ABOVE: f64 = 15.0;

/// The springpot of one sample period.
pub(in crate::model) struct SpringPot {
    /// Relaxation rates, 1/s.
    pub(in crate::model) rates: Vec<f64>,
    /// Force per state, N/m.
    pub(in crate::model) weights: Vec<f64>,
    /// Rates below the lowest: they have not relaxed yet, a spring. N/m.
    pub(in crate::model) stiffness: f64,
    /// Rates above the highest: they have relaxed already, a dashpot. N s/m.
    pub(in crate::model) damping: f64,
    relaxations: Vec<Relaxation>,
}

impl SpringPot {
    /// For ca (N s^alpha/m), alpha, a sample period (s) and the frequency up to which the force is to hold (Hz; 0: what ten states do).
    pub(in crate::model) fn new(ca: f64, alpha: f64, (sample_period_s, fastest_hz): (f64, f64)) -> Self {
        let step = RANGE / (RATES - 1) as f64;
        let usual = HIGHEST / sample_period_s;
        let more = (ABOVE * 2.0 * PI * fastest_hz / usual).max(1.0).ln() / step;
        let count = RATES + (more.ceil() as usize).min(MORE);
        let rates: Vec<f64> =
            (0..count).map(|i| usual * (step * (i as f64 - (RATES - 1) as f64)).exp()).collect();
        let highest = rates[count - 1];
        let front = ca * (PI * alpha).sin() / PI;
        let mut weights: Vec<f64> = rates.iter().map(|rate| front * step * rate.powf(alpha)).collect();
        // Beyond both ends the rule goes on without end, a geometric series. To second order in frequency over rate what lies there is a
        // spring, or a dashpot, and more of the last rate.
        let beyond = |order: f64| 1.0 / (step * order).exp_m1();
        let (first, last) = (weights[0], weights[count - 1]);
        let (slower, faster) = (first * beyond(1.0 + alpha), last * beyond(2.0 - alpha));
        weights[0] += slower;
        weights[count - 1] += faster;
        let stiffness = first * beyond(alpha) - slower;
        let damping = (last * beyond(1.0 - alpha) - faster) / highest;
        let relaxations = rates.iter().map(|rate| Relaxation::new(*rate, sample_period_s)).collect();
        Self { rates, weights, stiffness, damping, relaxations }
    }
}

impl Term for SpringPot {
    fn states(&self) -> usize {
        self.rates.len()
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
        let usual =
            [(0.05, 1.5e-3), (0.3, 1.5e-3), (1.1, 1.5e-3), (4.0, 1.5e-3), (15.0, 1.5e-3), (50.0, 0.02)];
        let fast = [(0.05, 1.5e-3), (1.1, 1.5e-3), (15.0, 1.5e-3), (45.0, 1.5e-3), (100.0, 2e-3)];
        for (alpha, (fastest_hz, at)) in [0.05, 0.2, 0.5, 0.8, 0.95]
            .into_iter()
            .flat_map(|alpha| [(0.0, &usual[..]), (100.0, &fast[..])].map(|of| (alpha, of)))
        {
            let pot = SpringPot::new(ca, alpha, (1.0 / 2048.0, fastest_hz));
            assert!(pot.stiffness > 0.0 && pot.damping > 0.0 && pot.weights.iter().all(|w| *w > 0.0));
            for (hz, permitted) in at {
                let s = Complex64::new(0.0, 2.0 * PI * hz);
                let states = pot.rates.iter().zip(&pot.weights).map(|(rate, weight)| weight * s / (s + rate));
                let force = states.sum::<Complex64>() + pot.stiffness + pot.damping * s;
                let off = (force / (ca * s.powf(alpha)) - 1.0).norm();
                assert!(off < *permitted, "alpha {alpha} at {hz} Hz: {off}");
            }
        }
    }
}
