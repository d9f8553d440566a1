//! A tree of Parquet files over many runs, partitioned the way Hive does it, which DuckDB, Dask, Spark and
//! pandas read as one table: `samples/date=.../case=.../run=.../samples.parquet`, and `steps` beside it.

use super::parquet::{Column, write_columns};
use super::{DataError, Record, content, io};
use crate::record::RunFolder;
use ::parquet::data_type::ByteArray;
use std::path::{Path, PathBuf};

/// Adds a run to the tree, in place of an earlier copy of it; returns the folder of its samples.
///
/// # Errors
/// [`DataError`] when the run cannot be read or the tree not written.
pub fn add_run(run: &Path, tree: &Path) -> Result<PathBuf, DataError> {
    let folder = RunFolder::open(run)?;
    let manifest = folder.manifest()?;
    let record = Record::open(run, &super::ReadOptions::default())?;
    let name = run
        .canonicalize()
        .map_err(io(run))?
        .file_name()
        .map(|name| name.to_string_lossy().into_owned())
        .ok_or_else(|| content(run, "the folder has no name"))?;
    let date = manifest.started_utc.get(..10).unwrap_or("unknown").to_owned();
    let case = manifest.case.as_deref().unwrap_or("none").replace(['/', '='], "-");
    let place = |kind: &str| {
        let parts = [format!("date={date}"), format!("case={case}"), format!("run={name}")];
        parts.iter().fold(tree.join(kind), |path, part| path.join(part))
    };
    let samples = place("samples");
    finished(&samples, "samples.parquet", |path| super::parquet::write(&record, path))?;
    if folder.steps().is_file() {
        finished(&place("steps"), "steps.parquet", |path| steps(&folder.steps(), path))?;
    }
    Ok(samples)
}

/// Writes under a name that no reader of the tree takes in, then renames: a query never meets half a file.
fn finished(
    folder: &Path,
    name: &str,
    write: impl FnOnce(&Path) -> Result<(), DataError>,
) -> Result<(), DataError> {
    std::fs::create_dir_all(folder).map_err(io(folder))?;
    let part = folder.join(format!(".{name}.part"));
    write(&part)?;
    std::fs::rename(&part, folder.join(name)).map_err(io(folder))
}

/// `steps.csv` as Parquet: numbers as doubles (what is none as NaN), words as text.
fn steps(from: &Path, to: &Path) -> Result<(), DataError> {
    let wrong = |error: ::csv::Error| super::format(from)(&error);
    let mut reader = ::csv::Reader::from_path(from).map_err(wrong)?;
    let names: Vec<String> = reader.headers().map_err(wrong)?.iter().map(str::to_owned).collect();
    let rows = reader.records().collect::<Result<Vec<_>, _>>().map_err(wrong)?;
    let cells = |k: usize| rows.iter().map(move |row| row.get(k).unwrap_or(""));
    let mut numbers: Vec<Vec<f64>> = Vec::new();
    let mut words: Vec<Vec<ByteArray>> = Vec::new();
    // Which list a column went into, and where.
    let mut places = Vec::new();
    for k in 0..names.len() {
        if cells(k).all(|cell| cell.is_empty() || cell.parse::<f64>().is_ok()) {
            places.push((true, numbers.len()));
            numbers.push(cells(k).map(|cell| cell.parse().unwrap_or(f64::NAN)).collect());
        } else {
            places.push((false, words.len()));
            words.push(cells(k).map(ByteArray::from).collect());
        }
    }
    let columns: Vec<(&str, Column)> = names
        .iter()
        .zip(places)
        .map(|(name, (number, at))| {
            let column = if number { Column::Doubles(&numbers[at]) } else { Column::Texts(&words[at]) };
            (name.as_str(), column)
        })
        .collect();
    write_columns(&columns, rows.len(), &[], to)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Manifest;
    use crate::record::samples::SampleWriter;
    use crate::stream::{Row, Sample};

    #[test]
    fn a_run_stands_in_the_tree_under_its_date_and_case() {
        let out = tempfile::tempdir().expect("folder");
        let folder = RunFolder::create(out.path(), "tree").expect("made");
        let mut manifest = Manifest::new("tree", 2048.0);
        manifest.case = Some("B1-G2-0.05".into());
        manifest.started_utc = "2026-03-04T05:06:07Z".into();
        folder.write_manifest(&manifest).expect("written");
        let mut writer = SampleWriter::create(&folder.samples(), 2048.0).expect("created");
        let rows: Vec<Row> = (0..100)
            .map(|sequence| {
                let mut sample = Sample { sequence, ..Sample::default() };
                sample.channels.relative_displacement_m = (sequence as f64).sin();
                Row { sample, step: 1, ..Row::default() }
            })
            .collect();
        writer.append(&rows, |_| {}).expect("appended");
        writer.close().expect("closed");
        std::fs::write(folder.steps(), "index,direction,a_max_m_s2\n0,forward,1.5\n1,backward,\n")
            .expect("written");
        let tree = out.path().join("tree");
        // Twice: the second replaces the first.
        for _ in 0..2 {
            add_run(folder.path(), &tree).expect("added");
        }
        let run = folder.path().file_name().expect("name").to_string_lossy().into_owned();
        let place = format!("date=2026-03-04/case=B1-G2-0.05/run={run}");
        let samples = tree.join("samples").join(&place);
        assert_eq!(std::fs::read_dir(&samples).expect("folder").count(), 1);
        let found = super::super::parquet::read(&samples.join("samples.parquet")).expect("read");
        let at = found.names.iter().position(|name| name == "relative_displacement_m").expect("there");
        assert!(found.values[at].iter().enumerate().all(|(i, d)| *d == (i as f64).sin()));
        let steps = tree.join("steps").join(place).join("steps.parquet");
        let found = super::super::parquet::read(&steps).expect("read");
        // The words are no numbers and are not read back as such.
        assert_eq!(found.names, ["index", "a_max_m_s2"]);
        assert_eq!(found.values[0], [0.0, 1.0]);
        assert!(found.values[1][0] == 1.5 && found.values[1][1].is_nan());
    }
}
