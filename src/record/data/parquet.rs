//! Apache Parquet through its column interface.

use super::{Columns, DataError, Kind, Record, format, io};
use ::parquet::basic::{Compression, LogicalType, Repetition, Type as Physical, ZstdLevel};
use ::parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use ::parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, Int32Type};
use ::parquet::errors::ParquetError;
use ::parquet::file::metadata::KeyValue;
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
    let stated = reader.metadata().file_metadata().key_value_metadata();
    let stated = |key: &str| stated?.iter().find(|pair| pair.key == key)?.value.clone();
    columns.kind = stated("kind").as_deref().and_then(Kind::of_name);
    let mut budget = super::most_decoded_bytes(path)?;
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
            // Checked as it comes: what a header claims is not what a page holds.
            if values.len() as u64 * 8 > budget {
                let (name, allowed) = (column.path().string(), budget >> 20);
                return Err(format(path)(&std::format!("`{name}` holds more than {allowed} MB of numbers")));
            }
        }
        budget -= values.len() as u64 * 8;
        let name = column.path().string();
        let unit = stated(&std::format!("unit:{name}"));
        columns.push_with_unit(name, values, unit);
    }
    Ok(columns)
}

/// Appends one column chunk.
pub(super) fn take<T: DataType>(
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

/// One column to be written.
pub(super) enum Column<'a> {
    /// Doubles.
    Doubles(&'a [f64]),
    /// 32-bit integers.
    Integers(&'a [i32]),
    /// UTF-8 text.
    Texts(&'a [ByteArray]),
}

/// Writes all channels as doubles and the step as 32-bit integers, Zstandard-compressed.
pub(super) fn write(record: &Record, path: &Path) -> Result<(), DataError> {
    let mut columns: Vec<(&str, Column)> =
        record.channels().map(|(role, values)| (role.name(), Column::Doubles(values))).collect();
    if !record.step.is_empty() {
        columns.push(("step", Column::Integers(&record.step)));
    }
    let mut said = vec![
        ("kind".to_owned(), record.kind.name().to_owned()),
        ("sample_rate_hz".to_owned(), record.sample_rate_hz.to_string()),
    ];
    said.extend(
        record.channels().map(|(role, _)| (std::format!("unit:{}", role.name()), role.unit().to_owned())),
    );
    write_columns(&columns, record.len(), &said, path)
}

/// Writes named columns, all of `length` rows, and what is said of the file in pairs of key and value.
pub(super) fn write_columns(
    columns: &[(&str, Column)],
    length: usize,
    said: &[(String, String)],
    path: &Path,
) -> Result<(), DataError> {
    let file = std::fs::File::create(path).map_err(io(path))?;
    write_to(columns, length, said, file).map_err(|error| format(path)(&error))
}

fn write_to(
    columns: &[(&str, Column)],
    length: usize,
    said: &[(String, String)],
    file: std::fs::File,
) -> Result<(), ParquetError> {
    let field = |(name, column): &(&str, Column)| {
        let (physical, logical) = match column {
            Column::Doubles(_) => (Physical::DOUBLE, None),
            Column::Integers(_) => (Physical::INT32, None),
            Column::Texts(_) => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        };
        let field = Type::primitive_type_builder(name, physical).with_logical_type(logical);
        field.with_repetition(Repetition::REQUIRED).build().map(Arc::new)
    };
    let fields = columns.iter().map(field).collect::<Result<Vec<_>, _>>()?;
    let schema = Arc::new(Type::group_type_builder("record").with_fields(fields).build()?);
    // Measured numbers hardly repeat: a dictionary only costs time.
    let properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(1)?))
        .set_dictionary_enabled(false)
        .set_key_value_metadata(Some(
            said.iter().map(|(key, value)| KeyValue::new(key.clone(), value.clone())).collect(),
        ))
        .set_statistics_enabled(EnabledStatistics::Chunk)
        .build();
    let mut writer = SerializedFileWriter::new(file, schema, Arc::new(properties))?;
    for start in (0..length).step_by(GROUP) {
        let rows = start..(start + GROUP).min(length);
        let mut group = writer.next_row_group()?;
        for (_, values) in columns {
            let Some(mut column) = group.next_column()? else { break };
            match values {
                Column::Doubles(v) => {
                    column.typed::<DoubleType>().write_batch(&v[rows.clone()], None, None)?
                }
                Column::Integers(v) => {
                    column.typed::<Int32Type>().write_batch(&v[rows.clone()], None, None)?
                }
                Column::Texts(v) => {
                    column.typed::<ByteArrayType>().write_batch(&v[rows.clone()], None, None)?
                }
            };
            column.close()?;
        }
        group.close()?;
    }
    writer.close()?;
    Ok(())
}
