//! Slopes of a step's residuals along the values that a fit moves and along what belongs to the step, by simulating it with each moved.
//! The descent builds its normal equations from them.

use super::descent::Fitted;
use super::tangent::is_piecewise_linear;
use super::{COMMON, HUBER, Measured, OVER, Simulated, Specimens, Step, slopes};
use std::sync::Arc;

/// Difference for a slope along a nuisance, over its prior deviation, where the solver is exact: a stiff contact amplifies a start by
/// tens, and a slope over what bends by then has the rest of the gap's left over, as information that is not there.
const SMALL: f64 = 0.01;
/// The same to both sides where its steps' errors are not far enough below that.
const TO_BOTH_SIDES: f64 = 0.2;
/// A change by so many times what is usual in a step is a jump that went over a sample, if it is one at all.
const UNUSUAL: f64 = 6.0;

impl Measured<'_> {
    /// Slopes of a step's residuals along the values that move and along its nuisances.
    pub(super) fn columns(
        &self,
        job: &mut Job<'_>,
        step: &Step<'_>,
        own: &[f64],
        known: Option<Arc<Vec<Vec<f64>>>>,
    ) -> (Vec<Vec<f64>>, Arc<Vec<Vec<f64>>>) {
        let motion = self.motion;
        let (window, n) = (step.window, step.simulated.len());
        let (sa, sd) = (1.0 / motion.restoring_noise_m_s2, 1.0 / motion.laser_noise_m);
        let common = self.common(job.values, window);
        let column = |a: &dyn Fn(usize) -> f64, d: &dyn Fn(usize) -> f64| -> Vec<f64> {
            (0..n).map(|i| sa * a(i)).chain((0..n).map(|i| sd * d(i))).collect()
        };
        let counted = self.counts();
        let counts = |i: usize| counted[window.range.start + i];
        let changed = |simulated: &Simulated, h: f64| {
            let change = |i: usize| step.simulated[i].0 - simulated[i].0;
            let square: f64 = (0..n).filter(|i| counts(*i)).map(|i| (sa * change(i)).powi(2)).sum();
            let most = OVER.max(UNUSUAL * (square / n as f64).sqrt()) / sa;
            let small = |i: usize| if counts(i) && change(i).abs() < most { change(i) / h } else { 0.0 };
            column(&small, &|i| (step.simulated[i].1 - simulated[i].1) / h)
        };
        let mut along = Vec::with_capacity(job.moved.len() + COMMON * self.records());
        for m in &mut job.moved {
            let simulated = self.simulate(&mut m.specimens, window, common[0], own);
            along.push(changed(&simulated, m.h));
        }
        let mut fresh = Vec::new();
        if known.is_none() {
            for (j, sigma) in self.sigmas(window).into_iter().enumerate().take(self.followed(window)) {
                let mut along_start = |h: f64| {
                    let mut start = own.to_vec();
                    start[j] += h;
                    changed(&self.simulate(&mut job.own, window, common[0], &start), h)
                };
                let sigma = sigma.max(1e-12);
                if job.exact {
                    fresh.push(along_start(SMALL * sigma));
                    continue;
                }
                let h = TO_BOTH_SIDES * sigma;
                let (to, fro) = (along_start(h), along_start(-h));
                fresh.push(to.iter().zip(&fro).map(|(to, fro)| 0.5 * (to + fro)).collect());
            }
            fresh.push(column(&|i| if counts(i) { -1.0 } else { 0.0 }, &|_| 0.0));
            let knots = self.knots(window);
            for knot in 0..knots {
                let share = |i: usize| match self.beside(window, i, knots) {
                    (left, share) if left == knot => 1.0 - share,
                    (left, share) if left + 1 == knot => share,
                    _ => 0.0,
                };
                fresh.push(column(&|_| 0.0, &|i| -share(i)));
            }
        }
        if job.moving {
            let rate = motion.sample_rate_hz;
            // The start is measured from the zero.
            let start = &known.as_deref().unwrap_or(&fresh)[0];
            // What is common to another record does nothing here.
            let nothing = |records: usize| vec![vec![0.0; 2 * n]; COMMON * records];
            along.extend(nothing(window.source));
            along.push(column(&|i| start[i] / sa, &|i| 1.0 + start[n + i] / sd));
            let drive = |i: usize| if counts(i) { -motion.drive_m_s2[window.range.start + i] } else { 0.0 };
            along.push(column(&drive, &|_| 0.0));
            let of_a = |i: usize| if counts(i) { -step.simulated[i].0 } else { 0.0 };
            let late = |i: usize| if counts(i) { rate * slopes(&step.simulated, i).0 } else { 0.0 };
            along.push(column(&late, &|i| rate * slopes(&step.simulated, i).1));
            along.push(column(&|_| 0.0, &|i| -step.simulated[i].1));
            along.push(column(&of_a, &|_| 0.0));
            along.extend(nothing(self.records() - 1 - window.source));
        }
        // A large residual stands as the root of its share of the cost.
        for (i, r) in step.residuals[..n].iter().enumerate().filter(|(_, r)| r.abs() > HUBER) {
            along.iter_mut().for_each(|c| c[i] *= HUBER / r.abs());
            fresh.iter_mut().for_each(|c| c[i] *= HUBER / r.abs());
        }
        let finite = |c: &Vec<f64>| c.iter().all(|x| x.is_finite());
        along.iter_mut().chain(&mut fresh).filter(|c| !finite(c)).for_each(|c| c.fill(0.0));
        (along, known.unwrap_or_else(|| Arc::new(fresh)))
    }

    /// What slopes are taken with: the model with each of its values moved, and as it is.
    pub(super) fn job<'b>(&self, fitted: &Fitted<'_>, values: &'b [f64]) -> Option<Job<'b>> {
        let mut moved = Vec::new();
        for j in 0..if fitted.moving { self.of_model(values) } else { 0 } {
            let (free, mut at) = (&fitted.free[j], values.to_vec());
            let mut h = 1e-3 * free.scale;
            if at[j] + h > free.bounds.1 {
                h = -h;
            }
            at[j] += h;
            let mut spec = fitted.spec.clone();
            // A number that cannot be moved has no slope.
            let specimens = fitted.numbers.put(&at, &mut spec).then(|| self.specimens(&spec)).flatten();
            moved.push(match specimens {
                Some(specimens) => Moved { specimens, h },
                None => Moved { specimens: self.specimens(&fitted.spec)?, h },
            });
        }
        let exact = is_piecewise_linear(&fitted.spec);
        Some(Job { values, moving: fitted.moving, moved, own: self.specimens(&fitted.spec)?, exact })
    }
}

/// What slopes are taken with.
pub(super) struct Job<'b> {
    values: &'b [f64],
    moving: bool,
    moved: Vec<Moved>,
    own: Specimens,
    /// Without error-controlled steps.
    exact: bool,
}

struct Moved {
    specimens: Specimens,
    h: f64,
}
