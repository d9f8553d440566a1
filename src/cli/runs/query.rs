//! `runs query`: steps and peaks over a tree of many runs, or SQL on it through DuckDB.

use crate::cli::{CliError, Outcome};
use crate::record::data::query::{Answer, Cell, Condition, peaks, steps};
use crate::report::Table;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

/// Python that answers in place of the `duckdb` program.
const PYTHON: &str = "import duckdb, json, sys\n\
connection = duckdb.connect()\n\
connection.execute(sys.argv[1])\n\
answer = connection.execute(sys.argv[2])\n\
names = [column[0] for column in answer.description or []]\n\
clean = lambda x: None if x != x else x\n\
rows = [dict(zip(names, map(clean, row))) for row in answer.fetchall()]\n\
json.dump(rows, sys.stdout, default=str)\n";

/// Ask a tree of exported runs (see `export --tree`).
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Tree of Parquet files
    tree: PathBuf,
    /// Condition on a column, as in `case=B1-*`, `date>=2026-03-01`, `frequency_hz<2`; all must hold
    #[arg(long = "where", value_name = "CONDITION")]
    conditions: Vec<Condition>,
    /// The peaks of each run and direction instead of its steps
    #[arg(long)]
    peaks: bool,
    /// A question in SQL to the tables `steps` and `samples`, answered by DuckDB (its program, or its Python module)
    #[arg(long, conflicts_with_all = ["conditions", "peaks"])]
    sql: Option<String>,
}

/// Answers.
///
/// # Errors
/// [`CliError::Failed`] when the tree cannot be read or DuckDB refuses.
pub fn execute(args: &Args, json: bool) -> Result<Outcome, CliError> {
    let started = Instant::now();
    if let Some(sql) = &args.sql {
        let rows = duckdb(&args.tree, sql)?;
        if json {
            let wall_s = started.elapsed().as_secs_f64();
            println!("{}", serde_json::json!({ "rows": rows, "wall_s": wall_s }));
        } else {
            print!("{}", of_json(&rows).text());
        }
        return Ok(Outcome::Done);
    }
    let ask = if args.peaks { peaks } else { steps };
    let answer = ask(&args.tree, &args.conditions).map_err(CliError::failed)?;
    let wall_s = started.elapsed().as_secs_f64();
    if json {
        println!(
            "{}",
            serde_json::json!({
                "runs": answer.runs, "columns": answer.columns, "rows": answer.rows, "wall_s": wall_s,
            })
        );
    } else {
        print!("{}", table(&answer).text());
        eprintln!("{} rows from {} runs in {:.0} ms", answer.rows.len(), answer.runs, 1e3 * wall_s);
    }
    Ok(Outcome::Done)
}

fn table(answer: &Answer) -> Table {
    let mut table = Table::new(answer.columns.iter().map(String::as_str));
    for row in &answer.rows {
        table.push(row.iter().map(|cell| match cell {
            Cell::Number(x) if x.is_nan() => "-".to_owned(),
            Cell::Number(x) if x.fract() == 0.0 && x.abs() < 1e15 => format!("{x}"),
            Cell::Number(x) => format!("{x:.5}"),
            Cell::Text(text) => text.clone(),
        }));
    }
    table
}

/// Rows that DuckDB answers with.
fn duckdb(tree: &Path, sql: &str) -> Result<Vec<serde_json::Value>, CliError> {
    let mut views = String::new();
    for name in ["steps", "samples"].into_iter().filter(|name| tree.join(name).is_dir()) {
        // A quote in a path is doubled, as SQL wants it.
        let files = tree.join(name).join("**/*.parquet").display().to_string().replace('\'', "''");
        views.push_str(&format!(
            "create view {name} as select * from read_parquet('{files}', hive_partitioning = true, union_by_name = true); "
        ));
    }
    if views.is_empty() {
        let text = format!("{}: no tree of runs; `export RUN --tree` makes one", tree.display());
        return Err(CliError::failed(text));
    }
    let program =
        Command::new("duckdb").args(["-json", "-c", &views, "-c", sql]).stdin(Stdio::null()).output();
    let output = match program {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Command::new("python3")
            .args(["-c", PYTHON, &views, sql])
            .stdin(Stdio::null())
            .output()
            .map_err(|_| CliError::failed("neither `duckdb` nor `python3` is there to answer SQL"))?,
        other => other.map_err(CliError::failed)?,
    };
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        // The last line of a Python traceback says what was wrong.
        let said = if said.starts_with("Traceback") {
            said.trim().lines().last().unwrap_or("")
        } else {
            said.trim()
        };
        let said = if said.contains("ModuleNotFoundError") {
            "SQL needs the program `duckdb` (duckdb.org), or `pip install duckdb`"
        } else {
            said
        };
        return Err(CliError::failed(format!("DuckDB: {said}")));
    }
    let text = String::from_utf8_lossy(&output.stdout);
    if text.trim().is_empty() {
        return Ok(Vec::new());
    }
    serde_json::from_str(&text).map_err(CliError::failed)
}

fn of_json(rows: &[serde_json::Value]) -> Table {
    let objects: Vec<_> = rows.iter().filter_map(serde_json::Value::as_object).collect();
    let Some(first) = objects.first() else { return Table::default() };
    let mut table = Table::new(first.keys().map(String::as_str));
    for object in &objects {
        table.push(first.keys().map(|key| match object.get(key) {
            Some(serde_json::Value::String(text)) => text.clone(),
            Some(serde_json::Value::Null) | None => "-".to_owned(),
            Some(other) => other.to_string(),
        }));
    }
    table
}
