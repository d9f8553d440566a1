//! The recorder: an ordinary thread that empties the rings of the control thread into a run folder.
//! Every way in which something can be lost is found here, counted and written down: a full ring, a
//! DAQ that skipped numbers, a disk that refuses.

use super::chain::LINK_ROWS;
use super::first_out::FirstOut;
use super::folder::{LossReport, RunError, RunFolder, io};
use super::samples::{SampleWriter, chunk_rows};
use super::steps_csv;
use super::syncer::Syncer;
use crate::control::event::{Ending, Event, Nrmse, StepSummary};
use crate::safety::DetectorId;
use crate::stream::{RecorderEnd, Row};
use crossbeam::channel::Sender;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::time::{Duration, Instant};

/// Chunks that are taken from the ring together at most.
const MOST_CHUNKS: usize = 16;
/// How often written rows are forced to the disk, which bounds what a power cut loses.
const SYNC_EVERY: Duration = Duration::from_secs(1);
/// How often the rings are looked into while they are empty; the control thread wakes nobody.
const POLL: Duration = Duration::from_millis(5);

/// What the recorder tells the operator's side while it works.
#[derive(Clone, Debug)]
pub enum Notice {
    /// An event of the control thread, already written down.
    Event(Event),
    /// The newest row written.
    Row(Row),
    /// Something could not be written; the run is no longer clean and should be stopped.
    Failed(String),
}

/// What the recorder has to say at the end.
#[derive(Clone, Debug, Default)]
pub struct Recorded {
    /// Rows written.
    pub rows: u64,
    /// Hash chain over all rows.
    pub sha256: String,
    /// What was lost.
    pub lost: LossReport,
    /// Results of the steps.
    pub steps: Vec<StepSummary>,
    /// How the control thread ended the run, if it said so.
    pub ending: Option<Ending>,
    /// Onboard model against measurement over all counted cycles.
    pub model_error: Nrmse,
    /// First-out cause of an abort.
    pub cause: Option<DetectorId>,
    /// First error in writing.
    pub error: Option<String>,
}

/// Empties the rings of one run into its folder.
pub struct Recorder {
    end: RecorderEnd<Event>,
    notices: Sender<Notice>,
    samples: SampleWriter,
    syncer: Syncer,
    chunk_rows: usize,
    events: BufWriter<File>,
    steps: BufWriter<File>,
    integrity: BufWriter<File>,
    /// For the samples of the stop, and for what is known at the end.
    reserves: [Option<Reserve>; 2],
    rows: Vec<Row>,
    last_sequence: Option<u64>,
    /// Rows that the disk refused: after and up to which number, and how many.
    unwritten: Option<(Option<u64>, u64, u64)>,
    marked_lost: u64,
    daq_lost: u64,
    first_out: FirstOut,
    result: Recorded,
}

/// Room on the disk that is kept while a run goes on, bytes, twice: for the samples of the stop that a full
/// disk brings (9 s of them), and for what is known at the end: events, table, manifest, report.
const RESERVE_BYTES: u64 = 2 << 20;

impl Recorder {
    /// Makes all files of the folder, before anything moves.
    ///
    /// # Errors
    /// [`RunError`] when one cannot be made.
    pub fn create(
        folder: &RunFolder,
        end: RecorderEnd<Event>,
        sample_rate_hz: f64,
        notices: Sender<Notice>,
    ) -> Result<Self, RunError> {
        let create = |path: std::path::PathBuf| File::create(&path).map(BufWriter::new).map_err(io(&path));
        // Appended to, as the daemon writes down there what operators do; a line is written at once.
        let append = |path: std::path::PathBuf| {
            let options = std::fs::OpenOptions::new().create(true).append(true).clone();
            options.open(&path).map(BufWriter::new).map_err(io(&path))
        };
        let [stop, at_end] = folder.reserves();
        let samples = SampleWriter::create(&folder.samples(), sample_rate_hz)?;
        let (events, integrity) = (append(folder.events())?, create(folder.integrity())?);
        let mut recorder = Self {
            samples,
            events,
            integrity,
            syncer: Syncer::start(&[folder.samples(), folder.events(), folder.integrity()])?,
            steps: create(folder.steps())?,
            reserves: [
                Reserve::take(&stop, RESERVE_BYTES)?.into(),
                Reserve::take(&at_end, RESERVE_BYTES)?.into(),
            ],
            chunk_rows: chunk_rows(sample_rate_hz),
            rows: Vec::with_capacity(MOST_CHUNKS * chunk_rows(sample_rate_hz)),
            end,
            notices,
            last_sequence: None,
            unwritten: None,
            marked_lost: 0,
            daq_lost: 0,
            first_out: FirstOut::new(folder.first_out(), sample_rate_hz),
            result: Recorded::default(),
        };
        let head = writeln!(recorder.steps, "{}", steps_csv::head()).and_then(|()| recorder.steps.flush());
        head.map_err(io(&folder.steps()))?;
        Ok(recorder)
    }

    /// Records until the control thread lets its end of the rings go and everything is written. What
    /// cannot be written is in [`Recorded::error`] and told at once through the notices; the rings go on
    /// being emptied.
    pub fn record(mut self) -> Recorded {
        self.run();
        self.finish()
    }
}

/// Room that is given back when it is needed.
struct Reserve(std::path::PathBuf);

impl Reserve {
    fn take(path: &std::path::Path, bytes: u64) -> Result<Self, RunError> {
        let file = File::create(path).map_err(io(path))?;
        let reserve = Self(path.to_owned());
        let flags = rustix::fs::FallocateFlags::empty();
        match rustix::fs::fallocate(&file, flags, 0, bytes) {
            // Not every file system can; such a one keeps no room.
            Ok(()) | Err(rustix::io::Errno::OPNOTSUPP | rustix::io::Errno::NOSYS) => Ok(reserve),
            Err(error) => Err(io(path)(error.into())),
        }
    }
}

impl Drop for Reserve {
    fn drop(&mut self) {
        // A file that stays is no harm: `recover` takes it away.
        let _ = std::fs::remove_file(&self.0);
    }
}

impl Recorder {
    fn run(&mut self) {
        let mut synced = Instant::now();
        loop {
            // Asked first: what was published before the end was let go is then seen below.
            let closed = self.end.closed();
            let taken = self.end.take_rows(&mut self.rows);
            self.take_events();
            // Whole chunks only, a quarter of a second each, which is what a killed process may lose.
            let whole = self.rows.len() - self.rows.len() % self.chunk_rows;
            self.write_rows(if closed && taken == 0 { self.rows.len() } else { whole });
            if synced.elapsed() >= SYNC_EVERY {
                let outcome = self.syncer.ask();
                self.note(outcome);
                synced = Instant::now();
            }
            if closed && taken == 0 && self.rows.is_empty() {
                break;
            }
            if taken == 0 && !closed {
                std::thread::park_timeout(POLL);
            }
        }
    }

    /// Keeps the first error, tells it, and goes on.
    fn note(&mut self, outcome: Result<(), String>) {
        if let Err(error) = outcome
            && self.result.error.is_none()
        {
            self.result.error = Some(error.clone());
            // Nobody listening any more is no reason to stop recording.
            let _ = self.notices.send(Notice::Failed(error));
        }
    }

    /// Appends rows. A disk that refuses them ends the run; the room kept for that takes them and those of
    /// the stop.
    fn append(&mut self, rows: &[Row]) -> Result<(), String> {
        let mut links = String::new();
        let mut appended = self.samples.append(rows, |link| links += &format!("{link}\n"));
        if let Err(error) = &appended
            && self.reserves[0].take().is_some()
        {
            self.note(Err(error.to_string()));
            appended = self.samples.append(rows, |link| links += &format!("{link}\n"));
        }
        appended.map_err(|error| error.to_string())?;
        let linked = self.integrity.write_all(links.as_bytes()).and_then(|()| self.integrity.flush());
        self.note(linked.map_err(|error| format!("integrity.txt: {error}")));
        Ok(())
    }

    /// Writes the first `count` of the rows that wait.
    fn write_rows(&mut self, count: usize) {
        if count == 0 {
            return;
        }
        let mut waiting = std::mem::take(&mut self.rows);
        let rows = &waiting[..count];
        for row in rows {
            self.watch_sequence(row);
        }
        match self.append(rows) {
            Ok(()) => self.tell_unwritten(rows.first().map(|row| row.sample.sequence)),
            Err(error) => {
                self.count_unwritten(rows);
                self.note(Err(error));
            }
        }
        let kept = self.first_out.take(rows);
        self.note(kept.map_err(|error| format!("first-out.h5: {error}")));
        if let Some(last) = rows.last() {
            let _ = self.notices.try_send(Notice::Row(*last));
        }
        waiting.drain(..count);
        self.rows = waiting;
    }

    /// Counts rows that the disk refused.
    fn count_unwritten(&mut self, rows: &[Row]) {
        let (Some(first), Some(last)) = (rows.first(), rows.last()) else { return };
        let count = rows.len() as u64;
        self.result.lost.samples += count;
        self.result.lost.disk += count;
        let before = first.sample.sequence.checked_sub(1);
        self.unwritten = Some(match self.unwritten {
            Some((after, _, more)) => (after, last.sample.sequence, more + count),
            None => (before, last.sample.sequence, count),
        });
    }

    /// Writes down the rows that the disk refused, once it takes some again (`before` is the first of
    /// these) or the run is over.
    fn tell_unwritten(&mut self, before: Option<u64>) {
        if let Some((after, last, missing)) = self.unwritten.take() {
            let record = serde_json::json!({
                "event": "gap", "after": after, "before": before, "missing": missing, "last": last,
                "refused_by_disk": missing, "dropped_by_ring": 0, "not_delivered_by_daq": 0,
            });
            self.write_event(&record.to_string());
        }
    }

    /// Finds jumps in the numbers and says what they are: rows the ring dropped, or samples that the DAQ
    /// never delivered.
    fn watch_sequence(&mut self, row: &Row) {
        let sequence = row.sample.sequence;
        let ring = u64::from(row.lost_before);
        self.marked_lost += ring;
        if let Some(last) = self.last_sequence {
            let missing = sequence.saturating_sub(last + 1);
            if missing > 0 {
                self.gap(Some(last), Some(sequence), missing, ring.min(missing));
                self.daq_lost += missing.saturating_sub(ring);
            }
        } else if ring > 0 {
            self.gap(None, Some(sequence), ring, ring);
        }
        self.last_sequence = Some(sequence.max(self.last_sequence.unwrap_or(0)));
    }

    /// Writes a gap record.
    fn gap(&mut self, after: Option<u64>, before: Option<u64>, missing: u64, ring: u64) {
        let record = serde_json::json!({
            "event": "gap", "after": after, "before": before, "missing": missing,
            "dropped_by_ring": ring, "not_delivered_by_daq": missing.saturating_sub(ring),
        });
        self.write_event(&record.to_string());
    }

    fn write_event(&mut self, line: &str) {
        let outcome = writeln!(self.events, "{line}").and_then(|()| self.events.flush());
        self.note(outcome.map_err(|error| format!("events.jsonl: {error}")));
    }

    fn take_events(&mut self) {
        while let Some(event) = self.end.take_event() {
            if matches!(event, Event::Live { .. }) {
                let _ = self.notices.try_send(Notice::Event(event));
                continue;
            }
            match serde_json::to_string(&event) {
                Ok(line) => self.write_event(&line),
                Err(error) => self.note(Err(error.to_string())),
            }
            match event {
                Event::Step(step) => {
                    let outcome =
                        writeln!(self.steps, "{}", steps_csv::line(&step)).and_then(|()| self.steps.flush());
                    self.note(outcome.map_err(|error| format!("steps.csv: {error}")));
                    self.result.steps.push(step);
                }
                Event::Abort { cause, sequence, .. } => {
                    self.first_out.trip(sequence);
                    self.result.cause.get_or_insert(cause);
                }
                Event::End { ending, error, .. } => {
                    self.result.ending = Some(ending);
                    self.result.model_error = error;
                }
                _ => {}
            }
            let _ = self.notices.try_send(Notice::Event(event));
        }
    }

    fn finish(mut self) -> Recorded {
        self.reserves = [None, None];
        self.take_events();
        self.tell_unwritten(None);
        let kept = self.first_out.finish();
        self.note(kept.map_err(|error| format!("first-out.h5: {error}")));
        let losses = self.end.losses();
        let unmarked = losses.record.saturating_sub(self.marked_lost);
        if unmarked > 0 {
            let last = self.last_sequence;
            self.gap(last, None, unmarked, unmarked);
        }
        let lost = &mut self.result.lost;
        lost.ring = losses.record;
        lost.daq = self.daq_lost;
        lost.samples += losses.record + self.daq_lost;
        lost.events = losses.events;
        lost.live = losses.live;
        self.result.rows = self.samples.rows();
        let outcome = self.syncer.finish();
        self.note(outcome);
        match self.samples.close() {
            Ok(last) => {
                // The last block is open where the run ended; a whole one has its link already.
                if !last.rows.is_multiple_of(LINK_ROWS) {
                    let linked = writeln!(self.integrity, "{last}").and_then(|()| self.integrity.flush());
                    if let Err(error) = linked {
                        self.result.error.get_or_insert(format!("integrity.txt: {error}"));
                    }
                }
                self.result.sha256 = last.chain;
            }
            Err(error) => {
                self.result.error.get_or_insert(error.to_string());
            }
        }
        self.result
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::samples::SampleReader;
    use crate::stream::{Depths, Sample, split};

    fn row(sequence: u64) -> Row {
        Row { sample: Sample { sequence, ..Sample::default() }, ..Row::default() }
    }

    #[test]
    fn an_overflowing_ring_is_counted_recorded_and_told_apart_from_the_daq() {
        let out = tempfile::tempdir().expect("folder");
        let folder = RunFolder::create(out.path(), "overflow").expect("made");
        let depths = Depths { record: 100, ..Depths::default() };
        let (mut control, mut end, _view, _operator) = split::<Event, ()>(depths);
        // Nobody reads yet: of 150 rows the last 50 are dropped. The DAQ itself skips 5 numbers later.
        for sequence in 0..150 {
            control.publish(&row(sequence));
        }
        let mut first = Vec::with_capacity(100);
        assert_eq!(end.take_rows(&mut first), 100);
        for sequence in (150..170).chain(175..180) {
            control.publish(&row(sequence));
        }
        drop(control);
        let (notices, _told) = crossbeam::channel::unbounded();
        let recorded = Recorder::create(&folder, end, 2048.0, notices).expect("made").record();
        assert_eq!(recorded.rows, 25);
        assert_eq!(recorded.lost, LossReport { samples: 55, ring: 50, daq: 5, ..LossReport::default() });
        let reader = SampleReader::open(&folder.samples()).expect("opens");
        let rows = reader.read(0, 25).expect("reads");
        assert_eq!((rows[0].sample.sequence, rows[0].lost_before), (150, 50));
        let events = std::fs::read_to_string(folder.events()).expect("events");
        let gaps: Vec<serde_json::Value> =
            events.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
        assert_eq!(gaps.len(), 2);
        assert_eq!((gaps[0]["before"].as_u64(), gaps[0]["missing"].as_u64()), (Some(150), Some(50)));
        assert_eq!(gaps[1]["after"].as_u64(), Some(169));
        assert_eq!(gaps[1]["not_delivered_by_daq"].as_u64(), Some(5));
    }

    #[test]
    fn rows_dropped_at_the_very_end_are_found() {
        let out = tempfile::tempdir().expect("folder");
        let folder = RunFolder::create(out.path(), "tail").expect("made");
        let depths = Depths { record: 10, ..Depths::default() };
        let (mut control, end, _view, _operator) = split::<Event, ()>(depths);
        for sequence in 0..14 {
            control.publish(&row(sequence));
        }
        drop(control);
        let (notices, _told) = crossbeam::channel::unbounded();
        let recorded = Recorder::create(&folder, end, 2048.0, notices).expect("made").record();
        assert_eq!((recorded.rows, recorded.lost.samples), (10, 4));
        let events = std::fs::read_to_string(folder.events()).expect("events");
        assert!(events.contains("\"after\":9") && events.contains("\"missing\":4"), "{events}");
    }
}
