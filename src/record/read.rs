//! A run folder as a [`Record`], the form in which comparison, identification and diagnosis read.

use super::data::{Kind, Record};
use super::folder::{RunError, RunFolder};
use super::salvage::{readable_rows, visit_sound};
use crate::stream::Row;
use std::path::Path;

/// Reads the samples of a run, finished or interrupted. Samples that were lost are filled in by
/// straight lines, belong to no step, and are named in the notes.
///
/// # Errors
/// [`RunError`] when the folder is none or its samples cannot be opened.
pub fn read_run(path: &Path) -> Result<Record, RunError> {
    let folder = RunFolder::open(path)?;
    let manifest = folder.manifest()?;
    let rate = manifest.sample_rate_hz;
    let expected = usize::try_from(manifest.samples).unwrap_or(0).min(1 << 22);
    let mut grid = Grid::new(path, rate, expected);
    if !visit_sound(&folder, &mut |row| grid.push(&row)) {
        let (rows, damage) = readable_rows(&folder)?;
        grid = Grid::new(path, rate, rows.len());
        grid.record.notes.extend(damage.map(|damage| format!("reading stopped early: {damage}")));
        rows.iter().for_each(|row| grid.push(row));
    }
    Ok(grid.finish())
}

/// Rows being put on a uniform grid of time.
struct Grid {
    record: Record,
    first: u64,
    last: Option<(u64, [f64; 5])>,
    filled: u64,
}

impl Grid {
    fn new(path: &Path, sample_rate_hz: f64, rows: usize) -> Self {
        let mut record = Record::empty(path.display().to_string(), Kind::Base, sample_rate_hz);
        for channel in [
            &mut record.time_s,
            &mut record.table_displacement_m,
            &mut record.table_acceleration_m_s2,
            &mut record.mass_acceleration_1_m_s2,
            &mut record.mass_acceleration_2_m_s2,
            &mut record.relative_displacement_m,
        ] {
            channel.reserve_exact(rows);
        }
        record.step.reserve_exact(rows);
        Self { record, first: 0, last: None, filled: 0 }
    }

    fn push(&mut self, row: &Row) {
        let (sequence, c) = (row.sample.sequence, &row.sample.channels);
        let values = [
            c.table_displacement_m,
            c.table_acceleration_m_s2,
            c.mass_acceleration_1_m_s2,
            c.mass_acceleration_2_m_s2,
            c.relative_displacement_m,
        ];
        match self.last {
            None => self.first = sequence,
            // A repeated or backward number is the DAQ's fault and has no place on a uniform grid.
            Some((before, _)) if sequence <= before => {
                self.record.notes.push(format!("sample {sequence} came again and was left out"));
                return;
            }
            Some((before, old)) => {
                for missing in before + 1..sequence {
                    let share = (missing - before) as f64 / (sequence - before) as f64;
                    let between = std::array::from_fn(|i| old[i] + share * (values[i] - old[i]));
                    self.put(missing, &between, -1);
                    self.filled += 1;
                }
            }
        }
        self.put(sequence, &values, row.step);
        self.last = Some((sequence, values));
    }

    fn put(&mut self, sequence: u64, values: &[f64; 5], step: i32) {
        let record = &mut self.record;
        record.time_s.push((sequence - self.first) as f64 / record.sample_rate_hz);
        record.table_displacement_m.push(values[0]);
        record.table_acceleration_m_s2.push(values[1]);
        record.mass_acceleration_1_m_s2.push(values[2]);
        record.mass_acceleration_2_m_s2.push(values[3]);
        record.relative_displacement_m.push(values[4]);
        record.step.push(step);
    }

    fn finish(mut self) -> Record {
        if self.filled > 0 {
            let note = format!("{} lost samples were filled in by straight lines", self.filled);
            self.record.notes.push(note);
        }
        self.record
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Manifest;
    use crate::record::samples::SampleWriter;
    use crate::stream::Sample;

    #[test]
    fn lost_samples_are_bridged_and_named() {
        let out = tempfile::tempdir().expect("folder");
        let folder = RunFolder::create(out.path(), "read").expect("made");
        folder.write_manifest(&Manifest::new("read", 2048.0)).expect("written");
        let mut writer = SampleWriter::create(&folder.samples(), 2048.0).expect("created");
        let rows: Vec<Row> = [10u64, 11, 12, 15, 16]
            .map(|sequence| {
                let mut sample = Sample { sequence, ..Sample::default() };
                sample.channels.relative_displacement_m = sequence as f64;
                Row { sample, step: 3, ..Row::default() }
            })
            .to_vec();
        writer.append(&rows, |_| {}).expect("appended");
        writer.close().expect("closed");
        let record = read_run(folder.path()).expect("read");
        assert_eq!(record.relative_displacement_m, [10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0]);
        assert_eq!(record.step, [3, 3, 3, -1, -1, 3, 3]);
        assert_eq!(record.time_s[6], 6.0 / 2048.0);
        assert_eq!(record.notes, ["2 lost samples were filled in by straight lines"]);
    }
}
