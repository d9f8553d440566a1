//! What can be made of a run whose process died: its rows are read as far as they go, played through the
//! signal chain again, and the folder is closed as interrupted, with step results and losses.

use super::folder::{LossReport, Manifest, RunError, RunFolder, RunState, io};
use super::recorder::{STEPS_HEAD, steps_line};
use super::samples::{ROW_BYTES, RowHash, SampleReader};
use crate::control::clock::Clock as _;
use crate::control::setup::{Setup, SetupError};
use crate::control::{Controller, Event, Nrmse, Parts, Request, StepSummary, VirtualClock};
use crate::stream::{Row, Sample, split};
use std::fmt::Write as _;

/// Rows that are read together.
const BLOCK_ROWS: u64 = 8192;

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

/// Rows of a run as far as they can be read, and what stopped the reading early.
///
/// # Errors
/// [`RunError`] when the file cannot be opened at all.
pub fn readable_rows(folder: &RunFolder) -> Result<(Vec<Row>, Option<String>), RunError> {
    let reader = SampleReader::open(&folder.samples())?;
    let mut rows = Vec::with_capacity(usize::try_from(reader.rows()).unwrap_or(0).min(1 << 24));
    let mut start = 0;
    while start < reader.rows() {
        let count = BLOCK_ROWS.min(reader.rows() - start);
        match reader.read(start, count) {
            Ok(block) => rows.extend(block),
            Err(error) => return Ok((rows, Some(error.to_string()))),
        }
        start += count;
    }
    Ok((rows, None))
}

/// Plays samples through filters, onboard model and statistics without recording them again.
///
/// # Errors
/// [`SetupError`] when the run's own configuration is refused.
pub fn replay_steps(setup: &Setup, samples: Vec<Sample>) -> Result<(Vec<StepSummary>, Nrmse), SetupError> {
    let plan = setup.replay_plan(samples, std::path::Path::new("."))?;
    let (end, mut recorder, _view, _operator) = split::<Event, Request>(plan.depths);
    let rate = setup.rig.sample_rate_hz;
    let mut controller = Controller::new(Parts {
        rig: plan.rig,
        generator: plan.generator,
        model: plan.model,
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
    /// What stopped the reading early, if anything.
    pub damage: Option<String>,
}

/// Closes the folder of an interrupted run; a run that was closed properly keeps its state.
///
/// # Errors
/// [`RecoverError`] when the run goes on, or its folder cannot be read or written.
pub fn recover(folder: &RunFolder) -> Result<Recovered, RecoverError> {
    let mut manifest = folder.manifest()?;
    let state = folder.state(&manifest);
    if state == RunState::Running {
        return Err(RecoverError::Running(folder.path().display().to_string()));
    }
    let (rows, damage) = readable_rows(folder)?;
    let setup = Setup::of_run(&manifest)?;
    let (steps, error) = replay_steps(&setup, rows.iter().map(|row| row.sample).collect())?;
    let mut table = format!("{STEPS_HEAD}\n");
    for step in &steps {
        // Writing to a String cannot fail.
        let _ = writeln!(table, "{}", steps_line(step));
    }
    std::fs::write(folder.steps(), table).map_err(io(&folder.steps()))?;
    manifest.state = state;
    manifest.clean = manifest.clean && state != RunState::Interrupted && damage.is_none();
    manifest.samples = rows.len() as u64;
    manifest.lost = losses(&rows, manifest.lost);
    manifest.samples_sha256 = Some(hash(&rows, manifest.sample_rate_hz));
    if state == RunState::Interrupted {
        manifest.cause.get_or_insert_with(|| "the process ended before the run did".to_owned());
    }
    folder.write_manifest(&manifest)?;
    Ok(Recovered { manifest, steps, error, damage })
}

fn hash(rows: &[Row], sample_rate_hz: f64) -> String {
    let mut hash = RowHash::default();
    let mut bytes = Vec::with_capacity(ROW_BYTES * 1024);
    for block in rows.chunks(1024) {
        bytes.clear();
        for row in block {
            super::samples::encode(row, sample_rate_hz, &mut bytes);
        }
        hash.update(&bytes, |_, _| {});
    }
    hash.hex()
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

/// Checks a run's hash chain. Returns the number of rows that agree with it, and the number there are.
///
/// # Errors
/// [`RunError`] when the files cannot be read.
pub fn verify(folder: &RunFolder) -> Result<(u64, u64), RunError> {
    let reader = SampleReader::open(&folder.samples())?;
    let path = folder.integrity();
    let chain = std::fs::read_to_string(&path).map_err(io(&path))?;
    let links: std::collections::HashMap<usize, &str> = chain
        .lines()
        .filter_map(|line| line.split_once(' '))
        .filter_map(|(rows, hash)| Some((rows.parse().ok()?, hash)))
        .collect();
    let (mut hash, mut good, mut broken, mut start) = (RowHash::default(), 0u64, false, 0);
    while start < reader.rows() && !broken {
        let count = BLOCK_ROWS.min(reader.rows() - start);
        let Ok(bytes) = reader.read_bytes(start, count) else { break };
        hash.update(&bytes, |rows, hash| {
            let agrees = links.get(&rows).is_none_or(|expected| *expected == hash);
            broken |= !agrees;
            if !broken {
                good = rows as u64;
            }
        });
        start += count;
    }
    let whole = folder.manifest()?.samples_sha256;
    if !broken && start == reader.rows() && whole.is_none_or(|whole| whole == hash.hex()) {
        good = reader.rows();
    }
    Ok((good, reader.rows()))
}
