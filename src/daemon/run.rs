//! One run of the daemon: starts the session on a thread of its own, follows its notices, and tells the
//! desk how it ended. The desk's lock is never held while anything is waited for.

use super::desk::{Cause, Desk, DeskError, Ended, Live};
use super::state::{Action, NotNow, State};
use crate::cli::run::hardware::close as close_links;
use crate::control::clock::now_ns;
use crate::control::session::{self, Finished, Session};
use crate::control::setup::Setup;
use crate::control::{Ending, Event, Nrmse, Request};
use crate::diagnose::live::Follower;
use crate::record::folder::now_utc;
use crate::record::recorder::Notice;
use crate::report::of_run;
use crate::rig::hardware::HardwareMonitor;
use crate::rig::simulated::FaultSwitches;
use crate::safety;
use serde_json::json;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;
use tokio::sync::oneshot;

type Started = (Session, Option<FaultSwitches>, Option<HardwareMonitor>);

impl Desk {
    /// Starts what is set up, on an armed bench. Returns the folder name of the run once it moves.
    ///
    /// # Errors
    /// [`DeskError`] in the wrong state, or when the run cannot be started; the bench is aborted then.
    pub async fn start(self: &Arc<Self>, who: &str) -> Result<String, DeskError> {
        let setup = {
            let mut inner = self.lock();
            let next = inner.state.after(Action::Start)?;
            inner.link.required()?;
            // SR-03: the state has not forgotten it, but what is latched is looked at itself.
            if inner.cause.is_some() {
                return Err(NotNow { action: Action::Start, state: State::Aborted }.into());
            }
            let setup = self.setup(&inner.work, self.next_seed());
            let schedule = setup.schedule().map_err(|error| DeskError::Start(error.to_string()))?;
            inner.enter(next);
            inner.ended = None;
            inner.live = Some(Live {
                operator: None,
                id: String::new(),
                name: setup.name.clone(),
                schedule,
                supervisor: safety::State::Faulted,
                rate_hz: setup.rig.sample_rate_hz,
                steps: Vec::new(),
                evidence: Follower::default(),
                error: Nrmse::default(),
                slips: 0,
                daq_lost: 0,
                real_time: None,
                faults: None,
                links: None,
                at: None,
                first: None,
                newest: 0,
                asked_ns: None,
                stop_asked: false,
            });
            setup
        };
        self.journal.note(who, "start", json!({ "name": setup.name, "seed": setup.seed }));
        self.touch();
        let (tell, told) = oneshot::channel();
        let desk = self.clone();
        let spawned =
            std::thread::Builder::new().name("session".into()).spawn(move || desk.run(&setup, tell));
        if let Err(error) = spawned {
            self.fail(&format!("cannot start a thread: {error}"));
        }
        match told.await {
            Ok(result) => result.map_err(DeskError::Start),
            Err(_) => Err(DeskError::Start("the session thread died".into())),
        }
    }

    /// The whole run; the session thread.
    fn run(self: Arc<Self>, setup: &Setup, tell: oneshot::Sender<Result<String, String>>) {
        let (mut session, faults, links) = match self.open(setup) {
            Ok(started) => started,
            Err(reason) => {
                self.fail(&reason);
                // A caller that has gone away needs no answer.
                let _ = tell.send(Err(reason));
                return;
            }
        };
        self.runs.fetch_add(1, Ordering::Relaxed);
        let id = self.begun(&session, faults, links.clone());
        let half_gap_m = setup.model.bumper.as_ref().map(|bumper| 0.5 * bumper.total_gap_m);
        let _ = tell.send(Ok(id.clone()));
        let viewer = self.watch(id, &mut session, setup.rig.sample_rate_hz, half_gap_m);
        let finished = session.wait(|notice| self.notice(notice));
        if let Some(Ok(viewer)) = viewer
            && viewer.join().is_err()
        {
            tracing::error!("the thread of the live view died");
        }
        match finished {
            Ok(finished) => self.ended(finished, links.as_ref()),
            Err(error) => self.fail(&error.to_string()),
        }
        self.journal.end_run();
        self.touch();
    }

    fn open(&self, setup: &Setup) -> Result<Started, String> {
        let (out, pace) = (&self.options.out, self.options.pace);
        let (plan, faults, links) = match &setup.rig.hardware {
            Some(devices) => {
                let opened = setup.hardware_plan(devices, out, pace);
                let (plan, links, _) = opened.map_err(|error| error.to_string())?;
                (plan, None, Some(links))
            }
            None => {
                let (plan, faults) = setup.plan(out, pace).map_err(|error| error.to_string())?;
                (plan, Some(faults), None)
            }
        };
        let session = session::start(plan).map_err(|error| error.to_string())?;
        Ok((session, faults, links))
    }

    /// The control thread runs: from here on it can be asked.
    fn begun(
        &self,
        session: &Session,
        faults: Option<FaultSwitches>,
        links: Option<HardwareMonitor>,
    ) -> String {
        let path = session.folder().path();
        let id = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        self.journal.begin_run(session.folder().events());
        let mut inner = self.lock();
        if let Some(live) = &mut inner.live {
            live.id.clone_from(&id);
            live.faults = faults;
            live.links = links;
            live.real_time = session.manifest().real_time.as_ref().map(|state| state.line());
            let operator = session.operator();
            if live.stop_asked && operator.ask(Request::Stop).is_err() {
                tracing::error!("the control thread takes no requests");
            }
            live.operator = Some(operator);
        }
        drop(inner);
        self.touch();
        id
    }

    /// A thread that feeds the live view; without it the run goes on unseen.
    fn watch(
        &self,
        id: String,
        session: &mut Session,
        rate_hz: f64,
        half_gap_m: Option<f64>,
    ) -> Option<std::io::Result<JoinHandle<()>>> {
        let view = session.take_view()?;
        let hub = self.hub.clone();
        let follow = move || hub.follow(id, view, rate_hz, half_gap_m);
        let spawned = std::thread::Builder::new().name("live".into()).spawn(follow);
        if let Err(error) = &spawned {
            tracing::error!(%error, "no thread for the live view");
        }
        Some(spawned)
    }

    /// Follows one notice of the recorder.
    fn notice(&self, notice: &Notice) {
        let changed = match notice {
            Notice::Row(row) => {
                if let Some(live) = &mut self.lock().live {
                    live.newest = row.sample.sequence;
                    live.first.get_or_insert(row.sample.sequence);
                    if row.step >= 0 && live.at.is_none_or(|(step, _)| step != row.step) {
                        live.at = Some((row.step, row.sample.sequence));
                    }
                }
                false
            }
            Notice::Failed(reason) => {
                self.hub.tell(&json!({ "type": "event", "event": "recorder", "text": reason }).to_string());
                true
            }
            Notice::Event(event) => self.event(event),
        };
        if changed {
            self.touch();
        }
    }

    /// Follows one event of the control thread; true when the status has changed by it.
    fn event(&self, event: &Event) -> bool {
        let mut inner = self.lock();
        let Some(live) = inner.live.as_mut() else { return false };
        match event {
            Event::Live { error, .. } => {
                live.error = *error;
                return false;
            }
            Event::Slip { .. } => live.slips += 1,
            Event::DaqGap { missing, .. } => live.daq_lost += missing,
            Event::Step(step) => {
                live.steps.push(*step);
                live.evidence.step_finished(self.options.out.join(&live.id), live.steps.len());
            }
            Event::Obeyed { request: Request::Stop, at_ns, .. } => {
                let asked_ns = live.asked_ns.unwrap_or_else(now_ns);
                self.stop_latency_ns.store(at_ns.saturating_sub(asked_ns).max(1), Ordering::Relaxed);
            }
            Event::Abort { cause, .. } => {
                let cause = Cause {
                    detector: cause.name().to_owned(),
                    text: "beyond its limit; the table is brought to rest".to_owned(),
                    at_utc: now_utc(),
                };
                inner.cause.get_or_insert(cause);
                inner.enter(State::Stopping);
            }
            Event::Supervisor { state, .. } => {
                live.supervisor = *state;
                let next = inner.state.under(*state);
                inner.enter(next);
            }
            // What was asked here and taken for granted is not so.
            Event::Refused { .. } => {
                let supervisor = live.supervisor;
                let next = inner.state.under(supervisor);
                inner.enter(next);
            }
            _ => {}
        }
        drop(inner);
        let told = match serde_json::to_value(event) {
            Ok(value) => json!({ "type": "event", "event": value }),
            Err(error) => {
                json!({ "type": "event", "event": { "event": "unreadable", "reason": error.to_string() } })
            }
        };
        self.hub.tell(&told.to_string());
        true
    }

    fn ended(&self, finished: Finished, links: Option<&HardwareMonitor>) {
        let finished = match links {
            Some(links) => match close_links(links, finished) {
                Ok(finished) => finished,
                Err(error) => return self.fail(&format!("the run folder cannot be closed: {error:?}")),
            },
            None => finished,
        };
        if let Err(error) = of_run::write(&finished.folder, &finished.steps) {
            // The numbers are in the folder all the same.
            tracing::error!(%error, "no report of the run");
        }
        let manifest = &finished.manifest;
        let mut inner = self.lock();
        let id = inner.live.take().map_or_else(String::new, |live| live.id);
        // SR-03: a fault that latched in the last moments latches as well, though the sweep had come to its end.
        let latched = inner.cause.is_some();
        inner.enter(if latched { State::Aborted } else { State::ended(finished.ending) });
        inner.checked = None;
        if matches!(finished.ending, Ending::Aborted | Ending::Failed | Ending::Interrupted) {
            let text = manifest.cause.clone().unwrap_or_else(|| "the run failed".into());
            let detector = if finished.ending == Ending::Aborted { text.clone() } else { "failure".into() };
            inner.cause.get_or_insert(Cause { detector, text, at_utc: now_utc() });
        }
        inner.ended = Some(Ended {
            id,
            outcome: manifest.state.name().to_owned(),
            samples: manifest.samples,
            lost_samples: manifest.lost.samples,
            slips: finished.timing.slips,
            clean: manifest.clean,
            nrmse_a: finished.model_error.nrmse_a,
            nrmse_d: finished.model_error.nrmse_d,
            timing: finished.timing.clone(),
        });
    }

    /// Counters of the links of the run that goes on, by name; `None` on a simulated rig.
    pub fn links(&self) -> Option<Vec<(&'static str, u64)>> {
        let inner = self.lock();
        let links = inner.live.as_ref()?.links.as_ref()?;
        let (line, bus) = links.counters();
        let named = [
            ("DAQ samples", line.samples),
            ("DAQ samples lost", line.lost),
            ("DAQ frames with a wrong CRC", line.bad_frames),
            ("DAQ samples late", line.late),
            ("drive cycles", bus.cycles),
            ("drive cycles skipped", bus.skipped),
            ("drive cycles without an answer", bus.missed_inputs),
            ("CAN send failures", bus.send_failures),
            ("CAN disturbances", bus.disturbed),
        ];
        Some(named.to_vec())
    }

    /// Stops what runs and waits until it has ended.
    pub async fn close(&self) {
        let mut changes = self.changes();
        if !self.state().is_live() {
            return;
        }
        if let Err(error) = self.ask("the daemon", Action::Stop) {
            tracing::error!(%error, "no stop at the end");
        }
        while self.state().is_live() {
            if changes.changed().await.is_err() {
                return;
            }
        }
    }

    /// The run could not be started or closed.
    fn fail(&self, reason: &str) {
        tracing::error!(reason, "the run failed");
        let mut inner = self.lock();
        inner.live = None;
        inner.checked = None;
        inner.enter(State::Aborted);
        let cause = Cause { detector: "failure".into(), text: reason.to_owned(), at_utc: now_utc() };
        inner.cause.get_or_insert(cause);
        drop(inner);
        self.touch();
    }
}
