//! What a rig is to the control step: something that delivers samples and takes commands.
//!
//! The simulated, hardware and replay rigs are siblings behind [`Rig`]; the control step cannot
//! tell them apart.

pub mod hardware;
pub mod replay;
pub mod simulated;
pub mod spec;

pub use spec::{Capacity, RigSpec, Tolerances};

use crate::safety::StopLine;
use crate::stream::{Command, Sample};

/// Why a rig refused or lost something.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RigFault {
    /// The link to the DAQ is down.
    #[error("the DAQ link is down: check the DAQ cable")]
    DaqLink,
    /// The link to the drive is down.
    #[error("the drive link is down: check the drive cable")]
    DriveLink,
    /// The drive tripped by itself.
    #[error("the drive has tripped")]
    DriveTrip,
    /// The record being replayed has ended.
    #[error("the record has ended")]
    EndOfRecord,
}

/// One rig, as the control step sees it. No method blocks, allocates, locks or logs.
pub trait Rig: Send {
    /// Takes the next delivered sample, oldest first; `None` when nothing (more) has arrived.
    ///
    /// # Errors
    /// A fault of the link or device; the rig stays usable for stopping as far as it can be.
    fn read(&mut self) -> Result<Option<Sample>, RigFault>;

    /// Hands over the command of this control period.
    ///
    /// # Errors
    /// A fault of the link or device.
    fn write(&mut self, command: &Command) -> Result<(), RigFault>;

    /// Asks the drive for its own fastest safe stop (quick stop), independent of the commands.
    fn quick_stop(&mut self);

    /// Steps of virtual time: a simulated or replayed rig advances by one sample period.
    /// A real rig, which advances by itself, does nothing.
    fn advance(&mut self) {}

    /// The line that makes the drive stop by itself, for a watchdog beside the control thread; `None` where
    /// the drive has its own time-outs only.
    fn stop_line(&self) -> Option<StopLine> {
        None
    }

    /// Delay from a command to its effect in the measured table motion, s, as far as it is known.
    fn chain_delay_s(&self) -> f64;
}
