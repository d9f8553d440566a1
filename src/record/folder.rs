//! Run folders: what is in one, how it is made, listed and found again.

use super::samples::SampleFileError;
use crate::control::event::Ending;
use crate::control::thread::RealTime;
use crate::control::timing::TimingReport;
use serde::{Deserialize, Serialize};
use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Version of the run folder's layout.
pub const FORMAT: u32 = 1;

/// Why a run folder could not be made, read or written.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The file system refused.
    #[error("{path}: {source}")]
    Io {
        /// Which file or folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The sample file is damaged or foreign.
    #[error(transparent)]
    Samples(#[from] SampleFileError),
    /// `run.toml` is not what it should be.
    #[error("{path}: {reason}")]
    Manifest {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

/// An input-output error with its path.
pub(super) fn io(path: &Path) -> impl Fn(std::io::Error) -> RunError + '_ {
    move |source| RunError::Io { path: path.to_owned(), source }
}

/// State of a run as `run.toml` has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RunState {
    /// The run goes on, or its process died: see [`RunFolder::state`].
    Running,
    /// The sweep was run to its end.
    Done,
    /// Stopped on request.
    Stopped,
    /// Ended by the safety supervisor.
    Aborted,
    /// The rig or the recorder failed.
    Failed,
    /// The process ended before the run did.
    Interrupted,
}

impl From<Ending> for RunState {
    fn from(ending: Ending) -> Self {
        match ending {
            Ending::Done => Self::Done,
            Ending::Stopped => Self::Stopped,
            Ending::Aborted => Self::Aborted,
            Ending::Failed => Self::Failed,
            Ending::Interrupted => Self::Interrupted,
        }
    }
}

impl RunState {
    /// The word of the files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Running => "running",
            Self::Done => "done",
            Self::Stopped => "stopped",
            Self::Aborted => "aborted",
            Self::Failed => "failed",
            Self::Interrupted => "interrupted",
        }
    }
}

/// What was lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LossReport {
    /// Samples that the DAQ took and the file does not have, whatever the reason.
    pub samples: u64,
    /// Of these, dropped because the recorder's ring was full.
    pub ring: u64,
    /// Of these, never delivered by the DAQ.
    pub daq: u64,
    /// Of these, refused by the disk.
    #[serde(default)]
    pub disk: u64,
    /// Events dropped because their ring was full.
    pub events: u64,
    /// Rows that the live view missed (allowed).
    pub live: u64,
}

/// `run.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: u32,
    /// Name of the run.
    pub name: String,
    /// How it stands.
    pub state: RunState,
    /// First-out cause of an abort or failure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cause: Option<String>,
    /// Nothing was lost and the run ended as asked.
    pub clean: bool,
    /// Start, UTC, RFC 3339.
    pub started_utc: String,
    /// End, UTC, RFC 3339.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ended_utc: Option<String>,
    /// Version of the product that wrote it.
    pub version: String,
    /// `virtual` or `wall`.
    pub clock: String,
    /// Sampling and control rate, Hz.
    pub sample_rate_hz: f64,
    /// Seed of the simulated rig.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Case of the paper's Table 1, if one was named.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub case: Option<String>,
    /// Rows in `samples.h5`.
    pub samples: u64,
    /// Hash chain over all rows, as in the last line of `integrity.txt`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub samples_sha256: Option<String>,
    /// Length of `events.jsonl` at the end of the run, bytes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub events_bytes: Option<u64>,
    /// SHA-256 of these bytes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub events_sha256: Option<String>,
    /// What `recover` found wrong and did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recovered: Option<String>,
    /// What was lost.
    #[serde(default)]
    pub lost: LossReport,
    /// Real-time set-up; absent in virtual time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub real_time: Option<RealTime>,
    /// Timing of the control thread.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub timing: Option<TimingReport>,
    /// SHA-256 of each configuration below, as text.
    #[serde(default)]
    pub sha256: std::collections::BTreeMap<String, String>,
    /// Every configuration of the run by its role (`rig`, `sweep`, `model`, `specimen`, `safety`), as
    /// TOML text.
    #[serde(default)]
    pub configuration: std::collections::BTreeMap<String, String>,
}

/// A run folder on disk. The one that writes it holds its lock until it ends, in whatever way.
#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
    _lock: Option<File>,
}

impl Manifest {
    /// What is known when a run starts; clock, seed, case and configurations are filled in by the caller.
    pub fn new(name: &str, sample_rate_hz: f64) -> Self {
        Self {
            format: FORMAT,
            name: name.to_owned(),
            state: RunState::Running,
            cause: None,
            clean: false,
            started_utc: now_utc(),
            ended_utc: None,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            clock: "virtual".to_owned(),
            sample_rate_hz,
            seed: None,
            case: None,
            samples: 0,
            samples_sha256: None,
            events_bytes: None,
            events_sha256: None,
            recovered: None,
            lost: LossReport::default(),
            real_time: None,
            timing: None,
            sha256: std::collections::BTreeMap::new(),
            configuration: std::collections::BTreeMap::new(),
        }
    }

    /// Keeps the text of a configuration and its hash.
    pub fn configure(&mut self, role: &str, text: String) {
        use sha2::Digest;
        let hash = super::samples::hex(&sha2::Sha256::digest(text.as_bytes()));
        self.sha256.insert(role.to_owned(), hash);
        self.configuration.insert(role.to_owned(), text);
    }
}

impl RunFolder {
    /// Makes `<out>/<utc time>-<name>/` and takes its lock.
    ///
    /// # Errors
    /// [`RunError::Io`].
    pub fn create(out: &Path, name: &str) -> Result<Self, RunError> {
        let stamp = chrono::Utc::now().format("%Y%m%dT%H%M%SZ");
        let safe: String = name
            .chars()
            .map(|c| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '-' })
            .collect();
        fs::create_dir_all(out).map_err(io(out))?;
        let mut path = out.join(format!("{stamp}-{safe}"));
        let mut again = 1;
        while let Err(error) = fs::create_dir(&path) {
            if error.kind() != std::io::ErrorKind::AlreadyExists || again > 999 {
                return Err(io(&path)(error));
            }
            again += 1;
            path = out.join(format!("{stamp}-{safe}-{again}"));
        }
        let lock_path = path.join(".lock");
        let lock = File::create(&lock_path).map_err(io(&lock_path))?;
        lock.lock().map_err(io(&lock_path))?;
        Ok(Self { path, _lock: Some(lock) })
    }

    /// Opens an existing folder for reading.
    ///
    /// # Errors
    /// [`RunError::Io`] when there is no `run.toml`.
    pub fn open(path: &Path) -> Result<Self, RunError> {
        let manifest = path.join("run.toml");
        fs::metadata(&manifest).map_err(io(&manifest))?;
        Ok(Self { path: path.to_owned(), _lock: None })
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// `samples.h5`.
    pub fn samples(&self) -> PathBuf {
        self.path.join("samples.h5")
    }

    /// `events.jsonl`.
    pub fn events(&self) -> PathBuf {
        self.path.join("events.jsonl")
    }

    /// `steps.csv`.
    pub fn steps(&self) -> PathBuf {
        self.path.join("steps.csv")
    }

    /// `integrity.txt`: the hash chain, a line a block (see [`super::chain`]).
    pub fn integrity(&self) -> PathBuf {
        self.path.join("integrity.txt")
    }

    /// Room kept on the disk while the run goes on.
    pub fn reserves(&self) -> [PathBuf; 2] {
        [".reserve-stop", ".reserve-end"].map(|name| self.path.join(name))
    }

    /// `first-out.h5`: all channels around the cause of an abort.
    pub fn first_out(&self) -> PathBuf {
        self.path.join("first-out.h5")
    }

    /// `report.html`.
    pub fn report(&self) -> PathBuf {
        self.path.join("report.html")
    }

    /// Reads `run.toml`.
    ///
    /// # Errors
    /// [`RunError`] when it is missing or not readable as one.
    pub fn manifest(&self) -> Result<Manifest, RunError> {
        let path = self.path.join("run.toml");
        let text = fs::read_to_string(&path).map_err(io(&path))?;
        toml::from_str(&text).map_err(|error| RunError::Manifest { path, reason: error.to_string() })
    }

    /// Replaces `run.toml` as a whole, so that a reader sees the old or the new one.
    ///
    /// # Errors
    /// [`RunError`] when it cannot be written.
    pub fn write_manifest(&self, manifest: &Manifest) -> Result<(), RunError> {
        let path = self.path.join("run.toml");
        let text = toml::to_string(manifest)
            .map_err(|error| RunError::Manifest { path: path.clone(), reason: error.to_string() })?;
        let new = self.path.join(".run.toml.new");
        let mut file = File::create(&new).map_err(io(&new))?;
        // On the disk before it takes the old one's name, or a power cut could leave an empty file.
        file.write_all(text.as_bytes()).and_then(|()| file.sync_all()).map_err(io(&new))?;
        fs::rename(&new, &path).map_err(io(&path))?;
        File::open(&self.path).and_then(|folder| folder.sync_all()).map_err(io(&self.path))
    }

    /// Keeps length and hash of `events.jsonl` as it stands.
    ///
    /// # Errors
    /// [`RunError::Io`].
    pub fn seal_events(&self, manifest: &mut Manifest) -> Result<(), RunError> {
        use sha2::Digest;
        let path = self.events();
        let events = fs::read(&path).map_err(io(&path))?;
        manifest.events_bytes = Some(events.len() as u64);
        manifest.events_sha256 = Some(super::samples::hex(&sha2::Sha256::digest(&events)));
        Ok(())
    }

    /// How the run stands: one that calls itself running while nobody holds its lock was interrupted.
    pub fn state(&self, manifest: &Manifest) -> RunState {
        if manifest.state == RunState::Running && !self.is_locked() {
            RunState::Interrupted
        } else {
            manifest.state
        }
    }

    fn is_locked(&self) -> bool {
        if self._lock.is_some() {
            return true;
        }
        File::open(self.path.join(".lock"))
            .is_ok_and(|lock| matches!(lock.try_lock_shared(), Err(fs::TryLockError::WouldBlock)))
    }
}

/// Now, UTC, RFC 3339.
pub fn now_utc() -> String {
    chrono::Utc::now().to_rfc3339_opts(chrono::SecondsFormat::Millis, true)
}

/// A run folder and what its `run.toml` says, or why that cannot be read.
pub type Listed = (PathBuf, Result<(Manifest, RunState), RunError>);

/// All run folders below a directory, oldest first, with what their `run.toml` says.
///
/// # Errors
/// [`RunError::Io`] when the directory cannot be read; a folder with a broken `run.toml` is listed with
/// its error.
pub fn list(out: &Path) -> Result<Vec<Listed>, RunError> {
    let mut runs = Vec::new();
    for entry in fs::read_dir(out).map_err(io(out))? {
        let path = entry.map_err(io(out))?.path();
        if !path.join("run.toml").exists() {
            continue;
        }
        let read = RunFolder::open(&path).and_then(|folder| {
            let manifest = folder.manifest()?;
            let state = folder.state(&manifest);
            Ok((manifest, state))
        });
        runs.push((path, read));
    }
    runs.sort_by(|a, b| a.0.cmp(&b.0));
    Ok(runs)
}
