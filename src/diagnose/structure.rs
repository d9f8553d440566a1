//! Is there structure in what an explanation leaves? A flexible model of the residual force - a surface over (D, D'), lines over
//! D for each sign of D', slow changes over the record, memory of several kinds - is fitted to the training steps and
//! judged on the held-out ones. Structure comes back on steps that were not seen; noise that a stiff contact carries
//! into the force does not. The verdict "outside the catalogue" stands on it.

use crate::identify::problem::{Part, Problem};
use crate::identify::refit::Refit;
use nalgebra::{DMatrix, DVector};

/// What the flexible model finds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Structure {
    /// Fall of the mean square of the held-out residuals, in units of their noise.
    pub explained: f64,
}

/// Samples that are used at most.
const SAMPLES: usize = 40_000;
/// Knots of the surface along each axis, of the lines over D, and over the record.
const GRID: usize = 9;
const LINE: usize = 25;
const TIMES: usize = 6;
/// Relaxation times and widths of play, over the typical period and the largest displacement.
const RELAXATIONS: [f64; 4] = [0.02, 0.1, 0.4, 1.5];
const PLAYS: [f64; 4] = [0.02, 0.1, 0.3, 0.6];
/// Shape, place over the record, frequency and memory: three of each time knot, two of frequency.
const FEATURES: usize = GRID * GRID + 2 * LINE + 3 * TIMES + 2 + RELAXATIONS.len() + 2 * PLAYS.len();
/// Prior of each coefficient, in units of the residual's noise: broad.
const PRIOR: f64 = 30.0;

/// Examines what a fitted model leaves; `None` when it cannot be evaluated.
pub fn examine(problem: &Problem<'_>, refit: &Refit) -> Option<Structure> {
    let mut residuals = [Vec::new(), Vec::new()];
    for (out, part) in residuals.iter_mut().zip([Part::Training, Part::HeldOut]) {
        if !problem.force_residuals(&refit.spec, refit.zero_m, part, out) {
            return None;
        }
    }
    let stride = residuals[0].len().div_ceil(SAMPLES).max(1);
    let basis = Basis::new(problem);
    let mut normal = DMatrix::<f64>::zeros(FEATURES, FEATURES);
    let mut right = DVector::<f64>::zeros(FEATURES);
    basis.visit(problem, Part::Training, &residuals[0], stride, |row, r| {
        for &(i, x) in row {
            right[i] += x * r;
            for &(j, y) in row {
                normal[(i, j)] += x * y;
            }
        }
    });
    for i in 0..FEATURES {
        normal[(i, i)] += PRIOR.powi(-2);
    }
    let coefficients = normal.cholesky()?.solve(&right);
    let (mut fall, mut count) = (0.0, 0usize);
    basis.visit(problem, Part::HeldOut, &residuals[1], 1, |row, r| {
        let fitted: f64 = row.iter().map(|&(i, x)| x * coefficients[i]).sum();
        fall += r * r - (r - fitted).powi(2);
        count += 1;
    });
    Some(Structure { explained: (fall / count.max(1) as f64).max(0.0) })
}

/// The regressors: scaled motion, and states that remember it.
struct Basis {
    displacement_m: f64,
    velocity_m_s: f64,
    period_s: f64,
    frequency_hz: f64,
}

impl Basis {
    fn new(problem: &Problem<'_>) -> Self {
        let motion = problem.motion;
        let largest = |x: &[f64]| {
            let windows = motion.windows.iter().flat_map(|w| &x[w.range.clone()]);
            windows.fold(1e-300_f64, |top, x| top.max(x.abs()))
        };
        let frequency_hz = motion.median_frequency_hz().max(1e-9);
        Self {
            displacement_m: largest(&motion.displacement_m),
            velocity_m_s: largest(&motion.velocity_m_s),
            period_s: 1.0 / frequency_hz,
            frequency_hz,
        }
    }

    /// Hands the regressors of every `stride`th residual of a part to `each`: (number, value) of those that are not zero.
    fn visit(
        &self,
        problem: &Problem<'_>,
        part: Part,
        residuals: &[f64],
        stride: usize,
        mut each: impl FnMut(&[(usize, f64)], f64),
    ) {
        let motion = problem.motion;
        let dt = motion.dt_s() * problem.thin as f64;
        let length = motion.displacement_m.len().max(1) as f64;
        let mut row = Vec::with_capacity(32);
        let mut at = 0;
        for (k, window) in motion.windows.iter().enumerate().filter(|(_, w)| part.takes(w)) {
            let mut memory = Memory::new(self, dt);
            let warm = (window.warm_from..window.range.start).step_by(problem.thin);
            warm.for_each(|n| memory.step(motion.displacement_m[n], motion.velocity_m_s[n]));
            for (i, n) in problem.samples(window).enumerate() {
                let (d, v) = (motion.displacement_m[n], motion.velocity_m_s[n]);
                memory.step(d, v);
                let weight = problem.weight(k, i);
                if weight > 0.0 && (at + i) % stride == 0 {
                    row.clear();
                    self.row(d, v, n as f64 / length, window.frequency_hz, &memory, &mut row);
                    // Relative to a typical weight, so that the prior means the same everywhere.
                    let scale = weight * problem.motion.restoring_noise_m_s2;
                    row.iter_mut().for_each(|(_, x)| *x *= scale);
                    each(&row, residuals[at + i]);
                }
            }
            at += problem.samples(window).count();
        }
    }

    fn row(
        &self,
        d: f64,
        v: f64,
        when: f64,
        frequency_hz: f64,
        memory: &Memory,
        row: &mut Vec<(usize, f64)>,
    ) {
        let (x, y) = (d / self.displacement_m, v / self.velocity_m_s);
        let (i, a) = knot(x, GRID);
        let (j, b) = knot(y, GRID);
        let corner = |i: usize, j: usize, w: f64| (i * GRID + j, w);
        row.push(corner(i, j, (1.0 - a) * (1.0 - b)));
        row.push(corner(i + 1, j, a * (1.0 - b)));
        row.push(corner(i, j + 1, (1.0 - a) * b));
        row.push(corner(i + 1, j + 1, a * b));
        let mut from = GRID * GRID;
        let (i, a) = knot(x, LINE);
        let side = from + if v > 0.0 { LINE } else { 0 };
        row.extend([(side + i, 1.0 - a), (side + i + 1, a)]);
        from += 2 * LINE;
        let (i, a) = knot(2.0 * when - 1.0, TIMES);
        for (m, factor) in [1.0, x, y].into_iter().enumerate() {
            row.extend([(from + m * TIMES + i, (1.0 - a) * factor), (from + m * TIMES + i + 1, a * factor)]);
        }
        from += 3 * TIMES;
        let faster = (frequency_hz / self.frequency_hz).ln();
        row.extend([(from, x * faster), (from + 1, y * faster)]);
        from += 2;
        row.extend(memory.relaxed.iter().enumerate().map(|(m, u)| (from + m, *u)));
        from += RELAXATIONS.len();
        for (m, p) in memory.played.iter().enumerate() {
            row.extend([(from + 2 * m, *p), (from + 2 * m + 1, *p * x.abs())]);
        }
    }
}

/// Knot below a place in -1..1 and the share of the way to the next.
fn knot(place: f64, knots: usize) -> (usize, f64) {
    let at = (0.5 * (place.clamp(-1.0, 1.0) + 1.0)) * (knots - 1) as f64;
    let below = (at as usize).min(knots - 2);
    (below, at - below as f64)
}

/// States that remember the motion, scaled to 1.
struct Memory {
    /// Relaxing displacement, `u' = v - u / tau`.
    relaxed: [f64; RELAXATIONS.len()],
    /// What is left of it after a step, and what a velocity of 1 m/s adds in one.
    relaxing: [(f64, f64); RELAXATIONS.len()],
    /// Play: the displacement less what lies within the width, over the width; a sliding friction element.
    played: [f64; PLAYS.len()],
    last: Option<f64>,
    displacement_m: f64,
}

impl Memory {
    /// At rest, to be stepped by `dt`, s.
    fn new(basis: &Basis, dt: f64) -> Self {
        let relaxing = RELAXATIONS.map(|share| {
            let tau = share * basis.period_s;
            let decay = (-dt / tau).exp();
            (decay, tau * (1.0 - decay) / basis.displacement_m)
        });
        Self {
            relaxed: [0.0; RELAXATIONS.len()],
            relaxing,
            played: [0.0; PLAYS.len()],
            last: None,
            displacement_m: basis.displacement_m,
        }
    }

    fn step(&mut self, d: f64, v: f64) {
        let x = d / self.displacement_m;
        for (u, (decay, added)) in self.relaxed.iter_mut().zip(self.relaxing) {
            *u = *u * decay + v * added;
        }
        let moved = x - self.last.unwrap_or(x);
        for (z, width) in self.played.iter_mut().zip(PLAYS) {
            *z = (*z + moved / width).clamp(-1.0, 1.0);
        }
        self.last = Some(x);
    }
}
