//! One run from its parts to its folder: makes the rings, starts the recorder and the control thread,
//! tells the operator's side what happens, and closes the folder. Used by the command line and by the
//! daemon.

use super::clock::{Clock, VirtualClock, WallClock};
use super::event::{Ending, Event, Nrmse, StepSummary};
use super::onboard::Onboard;
use super::step::{Controller, Parts, Request};
use super::thread::{RealTime, release_memory, set_up};
use super::timing::TimingReport;
use crate::record::recorder::{Notice, Recorded, Recorder};
use crate::record::{Manifest, RunError, RunFolder};
use crate::rig::Rig;
use crate::safety::{Guard, Watchdog};
use crate::stream::{Depths, OperatorEnd, ViewEnd, split};
use crate::sweep::Generator;
use crossbeam::channel::{Receiver, Sender, bounded, unbounded};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{JoinHandle, Thread};
use std::time::Duration;

/// Room in the record ring below which virtual time waits for the recorder, rows.
const LEAST_ROOM: usize = 4096 + 64;

/// How time passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// As fast as the recorder takes the rows.
    Virtual,
    /// By the clock on the wall.
    Wall {
        /// CPU to pin the control thread to.
        cpu: Option<usize>,
        /// Refuse to run without the full real-time set-up.
        require_realtime: bool,
    },
}

/// Why a run could not be started or closed.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// The folder could not be written.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A thread could not be started.
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
    /// The real-time set-up was required and is not complete.
    #[error("{} (required by --require-realtime; `shaketable doctor` says how to fix it)", .0.line())]
    NotRealTime(Box<RealTime>),
    /// A thread died, which is a fault of the program.
    #[error("the {0} thread died")]
    Died(&'static str),
}

/// What a run is made of.
pub struct Plan {
    /// Folder below which the run folder is made.
    pub out: PathBuf,
    /// What `run.toml` says at the start.
    pub manifest: Manifest,
    /// The rig.
    pub rig: Box<dyn Rig>,
    /// The command.
    pub generator: Generator,
    /// The onboard model.
    pub model: Onboard,
    /// Detectors, supervisor and stops; `None` for a replayed record.
    pub guard: Option<Guard>,
    /// How time passes.
    pub pace: Pace,
    /// Depths of the rings.
    pub depths: Depths,
}

/// A handle through which anyone may ask the control thread of a run; clones ask the same one.
#[derive(Clone)]
pub struct Operator(Arc<Mutex<OperatorEnd<Request>>>);

impl Operator {
    /// Asks the control thread for something; it looks once a period.
    ///
    /// # Errors
    /// The request when its ring is full, which means that the control thread has not run for long.
    pub fn ask(&self, request: Request) -> Result<(), Request> {
        // The lock is held for the push only; a holder that died has left the ring whole.
        self.0.lock().unwrap_or_else(PoisonError::into_inner).ask(request)
    }
}

/// A run that goes on.
pub struct Session {
    folder: RunFolder,
    manifest: Manifest,
    notices: Receiver<Notice>,
    operator: Operator,
    view: Option<ViewEnd>,
    control: JoinHandle<(Ending, TimingReport)>,
    recorder: JoinHandle<Recorded>,
}

/// A run that is over.
#[derive(Debug)]
pub struct Finished {
    /// Its folder.
    pub folder: RunFolder,
    /// `run.toml` as it stands in the folder.
    pub manifest: Manifest,
    /// How it ended.
    pub ending: Ending,
    /// Results of the steps.
    pub steps: Vec<StepSummary>,
    /// Onboard model against measurement over all counted cycles.
    pub model_error: Nrmse,
    /// Timing of the control thread.
    pub timing: TimingReport,
}

/// Starts a run.
///
/// # Errors
/// [`SessionError`] when the folder, the threads or the required real-time set-up cannot be had; the rig
/// has not been commanded then.
pub fn start(plan: Plan) -> Result<Session, SessionError> {
    let mut manifest = plan.manifest;
    let (end, recorder_end, view, operator) = split::<Event, Request>(plan.depths);
    let folder = RunFolder::create(&plan.out, &manifest.name)?;
    let rate = manifest.sample_rate_hz;
    let (tell, notices) = unbounded();
    let recorder = spawn_recorder(Recorder::create(&folder, recorder_end, rate, tell)?)?;
    let parts = Parts {
        rig: plan.rig,
        generator: plan.generator,
        model: plan.model,
        guard: plan.guard,
        end,
        sample_rate_hz: rate,
    };
    let (ready, readiness) = bounded(1);
    let control = spawn_control(parts, plan.pace, recorder.thread().clone(), ready)?;
    match readiness.recv() {
        Ok(Some(state)) => {
            let required = matches!(plan.pace, Pace::Wall { require_realtime: true, .. });
            if required && !state.complete() {
                return Err(SessionError::NotRealTime(Box::new(state)));
            }
            manifest.real_time = Some(state);
        }
        Ok(None) => {}
        Err(_) => return Err(SessionError::Died("control")),
    }
    folder.write_manifest(&manifest)?;
    let operator = Operator(Arc::new(Mutex::new(operator)));
    Ok(Session { folder, manifest, notices, operator, view: Some(view), control, recorder })
}

fn spawn_recorder(recorder: Recorder) -> Result<JoinHandle<Recorded>, SessionError> {
    std::thread::Builder::new()
        .name("recorder".into())
        .spawn(move || recorder.record())
        .map_err(SessionError::Thread)
}

fn spawn_control(
    parts: Parts,
    pace: Pace,
    recorder: Thread,
    ready: Sender<Option<RealTime>>,
) -> Result<JoinHandle<(Ending, TimingReport)>, SessionError> {
    let rate = parts.sample_rate_hz;
    let line = parts.rig.stop_line().filter(|_| parts.guard.is_some());
    let timeout = parts.guard.as_ref().map_or(Duration::ZERO, Guard::watchdog);
    std::thread::Builder::new()
        .name("control".into())
        .spawn(move || {
            let controller = Controller::new(parts);
            match pace {
                Pace::Virtual => {
                    // The other side waits for this message; if it has gone, the run has no reader.
                    let _ = ready.send(None);
                    run_virtual(controller, &recorder)
                }
                Pace::Wall { cpu, require_realtime } => {
                    // Held until the table stands still.
                    let (state, _awake) = set_up(cpu);
                    let refuse = require_realtime && !state.complete();
                    let _ = ready.send(Some(state));
                    let watched = line.map(|line| Watchdog::start(controller.heart(), line, timeout));
                    // Without the thread that would watch it the table is not moved.
                    let unwatched = matches!(watched, Some(Err(_)));
                    let result = if refuse || unwatched {
                        (Ending::Failed, TimingReport::default())
                    } else {
                        run_wall(controller, rate)
                    };
                    release_memory();
                    result
                }
            }
        })
        .map_err(SessionError::Thread)
}

/// Runs in virtual time: as fast as it goes, but never faster than the recorder takes the rows.
fn run_virtual(mut controller: Controller, recorder: &Thread) -> (Ending, TimingReport) {
    let mut clock = VirtualClock;
    loop {
        while controller.record_room() < LEAST_ROOM {
            recorder.unpark();
            std::thread::park_timeout(Duration::from_micros(200));
        }
        if let Some(ending) = controller.step(clock.tick()) {
            return (ending, controller.timing());
        }
    }
}

/// Runs by the clock on the wall.
fn run_wall(mut controller: Controller, rate_hz: f64) -> (Ending, TimingReport) {
    let mut clock = WallClock::new(rate_hz);
    loop {
        let tick = clock.tick();
        if let Some(ending) = controller.step(tick) {
            return (ending, controller.timing());
        }
    }
}

impl Session {
    /// The run folder.
    pub fn folder(&self) -> &RunFolder {
        &self.folder
    }

    /// What `run.toml` says.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// What happens, as it happens; disconnected once the run is over.
    pub fn notices(&self) -> &Receiver<Notice> {
        &self.notices
    }

    /// The live view's end of the rings; it can be taken once.
    pub fn take_view(&mut self) -> Option<ViewEnd> {
        self.view.take()
    }

    /// Asks the control thread for something.
    ///
    /// # Errors
    /// The request when its ring is full, which means that the control thread has not run for long.
    pub fn ask(&mut self, request: Request) -> Result<(), Request> {
        self.operator.ask(request)
    }

    /// A handle for asking that outlives [`Session::wait`].
    pub fn operator(&self) -> Operator {
        self.operator.clone()
    }

    /// Waits for the end, showing every notice, and closes the folder. A recorder that cannot write any
    /// more stops the run.
    ///
    /// # Errors
    /// [`SessionError`] when a thread died or the folder cannot be closed.
    pub fn wait(self, mut show: impl FnMut(&Notice)) -> Result<Finished, SessionError> {
        while let Ok(notice) = self.notices.recv() {
            if matches!(notice, Notice::Failed(_)) {
                // A full request ring means that the thread is not running: nothing left to stop.
                let _ = self.operator.ask(Request::Stop);
            }
            show(&notice);
        }
        let (ending, timing) = self.control.join().map_err(|_| SessionError::Died("control"))?;
        let recorded = self.recorder.join().map_err(|_| SessionError::Died("recorder"))?;
        let ending = if recorded.error.is_some() { Ending::Failed } else { ending };
        let mut manifest = self.manifest;
        close(&mut manifest, ending, &timing, &recorded);
        self.folder.seal_events(&mut manifest)?;
        self.folder.write_manifest(&manifest)?;
        Ok(Finished {
            folder: self.folder,
            manifest,
            ending,
            steps: recorded.steps,
            model_error: recorded.model_error,
            timing,
        })
    }
}

/// Fills in what is known at the end.
fn close(manifest: &mut Manifest, ending: Ending, timing: &TimingReport, recorded: &Recorded) {
    manifest.state = ending.into();
    let cause = recorded.cause.map(|cause| cause.name().to_owned());
    manifest.cause = cause.or(recorded.error.clone()).or(manifest.cause.take());
    manifest.clean = ending == Ending::Done && recorded.lost.samples == 0 && recorded.lost.events == 0;
    manifest.ended_utc = Some(crate::record::folder::now_utc());
    manifest.samples = recorded.rows;
    manifest.samples_sha256 = Some(recorded.sha256.clone());
    manifest.lost = recorded.lost;
    manifest.timing = Some(timing.clone());
}

#[cfg(test)]
mod tests;
