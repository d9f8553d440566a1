//! CANopen (CiA 301) and the drive profile CiA 402, as far as one servo drive needs them.
//!
//! Nothing here does input or output: state machines take frames and hand out frames, so that the host's
//! master, the drive emulator and firmware share them. Object numbers stand in [`objects`].

pub mod cia402;
pub mod emcy;
pub mod nmt;
pub mod objects;
pub mod pdo;
pub mod sdo;

/// A classic CAN data frame with an 11-bit identifier.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Frame {
    /// Identifier, 0 to 0x7FF.
    pub id: u16,
    len: u8,
    data: [u8; 8],
}

impl Frame {
    /// A frame with up to 8 data bytes; more are cut off.
    pub fn new(id: u16, data: &[u8]) -> Self {
        let len = data.len().min(8);
        let mut bytes = [0; 8];
        bytes[..len].copy_from_slice(&data[..len]);
        Self { id: id & 0x7FF, len: len as u8, data: bytes }
    }

    /// The data bytes.
    pub fn data(&self) -> &[u8] {
        &self.data[..usize::from(self.len)]
    }

    /// All 8 bytes, if there are 8 (SDO frames always have).
    pub fn full(&self) -> Option<&[u8; 8]> {
        (self.len == 8).then_some(&self.data)
    }
}

/// Identifiers of the predefined connection set (CiA 301, 7.3.5), for a node of number 1 to 127.
pub mod cob {
    /// NMT commands, from the master to all.
    pub const NMT: u16 = 0x000;
    /// SYNC.
    pub const SYNC: u16 = 0x080;
    /// EMCY of a node.
    pub const fn emcy(node: u8) -> u16 {
        0x080 + node as u16
    }
    /// Transmit PDO `n` (0 to 3) of a node.
    pub const fn tpdo(n: u8, node: u8) -> u16 {
        0x180 + 0x100 * n as u16 + node as u16
    }
    /// Receive PDO `n` (0 to 3) of a node.
    pub const fn rpdo(n: u8, node: u8) -> u16 {
        0x200 + 0x100 * n as u16 + node as u16
    }
    /// SDO answers of a node.
    pub const fn sdo_answer(node: u8) -> u16 {
        0x580 + node as u16
    }
    /// SDO requests to a node.
    pub const fn sdo_request(node: u8) -> u16 {
        0x600 + node as u16
    }
    /// Heartbeat and boot-up of a node.
    pub const fn heartbeat(node: u8) -> u16 {
        0x700 + node as u16
    }
}
