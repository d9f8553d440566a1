//! What `/metrics` shows to Prometheus: the state of the bench, samples, slips, losses, clients, requests.
//! Numbers that the desk and the live view keep anyhow are read when asked; requests are counted here.

use super::desk::Desk;
use super::publish::Publication;
use super::state::State;
use axum::http::{Method, StatusCode};
use prometheus_client::encoding::text::encode;
use prometheus_client::encoding::{EncodeLabelSet, EncodeLabelValue, LabelValueEncoder};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;
use std::sync::atomic::AtomicU64;

type Float = Gauge<f64, AtomicU64>;

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Asked {
    method: String,
    path: String,
    status: u16,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Refused {
    status: u16,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct InState {
    state: StateLabel,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct StateLabel(State);

impl EncodeLabelValue for StateLabel {
    fn encode(&self, encoder: &mut LabelValueEncoder<'_>) -> Result<(), std::fmt::Error> {
        self.0.name().encode(encoder)
    }
}

/// What is told of the publication; all zero without one.
const PUBLISHED: [(&str, &str); 8] = [
    ("publication_connected", "1 while the NATS server is connected"),
    ("publication_connections", "Connections to the NATS server"),
    ("publication_messages", "Messages that the NATS server has confirmed"),
    ("publication_frames_dropped", "Live frames that did not, or not surely, reach the NATS server"),
    ("publication_resent", "Events and steps sent again after a connection was lost"),
    ("publication_waiting_bytes", "Bytes of events that the NATS server has not confirmed yet"),
    ("publication_lines_dropped", "Events and steps that cannot be published"),
    ("publication_runs_dropped", "Runs of which not everything was published"),
];

fn published(p: &Publication) -> [u64; PUBLISHED.len()] {
    [
        p.connected.into(),
        p.connections,
        p.messages,
        p.frames_dropped,
        p.resent,
        p.waiting_bytes,
        p.lines_dropped,
        p.runs_dropped,
    ]
}

/// The registry and what is set when it is asked for.
pub struct Metrics {
    registry: Registry,
    requests: Family<Asked, Counter>,
    refused: Family<Refused, Counter>,
    state: Family<InState, Gauge>,
    clients: Gauge,
    dropped: Gauge,
    sent: Gauge,
    published: [Gauge; PUBLISHED.len()],
    runs: Gauge,
    slips: Gauge,
    lost: Gauge,
    fill: Float,
    stop: Float,
    progress: Float,
    error_a: Float,
    error_d: Float,
}

impl Default for Metrics {
    fn default() -> Self {
        let mut registry = Registry::with_prefix("shaketable");
        let (requests, refused, state) = (Family::default(), Family::default(), Family::default());
        registry.register("requests", "Requests answered", Family::clone(&requests));
        registry.register("requests_refused", "Requests refused at the gate", Family::clone(&refused));
        registry.register("state", "1 for the state that the bench is in", Family::clone(&state));
        let mut whole = |name, help| {
            let gauge = Gauge::default();
            registry.register(name, help, gauge.clone());
            gauge
        };
        let clients = whole("live_clients", "Clients of the live view");
        let dropped = whole("live_frames_dropped", "Frames that slow clients did not get");
        let sent = whole("live_frames_sent", "Frames sent to clients");
        let published = PUBLISHED.map(|(name, help)| whole(name, help));
        let runs = whole("runs_started", "Runs started by this daemon");
        let slips = whole("slips", "Slips of the control thread in the present or last run");
        let lost = whole("lost_samples", "Samples lost in the present or last run");
        let mut float = |name, help| {
            let gauge = Float::default();
            registry.register(name, help, gauge.clone());
            gauge
        };
        let fill = float("recorder_ring_fill", "Share of the recorder's ring that waits, 0 to 1");
        let stop = float("stop_latency_seconds", "From the last stop's request to its first command");
        let progress = float("progress", "Share of the sweep that is done, 0 to 1");
        let error_a = float("model_error_a", "Error of the onboard model, acceleration (NRMSE)");
        let error_d = float("model_error_d", "Error of the onboard model, displacement (NRMSE)");
        Self {
            registry,
            requests,
            refused,
            state,
            clients,
            dropped,
            sent,
            published,
            runs,
            slips,
            lost,
            fill,
            stop,
            progress,
            error_a,
            error_d,
        }
    }
}

impl Metrics {
    /// Counts an answered request.
    pub fn request(&self, method: &Method, path: &str, status: StatusCode) {
        let asked = Asked { method: method.to_string(), path: path.to_owned(), status: status.as_u16() };
        self.requests.get_or_create(&asked).inc();
    }

    /// Counts a refused request.
    pub fn refused(&self, status: StatusCode) {
        self.refused.get_or_create(&Refused { status: status.as_u16() }).inc();
    }

    /// The text for Prometheus.
    ///
    /// # Errors
    /// Only what the encoder's formatting can fail with, which is nothing.
    pub fn text(&self, desk: &Desk, publication: Option<&Publication>) -> Result<String, std::fmt::Error> {
        let status = desk.status();
        for state in State::ALL {
            self.state
                .get_or_create(&InState { state: StateLabel(state) })
                .set(i64::from(state == status.state));
        }
        let (dropped, sent, clients) = desk.hub.traffic();
        self.clients.set(clients as i64);
        self.dropped.set(dropped as i64);
        self.sent.set(sent as i64);
        for (gauge, value) in self.published.iter().zip(publication.map(published).unwrap_or_default()) {
            gauge.set(value as i64);
        }
        self.runs.set(desk.runs() as i64);
        self.fill.set(desk.hub.record_fill());
        self.stop.set(desk.stop_latency_s());
        if let Some(run) = &status.run {
            self.slips.set(run.slips as i64);
            self.lost.set(run.lost_samples as i64);
            self.progress.set(run.progress);
            self.error_a.set(run.nrmse_a);
            self.error_d.set(run.nrmse_d);
        } else if let Some(ended) = &status.ended {
            self.slips.set(ended.slips as i64);
            self.lost.set(ended.lost_samples as i64);
        }
        let mut text = String::new();
        encode(&mut text, &self.registry)?;
        Ok(text)
    }
}
