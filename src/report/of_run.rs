//! Fills the report of a run from its folder; `run`, `replay` and `recover` call it when a run is over.

use super::run::{Peaks, RunReport, StepPoint, measured, modelled, passes_resonance, peaks, peaks_table};
use super::{ReportError, RunSeries, Table};
use crate::config::Case;
use crate::config::published::peaks_of;
use crate::control::setup::{Setup, SetupError};
use crate::control::{Chain, StepDirection, StepSummary, TimingReport};
use crate::model::{build, paper};
use crate::record::samples::SampleReader;
use crate::record::{Manifest, RunError, RunFolder};
use crate::stream::Channels;
use crate::sweep::{Direction, Generator, Schedule};
use std::path::PathBuf;

/// Rows that are read together.
const BLOCK_ROWS: u64 = 8192;

/// Why a report could not be written.
#[derive(Debug, thiserror::Error)]
pub enum RunReportError {
    /// The run folder.
    #[error(transparent)]
    Run(#[from] RunError),
    /// What the run was made of.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// A figure or the page.
    #[error(transparent)]
    Report(#[from] ReportError),
}

impl From<&StepSummary> for StepPoint {
    fn from(step: &StepSummary) -> Self {
        Self {
            index: step.index,
            direction: match step.direction {
                StepDirection::Forward => Direction::Forward,
                StepDirection::Backward => Direction::Backward,
            },
            frequency_hz: step.frequency_hz,
            a_max_m_s2: step.a_max_m_s2,
            excursion_m: step.excursion_m,
            model_a_max_m_s2: step.model_a_max_m_s2,
            model_excursion_m: step.model_excursion_m,
            nrmse_a: step.nrmse_a,
            nrmse_d: step.nrmse_d,
            table_amplitude_ratio: step.table_amplitude_ratio,
        }
    }
}

/// The published model of a case on a table that follows its command exactly, through the same filters.
///
/// # Errors
/// [`SetupError`] when the sweep or the model is refused.
pub fn published_model(setup: &Setup, case: &Case) -> Result<Vec<StepSummary>, SetupError> {
    let rate = setup.rig.sample_rate_hz;
    let schedule: Schedule = setup.schedule()?;
    let mut model = build(&paper::of_case(case), 1.0 / rate)
        .map_err(|source| SetupError::Model { role: "published model", source })?;
    let (mut generator, mut chain) = (Generator::new(&schedule, rate), Chain::new(rate, &schedule));
    let mut steps = Vec::with_capacity(schedule.steps().len());
    while !generator.is_done() {
        let point = generator.next_point();
        let response = model.step(point.command.acceleration_m_s2);
        let measured = chain.condition(&Channels {
            table_acceleration_m_s2: point.command.acceleration_m_s2,
            mass_acceleration_1_m_s2: response.mass_acceleration_m_s2,
            mass_acceleration_2_m_s2: response.mass_acceleration_m_s2,
            relative_displacement_m: response.relative_displacement_m,
            ..Channels::default()
        });
        steps.extend(chain.compare(&point, &measured, &response));
        if let Some(index) = chain.settled(&point) {
            generator.settled(index);
        }
    }
    Ok(steps)
}

/// Number of steps of a whole sweep; 0 of one that is refused.
fn planned_steps(setup: &Setup) -> usize {
    setup.schedule().map_or(0, |schedule| schedule.steps().len())
}

/// The final table of a run, and the published peaks that are drawn beside it; the published model is laid beside a run that was
/// stopped in the steps that were run.
pub fn final_table(setup: &Setup, steps: &[StepSummary]) -> (Table, Vec<(String, Peaks)>) {
    let points: Vec<StepPoint> = steps.iter().map(StepPoint::from).collect();
    let mut published = Vec::new();
    let mut model = None;
    if let Some(case) = &setup.case {
        // A sweep that could be run can also be simulated; without it the row stays empty.
        model = published_model(setup, case).ok().and_then(|all| {
            let run = |step: &&StepSummary| steps.iter().any(|other| other.index == step.index);
            let points: Vec<StepPoint> = all.iter().filter(run).map(StepPoint::from).collect();
            peaks(&points, measured)
        });
        if let Some(row) = peaks_of(case) {
            let row =
                Peaks { frequency_hz: row.nu_r, a_max_m_s2: row.a_max_m_s2, excursion_m: row.excursion_m };
            published.push(("paper, Table 2".to_owned(), row));
        }
    }
    let mut rows = vec![
        ("measured on this table", peaks(&points, measured)),
        ("onboard model", peaks(&points, modelled)),
    ];
    if setup.case.is_some() {
        rows.push(("published model, ideal table", model));
        rows.push(("paper, Table 2", published.first().map(|(_, row)| *row)));
    }
    (peaks_table(passes_resonance(&points, planned_steps(setup)), rows), published)
}

fn timing_table(timing: &TimingReport) -> Table {
    let mut table = Table::new(["time (us)", "p50", "p99", "p99.9", "largest"]);
    let mut line = |name: &str, p: &crate::control::Percentiles| {
        let cells = [p.p50_us, p.p99_us, p.p999_us, p.max_us].map(|value| format!("{value:.2}"));
        table.push([name.to_owned()].into_iter().chain(cells));
    };
    line("wake-up latency", &timing.wake_up_latency);
    line("period error", &timing.period_error);
    for phase in &timing.phases {
        line(phase.phase.name(), &phase.times);
    }
    line("whole step", &timing.step);
    table
}

fn loss_table(manifest: &Manifest) -> Table {
    let lost = &manifest.lost;
    let rows = [
        ("samples recorded", manifest.samples),
        ("samples lost", lost.samples),
        ("of these dropped by the recorder's ring", lost.ring),
        ("of these never delivered by the DAQ", lost.daq),
        ("events lost", lost.events),
        ("slips of the control thread", manifest.timing.as_ref().map_or(0, |timing| timing.slips)),
    ];
    rows.into_iter().fold(Table::new(["account", "count"]), |table, (name, count)| {
        table.row([name.to_owned(), count.to_string()])
    })
}

fn series(folder: &RunFolder) -> Result<RunSeries, RunError> {
    let reader = SampleReader::open(&folder.samples())?;
    let mut series = RunSeries::new(reader.sample_rate_hz());
    let mut start = 0;
    while start < reader.rows() {
        let count = BLOCK_ROWS.min(reader.rows() - start);
        // A damaged end leaves the figures with what there is before it.
        let Ok(rows) = reader.read(start, count) else { break };
        rows.iter().for_each(|row| series.push(row));
        start += count;
    }
    Ok(series)
}

/// What the reader must not miss; `run` steps of a sweep of `planned` ones were run.
fn notes(manifest: &Manifest, run: usize, planned: usize) -> Vec<String> {
    let mut notes = Vec::new();
    if run < planned {
        notes.push(format!("{run} of {planned} steps were run; the largest values are those of these."));
    }
    if let Some(cause) = &manifest.cause {
        notes.push(format!("Cause of the end: {cause}."));
    }
    if manifest.lost.samples > 0 {
        notes.push(format!("{} samples were lost; events.jsonl says which.", manifest.lost.samples));
    }
    if let Some(timing) = manifest.timing.as_ref().filter(|timing| timing.slips > 0) {
        notes.push(format!(
            "The control thread came late {} times ({} periods); events.jsonl names cycle and phase of each.",
            timing.slips, timing.skipped_periods
        ));
    }
    if let Some(state) = manifest.real_time.as_ref().filter(|state| !state.complete()) {
        notes.push(state.line());
    }
    notes
}

/// The report of a run folder, not yet drawn.
///
/// # Errors
/// [`RunReportError`] when the folder cannot be read.
pub fn report(folder: &RunFolder, steps: &[StepSummary]) -> Result<RunReport, RunReportError> {
    let manifest = folder.manifest()?;
    let setup = Setup::of_run(&manifest)?;
    let (summary, published) = final_table(&setup, steps);
    let state = folder.state(&manifest).name();
    let planned = planned_steps(&setup);
    Ok(RunReport {
        title: format!("{} on {}", manifest.name, setup.rig.name),
        lead: format!(
            "Started {}, {state}; {:.1} s of samples at {} Hz, {} time.",
            manifest.started_utc,
            manifest.samples as f64 / manifest.sample_rate_hz,
            manifest.sample_rate_hz,
            manifest.clock
        ),
        notes: notes(&manifest, steps.len(), planned),
        summary,
        steps: steps.iter().map(StepPoint::from).collect(),
        planned_steps: planned,
        series: series(folder)?,
        published,
        timing: manifest.timing.as_ref().map(timing_table),
        losses: loss_table(&manifest),
        configuration: manifest.configuration.clone().into_iter().collect(),
    })
}

/// Writes `report.html` into a run folder, and returns its path and the final table.
///
/// # Errors
/// [`RunReportError`] when the folder cannot be read or the page not be written.
pub fn write(folder: &RunFolder, steps: &[StepSummary]) -> Result<(PathBuf, Table), RunReportError> {
    let report = report(folder, steps)?;
    let path = folder.report();
    report.page()?.write(&path)?;
    Ok((path, report.summary))
}
