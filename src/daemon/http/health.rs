//! Endpoints about the daemon itself: health, metrics, the description of the interface.

use super::App;
use super::error::ApiError;
use crate::control::TimingReport;
use crate::daemon::publish::Publication;
use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use std::sync::Arc;
use utoipa::ToSchema;

/// One counter.
#[derive(Serialize, ToSchema)]
pub struct Count {
    /// What is counted.
    pub name: &'static str,
    /// How often.
    pub count: u64,
}

/// How machine, daemon and last run do.
#[derive(Serialize, ToSchema)]
pub struct Health {
    /// Version of the daemon.
    pub version: &'static str,
    /// Operating system and its version.
    pub system: String,
    /// Rig.
    pub rig: String,
    /// Time since the daemon started, s.
    pub up_s: f64,
    /// Memory of the daemon, bytes.
    pub memory_bytes: u64,
    /// Free disk, bytes.
    pub disk_free_bytes: u64,
    /// Folder of the runs.
    pub runs_folder: String,
    /// Share of the recorder's ring that waits, 0 to 1.
    pub ring_fill: f64,
    /// Clients of the live view.
    pub clients: usize,
    /// Frames that slow clients did not get.
    pub frames_dropped: u64,
    /// Frames sent.
    pub frames_sent: u64,
    /// From the last stop's request to its first command, s; zero before the first.
    pub stop_latency_s: f64,
    /// Real-time set-up of the present run.
    pub real_time: Option<String>,
    /// Timing of the control thread in the last run.
    #[schema(value_type = Option<Object>)]
    pub timing: Option<TimingReport>,
    /// Slips of the present or last run.
    pub slips: u64,
    /// Samples lost in the present or last run.
    pub lost_samples: u64,
    /// Counters of the links of the present run; absent on a simulated rig.
    pub links: Option<Vec<Count>>,
    /// How the publication stands; absent without one.
    pub publication: Option<Publication>,
    /// Why the journal could not be written, if so.
    pub journal: Option<String>,
}

fn memory_bytes() -> u64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages = text.split(' ').nth(1).and_then(|pages| pages.parse::<u64>().ok()).unwrap_or(0);
    pages * rustix::param::page_size() as u64
}

/// How machine, daemon and last run do
#[utoipa::path(get, path = "/api/v1/health", tag = "health", responses((status = 200, body = Health)))]
pub async fn health(State(app): State<Arc<App>>) -> Json<Health> {
    let status = app.desk.status();
    let (frames_dropped, frames_sent, clients) = app.desk.hub.traffic();
    let space = rustix::fs::statvfs(app.desk.out());
    let system = rustix::system::uname();
    let word = |text: &std::ffi::CStr| text.to_string_lossy().into_owned();
    let (slips, lost_samples) = match (&status.run, &status.ended) {
        (Some(run), _) => (run.slips, run.lost_samples),
        (None, Some(ended)) => (ended.slips, ended.lost_samples),
        (None, None) => (0, 0),
    };
    Json(Health {
        version: env!("CARGO_PKG_VERSION"),
        system: format!("{} {} {}", word(system.sysname()), word(system.release()), word(system.machine())),
        rig: app.desk.rig().name.clone(),
        up_s: app.started.elapsed().as_secs_f64(),
        memory_bytes: memory_bytes(),
        disk_free_bytes: space.map_or(0, |space| space.f_bavail * space.f_frsize),
        runs_folder: app.desk.out().display().to_string(),
        ring_fill: app.desk.hub.record_fill(),
        clients,
        frames_dropped,
        frames_sent,
        stop_latency_s: app.desk.stop_latency_s(),
        real_time: status.run.as_ref().and_then(|run| run.real_time.clone()),
        timing: status.ended.map(|ended| ended.timing),
        slips,
        lost_samples,
        links: app
            .desk
            .links()
            .map(|all| all.into_iter().map(|(name, count)| Count { name, count }).collect()),
        publication: app.publication.as_ref().map(|facts| facts.read()),
        journal: app.desk.journal.failed(),
    })
}

/// Metrics for Prometheus
#[utoipa::path(get, path = "/metrics", tag = "health", responses(
    (status = 200, body = String, content_type = "application/openmetrics-text; version=1.0.0; charset=utf-8")))]
pub async fn metrics(State(app): State<Arc<App>>) -> Result<Response, ApiError> {
    let publication = app.publication.as_ref().map(|facts| facts.read());
    let text = app.metrics.text(&app.desk, publication.as_ref()).map_err(ApiError::failed)?;
    let kind = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    Ok(([(header::CONTENT_TYPE, kind)], text).into_response())
}

/// This description
#[utoipa::path(get, path = "/api/openapi.json", tag = "health", responses((status = 200, body = Object)))]
pub async fn description(State(app): State<Arc<App>>) -> Response {
    ([(header::CONTENT_TYPE, "application/json")], app.description.clone()).into_response()
}
