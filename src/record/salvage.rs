//! Rows of a sample file that no HDF5 reader opens any more: cut short, or with blocks that never reached
//! the disk. A row is known by itself, its time being its number over the rate; the file is searched for
//! runs of them, whatever its index says. Called by `recover` and by whoever reads a damaged run.

use super::folder::{RunError, RunFolder, io};
use super::samples::{ROW_BYTES, SampleFileError, SampleReader, chunk_rows, decode};
use crate::stream::Row;
use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::Path;

/// Rows that are read together.
const BLOCK_ROWS: u64 = 8192;
/// Bytes of the window that moves over the file.
const WINDOW: usize = 1 << 22;
/// Numbers above this are none: 17 years at 2048 Hz.
const MOST_SEQUENCE: u64 = 1 << 40;

/// Rows of a run as far as they can be had, in order, and what is wrong with the file if anything is.
///
/// # Errors
/// [`RunError`] when there is no file or it is none of this program's.
pub fn readable_rows(folder: &RunFolder) -> Result<(Vec<Row>, Option<String>), RunError> {
    let path = folder.samples();
    // The rate is told by the manifest too, which outlives a damaged sample file.
    let known_rate = folder.manifest().ok().map(|manifest| manifest.sample_rate_hz);
    let mut rows = Vec::new();
    let read = guarded(&path, || in_order(&path, &mut |row| rows.push(row)));
    let (rows, rate, damage) = match read.map(|(rate, damage)| (rows, rate, damage)) {
        Ok((rows, rate, None)) => {
            let missing = expected_rows(folder).saturating_sub(rows.len());
            if missing == 0 {
                return Ok((rows, None));
            }
            (rows, Some(rate), format!("{missing} rows less than were written"))
        }
        Ok((rows, rate, Some(damage))) => (rows, Some(rate), damage),
        Err(error @ SampleFileError::Layout { .. }) => return Err(error.into()),
        Err(error) => (Vec::new(), None, error.to_string()),
    };
    let Some(rate) = known_rate.or(rate) else { return Ok((rows, Some(damage))) };
    let found = scan(&path, rate)?;
    if found.len() <= rows.len() {
        return Ok((rows, Some(damage)));
    }
    let damage = format!("{damage}; {} rows were found by searching the file", found.len());
    Ok((found, Some(damage)))
}

/// Hands each row of an undamaged, complete sample file on, in order, without keeping them; `false` when
/// the file is damaged or rows are missing, and nothing of what was handed on may be used.
pub fn visit_sound(folder: &RunFolder, visit: &mut dyn FnMut(Row)) -> bool {
    let path = folder.samples();
    let mut count = 0;
    let read = guarded(&path, || {
        in_order(&path, &mut |row| {
            count += 1;
            visit(row);
        })
    });
    matches!(read, Ok((_, None))) && count >= expected_rows(folder)
}

/// Rows that the hash chain vouches for having been written.
fn expected_rows(folder: &RunFolder) -> usize {
    super::verify::links(folder).last_key_value().map_or(0, |(rows, _)| *rows)
}

/// A decoder fed with a damaged file must not take the process down.
fn guarded<T>(path: &Path, read: impl FnOnce() -> Result<T, SampleFileError>) -> Result<T, SampleFileError> {
    // Every row that was handed on before a panic is whole.
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(read))
        .unwrap_or_else(|_| Err(SampleFileError::Damaged { path: path.to_owned() }))
}

/// Rows as the file's index has them, up to the first that is none: the rate, and what is wrong there. The
/// row before one that is none may be torn, its head written and its tail not, and goes as well.
fn in_order(path: &Path, sink: &mut dyn FnMut(Row)) -> Result<(f64, Option<String>), SampleFileError> {
    let reader = SampleReader::open(path)?;
    let rate = reader.sample_rate_hz();
    let (mut start, mut rows, mut last, mut held) = (0, 0u64, None, None);
    while start < reader.rows() {
        let count = BLOCK_ROWS.min(reader.rows() - start);
        let bytes = match reader.read_bytes(start, count) {
            Ok(bytes) => bytes,
            // Chunks are read whole: the row before is complete.
            Err(error) => {
                held.into_iter().for_each(sink);
                return Ok((rate, Some(error.to_string())));
            }
        };
        for row in bytes.chunks_exact(ROW_BYTES) {
            // Zeroed blocks and the like; a repeated number is the DAQ's own and stays.
            let here = number(row, rate);
            if here.is_none_or(|n| last.is_some_and(|last| n == 0 || n + MOST_BACK <= last)) {
                return Ok((rate, Some(format!("row {rows} is damaged"))));
            }
            if let Some(before) = held.replace(decode(row)) {
                sink(before);
            }
            (last, rows) = (here, rows + 1);
        }
        start += count;
    }
    if let Some(row) = held {
        sink(row);
    }
    Ok((rate, None))
}

/// How far a DAQ may number backwards and still be believed, samples.
const MOST_BACK: u64 = 1 << 16;

/// Number of the row that starts here, if one does: its time is its number over the rate, bit by bit.
fn number(bytes: &[u8], rate: f64) -> Option<u64> {
    let time = f64::from_le_bytes(*bytes.first_chunk()?);
    let number = u64::from_le_bytes(*bytes.get(8..)?.first_chunk()?);
    let is_row = number < MOST_SEQUENCE && (number as f64 / rate).to_bits() == time.to_bits();
    (is_row && bytes.len() >= ROW_BYTES).then_some(number)
}

/// All rows found anywhere in a file, by rising number, each once.
///
/// # Errors
/// [`RunError::Io`] when the file cannot be read.
pub fn scan(path: &Path, rate: f64) -> Result<Vec<Row>, RunError> {
    let mut file = File::open(path).map_err(io(path))?;
    let mut window = Vec::with_capacity(WINDOW + 4 * ROW_BYTES);
    let mut rows: Vec<Row> = Vec::new();
    let mut run = Run { first: 0, last: None };
    loop {
        let kept = window.len();
        let ended = fill(&mut file, &mut window).map_err(io(path))? == 0;
        let mut at = 0;
        // Two rows are looked at together; the rest waits for the next window.
        while at + 2 * ROW_BYTES <= window.len() || (ended && at + ROW_BYTES <= window.len()) {
            at += run.look(&window[at..], rate, &mut rows);
        }
        if ended || window.len() == kept && at == 0 {
            run.close(rate, false, &mut rows);
            break;
        }
        window.drain(..at);
    }
    rows.sort_by_key(|row| row.sample.sequence);
    rows.dedup_by_key(|row| row.sample.sequence);
    Ok(rows)
}

/// Reads until the window is full or the file ends.
fn fill(file: &mut File, window: &mut Vec<u8>) -> std::io::Result<usize> {
    let room = WINDOW.saturating_sub(window.len()) as u64;
    loop {
        match file.take(room).read_to_end(window) {
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            outcome => return outcome,
        }
    }
}

/// Rows that follow one another without a break.
struct Run {
    first: usize,
    last: Option<u64>,
}

impl Run {
    /// Looks at one place of the file; returns how far to move.
    fn look(&mut self, bytes: &[u8], rate: f64, rows: &mut Vec<Row>) -> usize {
        let here = number(bytes, rate);
        let follows = match (self.last, here) {
            (Some(last), Some(here)) => here > last,
            // A run starts with two rows: one alone may be chance.
            (None, Some(here)) => {
                let next = bytes.get(ROW_BYTES..).and_then(|next| number(next, rate));
                // Zeros look like the row of number 0.
                next.is_some_and(|next| next > here && (here > 0 || next == 1))
            }
            _ => false,
        };
        if follows {
            rows.push(decode(bytes));
            self.last = here;
            return ROW_BYTES;
        }
        if self.last.is_some() {
            let zeros = bytes.iter().take(16).all(|byte| *byte == 0);
            self.close(rate, zeros, rows);
            return 0;
        }
        1
    }

    /// Ends a run. The last row of one that does not end with its chunk, or that ends in zeros, may be
    /// torn, and goes.
    fn close(&mut self, rate: f64, zeros_follow: bool, rows: &mut Vec<Row>) {
        let whole = (rows.len() - self.first).is_multiple_of(chunk_rows(rate)) && !zeros_follow;
        if self.last.take().is_some() && !whole {
            rows.pop();
        }
        self.first = rows.len();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Manifest;
    use crate::record::samples::SampleWriter;
    use crate::stream::Sample;

    const ROWS: u64 = 9 * 512;

    fn row(sequence: u64) -> Row {
        let mut sample = Sample { sequence, device_time_us: 488 * sequence, ..Sample::default() };
        sample.channels.relative_displacement_m = (sequence as f64).sin();
        Row { sample, step: 2, ..Row::default() }
    }

    fn folder(out: &Path) -> RunFolder {
        let folder = RunFolder::create(out, "salvage").expect("made");
        folder.write_manifest(&Manifest::new("salvage", 2048.0)).expect("written");
        let mut writer = SampleWriter::create(&folder.samples(), 2048.0).expect("created");
        let rows: Vec<Row> = (0..ROWS).map(|k| row(k + 7)).collect();
        for block in rows.chunks(512) {
            writer.append(block, |_| {}).expect("appended");
        }
        writer.close().expect("closed");
        folder
    }

    #[test]
    fn a_file_cut_short_gives_every_row_that_is_left_of_it() {
        let out = tempfile::tempdir().expect("folder");
        let folder = folder(out.path());
        let whole = std::fs::read(folder.samples()).expect("bytes");
        for share in [0.97, 0.8, 0.5, 0.21, 0.0] {
            let cut = (whole.len() as f64 * share) as usize;
            std::fs::write(folder.samples(), &whole[..cut]).expect("written");
            let (rows, damage) = readable_rows(&folder).expect("read");
            assert!(damage.is_some());
            assert!(rows.iter().enumerate().all(|(k, found)| *found == row(k as u64 + 7)), "{share}");
            // All but a torn row, and what stands between the chunks: headers and index, 12 KiB at most.
            let least = (cut / ROW_BYTES).saturating_sub(2 + (12 << 10) / ROW_BYTES);
            assert!(rows.len() >= least, "{share}: {} rows of {least}", rows.len());
        }
    }

    #[test]
    fn blocks_that_never_reached_the_disk_cost_their_own_rows_only() {
        let out = tempfile::tempdir().expect("folder");
        let folder = folder(out.path());
        let whole = std::fs::read(folder.samples()).expect("bytes");
        for block in 0..whole.len() / 4096 {
            let mut hurt = whole.clone();
            hurt[4096 * block..4096 * (block + 1)].fill(0);
            std::fs::write(folder.samples(), &hurt).expect("written");
            let (rows, _) = readable_rows(&folder).expect("read");
            assert!(rows.iter().all(|found| *found == row(found.sample.sequence)), "block {block}");
            let lost = ROWS as usize - rows.len();
            assert!(lost <= 4096 / ROW_BYTES + 3, "block {block}: {lost} rows lost");
        }
    }

    #[test]
    fn a_row_that_is_torn_before_zeros_is_none() {
        let out = tempfile::tempdir().expect("folder");
        let folder = folder(out.path());
        let whole = std::fs::read(folder.samples()).expect("bytes");
        // Everything from the middle of a row to the end, at every place within it that is not its head.
        let wanted = row(ROWS - 40);
        let head = wanted.sample.sequence.to_le_bytes();
        let at = whole.windows(8).rposition(|bytes| bytes == head).expect("there") - 8;
        for inside in [17, 24, 48, 80, ROW_BYTES - 1] {
            let mut hurt = whole.clone();
            hurt[at + inside..].fill(0);
            std::fs::write(folder.samples(), &hurt).expect("written");
            let (rows, damage) = readable_rows(&folder).expect("read");
            assert!(damage.is_some() && !rows.is_empty());
            assert!(rows.iter().all(|found| *found == row(found.sample.sequence)), "{inside} bytes of a row");
        }
    }
}
