//! What is asked of two effects that were found one after the other: whether the second does without the first, beside which other first
//! it does better, and whether what does much the same as either does.

use super::candidates;
use super::contest::{FURTHER_ON, HALF, best_first};
use super::search::{Search, Searcher, Stage};
use super::summits::in_short;
use super::trial::{self, Trial};
use super::verdict;
use crate::identify::least_squares::Settings;
use crate::identify::refit::Refit;
use crate::identify::response::Measured;
use crate::model::EffectSpec;
use crate::parallel;

/// Nats that a simpler effect beside the one that contains it has to bring.
const MERGED: f64 = 20.0;
/// So many candidates that the force puts first beside the second effect alone are fitted by the response.
const BY_FORCE: usize = 4;

impl Searcher<'_> {
    /// An effect that contains the one before it (Stribeck's friction and Coulomb's) may do alone; so fitted it may do better than it did
    /// beside the model without either.
    pub(super) fn merge(&self, stage: &mut Stage, search: &mut Search) {
        let Some(measured) = &self.measured else { return };
        for trial in &mut stage.finalists {
            let [simple, whole] = trial.names.as_slice() else { continue };
            if !candidates::contained_in(whole).contains(&simple.as_str()) {
                continue;
            }
            let alone = self.without_one(trial, 0, &search.base);
            if let Some(alone) = trial::respond(measured, &alone, None, Settings::default())
                && verdict::apart(trial, &alone) < MERGED
            {
                search.improve(&alone);
                *trial = alone;
            }
        }
    }

    /// Pairs of the second effect of the best one with another first: greedy search starts without the second, and which the first
    /// is may show only beside it. It may do without any, too, where its shape came only with the pair.
    pub(super) fn exchange_first(&self, stage: &mut Stage, base: &Trial) {
        let Some(pair) = stage.finalists.first_mut() else { return };
        let [one, _] = pair.names.as_slice() else { return };
        let Some(measured) = &self.measured else {
            if let Some(alone) = self.second_by_force(base, pair) {
                *pair = alone;
            }
            return;
        };
        let second = trial::respond(measured, &self.without_one(pair, 0, base), None, Settings::default());
        let Some(second) = second else { return };
        let spec = &second.refit.spec;
        let scales = candidates::scales(spec, self.motion);
        let mut effects = self.candidates(spec);
        effects.retain(|effect| effect.name != *one);
        // Without the first, much is left: the force sorts out.
        let settled = if second.is_far() { self.settled(&second) } else { None };
        let mut by_force = settled.map_or(Vec::new(), |settled| self.screen(&settled, &effects, &scales));
        by_force.truncate(BY_FORCE);
        let before = pair.names.clone();
        let known = Some(&*pair);
        let others = self.by_response(measured, (&second, known), &by_force, &effects, &scales);
        stage.finalists.extend(others);
        best_first(&mut stage.finalists, base);
        let Some(best) = stage.finalists.first_mut() else { return };
        let alone = if best.names == before {
            Some(second)
        } else {
            trial::respond(measured, &self.without_one(best, 0, base), None, Settings::default())
        };
        if let Some(alone) = alone.filter(|alone| verdict::apart(best, alone) < MERGED) {
            *best = alone;
        }
    }

    /// A pair without its first effect by the force along the measured motion, where that is no worse: play bends a line, too.
    fn second_by_force(&self, base: &Trial, pair: &Trial) -> Option<Trial> {
        let alone = self.fitted_by_force(&self.without_one(pair, 0, base))?;
        (verdict::apart(pair, &alone) < MERGED).then_some(alone)
    }

    /// An explanation without one of its effects, to be fitted; the model's own numbers start where it has put them.
    fn without_one(&self, trial: &Trial, which: usize, base: &Trial) -> Trial {
        let mut without = trial.clone();
        let Refit { spec, numbers, .. } = &mut without.refit;
        let known = spec.effects.len() - without.names.len();
        without.names.remove(which);
        spec.effects.remove(known + which);
        let scales = candidates::scales(&base.refit.spec, self.motion);
        numbers.clone_from(&base.refit.numbers);
        (known..spec.effects.len()).for_each(|index| numbers.add_effect(spec, index, &scales));
        without
    }

    /// What does much the same as an effect of the best explanation and was not fitted in its place, from where that has the model's own
    /// numbers: with those off, the two look alike, or the one does that bends more. One effect that leaves noise alone stands.
    pub(super) fn twins(&self, measured: &Measured<'_>, finalists: &[Trial], base: &Trial) -> Vec<Trial> {
        let may_be_another = |best: &&Trial| best.names.len() > 1 || best.excess() > best.chance();
        let Some(best) = finalists.first().filter(may_be_another) else { return Vec::new() };
        let some = measured.every(HALF);
        let arrived = (0..best.names.len()).filter_map(|which| {
            let twin = candidates::twin(&best.names[which])?;
            let without = self.without_one(best, which, base);
            let tried = |trial: &Trial| {
                trial.names.iter().any(|name| name == twin)
                    && without.names.iter().all(|name| trial.names.contains(name))
            };
            if finalists.iter().any(tried) {
                return None;
            }
            let starts = self.starts_beside(&without, twin, base);
            let ended = parallel::map(&starts, parallel::cores(), |start| in_short(&some, start));
            let (_, nearest) = ended.into_iter().flatten().min_by(|a, b| a.0.total_cmp(&b.0))?;
            trial::respond(measured, &nearest, None, FURTHER_ON)
        });
        arrived.collect()
    }

    /// Starts of an effect beside a model, to be fitted; none where it is not tried.
    fn starts_beside(&self, model: &Trial, name: &str, base: &Trial) -> Vec<Trial> {
        let scales = candidates::scales(&base.refit.spec, self.motion);
        let effect = self.candidates(&model.refit.spec).into_iter().find(|effect| effect.name == name);
        let starts = effect.map_or(Vec::new(), |effect| candidates::starts(effect, &scales));
        let with = |start: &EffectSpec| {
            let mut trial = model.clone();
            trial.names.push(start.name.clone());
            trial.refit.spec = candidates::beside(&model.refit.spec, start);
            trial.refit.numbers.add_effect(&trial.refit.spec, trial.refit.spec.effects.len() - 1, &scales);
            trial
        };
        starts.iter().map(with).collect()
    }
}

impl Search {
    /// Takes a fit in place of one of the same effects that it does better than.
    fn improve(&mut self, trial: &Trial) {
        for stage in &mut self.stages {
            let worse = |known: &&mut Trial| known.names == trial.names && verdict::apart(trial, known) > 0.0;
            let Some(known) = stage.finalists.iter_mut().find(worse) else { continue };
            known.clone_from(trial);
            best_first(&mut stage.finalists, &self.base);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::contest::HOPELESS;
    use crate::diagnose::search::Effort;
    use crate::diagnose::testing::{seen, with};
    use crate::identify::kinematics::Tolerances;
    use crate::identify::motion::Motion;
    use crate::model::testing::{b1_g2, effect};

    #[test]
    fn a_pair_is_laid_against_what_does_much_the_same_as_either() {
        let mut truth = b1_g2();
        let fades = effect("stiffness-degradation", &[("delta", 0.1), ("tau_s", 60.0)]);
        let branch = effect("maxwell-branch", &[("km_n_m", 1500.0), ("tau_s", 0.08)]);
        truth.effects.extend([fades.clone(), branch.clone()]);
        let motion = Motion::of(&seen(&truth, 37), 500.0, Tolerances::default()).expect("a motion");
        let searcher = Searcher::new(&motion, &b1_g2(), Effort::default());
        let (base, measured) =
            (searcher.base(&b1_g2()).expect("fits"), searcher.measured.as_ref().expect("seen"));
        let springpot = effect("fractional-damping", &[("ca", 150.0), ("alpha", 0.6)]);
        let pair = with(&searcher, &base, &[fades.clone(), springpot], Settings::default());
        let laid = searcher.twins(measured, std::slice::from_ref(&pair), &base);
        let [twin] = laid.as_slice() else { panic!("{} for one springpot", laid.len()) };
        assert_eq!(twin.names, ["stiffness-degradation", "maxwell-branch"]);
        assert!(verdict::apart(twin, &pair) > HOPELESS, "{}", verdict::apart(twin, &pair));
        let told = twin.refit.spec.effects[1].parameters["tau_s"];
        assert!((told / 0.08 - 1.0).abs() < 0.1, "{told}");
        // What was laid beside it is not again.
        assert!(searcher.twins(measured, &[pair.clone(), twin.clone()], &base).is_empty());
    }

    #[test]
    fn an_effect_that_does_better_without_what_it_contains_stands_so_where_it_was_tried_alone() {
        let mut truth = b1_g2();
        truth.effects.push(effect("stribeck-friction", &[("fc_n", 20.0), ("fs_n", 40.0), ("vs_m_s", 0.02)]));
        let motion = Motion::of(&seen(&truth, 43), 500.0, Tolerances::default()).expect("a motion");
        let searcher = Searcher::new(&motion, &b1_g2(), Effort::default());
        let base = searcher.base(&b1_g2()).expect("fits");
        let coulomb = effect("coulomb-friction", &[("fc_n", 20.0)]);
        let stribeck = effect("stribeck-friction", &[("fc_n", 15.0), ("fs_n", 20.0), ("vs_m_s", 0.05)]);
        let short = |start: &EffectSpec, iterations: usize| {
            with(
                &searcher,
                &base,
                std::slice::from_ref(start),
                Settings { iterations, ..Settings::default() },
            )
        };
        let finalists = vec![short(&coulomb, 20), short(&stribeck, 1)];
        let first = Stage { finalists, ..Stage::default() };
        let mut search = Search { base: base.clone(), stages: vec![first] };
        // Beside the other the fit finds where it is.
        let near = effect("stribeck-friction", &[("fc_n", 18.0), ("fs_n", 37.0), ("vs_m_s", 0.019)]);
        let faint = effect("coulomb-friction", &[("fc_n", 1.0)]);
        let pair = with(&searcher, &base, &[faint, near], Settings::default());
        let mut second = Stage { finalists: vec![pair], ..Stage::default() };
        searcher.merge(&mut second, &mut search);
        let [alone] = second.finalists.as_slice() else { panic!("one was there") };
        assert_eq!(alone.names, ["stribeck-friction"]);
        let [best, other] = search.stages[0].finalists.as_slice() else { panic!("two were there") };
        assert_eq!((&best.names, verdict::last_name(other).as_str()), (&alone.names, "coulomb-friction"));
        let totals = [best, alone].map(|trial| trial.response.as_ref().expect("judged").training.total());
        assert_eq!(totals[0], totals[1]);
    }

    #[test]
    fn one_effect_is_laid_against_what_does_much_the_same_unless_it_leaves_noise_alone() {
        let mut truth = b1_g2();
        truth.effects.push(effect("bumper-stiffening", &[("kb3_n_m3", 3e7)]));
        let motion = Motion::of(&seen(&truth, 40), 500.0, Tolerances::default()).expect("a motion");
        let searcher = Searcher::new(&motion, &b1_g2(), Effort::default());
        let (base, measured) =
            (searcher.base(&b1_g2()).expect("fits"), searcher.measured.as_ref().expect("seen"));
        let hertz = effect("hertz-contact", &[("kh", 4e4), ("n", 1.05)]);
        let hertz = with(&searcher, &base, &[hertz], FURTHER_ON);
        let laid = searcher.twins(measured, std::slice::from_ref(&hertz), &base);
        let [twin] = laid.as_slice() else { panic!("{} for one contact", laid.len()) };
        assert_eq!(twin.names, ["bumper-stiffening"]);
        assert!(verdict::apart(twin, &hertz) > HOPELESS, "{}", verdict::apart(twin, &hertz));
        let right = with(&searcher, &base, &truth.effects, FURTHER_ON);
        let right = searcher.heard_by_itself(right);
        assert!(right.excess() < right.chance(), "{} {}", right.excess(), right.chance());
        assert!(searcher.twins(measured, &[right], &base).is_empty());
    }
}
