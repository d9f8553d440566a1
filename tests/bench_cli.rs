//! `shaketable bench compare` and `bench diagnose`, as a script sees them.

mod common;

use common::{json, shaketable};

#[test]
fn a_bench_of_diagnosis_names_what_it_hid_and_tells_all_of_its_time() {
    let output = shaketable(&["bench", "diagnose", "--effects", "none,coulomb-friction", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let report = json(&output);
    let sweeps = report["sweeps"].as_array().expect("a list");
    let told: Vec<_> = sweeps.iter().map(|sweep| (&sweep["hidden"], &sweep["said"])).collect();
    let names = |hidden: &str, said: &str| (hidden.into(), said.into());
    let expected = [names("none", "adequate"), names("coulomb-friction", "coulomb-friction")];
    assert_eq!(told, expected.iter().map(|(hidden, said)| (hidden, said)).collect::<Vec<_>>());
    for sweep in sweeps {
        assert!(sweep["samples"].as_u64().is_some_and(|samples| samples > 900_000), "{sweep}");
        let whole = sweep["diagnose_s"].as_f64().expect("seconds");
        let parts = sweep["parts_s"].as_object().expect("parts");
        let sum: f64 = parts.values().filter_map(serde_json::Value::as_f64).sum();
        // What comes after the last part has ended is told nowhere.
        assert!((0.9..1.01).contains(&(sum / whole)), "{sum} of {whole} s: {parts:?}");
        for part in ["first order", "fits", "verdict and limits"] {
            assert!(parts[part].as_f64() > Some(0.0), "{part}: {parts:?}");
        }
    }
}

#[test]
fn an_effect_that_a_bench_does_not_know_is_refused_by_name() {
    let output = shaketable(&["bench", "diagnose", "--effects", "none,stiction"]);
    assert_eq!(output.status.code(), Some(2));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("`stiction`") && said.contains("coulomb-friction"), "{said}");
    assert!(output.stdout.is_empty(), "nothing is timed before: {}", String::from_utf8_lossy(&output.stdout));
}

#[test]
fn a_bench_of_comparison_tells_its_parts() {
    let figures = json(&shaketable(&["bench", "compare", "--json"]));
    assert!(figures["samples"].as_u64().is_some_and(|samples| samples > 900_000), "{figures}");
    let seconds = |part: &str| figures[part].as_f64().unwrap_or(0.0);
    let parts = ["quality_s", "windows_s", "noise_floor_s", "simulate_s"];
    assert!(parts.iter().all(|part| seconds(part) > 0.0), "{figures}");
    // It does at least what takes longest of it.
    let longest = parts.map(seconds).into_iter().fold(0.0, f64::max);
    assert!(seconds("compare_s") > 0.5 * longest, "{figures}");
}
