//! Where a model fails and what it lacks, for the interface: comparisons with a map by frequency and phase,
//! and diagnoses as jobs that a worker thread does one after the other.

use crate::compare::{CompareError, Comparison, Window, compare};
use crate::model::ModelSpec;
use crate::record::Record;
use serde::Serialize;
use serde_json::value::RawValue;
use std::collections::VecDeque;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use utoipa::ToSchema;

/// Parts of a cycle in the map.
pub const BINS: usize = 24;
/// Jobs that may wait.
const QUEUE: usize = 4;
/// Jobs whose answers are remembered.
const REMEMBERED: usize = 32;

/// One row of the map.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct MapStep {
    /// Index of the step.
    pub index: i32,
    /// Its frequency, Hz.
    pub frequency_hz: f64,
    /// Its direction.
    pub direction: Option<&'static str>,
}

/// Error by frequency and phase of the table's cycle: RMS of the difference in a cell over the RMS of what was
/// measured in the whole step.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Map {
    /// Rows.
    pub steps: Vec<MapStep>,
    /// Cells a row, equal parts of a cycle from phase 0.
    pub bins: usize,
    /// Acceleration.
    pub nrmse_a: Vec<Vec<Option<f64>>>,
    /// Displacement.
    pub nrmse_d: Vec<Vec<Option<f64>>>,
}

/// A comparison and its map.
#[derive(Debug, Serialize, ToSchema)]
pub struct Failure {
    /// As `shaketable compare --json`.
    #[schema(value_type = Object)]
    pub comparison: Comparison,
    /// By frequency and phase.
    pub map: Map,
}

/// Where a model fails on a record.
///
/// # Errors
/// [`CompareError`] as of [`compare`].
pub fn failure(record: &Record, model: &ModelSpec) -> Result<Failure, CompareError> {
    let comparison = compare(record, model)?;
    let map = map(&comparison, record.sample_rate_hz);
    Ok(Failure { comparison, map })
}

fn map(comparison: &Comparison, rate_hz: f64) -> Map {
    let mut map = Map { steps: Vec::new(), bins: BINS, nrmse_a: Vec::new(), nrmse_d: Vec::new() };
    let channels = &comparison.channels;
    for window in &comparison.windows {
        let Some(frequency_hz) = window.frequency_hz else { continue };
        let direction = window.direction.map(crate::sweep::Direction::label);
        map.steps.push(MapStep { index: window.step, frequency_hz, direction });
        map.nrmse_a.push(row(window, &channels.measured_a, &channels.model_a, rate_hz));
        map.nrmse_d.push(row(window, &channels.measured_d, &channels.model_d, rate_hz));
    }
    map
}

fn row(window: &Window, measured: &[f64], model: &[f64], rate_hz: f64) -> Vec<Option<f64>> {
    let (mut sums, mut counts) = ([0.0; BINS], [0_u32; BINS]);
    let (mut power, mut count) = (0.0, 0.0);
    for i in window.counted.clone() {
        let (Some(x), Some(y), Some(place)) = (measured.get(i), model.get(i), window.cycle_place(i, rate_hz))
        else {
            continue;
        };
        let bin = ((place * BINS as f64) as usize).min(BINS - 1);
        sums[bin] += (x - y).powi(2);
        counts[bin] += 1;
        power += x * x;
        count += 1.0;
    }
    let rms = f64::sqrt(power / f64::max(count, 1.0));
    let cell = |(sum, n): (f64, u32)| (n > 0 && rms > 0.0).then(|| (sum / f64::from(n)).sqrt() / rms);
    sums.into_iter().zip(counts).map(cell).collect()
}

/// Work that asks this program, in a process of its own, what a model lacks on a run: a search takes minutes and
/// memory, and whatever becomes of it, the daemon goes on. `scratch` is where the model is put meanwhile.
pub fn diagnosis(run: PathBuf, model: ModelSpec, scratch: PathBuf) -> Work {
    Box::new(move || {
        let text = toml::to_string(&model).map_err(|error| error.to_string())?;
        std::fs::write(&scratch, text).map_err(|error| format!("{}: {error}", scratch.display()))?;
        let program = std::env::current_exe().map_err(|error| error.to_string());
        let asked = program.and_then(|program| {
            let mut command = Command::new(program);
            command.arg("diagnose").arg(&run).arg("--model").arg(&scratch).arg("--json").stdin(Stdio::null());
            command.output().map_err(|error| error.to_string())
        });
        // Nothing is lost with it.
        let _ = std::fs::remove_file(&scratch);
        let output = asked?;
        if !output.status.success() {
            return Err(reason(&output));
        }
        let said = String::from_utf8_lossy(&output.stdout).trim().to_owned();
        RawValue::from_string(said).map_err(|error| format!("the diagnosis gave no JSON: {error}"))
    })
}

/// What a process said of its failure, in one line.
fn reason(output: &Output) -> String {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let words: Vec<&str> = said.split_whitespace().take(80).collect();
    if words.is_empty() { format!("the diagnosis ended with {}", output.status) } else { words.join(" ") }
}

/// How a job stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Stand {
    /// Others come first.
    Waiting,
    /// Being worked on.
    Running,
    /// Its answer is there.
    Done,
    /// It cannot be answered.
    Failed,
}

/// A diagnosis that was asked for.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Job {
    /// Number.
    pub id: u64,
    /// Folder name of the run.
    pub run: String,
    /// How it stands.
    pub state: Stand,
    /// Time since it was begun, s.
    pub elapsed_s: f64,
    /// As the command line's `--json` gives it.
    #[schema(value_type = Option<Object>)]
    pub result: Option<Arc<RawValue>>,
    /// Why there is no answer.
    pub error: Option<String>,
    #[serde(skip)]
    begun: Option<Instant>,
}

/// What a job does: its answer as JSON, or why there is none.
pub type Work = Box<dyn FnOnce() -> Result<Box<RawValue>, String> + Send>;

struct Order {
    id: u64,
    work: Work,
}

/// The jobs and their worker.
pub struct Jobs {
    all: Arc<Mutex<VecDeque<Job>>>,
    orders: SyncSender<Order>,
}

fn lock(all: &Mutex<VecDeque<Job>>) -> MutexGuard<'_, VecDeque<Job>> {
    all.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Jobs {
    /// Starts the worker; it ends when the jobs are dropped.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn start() -> std::io::Result<Self> {
        let (orders, todo) = sync_channel::<Order>(QUEUE);
        let all = Arc::new(Mutex::new(VecDeque::new()));
        let known = all.clone();
        std::thread::Builder::new().name("diagnosis".into()).spawn(move || {
            while let Ok(order) = todo.recv() {
                change(&known, order.id, |job| {
                    (job.state, job.begun) = (Stand::Running, Some(Instant::now()))
                });
                // Whatever a record does to the work, the next job must still be worked on.
                let answer = std::panic::catch_unwind(std::panic::AssertUnwindSafe(order.work))
                    .unwrap_or_else(|_| Err("the work failed by a fault of the program".to_owned()));
                change(&known, order.id, |job| {
                    job.elapsed_s = job.begun.map_or(0.0, |begun| begun.elapsed().as_secs_f64());
                    match answer {
                        Ok(result) => (job.state, job.result) = (Stand::Done, Some(result.into())),
                        Err(error) => (job.state, job.error) = (Stand::Failed, Some(error)),
                    }
                });
            }
        })?;
        Ok(Self { all, orders })
    }

    /// Asks for work on a run; `None` when too many wait.
    pub fn ask(&self, run: &str, work: Work) -> Option<Job> {
        let mut all = lock(&self.all);
        let id = all.back().map_or(1, |job| job.id + 1);
        match self.orders.try_send(Order { id, work }) {
            Ok(()) => {}
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => return None,
        }
        let job = Job {
            id,
            run: run.to_owned(),
            state: Stand::Waiting,
            elapsed_s: 0.0,
            result: None,
            error: None,
            begun: None,
        };
        all.push_back(job.clone());
        while all.len() > REMEMBERED
            && all.front().is_some_and(|job| matches!(job.state, Stand::Done | Stand::Failed))
        {
            all.pop_front();
        }
        Some(job)
    }

    /// How a job stands.
    pub fn get(&self, id: u64) -> Option<Job> {
        let mut job = lock(&self.all).iter().find(|job| job.id == id).cloned()?;
        if let (Stand::Running, Some(begun)) = (job.state, job.begun) {
            job.elapsed_s = begun.elapsed().as_secs_f64();
        }
        Some(job)
    }
}

fn change(all: &Mutex<VecDeque<Job>>, id: u64, with: impl FnOnce(&mut Job)) {
    if let Some(job) = lock(all).iter_mut().find(|job| job.id == id) {
        with(job);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn wait(jobs: &Jobs, id: u64) -> Job {
        for _ in 0..2000 {
            let job = jobs.get(id).expect("known");
            if matches!(job.state, Stand::Done | Stand::Failed) {
                return job;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        panic!("no answer within 10 s")
    }

    #[test]
    fn a_job_that_dies_is_told_and_the_next_one_is_done() {
        let jobs = Jobs::start().expect("thread");
        let raw = |text: &str| RawValue::from_string(text.to_owned()).map_err(|error| error.to_string());
        let dies = jobs.ask("r", Box::new(|| panic!("a fault"))).expect("room");
        let refuses = jobs.ask("r", Box::new(|| Err("no".into()))).expect("room");
        let answers = jobs.ask("r", Box::new(move || raw("{\"verdict\":1}"))).expect("room");
        assert_eq!(wait(&jobs, dies.id).state, Stand::Failed);
        assert_eq!(wait(&jobs, refuses.id).error.as_deref(), Some("no"));
        let done = wait(&jobs, answers.id);
        assert_eq!(done.result.expect("answer").get(), "{\"verdict\":1}");
        assert!(jobs.get(99).is_none());
    }

    #[test]
    fn too_many_jobs_are_refused() {
        let jobs = Jobs::start().expect("thread");
        let (release, held) = std::sync::mpsc::channel::<()>();
        let first = jobs
            .ask("r", Box::new(move || held.recv().map_err(|e| e.to_string()).and(Err("released".into()))));
        let first = first.expect("room");
        // The thread has to have taken it, or it still fills a place.
        while jobs.get(first.id).is_some_and(|job| job.state == Stand::Waiting) {
            std::thread::yield_now();
        }
        let accepted = (0..20).filter(|_| jobs.ask("r", Box::new(|| Err("x".into()))).is_some()).count();
        assert!((QUEUE..=QUEUE + 1).contains(&accepted), "{accepted}");
        release.send(()).expect("waiting");
    }
}
