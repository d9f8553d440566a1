//! The part of the safety chain that does not hang on the control thread (SR-13): a thread that listens to its heartbeat
//! and opens the stop line of the drive when it stays away. Started by the session for rigs that have such a line; a
//! rig of real devices has the time-outs of its drive instead.
//!
//! What is hand-made and lock-free here is two words: a counter that one thread raises and one reads, and a
//! flag that only ever goes from closed to open. No other data is published through them, each is one atomic access on its
//! own, and any order in which the two threads' accesses interleave is one of "a beat was seen" or "was not seen yet",
//! of which the second costs a quarter of the time-out at most. The rings come from `ringbuf`, the channels from
//! `crossbeam`.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{JoinHandle, Thread};
use std::time::{Duration, Instant};

/// The heartbeat of the control thread.
#[derive(Clone, Debug, Default)]
pub struct Heart(Arc<AtomicU64>);

impl Heart {
    /// One beat; never waits.
    pub fn beat(&self) {
        self.0.fetch_add(1, Ordering::Release);
    }

    fn count(&self) -> u64 {
        self.0.load(Ordering::Acquire)
    }
}

/// The line whose opening makes the drive stop by itself; once open it stays open.
#[derive(Clone, Debug, Default)]
pub struct StopLine(Arc<AtomicBool>);

impl StopLine {
    /// Makes the drive stop.
    pub fn open(&self) {
        self.0.store(true, Ordering::Release);
    }

    /// Whether the drive has been told to stop.
    pub fn is_open(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}

/// Listens until it is let go.
#[derive(Debug)]
pub struct Watchdog {
    line: StopLine,
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Watchdog {
    /// Listens from the first beat on; opens the line after `timeout` without one.
    ///
    /// # Errors
    /// When no thread can be had.
    pub fn start(heart: Heart, line: StopLine, timeout: Duration) -> std::io::Result<Self> {
        let over = Arc::new(AtomicBool::new(false));
        let (ended, opens) = (over.clone(), line.clone());
        let thread = std::thread::Builder::new()
            .name("watchdog".into())
            .spawn(move || listen(&heart, &opens, timeout, &ended))?;
        Ok(Self { line, over, thread: Some(thread) })
    }

    /// Whether the line is open.
    pub fn has_tripped(&self) -> bool {
        self.line.is_open()
    }
}

impl Drop for Watchdog {
    fn drop(&mut self) {
        // A thread that dies takes its watchdog with it; the drive must not go on without either.
        if std::thread::panicking() {
            self.line.open();
        }
        self.over.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            Thread::unpark(thread.thread());
            // A watchdog that died has nothing more to say.
            let _ = thread.join();
        }
    }
}

fn listen(heart: &Heart, line: &StopLine, timeout: Duration, over: &AtomicBool) {
    let (mut seen, mut at) = (0, Instant::now());
    while !over.load(Ordering::Acquire) {
        let beats = heart.count();
        if beats != seen || beats == 0 {
            (seen, at) = (beats, Instant::now());
        } else if at.elapsed() >= timeout {
            line.open();
            return;
        }
        std::thread::park_timeout(timeout / 4);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Waits for a condition, with a generous end.
    fn wait_for(condition: impl Fn() -> bool) -> bool {
        let begin = Instant::now();
        while !condition() && begin.elapsed() < Duration::from_secs(20) {
            std::thread::yield_now();
        }
        condition()
    }

    // SR-13
    #[test]
    fn it_opens_the_line_when_the_beat_stays_away_and_not_before_the_first() {
        let (heart, line, timeout) = (Heart::default(), StopLine::default(), Duration::from_millis(40));
        let watchdog = Watchdog::start(heart.clone(), line.clone(), timeout).expect("a thread");
        let begin = Instant::now();
        assert!(!wait_for(|| watchdog.has_tripped() || begin.elapsed() > 3 * timeout) || !line.is_open());
        heart.beat();
        let last = Instant::now();
        assert!(wait_for(|| line.is_open()));
        assert!(last.elapsed() >= timeout, "{:?}", last.elapsed());
    }

    #[test]
    fn letting_it_go_ends_it_without_a_trip() {
        let (heart, line) = (Heart::default(), StopLine::default());
        heart.beat();
        drop(Watchdog::start(heart, line.clone(), Duration::from_secs(3600)).expect("a thread"));
        assert!(!line.is_open());
    }
}
