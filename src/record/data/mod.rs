//! A record in memory, as comparison, identification and diagnosis read it, wherever it came from.
//!
//! [`Record::open`] reads a run folder or a data file (Parquet, CSV, HDF5, MAT v7.3, UFF58), puts every
//! channel in SI on a uniform time grid and says in [`Record::notes`] what it had to repair. [`write()`]
//! goes the other way. No file, however damaged, makes it panic or take memory out of proportion.

mod csv;
mod describe;
mod hdf5;
#[cfg(test)]
mod hostile_tests;
mod inertia;
mod lines;
mod mat;
#[cfg(feature = "parquet")]
mod parquet;
#[cfg(feature = "parquet")]
pub mod query;
mod roles;
mod steps;
#[cfg(test)]
mod tests;
#[cfg(feature = "parquet")]
mod tree;
mod uff58;
mod uniform;

use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

pub use roles::{Mapping, Role};
#[cfg(feature = "parquet")]
pub use tree::add_run;

/// Why a data file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum DataError {
    /// The file system refused.
    #[error("{path}: {source}")]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file is not what its format asks for.
    #[error("{path}: {reason}")]
    Format {
        /// Which file.
        path: PathBuf,
        /// What is wrong, and where.
        reason: String,
    },
    /// The file is sound but is no record: a channel is missing, the time column is no time.
    #[error("{path}: {reason}")]
    Content {
        /// Which file.
        path: PathBuf,
        /// What is wrong, and what would be accepted.
        reason: String,
    },
    /// A mapping cannot be understood.
    #[error("mapping `{text}`: {reason}")]
    Mapping {
        /// What was given.
        text: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A run folder could not be read.
    #[error(transparent)]
    Run(#[from] super::RunError),
}

/// A format error with its path.
fn format(path: &Path) -> impl Fn(&dyn std::fmt::Display) -> DataError + '_ {
    move |reason| DataError::Format { path: path.to_owned(), reason: reason.to_string() }
}

/// A content error with its path.
fn content(path: &Path, reason: impl Into<String>) -> DataError {
    DataError::Content { path: path.to_owned(), reason: reason.into() }
}

/// An input-output error with its path.
fn io(path: &Path) -> impl Fn(std::io::Error) -> DataError + '_ {
    move |source| DataError::Io { path: path.to_owned(), source }
}

/// How a data file is to be understood where its columns do not say it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReadOptions {
    /// Which column plays which role, with unit and sign. Roles not named here are looked for under
    /// their own names.
    pub map: Vec<Mapping>,
    /// Kind of record; guessed from the channels when absent.
    pub kind: Option<Kind>,
    /// Sampling rate, Hz, for files without a time column.
    pub sample_rate_hz: Option<f64>,
}

/// Numeric columns of a file, by name, all of one length.
#[derive(Clone, Debug, Default, PartialEq)]
struct Columns {
    names: Vec<String>,
    values: Vec<Vec<f64>>,
    /// Unit that the file states for each.
    units: Vec<Option<String>>,
    /// Rate stated by the file beside its columns.
    sample_rate_hz: Option<f64>,
    /// Kind stated by the file.
    kind: Option<Kind>,
    notes: Vec<String>,
}

impl Columns {
    fn push(&mut self, name: impl Into<String>, values: Vec<f64>) {
        self.push_with_unit(name, values, None);
    }

    fn push_with_unit(&mut self, name: impl Into<String>, values: Vec<f64>, unit: Option<String>) {
        self.names.push(name.into());
        self.values.push(values);
        self.units.push(unit.filter(|unit| !unit.is_empty() && unit != "NONE"));
    }
}

/// Formats of data files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// Apache Parquet.
    Parquet,
    /// Comma-separated values with a header row.
    Csv,
    /// HDF5, a data set a channel.
    Hdf5,
    /// MATLAB v7.3.
    Mat,
    /// Universal file format, data set 58.
    Uff58,
}

impl Format {
    /// The format that a file name ends in, if it is a known one.
    pub fn of_name(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        Some(match extension.as_str() {
            "parquet" | "pq" => Self::Parquet,
            "csv" | "txt" | "tsv" | "dat" => Self::Csv,
            "h5" | "hdf5" | "hdf" => Self::Hdf5,
            "mat" => Self::Mat,
            "uff" | "unv" | "uff58" => Self::Uff58,
            _ => return None,
        })
    }

    /// The format of an existing file: what its first bytes say, else its name.
    fn of_file(path: &Path) -> Result<Self, DataError> {
        use std::io::Read;
        let mut head = Vec::with_capacity(520);
        let file = std::fs::File::open(path).map_err(io(path))?;
        file.take(520).read_to_end(&mut head).map_err(io(path))?;
        const HDF5: &[u8] = b"\x89HDF\r\n\x1a\n";
        if head.is_empty() {
            return Err(format(path)(&"the file is empty"));
        }
        if head.starts_with(b"PAR1") {
            return Ok(Self::Parquet);
        }
        if head.starts_with(HDF5) || head.get(512..).is_some_and(|rest| rest.starts_with(HDF5)) {
            return Ok(Self::Hdf5);
        }
        if head.starts_with(b"MATLAB 5.0") {
            return Err(format(path)(&"MAT files before v7.3 are not read; save it with `-v7.3`"));
        }
        let text = head.trim_ascii_start();
        if text.starts_with(b"-1") && text[2..].trim_ascii_start().starts_with(b"58") {
            return Ok(Self::Uff58);
        }
        match Self::of_name(path) {
            Some(Self::Csv) | None if !head.contains(&0) => Ok(Self::Csv),
            Some(named) => Err(format(path)(&format!("the name says {named:?}, the first bytes do not"))),
            None => Err(format(path)(&"neither Parquet, CSV, HDF5, MAT v7.3 nor UFF58")),
        }
    }
}

/// Reads a file's numeric columns.
fn read_columns(path: &Path) -> Result<Columns, DataError> {
    let read = match Format::of_file(path)? {
        #[cfg(feature = "parquet")]
        Format::Parquet => parquet::read,
        #[cfg(not(feature = "parquet"))]
        Format::Parquet => return Err(format(path)(&"built without the `parquet` feature")),
        Format::Csv => csv::read,
        Format::Hdf5 | Format::Mat => hdf5::read,
        Format::Uff58 => uff58::read,
    };
    // Decoders of foreign formats are other people's code, fed with files that may be damaged on
    // purpose: a panic in there must not take the process down.
    let columns = std::panic::catch_unwind(|| read(path))
        .unwrap_or_else(|_| Err(format(path)(&"the file is damaged: its decoder gave up")))?;
    let longest = columns.values.iter().map(Vec::len).max().unwrap_or(0);
    if longest == 0 {
        return Err(content(path, "there are no numeric samples in it"));
    }
    Ok(columns)
}

/// Bytes of decoded channels that a file of this length may claim, lest a few damaged bytes ask for all
/// the memory there is: what the best compression could have packed into it (deflate: a thousandfold, and
/// something for runs of equal numbers), and half of the memory that is free.
fn most_decoded_bytes(path: &Path) -> Result<u64, DataError> {
    let length = std::fs::metadata(path).map_err(io(path))?.len();
    Ok(length.saturating_mul(1100).max(64 << 20).min(free_memory_bytes() / 2))
}

/// What Linux says is free for new work; four gibibytes where it says nothing.
fn free_memory_bytes() -> u64 {
    let free = std::fs::read_to_string("/proc/meminfo").ok().and_then(|text| {
        let line = text.lines().find(|line| line.starts_with("MemAvailable:"))?;
        line.split_whitespace().nth(1)?.parse::<u64>().ok()
    });
    free.map_or(4 << 30, |kib| kib << 10)
}

/// Writes a record with the column names of the contract.
///
/// # Errors
/// [`DataError`] when the file cannot be written.
pub fn write(record: &Record, path: &Path, to: Format) -> Result<(), DataError> {
    match to {
        #[cfg(feature = "parquet")]
        Format::Parquet => parquet::write(record, path),
        #[cfg(not(feature = "parquet"))]
        Format::Parquet => Err(format(path)(&"built without the `parquet` feature")),
        Format::Csv => csv::write(record, path),
        Format::Hdf5 => hdf5::write(record, path),
        Format::Mat => mat::write(record, path),
        Format::Uff58 => uff58::write(record, path),
    }
}

/// What was imposed and what was measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Table acceleration in; relative displacement and absolute acceleration out.
    Base,
    /// Applied force in; displacement and/or acceleration out.
    Force,
    /// Imposed displacement in, force out: a damper or a bumper on its own.
    Component,
}

impl Kind {
    /// The word of files and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Base => "base",
            Self::Force => "force",
            Self::Component => "component",
        }
    }

    /// The kind of that name.
    pub fn of_name(name: &str) -> Option<Self> {
        [Self::Base, Self::Force, Self::Component].into_iter().find(|kind| kind.name() == name)
    }
}

/// Uniformly sampled channels, SI. Every present channel has the length of `time_s`; an absent one
/// is empty.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Where it came from, for messages.
    pub source: String,
    /// What was imposed and what was measured.
    pub kind: Kind,
    /// Sampling rate, Hz.
    pub sample_rate_hz: f64,
    /// Time of each sample, s.
    pub time_s: Vec<f64>,
    /// Table displacement, m (`base`).
    pub table_displacement_m: Vec<f64>,
    /// Table acceleration, m/s2 (`base`).
    pub table_acceleration_m_s2: Vec<f64>,
    /// First accelerometer on the mass, m/s2 (`base`).
    pub mass_acceleration_1_m_s2: Vec<f64>,
    /// Second accelerometer on the mass, m/s2 (`base`).
    pub mass_acceleration_2_m_s2: Vec<f64>,
    /// Relative displacement, m (`base`: laser).
    pub relative_displacement_m: Vec<f64>,
    /// Force, N (`force`: applied; `component`: measured).
    pub force_n: Vec<f64>,
    /// Displacement, m (`force`: measured; `component`: imposed).
    pub displacement_m: Vec<f64>,
    /// Acceleration, m/s2 (`force`: measured).
    pub acceleration_m_s2: Vec<f64>,
    /// Index of the sweep step of each sample, -1 between steps.
    pub step: Vec<i32>,
    /// What was repaired or noticed while reading.
    pub notes: Vec<String>,
}

impl Record {
    /// A record without channels.
    pub fn empty(source: impl Into<String>, kind: Kind, sample_rate_hz: f64) -> Self {
        Self {
            source: source.into(),
            kind,
            sample_rate_hz,
            time_s: Vec::new(),
            table_displacement_m: Vec::new(),
            table_acceleration_m_s2: Vec::new(),
            mass_acceleration_1_m_s2: Vec::new(),
            mass_acceleration_2_m_s2: Vec::new(),
            relative_displacement_m: Vec::new(),
            force_n: Vec::new(),
            displacement_m: Vec::new(),
            acceleration_m_s2: Vec::new(),
            step: Vec::new(),
            notes: Vec::new(),
        }
    }

    /// Opens a run folder or a data file.
    ///
    /// # Errors
    /// [`DataError`] when it is neither, is damaged, or lacks what its kind needs.
    pub fn open(path: &Path, options: &ReadOptions) -> Result<Self, DataError> {
        if path.is_dir() {
            return Ok(super::read_run(path)?);
        }
        let columns = read_columns(path)?;
        roles::assemble(path, columns, &describe::with_sidecar(path, options)?)
    }

    /// A channel by its role; empty when absent.
    pub fn channel(&self, role: Role) -> &[f64] {
        match role {
            Role::Time => &self.time_s,
            Role::TableDisplacement => &self.table_displacement_m,
            Role::TableAcceleration => &self.table_acceleration_m_s2,
            Role::MassAcceleration1 => &self.mass_acceleration_1_m_s2,
            Role::MassAcceleration2 => &self.mass_acceleration_2_m_s2,
            Role::RelativeDisplacement => &self.relative_displacement_m,
            Role::Force => &self.force_n,
            Role::Displacement => &self.displacement_m,
            Role::Acceleration => &self.acceleration_m_s2,
            Role::Step => &[],
        }
    }

    /// The same, to be filled; the step column is not among them.
    pub(crate) fn channel_mut(&mut self, role: Role) -> Option<&mut Vec<f64>> {
        Some(match role {
            Role::Time => &mut self.time_s,
            Role::TableDisplacement => &mut self.table_displacement_m,
            Role::TableAcceleration => &mut self.table_acceleration_m_s2,
            Role::MassAcceleration1 => &mut self.mass_acceleration_1_m_s2,
            Role::MassAcceleration2 => &mut self.mass_acceleration_2_m_s2,
            Role::RelativeDisplacement => &mut self.relative_displacement_m,
            Role::Force => &mut self.force_n,
            Role::Displacement => &mut self.displacement_m,
            Role::Acceleration => &mut self.acceleration_m_s2,
            Role::Step => return None,
        })
    }

    /// Channels that are there, time first, the step column left out.
    pub fn channels(&self) -> impl Iterator<Item = (Role, &[f64])> {
        Role::ALL.into_iter().map(|role| (role, self.channel(role))).filter(|(_, values)| !values.is_empty())
    }

    /// What is imposed: table acceleration, force or displacement, by kind.
    pub fn input(&self) -> &[f64] {
        match self.kind {
            Kind::Base => &self.table_acceleration_m_s2,
            Kind::Force => &self.force_n,
            Kind::Component => &self.displacement_m,
        }
    }

    /// Mean of the accelerometers on the mass that are there (`base`), m/s2; empty when none is.
    pub fn mass_acceleration_m_s2(&self) -> Vec<f64> {
        let (one, two) = (&self.mass_acceleration_1_m_s2, &self.mass_acceleration_2_m_s2);
        match (one.is_empty(), two.is_empty()) {
            (false, false) => one.iter().zip(two).map(|(a, b)| 0.5 * (a + b)).collect(),
            (false, true) => one.clone(),
            _ => two.clone(),
        }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// Cuts every channel off after so many samples, as where a run was stopped.
    pub fn truncate(&mut self, samples: usize) {
        for role in Role::ALL {
            if let Some(channel) = self.channel_mut(role) {
                channel.truncate(samples);
            }
        }
        self.step.truncate(samples);
    }

    /// Stretches of equal, non-negative step index: (index, samples).
    pub fn step_ranges(&self) -> Vec<(i32, std::ops::Range<usize>)> {
        let mut first = 0;
        let runs = self.step.chunk_by(|a, b| a == b).map(|run| {
            let start = first;
            first += run.len();
            (run[0], start..first)
        });
        runs.filter(|(index, _)| *index >= 0).collect()
    }
}
