//! HDF5: a data set a channel (at the root or in one group, as MATLAB v7.3 has it too) or one compound
//! data set.

use super::{Columns, DataError, Kind, Record, format};
use hdf5_pure::{AttrValue, DType, Dataset, Datatype, File, FileBuilder};
use std::collections::HashMap;
use std::path::Path;

/// Reads every numeric one-dimensional data set (or MATLAB's `1 x n`) and compound field.
pub(super) fn read(path: &Path) -> Result<Columns, DataError> {
    let wrong = |error: hdf5_pure::Error| format(path)(&error);
    let file = File::open_streaming(path).map_err(wrong)?;
    let root = file.root();
    let mut columns = Columns::default();
    let rate =
        |attributes: HashMap<String, AttrValue>| attributes.get("sample_rate_hz").and_then(AttrValue::as_f64);
    let stated = root.attrs().unwrap_or_default();
    columns.kind = text_of(&stated, &["kind"]).as_deref().and_then(Kind::of_name);
    columns.sample_rate_hz = rate(stated);
    let mut groups = vec![root];
    // One level down: a MATLAB structure or a group a run.
    for name in groups[0].groups().map_err(wrong)? {
        if !name.starts_with('#') {
            groups.push(groups[0].group(&name).map_err(wrong)?);
        }
    }
    let mut budget = super::most_decoded_bytes(path)?;
    for group in &groups {
        for name in group.datasets().map_err(wrong)? {
            let dataset = group.dataset(&name).map_err(wrong)?;
            if columns.sample_rate_hz.is_none() {
                columns.sample_rate_hz = dataset.attrs().ok().and_then(rate);
            }
            take(path, &name, &dataset, &mut budget, &mut columns)?;
        }
        if !columns.names.is_empty() {
            break;
        }
    }
    Ok(columns)
}

/// A text attribute by one of its names.
fn text_of(attributes: &HashMap<String, AttrValue>, names: &[&str]) -> Option<String> {
    names.iter().find_map(|name| match attributes.get(*name)? {
        AttrValue::String(text) | AttrValue::AsciiString(text) => Some(text.trim().to_owned()),
        _ => None,
    })
}

/// Adds one data set when it is a column or a table.
fn take(
    path: &Path,
    name: &str,
    dataset: &Dataset,
    budget: &mut u64,
    columns: &mut Columns,
) -> Result<(), DataError> {
    let wrong = |error: hdf5_pure::Error| format(path)(&error);
    let shape = dataset.shape().map_err(wrong)?;
    let count = shape.iter().try_fold(1u64, |product, extent| product.checked_mul(*extent));
    let bytes = count.and_then(|count| count.checked_mul(dataset.element_size().ok()?));
    match bytes {
        Some(bytes) if bytes <= *budget => *budget -= bytes,
        _ => {
            let claimed = bytes.map_or("too much".to_owned(), |bytes| std::format!("{} MB", bytes >> 20));
            let allowed = *budget >> 20;
            return Err(format(path)(&std::format!(
                "`{name}` claims {claimed} of data; allowed: {allowed} MB"
            )));
        }
    }
    if name == "kind" && dataset.dtype().is_ok_and(|kind| kind == DType::U16) && bytes < Some(64) {
        // MATLAB's text: a number a character.
        let text: String =
            dataset.read_u16().map_err(wrong)?.iter().filter_map(|c| char::from_u32(u32::from(*c))).collect();
        columns.kind = columns.kind.or(Kind::of_name(&text));
        return Ok(());
    }
    // More than one extent above 1 is a matrix, not a channel.
    if shape.iter().filter(|extent| **extent > 1).count() > 1 || count == Some(0) {
        return Ok(());
    }
    let values = match dataset.dtype().map_err(wrong)? {
        DType::Compound(_) => return take_table(path, dataset, columns),
        DType::F64 => dataset.read_f64().map_err(wrong)?,
        DType::F32 => widen(dataset.read_f32().map_err(wrong)?),
        DType::I8 => widen(dataset.read_i8().map_err(wrong)?),
        DType::I16 => widen(dataset.read_i16().map_err(wrong)?),
        DType::I32 => widen(dataset.read_i32().map_err(wrong)?),
        DType::U8 => widen(dataset.read_u8().map_err(wrong)?),
        DType::U16 => widen(dataset.read_u16().map_err(wrong)?),
        DType::U32 => widen(dataset.read_u32().map_err(wrong)?),
        DType::I64 => dataset.read_i64().map_err(wrong)?.into_iter().map(|v| v as f64).collect(),
        DType::U64 => dataset.read_u64().map_err(wrong)?.into_iter().map(|v| v as f64).collect(),
        _ => return Ok(()),
    };
    match (name, values.as_slice()) {
        ("sample_rate_hz", [rate_hz]) => columns.sample_rate_hz = Some(*rate_hz),
        // A lone number beside the channels is a parameter.
        (_, [_]) => {}
        _ => {
            let unit = text_of(&dataset.attrs().unwrap_or_default(), &["unit", "units"]);
            columns.push_with_unit(name, values, unit);
        }
    }
    Ok(())
}

fn widen<T: Into<f64>>(values: Vec<T>) -> Vec<f64> {
    values.into_iter().map(Into::into).collect()
}

/// Adds the numeric fields of a compound data set.
fn take_table(path: &Path, dataset: &Dataset, columns: &mut Columns) -> Result<(), DataError> {
    let wrong = |error: hdf5_pure::Error| format(path)(&error);
    let Datatype::Compound { size, members } = dataset.datatype().map_err(wrong)? else { return Ok(()) };
    let DType::Compound(fields) = dataset.dtype().map_err(wrong)? else { return Ok(()) };
    let raw = dataset.read_raw().map_err(wrong)?;
    let size = size.max(1) as usize;
    for (member, (name, kind)) in members.iter().zip(&fields) {
        let big = match &member.datatype {
            Datatype::FixedPoint { byte_order, .. } | Datatype::FloatingPoint { byte_order, .. } => {
                std::format!("{byte_order:?}").starts_with("Big")
            }
            _ => continue,
        };
        let offset = member.byte_offset as usize;
        let Some(decode) = decoder(kind, big) else { continue };
        let values: Option<Vec<f64>> =
            raw.chunks_exact(size).map(|row| row.get(offset..).and_then(&*decode)).collect();
        match values {
            Some(values) => columns.push(name, values),
            None => return Err(format(path)(&std::format!("field `{name}` reaches past its row"))),
        }
    }
    Ok(())
}

type Decode = dyn Fn(&[u8]) -> Option<f64>;

/// From the bytes of a field to its number.
fn decoder(kind: &DType, big: bool) -> Option<Box<Decode>> {
    macro_rules! number {
        ($type:ty) => {
            Box::new(move |bytes: &[u8]| {
                let bytes = bytes.first_chunk()?;
                Some(if big { <$type>::from_be_bytes(*bytes) } else { <$type>::from_le_bytes(*bytes) } as f64)
            })
        };
    }
    Some(match kind {
        DType::F64 => number!(f64),
        DType::F32 => number!(f32),
        DType::I8 => number!(i8),
        DType::I16 => number!(i16),
        DType::I32 => number!(i32),
        DType::I64 => number!(i64),
        DType::U8 => number!(u8),
        DType::U16 => number!(u16),
        DType::U32 => number!(u32),
        DType::U64 => number!(u64),
        _ => return None,
    })
}

/// Writes a data set a channel, each with its unit as attribute.
pub(super) fn write(record: &Record, path: &Path) -> Result<(), DataError> {
    let mut builder = FileBuilder::new();
    builder.set_attr("sample_rate_hz", AttrValue::F64(record.sample_rate_hz));
    builder.set_attr("kind", AttrValue::String(record.kind.name().to_owned()));
    for (role, values) in record.channels() {
        let dataset = builder.create_dataset(role.name()).with_f64_data(values);
        dataset.set_attr("unit", AttrValue::String(role.unit().to_owned()));
    }
    if !record.step.is_empty() {
        builder.create_dataset("step").with_i32_data(&record.step);
    }
    builder.write(path).map_err(|error| format(path)(&error))
}
