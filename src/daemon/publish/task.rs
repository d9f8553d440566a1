//! The task that publishes: one loop that takes frames, lines and the status from where they are and hands them to the
//! connection while that has room. It keeps no queue of its own: frames wait in the seat at the live view, lines on the disk.

use super::connection::{Connection, Kind};
use super::lines::{Lines, Message};
use super::{Facts, Publication, PublishSpec, ROOT};
use crate::daemon::desk::Desk;
use crate::daemon::frame::{FOLLOWS, Head, stamp};
use crate::daemon::live::{LONGEST_WINDOW_S, Seat, window_of};
use crate::daemon::status::Status;
use async_nats::HeaderMap;
use axum::extract::ws;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::broadcast::{self, error::RecvError};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{Instant, MissedTickBehavior, interval};

/// How often the record is looked into.
const RHYTHM: Duration = Duration::from_millis(50);
/// How often the status goes out.
const STATUS_EVERY: Duration = Duration::from_secs(1);
/// Pause before a server is tried again, the first and the longest; doubled each time.
const PAUSE: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(5));
/// Header with the folder name of the run that a live frame belongs to.
const RUN_HEADER: &str = "Shaketable-Run";
/// Header by which a stream of the server tells a message that comes again.
const ID_HEADER: &str = "Nats-Msg-Id";

/// What a worker thread brings back from the record.
struct Read {
    lines: Lines,
    messages: Vec<Message>,
    failed: Option<String>,
}

/// A message with the status.
#[derive(Serialize)]
struct Told<'a> {
    table: &'a str,
    publication: Publication,
    status: Status,
}

struct Task {
    desk: Arc<Desk>,
    spec: PublishSpec,
    facts: Arc<Facts>,
    seat: Seat,
    begun: broadcast::Receiver<PathBuf>,
    connection: Option<Connection>,
    connecting: Option<JoinHandle<Result<Connection, String>>>,
    try_at: Instant,
    pause: Duration,
    /// Here unless a worker thread has it.
    lines: Option<Lines>,
    reading: Option<JoinHandle<Read>>,
    /// Runs that have begun since it was here last.
    added: Vec<PathBuf>,
    /// The connection was lost since then.
    rewind: bool,
    status_at: Instant,
    /// Frames that did not, or not surely, arrive, beside those that the live view had no place for.
    frames_dropped: u64,
    /// Those.
    frames_unplaced: u64,
    missed_runs: u64,
    /// What earlier connections have delivered: messages, frames.
    before: (u64, u64),
    /// The run of the frames, by its number.
    run: (u32, String),
}

/// Publishes until `closing` says so, and a connected server has confirmed everything.
pub async fn run(desk: Arc<Desk>, spec: PublishSpec, facts: Arc<Facts>, mut closing: watch::Receiver<bool>) {
    let begun = desk.journal.runs();
    let Some(seat) = desk.hub.join(window_of(spec.live_rows).unwrap_or(LONGEST_WINDOW_S)) else {
        tracing::error!("no place at the live view: nothing is published");
        return;
    };
    let (now, lines) = (Instant::now(), Lines::new(spec.table()));
    let mut task = Task {
        desk,
        spec,
        facts,
        seat,
        begun,
        connection: None,
        connecting: None,
        try_at: now,
        pause: PAUSE.0,
        lines: Some(lines),
        reading: None,
        added: Vec::new(),
        rewind: false,
        status_at: now,
        frames_dropped: 0,
        frames_unplaced: 0,
        missed_runs: 0,
        before: (0, 0),
        run: (0, String::new()),
    };
    let mut rhythm = interval(RHYTHM);
    rhythm.set_missed_tick_behavior(MissedTickBehavior::Skip);
    while !(*closing.borrow_and_update() && task.is_done()) {
        tokio::select! {
            changed = closing.changed() => if changed.is_err() { break },
            begun = task.begun.recv() => task.begin(begun),
            Some(message) = task.seat.queue.recv() => task.frame(message).await,
            opened = settled(&mut task.connecting) => task.opened(opened),
            read = settled(&mut task.reading) => task.tell(read).await,
            alive = receipt(&mut task.connection) => task.receipt(alive).await,
            _ = rhythm.tick() => task.look().await,
        }
    }
    task.desk.hub.leave(task.seat.id);
}

/// Waits for a task, if there is one; `None` when it died.
async fn settled<T>(task: &mut Option<JoinHandle<T>>) -> Option<T> {
    let Some(running) = task else { return std::future::pending().await };
    let outcome = running.await;
    *task = None;
    outcome.ok()
}

/// Waits for a receipt, if there is a connection.
async fn receipt(connection: &mut Option<Connection>) -> bool {
    match connection {
        Some(connection) => connection.receipt().await,
        None => std::future::pending().await,
    }
}

impl Task {
    /// Nothing more to tell, or nobody to tell it to.
    fn is_done(&self) -> bool {
        let told = self.added.is_empty() && self.lines.as_ref().is_some_and(Lines::is_empty);
        self.connection.is_none() || told
    }

    fn subject(&self, topic: &str) -> String {
        format!("{ROOT}.{}.{topic}", self.spec.table())
    }

    fn begin(&mut self, begun: Result<PathBuf, RecvError>) {
        match begun {
            Ok(events) => self.added.push(events),
            Err(RecvError::Lagged(missed)) => self.missed_runs += missed,
            // The desk lives as long as this.
            Err(RecvError::Closed) => {}
        }
    }

    /// Sends a live frame, or drops it.
    async fn frame(&mut self, message: ws::Message) {
        let ws::Message::Binary(bytes) = message else { return };
        let Some((head, unplaced)) = Head::read(&bytes) else { return };
        self.frames_unplaced = unplaced.into();
        // The past is for a page that shows a window at once.
        if head.kind != FOLLOWS {
            return;
        }
        if self.run.0 != head.run {
            // Frames wait for a moment; the run may be the next one by now, and these are without a name then.
            let (number, name) = self.desk.hub.run();
            self.run = (head.run, if number == head.run { name } else { String::new() });
        }
        let subject = self.subject("live");
        let Some(connection) = self.connection.as_mut().filter(|connection| connection.room(Kind::Frame) > 0)
        else {
            self.frames_dropped += 1;
            return;
        };
        let mut frame = Vec::from(bytes);
        let dropped = self.frames_dropped + self.frames_unplaced;
        stamp(&mut frame, u32::try_from(dropped).unwrap_or(u32::MAX));
        let mut headers = HeaderMap::new();
        if !self.run.1.is_empty() {
            headers.insert(RUN_HEADER, self.run.1.as_str());
        }
        if let Err(error) = connection.send(Kind::Frame, &subject, headers, frame).await {
            self.object(error);
            self.frames_dropped += 1;
        }
    }

    fn opened(&mut self, opened: Option<Result<Connection, String>>) {
        match opened.unwrap_or_else(|| Err("the task that connects died".into())) {
            Ok(connection) => {
                tracing::info!(server = self.spec.server, table = self.spec.table(), "publishing");
                self.connection = Some(connection);
                let mut facts = self.facts.lock();
                (facts.connected, facts.error) = (true, None);
                facts.connections += 1;
            }
            Err(reason) => self.retry(reason),
        }
    }

    /// Tries again after a pause.
    fn retry(&mut self, reason: String) {
        self.object(reason);
        self.try_at = Instant::now() + self.pause;
        self.pause = (2 * self.pause).min(PAUSE.1);
    }

    /// Keeps what went wrong; the same is said once.
    fn object(&self, reason: String) {
        let mut facts = self.facts.lock();
        if facts.error.as_ref() != Some(&reason) {
            tracing::warn!(server = facts.server, "publication: {reason}");
            facts.error = Some(reason);
        }
    }

    /// Gives the connection up.
    fn lose(&mut self, reason: String) {
        if let Some(connection) = self.connection.take() {
            let (sent, confirmed) = connection.counts();
            self.frames_dropped += sent.frames - confirmed.frames;
            self.before.0 += confirmed.messages();
            self.before.1 += confirmed.frames;
            self.rewind = true;
            self.facts.lock().connected = false;
        }
        self.retry(reason);
    }

    async fn receipt(&mut self, alive: bool) {
        if !alive {
            return self.lose("the connection was lost".into());
        }
        let Some(connection) = &mut self.connection else { return };
        let (_, confirmed) = connection.counts();
        if confirmed.messages() > 0 {
            self.pause = PAUSE.0;
        }
        // What was sent meanwhile is asked for at once, so that a backlog goes at the pace of the server.
        connection.ask().await;
        if let Some(lines) = self.lines.as_mut().filter(|_| !self.rewind) {
            lines.confirm(confirmed.lines);
        }
        self.read();
    }

    /// In the rhythm of the loop: connects, looks into the record, sends the status, asks for receipts.
    async fn look(&mut self) {
        if let Some(connection) = &self.connection {
            let (complaint, lost) = (connection.complaint(), connection.is_lost());
            if let Some(complaint) = complaint {
                self.object(format!("the server objects: {complaint}"));
            }
            if let Some(reason) = lost {
                self.lose(reason);
            }
        } else if self.connecting.is_none() && Instant::now() >= self.try_at {
            self.connecting = Some(tokio::spawn(Connection::open(self.spec.clone())));
        }
        // Before a worker thread takes the lines away again.
        self.count();
        self.read();
        self.status().await;
        if let Some(connection) = &mut self.connection {
            connection.ask().await;
        }
    }

    /// Has a worker thread look into the record, unless one does.
    fn read(&mut self) {
        if self.reading.is_some() {
            return;
        }
        let Some(mut lines) = self.lines.take() else { return };
        if std::mem::take(&mut self.rewind) {
            let again = lines.rewind();
            self.facts.lock().resent += again;
        }
        for events in self.added.drain(..) {
            lines.add(events);
        }
        let room = self.connection.as_ref().map_or(0, |c| c.room(Kind::Line)) as usize;
        if lines.is_empty() {
            self.lines = Some(lines);
            return;
        }
        let desk = self.desk.clone();
        self.reading = Some(tokio::task::spawn_blocking(move || {
            let (messages, failed) = lines.take(room, |events| desk.journal.is_open(events));
            lines.measure();
            Read { lines, messages, failed }
        }));
    }

    /// Sends what a worker thread has found.
    async fn tell(&mut self, read: Option<Read>) {
        let Some(Read { mut lines, messages, failed }) = read else {
            // Its numbers are gone with it; what waits is told no more, and counting begins anew.
            self.missed_runs += 1;
            self.lines = Some(Lines::new(self.spec.table()));
            return self.lose("a worker thread died".into());
        };
        if let Some(reason) = failed {
            self.object(reason);
        }
        // A connection that was lost meanwhile has none of these; they come again.
        if let Some(connection) = self.connection.as_mut().filter(|_| !self.rewind) {
            let mut objection = None;
            for Message { topic, id, payload } in messages {
                let subject = format!("{ROOT}.{}.{}", self.spec.table(), topic.word());
                let mut headers = HeaderMap::new();
                headers.insert(ID_HEADER, id.as_str());
                if let Err(error) = connection.send(Kind::Line, &subject, headers, payload).await {
                    lines.refused();
                    objection = Some(format!("{id}: {error}"));
                }
            }
            connection.ask().await;
            lines.confirm(connection.counts().1.lines);
            if let Some(objection) = objection {
                self.object(objection);
            }
        }
        self.lines = Some(lines);
    }

    /// Brings the facts up to date.
    fn count(&self) {
        let mut facts = self.facts.lock();
        let confirmed = self.connection.as_ref().map(|connection| connection.counts().1).unwrap_or_default();
        facts.messages = self.before.0 + confirmed.messages();
        facts.frames = self.before.1 + confirmed.frames;
        facts.frames_dropped = self.frames_dropped + self.frames_unplaced;
        if let Some(lines) = &self.lines {
            let (waiting, lost_lines, lost_runs) = lines.waiting();
            facts.waiting_bytes = waiting;
            facts.lines_dropped = lost_lines;
            facts.runs_dropped = lost_runs + self.missed_runs;
        }
    }

    async fn status(&mut self) {
        let subject = self.subject("status");
        let Some(connection) = self.connection.as_mut().filter(|connection| connection.room(Kind::Other) > 0)
        else {
            return;
        };
        if Instant::now() < self.status_at {
            return;
        }
        self.status_at = Instant::now() + STATUS_EVERY;
        let publication = self.facts.read();
        let told = Told { table: self.spec.table(), publication, status: self.desk.status() };
        let sent = match serde_json::to_vec(&told) {
            Ok(payload) => connection.send(Kind::Other, &subject, HeaderMap::new(), payload).await,
            Err(error) => Err(error.to_string()),
        };
        if let Err(error) = sent {
            self.object(error);
        }
    }
}
