//! The messages and their layouts: one `struct` a kind, fields in the order of the wire.
//!
//! The host sends kinds below 0x80 and the device answers with those from 0x80 on; samples, the one
//! kind that is sent unasked, are 0xA0. Every layout has one length, so that a frame whose checksum
//! passes by chance must also have the right length to be taken for a message.

use super::WireError;
use super::fields::{FieldReader, FieldWriter};

/// Channels in a sample: table displacement, table acceleration, mass acceleration 1 and 2,
/// relative displacement.
pub const CHANNELS: usize = 5;
/// Largest count of a channel.
pub const COUNTS_MAX: i32 = (1 << 23) - 1;
/// Smallest count of a channel.
pub const COUNTS_MIN: i32 = -(1 << 23);
/// Counts that stand for the full scale of a sensor.
pub const COUNTS_FULL_SCALE: f64 = 8_388_608.0;

/// Kind byte of each message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Kind {
    /// Host: who are you?
    Identify = 0x01,
    /// Host: sample at this rate.
    Configure = 0x02,
    /// Host: begin to send samples, sequence number from 0.
    Start = 0x03,
    /// Host: end.
    Stop = 0x04,
    /// Host: send the calibration of one channel.
    ReadCalibration = 0x05,
    /// Device: who I am.
    Identity = 0x81,
    /// Device: done or refused.
    Acknowledge = 0x82,
    /// Device: calibration of one channel.
    Calibration = 0x85,
    /// Device: one sample of all channels.
    Sample = 0xA0,
}

impl Kind {
    const ALL: [Self; 9] = [
        Self::Identify,
        Self::Configure,
        Self::Start,
        Self::Stop,
        Self::ReadCalibration,
        Self::Identity,
        Self::Acknowledge,
        Self::Calibration,
        Self::Sample,
    ];

    /// The kind that a byte names.
    pub fn from_byte(byte: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| *kind as u8 == byte)
    }

    /// Length of the fields that follow the kind byte (checksum not counted), bytes.
    pub const fn length(self) -> usize {
        match self {
            Self::Identify | Self::Stop => 0,
            Self::Configure => 8,
            Self::Start => 4,
            Self::ReadCalibration => 1,
            Self::Identity => 2 + 4 + 4 + 4 + 16 + 1,
            Self::Acknowledge => 1 + 1 + 4,
            Self::Calibration => 1 + 1 + 8 + 8 + 8 + 4 + 16,
            Self::Sample => 2 + 4 + 8 + 3 * CHANNELS,
        }
    }
}

/// Host to device: how to sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Configure {
    /// Samples a second, in thousandths (2048 Hz is 2,048,000).
    pub rate_mhz: u32,
    /// Corner of the anti-aliasing filter, in thousandths of a hertz; 0 leaves it to the device.
    pub bandwidth_mhz: u32,
}

/// Device to host: who it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// [`super::PROTOCOL_VERSION`] of the firmware.
    pub protocol: u16,
    /// Vendor number.
    pub vendor: u32,
    /// Product number.
    pub product: u32,
    /// Firmware version, major in the top byte, then minor, then patch (16 bit).
    pub firmware: u32,
    /// Serial number, ASCII, zero-padded.
    pub serial: [u8; 16],
    /// Channels in a sample; [`CHANNELS`] in this protocol version.
    pub channels: u8,
}

/// What the device says to a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum AckCode {
    /// Done.
    Done = 0,
    /// The value is out of range; `value` holds the nearest allowed one.
    OutOfRange = 1,
    /// Not now (configure while running, start while running).
    WrongState = 2,
    /// The kind is not known to this firmware.
    Unknown = 3,
    /// The device found itself defective.
    Defective = 4,
}

impl AckCode {
    fn from_byte(byte: u8) -> Option<Self> {
        [Self::Done, Self::OutOfRange, Self::WrongState, Self::Unknown, Self::Defective]
            .into_iter()
            .find(|code| *code as u8 == byte)
    }
}

/// Device to host: the answer to configure, start and stop, and to what it did not understand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Acknowledge {
    /// Kind byte of the request.
    pub request: u8,
    /// The answer.
    pub code: AckCode,
    /// Configure: the rate in force, mHz. Start: the token of the request. Otherwise 0.
    pub value: u32,
}

/// SI unit of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Unit {
    /// m.
    Metre = 1,
    /// m/s2.
    MetrePerSecondSquared = 2,
}

/// Device to host: how counts of one channel become SI, kept in the device with the sensor.
///
/// `value = scale * counts + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// Channel, from 0, in the order of the sample.
    pub channel: u8,
    /// Unit of the value.
    pub unit: Unit,
    /// SI per count; finite and not zero. The sign belongs to it.
    pub scale: f64,
    /// SI at zero counts; finite.
    pub offset: f64,
    /// Full scale, SI: beyond it the device sets its over-range bit; above 0.
    pub full_scale: f64,
    /// Date of the calibration, YYYYMMDD in decimal; 0 when never calibrated.
    pub date: u32,
    /// Serial number of the sensor, ASCII, zero-padded.
    pub sensor: [u8; 16],
}

impl Calibration {
    /// The value of `counts`, SI.
    pub fn value(&self, counts: i32) -> f64 {
        self.scale * f64::from(counts) + self.offset
    }

    /// The counts nearest to `value` (SI), and whether it fits the range of a channel.
    pub fn counts(&self, value: f64) -> (i32, bool) {
        let exact = (value - self.offset) / self.scale;
        // `round` needs std; half away from zero by hand, NaN becomes 0 through the cast.
        let rounded = if exact < 0.0 { exact - 0.5 } else { exact + 0.5 };
        let counts = rounded as i64;
        let limited = counts.clamp(i64::from(COUNTS_MIN), i64::from(COUNTS_MAX));
        (limited as i32, exact.is_finite() && limited == counts)
    }
}

/// Device to host: all channels at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SampleFrame {
    /// Bits of [`SampleFrame::OVERRANGE_0`] and following.
    pub status: u16,
    /// Counts instants since start; advances also when a sample could not be sent.
    pub sequence: u32,
    /// Device time of the instant at which the channels were held, us since power-up.
    pub device_time_us: u64,
    /// Counts, 24 bit two's complement on the wire; values beyond are cut to the range.
    pub counts: [i32; CHANNELS],
}

impl SampleFrame {
    /// Channel 0 is beyond its full scale; channel `n` has bit `n`.
    pub const OVERRANGE_0: u16 = 1 << 0;
    /// Any channel beyond its full scale.
    pub const OVERRANGE_ANY: u16 = (1 << CHANNELS) - 1;
    /// The device had to drop samples before this one (its own send buffer was full).
    pub const OVERFLOW: u16 = 1 << 8;
    /// Sensor supply out of tolerance.
    pub const SUPPLY: u16 = 1 << 9;
}

/// Everything that travels on the line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Message {
    /// See [`Kind::Identify`].
    Identify,
    /// See [`Kind::Configure`].
    Configure(Configure),
    /// See [`Kind::Start`]; the token comes back in the answer.
    Start {
        /// Any number.
        token: u32,
    },
    /// See [`Kind::Stop`].
    Stop,
    /// See [`Kind::ReadCalibration`].
    ReadCalibration {
        /// Channel, from 0.
        channel: u8,
    },
    /// See [`Kind::Identity`].
    Identity(Identity),
    /// See [`Kind::Acknowledge`].
    Acknowledge(Acknowledge),
    /// See [`Kind::Calibration`].
    Calibration(Calibration),
    /// See [`Kind::Sample`].
    Sample(SampleFrame),
}

impl Message {
    /// The kind byte that the message goes by.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Identify => Kind::Identify,
            Self::Configure(_) => Kind::Configure,
            Self::Start { .. } => Kind::Start,
            Self::Stop => Kind::Stop,
            Self::ReadCalibration { .. } => Kind::ReadCalibration,
            Self::Identity(_) => Kind::Identity,
            Self::Acknowledge(_) => Kind::Acknowledge,
            Self::Calibration(_) => Kind::Calibration,
            Self::Sample(_) => Kind::Sample,
        }
    }

    /// Writes kind byte and fields.
    pub(super) fn write(&self, to: &mut FieldWriter<'_>) {
        to.uint(self.kind() as u64, 1);
        match self {
            Self::Identify | Self::Stop => {}
            Self::Configure(c) => {
                to.uint(c.rate_mhz.into(), 4).uint(c.bandwidth_mhz.into(), 4);
            }
            Self::Start { token } => {
                to.uint((*token).into(), 4);
            }
            Self::ReadCalibration { channel } => {
                to.uint((*channel).into(), 1);
            }
            Self::Identity(i) => {
                to.uint(i.protocol.into(), 2).uint(i.vendor.into(), 4).uint(i.product.into(), 4);
                to.uint(i.firmware.into(), 4).bytes(&i.serial).uint(i.channels.into(), 1);
            }
            Self::Acknowledge(a) => {
                to.uint(a.request.into(), 1).uint(a.code as u64, 1).uint(a.value.into(), 4);
            }
            Self::Calibration(c) => {
                to.uint(c.channel.into(), 1).uint(c.unit as u64, 1);
                to.float(c.scale).float(c.offset).float(c.full_scale);
                to.uint(c.date.into(), 4).bytes(&c.sensor);
            }
            Self::Sample(s) => {
                to.uint(s.status.into(), 2).uint(s.sequence.into(), 4).uint(s.device_time_us, 8);
                for counts in s.counts {
                    to.uint(counts.clamp(COUNTS_MIN, COUNTS_MAX) as u64, 3);
                }
            }
        }
    }

    /// Reads a message from kind byte and fields, the checksum being checked and taken off.
    pub(super) fn read(content: &[u8]) -> Result<Self, WireError> {
        let (&byte, fields) = content.split_first().ok_or(WireError::TooShort { received: 0 })?;
        let kind = Kind::from_byte(byte).ok_or(WireError::UnknownKind { received: byte })?;
        if fields.len() != kind.length() {
            return Err(WireError::Length { kind: byte, expected: kind.length(), received: fields.len() });
        }
        let mut from = FieldReader::new(fields);
        // The length was checked, so a field can only be missing if `Kind::length` were wrong.
        Self::read_fields(kind, &mut from)
            .unwrap_or(Err("length"))
            .map_err(|field| WireError::Field { kind: byte, field })
    }

    fn read_fields(kind: Kind, from: &mut FieldReader<'_>) -> Option<Result<Self, &'static str>> {
        Some(Ok(match kind {
            Kind::Identify => Self::Identify,
            Kind::Stop => Self::Stop,
            Kind::Configure => Self::Configure(Configure {
                rate_mhz: from.uint(4)? as u32,
                bandwidth_mhz: from.uint(4)? as u32,
            }),
            Kind::Start => Self::Start { token: from.uint(4)? as u32 },
            Kind::ReadCalibration => Self::ReadCalibration { channel: from.uint(1)? as u8 },
            Kind::Identity => Self::Identity(Identity {
                protocol: from.uint(2)? as u16,
                vendor: from.uint(4)? as u32,
                product: from.uint(4)? as u32,
                firmware: from.uint(4)? as u32,
                serial: from.text()?,
                channels: from.uint(1)? as u8,
            }),
            Kind::Acknowledge => {
                let (request, code) = (from.uint(1)? as u8, from.uint(1)? as u8);
                let Some(code) = AckCode::from_byte(code) else { return Some(Err("code")) };
                Self::Acknowledge(Acknowledge { request, code, value: from.uint(4)? as u32 })
            }
            Kind::Calibration => return Self::read_calibration(from),
            Kind::Sample => {
                let mut sample = SampleFrame {
                    status: from.uint(2)? as u16,
                    sequence: from.uint(4)? as u32,
                    device_time_us: from.uint(8)?,
                    counts: [0; CHANNELS],
                };
                for counts in &mut sample.counts {
                    *counts = from.int(3)?;
                }
                Self::Sample(sample)
            }
        }))
    }

    fn read_calibration(from: &mut FieldReader<'_>) -> Option<Result<Self, &'static str>> {
        let channel = from.uint(1)? as u8;
        let unit = match from.uint(1)? {
            1 => Unit::Metre,
            2 => Unit::MetrePerSecondSquared,
            _ => return Some(Err("unit")),
        };
        let (scale, offset, full_scale) = (from.float()?, from.float()?, from.float()?);
        let (date, sensor) = (from.uint(4)? as u32, from.text()?);
        if usize::from(channel) >= CHANNELS {
            return Some(Err("channel"));
        }
        if !scale.is_finite() || scale == 0.0 {
            return Some(Err("scale"));
        }
        if !offset.is_finite() {
            return Some(Err("offset"));
        }
        if !full_scale.is_finite() || full_scale <= 0.0 {
            return Some(Err("full_scale"));
        }
        Some(Ok(Self::Calibration(Calibration { channel, unit, scale, offset, full_scale, date, sensor })))
    }
}
