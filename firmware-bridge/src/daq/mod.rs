//! The host's end of the serial line to the DAQ device.
//!
//! [`DaqDevice::open`] finds out who is there and reads the calibration, [`DaqDevice::start`] hands the port to
//! a thread of its own that turns bytes into samples in a ring. A broken cable ends the stream with a
//! [`DaqFault`]; it is mended only by opening again, between runs.

mod link;
mod port;
mod session;

pub use link::{DaqCounters, DaqFault, DaqMonitor, DaqSample, DaqStream};
pub use port::{LowLatency, open_port};
pub use session::{DaqDevice, DaqSettings, ExpectedDevice};

/// Why a device cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum DaqError {
    /// The port could not be opened or set up.
    #[error("cannot open the DAQ's serial port {path}: {reason}; is the DAQ cable plugged in?")]
    Open {
        /// Path of the port.
        path: std::string::String,
        /// What the system said.
        reason: std::string::String,
    },
    /// Reading or writing failed.
    #[error("the DAQ's serial line {path} failed: {source}; check the DAQ cable")]
    Line {
        /// Path of the port.
        path: std::string::String,
        /// What the system said.
        source: std::io::Error,
    },
    /// No answer within the time allowed.
    #[error("the DAQ on {path} did not answer {request} within {timeout_ms} ms; check power and cable")]
    NoAnswer {
        /// Path of the port.
        path: std::string::String,
        /// What was asked.
        request: &'static str,
        /// Time allowed, ms.
        timeout_ms: u64,
    },
    /// The device refused.
    #[error("the DAQ refused {request}: {code:?}, value {value}")]
    Refused {
        /// What was asked.
        request: &'static str,
        /// Its answer.
        code: crate::wire::AckCode,
        /// The value in its answer.
        value: u32,
    },
    /// Somebody else is on the line.
    #[error("wrong DAQ on {path}: {what} is {received}, expected {expected}")]
    WrongDevice {
        /// Path of the port.
        path: std::string::String,
        /// Which part of the identity.
        what: &'static str,
        /// What was configured.
        expected: std::string::String,
        /// What the device says.
        received: std::string::String,
    },
    /// The thread could not be started.
    #[error("cannot start the thread of the DAQ link: {0}")]
    Thread(std::io::Error),
}
