//! Spring-slider (Jenkins) elements in parallel with a power-law spread of yields (Iwan 1966, Segalman
//! 2005), in closed form: the virgin curve is integrated once, and every branch after a reversal is
//! the virgin curve doubled (Masing), with reversals wiped out when a loop closes.

use super::{Effect, Parameter, Place};
use crate::model::ModelError;
use crate::model::system::{Point, Term};

/// `iwan-hysteresis`.
pub static EFFECT: Effect = Effect {
    name: "iwan-hysteresis",
    place: Place::Isolator,
    equation: "F = Preisach-Masing sum of Jenkins elements, density of stiffness over yield y ~ y^exponent on [yield_min, yield_max], total kp",
    source: "W. D. Iwan, J. Appl. Mech. 33 (1966) 893; D. J. Segalman, J. Appl. Mech. 72 (2005) 752",
    states: "memory of reversals",
    regime: "all",
    shows: "rate-independent loops, loss per cycle a power of amplitude, softening, memory of the largest excursion",
    experiment: "loops at several A_G and rates",
    piecewise_linear: false,
    parameters: |s| {
        vec![
            Parameter::not_negative(
                "kp_n_m",
                "N/m",
                "stiffness before any slip",
                (1e-2 * s.stiffness_n_m(), 10.0 * s.stiffness_n_m()),
                0.2 * s.stiffness_n_m(),
            ),
            Parameter::either("exponent", "1", "exponent of the density over yield, above -1", 1.0, -0.5)
                .at_least(LEAST)
                .at_most(3.0),
            Parameter::not_negative(
                "yield_min_m",
                "m",
                "smallest yield",
                (1e-3 * s.displacement_m, 0.3 * s.displacement_m),
                1e-2 * s.displacement_m,
            ),
            Parameter::positive(
                "yield_max_m",
                "m",
                "largest yield",
                (0.1 * s.displacement_m, 3.0 * s.displacement_m),
                s.displacement_m,
            ),
        ]
    },
    install: |values, system| {
        let [kp, exponent, low, high] =
            ["kp_n_m", "exponent", "yield_min_m", "yield_max_m"].map(|name| values.get(name));
        if low >= high {
            return Err(ModelError::invalid(
                values.key("yield_min_m"),
                format!("{low} m; allowed: below yield_max_m ({high} m)"),
            ));
        }
        system.isolator_terms.push(Box::new(Iwan::new(kp, exponent, low, high)));
        Ok(())
    },
};

/// Least exponent: at -1 all stiffness would yield at once.
const LEAST: f64 = -0.98;
/// Reversals remembered; beyond that those two go whose neighbours are most like them.
const DEPTH: usize = 64;
/// Ranges of the elements by which a motion is taken to have come from elsewhere once all of them slip.
const ELSEWHERE: f64 = 1e3;

struct Iwan {
    exponent: f64,
    low: f64,
    high: f64,
    /// Density of stiffness is `density * y^exponent`.
    density: f64,
    /// `low^(exponent + 2)` and `high^(exponent + 1)`.
    ends: [f64; 2],
    /// Reversals, outermost first: each lies within the two before it.
    turns: [(f64, f64); DEPTH],
    count: usize,
    last: f64,
    direction: f64,
}

impl Iwan {
    fn new(kp: f64, exponent: f64, low: f64, high: f64) -> Self {
        let m = exponent + 1.0;
        let density = kp * m / (high.powf(m) - low.powf(m));
        let ends = [low.powf(m + 1.0), high.powf(m)];
        let turns = [(0.0, 0.0); DEPTH];
        Self { exponent, low, high, density, ends, turns, count: 0, last: 0.0, direction: 0.0 }
    }

    /// Force after a monotonic deformation `x >= 0` from the virgin state: sum of min(x, y).
    fn virgin(&self, x: f64) -> f64 {
        let (m, c) = (self.exponent + 1.0, self.density);
        let split = x.clamp(self.low, self.high);
        let power = split.powf(m);
        let slipping = (power * split - self.ends[0]) / (m + 1.0);
        let holding = x * (self.ends[1] - power) / m;
        c * (slipping + holding)
    }

    /// Reversals still in force when the motion has come to `x`.
    fn active(&self, x: f64) -> usize {
        let mut count = self.count;
        while count > 0 {
            let (top, _) = self.turns[count - 1];
            let reach = if count >= 2 { (self.turns[count - 2].0 - top).abs() } else { 2.0 * top.abs() };
            let towards = if count >= 2 { self.turns[count - 2].0 - top } else { -top };
            if (x - top) * towards < 0.0 || (x - top).abs() < reach {
                break;
            }
            count -= count.min(2);
        }
        count
    }

    /// Takes note of a reversal at the place last taken note of.
    fn turn(&mut self) {
        let force = self.at(self.last);
        if self.slips() {
            // All elements slip one way: whatever was before is forgotten.
            let away = ELSEWHERE * self.high * self.direction;
            self.turns[0] = (self.last - away, -force);
            self.count = 1;
        } else if self.count == DEPTH {
            self.merge();
        }
        self.turns[self.count] = (self.last, force);
        self.count += 1;
    }

    /// Whether all elements slip at the place last taken note of.
    fn slips(&self) -> bool {
        match self.count.checked_sub(1) {
            Some(turn) => (self.last - self.turns[turn].0).abs() >= 2.0 * self.high,
            None => self.last.abs() >= self.high,
        }
    }

    /// Forgets two reversals that follow each other and are nearest to those two before them: a motion that settles leaves loops that
    /// are next to the same.
    fn merge(&mut self) {
        let place = |i: usize| self.turns[i].0;
        let apart = |i: usize| (place(i) - place(i + 2)).abs() + (place(i + 1) - place(i + 3)).abs();
        if let Some(i) = (0..DEPTH - 3).min_by(|a, b| apart(*a).total_cmp(&apart(*b))) {
            self.turns.copy_within(i + 4.., i + 2);
            self.count -= 2;
        }
    }

    /// Force on the branch that the reversals so far lead to.
    fn at(&self, x: f64) -> f64 {
        match self.active(x) {
            0 => self.virgin(x.abs()).copysign(x),
            count => self.from(self.turns[count - 1], x),
        }
    }

    /// Force on the branch that begins at a reversal.
    fn from(&self, (turn, force): (f64, f64), x: f64) -> f64 {
        force + (2.0 * self.virgin(0.5 * (x - turn).abs())).copysign(x - turn)
    }

    /// How far back from the place last taken note of a new branch leads, until it meets the one that it left.
    fn loop_width(&self) -> f64 {
        let count = self.active(self.last);
        let from = count.checked_sub(1).map_or(-self.last, |turn| self.turns[turn].0);
        (self.last - from).abs()
    }
}

impl Term for Iwan {
    fn turns(&self) -> bool {
        true
    }

    fn force(&self, at: &Point, _: &[f64], _: &mut [f64]) -> f64 {
        let (x, back) = (at.displacement_m, at.displacement_m - self.last);
        // A reversal that is not taken note of yet has its branch all the same.
        if back * self.direction < 0.0 && back.abs() < self.loop_width() {
            return self.from((self.last, self.at(self.last)), x);
        }
        self.at(x)
    }

    fn retraces(&self) -> bool {
        true
    }

    fn commit(&mut self, displacement_m: f64) {
        let step = displacement_m - self.last;
        if step == 0.0 {
            return;
        }
        if step * self.direction < 0.0 {
            self.turn();
        }
        self.count = self.active(displacement_m);
        self.direction = step.signum();
        self.last = displacement_m;
    }

    fn reset(&mut self) {
        (self.count, self.last, self.direction) = (0, 0.0, 0.0);
    }

    fn tangent_n_m(&self) -> f64 {
        self.virgin(self.low.max(1e-9 * self.high)) / self.low.max(1e-9 * self.high)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// Elements that slip one by one: spring force over stiffness, and yield.
    struct Elements(Vec<(f64, f64)>);

    impl Elements {
        fn force(&mut self, step: f64) -> f64 {
            let each = |(u, y): &mut (f64, f64)| {
                *u = (*u + step).clamp(-*y, *y);
                *u
            };
            self.0.iter_mut().map(each).sum::<f64>() / self.0.len() as f64
        }
    }

    /// A decay from far beyond the largest yield turns hundreds of times; so does one that has settled but for what noise makes of it.
    #[test]
    fn a_motion_that_turns_often_is_remembered() {
        // As many elements in each part of the yields: an exponent of 0.
        let (low, high, many) = (2e-4, 5.5e-3, 4000);
        let spread = |i: usize| low + (high - low) * (i as f64 + 0.5) / f64::from(many);
        let mut elements = Elements((0..many as usize).map(|i| (0.0, spread(i))).collect());
        let mut iwan = Iwan::new(1.0, 0.0, low, high);
        let (mut last, mut worst) = (0.0, 0.0_f64);
        for n in 0..30_000 {
            let cycle = n as f64 / 100.0;
            // Down to 4.3 mm; then by a micrometre a cycle, up and down by turns of the offset.
            let amplitude = 4.3e-3 + 0.03 * (-cycle / 12.0).exp() + 1e-6 * (1.0 - cycle / 300.0);
            let x = amplitude * (TAU * cycle).sin() + 2e-4 * (0.02 * cycle).sin();
            iwan.commit(x);
            let (closed, summed) = (iwan.at(x), elements.force(x - last));
            last = x;
            worst = worst.max((closed - summed).abs());
        }
        let largest = iwan.virgin(high);
        assert!(worst < 2e-3 * largest, "{worst} of {largest}");
    }
}
