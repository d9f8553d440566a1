//! Ctrl-C and SIGTERM while a run goes on: the first stops the table as an operator would, the second
//! ends the process.

use crate::control::Request;
use crate::control::session::Operator;
use std::io;
use tokio::runtime::{Builder, Runtime};
use tokio::signal::unix::{Signal, SignalKind, signal};

/// Exit code after a second interrupt, as shells have it for SIGINT.
const INTERRUPTED: i32 = 130;

/// The signals of an impatient operator, from [`Interrupts::listen`] on.
pub(super) struct Interrupts {
    runtime: Runtime,
    ctrl_c: Signal,
    terminate: Signal,
}

impl Interrupts {
    /// From now on interrupts wait for [`Interrupts::stop`] instead of ending the process.
    ///
    /// # Errors
    /// When the system gives no handler.
    pub(super) fn listen() -> io::Result<Self> {
        let runtime = Builder::new_current_thread().enable_io().build()?;
        let inside = runtime.enter();
        let (ctrl_c, terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
        drop(inside);
        Ok(Self { runtime, ctrl_c, terminate })
    }

    /// The first interrupt stops this run, the second ends the process.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub(super) fn stop(mut self, operator: Operator) -> io::Result<()> {
        std::thread::Builder::new().name("interrupt".into()).spawn(move || {
            self.wait();
            eprintln!("stopping the table; once more ends the process at once");
            // A full ring means that the control thread does not run: the second interrupt helps then.
            let _ = operator.ask(Request::Stop);
            self.wait();
            std::process::exit(INTERRUPTED);
        })?;
        Ok(())
    }

    /// Waits for either signal.
    fn wait(&mut self) {
        self.runtime.block_on(async {
            tokio::select! {
                _ = self.ctrl_c.recv() => {}
                _ = self.terminate.recv() => {}
            }
        });
    }
}
