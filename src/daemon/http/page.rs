//! The page: its built files travel inside the binary, compressed once at the start.

use super::App;
use super::error::{ApiError, Body, Problem};
use super::gate::{COOKIE, cookie};
use crate::daemon::access::Rights;
use axum::Json;
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use flate2::{Compression, write::GzEncoder};
use serde::{Deserialize, Serialize};
use sha2::Digest;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use utoipa::ToSchema;

/// What the page may load and ask: itself only.
const POLICY: &str = "default-src 'self'; connect-src 'self'; img-src 'self' data:; frame-ancestors 'none'; \
                      base-uri 'none'; form-action 'none'; object-src 'none'";

/// One built file.
struct File {
    plain: Bytes,
    packed: Bytes,
    kind: &'static str,
    tag: String,
}

impl File {
    /// The built-in text, or that of the same file in a folder.
    fn new(
        folder: Option<&Path>,
        name: &str,
        built_in: &'static [u8],
        kind: &'static str,
    ) -> std::io::Result<Self> {
        let plain = match folder {
            None => Bytes::from_static(built_in),
            Some(folder) => std::fs::read(folder.join(name))?.into(),
        };
        let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
        encoder.write_all(&plain)?;
        let packed = encoder.finish()?;
        let tag = format!("\"{}\"", &crate::record::samples::hex(&sha2::Sha256::digest(&plain))[..16]);
        Ok(Self { plain, packed: packed.into(), kind, tag })
    }

    fn answer(&self, headers: &HeaderMap) -> Response {
        let head = [
            (header::CONTENT_TYPE, self.kind.to_owned()),
            (header::ETAG, self.tag.clone()),
            (header::CACHE_CONTROL, "no-cache".to_owned()),
            (header::CONTENT_SECURITY_POLICY, POLICY.to_owned()),
        ];
        let asked = |name| headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or_default();
        if asked(header::IF_NONE_MATCH) == self.tag {
            return (StatusCode::NOT_MODIFIED, head).into_response();
        }
        if asked(header::ACCEPT_ENCODING).contains("gzip") {
            return (head, [(header::CONTENT_ENCODING, "gzip")], self.packed.clone()).into_response();
        }
        (head, self.plain.clone()).into_response()
    }
}

/// The built page.
pub struct Page {
    index: File,
    script: File,
    style: File,
    icon: File,
}

impl Page {
    /// Compresses the files that travel inside the binary, or those of a folder.
    ///
    /// # Errors
    /// A file of the folder cannot be read.
    pub fn new(folder: Option<&Path>) -> std::io::Result<Self> {
        let file = |name, built_in, kind| File::new(folder, name, built_in, kind);
        let dist = [
            include_bytes!("../../../web/dist/index.html").as_slice(),
            include_bytes!("../../../web/dist/app.js"),
            include_bytes!("../../../web/dist/app.css"),
            include_bytes!("../../../web/dist/icon.svg"),
        ];
        Ok(Self {
            index: file("index.html", dist[0], "text/html; charset=utf-8")?,
            script: file("app.js", dist[1], "text/javascript; charset=utf-8")?,
            style: file("app.css", dist[2], "text/css; charset=utf-8")?,
            icon: file("icon.svg", dist[3], "image/svg+xml")?,
        })
    }

    /// Bytes that a browser loads, compressed.
    pub fn packed_bytes(&self) -> usize {
        [&self.index, &self.script, &self.style, &self.icon].iter().map(|file| file.packed.len()).sum()
    }
}

/// `/`
pub async fn index(State(app): State<Arc<App>>, headers: HeaderMap) -> Response {
    app.page.index.answer(&headers)
}

/// `/app.js`
pub async fn script(State(app): State<Arc<App>>, headers: HeaderMap) -> Response {
    app.page.script.answer(&headers)
}

/// `/app.css`
pub async fn style(State(app): State<Arc<App>>, headers: HeaderMap) -> Response {
    app.page.style.answer(&headers)
}

/// `/icon.svg`
pub async fn icon(State(app): State<Arc<App>>, headers: HeaderMap) -> Response {
    app.page.icon.answer(&headers)
}

/// A token to log in with.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Token {
    /// The token, as it stands in the daemon's token file.
    #[schema(max_length = 200)]
    pub token: String,
}

/// What the caller may do.
#[derive(Serialize, ToSchema)]
pub struct LoggedIn {
    /// The daemon asks for tokens.
    pub token_needed: bool,
    /// What the caller may do.
    pub rights: Rights,
}

/// What the caller may do
#[utoipa::path(get, path = "/api/v1/login", tag = "login", responses((status = 200, body = LoggedIn)))]
pub async fn rights(
    State(app): State<Arc<App>>,
    axum::Extension(caller): axum::Extension<super::gate::Caller>,
) -> Json<LoggedIn> {
    Json(LoggedIn { token_needed: app.access.needs_token(), rights: caller.rights })
}

/// Log the page in with a token; one that is logged in already adds to what it has
#[utoipa::path(post, path = "/api/v1/login", tag = "login", request_body = Token, responses(
    (status = 200, body = LoggedIn), (status = 401, body = Problem)))]
pub async fn log_in(
    State(app): State<Arc<App>>,
    headers: HeaderMap,
    Body(token): Body<Token>,
) -> Result<Response, ApiError> {
    if !app.access.needs_token() {
        return Ok(Json(LoggedIn { token_needed: false, rights: Rights::ALL }).into_response());
    }
    let (value, rights) =
        app.access.log_in(token.token.trim(), cookie(&headers)).ok_or_else(ApiError::unknown_caller)?;
    let secure = if app.access.is_secure() { "; Secure" } else { "" };
    let set = format!("{COOKIE}={value}; Path=/; HttpOnly; SameSite=Strict; Max-Age=43200{secure}");
    Ok(([(header::SET_COOKIE, set)], Json(LoggedIn { token_needed: true, rights })).into_response())
}

/// Log the page out
#[utoipa::path(delete, path = "/api/v1/login", tag = "login", responses((status = 204, description = "logged out")))]
pub async fn log_out(State(app): State<Arc<App>>, headers: HeaderMap) -> Response {
    if let Some(cookie) = cookie(&headers) {
        app.access.log_out(cookie);
    }
    let set = format!("{COOKIE}=; Path=/; HttpOnly; SameSite=Strict; Max-Age=0");
    (StatusCode::NO_CONTENT, [(header::SET_COOKIE, set)]).into_response()
}
