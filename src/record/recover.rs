//! What can be made of a run whose process died: its rows are read as far as they go, played through the
//! signal chain again, and the folder is closed as interrupted, with step results and losses.

use super::chain::{LINK_ROWS, Link, RowChain};
use super::folder::{LossReport, Manifest, RunError, RunFolder, RunState, io};
use super::salvage::readable_rows;
use super::samples::{ROW_BYTES, SampleWriter, chunk_rows, encode};
use super::steps_csv;
use super::verify::links;
use crate::control::clock::Clock as _;
use crate::control::setup::{Setup, SetupError};
use crate::control::{Controller, Event, Nrmse, Parts, Request, StepSummary, VirtualClock};
use crate::stream::{Row, split};
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Why a run could not be recovered or played back.
#[derive(Debug, thiserror::Error)]
pub enum RecoverError {
    /// The folder or its files.
    #[error(transparent)]
    Run(#[from] RunError),
    /// What the run was made of.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// Its process is still at work.
    #[error("{0} is still being written")]
    Running(String),
}

/// Plays samples through filters, onboard model and statistics without recording them again.
///
/// # Errors
/// [`SetupError`] when the run's own configuration is refused.
pub fn replay_steps(setup: &Setup, rows: &[Row]) -> Result<(Vec<StepSummary>, Nrmse), SetupError> {
    let samples = rows.iter().map(|row| row.sample).collect();
    let plan = setup.replay_plan(samples, setup.recorded_command(rows)?, std::path::Path::new("."))?;
    let (end, mut recorder, _view, _operator) = split::<Event, Request>(plan.depths);
    let rate = setup.rig.sample_rate_hz;
    let mut controller = Controller::new(Parts {
        rig: plan.rig,
        generator: plan.generator,
        model: plan.model,
        guard: plan.guard,
        end,
        sample_rate_hz: rate,
    });
    let (mut clock, mut rows) = (VirtualClock, Vec::with_capacity(4096));
    let (mut steps, mut error) = (Vec::new(), Nrmse::default());
    loop {
        let ending = controller.step(clock.tick());
        rows.clear();
        recorder.take_rows(&mut rows);
        while let Some(event) = recorder.take_event() {
            match event {
                Event::Step(step) => steps.push(step),
                Event::End { error: whole, .. } => error = whole,
                _ => {}
            }
        }
        if ending.is_some() {
            return Ok((steps, error));
        }
    }
}

/// What was recovered.
#[derive(Debug)]
pub struct Recovered {
    /// `run.toml` as it now stands.
    pub manifest: Manifest,
    /// Results of the steps that were finished.
    pub steps: Vec<StepSummary>,
    /// Onboard model against measurement.
    pub error: Nrmse,
    /// What is wrong with the sample file, if anything.
    pub damage: Option<String>,
    /// Rows that differ from their hashes.
    pub differing: u64,
}

/// Closes the folder of an interrupted run; a run that was closed properly keeps its state. A damaged
/// sample file is kept under another name, and what could be had of it takes its place.
///
/// # Errors
/// [`RecoverError`] when the run goes on, or its folder cannot be read or written.
pub fn recover(folder: &RunFolder) -> Result<Recovered, RecoverError> {
    let mut manifest = folder.manifest()?;
    let state = folder.state(&manifest);
    if state == RunState::Running {
        return Err(RecoverError::Running(folder.path().display().to_string()));
    }
    for reserve in folder.reserves() {
        // Mostly there is none.
        let _ = std::fs::remove_file(reserve);
    }
    let (rows, damage) = readable_rows(folder)?;
    let rate = manifest.sample_rate_hz;
    let differing = differing_rows(&rows, rate, &links(folder));
    let chain = match &damage {
        Some(_) => rebuild(folder, &rows, rate)?,
        None => close_chain(folder, &rows, rate)?,
    };
    let cut = trim_events(folder)?;
    let setup = Setup::of_run(&manifest)?;
    let (steps, error) = replay_steps(&setup, &rows)?;
    let mut table = format!(
        "{}
",
        steps_csv::head()
    );
    for step in &steps {
        // Writing to a String cannot fail.
        let _ = writeln!(table, "{}", steps_csv::line(step));
    }
    std::fs::write(folder.steps(), table).map_err(io(&folder.steps()))?;
    let said = [
        damage.clone(),
        (differing > 0).then(|| format!("{differing} rows differ from their hashes")),
        cut.then(|| "the last line of events.jsonl was cut short".to_owned()),
    ];
    let said: Vec<String> = said.into_iter().flatten().collect();
    manifest.state = state;
    manifest.clean = manifest.clean && state != RunState::Interrupted && damage.is_none() && differing == 0;
    manifest.samples = rows.len() as u64;
    manifest.lost = losses(&rows, manifest.lost);
    manifest.samples_sha256 = Some(chain);
    if !said.is_empty() {
        manifest.recovered = Some(said.join("; "));
    }
    if state == RunState::Interrupted {
        manifest.cause.get_or_insert_with(|| "the process ended before the run did".to_owned());
    }
    folder.seal_events(&mut manifest)?;
    folder.write_manifest(&manifest)?;
    Ok(Recovered { manifest, steps, error, damage, differing })
}

/// The chain over rows: calls `link` with each link, and returns the last.
fn chain_of(rows: &[Row], sample_rate_hz: f64, mut link: impl FnMut(Link)) -> Link {
    let mut chain = RowChain::default();
    let mut bytes = Vec::with_capacity(ROW_BYTES * LINK_ROWS);
    for block in rows.chunks(LINK_ROWS) {
        bytes.clear();
        for row in block {
            encode(row, sample_rate_hz, &mut bytes);
        }
        chain.update(&bytes, &mut link);
    }
    chain.last()
}

/// Rows in blocks that differ from what was written. Rows that are missing shift those behind them, so each
/// stretch of blocks is looked for where its numbers say it was.
fn differing_rows(rows: &[Row], sample_rate_hz: f64, written: &BTreeMap<usize, Link>) -> u64 {
    let first = rows.first().map_or(0, |row| row.sample.sequence);
    let mut differing = 0;
    for (end, link) in written {
        let start = end.saturating_sub(1) / LINK_ROWS * LINK_ROWS;
        let from = rows.partition_point(|row| row.sample.sequence < first + start as u64);
        let Some(block) = rows.get(from..from + (end - start)) else { continue };
        // Only a block that is all there can be told.
        let there = block[block.len() - 1].sample.sequence + 1 == first + *end as u64;
        let mut found = None;
        let last = chain_of(block, sample_rate_hz, |link| found = Some(link));
        if there && found.unwrap_or(last).block != link.block {
            differing += block.len() as u64;
        }
    }
    differing
}

/// Writes the links that the process did not come to, behind those that are there.
fn close_chain(folder: &RunFolder, rows: &[Row], sample_rate_hz: f64) -> Result<String, RunError> {
    let known = links(folder);
    let mut missing = String::new();
    let mut add = |link: &Link| {
        if !known.contains_key(&link.rows) {
            missing += &format!("{link}\n");
        }
    };
    let last = chain_of(rows, sample_rate_hz, |link| add(&link));
    if !last.rows.is_multiple_of(LINK_ROWS) {
        add(&last);
    }
    let path = folder.integrity();
    let kept: String = known.values().map(|link| format!("{link}\n")).collect();
    std::fs::write(&path, kept + &missing).map_err(io(&path))?;
    Ok(last.chain)
}

/// Puts a new sample file in the place of a damaged one, which is kept as `samples.damaged.h5` beside its
/// chain, and returns the new chain.
fn rebuild(folder: &RunFolder, rows: &[Row], sample_rate_hz: f64) -> Result<String, RunError> {
    let new = folder.path().join(".samples.new.h5");
    let mut chain = String::new();
    let mut writer = SampleWriter::create(&new, sample_rate_hz)?;
    for block in rows.chunks(chunk_rows(sample_rate_hz)) {
        writer.append(block, |link| chain += &format!("{link}\n"))?;
    }
    let last = writer.close()?;
    if !last.rows.is_multiple_of(LINK_ROWS) {
        chain += &format!("{last}\n");
    }
    for (path, kept) in
        [(folder.samples(), "samples.damaged.h5"), (folder.integrity(), "integrity.damaged.txt")]
    {
        let kept = folder.path().join(kept);
        // What an earlier recovery kept is the original.
        if path.exists() && !kept.exists() {
            std::fs::rename(&path, &kept).map_err(io(&kept))?;
        }
    }
    std::fs::write(folder.integrity(), chain).map_err(io(&folder.integrity()))?;
    std::fs::rename(&new, folder.samples()).map_err(io(&new))?;
    Ok(last.chain)
}

/// Cuts a last line that was not written to its end, and says whether there was one.
fn trim_events(folder: &RunFolder) -> Result<bool, RunError> {
    let path = folder.events();
    let mut events = match std::fs::read(&path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Vec::new(),
        read => read.map_err(io(&path))?,
    };
    let (length, mut kept) = (events.len(), 0);
    for line in events.split_inclusive(|byte| *byte == b'\n') {
        let whole = line.ends_with(b"\n") && serde_json::from_slice::<serde::de::IgnoredAny>(line).is_ok();
        if !whole {
            break;
        }
        kept += line.len();
    }
    events.truncate(kept);
    if kept < length || length == 0 {
        std::fs::write(&path, &events).map_err(io(&path))?;
    }
    Ok(kept < length)
}

/// Losses that the numbers of the rows tell.
fn losses(rows: &[Row], known: LossReport) -> LossReport {
    let mut lost = LossReport { live: known.live, events: known.events, ..LossReport::default() };
    for pair in rows.windows(2) {
        let missing = pair[1].sample.sequence.saturating_sub(pair[0].sample.sequence + 1);
        let ring = u64::from(pair[1].lost_before).min(missing);
        lost.samples += missing;
        lost.ring += ring;
        lost.daq += missing - ring;
    }
    lost
}
