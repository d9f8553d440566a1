//! The WebSocket of the live view: binary frames and status texts out; window changes in. A client that
//! does not read for long is let go, and nobody else notices.

use super::App;
use super::error::{ApiError, Problem, Query};
use crate::daemon::live::{LONGEST_WINDOW_S, RAW_WINDOW_S, Seat};
use axum::extract::State;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::response::Response;
use serde::Deserialize;
use std::sync::Arc;
use std::time::Duration;
use utoipa::IntoParams;

/// A client that takes nothing for so long is let go.
const PATIENCE: Duration = Duration::from_secs(30);
/// Largest message of a client, bytes.
const LARGEST_MESSAGE: usize = 1024;

/// What a client wants to see.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct Wanted {
    /// Length of the window, s; up to 5 s every sample is sent.
    #[param(minimum = 0.1, maximum = 300)]
    window_s: Option<f64>,
}

/// What a client may say.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Said {
    window_s: f64,
}

fn window(asked_s: f64) -> Option<f64> {
    (0.1..=LONGEST_WINDOW_S).contains(&asked_s).then_some(asked_s)
}

/// Live view: binary frames (see the book), status as JSON texts
#[utoipa::path(get, path = "/api/v1/live", tag = "session", params(Wanted), responses(
    (status = 101, description = "WebSocket"), (status = 426, description = "not a WebSocket request"),
    (status = 429, body = Problem)))]
pub async fn live(
    State(app): State<Arc<App>>,
    Query(wanted): Query<Wanted>,
    upgrade: Result<WebSocketUpgrade, axum::extract::ws::rejection::WebSocketUpgradeRejection>,
) -> Result<Response, ApiError> {
    let upgrade = upgrade.map_err(ApiError::bad)?;
    let asked = wanted.window_s.unwrap_or(RAW_WINDOW_S);
    let window_s = window(asked)
        .ok_or_else(|| ApiError::bad(format!("window_s: {asked}; allowed: 0.1 to {LONGEST_WINDOW_S} s")))?;
    let seat =
        app.desk.hub.join(window_s).ok_or_else(|| ApiError::too_many("too many clients of the live view"))?;
    // The seat is given back whatever becomes of the connection.
    let seat = Taken { app, seat: Some(seat) };
    Ok(upgrade
        .max_message_size(LARGEST_MESSAGE)
        .max_frame_size(LARGEST_MESSAGE)
        .on_upgrade(|socket| serve(seat, socket)))
}

struct Taken {
    app: Arc<App>,
    seat: Option<Seat>,
}

impl Drop for Taken {
    fn drop(&mut self) {
        if let Some(seat) = &self.seat {
            self.app.desk.hub.leave(seat.id);
        }
    }
}

async fn serve(mut taken: Taken, mut socket: WebSocket) {
    let app = taken.app.clone();
    let Some(seat) = taken.seat.as_mut() else { return };
    let mut status = app.status.subscribe();
    status.mark_changed();
    loop {
        let message = tokio::select! {
            frame = seat.queue.recv() => match frame {
                Some(frame) => frame,
                None => return,
            },
            changed = status.changed() => match changed {
                Ok(()) => Message::Text(status.borrow_and_update().clone()),
                Err(_) => return,
            },
            said = socket.recv() => match said {
                Some(Ok(Message::Text(text))) => {
                    if let Some(window_s) = serde_json::from_str::<Said>(&text).ok().and_then(|said| window(said.window_s)) {
                        app.desk.hub.window(seat.id, window_s);
                    }
                    continue;
                }
                Some(Ok(Message::Close(_)) | Err(_)) | None => return,
                Some(Ok(_)) => continue,
            },
        };
        match tokio::time::timeout(PATIENCE, socket.send(message)).await {
            Ok(Ok(())) => {}
            // Gone, or reading nothing for half a minute.
            Ok(Err(_)) | Err(_) => return,
        }
    }
}
