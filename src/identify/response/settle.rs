//! What belongs to each step alone, estimated where the numbers of a model stay: of the held-out steps whenever a fit is judged, and of
//! those of training whose start is hardly known when a fit has ended.

use super::columns::Job;
use super::descent::{Fitted, LITTLE};
use super::{Laid, Measured, Nuisances, STARTING, Step};
use crate::identify::least_squares::{dot, gram};
use crate::identify::numbers::Numbers;
use crate::identify::problem::Part;
use crate::model::ModelSpec;
use crate::parallel;
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

/// Steps that are tried at most.
const TRIED: usize = 40;
/// A fall of a step's cost that is not worth a simulation.
const SETTLED: f64 = 2e-3;
/// Share of what slopes promise below which they do not hold on.
const SLOW: f64 = 0.25;
/// Damping where a step led up, and the one beyond which none leads down.
const DAMPED: f64 = 1e-2;
const STUCK: f64 = 1e4;
/// A step is elsewhere when it leaves so many times what most steps leave; and what another start has to bring at least.
const ELSEWHERE: f64 = 3.0;
const BETTER: f64 = 0.1;
/// Square of the distance, in deviations, by which what belongs to a step has gone from what is known of it beforehand, beyond which it is
/// tried from there again: in a step that makes much of its start a fit that comes from another model's may stay where the noise did not
/// put it.
const ASTRAY: f64 = 25.0;
/// Other starts of such a step: displacement and velocity, in deviations of what is known of them beforehand.
const OTHER_STARTS: [[f64; 2]; 8] =
    [[0.3, 0.0], [-0.3, 0.0], [0.0, 0.3], [0.0, -0.3], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];

/// Where a step has settled.
struct Settled {
    cost: f64,
    own: Nuisances,
}

impl Settled {
    /// Goes to another place where that is a better one; whether it does.
    fn replaced_by(&mut self, other: Option<Self>) -> bool {
        let better = other.filter(|other| other.cost < self.cost - BETTER);
        let found = better.is_some();
        if let Some(better) = better {
            *self = better;
        }
        found
    }
}

impl Measured<'_> {
    /// Lays a fitted model against the held-out steps: only what belongs to each step is estimated.
    pub fn judge(&self, spec: &ModelSpec, numbers: &Numbers, laid: &Laid) -> Option<Laid> {
        let mut spec = spec.clone();
        numbers.put(&laid.values, &mut spec).then_some(())?;
        let free = self.free(numbers, 0.0);
        let fitted = Fitted::at_rest(&spec, numbers, &free);
        let windows = self.windows(Part::HeldOut);
        let starts: Vec<(usize, Nuisances)> =
            windows.iter().copied().zip(self.still(Part::HeldOut)).collect();
        let settled = self.settled(&fitted, &laid.values, &starts)?;
        let mut settled = settled.into_iter().collect::<Option<Vec<Settled>>>()?;
        self.elsewhere(&fitted, &laid.values, windows, &mut settled)?;
        Some(Laid {
            values: laid.values.clone(),
            cost: settled.iter().map(|of| of.cost).sum(),
            prior: 0.0,
            promised: 0.0,
            count: windows.iter().map(|k| self.count(&self.motion.windows[*k])).sum(),
            information: DMatrix::zeros(0, 0),
            nuisances: settled.into_iter().map(|of| of.own).collect(),
        })
    }

    /// What belongs to the steps of training where some of it is found in a better place than where a fit ended; nothing where none is.
    pub(super) fn better_starts(
        &self,
        spec: &ModelSpec,
        numbers: &Numbers,
        laid: &Laid,
    ) -> Option<Vec<Nuisances>> {
        let windows = self.windows(Part::Training);
        let astray: Vec<usize> =
            (0..windows.len()).filter(|i| self.is_astray(windows[*i], &laid.nuisances[*i])).collect();
        if self.sees_displacement && astray.is_empty() {
            return None;
        }
        let mut spec = spec.clone();
        numbers.put(&laid.values, &mut spec).then_some(())?;
        let free = self.free(numbers, 0.0);
        let fitted = Fitted::at_rest(&spec, numbers, &free);
        let each = self.lay_each(&spec, Part::Training, &laid.values, &laid.nuisances)?;
        let ended = each.into_iter().zip(&laid.nuisances);
        let mut settled: Vec<Settled> =
            ended.map(|((cost, _), own)| Settled { cost, own: own.clone() }).collect();
        let still = self.still(Part::Training);
        let starts: Vec<(usize, Nuisances)> =
            astray.iter().map(|i| (windows[*i], still[*i].clone())).collect();
        let again = self.settled(&fitted, &laid.values, &starts)?;
        let mut found = false;
        for (i, other) in astray.into_iter().zip(again) {
            found |= settled[i].replaced_by(other);
        }
        found |= self.elsewhere(&fitted, &laid.values, windows, &mut settled)?;
        found.then(|| settled.into_iter().map(|of| of.own).collect())
    }

    /// Whether what belongs to a step has gone far from what is known of it beforehand.
    fn is_astray(&self, k: usize, own: &[f64]) -> bool {
        let sigmas = self.sigmas(&self.motion.windows[k]);
        own[..STARTING].iter().zip(&sigmas).map(|(x, sigma)| (x / sigma).powi(2)).sum::<f64>() > ASTRAY
    }

    /// Steps settled from so many starts, each the number of its window and what belongs to it there; none of one that leaves the finite
    /// numbers.
    fn settled(
        &self,
        fitted: &Fitted<'_>,
        values: &[f64],
        starts: &[(usize, Nuisances)],
    ) -> Option<Vec<Option<Settled>>> {
        let length = |(k, _): &(usize, Nuisances)| self.motion.windows[*k].range.len();
        parallel::map_with(
            starts,
            length,
            || self.job(fitted, values),
            |job, (k, own)| Some(self.settle(job, *k, own.clone())),
        )
    }

    /// Steps whose start nothing but an integrated acceleration tells may have settled where a contact begins on the wrong side: those
    /// that leave far more than most are tried from other starts. Whether any did better.
    fn elsewhere(
        &self,
        fitted: &Fitted<'_>,
        values: &[f64],
        windows: &[usize],
        settled: &mut [Settled],
    ) -> Option<bool> {
        if self.sees_displacement {
            return Some(false);
        }
        let over = |(k, settled): (&usize, &Settled)| {
            settled.cost / self.count(&self.motion.windows[*k]).max(1) as f64
        };
        let means: Vec<f64> = windows.iter().zip(settled.iter()).map(over).collect();
        let mut sorted = means.clone();
        sorted.sort_by(f64::total_cmp);
        let most = ELSEWHERE * sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
        let mut found = false;
        for i in (0..means.len()).filter(|i| means[*i] > most) {
            let sigmas = self.sigmas(&self.motion.windows[windows[i]]);
            let start = |deviations: [f64; 2]| {
                let mut own = vec![0.0; settled[i].own.len()];
                own.iter_mut().zip(&sigmas).zip(deviations).for_each(|((x, sigma), by)| *x = by * sigma);
                (windows[i], own)
            };
            let tried = self.settled(fitted, values, &OTHER_STARTS.map(start))?;
            for other in tried {
                found |= settled[i].replaced_by(other);
            }
        }
        Some(found)
    }

    /// Gauss-Newton on what belongs to one step, damped where it leads up.
    fn settle(&self, job: &mut Job<'_>, k: usize, mut own: Nuisances) -> Option<Settled> {
        let precision = self.precision(&self.motion.windows[k]);
        let (mut cost, mut step) = self.lay_one(&mut job.own, k, job.values, &own)?;
        let mut slopes = Slopes::of(self, job, &step, &own, cost, &precision);
        let mut damping = 0.0;
        for _ in 0..TRIED {
            let Some((change, promised)) = slopes.change(self, &step, &own, &precision, damping) else {
                break;
            };
            let fresh = cost >= slopes.cost;
            if promised < SETTLED && (fresh || cost > LITTLE * slopes.cost) {
                break;
            }
            let moved: Nuisances = own.iter().zip(change.iter()).map(|(x, by)| x - by).collect();
            match self.lay_one(&mut job.own, k, job.values, &moved).filter(|(to, _)| *to < cost) {
                Some((to, at)) => {
                    let worth_going_on = cost - to > SLOW * promised;
                    (cost, step, own, damping) = (to, at, moved, 0.1 * damping);
                    if worth_going_on && cost > LITTLE * slopes.cost {
                        continue;
                    }
                }
                None if fresh => {
                    damping = (10.0 * damping).max(DAMPED);
                    if damping > STUCK {
                        break;
                    }
                    continue;
                }
                None => {}
            }
            slopes = Slopes::of(self, job, &step, &own, cost, &precision);
        }
        Some(Settled { cost, own })
    }
}

/// Slopes of a step's residuals along what belongs to it, and the cost where they were taken.
struct Slopes {
    beside: Arc<Vec<Vec<f64>>>,
    fisher: DMatrix<f64>,
    cost: f64,
}

impl Slopes {
    fn of(
        measured: &Measured<'_>,
        job: &mut Job<'_>,
        step: &Step<'_>,
        own: &[f64],
        cost: f64,
        precision: &DMatrix<f64>,
    ) -> Self {
        let (_, beside) = measured.columns(job, step, own, None);
        let fisher = gram(&beside) + precision;
        Self { beside, fisher, cost }
    }

    /// By how much to go back along each nuisance, and how far the cost falls to second order without damping.
    fn change(
        &self,
        measured: &Measured<'_>,
        step: &Step<'_>,
        own: &[f64],
        precision: &DMatrix<f64>,
        damping: f64,
    ) -> Option<(DVector<f64>, f64)> {
        let weight = measured.weight(step, own, precision);
        let along = DVector::from_fn(own.len(), |i, _| dot(&self.beside[i], &step.residuals));
        let pull = along + precision * DVector::from_column_slice(own);
        let undamped = self.fisher.clone().cholesky()?.solve(&pull);
        let promised = weight * pull.dot(&undamped);
        if damping == 0.0 {
            return Some((undamped, promised));
        }
        let mut damped = self.fisher.clone();
        (0..own.len()).for_each(|i| damped[(i, i)] *= 1.0 + damping);
        Some((damped.cholesky()?.solve(&pull), promised))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::testing::seen_over;
    use crate::identify::kinematics::Tolerances;
    use crate::identify::least_squares::Settings;
    use crate::identify::motion::Motion;
    use crate::model::testing::b1_g2;
    use crate::sweep::{SweepSpec, Transition};

    /// Behind a stiff bumper the mass comes back otherwise in every cycle of some steps, and ever farther off where it started so.
    #[test]
    fn a_fit_that_comes_from_a_start_far_off_ends_where_the_noise_put_it() {
        let mut truth = b1_g2();
        truth.isolator.damping_n_s_m = 1156.0;
        if let Some(bumper) = &mut truth.bumper {
            (bumper.stiffness_n_m, bumper.damping_n_s_m, bumper.total_gap_m) = (686e3, 1604.0, 0.0108);
        }
        let mut sweep =
            SweepSpec { transition: Transition::None, acceleration_g: 0.056, ..SweepSpec::paper() };
        (sweep.start_hz, sweep.stop_hz, sweep.step_hz, sweep.cycles) = (Some(0.7), Some(1.3), Some(0.05), 10);
        let record = seen_over(&truth, &sweep, 5);
        let motion = Motion::of(&record, truth.mass_kg, Tolerances::default()).expect("a motion");
        let measured = Measured::new(&motion).expect("a base record");
        let (numbers, settings) = (Numbers::default(), Settings { iterations: 30, ..Settings::default() });
        let fit = |from: Option<&Laid>| measured.fit(&truth, &numbers, 0.0, from, settings).expect("fits");
        let still = fit(None);
        let mut astray = still.clone();
        for (k, own) in measured.training.iter().zip(&mut astray.nuisances) {
            own[1] += 7.0 * measured.sigmas(&motion.windows[*k])[1];
        }
        // Of itself a step does not come back.
        let free = measured.free(&numbers, 0.0);
        let fitted = Fitted::at_rest(&truth, &numbers, &free);
        let starts: Vec<_> = measured.training.iter().copied().zip(astray.nuisances.clone()).collect();
        let settled = measured.settled(&fitted, &astray.values, &starts).expect("settles");
        let of_itself: f64 = settled.into_iter().flatten().map(|settled| settled.cost).sum();
        assert!(of_itself > 1.5 * still.cost, "{of_itself} {}", still.cost);
        let back = fit(Some(&astray));
        assert!((back.cost - still.cost).abs() < 1.0, "{} {}", back.cost, still.cost);
    }
}
