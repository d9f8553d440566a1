//! The first-out snapshot (SR-12): all channels from 5 s before the cause of an abort to 5 s after, in a small file of the
//! same layout as the samples. Fed by the recorder with every row; what it needs of the past it keeps itself.

use super::samples::{SampleFileError, SampleWriter};
use crate::safety::SNAPSHOT_S;
use crate::stream::Row;
use std::collections::VecDeque;
use std::path::PathBuf;

/// Collects the rows around the first cause.
pub struct FirstOut {
    path: PathBuf,
    sample_rate_hz: f64,
    half: u64,
    rows: VecDeque<Row>,
    window: Option<(u64, u64)>,
    written: bool,
}

impl FirstOut {
    /// Writes to `path` once there is a cause; until then nothing is made.
    pub fn new(path: PathBuf, sample_rate_hz: f64) -> Self {
        let half = (SNAPSHOT_S * sample_rate_hz).ceil() as u64;
        let rows = VecDeque::with_capacity(2 * half as usize + 2);
        Self { path, sample_rate_hz, half, rows, window: None, written: false }
    }

    /// Takes rows in their order; writes the file when the last one of the window has come.
    ///
    /// # Errors
    /// [`SampleFileError`] of the file.
    pub fn take(&mut self, rows: &[Row]) -> Result<(), SampleFileError> {
        for row in rows {
            if self.window.is_some_and(|(_, last)| row.sample.sequence > last) {
                self.write()?;
            }
            if self.written {
                return Ok(());
            }
            if self.rows.len() == self.rows.capacity() {
                self.rows.pop_front();
            }
            self.rows.push_back(*row);
        }
        Ok(())
    }

    /// The first cause, after this sample; later ones change nothing.
    pub fn trip(&mut self, sequence: u64) {
        self.window.get_or_insert((sequence.saturating_sub(self.half), sequence + self.half));
    }

    /// The run is over: writes what there is, if there was a cause.
    ///
    /// # Errors
    /// [`SampleFileError`] of the file.
    pub fn finish(&mut self) -> Result<(), SampleFileError> {
        self.write()
    }

    fn write(&mut self) -> Result<(), SampleFileError> {
        let Some((first, last)) = self.window.filter(|_| !self.written) else { return Ok(()) };
        self.written = true;
        let within = |row: &&Row| (first..=last).contains(&row.sample.sequence);
        let rows: Vec<Row> = self.rows.iter().filter(within).copied().collect();
        let mut writer = SampleWriter::create(&self.path, self.sample_rate_hz)?;
        writer.append(&rows, |_| {})?;
        writer.close().map(|_| ())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::samples::SampleReader;
    use crate::stream::Sample;

    fn rows(sequence: std::ops::Range<u64>) -> Vec<Row> {
        sequence
            .map(|sequence| Row { sample: Sample { sequence, ..Sample::default() }, ..Row::default() })
            .collect()
    }

    fn numbers(path: &std::path::Path) -> (u64, u64, u64) {
        let reader = SampleReader::open(path).expect("opens");
        let rows = reader.read(0, reader.rows()).expect("reads");
        (rows[0].sample.sequence, rows[rows.len() - 1].sample.sequence, reader.rows())
    }

    // SR-12
    #[test]
    fn five_seconds_before_and_after_are_kept_even_if_the_rows_are_ahead_of_the_cause() {
        let out = tempfile::tempdir().expect("folder");
        let path = out.path().join("first-out.h5");
        let mut first_out = FirstOut::new(path.clone(), 100.0);
        first_out.take(&rows(0..3000)).expect("kept");
        first_out.take(&rows(3000..3300)).expect("kept");
        first_out.trip(3000);
        first_out.trip(3100);
        assert!(!path.exists());
        first_out.take(&rows(3300..4000)).expect("written");
        assert_eq!(numbers(&path), (2500, 3500, 1001));
        first_out.finish().expect("nothing left");
        assert_eq!(numbers(&path), (2500, 3500, 1001));
    }

    #[test]
    fn a_run_that_ends_early_keeps_what_there_is() {
        let out = tempfile::tempdir().expect("folder");
        let path = out.path().join("first-out.h5");
        let mut first_out = FirstOut::new(path.clone(), 100.0);
        first_out.take(&rows(0..300)).expect("kept");
        first_out.finish().expect("no cause");
        assert!(!path.exists());
        first_out.trip(250);
        first_out.finish().expect("written");
        assert_eq!(numbers(&path), (0, 299, 300));
    }
}
