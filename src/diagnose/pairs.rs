//! What is asked of two effects that were found one after the other: whether the second does without the first, beside which other first
//! it does better, and whether what does much the same as either does.

use super::candidates;
use super::contest::{FURTHER_ON, HALF, best_first};
use super::search::{Search, Searcher, Stage};
use super::summits::in_short;
use super::thresholds::Thresholds;
use super::trial::{self, Trial};
use super::verdict::{self, Decision, Refused};
use crate::identify::least_squares::Settings;
use crate::identify::refit::{Domain, Refit};
use crate::identify::response::Measured;
use crate::model::EffectSpec;
use crate::model::effects::maxwell_branch;
use crate::parallel;
use crate::record::Kind;

/// Nats that a simpler effect beside the one that contains it has to bring.
const MERGED: f64 = 20.0;
/// How what does much the same is fitted in short along an imposed motion, and how many are in full.
const IN_SHORT: Settings = Settings { iterations: 8, tolerance: 1e-5, difference: 1e-3 };
const IN_FULL: usize = 3;
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

    /// What was decided of a component with its explanation exchanged where another does better, and as lean as it can be.
    pub(super) fn reconsidered(&self, decision: Decision, base: &Trial, thresholds: Thresholds) -> Decision {
        let before = decision.chosen.names.clone();
        let decision = self.leaner(self.exchanged(decision, base, thresholds), base, thresholds);
        if decision.chosen.names == before {
            return decision;
        }
        verdict::judged_anew(decision, base, self, thresholds)
    }

    /// What was decided of a component without the effects that the rest does as well without, and with Coulomb's friction for a Stribeck's
    /// that does no better: what an effect was found for, a later one may have taken over.
    fn leaner(&self, mut decision: Decision, base: &Trial, thresholds: Thresholds) -> Decision {
        while self.motion.kind == Kind::Component
            && let Some((which, lean, ahead)) = self.leaner_by_one(&decision.chosen, base, thresholds)
        {
            let name = decision.chosen.names[which].clone();
            if lean.names.len() < decision.chosen.names.len() && which < decision.probabilities.len() {
                decision.probabilities.remove(which);
            }
            let reason = format!("as well explained without it: {:.1} nats apart", ahead.max(0.0));
            decision.refused.push(Refused { name, reason });
            decision.chosen = lean;
        }
        decision
    }

    /// A decision on a component that leaves more than noise with what does much the same in the place of one of its effects, a second
    /// relaxation beside the first for a springpot, where that explains more: each was found beside what was still missing.
    fn exchanged(&self, mut decision: Decision, base: &Trial, thresholds: Thresholds) -> Decision {
        for _ in 0..decision.chosen.names.len() {
            let chosen = &decision.chosen;
            if self.motion.kind != Kind::Component || verdict::leaves_noise(self, chosen, thresholds) {
                break;
            }
            let starts: Vec<Trial> =
                (0..chosen.names.len()).flat_map(|which| self.others(chosen, which, base)).collect();
            let short = |start: &Trial| {
                let refit = trial::polish(&self.screening, &start.refit, Domain::Force, IN_SHORT)?;
                Some(Trial { refit, ..start.clone() })
            };
            let mut ended: Vec<Trial> =
                parallel::map(&starts, parallel::cores(), short).into_iter().flatten().collect();
            ended.sort_by(|a, b| trial::objective(&a.refit).total_cmp(&trial::objective(&b.refit)));
            ended.truncate(IN_FULL);
            let better = self.likeliest_by_force(&ended);
            let Some(better) = better.filter(|better| verdict::apart(better, chosen) > thresholds.tie) else {
                break;
            };
            let gone: Vec<_> =
                chosen.names.iter().filter(|name| !better.names.contains(name)).cloned().collect();
            let reason = format!(
                "explains less than what does much the same: {:.1} nats apart",
                verdict::apart(&better, chosen)
            );
            decision.refused.extend(gone.into_iter().map(|name| Refused { name, reason: reason.clone() }));
            decision.ambiguous_with.clear();
            decision.probabilities = vec![verdict::EXPERIENCE; better.names.len()];
            decision.chosen = better;
        }
        decision
    }

    /// Starts of what does much the same as one of the effects of an explanation, in its place.
    fn others(&self, trial: &Trial, which: usize, base: &Trial) -> Vec<Trial> {
        let Some(twin) = candidates::twin(&trial.names[which]) else { return Vec::new() };
        let starts = self.starts_beside(&self.without_one(trial, which, base), twin, base);
        if twin != maxwell_branch::EFFECT.name {
            return starts;
        }
        // The faster of two relaxations is in the place of the springpot's fast end.
        let time_s = |trial: &Trial| {
            trial.refit.spec.effects.last().and_then(|of| of.parameters.get("tau_s").copied())
        };
        let twice = |slow: &Trial| {
            let faster = self.starts_beside(slow, twin, base);
            faster.into_iter().filter(|fast| time_s(fast) < time_s(slow)).collect::<Vec<_>>()
        };
        starts.iter().flat_map(twice).chain(starts.clone()).collect()
    }

    /// The effect that is missed least, the explanation without it or with the simpler one in its place, and how far that is behind, nats;
    /// nothing where all are missed.
    fn leaner_by_one(
        &self,
        trial: &Trial,
        base: &Trial,
        thresholds: Thresholds,
    ) -> Option<(usize, Trial, f64)> {
        let several = trial.names.len() > 1;
        let without = |which| several.then(|| (which, self.without_one(trial, which, base), MERGED));
        let plain =
            |which| Some((which, self.with_plain_friction(trial, which, base)?, 0.5 * thresholds.tie));
        let tried: Vec<(usize, Trial, f64)> =
            (0..trial.names.len()).flat_map(|which| [without(which), plain(which)]).flatten().collect();
        let fitted = parallel::map(&tried, parallel::cores(), |(which, lean, enough)| {
            let lean = self.fitted_by_force(lean)?;
            let ahead = verdict::apart(trial, &lean);
            (ahead < *enough).then_some((*which, lean, ahead))
        });
        fitted.into_iter().flatten().min_by(|a, b| a.2.total_cmp(&b.2))
    }

    /// An explanation with Coulomb's friction in the place of its Stribeck's, to be fitted.
    fn with_plain_friction(&self, trial: &Trial, which: usize, base: &Trial) -> Option<Trial> {
        let known = trial.refit.spec.effects.len() - trial.names.len();
        let friction =
            trial.refit.spec.effects.get(known + which).filter(|of| of.name == "stribeck-friction")?;
        let constant = ("fc_n".to_owned(), *friction.parameters.get("fc_n")?);
        let mut plain = trial.clone();
        plain.names[which] = "coulomb-friction".to_owned();
        plain.refit.spec.effects[known + which] = EffectSpec {
            name: "coulomb-friction".into(),
            expression: None,
            parameters: [constant].into_iter().collect(),
        };
        self.number_anew(&mut plain, known, base);
        Some(plain)
    }

    /// Numbers of a model whose effects from one on are not those that it was fitted with.
    fn number_anew(&self, trial: &mut Trial, from: usize, base: &Trial) {
        let Refit { spec, numbers, .. } = &mut trial.refit;
        let scales = candidates::scales(&base.refit.spec, self.motion);
        numbers.clone_from(&base.refit.numbers);
        (from..spec.effects.len()).for_each(|index| numbers.add_effect(spec, index, &scales));
    }

    /// An explanation without one of its effects, to be fitted; the model's own numbers start where it has put them.
    fn without_one(&self, trial: &Trial, which: usize, base: &Trial) -> Trial {
        let mut without = trial.clone();
        let known = without.refit.spec.effects.len() - without.names.len();
        without.names.remove(which);
        without.refit.spec.effects.remove(known + which);
        self.number_anew(&mut without, known, base);
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
        let effect = self.candidates_beside(model).into_iter().find(|effect| effect.name == name);
        let scales = candidates::scales(&base.refit.spec, self.motion);
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
        let mut search = Search { base: base.clone(), stages: vec![first], law: None, otherwise: None };
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
