//! Process data: which objects travel in which PDO, and their packing.
//!
//! Two PDOs each way, because position, velocity feed-forward and controlword exceed 8 bytes. All are
//! synchronous (transmission type 1): outputs take effect at the SYNC that follows, inputs are
//! sampled at the SYNC.

use super::objects::{self, Address};
use super::{Frame, cob};
use crate::wire::fields::{FieldReader, FieldWriter};

/// One object in a PDO.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mapped {
    /// The object.
    pub address: Address,
    /// Its length, bits.
    pub bits: u8,
}

impl Mapped {
    const fn new(address: Address, bits: u8) -> Self {
        Self { address, bits }
    }

    /// The entry as the mapping object holds it (CiA 301, 7.4.8.2).
    pub fn entry(self) -> u32 {
        u32::from(self.address.index) << 16 | u32::from(self.address.sub) << 8 | u32::from(self.bits)
    }
}

/// Outputs in receive PDO 1: controlword and target position.
pub const RPDO1: [Mapped; 2] =
    [Mapped::new(objects::CONTROLWORD, 16), Mapped::new(objects::TARGET_POSITION, 32)];
/// Outputs in receive PDO 2: velocity and torque feed-forward.
pub const RPDO2: [Mapped; 2] =
    [Mapped::new(objects::VELOCITY_OFFSET, 32), Mapped::new(objects::TORQUE_OFFSET, 16)];
/// Inputs in transmit PDO 1: statusword and actual position.
pub const TPDO1: [Mapped; 2] = [Mapped::new(objects::STATUSWORD, 16), Mapped::new(objects::POSITION, 32)];
/// Inputs in transmit PDO 2: following error and actual velocity.
pub const TPDO2: [Mapped; 2] =
    [Mapped::new(objects::FOLLOWING_ERROR, 32), Mapped::new(objects::VELOCITY, 32)];

/// What the host sends each cycle, in the drive's units.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outputs {
    /// Controlword.
    pub controlword: u16,
    /// Target position, counts.
    pub target_position: i32,
    /// Velocity feed-forward, drive units.
    pub velocity_offset: i32,
    /// Torque feed-forward, per mille of the rated torque.
    pub torque_offset: i16,
}

impl Outputs {
    /// The two frames for `node`.
    pub fn frames(&self, node: u8) -> [Frame; 2] {
        let mut bytes = [0; 6];
        FieldWriter::new(&mut bytes)
            .uint(self.controlword.into(), 2)
            .uint(self.target_position as u32 as u64, 4);
        let first = Frame::new(cob::rpdo(0, node), &bytes);
        FieldWriter::new(&mut bytes)
            .uint(self.velocity_offset as u32 as u64, 4)
            .uint(self.torque_offset as u16 as u64, 2);
        [first, Frame::new(cob::rpdo(1, node), &bytes)]
    }

    /// Takes over what a frame to `node` carries; says whether it was one of the two.
    pub fn take(&mut self, frame: &Frame, node: u8) -> bool {
        let mut fields = FieldReader::new(frame.data());
        if frame.id == cob::rpdo(0, node)
            && let (Some(word), Some(position)) = (fields.uint(2), fields.int(4))
        {
            self.controlword = word as u16;
            self.target_position = position;
            return true;
        }
        if frame.id == cob::rpdo(1, node)
            && let (Some(velocity), Some(torque)) = (fields.int(4), fields.int(2))
        {
            self.velocity_offset = velocity;
            self.torque_offset = torque as i16;
            return true;
        }
        false
    }
}

/// What the drive sends each cycle, in its units.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Inputs {
    /// Statusword.
    pub statusword: u16,
    /// Actual position, counts.
    pub position: i32,
    /// Following error, counts.
    pub following_error: i32,
    /// Actual velocity, drive units.
    pub velocity: i32,
}

impl Inputs {
    /// The two frames of `node`.
    pub fn frames(&self, node: u8) -> [Frame; 2] {
        let mut bytes = [0; 8];
        FieldWriter::new(&mut bytes).uint(self.statusword.into(), 2).uint(self.position as u32 as u64, 4);
        let first = Frame::new(cob::tpdo(0, node), &bytes[..6]);
        FieldWriter::new(&mut bytes)
            .uint(self.following_error as u32 as u64, 4)
            .uint(self.velocity as u32 as u64, 4);
        [first, Frame::new(cob::tpdo(1, node), &bytes)]
    }

    /// Takes over what a frame of `node` carries: the number of the PDO (0 or 1) if it was one.
    pub fn take(&mut self, frame: &Frame, node: u8) -> Option<u8> {
        let mut fields = FieldReader::new(frame.data());
        if frame.id == cob::tpdo(0, node)
            && let (Some(word), Some(position)) = (fields.uint(2), fields.int(4))
        {
            self.statusword = word as u16;
            self.position = position;
            return Some(0);
        }
        if frame.id == cob::tpdo(1, node)
            && let (Some(error), Some(velocity)) = (fields.int(4), fields.int(4))
        {
            self.following_error = error;
            self.velocity = velocity;
            return Some(1);
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_directions_survive_the_bus() {
        let outputs = Outputs {
            controlword: 0x1F,
            target_position: -123_456,
            velocity_offset: i32::MIN,
            torque_offset: -7,
        };
        let mut heard = Outputs::default();
        assert!(outputs.frames(5).iter().all(|frame| heard.take(frame, 5)));
        assert_eq!(heard, outputs);
        assert!(!heard.take(&outputs.frames(6)[0], 5));
        let inputs = Inputs { statusword: 0x1237, position: i32::MAX, following_error: -1, velocity: -2 };
        let mut heard = Inputs::default();
        let numbers = inputs.frames(5).map(|frame| heard.take(&frame, 5));
        assert_eq!((heard, numbers), (inputs, [Some(0), Some(1)]));
    }

    #[test]
    fn mappings_fit_a_frame_and_read_as_the_standard_writes_them() {
        for mapping in [RPDO1, RPDO2, TPDO1, TPDO2] {
            assert!(mapping.iter().map(|m| u32::from(m.bits)).sum::<u32>() <= 64);
        }
        assert_eq!(RPDO1[1].entry(), 0x607A_0020);
    }
}
