//! The command line of a run, as a script sees it: JSON, exit codes, determinism, a killed process.

mod common;
#[path = "common/waiting.rs"]
mod waiting;

use common::{json, shaketable};
use serde_json::Value;
use shaketable::record::samples::SampleReader;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use waiting::wait_for;

fn run(out: &Path, more: &[&str]) -> Value {
    let out = out.to_str().expect("a path");
    let output = shaketable(&[&["run", "--json", "--steps", "2.0..2.3", "--out", out], more].concat());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    json(&output)
}

#[test]
fn a_run_tells_what_scripts_need_and_repeats_itself_by_its_seed() {
    let out = tempfile::tempdir().expect("folder");
    let first = run(out.path(), &["--seed", "1"]);
    assert_eq!(first["outcome"], "done");
    assert_eq!(first["cause"], Value::Null);
    assert_eq!((first["lost_samples"].as_u64(), first["slips"].as_u64()), (Some(0), Some(0)));
    let steps = first["steps"].as_array().expect("steps");
    assert_eq!(steps.len(), 8);
    for key in ["index", "frequency_hz", "a_max_m_s2", "excursion_m", "model_a_max_m_s2", "model_excursion_m"]
    {
        assert!(steps.iter().all(|step| step[key].is_number()), "{key}");
    }
    assert_eq!((&steps[0]["direction"], &steps[7]["direction"]), (&"forward".into(), &"backward".into()));
    assert!(first["error"]["nrmse_a"].as_f64().is_some_and(|error| error < 0.02), "{}", first["error"]);
    assert!(first["timing"]["step"]["p999_us"].is_number());
    let folder = PathBuf::from(first["run_dir"].as_str().expect("a folder"));
    for file in ["run.toml", "samples.h5", "events.jsonl", "steps.csv", "integrity.txt"] {
        assert!(folder.join(file).is_file(), "{file}");
    }
    let again = run(out.path(), &["--seed", "1"]);
    let other = run(out.path(), &["--seed", "2"]);
    assert_eq!(first["samples_sha256"], again["samples_sha256"]);
    assert_ne!(first["samples_sha256"], other["samples_sha256"]);
    let replayed = shaketable(
        &["replay", folder.to_str().expect("a path"), "--json", "--out"]
            .into_iter()
            .chain([out.path().to_str().expect("a path")])
            .collect::<Vec<_>>(),
    );
    assert_eq!(json(&replayed)["identical"], true);
    let intact = shaketable(&["runs", "verify", folder.to_str().expect("a path"), "--json"]);
    assert_eq!(json(&intact)["intact"], true);
}

#[test]
fn a_flipped_bit_in_the_samples_is_found() {
    let out = tempfile::tempdir().expect("folder");
    let report = run(out.path(), &[]);
    let folder = report["run_dir"].as_str().expect("a folder");
    let path = Path::new(folder).join("samples.h5");
    let mut bytes = std::fs::read(&path).expect("readable");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&path, bytes).expect("writable");
    let verified = shaketable(&["runs", "verify", folder, "--json"]);
    assert_eq!(verified.status.code(), Some(1));
    let verified = json(&verified);
    assert!(verified["rows_verified"].as_u64() < verified["rows"].as_u64(), "{verified}");
}

#[test]
fn wrong_usage_is_told_with_exit_code_2_and_leaves_nothing() {
    let out = tempfile::tempdir().expect("folder");
    let path = out.path().join("runs");
    let path = path.to_str().expect("a path");
    let wrong: [(&[&str], &str); 7] = [
        (&["--ag", "0.2"], "displacement"),
        (&["--steps", "7..8"], "no step"),
        (&["--case", "B9-G1-0.05"], "B1-G2-0.05"),
        (&["--rig", "nowhere"], "simulated"),
        (&["--model", "nowhere"], "nowhere"),
        (&["--ag", "-1"], "0.0001"),
        (&["--cpu", "0"], "--real-time"),
    ];
    for (args, expected) in wrong {
        let output = shaketable(&[&["run", "--out", path], args].concat());
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{args:?}: {told}");
        assert!(told.contains(expected), "{args:?}: {told}");
    }
    assert!(!Path::new(path).exists());
}

#[test]
fn a_preview_moves_nothing() {
    let out = tempfile::tempdir().expect("folder");
    let path = out.path().join("runs");
    let output = shaketable(&["run", "--preview", "--out", path.to_str().expect("a path")]);
    assert_eq!(output.status.code(), Some(0));
    assert!(String::from_utf8_lossy(&output.stdout).contains("92 steps"));
    assert!(!path.exists());
}

#[test]
fn a_killed_run_keeps_its_samples_and_can_be_recovered() {
    let out = tempfile::tempdir().expect("folder");
    let runs = out.path().to_str().expect("a path");
    let mut child = Command::new(env!("CARGO_BIN_EXE_shaketable"))
        .args(["run", "--real-time", "--steps", "4.0..5.0", "--out", runs])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("starts");
    let folder = wait_for(|| {
        let entry = std::fs::read_dir(out.path()).ok()?.flatten().next()?.path();
        entry.join("run.toml").exists().then_some(entry)
    });
    let rows = || SampleReader::open(&folder.join("samples.h5")).ok().map(|reader| reader.rows());
    // While it runs the file opens and grows; by then the first steps are done.
    wait_for(|| rows().filter(|&rows| rows > 4 * 2048));
    let listed = json(&shaketable(&["runs", "--json", "--out", runs]));
    assert_eq!(listed["runs"][0]["state"], "running");
    assert_eq!(shaketable(&["recover", folder.to_str().expect("a path")]).status.code(), Some(2));
    child.kill().expect("killed");
    child.wait().expect("gone");
    let left = rows().expect("opens at once");
    let listed = json(&shaketable(&["runs", "--json", "--out", runs]));
    assert_eq!(listed["runs"][0]["state"], "interrupted");
    let recovered = json(&shaketable(&["recover", folder.to_str().expect("a path"), "--json"]));
    assert_eq!(recovered["samples"].as_u64(), Some(left));
    assert_eq!((recovered["outcome"].as_str(), recovered["damage"].as_str()), (Some("interrupted"), None));
    assert!(recovered["steps"].as_array().is_some_and(|steps| !steps.is_empty()), "{recovered}");
    let reader = SampleReader::open(&folder.join("samples.h5")).expect("opens");
    let kept = reader.read(0, left).expect("reads");
    assert!(kept.windows(2).all(|pair| pair[1].sample.sequence == pair[0].sample.sequence + 1));
}

#[test]
fn an_interrupt_stops_the_table_and_closes_the_run() {
    let out = tempfile::tempdir().expect("folder");
    let child = Command::new(env!("CARGO_BIN_EXE_shaketable"))
        .args(["run", "--real-time", "--steps", "4.0..5.0", "--json", "--out"])
        .arg(out.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("starts");
    let folder = wait_for(|| Some(std::fs::read_dir(out.path()).ok()?.flatten().next()?.path()));
    // Two seconds of samples: the table is in its first step.
    wait_for(|| SampleReader::open(&folder.join("samples.h5")).ok().filter(|file| file.rows() > 2 * 2048));
    let told = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill runs");
    assert!(told.success());
    let output = child.wait_with_output().expect("ends");
    assert_eq!(output.status.code(), Some(0));
    let report = json(&output);
    assert_eq!((&report["outcome"], &report["lost_samples"]), (&"stopped".into(), &0.into()));
    let reader = SampleReader::open(&folder.join("samples.h5")).expect("opens");
    let rows = reader.read(0, reader.rows()).expect("reads");
    let last = rows.last().expect("rows");
    assert!(rows.len() < 20 * 2048, "the sweep would have gone on: {}", rows.len());
    assert_eq!((last.command.velocity_m_s, last.command.acceleration_m_s2), (0.0, 0.0));
    let jerk = |pair: &[shaketable::stream::Row]| {
        (pair[1].command.acceleration_m_s2 - pair[0].command.acceleration_m_s2).abs() * 2048.0
    };
    let largest = rows.windows(2).map(jerk).fold(0.0, f64::max);
    assert!(largest < 100.0, "the command is smooth to its end: {largest} m/s3");
}

#[test]
fn a_whole_sweep_behind_the_stiffest_bumper_lacks_nothing() {
    let out = tempfile::tempdir().expect("folder");
    let model = "andreaus-2020-b4-g3";
    let words =
        ["run", "--json", "--seed", "23", "--model", model, "--out", out.path().to_str().expect("a path")];
    let ran = json(&shaketable(&words));
    assert_eq!(ran["outcome"], "done");
    let folder = ran["run_dir"].as_str().expect("a folder");
    let found = json(&shaketable(&["diagnose", folder, "--model", model, "--json"]));
    // Noise within the kicks of impacts was taken for a constant force, and for slow noise of the laser.
    assert_eq!(found["verdict"], "adequate", "{found}");
    let notes = found["notes"].as_array().expect("notes");
    assert!(notes.iter().all(|note| !note.as_str().unwrap_or_default().contains("slow noise")), "{notes:?}");
    let numbers = found["reidentified"].as_array().expect("numbers");
    let of = |number: &Value, key: &str| number[key].as_f64().expect("a number");
    let deviations =
        |n: &Value| 3.92 * (of(n, "value") - of(n, "nominal")) / (of(n, "high95") - of(n, "low95"));
    assert!(numbers.iter().all(|number| deviations(number).abs() < 3.0), "{numbers:?}");
}
