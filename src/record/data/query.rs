//! Questions to a tree of many runs: which steps, or which peaks, under which conditions.
//!
//! `runs query` calls it. Partitions (date, case, run) that cannot match are not opened; the others are
//! read in parallel. Whatever needs more than filters and peaks is a matter for SQL on the same files.

use super::parquet::take;
use super::{DataError, content, format, io};
use crate::parallel;
use ::parquet::basic::Type as Physical;
use ::parquet::column::reader::ColumnReader;
use ::parquet::errors::ParquetError;
use ::parquet::file::reader::{FileReader, SerializedFileReader};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Columns that come from the folders.
const PARTITIONS: [&str; 3] = ["date", "case", "run"];
/// Columns that peaks are made of.
const PEAK_OF: [&str; 4] = ["direction", "frequency_hz", "a_max_m_s2", "excursion_m"];

/// One value of a table; a number that is none is `null` in JSON.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Cell {
    /// A number.
    Number(f64),
    /// Words.
    Text(String),
}

/// Named columns and rows of equal length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Answer {
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Rows.
    pub rows: Vec<Vec<Cell>>,
    /// Runs that were opened.
    pub runs: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Relation {
    Equal,
    Unequal,
    Less,
    AtMost,
    More,
    AtLeast,
}

/// A condition on a column: `case=B1-*`, `date>=2026-03-01`, `frequency_hz<2`.
///
/// Values that are numbers on both sides are compared as such, others as text; `*` in the text of `=` and
/// `!=` stands for anything.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    column: String,
    relation: Relation,
    value: String,
}

impl FromStr for Condition {
    type Err = DataError;

    fn from_str(text: &str) -> Result<Self, DataError> {
        // Longer signs first.
        let signs = [
            ("!=", Relation::Unequal),
            ("<=", Relation::AtMost),
            (">=", Relation::AtLeast),
            ("=", Relation::Equal),
            ("<", Relation::Less),
            (">", Relation::More),
        ];
        let found = signs
            .iter()
            .filter_map(|(sign, relation)| Some((text.find(sign)?, sign.len(), *relation)))
            .min_by_key(|(at, length, _)| (*at, std::cmp::Reverse(*length)));
        match found {
            Some((at, length, relation)) if at > 0 => Ok(Self {
                column: text[..at].trim().to_owned(),
                relation,
                value: text[at + length..].trim().to_owned(),
            }),
            _ => Err(DataError::Mapping {
                text: text.to_owned(),
                reason: "a condition reads `column=value`, with =, !=, <, <=, > or >=".to_owned(),
            }),
        }
    }
}

impl Condition {
    fn holds(&self, cell: &Cell) -> bool {
        let order = match (cell, self.value.parse::<f64>()) {
            (Cell::Number(x), Ok(y)) => x.partial_cmp(&y),
            (Cell::Number(_), Err(_)) => None,
            (Cell::Text(text), _) if self.value.contains('*') => {
                return match self.relation {
                    Relation::Equal => matches(&self.value, text),
                    Relation::Unequal => !matches(&self.value, text),
                    _ => false,
                };
            }
            (Cell::Text(text), _) => Some(text.as_str().cmp(&self.value)),
        };
        // What is no number fulfils nothing but `!=`.
        let Some(order) = order else { return self.relation == Relation::Unequal };
        match self.relation {
            Relation::Equal => order.is_eq(),
            Relation::Unequal => order.is_ne(),
            Relation::Less => order.is_lt(),
            Relation::AtMost => order.is_le(),
            Relation::More => order.is_gt(),
            Relation::AtLeast => order.is_ge(),
        }
    }
}

/// Whether a text fits a pattern in which `*` stands for anything.
fn matches(pattern: &str, text: &str) -> bool {
    let mut parts = pattern.split('*');
    let Some(mut rest) = parts.next().and_then(|first| text.strip_prefix(first)) else { return false };
    let Some(last) = parts.next_back() else { return rest.is_empty() };
    for part in parts {
        match rest.find(part) {
            Some(at) => rest = &rest[at + part.len()..],
            None => return false,
        }
    }
    rest.ends_with(last)
}

/// Steps of all runs of a tree that fulfil the conditions, ordered by date, case, run and step.
///
/// # Errors
/// [`DataError`] when the tree has no steps, a file cannot be read or a condition names no column.
pub fn steps(tree: &Path, conditions: &[Condition]) -> Result<Answer, DataError> {
    let top = tree.join("steps");
    if !top.is_dir() {
        return Err(content(tree, "no tree of runs: `steps` is missing; `export RUN --tree` makes one"));
    }
    let mut files = Vec::new();
    walk(&top, &mut Vec::new(), conditions, &mut files)?;
    files.sort();
    let tables = parallel::map(&files, parallel::cores(), read);
    let mut answer = Answer { runs: files.len(), ..Answer::default() };
    for table in tables {
        append(&mut answer, table?);
    }
    for condition in conditions {
        let at = column(&answer, tree, &condition.column)?;
        answer.rows.retain(|row| condition.holds(&row[at]));
    }
    Ok(answer)
}

/// The peaks of each run and direction: A_max with its frequency, and the largest excursion.
///
/// # Errors
/// As [`steps`], and when the steps lack a column that peaks are made of.
pub fn peaks(tree: &Path, conditions: &[Condition]) -> Result<Answer, DataError> {
    let steps = steps(tree, conditions)?;
    let mut names: Vec<&str> = PARTITIONS.to_vec();
    names.extend(["direction", "steps", "frequency_hz", "a_max_m_s2", "excursion_m"]);
    let mut answer = Answer { columns: names.iter().map(ToString::to_string).collect(), ..Answer::default() };
    answer.runs = steps.runs;
    if steps.rows.is_empty() {
        return Ok(answer);
    }
    let [direction, frequency, a_max, excursion] = PEAK_OF.map(|name| column(&steps, tree, name));
    let (direction, frequency, a_max, excursion) = (direction?, frequency?, a_max?, excursion?);
    let number = |row: &[Cell], at: usize| match row[at] {
        Cell::Number(x) => x,
        Cell::Text(_) => f64::NAN,
    };
    // Rows of a run and direction follow one another but for runs that turn back and forth.
    let mut groups: Vec<(Vec<&Cell>, Vec<&Vec<Cell>>)> = Vec::new();
    for row in &steps.rows {
        let key: Vec<&Cell> = row[..PARTITIONS.len()].iter().chain([&row[direction]]).collect();
        match groups.iter_mut().rev().take(2).find(|(known, _)| *known == key) {
            Some((_, rows)) => rows.push(row),
            None => groups.push((key, vec![row])),
        }
    }
    for (key, rows) in groups {
        let largest = |at: usize| {
            rows.iter().copied().max_by(|a, b| rank(number(a, at)).total_cmp(&rank(number(b, at))))
        };
        let (Some(top), Some(widest)) = (largest(a_max), largest(excursion)) else { continue };
        let mut row: Vec<Cell> = key.into_iter().cloned().collect();
        let figures =
            [rows.len() as f64, number(top, frequency), number(top, a_max), number(widest, excursion)];
        row.extend(figures.map(Cell::Number));
        answer.rows.push(row);
    }
    Ok(answer)
}

/// What is no number comes last.
fn rank(x: f64) -> f64 {
    if x.is_nan() { f64::NEG_INFINITY } else { x }
}

fn column(answer: &Answer, tree: &Path, name: &str) -> Result<usize, DataError> {
    answer.columns.iter().position(|column| column == name).ok_or_else(|| {
        content(tree, std::format!("no column `{name}`; there are {}", answer.columns.join(", ")))
    })
}

/// A file of the tree and the values of its partitions.
type Place = (Vec<(String, String)>, PathBuf);

/// Collects the files below a folder whose partitions can fulfil the conditions.
fn walk(
    folder: &Path,
    partitions: &mut Vec<(String, String)>,
    conditions: &[Condition],
    files: &mut Vec<Place>,
) -> Result<(), DataError> {
    for entry in std::fs::read_dir(folder).map_err(io(folder))? {
        let path = entry.map_err(io(folder))?.path();
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        if let Some((key, value)) = name.split_once('=').filter(|_| path.is_dir()) {
            let cell = Cell::Text(value.to_owned());
            if conditions.iter().all(|condition| condition.column != key || condition.holds(&cell)) {
                partitions.push((key.to_owned(), value.to_owned()));
                walk(&path, partitions, conditions, files)?;
                partitions.pop();
            }
        } else if name.ends_with(".parquet") && !name.starts_with('.') {
            files.push((partitions.clone(), path));
        }
    }
    Ok(())
}

/// One file with its partitions in front.
fn read((partitions, path): &Place) -> Result<Answer, DataError> {
    let wrong = |error: ParquetError| format(path)(&error);
    let file = std::fs::File::open(path).map_err(io(path))?;
    let reader = SerializedFileReader::new(file).map_err(wrong)?;
    let schema = reader.metadata().file_metadata().schema_descr_ptr();
    let mut columns: Vec<String> = PARTITIONS.map(str::to_owned).to_vec();
    let mut values: Vec<Vec<Cell>> = Vec::new();
    for (index, column) in schema.columns().iter().enumerate() {
        if column.max_rep_level() > 0 || column.physical_type() == Physical::FIXED_LEN_BYTE_ARRAY {
            continue;
        }
        let mut cells = Vec::new();
        for group in 0..reader.num_row_groups() {
            let group = reader.get_row_group(group).map_err(wrong)?;
            chunk(group.get_column_reader(index).map_err(wrong)?, column.max_def_level(), &mut cells)
                .map_err(wrong)?;
        }
        columns.push(column.path().string());
        values.push(cells);
    }
    let length = values.iter().map(Vec::len).min().unwrap_or(0);
    let front = PARTITIONS.map(|key| {
        let value = partitions.iter().find(|(name, _)| name == key).map(|(_, value)| value.clone());
        Cell::Text(value.unwrap_or_default())
    });
    let mut values: Vec<_> = values.into_iter().map(Vec::into_iter).collect();
    let rows = (0..length)
        .map(|_| front.iter().cloned().chain(values.iter_mut().filter_map(Iterator::next)).collect());
    Ok(Answer { columns, rows: rows.collect(), runs: 1 })
}

/// Appends the cells of one column chunk.
fn chunk(reader: ColumnReader, levels: i16, cells: &mut Vec<Cell>) -> Result<(), ParquetError> {
    let mut numbers = Vec::new();
    match reader {
        ColumnReader::DoubleColumnReader(reader) => take(reader, levels, &mut numbers, |v| v)?,
        ColumnReader::FloatColumnReader(reader) => take(reader, levels, &mut numbers, f64::from)?,
        ColumnReader::Int32ColumnReader(reader) => take(reader, levels, &mut numbers, f64::from)?,
        ColumnReader::Int64ColumnReader(reader) => take(reader, levels, &mut numbers, |v| v as f64)?,
        ColumnReader::BoolColumnReader(reader) => {
            take(reader, levels, &mut numbers, |v| f64::from(u8::from(v)))?;
        }
        ColumnReader::ByteArrayColumnReader(mut reader) => {
            let (mut words, mut defined) = (Vec::new(), Vec::new());
            while reader.read_records(1 << 12, (levels > 0).then_some(&mut defined), None, &mut words)?.0 > 0
            {
                let mut present = words.drain(..);
                let mut text = || present.next().map(|w| String::from_utf8_lossy(w.data()).into_owned());
                if levels == 0 {
                    cells.extend(std::iter::from_fn(&mut text).map(Cell::Text));
                } else {
                    let there = defined.iter().map(|level| (*level == levels).then(&mut text).flatten());
                    cells.extend(there.map(|word| Cell::Text(word.unwrap_or_default())));
                }
                drop(present);
                defined.clear();
            }
        }
        _ => {}
    }
    cells.extend(numbers.into_iter().map(Cell::Number));
    Ok(())
}

/// Adds a table; columns that one side lacks become "no number".
fn append(answer: &mut Answer, table: Answer) {
    if answer.columns.is_empty() {
        answer.columns.clone_from(&table.columns);
    }
    if answer.columns == table.columns {
        answer.rows.extend(table.rows);
        return;
    }
    for name in &table.columns {
        if !answer.columns.contains(name) {
            answer.columns.push(name.clone());
            answer.rows.iter_mut().for_each(|row| row.push(Cell::Number(f64::NAN)));
        }
    }
    let places: Vec<Option<usize>> =
        answer.columns.iter().map(|name| table.columns.iter().position(|other| other == name)).collect();
    let at = |row: &[Cell], place: &Option<usize>| place.and_then(|i| row.get(i).cloned());
    answer.rows.extend(
        table
            .rows
            .iter()
            .map(|row| places.iter().map(|place| at(row, place).unwrap_or(Cell::Number(f64::NAN))).collect()),
    );
}

#[cfg(test)]
mod tests {
    use super::super::parquet::{Column, write_columns};
    use super::*;
    use ::parquet::data_type::ByteArray;

    /// A tree of runs over cases and dates, forward then backward; A_max is told by run and step.
    fn tree(runs: usize, steps: usize) -> tempfile::TempDir {
        let out = tempfile::tempdir().expect("folder");
        for run in 0..runs {
            let case = ["B1-G2-0.05", "B1-G3-0.05", "B4-G1-0.03"][run % 3];
            let folder = out
                .path()
                .join(std::format!("steps/date=2026-03-{:02}/case={case}/run=r{run:04}", 1 + run % 28));
            std::fs::create_dir_all(&folder).expect("made");
            let half = steps / 2;
            let hz: Vec<f64> =
                (0..steps).map(|i| 0.5 + 0.1 * (if i < half { i } else { steps - 1 - i }) as f64).collect();
            let a: Vec<f64> = (0..steps).map(|i| run as f64 + if i == 3 { 0.5 } else { 0.0 }).collect();
            let e: Vec<f64> =
                (0..steps).map(|i| if i == steps - 2 { f64::NAN } else { 1e-3 * i as f64 }).collect();
            let way: Vec<ByteArray> =
                (0..steps).map(|i| ByteArray::from(if i < half { "forward" } else { "backward" })).collect();
            let index: Vec<i32> = (0..steps as i32).collect();
            let columns = [
                ("index", Column::Integers(&index)),
                ("direction", Column::Texts(&way)),
                ("frequency_hz", Column::Doubles(&hz)),
                ("a_max_m_s2", Column::Doubles(&a)),
                ("excursion_m", Column::Doubles(&e)),
            ];
            write(&columns, steps, &folder.join("steps.parquet"));
        }
        out
    }

    fn write(columns: &[(&str, Column)], steps: usize, path: &Path) {
        write_columns(columns, steps, &[], path).expect("written");
    }

    fn conditions(texts: &[&str]) -> Vec<Condition> {
        texts.iter().map(|text| text.parse().expect("condition")).collect()
    }

    #[test]
    fn steps_are_filtered_by_partition_and_by_value() {
        let tree = tree(12, 20);
        let all = steps(tree.path(), &[]).expect("read");
        assert_eq!((all.runs, all.rows.len()), (12, 240));
        assert_eq!(all.columns[..5], ["date", "case", "run", "index", "direction"]);
        let some = conditions(&["case=B1-*", "date<=2026-03-05", "frequency_hz<0.75", "direction!=forward"]);
        let found = steps(tree.path(), &some).expect("read");
        // Runs 0, 1, 3, 4 lie in the first five days and have a bumper B1; three steps each.
        assert_eq!((found.runs, found.rows.len()), (4, 12));
        assert!(found.rows.iter().all(|row| row[4] == Cell::Text("backward".into())));
    }

    #[test]
    fn peaks_are_those_of_each_direction() {
        let tree = tree(3, 20);
        let found = peaks(tree.path(), &[]).expect("read");
        assert_eq!(found.rows.len(), 6);
        let second = found.rows.iter().find(|row| row[2] == Cell::Text("r0001".into())).expect("there");
        assert_eq!(second[3], Cell::Text("forward".into()));
        // The last forward step is widest, the fourth has the peak; written as the tree computes them.
        assert_eq!(second[4..], [10.0, 0.5 + 0.1 * 3.0, 1.5, 1e-3 * 9.0].map(Cell::Number));
        // What is no number is no peak.
        let last = found.rows.last().expect("there");
        assert_eq!(last[7], Cell::Number(1e-3 * 19.0));
    }

    #[test]
    fn runs_with_other_columns_are_joined_by_name() {
        let tree = tree(2, 4);
        let folder = tree.path().join("steps/date=2026-12-01/case=none/run=other");
        std::fs::create_dir_all(&folder).expect("made");
        write(
            &[("index", Column::Integers(&[7])), ("extra", Column::Doubles(&[2.5]))],
            1,
            &folder.join("steps.parquet"),
        );
        let found = steps(tree.path(), &[]).expect("read");
        let (last, first) = (found.rows.last().expect("there"), &found.rows[0]);
        assert_eq!(found.columns.last().map(String::as_str), Some("extra"));
        assert_eq!(last.last(), Some(&Cell::Number(2.5)));
        assert!(matches!(first.last(), Some(Cell::Number(x)) if x.is_nan()));
        assert!(last.len() == first.len());
    }

    #[test]
    fn what_cannot_be_answered_is_said() {
        let tree = tree(1, 4);
        let error = |texts: &[&str]| steps(tree.path(), &conditions(texts)).expect_err("refused").to_string();
        assert!(error(&["a_max=3"]).contains("a_max_m_s2"), "{}", error(&["a_max=3"]));
        assert!("case".parse::<Condition>().is_err() && "=3".parse::<Condition>().is_err());
        assert!(steps(&tree.path().join("nowhere"), &[]).is_err());
        assert!(
            matches("B*-G?*", "B1-G?2")
                && !matches("B1*", "B2")
                && matches("a*b*c", "axxbyyc")
                && !matches("a*b", "abx")
        );
    }
}
