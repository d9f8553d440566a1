//! Starts of effects fitted by the response against each other beside one model: in short by a part of the steps, then the best of
//! them in full, then from other starts. The search by the response hands over those that first order and force put first.

use super::by_response::first_of_each;
use super::trial::{self, Trial};
use super::verdict;
use crate::identify::least_squares::Settings;
use crate::identify::numbers::Numbers;
use crate::identify::refit::Refit;
use crate::identify::response::{Laid, Measured, PROMISED, Until};
use crate::model::{ModelSpec, Scales};
use crate::parallel;

/// Every so many steps are looked at to sort starts out, and of a long record.
pub(super) const HALF: usize = 2;
const THIRD: usize = 3;
/// How fits go on.
pub(super) const FURTHER_ON: Settings = Settings { iterations: 20, tolerance: 1e-6, difference: 1e-3 };
/// How starts are sorted out, and what is left of them fitted.
pub(super) const SORTED_OUT: Settings = Settings { iterations: 3, ..FURTHER_ON };
const IN_FULL: Settings = Settings { iterations: 30, ..FURTHER_ON };
/// What is behind the best by so many nats after a short fit gets no long one; a candidate a few rounds more, to be refused by name.
pub(super) const HOPELESS: f64 = 80.0;
const FEW_ROUNDS: usize = 2;
/// Nats that an effect beside another may bring after a short fit, half of what is asked of it, for a full one.
const PROMISING: f64 = 5.0;
/// Cost within which two short fits of an effect that promise no more have ended at the same place.
const ARRIVED: f64 = 1.0;
/// Nats behind the best within which another start of an effect is worth a fit.
const NEARBY: f64 = 30.0;
/// So many of those are refined, and whatever is that near after a short fit, but beside an effect that leaves much so many at most; so
/// many at least, to be refused by name.
const REFINED: usize = 3;
const REFINED_FAR_OFF: usize = 6;
const REFUSED: usize = 2;

/// A model that starts are fitted beside.
pub(super) struct Contest<'c, 'a> {
    measured: &'c Measured<'a>,
    /// A part of the steps: every so many.
    some: Measured<'a>,
    every: usize,
    from: &'c Trial,
    scales: &'c Scales,
    /// How many residuals count as one independent one.
    colour: f64,
    /// What an explanation that is known already comes to over that part of the steps.
    known: f64,
}

/// A start after a short fit.
pub(super) struct Entrant {
    spec: ModelSpec,
    numbers: Numbers,
    short: Laid,
    /// Nats behind the best of all.
    behind: f64,
    /// It does not catch up with the best, or brings nothing.
    hopeless: bool,
    /// It has arrived where a better start of its effect has.
    again: bool,
}

impl Entrant {
    fn name(&self) -> Option<&str> {
        self.spec.effects.last().map(|effect| effect.name.as_str())
    }

    /// Whether it has come to the same end as another start of its effect: neither leaves less nor promises more.
    fn has_arrived_with(&self, other: &Self) -> bool {
        let (one, two) = (&self.short, &other.short);
        (one.total() - two.total()).abs().max(one.promised()).max(two.promised()) < ARRIVED
    }

    /// Whether a full fit may bring anything.
    pub(super) fn is_hopeful(&self) -> bool {
        !self.hopeless
    }
}

impl<'c, 'a> Contest<'c, 'a> {
    pub(super) fn new(measured: &'c Measured<'a>, from: &'c Trial, scales: &'c Scales, colour: f64) -> Self {
        let every = if measured.is_long() { THIRD } else { HALF };
        let known = f64::INFINITY;
        Self { measured, some: measured.every(every), every, from, scales, colour: colour.max(1.0), known }
    }

    /// The same against an explanation that is known already: what is far behind that, too, does not matter.
    pub(super) fn against(self, known: &Trial) -> Self {
        let response = known.response.as_ref();
        let of_part =
            response.and_then(|of| self.measured.of_every(self.every, &known.refit.spec, &of.training));
        Self { known: of_part.unwrap_or(f64::INFINITY), ..self }
    }

    /// Nats of a cost over a part of the steps.
    fn nats(&self, cost: f64, colour: f64) -> f64 {
        0.5 * self.every as f64 * cost / colour
    }

    fn fit(
        &self,
        measured: &Measured<'_>,
        start: &ModelSpec,
        settings: Settings,
        until: Until<'_>,
    ) -> Option<Entrant> {
        let refit = &self.from.refit;
        let mut numbers = refit.numbers.clone();
        numbers.add_effect(start, start.effects.len() - 1, self.scales);
        numbers.start_from(start);
        let short = measured.fit_up_to(start, &numbers, (refit.zero_m, None), settings, until)?;
        let mut spec = start.clone();
        numbers.put(&short.values, &mut spec).then_some(Entrant {
            spec,
            numbers,
            short,
            behind: 0.0,
            hopeless: false,
            again: false,
        })
    }

    /// What the model itself comes to in short, where that tells what an effect beside another may bring, or one that a long record is to
    /// have: little is left there.
    fn without(&self) -> Option<f64> {
        let Refit { spec, numbers, zero_m, .. } = &self.from.refit;
        if self.from.names.is_empty() && !self.measured.is_long() || self.from.is_far() {
            return None;
        }
        let mut numbers = numbers.clone();
        numbers.start_from(spec);
        Some(self.some.fit(spec, &numbers, *zero_m, None, SORTED_OUT)?.total())
    }

    /// Fits all starts in short: the best of each effect, best first, and the others.
    pub(super) fn in_short(&self, starts: &[ModelSpec]) -> (Vec<Entrant>, Vec<Entrant>) {
        // None is given up: far off, what a start promises at first says little of where it leads.
        let short = |start: &ModelSpec| self.fit(&self.some, start, SORTED_OUT, Until::default());
        let tried = parallel::map(starts, parallel::cores(), short);
        let mut tried: Vec<Entrant> = tried.into_iter().flatten().collect();
        tried.sort_by(|a, b| a.short.total().total_cmp(&b.short.total()));
        let Some(first) = tried.first() else { return (tried, Vec::new()) };
        let least = first.short.total().min(self.known);
        let without = self.without();
        for of in &mut tried {
            let (total, promised) = (of.short.total(), of.short.promised());
            of.behind = self.nats(total - least, self.colour);
            // One that is a good way behind and promises no more does not catch up.
            let settled = of.behind - self.nats(PROMISED * promised, 1.0);
            let brings =
                without.map_or(f64::INFINITY, |without| self.nats(without - total + promised, self.colour));
            of.hopeless = of.behind > HOPELESS || settled > 0.5 * HOPELESS || brings < PROMISING;
        }
        let mut others = first_of_each(&mut tried, |_| 1, |of| of.spec.effects.last());
        for other in &mut others {
            other.again =
                tried.iter().any(|best| best.name() == other.name() && other.has_arrived_with(best));
        }
        (tried, others)
    }

    /// Fits the best of those in full, best first.
    pub(super) fn in_full(&self, mut tried: Vec<Entrant>) -> Vec<Trial> {
        let within = |nats: f64| tried.iter().take_while(|of| of.behind < nats).count();
        let (mut near, hopeful) = (within(NEARBY), within(HOPELESS));
        // Beside an effect a long record leaves so little that a short fit sorts them out; where much is left, most of them do nothing
        // about it, and what is left is no noise that nats could be counted over.
        if !self.from.names.is_empty() {
            near = match (self.measured.is_long(), self.from.is_far()) {
                (true, _) => near.min(REFINED),
                (false, true) => near.min(REFINED_FAR_OFF),
                (false, false) => near,
            };
        }
        tried.truncate(near.max(hopeful.clamp(REFUSED, REFINED)));
        let Some((first, rest)) = tried.split_first() else { return Vec::new() };
        let mut finalists: Vec<Trial> = self.arrived(first, Until::default()).into_iter().collect();
        let beyond = finalists.first().map_or(f64::INFINITY, |best| best.total_behind(HOPELESS));
        let until = Until::below(beyond);
        let rest = parallel::map(rest, parallel::cores(), |entrant| self.arrived(entrant, until));
        finalists.extend(rest.into_iter().flatten());
        best_first(&mut finalists, self.from);
        finalists
    }

    /// The other starts of the best finalist, and of those that come near it: a likelihood with several summits.
    pub(super) fn other_summits(&self, mut others: Vec<Entrant>, finalists: &mut Vec<Trial>) {
        let Some(best) = finalists.first() else { return };
        let ended = |entrant: &Entrant| {
            let near = |trial: &&Trial| verdict::apart(best, trial) < NEARBY;
            let name = entrant.name()?;
            finalists.iter().filter(near).find(|trial| verdict::last_name(trial) == name)?.response.as_ref()
        };
        // Of friction that falls beside one that does not, the best one alone: it is looked for from there.
        let falls = verdict::last_name(best) == "coulomb-friction";
        others.retain(|entrant| {
            entrant.is_hopeful()
                && !entrant.again
                && ended(entrant).is_some()
                && !(falls && entrant.name() == Some("stribeck-friction"))
        });
        let others = parallel::map(&others, parallel::cores(), |entrant| {
            self.arrived(entrant, Until::better_than(&ended(entrant)?.training))
        });
        finalists.extend(others.into_iter().flatten());
        best_first(finalists, self.from);
    }

    /// A full fit from where a short one ended, judged. Each step's start anew: what the model before had there holds the gap where it
    /// was.
    fn arrived(&self, entrant: &Entrant, until: Until<'_>) -> Option<Trial> {
        let iterations = if entrant.hopeless { FEW_ROUNDS } else { IN_FULL.iterations };
        let settings = Settings { iterations, ..IN_FULL };
        let Entrant { spec, numbers, short: laid, .. } =
            self.fit(self.measured, &entrant.spec, settings, until)?;
        let mut names = self.from.names.clone();
        names.push(spec.effects.last()?.name.clone());
        let refit = Refit { spec, ..self.from.refit.clone() };
        trial::judge_response(self.measured, &Trial { names, refit, ..self.from.clone() }, numbers, laid)
    }
}

/// By what they bring on top of another trial, the best one alone of those with the same effects. Where the response decides, by
/// what they are behind the one that leaves least: over a model that is far off, a thousandth in how many residuals count as one
/// is hundreds of nats.
pub(super) fn best_first(trials: &mut Vec<Trial>, from: &Trial) {
    let cost = |trial: &Trial| {
        trial.response.as_ref().map_or(f64::INFINITY, |r| r.training.total() + r.held_out.cost)
    };
    let least = trials.iter().min_by(|a, b| cost(a).total_cmp(&cost(b))).filter(|t| t.response.is_some());
    let beside = least.cloned();
    let brings = |trial: &Trial| verdict::apart(trial, beside.as_ref().unwrap_or(from));
    trials.sort_by(|a, b| brings(b).total_cmp(&brings(a)));
    let mut seen: Vec<Vec<String>> = Vec::with_capacity(trials.len());
    trials.retain(|trial| {
        let mut effects = trial.names.clone();
        effects.sort();
        let new = !seen.contains(&effects);
        seen.push(effects);
        new
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::candidates;
    use crate::diagnose::search::{Effort, Searcher};
    use crate::diagnose::testing::seen;
    use crate::identify::kinematics::Tolerances;
    use crate::identify::motion::Motion;
    use crate::model::testing::{b1_g2, effect};

    /// Names of the starts beside Coulomb's friction that a short fit leaves hopeful.
    fn hopeful(hidden: &[(&str, &[(&str, f64)])]) -> Vec<String> {
        let mut truth = b1_g2();
        truth.effects.extend(hidden.iter().map(|(name, of)| effect(name, of)));
        let motion = Motion::of(&seen(&truth, 36), 500.0, Tolerances::default()).expect("a motion");
        let searcher = Searcher::new(&motion, &b1_g2(), Effort::default());
        let (base, measured) =
            (searcher.base(&b1_g2()).expect("fits"), searcher.measured.as_ref().expect("seen"));
        let scales = candidates::scales(&base.refit.spec, &motion);
        let start = candidates::beside(&base.refit.spec, &effect("coulomb-friction", &[("fc_n", 10.0)]));
        let colour = |trial: &Trial| trial.response.as_ref().expect("responds").colour();
        let first = Contest::new(measured, &base, &scales, colour(&base));
        let from = first.in_full(first.in_short(&[start]).0).remove(0);
        assert_eq!(from.names, ["coulomb-friction"]);
        let beside = Contest::new(measured, &from, &scales, colour(&from));
        let starts = [("cubic-stiffness", "k3_n_m3", 2e5), ("bumper-preload", "f0_n", 1.0)];
        let starts = starts
            .map(|(name, of, value)| candidates::beside(&from.refit.spec, &effect(name, &[(of, value)])));
        let (tried, _) = beside.in_short(&starts);
        assert_eq!(tried.len(), 2);
        tried.iter().filter(|of| of.is_hopeful()).filter_map(|of| Some(of.name()?.to_owned())).collect()
    }

    #[test]
    fn what_is_far_behind_a_known_explanation_is_not_followed() {
        let mut truth = b1_g2();
        truth.effects.push(effect("coulomb-friction", &[("fc_n", 12.0)]));
        let motion = Motion::of(&seen(&truth, 39), 500.0, Tolerances::default()).expect("a motion");
        let searcher = Searcher::new(&motion, &b1_g2(), Effort::default());
        let (base, measured) =
            (searcher.base(&b1_g2()).expect("fits"), searcher.measured.as_ref().expect("seen"));
        let scales = candidates::scales(&base.refit.spec, &motion);
        let start = |name: &str, of: &str, value: f64| {
            candidates::beside(&base.refit.spec, &effect(name, &[(of, value)]))
        };
        let (right, wrong) = (start("coulomb-friction", "fc_n", 10.0), start("bumper-preload", "f0_n", 5.0));
        let contest =
            || Contest::new(measured, &base, &scales, base.response.as_ref().expect("laid").colour());
        let known = contest().in_full(contest().in_short(std::slice::from_ref(&right)).0).remove(0);
        let of_part = contest().against(&known).known;
        let whole = known.response.as_ref().expect("laid").training.total();
        assert!((HALF as f64 * of_part / whole - 1.0).abs() < 0.2, "{of_part} of {whole}");
        let hopeful = |contest: Contest<'_, '_>, start: &ModelSpec| {
            contest.in_short(std::slice::from_ref(start)).0.iter().any(Entrant::is_hopeful)
        };
        // Alone it is the best there is; beside what is known it has no chance, which that itself has.
        assert!(hopeful(contest(), &wrong));
        let beside = contest().against(&known).in_short(std::slice::from_ref(&wrong)).0.remove(0);
        assert!(!beside.is_hopeful(), "{} nats behind, {}", beside.behind, beside.short.promised());
        let itself = contest().against(&known).in_short(std::slice::from_ref(&right)).0.remove(0);
        assert!(itself.is_hopeful(), "{} nats behind, {}", itself.behind, itself.short.promised());
    }

    #[test]
    fn beside_an_effect_that_explains_all_a_short_fit_tells_what_brings_nothing() {
        let friction: (&str, &[(&str, f64)]) = ("coulomb-friction", &[("fc_n", 12.0)]);
        assert_eq!(hopeful(&[friction]), Vec::<String>::new());
        let both = [friction, ("cubic-stiffness", &[("k3_n_m3", 2e6)])];
        assert!(hopeful(&both).contains(&"cubic-stiffness".to_owned()));
    }
}
