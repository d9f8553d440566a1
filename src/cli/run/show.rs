//! What `run` shows on a terminal: preview, progress bar, end table.

use crate::cli::{CliError, Outcome};
use crate::control::Event;
use crate::control::session::Finished;
use crate::control::setup::Setup;
use crate::diagnose::live::Follower;
use crate::record::recorder::Notice;
use crate::report::Table;
use crate::sweep::{Preview, Schedule, Step};
use indicatif::{ProgressBar, ProgressStyle};
use std::path::{Path, PathBuf};

/// Shows what the sweep asks of the table; a sweep beyond it is refused.
pub(super) fn preview(preview: &Preview, json: bool) -> Result<Outcome, CliError> {
    if json {
        let checked = preview.check();
        let object = serde_json::json!({
            "steps": preview.rows().iter().filter(|row| row.place == "step").count(),
            "fits": checked.is_ok(),
            "reason": checked.err().map(|error| error.to_string()),
        });
        println!("{object}");
    } else {
        print!("{}", preview.text());
    }
    preview.check().map(|()| Outcome::Done).map_err(CliError::usage)
}

/// The progress bar of a run; silent when standard error is no terminal.
pub(super) struct Progress {
    bar: ProgressBar,
    steps: Vec<Step>,
    sample_rate_hz: f64,
    error: String,
    first: Option<u64>,
    finished: usize,
    evidence: Option<(Follower, PathBuf)>,
}

impl Progress {
    pub(super) fn new(schedule: &Schedule, sample_rate_hz: f64) -> Self {
        let samples = (schedule.duration_s() * sample_rate_hz) as u64;
        let bar = ProgressBar::new(samples);
        let style = ProgressStyle::with_template("{bar:30} {percent:>3} %  {msg}  ETA {eta}")
            .unwrap_or_else(|_| ProgressStyle::default_bar());
        bar.set_style(style);
        let steps = schedule.steps().to_vec();
        Self { bar, steps, sample_rate_hz, error: String::new(), first: None, finished: 0, evidence: None }
    }

    /// Asks after each step what the run in this folder says of missing effects.
    pub(super) fn follow(&mut self, folder: &Path) {
        self.evidence = Some((Follower::default(), folder.to_owned()));
    }

    pub(super) fn notice(&mut self, notice: &Notice) {
        match notice {
            Notice::Row(row) => self.row(row.sample.sequence),
            Notice::Event(Event::Live { error, .. }) => {
                self.error =
                    format!("model error A {:.1} %, D {:.1} %", 100.0 * error.nrmse_a, 100.0 * error.nrmse_d);
            }
            Notice::Event(Event::Step(_)) => {
                self.finished += 1;
                if let Some((follower, folder)) = &self.evidence {
                    follower.step_finished(folder.clone(), self.finished);
                }
            }
            Notice::Event(Event::RigFault { fault, .. }) => self.bar.println(format!("rig: {fault}")),
            Notice::Event(_) => {}
            Notice::Failed(reason) => self.bar.println(format!("recorder: {reason}; the run is stopped")),
        }
    }

    fn row(&mut self, sequence: u64) {
        let first = *self.first.get_or_insert(sequence);
        let position = sequence.saturating_sub(first);
        let time_s = position as f64 / self.sample_rate_hz;
        let at = self.steps.partition_point(|step| step.start_s <= time_s).saturating_sub(1);
        if let Some(step) = self.steps.get(at) {
            let evidence = self.evidence.as_ref().and_then(|(follower, _)| follower.latest());
            let evidence = evidence.map_or_else(String::new, |found| format!("  {}", found.line()));
            self.bar.set_message(format!(
                "step {}/{} {:.2} Hz {}  {}{evidence}",
                at + 1,
                self.steps.len(),
                step.frequency_hz,
                step.direction.label(),
                self.error
            ));
        }
        self.bar.set_position(position);
    }

    pub(super) fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

/// The end table, the timing, the losses, and where everything is.
pub(super) fn summary(setup: &Setup, finished: &Finished, table: &Table, wall_s: f64) {
    let manifest = &finished.manifest;
    let outcome = manifest.state.name();
    println!("{} on {}: {outcome}", manifest.name, setup.rig.name);
    if let Some(cause) = &manifest.cause {
        println!("cause: {cause}");
    }
    println!("\n{}", table.text());
    let error = finished.model_error;
    println!(
        "\nmodel error (NRMSE over all counted cycles): A {:.2} %, D {:.2} %",
        100.0 * error.nrmse_a,
        100.0 * error.nrmse_d
    );
    timing(finished, wall_s);
    let lost = &manifest.lost;
    println!(
        "lost samples: {} (ring {}, DAQ {}) of {}",
        lost.samples,
        lost.ring,
        lost.daq,
        manifest.samples + lost.samples
    );
    println!("run folder: {}", finished.folder.path().display());
    if finished.folder.report().exists() {
        println!("plots:      {}", finished.folder.report().display());
    }
}

fn timing(finished: &Finished, wall_s: f64) {
    let timing = &finished.timing;
    let step = &timing.step;
    println!(
        "{} control steps in {wall_s:.1} s wall ({} time): step p50 {:.2} us, p99.9 {:.2} us; slips: {} ({} periods)",
        timing.cycles,
        finished.manifest.clock,
        step.p50_us,
        step.p999_us,
        timing.slips,
        timing.skipped_periods
    );
    if let Some(state) = &finished.manifest.real_time {
        let wake = &timing.wake_up_latency;
        println!(
            "{}; wake-up latency p50 {:.1} us, p99 {:.1} us, p99.9 {:.1} us, max {:.0} us",
            state.line(),
            wake.p50_us,
            wake.p99_us,
            wake.p999_us,
            wake.max_us
        );
    }
}
