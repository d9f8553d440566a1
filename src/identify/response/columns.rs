//! Slopes of a step's residuals along the values that a fit moves and along what belongs to the step, by simulating it with each moved.
//! The descent builds its normal equations from them.

use super::descent::Fitted;
use super::tangent::is_piecewise_linear;
use super::{COMMON, HUBER, Measured, OVER, Simulated, Specimens, Step};
use crate::identify::least_squares::Free;
use std::sync::Arc;

/// Differences for a slope along a nuisance, over its prior deviation, and along a number, over its scale, where the solver is exact:
/// a stiff contact amplifies a change by tens, and a slope over what bends by then has something of the other slopes left over, as
/// information that is not there.
const SMALL: [f64; 2] = [0.01, 1e-5];
/// The same to both sides where its steps' errors are not far enough below that.
const TO_BOTH_SIDES: [f64; 2] = [0.2, 1e-2];
/// Difference for a coarse slope along a number there.
const COARSE: f64 = 1e-3;
/// Standard deviations that differences are wide at least, coarse and fine ones, and the most that this makes of them, over the scale.
const WIDE: [f64; 2] = [1.0, 2.0];
const WIDEST: f64 = 0.2;
/// A change by so many times what is usual in a step is a jump that went over a sample, if it is one at all.
const UNUSUAL: f64 = 6.0;
/// So many samples from a jump that is spread over those beside it nothing of it is left; times what changes there that a jump does.
const BESIDE: usize = 4;
const ALONE: f64 = 2.0;

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
        let (sa, sd) = self.over_noises();
        let common = self.common(job.values, window);
        let column = |a: &dyn Fn(usize) -> f64, d: &dyn Fn(usize) -> f64| -> Vec<f64> {
            let mut column: Vec<f64> = (0..n).map(|i| sa * a(i)).chain((0..n).map(|i| sd * d(i))).collect();
            self.whiten(window, &mut column);
            column
        };
        let counted = self.counts();
        let counts = |i: usize| counted[window.range.start + i];
        let changed = |simulated: &Simulated, h: f64| {
            let change = |i: usize| step.simulated[i].0 - simulated[i].0;
            let square: f64 = (0..n).filter(|i| counts(*i)).map(|i| (sa * change(i)).powi(2)).sum();
            let most = OVER.max(UNUSUAL * (square / n as f64).sqrt()) / sa;
            // A contact changes that much as a whole, a jump a few samples; over those, slopes lead a fit from far off astray.
            let beside = |i: usize| {
                let before = i.checked_sub(BESIDE).map_or(0.0, |i| change(i).abs());
                before.max(if i + BESIDE < n { change(i + BESIDE).abs() } else { 0.0 })
            };
            let goes_over = |i: usize| change(i).abs() > most && change(i).abs() > ALONE * beside(i);
            let small = |i: usize| if counts(i) && !goes_over(i) { change(i) / h } else { 0.0 };
            column(&small, &|i| (step.simulated[i].1 - simulated[i].1) / h)
        };
        let mut along = Vec::with_capacity(job.moved.len() + COMMON * self.records());
        for m in &mut job.moved {
            let sides: Vec<_> = m
                .sides
                .iter_mut()
                .map(|(of, h)| changed(&self.simulate(of, window, common, own), *h))
                .collect();
            along.push(mean(&sides, 2 * n));
        }
        let mut fresh = Vec::new();
        if known.is_none() {
            for (j, sigma) in self.sigmas(window).into_iter().enumerate().take(self.followed(window)) {
                let mut along_start = |h: f64| {
                    let mut start = own.to_vec();
                    start[j] += h;
                    changed(&self.simulate(&mut job.own, window, common, &start), h)
                };
                let sigma = sigma.max(1e-12);
                let sides = if job.exact { &[SMALL[0]][..] } else { &[TO_BOTH_SIDES[0], -TO_BOTH_SIDES[0]] };
                let slopes: Vec<_> = sides.iter().map(|h| along_start(h * sigma)).collect();
                fresh.push(mean(&slopes, 2 * n));
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
            let mut zero = column(&|_| 0.0, &|_| 1.0);
            zero.iter_mut().zip(start).for_each(|(zero, start)| *zero += start);
            along.push(zero);
            let drive = |i: usize| if counts(i) { -motion.drive_m_s2[window.range.start + i] } else { 0.0 };
            along.push(column(&drive, &|_| 0.0));
            let of_a = |i: usize| if counts(i) { -self.of_mass(window, &step.simulated, i).0 } else { 0.0 };
            let slope = |i: usize| self.rise_of_mass(window, &step.simulated, i);
            let late = |i: usize| if counts(i) { rate * slope(i).0 } else { 0.0 };
            along.push(column(&late, &|i| rate * slope(i).1));
            along.push(column(&|_| 0.0, &|i| -step.simulated[i].1));
            along.push(column(&of_a, &|_| 0.0));
            along.push(if window.random {
                let h = self.table_zero_m_s2 * if job.exact { SMALL[0] } else { TO_BOTH_SIDES[0] };
                let mut moved = common.to_vec();
                moved[COMMON - 1] += h;
                changed(&self.simulate(&mut job.own, window, &moved, own), h)
            } else {
                vec![0.0; 2 * n]
            });
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
        let exact = is_piecewise_linear(&fitted.spec);
        let mut moved = Vec::new();
        for j in 0..if fitted.moving { self.of_model(values) } else { 0 } {
            let free = &fitted.free[j];
            let specimens = |h: f64| {
                let (mut at, mut spec) = (values.to_vec(), fitted.spec.clone());
                at[j] += h;
                let within = (free.bounds.0..=free.bounds.1).contains(&at[j]);
                (within && fitted.numbers.put(&at, &mut spec)).then(|| self.specimens(&spec)).flatten()
            };
            let most = if !exact && fitted.fine { 2 } else { 1 };
            let h = difference(free, exact, fitted.fine, fitted.deviations.get(j).copied().unwrap_or(0.0));
            let sides = [h, -h].into_iter().filter_map(|h| Some((specimens(h)?, h))).take(most).collect();
            moved.push(Moved { sides });
        }
        Some(Job { values, moving: fitted.moving, moved, own: self.specimens(&fitted.spec)?, exact })
    }
}

/// Difference for a slope along a number whose standard deviation is known so far: where the record tells it far better than its scale,
/// errors of the solver would be much of a narrower one.
pub(super) fn difference(free: &Free, exact: bool, fine: bool, deviation: f64) -> f64 {
    let (share, deviations) = match (exact, fine) {
        (true, _) => (SMALL[1], 0.0),
        (false, false) => (COARSE, WIDE[0]),
        (false, true) => (TO_BOTH_SIDES[1], WIDE[1]),
    };
    (share * free.scale).max((deviations * deviation).min(WIDEST * free.scale))
}

/// What slopes are taken with.
pub(super) struct Job<'b> {
    pub(super) values: &'b [f64],
    moving: bool,
    moved: Vec<Moved>,
    pub(super) own: Specimens,
    /// Without error-controlled steps.
    exact: bool,
}

/// A number moved to one side or to both, by how much; to none where it cannot be moved: it has no slope then.
struct Moved {
    sides: Vec<(Specimens, f64)>,
}

/// Mean of slopes to one side or to both; none where there is no side.
fn mean(sides: &[Vec<f64>], length: usize) -> Vec<f64> {
    let share = 1.0 / sides.len() as f64;
    (0..length).map(|i| sides.iter().map(|side| share * side[i]).sum()).collect()
}
