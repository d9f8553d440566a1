//! Universal file format, data set 58 (function at nodal degree of freedom), text form, as defined by
//! the Structural Dynamics Research Lab, University of Cincinnati: one block a channel, its name in the
//! first identification line.

use super::lines::BoundedLines;
use super::{Columns, DataError, Kind, Record, Role, format, io};
use std::io::{BufRead, BufReader, Write};
use std::path::Path;

/// Reads all blocks of real, evenly spaced data; other blocks are left out and named.
pub(super) fn read(path: &Path) -> Result<Columns, DataError> {
    let file = std::fs::File::open(path).map_err(io(path))?;
    let mut lines = Lines {
        path,
        reader: BufReader::with_capacity(1 << 20, BoundedLines::new(file)),
        number: 0,
        buffer: Vec::new(),
    };
    let mut columns = Columns::default();
    let mut start_s = None;
    while let Some(line) = lines.next()? {
        if line.trim() != "-1" {
            continue;
        }
        let Some(kind) = lines.next()? else { break };
        if kind.trim() != "58" {
            if kind.trim_start().starts_with("58b") {
                return Err(lines.wrong("binary blocks (58b) are not read; export them as text (58)"));
            }
            while let Some(line) = lines.next()? {
                if line.trim() == "-1" {
                    break;
                }
            }
            continue;
        }
        let block = Block::read(&mut lines)?;
        if columns.sample_rate_hz.is_some_and(|rate| (rate * block.interval_s - 1.0).abs() > 1e-5) {
            return Err(lines.wrong("the blocks do not share one sampling rate"));
        }
        columns.sample_rate_hz = Some(rate_hz(block.interval_s));
        start_s = start_s.or(Some(block.start_s));
        columns.kind = columns.kind.or(block.kind);
        columns.push_with_unit(block.name, block.values, block.unit);
    }
    if let Some(start_s) = start_s.filter(|start| *start != 0.0) {
        columns.notes.push(format!("time counts from {start_s} s of the file"));
    }
    Ok(columns)
}

/// The shortest number whose interval the format, with its six digits, would have written as this one.
fn rate_hz(interval_s: f64) -> f64 {
    let rate_hz = 1.0 / interval_s;
    (0..9)
        .map(|digits| {
            let scale = 10f64.powi(digits - rate_hz.log10().floor() as i32);
            (rate_hz * scale).round() / scale
        })
        .find(|short| (short * interval_s - 1.0).abs() < 5e-6)
        .unwrap_or(rate_hz)
}

/// Lines with their number, of bounded length.
struct Lines<'a> {
    path: &'a Path,
    reader: BufReader<BoundedLines<std::fs::File>>,
    number: usize,
    buffer: Vec<u8>,
}

impl Lines<'_> {
    fn next(&mut self) -> Result<Option<String>, DataError> {
        self.buffer.clear();
        self.number += 1;
        if self.reader.read_until(b'\n', &mut self.buffer).map_err(io(self.path))? == 0 {
            return Ok(None);
        }
        let text = String::from_utf8_lossy(&self.buffer);
        Ok(Some(text.trim_end_matches(['\r', '\n']).to_owned()))
    }

    fn need(&mut self) -> Result<String, DataError> {
        match self.next()? {
            Some(line) => Ok(line),
            None => Err(self.wrong("the file ends in the middle of a block")),
        }
    }

    fn wrong(&self, reason: &str) -> DataError {
        format(self.path)(&std::format!("line {}: {reason}", self.number))
    }
}

struct Block {
    name: String,
    kind: Option<Kind>,
    unit: Option<String>,
    start_s: f64,
    interval_s: f64,
    values: Vec<f64>,
}

impl Block {
    fn read(lines: &mut Lines) -> Result<Self, DataError> {
        let name = lines.need()?.trim().to_owned();
        let second = lines.need()?;
        let kind = second.trim().strip_suffix(" record").and_then(Kind::of_name);
        for _ in 0..4 {
            lines.need()?;
        }
        // Record 7: data type, number, spacing, first abscissa, increment.
        let form = lines.need()?;
        let field = |range: std::ops::Range<usize>| form.get(range).unwrap_or("").trim().to_owned();
        let (form_of, number, spacing) = (field(0..10), field(10..20), field(20..30));
        let start_s: f64 = field(30..43).parse().unwrap_or(0.0);
        let interval_s: f64 = field(43..56).parse().unwrap_or(f64::NAN);
        if !matches!(form_of.as_str(), "2" | "4") || spacing != "1" {
            return Err(lines.wrong("only real data of even spacing make a channel"));
        }
        if !(interval_s.is_finite() && interval_s > 0.0) {
            return Err(lines.wrong("the sampling interval must be positive"));
        }
        let Ok(number) = number.parse::<usize>() else {
            return Err(lines.wrong("the number of samples cannot be read"));
        };
        // Records 8 to 11: the axes; 9 is the ordinate, its unit in the columns 48 to 67.
        lines.need()?;
        let ordinate = lines.need()?;
        let unit = ordinate.get(47..).map(|unit| unit.get(..20).unwrap_or(unit).trim().to_owned());
        for _ in 0..2 {
            lines.need()?;
        }
        let width = if form_of == "4" { 20 } else { 13 };
        let mut values = Vec::new();
        loop {
            let line = lines.need()?;
            if line.trim() == "-1" && values.len() >= number {
                break;
            }
            for cell in line.as_bytes().chunks(width) {
                let text = std::str::from_utf8(cell).unwrap_or("").trim();
                if !text.is_empty() && values.len() < number {
                    values.push(text.parse().unwrap_or(f64::NAN));
                }
            }
        }
        Ok(Self { name, kind, unit, start_s, interval_s, values })
    }
}

/// Writes a block a channel in double precision (12 decimals of the mantissa, as the format has it).
pub(super) fn write(record: &Record, path: &Path) -> Result<(), DataError> {
    let file = std::fs::File::create(path).map_err(io(path))?;
    let mut out = std::io::BufWriter::with_capacity(1 << 20, file);
    let mut blocks = || {
        let mut node = 0;
        for (role, values) in record.channels().filter(|(role, _)| *role != Role::Time) {
            node += 1;
            block(&mut out, record, role, node, values.iter().copied(), values.len())?;
        }
        if !record.step.is_empty() {
            let steps = record.step.iter().map(|step| f64::from(*step));
            block(&mut out, record, Role::Step, node + 1, steps, record.step.len())?;
        }
        out.flush()
    };
    blocks().map_err(io(path))
}

fn block(
    out: &mut impl Write,
    record: &Record,
    role: Role,
    node: u32,
    values: impl Iterator<Item = f64>,
    number: usize,
) -> std::io::Result<()> {
    // Specific data types of the format: 8 displacement, 12 acceleration, 13 excitation force, 0 unknown.
    let quantity = match role.unit() {
        "m" => 8,
        "m/s2" => 12,
        "N" => 13,
        _ => 0,
    };
    let start_s = record.time_s.first().copied().unwrap_or(0.0);
    let interval_s = 1.0 / record.sample_rate_hz;
    writeln!(out, "{:>6}\n{:>6}\n{:<80}", -1, 58, role.name())?;
    writeln!(out, "{:<80}", std::format!("{:?} record", record.kind).to_lowercase())?;
    writeln!(out, "{:<80}\n{:<80}\n{:<80}", "NONE", "NONE", "NONE")?;
    writeln!(
        out,
        "{:>5}{:>10}{:>5}{:>10} {:<10}{:>10}{:>4} {:<10}{:>10}{:>4}",
        1, node, 0, 0, "NONE", node, 1, "NONE", 0, 0
    )?;
    let (start, interval) = (exponent(start_s, 5), exponent(interval_s, 5));
    writeln!(out, "{:>10}{number:>10}{:>10}{start:>13}{interval:>13}{:>13}", 4, 1, exponent(0.0, 5))?;
    let axis = |kind: u32, label: &str, unit: &str| {
        std::format!("{kind:>10}{:>5}{:>5}{:>5} {label:<20} {unit:<20}", 0, 0, 0)
    };
    writeln!(out, "{}", axis(17, "time", "s"))?;
    writeln!(out, "{}", axis(quantity, role.name().get(..20).unwrap_or(role.name()), role.unit()))?;
    writeln!(out, "{}\n{}", axis(0, "NONE", "NONE"), axis(0, "NONE", "NONE"))?;
    for (i, value) in values.enumerate() {
        let end = if i % 4 == 3 || i + 1 == number { "\n" } else { "" };
        write!(out, "{:>20}{end}", exponent(value, 12))?;
    }
    writeln!(out, "{:>6}", -1)
}

/// Fortran's E format: a sign and two digits of exponent at least.
fn exponent(value: f64, decimals: usize) -> String {
    let text = std::format!("{value:.decimals$E}");
    match text.split_once('E') {
        Some((mantissa, power)) => {
            let power: i32 = power.parse().unwrap_or(0);
            let sign = if power < 0 { '-' } else { '+' };
            std::format!("{mantissa}E{sign}{:02}", power.abs())
        }
        None => text,
    }
}
