//! A DAQ device without a line of its own: bytes and samples come in, bytes go out.

use super::fault::Fault;
use crate::wire::{
    AckCode, Acknowledge, CHANNELS, COUNTS_FULL_SCALE, Calibration, Deframer, Identity, Kind, Message,
    PROTOCOL_VERSION, SampleFrame, Unit, WIRE_MAX, encode,
};
use std::vec::Vec;

/// Full scale of the emulated sensors, SI: 0.15 m, 2 g table, 4 g mass, 0.1 m laser.
const FULL_SCALE: [f64; CHANNELS] = [0.15, 19.6133, 39.2266, 39.2266, 0.1];

/// The device.
#[derive(Debug)]
pub struct DaqNode {
    identity: Identity,
    calibration: [Calibration; CHANNELS],
    deframer: Deframer,
    rate_mhz: u32,
    sequence: Option<u32>,
    /// Source channel and gain of each channel, for faults of the wiring.
    wiring: [(usize, f64); CHANNELS],
    bit_error_rate: f64,
    hold: u32,
    held: Vec<u8>,
    silent: bool,
    random: u64,
}

impl DaqNode {
    /// A device that waits for requests; `rate_hz` is the one rate it can do.
    pub fn new(vendor: u32, product: u32, serial: &str, rate_hz: f64, seed: u64) -> Self {
        let mut text = [0; 16];
        for (to, from) in text.iter_mut().zip(serial.bytes()) {
            *to = from;
        }
        let calibration = std::array::from_fn(|i| Calibration {
            channel: i as u8,
            unit: if matches!(i, 0 | 4) { Unit::Metre } else { Unit::MetrePerSecondSquared },
            scale: FULL_SCALE[i] / COUNTS_FULL_SCALE,
            offset: 0.0,
            full_scale: FULL_SCALE[i],
            date: 20_260_101,
            sensor: *b"EMULATED\0\0\0\0\0\0\0\0",
        });
        Self {
            identity: Identity {
                protocol: PROTOCOL_VERSION,
                vendor,
                product,
                firmware: 1 << 24,
                serial: text,
                channels: CHANNELS as u8,
            },
            calibration,
            deframer: Deframer::new(),
            rate_mhz: (rate_hz * 1e3).round() as u32,
            sequence: None,
            wiring: std::array::from_fn(|i| (i, 1.0)),
            bit_error_rate: 0.0,
            hold: 0,
            held: Vec::new(),
            silent: false,
            random: seed | 1,
        }
    }

    /// Whether it is sampling.
    pub fn running(&self) -> bool {
        self.sequence.is_some()
    }

    /// Number of the next sample; `None` while it is not sampling.
    pub fn sequence(&self) -> Option<u32> {
        self.sequence
    }

    /// Takes bytes from the host and appends the answers to `out`.
    pub fn on_bytes(&mut self, bytes: &[u8], out: &mut Vec<u8>) {
        let mut requests = Vec::new();
        self.deframer.feed(bytes, |found| requests.extend(found.ok()));
        for request in requests {
            if let Some(answer) = self.answer(&request) {
                append(&answer, out);
            }
        }
    }

    fn answer(&mut self, request: &Message) -> Option<Message> {
        let acknowledge = |request: Kind, code, value| {
            Some(Message::Acknowledge(Acknowledge { request: request as u8, code, value }))
        };
        match *request {
            Message::Identify => Some(Message::Identity(self.identity)),
            Message::ReadCalibration { channel } => match self.calibration.get(usize::from(channel)) {
                Some(calibration) => Some(Message::Calibration(*calibration)),
                None => acknowledge(Kind::ReadCalibration, AckCode::OutOfRange, CHANNELS as u32 - 1),
            },
            Message::Configure(_) | Message::Start { .. } if self.running() => {
                acknowledge(request.kind(), AckCode::WrongState, 0)
            }
            Message::Configure(configure) => {
                // The emulated front-end has the rate of its mechanics only.
                if configure.rate_mhz == self.rate_mhz {
                    return acknowledge(Kind::Configure, AckCode::Done, self.rate_mhz);
                }
                acknowledge(Kind::Configure, AckCode::OutOfRange, self.rate_mhz)
            }
            Message::Start { token } => {
                self.sequence = Some(0);
                acknowledge(Kind::Start, AckCode::Done, token)
            }
            Message::Stop => {
                self.sequence = None;
                acknowledge(Kind::Stop, AckCode::Done, 0)
            }
            // What only devices say is not for us.
            _ => None,
        }
    }

    /// Takes one instant, SI by channel, and appends what goes on the line to `out`.
    pub fn sample(&mut self, values: &[f64; CHANNELS], device_time_us: u64, out: &mut Vec<u8>) {
        let Some(sequence) = self.sequence else { return };
        self.sequence = Some(sequence.wrapping_add(1));
        if self.silent {
            return;
        }
        let mut frame = SampleFrame { sequence, device_time_us, ..SampleFrame::default() };
        for (i, (source, gain)) in self.wiring.iter().enumerate() {
            let (counts, fits) = self.calibration[i].counts(values[*source] * gain);
            frame.counts[i] = counts;
            if !fits {
                frame.status |= SampleFrame::OVERRANGE_0 << i;
            }
        }
        let from = self.held.len();
        append(&Message::Sample(frame), &mut self.held);
        if self.bit_error_rate > 0.0 {
            self.flip_bits(from);
        }
        self.hold = self.hold.saturating_sub(1);
        if self.hold == 0 {
            out.append(&mut self.held);
        }
    }

    /// Switches a fault of the device or its line on; faults of others are ignored.
    pub fn fault(&mut self, fault: Fault, out: &mut Vec<u8>) {
        match fault {
            Fault::DaqGarbage(bytes) => {
                for _ in 0..bytes {
                    out.push((self.uniform() * 256.0) as u8);
                }
            }
            Fault::DaqBitErrors(rate) => self.bit_error_rate = rate,
            Fault::DaqHold(samples) => self.hold = samples + 1,
            Fault::DaqSilent => self.silent = true,
            Fault::DaqSwap(a, b) => self.wiring.swap(a.into(), b.into()),
            Fault::DaqGain(channel, factor) => self.wiring[usize::from(channel)].1 = factor,
            _ => {}
        }
    }

    fn flip_bits(&mut self, from: usize) {
        for index in from..self.held.len() {
            for bit in 0..8 {
                if self.uniform() < self.bit_error_rate {
                    self.held[index] ^= 1 << bit;
                }
            }
        }
    }

    /// Uniform in [0, 1): Knuth's MMIX generator, good enough for noise on a line.
    fn uniform(&mut self) -> f64 {
        self.random =
            self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.random >> 11) as f64 / (1_u64 << 53) as f64
    }
}

fn append(message: &Message, out: &mut Vec<u8>) {
    let mut wire = [0; WIRE_MAX];
    let used = encode(message, &mut wire);
    out.extend(&wire[..used]);
}
