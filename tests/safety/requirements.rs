//! Requirement, code and test share the numbers `SR-nn`: each must be found in `docs/safety.md`, in the code and at a test.

use crate::pages::page;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// All Rust sources below a folder.
fn sources(below: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(below).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|ext| ext == "rs") {
            found.push(path);
        }
    }
}

/// The numbers that a text names.
fn numbers(text: &str) -> BTreeSet<String> {
    let named = text.match_indices("SR-").filter_map(|(at, _)| text.get(at..at + 5));
    named.filter(|id| id[3..].chars().all(|c| c.is_ascii_digit())).map(str::to_owned).collect()
}

/// Numbers that stand on the line above `#[test]` or of a property test.
fn tested(text: &str) -> BTreeSet<String> {
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let above = |pair: &&[&str]| pair[0].starts_with("// SR-") && pair[1].starts_with("#[test]");
    lines.windows(2).filter(above).flat_map(|pair| numbers(pair[0])).collect()
}

/// What a set of texts lacks: requirements, code and tests must name the same numbers.
fn lacking(page: &str, code: &[String], tests: &[String]) -> Vec<String> {
    let asked = numbers(page);
    let done: BTreeSet<String> = code.iter().flat_map(|text| numbers(text)).collect();
    let shown: BTreeSet<String> = tests.iter().flat_map(|text| tested(text)).collect();
    let all: BTreeSet<&String> = asked.iter().chain(&done).chain(&shown).collect();
    let mut missing = Vec::new();
    for id in all {
        for (place, set) in [("docs/safety.md", &asked), ("the code", &done), ("a test", &shown)] {
            if !set.contains(id) {
                missing.push(format!("{id} is missing in {place}"));
            }
        }
    }
    missing
}

/// Splits a source into its code and its tests.
fn split(path: &Path, text: &str) -> (String, String) {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let whole = path.components().any(|part| part.as_os_str() == "tests") || name.ends_with("tests.rs");
    let at = if whole { 0 } else { text.find("#[cfg(test)]").unwrap_or(text.len()) };
    (text[..at].to_owned(), text[at..].to_owned())
}

fn parts() -> (String, Vec<String>, Vec<String>) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    for folder in ["src", "tests"] {
        sources(&root.join(folder), &mut files);
    }
    // This file speaks of numbers in general.
    files.retain(|path| !path.ends_with("safety/requirements.rs"));
    let texts = files.iter().map(|path| split(path, &std::fs::read_to_string(path).expect("a source")));
    let (code, tests) = texts.unzip();
    (std::fs::read_to_string(page()).expect("docs/safety.md"), code, tests)
}

#[test]
fn every_requirement_has_its_code_and_its_test() {
    let (page, code, tests) = parts();
    assert!(numbers(&page).len() >= 16);
    let missing = lacking(&page, &code, &tests);
    assert!(missing.is_empty(), "{missing:#?}");
}

#[test]
fn a_missing_one_is_found_wherever_it_is_missing() {
    let (page, code, tests) = parts();
    let without = |text: &String| text.replace("SR-08", "SR-xx");
    let all_without = |texts: &[String]| texts.iter().map(without).collect::<Vec<_>>();
    assert_eq!(lacking(&without(&page), &code, &tests), ["SR-08 is missing in docs/safety.md"]);
    assert_eq!(lacking(&page, &all_without(&code), &tests), ["SR-08 is missing in the code"]);
    assert_eq!(lacking(&page, &code, &all_without(&tests)), ["SR-08 is missing in a test"]);
}
