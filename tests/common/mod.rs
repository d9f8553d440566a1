//! The binary as a script sees it, for the tests of the command line.

use serde_json::Value;
use std::process::{Command, Output};

/// Runs the binary to its end.
pub fn shaketable(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_shaketable")).args(args).output().expect("the binary runs")
}

/// The one object of `--json`.
pub fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| {
        panic!("one JSON object on standard output: {error}\n{}", String::from_utf8_lossy(&output.stderr))
    })
}
