//! The part of the search that the simulated response decides: candidates are scored to first order, the best are fitted, and what
//! contains a simpler effect is tried without it. The search calls it wherever a base record drives a simulation.

use super::candidates;
use super::contest::{Contest, Entrant, FURTHER_ON, HOPELESS, best_first};
use super::parts;
use super::search::{Search, Searcher, Stage, UNSEEN};
use super::trial::{self, Response, Trial};
use super::verdict;
use crate::identify::least_squares::Settings;
use crate::identify::problem::Part;
use crate::identify::refit::Refit;
use crate::identify::response::{Measured, Score, Tangent, Until};
use crate::model;
use crate::model::effects::Effect;
use crate::model::{EffectSpec, ModelSpec, Scales};
use crate::parallel;

/// So many candidates that the response puts first are fitted by it.
const SCORED: usize = 4;
/// So many starts of an effect that has two numbers, of one that has more or whose two numbers make up for the model's own ones, and
/// of one that rings.
const FEW_STARTS: usize = 2;
const STARTS: usize = 3;
const OF_RINGING: usize = 5;
/// Times as many starts of an effect as are fitted are looked at again to first order.
const AGAIN: usize = 2;
/// Share of the best one's nats to first order below which another start of an effect is not fitted.
const ANOTHER: f64 = 0.3;
/// Nats to first order below which a candidate is not fitted, the first alone to be refused by name; and the share of the first
/// one's.
pub(super) const WORTH: f64 = 4.0;
const SHARE: f64 = 0.05;
/// Nats to first order that the most of so many starts may bring by chance: where no fit from there gains anything, none is looked for.
const CHANCE: f64 = 8.0;
/// Nats to first order below which nothing is fitted beside an effect of a long record: what is asked of a second effect.
const SECOND: f64 = 10.0;
/// Nats that an explanation brings at most for those to be fitted as well that first order put so many nats behind it at most: it knows
/// nothing of the held-out steps.
const FAINTLY: f64 = 30.0;
const NEAR: f64 = 6.0;
/// Nats by which a model has to do better when it is fitted again.
const BETTER: f64 = 2.0;
/// Nats that a simpler effect beside the one that contains it has to bring.
const MERGED: f64 = 20.0;
/// Rounds of a fit with another slow noise.
const HEARD_ANEW: usize = 6;
/// Deviations of its prior that a number of the model is from where it was given when it makes up for something; and the share of
/// its prior's width that it is then left.
pub(super) const ASTRAY: f64 = 5.0;
const HELD: f64 = 0.01;
/// Share of the largest displacement at which a knee beyond it is tried, if that is within so many deviations of its prior.
const JUST: f64 = 0.985;
const WIDELY: f64 = 3.0;
/// Profiles of an explanation; what the last one comes upon is left there.
const PROFILES: usize = 4;
/// Change of the response, in units of the noise, that is faint enough for first order; attempts to make a start as faint.
const FAINT: f64 = 0.3;
const FAINTER: usize = 3;

impl Searcher<'_> {
    /// A model fitted again from where the best finalist beside it has put its numbers, when that does better: what it falls by is
    /// no added effect's.
    pub(super) fn better_placed(&self, stage: &Stage, from: &Trial) -> Option<Trial> {
        let (measured, best) = (self.measured.as_ref()?, stage.finalists.first()?);
        if best.names.len() != from.names.len() + 1 || !best.names.starts_with(&from.names) {
            return None;
        }
        let training = &from.response.as_ref()?.training;
        let mut spec = best.refit.spec.clone();
        spec.effects.pop();
        let start = Trial { refit: Refit { spec, ..from.refit.clone() }, ..from.clone() };
        let settings = Settings { iterations: 20, ..Settings::default() };
        let until = Until::better_than(training);
        let (numbers, again) = trial::fit_response(measured, &start, None, settings, until)?;
        let better = training.total() - again.total() > 2.0 * BETTER;
        if better { trial::judge_response(measured, &start, numbers, again) } else { None }
    }

    /// Where a better model leaves another slow noise of the displacement sensor, everything found so far is fitted and judged with that:
    /// what the model before lacked had posed as noise. What the stage goes on from, so fitted.
    pub(super) fn heard_anew(&self, search: &mut Search, stage: &mut Stage, from: &Trial) -> Option<Trial> {
        let (measured, best) = (self.measured.as_ref()?, stage.finalists.first()?);
        let response = best.response.as_ref().filter(|_| verdict::apart(best, from) > 0.0)?;
        let laid = [(Part::Training, &response.training), (Part::HeldOut, &response.held_out)];
        if !measured.learn_slow_noise(&best.refit.spec, &best.refit.numbers, laid) {
            return None;
        }
        let best = best.clone();
        let again = |trial: &Trial| {
            // What is hopelessly behind is laid anew as it is.
            let iterations = if verdict::apart(&best, trial) > HOPELESS { 0 } else { HEARD_ANEW };
            let settings = Settings { iterations, ..Settings::default() };
            let laid = trial.response.as_ref().map(|response| &response.training);
            trial::respond(measured, trial, laid, settings).unwrap_or_else(|| trial.clone())
        };
        let all = |trials: &mut Vec<Trial>| *trials = parallel::map(trials, parallel::cores(), again);
        all(&mut stage.finalists);
        search.stages.iter_mut().for_each(|stage| all(&mut stage.finalists));
        search.base = again(&search.base);
        let from = search.best().clone();
        best_first(&mut stage.finalists, &from);
        Some(from)
    }

    /// A fitted model in which numbers of its own went far from what they were given to make up for what is missing, fitted again with
    /// those held where they were given: a missing effect may show only from there, and its fit then frees them.
    pub(super) fn brought_back(&self, from: &Trial) -> Option<Trial> {
        let measured = self.measured.as_ref().filter(|_| from.response.is_some())?;
        let (mut held, mut spec) = (from.refit.numbers.clone(), from.refit.spec.clone());
        held.start_from(&spec);
        let mut astray = false;
        for (number, free) in held.numbers.iter().zip(&mut held.free) {
            let (mean, sigma) = free.prior;
            if !number.key.starts_with("effect[") && (free.start - mean).abs() > ASTRAY * sigma {
                spec.set(&number.key, mean).ok()?;
                free.prior = (mean, HELD * sigma);
                astray = true;
            }
        }
        if !astray {
            return None;
        }
        let free_again = from.refit.numbers.clone();
        let start = Trial { refit: Refit { spec, numbers: held, ..from.refit.clone() }, ..from.clone() };
        let settings = Settings { iterations: 8, ..Settings::default() };
        let mut back = trial::respond(measured, &start, None, settings)?;
        back.refit.numbers = free_again;
        Some(back)
    }

    /// An explanation with the limits of its numbers by the profile of the likelihood; where that comes upon a better place, the fit goes
    /// on from there. A long record leaves so little between them that a valley does not bend.
    pub(super) fn bounded(&self, mut trial: Trial) -> Trial {
        let Some(measured) = self.measured.as_ref().filter(|measured| !measured.is_long()) else {
            return trial;
        };
        for round in 1..=PROFILES {
            let Some(Response { training, left, .. }) = &trial.response else { break };
            let Refit { spec, numbers, .. } = &trial.refit;
            let profile = measured.profile(spec, numbers, training, left[0].colour);
            let again = profile.better.filter(|_| round < PROFILES).and_then(|better| {
                let mut start = trial.clone();
                numbers.put(&better.values, &mut start.refit.spec);
                trial::respond(measured, &start, Some(&better), FURTHER_ON)
            });
            match again.filter(|again| verdict::likelier(again, &trial) > 0.0) {
                Some(again) => trial = again,
                None => {
                    trial.refit.limits = self.whatever_the_shape(measured, &trial, profile.limits);
                    break;
                }
            }
        }
        trial
    }

    /// An effect that contains the one before it (Stribeck's friction and Coulomb's) may do alone.
    pub(super) fn merge(&self, stage: &mut Stage, base: &Trial) {
        let Some(measured) = &self.measured else { return };
        let settings = Settings { iterations: 12, ..Settings::default() };
        for trial in &mut stage.finalists {
            let [simple, whole] = trial.names.as_slice() else { continue };
            if !candidates::contained_in(whole).contains(&simple.as_str()) {
                continue;
            }
            let alone = self.second_alone(base, trial);
            if let Some(alone) = trial::respond(measured, &alone, None, settings)
                && verdict::apart(trial, &alone) < MERGED
            {
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
        let settings = Settings { iterations: 12, ..Settings::default() };
        let second = trial::respond(measured, &self.second_alone(base, pair), None, settings);
        let Some(second) = second else { return };
        let spec = &second.refit.spec;
        let scales = candidates::scales(spec, self.motion);
        let mut effects = self.candidates(spec);
        effects.retain(|effect| effect.name != *one);
        // Without the first, much is left: the force sorts out.
        let settled = if second.is_far() { self.settled(&second) } else { None };
        let mut by_force = settled.map_or(Vec::new(), |settled| self.screen(&settled, &effects, &scales));
        by_force.truncate(SCORED);
        let before = pair.names.clone();
        let known = Some(&*pair);
        let others = self.by_response(measured, (&second, known), &by_force, &effects, &scales);
        stage.finalists.extend(others);
        best_first(&mut stage.finalists, base);
        let Some(best) = stage.finalists.first_mut() else { return };
        let alone = if best.names == before {
            Some(second)
        } else {
            trial::respond(measured, &self.second_alone(base, best), None, settings)
        };
        if let Some(alone) = alone.filter(|alone| verdict::apart(best, alone) < MERGED) {
            *best = alone;
        }
    }

    /// A pair without its first effect by the force along the measured motion, where that is no worse: play bends a line, too.
    fn second_by_force(&self, base: &Trial, pair: &Trial) -> Option<Trial> {
        let alone = self.fitted_by_force(&self.second_alone(base, pair))?;
        (verdict::apart(pair, &alone) < MERGED).then_some(alone)
    }

    /// A pair without its first effect, to be fitted.
    fn second_alone(&self, base: &Trial, pair: &Trial) -> Trial {
        let mut spec = pair.refit.spec.clone();
        spec.effects.remove(spec.effects.len() - 2);
        let mut numbers = base.refit.numbers.clone();
        let scales = candidates::scales(&base.refit.spec, self.motion);
        numbers.add_effect(&spec, spec.effects.len() - 1, &scales);
        let refit = Refit { spec, numbers, ..base.refit.clone() };
        Trial { names: vec![verdict::last_name(pair)], refit, ..base.clone() }
    }

    /// Fits candidates by the simulated response: those that the force puts first, and those that the response itself does to
    /// first order, from where each puts them; no farther where an explanation is known that is far ahead.
    pub(super) fn by_response(
        &self,
        measured: &Measured<'_>,
        (from, known): (&Trial, Option<&Trial>),
        by_force: &[(&'static str, Refit)],
        effects: &[&'static Effect],
        scales: &Scales,
    ) -> Vec<Trial> {
        let Some(response) = &from.response else { return Vec::new() };
        let (spec, laid, long) = (&from.refit.spec, &response.training, measured.is_long());
        let with = |start: &EffectSpec| candidates::beside(spec, start);
        let mut first: Vec<(f64, ModelSpec)> = Vec::new();
        if let Some(tangent) = measured.tangent(spec, &from.refit.numbers, laid) {
            let mut starts: Vec<EffectSpec> =
                effects.iter().flat_map(|effect| looked_at(effect, scales, long)).collect();
            if measured.is_forced() {
                starts.extend(effects.iter().flat_map(|e| candidates::starts_elsewhere(e, scales)));
            }
            let fainter = |start: &EffectSpec, factor: f64| candidates::fainter(start, factor, scales);
            let told = to_first_order(&tangent, &starts, with, fainter, |told| {
                first_of_each(told, |e| AGAIN * fitted_starts(e, long), |(start, _)| Some(start));
            });
            let moved = |(start, score): (EffectSpec, Score)| {
                let (scaled, scale) = candidates::scaled(&start, score.scale, scales)?;
                // The model's own numbers follow, where that leaves a model that there can be.
                let moved = from.refit.numbers.moved(with(&scaled), &score.followed, scale)?;
                let can_be = model::build(&moved, self.motion.dt_s()).is_ok();
                Some((score.nats, if can_be { moved } else { with(&scaled) }))
            };
            first = told.into_iter().filter_map(moved).collect();
            first.sort_by(|a, b| b.0.total_cmp(&a.0));
            first_of_each(&mut first, |effect| fitted_starts(effect, long), |(_, spec)| spec.effects.last());
        }
        parts::done("first order");
        // To first order is near enough where little is left; otherwise the force has a say.
        let best = first.first().map_or(0.0, |(nats, _)| *nats);
        let least = if long { SECOND } else { WORTH };
        if !from.names.is_empty() && best < least {
            return Vec::new();
        }
        let far = from.is_far();
        let worth = (SHARE * best).max(if far { 0.0 } else { WORTH });
        let by_force = if far { by_force } else { &[] };
        let mut effects: Vec<String> = Vec::new();
        let mut passed_over: Vec<ModelSpec> = Vec::new();
        first.retain(|(nats, spec)| {
            let name = spec.effects.last().map(|e| e.name.clone()).unwrap_or_default();
            let another = effects.contains(&name);
            // Beside an effect and yet far off, first order says little of those that a short fit tells of soon.
            let soon = far
                && !from.names.is_empty()
                && spec.effects.last().is_some_and(|effect| effect.parameters.len() == 1);
            let goes_on = effects.is_empty()
                || if another {
                    *nats > ANOTHER * best
                } else {
                    // What one that goes on contains may do as well with less.
                    let simpler =
                        effects.iter().any(|of| candidates::contained_in(of).contains(&name.as_str()));
                    soon || (effects.len() < SCORED || simpler) && *nats > worth
                };
            if goes_on && !another {
                effects.push(name);
            } else if !another && *nats > best - NEAR {
                passed_over.push(spec.clone());
            }
            goes_on
        });
        let mut starts: Vec<ModelSpec> = first.into_iter().map(|(_, spec)| spec).collect();
        starts.extend(by_force.iter().map(|(_, refit)| refit.spec.clone()));
        let mut contest = Contest::new(measured, from, scales, response.colour());
        if let Some(known) = known {
            contest = contest.against(known);
        }
        let (tried, others) = contest.in_short(&starts);
        let hopeful = tried.iter().any(Entrant::is_hopeful);
        parts::done("short fits");
        let mut finalists = contest.in_full(tried);
        parts::done("fits");
        // Nothing better need be looked for where the best brings nothing, of a long record or when no more was promised.
        let looked_for = !measured.is_long() && hopeful && (best > CHANCE || far);
        if !looked_for && finalists.first().is_none_or(|best| verdict::apart(best, from) <= 0.0) {
            return finalists;
        }
        let behind =
            |known: &Trial| finalists.first().is_none_or(|best| verdict::apart(known, best) > HOPELESS);
        if !hopeful && known.is_some_and(behind) {
            return finalists;
        }
        contest.other_summits(others, &mut finalists);
        parts::done("fits from other starts");
        if let Some(best) = finalists.first_mut() {
            self.go_on(measured, best);
        }
        finalists.extend(self.falling(measured, finalists.first(), scales));
        best_first(&mut finalists, from);
        finalists.extend(self.level(measured, finalists.first(), scales));
        finalists.extend(self.turning(measured, &finalists, scales));
        best_first(&mut finalists, from);
        self.shape(measured, &mut finalists, scales);
        best_first(&mut finalists, from);
        if let Some(best) = finalists.first_mut() {
            self.ringing(measured, best, scales);
        }
        let is_faint = |best: &Trial| (0.0..FAINTLY).contains(&verdict::apart(best, from));
        if from.names.is_empty() && finalists.first().is_some_and(is_faint) {
            first_of_each(&mut passed_over, |_| 1, |spec| spec.effects.last());
            finalists.extend(contest.in_full(contest.in_short(&passed_over).0));
            best_first(&mut finalists, from);
        }
        parts::done("shapes and summits");
        finalists
    }

    /// A way from far off takes longer; it may have begun in a wrong direction, from where numbers of the model's own made up for what
    /// is there now, or have left a knee beyond the motion.
    fn go_on(&self, measured: &Measured<'_>, best: &mut Trial) {
        let take = |arrived: Option<Trial>, best: &mut Trial| {
            if let Some(arrived) = arrived.filter(|arrived| verdict::apart(arrived, best) > 0.0) {
                *best = arrived;
            }
        };
        if let (true, Some(response)) = (best.is_far(), &best.response) {
            take(trial::respond(measured, best, Some(&response.training), FURTHER_ON), best);
        }
        if let Some(back) = self.brought_back(best) {
            take(trial::respond(measured, &back, None, FURTHER_ON), best);
        }
        for within in self.knees_within(best) {
            take(trial::respond(measured, &within, None, FURTHER_ON), best);
        }
    }

    /// A fitted model with a knee just within the motion that was left beyond it, where it has no slope to follow, although it may well
    /// lie within.
    fn knees_within(&self, best: &Trial) -> Vec<Trial> {
        let motion = self.motion;
        let fitted = motion.windows.iter().filter(|window| !window.held_out);
        let reach_m = fitted
            .flat_map(|window| &motion.displacement_m[window.range.clone()])
            .fold(0.0_f64, |reach, d| reach.max(d.abs()));
        let Refit { numbers, sigmas, .. } = &best.refit;
        let tried =
            numbers.numbers.iter().zip(&numbers.free).zip(sigmas).filter_map(|((number, free), sigma)| {
                let (mean, width) = free.prior;
                let within_m = JUST * reach_m;
                let knee = number.key.starts_with("isolator.breakpoints_m");
                let may = knee && *sigma > UNSEEN * width && (mean - within_m).abs() < WIDELY * width;
                let mut start = best.clone();
                (may && start.refit.spec.set(&number.key, within_m).is_ok()).then_some(start)
            });
        tried.collect()
    }

    /// One effect alone on top of a fitted model, a fit of it by force at hand.
    pub(super) fn with_effect(
        &self,
        from: &Trial,
        effect: &'static Effect,
        by_force: Refit,
    ) -> Option<Trial> {
        let (measured, scales) = (self.measured.as_ref()?, candidates::scales(&from.refit.spec, self.motion));
        let fitted = self.by_response(measured, (from, None), &[(effect.name, by_force)], &[effect], &scales);
        fitted.into_iter().find(|trial| verdict::last_name(trial) == effect.name)
    }
}

/// What starts of effects bring to first order: all of them, best first, then those that are kept again, with everything else moved as the
/// first look has it follow, where that leaves less of a change.
pub(super) fn to_first_order(
    tangent: &Tangent<'_, '_>,
    starts: &[EffectSpec],
    with: impl Fn(&EffectSpec) -> ModelSpec + Sync,
    fainter: impl Fn(&EffectSpec, f64) -> Option<EffectSpec> + Sync,
    keep: impl FnOnce(&mut Vec<(EffectSpec, Score)>),
) -> Vec<(EffectSpec, Score)> {
    let told =
        parallel::map(starts, parallel::cores(), |start| faint_enough(tangent, start, &with, &fainter));
    let mut told: Vec<(EffectSpec, Score)> = told.into_iter().flatten().collect();
    told.sort_by(|a, b| b.1.nats.total_cmp(&a.1.nats));
    keep(&mut told);
    parallel::map(&told, parallel::cores(), |(start, score)| {
        let again = tangent.score_again(&with(start), score).filter(|again| again.change < score.change);
        (start.clone(), again.unwrap_or_else(|| score.clone()))
    })
}

/// What a start brings, made fainter where it is too much for first order and may be.
fn faint_enough(
    tangent: &Tangent<'_, '_>,
    start: &EffectSpec,
    with: impl Fn(&EffectSpec) -> ModelSpec,
    fainter: impl Fn(&EffectSpec, f64) -> Option<EffectSpec>,
) -> Option<(EffectSpec, Score)> {
    let mut start = start.clone();
    let mut change = tangent.change(&with(&start))?;
    for _ in 0..FAINTER {
        if change < FAINT {
            break;
        }
        let Some(weaker) = fainter(&start, 0.5 * FAINT / change) else { break };
        match tangent.change(&with(&weaker)) {
            Some(of) if of < 0.7 * change => (start, change) = (weaker, of),
            _ => break,
        }
    }
    let score = tangent.score(&with(&start))?;
    Some((start, score))
}

/// Starts of an effect that are scored to first order: of a long record every other frequency of a ringing, whose fits bridge the rest.
fn looked_at(effect: &Effect, scales: &Scales, long: bool) -> Vec<EffectSpec> {
    let mut starts = candidates::starts(effect, scales);
    if long && effect.name == "stand-compliance" {
        starts.truncate(starts.len().div_ceil(2));
    }
    starts
}

/// Starts of an effect that are fitted: where there are several numbers, or the frequency of a ringing, the likelihood has several
/// summits, or long valleys. A long record takes a springpot, whose many states are slow to follow, from fewer.
fn fitted_starts(effect: &EffectSpec, long: bool) -> usize {
    match effect.parameters.len() {
        _ if effect.name == "stand-compliance" => OF_RINGING,
        0 | 1 => 1,
        2 if long || effect.name != "fractional-damping" => FEW_STARTS,
        _ => STARTS,
    }
}

/// Keeps the first so many of each effect; what is left over.
pub(super) fn first_of_each<T>(
    sorted: &mut Vec<T>,
    most: impl Fn(&EffectSpec) -> usize,
    effect: impl Fn(&T) -> Option<&EffectSpec>,
) -> Vec<T> {
    let mut seen: Vec<String> = Vec::new();
    let (kept, left) = std::mem::take(sorted).into_iter().partition(|item| {
        let Some(last) = effect(item) else { return false };
        let before = seen.iter().filter(|name| **name == last.name).count();
        seen.push(last.name.clone());
        before < most(last)
    });
    *sorted = kept;
    left
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::search::Effort;
    use crate::diagnose::testing::{seen, with};
    use crate::identify::kinematics::Tolerances;
    use crate::identify::motion::Motion;
    use crate::model::testing::{b1_g2, effect};

    #[test]
    fn a_better_place_of_a_model_is_taken_whatever_its_freedom_is_worth_there() {
        let mut truth = b1_g2();
        truth.effects.push(effect("maxwell-branch", &[("km_n_m", 1500.0), ("tau_s", 0.08)]));
        let motion = Motion::of(&seen(&truth, 38), 500.0, Tolerances::default()).expect("a motion");
        let searcher = Searcher::new(&motion, &b1_g2(), Effort::default());
        let base = searcher.base(&b1_g2()).expect("fits");
        let start = effect("maxwell-branch", &[("km_n_m", 500.0), ("tau_s", 0.03)]);
        let mut short = with(&searcher, &base, &[start], Settings { iterations: 1, ..Settings::default() });
        let response = short.response.as_mut().expect("judged");
        response.freedom_nats -= 1e6;
        let before = response.training.total();
        let bounded = searcher.bounded(short);
        assert!(bounded.response.is_some_and(|after| after.training.total() < before - 100.0));
        let told = bounded.refit.spec.effects[0].parameters["tau_s"];
        assert!((told / 0.08 - 1.0).abs() < 0.05, "{told}");
        assert_eq!(bounded.refit.limits.len(), bounded.refit.numbers.numbers.len());
    }
}
