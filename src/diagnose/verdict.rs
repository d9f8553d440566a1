//! From a search to one of the four verdicts.

use super::candidates::contained_in;
use super::search::{Search, Searcher};
use super::structure;
use super::thresholds::Thresholds;
use super::trial::{Trial, schwarz_nats};
use crate::identify::numbers::Number;
use crate::parallel;
use crate::record::Kind;
use serde::Serialize;

/// The answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Nothing beyond the noise and the parameters' own uncertainty.
    Adequate,
    /// One effect, or several, explain what was left.
    Missing,
    /// Several explain it equally well.
    Ambiguous,
    /// Structure is left that the catalogue does not explain.
    OutsideCatalogue,
}

impl Verdict {
    /// As in the JSON contract.
    pub fn name(self) -> &'static str {
        match self {
            Self::Adequate => "adequate",
            Self::Missing => "missing",
            Self::Ambiguous => "ambiguous",
            Self::OutsideCatalogue => "outside-catalogue",
        }
    }
}

/// A candidate that was not taken, and why.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Refused {
    /// Effect.
    pub name: String,
    /// Why.
    pub reason: String,
}

/// What was decided.
#[derive(Clone, Debug)]
pub struct Decision {
    /// The verdict.
    pub verdict: Verdict,
    /// The trial that carries it (the base when adequate).
    pub chosen: Trial,
    /// Names that explain it as well (of the effect added last).
    pub ambiguous_with: Vec<String>,
    /// Probability of each effect of the chosen trial.
    pub probabilities: Vec<f64>,
    /// Everything else.
    pub refused: Vec<Refused>,
    /// Share of the excess that is left.
    pub left: f64,
}

/// Difference of log-likelihood of two trials on the held-out steps, in nats: how much better the
/// first is. The noise level itself is estimated, so the logarithm of the mean squares is compared.
pub fn gain(better: &Trial, worse: &Trial) -> f64 {
    if let (Some(with), Some(of)) = (&better.response, &worse.response) {
        return 0.5 * (of.held_out.cost - with.held_out.cost) / with.colour().min(of.colour()).max(1.0);
    }
    let independent = better.force.count as f64 / better.force.colour;
    0.5 * independent * (worse.force.mean().max(1e-300) / better.force.mean().max(1e-300)).ln()
}

/// How much better the first of two trials is over the whole record, nats: on the held-out steps, and on those of the fit less
/// what its freedom is worth: where the simulated response decides, by how much the record narrows its numbers, else half the
/// logarithm of the independent samples for each parameter more (Schwarz 1978). Of those that come near each other by all steps.
pub fn apart(better: &Trial, worse: &Trial) -> f64 {
    by_all_steps(better, worse).unwrap_or_else(|| added(better, worse))
}

/// The same where both were told by all steps.
fn by_all_steps(better: &Trial, worse: &Trial) -> Option<f64> {
    Some(better.whole?.ahead_of(&worse.whole?))
}

/// The same by both parts of the steps, of a model and the one that it was added to.
fn added(with: &Trial, from: &Trial) -> f64 {
    gain(with, from) + evidence(with, from)
}

/// By how much a model is likelier with the numbers of the first of two fits of it than with those of the second, nats: what its freedom
/// is worth where either ended says nothing of which is the better place.
pub fn likelier(better: &Trial, worse: &Trial) -> f64 {
    gain(better, worse) + better.training_gain(worse)
}

/// The better of two trials over the whole record, the first when neither is.
pub fn better<'a>(best: &'a Trial, trial: &'a Trial) -> &'a Trial {
    if apart(trial, best) > 0.0 { trial } else { best }
}

/// The part of the steps that were fitted.
fn evidence(trial: &Trial, from: &Trial) -> f64 {
    if let (Some(with), Some(of)) = (&trial.response, &from.response) {
        return with.evidence().ahead_of(&of.evidence());
    }
    let added = trial.dimension() as f64 - from.dimension() as f64;
    schwarz_nats(from.objective - trial.objective, added, trial.training, trial.colour)
}

/// Share of the excess that a flexible model has to see on held-out steps before it is called structure; and an excess,
/// in units of the noise, that is structure whatever the flexible model sees.
const STRUCTURED: f64 = 0.2;
const UNMISTAKABLE: f64 = 0.5;
/// Held-out error over what noise alone makes of it, from which on something is left at all: what the noise of a displacement puts into a force
/// is correlated, too.
const LEAST_OVER_NOISE: f64 = 1.02;

/// Decides; the searcher examines what a trial leaves.
pub fn decide(search: &Search, searcher: &Searcher<'_>, thresholds: Thresholds) -> Decision {
    let base = &search.base;
    let mut taken = base.clone();
    let mut refused = Vec::new();
    let mut ambiguous_with = Vec::new();
    let mut probabilities: Vec<f64> = Vec::new();
    for stage in &search.stages {
        let Some((chosen, rivals)) = choose(&stage.finalists, &taken, thresholds) else {
            for trial in &stage.finalists {
                refused.push(too_little(trial, &taken, thresholds));
            }
            break;
        };
        weigh(&stage.finalists, &chosen, &taken, thresholds, &mut probabilities);
        for trial in &stage.finalists {
            let name = own_name(trial, &chosen);
            if name != own_name(&chosen, trial) && !rivals.contains(&name) {
                let ahead = apart(trial, &chosen) > 0.0;
                let why = if ahead { "does not stand beside what was kept" } else { "explains less" };
                refused.push(refuse(trial, &chosen, base, why));
            }
        }
        for (name, left) in &stage.screened {
            refused.push(Refused {
                name: name.clone(),
                reason: match left {
                    Some(left) => format!(
                        "leaves {:.0} % of the excess in the force domain",
                        100.0 * left.clamp(0.0, 1.0)
                    ),
                    None => "there is no excess in the force domain".to_owned(),
                },
            });
        }
        taken = chosen;
        ambiguous_with = rivals;
    }
    let (left, of_base) = what_is_left(&taken, base, searcher);
    let verdict = if taken.response.is_some() {
        by_response(&taken, search, searcher, &ambiguous_with, thresholds)
    } else {
        by_force(&taken, (left, of_base), searcher, &ambiguous_with, thresholds)
    };
    Decision { verdict, chosen: taken, ambiguous_with, probabilities, refused, left }
}

/// A decision by the force along the motion whose explanation is another one by now, judged anew.
pub fn judged_anew(
    mut decision: Decision,
    base: &Trial,
    searcher: &Searcher<'_>,
    thresholds: Thresholds,
) -> Decision {
    let (left, of_base) = what_is_left(&decision.chosen, base, searcher);
    decision.left = left;
    decision.verdict =
        by_force(&decision.chosen, (left, of_base), searcher, &decision.ambiguous_with, thresholds);
    decision
}

/// Share of the base model's excess that is left, and what a flexible model sees of that excess, in units of the noise.
fn what_is_left(taken: &Trial, base: &Trial, searcher: &Searcher<'_>) -> (f64, f64) {
    let explained =
        |trial: &&Trial| structure::examine(searcher.problem(), &trial.refit).unwrap_or_default().explained;
    let examined = if taken.names.is_empty() { vec![base] } else { vec![base, taken] };
    let explained = parallel::map(&examined, parallel::cores(), explained);
    let of_base = explained.first().copied().unwrap_or_default();
    // Where the flexible model sees most of what the base lacks, what it still sees is what is left. Where it does not,
    // the covariance of neighbouring residuals has to do.
    let of_taken = explained.get(1).filter(|_| of_base > 0.5 * base.force.excess);
    let share = taken.share_left(base);
    (of_taken.map_or(share, |of_taken| share.min(of_taken / of_base.max(1e-300))), of_base)
}

/// The verdict where the force along the measured motion decides; what is left is something only where the error is more than noise
/// makes of it.
fn by_force(
    taken: &Trial,
    (left, of_base): (f64, f64),
    searcher: &Searcher<'_>,
    ambiguous_with: &[String],
    thresholds: Thresholds,
) -> Verdict {
    let excess = taken.excess();
    let is_structured = if taken.names.is_empty() {
        // Nothing in the catalogue helps; is anything left at all?
        of_base > STRUCTURED * excess || excess > UNMISTAKABLE
    } else {
        left > thresholds.left
    };
    let stands_out = || {
        let error = searcher.held_out_error(taken);
        error.is_none_or(|error| error.nrmse() > LEAST_OVER_NOISE * error.noise_floor(searcher.motion))
    };
    if excess > thresholds.excess && is_structured && stands_out() {
        Verdict::OutsideCatalogue
    } else if taken.names.is_empty() {
        Verdict::Adequate
    } else if ambiguous_with.is_empty() {
        Verdict::Missing
    } else {
        Verdict::Ambiguous
    }
}

/// The verdict where the simulated response decides.
fn by_response(
    taken: &Trial,
    search: &Search,
    searcher: &Searcher<'_>,
    ambiguous_with: &[String],
    thresholds: Thresholds,
) -> Verdict {
    let base = &search.base;
    let [deviations, share] = thresholds.beside;
    let beyond_chance = taken.excess() > deviations * taken.chance() && taken.share_left(base) > share;
    let told_by_structure = taken.excess() > thresholds.structure || !taken.names.is_empty() && beyond_chance;
    let told_by_error = || {
        searcher.over_noise(taken).is_some_and(|times| times > thresholds.most_over_noise(searcher.motion))
    };
    // A shape that leaves nothing, where what is named does.
    let lawful = search.law.is_some() && !taken.names.is_empty();
    // Shapes are asked only where the residuals themselves do not tell; in place of an effect one has been asked already, beside the base
    // model more is asked of it.
    let told_by_shape = || {
        let shaped = searcher.shaped(base, taken, thresholds);
        shaped.beside > thresholds.of_shape(taken) || shaped.instead > thresholds.of_shape_instead(taken)
    };
    // No mass on another rig moves as a few lines of a model say to within the noise of a good sensor: what explains nearly all there
    // stands, and what is left is shown.
    let nearly_all = || {
        let left =
            |trial| searcher.over_noise(trial).map_or(f64::INFINITY, |times| (times * times - 1.0).max(0.0));
        searcher.motion.kind == Kind::Force
            && !taken.names.is_empty()
            && taken.share_left(base).max(left(taken) / left(base).max(1e-3)) < thresholds.nearly
    };
    let faint = || taken.names.is_empty() && leaves_noise(searcher, taken, thresholds);
    if lawful || (told_by_structure || told_by_error() || told_by_shape()) && !nearly_all() && !faint() {
        Verdict::OutsideCatalogue
    } else if taken.names.is_empty() {
        Verdict::Adequate
    } else if ambiguous_with.is_empty() {
        Verdict::Missing
    } else {
        Verdict::Ambiguous
    }
}

/// Whether what a trial leaves of a record of another rig is noise: of an applied force but for what a solver makes of it, of a component
/// but for what its motion does between samples.
pub fn leaves_noise(searcher: &Searcher<'_>, trial: &Trial, thresholds: Thresholds) -> bool {
    let times = match searcher.motion.kind {
        Kind::Base => None,
        Kind::Force => searcher.over_noise(trial),
        Kind::Component => Some(trial.force.mean().sqrt()),
    };
    trial.excess() < thresholds.faint[1]
        && times.is_some_and(|times| times <= thresholds.most_over_noise(searcher.motion))
}

/// What brings so many times what is asked of all steps together need not bring its part on those held out: a first effect, another one.
/// Of 69 records of nothing missing the one with most had an effect that brought 4.2 nats, of the 6 that are asked.
const MORE: [f64; 2] = [1.25, 2.0];

/// Of what was named on records with a known truth, so much was there, however sure the likelihood was
/// (docs/diagnosis-evidence.md).
pub const EXPERIENCE: f64 = 0.97;

/// Whether a trial brings more than chance on the held-out steps and on those of the fit: a gain on either alone may be one
/// lucky step. Where the simulated response decides, its residuals are white and both count together: what brings far more than
/// chance there may bring little on the held-out steps alone.
pub fn brings(trial: &Trial, from: &Trial, thresholds: Thresholds) -> bool {
    let (held_out, [each, together]) = (gain(trial, from), thresholds.asked(trial, from));
    // Where the response decides, the held-out steps have paid for the freedom already.
    let fitted = if trial.response.is_some() { trial.training_gain(from) } else { evidence(trial, from) };
    let more = MORE[usize::from(!from.names.is_empty())];
    let beyond_chance = trial.response.is_some() && added(trial, from) > more * together;
    // What the fit saw nothing of is one lucky step of those that it did not see.
    fitted > each && (held_out > each || beyond_chance) && brings_together(trial, from, thresholds)
}

/// Share of what a trial brings in all that held-out steps may take from it: where few of them show an effect, noise has a say.
const AGAINST: f64 = 0.1;

/// Whether it does so on all steps together, and those held out do not speak against it.
fn brings_together(trial: &Trial, from: &Trial, thresholds: Thresholds) -> bool {
    let ([_, together], in_all) = (thresholds.asked(trial, from), added(trial, from));
    let least = if trial.response.is_some() { -AGAINST * in_all } else { 0.0 };
    in_all > together && gain(trial, from) > least
}

/// The best finalist that passes, the simpler one among equals, and those that tie with it.
fn choose(finalists: &[Trial], from: &Trial, thresholds: Thresholds) -> Option<(Trial, Vec<String>)> {
    let stands = |trial: &Trial| stands(trial, from, thresholds);
    if !finalists.iter().any(|trial| brings(trial, from, thresholds) && stands(trial)) {
        return None;
    }
    // That something is missing takes gains on both parts of the steps; which, all steps together.
    let passed: Vec<&Trial> =
        finalists.iter().filter(|trial| brings_together(trial, from, thresholds) && stands(trial)).collect();
    let best = passed.iter().copied().reduce(better)?;
    let near = |trial: &&Trial, nats: f64| apart(best, trial) < nats;
    let equals: Vec<&Trial> =
        passed.iter().copied().filter(|trial| near(trial, 0.5 * thresholds.tie)).collect();
    let is_simpler = |a: &Trial, b: &Trial| contained_in(&own_name(b, a)).contains(&own_name(a, b).as_str());
    let chosen = equals
        .iter()
        .find(|a| equals.iter().all(|b| !is_simpler(b, a)) && equals.iter().any(|b| is_simpler(a, b)))
        .map_or(best, |a| a);
    // Once something is missing, what brings a little less than was asked of it is a rival as well.
    let rivals = finalists
        .iter()
        .filter(|trial| near(trial, thresholds.tie) && added(trial, from) > 0.0 && stands(trial))
        .filter(|trial| own_name(trial, chosen) != own_name(chosen, trial))
        .map(|trial| own_name(trial, chosen))
        .collect();
    let mut chosen = chosen.clone();
    // Along an imposed motion contacts begin where they are said to, and what makes up for the amplitude does so.
    if chosen.output.is_some() && chosen.response.is_none() {
        sharpen(&mut chosen, from);
    }
    Some((chosen, rivals))
}

/// Where contacts begin and end moves by whole samples, which a linearised fit does not see: the amplitude of an added
/// effect that has no other number is known at least as well as the fall of the sum of squares from zero amplitude says. Beside another one
/// that fall is not of second order: a hysteresis of no stiffness has no yield displacement either.
fn sharpen(trial: &mut Trial, from: &Trial) {
    let gained = trial.training_gain(from);
    let alone = leading(trial).filter(|_| trial.dimension() == from.dimension() + 1);
    let refit = &mut trial.refit;
    if let Some(j) = alone.filter(|j| !refit.numbers.numbers[*j].logarithmic)
        && gained > 0.0
    {
        refit.sigmas[j] = refit.sigmas[j].min(refit.fit.values[j].abs() / (2.0 * gained).sqrt());
    }
}

/// The simulated response of held-out steps is better, or no worse than chance has it: in its mean, or in most of the
/// record, since a step in which a stiff contact leads elsewhere rules the mean.
fn follows(trial: &Trial, from: &Trial, thresholds: Thresholds) -> bool {
    match (&trial.output, &from.output) {
        _ if trial.response.is_some() => true,
        (Some(with), Some(without)) => {
            let independent = with.count as f64 / with.colour;
            let lost = 0.5 * independent * (with.mean() / without.mean().max(1e-300)).ln();
            lost < thresholds.tie || with.log_mean < without.log_mean
        }
        _ => true,
    }
}

/// Place of the first number of the effect added last among those that were fitted: how strong it is.
fn leading(trial: &Trial) -> Option<usize> {
    let prefix = format!("effect[{}].", trial.refit.spec.effects.len() - 1);
    trial.refit.numbers.numbers.iter().position(|number| number.key.starts_with(&prefix))
}

/// Whether what a trial adds is there, and its simulated response does not speak against it.
fn stands(trial: &Trial, from: &Trial, thresholds: Thresholds) -> bool {
    excludes_zero(trial, from) && follows(trial, from, thresholds)
}

/// Share of its deviation below which a strength is none.
const NOTHING: f64 = 0.01;
/// Mean square of the force of a component without an effect over that with it, at least, where the interval of its strength does not exclude
/// none: what is made of the motion between samples takes some per cent of the noise away. Beside another effect that is never enough.
const TAKES: f64 = 1.1;

/// The interval of the leading parameter of the added effect excludes zero (how fast a stiffness falls that does not fall may be known
/// all the same): the one of 95 % where the simulated response decides, whose
/// nats have told chance already; else by 3.5 standard deviations of the coloured fit.
fn excludes_zero(trial: &Trial, from: &Trial) -> bool {
    let is_linear = |(number, value, sigma): (&Number, f64, f64)| {
        // What ends at nothing has let the others fit better, and explains nothing itself.
        !number.logarithmic && value.abs() > NOTHING * sigma
    };
    let brings = || trial.training_gain(from) > 0.5 * told_by(trial).powi(2);
    let takes = || {
        let alone = from.names.is_empty();
        trial.response.is_some() || alone && from.force.mean() > TAKES * trial.force.mean()
    };
    is_there(trial) || strength(trial).is_some_and(is_linear) && brings() && takes()
}

/// How strong the effect added last is, among the numbers that were fitted: the number, its value and deviation.
fn strength(trial: &Trial) -> Option<(&Number, f64, f64)> {
    let refit = &trial.refit;
    leading(trial).map(|j| (&refit.numbers.numbers[j], refit.fit.values[j], refit.sigmas[j]))
}

/// Deviations by which a strength differs from none.
fn told_by(trial: &Trial) -> f64 {
    if trial.response.is_some() { 1.96 } else { 3.5 }
}

/// Whether the interval of the strength of the effect added last excludes none. One fitted by its logarithm is away from that when its
/// magnitude is known.
pub fn is_there(trial: &Trial) -> bool {
    strength(trial).is_some_and(|(number, value, sigma)| {
        if number.logarithmic { sigma < 0.5 } else { value.abs() > told_by(trial) * sigma }
    })
}

/// Probability of each effect of what was chosen among the rivals that differ in that effect alone, and that it is none of them.
/// Where none was tried at this stage, it stays what it was, if the effect does.
/// What does not stand beside what was taken before is no rival, whatever it brings, nor what was refused although it is ahead.
fn weigh(
    finalists: &[Trial],
    chosen: &Trial,
    from: &Trial,
    thresholds: Thresholds,
    probabilities: &mut Vec<f64>,
) {
    let before = std::mem::take(probabilities);
    for place in 0..chosen.names.len() {
        let others = || chosen.names.iter().enumerate().filter(|(i, _)| *i != place);
        let alike = |trial: &&Trial| {
            trial.names.len() == chosen.names.len() && others().all(|(_, name)| trial.names.contains(name))
        };
        let is_rival = |trial: &&Trial| {
            let was_refused = || apart(trial, chosen) > 0.0 && !brings_together(trial, from, thresholds);
            stands(trial, from, thresholds) && !was_refused()
        };
        let rivals: Vec<&Trial> = finalists.iter().filter(alike).filter(is_rival).collect();
        // A tie is even odds; the scale of the tie takes the place of a nat, since model error and
        // colour make the likelihood sharper than experience bears out.
        let weight = |trial: &Trial| (-apart(chosen, trial) / (0.5 * thresholds.tie)).exp();
        let sum: f64 = rivals.iter().map(|trial| weight(trial)).sum();
        let stayed = from.names.get(place) == chosen.names.get(place);
        let known = before.get(place).filter(|_| stayed && rivals.len() < 2);
        probabilities.push(known.copied().unwrap_or(EXPERIENCE / sum.max(1.0)));
    }
}

/// Excess of the base model, in units of the noise, of which no share is told.
const NO_EXCESS: f64 = 1e-3;

fn refuse(trial: &Trial, against: &Trial, base: &Trial, why: &str) -> Refused {
    let nats = if let Some(nats) = by_all_steps(against, trial) {
        format!("{nats:.1} nats apart, both fitted to all steps")
    } else {
        let on_the_fit = against.training_gain(trial);
        let held_out = gain(against, trial);
        format!("{held_out:.1} nats apart on held-out steps, {on_the_fit:.1} on the steps of the fit")
    };
    let [left, left_kept] = [trial, against].map(|of| 100.0 * of.share_left(base).min(1.0));
    // At few samples a cycle the base model's residuals may show none.
    let shares = if base.excess() > NO_EXCESS {
        format!("leaves {left:.1} % of the excess ({left_kept:.1} % with what was kept), ")
    } else {
        String::new()
    };
    Refused { name: last_name(trial), reason: format!("{why}: {shares}{nats}") }
}

/// Why a trial that does not bring enough was not taken.
fn too_little(trial: &Trial, from: &Trial, thresholds: Thresholds) -> Refused {
    let [_, asked] = thresholds.asked(trial, from);
    let why = if !brings(trial, from, thresholds) {
        "no gain on held-out steps beyond chance"
    } else if !excludes_zero(trial, from) {
        "the interval of its strength does not exclude none, the other numbers do as well"
    } else {
        "the simulated response of the held-out steps is no better with it"
    };
    Refused {
        name: last_name(trial),
        reason: format!(
            "{why}: brings {:.1} nats there, {:.1} on the steps of the fit and {:.1} in all, less what its freedom costs; {asked:.0} are asked",
            gain(trial, from),
            trial.training_gain(from),
            added(trial, from),
        ),
    }
}

/// The effect that a trial has and another one has not, the last one where that is none.
pub fn own_name(trial: &Trial, other: &Trial) -> String {
    let own = trial.names.iter().rfind(|name| !other.names.contains(name));
    own.or(trial.names.last()).cloned().unwrap_or_default()
}

/// The effect added last.
pub fn last_name(trial: &Trial) -> String {
    trial.names.last().cloned().unwrap_or_default()
}

#[cfg(test)]
#[path = "verdict_tests.rs"]
mod tests;
