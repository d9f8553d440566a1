//! A data file described by a small TOML: what its columns are, in which units and signs, and what kind of
//! record it is. `--columns FILE` names one; the sidecar that is written beside a CSV is one too, and is
//! found by itself.

use super::{DataError, Kind, Mapping, ReadOptions, Role, format, io};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Longest description that is read, bytes.
const MOST_BYTES: u64 = 1 << 20;

/// The whole description.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Description {
    /// Where the record came from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// Kind of record.
    pub kind: Option<Kind>,
    /// Sampling rate, Hz.
    pub sample_rate_hz: Option<f64>,
    /// Number of samples, for information.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub samples: Option<usize>,
    /// What was repaired before, for information.
    #[serde(default)]
    pub notes: Vec<String>,
    /// The columns.
    #[serde(default)]
    pub columns: Vec<Column>,
}

/// One column.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Column {
    /// Its name in the file.
    pub name: String,
    /// What it is; its name when left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub role: Option<String>,
    /// Unit of the stored numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// Stored numbers times this are in the unit.
    #[serde(default = "one")]
    pub calibration: f64,
    /// -1 for a sensor that looks the other way.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub sign: f64,
}

fn one() -> f64 {
    1.0
}

fn is_one(value: &f64) -> bool {
    *value == 1.0
}

/// Name of the sidecar of a data file.
pub(super) fn sidecar(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".toml");
    PathBuf::from(name)
}

impl Description {
    fn read(path: &Path) -> Result<Self, DataError> {
        use std::io::Read;
        let file = std::fs::File::open(path).map_err(io(path))?;
        let mut text = String::new();
        file.take(MOST_BYTES).read_to_string(&mut text).map_err(io(path))?;
        toml::from_str(&text).map_err(|error| format(path)(&error))
    }

    fn mappings(&self, path: &Path) -> Result<Vec<Mapping>, DataError> {
        let wrong = |reason: String| format(path)(&reason);
        let mapping = |column: &Column| {
            let role: Role = column.role.as_ref().unwrap_or(&column.name).parse().map_err(wrong)?;
            if column.sign.abs() != 1.0 || !(column.calibration.is_finite() && column.calibration != 0.0) {
                return Err(wrong(std::format!(
                    "column `{}`: sign must be 1 or -1, calibration a number other than 0",
                    column.name
                )));
            }
            let mut mapping = Mapping::new(role, &column.name);
            mapping.factor = column.sign * column.calibration;
            if let Some(unit) = &column.unit {
                mapping.factor *= role.factor(unit).ok_or_else(|| {
                    wrong(std::format!("column `{}`: `{unit}` is no unit of {}", column.name, role.name()))
                })?;
                mapping.unit_known = true;
            }
            Ok(mapping)
        };
        self.columns.iter().map(mapping).collect()
    }
}

impl ReadOptions {
    /// Takes in what a description file says; what was given before has precedence.
    ///
    /// # Errors
    /// [`DataError`] when the file cannot be read, has unknown keys, or names what is no role or unit.
    pub fn describe(&mut self, path: &Path) -> Result<(), DataError> {
        let description = Description::read(path)?;
        for mapping in description.mappings(path)? {
            if self.map.iter().all(|given| given.role != mapping.role) {
                self.map.push(mapping);
            }
        }
        self.kind = self.kind.or(description.kind);
        self.sample_rate_hz = self.sample_rate_hz.or(description.sample_rate_hz);
        Ok(())
    }
}

/// The options with what the sidecar of a file says, if it has one; columns that are not there are left out,
/// as the options may name others in their place.
pub(super) fn with_sidecar(path: &Path, options: &ReadOptions) -> Result<ReadOptions, DataError> {
    let mut options = options.clone();
    let sidecar = sidecar(path);
    if options.map.is_empty() && sidecar.is_file() {
        options.describe(&sidecar)?;
    }
    Ok(options)
}
