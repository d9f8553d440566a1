//! Answers of the interface that are no success: one JSON shape, `{"error": "...", "message": "..."}`.

use crate::daemon::desk::DeskError;
use crate::daemon::work::WorkError;
use axum::Json;
use axum::extract::rejection::{JsonRejection, PathRejection, QueryRejection};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

/// The body of every answer that is no success.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Problem {
    /// A word for programs.
    pub error: &'static str,
    /// What is wrong, where, and what is allowed.
    pub message: String,
}

/// A refusal or failure.
#[derive(Clone, Debug)]
pub struct ApiError {
    status: StatusCode,
    problem: Problem,
}

impl ApiError {
    fn new(status: StatusCode, error: &'static str, message: impl ToString) -> Self {
        Self { status, problem: Problem { error, message: message.to_string() } }
    }

    /// 400: the request is not what it should be.
    pub fn bad(message: impl ToString) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "bad-request", message)
    }

    /// 401: who is it?
    pub fn unknown_caller() -> Self {
        let message = "a token is needed: `Authorization: Bearer ...`, or log in on the page";
        Self::new(StatusCode::UNAUTHORIZED, "token-needed", message)
    }

    /// 403: known, but not allowed.
    pub fn forbidden(message: impl ToString) -> Self {
        Self::new(StatusCode::FORBIDDEN, "forbidden", message)
    }

    /// 404.
    pub fn not_found(message: impl ToString) -> Self {
        Self::new(StatusCode::NOT_FOUND, "not-found", message)
    }

    /// 409: not in this state.
    pub fn conflict(message: impl ToString) -> Self {
        Self::new(StatusCode::CONFLICT, "not-now", message)
    }

    /// 413: the body is announced as larger than allowed.
    pub fn too_large(limit: usize) -> Self {
        let message = format!("the body is larger than the {limit} bytes that are allowed");
        Self::new(StatusCode::PAYLOAD_TOO_LARGE, "too-large", message)
    }

    /// 421: the host is not ours.
    pub fn misdirected(host: &str) -> Self {
        let message = format!("`{host}` is not a name of this daemon; give --host to add one");
        Self::new(StatusCode::MISDIRECTED_REQUEST, "wrong-host", message)
    }

    /// 422: understood, but not allowed as a value.
    pub fn invalid(message: impl ToString) -> Self {
        Self::new(StatusCode::UNPROCESSABLE_ENTITY, "invalid", message)
    }

    /// 429.
    pub fn too_many(message: impl ToString) -> Self {
        Self::new(StatusCode::TOO_MANY_REQUESTS, "too-many", message)
    }

    /// 500: a fault of this machine or program.
    pub fn failed(message: impl ToString) -> Self {
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, "failed", message)
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        (self.status, Json(self.problem)).into_response()
    }
}

impl From<DeskError> for ApiError {
    fn from(error: DeskError) -> Self {
        match error {
            DeskError::Work(error) => error.into(),
            DeskError::NotNow(_) | DeskError::Unchecked(_) | DeskError::Busy => Self::conflict(error),
            DeskError::Acknowledge(_) => Self::conflict(error),
            DeskError::Start(_) | DeskError::Silent(_) => Self::conflict(error),
        }
    }
}

impl From<WorkError> for ApiError {
    fn from(error: WorkError) -> Self {
        match error {
            WorkError::Invalid { .. } => Self::invalid(error),
            WorkError::NothingToUndo => Self::conflict(error),
        }
    }
}

impl From<JsonRejection> for ApiError {
    fn from(rejection: JsonRejection) -> Self {
        Self::new(rejection.status(), "bad-body", rejection.body_text())
    }
}

impl From<PathRejection> for ApiError {
    fn from(rejection: PathRejection) -> Self {
        Self::bad(rejection.body_text())
    }
}

impl From<QueryRejection> for ApiError {
    fn from(rejection: QueryRejection) -> Self {
        Self::bad(rejection.body_text())
    }
}

/// A JSON body whose rejection has our shape.
#[derive(axum::extract::FromRequest)]
#[from_request(via(Json), rejection(ApiError))]
pub struct Body<T>(pub T);

/// Path parameters whose rejection has our shape.
#[derive(axum::extract::FromRequestParts)]
#[from_request(via(axum::extract::Path), rejection(ApiError))]
pub struct Path<T>(pub T);

/// A query whose rejection has our shape.
#[derive(axum::extract::FromRequestParts)]
#[from_request(via(axum::extract::Query), rejection(ApiError))]
pub struct Query<T>(pub T);
