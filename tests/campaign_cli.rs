//! The command line of a campaign, as processes: killed in the middle and resumed, spread over parts that work at the
//! same time and merged.

mod common;
#[path = "common/waiting.rs"]
mod waiting;

use common::{json, shaketable};
use serde_json::Value;
use shaketable::record::folder::{self, RunState};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use waiting::wait_for;

const CAMPAIGN: &str = r#"
name = "short"
rig = "simulated"
sweep = "quick"
model = "andreaus-2020-b0"
seed = 11
[[bumper]]
name = "B0"
[[bumper]]
name = "B1"
stiffness_n_m = 33e3
damping_n_s_m = 300.0
[[gap]]
name = "G1"
total_gap_m = 0.015
[[gap]]
name = "G2"
total_gap_m = 0.020
[matrix]
accelerations_g = [0.03, 0.04, 0.05]
"#;
const CASES: usize = 9;

struct Bench {
    folder: tempfile::TempDir,
    file: PathBuf,
}

impl Bench {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("folder");
        let file = folder.path().join("short.toml");
        std::fs::write(&file, CAMPAIGN).expect("written");
        Self { folder, file }
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn command(&self, out: &Path, more: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_shaketable"));
        command.args(["campaign", "run"]).arg(&self.file).arg("--out").arg(out).arg("--json").args(more);
        command
    }

    fn run(&self, out: &Path, more: &[&str]) -> Value {
        let output = self.command(out, more).output().expect("runs");
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        json(&output)
    }

    fn start(&self, out: &Path, more: &[&str]) -> Child {
        self.command(out, more).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().expect("starts")
    }
}

/// Results by file name, byte for byte.
fn results(out: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(out.join("cases")).into_iter().flatten().flatten();
    let json = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "json");
    let name =
        |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    entries
        .map(|entry| entry.path())
        .filter(json)
        .filter_map(|path| Some((name(&path), std::fs::read(&path).ok()?)))
        .collect()
}

/// Names of the runs below a campaign's folder, by whether they came to an end.
fn runs(out: &Path) -> (Vec<String>, Vec<String>) {
    let listed = folder::list(&out.join("runs")).unwrap_or_default();
    let whole = listed.into_iter().filter_map(|(_, read)| read.ok());
    let (ended, cut): (Vec<_>, Vec<_>) = whole.partition(|(_, state)| *state == RunState::Done);
    let names = |runs: Vec<(shaketable::record::Manifest, RunState)>| {
        let mut names: Vec<String> = runs.into_iter().map(|(manifest, _)| manifest.name).collect();
        names.sort();
        names
    };
    (names(ended), names(cut))
}

#[test]
fn a_killed_campaign_goes_on_without_repeating_or_losing_a_case() {
    let bench = Bench::new();
    let (whole, out) = (bench.at("whole"), bench.at("killed"));
    assert_eq!(bench.run(&whole, &[])["ran"], CASES);
    for at_least in [1, 4] {
        let mut child = bench.start(&out, &["--jobs", "2"]);
        // Some cases are done, and at least one run is under way.
        wait_for(|| (results(&out).len() >= at_least && !runs(&out).1.is_empty()).then_some(()));
        child.kill().expect("killed");
        use std::os::unix::process::ExitStatusExt;
        assert_eq!(child.wait().expect("gone").signal(), Some(9), "it had ended before it was killed");
        let left = results(&out);
        assert!(left.len() < CASES);
        // What is there is whole.
        assert!(left.iter().all(|(name, bytes)| results(&whole)[name] == *bytes));
    }
    let before = results(&out).len();
    let adopted = runs(&out).0.len() - before;
    let summary = bench.run(&out, &[]);
    assert_eq!(summary["there"], before);
    assert_eq!(summary["ran"], CASES - before - adopted, "{summary}");
    assert!(results(&out) == results(&whole), "the results are not those of a run in one go");
    let (ended, cut) = runs(&out);
    assert_eq!(ended.iter().collect::<BTreeSet<_>>().len(), CASES);
    assert_eq!(ended.len(), CASES, "no case was run to its end twice: {ended:?}");
    assert!(!cut.is_empty(), "the runs that were cut short stay as interrupted");
    assert_eq!(bench.run(&out, &[])["there"], CASES);
}

#[test]
fn parts_that_run_at_the_same_time_merge_to_one_run() {
    let bench = Bench::new();
    let (whole, merged) = (bench.at("whole"), bench.at("merged"));
    bench.run(&whole, &[]);
    let parts = [bench.at("part-1"), bench.at("part-2")];
    let children: Vec<Child> =
        parts.iter().zip(["1/2", "2/2"]).map(|(out, part)| bench.start(out, &["--shard", part])).collect();
    let summaries: Vec<Value> =
        children.into_iter().map(|child| json(&child.wait_with_output().expect("ends"))).collect();
    let ran: Vec<u64> = summaries.iter().filter_map(|summary| summary["ran"].as_u64()).collect();
    assert_eq!(ran.iter().sum::<u64>(), CASES as u64);
    assert!(ran.iter().all(|&ran| ran > 0), "{ran:?}");
    let path = |path: &Path| path.to_str().expect("a path").to_owned();
    let output = shaketable(&["campaign", "merge", &path(&merged), &path(&parts[0]), &path(&parts[1])]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(results(&merged) == results(&whole), "the parts are not the whole");
    // A part that disagrees is refused.
    let case = parts[1].join("cases").join(results(&parts[1]).keys().next().expect("a case"));
    let text = std::fs::read_to_string(&case).expect("read");
    std::fs::write(&case, text.replacen("\"seed\": ", "\"seed\": 1", 1)).expect("written");
    let output = shaketable(&["campaign", "merge", &path(&merged), &path(&parts[1])]);
    assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
}
