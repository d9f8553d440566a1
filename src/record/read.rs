//! A run folder as a [`Record`], the form in which comparison, identification and diagnosis read.

use super::data::{Kind, Record};
use super::folder::{RunError, RunFolder};
use super::salvage::readable_rows;
use std::path::Path;

/// Reads the samples of a run, finished or interrupted. Samples that were lost are filled in by
/// straight lines, belong to no step, and are named in the notes.
///
/// # Errors
/// [`RunError`] when the folder is none or its samples cannot be opened.
pub fn read_run(path: &Path) -> Result<Record, RunError> {
    let folder = RunFolder::open(path)?;
    let manifest = folder.manifest()?;
    let (rows, damage) = readable_rows(&folder)?;
    let first = rows.first().map_or(0, |row| row.sample.sequence);
    let mut record = Record {
        source: path.display().to_string(),
        kind: Kind::Base,
        sample_rate_hz: manifest.sample_rate_hz,
        time_s: Vec::with_capacity(rows.len()),
        table_displacement_m: Vec::with_capacity(rows.len()),
        table_acceleration_m_s2: Vec::with_capacity(rows.len()),
        mass_acceleration_1_m_s2: Vec::with_capacity(rows.len()),
        mass_acceleration_2_m_s2: Vec::with_capacity(rows.len()),
        relative_displacement_m: Vec::with_capacity(rows.len()),
        force_n: Vec::new(),
        displacement_m: Vec::new(),
        acceleration_m_s2: Vec::new(),
        step: Vec::with_capacity(rows.len()),
        notes: damage.into_iter().map(|damage| format!("reading stopped early: {damage}")).collect(),
    };
    let mut last: Option<(u64, [f64; 5])> = None;
    let mut filled = 0u64;
    for row in &rows {
        let (sequence, c) = (row.sample.sequence, &row.sample.channels);
        let values = [
            c.table_displacement_m,
            c.table_acceleration_m_s2,
            c.mass_acceleration_1_m_s2,
            c.mass_acceleration_2_m_s2,
            c.relative_displacement_m,
        ];
        if let Some((before, old)) = last {
            // A repeated or backward number is the DAQ's fault and has no place on a uniform grid.
            if sequence <= before {
                record.notes.push(format!("sample {sequence} came again and was left out"));
                continue;
            }
            for missing in before + 1..sequence {
                let share = (missing - before) as f64 / (sequence - before) as f64;
                let between: [f64; 5] = std::array::from_fn(|i| old[i] + share * (values[i] - old[i]));
                push(&mut record, missing - first, &between, -1);
                filled += 1;
            }
        }
        push(&mut record, sequence - first, &values, row.step);
        last = Some((sequence, values));
    }
    if filled > 0 {
        record.notes.push(format!("{filled} lost samples were filled in by straight lines"));
    }
    Ok(record)
}

fn push(record: &mut Record, index: u64, values: &[f64; 5], step: i32) {
    record.time_s.push(index as f64 / record.sample_rate_hz);
    record.table_displacement_m.push(values[0]);
    record.table_acceleration_m_s2.push(values[1]);
    record.mass_acceleration_1_m_s2.push(values[2]);
    record.mass_acceleration_2_m_s2.push(values[3]);
    record.relative_displacement_m.push(values[4]);
    record.step.push(step);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Manifest;
    use crate::record::samples::SampleWriter;
    use crate::stream::{Row, Sample};

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
