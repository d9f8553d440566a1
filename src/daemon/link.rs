//! The operator's link at the desk: a sign of life that someone at the table sends on purpose (`watch --heartbeat`, or a
//! dead man's switch that speaks HTTP), independent of any page. The desk hands each on to the control thread, whose
//! detector `operator-link` stops the run when they stay away; between runs the desk itself arms, starts and resets
//! nothing as long as a configured link is silent (SR-18).

use super::desk::{Desk, DeskError, Inner};
use super::state::State;
use super::status::Interlock;
use crate::control::Request;
use crate::safety::{DetectorId, SafetySpec};
use serde::Serialize;
use serde_json::json;
use std::time::{Duration, Instant};
use utoipa::ToSchema;

/// What a sign of life is answered with.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub struct Heard {
    /// State of the bench.
    pub state: State,
    /// A link is configured (`supervision.operator_link`): when the next sign stays away, that counts.
    pub watched: bool,
    /// After so much silence a run is stopped, s.
    pub silence_s: f64,
}

/// What is known of the link.
#[derive(Clone, Copy, Debug)]
pub(super) struct Link {
    watched: bool,
    silence: Duration,
    heard: Option<Instant>,
    /// Whether it was there when it was last asked about.
    there: bool,
}

impl Link {
    /// As the safety file says.
    pub(super) fn new(spec: &SafetySpec) -> Self {
        let row = spec.row(DetectorId::OperatorLink);
        Self {
            watched: spec.supervision.operator_link && row.disabled.is_none(),
            silence: Duration::try_from_secs_f64(row.trip).unwrap_or(Duration::MAX),
            heard: None,
            there: false,
        }
    }

    /// A link that is configured and has not been heard of for too long, or never.
    fn silent(&self) -> bool {
        self.watched && self.heard.is_none_or(|at| at.elapsed() >= self.silence)
    }

    /// Refuses what must not happen while a configured link is silent.
    pub(super) fn required(&self) -> Result<(), DeskError> {
        if !self.silent() {
            return Ok(());
        }
        let last = match self.heard {
            Some(at) => format!("for {:.1} s", at.elapsed().as_secs_f64()),
            None => "so far".to_owned(),
        };
        Err(DeskError::Silent(format!(
            "the operator's link has not been heard of {last}: `shaketable watch --heartbeat` is one"
        )))
    }

    /// Its line in the interlock chain, where one is configured.
    pub(super) fn interlock(&self) -> Option<Interlock> {
        let ok = !self.silent();
        let text = if ok { "heard" } else { "silent" }.to_owned();
        self.watched.then_some(Interlock { name: "operator's link", ok, text })
    }
}

impl Desk {
    /// A sign of life of the operator's side; a run that goes on is told at once.
    pub fn alive(&self, who: &str) -> Heard {
        let (heard, returned) = {
            let mut inner = self.lock();
            let returned = inner.link.silent();
            inner.link.heard = Some(Instant::now());
            if let Some(live) = inner.live.as_mut() {
                live.ask(Request::Alive);
            }
            let Link { watched, silence, .. } = inner.link;
            (Heard { state: inner.state, watched, silence_s: silence.as_secs_f64() }, returned)
        };
        if returned {
            self.journal.note(who, "operator-link", json!({ "heard": true }));
            self.touch();
        }
        heard
    }

    /// Looks whether the link has come or gone since the last look; an armed bench is disarmed when it has gone. Called in
    /// the rhythm of the status.
    pub(super) fn watch_link(&self) {
        let changed = {
            let mut inner = self.lock();
            let there = !inner.link.silent();
            let changed = there != inner.link.there;
            inner.link.there = there;
            if changed && !there {
                disarm(&mut inner);
            }
            changed.then_some(there)
        };
        let Some(there) = changed else { return };
        if !there {
            self.journal.note("the daemon", "operator-link", json!({ "heard": false }));
        }
        self.touch();
    }
}

/// Nobody stands at an armed table: it is no longer armed.
fn disarm(inner: &mut Inner) {
    if inner.state == State::Armed {
        inner.enter(State::Idle);
        inner.checked = None;
    }
}
