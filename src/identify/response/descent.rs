//! Damped Gauss-Newton on the response: the nuisances of each step are eliminated from the normal equations, which therefore stay
//! as small as the model. Called for every fit and every judgement by the response.

use super::columns::{Job, difference};
use super::tangent::is_piecewise_linear;
use super::until::{Course, Until};
use super::{COMMON, Laid, Measured, Nuisances, Step, robust};
use crate::identify::kinematics::Estimate;
use crate::identify::least_squares::{self, Free, Settings, dot, gram, mixed_gram};
use crate::identify::numbers::Numbers;
use crate::identify::problem::Part;
use crate::identify::refit::Refit;
use crate::model::ModelSpec;
use crate::parallel;
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

/// A fall of the cost that is not worth another step: as far from the least, a fit is 0.14 deviations off.
const SETTLED: f64 = 0.02;
/// Times what a fit promises still that it may come to.
pub const PROMISED: f64 = 5.0;
/// Share of the cost above which the slopes along the nuisances are kept.
pub(super) const LITTLE: f64 = 0.98;
/// Steps that are taken with the slopes of an earlier one.
const CHORDS: usize = 3;
/// A fit of so few rounds sorts out: its slopes need not be better than its steps.
const SORTING: usize = 3;
/// Square of the distance, in deviations, within which two fits end in the same place.
const SAME: f64 = 1.0;
/// Damping of a first step, and the one at which coarse slopes lead no farther.
pub(super) const UNDAMPED: f64 = 1e-4;
const STALLED: f64 = 1.0;
/// How much wider a difference becomes by better slopes when these are taken again, and how often at most.
const GROWN: f64 = 1.2;
const AGAIN: usize = 3;
/// Damping of a step that was too long before, and how many times as far it goes on from there while the cost falls.
const SHORT: f64 = 1e-3;
const FURTHER: [f64; 5] = [1.0, 2.0, 4.0, 8.0, 16.0];

impl<'a> Measured<'a> {
    /// Fits a model's numbers to the steps of training from where another fit ended.
    pub fn fit(
        &self,
        start: &ModelSpec,
        numbers: &Numbers,
        zero_m: f64,
        from: Option<&Laid>,
        settings: Settings,
    ) -> Option<Laid> {
        self.fit_up_to(start, numbers, (zero_m, from), settings, Until::default())
    }

    /// The same, given up where it is not worth going on; `None` also where it leads to a known place.
    pub fn fit_up_to(
        &self,
        start: &ModelSpec,
        numbers: &Numbers,
        (zero_m, from): (f64, Option<&Laid>),
        settings: Settings,
        until: Until<'_>,
    ) -> Option<Laid> {
        let free = self.free(numbers, zero_m);
        let mut values: Vec<f64> = free.iter().map(|f| f.start.clamp(f.bounds.0, f.bounds.1)).collect();
        let mut nuisances = self.still(Part::Training);
        if let Some(from) = from {
            let (to, of) = (self.of_model(&values), self.of_model(&from.values));
            values[to..].copy_from_slice(&from.values[of..]);
            nuisances.clone_from(&from.nuisances);
        }
        // Where the solver is exact there are no coarse slopes.
        let fine = is_piecewise_linear(start);
        let fitted = || Fitted { until, ..Fitted::new(start, numbers, &free, fine) };
        let laid = self.descend(fitted(), values, nuisances, settings)?;
        if settings.iterations <= SORTING {
            return Some(laid);
        }
        let Some(nuisances) = self.better_starts(start, numbers, &laid) else { return Some(laid) };
        self.descend(fitted(), laid.values, nuisances, settings)
    }

    fn descend(
        &self,
        mut fitted: Fitted<'_>,
        values: Vec<f64>,
        nuisances: Vec<Nuisances>,
        settings: Settings,
    ) -> Option<Laid> {
        let free = fitted.free;
        let mut at = self.at(&fitted, values, nuisances)?;
        fitted.spec.clone_from(&at.spec);
        let mut damping = UNDAMPED;
        let mut system = self.slopes(&mut fitted, &at, None)?;
        // Coarse slopes lead near, where fine ones take over.
        let coarse = |fitted: &Fitted<'_>| !fitted.fine && settings.iterations > SORTING;
        // Where the slopes along the nuisances were taken, and whether the values have moved since.
        let (mut cost_of_nuisances, mut kept) = (at.cost, false);
        let (mut rounds, mut chords, mut idle) = (0, 0, 0);
        // Where the last of several short steps ended.
        let mut behind: Option<(Vec<f64>, Vec<Nuisances>)> = None;
        let mut course = Course::new(at.total, settings.iterations);
        while rounds < settings.iterations {
            let Some((moved, own)) = system.step(free, &at.values, &at.nuisances, damping) else { break };
            if chords == 0 {
                let promised = system.promises(free, &at.values, &moved);
                // One that is far behind and promises no more, or that has slowed down so much, does not catch up.
                let undamped = damping <= UNDAMPED;
                let promises = !undamped || at.total - PROMISED * promised <= fitted.until.beyond;
                if !promises || course.may_come_to() > fitted.until.beyond {
                    break;
                }
                if undamped && fitted.until.known.is_some_and(|known| system.leads_to(&moved, known)) {
                    return None;
                }
                if promised < SETTLED {
                    if !coarse(&fitted) {
                        break;
                    }
                    (fitted.fine, damping) = (true, UNDAMPED);
                    system = self.slopes(&mut fitted, &at, Some(system))?;
                    continue;
                }
            }
            let before = at.total;
            match self.at(&fitted, moved, own).filter(|to| to.total < before) {
                Some(to) => at = to,
                None if chords > 0 => {}
                None if kept => {
                    (kept, cost_of_nuisances) = (false, at.cost);
                    system = self.slopes(&mut fitted, &at, None)?;
                    continue;
                }
                None if coarse(&fitted) && damping >= STALLED => {
                    (fitted.fine, damping) = (true, UNDAMPED);
                    system = self.slopes(&mut fitted, &at, Some(system))?;
                    continue;
                }
                None => {
                    damping *= 10.0;
                    if damping > 1e5 {
                        break;
                    }
                    continue;
                }
            }
            if chords == 0 {
                let ended = (damping >= SHORT).then(|| (at.values.clone(), at.nuisances.clone()));
                if let (Some(from), Some(_)) = (&behind, &ended) {
                    at = self.further(&fitted, at, from);
                }
                behind = ended;
                rounds += 1;
                course.came_to(at.total);
                damping = (damping * 0.1).max(1e-9);
            }
            fitted.spec.clone_from(&at.spec);
            let settled = before - at.total < SETTLED;
            // The slopes hold for a few steps; one simulation in place of one for each of them.
            if !settled && chords < CHORDS {
                chords += 1;
                self.aim(&mut system, &at.nuisances, &at.steps);
                continue;
            }
            // A step may promise more than it keeps, once.
            idle = if settled && chords == 0 { idle + 1 } else { 0 };
            let mut ended = idle > 1;
            chords = 0;
            // The slopes along the nuisances change little while the model moves little.
            kept = at.cost > LITTLE * cost_of_nuisances;
            if !kept {
                cost_of_nuisances = at.cost;
            }
            if ended && coarse(&fitted) {
                (fitted.fine, ended, idle) = (true, false, 0);
            }
            system = self.slopes(&mut fitted, &at, kept.then_some(system))?;
            if ended {
                break;
            }
        }
        if coarse(&fitted) {
            fitted.fine = true;
            system = self.slopes(&mut fitted, &at, Some(system))?;
        }
        let count = at.steps.iter().map(|s| self.count(s.window)).sum();
        let prior = at.total - at.cost;
        let on = system.step(free, &at.values, &at.nuisances, UNDAMPED);
        let promised = on.map_or(0.0, |(moved, _)| system.promises(free, &at.values, &moved));
        let At { values, nuisances, cost, .. } = at;
        Some(Laid { prior, values, nuisances, cost, promised, count, information: system.normal })
    }

    /// Lays a model with such values against the steps of a part.
    pub(super) fn at(
        &self,
        fitted: &Fitted<'_>,
        values: Vec<f64>,
        nuisances: Vec<Nuisances>,
    ) -> Option<At<'_>> {
        let mut spec = fitted.spec.clone();
        fitted.numbers.put(&values, &mut spec).then_some(())?;
        let (cost, steps) = self.lay(&spec, Part::Training, &values, &nuisances)?;
        let total = cost + least_squares::prior_sum(fitted.free, &values);
        Some(At { spec, values, nuisances, steps, cost, total })
    }

    /// In a valley that bends every step is a short one: on along what the last one came to, from floor to floor.
    fn further<'b>(
        &'b self,
        fitted: &Fitted<'_>,
        mut at: At<'b>,
        from: &(Vec<f64>, Vec<Nuisances>),
    ) -> At<'b> {
        let (values, nuisances) = (at.values.clone(), at.nuisances.clone());
        for times in FURTHER {
            let on = |x: &[f64], of: &[f64]| -> Vec<f64> {
                x.iter().zip(of).map(|(x, of)| x + times * (x - of)).collect()
            };
            let mut moved = on(&values, &from.0);
            moved
                .iter_mut()
                .zip(fitted.free)
                .for_each(|(x, free)| *x = x.clamp(free.bounds.0, free.bounds.1));
            let own = nuisances.iter().zip(&from.1).map(|(x, of)| on(x, of)).collect();
            match self.at(fitted, moved, own) {
                Some(to) if to.total < at.total => at = to,
                _ => break,
            }
        }
        at
    }

    /// The slopes where a fit stands. Fine ones again where the coarse ones had made a number's deviation too small, and with it the
    /// difference: what a solver's errors add to slopes is information that is not there.
    pub(super) fn slopes(
        &self,
        fitted: &mut Fitted<'_>,
        at: &At<'_>,
        known: Option<System>,
    ) -> Option<System> {
        let mut system = self.linearise(fitted, &at.values, &at.nuisances, &at.steps, known)?;
        // The width of exact differences depends on nothing.
        if is_piecewise_linear(&fitted.spec) {
            return Some(system);
        }
        for _ in 0..AGAIN {
            let covariance = least_squares::covariance(&system.normal, fitted.free, 1.0);
            let now = covariance.diagonal().iter().map(|variance| variance.max(0.0).sqrt()).collect();
            let before = std::mem::replace(&mut fitted.deviations, now);
            if !fitted.fine {
                break;
            }
            // Where a wider difference has it smaller again, the two would take turns for ever.
            fitted.deviations.iter_mut().zip(&before).for_each(|(now, before)| *now = now.max(*before));
            let wider = |((free, now), before): ((&Free, &f64), &f64)| {
                let [now, before] = [now, before].map(|known| difference(free, false, true, *known));
                now > GROWN * before
            };
            let each = fitted.free.iter().zip(&fitted.deviations).zip(&before);
            if !each.take(self.of_model(&at.values)).any(wider) {
                break;
            }
            system = self.linearise(fitted, &at.values, &at.nuisances, &at.steps, Some(system))?;
        }
        Some(system)
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
            |k| steps[*k].simulated.len(),
            || self.job(fitted, values),
            |job, &k| {
                let known = known.as_ref().map(|own| own[k].beside.clone());
                self.eliminate(job, &steps[k], &nuisances[k], known)
            },
        )?;
        let size = values.len();
        let mut system =
            System { normal: DMatrix::zeros(size, size), gradient: DVector::zeros(size), own: Vec::new() };
        for (information, own) in eliminated {
            system.normal += information;
            system.own.push(own);
        }
        self.aim(&mut system, nuisances, steps);
        Some(system)
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
        let inner = weight * (gram(&beside) + &precision);
        let inverse = inner.cholesky()?.inverse();
        let mixed = weight * mixed_gram(&along, &beside);
        let information = weight * gram(&along) - &mixed * &inverse * mixed.transpose();
        let pull = DVector::zeros(own.len());
        Some((information, Eliminated { along, beside, weight, precision, mixed, inverse, pull }))
    }

    /// A step's slope of the cost by its sum of squares.
    pub(super) fn weight(&self, step: &Step<'_>, own: &[f64], precision: &DMatrix<f64>) -> f64 {
        let now = DVector::from_column_slice(own);
        let chi2 = dot(&step.residuals, &step.residuals) + (now.transpose() * precision * &now)[(0, 0)];
        robust(chi2, self.count(step.window)).1
    }

    /// The gradient where the residuals are now, along the slopes that are there.
    pub(super) fn aim(&self, system: &mut System, nuisances: &[Nuisances], steps: &[Step<'_>]) {
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

    /// Covariance of a fit's values, so many residuals counting as one independent one.
    pub(super) fn covariance(&self, numbers: &Numbers, laid: &Laid, colour: f64) -> DMatrix<f64> {
        laid.as_fit(&laid.values, laid.information.clone()).covariance(&self.free(numbers, 0.0), colour)
    }

    /// What the response says of each record's gains, of the displacement sensor and of the accelerometers on the mass, beside what the
    /// kinematics say: factors.
    pub fn gains(&self, numbers: &Numbers, laid: &Laid, colour: f64) -> Vec<[Estimate; 2]> {
        let factor = |less_one: Estimate| Estimate { value: 1.0 + less_one.value, ..less_one };
        let of_record = |common: Vec<Estimate>| [factor(common[3]), factor(common[4])];
        self.of_records(numbers, laid, colour).map(of_record).collect()
    }

    /// By how much each record's answer comes later than the model's, s.
    pub fn lags_s(&self, numbers: &Numbers, laid: &Laid, colour: f64) -> Vec<Estimate> {
        self.of_records(numbers, laid, colour).map(|common| common[2]).collect()
    }

    /// What is common to all steps of each record.
    fn of_records(&self, numbers: &Numbers, laid: &Laid, colour: f64) -> impl Iterator<Item = Vec<Estimate>> {
        let (first, covariance) = (self.of_model(&laid.values), self.covariance(numbers, laid, colour));
        let value =
            move |j: usize| Estimate { value: laid.values[j], sigma: covariance[(j, j)].max(0.0).sqrt() };
        (0..self.records())
            .map(move |record| (0..COMMON).map(|i| value(first + COMMON * record + i)).collect())
    }

    /// The fit as the rest of the diagnosis knows fits: the model's numbers and the zero, everything else eliminated.
    pub fn refit(&self, start: &ModelSpec, numbers: &Numbers, laid: &Laid, colour: f64) -> Refit {
        let free = self.free(numbers, 0.0);
        let kept = self.of_model(&laid.values) + 1;
        let covariance = self.covariance(numbers, laid, colour);
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
            fit: laid.as_fit(&laid.values[..kept], information),
            inflation: colour,
            sigmas,
            limits: Vec::new(),
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
    /// Slopes along the numbers as good as they are to be had.
    pub(super) fine: bool,
    /// When it is given up.
    pub(super) until: Until<'b>,
    /// Standard deviation of each value as far as it is known; none before the first slopes.
    pub(super) deviations: Vec<f64>,
}

impl<'b> Fitted<'b> {
    pub(super) fn new(spec: &ModelSpec, numbers: &'b Numbers, free: &'b [Free], fine: bool) -> Self {
        Self {
            spec: spec.clone(),
            numbers,
            free,
            moving: true,
            fine,
            until: Until::default(),
            deviations: Vec::new(),
        }
    }

    /// A fitted model whose numbers stay: what belongs to the steps alone moves.
    pub(super) fn at_rest(spec: &ModelSpec, numbers: &'b Numbers, free: &'b [Free]) -> Self {
        Self { moving: false, ..Self::new(spec, numbers, free, true) }
    }
}

/// Where a fit stands.
pub(super) struct At<'b> {
    pub(super) spec: ModelSpec,
    pub(super) values: Vec<f64>,
    pub(super) nuisances: Vec<Nuisances>,
    pub(super) steps: Vec<Step<'b>>,
    pub(super) cost: f64,
    /// With the priors.
    pub(super) total: f64,
}

/// Normal equations with the nuisances of each step eliminated, and what is needed to find those again.
#[derive(Clone)]
pub(super) struct System {
    pub(super) normal: DMatrix<f64>,
    pub(super) gradient: DVector<f64>,
    pub(super) own: Vec<Eliminated>,
}

/// What belongs to one step.
#[derive(Clone)]
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
    pub(super) fn promises(&self, free: &[Free], values: &[f64], moved: &[f64]) -> f64 {
        let n = self.gradient.len();
        let of_steps = self.own.iter().map(|own| (own.pull.transpose() * &own.inverse * &own.pull)[(0, 0)]);
        let change = DVector::from_fn(n, |j, _| moved[j] - values[j]);
        let of_values =
            -2.0 * self.gradient.dot(&change) - (change.transpose() * &self.normal * &change)[(0, 0)];
        let of_priors = least_squares::prior_sum(free, values) - least_squares::prior_sum(free, moved);
        of_steps.sum::<f64>() + of_values + of_priors
    }

    /// Whether values lie where another fit of them ended, as far as the record tells; not where that was of other ones.
    fn leads_to(&self, moved: &[f64], known: &Laid) -> bool {
        if known.values.len() != moved.len() {
            return false;
        }
        let apart = DVector::from_fn(moved.len(), |j, _| moved[j] - known.values[j]);
        (apart.transpose() * &self.normal * &apart)[(0, 0)] < SAME
    }

    /// Values and nuisances after a damped step.
    pub(super) fn step(
        &self,
        free: &[Free],
        values: &[f64],
        nuisances: &[Nuisances],
        damping: f64,
    ) -> Option<(Vec<f64>, Vec<Nuisances>)> {
        let n = self.gradient.len();
        let moved = least_squares::damped_step(free, values, &self.normal, &self.gradient, damping)?;
        let change = DVector::from_fn(n, |j, _| moved[j] - values[j]);
        let own = nuisances.iter().zip(&self.own).map(|(own, eliminated)| {
            let pull = &eliminated.pull + eliminated.mixed.transpose() * &change;
            let step = &eliminated.inverse * pull;
            own.iter().zip(step.iter()).map(|(x, s)| x - s).collect()
        });
        Some((moved, own.collect()))
    }
}
