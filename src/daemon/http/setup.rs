//! Endpoints of what is set up: sweep, case, onboard model with its effects; what a sweep asks of the table
//! and what the model expects of it.

use super::App;
use super::error::{ApiError, Body, Problem};
use super::gate::Caller;
use crate::config::{Case, builtin};
use crate::daemon::preview::{Asks, Expected, asks, expected};
use crate::model::effects::{CATALOGUE, Parameter};
use crate::model::{EffectSpec, ModelSpec, Scales};
use crate::rig::simulated::Fault;
use crate::sweep::{Schedule, SweepSpec};
use axum::extract::State;
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::sync::Arc;
use utoipa::ToSchema;

/// Most samples that are simulated for one answer: a quarter of an hour at 2048 Hz.
const MOST_SAMPLES: f64 = 2e6;

/// What is set up for the next run.
#[derive(Serialize, ToSchema)]
pub struct SetUp {
    /// Name of the next run.
    pub name: String,
    /// Case of the paper, if one was named.
    pub case: Option<String>,
    /// The sweep.
    pub sweep: SweepSpec,
    /// The onboard model.
    pub model: ModelSpec,
    /// Changes of the model that can be taken back.
    pub undos: usize,
    /// Names of the sweeps that come with the program.
    pub sweeps: Vec<&'static str>,
    /// Names of the models that come with the program.
    pub models: Vec<&'static str>,
}

/// A case of the paper.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Named {
    /// Bumper, gap and acceleration in g, as in `B1-G2-0.05`.
    #[schema(example = "B1-G2-0.05", max_length = 40)]
    pub case: String,
}

/// A sweep and a model to try; what is left out is as set up.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Trial {
    /// The sweep.
    pub sweep: Option<SweepSpec>,
    /// The model.
    pub model: Option<ModelSpec>,
    /// An effect to add to the model.
    pub effect: Option<EffectSpec>,
}

/// One effect of the catalogue, with parameters for the present model.
#[derive(Serialize, ToSchema)]
pub struct Entry {
    /// Public name.
    pub name: &'static str,
    /// Where it sits.
    #[schema(value_type = String)]
    pub place: crate::model::effects::Place,
    /// Its equation.
    pub equation: &'static str,
    /// Paper or book.
    pub source: &'static str,
    /// How it shows.
    pub shows: &'static str,
    /// The experiment that makes it visible.
    pub experiment: &'static str,
    /// Its parameters: name, unit, meaning, range, starting value.
    #[schema(value_type = Vec<Object>)]
    pub parameters: Vec<Parameter>,
}

/// Switches of the simulated rig.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Switch {
    /// Every channel keeps its last value.
    FrozenFeedback,
    /// No sample arrives.
    Dropout,
    /// Samples are held back and arrive in bursts.
    LateBurst,
    /// The last sample is delivered again.
    RepeatedSample,
    /// The drive's bus is off.
    BusOff,
    /// Bytes of the DAQ link are damaged.
    SerialGarbage,
    /// The drive trips.
    DriveTrip,
}

/// One switch and where it is put.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Switched {
    /// Which.
    pub fault: Switch,
    /// On or off.
    pub on: bool,
}

fn set_up(app: &App) -> SetUp {
    let work = app.desk.work();
    SetUp {
        name: work.name.clone(),
        case: work.case.map(|case| case.to_string()),
        undos: work.undos(),
        sweep: work.sweep,
        model: work.model,
        sweeps: builtin::names("sweeps").collect(),
        models: builtin::names("models").collect(),
    }
}

/// What is set up for the next run
#[utoipa::path(get, path = "/api/v1/setup", tag = "setup", responses((status = 200, body = SetUp)))]
pub async fn get(State(app): State<Arc<App>>) -> Json<SetUp> {
    Json(set_up(&app))
}

/// The catalogue of effects, with parameters for the present model
#[utoipa::path(get, path = "/api/v1/catalogue", tag = "setup", responses((status = 200, body = Vec<Entry>)))]
pub async fn catalogue(State(app): State<Arc<App>>) -> Json<Vec<Entry>> {
    let scales = Scales::of_spec(&app.desk.work().model, 1.0 / app.desk.rig().sample_rate_hz);
    let entry = |effect: &&crate::model::effects::Effect| Entry {
        name: effect.name,
        place: effect.place,
        equation: effect.equation,
        source: effect.source,
        shows: effect.shows,
        experiment: effect.experiment,
        parameters: (effect.parameters)(&scales),
    };
    Json(CATALOGUE.iter().map(entry).collect())
}

/// Set the sweep
#[utoipa::path(put, path = "/api/v1/setup/sweep", tag = "setup", request_body = SweepSpec, responses(
    (status = 200, body = SetUp), (status = 409, body = Problem), (status = 422, body = Problem)))]
pub async fn sweep(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
    Body(sweep): Body<SweepSpec>,
) -> Result<Json<SetUp>, ApiError> {
    let what = json!({ "sweep": sweep });
    app.desk.configure(&caller.who, what, |work| work.set_sweep(sweep))?;
    Ok(Json(set_up(&app)))
}

/// Set bumper, gap and acceleration by a case of the paper
#[utoipa::path(put, path = "/api/v1/setup/case", tag = "setup", request_body = Named, responses(
    (status = 200, body = SetUp), (status = 409, body = Problem), (status = 422, body = Problem)))]
pub async fn case(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
    Body(named): Body<Named>,
) -> Result<Json<SetUp>, ApiError> {
    let case: Case = named.case.parse().map_err(ApiError::invalid)?;
    app.desk.configure(&caller.who, json!({ "case": named.case }), |work| {
        work.set_case(case);
        Ok(())
    })?;
    Ok(Json(set_up(&app)))
}

/// Set the onboard model
#[utoipa::path(put, path = "/api/v1/setup/model", tag = "setup", request_body = ModelSpec, responses(
    (status = 200, body = SetUp), (status = 409, body = Problem), (status = 422, body = Problem)))]
pub async fn model(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
    Body(model): Body<ModelSpec>,
) -> Result<Json<SetUp>, ApiError> {
    let rate = app.desk.rig().sample_rate_hz;
    app.desk.configure(&caller.who, json!({ "model": model }), |work| work.set_model(model, rate))?;
    Ok(Json(set_up(&app)))
}

/// Add an effect to the onboard model
#[utoipa::path(post, path = "/api/v1/setup/model/effects", tag = "setup", request_body = EffectSpec, responses(
    (status = 200, body = SetUp), (status = 409, body = Problem), (status = 422, body = Problem)))]
pub async fn add_effect(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
    Body(effect): Body<EffectSpec>,
) -> Result<Json<SetUp>, ApiError> {
    let rate = app.desk.rig().sample_rate_hz;
    app.desk.configure(&caller.who, json!({ "effect": effect }), |work| {
        let model = work.with_effect(&effect, rate)?;
        work.set_model(model, rate)
    })?;
    Ok(Json(set_up(&app)))
}

/// Take the last change of the onboard model back
#[utoipa::path(post, path = "/api/v1/setup/model/undo", tag = "setup", responses(
    (status = 200, body = SetUp), (status = 409, body = Problem)))]
pub async fn undo(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
) -> Result<Json<SetUp>, ApiError> {
    app.desk.configure(&caller.who, json!({ "undo": true }), |work| work.undo())?;
    Ok(Json(set_up(&app)))
}

/// What a sweep asks of the table
#[utoipa::path(post, path = "/api/v1/preview", tag = "setup", request_body = Trial, responses(
    (status = 200, body = Asks), (status = 422, body = Problem)))]
pub async fn preview(State(app): State<Arc<App>>, Body(trial): Body<Trial>) -> Result<Json<Asks>, ApiError> {
    let setup = tried(&app, trial)?;
    app.answer(move || asks(&setup)).await?.map(Json).map_err(ApiError::invalid)
}

/// What the model expects of a sweep, on an ideal table
#[utoipa::path(post, path = "/api/v1/dry-run", tag = "setup", request_body = Trial, responses(
    (status = 200, body = Vec<Expected>), (status = 422, body = Problem)))]
pub async fn dry_run(
    State(app): State<Arc<App>>,
    Body(trial): Body<Trial>,
) -> Result<Json<Vec<Expected>>, ApiError> {
    let setup = tried(&app, trial)?;
    let schedule = Schedule::new(&setup.sweep).map_err(ApiError::invalid)?;
    let rate = setup.rig.sample_rate_hz;
    let samples = schedule.duration_s() * rate;
    if samples > MOST_SAMPLES {
        let most_s = MOST_SAMPLES / rate;
        return Err(ApiError::invalid(format!(
            "the sweep takes {:.0} s; at most {most_s:.0} s are simulated for an answer",
            samples / rate
        )));
    }
    app.answer(move || expected(&setup.model, schedule.steps(), rate))
        .await?
        .map(Json)
        .map_err(ApiError::invalid)
}

/// What is set up, with what is to be tried in its place.
fn tried(app: &App, trial: Trial) -> Result<crate::control::setup::Setup, ApiError> {
    let mut work = app.desk.work();
    let rate = app.desk.rig().sample_rate_hz;
    if let Some(sweep) = trial.sweep {
        work.set_sweep(sweep)?;
    }
    if let Some(model) = trial.model {
        work.set_model(model, rate)?;
    }
    if let Some(effect) = trial.effect {
        let model = work.with_effect(&effect, rate)?;
        work.set_model(model, rate)?;
    }
    Ok(work.setup(app.desk.rig(), 0))
}

/// Put a fault switch of the simulated rig while it runs
#[utoipa::path(put, path = "/api/v1/rig/faults", tag = "setup", request_body = Switched, responses(
    (status = 200, body = super::session::Now), (status = 409, body = Problem)))]
pub async fn faults(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
    Body(switched): Body<Switched>,
) -> Result<Json<super::session::Now>, ApiError> {
    let switches = app.desk.faults().ok_or_else(|| ApiError::conflict("no simulated rig is running"))?;
    let fault = match switched.fault {
        Switch::FrozenFeedback => Fault::FrozenFeedback,
        Switch::Dropout => Fault::Dropout,
        Switch::LateBurst => Fault::LateBurst,
        Switch::RepeatedSample => Fault::RepeatedSample,
        Switch::BusOff => Fault::BusOff,
        Switch::SerialGarbage => Fault::SerialGarbage,
        Switch::DriveTrip => Fault::DriveTrip,
    };
    switches.set(fault, switched.on);
    app.desk.journal.note(&caller.who, "fault", json!({ "fault": switched.fault, "on": switched.on }));
    Ok(Json(super::session::Now { state: app.desk.state() }))
}
