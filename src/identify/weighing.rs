//! How much each sample of a measured force counts against a model: what the noise of the motion makes of the force, where it bends or
//! jumps, and the slow drift of the displacement sensor. Called when a problem is set up, and for every residual of the force.

use super::component;
use super::motion::Window;
use super::output_error::OutputError;
use super::problem::{DRIFT_MEMORY, NARROW, Part, Problem};
use crate::model::ModelSpec;
use crate::parallel;

impl Problem<'_> {
    /// Weighs the samples for a model and the zero of its displacement sensor: what the noise of the displacement makes of
    /// the force along its slope, and where the force bends or jumps (a contact begins) within `around` times that noise,
    /// any part of it.
    pub fn weigh(&mut self, spec: &ModelSpec, zero_m: f64, around: f64) {
        let motion = self.motion;
        let slow = 3.0 * motion.velocity_noise_m_s;
        let counts = component::beside_jumps(motion);
        let shapes = self.shapes(spec, zero_m, around);
        self.carried = self.carried_m_s2(spec, &shapes);
        let weight = |n: usize, bend: f64, carried: f64| {
            let is_slow = motion.velocity_m_s[n].abs() < slow && !motion.is_held_at(n);
            if is_slow || counts.get(n) == Some(&false) {
                return 0.0;
            }
            let sigma = motion.restoring_noise_m_s2.hypot(carried).hypot(0.5 * bend);
            if sigma > 0.0 && sigma.is_finite() { 1.0 / sigma } else { 0.0 }
        };
        self.weights.clear();
        for ((window, shape), carried) in motion.windows.iter().zip(&shapes).zip(&self.carried) {
            let samples = self.samples(window).zip(shape).zip(carried);
            self.weights.push(samples.map(|((n, (_, bend)), carried)| weight(n, *bend, *carried)).collect());
        }
        let slopes = |shape: Vec<(f64, f64)>| shape.into_iter().map(|(slope, _)| slope).collect();
        self.slopes = shapes.into_iter().map(slopes).collect();
    }

    /// Slope (1/s2) and bend (m/s2) of a model's force over the mass about each thinned sample, by window: within so many times the noise
    /// of the displacement.
    fn shapes(&self, spec: &ModelSpec, zero_m: f64, around: f64) -> Vec<Vec<(f64, f64)>> {
        let aside_m = around * (3.0 * self.shift_m() + self.drift_m);
        let places = [zero_m, zero_m + aside_m, zero_m - aside_m];
        let forces =
            parallel::map(&places, parallel::cores(), |zero_m| self.restoring(spec, *zero_m, Part::All));
        let windows = self.motion.windows.iter().enumerate();
        let of_window = |(k, window): (usize, &Window)| match &forces[..] {
            [Some(at), Some(right), Some(left)] => {
                let both = right[k].iter().zip(&left[k]);
                let shape = |(f, (r, l)): (&f64, (&f64, &f64))| {
                    ((r - l) / (2.0 * aside_m).max(1e-300), r + l - 2.0 * f)
                };
                at[k].iter().zip(both).map(shape).collect()
            }
            _ => self.samples(window).map(|_| (0.0, 0.0)).collect(),
        };
        windows.map(of_window).collect()
    }

    /// What the noise of displacement and velocity makes of a model's force over the mass at each thinned sample, m/s2 rms, by window.
    fn carried_m_s2(&self, spec: &ModelSpec, shapes: &[Vec<(f64, f64)>]) -> Vec<Vec<f64>> {
        let (motion, shift) = (self.motion, self.shift_m());
        let damping = component::damping(motion, spec);
        let carried = |(n, (slope, _)): (usize, &(f64, f64))| {
            (slope * shift).hypot(damping(n) * motion.velocity_noise_m_s)
        };
        let of_window = |(window, shape): (&Window, &Vec<(f64, f64)>)| {
            self.samples(window).zip(shape).map(carried).collect()
        };
        motion.windows.iter().zip(shapes).map(of_window).collect()
    }

    /// Errors of a component's force window by window, each with its number, over the samples that count; `None` when the model cannot be
    /// built.
    pub(super) fn force_errors(
        &self,
        spec: &ModelSpec,
        shift_m: f64,
        part: Part,
    ) -> Option<Vec<(usize, OutputError)>> {
        let motion = self.motion;
        let modelled = self.restoring(spec, shift_m, part)?;
        let carried = self.carried_m_s2(spec, &self.shapes(spec, shift_m, NARROW));
        let windows = motion.windows.iter().enumerate().filter(|(_, w)| part.takes(w));
        let force = |(k, window): (usize, &Window)| {
            let mut error = OutputError::default();
            let mut off = Vec::with_capacity(modelled[k].len());
            self.push_off(k, window, &modelled[k], &mut off);
            for (i, n) in self.samples(window).enumerate().filter(|(i, _)| self.weight(k, *i) > 0.0) {
                error.sum_a += off[i].powi(2);
                error.power_a += motion.restoring_m_s2[n].powi(2);
                error.carried_a += carried[k][i].powi(2);
                error.count += 1;
            }
            (k, error)
        };
        Some(windows.map(force).collect())
    }

    /// Appends by how much a model's restoring force over the mass is off in one window, m/s2: measured minus modelled, but for the means of holds.
    pub(super) fn push_off(&self, k: usize, window: &Window, modelled: &[f64], out: &mut Vec<f64>) {
        let begin = out.len();
        let measured = self.samples(window).map(|n| self.motion.restoring_m_s2[n]);
        out.extend(measured.zip(modelled).map(|(measured, modelled)| measured - modelled));
        self.take_out_holds(k, window, &mut out[begin..]);
    }

    /// Takes out what a component's force is off in the mean of each hold in one window: friction may hold anything within its size there, and
    /// only what changes is told.
    fn take_out_holds(&self, k: usize, window: &Window, off: &mut [f64]) {
        if self.motion.is_held.is_empty() {
            return;
        }
        let held: Vec<bool> = self.samples(window).map(|n| self.motion.is_held_at(n)).collect();
        let mut from = 0;
        for run in held.chunk_by(|a, b| a == b) {
            let range = from..from + run.len();
            from = range.end;
            if !run[0] {
                continue;
            }
            let both = off[range.clone()].iter().zip(&self.weights[k][range.clone()]);
            let (sum, count) = both.fold((0.0, 0.0), |(sum, count), (off, weight)| {
                (sum + weight * weight * off, count + weight * weight)
            });
            let mean = if count > 0.0 { sum / count } else { 0.0 };
            off[range].iter_mut().for_each(|off| *off -= mean);
        }
    }

    /// Takes the drift of the displacement sensor in one window out of its residuals: a line from cycle to cycle
    /// within its prior (a first-order autoregression), which the residuals show through the slope of the force.
    pub(super) fn take_out_drift(&self, k: usize, residuals: &mut [f64]) {
        if self.drift_m == 0.0 {
            return;
        }
        let window = &self.motion.windows[k];
        let cycle = self.motion.sample_rate_hz / (window.frequency_hz.max(1e-9) * self.thin as f64);
        let cycle = cycle.clamp(2.0, residuals.len().max(2) as f64);
        let knots = (residuals.len() as f64 / cycle).ceil() as usize + 1;
        let innovation = (1.0 - DRIFT_MEMORY * DRIFT_MEMORY) * self.drift_m.max(1e-300).powi(2);
        let mut diagonal = vec![(1.0 + DRIFT_MEMORY * DRIFT_MEMORY) / innovation; knots];
        let mut beside = vec![-DRIFT_MEMORY / innovation; knots];
        let mut right = vec![0.0; knots];
        diagonal[0] = 1.0 / innovation;
        diagonal[knots - 1] = 1.0 / innovation;
        let per_sample = 1.0 / cycle;
        // Each residual is steered by the knots on its left and right.
        let steer = |i: usize| {
            let at = i as f64 * per_sample;
            let whole = at as usize;
            let rest = at - whole as f64;
            let s = self.weights[k][i] * self.slopes[k][i];
            (whole.min(knots - 2), s * (1.0 - rest), s * rest)
        };
        for (i, r) in residuals.iter().enumerate() {
            let (j, a, b) = steer(i);
            diagonal[j] += a * a;
            diagonal[j + 1] += b * b;
            beside[j] += a * b;
            right[j] += a * r;
            right[j + 1] += b * r;
        }
        // The matrix is symmetric, tridiagonal and positive definite: elimination without pivots.
        for j in 1..knots {
            let factor = beside[j - 1] / diagonal[j - 1];
            diagonal[j] -= factor * beside[j - 1];
            right[j] -= factor * right[j - 1];
        }
        right[knots - 1] /= diagonal[knots - 1];
        for j in (0..knots - 1).rev() {
            right[j] = (right[j] - beside[j] * right[j + 1]) / diagonal[j];
        }
        for (i, r) in residuals.iter_mut().enumerate() {
            let (j, a, b) = steer(i);
            *r -= a * right[j] + b * right[j + 1];
        }
    }

    /// Share of the mean square of a part's force residuals that the noise of displacement and velocity puts
    /// there through the slopes of the force: it is correlated from sample to sample and no structure.
    pub fn carried_noise(&self, part: Part) -> f64 {
        let (mut sum, mut count) = (0.0, 0usize);
        for (k, _) in self.motion.windows.iter().enumerate().filter(|(_, w)| part.takes(w)) {
            for (weight, carried) in self.weights[k].iter().zip(&self.carried[k]) {
                sum += (weight * carried).powi(2);
                count += usize::from(*weight > 0.0);
            }
        }
        sum / count.max(1) as f64
    }

    /// Noise of the displacement that the force answers to, m rms.
    fn shift_m(&self) -> f64 {
        self.motion.displacement_noise_m.max(1e-3 * self.motion.laser_noise_m)
    }
}
