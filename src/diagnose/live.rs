//! Evidence while a run goes on: after each finished step, what each candidate would explain of what is recorded so far. No verdict -
//! that needs held-out steps and a simulation - but a hint which way it goes. `run` and the daemon ask for it; the work is
//! done by this program in a process of its own, at low priority, so that nothing beside the table waits for it.

use super::engine::DiagnoseError;
use super::search::{Effort, Searcher};
use crate::identify::kinematics::Tolerances;
use crate::identify::motion::{Motion, MotionError};
use crate::model::ModelSpec;
use crate::record::Record;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use utoipa::ToSchema;

/// Steps that have to be finished first: the base model's own numbers are fitted as well.
pub const FEWEST_STEPS: usize = 6;

/// Steps that are looked at, at most.
const MOST_STEPS: usize = 10;

/// What one candidate brings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Candidate {
    /// Effect.
    pub name: String,
    /// Log-likelihood that it adds on what is recorded so far, in nats, coloured residuals considered, less half the
    /// logarithm of the number of independent samples for each of its parameters (Schwarz 1978).
    pub evidence_nats: f64,
}

/// The candidates after some steps, best first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Evidence {
    /// Steps that it stands on.
    pub steps: usize,
    /// Candidates that bring anything, best first.
    pub candidates: Vec<Candidate>,
}

impl Evidence {
    /// In a few words, for a line of progress.
    pub fn line(&self) -> String {
        match self.candidates.first() {
            Some(best) => format!("{} {:+.0} nats", best.name, best.evidence_nats),
            None => "nothing missing so far".to_owned(),
        }
    }
}

/// The evidence in a record, force along the measured motion alone.
///
/// # Errors
/// As of a diagnosis.
pub fn evidence(record: &Record, nominal: &ModelSpec) -> Result<Evidence, DiagnoseError> {
    crate::model::build(nominal, 1.0 / record.sample_rate_hz)?;
    let mut motion = Motion::of(record, nominal.mass_kg, Tolerances::default())?;
    if motion.windows.len() < FEWEST_STEPS {
        return Err(MotionError::TooShort { samples: motion.windows.len(), needed: FEWEST_STEPS }.into());
    }
    let steps = motion.windows.len();
    // All that is fitted is for training; some of the steps, spread over the run, are enough for a hint.
    motion.windows = motion.windows.into_iter().step_by(steps.div_ceil(MOST_STEPS)).collect();
    motion.windows.iter_mut().for_each(|window| window.held_out = false);
    let effort = Effort { screening_samples: 8_000, fitting_samples: 30_000, ..Effort::default() };
    let searcher = Searcher::new(&motion, nominal, effort);
    let candidates =
        searcher.evidence(nominal).ok_or_else(|| DiagnoseError::Diverges { name: nominal.name.clone() })?;
    let candidates = candidates
        .into_iter()
        .filter(|(_, nats)| *nats > 0.0)
        .map(|(name, evidence_nats)| Candidate { name: name.to_owned(), evidence_nats })
        .collect();
    Ok(Evidence { steps, candidates })
}

/// Follows a run that goes on.
#[derive(Debug, Default)]
pub struct Follower {
    latest: Arc<Mutex<Option<Evidence>>>,
    busy: Arc<AtomicBool>,
}

impl Follower {
    /// A step of the run is finished and on its way to the disk. While an earlier question is worked on this one is left
    /// out: the next step asks again.
    pub fn step_finished(&self, run: PathBuf, finished: usize) {
        if finished < FEWEST_STEPS || self.busy.swap(true, Ordering::AcqRel) {
            return;
        }
        let (latest, busy) = (self.latest.clone(), self.busy.clone());
        let work = move || {
            if let Some(found) = ask(&run) {
                *latest.lock().unwrap_or_else(PoisonError::into_inner) = Some(found);
            }
            busy.store(false, Ordering::Release);
        };
        if std::thread::Builder::new().name("evidence".into()).spawn(work).is_err() {
            // No thread, no evidence; the run goes on.
            self.busy.store(false, Ordering::Release);
        }
    }

    /// The newest answer.
    pub fn latest(&self) -> Option<Evidence> {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Asks this program about a run and the model on board.
fn ask(run: &std::path::Path) -> Option<Evidence> {
    let program = std::env::current_exe().ok()?;
    let mut command = Command::new(program);
    command.args(["diagnose", "--evidence", "--json", "--model"]).arg(run).arg(run);
    let output = command.stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    output.status.success().then(|| serde_json::from_slice(&output.stdout).ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_names_the_best() {
        let best = Candidate { name: "backlash".into(), evidence_nats: 33.7 };
        let found = Evidence { steps: 8, candidates: vec![best] };
        assert_eq!(found.line(), "backlash +34 nats");
        assert_eq!(Evidence { steps: 8, candidates: vec![] }.line(), "nothing missing so far");
    }

    #[test]
    fn too_few_steps_are_asked_about_nobody() {
        let follower = Follower::default();
        follower.step_finished(PathBuf::from("/nowhere"), FEWEST_STEPS - 1);
        assert!(!follower.busy.load(Ordering::Acquire) && follower.latest().is_none());
    }
}
