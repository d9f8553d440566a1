//! Endpoints of the analysis: where a model fails on a run, and what it lacks.

use super::App;
use super::error::{ApiError, Body, Path, Problem};
use super::gate::Caller;
use super::runs::folder;
use crate::daemon::analysis::{Failure, Job, diagnosis, failure};
use crate::model::ModelSpec;
use crate::record::{RunFolder, RunState, read_run};
use axum::extract::State;
use axum::{Extension, Json};
use serde::Deserialize;
use serde_json::json;
use std::sync::Arc;
use utoipa::ToSchema;

/// Which model is judged.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Against {
    /// The onboard model as it is set up now, in place of that of the run.
    #[serde(default)]
    pub as_set_up: bool,
}

fn model(app: &App, folder: &RunFolder, against: &Against) -> Result<ModelSpec, ApiError> {
    let manifest = folder.manifest().map_err(ApiError::failed)?;
    if folder.state(&manifest) == RunState::Running {
        return Err(ApiError::conflict("the run goes on; wait for its end"));
    }
    if against.as_set_up {
        return Ok(app.desk.work().model);
    }
    let setup = crate::control::setup::Setup::of_run(&manifest).map_err(ApiError::conflict)?;
    Ok(setup.model)
}

/// Where the model fails on a run
#[utoipa::path(post, path = "/api/v1/runs/{id}/compare", tag = "analysis", request_body = Against,
    params(("id" = String, Path)), responses(
    (status = 200, body = Failure), (status = 404, body = Problem), (status = 409, body = Problem)))]
pub async fn compare(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    Body(against): Body<Against>,
) -> Result<Json<Failure>, ApiError> {
    let folder = folder(&app, &id)?;
    let model = model(&app, &folder, &against)?;
    let found = app.answer(move || {
        let record = read_run(folder.path()).map_err(|error| error.to_string())?;
        failure(&record, &model).map_err(|error| error.to_string())
    });
    found.await?.map(Json).map_err(ApiError::conflict)
}

/// Ask what the model lacks on a run; the answer is a job's
#[utoipa::path(post, path = "/api/v1/runs/{id}/diagnose", tag = "analysis", request_body = Against,
    params(("id" = String, Path)), responses(
    (status = 200, body = Job), (status = 404, body = Problem), (status = 409, body = Problem)))]
pub async fn diagnose(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    Body(against): Body<Against>,
) -> Result<Json<Job>, ApiError> {
    let folder = folder(&app, &id)?;
    let model = model(&app, &folder, &against)?;
    let scratch = app.desk.out().join(format!(".diagnosis-{}.toml", app.unique()));
    let job = app.jobs.ask(&id, diagnosis(folder.path().to_owned(), model, scratch));
    let job = job.ok_or_else(|| ApiError::too_many("other diagnoses wait; ask again"))?;
    app.desk.journal.note(&caller.who, "diagnose", json!({ "run": id, "job": job.id }));
    Ok(Json(job))
}

/// How a diagnosis stands, and its answer
#[utoipa::path(get, path = "/api/v1/jobs/{id}", tag = "analysis", params(("id" = u64, Path)), responses(
    (status = 200, body = Job), (status = 404, body = Problem)))]
pub async fn job(State(app): State<Arc<App>>, Path(id): Path<u64>) -> Result<Json<Job>, ApiError> {
    app.jobs.get(id).map(Json).ok_or_else(|| ApiError::not_found(format!("no job {id}")))
}
