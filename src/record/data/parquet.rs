//! Apache Parquet through its column interface.

use super::{Columns, DataError, Record, format, io};
use ::parquet::basic::{Compression, Type as Physical, ZstdLevel};
use ::parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use ::parquet::data_type::{DataType, DoubleType, Int32Type};
use ::parquet::errors::ParquetError;
use ::parquet::file::properties::{EnabledStatistics, WriterProperties};
use ::parquet::file::reader::{FileReader, SerializedFileReader};
use ::parquet::file::writer::SerializedFileWriter;
use ::parquet::schema::types::Type;
use std::path::Path;
use std::sync::Arc;

/// Values decoded at a time: memory follows what is there, not what a header claims.
const BATCH: usize = 1 << 16;
/// Rows of a written row group.
const GROUP: usize = 1 << 18;

/// Reads every numeric column at the top level; nulls are "no number".
pub(super) fn read(path: &Path) -> Result<Columns, DataError> {
    let wrong = |error: ParquetError| format(path)(&error);
    let file = std::fs::File::open(path).map_err(io(path))?;
    let reader = SerializedFileReader::new(file).map_err(wrong)?;
    let schema = reader.metadata().file_metadata().schema_descr_ptr();
    let mut columns = Columns::default();
    for (index, column) in schema.columns().iter().enumerate() {
        let numeric = matches!(
            column.physical_type(),
            Physical::BOOLEAN | Physical::INT32 | Physical::INT64 | Physical::FLOAT | Physical::DOUBLE
        );
        if !numeric || column.max_rep_level() > 0 {
            continue;
        }
        let mut values = Vec::new();
        for group in 0..reader.num_row_groups() {
            let group = reader.get_row_group(group).map_err(wrong)?;
            let levels = column.max_def_level();
            match group.get_column_reader(index).map_err(wrong)? {
                ColumnReader::DoubleColumnReader(reader) => take(reader, levels, &mut values, |v| v),
                ColumnReader::FloatColumnReader(reader) => take(reader, levels, &mut values, f64::from),
                ColumnReader::Int32ColumnReader(reader) => take(reader, levels, &mut values, f64::from),
                ColumnReader::Int64ColumnReader(reader) => take(reader, levels, &mut values, |v| v as f64),
                ColumnReader::BoolColumnReader(reader) => {
                    take(reader, levels, &mut values, |v| f64::from(u8::from(v)))
                }
                _ => Ok(()),
            }
            .map_err(wrong)?;
        }
        columns.push(column.path().string(), values);
    }
    Ok(columns)
}

/// Appends one column chunk.
fn take<T: DataType>(
    mut reader: ColumnReaderImpl<T>,
    most_level: i16,
    values: &mut Vec<f64>,
    to_f64: impl Fn(T::T) -> f64,
) -> Result<(), ParquetError> {
    let mut batch = Vec::new();
    let mut levels = Vec::new();
    loop {
        batch.clear();
        levels.clear();
        let defined = (most_level > 0).then_some(&mut levels);
        let (records, _, _) = reader.read_records(BATCH, defined, None, &mut batch)?;
        if records == 0 {
            return Ok(());
        }
        if most_level == 0 || batch.len() == records {
            values.extend(batch.drain(..).map(&to_f64));
            continue;
        }
        let mut present = batch.drain(..);
        for level in &levels {
            let value = (*level == most_level).then(|| present.next()).flatten();
            values.push(value.map_or(f64::NAN, &to_f64));
        }
    }
}

/// Writes all channels as doubles and the step as 32-bit integers, Zstandard-compressed.
pub(super) fn write(record: &Record, path: &Path) -> Result<(), DataError> {
    let file = std::fs::File::create(path).map_err(io(path))?;
    write_to(record, file).map_err(|error| format(path)(&error))
}

fn write_to(record: &Record, file: std::fs::File) -> Result<(), ParquetError> {
    let channels: Vec<_> = record.channels().collect();
    let field = |name: &str, physical| {
        let field = Type::primitive_type_builder(name, physical);
        field.with_repetition(::parquet::basic::Repetition::REQUIRED).build().map(Arc::new)
    };
    let mut fields = channels
        .iter()
        .map(|(role, _)| field(role.name(), Physical::DOUBLE))
        .collect::<Result<Vec<_>, _>>()?;
    if !record.step.is_empty() {
        fields.push(field("step", Physical::INT32)?);
    }
    let schema = Arc::new(Type::group_type_builder("record").with_fields(fields).build()?);
    // Measured numbers hardly repeat: a dictionary only costs time.
    let properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(1)?))
        .set_dictionary_enabled(false)
        .set_statistics_enabled(EnabledStatistics::Chunk)
        .build();
    let mut writer = SerializedFileWriter::new(file, schema, Arc::new(properties))?;
    let length = record.len();
    for start in (0..length).step_by(GROUP) {
        let rows = start..(start + GROUP).min(length);
        let mut group = writer.next_row_group()?;
        for (_, values) in &channels {
            if let Some(mut column) = group.next_column()? {
                column.typed::<DoubleType>().write_batch(&values[rows.clone()], None, None)?;
                column.close()?;
            }
        }
        if !record.step.is_empty()
            && let Some(mut column) = group.next_column()?
        {
            column.typed::<Int32Type>().write_batch(&record.step[rows], None, None)?;
            column.close()?;
        }
        group.close()?;
    }
    writer.close()?;
    Ok(())
}
