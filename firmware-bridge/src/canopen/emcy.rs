//! Emergency messages (CiA 301, 7.2.7): what a drive says when it trips.

use super::{Frame, cob};
use crate::wire::fields::{FieldReader, FieldWriter};

/// One emergency message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Emergency {
    /// Error code; 0 when the error has gone.
    pub code: u16,
    /// Error register (object 0x1001).
    pub register: u8,
    /// Five bytes of the manufacturer.
    pub manufacturer: [u8; 5],
}

impl Emergency {
    /// The frame of a node.
    pub fn frame(&self, node: u8) -> Frame {
        let mut bytes = [0; 8];
        FieldWriter::new(&mut bytes)
            .uint(self.code.into(), 2)
            .uint(self.register.into(), 1)
            .bytes(&self.manufacturer);
        Frame::new(cob::emcy(node), &bytes)
    }

    /// The message in a frame of `node`.
    pub fn from_frame(frame: &Frame, node: u8) -> Option<Self> {
        if frame.id != cob::emcy(node) || frame.full().is_none() {
            return None;
        }
        let mut fields = FieldReader::new(frame.data());
        Some(Self {
            code: fields.uint(2)? as u16,
            register: fields.uint(1)? as u8,
            manufacturer: fields.bytes(5)?.try_into().ok()?,
        })
    }

    /// What the code means: exact for those that a drive sends on its own protection (CiA 402-2 and
    /// CiA 301), else by its class.
    pub fn meaning(&self) -> &'static str {
        match self.code {
            0x2310..=0x231F => "continuous over-current",
            0x2320..=0x232F => "short circuit or earth leakage",
            0x3210 => "DC link over-voltage",
            0x3220 => "DC link under-voltage",
            0x4210 => "drive too hot",
            0x4310 => "motor too hot",
            0x5441 | 0x5442 => "limit switch or emergency stop input",
            0x6320 => "parameter error",
            0x7121 => "motor blocked",
            0x7300..=0x73FF => "position sensor",
            0x8110 => "CAN overrun",
            0x8120 => "CAN error-passive",
            0x8130 => "heartbeat of the host lost",
            0x8140 => "recovered from bus-off",
            0x8210 => "PDO too short",
            0x8250 => "RPDO timed out",
            0x8611 => "following error",
            0x8612 => "position limit",
            0x8700 => "SYNC lost",
            code => match code >> 8 {
                0x00 => "no error",
                0x10 => "generic error",
                0x20..=0x2F => "current",
                0x30..=0x3F => "voltage",
                0x40..=0x4F => "temperature",
                0x50..=0x5F => "device hardware",
                0x60..=0x6F => "device software",
                0x70..=0x7F => "additional modules",
                0x80..=0x8F => "monitoring",
                0x90..=0x9F => "external error",
                0xF0..=0xFF => "additional functions",
                _ => "unknown",
            },
        }
    }
}
