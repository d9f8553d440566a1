//! The whole diagnosis of one record: instruments, re-identification, search, verdict.

use super::anew::clear;
use super::answer::{self, Composer};
use super::instruments::{self, Finding};
use super::late_force::{self, Lagging};
use super::report::Diagnosis;
use super::search::{Effort, Otherwise, Searcher, Stage};
use super::thresholds::Thresholds;
use super::trial::Trial;
use super::verdict::{self, Verdict};
use super::{late, parts};
use crate::compare::quality;
use crate::identify::kinematics::Tolerances;
use crate::identify::motion::{Motion, MotionError};
use crate::identify::together::{Setting, TogetherError};
use crate::identify::{answered, force_on_time, holding, in_its_band};
use crate::model::{ModelError, ModelSpec};
use crate::record::mended::mended;
use crate::record::quality::Severity;
use crate::record::{Kind, Record};
use std::time::Instant;

/// How a diagnosis is done.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Tolerances of the instruments.
    pub tolerances: Tolerances,
    /// Effort of the search.
    pub effort: Effort,
    /// Thresholds of the verdict.
    pub thresholds: Thresholds,
    /// What the rig can do; defaults to the paper's table.
    pub reach: Option<(f64, f64, f64)>,
    /// Diagnose a record that is not fit for it all the same.
    pub anyway: bool,
    /// Effects that are not tried: what the user knows not to be there.
    pub without: Vec<&'static str>,
}

/// Why a record cannot be diagnosed.
#[derive(Debug, thiserror::Error)]
pub enum DiagnoseError {
    /// The record does not hold what its kind needs.
    #[error(transparent)]
    Motion(#[from] MotionError),
    /// The record itself is at fault: no verdict on a model could be trusted.
    #[error("the record `{record}` is not fit to judge a model by: {faults}")]
    Unfit {
        /// Name of the record.
        record: String,
        /// What is wrong with it.
        faults: String,
    },
    /// The records do not belong together.
    #[error(transparent)]
    Together(#[from] TogetherError),
    /// The model cannot be built.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The model as given cannot follow the record at all.
    #[error("the model `{name}` gives no finite response to this record")]
    Diverges {
        /// Name of the model.
        name: String,
    },
}

/// Diagnoses a record against a model.
///
/// # Errors
/// A record that lacks a channel or is not fit to judge a model by, a model that cannot be built or follows nothing.
pub fn diagnose(record: &Record, nominal: &ModelSpec, options: &Options) -> Result<Diagnosis, DiagnoseError> {
    diagnose_together(&[(record, nominal)], options)
}

/// Diagnoses several records of one specimen as one; their models may differ in gap and bumpers alone, and the first
/// record is one with bumpers, if any is.
///
/// # Errors
/// As of [`diagnose`]; records that do not belong together; none.
pub fn diagnose_together(
    tests: &[(&Record, &ModelSpec)],
    options: &Options,
) -> Result<Diagnosis, DiagnoseError> {
    let begun = Instant::now();
    let records: Vec<_> = tests.iter().map(|(record, _)| mended(record)).collect();
    // As they were recorded: at the rate of its band a channel that is cut off is smooth.
    let said = records.iter().zip(tests).map(|(record, (_, model))| fitness(record, model, options.anyway));
    let said = said.collect::<Result<Vec<_>, _>>()?.concat();
    let records: Vec<_> = records.into_iter().map(in_its_band).collect();
    let all = || records.iter().map(|record| &**record);
    let models: Vec<_> = tests.iter().map(|(_, model)| holding(model, all())).collect();
    let tests: Vec<(&Record, &ModelSpec)> =
        records.iter().zip(&models).map(|(record, model)| (&**record, &**model)).collect();
    let late_s = vec![0.0; tests.len()];
    let again =
        Again { said: &said, late_s: &late_s, late: None, on_time: ON_TIME, noise: QUIETER, found: &[] };
    let mut out = of_records(&tests, options, again)?;
    out.wall_s = begun.elapsed().as_secs_f64();
    Ok(out)
}

/// Diagnoses records that are ready for it, whose forces were put on time by so much each, s.
fn of_records(
    tests: &[(&Record, &ModelSpec)],
    options: &Options,
    again: Again<'_>,
) -> Result<Diagnosis, DiagnoseError> {
    let Some((_, nominal)) = tests.first() else {
        return Err(MotionError::TooShort { samples: 0, needed: 1 }.into());
    };
    let mut motions = Vec::with_capacity(tests.len());
    let mut findings: Vec<(usize, Finding)> = Vec::new();
    let mut notes: Vec<String> = tests.iter().flat_map(|(record, _)| record.notes.clone()).collect();
    let new: Vec<_> = again.said.iter().filter(|text| !notes.contains(text)).cloned().collect();
    notes.extend(new);
    for (i, (record, model)) in tests.iter().enumerate() {
        crate::model::build(model, 1.0 / record.sample_rate_hz)?;
        let motion = Motion::of(record, model.mass_kg, options.tolerances)?;
        let judged = |found| instruments::judge(found, record, options.tolerances);
        for finding in motion.instruments.as_ref().map(judged).unwrap_or_default() {
            if !findings.iter().any(|(_, known)| known.name == finding.name) {
                findings.push((i, finding));
            }
        }
        motions.push((motion, Setting::between(nominal, model)?));
    }
    let motion = Motion::together(motions)?;
    notes.extend(late::taken_back(again.late_s, motion.dt_s()));
    parts::done("fitness, instruments, motion");
    let out = of_motion((tests, nominal), options, motion, (findings, notes), again)?;
    parts::done("errors, missing force");
    Ok(out)
}

/// So many times at most a force is put on time, and where that is left to what explains the record.
const ON_TIME: usize = 4;
const BY_EXPLANATION: usize = 1;
/// Share of the base model's error that putting a force on time may leave, at most, where it is done before anything else is tried: what
/// friction does to an axis passes for a lag of some samples, and leaves nearly all of it.
const LEFT_ON_TIME: f64 = 0.7;
/// Error over the noise floor of a component whose force was put on time, at most, where noise was all that was left with that.
const KEPT: f64 = 1.5;
/// So many times at most the noise is taken to be what a diagnosis leaves, or a drift or a hum taken out.
const QUIETER: usize = 2;

/// What a diagnosis may do again.
#[derive(Clone, Copy)]
struct Again<'a> {
    /// What was said of the records as they were recorded.
    said: &'a [String],
    /// By how much the force of each record has been put on time, s.
    late_s: &'a [f64],
    /// Error of the base model on the records as they came, where their forces were put on time by what it says.
    late: Option<f64>,
    /// So many times more it may be.
    on_time: usize,
    /// So many times more the noise may be told anew.
    noise: usize,
    /// What the search before found on the same motion, seen with more noise.
    found: &'a [Stage],
}

impl Again<'_> {
    /// Diagnoses the records with their forces put on time by lags of what answers them, s.
    fn put_on_time(
        self,
        tests: &[(&Record, &ModelSpec)],
        options: &Options,
        lags_s: &[f64],
    ) -> Result<Diagnosis, DiagnoseError> {
        let records: Vec<Record> =
            tests.iter().zip(lags_s).map(|((record, _), lag_s)| force_on_time(record, -lag_s)).collect();
        let prompt: Vec<_> = records.iter().zip(tests).map(|(record, (_, model))| (record, *model)).collect();
        let late_s: Vec<f64> = self.late_s.iter().zip(lags_s).map(|(late_s, lag_s)| late_s - lag_s).collect();
        of_records(
            &prompt,
            options,
            Again { late_s: &late_s, on_time: self.on_time - 1, noise: QUIETER, found: &[], ..self },
        )
    }
}

/// Diagnoses the motion of the tests; once more with the noise that is left, where that is less than the record showed.
fn of_motion(
    (tests, nominal): (&[(&Record, &ModelSpec)], &ModelSpec),
    options: &Options,
    motion: Motion,
    (mut findings, notes): (Vec<(usize, Finding)>, Vec<String>),
    again: Again<'_>,
) -> Result<Diagnosis, DiagnoseError> {
    let searcher = Searcher::new(&motion, nominal, options.effort).without(&options.without);
    parts::done("weights");
    let diverges = || DiagnoseError::Diverges { name: nominal.name.clone() };
    let base = searcher.base(nominal).ok_or_else(diverges)?;
    parts::done("base model");
    let is_moved = again.late_s.iter().any(|late_s| *late_s != 0.0);
    if !is_moved && again.noise == QUIETER {
        answer::astray(&base.refit).iter().for_each(|text| parts::so_far(text));
    }
    let error = || searcher.held_out_error(&base).map(|error| error.nrmse());
    let much = if is_moved { late::SPOKEN_OF } else { late::MUCH };
    if again.on_time > BY_EXPLANATION
        && let Some(lags) = late::of_forces(&searcher, &base, much)
    {
        let late = again.late.or_else(error);
        return Again { late, ..again }.put_on_time(tests, options, &lags);
    }
    let leaves_most = |late| error().is_some_and(|error| error > LEFT_ON_TIME * late);
    if again.late.is_some_and(leaves_most) {
        let by_explanation = Again { on_time: BY_EXPLANATION + 1, late: None, ..again };
        return by_explanation.put_on_time(tests, options, again.late_s);
    }
    let hum = |trial: &Trial| {
        let (motion, said) = (again.noise > 0).then(|| searcher.without_hum(trial)).flatten()?;
        Some(Otherwise { motion, said, quieter: false })
    };
    let anew = |otherwise: Otherwise, found: &[Stage], findings, notes: Vec<String>| {
        let Otherwise { motion, said, quieter } = otherwise;
        let noise = again.noise.saturating_sub(1);
        let again = Again { noise, found: if quieter { found } else { &[] }, ..again };
        of_motion((tests, nominal), options, motion, (findings, [notes, said].concat()), again)
    };
    if let Some(without) = hum(&base) {
        return anew(without, &[], findings, notes);
    }
    // A component's force is put on time once.
    let first =
        (motion.kind == Kind::Component && !is_moved && again.on_time > 0).then(|| searcher.stage(&base));
    let lagging = first
        .as_ref()
        .and_then(|first| late_force::of_component(&searcher, nominal, (&base, first), options.thresholds));
    let put_on_time = |lagging: &Lagging| {
        let notes = [notes.clone(), vec![late::said_of_component(lagging.late_s)]].concat();
        let again = Again { on_time: 0, noise: QUIETER, found: &[], ..again };
        let motion = answered(&motion, lagging.late_s);
        of_motion((tests, nominal), options, motion, (findings.clone(), notes), again)
    };
    if let Some(lagging) = lagging.as_ref().filter(|lagging| lagging.explains) {
        let prompt = put_on_time(lagging)?;
        if prompt.error_after < KEPT * prompt.noise_floor {
            return Ok(prompt);
        }
    }
    let quieter = |trial: &Trial| {
        let motion = (again.noise > 0).then(|| searcher.quieter(trial)).flatten()?;
        Some(Otherwise { motion, said: Vec::new(), quieter: true })
    };
    let steadier = |trial: &Trial| {
        let (motion, drift) = (again.noise > 0).then(|| searcher.steadier(trial)).flatten()?;
        let said =
            format!("the force drifts by {:.2} % of its rms over the record: taken out", 100.0 * drift);
        Some(Otherwise { motion, said: vec![said], quieter: false })
    };
    let otherwise = |trial: &Trial| steadier(trial).or_else(|| hum(trial)).or_else(|| quieter(trial));
    let tried = match first {
        Some(first) => vec![first],
        None => searcher.taken_over(again.found, &base),
    };
    let mut search = searcher.search_from((base, tried), options.thresholds, otherwise);
    if let Some(otherwise) = search.otherwise.take() {
        parts::done("noise told anew");
        return anew(otherwise, clear(&search), findings, notes);
    }
    let decision = verdict::decide(&search, &searcher, options.thresholds);
    let decision = searcher.reconsidered(decision, &search.base, options.thresholds);
    let mut decision = searcher.by_law(&search, decision, options.thresholds);
    parts::done("verdict and laws");
    if let Some(lagging) = lagging.filter(|lagging| lagging.is_rather_than(&decision.chosen)) {
        let prompt = put_on_time(&lagging)?;
        let before = searcher.held_out_error(&decision.chosen).map(|error| error.nrmse());
        if before.is_none_or(|before| prompt.error_after < before) {
            return Ok(prompt);
        }
    }
    // With less noise what stays unexplained only stands out more.
    let less_noise = || {
        let holds = decision.verdict != Verdict::OutsideCatalogue;
        holds.then(|| quieter(&decision.chosen)).flatten()
    };
    let at_last = steadier(search.best()).or_else(|| hum(&decision.chosen)).or_else(less_noise);
    if let Some(otherwise) = at_last {
        return anew(otherwise, clear(&search), findings, notes);
    }
    // Of an explanation that does not hold no numbers are told.
    if decision.verdict != Verdict::OutsideCatalogue {
        decision.chosen = searcher.bounded(decision.chosen);
    }
    parts::done("verdict and limits");
    let gains = searcher.gains(&decision.chosen);
    for (i, finding) in &mut findings {
        gains.get(*i).copied().into_iter().for_each(|gains| finding.sharpen(gains));
    }
    let findings: Vec<Finding> = findings.into_iter().map(|(_, finding)| finding).collect();
    let lags = late::of_forces(&searcher, &decision.chosen, late::SPOKEN_OF).filter(|_| again.on_time > 0);
    let found = Composer { tests, nominal, options, motion: &motion, searcher: &searcher }
        .compose(&search, decision, &findings, notes)
        .ok_or_else(diverges)?;
    let Some(lags) = lags else { return Ok(found) };
    let prompt = again.put_on_time(tests, options, &lags).ok();
    Ok(prompt.filter(|prompt| prompt.error_after < found.error_after).unwrap_or(found))
}

/// What is to be said of a record as it was recorded, its faults mended; refuses one that is not fit before any physics is blamed, unless
/// it is to be used anyway.
///
/// # Errors
/// [`DiagnoseError::Unfit`] with what is wrong.
pub fn fitness(record: &Record, model: &ModelSpec, anyway: bool) -> Result<Vec<String>, DiagnoseError> {
    let text = |finding: crate::record::quality::Finding| finding.text;
    let (errors, rest): (Vec<_>, Vec<_>) = quality(record, model)
        .into_iter()
        .partition(|finding| !anyway && finding.severity == Severity::Error);
    if !errors.is_empty() {
        let faults: Vec<String> = errors.into_iter().map(text).collect();
        return Err(DiagnoseError::Unfit { record: record.source.clone(), faults: faults.join("; ") });
    }
    Ok(rest.into_iter().map(text).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::testing::oscillator;
    use rand::{SeedableRng, prelude::Distribution};

    #[test]
    fn a_channel_that_was_cut_off_is_refused_at_any_rate() {
        // A motion of a band that ends steeply, as one that was low-passed, cut off at two and a half of its deviations.
        const RATE_HZ: f64 = 2000.0;
        const HALF: usize = 50;
        let mut random = rand_pcg::Pcg64::seed_from_u64(2);
        let noise: Vec<f64> =
            (0..40_000 + 2 * HALF).map(|_| rand_distr::StandardNormal.sample(&mut random)).collect();
        let taps: Vec<f64> = (0..=2 * HALF)
            .map(|k| {
                let (from, turn) = (k as f64 - HALF as f64, std::f64::consts::PI * k as f64 / HALF as f64);
                let sinc = match from {
                    0.0 => 1.0,
                    from => (0.4 * std::f64::consts::PI * from).sin() / (0.4 * std::f64::consts::PI * from),
                };
                0.4 * sinc * (0.42 - 0.5 * turn.cos() + 0.08 * (2.0 * turn).cos())
            })
            .collect();
        let a: Vec<f64> = noise
            .windows(taps.len())
            .map(|noise| noise.iter().zip(&taps).map(|(noise, tap)| noise * tap).sum())
            .collect();
        let rms = (a.iter().map(|a| a * a).sum::<f64>() / a.len() as f64).sqrt();
        let record = Record {
            time_s: (0..a.len()).map(|i| i as f64 / RATE_HZ).collect(),
            // Of another course: with what drives it the motion may end.
            force_n: a.iter().rev().map(|a| 2.0 * a).collect(),
            acceleration_m_s2: a.iter().map(|a| a.clamp(-2.5 * rms, 2.5 * rms)).collect(),
            ..Record::empty("cut off", Kind::Force, RATE_HZ)
        };
        assert!(in_its_band(std::borrow::Cow::Borrowed(&record)).sample_rate_hz < RATE_HZ);
        let refused = diagnose(&record, &oscillator(2.0, 2000.0, 8.0), &Options::default());
        assert!(matches!(&refused, Err(DiagnoseError::Unfit { faults, .. }) if faults.contains("saturated")));
    }
}
