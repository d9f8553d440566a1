//! Opening a serial port so that it does not hold samples back.

use super::DaqError;
use serialport::TTYPort;
use std::path::{Path, PathBuf};
use std::string::ToString;
use std::time::Duration;

/// What became of the wish for low latency.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LowLatency {
    /// The adapter's timer was set and reads back as 1 ms.
    Set,
    /// The port has no such timer (pseudo terminal, native UART): nothing is held back.
    NotNeeded,
    /// The timer is there and could not be set (rights); bytes may come up to so many ms late.
    Refused {
        /// Timer in force, ms.
        timer_ms: u32,
    },
}

/// Opens a port raw, 8N1, without flow control, and asks its adapter for low latency.
///
/// # Errors
/// [`DaqError::Open`].
pub fn open_port(path: &str, baud: u32, read_timeout: Duration) -> Result<(TTYPort, LowLatency), DaqError> {
    let port = TTYPort::open(&serialport::new(path, baud).timeout(read_timeout))
        .map_err(|error| DaqError::Open { path: path.into(), reason: error.to_string() })?;
    Ok((port, set_low_latency(path)))
}

/// The latency timer of USB adapters is a file in sysfs, which the low_latency flag of the port sets in
/// the driver as well; the file needs no ioctl and can be read back.
fn set_low_latency(path: &str) -> LowLatency {
    let Some(timer) = latency_timer(path) else { return LowLatency::NotNeeded };
    // A refused write shows in what is read back.
    let _ = std::fs::write(&timer, "1");
    match std::fs::read_to_string(&timer).ok().and_then(|text| text.trim().parse().ok()) {
        Some(1) => LowLatency::Set,
        Some(timer_ms) => LowLatency::Refused { timer_ms },
        None => LowLatency::NotNeeded,
    }
}

fn latency_timer(path: &str) -> Option<PathBuf> {
    let device = std::fs::canonicalize(path).ok()?;
    let timer = Path::new("/sys/bus/usb-serial/devices").join(device.file_name()?).join("latency_timer");
    timer.exists().then_some(timer)
}
