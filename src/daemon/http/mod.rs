//! The HTTP and WebSocket interface: what all handlers share, the routes, the description of both. Every
//! handler is reached through [`gate`] only; work that takes longer than a moment goes to worker threads.

mod analysis;
pub mod error;
pub mod gate;
mod health;
mod live;
mod page;
mod runs;
mod session;
mod setup;

use super::access::{Access, Right};
use super::analysis::Jobs;
use super::desk::Desk;
use super::metrics::Metrics;
use super::publish::Facts;
use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::extract::ws::Utf8Bytes;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::routing::get;
use error::{ApiError, Problem};
use governor::{DefaultKeyedRateLimiter, Quota, RateLimiter};
use std::net::IpAddr;
use std::num::NonZeroU32;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::set_header::SetResponseHeaderLayer;
use utoipa::openapi::path::{HttpMethod, Operation, PathItem};
use utoipa::openapi::{OpenApi, RefOr, ResponseBuilder, content::ContentBuilder, schema};
use utoipa::{OpenApi as _, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// Largest body of a request, bytes.
pub const LARGEST_BODY: usize = 256 * 1024;
/// Requests a second and address, and how many at once.
const REQUESTS: (u32, u32) = (1000, 2000);
/// Things that take a worker thread for long, at once.
const WORKERS: usize = 2;
/// How long one waits for such a turn, and for an answer then: both together less than a client waits.
const TURN: Duration = Duration::from_secs(3);
const ANSWER: Duration = Duration::from_secs(6);

/// What all handlers share.
pub struct App {
    /// The desk.
    pub desk: Arc<Desk>,
    /// Who may do what.
    pub access: Access,
    /// Counts.
    pub metrics: Metrics,
    /// Rates by address.
    pub limiter: DefaultKeyedRateLimiter<IpAddr>,
    /// The newest status as text, for all clients of the live view.
    pub status: watch::Sender<Utf8Bytes>,
    /// How the publication stands, if there is one.
    pub publication: Option<Arc<Facts>>,
    page: page::Page,
    description: String,
    jobs: Jobs,
    turns: Arc<Semaphore>,
    started: Instant,
    numbers: AtomicU64,
}

impl App {
    /// Puts everything together; the page is the built-in one, or that of a folder.
    ///
    /// # Errors
    /// The page of the folder cannot be read, or no thread for jobs be had.
    pub fn new(
        desk: Arc<Desk>,
        access: Access,
        page: Option<&Path>,
        publication: Option<Arc<Facts>>,
    ) -> std::io::Result<Arc<Self>> {
        let (rate, burst) = REQUESTS;
        let most = |n: u32| NonZeroU32::new(n).unwrap_or(NonZeroU32::MIN);
        let quota = Quota::per_second(most(rate)).allow_burst(most(burst));
        Ok(Arc::new(Self {
            desk,
            access,
            metrics: Metrics::default(),
            limiter: RateLimiter::keyed(quota),
            status: watch::channel(Utf8Bytes::default()).0,
            publication,
            page: page::Page::new(page)?,
            description: serde_json::to_string(&described())?,
            jobs: Jobs::start()?,
            turns: Arc::new(Semaphore::new(WORKERS)),
            started: Instant::now(),
            numbers: AtomicU64::new(0),
        }))
    }

    /// Bytes of the page that a browser loads.
    pub fn page_bytes(&self) -> usize {
        self.page.packed_bytes()
    }

    /// Waits for a turn on the worker threads.
    async fn turn(&self) -> Result<OwnedSemaphorePermit, ApiError> {
        match tokio::time::timeout(TURN, self.turns.clone().acquire_owned()).await {
            Ok(Ok(turn)) => Ok(turn),
            _ => Err(ApiError::too_many("the daemon works on other answers; ask again")),
        }
    }

    /// Runs on a worker thread what an answer waits for, in its turn. Work that takes longer ends unheard and keeps its turn until
    /// then: a model may be slow to simulate, whatever its file says.
    async fn answer<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, ApiError> {
        let turn = self.turn().await?;
        let worked = blocking(move || {
            let _turn = turn;
            work()
        });
        let late = |_| ApiError::too_many("this takes longer than an answer may; do it in a shell");
        tokio::time::timeout(ANSWER, worked).await.map_err(late)?
    }

    fn unique(&self) -> u64 {
        self.numbers.fetch_add(1, Ordering::Relaxed)
    }
}

/// Runs what takes longer than a moment on a worker thread.
async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, ApiError> {
    tokio::task::spawn_blocking(work).await.map_err(|_| ApiError::failed("a worker thread died"))
}

#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "shaketable",
        description = "The operator's desk of a shaking table. Rights: `x-right` of each operation; \
        every caller with the right to view may stop."
    ),
    components(schemas(Problem))
)]
struct Described;

fn routes() -> OpenApiRouter<Arc<App>> {
    OpenApiRouter::with_openapi(Described::openapi())
        .routes(routes!(session::status))
        .routes(routes!(session::journal))
        .routes(routes!(session::steps))
        .routes(routes!(session::preflight))
        .routes(routes!(session::arm))
        .routes(routes!(session::disarm))
        .routes(routes!(session::start))
        .routes(routes!(session::hold))
        .routes(routes!(session::resume))
        .routes(routes!(session::stop))
        .routes(routes!(session::reset))
        .routes(routes!(session::alive))
        .routes(routes!(setup::get))
        .routes(routes!(setup::catalogue))
        .routes(routes!(setup::sweep))
        .routes(routes!(setup::case))
        .routes(routes!(setup::model))
        .routes(routes!(setup::add_effect))
        .routes(routes!(setup::undo))
        .routes(routes!(setup::preview))
        .routes(routes!(setup::dry_run))
        .routes(routes!(setup::faults))
        .routes(routes!(runs::runs))
        .routes(routes!(runs::run))
        .routes(routes!(runs::steps))
        .routes(routes!(runs::events))
        .routes(routes!(runs::report))
        .routes(routes!(runs::cycles))
        .routes(routes!(runs::notes, runs::write_notes))
        .routes(routes!(runs::export))
        .routes(routes!(analysis::compare))
        .routes(routes!(analysis::diagnose))
        .routes(routes!(analysis::job))
        .routes(routes!(health::health))
        .routes(routes!(health::metrics))
        .routes(routes!(health::description))
        .routes(routes!(live::live))
        .routes(routes!(page::rights, page::log_in, page::log_out))
}

/// The description, with the right of each operation and the refusals that all of them share.
pub fn described() -> OpenApi {
    let mut description = routes().into_openapi();
    for (path, item) in &mut description.paths.paths {
        for (method, operation) in operations(item) {
            complete(path, method, operation);
        }
    }
    description
}

fn operations(item: &mut PathItem) -> Vec<(HttpMethod, &mut Operation)> {
    let all = [
        (HttpMethod::Get, &mut item.get),
        (HttpMethod::Put, &mut item.put),
        (HttpMethod::Post, &mut item.post),
        (HttpMethod::Delete, &mut item.delete),
    ];
    all.into_iter().filter_map(|(method, operation)| Some((method, operation.as_mut()?))).collect()
}

fn complete(path: &str, method: HttpMethod, operation: &mut Operation) {
    let method = match method {
        HttpMethod::Put => axum::http::Method::PUT,
        HttpMethod::Post => axum::http::Method::POST,
        HttpMethod::Delete => axum::http::Method::DELETE,
        _ => axum::http::Method::GET,
    };
    let right = gate::needed(&method, path).unwrap_or(Right::Configure);
    let right = serde_json::to_value(right).unwrap_or_default();
    operation.extensions = Some([("x-right".to_owned(), right)].into_iter().collect());
    let shared = [
        (StatusCode::BAD_REQUEST, "not what it should be"),
        (StatusCode::UNAUTHORIZED, "a token is needed"),
        (StatusCode::FORBIDDEN, "not allowed to this caller, or to a page of another origin"),
        (StatusCode::PAYLOAD_TOO_LARGE, "the body is too large"),
        (StatusCode::UNSUPPORTED_MEDIA_TYPE, "the body is no JSON by its content type"),
        (StatusCode::MISDIRECTED_REQUEST, "the host is none of this daemon's names"),
        (StatusCode::UNPROCESSABLE_ENTITY, "understood, but not allowed as a value"),
        (StatusCode::TOO_MANY_REQUESTS, "too many requests"),
    ];
    for (status, text) in shared {
        let problem = schema::Ref::from_schema_name(Problem::name());
        let body = ContentBuilder::new().schema(Some(problem)).build();
        let response = ResponseBuilder::new().description(text).content("application/json", body).build();
        let responses = &mut operation.responses.responses;
        responses.entry(status.as_u16().to_string()).or_insert(RefOr::T(response));
    }
}

/// The whole interface.
pub fn router(app: Arc<App>) -> Router {
    let fixed = |name, value| SetResponseHeaderLayer::if_not_present(name, HeaderValue::from_static(value));
    let (api, _) = routes().split_for_parts();
    api.route("/", get(page::index))
        .route("/app.js", get(page::script))
        .route("/app.css", get(page::style))
        .route("/icon.svg", get(page::icon))
        .fallback(|| async { ApiError::not_found("there is nothing at this address") })
        .method_not_allowed_fallback(|| async {
            (StatusCode::METHOD_NOT_ALLOWED, "another method is allowed here")
        })
        .layer(axum::middleware::from_fn_with_state(app.clone(), gate::pass))
        .layer(DefaultBodyLimit::max(LARGEST_BODY))
        .layer(CatchPanicLayer::new())
        .layer(fixed(header::X_CONTENT_TYPE_OPTIONS, "nosniff"))
        .layer(fixed(header::REFERRER_POLICY, "no-referrer"))
        .layer(fixed(header::CACHE_CONTROL, "no-store"))
        .layer(fixed(HeaderName::from_static("cross-origin-resource-policy"), "same-origin"))
        .layer(fixed(HeaderName::from_static("cross-origin-opener-policy"), "same-origin"))
        .with_state(app)
}
