//! A fitted model fitted again from another place: from where a richer one has put its numbers, with another slow noise, with numbers held
//! that went astray, with a knee within the motion, and from what the profile of its likelihood comes upon.

use super::contest::{FURTHER_ON, HOPELESS, best_first};
use super::search::{Search, Searcher, Stage, UNSEEN};
use super::trial::{self, Response, Trial};
use super::verdict;
use crate::identify::least_squares::Settings;
use crate::identify::problem::{Part, Problem};
use crate::identify::refit::Refit;
use crate::identify::response::{Measured, Until};
use crate::model::ModelSpec;
use crate::parallel;

/// Nats by which a model has to do better when it is fitted again.
const BETTER: f64 = 2.0;
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

impl Searcher<'_> {
    /// A model fitted again from where the best finalist beside it has put its numbers, when that does better: what it falls by is
    /// no added effect's. From where that has put the steps, too, if its effect may as well be none.
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
        let steps =
            best.response.as_ref().map(|response| &response.training).filter(|_| !verdict::is_there(best));
        let (numbers, again) = trial::fit_response(measured, &start, steps, settings, until)?;
        let better = training.total() - again.total() > 2.0 * BETTER;
        if better { trial::judge_response(measured, &start, numbers, again) } else { None }
    }

    /// Where a better model leaves another slow noise of the displacement sensor, or has its jumps elsewhere, everything found so far is
    /// fitted and judged with that: what the model before lacked had posed as noise, and its contacts began at other instants. What the
    /// stage goes on from, so fitted.
    pub(super) fn heard_anew(&self, search: &mut Search, stage: &mut Stage, from: &Trial) -> Option<Trial> {
        let (measured, best) = (self.measured.as_ref()?, stage.finalists.first()?);
        if verdict::apart(best, from) <= 0.0 || !tells_otherwise(measured, best) {
            return None;
        }
        let best = best.clone();
        // What is hopelessly behind is laid anew as it is.
        let rounds = |trial: &Trial| if verdict::apart(&best, trial) > HOPELESS { 0 } else { HEARD_ANEW };
        let again = |trial: &Trial| from_where_it_stands(measured, trial, rounds(trial));
        let all = |trials: &mut Vec<Trial>| *trials = parallel::map(trials, parallel::cores(), again);
        all(&mut stage.finalists);
        search.stages.iter_mut().for_each(|stage| all(&mut stage.finalists));
        search.base = again(&search.base);
        let from = search.best().clone();
        best_first(&mut stage.finalists, &from);
        Some(from)
    }

    /// The same stages by a response that is seen with less noise: what was tried is fitted on from where it stood.
    pub(super) fn taken_over(&self, stages: &[Stage], base: &Trial) -> Vec<Stage> {
        let Some(measured) = &self.measured else { return Vec::new() };
        let taken = |stage: &Stage| {
            let best = stage.finalists.first();
            let again = |trial: &Trial| {
                let hopeless = best.is_some_and(|best| verdict::apart(best, trial) > HOPELESS);
                let settings =
                    Settings { iterations: if hopeless { 0 } else { FURTHER_ON.iterations }, ..FURTHER_ON };
                fitted_on(measured, trial, settings)
            };
            let again = parallel::map(&stage.finalists, parallel::cores(), again);
            let mut finalists: Vec<Trial> = again.into_iter().flatten().collect();
            best_first(&mut finalists, base);
            Stage { finalists, ..stage.clone() }
        };
        stages.iter().map(taken).collect()
    }

    /// A fitted model, fitted again where it tells slow noise or jumps otherwise than the one before.
    pub(super) fn heard_by_itself(&self, trial: Trial) -> Trial {
        match self.measured.as_ref().filter(|measured| tells_otherwise(measured, &trial)) {
            Some(measured) => from_where_it_stands(measured, &trial, HEARD_ANEW),
            None => trial,
        }
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
    pub fn bounded(&self, mut trial: Trial) -> Trial {
        let Some(measured) = self.measured.as_ref().filter(|measured| !measured.is_long()) else {
            return self.beyond_limits(trial);
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

    /// A way from far off takes longer; it may have begun in a wrong direction, from where numbers of the model's own made up for what
    /// is there now, or have left a knee beyond the motion.
    pub(super) fn go_on(&self, measured: &Measured<'_>, best: &mut Trial) {
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
}

/// First stages of a search that are what they are with less noise, too: each of them found so much that what it passed over for too little is
/// nothing beside that.
pub(super) fn clear(search: &Search) -> &[Stage] {
    let best = |stage: usize| search.stages.get(stage)?.finalists.first();
    let is_clear = |stage: &usize| {
        let from = stage.checked_sub(1).and_then(best).unwrap_or(&search.base);
        best(*stage).is_some_and(|best| verdict::apart(best, from) > HOPELESS)
    };
    let clear = (0..search.stages.len()).take_while(is_clear).count();
    &search.stages[..clear]
}

/// A knee or gap just beyond the motion has no slope to follow, although the truth may lie within: such numbers are tried
/// from there.
pub(super) fn reached(problem: &Problem<'_>, nominal: &ModelSpec, fit: Refit) -> Refit {
    let mut best = fit;
    for j in 0..best.numbers.numbers.len() {
        let (key, prior) = (best.numbers.numbers[j].key.clone(), best.numbers.free[j].prior);
        let edge = key.starts_with("isolator.breakpoints_m") || key == "bumper.total_gap_m";
        if !edge || best.sigmas[j] < UNSEEN * prior.1 {
            continue;
        }
        let mut start = best.clone();
        if start.spec.set(&key, prior.0 - 1.5 * prior.1).is_ok()
            && let Some(other) = trial::base_by_force(problem, nominal, Some(&start))
            && trial::objective(&other) < trial::objective(&best)
        {
            best = other;
        }
    }
    best
}

/// A fitted model fitted on for so many rounds with what has been told since.
fn from_where_it_stands(measured: &Measured<'_>, trial: &Trial, iterations: usize) -> Trial {
    let settings = Settings { iterations, ..Settings::default() };
    fitted_on(measured, trial, settings).unwrap_or_else(|| trial.clone())
}

/// The same; `None` where it cannot be simulated.
fn fitted_on(measured: &Measured<'_>, trial: &Trial, settings: Settings) -> Option<Trial> {
    let laid = trial.response.as_ref().map(|response| &response.training);
    trial::respond(measured, trial, laid, settings)
}

/// Has a fitted model tell slow noise of the displacement sensor and jumps; whether either is another than before.
pub(super) fn tells_otherwise(measured: &Measured<'_>, trial: &Trial) -> bool {
    let Some(response) = &trial.response else { return false };
    let (Refit { spec, numbers, .. }, Response { training, held_out, .. }) = (&trial.refit, response);
    let laid = [(Part::Training, training), (Part::HeldOut, held_out)];
    let (jumps, drive) = (measured.learn_jumps(spec, laid), measured.learn_noise_of_drive(spec));
    // Beside what noise in the drive does.
    let slow = measured.learn_slow_noise(spec, numbers, laid);
    jumps || drive || slow
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::search::Effort;
    use crate::diagnose::testing::{seen, seen_briefly, with};
    use crate::identify::kinematics::Tolerances;
    use crate::identify::motion::Motion;
    use crate::model::testing::{b1_g2, effect};

    #[test]
    fn a_better_place_of_a_model_is_taken_whatever_its_freedom_is_worth_there() {
        let mut truth = b1_g2();
        truth.effects.push(effect("maxwell-branch", &[("km_n_m", 1500.0), ("tau_s", 0.08)]));
        let motion = Motion::of(&seen_briefly(&truth, 38), 500.0, Tolerances::default()).expect("a motion");
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

    #[test]
    fn a_knee_that_the_mass_does_not_reach_may_be_anywhere_beyond_the_motion() {
        const GIVEN_M: f64 = 0.0163;
        let mut truth = b1_g2();
        truth.bumper = None;
        truth.isolator.breakpoints_m[1] = 0.2;
        let record = seen(&truth, 18);
        let motion = Motion::of(&record, 500.0, Tolerances::default()).expect("a motion");
        // Given within the motion of the steps that are fitted: the fit takes it to where that ends, and no farther.
        let mut nominal = truth.clone();
        nominal.isolator.breakpoints_m[1] = GIVEN_M;
        let searcher = Searcher::new(&motion, &nominal, Effort::default());
        let base = searcher.base(&nominal).expect("follows");
        let knee = |trial: &Trial| trial.refit.interval("isolator.breakpoints_m[1]").expect("moves");
        let (value, low, high) = knee(&base);
        let prior_m = 0.06 / 1.96 * GIVEN_M;
        assert!(value > GIVEN_M && high - value < 0.2 * prior_m, "{low} {value} {high}");
        let (_, bounded_low, high) = knee(&searcher.bounded(base));
        assert!((bounded_low - low).abs() < 0.1 * prior_m, "{bounded_low} {low}");
        assert!(high - value > 0.5 * prior_m, "{high} beyond {value}");
    }

    #[test]
    fn a_model_that_tells_jumps_otherwise_is_fitted_again_with_those() {
        let mut truth = b1_g2();
        truth.effects.push(effect("hertz-contact", &[("kh", 1.2e5), ("n", 1.3)]));
        let motion = Motion::of(&seen(&truth, 26), 500.0, Tolerances::default()).expect("a motion");
        let searcher = Searcher::new(&motion, &b1_g2(), Effort::default());
        let base = searcher.base(&b1_g2()).expect("fits");
        let trial = with(&searcher, &base, &truth.effects, Settings::default());
        let (before, again) = (trial.refit.fit.values.clone(), searcher.heard_by_itself(trial));
        assert_ne!(before, again.refit.fit.values, "other samples count");
        let told = again.refit.spec.effects[0].parameters["n"];
        assert!((told / 1.3 - 1.0).abs() < 0.01, "{told}");
    }
}
