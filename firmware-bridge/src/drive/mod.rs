//! The host's end of the CAN bus to a CiA 402 servo drive.
//!
//! [`CanBus`] is the socket, [`prepare`] configures the drive and reads everything back, and
//! [`DriveStream`] is the thread that exchanges process data with SYNC once a cycle. If the host dies, the
//! drive stops by itself: `prepare` refuses a drive in which that cannot be verified.

mod bus;
mod cyclic;
mod sequencer;
mod setup;
mod status;

pub use bus::{BusEvent, CanBus};
pub use cyclic::{DriveMonitor, DriveStream, TimedCommand};
pub use sequencer::{Sequencer, Wish};
pub use setup::{ReadyDrive, prepare};
pub use status::{DriveCounters, DriveFault, Phase};

use crate::canopen::objects::Address;
use crate::canopen::sdo::SdoError;
use std::string::String;
use std::time::Duration;
use std::vec::Vec;

/// How metres become the drive's units. Signs turn the axis round.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Units {
    /// Position counts a metre.
    pub counts_per_m: f64,
    /// Units of velocity (object 0x60B1) a metre a second.
    pub velocity_per_m_s: f64,
    /// Torque offset (0x60B2), per mille of the rated torque, a m/s2; 0 for none.
    pub torque_per_m_s2: f64,
}

/// An object to be written before the drive starts, and read back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setting {
    /// Where.
    pub address: Address,
    /// What; the low `bytes` bytes of it.
    pub value: u32,
    /// Length of the object, bytes (1, 2 or 4).
    pub bytes: u8,
}

/// Who must be on the bus; `None` accepts any.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExpectedDrive {
    /// Vendor number.
    pub vendor: Option<u32>,
    /// Product code.
    pub product: Option<u32>,
    /// Serial number.
    pub serial: Option<u32>,
}

/// Settings of the drive and its link.
#[derive(Clone, Debug)]
pub struct DriveSettings {
    /// Node number of the drive, 1 to 127.
    pub node: u8,
    /// Node number under which the host sends its heartbeat, 1 to 127.
    pub host_node: u8,
    /// Identity that is asked for.
    pub expected: ExpectedDrive,
    /// Units.
    pub units: Units,
    /// Period of SYNC and process data.
    pub cycle: Duration,
    /// Mode of operation: 8 cyclic synchronous position, 7 interpolated position.
    pub mode: i8,
    /// Time without the host's heartbeat after which the drive stops by itself.
    pub host_lost: Duration,
    /// Time without process data after which the drive stops by itself.
    pub commands_lost: Duration,
    /// The drive's own SYNC time-out, where it has one (a vendor's object, in ms).
    pub sync_timeout: Option<Address>,
    /// Period of the drive's heartbeat; three of them without one count as a silent drive.
    pub drive_heartbeat: Duration,
    /// Cycles without process data from the drive after which it counts as silent.
    pub missed_cycles: u32,
    /// Time without a fresh command after which the link asks for quick stop: the control thread is dead.
    pub command_stale: Duration,
    /// Deceleration of quick stop, m/s2.
    pub quick_stop_m_s2: f64,
    /// Following error at which the drive trips, m.
    pub following_error_m: f64,
    /// Highest speed of the target, m/s: a command that jumps further is refused and ends in quick stop.
    pub speed_limit_m_s: f64,
    /// Further objects to set, in order.
    pub settings: Vec<Setting>,
}

/// Why a drive cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// No such interface, or no right to it.
    #[error(
        "cannot open the CAN interface {interface}: {reason}; is it up, and is the drive cable plugged in?"
    )]
    Open {
        /// Name of the interface.
        interface: String,
        /// What the system said.
        reason: String,
    },
    /// Sending or receiving failed.
    #[error("the CAN bus failed: {0}; check the drive cable and its termination")]
    Bus(#[from] std::io::Error),
    /// The controller went off the bus.
    #[error("the CAN controller is bus-off: check the drive cable, its termination and the bit rate")]
    BusOff,
    /// No answer within the time allowed.
    #[error(
        "the drive (node {node}) did not answer {request} within {timeout_ms} ms; check its power and the drive cable"
    )]
    NoAnswer {
        /// Node number.
        node: u8,
        /// What was asked.
        request: String,
        /// Time allowed, ms.
        timeout_ms: u64,
    },
    /// A transfer was refused.
    #[error("{0} ({meaning})", meaning = meaning(.0))]
    Sdo(#[from] SdoError),
    /// Another device is on the bus.
    #[error("wrong drive at node {node}: {what} is {received:#010x}, expected {expected:#010x}")]
    WrongDevice {
        /// Node number.
        node: u8,
        /// Which part of the identity.
        what: &'static str,
        /// What was configured.
        expected: u32,
        /// What the drive says.
        received: u32,
    },
    /// A setting did not take, which is refused since the drive's own time-outs hang on it.
    #[error("the drive keeps {received} in {address} ({what}), {written} was written")]
    NotTaken {
        /// The object.
        address: Address,
        /// What it is for.
        what: &'static str,
        /// Written.
        written: u32,
        /// Read back.
        received: u32,
    },
    /// The thread could not be started.
    #[error("cannot start the thread of the drive link: {0}")]
    Thread(std::io::Error),
}

fn meaning(error: &SdoError) -> &'static str {
    match error {
        SdoError::Aborted { code, .. } => crate::canopen::sdo::abort_meaning(*code),
        SdoError::Unexpected { .. } => "another master on the bus, or a broken node",
        SdoError::TooLong { .. } => "not what the standard says",
    }
}
