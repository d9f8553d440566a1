//! The gate before every handler: host, origin, rate, right. One table says which right an endpoint needs;
//! what is not in it is refused. Nothing behind the gate looks at tokens again.

use super::error::ApiError;
use super::{App, LARGEST_BODY};
use crate::daemon::access::{Right, Rights};
use axum::extract::{ConnectInfo, MatchedPath, Request, State};
use axum::http::{HeaderMap, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::SocketAddr;
use std::sync::Arc;

/// Name of the page's cookie.
pub const COOKIE: &str = "shaketable";

/// Every endpoint and the right that it needs.
pub const ENDPOINTS: &[(&str, &str, Right)] = &[
    ("GET", "/", Right::Anyone),
    ("GET", "/app.js", Right::Anyone),
    ("GET", "/app.css", Right::Anyone),
    ("GET", "/icon.svg", Right::Anyone),
    ("GET", "/api/v1/login", Right::Anyone),
    ("POST", "/api/v1/login", Right::Anyone),
    ("DELETE", "/api/v1/login", Right::Anyone),
    ("GET", "/api/openapi.json", Right::View),
    ("GET", "/metrics", Right::View),
    ("GET", "/api/v1/status", Right::View),
    ("GET", "/api/v1/health", Right::View),
    ("GET", "/api/v1/journal", Right::View),
    ("GET", "/api/v1/live", Right::View),
    ("GET", "/api/v1/session/steps", Right::View),
    ("POST", "/api/v1/session/stop", Right::View),
    ("POST", "/api/v1/session/pre-flight", Right::Operate),
    ("POST", "/api/v1/session/arm", Right::Operate),
    ("POST", "/api/v1/session/disarm", Right::Operate),
    ("POST", "/api/v1/session/start", Right::Operate),
    ("POST", "/api/v1/session/hold", Right::Operate),
    ("POST", "/api/v1/session/resume", Right::Operate),
    ("POST", "/api/v1/session/reset", Right::Operate),
    ("POST", "/api/v1/session/alive", Right::Operate),
    ("GET", "/api/v1/setup", Right::View),
    ("GET", "/api/v1/catalogue", Right::View),
    ("PUT", "/api/v1/setup/sweep", Right::Operate),
    ("PUT", "/api/v1/setup/case", Right::Operate),
    ("PUT", "/api/v1/setup/model", Right::Configure),
    ("POST", "/api/v1/setup/model/effects", Right::Configure),
    ("POST", "/api/v1/setup/model/undo", Right::Configure),
    ("POST", "/api/v1/preview", Right::View),
    ("POST", "/api/v1/dry-run", Right::View),
    ("PUT", "/api/v1/rig/faults", Right::Configure),
    ("GET", "/api/v1/runs", Right::View),
    ("GET", "/api/v1/runs/{id}", Right::View),
    ("GET", "/api/v1/runs/{id}/steps", Right::View),
    ("GET", "/api/v1/runs/{id}/events", Right::View),
    ("GET", "/api/v1/runs/{id}/report", Right::View),
    ("GET", "/api/v1/runs/{id}/cycles", Right::View),
    ("POST", "/api/v1/runs/{id}/compare", Right::View),
    ("POST", "/api/v1/runs/{id}/diagnose", Right::Operate),
    ("GET", "/api/v1/jobs/{id}", Right::View),
    ("GET", "/api/v1/runs/{id}/export", Right::View),
    ("GET", "/api/v1/runs/{id}/notes", Right::View),
    ("PUT", "/api/v1/runs/{id}/notes", Right::Operate),
];

/// Who asks, for handlers and the journal.
#[derive(Clone, Debug)]
pub struct Caller {
    /// What it may do.
    pub rights: Rights,
    /// For the journal: name if it gave one, rights, address.
    pub who: String,
}

fn text(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

/// The value of the page's cookie.
pub fn cookie(headers: &HeaderMap) -> Option<&str> {
    let all = text(headers, header::COOKIE)?;
    all.split(';')
        .filter_map(|pair| pair.trim().split_once('='))
        .find(|(name, _)| *name == COOKIE)
        .map(|(_, v)| v)
}

/// The right that an endpoint needs; `None` when there is no such endpoint.
pub fn needed(method: &Method, path: &str) -> Option<Right> {
    // Whoever may get something may ask whether it is there.
    let method = if method == Method::HEAD { "GET" } else { method.as_str() };
    ENDPOINTS.iter().find(|(known, at, _)| *known == method && *at == path).map(|(_, _, right)| *right)
}

/// Lets a request pass or refuses it.
pub async fn pass(State(app): State<Arc<App>>, mut request: Request, next: Next) -> Response {
    match judge(&app, &request) {
        Ok(caller) => {
            request.extensions_mut().insert(caller);
            let method = request.method().clone();
            let path = request.extensions().get::<MatchedPath>().map(|path| path.as_str().to_owned());
            let response = next.run(request).await;
            app.metrics.request(&method, path.as_deref().unwrap_or("other"), response.status());
            response
        }
        Err(error) => {
            let response = error.into_response();
            app.metrics.refused(response.status());
            response
        }
    }
}

fn judge(app: &App, request: &Request) -> Result<Caller, ApiError> {
    let headers = request.headers();
    let authority = request.uri().authority().map(|authority| authority.as_str());
    let host = authority.or_else(|| text(headers, header::HOST)).unwrap_or_default();
    if headers.get_all(header::HOST).iter().count() > 1 || !app.access.host_is_ours(host) {
        return Err(ApiError::misdirected(host));
    }
    if let Some(origin) = headers.get(header::ORIGIN) {
        let ours = origin.to_str().is_ok_and(|origin| app.access.origin_is_ours(origin, host));
        if !ours {
            return Err(ApiError::forbidden("a page of another origin asks: refused"));
        }
    }
    let fetch = |name| headers.get(name).and_then(|value: &header::HeaderValue| value.to_str().ok());
    // A link from elsewhere to the page itself is fine; anything else from elsewhere is not.
    let foreign = fetch("sec-fetch-site").is_some_and(|site| site == "cross-site" || site == "same-site");
    if foreign && !(request.method() == Method::GET && request.uri().path() == "/") {
        return Err(ApiError::forbidden("a page of another site asks: refused"));
    }
    let peer = request.extensions().get::<ConnectInfo<SocketAddr>>().map(|info| info.0);
    if let Some(peer) = peer
        && app.limiter.check_key(&peer.ip()).is_err()
    {
        return Err(ApiError::too_many("more than 1000 requests a second from one address"));
    }
    // One that does not say how long it is is cut off while it is read.
    let length = text(headers, header::CONTENT_LENGTH).and_then(|length| length.parse::<u64>().ok());
    if length.is_some_and(|length| length > LARGEST_BODY as u64) {
        return Err(ApiError::too_large(LARGEST_BODY));
    }
    let bearer = text(headers, header::AUTHORIZATION).and_then(|value| value.strip_prefix("Bearer "));
    let rights = app.access.rights(bearer, cookie(headers));
    let path = request.extensions().get::<MatchedPath>().map(|path| path.as_str());
    // Without a path the fallback answers "not found"; with one and another method, "not allowed".
    let right = path.map_or(Some(Right::Anyone), |path| needed(request.method(), path));
    let allowed = match right {
        Some(right) => rights.has(right),
        None => rights.view,
    };
    if !allowed {
        return Err(match rights.view {
            true => ApiError::forbidden(format!("this needs the right to {}", word(right))),
            false => ApiError::unknown_caller(),
        });
    }
    Ok(Caller { rights, who: who(headers, rights, peer) })
}

fn word(right: Option<Right>) -> &'static str {
    match right {
        Some(Right::Configure) => "configure",
        Some(Right::Operate) => "operate",
        _ => "view",
    }
}

/// A name from the page is a courtesy to the reader of the journal, no proof.
fn who(headers: &HeaderMap, rights: Rights, peer: Option<SocketAddr>) -> String {
    let name = headers.get("x-operator").and_then(|value| value.to_str().ok()).unwrap_or_default();
    let name: String = name.chars().filter(|c| c.is_alphanumeric() || " .-_".contains(*c)).take(40).collect();
    let from = peer.map_or_else(|| "?".to_owned(), |peer| peer.ip().to_string());
    match name.trim() {
        "" => format!("{} at {from}", rights.word()),
        name => format!("{name} ({}) at {from}", rights.word()),
    }
}
