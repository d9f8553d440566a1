//! From a message to bytes on the line and back: checksum, COBS, delimiter.
//!
//! [`encode`] serves both ends. [`Deframer`] takes bytes as they come, finds the next delimiter after
//! any garbage by itself, and hands out what is between two delimiters as a message or as an error.

use super::fields::FieldWriter;
use super::{Kind, Message, WireError};
use crc::{CRC_32_ISO_HDLC, Crc, Table};

/// CRC-32 of Ethernet, zip and PNG (reflected 0x04C11DB7, start and final inversion): every
/// firmware tool chain has it. The 16-fold table makes the host some ten times faster.
const CRC: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISO_HDLC);

const CRC_BYTES: usize = 4;
/// Longest content with checksum: the calibration message.
const CONTENT_MAX: usize = 1 + Kind::Calibration.length() + CRC_BYTES;
/// Most bytes that a message takes on the line: content, one COBS byte (content is below 254) and
/// the delimiter.
pub const WIRE_MAX: usize = CONTENT_MAX + 2;
const SHORTEST: usize = 1 + CRC_BYTES;

/// Bytes of `message` on the line, delimiter included: written to the start of `wire`, number returned.
pub fn encode(message: &Message, wire: &mut [u8; WIRE_MAX]) -> usize {
    let mut content = [0_u8; CONTENT_MAX];
    let mut to = FieldWriter::new(&mut content);
    message.write(&mut to);
    let used = to.finish().unwrap_or(0);
    let checksum = CRC.checksum(&content[..used]);
    content[used..used + CRC_BYTES].copy_from_slice(&checksum.to_le_bytes());
    let coded = cobs::encode(&content[..used + CRC_BYTES], wire);
    wire[coded] = 0;
    coded + 1
}

/// Turns a stream of bytes into messages.
#[derive(Clone, Debug)]
pub struct Deframer {
    bytes: [u8; WIRE_MAX],
    used: usize,
    discarding: bool,
}

impl Default for Deframer {
    fn default() -> Self {
        Self::new()
    }
}

impl Deframer {
    /// Waits for the first frame.
    pub const fn new() -> Self {
        Self { bytes: [0; WIRE_MAX], used: 0, discarding: false }
    }

    /// Takes bytes and calls `found` for every frame that ends in them, in order.
    pub fn feed(&mut self, mut bytes: &[u8], mut found: impl FnMut(Result<Message, WireError>)) {
        while let Some(end) = bytes.iter().position(|byte| *byte == 0) {
            self.collect(&bytes[..end]);
            if let Some(result) = self.close() {
                found(result);
            }
            bytes = &bytes[end + 1..];
        }
        self.collect(bytes);
    }

    /// Keeps bytes of an unfinished frame. What is too long for any message is thrown away up to the
    /// next delimiter, so that a line full of noise costs no memory.
    fn collect(&mut self, bytes: &[u8]) {
        match self.bytes.get_mut(self.used..self.used + bytes.len()) {
            Some(room) if !self.discarding => {
                room.copy_from_slice(bytes);
                self.used += bytes.len();
            }
            _ => self.discarding = self.discarding || !bytes.is_empty(),
        }
    }

    /// A delimiter came: what lies before it. Nothing before it is a mere separator, no error.
    fn close(&mut self) -> Option<Result<Message, WireError>> {
        let used = core::mem::take(&mut self.used);
        if core::mem::take(&mut self.discarding) {
            return Some(Err(WireError::TooLong));
        }
        if used == 0 {
            return None;
        }
        Some(decode_frame(&mut self.bytes[..used]))
    }
}

/// Decodes what is between two delimiters, in place.
fn decode_frame(frame: &mut [u8]) -> Result<Message, WireError> {
    let length = cobs::decode_in_place(frame).map_err(|_| WireError::Cobs)?;
    let content = frame.get(..length).ok_or(WireError::Cobs)?;
    if length < SHORTEST {
        return Err(WireError::TooShort { received: length });
    }
    let (content, checksum) = content.split_at(length - CRC_BYTES);
    let received = checksum.iter().rev().fold(0, |sum, byte| (sum << 8) | u32::from(*byte));
    let computed = CRC.checksum(content);
    if computed != received {
        return Err(WireError::Crc { computed, received });
    }
    Message::read(content)
}
