//! What the drive link tells the others, without locks.

use crate::canopen::emcy::Emergency;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU8, AtomicU32, AtomicU64, Ordering};

/// Why the drive no longer follows. The first one is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DriveFault {
    /// Neither heartbeat nor process data.
    #[error("the drive has fallen silent: check the drive cable and its power")]
    Silent,
    /// The host's controller is off the bus.
    #[error("the CAN bus is off: check the drive cable, its termination and the bit rate")]
    BusOff,
    /// Nothing can be sent.
    #[error("nothing can be sent on the CAN bus: check the drive cable")]
    CannotSend,
    /// The drive tripped and said why.
    #[error("the drive has tripped: {} (EMCY {code:#06x})", Emergency { code: *.code, ..Default::default() }.meaning())]
    Tripped {
        /// Error code of its EMCY.
        code: u16,
    },
    /// The drive left operation without being asked.
    #[error("the drive has left operation by itself")]
    LeftOperation,
    /// The drive restarted.
    #[error("the drive has restarted: check its power")]
    Restarted,
    /// The control thread gave no fresh command.
    #[error("no fresh command from the control thread")]
    CommandsStale,
    /// A command was too far from the one before.
    #[error("a command jumped further than the speed limit allows")]
    CommandJump,
}

impl DriveFault {
    fn pack(self) -> u32 {
        match self {
            Self::Silent => 1,
            Self::BusOff => 2,
            Self::CannotSend => 3,
            Self::Tripped { code } => 4 | u32::from(code) << 16,
            Self::LeftOperation => 5,
            Self::Restarted => 6,
            Self::CommandsStale => 7,
            Self::CommandJump => 8,
        }
    }

    fn unpack(packed: u32) -> Option<Self> {
        Some(match packed & 0xFF {
            1 => Self::Silent,
            2 => Self::BusOff,
            3 => Self::CannotSend,
            4 => Self::Tripped { code: (packed >> 16) as u16 },
            5 => Self::LeftOperation,
            6 => Self::Restarted,
            7 => Self::CommandsStale,
            8 => Self::CommandJump,
            _ => return None,
        })
    }

    /// Whether the link itself is broken, so that no word of ours reaches the drive.
    pub fn is_link(self) -> bool {
        matches!(self, Self::Silent | Self::BusOff | Self::CannotSend)
    }
}

/// Where the sequence of the drive stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Phase {
    /// Not enabled.
    #[default]
    Off = 0,
    /// On the way to operation.
    Enabling = 1,
    /// Follows the commands.
    Enabled = 2,
    /// Quick stop asked for or seen.
    Stopping = 3,
    /// Tripped.
    Fault = 4,
}

impl Phase {
    fn unpack(code: u8) -> Self {
        [Self::Off, Self::Enabling, Self::Enabled, Self::Stopping, Self::Fault]
            .into_iter()
            .find(|phase| *phase as u8 == code)
            .unwrap_or_default()
    }
}

/// Counters of the link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DriveCounters {
    /// Cycles done.
    pub cycles: u64,
    /// Cycles skipped because the thread woke too late.
    pub skipped: u64,
    /// Worst wake-up, ns late.
    pub worst_late_ns: u64,
    /// Cycles without process data from the drive.
    pub missed_inputs: u64,
    /// Frames that could not be sent.
    pub send_failures: u64,
    /// Times the controller reported a disturbed bus.
    pub disturbed: u64,
    /// Commands taken from the ring.
    pub commands: u64,
}

#[derive(Debug, Default)]
pub(super) struct Shared {
    pub stop: AtomicBool,
    /// A [`super::Wish`].
    pub wish: AtomicU8,
    pub phase: AtomicU8,
    fault: AtomicU32,
    pub position: AtomicI32,
    pub following_error: AtomicI32,
    pub cycles: AtomicU64,
    pub skipped: AtomicU64,
    pub worst_late_ns: AtomicU64,
    pub missed_inputs: AtomicU64,
    pub send_failures: AtomicU64,
    pub disturbed: AtomicU64,
    pub commands: AtomicU64,
}

impl Shared {
    /// Keeps the first fault; only the drive's own word on why it left operation replaces the bare fact.
    pub fn latch(&self, fault: DriveFault) {
        let first = self.fault.compare_exchange(0, fault.pack(), Ordering::AcqRel, Ordering::Acquire);
        if first == Err(DriveFault::LeftOperation.pack()) && matches!(fault, DriveFault::Tripped { .. }) {
            self.fault.store(fault.pack(), Ordering::Release);
        }
    }

    pub fn fault(&self) -> Option<DriveFault> {
        DriveFault::unpack(self.fault.load(Ordering::Acquire))
    }

    pub fn phase(&self) -> Phase {
        Phase::unpack(self.phase.load(Ordering::Acquire))
    }

    pub fn counters(&self) -> DriveCounters {
        let get = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        DriveCounters {
            cycles: get(&self.cycles),
            skipped: get(&self.skipped),
            worst_late_ns: get(&self.worst_late_ns),
            missed_inputs: get(&self.missed_inputs),
            send_failures: get(&self.send_failures),
            disturbed: get(&self.disturbed),
            commands: get(&self.commands),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn the_first_fault_stays_and_says_which_cable() {
        let shared = Shared::default();
        assert_eq!(shared.fault(), None);
        shared.latch(DriveFault::Tripped { code: 0x8611 });
        shared.latch(DriveFault::Silent);
        assert_eq!(shared.fault(), Some(DriveFault::Tripped { code: 0x8611 }));
        assert_eq!(
            DriveFault::Tripped { code: 0x8611 }.to_string(),
            "the drive has tripped: following error (EMCY 0x8611)"
        );
        let explained = Shared::default();
        explained.latch(DriveFault::LeftOperation);
        explained.latch(DriveFault::Tripped { code: 0x8611 });
        assert_eq!(explained.fault(), Some(DriveFault::Tripped { code: 0x8611 }));
        for fault in [DriveFault::Silent, DriveFault::BusOff, DriveFault::CannotSend] {
            assert!(fault.to_string().contains("drive cable"), "{fault}");
        }
    }

    #[test]
    fn every_fault_survives_its_packing() {
        for fault in [
            DriveFault::Silent,
            DriveFault::BusOff,
            DriveFault::CannotSend,
            DriveFault::Tripped { code: 0xFFFF },
            DriveFault::LeftOperation,
            DriveFault::Restarted,
            DriveFault::CommandsStale,
            DriveFault::CommandJump,
        ] {
            assert_eq!(DriveFault::unpack(fault.pack()), Some(fault));
        }
    }
}
