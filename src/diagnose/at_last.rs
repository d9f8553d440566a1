//! What an explanation of a component is let go to once a search has ended: corners sharper than the search allows, and numbers of an
//! effect's shape that it leaves as they usually are.

use super::search::{Searcher, Stage};
use super::summits::with_effect;
use super::trial::Trial;
use super::{candidates, verdict};
use crate::identify::refit::Refit;
use crate::model::{Scales, effects};
use crate::parallel;
use crate::record::Kind;

/// So many finalists of a component are let go beyond the limits of a search.
const LET_GO: usize = 2;
/// A number is at its limit when it is so near.
const AT_LIMIT: f64 = 1e-3;

impl Searcher<'_> {
    /// Fits the finalists of a component that are the last ones beyond limits that hold during the search.
    pub(super) fn let_go(&self, last: &mut Stage) {
        if self.motion.kind == Kind::Component {
            let first: Vec<Trial> = last.finalists.iter().take(LET_GO).cloned().collect();
            let farther = parallel::map(&first, parallel::cores(), |trial| self.beyond_limits(trial.clone()));
            last.finalists.iter_mut().zip(farther).for_each(|(trial, farther)| *trial = farther);
            last.finalists.sort_by(|a, b| a.force.chi2.total_cmp(&b.force.chi2));
        }
    }

    /// An explanation of a component with the numbers of shape that ended at the limit of what can be simulated let go: along a motion that is
    /// known, corners may be sharper. A search does without: beside what is still missing they would be too sharp.
    pub(super) fn beyond_limits(&self, trial: Trial) -> Trial {
        if self.motion.kind != Kind::Component {
            return trial;
        }
        let scales = candidates::scales(&trial.refit.spec, self.motion);
        let mut wider = trial.clone();
        let mut is_let_go = false;
        for (index, effect) in trial.refit.spec.effects.iter().enumerate() {
            for shape in candidates::shapes(&effect.name) {
                let Some(farthest) = shape.at_last else { continue };
                let key = format!("effect[{index}].{}", shape.name);
                is_let_go |= match shape.limits {
                    Some((_, high)) => let_go(&mut wider.refit, &key, high, farthest.1),
                    None => take_along(&mut wider, (index, shape.name), farthest, &scales),
                };
            }
        }
        let farther = if is_let_go { self.fitted_by_force(&wider) } else { None };
        farther.filter(|farther| verdict::apart(farther, &trial) > 0.0).unwrap_or(trial)
    }
}

/// Lets a number that ended at its limit go to a farther one; whether it did. What has been let go is where it is.
fn let_go(refit: &mut Refit, key: &str, limit: f64, farthest: f64) -> bool {
    let Refit { numbers, fit, .. } = refit;
    let mut all = numbers.numbers.iter().zip(&mut numbers.free).zip(&fit.values);
    let of = all.find(|((number, _), _)| number.key == key);
    let held = of.filter(|((number, free), value)| {
        let is_held = free.bounds.1 < number.as_fitted(farthest);
        is_held && **value >= number.as_fitted(limit) - AT_LIMIT
    });
    held.map(|((number, free), _)| free.bounds.1 = number.as_fitted(farthest)).is_some()
}

/// Takes a number of an effect's shape that a search leaves as it is into what is fitted, within such limits; whether it was not before.
fn take_along(trial: &mut Trial, (index, name): (usize, &str), limits: (f64, f64), scales: &Scales) -> bool {
    let mut spec = trial.refit.spec.clone();
    let Some(of) = spec.effects.get_mut(index).filter(|of| !of.parameters.contains_key(name)) else {
        return false;
    };
    let effect = effects::find(&of.name).map(|effect| (effect.parameters)(scales)).unwrap_or_default();
    let Some(default) = effect.iter().find(|p| p.name == name).and_then(|p| p.default) else { return false };
    of.parameters.insert(name.to_owned(), default);
    *trial = with_effect(trial.clone(), spec, index, scales);
    bound(&mut trial.refit, &format!("effect[{index}].{name}"), limits);
    true
}

/// Keeps a number within limits.
pub(super) fn bound(refit: &mut Refit, key: &str, (low, high): (f64, f64)) {
    let numbers = refit.numbers.numbers.iter().zip(&mut refit.numbers.free);
    numbers.filter(|(number, _)| number.key == key).for_each(|(number, free)| {
        free.bounds = (number.as_fitted(low), number.as_fitted(high));
    });
}

#[cfg(test)]
mod tests {
    use crate::diagnose::testing::imposed;
    use crate::diagnose::{Options, Verdict, diagnose};
    use crate::model::ModelSpec;
    use crate::model::effects::stribeck_friction::EXPONENT;
    use crate::model::testing::{b1_g2, effect};

    #[test]
    #[ignore = "minutes: `./test blind`"]
    fn friction_that_falls_as_tustin_has_it_is_stribecks_with_its_exponent() {
        let nominal = ModelSpec { bumper: None, ..b1_g2() };
        let mut truth = nominal.clone();
        let numbers = [("fc_n", 200.0), ("fs_n", 350.0), ("vs_m_s", 0.02), (EXPONENT, 1.0)];
        truth.effects.push(effect("stribeck-friction", &numbers));
        let found = diagnose(&imposed(&truth, 62), &nominal, &Options::default()).expect("a sound record");
        let names: Vec<&str> = found.effects.iter().map(|of| of.name.as_str()).collect();
        assert_eq!((found.verdict, names), (Verdict::Missing, vec!["stribeck-friction"]));
        for (name, truth) in numbers {
            let told = found.effects[0].parameters[name].value;
            assert!((told / truth - 1.0).abs() < 0.1, "{name}: {told} for {truth}");
        }
    }
}
