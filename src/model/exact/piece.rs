//! One linear piece: d'' + 2 alpha d' + w^2 d = -a(t) - g, its power series and exact transition.

use super::input::{Input, TERMS, Wave};
use crate::model::general::Line;

/// Coefficients of one regime, per unit mass.
#[derive(Clone, Copy, Debug, Default)]
pub struct Piece {
    /// Damping over mass, 1/s.
    pub damping: f64,
    /// Stiffness over mass, 1/s2.
    pub stiffness: f64,
    /// Constant force over mass, m/s2.
    pub constant: f64,
    /// Displacements between which no event of knees or free gaps can lie, m.
    pub range: (f64, f64),
}

/// Power series of displacement about a time.
#[derive(Clone, Copy, Debug)]
pub struct Series([f64; TERMS]);

impl Series {
    /// Displacement and velocity after `s` seconds.
    pub fn at(&self, s: f64) -> (f64, f64) {
        let (mut d, mut v) = (0.0, 0.0);
        for n in (0..TERMS).rev() {
            v = v * s + d;
            d = d * s + self.0[n];
        }
        (d, v)
    }
}

impl Piece {
    /// The solution through (d, v) under an input, about a time since the start of the sample.
    pub fn series<I: Input>(&self, (d, v): (f64, f64), input: I, time_s: f64) -> Series {
        let a = input.series(time_s);
        let mut x = [0.0; TERMS];
        (x[0], x[1]) = (d, v);
        for n in 0..TERMS - 2 {
            let m = n as f64;
            let constant = if n == 0 { self.constant } else { 0.0 };
            let force = -a[n] - constant - self.damping * (m + 1.0) * x[n + 1] - self.stiffness * x[n];
            x[n + 2] = force / ((m + 1.0) * (m + 2.0));
        }
        Series(x)
    }

    /// Exact transition over one sample.
    pub fn transition<I: Input>(&self, h: f64, first: I, second: I) -> Transition {
        let still = Line { start: 0.0, slope: 0.0 };
        let free = Self { constant: 0.0, ..*self };
        let column = |state: (f64, f64)| free.series(state, still, 0.0).at(h);
        let (a, b) = (column((1.0, 0.0)), column((0.0, 1.0)));
        let (p, q) = (free.series((0.0, 0.0), first, 0.0).at(h), free.series((0.0, 0.0), second, 0.0).at(h));
        let c = self.series((0.0, 0.0), still, 0.0).at(h);
        Transition { d: [a.0, b.0, p.0, q.0, c.0], v: [a.1, b.1, p.1, q.1, c.1] }
    }

    /// Transition under a first-order hold, by its values at the beginning and end of the sample.
    pub fn hold(&self, h: f64) -> Transition {
        self.transition(h, Line { start: 1.0, slope: -1.0 / h }, Line { start: 0.0, slope: 1.0 / h })
    }

    /// Transition under a sine, by its value and quadrature at the beginning of the sample.
    pub fn wave(&self, h: f64, angular_frequency: f64) -> Transition {
        let unit = |value, quadrature| Wave { value, quadrature, angular_frequency };
        self.transition(h, unit(1.0, 0.0), unit(0.0, 1.0))
    }
}

/// Rows of the transition of one sample: by displacement, velocity, both input numbers, constant.
#[derive(Clone, Copy, Debug, Default)]
pub struct Transition {
    d: [f64; 5],
    v: [f64; 5],
}

impl Transition {
    /// State after the sample.
    #[inline]
    pub fn apply(&self, d: f64, v: f64, p: f64, q: f64) -> (f64, f64) {
        let row = |r: &[f64; 5]| (r[2] * p + r[3] * q + r[4]) + (r[0] * d + r[1] * v);
        (row(&self.d), row(&self.v))
    }
}
