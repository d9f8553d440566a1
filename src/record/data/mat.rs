//! MATLAB v7.3 files: a column vector a channel, `sample_rate_hz`, `kind`, `source`,
//! and a structure `unit` with the unit of each. They are read by
//! the HDF5 reader.

use super::{DataError, Record, format};
use hdf5_pure::mat::{MatBuilder, MatError, Options};
use std::path::Path;

/// Writes a record.
pub(super) fn write(record: &Record, path: &Path) -> Result<(), DataError> {
    write_to(record, path).map_err(|error| format(path)(&error))
}

fn write_to(record: &Record, path: &Path) -> Result<(), MatError> {
    let mut builder = MatBuilder::new(Options::default());
    let rows = record.len();
    for (role, values) in record.channels() {
        builder.write_f64(role.name(), &[rows, 1], values)?;
    }
    if !record.step.is_empty() {
        builder.write_i32("step", &[rows, 1], &record.step)?;
    }
    builder.write_scalar_f64("sample_rate_hz", record.sample_rate_hz)?;
    builder.write_char("kind", record.kind.name())?;
    builder.struct_("unit", |units| {
        for (role, _) in record.channels() {
            units.write_char(role.name(), role.unit())?;
        }
        Ok(())
    })?;
    builder.write_char("source", &record.source)?;
    builder.write(path)
}
