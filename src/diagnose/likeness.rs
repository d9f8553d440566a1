//! Which force is like another one along the measured motion, what a model's own numbers can make of either left aside? Where a base
//! model is far from its record, first order does not tell what it lacks; what was found does.

use super::candidates;
use super::trial::Trial;
use crate::identify::least_squares::{dot, gram, sum_of_squares};
use crate::identify::numbers::Numbers;
use crate::identify::problem::{Part, Problem};
use crate::model::{EffectSpec, ModelSpec};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Share of the width of its prior by which a number is moved for its slope.
const STEP: f64 = 0.1;

/// A force along the motion, in units of its noise, beside what the base model's numbers can make of a force.
pub struct Likeness<'a> {
    problem: &'a Problem<'a>,
    zero_m: f64,
    /// The model that the force is to be added to, and the residuals that it leaves.
    bare: ModelSpec,
    left: Vec<f64>,
    /// The base model's numbers, their slopes for a move by the width of the prior, and the information of all together.
    numbers: &'a Numbers,
    slopes: Vec<Vec<f64>>,
    information: Cholesky<f64, Dyn>,
    found: Followed,
}

/// A force, by how much the base model's numbers make up for it, in widths of their priors, and what is left of it then.
struct Followed {
    by: DVector<f64>,
    rest: Vec<f64>,
}

/// How like a force is to what was found.
pub struct Like {
    /// Share of the power of what was found that it has.
    pub share: f64,
    /// The model with it, and with its numbers such that both together are most like what was asked.
    pub with: ModelSpec,
}

impl<'a> Likeness<'a> {
    /// To what the effects of a trial beyond the base model do together; `None` when a model cannot be built.
    pub fn new(problem: &'a Problem<'a>, base: &'a Trial, taken: &Trial) -> Option<Self> {
        let zero_m = taken.refit.zero_m;
        let mut bare = taken.refit.spec.clone();
        bare.effects.truncate(base.refit.spec.effects.len());
        let left = residuals(problem, &bare, zero_m)?;
        let found = force(problem, &taken.refit.spec, zero_m, &left)?;
        Self::to(found, (problem, zero_m), base, (bare, left))
    }

    /// To what the base model leaves.
    pub fn to_what_is_left(problem: &'a Problem<'a>, base: &'a Trial) -> Option<Self> {
        let (bare, zero_m) = (base.refit.spec.clone(), base.refit.zero_m);
        let left = residuals(problem, &bare, zero_m)?;
        Self::to(left.clone(), (problem, zero_m), base, (bare, left))
    }

    fn to(
        found: Vec<f64>,
        (problem, zero_m): (&'a Problem<'a>, f64),
        base: &'a Trial,
        (bare, left): (ModelSpec, Vec<f64>),
    ) -> Option<Self> {
        let numbers = &base.refit.numbers;
        let slope = |j: usize| {
            let by =
                DVector::from_fn(numbers.free.len(), |i, _| if i == j { numbers.free[i].scale } else { 0.0 });
            let moved = numbers.moved(bare.clone(), by.as_slice(), STEP)?;
            Some(force(problem, &moved, zero_m, &left)?.into_iter().map(|x| x / STEP).collect())
        };
        let slopes = (0..numbers.free.len()).map(slope).collect::<Option<Vec<Vec<f64>>>>()?;
        // Each number within its prior, in units of whose width it moves.
        let information = (gram(&slopes) + DMatrix::identity(slopes.len(), slopes.len())).cholesky()?;
        let found = followed(&slopes, &information, found);
        Some(Self { problem, zero_m, bare, left, numbers, slopes, information, found })
    }

    /// How like a start of an effect is, `grown` by as much as is best; `None` when its model cannot be built.
    pub fn of(
        &self,
        start: &EffectSpec,
        grown: impl Fn(&EffectSpec, f64) -> Option<EffectSpec>,
    ) -> Option<Like> {
        let force = force(self.problem, &candidates::beside(&self.bare, start), self.zero_m, &self.left)?;
        let other = followed(&self.slopes, &self.information, force);
        let along = dot(&other.rest, &self.found.rest);
        let times = along / sum_of_squares(&other.rest).max(f64::MIN_POSITIVE);
        let by = &self.found.by - other.by * times;
        let by: Vec<f64> = by.iter().zip(&self.numbers.free).map(|(by, free)| by * free.scale).collect();
        let with = candidates::beside(&self.bare, &grown(start, times)?);
        let share = times * along / sum_of_squares(&self.found.rest).max(f64::MIN_POSITIVE);
        Some(Like { share, with: self.numbers.moved(with, &by, 1.0)? })
    }
}

/// Measured minus modelled restoring force on the steps of the fit, in units of its noise.
fn residuals(problem: &Problem<'_>, spec: &ModelSpec, zero_m: f64) -> Option<Vec<f64>> {
    let mut out = Vec::new();
    problem.force_residuals(spec, zero_m, Part::Training, &mut out).then_some(out)
}

/// What a model's restoring force is more than that of one which leaves the residuals `left`.
fn force(problem: &Problem<'_>, spec: &ModelSpec, zero_m: f64, left: &[f64]) -> Option<Vec<f64>> {
    Some(left.iter().zip(residuals(problem, spec, zero_m)?).map(|(left, with)| left - with).collect())
}

fn followed(slopes: &[Vec<f64>], information: &Cholesky<f64, Dyn>, mut force: Vec<f64>) -> Followed {
    let along = DVector::from_iterator(slopes.len(), slopes.iter().map(|slope| dot(slope, &force)));
    let by = information.solve(&along);
    for (slope, by) in slopes.iter().zip(by.iter()) {
        force.iter_mut().zip(slope).for_each(|(rest, x)| *rest -= by * x);
    }
    Followed { by, rest: force }
}
