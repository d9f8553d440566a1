//! The binary as a script sees it, for the tests of the command line.

use serde_json::Value;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

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

/// Waits for a condition, for at most 30 s.
pub fn wait_for<T>(mut condition: impl FnMut() -> Option<T>) -> T {
    let give_up = Instant::now() + Duration::from_secs(30);
    loop {
        if let Some(value) = condition() {
            return value;
        }
        assert!(Instant::now() < give_up, "waited for 30 s");
        std::thread::yield_now();
    }
}
