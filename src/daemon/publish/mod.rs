//! Publication of a table through a NATS server: decimated live data, steps, events and status, under the table's own name,
//! so that one subscriber sees many tables. The daemon starts it when asked to (`serve --publish`). It takes live frames
//! from a queue like that of any page, and lines from the record on the disk: a slow, silent or absent server costs live
//! frames, which are counted, and delays lines, and neither the control thread nor the recorder knows of it.

mod connection;
mod lines;
pub mod spec;
mod task;

pub use spec::{PublishError, PublishSpec};

use super::desk::Desk;
use serde::Serialize;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use utoipa::ToSchema;

/// First word of every subject.
const ROOT: &str = "shaketable";
/// Longest that the end of the daemon waits for a connected server to confirm the last lines.
const FAREWELL: Duration = Duration::from_secs(3);

/// How the publication stands.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, ToSchema)]
pub struct Publication {
    /// The server.
    pub server: String,
    /// Name of this table.
    pub table: String,
    /// Connected and logged in.
    pub connected: bool,
    /// Connections so far.
    pub connections: u64,
    /// Messages that have surely arrived.
    pub messages: u64,
    /// Live frames that have surely arrived.
    pub frames: u64,
    /// Live frames that have not, or not surely, arrived: no server, a slow one, or a connection that was lost.
    pub frames_dropped: u64,
    /// Events and steps that were sent again after a connection was lost; some of them have arrived twice.
    pub resent: u64,
    /// Bytes of `events.jsonl` that the server has not confirmed yet.
    pub waiting_bytes: u64,
    /// Events and steps that cannot be published: too long for the server.
    pub lines_dropped: u64,
    /// Runs that were given up: more than 64 waited for the server, or the record could not be read.
    pub runs_dropped: u64,
    /// What went wrong last.
    pub error: Option<String>,
}

/// How the publication stands, for all who ask.
#[derive(Debug, Default)]
pub struct Facts(Mutex<Publication>);

impl Facts {
    fn lock(&self) -> MutexGuard<'_, Publication> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How it stands now.
    pub fn read(&self) -> Publication {
        self.lock().clone()
    }
}

/// A publication that goes on.
pub struct Publisher {
    facts: Arc<Facts>,
    closing: watch::Sender<bool>,
    task: JoinHandle<()>,
}

impl Publisher {
    /// Starts to publish what a desk does; `spec` is complete.
    pub fn start(desk: Arc<Desk>, spec: PublishSpec) -> Self {
        let first = Publication {
            server: spec.server.clone(),
            table: spec.table().to_owned(),
            ..Publication::default()
        };
        let facts = Arc::new(Facts(Mutex::new(first)));
        let (closing, closed) = watch::channel(false);
        let task = tokio::spawn(task::run(desk, spec, facts.clone(), closed));
        Self { facts, closing, task }
    }

    /// How it stands, for health and metrics.
    pub fn facts(&self) -> Arc<Facts> {
        self.facts.clone()
    }

    /// Ends once a connected server has confirmed everything, or after three seconds.
    pub async fn close(mut self) {
        self.closing.send_replace(true);
        if tokio::time::timeout(FAREWELL, &mut self.task).await.is_err() {
            self.task.abort();
            tracing::warn!("not everything was published; the record has all of it");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Case;
    use crate::control::session::Pace;
    use crate::control::setup::model_of_case;
    use crate::daemon::desk::Options;
    use crate::daemon::work::Work;
    use crate::rig::RigSpec;
    use crate::safety::SafetySpec;
    use crate::stream::{Depths, Row, Sample, split};
    use crate::sweep::SweepSpec;

    fn desk(out: &std::path::Path) -> Arc<Desk> {
        let case: Case = "B1-G2-0.05".parse().expect("case");
        let work = Work::new(Some(case), SweepSpec::paper(), model_of_case(&case), None);
        let safety = SafetySpec::built_in().expect("valid");
        let (out, pace) = (out.to_owned(), Pace::Virtual);
        Desk::new(Options { out, rig: RigSpec::default(), work, seed: 1, pace, safety })
    }

    #[tokio::test]
    async fn without_a_server_frames_are_dropped_and_counted_and_lines_wait() {
        let folder = tempfile::tempdir().expect("folder");
        let desk = desk(folder.path());
        // A port that was free a moment ago, and that nobody listens on.
        let port =
            std::net::TcpListener::bind("127.0.0.1:0").and_then(|l| l.local_addr()).expect("port").port();
        let spec = PublishSpec {
            server: format!("nats://127.0.0.1:{port}"),
            table: Some("east".into()),
            live_rows: 1,
            credentials: None,
            trust: None,
            certificate: None,
        };
        let publisher = Publisher::start(desk.clone(), spec);
        let facts = publisher.facts();
        let seen = |wanted: fn(&Publication) -> bool| {
            let facts = facts.clone();
            async move {
                let until = async {
                    while !wanted(&facts.read()) {
                        tokio::time::sleep(Duration::from_millis(5)).await;
                    }
                };
                let outcome = tokio::time::timeout(Duration::from_secs(20), until).await;
                outcome.unwrap_or_else(|_| panic!("never: {:?}", facts.read()));
            }
        };
        seen(|publication| publication.error.is_some()).await;
        assert_eq!(desk.hub.traffic().2, 1, "a seat like that of any page");
        let events = folder.path().join("run.jsonl");
        desk.journal.note("operator", "arm", serde_json::json!({}));
        desk.journal.begin_run(events.clone());
        let (mut control, _recorder, view, _operator) = split::<u8, u8>(Depths::default());
        for sequence in 0..100 {
            control.publish(&Row { sample: Sample { sequence, ..Sample::default() }, ..Row::default() });
        }
        drop(control);
        desk.hub.follow("night".into(), view, 2048.0, None);
        seen(|publication| publication.frames_dropped == 1 && publication.waiting_bytes > 0).await;
        let publication = facts.read();
        assert_eq!(publication.waiting_bytes, std::fs::metadata(&events).expect("written").len());
        assert_eq!((publication.connected, publication.messages), (false, 0));
        publisher.close().await;
        assert_eq!(desk.hub.traffic().2, 0);
    }
}
