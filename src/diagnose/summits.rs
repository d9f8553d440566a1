//! Effects whose likelihood has more than one summit, or numbers that are left out at first: sharpness of a hysteresis, ringing of a
//! stand, breakaway of friction. The search by the response calls them for the best of its candidates.

use super::at_last::bound;
use super::by_response::WORTH;
use super::contest::{FURTHER_ON, HALF, HOPELESS, SORTED_OUT};
use super::search::Searcher;
use super::trial::{self, Trial};
use super::{candidates, verdict};
use crate::identify::least_squares::Settings;
use crate::identify::response::{Measured, Until};
use crate::model::effects::coulomb_friction::TURNING;
use crate::model::{ModelSpec, Scales, effects};
use crate::parallel;
use crate::record::Kind;

/// How the shape of an effect is fitted.
const OF_SHAPE: Settings = Settings { iterations: 12, ..FURTHER_ON };
/// How many times as fast a stand rings that is tried beside one that was found, and how often at most.
const BESIDE: [f64; 6] = [0.7, 0.84, 0.92, 1.09, 1.19, 1.4];
const SUMMITS: usize = 3;
/// Stribeck velocities that are tried beside Coulomb's friction, over the typical velocity; how much more than it breakaway takes; and
/// nats to first order below which that is not fitted.
const FALLS: [f64; 6] = [0.01, 0.03, 0.07, 0.15, 0.3, 0.6];
const RISE: f64 = 0.1;
const FALLING: f64 = 5.0;

/// Velocities over which Coulomb's friction may turn round, over the typical velocity.
const TURNS: [f64; 4] = [3e-3, 1e-2, 3e-2, 0.1];

impl Searcher<'_> {
    /// Lets the shape of the last effect follow, too, where that pays: in those that may be the best then, which bring no more by it than
    /// the best leaves: twice what neighbouring residuals tell of that, which see little of what is slow.
    pub(super) fn shape(&self, measured: &Measured<'_>, finalists: &mut [Trial], scales: &Scales) {
        let Some(best) = finalists.first().cloned() else { return };
        let reshaped = |trial: &Trial| -> Option<Trial> {
            if verdict::apart(&best, trial) > 2.0 * (HOPELESS + best.nats_left()) {
                return None;
            }
            let (shaped, without) = (with_shape(trial, scales)?, &trial.response.as_ref()?.training);
            // From where it is; given up where it does not pay.
            let enough = without.total() - 2.0 * WORTH;
            let fitted = |shaped: &Trial| {
                trial::fit_response(measured, shaped, Some(without), OF_SHAPE, Until::below(enough))
            };
            let (mut numbers, mut laid) = fitted(&shaped)?;
            // It promises what it did not reach: there is a bend in the way.
            if laid.total() > enough && laid.promised() > 2.0 * WORTH {
                (numbers, laid) = fitted(&with_other_shape(&shaped)?)?;
            }
            let shaped = trial::judge_response(measured, &shaped, numbers, laid)?;
            (verdict::apart(&shaped, trial) > WORTH).then_some(shaped)
        };
        replace_where_told(finalists, reshaped);
    }

    /// The same by the force along the measured motion, where there is no response; and friction that turns round over a velocity.
    pub(super) fn shape_by_force(&self, finalists: &mut Vec<Trial>, scales: &Scales) {
        self.turning_by_force(finalists, scales);
        let reshaped = |trial: &Trial| -> Option<Trial> {
            let mut best: Option<Trial> = None;
            let effects = trial.refit.spec.effects.len();
            // What an effect was shaped like without those that came after it may have been astray.
            for index in (effects.saturating_sub(trial.names.len().max(1))..effects).rev() {
                let from = best.as_ref().unwrap_or(trial);
                let shaped =
                    with_shape_of(from, index, scales).and_then(|shaped| self.fitted_by_force(&shaped));
                best = shaped.filter(|shaped| verdict::apart(shaped, from) > WORTH).or(best);
            }
            best
        };
        replace_where_told(finalists, reshaped);
    }

    /// Coulomb's friction that turns round smoothly in place of one that sticks, or beside a Stribeck's that makes up for it, by the force
    /// along the measured motion.
    fn turning_by_force(&self, finalists: &mut Vec<Trial>, scales: &Scales) {
        // The motion of a component is imposed: that of a mass moves with what holds it.
        if self.motion.kind != Kind::Component {
            return;
        }
        let sticking = finalists.iter().position(is_sticking);
        let falling = |trial: &Trial| {
            let tried = self.candidates(&trial.refit.spec);
            verdict::last_name(trial) == "stribeck-friction"
                && tried.iter().any(|effect| effect.name == "coulomb-friction")
        };
        let Some(place) = sticking.or_else(|| finalists.iter().position(falling)) else { return };
        let from = &finalists[place];
        let turning = parallel::map(&TURNS, parallel::cores(), |share| {
            self.fitted_by_force(&turned(from, share * scales.velocity_m_s, scales)?)
        });
        let best = turning.into_iter().flatten().min_by(|a, b| a.objective.total_cmp(&b.objective));
        let Some(best) = best.filter(|best| verdict::apart(best, from) > WORTH) else { return };
        match sticking {
            Some(place) => finalists[place] = best,
            None => finalists.push(best),
        }
    }

    /// Limits of the numbers of an explanation that hold although the shape of its last effect was left out: it was since it did not pay,
    /// not since it is known, and the other numbers go with it.
    pub(super) fn whatever_the_shape(
        &self,
        measured: &Measured<'_>,
        trial: &Trial,
        mut limits: Vec<(f64, f64)>,
    ) -> Vec<(f64, f64)> {
        let scales = candidates::scales(&trial.refit.spec, self.motion);
        let more = |shaped: &Trial| shaped.refit.numbers.numbers.len() > trial.refit.numbers.numbers.len();
        let shaped = with_shape(trial, &scales).filter(more);
        let shaped = shaped.and_then(|shaped| trial::respond(measured, &shaped, None, OF_SHAPE));
        // It contains what it began from; a fit that lost it says nothing.
        let Some(shaped) = shaped.filter(|shaped| shaped.training_gain(trial) > -WORTH) else {
            return limits;
        };
        let shaped = self.bounded(shaped).refit;
        for (number, limit) in trial.refit.numbers.numbers.iter().zip(&mut limits) {
            let place = shaped.numbers.numbers.iter().position(|other| other.key == number.key);
            if let Some((low, high)) = place.and_then(|place| shaped.limits.get(place)) {
                *limit = (limit.0.min(*low), limit.1.max(*high));
            }
        }
        limits
    }

    /// A stand's likelihood has a summit for every number of ringings between two contacts: those beside the one that was found, for as
    /// long as they are higher.
    pub(super) fn ringing(&self, measured: &Measured<'_>, best: &mut Trial, scales: &Scales) {
        if verdict::last_name(best) != "stand-compliance" {
            return;
        }
        let some = measured.every(HALF);
        for _ in 0..SUMMITS {
            let Some(shaped) = with_shape(best, scales) else { return };
            let beside = |times: &f64| -> Option<(f64, Trial)> {
                let mut start = shaped.clone();
                let last = start.refit.spec.effects.last_mut()?;
                *last.parameters.get_mut("ms_kg")? /= times * times;
                in_short(&some, &start)
            };
            let tried = parallel::map(&BESIDE, parallel::cores(), beside);
            let highest = tried.into_iter().flatten().min_by(|a, b| a.0.total_cmp(&b.0));
            let arrived = highest.and_then(|(_, start)| trial::respond(measured, &start, None, FURTHER_ON));
            match arrived.filter(|arrived| verdict::apart(arrived, best) > WORTH) {
                Some(arrived) => *best = arrived,
                None => return,
            }
        }
    }

    /// Stribeck's friction beside a Coulomb's that does best: what it does more is next to nothing beside what both do, which first order
    /// about the model without friction does not tell.
    pub(super) fn falling(
        &self,
        measured: &Measured<'_>,
        best: Option<&Trial>,
        scales: &Scales,
    ) -> Option<Trial> {
        let best = best.filter(|best| is_sticking(best))?;
        self.candidates(&best.refit.spec).iter().find(|effect| effect.name == "stribeck-friction")?;
        let (index, laid) = (best.refit.spec.effects.len() - 1, &best.response.as_ref()?.training);
        let constant = *best.refit.spec.effects[index].parameters.get("fc_n")?;
        let tangent = measured.tangent(&best.refit.spec, &best.refit.numbers, laid)?;
        let scored = parallel::map(&FALLS, parallel::cores(), |share| {
            let mut spec = best.refit.spec.clone();
            let effect = &mut spec.effects[index];
            effect.name = "stribeck-friction".into();
            effect.parameters.insert("fs_n".into(), (1.0 + RISE) * constant);
            effect.parameters.insert("vs_m_s".into(), share * scales.velocity_m_s);
            let score = tangent.score(&spec)?;
            let more = (RISE * score.scale).clamp(0.1 * RISE, 20.0);
            spec.effects[index].parameters.insert("fs_n".into(), (1.0 + more) * constant);
            (score.scale > 0.0).then_some((score.nats, spec))
        });
        let (nats, spec) = scored.into_iter().flatten().max_by(|a, b| a.0.total_cmp(&b.0))?;
        if nats < FALLING {
            return None;
        }
        trial::respond(measured, &with_last(best, spec, scales)?, None, FURTHER_ON)
    }

    /// Coulomb's friction beside a Stribeck's that does best, from where that has the model's own numbers: its own fit may have stopped
    /// short of a place that the richer one reached, and stand behind for that alone.
    pub(super) fn level(
        &self,
        measured: &Measured<'_>,
        best: Option<&Trial>,
        scales: &Scales,
    ) -> Option<Trial> {
        let best = best.filter(|best| verdict::last_name(best) == "stribeck-friction")?;
        self.candidates(&best.refit.spec).iter().find(|effect| effect.name == "coulomb-friction")?;
        let mut spec = best.refit.spec.clone();
        let effect = spec.effects.last_mut()?;
        let [constant, most, over] =
            ["fc_n", "fs_n", "vs_m_s"].map(|name| effect.parameters.get(name).copied());
        let falls = (-(scales.velocity_m_s / over?).powi(2)).exp();
        effect.name = "coulomb-friction".into();
        effect.parameters = [("fc_n".into(), constant? + (most? - constant?) * falls)].into_iter().collect();
        trial::respond(measured, &with_last(best, spec, scales)?, None, FURTHER_ON)
    }

    /// Coulomb's friction that turns round smoothly beside one that sticks, where friction does best: Stribeck's makes up for it with a
    /// damping that is off.
    pub(super) fn turning(
        &self,
        measured: &Measured<'_>,
        finalists: &[Trial],
        scales: &Scales,
    ) -> Option<Trial> {
        let first = verdict::last_name(finalists.first()?);
        let sticking = finalists
            .iter()
            .find(|trial| is_sticking(trial))
            .filter(|_| matches!(first.as_str(), "coulomb-friction" | "stribeck-friction"))?;
        let (index, laid) = (sticking.refit.spec.effects.len() - 1, &sticking.response.as_ref()?.training);
        let tangent = measured.tangent(&sticking.refit.spec, &sticking.refit.numbers, laid)?;
        let scored = parallel::map(&TURNS, parallel::cores(), |share| {
            let mut spec = sticking.refit.spec.clone();
            spec.effects[index].parameters.insert(TURNING.into(), share * scales.velocity_m_s);
            let score = tangent.score(&spec)?;
            (score.scale > 0.0).then_some((score.nats, spec))
        });
        let (nats, spec) = scored.into_iter().flatten().max_by(|a, b| a.0.total_cmp(&b.0))?;
        if nats < FALLING {
            return None;
        }
        trial::respond(measured, &with_last(sticking, spec, scales)?, None, FURTHER_ON)
    }
}

/// A model fitted in short: what is left, and where it ended.
pub(super) fn in_short(some: &Measured<'_>, start: &Trial) -> Option<(f64, Trial)> {
    let (numbers, laid) = trial::fit_response(some, start, None, SORTED_OUT, Until::default())?;
    let mut ended = start.clone();
    numbers.put(&laid.values, &mut ended.refit.spec);
    Some((laid.total(), ended))
}

/// Puts what is made of each trial in its place, where anything is.
fn replace_where_told(trials: &mut [Trial], made: impl Fn(&Trial) -> Option<Trial> + Sync) {
    let made = parallel::map(trials, parallel::cores(), made);
    for (of, made) in trials.iter_mut().zip(made) {
        if let Some(made) = made {
            *of = made;
        }
    }
}

/// Coulomb's friction that sticks, added last.
fn is_sticking(trial: &Trial) -> bool {
    let turns = trial.refit.spec.effects.last().is_some_and(|last| last.parameters.contains_key(TURNING));
    verdict::last_name(trial) == "coulomb-friction" && !turns
}

/// A trial whose friction, Coulomb's or Stribeck's, added last, is to be one of Coulomb's that turns round over such a velocity.
fn turned(trial: &Trial, over_m_s: f64, scales: &Scales) -> Option<Trial> {
    let mut spec = trial.refit.spec.clone();
    let effect = spec.effects.last_mut()?;
    let constant = *effect.parameters.get("fc_n")?;
    effect.name = "coulomb-friction".into();
    effect.parameters = [("fc_n".into(), constant), (TURNING.into(), over_m_s)].into_iter().collect();
    with_last(trial, spec, scales)
}

/// A trial whose model differs in its last effect, which may be another one; its numbers are to be fitted as the model has them.
fn with_last(from: &Trial, spec: ModelSpec, scales: &Scales) -> Option<Trial> {
    let index = spec.effects.len().checked_sub(1)?;
    let mut trial = from.clone();
    trial.names.last_mut()?.clone_from(&spec.effects[index].name);
    Some(with_effect(trial, spec, index, scales))
}

/// The same of the numbers of one of its effects.
pub(super) fn with_effect(mut trial: Trial, spec: ModelSpec, index: usize, scales: &Scales) -> Trial {
    let own = format!("effect[{index}].");
    trial.refit.numbers.retain(|key| !key.starts_with(&own));
    trial.refit.numbers.add_effect(&spec, index, scales);
    trial.refit.spec = spec;
    trial
}

/// A trial in which the shape of its last effect is fitted, too; none where it has none.
fn with_shape(trial: &Trial, scales: &Scales) -> Option<Trial> {
    with_shape_of(trial, trial.refit.spec.effects.len().checked_sub(1)?, scales)
}

/// The same of one of its effects; none where it was fitted before another came.
fn with_shape_of(trial: &Trial, index: usize, scales: &Scales) -> Option<Trial> {
    let mut spec = trial.refit.spec.clone();
    let is_last = index + 1 == spec.effects.len();
    let of = spec.effects.get_mut(index)?;
    let shapes = candidates::shapes(&of.name).iter().filter_map(|shape| Some((shape.name, shape.limits?)));
    let shapes: Vec<(&str, (f64, f64))> = shapes.collect();
    let is_fitted = !is_last && shapes.iter().all(|(name, _)| of.parameters.contains_key(*name));
    // One whose loading shape is fitted has its own already; sharper, it would grow without bounds.
    if shapes.is_empty() || of.parameters.contains_key("beta") || is_fitted {
        return None;
    }
    let effect = effects::find(&of.name).ok()?;
    for (name, _) in &shapes {
        let default = (effect.parameters)(scales).iter().find(|p| p.name == *name)?.default?;
        of.parameters.entry((*name).to_owned()).or_insert(default);
    }
    let mut shaped = with_effect(trial.clone(), spec, index, scales);
    for (name, limits) in shapes {
        bound(&mut shaped.refit, &format!("effect[{index}].{name}"), limits);
    }
    Some(shaped)
}

/// The same with the shape that a fit is to begin from when that of the default led nowhere.
fn with_other_shape(shaped: &Trial) -> Option<Trial> {
    let mut other = shaped.clone();
    let last = other.refit.spec.effects.last_mut()?;
    let known = last.name.clone();
    for shape in candidates::shapes(&known) {
        let start = last.parameters.get_mut(shape.name).zip(shape.other);
        start.into_iter().for_each(|(value, other)| *value = other);
    }
    Some(other)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::adding::add;
    use crate::diagnose::report::NamedEffect;
    use crate::diagnose::search::Effort;
    use crate::diagnose::testing::{among, imposed, seen, with};
    use crate::diagnose::{Options, Verdict, diagnose};
    use crate::identify::kinematics::Tolerances;
    use crate::identify::motion::Motion;
    use crate::model::EffectSpec;
    use crate::model::testing::{b1_g2, effect};
    use crate::record::Record;

    #[test]
    fn coulombs_friction_goes_on_from_where_stribecks_ended() {
        let mut truth = b1_g2();
        truth.effects.push(effect("coulomb-friction", &[("fc_n", 12.0)]));
        let motion = Motion::of(&seen(&truth, 35), 500.0, Tolerances::default()).expect("a motion");
        let searcher = Searcher::new(&motion, &b1_g2(), Effort::default());
        let (base, measured) =
            (searcher.base(&b1_g2()).expect("fits"), searcher.measured.as_ref().expect("seen"));
        let scales = candidates::scales(&base.refit.spec, &motion);
        let beside = |name: &str, of: &[(&str, f64)]| with(&searcher, &base, &[effect(name, of)], FURTHER_ON);
        let whole = beside("stribeck-friction", &[("fc_n", 8.0), ("fs_n", 14.0), ("vs_m_s", 0.02)]);
        let own = beside("coulomb-friction", &[("fc_n", 8.0)]);
        let level = searcher.level(measured, Some(&whole), &scales).expect("Coulomb's");
        assert_eq!(level.names, ["coulomb-friction"]);
        assert!(verdict::apart(&level, &own) > -1.0, "{}", verdict::apart(&level, &own));
        let friction_n = level.refit.spec.effects[0].parameters["fc_n"];
        assert!((friction_n - 12.0).abs() < 1.0, "{friction_n}");
        // Of what is Coulomb's already there is nothing to do, nor where it is left out.
        assert!(searcher.level(measured, Some(&own), &scales).is_none());
        let without = Searcher::new(&motion, &b1_g2(), Effort::default()).without(&["coulomb-friction"]);
        assert!(without.level(measured, Some(&whole), &scales).is_none());
    }

    #[test]
    #[ignore = "minutes: `./test blind`"]
    fn friction_that_turns_round_smoothly_is_no_stribeck_friction() {
        let mut truth = b1_g2();
        truth.isolator.damping_n_s_m = 1180.0;
        truth.effects.push(effect("coulomb-friction", &[("fc_n", 12.0), (TURNING, 1e-3)]));
        let mut record = seen(&truth, 31);
        record.table_displacement_m.clear();
        let options = among(&["coulomb-friction", "stribeck-friction", "quadratic-damping"]);
        let found = diagnose(&record, &b1_g2(), &options).expect("a sound record");
        let names: Vec<&str> = found.effects.iter().map(|e| e.name.as_str()).collect();
        assert_eq!((found.verdict, names), (Verdict::Missing, vec!["coulomb-friction"]));
        let told = &found.effects[0].parameters;
        let within = |name: &str, truth: f64| {
            let told = &told[name];
            (told.value - truth).abs() < 0.7 * (told.high95 - told.low95) && told.high95 < 1.5 * truth
        };
        assert!(within("fc_n", 12.0) && within(TURNING, 1e-3), "{told:?}");
        // So it is written to a model, and said.
        let added =
            add(&record, &b1_g2(), &effect("coulomb-friction", &[("fc_n", 5.0)]), &[]).expect("fitted");
        let over = added.parameters.iter().find(|p| p.key == format!("effect[0].{TURNING}")).expect("said");
        assert_eq!((over.nominal, Some(&over.value)), (0.0, added.model.effects[0].parameters.get(TURNING)));
    }

    /// The force that a motion imposed on a specimen with such an effect takes, and the effects that are named on it.
    fn named_of_a_component(of: EffectSpec) -> (Record, Vec<NamedEffect>) {
        let mut truth = b1_g2();
        truth.isolator.damping_n_s_m *= 1.05;
        truth.effects.push(of);
        let record = imposed(&truth, 51);
        let found = diagnose(&record, &b1_g2(), &Options::default()).expect("a sound record");
        (record, found.effects)
    }

    #[test]
    fn the_friction_of_a_component_turns_round_over_a_velocity_that_shows() {
        for over_m_s in [0.0, 0.01] {
            let truth = effect("coulomb-friction", &[("fc_n", 60.0), (TURNING, over_m_s)]);
            let (record, found) = named_of_a_component(truth);
            let names: Vec<&str> = found.iter().map(|of| of.name.as_str()).collect();
            assert_eq!(names, ["coulomb-friction"], "{over_m_s}");
            let told = found[0].parameters.get(TURNING).map_or(0.0, |told| told.value);
            assert!((told - over_m_s).abs() < 1e-3, "{told} {over_m_s}");
            // It does so when it is added, too.
            let added = add(&record, &b1_g2(), &effect("coulomb-friction", &[("fc_n", 20.0)]), &[]);
            let [friction] = &added.expect("fits").model.effects[..] else { panic!("one effect") };
            let over = friction.parameters.get(TURNING).copied().unwrap_or(0.0);
            assert!((over - told).abs() < 1e-5, "{over} {told}");
        }
    }

    #[test]
    fn a_stand_is_named_where_a_bumper_alone_is_pressed() {
        let stand = [("ks_n_m", 1e5), ("ms_kg", 3.0), ("zeta", 0.05)];
        let (_, found) = named_of_a_component(effect("stand-compliance", &stand));
        let names: Vec<&str> = found.iter().map(|of| of.name.as_str()).collect();
        assert_eq!(names, ["stand-compliance"]);
        let told = found[0].parameters["ks_n_m"].value;
        assert!((told / 1e5 - 1.0).abs() < 0.05, "{told}");
    }

    #[test]
    #[ignore = "minutes: `./test blind`"]
    fn limits_hold_although_a_shape_was_left_out() {
        let mut truth = b1_g2();
        let shape = [("kh_n_m", 1400.0), ("dy_m", 7e-4), ("n", 1.45), ("beta", 0.67), ("gamma", 0.33)];
        truth.effects.push(effect("bouc-wen-hysteresis", &shape));
        let mut record = seen(&truth, 33);
        record.table_displacement_m.clear();
        let options = among(&["bouc-wen-hysteresis", "coulomb-friction"]);
        let found = diagnose(&record, &b1_g2(), &options).expect("a sound record");
        let names: Vec<&str> = found.effects.iter().map(|e| e.name.as_str()).collect();
        assert_eq!(names, ["bouc-wen-hysteresis"]);
        let told = &found.effects[0].parameters;
        assert!(!told.contains_key("n"), "this record tells the shape: {told:?}");
        for (name, truth) in &shape[..2] {
            let told = &told[*name];
            assert!((told.low95..told.high95).contains(truth), "{name}: {told:?}");
        }
    }
}
