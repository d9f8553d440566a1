//! The part of the search that the simulated response decides: candidates are scored to first order, and the best are fitted. The search
//! calls it wherever a base record drives a simulation.

use super::candidates;
use super::contest::{Contest, Entrant, HOPELESS, best_first};
use super::parts;
use super::search::Searcher;
use super::thresholds::Thresholds;
use super::trial::Trial;
use super::verdict;
use crate::identify::refit::Refit;
use crate::identify::response::{Measured, Score, Tangent};
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
/// Of a long record the best alone is fitted then, to be refused by name.
const CHANCE: f64 = 8.0;
/// Nats to first order below which nothing is fitted beside an effect of a long record: what is asked of a second effect.
const SECOND: f64 = 10.0;
/// Nats that an explanation brings at most for those to be fitted as well that first order put so many nats behind it at most: it knows
/// nothing of the held-out steps.
const FAINTLY: f64 = 30.0;
const NEAR: f64 = 6.0;
/// Change of the response, in units of the noise, that is faint enough for first order; attempts to make a start as faint.
const FAINT: f64 = 0.3;
const FAINTER: usize = 3;
/// The same at a second look: where the model's own numbers make up for nearly all of a change, as a bumper's damping does for one that
/// grows with penetration, the bend of what they make up for is more than what is left.
const FAINTEST: f64 = 0.003;

impl Searcher<'_> {
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
        if let Some((nats, name)) =
            first.first().and_then(|(nats, with)| Some((nats, &with.effects.last()?.name)))
        {
            let beside =
                if from.names.is_empty() { String::new() } else { format!(" beside {}", from.said()) };
            parts::so_far(&format!("at a first look {name} brings most{beside}, {nats:.0} nats"));
        }
        // To first order is near enough where little is left; otherwise the force has a say.
        let best = first.first().map_or(0.0, |(nats, _)| *nats);
        let least = if long { SECOND } else { WORTH };
        if !from.names.is_empty() && best < least {
            return Vec::new();
        }
        let far = from.is_far();
        let worth = (SHARE * best).max(if far { 0.0 } else { WORTH });
        let by_chance = long && !far && best <= CHANCE;
        let scored = if by_chance { 1 } else { SCORED };
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
                    soon || (effects.len() < scored || simpler) && *nats > worth
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
        let enough = |best: &Trial| if by_chance { Thresholds::default().asked(best, from)[1] } else { 0.0 };
        if !looked_for && finalists.first().is_none_or(|best| verdict::apart(best, from) <= enough(best)) {
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
}

/// What starts of effects bring to first order: all of them, best first, then those that are kept again, with everything else moved as the
/// first look has it follow, and much fainter, where that tells of more. What is beyond first order can only hide what a start brings.
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
    let moved = |start: EffectSpec, score: Score| {
        let again = tangent.score_again(&with(&start), &score);
        let again = again.filter(|again| again.change < score.change || again.nats > score.nats);
        (start, again.unwrap_or(score))
    };
    parallel::map(&told, parallel::cores(), |(start, score)| {
        let faintest = Some(FAINTEST / score.change)
            .filter(|by| *by < 1.0)
            .and_then(|by| fainter(start, by))
            .and_then(|start| Some(moved(start.clone(), tangent.score(&with(&start))?)));
        let faint = moved(start.clone(), score.clone());
        faintest.filter(|(_, score)| score.nats > faint.1.nats).unwrap_or(faint)
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
