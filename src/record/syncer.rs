//! Forces files to the disk from a thread of its own. A disk that other programs keep busy takes a second
//! for that, in which the recorder would write nothing and a killed process would lose what waits. Used by the
//! recorder, which asks once a second.

use super::folder::{RunError, io};
use crossbeam::channel::{Receiver, Sender, TryRecvError, bounded};
use std::fs::File;
use std::path::PathBuf;
use std::thread::JoinHandle;

/// The recorder's end.
pub(super) struct Syncer {
    ask: Option<Sender<()>>,
    failed: Receiver<String>,
    thread: Option<JoinHandle<()>>,
}

impl Syncer {
    /// Starts the thread for files that exist.
    ///
    /// # Errors
    /// [`RunError::Io`] when a file does not open or no thread can be had.
    pub(super) fn start(paths: &[PathBuf]) -> Result<Self, RunError> {
        // Any handle of a file forces all that was written to it, through whichever.
        let files = paths
            .iter()
            .map(|path| Ok((path.clone(), File::open(path).map_err(io(path))?)))
            .collect::<Result<Vec<_>, RunError>>()?;
        let (ask, asked) = bounded::<()>(1);
        let (tell, failed) = bounded(1);
        let work = move || {
            for () in asked {
                for (path, file) in &files {
                    if let Err(error) = file.sync_data() {
                        // One error is enough to end the run.
                        let _ = tell.try_send(format!("{}: {error}", path.display()));
                    }
                }
            }
        };
        let started = std::thread::Builder::new().name("syncer".into()).spawn(work);
        let folder = paths.first().cloned().unwrap_or_default();
        Ok(Self { ask: Some(ask), failed, thread: Some(started.map_err(io(&folder))?) })
    }

    /// Asks for all files to be forced to the disk, unless that is still going on; tells an error of before.
    pub(super) fn ask(&self) -> Result<(), String> {
        if let Some(ask) = &self.ask {
            // Full: the disk is slow, and one more request would not make it faster.
            let _ = ask.try_send(());
        }
        match self.failed.try_recv() {
            Ok(error) => Err(error),
            Err(TryRecvError::Empty | TryRecvError::Disconnected) => Ok(()),
        }
    }

    /// Waits for what is under way.
    pub(super) fn finish(&mut self) -> Result<(), String> {
        self.ask = None;
        if let Some(thread) = self.thread.take() {
            thread.join().map_err(|_| "the syncer thread died".to_owned())?;
        }
        self.ask()
    }
}
