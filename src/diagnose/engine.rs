//! The whole diagnosis of one record: instruments, re-identification, search, verdict.

use super::answer::Composer;
use super::instruments::{self, Finding};
use super::report::Diagnosis;
use super::search::{Effort, Searcher};
use super::thresholds::Thresholds;
use super::verdict::{self, Verdict};
use super::{late, parts};
use crate::identify::kinematics::Tolerances;
use crate::identify::motion::{Motion, MotionError};
use crate::identify::together::{Setting, TogetherError};
use crate::identify::{force_on_time, readied};
use crate::model::{ModelError, ModelSpec};
use crate::record::{Record, quality};
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
    let records: Vec<_> = tests.iter().map(|(record, _)| readied(record)).collect();
    let tests: Vec<(&Record, &ModelSpec)> =
        records.iter().zip(tests).map(|(record, (_, model))| (&**record, *model)).collect();
    let mut out = of_records(&tests, options, &vec![0.0; tests.len()], ON_TIME)?;
    out.wall_s = begun.elapsed().as_secs_f64();
    Ok(out)
}

/// Diagnoses records that are ready for it, whose forces were put on time by so much each, s.
fn of_records(
    tests: &[(&Record, &ModelSpec)],
    options: &Options,
    late_s: &[f64],
    on_time: usize,
) -> Result<Diagnosis, DiagnoseError> {
    let Some((_, nominal)) = tests.first() else {
        return Err(MotionError::TooShort { samples: 0, needed: 1 }.into());
    };
    let mut motions = Vec::with_capacity(tests.len());
    let mut findings: Vec<(usize, Finding)> = Vec::new();
    let mut notes: Vec<String> = Vec::new();
    for (i, (record, model)) in tests.iter().enumerate() {
        crate::model::build(model, 1.0 / record.sample_rate_hz)?;
        notes.extend(of_record(record, options.anyway)?);
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
    notes.extend(late::taken_back(late_s, motion.dt_s()));
    parts::done("fitness, instruments, motion");
    let out = of_motion(
        (tests, nominal),
        options,
        motion,
        (findings, notes),
        Again { late_s, on_time, noise: QUIETER },
    )?;
    parts::done("errors, missing force");
    Ok(out)
}

/// So many times at most a force is put on time, and where that is left to what explains the record.
const ON_TIME: usize = 4;
const BY_EXPLANATION: usize = 1;
/// So many times at most the noise is taken to be what a diagnosis leaves, or a drift taken out.
const QUIETER: usize = 2;

/// What a diagnosis may do again.
#[derive(Clone, Copy)]
struct Again<'a> {
    /// By how much the force of each record has been put on time, s.
    late_s: &'a [f64],
    /// So many times more it may be.
    on_time: usize,
    /// So many times more the noise may be told anew.
    noise: usize,
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
        of_records(&prompt, options, &late_s, self.on_time - 1)
    }
}

/// Diagnoses the motion of the tests; once more with the noise that is left, where that is less than the record showed.
fn of_motion(
    (tests, nominal): (&[(&Record, &ModelSpec)], &ModelSpec),
    options: &Options,
    motion: Motion,
    (mut findings, mut notes): (Vec<(usize, Finding)>, Vec<String>),
    again: Again<'_>,
) -> Result<Diagnosis, DiagnoseError> {
    let searcher = Searcher::new(&motion, nominal, options.effort).without(&options.without);
    parts::done("weights");
    let diverges = || DiagnoseError::Diverges { name: nominal.name.clone() };
    let base = searcher.base(nominal).ok_or_else(diverges)?;
    parts::done("base model");
    let is_moved = again.late_s.iter().any(|late_s| *late_s != 0.0);
    let much = if is_moved { late::SPOKEN_OF } else { late::MUCH };
    if again.on_time > BY_EXPLANATION
        && let Some(lags) = late::of_forces(&searcher, &base, much)
    {
        return again.put_on_time(tests, options, &lags);
    }
    let search = searcher.search(base, options.thresholds);
    let mut decision = verdict::decide(&search, &searcher, options.thresholds);
    let less = Again { noise: again.noise.saturating_sub(1), ..again };
    if again.noise > 0
        && let Some((steadier, drift)) = searcher.steadier(search.best())
    {
        notes.push(format!(
            "the force drifts by {:.2} % of its rms over the record: taken out",
            100.0 * drift
        ));
        return of_motion((tests, nominal), options, steadier, (findings, notes), less);
    }
    if again.noise > 0
        && let Some(quieter) = searcher.quieter(&decision.chosen)
    {
        return of_motion((tests, nominal), options, quieter, (findings, notes), less);
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

/// What is to be said of a record; refuses one that is not fit before any physics is blamed, unless it is to be used anyway.
fn of_record(record: &Record, anyway: bool) -> Result<Vec<String>, DiagnoseError> {
    let text = |finding: quality::Finding| finding.text;
    let (errors, rest): (Vec<_>, Vec<_>) = quality::examine(record)
        .into_iter()
        .partition(|finding| !anyway && finding.severity == quality::Severity::Error);
    if !errors.is_empty() {
        let faults: Vec<String> = errors.into_iter().map(text).collect();
        return Err(DiagnoseError::Unfit { record: record.source.clone(), faults: faults.join("; ") });
    }
    let new = rest.into_iter().map(text).filter(|text| !record.notes.contains(text));
    Ok(record.notes.iter().cloned().chain(new).collect())
}
