//! Who did what and when: every request that changed something, as a line of `events.jsonl` below the
//! folder of the runs, and, while there is a run, in that run's own `events.jsonl`.

use serde_json::{Value, json};
use std::collections::VecDeque;
use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use tokio::sync::broadcast;

/// Entries that the page is shown.
const REMEMBERED: usize = 200;
/// Runs that may begin before someone who follows them looks.
const BEGUN: usize = 16;

/// The journal; shared by all handlers.
pub struct Journal {
    path: PathBuf,
    inner: Mutex<Inner>,
    begun: broadcast::Sender<PathBuf>,
}

#[derive(Default)]
struct Inner {
    recent: VecDeque<Value>,
    /// Lines since the last run, written to the next run's folder when it begins.
    before: Vec<String>,
    run: Option<PathBuf>,
    failed: Option<String>,
}

impl Journal {
    /// Appends to `events.jsonl` in a folder.
    pub fn new(folder: &Path) -> Self {
        Self {
            path: folder.join("events.jsonl"),
            inner: Mutex::default(),
            begun: broadcast::channel(BEGUN).0,
        }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes down what was done, by whom, with its particulars.
    pub fn note(&self, who: &str, did: &str, what: Value) {
        let entry = json!({
            "event": "operator", "at_utc": crate::record::folder::now_utc(), "who": who, "did": did, "what": what,
        });
        let line = format!("{entry}\n");
        let mut inner = self.lock();
        let mut outcome = append(&self.path, &line);
        match &inner.run {
            Some(run) => outcome = outcome.and(append(run, &line)),
            None => inner.before.push(line),
        }
        if let Err(error) = outcome {
            inner.failed = Some(format!("{}: {error}", self.path.display()));
        }
        if inner.recent.len() == REMEMBERED {
            inner.recent.pop_front();
        }
        inner.recent.push_back(entry);
    }

    /// From here on entries belong to a run as well; those since the last run lead to it.
    pub fn begin_run(&self, events: PathBuf) {
        let mut inner = self.lock();
        let before: String = std::mem::take(&mut inner.before).concat();
        if let Err(error) = append(&events, &before) {
            inner.failed = Some(format!("{}: {error}", events.display()));
        }
        inner.run = Some(events.clone());
        // Nobody has to follow.
        let _ = self.begun.send(events);
    }

    /// Tells the `events.jsonl` of every run that begins from now on.
    pub fn runs(&self) -> broadcast::Receiver<PathBuf> {
        self.begun.subscribe()
    }

    /// Whether lines may still be added to the `events.jsonl` of a run.
    pub fn is_open(&self, events: &Path) -> bool {
        self.lock().run.as_deref() == Some(events)
    }

    /// The run is over.
    pub fn end_run(&self) {
        self.lock().run = None;
    }

    /// The latest entries, oldest first.
    pub fn recent(&self) -> Vec<Value> {
        self.lock().recent.iter().cloned().collect()
    }

    /// Why the journal could not be written the last time that it could not.
    pub fn failed(&self) -> Option<String> {
        self.lock().failed.clone()
    }
}

fn append(path: &Path, text: &str) -> std::io::Result<()> {
    OpenOptions::new().create(true).append(true).open(path)?.write_all(text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_led_to_a_run_stands_in_its_folder_too() {
        let folder = tempfile::tempdir().expect("folder");
        let journal = Journal::new(folder.path());
        journal.note("operator", "arm", json!({}));
        let run = folder.path().join("run.jsonl");
        let mut runs = journal.runs();
        journal.begin_run(run.clone());
        assert!(runs.try_recv().expect("told") == run && journal.is_open(&run));
        journal.note("viewer", "stop", json!({"reason": "noise"}));
        journal.end_run();
        assert!(!journal.is_open(&run));
        journal.note("operator", "reset", json!({}));
        let did = |path: &Path| -> Vec<String> {
            let text = std::fs::read_to_string(path).expect("written");
            let entry = |line: &str| serde_json::from_str::<Value>(line).expect("JSON")["did"].to_string();
            text.lines().map(entry).collect()
        };
        assert_eq!(did(&run), ["\"arm\"", "\"stop\""]);
        assert_eq!(did(&folder.path().join("events.jsonl")), ["\"arm\"", "\"stop\"", "\"reset\""]);
        assert_eq!(journal.recent().len(), 3);
        assert_eq!(journal.failed(), None);
    }
}
