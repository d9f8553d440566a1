//! Arguments that every subcommand which opens a record shares.

use super::CliError;
use crate::config::{ConfigError, builtin::find};
use crate::control::setup::Setup;
use crate::model::ModelSpec;
use crate::record::data::{Mapping, ReadOptions};
use crate::record::{Kind, Record, RunFolder};
use std::path::{Path, PathBuf};

/// A record and how to understand it.
#[derive(Clone, Debug, clap::Args)]
pub struct ReadArgs {
    /// Run folder or data file (Parquet, CSV, HDF5, MAT v7.3, UFF58)
    pub record: PathBuf,
    #[command(flatten)]
    reading: ReadingArgs,
}

/// How to understand a record.
#[derive(Clone, Debug, clap::Args)]
pub struct ReadingArgs {
    /// Column of a role: `role=column`, `role=-column` (sign turned) or `role=column:unit`, such as
    /// `relative_displacement_m=laser:mm`; may be repeated
    #[arg(long, value_name = "ROLE=COLUMN")]
    pub map: Vec<Mapping>,
    /// TOML file that says what the columns are (`[[columns]]` with `name`, `role`, `unit`, `sign`,
    /// `calibration`), and `kind` and `sample_rate_hz`; `--map` has precedence
    #[arg(long, value_name = "FILE")]
    pub columns: Option<PathBuf>,
    /// What was imposed and measured; guessed from the columns when left out
    #[arg(long, value_enum)]
    pub kind: Option<Kind>,
    /// Sampling rate in Hz, for a file without a time column
    #[arg(long, value_name = "HZ")]
    pub rate: Option<f64>,
}

impl ReadingArgs {
    /// With the record that they are about.
    pub fn of(self, record: PathBuf) -> ReadArgs {
        ReadArgs { record, reading: self }
    }
}

impl ReadArgs {
    /// The options as the reader takes them.
    ///
    /// # Errors
    /// [`CliError::Usage`] when the description of the columns is not one.
    pub fn options(&self) -> Result<ReadOptions, CliError> {
        let ReadingArgs { map, columns, kind, rate } = &self.reading;
        let mut options = ReadOptions { map: map.clone(), kind: *kind, sample_rate_hz: *rate };
        if let Some(path) = columns {
            options.describe(path).map_err(CliError::usage)?;
        }
        Ok(options)
    }

    /// Opens the record; what was repaired goes to standard error.
    ///
    /// # Errors
    /// [`CliError::Failed`] with the file and the reason.
    pub fn open(&self) -> Result<Record, CliError> {
        let record = Record::open(&self.record, &self.options()?).map_err(CliError::failed)?;
        for note in &record.notes {
            eprintln!("note: {note}");
        }
        Ok(record)
    }
}

/// What was done to a record beyond what was said when it was opened goes to standard error.
pub(super) fn say_new(notes: &[String], record: &Record) {
    for note in notes.iter().filter(|note| !record.notes.contains(note)) {
        eprintln!("note: {note}");
    }
}

/// Reads a model by name or path; of a run folder its onboard model.
///
/// # Errors
/// [`CliError::Usage`] when there is none, or what there is is not valid.
pub(super) fn read_model(name: &str) -> Result<ModelSpec, CliError> {
    let path = Path::new(name);
    if path.is_dir() {
        let manifest = RunFolder::open(path).and_then(|folder| folder.manifest()).map_err(CliError::usage)?;
        return Ok(Setup::of_run(&manifest).map_err(CliError::usage)?.model);
    }
    find("models", name)
        .and_then(|source| source.parse())
        .map_err(|error: ConfigError| CliError::Usage(error.into()))
}
