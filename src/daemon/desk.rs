//! The operator's desk: the one place where the state of the bench is kept and changed. Handlers of the
//! interface call it from many tasks; every change is checked by [`State::after`] under one short lock,
//! written into the journal and told to all clients. Runs themselves are in `run`.

use super::check::{Checked, check};
use super::journal::Journal;
use super::link::Link;
use super::live::Hub;
use super::state::{Action, NotNow, State};
use super::work::{Work, WorkError};
use crate::control::clock::now_ns;
use crate::control::session::{Operator, Pace};
use crate::control::setup::Setup;
use crate::control::{Nrmse, Request, StepSummary};
use crate::diagnose::live::Follower;
use crate::record::folder::now_utc;
use crate::rig::RigSpec;
use crate::rig::hardware::HardwareMonitor;
use crate::rig::simulated::FaultSwitches;
use crate::safety::{self, SafetySpec};
use crate::sweep::Schedule;
use serde::Serialize;
use serde_json::{Value, json};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;
use utoipa::ToSchema;

/// What the daemon is started with.
pub struct Options {
    /// Folder of the runs.
    pub out: PathBuf,
    /// The rig.
    pub rig: RigSpec,
    /// What is set up at the start.
    pub work: Work,
    /// Seed of the first run on the simulated rig; each run takes the next one.
    pub seed: u64,
    /// How time passes.
    pub pace: Pace,
    /// Detectors, action ladder, stops, and whether an operator's link is watched.
    pub safety: SafetySpec,
}

/// Why the desk refused something.
#[derive(Debug, thiserror::Error)]
pub enum DeskError {
    /// Not in this state.
    #[error(transparent)]
    NotNow(#[from] NotNow),
    /// Not a sound configuration.
    #[error(transparent)]
    Work(#[from] WorkError),
    /// The checks are not there, not passed, or others than those confirmed.
    #[error("{0}")]
    Unchecked(String),
    /// The acknowledged cause is not the one that latched.
    #[error("the cause to acknowledge is `{0}`")]
    Acknowledge(String),
    /// Something that goes on must end first.
    #[error("the checks are still being made")]
    Busy,
    /// The run could not be started.
    #[error("{0}")]
    Start(String),
    /// The operator's link is configured and silent.
    #[error("{0}")]
    Silent(String),
}

/// Why the bench is aborted.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Cause {
    /// The first-out detector, or `failure`.
    pub detector: String,
    /// In words.
    pub text: String,
    /// When, UTC.
    pub at_utc: String,
}

/// A run that goes on.
pub(super) struct Live {
    pub(super) operator: Option<Operator>,
    pub(super) id: String,
    pub(super) name: String,
    pub(super) schedule: Schedule,
    /// How the supervisor of the control thread stands, as it told last.
    pub(super) supervisor: safety::State,
    pub(super) rate_hz: f64,
    pub(super) steps: Vec<StepSummary>,
    pub(super) evidence: Follower,
    pub(super) error: Nrmse,
    pub(super) slips: u64,
    pub(super) daq_lost: u64,
    pub(super) real_time: Option<String>,
    pub(super) faults: Option<FaultSwitches>,
    pub(super) links: Option<HardwareMonitor>,
    /// Index of the newest step and the number of its first row.
    pub(super) at: Option<(i32, u64)>,
    pub(super) first: Option<u64>,
    pub(super) newest: u64,
    pub(super) asked_ns: Option<u64>,
    pub(super) stop_asked: bool,
}

/// A run that is over.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Ended {
    /// Folder name of the run.
    pub id: String,
    /// `done`, `stopped`, `aborted`, `failed`.
    pub outcome: String,
    /// Samples recorded.
    pub samples: u64,
    /// Samples lost.
    pub lost_samples: u64,
    /// Slips of the control thread.
    pub slips: u64,
    /// Nothing was lost and the run ended as asked.
    pub clean: bool,
    /// Error of the onboard model over all counted cycles, acceleration.
    pub nrmse_a: f64,
    /// The same, displacement.
    pub nrmse_d: f64,
    /// Timing of the control thread.
    #[schema(value_type = Object)]
    pub timing: crate::control::TimingReport,
}

pub(super) struct Inner {
    pub(super) state: State,
    pub(super) since_utc: String,
    pub(super) work: Work,
    pub(super) checked: Option<Checked>,
    pub(super) checking: bool,
    pub(super) cause: Option<Cause>,
    pub(super) link: Link,
    pub(super) live: Option<Live>,
    pub(super) ended: Option<Ended>,
}

/// The desk.
pub struct Desk {
    pub(super) options: Fixed,
    inner: Mutex<Inner>,
    /// The live view.
    pub hub: Arc<Hub>,
    /// Who did what.
    pub journal: Journal,
    changed: watch::Sender<u64>,
    seed: AtomicU64,
    checks: AtomicU64,
    pub(super) stop_latency_ns: AtomicU64,
    pub(super) runs: AtomicU64,
}

/// The part of the options that stays.
pub(super) struct Fixed {
    pub(super) out: PathBuf,
    pub(super) rig: RigSpec,
    pub(super) pace: Pace,
    pub(super) safety: SafetySpec,
}

impl Desk {
    /// A desk with an idle bench.
    pub fn new(options: Options) -> Arc<Self> {
        let inner = Inner {
            state: State::Idle,
            since_utc: now_utc(),
            work: options.work,
            checked: None,
            checking: false,
            cause: None,
            link: Link::new(&options.safety),
            live: None,
            ended: None,
        };
        Arc::new(Self {
            journal: Journal::new(&options.out),
            options: Fixed { out: options.out, rig: options.rig, pace: options.pace, safety: options.safety },
            inner: Mutex::new(inner),
            hub: Arc::default(),
            changed: watch::channel(0).0,
            seed: AtomicU64::new(options.seed),
            checks: AtomicU64::new(1),
            stop_latency_ns: AtomicU64::new(0),
            runs: AtomicU64::new(0),
        })
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells when something has changed.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    pub(super) fn touch(&self) {
        self.changed.send_modify(|count| *count += 1);
    }

    /// The folder of the runs.
    pub fn out(&self) -> &std::path::Path {
        &self.options.out
    }

    /// The rig.
    pub fn rig(&self) -> &RigSpec {
        &self.options.rig
    }

    /// What is set up for the next run.
    pub fn work(&self) -> Work {
        self.lock().work.clone()
    }

    /// The state.
    pub fn state(&self) -> State {
        self.lock().state
    }

    /// From the request to the first command of the last stop, s; zero before the first one.
    pub fn stop_latency_s(&self) -> f64 {
        1e-9 * self.stop_latency_ns.load(Ordering::Relaxed) as f64
    }

    /// Runs that were started.
    pub fn runs(&self) -> u64 {
        self.runs.load(Ordering::Relaxed)
    }

    /// Everything that defines the next run.
    pub(super) fn setup(&self, work: &Work, seed: u64) -> Setup {
        let safety = Some(self.options.safety.clone());
        Setup { safety, ..work.setup(&self.options.rig, seed) }
    }

    pub(super) fn next_seed(&self) -> u64 {
        self.seed.fetch_add(1, Ordering::Relaxed)
    }

    /// Changes what is set up; the checks are then void.
    ///
    /// # Errors
    /// [`DeskError`] in the wrong state, or when the change itself is refused.
    pub fn configure(
        &self,
        who: &str,
        what: Value,
        change: impl FnOnce(&mut Work) -> Result<(), WorkError>,
    ) -> Result<(), DeskError> {
        {
            let mut inner = self.lock();
            let next = inner.state.after(Action::Configure)?;
            if inner.checking {
                return Err(DeskError::Busy);
            }
            change(&mut inner.work)?;
            inner.enter(next);
            inner.checked = None;
        }
        self.journal.note(who, "configure", what);
        self.touch();
        Ok(())
    }

    /// Makes the checks; returns once they are made, which real devices take seconds for.
    ///
    /// # Errors
    /// [`DeskError`] in the wrong state.
    pub fn preflight(&self, who: &str) -> Result<Checked, DeskError> {
        let work = {
            let mut inner = self.lock();
            let next = inner.state.after(Action::PreFlight)?;
            if inner.checking {
                return Err(DeskError::Busy);
            }
            inner.enter(next);
            (inner.checking, inner.checked) = (true, None);
            inner.work.clone()
        };
        self.touch();
        let required = matches!(self.options.pace, Pace::Wall { require_realtime: true, .. });
        let setup = self.setup(&work, self.seed.load(Ordering::Relaxed));
        let id = self.checks.fetch_add(1, Ordering::Relaxed);
        let checked = check(&setup, &self.options.out, required, id);
        {
            let mut inner = self.lock();
            inner.checking = false;
            // A stop meanwhile has taken the bench back to idle.
            if inner.state == State::PreFlight {
                inner.checked = Some(checked.clone());
            }
        }
        let failed: Vec<_> = checked.lines.iter().filter(|line| !line.ok).map(|line| line.name).collect();
        self.journal.note(who, "pre-flight", json!({ "id": id, "passed": checked.passed, "failed": failed }));
        self.touch();
        Ok(checked)
    }

    /// Confirms the checks of a number.
    ///
    /// # Errors
    /// [`DeskError`] in the wrong state, or when these checks are not there or have not passed.
    pub fn arm(&self, who: &str, id: u64) -> Result<(), DeskError> {
        {
            let mut inner = self.lock();
            let next = inner.state.after(Action::Arm)?;
            inner.link.required()?;
            let unchecked = |text: String| Err(DeskError::Unchecked(text));
            match &inner.checked {
                None => return unchecked("there are no checks to confirm yet".into()),
                Some(checked) if checked.id != id => {
                    return unchecked(format!("the checks to confirm are number {}, not {id}", checked.id));
                }
                Some(checked) if !checked.passed => return unchecked("the checks have not passed".into()),
                Some(_) => inner.enter(next),
            }
        }
        self.journal.note(who, "arm", json!({ "pre_flight": id }));
        self.touch();
        Ok(())
    }

    /// Gives the confirmation back.
    ///
    /// # Errors
    /// [`DeskError`] in the wrong state.
    pub fn disarm(&self, who: &str) -> Result<(), DeskError> {
        {
            let mut inner = self.lock();
            let next = inner.state.after(Action::Disarm)?;
            inner.enter(next);
            inner.checked = None;
        }
        self.journal.note(who, "disarm", json!({}));
        self.touch();
        Ok(())
    }

    /// Holds, resumes or stops. A stop reaches the control thread before anything else is done here.
    ///
    /// # Errors
    /// [`DeskError`] in the wrong state; a stop is never refused.
    pub fn ask(&self, who: &str, action: Action) -> Result<State, DeskError> {
        let request = match action {
            Action::Hold => Request::Hold,
            Action::Resume => Request::Resume,
            _ => Request::Stop,
        };
        let (state, sample) = {
            let mut inner = self.lock();
            let next = inner.state.after(action)?;
            let mut sample = None;
            if let Some(live) = inner.live.as_mut() {
                sample = Some(live.newest);
                live.ask(request);
            }
            inner.enter(next);
            if next == State::Idle {
                inner.checked = None;
            }
            (next, sample)
        };
        self.journal.note(who, action.name(), json!({ "after_sample": sample }));
        self.touch();
        Ok(state)
    }

    /// Acknowledges the cause of an abort and clears it.
    ///
    /// # Errors
    /// [`DeskError`] when the bench is not aborted, another cause is acknowledged, or the operator's link is silent.
    pub fn reset(&self, who: &str, acknowledged: &str) -> Result<(), DeskError> {
        let cause = {
            let mut inner = self.lock();
            let next = inner.state.after(Action::Reset)?;
            let cause = inner.cause.clone();
            if let Some(cause) = cause.as_ref().filter(|cause| cause.detector != acknowledged) {
                return Err(DeskError::Acknowledge(cause.detector.clone()));
            }
            // SR-04: what is still wrong cannot be cleared.
            inner.link.required()?;
            inner.enter(next);
            (inner.cause, inner.checked) = (None, None);
            cause
        };
        self.journal.note(who, "reset", json!({ "acknowledged": cause }));
        self.touch();
        Ok(())
    }

    /// The fault switches of the simulated rig that runs.
    pub fn faults(&self) -> Option<FaultSwitches> {
        self.lock().live.as_ref().and_then(|live| live.faults.clone())
    }
}

impl Inner {
    pub(super) fn enter(&mut self, state: State) {
        if self.state != state {
            self.since_utc = now_utc();
        }
        self.state = state;
    }
}

impl Live {
    /// Hands a request to the control thread, or keeps a stop until that is there.
    pub(super) fn ask(&mut self, request: Request) {
        if request == Request::Stop {
            self.stop_asked = true;
            self.asked_ns.get_or_insert_with(now_ns);
        }
        if let Some(operator) = &self.operator
            && operator.ask(request).is_err()
        {
            // The ring holds 64 requests, of which the thread takes all in every period: it does not run.
            tracing::error!(?request, "the control thread takes no requests");
        }
    }
}
