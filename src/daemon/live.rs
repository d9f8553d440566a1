//! The live view: takes rows off their ring, joins them for long windows, and hands every client its
//! frames through a queue of its own. A full queue drops the frame and counts it; nobody waits for a
//! client, and the ring that feeds this is not the recorder's.

use super::frame::{Envelope, FOLLOWS, Head, Point, REPLACES, encode, point, stamp};
use super::meters::{Gauge, Meters};
use crate::stream::ViewEnd;
use axum::body::Bytes;
use axum::extract::ws::{Message, Utf8Bytes};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::mpsc;

/// Longest window that is sent row by row, s.
pub const RAW_WINDOW_S: f64 = 5.0;
/// Longest window, s.
pub const LONGEST_WINDOW_S: f64 = 300.0;
/// Clients that may watch at once.
pub const MOST_CLIENTS: usize = 128;
/// Frames that wait for a client before they are dropped: about a second.
const QUEUE: usize = 64;
/// How often frames go out.
const RHYTHM: Duration = Duration::from_millis(16);
/// Rows joined into two points, and the longest window (s) that this serves.
const TIERS: [(u64, f64); 5] =
    [(1, RAW_WINDOW_S), (16, 12.0), (64, 45.0), (128, 90.0), (512, LONGEST_WINDOW_S)];

/// One resolution of the live view.
struct Tier {
    envelope: Envelope,
    /// The past, for clients that come later.
    past: VecDeque<Point>,
    depth: usize,
    fresh: Vec<Point>,
    fresh_first: u64,
}

struct Client {
    id: u64,
    tier: usize,
    queue: mpsc::Sender<Message>,
    dropped: u32,
    /// The past of its window could not be queued yet; what follows makes no sense without it.
    owed: bool,
}

struct Shared {
    tiers: Vec<Tier>,
    clients: Vec<Client>,
    run: u32,
    /// Folder name of that run.
    id: String,
    next_sequence: u64,
    meters: Meters,
}

/// The live view of the daemon.
pub struct Hub {
    shared: Mutex<Shared>,
    next_id: AtomicU64,
    dropped: AtomicU64,
    sent: AtomicU64,
    connected: AtomicUsize,
    newest: AtomicU64,
    fill: AtomicU64,
}

/// What a new client gets: its number and its queue.
pub struct Seat {
    /// For [`Hub::window`] and [`Hub::leave`].
    pub id: u64,
    /// What it is sent.
    pub queue: mpsc::Receiver<Message>,
}

impl Default for Hub {
    fn default() -> Self {
        let shared = Shared {
            tiers: tiers(2048.0),
            clients: Vec::new(),
            run: 0,
            id: String::new(),
            next_sequence: 0,
            meters: Meters::default(),
        };
        Self {
            shared: Mutex::new(shared),
            next_id: AtomicU64::new(1),
            dropped: AtomicU64::new(0),
            sent: AtomicU64::new(0),
            connected: AtomicUsize::new(0),
            newest: AtomicU64::new(0),
            fill: AtomicU64::new(0),
        }
    }
}

fn tiers(rate_hz: f64) -> Vec<Tier> {
    let tier = |(factor, window_s): (u64, f64)| {
        let points = if factor == 1 { window_s * rate_hz } else { 2.0 * window_s * rate_hz / factor as f64 };
        Tier {
            envelope: Envelope::new(factor),
            past: VecDeque::with_capacity(points as usize + 2),
            depth: points as usize,
            fresh: Vec::new(),
            fresh_first: 0,
        }
    };
    TIERS.into_iter().map(tier).collect()
}

/// A window (s) that is shown with so many rows joined into two points; `None` when no window is.
pub fn window_of(rows: u64) -> Option<f64> {
    TIERS.iter().find(|(factor, _)| *factor == rows).map(|(_, longest_s)| *longest_s)
}

/// The resolution that serves a window.
fn tier_of(window_s: f64) -> usize {
    TIERS.iter().position(|(_, longest_s)| window_s <= *longest_s).unwrap_or(TIERS.len() - 1)
}

impl Hub {
    fn lock(&self) -> MutexGuard<'_, Shared> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a client in; `None` when there are too many.
    pub fn join(&self, window_s: f64) -> Option<Seat> {
        let (queue, seat) = mpsc::channel(QUEUE);
        let id = self.next_id.fetch_add(1, Ordering::Relaxed);
        let mut shared = self.lock();
        if shared.clients.len() >= MOST_CLIENTS {
            return None;
        }
        let mut client = Client { id, tier: tier_of(window_s), queue, dropped: 0, owed: true };
        shared.replay(&mut client);
        shared.clients.push(client);
        self.connected.store(shared.clients.len(), Ordering::Relaxed);
        Some(Seat { id, queue: seat })
    }

    /// Changes the window of a client; it is sent the past of the new one.
    pub fn window(&self, id: u64, window_s: f64) {
        let mut guard = self.lock();
        let shared = &mut *guard;
        if let Some(at) = shared.clients.iter().position(|client| client.id == id) {
            let mut client = shared.clients.swap_remove(at);
            (client.tier, client.owed) = (tier_of(window_s), true);
            shared.replay(&mut client);
            shared.clients.push(client);
        }
    }

    /// Lets a client go.
    pub fn leave(&self, id: u64) {
        let mut shared = self.lock();
        shared.clients.retain(|client| client.id != id);
        self.connected.store(shared.clients.len(), Ordering::Relaxed);
    }

    /// Sends a text to all clients.
    pub fn tell(&self, text: &str) {
        let text = Utf8Bytes::from(text);
        let mut shared = self.lock();
        for client in &mut shared.clients {
            self.count(client.queue.try_send(Message::Text(text.clone())).is_ok(), client);
        }
    }

    /// Frames dropped for all clients so far, frames sent, clients now.
    pub fn traffic(&self) -> (u64, u64, usize) {
        let of = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        (of(&self.dropped), of(&self.sent), self.connected.load(Ordering::Relaxed))
    }

    /// The newest readings.
    pub fn meters(&self) -> Meters {
        self.lock().meters
    }

    /// Sequence number of the newest row.
    pub fn newest(&self) -> u64 {
        self.newest.load(Ordering::Relaxed)
    }

    /// Share of the recorder's ring that waits to be written, 0 to 1.
    pub fn record_fill(&self) -> f64 {
        1e-3 * self.fill.load(Ordering::Relaxed) as f64
    }

    fn count(&self, sent: bool, client: &mut Client) {
        if sent {
            self.sent.fetch_add(1, Ordering::Relaxed);
        } else {
            client.dropped = client.dropped.saturating_add(1);
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Number of the run that frames show, and its folder name.
    pub fn run(&self) -> (u32, String) {
        let shared = self.lock();
        (shared.run, shared.id.clone())
    }

    /// Feeds the clients from a run's ring until the control thread lets its end go. Runs on a thread of
    /// its own.
    pub fn follow(&self, id: String, mut view: ViewEnd, rate_hz: f64, half_gap_m: Option<f64>) {
        let mut gauge = Gauge::new(rate_hz, half_gap_m);
        {
            let mut shared = self.lock();
            (shared.run, shared.id) = (shared.run.wrapping_add(1), id);
            shared.tiers = tiers(rate_hz);
            shared.meters = Meters::default();
        }
        let mut rows = Vec::with_capacity(256);
        loop {
            // Asked first: what was published before the end was let go is then seen below.
            let closed = view.closed();
            rows.clear();
            while let Some(row) = view.take_row() {
                gauge.push(&row);
                rows.push((row.sample.sequence, point(&row)));
            }
            self.fill.store((1e3 * view.record_fill()) as u64, Ordering::Relaxed);
            if !rows.is_empty() {
                self.show(&rows, gauge.readings());
            }
            if closed {
                return;
            }
            std::thread::sleep(RHYTHM);
        }
    }

    /// Shows rows; a frame holds no gap, so that its first number tells those of all others.
    fn show(&self, rows: &[(u64, Point)], meters: Meters) {
        for stretch in rows.chunk_by(|before, after| before.0 + 1 == after.0) {
            self.show_stretch(stretch, meters);
        }
    }

    fn show_stretch(&self, rows: &[(u64, Point)], meters: Meters) {
        let mut guard = self.lock();
        let shared = &mut *guard;
        shared.meters = meters;
        for (sequence, point) in rows {
            shared.take(*sequence, point);
        }
        if let Some((sequence, _)) = rows.last() {
            self.newest.store(*sequence, Ordering::Relaxed);
        }
        let run = shared.run;
        let frames: Vec<Option<Vec<u8>>> = shared.tiers.iter_mut().map(|tier| tier.frame(run)).collect();
        let mut clients = std::mem::take(&mut shared.clients);
        for client in &mut clients {
            if client.owed {
                shared.replay(client);
                self.count(!client.owed, client);
            } else if let Some(Some(frame)) = frames.get(client.tier) {
                let mut own = frame.clone();
                stamp(&mut own, client.dropped);
                let sent = client.queue.try_send(Message::Binary(Bytes::from(own))).is_ok();
                self.count(sent, client);
            }
        }
        shared.clients = clients;
        for tier in &mut shared.tiers {
            tier.fresh.clear();
        }
    }
}

impl Shared {
    fn take(&mut self, sequence: u64, point: &Point) {
        let jumped = sequence != self.next_sequence;
        self.next_sequence = sequence + 1;
        for tier in &mut self.tiers {
            if jumped {
                tier.envelope.clear();
            }
            tier.take(sequence, point);
        }
    }

    /// Sends the past to a client, the newest rows included; a full queue is tried again with the next rows.
    fn replay(&self, client: &mut Client) {
        let Some(tier) = self.tiers.get(client.tier) else { return };
        let points: Vec<Point> = tier.past.iter().copied().collect();
        let factor = tier.envelope.factor();
        let rows = if factor == 1 { points.len() as u64 } else { points.len() as u64 / 2 * factor };
        let head = Head {
            kind: REPLACES,
            count: points.len() as u32,
            factor: factor as u32,
            run: self.run,
            first: self.next_sequence.saturating_sub(rows),
        };
        let mut frame = encode(&head, &points);
        stamp(&mut frame, client.dropped);
        client.owed = client.queue.try_send(Message::Binary(Bytes::from(frame))).is_err();
    }
}

impl Tier {
    fn take(&mut self, sequence: u64, point: &Point) {
        let factor = self.envelope.factor();
        let (pair, count) = if factor == 1 {
            ([*point; 2], 1)
        } else {
            match self.envelope.push(point) {
                Some(pair) => (pair, 2),
                None => return,
            }
        };
        if self.fresh.is_empty() {
            self.fresh_first = sequence + 1 - factor.min(sequence + 1);
        }
        for point in pair.iter().take(count) {
            if self.past.len() >= self.depth {
                self.past.pop_front();
            }
            self.past.push_back(*point);
            self.fresh.push(*point);
        }
    }

    fn frame(&mut self, run: u32) -> Option<Vec<u8>> {
        if self.fresh.is_empty() {
            return None;
        }
        let head = Head {
            kind: FOLLOWS,
            count: self.fresh.len() as u32,
            factor: self.envelope.factor() as u32,
            run,
            first: self.fresh_first,
        };
        Some(encode(&head, &self.fresh))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::{Depths, Row, Sample, split};

    fn rows(from: u64, count: u64) -> Vec<(u64, Point)> {
        (from..from + count).map(|n| (n, [n as f32; 10])).collect()
    }

    fn head(message: &Message) -> (u8, u32, u64, u32) {
        let Message::Binary(bytes) = message else { panic!("binary: {message:?}") };
        let (head, dropped) = Head::read(bytes).expect("a frame");
        (head.kind, head.count, head.first, dropped)
    }

    #[test]
    fn a_client_that_reads_nothing_loses_frames_and_is_told_how_many() {
        let hub = Hub::default();
        let mut idle = hub.join(5.0).expect("room");
        let mut eager = hub.join(5.0).expect("room");
        let mut expected = 0;
        for n in 0..200 {
            hub.show(&rows(33 * n, 33), Meters::default());
            while let Ok(message) = eager.queue.try_recv() {
                let (kind, count, first, dropped) = head(&message);
                if kind == FOLLOWS {
                    assert_eq!((count, first, dropped), (33, expected, 0));
                    expected += 33;
                }
            }
        }
        assert_eq!(expected, 33 * 200);
        // One place was taken by the past.
        assert_eq!(hub.traffic().0, 200 - 63);
        for _ in 0..QUEUE {
            idle.queue.try_recv().expect("queued");
        }
        hub.show(&rows(33 * 200, 33), Meters::default());
        assert_eq!(head(&idle.queue.try_recv().expect("sent")).3, 200 - 63);
    }

    #[test]
    fn a_late_client_is_shown_the_past_of_its_window() {
        let hub = Hub::default();
        hub.show(&rows(0, 30_000), Meters::default());
        let mut raw = hub.join(5.0).expect("room");
        assert_eq!(head(&raw.queue.try_recv().expect("past")), (REPLACES, 10_240, 30_000 - 10_240, 0));
        hub.window(raw.id, 30.0);
        let (kind, count, first, _) = head(&raw.queue.try_recv().expect("past"));
        assert_eq!((kind, count), (REPLACES, 2 * (30_000 / 64)));
        assert!(first < 64, "{first}");
        for _ in 1..MOST_CLIENTS {
            std::mem::forget(hub.join(5.0).expect("room").queue);
        }
        assert!(hub.join(5.0).is_none(), "more than {MOST_CLIENTS}");
        // A client whose queue is full when it changes its window gets the past of the new one later.
        while raw.queue.try_recv().is_ok() {}
        let mut shown = 0;
        // At this resolution two rows of 33 make one frame.
        while raw.queue.len() < QUEUE {
            hub.show(&rows(30_000 + 33 * shown, 33), Meters::default());
            shown += 1;
            assert!(shown < 10 * QUEUE as u64, "the queue never fills");
        }
        hub.window(raw.id, 5.0);
        while let Ok(message) = raw.queue.try_recv() {
            assert_ne!(head(&message).0, REPLACES, "there was no room for it");
        }
        hub.show(&rows(30_000 + 33 * shown, 33), Meters::default());
        assert_eq!(head(&raw.queue.try_recv().expect("past")).0, REPLACES);
        hub.leave(raw.id);
        assert!(hub.join(5.0).is_some());
    }

    #[test]
    fn the_view_ends_with_its_run() {
        let hub = Hub::default();
        let mut client = hub.join(5.0).expect("room");
        let (mut control, _recorder, view, _operator) = split::<u8, u8>(Depths::default());
        for sequence in 0..100 {
            control.publish(&Row { sample: Sample { sequence, ..Sample::default() }, ..Row::default() });
        }
        drop(control);
        hub.follow("night".into(), view, 2048.0, None);
        assert_eq!(hub.run(), (1, "night".to_owned()));
        let _past = client.queue.try_recv().expect("past");
        assert_eq!(head(&client.queue.try_recv().expect("rows")).1, 100);
        assert_eq!(hub.newest(), 99);
    }
}
