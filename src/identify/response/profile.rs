//! Limits of numbers by the profile of the likelihood: a number is held where it may just be, and everything else is fitted again.
//! Where a valley bends (a springpot's strength with its order, a branch's time with its stiffness) the curvature at its floor says
//! far too little. Called for what a diagnosis names in the end.

use super::descent::{At, Eliminated, Fitted, System, UNDAMPED};
use super::{Laid, Measured};
use crate::identify::least_squares::{Free, Settings};
use crate::identify::numbers::Numbers;
use crate::model::ModelSpec;
use crate::parallel;
use nalgebra::{DMatrix, DVector};

/// Twice the fall of the log-likelihood at limits of 95 %, and how many standard deviations of a parabola that is.
const FALL: f64 = 3.84;
const TIMES: f64 = 1.96;
/// Share of that fall, from and to, from which the limit follows by a parabola; attempts to come as near.
const NEAR: (f64, f64) = (0.75, 1.35);
const ATTEMPTS: usize = 4;
/// A rise of the log-likelihood, twice, that is a better place.
const RISEN: f64 = 2.0;
/// Share of its prior's deviation that the record leaves a number of the model's own of which it says nothing: that has its prior. Of what
/// it says something the curvature may say too much: a slope that begins where a bumper does bends the valley of the gap, and a knee at the
/// end of the motion is held by what is within and by nothing beyond.
const UNKNOWN: f64 = 0.9;
/// A rise to a share of the limit that a flat side is taken to have at least: the next attempt is so much farther out.
const FLAT: f64 = 0.01;
/// Steps with the slopes of the floor, and a fall of the cost below which these have led to the least.
const STEPS: usize = 6;
const SETTLED: f64 = 0.05;
/// How everything else is fitted where they do not.
const BESIDE: Settings = Settings { iterations: 8, tolerance: 1e-6, difference: 1e-3 };

/// What the likelihood says along numbers.
pub struct Profile {
    /// 95 % limits of every number of the model as the fit moves it; the wider of those of the profile and of the curvature,
    /// since a fit that did not arrive makes a profile too narrow.
    pub limits: Vec<(f64, f64)>,
    /// A better place that was come upon.
    pub better: Option<Laid>,
}

impl Measured<'_> {
    /// Profiles the likelihood along the numbers of the effects, and those of the model's own that the record tells (Venzon and
    /// Moolgavkar 1988), `colour` residuals counting as one independent one. Every other number may at least be where it was fitted beside
    /// their limits.
    pub fn profile(&self, spec: &ModelSpec, numbers: &Numbers, laid: &Laid, colour: f64) -> Profile {
        let covariance = self.covariance(numbers, laid, colour);
        let sigma = |j: usize| covariance[(j, j)].max(0.0).sqrt();
        let told = |j: usize| sigma(j) < UNKNOWN * numbers.free[j].prior.1;
        let own =
            (0..numbers.numbers.len()).filter(|j| numbers.numbers[*j].key.starts_with("effect[") || told(*j));
        let sides: Vec<(usize, f64)> = own.flat_map(|j| [(j, -1.0), (j, 1.0)]).collect();
        let slopes = if sides.is_empty() { None } else { self.slopes_there(spec, numbers, laid) };
        let from = Floor { spec, numbers, laid, colour, covariance: &covariance, slopes };
        let reached = parallel::map(&sides, parallel::cores(), |(j, side)| self.side(&from, *j, *side));
        let around = |j: usize| (laid.values[j] - TIMES * sigma(j), laid.values[j] + TIMES * sigma(j));
        let mut limits: Vec<(f64, f64)> = (0..numbers.numbers.len()).map(around).collect();
        let mut better: Option<Laid> = None;
        for side in reached.into_iter().flatten() {
            match side {
                Side::Limit(values) => {
                    for (limit, value) in limits.iter_mut().zip(values) {
                        *limit = (limit.0.min(value), limit.1.max(value));
                    }
                }
                Side::Better(there) if better.as_ref().is_none_or(|b| there.total() < b.total()) => {
                    better = Some(there);
                }
                Side::Better(_) => {}
            }
        }
        Profile { limits, better }
    }

    /// Goes to one side along a number to where the likelihood has fallen to its limit.
    fn side(&self, floor: &Floor<'_>, j: usize, side: f64) -> Option<Side> {
        let Floor { spec, numbers, laid, colour, covariance, slopes } = floor;
        let kept = numbers.numbers.len();
        let sigma = covariance[(j, j)].max(0.0).sqrt();
        let mut along: Vec<f64> =
            (0..laid.values.len()).map(|i| side * TIMES * covariance[(i, j)] / sigma.max(1e-300)).collect();
        let on = |along: &[f64], times: f64| -> Vec<f64> {
            laid.values.iter().zip(along).map(|(value, by)| value + times * by).collect()
        };
        let fallen_to = |cost: f64, prior: f64| (cost - laid.cost) / colour.max(1.0) + prior - laid.prior;
        let mut reached = None;
        for _ in 0..ATTEMPTS {
            let (mut held, mut values) = ((*numbers).clone(), on(&along, 1.0));
            for (free, value) in held.free.iter_mut().zip(&mut values) {
                *value = value.clamp(free.bounds.0, free.bounds.1);
                free.start = *value;
            }
            let bounds = held.free[j].bounds;
            let at_bound = values[j] <= bounds.0 || values[j] >= bounds.1;
            held.free[j].bounds = (values[j], values[j]);
            // The slopes of the floor mostly lead there, too: a step along them takes one simulation, new ones one for every number.
            let led = slopes.as_ref().and_then(|slopes| {
                let at = self.along(slopes, floor, &self.free(&held, 0.0), &values)?;
                Some((fallen_to(at.cost, at.total - at.cost), at.values))
            });
            let (fallen, there) = match led.filter(|(fallen, _)| *fallen >= -RISEN) {
                Some(led) => led,
                None => {
                    let from = Laid { values, ..(*laid).clone() };
                    let Some(there) = self.fit(spec, &held, 0.0, Some(&from), BESIDE) else { break };
                    let fallen = fallen_to(there.cost, there.prior);
                    if fallen < -RISEN {
                        return Some(Side::Better(there));
                    }
                    (fallen, there.values)
                }
            };
            let times = (FALL / fallen.max(FLAT * FALL)).sqrt();
            along = there.iter().zip(&laid.values).map(|(there, here)| there - here).collect();
            let share = fallen / FALL;
            if at_bound && share < NEAR.1 {
                return Some(Side::Limit(on(&along[..kept], 1.0)));
            }
            if share > NEAR.0 && share < NEAR.1 {
                return Some(Side::Limit(on(&along[..kept], times)));
            }
            if share < NEAR.0 {
                // So far at least.
                reached = Some(Side::Limit(on(&along[..kept], 1.0)));
            }
            along.iter_mut().for_each(|by| *by *= times);
        }
        reached
    }

    /// The slopes at the floor.
    fn slopes_there(&self, spec: &ModelSpec, numbers: &Numbers, laid: &Laid) -> Option<System> {
        let free = self.free(numbers, 0.0);
        let mut fitted = Fitted::new(spec, numbers, &free, true);
        let at = self.at(&fitted, laid.values.clone(), laid.nuisances.clone())?;
        fitted.spec.clone_from(&at.spec);
        self.slopes(&mut fitted, &at, None)
    }

    /// Fits everything else with the slopes of the floor where a number is held; `None` where they do not lead to the least.
    fn along<'b>(
        &'b self,
        slopes: &System,
        floor: &Floor<'_>,
        free: &[Free],
        values: &[f64],
    ) -> Option<At<'b>> {
        let mut slopes = slopes.clone();
        let fitted = Fitted::new(floor.spec, floor.numbers, free, true);
        let change = DVector::from_fn(values.len(), |j, _| values[j] - floor.laid.values[j]);
        let follow = |(own, of): (&Vec<f64>, &Eliminated)| -> Vec<f64> {
            let by = &of.inverse * (of.mixed.transpose() * &change);
            own.iter().zip(by.iter()).map(|(x, by)| x - by).collect()
        };
        let beside = floor.laid.nuisances.iter().zip(&slopes.own).map(follow).collect();
        let mut at = self.at(&fitted, values.to_vec(), beside)?;
        for _ in 0..STEPS {
            self.aim(&mut slopes, &at.nuisances, &at.steps);
            let (moved, own) = slopes.step(free, &at.values, &at.nuisances, UNDAMPED)?;
            let promised = slopes.promises(free, &at.values, &moved);
            if promised < SETTLED {
                return Some(at);
            }
            let to = self.at(&fitted, moved, own)?;
            if to.total >= at.total {
                return None;
            }
            at = to;
        }
        None
    }
}

/// Where a fit has arrived.
struct Floor<'b> {
    spec: &'b ModelSpec,
    numbers: &'b Numbers,
    laid: &'b Laid,
    colour: f64,
    covariance: &'b DMatrix<f64>,
    slopes: Option<System>,
}

/// What was found to one side.
enum Side {
    /// The model's numbers at the limit.
    Limit(Vec<f64>),
    Better(Laid),
}
