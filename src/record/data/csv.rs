//! Comma-, semicolon- or tab-separated values with a header row.

use super::describe::{self, Column, Description};
use super::lines::BoundedLines;
use super::{Columns, DataError, Record, format, io};
use std::io::{BufRead, BufReader, Write};
use std::path::Path;

/// Reads every column. A cell that is empty or no number is "no number" in the column; a column
/// without any number is left out.
pub(super) fn read(path: &Path) -> Result<Columns, DataError> {
    let file = std::fs::File::open(path).map_err(io(path))?;
    let mut buffered = BufReader::with_capacity(1 << 20, BoundedLines::new(file));
    let delimiter = delimiter(buffered.fill_buf().map_err(io(path))?);
    let mut reader = ::csv::ReaderBuilder::new()
        .delimiter(delimiter)
        .comment(Some(b'#'))
        .flexible(true)
        .trim(::csv::Trim::All)
        .from_reader(buffered);
    let head = reader.byte_headers().map_err(|error| format(path)(&error))?.clone();
    let mut names: Vec<String> = head
        .iter()
        .map(|name| String::from_utf8_lossy(name).trim_start_matches('\u{feff}').to_owned())
        .collect();
    if names.iter().all(|name| name.parse::<f64>().is_ok()) {
        return Err(format(path)(&"the first row must name the columns"));
    }
    let mut values = vec![Vec::new(); names.len()];
    let mut row = ::csv::ByteRecord::new();
    let (mut ragged, mut rows) = (0usize, 0usize);
    while reader.read_byte_record(&mut row).map_err(|error| format(path)(&error))? {
        rows += 1;
        if row.len() != names.len() {
            // The last line of a file cut short, mostly.
            ragged += 1;
            continue;
        }
        for (column, cell) in values.iter_mut().zip(row.iter()) {
            column.push(number(cell, delimiter));
        }
    }
    if ragged * 10 > rows {
        let width = names.len();
        return Err(format(path)(&format!(
            "{ragged} of {rows} rows do not have the {width} cells of the header"
        )));
    }
    let mut columns = Columns::default();
    for (name, column) in names.drain(..).zip(values) {
        if column.iter().any(|value: &f64| !value.is_nan()) {
            columns.push(name, column);
        }
    }
    if ragged > 0 {
        columns.notes.push(format!("{ragged} incomplete rows were left out"));
    }
    Ok(columns)
}

/// The separator that the header has most of.
fn delimiter(start: &[u8]) -> u8 {
    let header = start.split(|byte| *byte == b'\n').find(|line| !line.starts_with(b"#")).unwrap_or(start);
    let count = |byte: u8| header.iter().filter(|found| **found == byte).count();
    [b',', b';', b'\t'].into_iter().max_by_key(|byte| (count(*byte), *byte == b',')).unwrap_or(b',')
}

fn number(cell: &[u8], delimiter: u8) -> f64 {
    let Ok(text) = std::str::from_utf8(cell) else { return f64::NAN };
    match text.parse() {
        Ok(value) => value,
        // A decimal comma can only stand where commas do not separate.
        Err(_) if delimiter != b',' => text.replace(',', ".").parse().unwrap_or(f64::NAN),
        Err(_) => f64::NAN,
    }
}

/// Writes all channels, numbers in the shortest form that reads back exactly, and beside the file a
/// sidecar `<file>.toml` that names units, rate and kind.
pub(super) fn write(record: &Record, path: &Path) -> Result<(), DataError> {
    let file = std::fs::File::create(path).map_err(io(path))?;
    let mut out = std::io::BufWriter::with_capacity(1 << 20, file);
    let channels: Vec<_> = record.channels().collect();
    let mut head: Vec<&str> = channels.iter().map(|(role, _)| role.name()).collect();
    if !record.step.is_empty() {
        head.push("step");
    }
    let mut rows = || {
        writeln!(out, "{}", head.join(","))?;
        for i in 0..record.len() {
            for (k, (_, values)) in channels.iter().enumerate() {
                let comma = if k == 0 { "" } else { "," };
                write!(out, "{comma}{}", values[i])?;
            }
            match record.step.get(i) {
                Some(step) => writeln!(out, ",{step}")?,
                None => writeln!(out)?,
            }
        }
        out.flush()
    };
    rows().map_err(io(path))?;
    write_sidecar(record, path)
}

fn write_sidecar(record: &Record, path: &Path) -> Result<(), DataError> {
    let columns =
        record.channels().map(|(role, _)| role).chain((!record.step.is_empty()).then_some(super::Role::Step));
    let column = |role: super::Role| Column {
        name: role.name().to_owned(),
        role: None,
        unit: Some(role.unit().to_owned()),
        calibration: 1.0,
        sign: 1.0,
    };
    let description = Description {
        source: Some(record.source.clone()),
        kind: Some(record.kind),
        sample_rate_hz: Some(record.sample_rate_hz),
        samples: Some(record.len()),
        notes: record.notes.clone(),
        columns: columns.map(column).collect(),
    };
    let sidecar = describe::sidecar(path);
    let text = toml::to_string(&description).map_err(|error| format(&sidecar)(&error))?;
    std::fs::write(&sidecar, text).map_err(io(&sidecar))
}
