//! When a fit that is on its way is not worth going on. The descent asks at each round.

use super::{Laid, Measured};
use crate::identify::problem::Part;
use crate::model::ModelSpec;

/// A total that is lower by less is not worth another fit.
const BETTER: f64 = 1.0;

/// When a fit is given up.
#[derive(Clone, Copy, Debug)]
pub struct Until<'b> {
    /// Total that it has to come below.
    pub(super) beyond: f64,
    /// Where another fit of the same numbers ended: it need not be found twice.
    pub(super) known: Option<&'b Laid>,
}

impl Default for Until<'_> {
    /// Never.
    fn default() -> Self {
        Self::below(f64::INFINITY)
    }
}

impl<'b> Until<'b> {
    /// It has to come below a total.
    pub fn below(total: f64) -> Self {
        Self { beyond: total, known: None }
    }

    /// It has to do better than another fit of the same numbers.
    pub fn better_than(known: &'b Laid) -> Self {
        Self { beyond: known.total() - BETTER, known: Some(known) }
    }
}

impl Measured<'_> {
    /// What a fitted model comes to over every so many of the steps that it was fitted to, its priors included: what fits of these alone
    /// are measured by. `None` where it cannot be simulated.
    pub fn of_every(&self, steps: usize, fitted: &ModelSpec, laid: &Laid) -> Option<f64> {
        let nuisances: Vec<_> = laid.nuisances.iter().step_by(steps.max(1)).cloned().collect();
        let (cost, _) = self.every(steps).lay(fitted, Part::Training, &laid.values, &nuisances)?;
        Some(cost + laid.prior)
    }
}

/// Totals after each round of a fit that takes so many at most.
pub(super) struct Course {
    totals: Vec<f64>,
    rounds: usize,
}

impl Course {
    pub(super) fn new(total: f64, rounds: usize) -> Self {
        Self { totals: vec![total], rounds }
    }

    /// A round has ended there.
    pub(super) fn came_to(&mut self, total: f64) {
        self.totals.push(total);
    }

    /// Where it ends if all of the rounds left bring as much as the better of the last two.
    pub(super) fn may_come_to(&self) -> f64 {
        let [_, .., before, last, now] = self.totals.as_slice() else {
            return f64::NEG_INFINITY;
        };
        let left = (self.rounds + 1).saturating_sub(self.totals.len());
        now - left as f64 * (before - last).max(last - now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fit_may_come_as_far_as_its_last_rounds_go_on() {
        let mut course = Course::new(1000.0, 10);
        for (total, least) in
            [(500.0, f64::NEG_INFINITY), (400.0, f64::NEG_INFINITY), (390.0, -310.0), (389.0, 329.0)]
        {
            course.came_to(total);
            assert_eq!(course.may_come_to(), least);
        }
    }
}
