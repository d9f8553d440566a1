//! Real-time set-up of the control thread: scheduling class, locked memory, affinity. What could not
//! be had is reported ([`RealTime`]), never only warned about; the caller decides whether to go on.
//! The only file with unsafe code.

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::thread::{CpuSet, sched_setaffinity};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{self, Write};

/// Priority of the control thread within `SCHED_FIFO`.
pub const PRIORITY: i32 = 80;

/// What of the real-time set-up is in force.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RealTime {
    /// `SCHED_FIFO` at [`PRIORITY`].
    pub fifo: bool,
    /// Present and future pages are locked.
    pub memory_locked: bool,
    /// The processors stay out of idle states that take long to wake from; `false` also where the kernel offers no
    /// such thing.
    #[serde(default)]
    pub awake: bool,
    /// CPU that the thread is pinned to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cpu: Option<usize>,
    /// Why something is missing, and how to get it.
    pub missing: Vec<String>,
}

impl RealTime {
    /// Everything asked for is in force.
    pub fn complete(&self) -> bool {
        self.missing.is_empty()
    }

    /// One line for the operator.
    pub fn line(&self) -> String {
        if self.complete() {
            let cpu = self.cpu.map_or_else(String::new, |cpu| format!(", CPU {cpu}"));
            let awake = if self.awake { ", no idle states" } else { "" };
            format!("real time: SCHED_FIFO {PRIORITY}, memory locked{cpu}{awake}")
        } else {
            format!("real time: degraded ({})", self.missing.join("; "))
        }
    }
}

/// Keeps the processors out of idle states for as long as it lives: a request of 0 us to the kernel's PM QoS interface
/// (Linux, Documentation/power/pm_qos_interface). Waking from such a state costs tens of microseconds.
#[derive(Debug)]
pub struct Awake {
    _request: File,
}

impl Awake {
    /// File of the interface.
    pub const PATH: &str = "/dev/cpu_dma_latency";

    /// Makes the request.
    ///
    /// # Errors
    /// The file is not there, or is not this user's to write.
    pub fn request() -> io::Result<Self> {
        let mut request = File::options().write(true).open(Self::PATH)?;
        request.write_all(&0_i32.to_ne_bytes())?;
        Ok(Self { _request: request })
    }
}

/// Sets the calling thread up for real time, as far as the system allows. What comes with the state has to live as long
/// as the thread needs it.
pub fn set_up(cpu: Option<usize>) -> (RealTime, Option<Awake>) {
    let mut state = RealTime::default();
    let awake = match Awake::request() {
        Ok(awake) => Some(awake),
        Err(error) if error.kind() == io::ErrorKind::NotFound => None,
        Err(error) => {
            let path = Awake::PATH;
            state
                .missing
                .push(format!("idle states not held off ({error}): give the user the right to write {path}"));
            None
        }
    };
    state.awake = awake.is_some();
    match mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE) {
        Ok(()) => state.memory_locked = true,
        Err(error) => state
            .missing
            .push(format!("memory not locked ({error}): raise the memlock limit in /etc/security/limits.d")),
    }
    if let Some(cpu) = cpu {
        let mut set = CpuSet::new();
        set.set(cpu);
        match sched_setaffinity(None, &set) {
            Ok(()) => state.cpu = Some(cpu),
            Err(error) => state.missing.push(format!("not pinned to CPU {cpu} ({error})")),
        }
    }
    match set_fifo(PRIORITY) {
        Ok(()) => state.fifo = true,
        Err(error) => state
            .missing
            .push(format!("no SCHED_FIFO ({error}): raise the rtprio limit in /etc/security/limits.d")),
    }
    (state, awake)
}

/// Whether this process may use `SCHED_FIFO` at [`PRIORITY`]: tried on a thread of its own.
pub fn may_use_fifo() -> io::Result<()> {
    std::thread::spawn(|| set_fifo(PRIORITY))
        .join()
        .unwrap_or_else(|_| Err(io::Error::other("the probing thread died")))
}

/// Puts the calling thread, which serves a link of the rig, just below the control thread. Without the right to it
/// the link runs as any thread does, which its report of late cycles shows.
pub fn prioritise_link() {
    let _ = set_fifo(PRIORITY - 5);
}

/// Lets the memory go that [`set_up`] locked, so that later work does not hold its pages in memory.
pub fn release_memory() {
    // Failing to unlock costs memory only.
    let _ = rustix::mm::munlockall();
}

fn set_fifo(priority: i32) -> io::Result<()> {
    // SAFETY: `sched_param` is plain old data for which all zeros is a valid value.
    let mut parameters: libc::sched_param = unsafe { std::mem::zeroed() };
    parameters.sched_priority = priority;
    // SAFETY: thread id 0 is the calling thread, and the pointer is to a live local that the kernel
    // only reads during the call.
    let code = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &parameters) };
    if code == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_shows() {
        let degraded = RealTime { missing: vec!["no SCHED_FIFO".into()], ..RealTime::default() };
        assert!(!degraded.complete());
        assert!(degraded.line().contains("degraded (no SCHED_FIFO)"));
        let (state, _) =
            std::thread::spawn(|| set_up(Some(usize::from(u16::MAX) % 512))).join().expect("no panic");
        // CPU 511 does not exist on the machines this runs on; that must show and not end the thread.
        assert!(state.cpu.is_none() && !state.complete(), "{state:?}");
        release_memory();
    }
}
