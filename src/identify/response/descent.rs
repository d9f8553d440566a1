//! Damped Gauss-Newton on the response: the nuisances of each step are eliminated from the normal equations, which therefore stay
//! as small as the model. Called for every fit and every judgement by the response.

use super::tangent::is_piecewise_linear;
use super::{
    COMMON, HUBER, Laid, Measured, Nuisances, OVER, Simulated, Specimens, Step, TOGETHER, robust, slopes,
};
use crate::identify::least_squares::{self, Free, Settings, dot};
use crate::identify::numbers::Numbers;
use crate::identify::problem::Part;
use crate::identify::refit::Refit;
use crate::model::ModelSpec;
use crate::parallel;
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

/// Difference for a slope along a nuisance, over its prior deviation, where the solver is exact: a stiff contact amplifies a start by
/// tens, and a slope over what bends by then has the rest of the gap's left over, as information that is not there.
const SMALL: f64 = 0.01;
/// The same to both sides where its steps' errors are not far enough below that.
const TO_BOTH_SIDES: f64 = 0.2;
/// A change by so many times what is usual in a step is a jump that went over a sample, if it is one at all.
const UNUSUAL: f64 = 6.0;
/// A fall of the cost that is not worth another step.
const SETTLED: f64 = 0.3;
/// Share of the cost above which the slopes along the nuisances are kept.
const LITTLE: f64 = 0.98;
/// Steps that are taken with the slopes of an earlier one.
const CHORDS: usize = 3;

impl<'a> Measured<'a> {
    /// Slopes of a step's residuals along the values that move and along its nuisances.
    fn columns(
        &self,
        job: &mut Job<'_>,
        step: &Step<'_>,
        own: &[f64],
        known: Option<Arc<Vec<Vec<f64>>>>,
    ) -> (Vec<Vec<f64>>, Arc<Vec<Vec<f64>>>) {
        let motion = self.motion;
        let (window, n) = (step.window, step.simulated.len());
        let (sa, sd) = (1.0 / motion.restoring_noise_m_s2, 1.0 / motion.laser_noise_m);
        let common = &job.values[job.values.len() - COMMON..];
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
        let mut along = Vec::with_capacity(job.moved.len() + COMMON);
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
            along.push(column(&|i| start[i] / sa, &|i| 1.0 + start[n + i] / sd));
            let drive = |i: usize| if counts(i) { -motion.drive_m_s2[window.range.start + i] } else { 0.0 };
            along.push(column(&drive, &|_| 0.0));
            let of_a = |i: usize| if counts(i) { -step.simulated[i].0 } else { 0.0 };
            let late = |i: usize| if counts(i) { rate * slopes(&step.simulated, i).0 } else { 0.0 };
            along.push(column(&late, &|i| rate * slopes(&step.simulated, i).1));
            along.push(column(&|_| 0.0, &|i| -step.simulated[i].1));
            along.push(column(&of_a, &|_| 0.0));
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

    /// Fits a model's numbers to the steps of training from where another fit ended.
    pub fn fit(
        &self,
        start: &ModelSpec,
        numbers: &Numbers,
        zero_m: f64,
        from: Option<&Laid>,
        settings: Settings,
    ) -> Option<Laid> {
        let free = self.free(numbers, zero_m);
        let mut values: Vec<f64> = free.iter().map(|f| f.start.clamp(f.bounds.0, f.bounds.1)).collect();
        let mut nuisances = self.still(Part::Training);
        if let Some(from) = from {
            let (to, of) = (values.len() - COMMON, from.values.len() - COMMON);
            values[to..].copy_from_slice(&from.values[of..]);
            nuisances.clone_from(&from.nuisances);
        }
        self.descend(
            Fitted { spec: start.clone(), numbers, free: &free, moving: true },
            Part::Training,
            values,
            nuisances,
            settings,
        )
    }

    /// Lays a fitted model against the held-out steps: only what belongs to each step is estimated.
    pub fn judge(&self, spec: &ModelSpec, numbers: &Numbers, laid: &Laid) -> Option<Laid> {
        let free = self.free(numbers, 0.0);
        let settings = Settings { iterations: 12, ..Settings::default() };
        let still = self.still(Part::HeldOut);
        let fitted = Fitted { spec: spec.clone(), numbers, free: &free, moving: false };
        self.descend(fitted, Part::HeldOut, laid.values.clone(), still, settings)
    }

    fn descend(
        &self,
        mut fitted: Fitted<'_>,
        part: Part,
        mut values: Vec<f64>,
        mut nuisances: Vec<Nuisances>,
        settings: Settings,
    ) -> Option<Laid> {
        let free = fitted.free;
        let prior = |x: &[f64]| least_squares::prior_sum(free, x);
        fitted.numbers.put(&values, &mut fitted.spec).then_some(())?;
        let (mut cost, mut steps) = self.lay(&fitted.spec, part, &values, &nuisances)?;
        let mut damping = 1e-4;
        let mut system = self.linearise(&fitted, &values, &nuisances, &steps, None)?;
        // Where the slopes along the nuisances were taken, and whether the values have moved since.
        let (mut cost_of_nuisances, mut kept) = (cost, false);
        let (mut rounds, mut chords) = (0, 0);
        while rounds < settings.iterations {
            let Some((moved, own)) = system.step(free, &values, &nuisances, damping) else { break };
            if chords == 0 && system.promises(free, &values, &moved) < SETTLED {
                break;
            }
            let mut spec = fitted.spec.clone();
            let laid =
                fitted.numbers.put(&moved, &mut spec).then(|| self.lay(&spec, part, &moved, &own)).flatten();
            let before = cost + prior(&values);
            let fall = match laid {
                Some((to, there)) if to + prior(&moved) < before => {
                    let fall = before - to - prior(&moved);
                    (cost, steps, values, nuisances, fitted.spec) = (to, there, moved, own, spec);
                    fall
                }
                _ if chords > 0 => 0.0,
                _ if kept => {
                    (kept, cost_of_nuisances) = (false, cost);
                    system = self.linearise(&fitted, &values, &nuisances, &steps, None)?;
                    continue;
                }
                _ => {
                    damping *= 10.0;
                    if damping > 1e5 {
                        break;
                    }
                    continue;
                }
            };
            let settled = fall < SETTLED;
            if chords == 0 {
                rounds += 1;
                damping = (damping * 0.1).max(1e-9);
            }
            // The slopes hold for a few steps; one simulation in place of one for each of them.
            if !settled && chords < CHORDS {
                chords += 1;
                self.aim(&mut system, &nuisances, &steps);
                continue;
            }
            let ended = settled && chords == 0;
            chords = 0;
            // The slopes along the nuisances change little while the model moves little.
            kept = cost > LITTLE * cost_of_nuisances;
            if !kept {
                cost_of_nuisances = cost;
            }
            system = self.linearise(&fitted, &values, &nuisances, &steps, kept.then_some(system))?;
            if ended {
                break;
            }
        }
        let count = steps.iter().map(|s| self.count(s.window)).sum();
        let prior = if fitted.moving { prior(&values) } else { 0.0 };
        Some(Laid { prior, values, nuisances, cost, count, information: system.normal })
    }

    pub(super) fn linearise(
        &self,
        fitted: &Fitted<'_>,
        values: &[f64],
        nuisances: &[Nuisances],
        steps: &[Step<'_>],
        known: Option<System>,
    ) -> Option<System> {
        let each: Vec<usize> = (0..steps.len()).collect();
        let known = known.map(|system| system.own);
        let eliminated = parallel::map_with(
            &each,
            TOGETHER,
            || self.job(fitted, values),
            |job, &k| {
                let known = known.as_ref().map(|own| own[k].beside.clone());
                self.eliminate(job, &steps[k], &nuisances[k], known)
            },
        )?;
        let size = if fitted.moving { values.len() } else { 0 };
        let mut system =
            System { normal: DMatrix::zeros(size, size), gradient: DVector::zeros(size), own: Vec::new() };
        for (information, own) in eliminated {
            system.normal += information;
            system.own.push(own);
        }
        self.aim(&mut system, nuisances, steps);
        Some(system)
    }

    /// What slopes are taken with: the model with each of its values moved, and as it is.
    fn job<'b>(&self, fitted: &Fitted<'_>, values: &'b [f64]) -> Option<Job<'b>> {
        let own_numbers = values.len() - COMMON;
        let mut moved = Vec::new();
        for j in 0..if fitted.moving { own_numbers } else { 0 } {
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

    /// A step's information on the values that move, its nuisances eliminated, and what is needed to find those again.
    fn eliminate(
        &self,
        job: &mut Job<'_>,
        step: &Step<'_>,
        own: &[f64],
        known: Option<Arc<Vec<Vec<f64>>>>,
    ) -> Option<(DMatrix<f64>, Eliminated)> {
        let (along, beside) = self.columns(job, step, own, known);
        let precision = self.precision(step.window);
        let weight = self.weight(step, own, &precision);
        let gram = |a: &[Vec<f64>], b: &[Vec<f64>]| {
            DMatrix::from_fn(a.len(), b.len(), |i, j| weight * dot(&a[i], &b[j]))
        };
        let inner = gram(&beside, &beside) + weight * &precision;
        let inverse = inner.cholesky()?.inverse();
        let mixed = gram(&along, &beside);
        let information = gram(&along, &along) - &mixed * &inverse * mixed.transpose();
        let pull = DVector::zeros(own.len());
        Some((information, Eliminated { along, beside, weight, precision, mixed, inverse, pull }))
    }

    /// A step's slope of the cost by its sum of squares.
    fn weight(&self, step: &Step<'_>, own: &[f64], precision: &DMatrix<f64>) -> f64 {
        let now = DVector::from_column_slice(own);
        let chi2 = dot(&step.residuals, &step.residuals) + (now.transpose() * precision * &now)[(0, 0)];
        robust(chi2, self.count(step.window)).1
    }

    /// The gradient where the residuals are now, along the slopes that are there.
    fn aim(&self, system: &mut System, nuisances: &[Nuisances], steps: &[Step<'_>]) {
        system.gradient.fill(0.0);
        for ((eliminated, step), own) in system.own.iter_mut().zip(steps).zip(nuisances) {
            let weight = self.weight(step, own, &eliminated.precision);
            let now = DVector::from_column_slice(own);
            let slope =
                |a: &[Vec<f64>]| DVector::from_fn(a.len(), |i, _| weight * dot(&a[i], &step.residuals));
            eliminated.pull = slope(&eliminated.beside) + weight * &eliminated.precision * &now;
            let through = &eliminated.inverse * &eliminated.pull;
            system.gradient += slope(&eliminated.along) - &eliminated.mixed * through;
        }
    }

    /// What the freedom of a fit's numbers is worth, nats: half the logarithm of how much narrower the record makes them than they were
    /// before, so that one that it says nothing about costs nothing (Occam factor of a Laplace approximation: MacKay 1992). The strength
    /// of an effect may have any magnitude: what it was before is as wide as some times what it is.
    pub fn freedom_nats(&self, numbers: &Numbers, laid: &Laid, colour: f64) -> f64 {
        let free = self.free(numbers, 0.0);
        let wide = |j: usize| {
            let sigma = free[j].prior.1;
            match numbers.numbers.get(j) {
                Some(number) if number.strength => sigma.min(MAGNITUDE * laid.values[j].abs()),
                _ if sigma.is_finite() => sigma,
                _ => laid.values[j].abs().max(free[j].scale),
            }
        };
        let narrowed = DMatrix::from_fn(free.len(), free.len(), |i, j| {
            wide(i) * laid.information[(i, j)] * wide(j) / colour.max(1.0) + f64::from(u8::from(i == j))
        });
        narrowed.cholesky().map_or(0.0, |root| root.l().diagonal().iter().map(|x| x.ln()).sum())
    }

    /// The fit as the rest of the diagnosis knows fits: the model's numbers and the zero, everything else eliminated.
    pub fn refit(&self, start: &ModelSpec, numbers: &Numbers, laid: &Laid, colour: f64) -> Refit {
        let free = self.free(numbers, 0.0);
        let kept = laid.values.len() - COMMON + 1;
        let fit = |values: &[f64], information: DMatrix<f64>| least_squares::Fit {
            values: values.to_vec(),
            residual_sum: laid.cost,
            prior_sum: laid.prior,
            count: laid.count,
            information,
            iterations: 0,
        };
        let covariance = fit(&laid.values, laid.information.clone()).covariance(&free, colour);
        let sigmas = (0..kept).map(|j| covariance[(j, j)].max(0.0).sqrt()).collect();
        // What is common to all steps but the zero, with its priors, eliminated from the information.
        let (rest, mixed) =
            (free.len() - kept, laid.information.view((0, kept), (kept, free.len() - kept)).into_owned());
        let mut corner = laid.information.view((kept, kept), (rest, rest)).into_owned();
        (0..rest).for_each(|j| corner[(j, j)] += free[kept + j].prior.1.powi(-2));
        let outer = laid.information.view((0, 0), (kept, kept)).into_owned();
        let information = match corner.try_inverse() {
            Some(inverse) => outer - &mixed * inverse * mixed.transpose(),
            None => outer,
        };
        let mut spec = start.clone();
        numbers.put(&laid.values, &mut spec);
        Refit {
            spec,
            numbers: numbers.clone(),
            zero_m: laid.values[kept - 1],
            fit: fit(&laid.values[..kept], information),
            inflation: colour,
            sigmas,
        }
    }
}

/// How much wider than its strength an effect's range was before: two nats for its magnitude.
const MAGNITUDE: f64 = 7.4;

/// A fit that goes on.
pub(super) struct Fitted<'b> {
    pub(super) spec: ModelSpec,
    pub(super) numbers: &'b Numbers,
    pub(super) free: &'b [Free],
    /// The numbers of the model move, not the nuisances of the steps alone.
    pub(super) moving: bool,
}

struct Job<'b> {
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

/// Normal equations with the nuisances of each step eliminated, and what is needed to find those again.
pub(super) struct System {
    pub(super) normal: DMatrix<f64>,
    pub(super) gradient: DVector<f64>,
    pub(super) own: Vec<Eliminated>,
}

/// What belongs to one step.
pub(super) struct Eliminated {
    /// Slopes of its residuals along the values, and along its nuisances.
    pub(super) along: Vec<Vec<f64>>,
    pub(super) beside: Arc<Vec<Vec<f64>>>,
    pub(super) weight: f64,
    precision: DMatrix<f64>,
    pub(super) mixed: DMatrix<f64>,
    pub(super) inverse: DMatrix<f64>,
    pub(super) pull: DVector<f64>,
}

impl System {
    /// How far the cost falls to second order when the values move and the nuisances follow.
    fn promises(&self, free: &[Free], values: &[f64], moved: &[f64]) -> f64 {
        let n = self.gradient.len();
        let of_steps = self.own.iter().map(|own| (own.pull.transpose() * &own.inverse * &own.pull)[(0, 0)]);
        let change = DVector::from_fn(n, |j, _| moved[j] - values[j]);
        let of_values =
            -2.0 * self.gradient.dot(&change) - (change.transpose() * &self.normal * &change)[(0, 0)];
        let of_priors = if n > 0 {
            least_squares::prior_sum(free, values) - least_squares::prior_sum(free, moved)
        } else {
            0.0
        };
        of_steps.sum::<f64>() + of_values + of_priors
    }

    /// Values and nuisances after a damped step.
    fn step(
        &self,
        free: &[Free],
        values: &[f64],
        nuisances: &[Nuisances],
        damping: f64,
    ) -> Option<(Vec<f64>, Vec<Nuisances>)> {
        let n = self.gradient.len();
        let moved = if n > 0 {
            least_squares::damped_step(free, values, &self.normal, &self.gradient, damping)?
        } else {
            values.to_vec()
        };
        let change = DVector::from_fn(n, |j, _| moved[j] - values[j]);
        let own = nuisances.iter().zip(&self.own).map(|(own, eliminated)| {
            let pull = if n > 0 {
                &eliminated.pull + eliminated.mixed.transpose() * &change
            } else {
                eliminated.pull.clone()
            };
            let step = &eliminated.inverse * pull;
            own.iter().zip(step.iter()).map(|(x, s)| x - s).collect()
        });
        Some((moved, own.collect()))
    }
}
