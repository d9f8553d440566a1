//! What travels on the serial line between the host and the DAQ device.
//!
//! Firmware and host use this same module; it allocates nothing and cannot panic on any input. A
//! message has a fixed layout a kind ([`Message`]), little-endian, closed by a CRC-32, wrapped in
//! COBS and ended by a zero byte ([`frame`]). The page `docs/wire-formats.md` describes it for those
//! who write the firmware in another language, with test vectors in `vectors/`.

pub mod fields;
pub mod frame;
pub mod message;

pub use frame::{Deframer, WIRE_MAX, encode};
pub use message::{
    AckCode, Acknowledge, CHANNELS, COUNTS_FULL_SCALE, COUNTS_MAX, COUNTS_MIN, Calibration, Configure,
    Identity, Kind, Message, SampleFrame, Unit,
};

/// Version of this protocol; a device that speaks another one is refused.
pub const PROTOCOL_VERSION: u16 = 1;

/// Why bytes were not accepted as a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// The bytes between two delimiters are not COBS.
    #[error("not a COBS frame")]
    Cobs,
    /// More bytes without a delimiter than the longest message has.
    #[error("no delimiter within {WIRE_MAX} bytes")]
    TooLong,
    /// Fewer bytes than the shortest message has.
    #[error("{received} bytes are too few for a message")]
    TooShort {
        /// Decoded length.
        received: usize,
    },
    /// The checksum does not fit the content.
    #[error("CRC-32 is {computed:#010x}, the frame says {received:#010x}")]
    Crc {
        /// Over the content.
        computed: u32,
        /// In the frame.
        received: u32,
    },
    /// A sound frame of a kind that this version does not know.
    #[error("message kind {received:#04x} is unknown")]
    UnknownKind {
        /// The kind byte.
        received: u8,
    },
    /// A sound frame whose length does not fit its kind.
    #[error("message kind {kind:#04x} has {expected} bytes, received {received}")]
    Length {
        /// The kind byte.
        kind: u8,
        /// Length of that kind's content.
        expected: usize,
        /// Length received.
        received: usize,
    },
    /// A field holds a value that is not allowed there.
    #[error("field {field} of message kind {kind:#04x} is out of range")]
    Field {
        /// The kind byte.
        kind: u8,
        /// Name of the field.
        field: &'static str,
    },
}
