//! The status of the bench as every client sees it: made by the desk on each change and five times a second
//! while something moves, sent over the WebSocket and given by `GET /api/v1/status`.

use super::check::Checked;
use super::desk::{Cause, Desk, Ended, Live};
use super::meters::Meters;
use super::state::{Action, State};
use crate::control::StepSummary;
use crate::diagnose::live::Evidence;
use serde::Serialize;
use utoipa::ToSchema;

/// One link of the chain that must be whole before the table may move.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Interlock {
    /// What it guards.
    pub name: &'static str,
    /// Closed: nothing objects.
    pub ok: bool,
    /// What it says.
    pub text: String,
}

/// What is set up, in short.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct SetupShort {
    /// Name of the next run.
    pub name: String,
    /// Case of the paper, if one was named.
    pub case: Option<String>,
    /// Name of the rig.
    pub rig: String,
    /// The rig is simulated.
    pub simulated: bool,
    /// Name of the onboard model.
    pub model: String,
    /// Names of its effects.
    pub effects: Vec<String>,
    /// Changes of the model that can be taken back.
    pub undos: usize,
    /// Peak table acceleration A_G, g.
    pub acceleration_g: f64,
    /// Total gap, m; absent without bumpers.
    pub total_gap_m: Option<f64>,
    /// Half the stroke of the table, m.
    pub reach_m: f64,
    /// Samples a second.
    pub sample_rate_hz: f64,
}

/// The run that goes on.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Running {
    /// Folder name of the run; empty until it has begun.
    pub id: String,
    /// Name.
    pub name: String,
    /// Index of the step, from 0; absent before the first.
    pub step: Option<u32>,
    /// Number of steps.
    pub steps: usize,
    /// Frequency of the step, Hz.
    pub frequency_hz: Option<f64>,
    /// Direction of the step.
    pub direction: Option<&'static str>,
    /// Share that is done, 0 to 1.
    pub progress: f64,
    /// Time left, s.
    pub eta_s: f64,
    /// Time since its start, s.
    pub elapsed_s: f64,
    /// Error of the onboard model at the moment, acceleration.
    pub nrmse_a: f64,
    /// The same, displacement.
    pub nrmse_d: f64,
    /// Slips of the control thread so far.
    pub slips: u64,
    /// Samples that the DAQ never delivered so far.
    pub lost_samples: u64,
    /// Steps that are finished.
    pub finished: usize,
    /// How the supervisor of the control thread stands.
    pub supervisor: &'static str,
    /// Real-time set-up.
    pub real_time: Option<String>,
    /// Share of the recorder's ring that waits, 0 to 1.
    pub ring_fill: f64,
    /// What the finished steps say of missing effects; absent before there are enough of them.
    pub evidence: Option<Evidence>,
}

/// The whole status.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Status {
    /// State of the bench.
    pub state: State,
    /// Since when, UTC.
    pub since_utc: String,
    /// What can be asked now.
    pub possible: Vec<Action>,
    /// First-out cause of an abort.
    pub cause: Option<Cause>,
    /// The interlock chain.
    pub interlocks: Vec<Interlock>,
    /// What the checks before the run found.
    pub checked: Option<Checked>,
    /// The checks are being made.
    pub checking: bool,
    /// What is set up.
    pub setup: SetupShort,
    /// The run that goes on.
    pub run: Option<Running>,
    /// The run that ended last.
    pub ended: Option<Ended>,
    /// Readings of the newest cycle.
    pub meters: Meters,
    /// Version of the daemon.
    pub version: &'static str,
}

impl Desk {
    /// The status now.
    pub fn status(&self) -> Status {
        let (meters, ring_fill) = (self.hub.meters(), self.hub.record_fill());
        let inner = self.lock();
        let work = &inner.work;
        let rig = self.rig();
        Status {
            state: inner.state,
            since_utc: inner.since_utc.clone(),
            possible: inner.state.possible(),
            cause: inner.cause.clone(),
            interlocks: self.interlocks(&inner),
            checked: inner.checked.clone(),
            checking: inner.checking,
            setup: SetupShort {
                name: work.name.clone(),
                case: work.case.map(|case| case.to_string()),
                rig: rig.name.clone(),
                simulated: rig.hardware.is_none(),
                model: work.model.name.clone(),
                effects: work.model.effects.iter().map(|effect| effect.name.clone()).collect(),
                undos: work.undos(),
                acceleration_g: work.sweep.acceleration_g,
                total_gap_m: work.model.bumper.as_ref().map(|bumper| bumper.total_gap_m),
                reach_m: rig.capacity().displacement_m,
                sample_rate_hz: rig.sample_rate_hz,
            },
            run: inner.live.as_ref().map(|live| running(live, ring_fill)),
            ended: inner.ended.clone(),
            meters,
            version: env!("CARGO_PKG_VERSION"),
        }
    }

    /// The steps that the run which goes on has finished.
    pub fn finished_steps(&self) -> Vec<StepSummary> {
        self.lock().live.as_ref().map(|live| live.steps.clone()).unwrap_or_default()
    }

    fn interlocks(&self, inner: &super::desk::Inner) -> Vec<Interlock> {
        let link = |name, ok, text: &str| Interlock { name, ok, text: text.to_owned() };
        let line = |name: &'static str, check: &str| {
            let found = inner.checked.as_ref().and_then(|c| c.lines.iter().find(|line| line.name == check));
            match found {
                Some(line) => Interlock { name, ok: line.ok, text: line.found.clone() },
                None if inner.live.is_some() => {
                    Interlock { name, ok: true, text: "checked before the run".into() }
                }
                None => Interlock { name, ok: false, text: "not checked yet".into() },
            }
        };
        let latch = match &inner.cause {
            None => link("no latched cause", true, "clear"),
            Some(cause) => link("no latched cause", false, &cause.text),
        };
        let armed = matches!(inner.state, State::Armed) || inner.state.is_live();
        let mut chain = vec![
            latch,
            line("links", "links"),
            line("loop", "loop check"),
            line("table limits", "sweep within the table's limits"),
            line("disk", "disk"),
            link("armed", armed, if armed { "confirmed by an operator" } else { "not armed" }),
        ];
        chain.extend(inner.link.interlock());
        chain
    }
}

fn running(live: &Live, ring_fill: f64) -> Running {
    let steps = live.schedule.steps();
    let at = live.at.and_then(|(index, since)| Some((steps.get(index as usize)?, since)));
    let elapsed_s = live.newest.saturating_sub(live.first.unwrap_or(live.newest)) as f64 / live.rate_hz;
    let total_s = live.schedule.duration_s();
    // By the step, not by the clock: a hold or a wait for the steady state moves all that follows.
    let done_s = at.map_or(elapsed_s, |(step, since)| {
        let in_step_s = live.newest.saturating_sub(since) as f64 / live.rate_hz;
        step.start_s + in_step_s.min(step.end_s - step.start_s)
    });
    Running {
        id: live.id.clone(),
        name: live.name.clone(),
        step: at.map(|(step, _)| step.index),
        steps: steps.len(),
        frequency_hz: at.map(|(step, _)| step.frequency_hz),
        direction: at.map(|(step, _)| step.direction.label()),
        progress: (done_s / total_s).clamp(0.0, 1.0),
        eta_s: (total_s - done_s).max(0.0),
        elapsed_s,
        nrmse_a: live.error.nrmse_a,
        nrmse_d: live.error.nrmse_d,
        slips: live.slips,
        lost_samples: live.daq_lost,
        finished: live.steps.len(),
        supervisor: live.supervisor.name(),
        real_time: live.real_time.clone(),
        ring_fill,
        evidence: live.evidence.latest(),
    }
}
