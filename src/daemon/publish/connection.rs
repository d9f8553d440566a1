//! One connection to the server, from login to loss, and what has surely arrived through it. A message counts as arrived
//! once a later one, sent to an inbox of our own, has come back: a server handles what one connection brings in order. That
//! bounds what is under way as well, so that nothing here ever waits for a server. A lost connection is not mended but
//! replaced, as nobody knows what the old one still delivered.

use super::spec::PublishSpec;
use async_nats::client::Statistics;
use async_nats::connection::State;
use async_nats::{Client, Event, HeaderMap, Subscriber};
use axum::body::Bytes;
use futures_util::StreamExt;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// What the crate's own queue holds; never full, as no more than [`Kind::most`] of each kind and one question wait there.
const QUEUE: usize = 512;
/// Longest until a server has logged us in.
const CONNECT_WITHIN: Duration = Duration::from_secs(4);
/// Longest until a receipt is back; a server that keeps it longer is taken for gone.
const RECEIPT_WITHIN: Duration = Duration::from_secs(5);
/// How often the crate looks whether the server lives, which ends what is left of a connection that was given up.
const PING_EVERY: Duration = Duration::from_secs(3);

/// Messages, by what they are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Events and steps.
    pub lines: u64,
    /// Live frames.
    pub frames: u64,
    /// Others.
    pub others: u64,
}

impl Counts {
    /// All of them.
    pub fn messages(&self) -> u64 {
        self.lines + self.frames + self.others
    }

    fn of(&mut self, kind: Kind) -> &mut u64 {
        match kind {
            Kind::Line => &mut self.lines,
            Kind::Frame => &mut self.frames,
            Kind::Other => &mut self.others,
        }
    }
}

/// What a message is counted as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// An event or step; comes again if it is not confirmed.
    Line,
    /// A live frame; lost if it is not confirmed.
    Frame,
    /// Anything else.
    Other,
}

impl Kind {
    /// Most that may be under way; a second of frames, as older ones are of no use to a live view.
    fn most(self) -> u64 {
        match self {
            Self::Line => 192,
            Self::Frame => 64,
            Self::Other => 4,
        }
    }
}

/// The connection.
pub struct Connection {
    client: Client,
    statistics: Arc<Statistics>,
    inbox: String,
    receipts: Subscriber,
    complaint: Arc<Mutex<Option<String>>>,
    sent: Counts,
    confirmed: Counts,
    /// What was sent when the receipt was asked for that is not back yet, and when that was.
    asked: Option<(Counts, Instant)>,
}

impl Connection {
    /// Connects and logs in.
    ///
    /// # Errors
    /// Why that could not be, in words without secrets.
    pub async fn open(spec: PublishSpec) -> Result<Self, String> {
        let complaint = Arc::new(Mutex::new(None));
        let heard = complaint.clone();
        let options = spec.options().map_err(|error| error.to_string())?;
        let options = options
            .name(format!("shaketable {}", spec.table()))
            .connection_timeout(CONNECT_WITHIN)
            .ping_interval(PING_EVERY)
            .client_capacity(QUEUE)
            // The fewest that the crate knows; `is_lost` looks whether it has used it.
            .max_reconnects(1)
            .event_callback(move |event| {
                if let Event::ServerError(error) = event {
                    *heard.lock().unwrap_or_else(PoisonError::into_inner) = Some(error.to_string());
                }
                std::future::ready(())
            });
        let connect = async {
            let client = options.connect(&spec.server).await.map_err(|error| error.to_string())?;
            let inbox = client.new_inbox();
            let receipts = client.subscribe(inbox.clone()).await.map_err(|error| error.to_string())?;
            let statistics = client.statistics();
            let (sent, confirmed) = Default::default();
            Ok(Self { client, statistics, inbox, receipts, complaint, sent, confirmed, asked: None })
        };
        let outcome = tokio::time::timeout(CONNECT_WITHIN, connect).await;
        outcome.unwrap_or_else(|_| Err(format!("no answer within {} s", CONNECT_WITHIN.as_secs())))
    }

    /// Messages of a kind that may be sent before anything more is confirmed.
    pub fn room(&self, kind: Kind) -> u64 {
        let (mut sent, mut confirmed) = (self.sent, self.confirmed);
        kind.most().saturating_sub(*sent.of(kind) - *confirmed.of(kind))
    }

    /// What was sent, and what of it has surely arrived.
    pub fn counts(&self) -> (Counts, Counts) {
        (self.sent, self.confirmed)
    }

    /// Sends a message; a place in the window is the caller's to look for.
    ///
    /// # Errors
    /// Why the message cannot be sent, now or ever.
    pub async fn send(
        &mut self,
        kind: Kind,
        subject: &str,
        headers: HeaderMap,
        payload: impl Into<Bytes>,
    ) -> Result<(), String> {
        let sent = self.client.publish_with_headers(subject.to_owned(), headers, payload.into()).await;
        // A line that is refused keeps its place among those that were handed out.
        if sent.is_ok() || kind == Kind::Line {
            *self.sent.of(kind) += 1;
        }
        sent.map_err(|error| error.to_string())
    }

    /// Asks for a receipt if something is not confirmed and none is asked for yet.
    pub async fn ask(&mut self) {
        if self.asked.is_some() || self.sent == self.confirmed {
            return;
        }
        self.asked = Some((self.sent, Instant::now()));
        let question = Bytes::from(self.sent.messages().to_string());
        // A client that has ended takes nothing; the receipt then stays away.
        let _ = self.client.publish(self.inbox.clone(), question).await;
    }

    /// Waits for a receipt; what it confirms can be asked for after that. False when the connection is gone. Nothing is lost
    /// when this is not waited for to its end.
    pub async fn receipt(&mut self) -> bool {
        let Some(message) = self.receipts.next().await else { return false };
        if self.is_replaced() {
            return false;
        }
        if let Some((asked, _)) = self.asked
            && message.payload == asked.messages().to_string().as_bytes()
        {
            (self.confirmed, self.asked) = (asked, None);
        }
        true
    }

    /// Why the connection is to be given up, if it is.
    pub fn is_lost(&self) -> Option<String> {
        if self.is_replaced() || self.client.connection_state() == State::Disconnected {
            return Some("the connection was lost".to_owned());
        }
        let (_, since) = self.asked?;
        let late = since.elapsed() >= RECEIPT_WITHIN;
        late.then(|| format!("no receipt from the server within {} s", RECEIPT_WITHIN.as_secs()))
    }

    /// The crate has mended the connection: whatever was in its buffers is gone, and a receipt says nothing about it.
    fn is_replaced(&self) -> bool {
        self.statistics.connects.load(Ordering::Relaxed) != 1
    }

    /// What the server objected to since this was asked last.
    pub fn complaint(&self) -> Option<String> {
        self.complaint.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}
