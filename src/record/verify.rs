//! Checks a run against its hash chain: which rows are as they were written, which are not, which nothing
//! vouches for, and whether the events are those of the end. `runs verify` prints it.

use super::chain::{LINK_ROWS, Link, RowChain};
use super::folder::{Manifest, RunError, RunFolder, io};
use super::samples::{ROW_BYTES, SampleReader, hex};
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;

/// What the hash chain says of a run.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Verdict {
    /// Rows in the file.
    pub rows: u64,
    /// Rows that agree with the chain.
    pub rows_verified: u64,
    /// Rows behind the last link of a run that was not closed: nothing vouches for them.
    pub rows_unlinked: u64,
    /// Rows that differ from what was written, as (first, one past the last).
    pub broken: Vec<(u64, u64)>,
    /// Rows that were written and are not in the file any more.
    pub rows_missing: u64,
    /// Whether `events.jsonl` is as it was at the end; absent when the run was not closed.
    pub events_intact: Option<bool>,
    /// Why reading stopped early.
    pub damage: Option<String>,
    /// All is as it was written.
    pub intact: bool,
}

/// Links of `integrity.txt` by their row; a line cut short is none.
pub(super) fn links(folder: &RunFolder) -> BTreeMap<usize, Link> {
    let text = std::fs::read_to_string(folder.integrity()).unwrap_or_default();
    text.lines().filter_map(|line| line.parse::<Link>().ok()).map(|link| (link.rows, link)).collect()
}

/// Whether `events.jsonl` begins with what it was at the end of the run; what was added later is another's.
fn events_intact(folder: &RunFolder, manifest: &Manifest) -> Result<Option<bool>, RunError> {
    let (Some(bytes), Some(sha256)) = (manifest.events_bytes, &manifest.events_sha256) else {
        return Ok(None);
    };
    let path = folder.events();
    let events = std::fs::read(&path).map_err(io(&path))?;
    let then = usize::try_from(bytes).ok().and_then(|bytes| events.get(..bytes));
    Ok(Some(then.is_some_and(|then| hex(&Sha256::digest(then)) == *sha256)))
}

/// Checks a run.
///
/// # Errors
/// [`RunError`] when there is nothing to check: no `run.toml`, no sample file that opens.
pub fn verify(folder: &RunFolder) -> Result<Verdict, RunError> {
    let manifest = folder.manifest()?;
    let reader = SampleReader::open(&folder.samples())?;
    let links = links(folder);
    let mut verdict = Verdict { rows: reader.rows(), ..Verdict::default() };
    let mut chain = Follower::default();
    let mut start = 0;
    while start < reader.rows() {
        let count = (LINK_ROWS as u64).min(reader.rows() - start);
        let bytes = match reader.read_bytes(start, count) {
            Ok(bytes) => bytes,
            Err(error) => {
                verdict.damage = Some(error.to_string());
                break;
            }
        };
        chain.block(start, &bytes, &links, &mut verdict);
        start += count;
    }
    verdict.rows_unlinked = chain.pending.iter().map(|(first, end)| end - first).sum();
    let written = links.keys().next_back().map_or(0, |rows| *rows as u64);
    let closed = manifest.samples_sha256.is_some();
    verdict.rows_missing =
        written.max(if closed { manifest.samples } else { 0 }).saturating_sub(verdict.rows);
    if let Some(sha256) = &manifest.samples_sha256
        && *sha256 == hex(&chain.before)
        && verdict.broken.is_empty()
    {
        verdict.rows_verified += std::mem::take(&mut verdict.rows_unlinked);
    } else if closed && verdict.rows_unlinked > 0 {
        verdict.broken.append(&mut chain.pending);
        verdict.rows_unlinked = 0;
    }
    verdict.events_intact = events_intact(folder, &manifest)?;
    verdict.intact = verdict.broken.is_empty()
        && verdict.rows_missing == 0
        && verdict.damage.is_none()
        && verdict.rows_verified + verdict.rows_unlinked == verdict.rows
        && manifest.samples_sha256.is_none_or(|sha256| sha256 == hex(&chain.before))
        && verdict.events_intact != Some(false);
    Ok(verdict)
}

/// The chain as it is followed through the file.
#[derive(Default)]
struct Follower {
    before: [u8; 32],
    /// Blocks without a link of their own, which the next link decides about.
    pending: Vec<(u64, u64)>,
}

impl Follower {
    fn block(&mut self, start: u64, bytes: &[u8], links: &BTreeMap<usize, Link>, verdict: &mut Verdict) {
        let end = start + (bytes.len() / ROW_BYTES) as u64;
        let mut found = RowChain::after(start as usize, self.before);
        let mut complete = None;
        found.update(bytes, |link| complete = Some(link));
        let found = complete.unwrap_or_else(|| found.last());
        let Some(written) = links.get(&(end as usize)) else {
            self.pending.push((start, end));
            self.before = bytes_of(&found.chain);
            return;
        };
        let had_pending = !self.pending.is_empty();
        if found.chain == written.chain {
            verdict.rows_verified += self.pending.drain(..).map(|(first, end)| end - first).sum::<u64>();
            verdict.rows_verified += end - start;
        } else {
            // Of blocks without a link and the list itself one differs from what was written.
            verdict.broken.append(&mut self.pending);
            let follows =
                RowChain::chained(self.before, &bytes_of(&written.block)) == bytes_of(&written.chain);
            if found.block == written.block && (follows || had_pending) {
                verdict.rows_verified += end - start;
            } else {
                verdict.broken.push((start, end));
            }
        }
        self.before = bytes_of(&written.chain);
    }
}

/// Bytes of a hexadecimal SHA-256; zeros where it is none, which then agrees with nothing.
fn bytes_of(hex: &str) -> [u8; 32] {
    std::array::from_fn(|i| {
        hex.get(2 * i..2 * i + 2).and_then(|two| u8::from_str_radix(two, 16).ok()).unwrap_or(0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::samples::SampleWriter;
    use crate::stream::{Row, Sample};

    const ROWS: usize = 5 * LINK_ROWS + 100;

    /// A closed run of which block `changed`, if any, is not what the chain says.
    fn run(out: &std::path::Path, changed: Option<usize>) -> RunFolder {
        let folder = RunFolder::create(out, "verify").expect("made");
        let mut manifest = Manifest::new("verify", 2048.0);
        let rows = |changed: Option<usize>| -> Vec<Row> {
            (0..ROWS)
                .map(|k| {
                    let hurt = changed.is_some_and(|block| k == block * LINK_ROWS + 17);
                    let sample =
                        Sample { sequence: k as u64, device_time_us: u64::from(hurt), ..Sample::default() };
                    Row { sample, ..Row::default() }
                })
                .collect()
        };
        let mut chain = String::new();
        let write = |rows: &[Row], chain: &mut String| {
            let mut writer = SampleWriter::create(&folder.samples(), 2048.0).expect("created");
            writer.append(rows, |link| *chain += &format!("{link}\n")).expect("appended");
            writer.close().expect("closed")
        };
        let last = write(&rows(None), &mut chain);
        chain += &format!("{last}\n");
        std::fs::write(folder.integrity(), chain).expect("written");
        if changed.is_some() {
            write(&rows(changed), &mut String::new());
        }
        std::fs::write(folder.events(), "{}\n").expect("written");
        manifest.samples = ROWS as u64;
        manifest.samples_sha256 = Some(last.chain);
        folder.seal_events(&mut manifest).expect("sealed");
        folder.write_manifest(&manifest).expect("written");
        folder
    }

    #[test]
    fn a_changed_row_costs_its_block_and_no_other() {
        for block in 0..6 {
            let out = tempfile::tempdir().expect("folder");
            let verdict = verify(&run(out.path(), Some(block))).expect("checked");
            let (first, end) = (block * LINK_ROWS, ((block + 1) * LINK_ROWS).min(ROWS));
            assert_eq!(verdict.broken, [(first as u64, end as u64)]);
            assert_eq!(verdict.rows_verified, (ROWS - (end - first)) as u64);
            assert!(!verdict.intact);
        }
    }

    #[test]
    fn links_that_are_missing_or_changed_are_told() {
        let out = tempfile::tempdir().expect("folder");
        let folder = run(out.path(), None);
        assert!(verify(&folder).expect("checked").intact);
        let chain = std::fs::read_to_string(folder.integrity()).expect("chain");
        let lines: Vec<&str> = chain.lines().collect();
        let with = |lines: &[&str]| {
            std::fs::write(folder.integrity(), lines.join("\n")).expect("written");
            verify(&folder).expect("checked")
        };
        // The chain of the next link vouches for a block whose own link is lost.
        assert!(with(&[&lines[..2], &lines[3..]].concat()).intact);
        // Of a run that was closed the manifest vouches for the end.
        assert!(with(&lines[..3]).intact);
        let mut manifest = folder.manifest().expect("manifest");
        manifest.samples_sha256 = None;
        folder.write_manifest(&manifest).expect("written");
        let verdict = with(&lines[..3]);
        let unlinked = (ROWS - 3 * LINK_ROWS) as u64;
        assert_eq!((verdict.rows_verified, verdict.rows_unlinked), (ROWS as u64 - unlinked, unlinked));
        // A list in which one chain hash is another's.
        let (rows_and_block, _) = lines[1].rsplit_once(' ').expect("words");
        let (_, other) = lines[4].rsplit_once(' ').expect("words");
        let forged = format!("{rows_and_block} {other}");
        assert!(!with(&[lines[0], &forged, lines[2], lines[3], lines[4], lines[5]]).intact);
        std::fs::write(folder.events(), "{ }\n").expect("written");
        assert_eq!(verify(&folder).expect("checked").events_intact, Some(false));
    }
}
