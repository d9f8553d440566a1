//! The rings between the control thread and everything else, split once into ends that say which
//! thread may hold them. The control thread never waits: a full ring drops the row, counts it, and
//! the next row that fits says how many went before it.

use super::Row;
use ringbuf::{
    HeapCons, HeapProd, HeapRb,
    traits::{Consumer, Observer, Producer, Split},
};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Depth of every ring, in entries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Depths {
    /// Rows for the recorder; 8 s at 2048 Hz unless a test wants it shallow.
    pub record: usize,
    /// Rows for the live view.
    pub live: usize,
    /// Events of the control thread.
    pub events: usize,
    /// Requests to the control thread.
    pub requests: usize,
}

impl Default for Depths {
    fn default() -> Self {
        Self { record: 8 * 2048, live: 2048, events: 1024, requests: 64 }
    }
}

impl Depths {
    /// The usual depths for a sampling rate, Hz: the record ring holds 8 s, the live ring 1 s.
    pub fn for_rate(sample_rate_hz: f64) -> Self {
        let second = (sample_rate_hz.ceil() as usize).max(256);
        Self { record: 8 * second, live: second, ..Self::default() }
    }
}

/// What was dropped, by ring; shared by all ends, written by the producers only.
#[derive(Debug, Default)]
pub struct Losses {
    record: AtomicU64,
    live: AtomicU64,
    events: AtomicU64,
    /// Rows that waited for the recorder when it last looked, per mille of its ring.
    waiting: AtomicU64,
}

/// One reading of [`Losses`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Lossy {
    /// Rows that never reached the recorder.
    pub record: u64,
    /// Rows that never reached the live view (allowed, counted).
    pub live: u64,
    /// Events that found their ring full.
    pub events: u64,
}

impl Losses {
    fn read(&self) -> Lossy {
        Lossy {
            record: self.record.load(Ordering::Acquire),
            live: self.live.load(Ordering::Acquire),
            events: self.events.load(Ordering::Acquire),
        }
    }
}

/// The end that the control thread holds: rows and events out, requests in.
pub struct ControlEnd<E, Q> {
    record: HeapProd<Row>,
    live: HeapProd<Row>,
    events: HeapProd<E>,
    requests: HeapCons<Q>,
    losses: Arc<Losses>,
    lost_before: u32,
}

impl<E, Q> ControlEnd<E, Q> {
    /// Publishes one row to the recorder and to the live view; never waits.
    pub fn publish(&mut self, row: &Row) {
        let marked = Row { lost_before: self.lost_before, ..*row };
        if self.record.try_push(marked).is_ok() {
            self.lost_before = 0;
        } else {
            self.lost_before = self.lost_before.saturating_add(1);
            self.losses.record.fetch_add(1, Ordering::Release);
        }
        if self.live.try_push(*row).is_err() {
            self.losses.live.fetch_add(1, Ordering::Release);
        }
    }

    /// Publishes one event; a full ring drops and counts it.
    pub fn event(&mut self, event: E) {
        if self.events.try_push(event).is_err() {
            self.losses.events.fetch_add(1, Ordering::Release);
        }
    }

    /// The next request, oldest first.
    pub fn request(&mut self) -> Option<Q> {
        self.requests.try_pop()
    }

    /// Rows that can still be published before the recorder's ring is full.
    pub fn record_room(&self) -> usize {
        self.record.vacant_len()
    }

    /// What was dropped so far.
    pub fn losses(&self) -> Lossy {
        self.losses.read()
    }
}

/// The end that the recorder thread holds.
pub struct RecorderEnd<E> {
    rows: HeapCons<Row>,
    events: HeapCons<E>,
    losses: Arc<Losses>,
}

impl<E> RecorderEnd<E> {
    /// Moves what has arrived into `rows`, at most up to its capacity; returns how many.
    pub fn take_rows(&mut self, rows: &mut Vec<Row>) -> usize {
        self.losses.waiting.store((1e3 * self.fill()) as u64, Ordering::Relaxed);
        let before = rows.len();
        let room = rows.capacity() - before;
        rows.extend(self.rows.pop_iter().take(room));
        rows.len() - before
    }

    /// The next event, oldest first.
    pub fn take_event(&mut self) -> Option<E> {
        self.events.try_pop()
    }

    /// Whether the control thread has let its end go; what is still in the rings remains readable.
    pub fn closed(&self) -> bool {
        !self.rows.write_is_held()
    }

    /// Share of the ring that waits to be written, 0 to 1.
    pub fn fill(&self) -> f64 {
        self.rows.occupied_len() as f64 / self.rows.capacity().get() as f64
    }

    /// What was dropped so far.
    pub fn losses(&self) -> Lossy {
        self.losses.read()
    }
}

/// The end that the live view holds.
pub struct ViewEnd {
    rows: HeapCons<Row>,
    losses: Arc<Losses>,
}

impl ViewEnd {
    /// The next row, oldest first.
    pub fn take_row(&mut self) -> Option<Row> {
        self.rows.try_pop()
    }

    /// Whether the control thread has let its end go; what is still in the ring remains readable.
    pub fn closed(&self) -> bool {
        !self.rows.write_is_held()
    }

    /// What was dropped so far.
    pub fn losses(&self) -> Lossy {
        self.losses.read()
    }

    /// Share of the recorder's ring that waited when the recorder last looked, 0 to 1.
    pub fn record_fill(&self) -> f64 {
        1e-3 * self.losses.waiting.load(Ordering::Relaxed) as f64
    }
}

/// The end through which the operator's side asks the control thread for something.
pub struct OperatorEnd<Q> {
    requests: HeapProd<Q>,
}

impl<Q> OperatorEnd<Q> {
    /// Hands a request over.
    ///
    /// # Errors
    /// The request itself when the ring is full.
    pub fn ask(&mut self, request: Q) -> Result<(), Q> {
        self.requests.try_push(request)
    }
}

/// Makes the rings and splits them into their four ends, once.
pub fn split<E, Q>(depths: Depths) -> (ControlEnd<E, Q>, RecorderEnd<E>, ViewEnd, OperatorEnd<Q>) {
    let (record, record_out) = HeapRb::new(depths.record.max(1)).split();
    let (live, live_out) = HeapRb::new(depths.live.max(1)).split();
    let (events, events_out) = HeapRb::new(depths.events.max(1)).split();
    let (requests_in, requests) = HeapRb::new(depths.requests.max(1)).split();
    let losses = Arc::new(Losses::default());
    (
        ControlEnd { record, live, events, requests, losses: losses.clone(), lost_before: 0 },
        RecorderEnd { rows: record_out, events: events_out, losses: losses.clone() },
        ViewEnd { rows: live_out, losses },
        OperatorEnd { requests: requests_in },
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::Sample;

    fn row(sequence: u64) -> Row {
        Row { sample: Sample { sequence, ..Sample::default() }, ..Row::default() }
    }

    #[test]
    fn an_overflow_is_counted_and_the_numbers_tell_which_rows_went() {
        let depths = Depths { record: 4, live: 2, events: 1, requests: 1 };
        let (mut control, mut recorder, mut view, mut operator) = split::<u8, u8>(depths);
        for sequence in 0..7 {
            control.publish(&row(sequence));
        }
        let mut rows = Vec::with_capacity(16);
        assert_eq!(recorder.take_rows(&mut rows), 4);
        control.publish(&row(7));
        recorder.take_rows(&mut rows);
        let kept: Vec<u64> = rows.iter().map(|row| row.sample.sequence).collect();
        assert_eq!(kept, [0, 1, 2, 3, 7]);
        assert_eq!(rows[4].lost_before, 3);
        assert_eq!(recorder.losses(), Lossy { record: 3, live: 6, events: 0 });
        assert_eq!(view.take_row().map(|row| row.sample.sequence), Some(0));
        control.event(1);
        control.event(2);
        assert_eq!(recorder.take_event(), Some(1));
        assert_eq!(recorder.take_event(), None);
        assert_eq!(control.losses().events, 1);
        operator.ask(9).expect("room");
        assert_eq!(operator.ask(8), Err(8));
        assert_eq!(control.request(), Some(9));
    }

    #[test]
    fn a_reader_with_little_room_takes_no_more_than_that() {
        let (mut control, mut recorder, _view, _operator) = split::<u8, u8>(Depths::default());
        for sequence in 0..10 {
            control.publish(&row(sequence));
        }
        let mut rows = Vec::with_capacity(4);
        let capacity = rows.capacity();
        assert_eq!(recorder.take_rows(&mut rows), capacity.min(10));
        assert_eq!(rows[0].sample.sequence, 0);
    }
}
