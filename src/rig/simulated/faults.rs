//! Fault switches of the simulated rig: set from any thread while the rig runs, read by it once a
//! sample without waiting.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

/// Samples that a USB serial adapter without `low_latency` holds back at 2048 Hz (16 ms).
pub const LATE_BURST_SAMPLES: u32 = 33;

/// One measured channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Channel {
    /// Table displacement.
    TableDisplacement = 0,
    /// Table acceleration.
    TableAcceleration = 1,
    /// First accelerometer on the mass.
    MassAcceleration1 = 2,
    /// Second accelerometer on the mass.
    MassAcceleration2 = 3,
    /// Laser.
    RelativeDisplacement = 4,
}

/// All channels, in the order of their numbers.
pub const ALL_CHANNELS: [Channel; 5] = [
    Channel::TableDisplacement,
    Channel::TableAcceleration,
    Channel::MassAcceleration1,
    Channel::MassAcceleration2,
    Channel::RelativeDisplacement,
];

/// Something that goes wrong on the rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Fault {
    /// Every channel keeps its last value while commands are still accepted and numbers advance.
    FrozenFeedback,
    /// No sample arrives; the device's sequence number advances.
    Dropout,
    /// Samples are held back and arrive [`LATE_BURST_SAMPLES`] at a time.
    LateBurst,
    /// The last sample is delivered again, with its old number.
    RepeatedSample,
    /// A channel delivers NaN.
    NotANumber(Channel),
    /// A channel keeps its value.
    Stuck(Channel),
    /// Two channels have changed places.
    Swapped(Channel, Channel),
    /// The drive's bus is off: no command gets through and the caller is told.
    BusOff,
    /// Bytes of the DAQ link are damaged: two of three frames fail their check and are lost.
    SerialGarbage,
    /// The drive trips and stops by itself.
    DriveTrip,
}

const FROZEN: u32 = 1;
const DROPOUT: u32 = 1 << 1;
const BURST: u32 = 1 << 2;
const REPEAT: u32 = 1 << 3;
const BUS_OFF: u32 = 1 << 4;
const GARBAGE: u32 = 1 << 5;
const TRIP: u32 = 1 << 6;
const NAN_SHIFT: u32 = 8;
const STUCK_SHIFT: u32 = 16;
/// Six bits for the two channels that are swapped; equal numbers mean none.
const SWAP_SHIFT: u32 = 24;
const SWAP_MASK: u32 = 0x3f << SWAP_SHIFT;

/// Handle on the switches; clones act on the same rig.
#[derive(Clone, Debug, Default)]
pub struct FaultSwitches {
    bits: Arc<AtomicU32>,
}

impl FaultSwitches {
    /// Switches a fault on or off; acts from the rig's next sample on.
    pub fn set(&self, fault: Fault, on: bool) {
        if let Fault::Swapped(first, second) = fault {
            let pair = if on { first as u32 | (second as u32) << 3 } else { 0 };
            let swap = |bits: u32| Some(bits & !SWAP_MASK | pair << SWAP_SHIFT);
            // The closure always gives a value, so the update cannot fail.
            let _ = self.bits.fetch_update(Ordering::AcqRel, Ordering::Acquire, swap);
            return;
        }
        let bit = match fault {
            Fault::FrozenFeedback => FROZEN,
            Fault::Dropout => DROPOUT,
            Fault::LateBurst => BURST,
            Fault::RepeatedSample => REPEAT,
            Fault::BusOff => BUS_OFF,
            Fault::SerialGarbage => GARBAGE,
            Fault::DriveTrip => TRIP,
            Fault::NotANumber(channel) => 1 << (NAN_SHIFT + channel as u32),
            Fault::Stuck(channel) => 1 << (STUCK_SHIFT + channel as u32),
            Fault::Swapped(..) => 0,
        };
        if on {
            self.bits.fetch_or(bit, Ordering::AcqRel);
        } else {
            self.bits.fetch_and(!bit, Ordering::AcqRel);
        }
    }

    /// Switches everything off.
    pub fn clear(&self) {
        self.bits.store(0, Ordering::Release);
    }

    /// What is switched on now.
    pub(super) fn active(&self) -> Active {
        Active(self.bits.load(Ordering::Acquire))
    }
}

/// One reading of the switches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Active(u32);

impl Active {
    pub(super) fn none(self) -> bool {
        self.0 == 0
    }

    pub(super) fn frozen(self) -> bool {
        self.0 & FROZEN != 0
    }

    pub(super) fn dropout(self) -> bool {
        self.0 & DROPOUT != 0
    }

    pub(super) fn late_burst(self) -> bool {
        self.0 & BURST != 0
    }

    pub(super) fn repeated(self) -> bool {
        self.0 & REPEAT != 0
    }

    pub(super) fn bus_off(self) -> bool {
        self.0 & BUS_OFF != 0
    }

    pub(super) fn garbage(self) -> bool {
        self.0 & GARBAGE != 0
    }

    pub(super) fn trip(self) -> bool {
        self.0 & TRIP != 0
    }

    /// What the channel faults make of a sample; `last` is the sample before it.
    pub(super) fn spoil(self, values: &mut [f64; 5], last: &[f64; 5]) {
        if self.frozen() {
            *values = *last;
        }
        for (channel, (value, last)) in values.iter_mut().zip(last).enumerate() {
            if self.0 >> (STUCK_SHIFT as usize + channel) & 1 != 0 {
                *value = *last;
            }
        }
        let pair = self.0 >> SWAP_SHIFT;
        let (first, second) = ((pair & 7) as usize, (pair >> 3 & 7) as usize);
        if first != second && first < 5 && second < 5 {
            values.swap(first, second);
        }
        for (channel, value) in values.iter_mut().enumerate() {
            if self.0 >> (NAN_SHIFT as usize + channel) & 1 != 0 {
                *value = f64::NAN;
            }
        }
    }
}
