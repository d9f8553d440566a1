//! The search for what is missing: base re-fitted, candidates one by one, then in combination.

use super::anew::{reached, tells_otherwise};
use super::candidates;
use super::contest::{HOPELESS, best_first};
use super::parts;
use super::thresholds::Thresholds;
use super::trial::{self, Trial};
use super::verdict;
use crate::identify::least_squares::Settings;
use crate::identify::motion::Motion;
use crate::identify::problem::{NARROW, Part, Problem, WIDE};
use crate::identify::refit::{Domain, Refit};
use crate::identify::response::Measured;
use crate::model::effects::{Effect, maxwell_branch};
use crate::model::{EffectSpec, ModelSpec, Scales};
use crate::record::Kind;

/// Settings of a search.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Thinned samples for screening.
    pub screening_samples: usize,
    /// Thinned samples for the fits of those that passed.
    pub fitting_samples: usize,
    /// Samples used in the output domain.
    pub output_samples: usize,
    /// How many candidates are fitted in full.
    pub finalists: usize,
    /// At most so many effects together.
    pub together: usize,
}

impl Default for Effort {
    fn default() -> Self {
        Self {
            screening_samples: 20_000,
            fitting_samples: 200_000,
            output_samples: 60_000,
            finalists: 5,
            together: 3,
        }
    }
}

/// A candidate that leaves more of the excess than the best one, by this share, is not fitted in full.
const NEAR: f64 = 0.25;
/// What a model leaves of the force on the thinned record over what noise makes, at least, for shares of its excess to be told.
const NO_EXCESS: f64 = 1.001;
/// Nats that a candidate brings on the thinned record before it is fitted in full.
const PROMISING: f64 = 3.0;
/// Share of its prior's width that is left to a number that the motion does not reach.
pub(super) const UNSEEN: f64 = 0.9;

/// Dry frictions, of which one contains the other.
const FRICTIONS: [&str; 2] = ["coulomb-friction", "stribeck-friction"];

/// What a search found at one stage: the best so far plus one more effect.
#[derive(Clone, Debug, Default)]
pub struct Stage {
    /// Fully fitted candidates, best held-out score first.
    pub finalists: Vec<Trial>,
    /// Names of those that did not pass the screening, with the share of the excess they left, where there is one.
    pub screened: Vec<(String, Option<f64>)>,
    /// What the force sorted out, best first; nothing where it was not asked.
    pub(super) by_force: Vec<(&'static str, Refit)>,
}

/// A finished search.
#[derive(Clone, Debug)]
pub struct Search {
    /// The base model re-fitted.
    pub base: Trial,
    /// Stages, one effect more each.
    pub stages: Vec<Stage>,
    /// The base model with a law beside it that the catalogue lacks, where that was tried; where a response is simulated, with a shape, if one
    /// leaves nothing of the record.
    pub(super) law: Option<Trial>,
    /// What the first stage said the motion should be taken as in its place; the search ended with that.
    pub(super) otherwise: Option<Otherwise>,
}

/// A motion that is to be searched in another's place.
#[derive(Clone, Debug)]
pub(super) struct Otherwise {
    pub(super) motion: Motion,
    /// What is to be said of that.
    pub(super) said: Vec<String>,
    /// It is the same, seen with less noise.
    pub(super) quieter: bool,
}

/// Everything a search needs to know.
pub struct Searcher<'a> {
    pub(super) motion: &'a Motion,
    pub(super) effort: Effort,
    pub(super) screening: Problem<'a>,
    pub(super) fitting: Problem<'a>,
    /// The nominal model fitted by force.
    pub(super) fitted: Option<Refit>,
    pub(super) stride: usize,
    /// Effects that are not tried.
    without: Vec<&'static str>,
    /// The one effect that is tried, and no other beside it.
    only: Option<&'static Effect>,
    /// The response to lay models against, where there is one.
    pub(super) measured: Option<Measured<'a>>,
}

impl<'a> Searcher<'a> {
    /// Prepares the problems; the weights of the samples come from the re-fitted nominal model, since a gap that is
    /// merely off puts them beside the contacts.
    pub fn new(motion: &'a Motion, nominal: &ModelSpec, effort: Effort) -> Self {
        let total: usize = motion.windows.iter().map(|w| w.range.len()).sum();
        let measured = Measured::new(motion);
        let enough = effort.screening_samples / if measured.is_some() { 2 } else { 1 };
        let mut screening = Problem::of_some(motion, nominal, enough);
        let mut fitting = Problem::new(motion, nominal, effort.fitting_samples);
        let mut fitted: Option<Refit> = None;
        // A component on its own has no contact to be beside of, and its given model may promise next to nothing.
        if motion.kind != Kind::Component {
            for around in [WIDE, NARROW, NARROW] {
                if let Some(base) = trial::base_by_force(&screening, nominal, fitted.as_ref()) {
                    let base = reached(&screening, nominal, base);
                    screening.weigh(&base.spec, base.zero_m, around);
                    fitted = Some(base);
                }
            }
            if let Some(base) = &fitted {
                fitting.weigh(&base.spec, base.zero_m, NARROW);
            }
            if let Some(base) = trial::base_by_force(&fitting, nominal, fitted.as_ref()) {
                screening.weigh(&base.spec, base.zero_m, NARROW);
                fitting.weigh(&base.spec, base.zero_m, NARROW);
                fitted = Some(base);
            }
        }
        let stride = total.div_ceil(effort.output_samples.max(1)).max(1);
        Self { motion, effort, screening, fitting, fitted, stride, without: Vec::new(), only: None, measured }
    }

    /// The same with effects left untried that cannot be there.
    pub fn without(self, names: &[&'static str]) -> Self {
        Self { without: names.to_vec(), ..self }
    }

    /// The same with one effect alone.
    pub fn only(self, effect: &'static Effect) -> Self {
        Self { effort: Effort { together: 1, ..self.effort }, only: Some(effect), ..self }
    }

    /// Effects that are tried on top of a model.
    pub(super) fn candidates(&self, spec: &ModelSpec) -> Vec<&'static Effect> {
        if let Some(effect) = self.only {
            return vec![effect];
        }
        let mut effects = candidates::physical(spec);
        effects.retain(|effect| !self.without.contains(&effect.name));
        effects
    }

    /// The same on top of an explanation. Along an imposed motion two dry frictions are one, and a relaxation may have
    /// two times.
    pub(super) fn candidates_beside(&self, from: &Trial) -> Vec<&'static Effect> {
        let mut effects = self.candidates(&from.refit.spec);
        if self.motion.kind == Kind::Component {
            let rubs = |name: &str| FRICTIONS.contains(&name);
            if from.names.iter().any(|name| rubs(name)) {
                effects.retain(|effect| !rubs(effect.name));
            }
            let relaxes = |name: &&String| **name == maxwell_branch::EFFECT.name;
            if from.names.iter().filter(relaxes).count() == 1 && self.only.is_none() {
                effects.push(&maxwell_branch::EFFECT);
            }
        }
        effects
    }

    /// Where the fits of an effect begin.
    pub(super) fn starts(&self, effect: &Effect, scales: &Scales) -> Vec<EffectSpec> {
        let starts = if self.measured.is_some() { candidates::starts } else { candidates::starts_by_force };
        starts(effect, scales)
    }

    /// The problem with the finer thinning.
    pub fn problem(&self) -> &Problem<'a> {
        &self.fitting
    }

    /// Re-fits the base model.
    pub fn base(&self, nominal: &ModelSpec) -> Option<Trial> {
        let refit = trial::base_by_force(&self.fitting, nominal, self.fitted.as_ref())?;
        let base = self.finish(&trial::judge_by_force(&self.fitting, &[], refit)?)?;
        // With its jumps and the slow noise known, once more.
        let again = self.measured.as_ref().filter(|_| base.response.is_some()).and_then(|measured| {
            let settings = Settings { iterations: 6, ..Settings::default() };
            if tells_otherwise(measured, &base) {
                trial::respond(measured, &base, None, settings)
            } else {
                None
            }
        });
        Some(again.unwrap_or(base))
    }

    /// Refines what was fitted by force, and judges it: by the response where there is one.
    pub fn finish(&self, by_force: &Trial) -> Option<Trial> {
        let settings = Settings { iterations: 20, ..Settings::default() };
        let responded = self.measured.as_ref().and_then(|m| trial::respond(m, by_force, None, settings));
        responded.or_else(|| trial::finish(&self.fitting, by_force, self.stride))
    }

    /// What every candidate adds to the fitted base model on the thinned training steps, best first: nats, coloured
    /// residuals considered, less half the logarithm of the independent samples for each parameter (Schwarz 1978).
    pub fn evidence(&self, nominal: &ModelSpec) -> Option<Vec<(&'static str, f64)>> {
        let base = trial::base_by_force(&self.screening, nominal, self.fitted.as_ref())?;
        let scales = candidates::scales(&base.spec, self.motion);
        let effects = self.candidates(&base.spec);
        let count = self.screening.weighted_count(Part::Training);
        let nats = |refit: &Refit| {
            let added = refit.fit.values.len() as f64 - base.fit.values.len() as f64;
            let fall = trial::objective(&base) - trial::objective(refit);
            trial::schwarz_nats(fall, added, count, base.inflation)
        };
        let best = self.screen(&base, &effects, &scales);
        let mut found: Vec<_> = best.iter().map(|(name, refit)| (*name, nats(refit))).collect();
        found.sort_by(|a, b| b.1.total_cmp(&a.1));
        Some(found)
    }

    /// Tries every candidate on top of a fitted model.
    pub fn stage(&self, from: &Trial) -> Stage {
        self.stage_again(from, Vec::new())
    }

    /// The same where the force has sorted out before: its fits do not depend on where the model's own numbers start.
    fn stage_again(&self, from: &Trial, known: Vec<(&'static str, Refit)>) -> Stage {
        let scales = candidates::scales(&from.refit.spec, self.motion);
        let effects = self.candidates_beside(from);
        let Some(base) = self.settled(from) else {
            return Stage { finalists: Vec::new(), screened: Vec::new(), by_force: known };
        };
        let near = from.response.is_some() && !from.is_far();
        let mut best = match (near, known.is_empty()) {
            (true, _) => Vec::new(),
            (false, true) => self.screen(&base, &effects, &scales),
            (false, false) => known,
        };
        parts::done("candidates by force");
        let by_force = best.clone();
        let reference = trial::objective(&base).max(1e-300);
        let floor = (self.screening.weighted_count(Part::Training) as f64).min(reference);
        let share = |objective: f64| (objective - floor) / (reference - floor).max(1e-9 * reference);
        // The best goes on, and who comes near it. A second always does where the best brings
        // anything, to be refused by name.
        let near = best.first().map_or(0.0, |(_, refit)| share(trial::objective(refit))) + NEAR;
        let brings = |refit: &Refit| reference - trial::objective(refit) > 2.0 * PROMISING;
        let pass = best
            .iter()
            .take(self.effort.finalists)
            .enumerate()
            .take_while(|(i, (_, refit))| {
                *i == 0 || brings(refit) && (*i == 1 || share(trial::objective(refit)) < near)
            })
            .count();
        let told = |refit: &Refit| (reference > NO_EXCESS * floor).then(|| share(trial::objective(refit)));
        let screened: Vec<(String, Option<f64>)> =
            best.iter().skip(pass).map(|(name, refit)| ((*name).to_owned(), told(refit))).collect();
        let finalists = match (&self.measured, &from.response) {
            (Some(measured), Some(_)) => {
                best.truncate(pass.max(2));
                self.by_response(measured, (from, None), &best, &effects, &scales)
            }
            _ => {
                best.truncate(pass);
                self.finalists(from, &best)
            }
        };
        let screened =
            screened.into_iter().filter(|(name, _)| finalists.iter().all(|t| verdict::last_name(t) != *name));
        let screened = screened.collect();
        Stage { finalists, screened, by_force }
    }

    /// A fitted model, settled where the force on the thinned record has it.
    pub(super) fn settled(&self, trial: &Trial) -> Option<Refit> {
        let settled = Settings { iterations: 4, ..Settings::default() };
        trial::polish(&self.screening, &trial.refit, Domain::Force, settled)
    }

    /// Adds effects one at a time for as long as a good part of the excess is left and falls.
    pub fn search(&self, base: Trial, thresholds: Thresholds) -> Search {
        self.search_from((base, Vec::new()), thresholds, |_| None)
    }

    /// The same where first stages may have been tried, and ended where what explains most after one says that the motion should be
    /// taken otherwise: the rest of the search would be done again.
    pub(super) fn search_from(
        &self,
        (base, tried): (Trial, Vec<Stage>),
        thresholds: Thresholds,
        otherwise: impl Fn(&Trial) -> Option<Otherwise>,
    ) -> Search {
        // A component's force is compared along an imposed motion: nothing but its gain ends the search.
        let component = self.motion.kind == Kind::Component;
        let enough = if component { 0.0 } else { 0.5 * thresholds.left };
        let mut search = Search { base, stages: Vec::new(), law: None, otherwise: None };
        let mut tried = tried.into_iter();
        // Stages that brought something.
        let mut told = 0;
        // Beyond a pair the response explains anything.
        let together =
            if search.base.response.is_some() { self.effort.together.min(2) } else { self.effort.together };
        for depth in 0..together {
            let mut from = search.best().clone();
            if from.names.len() >= together {
                break;
            }
            if depth > 0
                && from.response.is_none()
                && (from.share_left(&search.base) < enough || from.excess() < thresholds.excess)
            {
                break;
            }
            // What such a record leaves to find there is fainter than what is made of it between its samples.
            if depth > 0 && verdict::leaves_noise(self, &from, thresholds) {
                break;
            }
            let mut stage = tried.next().unwrap_or_else(|| self.stage(&from));
            // Of a second stage only where it brings anything: what it goes on from may have stopped short.
            let asked = depth == 0 || stage.finalists.iter().any(|t| verdict::brings(t, &from, thresholds));
            if let Some(better) = if asked { self.better_placed(&stage, &from) } else { None } {
                // What leaves nothing, far ahead of that, stays what it is.
                let stays = |best: &Trial| !best.leaves_much() && verdict::apart(best, &better) > HOPELESS;
                if !stage.finalists.first().is_some_and(stays) {
                    stage = self.stage_again(&better, stage.by_force);
                }
                search.replace(&better);
                from = better;
            }
            parts::done("base model again");
            from = self.heard_anew(&mut search, &mut stage, &from).unwrap_or(from);
            parts::done("all again with what was told anew");
            let brings =
                |stage: &Stage| stage.finalists.iter().any(|trial| verdict::brings(trial, &from, thresholds));
            if depth == 0 && self.measured.as_ref().is_none_or(|measured| !measured.is_long()) {
                let best = stage.finalists.first().filter(|best| verdict::brings(best, &from, thresholds));
                search.otherwise = otherwise(best.unwrap_or(&from));
                if search.otherwise.is_some() {
                    search.stages.push(stage);
                    break;
                }
            }
            // Where the best leaves much, or nothing brings anything.
            if (stage.finalists.first().is_none_or(Trial::leaves_much) || depth == 0 && !brings(&stage))
                && let Some(back) = self.brought_back(&from)
            {
                stage.finalists.extend(self.stage_again(&back, stage.by_force.clone()).finalists);
                best_first(&mut stage.finalists, &from);
            }
            // A pair may also grow from the second best: greedy search alone can start wrong. Where the response decides, the first of
            // a pair is exchanged below; unless nothing brings anything beside the best, although it is far off.
            let enough_said =
                |best: &Trial| best.share_left(&search.base) < enough || best.excess() < thresholds.excess;
            let greedy = if from.response.is_some() {
                from.is_far() && !stage.finalists.iter().any(|t| verdict::brings(t, &from, thresholds))
            } else {
                !stage.finalists.first().is_some_and(enough_said)
            };
            let second = search.stages.first().and_then(|s| s.finalists.get(1));
            if let (1, true, Some(second)) = (depth, greedy, second) {
                stage.finalists.extend(self.stage(second).finalists);
                best_first(&mut stage.finalists, &search.base);
            }
            self.merge(&mut stage, &mut search);
            let mut gained = brings(&stage);
            // What a law explains, or a shape, needs no second effect.
            let mut lawful = false;
            if depth == 0 && component {
                lawful = self.is_lawful(&mut search, &stage, thresholds);
            } else if depth == 0 {
                search.law = self.shaped_alone(&search.base, &stage, thresholds);
                lawful = search.law.is_some();
            }
            // What two bring together neither may bring alone: play where the force has an offset.
            if component
                && !(gained || lawful)
                && from.names.len() + 2 <= together
                && let Some(best) = stage.finalists.first()
            {
                stage.finalists.extend(self.stage(best).finalists);
                best_first(&mut stage.finalists, &from);
                gained = brings(&stage);
            }
            if gained && !lawful {
                self.exchange_first(&mut stage, &search.base);
                if let Some(measured) = &self.measured {
                    stage.finalists.extend(self.twins(measured, &stage.finalists, &search.base));
                    best_first(&mut stage.finalists, &search.base);
                }
            }
            parts::done("other first effects");
            if gained && !lawful {
                self.told_by_all_steps(&mut stage.finalists, &from);
            }
            parts::done("rivals by all steps");
            search.stages.push(stage);
            parts::so_far(&search.said());
            if !gained {
                break;
            }
            told = search.stages.len();
            if lawful {
                break;
            }
        }
        if let Some(last) = search.stages[..told].last_mut() {
            self.let_go(last);
        }
        search
    }
}

impl Search {
    /// Takes a better fit of the same effects in place of the one there is.
    fn replace(&mut self, better: &Trial) {
        if better.names.is_empty() {
            self.base = better.clone();
        }
        let finalists = self.stages.iter_mut().flat_map(|stage| &mut stage.finalists);
        finalists.filter(|trial| trial.names == better.names).for_each(|trial| *trial = better.clone());
    }

    /// What explains most so far, in words.
    fn said(&self) -> String {
        let best = self.best();
        let explained = 100.0 * (1.0 - best.share_left(&self.base)).clamp(0.0, 1.0);
        if best.names.is_empty() {
            "no known effect brings anything so far".to_owned()
        } else {
            format!("{} explains {explained:.1} % of what the re-identified model leaves", best.said())
        }
    }

    /// The best trial of all stages, the base when there is none.
    pub fn best(&self) -> &Trial {
        self.stages.iter().flat_map(|stage| &stage.finalists).fold(&self.base, verdict::better)
    }
}
