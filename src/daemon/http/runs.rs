//! Endpoints of recorded runs: list, search, steps, events, report, the samples of a step, notes, export. A
//! run is named by its folder below the folder of the runs and by nothing else.

use super::App;
use super::error::{ApiError, Body, Path, Problem, Query};
use super::gate::Caller;
use crate::record::data::{self, Format, ReadOptions};
use crate::record::folder::list;
use crate::record::samples::SampleReader;
use crate::record::{Manifest, Record, RunFolder, RunState};
use crate::stream::Row;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::VecDeque;
use std::sync::Arc;
use utoipa::{IntoParams, ToSchema};

/// Longest notes, bytes.
const LONGEST_NOTES: usize = 64 * 1024;
/// Most points of a channel in an answer.
const MOST_POINTS: usize = 8192;

/// A run in the list.
#[derive(Serialize, ToSchema)]
pub struct RunShort {
    /// Folder name.
    pub id: String,
    /// Name.
    pub name: String,
    /// `running`, `done`, `stopped`, `aborted`, `failed`, `interrupted`, or `unreadable`.
    pub state: String,
    /// First-out cause, or why it cannot be read.
    pub cause: Option<String>,
    /// Case of the paper.
    pub case: Option<String>,
    /// Start, UTC.
    pub started_utc: String,
    /// Nothing was lost and the run ended as asked.
    pub clean: bool,
    /// Samples.
    pub samples: u64,
    /// Samples lost.
    pub lost_samples: u64,
    /// Name of the onboard model.
    pub model: Option<String>,
    /// First line of the notes.
    pub note: Option<String>,
}

/// Which runs are wanted.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct Search {
    /// Words that name, case, state, model or notes must have.
    #[param(max_length = 200)]
    search: Option<String>,
    /// At most so many, newest first.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
}

/// Which samples are wanted.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct Which {
    /// Index of the step.
    #[param(minimum = 0)]
    step: i32,
    /// So many of its last cycles.
    #[param(minimum = 1, maximum = 100)]
    cycles: Option<u32>,
}

/// The samples of the last cycles of a step.
#[derive(Serialize, ToSchema)]
pub struct Cycles {
    /// Index of the step.
    pub step: i32,
    /// Its frequency, Hz.
    pub frequency_hz: f64,
    /// Time since the first of them, s.
    pub time_s: Vec<f64>,
    /// Phase of the command's cycle, deg, 0 to 360.
    pub phase_deg: Vec<f64>,
    /// Table acceleration, m/s2.
    pub table_acceleration_m_s2: Vec<f64>,
    /// Measured A, m/s2.
    pub mass_acceleration_m_s2: Vec<f64>,
    /// Measured D, m.
    pub relative_displacement_m: Vec<f64>,
    /// The onboard model's A, m/s2.
    pub model_acceleration_m_s2: Vec<f64>,
    /// The onboard model's D, m.
    pub model_displacement_m: Vec<f64>,
}

/// Notes on a run.
#[derive(Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Notes {
    /// The text.
    #[schema(max_length = 65536)]
    pub text: String,
}

/// Which file is wanted.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct Wanted {
    /// Format of the file.
    #[param(inline)]
    format: FileFormat,
}

/// File formats of an export.
#[derive(Clone, Copy, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum FileFormat {
    /// Comma-separated values.
    Csv,
    /// HDF5.
    Hdf5,
    /// MATLAB 7.3.
    Mat,
    /// Universal file, data set 58.
    Uff,
    /// Parquet.
    Parquet,
}

/// The folder of a run. A name with anything but letters, digits, `-`, `_` and `.` names none, nor does one
/// that begins with a dot: nothing outside the folder of the runs can be named.
pub(super) fn folder(app: &App, id: &str) -> Result<RunFolder, ApiError> {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    let named = !id.is_empty() && id.len() <= 200 && !id.starts_with('.') && id.chars().all(plain);
    let absent = || ApiError::not_found(format!("no run `{}`", id.chars().take(80).collect::<String>()));
    if !named {
        return Err(absent());
    }
    let path = app.desk.out().join(id);
    // A link could lead out of the folder.
    if std::fs::symlink_metadata(&path).is_ok_and(|found| found.is_symlink()) {
        return Err(absent());
    }
    RunFolder::open(&path).map_err(|_| absent())
}

fn notes_path(folder: &RunFolder) -> std::path::PathBuf {
    folder.path().join("notes.txt")
}

fn short(id: String, folder: &std::path::Path, manifest: &Manifest, state: RunState) -> RunShort {
    #[derive(Deserialize)]
    struct Name {
        name: String,
    }
    let model = manifest.configuration.get("model").and_then(|text| toml::from_str::<Name>(text).ok());
    let notes = std::fs::read_to_string(folder.join("notes.txt")).ok();
    RunShort {
        id,
        name: manifest.name.clone(),
        state: state.name().to_owned(),
        cause: manifest.cause.clone(),
        case: manifest.case.clone(),
        started_utc: manifest.started_utc.clone(),
        clean: manifest.clean,
        samples: manifest.samples,
        lost_samples: manifest.lost.samples,
        model: model.map(|model| model.name),
        note: notes.and_then(|text| text.lines().next().map(str::to_owned)),
    }
}

/// Recorded runs, newest first
#[utoipa::path(get, path = "/api/v1/runs", tag = "runs", params(Search), responses((status = 200, body = Vec<RunShort>)))]
pub async fn runs(
    State(app): State<Arc<App>>,
    Query(search): Query<Search>,
) -> Result<Json<Vec<RunShort>>, ApiError> {
    let limit = search.limit.unwrap_or(200).clamp(1, 1000) as usize;
    let words: Vec<String> =
        search.search.unwrap_or_default().split_whitespace().map(str::to_lowercase).take(20).collect();
    let found = super::blocking(move || {
        let mut found = Vec::new();
        for (path, read) in list(app.desk.out())?.into_iter().rev() {
            let id = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
            let run = match read {
                Ok((manifest, state)) => short(id, &path, &manifest, state),
                Err(error) => RunShort {
                    name: id.clone(),
                    id,
                    state: "unreadable".into(),
                    cause: Some(error.to_string()),
                    case: None,
                    started_utc: String::new(),
                    clean: false,
                    samples: 0,
                    lost_samples: 0,
                    model: None,
                    note: None,
                },
            };
            let text = format!("{run:?}").to_lowercase();
            if words.iter().all(|word| text.contains(word)) {
                found.push(run);
            }
            if found.len() >= limit {
                break;
            }
        }
        Ok::<_, crate::record::RunError>(found)
    });
    found.await?.map(Json).map_err(ApiError::failed)
}

impl std::fmt::Debug for RunShort {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let or = |text: &Option<String>| text.clone().unwrap_or_default();
        write!(
            f,
            "{} {} {} {} {} {}",
            self.id,
            self.name,
            self.state,
            or(&self.case),
            or(&self.model),
            or(&self.note)
        )
    }
}

/// Everything that `run.toml` says of a run
#[utoipa::path(get, path = "/api/v1/runs/{id}", tag = "runs", params(("id" = String, Path)), responses(
    (status = 200, body = Object), (status = 404, body = Problem)))]
pub async fn run(State(app): State<Arc<App>>, Path(id): Path<String>) -> Result<Json<Manifest>, ApiError> {
    folder(&app, &id)?.manifest().map(Json).map_err(ApiError::failed)
}

/// The steps of a run, as `steps.csv` has them
#[utoipa::path(get, path = "/api/v1/runs/{id}/steps", tag = "runs", params(("id" = String, Path)), responses(
    (status = 200, body = Vec<Object>), (status = 404, body = Problem)))]
pub async fn steps(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<Json<Vec<crate::control::StepSummary>>, ApiError> {
    let folder = folder(&app, &id)?;
    super::blocking(move || read_steps(&folder)).await?.map(Json)
}

fn read_steps(folder: &RunFolder) -> Result<Vec<crate::control::StepSummary>, ApiError> {
    crate::record::steps_csv::read(&folder.steps()).map_err(ApiError::failed)
}

/// The events of a run, a JSON object a line
#[utoipa::path(get, path = "/api/v1/runs/{id}/events", tag = "runs", params(("id" = String, Path)), responses(
    (status = 200, body = String, content_type = "application/jsonl"), (status = 404, body = Problem)))]
pub async fn events(State(app): State<Arc<App>>, Path(id): Path<String>) -> Result<Response, ApiError> {
    let path = folder(&app, &id)?.events();
    let text = tokio::fs::read(path).await.map_err(ApiError::failed)?;
    Ok(([(header::CONTENT_TYPE, "application/jsonl")], text).into_response())
}

/// The report of a run, a page of its own
#[utoipa::path(get, path = "/api/v1/runs/{id}/report", tag = "runs", params(("id" = String, Path)), responses(
    (status = 200, body = String, content_type = "text/html"), (status = 404, body = Problem)))]
pub async fn report(State(app): State<Arc<App>>, Path(id): Path<String>) -> Result<Response, ApiError> {
    let path = folder(&app, &id)?.report();
    let text = tokio::fs::read(path).await.map_err(|_| ApiError::not_found("the run has no report yet"))?;
    // Whatever a report holds, it is no part of the page: it runs nothing and asks for nothing.
    let policy = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox";
    let headers =
        [(header::CONTENT_TYPE, "text/html; charset=utf-8"), (header::CONTENT_SECURITY_POLICY, policy)];
    Ok((headers, text).into_response())
}

/// The samples of the last cycles of a step
#[utoipa::path(get, path = "/api/v1/runs/{id}/cycles", tag = "runs", params(("id" = String, Path), Which), responses(
    (status = 200, body = Cycles), (status = 404, body = Problem)))]
pub async fn cycles(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    Query(which): Query<Which>,
) -> Result<Json<Cycles>, ApiError> {
    let folder = folder(&app, &id)?;
    app.answer(move || read_cycles(&folder, &which)).await?.map(Json)
}

/// Rows that are read at once.
const CHUNK: u64 = 32_768;

fn read_cycles(folder: &RunFolder, which: &Which) -> Result<Cycles, ApiError> {
    let steps = read_steps(folder)?;
    let absent = || ApiError::not_found(format!("the run has no finished step {}", which.step));
    let step = steps.iter().find(|step| step.index as i32 == which.step).ok_or_else(absent)?;
    let reader = SampleReader::open(&folder.samples()).map_err(ApiError::conflict)?;
    let rate = reader.sample_rate_hz();
    let cycle = rate / step.frequency_hz;
    let wanted = (f64::from(which.cycles.unwrap_or(3).clamp(1, 100)) * cycle).round() as usize;
    // Counted rows of the step so far, and the last of them.
    let (mut counted, mut kept) = (0, VecDeque::new());
    let mut at = 0;
    'file: while at < reader.rows() {
        let rows = reader.read(at, CHUNK.min(reader.rows() - at)).map_err(ApiError::conflict)?;
        at += rows.len() as u64;
        for row in rows {
            if row.step > which.step {
                break 'file;
            }
            if row.step == which.step {
                counted += 1;
                kept.push_back(row);
                if kept.len() > wanted {
                    kept.pop_front();
                }
            }
        }
    }
    if kept.is_empty() {
        return Err(absent());
    }
    let from = counted - kept.len();
    let every = kept.len().div_ceil(MOST_POINTS).max(1);
    let picked: Vec<(usize, &Row)> = kept.iter().enumerate().step_by(every).collect();
    let of = |value: fn(&Row) -> f64| picked.iter().map(|(_, row)| value(row)).collect::<Vec<_>>();
    Ok(Cycles {
        step: which.step,
        frequency_hz: step.frequency_hz,
        time_s: picked.iter().map(|(i, _)| *i as f64 / rate).collect(),
        // Counted cycles begin at phase 0.
        phase_deg: picked.iter().map(|(i, _)| 360.0 * ((from + i) as f64 / cycle).fract()).collect(),
        table_acceleration_m_s2: of(|row| row.sample.channels.table_acceleration_m_s2),
        mass_acceleration_m_s2: of(|row| row.sample.channels.mass_acceleration_m_s2()),
        relative_displacement_m: of(|row| row.sample.channels.relative_displacement_m),
        model_acceleration_m_s2: of(|row| row.model_acceleration_m_s2),
        model_displacement_m: of(|row| row.model_displacement_m),
    })
}

/// Notes on a run
#[utoipa::path(get, path = "/api/v1/runs/{id}/notes", tag = "runs", params(("id" = String, Path)), responses(
    (status = 200, body = Notes), (status = 404, body = Problem)))]
pub async fn notes(State(app): State<Arc<App>>, Path(id): Path<String>) -> Result<Json<Notes>, ApiError> {
    let path = notes_path(&folder(&app, &id)?);
    match tokio::fs::read_to_string(path).await {
        Ok(text) => Ok(Json(Notes { text })),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Json(Notes { text: String::new() })),
        Err(error) => Err(ApiError::failed(error)),
    }
}

/// Write notes on a run
#[utoipa::path(put, path = "/api/v1/runs/{id}/notes", tag = "runs", request_body = Notes,
    params(("id" = String, Path)), responses(
    (status = 200, body = Notes), (status = 404, body = Problem), (status = 422, body = Problem)))]
pub async fn write_notes(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    Body(notes): Body<Notes>,
) -> Result<Json<Notes>, ApiError> {
    let folder = folder(&app, &id)?;
    if notes.text.len() > LONGEST_NOTES {
        return Err(ApiError::invalid(format!(
            "notes of {} bytes; allowed: {LONGEST_NOTES}",
            notes.text.len()
        )));
    }
    tokio::fs::write(notes_path(&folder), &notes.text).await.map_err(ApiError::failed)?;
    app.desk.journal.note(&caller.who, "notes", json!({ "run": id }));
    Ok(Json(notes))
}

/// A run in the format of another tool
#[utoipa::path(get, path = "/api/v1/runs/{id}/export", tag = "runs", params(("id" = String, Path), Wanted), responses(
    (status = 200, body = Vec<u8>, content_type = "application/octet-stream"), (status = 404, body = Problem),
    (status = 409, body = Problem)))]
pub async fn export(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    Query(wanted): Query<Wanted>,
) -> Result<Response, ApiError> {
    let folder = folder(&app, &id)?;
    let (format, ending) = match wanted.format {
        FileFormat::Csv => (Format::Csv, "csv"),
        FileFormat::Hdf5 => (Format::Hdf5, "h5"),
        FileFormat::Mat => (Format::Mat, "mat"),
        FileFormat::Uff => (Format::Uff58, "uff"),
        FileFormat::Parquet => (Format::Parquet, "parquet"),
    };
    let turn = app.turn().await?;
    let name = format!("{id}.{ending}");
    let path = folder.path().join(format!(".export-{}.{ending}", app.unique()));
    let target = path.clone();
    let written = super::blocking(move || {
        let record = Record::open(folder.path(), &ReadOptions::default()).map_err(|e| e.to_string())?;
        data::write(&record, &target, format).map_err(|e| e.to_string())
    });
    let written = written.await?;
    drop(turn);
    let opened = tokio::fs::File::open(&path).await;
    // The open file stays readable; nobody else sees it.
    let _ = tokio::fs::remove_file(&path).await;
    written.map_err(ApiError::conflict)?;
    let body =
        axum::body::Body::from_stream(tokio_util::io::ReaderStream::new(opened.map_err(ApiError::failed)?));
    let headers = [
        (header::CONTENT_TYPE, "application/octet-stream".to_owned()),
        (header::CONTENT_DISPOSITION, format!("attachment; filename=\"{name}\"")),
    ];
    Ok((headers, body).into_response())
}
