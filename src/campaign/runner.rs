//! Runs the cases of a campaign: those without a result, in parallel where the rig is simulated, one by one
//! in the order of the file where it is real.
//!
//! `campaign run` calls it. A case is done when its result stands in the folder; a run that was finished but
//! whose result was not written any more is taken over, one that was cut short is run again. An abort by
//! safety is a result.

use super::CampaignError;
use super::spec::{AfterAbort, CaseKey, Configuration};
use super::store::{CaseOutcome, CaseResult, Store, fingerprint};
use crate::control::session::Finished;
use crate::control::session::Pace;
use crate::control::setup::Setup;
use crate::control::{Ending, StepSummary};
use crate::record::folder::{self, RunState};
use crate::record::recorder::Notice;
use crate::record::{Manifest, RunFolder, steps_csv};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// What is run of a campaign, and how.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Options {
    /// Part i of n, from 1: the devices (pairs of bumper and gap) are dealt out in turn.
    pub shard: Option<(usize, usize)>,
    /// Runs at a time.
    pub jobs: usize,
    /// Run again what was aborted or left out.
    pub retry: bool,
    /// Only these cases; empty: all.
    pub only: Vec<String>,
}

/// What the operator answers when something has to be mounted or set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Ready.
    Go,
    /// Leave this case out.
    Skip,
    /// Start no further case.
    Quit,
}

/// What happens while a campaign runs.
#[derive(Clone, Debug)]
pub enum Progress {
    /// So many runs are to be made, after so many that had a result already.
    Planned {
        /// Runs to be made.
        runs: usize,
        /// Runs that had a result.
        there: usize,
        /// Steps of one run.
        steps: usize,
    },
    /// A run begins.
    Begins(String),
    /// A step of some run is over.
    Step,
    /// A run has its result: its name, how it ended, and steps that it did not make.
    Ends(String, String, usize),
    /// A run of a finished folder was taken over.
    Adopted(String),
}

/// Drives one run to its end below a folder.
pub type Drive<'a> =
    dyn Fn(&Setup, &Path, &mut dyn FnMut(&Notice)) -> Result<Finished, CampaignError> + Sync + 'a;
/// Asks the operator before a run whether all is mounted and set.
pub type Ask<'a> = dyn Fn(&CaseKey, &Configuration) -> Answer + Sync + 'a;

/// How a call of [`run`] ended.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Summary {
    /// Runs made by this call.
    pub ran: usize,
    /// Runs that had a result before.
    pub there: usize,
    /// Of all results in this part: aborted by safety.
    pub aborted: usize,
    /// Of all results in this part: left out.
    pub not_run: usize,
    /// Runs without a result still, and why where it is known.
    pub missing: Vec<String>,
}

/// One run of one case.
#[derive(Clone, Debug)]
struct Planned {
    case: CaseKey,
    repeat: u32,
}

struct Runner<'a> {
    configuration: &'a Configuration,
    store: &'a Store,
    options: &'a Options,
    drive: &'a Drive<'a>,
    ask: &'a Ask<'a>,
    tell: &'a (dyn Fn(Progress) + Sync),
    finished: BTreeMap<String, PathBuf>,
    /// Device and what was aborted there.
    aborted: Mutex<BTreeMap<String, (f64, String)>>,
    mounted: Mutex<Option<String>>,
    end: AtomicBool,
    missing: Mutex<Vec<String>>,
    ran: AtomicUsize,
    /// Of one run.
    steps: usize,
}

/// The set-up of one run.
pub fn setup_of(configuration: &Configuration, case: &CaseKey, repeat: u32) -> Setup {
    let mut sweep = configuration.sweep.clone();
    sweep.acceleration_g = case.acceleration_g;
    let name = Store::run_name(&case.label, repeat);
    // The case of the paper is named only where the numbers are the paper's.
    let of_paper = configuration.published_of(case).map(|row| row.case);
    Setup {
        rig: configuration.rig.clone(),
        sweep,
        model: configuration.model_of(case),
        specimen: configuration.specimen_of(case),
        case: of_paper,
        safety: None,
        seed: seed_of(configuration.spec.seed, &name),
        name,
    }
}

/// Seed of a run: from that of the campaign and the run's name, so that it depends on no order.
fn seed_of(seed: u64, name: &str) -> u64 {
    use sha2::Digest;
    let digest = sha2::Sha256::digest(format!("{seed}/{name}").as_bytes());
    // TOML integers are signed: the top half is left out.
    digest.iter().take(7).fold(0, |sum, byte| (sum << 8) | u64::from(*byte))
}

/// Runs what has no result yet.
///
/// # Errors
/// [`CampaignError`] when the folder cannot be used; a case that fails is named in [`Summary::missing`].
pub fn run(
    configuration: &Configuration,
    store: &Store,
    options: &Options,
    drive: &Drive<'_>,
    ask: &Ask<'_>,
    tell: &(dyn Fn(Progress) + Sync),
) -> Result<Summary, CampaignError> {
    store.prepare(configuration)?;
    let steps = configuration.sweep.forward_hz().map_or(0, |hz| hz.len());
    let ways =
        if configuration.sweep.direction == crate::sweep::SweepDirection::ForwardBackward { 2 } else { 1 };
    let runner = Runner {
        configuration,
        store,
        options,
        drive,
        ask,
        tell,
        finished: finished_runs(&store.runs()),
        aborted: Mutex::new(BTreeMap::new()),
        mounted: Mutex::new(None),
        end: AtomicBool::new(false),
        missing: Mutex::new(Vec::new()),
        ran: AtomicUsize::new(0),
        steps: steps * ways,
    };
    let all = runner.planned();
    let (open, there) = runner.open(&all)?;
    tell(Progress::Planned { runs: open.len(), there, steps: runner.steps });
    runner.work(&open);
    runner.summary(&all, there)
}

impl Runner<'_> {
    /// All runs of this part of the campaign, in order.
    fn planned(&self) -> Vec<Planned> {
        let mut devices: Vec<&str> = Vec::new();
        for case in &self.configuration.cases {
            if !devices.contains(&case.device.as_str()) {
                devices.push(&case.device);
            }
        }
        let mine = |device: &str| match self.options.shard {
            None => true,
            Some((part, parts)) => {
                devices.iter().position(|d| *d == device).is_some_and(|at| at % parts == part - 1)
            }
        };
        let wanted = |case: &&CaseKey| {
            mine(&case.device) && (self.options.only.is_empty() || self.options.only.contains(&case.label))
        };
        let cases = self.configuration.cases.iter().filter(wanted);
        cases
            .flat_map(|case| {
                (1..=self.configuration.spec.repeats).map(|repeat| Planned { case: case.clone(), repeat })
            })
            .collect()
    }

    /// Those without a valid result, and how many have one. Results of aborts set the stop rule.
    fn open(&self, all: &[Planned]) -> Result<(Vec<Planned>, usize), CampaignError> {
        let mut open = Vec::new();
        for planned in all {
            let there = self.store.result(&planned.case.label, planned.repeat)?;
            match there.filter(|result| self.is_valid(planned, result)) {
                Some(result) => self.remember(planned, &result),
                None => open.push(planned.clone()),
            }
        }
        let there = all.len() - open.len();
        Ok((open, there))
    }

    /// Whether a result is of today's configuration, and need not be tried again.
    fn is_valid(&self, planned: &Planned, result: &CaseResult) -> bool {
        let again = self.options.retry && result.outcome != CaseOutcome::Done;
        !again && self.manifest(planned).is_ok_and(|manifest| fingerprint(&manifest) == result.fingerprint)
    }

    fn manifest(&self, planned: &Planned) -> Result<Manifest, CampaignError> {
        let setup = setup_of(self.configuration, &planned.case, planned.repeat);
        setup
            .manifest(Pace::Virtual)
            .map_err(|source| CampaignError::Setup { case: planned.case.label.clone(), source })
    }

    fn remember(&self, planned: &Planned, result: &CaseResult) {
        if result.outcome == CaseOutcome::Aborted {
            let text = format!(
                "{} was {}",
                result.case,
                result.state().replacen("not run to its end", "aborted", 1)
            );
            let entry = (planned.case.acceleration_g, text);
            locked(&self.aborted).entry(planned.case.device.clone()).or_insert(entry);
        }
    }

    /// Works through the runs: a device is one unit where several work, so that the stop rule finds the lower
    /// accelerations done.
    fn work(&self, open: &[Planned]) {
        let jobs = if self.configuration.rig.hardware.is_some() { 1 } else { self.options.jobs.max(1) };
        let mut units: Vec<Vec<Planned>> = Vec::new();
        for planned in open {
            let same = |unit: &&mut Vec<Planned>| {
                jobs == 1 || unit.first().is_some_and(|first| first.case.device == planned.case.device)
            };
            match units.iter_mut().find(same) {
                Some(unit) => unit.push(planned.clone()),
                None => units.push(vec![planned.clone()]),
            }
        }
        // The longest first, so that none is left alone at the end.
        units.sort_by_key(|unit| std::cmp::Reverse(unit.len()));
        let next = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for _ in 0..jobs.min(units.len()) {
                scope.spawn(|| {
                    while let Some(unit) = units.get(next.fetch_add(1, Ordering::Relaxed)) {
                        for planned in unit {
                            self.one(planned);
                        }
                    }
                });
            }
        });
    }

    /// One run, whatever becomes of it.
    fn one(&self, planned: &Planned) {
        let name = Store::run_name(&planned.case.label, planned.repeat);
        let missed = |why: String| locked(&self.missing).push(format!("{name}: {why}"));
        if self.end.load(Ordering::Relaxed) {
            return missed("not started any more".to_owned());
        }
        match self.result_of(planned, &name) {
            Ok(Some(result)) => {
                let left = self.steps.saturating_sub(result.steps.len());
                self.remember(planned, &result);
                if result.outcome == CaseOutcome::Aborted
                    && self.configuration.spec.stop.after_abort == AfterAbort::End
                {
                    self.end.store(true, Ordering::Relaxed);
                }
                if let Err(error) = self.store.keep(&result) {
                    return missed(error.to_string());
                }
                (self.tell)(Progress::Ends(name, result.state(), left));
            }
            Ok(None) => {}
            Err(error) => missed(error.to_string()),
        }
    }

    /// The result of a run: left out, taken over, or driven now. `None` when it is not ours to make.
    fn result_of(&self, planned: &Planned, name: &str) -> Result<Option<CaseResult>, CampaignError> {
        let Some(_claim) = self.store.claim(&planned.case.label, planned.repeat)? else {
            locked(&self.missing).push(format!("{name}: another process is at work on it"));
            return Ok(None);
        };
        // Another process may have finished it since.
        if let Some(there) = self.store.result(&planned.case.label, planned.repeat)?
            && self.is_valid(planned, &there)
        {
            return Ok(Some(there));
        }
        let manifest = self.manifest(planned)?;
        let blank = CaseResult {
            seed: manifest.seed.unwrap_or(0),
            fingerprint: fingerprint(&manifest),
            ..CaseResult::empty(self.configuration, &planned.case, planned.repeat)
        };
        if let Some(why) = self.left_out(planned) {
            return Ok(Some(CaseResult { cause: Some(why), ..blank }));
        }
        if let Some(path) = self.finished.get(&blank.fingerprint).filter(|_| !self.options.retry)
            && let Some(result) = adopt(path, &blank)
        {
            (self.tell)(Progress::Adopted(name.to_owned()));
            result.steps.iter().for_each(|_| (self.tell)(Progress::Step));
            return Ok(Some(result));
        }
        match self.ready(planned) {
            Answer::Go => {}
            Answer::Skip => {
                return Ok(Some(CaseResult { cause: Some("left out by the operator".into()), ..blank }));
            }
            Answer::Quit => {
                self.end.store(true, Ordering::Relaxed);
                locked(&self.missing).push(format!("{name}: not started any more"));
                return Ok(None);
            }
        }
        self.driven(planned, name, blank).map(Some)
    }

    /// Why a case is left out by the stop rule.
    fn left_out(&self, planned: &Planned) -> Option<String> {
        if self.configuration.spec.stop.after_abort != AfterAbort::SkipHigher {
            return None;
        }
        let aborted = locked(&self.aborted);
        let (level, text) = aborted.get(&planned.case.device)?;
        (*level < planned.case.acceleration_g - 1e-9).then(|| text.clone())
    }

    /// Asks the operator when something else has to be mounted than before.
    fn ready(&self, planned: &Planned) -> Answer {
        let mut mounted = locked(&self.mounted);
        if mounted.as_deref() == Some(planned.case.device.as_str()) {
            return Answer::Go;
        }
        let answer = (self.ask)(&planned.case, self.configuration);
        if answer == Answer::Go {
            *mounted = Some(planned.case.device.clone());
        }
        answer
    }

    fn driven(&self, planned: &Planned, name: &str, blank: CaseResult) -> Result<CaseResult, CampaignError> {
        (self.tell)(Progress::Begins(name.to_owned()));
        let setup = setup_of(self.configuration, &planned.case, planned.repeat);
        let finished = (self.drive)(&setup, &self.store.runs(), &mut |notice| {
            if matches!(notice, Notice::Event(crate::control::Event::Step(_))) {
                (self.tell)(Progress::Step);
            }
        })?;
        self.ran.fetch_add(1, Ordering::Relaxed);
        let reason = || finished.manifest.cause.clone().unwrap_or_else(|| "the run failed".to_owned());
        match finished.ending {
            Ending::Done | Ending::Aborted => {
                let schedule = setup.schedule().ok();
                let at_hz = schedule
                    .and_then(|schedule| Some(schedule.steps().get(finished.steps.len())?.frequency_hz));
                Ok(filled(blank, &finished.manifest, finished.steps, at_hz))
            }
            Ending::Stopped => {
                Err(CampaignError::Run { case: name.to_owned(), reason: "stopped on request".into() })
            }
            Ending::Failed | Ending::Interrupted => {
                Err(CampaignError::Run { case: name.to_owned(), reason: reason() })
            }
        }
    }

    fn summary(&self, all: &[Planned], there: usize) -> Result<Summary, CampaignError> {
        let mut summary = Summary { ran: self.ran.load(Ordering::Relaxed), there, ..Summary::default() };
        for planned in all {
            match self.store.result(&planned.case.label, planned.repeat)?.map(|result| result.outcome) {
                Some(CaseOutcome::Aborted) => summary.aborted += 1,
                Some(CaseOutcome::NotRun) => summary.not_run += 1,
                Some(CaseOutcome::Done) | None => {}
            }
        }
        summary.missing = std::mem::take(&mut *locked(&self.missing));
        summary.missing.sort();
        Ok(summary)
    }
}

/// What is behind a mutex, whoever died while holding it: every change is whole in itself.
fn locked<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// Run folders that came to an end of their own, by fingerprint.
fn finished_runs(runs: &Path) -> BTreeMap<String, PathBuf> {
    let listed = folder::list(runs).unwrap_or_default();
    listed
        .into_iter()
        .filter_map(|(path, read)| {
            let (manifest, state) = read.ok()?;
            matches!(state, RunState::Done | RunState::Aborted).then(|| (fingerprint(&manifest), path))
        })
        .collect()
}

/// The result of a finished run folder; `None` when it cannot be read whole.
fn adopt(path: &Path, blank: &CaseResult) -> Option<CaseResult> {
    let folder = RunFolder::open(path).ok()?;
    let manifest = folder.manifest().ok()?;
    let steps = steps_csv::read(&folder.steps()).ok()?;
    let schedule = Setup::of_run(&manifest).ok()?.schedule().ok()?;
    let at_hz = schedule.steps().get(steps.len()).map(|step| step.frequency_hz);
    Some(filled(blank.clone(), &manifest, steps, at_hz))
}

/// A result from what a run left.
fn filled(blank: CaseResult, manifest: &Manifest, steps: Vec<StepSummary>, at_hz: Option<f64>) -> CaseResult {
    let aborted = manifest.state == RunState::Aborted;
    CaseResult {
        outcome: if aborted { CaseOutcome::Aborted } else { CaseOutcome::Done },
        cause: manifest.cause.clone(),
        at_hz: at_hz.filter(|_| aborted),
        clean: manifest.clean,
        samples: manifest.samples,
        lost_samples: manifest.lost.samples,
        samples_sha256: manifest.samples_sha256.clone(),
        steps,
        ..blank
    }
}

#[cfg(test)]
#[path = "runner_tests.rs"]
mod tests;
