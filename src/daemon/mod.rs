//! The daemon: the operator's desk over HTTP and WebSocket, with its page. `shaketable serve` starts it.
//!
//! [`desk`] keeps the state of the bench, [`run`](desk::Desk::start) drives the sessions of
//! [`crate::control`], [`live`] hands rows to clients, [`publish`] to a NATS server, [`access`] says who may do what, [`http`] is the
//! interface. Losing the page, or all of them, changes nothing on the table.

pub mod access;
pub mod analysis;
pub mod check;
pub mod desk;
pub mod frame;
pub mod http;
pub mod journal;
pub mod link;
pub mod live;
pub mod meters;
pub mod metrics;
pub mod preview;
pub mod publish;
mod run;
pub mod state;
pub mod status;
pub mod work;

use access::{Access, AccessError};
use axum::extract::ws::Utf8Bytes;
use desk::Desk;
use http::App;
use publish::{PublishSpec, Publisher};
use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// How often the status goes out while something moves.
const STATUS_EVERY: Duration = Duration::from_millis(200);
/// A client has so long to send the head of a request.
const HEAD_WITHIN: Duration = Duration::from_secs(10);

/// Where and to whom the daemon listens.
#[derive(Clone, Debug)]
pub struct Listen {
    /// Address; port 0 takes a free one.
    pub address: SocketAddr,
    /// Names beside the address that it is known by.
    pub hosts: Vec<String>,
    /// File of the tokens, made on first use.
    pub token_file: Option<PathBuf>,
    /// Certificate chain and key, PEM.
    pub tls: Option<(PathBuf, PathBuf)>,
    /// Folder of the page's files, in place of the built-in ones.
    pub page: Option<PathBuf>,
    /// Where to publish, complete.
    pub publish: Option<PublishSpec>,
}

/// Why the daemon does not run.
#[derive(Debug, thiserror::Error)]
pub enum DaemonError {
    /// Not safe to listen so.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// The address cannot be had.
    #[error("cannot listen on {address}: {source}")]
    Listen {
        /// Which address.
        address: SocketAddr,
        /// Why.
        source: std::io::Error,
    },
    /// Certificate or key cannot be used.
    #[error("certificate {certificate} with key {key}: {source}")]
    Tls {
        /// Certificate chain.
        certificate: PathBuf,
        /// Key.
        key: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The folder of the runs cannot be made, or the server failed.
    #[error("{0}")]
    Io(#[from] std::io::Error),
}

/// Listens and serves until `stop` says so; `ready` is called with the address that was taken.
///
/// # Errors
/// [`DaemonError`] when it cannot listen, or not safely.
pub async fn serve(
    desk: Arc<Desk>,
    listen: Listen,
    ready: impl FnOnce(&str, usize),
    stop: impl Future<Output = ()>,
) -> Result<(), DaemonError> {
    std::fs::create_dir_all(desk.out())?;
    let failed = |source| DaemonError::Listen { address: listen.address, source };
    let secure = listen.tls.is_some();
    let access = Access::new(listen.address, listen.hosts.clone(), listen.token_file.as_deref(), secure)?;
    let socket = TcpListener::bind(listen.address).map_err(failed)?;
    socket.set_nonblocking(true).map_err(failed)?;
    let address = socket.local_addr().map_err(failed)?;
    let publisher = listen.publish.map(|spec| Publisher::start(desk.clone(), spec));
    let facts = publisher.as_ref().map(Publisher::facts);
    let app = App::new(desk.clone(), access.at(address), listen.page.as_deref(), facts)?;
    let teller = tokio::spawn(tell(app.clone()));
    let service = http::router(app.clone()).into_make_service_with_connect_info::<SocketAddr>();
    let handle = axum_server::Handle::new();
    let scheme = if secure { "https" } else { "http" };
    let server = async {
        match &listen.tls {
            None => {
                let mut server = axum_server::from_tcp(socket)?.handle(handle.clone());
                server
                    .http_builder()
                    .http1()
                    .timer(hyper_util::rt::TokioTimer::new())
                    .header_read_timeout(HEAD_WITHIN);
                server.serve(service).await
            }
            Some((certificate, key)) => {
                let config = axum_server::tls_rustls::RustlsConfig::from_pem_file(certificate, key).await?;
                let mut server = axum_server::from_tcp_rustls(socket, config)?.handle(handle.clone());
                server
                    .http_builder()
                    .http1()
                    .timer(hyper_util::rt::TokioTimer::new())
                    .header_read_timeout(HEAD_WITHIN);
                server.serve(service).await
            }
        }
    };
    ready(&format!("{scheme}://{address}"), app.page_bytes());
    let outcome = tokio::select! {
        outcome = server => outcome.map_err(DaemonError::Io),
        () = stop => Ok(()),
    };
    teller.abort();
    handle.shutdown();
    desk.close().await;
    if let Some(publisher) = publisher {
        publisher.close().await;
    }
    outcome
}

/// Sends the status: at once when something has changed, and steadily while something moves.
async fn tell(app: Arc<App>) {
    let mut changes = app.desk.changes();
    changes.mark_changed();
    let mut rhythm = tokio::time::interval(STATUS_EVERY);
    rhythm.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    loop {
        tokio::select! {
            changed = changes.changed() => if changed.is_err() { return },
            _ = rhythm.tick() => {
                app.desk.watch_link();
                app.limiter.retain_recent();
                if !app.desk.state().is_live() {
                    continue;
                }
            }
        }
        changes.borrow_and_update();
        let told = serde_json::json!({ "type": "status", "status": app.desk.status() });
        app.status.send_replace(Utf8Bytes::from(told.to_string()));
    }
}
