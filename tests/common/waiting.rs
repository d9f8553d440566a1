//! Waiting for what another process does.

use std::time::{Duration, Instant};

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
