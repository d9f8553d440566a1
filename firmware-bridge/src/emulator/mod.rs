//! Both devices in software, in real time, with faults on request, so that a whole lab runs on one machine: the
//! DAQ on a pseudo terminal, the drive on a (virtual) CAN interface, any mechanics behind them.
//!
//! [`Lab::start`] runs them; tests and `shaketable emulate` call it. The device code ([`DriveNode`],
//! [`DaqNode`]) takes time and frames from outside and can be tested without threads.

mod arrivals;
mod daq;
mod dictionary;
mod drive;
mod fault;
mod lab;
mod motion;

pub use daq::DaqNode;
pub use drive::{DriveNode, DriveSpec};
pub use fault::{Fault, FaultError};
pub use lab::{Lab, LabReport, LabSettings};
pub use motion::Demand;

use crate::wire::CHANNELS;

/// The mechanics behind the emulated devices: table and specimen.
pub trait Plant: Send {
    /// Advances by one sample period with what the drive asks of the table, and gives what the sensors
    /// then show, SI, in the order of the channels.
    fn step(&mut self, demand: Demand) -> [f64; CHANNELS];
}
