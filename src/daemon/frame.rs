//! Binary frames of the live view: a head of 32 bytes and little-endian 32-bit floats, channel after
//! channel, made once for all clients. The layout is public (`docs/daemon.md`).

use crate::stream::Row;

/// Channels of a frame, in order.
pub const CHANNELS: [&str; 10] = [
    "table_displacement_m",
    "table_acceleration_m_s2",
    "mass_acceleration_m_s2",
    "relative_displacement_m",
    "model_acceleration_m_s2",
    "model_displacement_m",
    "command_displacement_m",
    "command_acceleration_m_s2",
    "step",
    "regime",
];
/// Their number.
pub const WIDTH: usize = CHANNELS.len();
/// Channels whose smallest and largest value is kept when rows are joined; of the others the last.
const ENVELOPES: usize = 8;
/// First byte of every frame.
pub const MAGIC: u8 = 0x53;
/// Bytes before the first number.
pub const HEAD: usize = 32;
/// A frame that follows what went before.
pub const FOLLOWS: u8 = 0;
/// The frame holds the past: whatever the client has shown so far is replaced.
pub const REPLACES: u8 = 1;

/// One row as the live view shows it.
pub type Point = [f32; WIDTH];

/// The row in the order of [`CHANNELS`]. The regime is a number: branch, then 16 for the right contact, 32
/// for the left, 64 for sticking.
pub fn point(row: &Row) -> Point {
    let c = &row.sample.channels;
    let regime = u32::from(row.model_regime.isolator_branch)
        + 16 * u32::from(row.model_regime.right_contact)
        + 32 * u32::from(row.model_regime.left_contact)
        + 64 * u32::from(row.model_regime.sticking);
    [
        c.table_displacement_m as f32,
        c.table_acceleration_m_s2 as f32,
        c.mass_acceleration_m_s2() as f32,
        c.relative_displacement_m as f32,
        row.model_acceleration_m_s2 as f32,
        row.model_displacement_m as f32,
        row.command.displacement_m as f32,
        row.command.acceleration_m_s2 as f32,
        row.step as f32,
        regime as f32,
    ]
}

/// Joins rows: `factor` of them become two points, the smallest and the largest of each channel.
#[derive(Clone, Debug)]
pub struct Envelope {
    factor: u64,
    low: Point,
    high: Point,
    joined: u64,
}

impl Envelope {
    /// Joins `factor` rows; 1 leaves them as they are.
    pub fn new(factor: u64) -> Self {
        Self { factor, low: [0.0; WIDTH], high: [0.0; WIDTH], joined: 0 }
    }

    /// Rows that become two points.
    pub fn factor(&self) -> u64 {
        self.factor
    }

    /// Forgets a pair that is not complete.
    pub fn clear(&mut self) {
        self.joined = 0;
    }

    /// Takes a row; gives the two points once enough are joined.
    pub fn push(&mut self, point: &Point) -> Option<[Point; 2]> {
        if self.joined == 0 {
            (self.low, self.high) = (*point, *point);
        }
        for (k, ((low, high), value)) in self.low.iter_mut().zip(&mut self.high).zip(point).enumerate() {
            let enveloped = k < ENVELOPES;
            *low = if enveloped { low.min(*value) } else { *value };
            *high = if enveloped { high.max(*value) } else { *value };
        }
        self.joined += 1;
        (self.joined >= self.factor).then(|| {
            self.joined = 0;
            [self.low, self.high]
        })
    }
}

/// What the head of a frame says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head {
    /// [`FOLLOWS`] or [`REPLACES`].
    pub kind: u8,
    /// Points a channel.
    pub count: u32,
    /// Rows that two points stand for; 1: every point is a row.
    pub factor: u32,
    /// Number of the run since the daemon's start; a new one clears the view.
    pub run: u32,
    /// Sequence number of the first row.
    pub first: u64,
}

/// Writes a frame. `dropped` in the head is left zero: it is the client's own number, see [`stamp`].
pub fn encode(head: &Head, points: &[Point]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEAD + 4 * WIDTH * points.len());
    bytes.extend([MAGIC, 1, head.kind, WIDTH as u8]);
    bytes.extend(head.count.to_le_bytes());
    bytes.extend(head.factor.to_le_bytes());
    bytes.extend(head.run.to_le_bytes());
    bytes.extend(head.first.to_le_bytes());
    bytes.extend(0u32.to_le_bytes());
    bytes.extend(0u32.to_le_bytes());
    for channel in 0..WIDTH {
        for point in points {
            bytes.extend(point[channel].to_le_bytes());
        }
    }
    bytes
}

impl Head {
    /// Reads the head of a frame, and the number of frames that its client had not got by then; `None` when it is no frame.
    pub fn read(frame: &[u8]) -> Option<(Self, u32)> {
        let word = |at: usize| Some(u32::from_le_bytes(frame.get(at..at + 4)?.try_into().ok()?));
        let [MAGIC, 1, kind, _] = *frame.get(..4)? else { return None };
        let first = u64::from_le_bytes(frame.get(16..24)?.try_into().ok()?);
        let head = Self { kind, count: word(4)?, factor: word(8)?, run: word(12)?, first };
        Some((head, word(24)?))
    }
}

/// Puts the number of frames that this client did not get into the head of its copy.
pub fn stamp(frame: &mut [u8], dropped: u32) {
    if let Some(place) = frame.get_mut(24..28) {
        place.copy_from_slice(&dropped.to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_head_and_the_order_are_as_documented() {
        let points = [[1.0; WIDTH], [2.0; WIDTH]];
        let head = Head { kind: REPLACES, count: 2, factor: 1, run: 7, first: 0x0102_0304_0506_0708 };
        let mut bytes = encode(&head, &points);
        stamp(&mut bytes, 5);
        assert_eq!(bytes.len(), HEAD + 2 * 4 * WIDTH);
        assert_eq!(bytes[..4], [MAGIC, 1, 1, 10]);
        assert_eq!(bytes[4..16], [2, 0, 0, 0, 1, 0, 0, 0, 7, 0, 0, 0]);
        assert_eq!(bytes[16..24], [8, 7, 6, 5, 4, 3, 2, 1]);
        assert_eq!(bytes[24..32], [5, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(bytes[32..40], [0, 0, 128, 63, 0, 0, 0, 64]);
        assert_eq!(Head::read(&bytes), Some((head, 5)));
        assert_eq!(Head::read(&bytes[..HEAD - 5]), None);
    }

    #[test]
    fn an_envelope_keeps_every_peak() {
        let mut envelope = Envelope::new(16);
        let mut seen = Vec::new();
        for n in 0..160_u32 {
            let mut point = [0.0; WIDTH];
            point[2] = if n == 37 { 9.0 } else { 0.0 };
            point[3] = if n == 91 { -4.0 } else { 0.0 };
            point[8] = n as f32;
            seen.extend(envelope.push(&point).into_iter().flatten());
        }
        assert_eq!(seen.len(), 20);
        assert_eq!(seen.iter().map(|p| p[2]).fold(0.0, f32::max), 9.0);
        assert_eq!(seen.iter().map(|p| p[3]).fold(0.0, f32::min), -4.0);
        assert_eq!(seen[19][8], 159.0);
    }
}
