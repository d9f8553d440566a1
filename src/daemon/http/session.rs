//! Endpoints of the session: status, checks, arming, starting, holding, stopping, resetting.

use super::App;
use super::error::{ApiError, Body, Problem};
use super::gate::Caller;
use crate::control::StepSummary;
use crate::daemon::check::Checked;
use crate::daemon::link::Heard;
use crate::daemon::state::{Action, State as BenchState};
use crate::daemon::status::Status;
use axum::extract::State;
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::sync::Arc;
use utoipa::ToSchema;

/// Which checks are confirmed.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Confirm {
    /// Number of the checks, as they were shown.
    pub pre_flight: u64,
}

/// Which cause is acknowledged.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Acknowledge {
    /// The first-out detector, as it was shown.
    #[schema(max_length = 200)]
    pub cause: String,
}

/// The state after a request.
#[derive(Serialize, ToSchema)]
pub struct Now {
    /// State of the bench.
    pub state: BenchState,
}

/// The run that was started.
#[derive(Serialize, ToSchema)]
pub struct StartedRun {
    /// Folder name of the run.
    pub id: String,
}

/// Status of the bench
#[utoipa::path(get, path = "/api/v1/status", tag = "session", responses((status = 200, body = Status)))]
pub async fn status(State(app): State<Arc<App>>) -> Json<Status> {
    Json(app.desk.status())
}

/// Latest entries of the journal, oldest first
#[utoipa::path(get, path = "/api/v1/journal", tag = "session", responses((status = 200, body = Vec<Value>)))]
pub async fn journal(State(app): State<Arc<App>>) -> Json<Vec<Value>> {
    Json(app.desk.journal.recent())
}

/// Steps that the present run has finished
#[utoipa::path(get, path = "/api/v1/session/steps", tag = "session", responses((status = 200, body = Vec<Object>)))]
pub async fn steps(State(app): State<Arc<App>>) -> Json<Vec<StepSummary>> {
    Json(app.desk.finished_steps())
}

/// Make the checks before a run
#[utoipa::path(post, path = "/api/v1/session/pre-flight", tag = "session", responses(
    (status = 200, body = Checked), (status = 409, body = Problem)))]
pub async fn preflight(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
) -> Result<Json<Checked>, ApiError> {
    let desk = app.desk.clone();
    let checked = super::blocking(move || desk.preflight(&caller.who)).await??;
    Ok(Json(checked))
}

/// Confirm the checks: the bench may be started
#[utoipa::path(post, path = "/api/v1/session/arm", tag = "session", request_body = Confirm, responses(
    (status = 200, body = Now), (status = 409, body = Problem)))]
pub async fn arm(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
    Body(confirm): Body<Confirm>,
) -> Result<Json<Now>, ApiError> {
    app.desk.arm(&caller.who, confirm.pre_flight)?;
    Ok(Json(Now { state: app.desk.state() }))
}

/// Give the confirmation back
#[utoipa::path(post, path = "/api/v1/session/disarm", tag = "session", responses(
    (status = 200, body = Now), (status = 409, body = Problem)))]
pub async fn disarm(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
) -> Result<Json<Now>, ApiError> {
    app.desk.disarm(&caller.who)?;
    Ok(Json(Now { state: app.desk.state() }))
}

/// Start the sweep on an armed bench
#[utoipa::path(post, path = "/api/v1/session/start", tag = "session", responses(
    (status = 200, body = StartedRun), (status = 409, body = Problem)))]
pub async fn start(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
) -> Result<Json<StartedRun>, ApiError> {
    Ok(Json(StartedRun { id: app.desk.start(&caller.who).await? }))
}

/// Stay in the present step once its counted cycles are done
#[utoipa::path(post, path = "/api/v1/session/hold", tag = "session", responses(
    (status = 200, body = Now), (status = 409, body = Problem)))]
pub async fn hold(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
) -> Result<Json<Now>, ApiError> {
    Ok(Json(Now { state: app.desk.ask(&caller.who, Action::Hold)? }))
}

/// End a hold
#[utoipa::path(post, path = "/api/v1/session/resume", tag = "session", responses(
    (status = 200, body = Now), (status = 409, body = Problem)))]
pub async fn resume(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
) -> Result<Json<Now>, ApiError> {
    Ok(Json(Now { state: app.desk.ask(&caller.who, Action::Resume)? }))
}

/// Bring the table to rest; every viewer may
#[utoipa::path(post, path = "/api/v1/session/stop", tag = "session", responses(
    (status = 200, body = Now), (status = 409, body = Problem)))]
pub async fn stop(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
) -> Result<Json<Now>, ApiError> {
    Ok(Json(Now { state: app.desk.ask(&caller.who, Action::Stop)? }))
}

/// Acknowledge the cause of an abort and clear it
#[utoipa::path(post, path = "/api/v1/session/reset", tag = "session", request_body = Acknowledge, responses(
    (status = 200, body = Now), (status = 409, body = Problem)))]
pub async fn reset(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
    Body(acknowledge): Body<Acknowledge>,
) -> Result<Json<Now>, ApiError> {
    app.desk.reset(&caller.who, &acknowledge.cause)?;
    Ok(Json(Now { state: app.desk.state() }))
}

/// A sign of life of the operator's link; several a second, as long as someone watches over the table
#[utoipa::path(post, path = "/api/v1/session/alive", tag = "session", responses((status = 200, body = Heard)))]
pub async fn alive(State(app): State<Arc<App>>, Extension(caller): Extension<Caller>) -> Json<Heard> {
    Json(app.desk.alive(&caller.who))
}
