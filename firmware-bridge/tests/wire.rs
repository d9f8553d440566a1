//! The wire format against vectors made by other code, and against everything that a line can do to
//! a frame.

use firmware_bridge::wire::{
    AckCode, Acknowledge, CHANNELS, COUNTS_MAX, COUNTS_MIN, Calibration, Configure, Deframer, Identity,
    Message, SampleFrame, Unit, WIRE_MAX, WireError, encode,
};
use proptest::prelude::*;
use serde_json::Value;

fn wire_of(message: &Message) -> Vec<u8> {
    let mut wire = [0; WIRE_MAX];
    let used = encode(message, &mut wire);
    wire[..used].to_vec()
}

fn decoded(bytes: &[u8]) -> Vec<Result<Message, WireError>> {
    let mut found = Vec::new();
    Deframer::new().feed(bytes, |result| found.push(result));
    found
}

fn bytes_of(hex: &str) -> Vec<u8> {
    (0..hex.len()).step_by(2).map(|i| u8::from_str_radix(&hex[i..i + 2], 16).expect("hex")).collect()
}

/// The message that a vector describes, from its named fields.
fn described(vector: &Value) -> Message {
    let number = |key: &str| vector[key].as_u64().expect("unsigned");
    let float = |key: &str| vector[key].as_f64().expect("float");
    let text = |key: &str| {
        let mut bytes = [0; 16];
        let source = vector[key].as_str().expect("text").as_bytes();
        bytes[..source.len()].copy_from_slice(source);
        bytes
    };
    match vector["kind"].as_str().expect("kind") {
        "identify" => Message::Identify,
        "stop" => Message::Stop,
        "start" => Message::Start { token: number("token") as u32 },
        "read-calibration" => Message::ReadCalibration { channel: number("channel") as u8 },
        "configure" => Message::Configure(Configure {
            rate_mhz: number("rate_mhz") as u32,
            bandwidth_mhz: number("bandwidth_mhz") as u32,
        }),
        "identity" => Message::Identity(Identity {
            protocol: number("protocol") as u16,
            vendor: number("vendor") as u32,
            product: number("product") as u32,
            firmware: number("firmware") as u32,
            serial: text("serial"),
            channels: number("channels") as u8,
        }),
        "acknowledge" => Message::Acknowledge(Acknowledge {
            request: number("request") as u8,
            code: [AckCode::Done, AckCode::OutOfRange, AckCode::WrongState, AckCode::Unknown]
                [number("code") as usize],
            value: number("value") as u32,
        }),
        "calibration" => Message::Calibration(Calibration {
            channel: number("channel") as u8,
            unit: [Unit::Metre, Unit::MetrePerSecondSquared][number("unit") as usize - 1],
            scale: float("scale"),
            offset: float("offset"),
            full_scale: float("full_scale"),
            date: number("date") as u32,
            sensor: text("sensor"),
        }),
        "sample" => Message::Sample(SampleFrame {
            status: number("status") as u16,
            sequence: number("sequence") as u32,
            device_time_us: number("device_time_us"),
            counts: std::array::from_fn(|i| vector["counts"][i].as_i64().expect("count") as i32),
        }),
        other => panic!("unknown vector kind {other}"),
    }
}

#[test]
fn vectors_hold_in_both_directions() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/vectors/daq-frames.json");
    let vectors: Vec<Value> =
        serde_json::from_str(&std::fs::read_to_string(file).expect("vectors")).expect("JSON");
    assert!(vectors.len() >= 17);
    for vector in &vectors {
        let message = described(vector);
        let wire = bytes_of(vector["wire"].as_str().expect("wire"));
        assert_eq!(wire_of(&message), wire, "encoding {vector}");
        assert_eq!(decoded(&wire), [Ok(message)], "decoding {vector}");
    }
}

/// One message of each kind, with bytes that stress the coding (zeros, ones, mixed).
fn one_of_each() -> Vec<Message> {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/vectors/daq-frames.json");
    let vectors: Vec<Value> =
        serde_json::from_str(&std::fs::read_to_string(file).expect("vectors")).expect("JSON");
    vectors.iter().map(described).collect()
}

#[test]
fn every_single_bit_flip_is_detected() {
    for message in one_of_each() {
        let wire = wire_of(&message);
        // A sound neighbour on each side: a flipped delimiter may cost the next frame, never invent one.
        let neighbour = Message::Start { token: 0x5555_5555 };
        let around = wire_of(&neighbour);
        for bit in 0..8 * wire.len() {
            let mut stream = around.clone();
            stream.extend(&wire);
            stream[around.len() + bit / 8] ^= 1 << (bit % 8);
            stream.extend(&around);
            stream.extend(&around);
            let messages: Vec<Message> = decoded(&stream).into_iter().flatten().collect();
            assert!(!messages.contains(&message), "flip of bit {bit} of {message:?} went unseen");
            assert!(messages.iter().all(|m| *m == neighbour), "flip of bit {bit} made {messages:?}");
            assert!(messages.len() >= 2, "a flip of bit {bit} cost more than the frame and its neighbour");
        }
    }
}

#[test]
fn every_pair_of_flips_in_a_sample_is_detected() {
    let message = Message::Sample(SampleFrame {
        status: 0,
        sequence: 77,
        device_time_us: 37_597,
        counts: [1, -1, 300, -300, 70_000],
    });
    let wire = wire_of(&message);
    for first in 0..8 * wire.len() {
        for second in first + 1..8 * wire.len() {
            let mut bent = wire.clone();
            bent[first / 8] ^= 1 << (first % 8);
            bent[second / 8] ^= 1 << (second % 8);
            let survived = decoded(&bent).into_iter().flatten().count();
            assert_eq!(survived, 0, "flips of bits {first} and {second}");
        }
    }
}

fn any_sample() -> impl Strategy<Value = SampleFrame> {
    (any::<u16>(), any::<u32>(), any::<u64>(), prop::array::uniform5(COUNTS_MIN..=COUNTS_MAX)).prop_map(
        |(status, sequence, device_time_us, counts)| SampleFrame { status, sequence, device_time_us, counts },
    )
}

fn any_message() -> impl Strategy<Value = Message> {
    prop_oneof![
        8 => any_sample().prop_map(Message::Sample),
        1 => any::<u32>().prop_map(|token| Message::Start { token }),
        1 => (any::<u32>(), any::<u32>())
            .prop_map(|(rate_mhz, bandwidth_mhz)| Message::Configure(Configure { rate_mhz, bandwidth_mhz })),
        1 => any::<u8>().prop_map(|channel| Message::ReadCalibration { channel }),
        1 => (0..CHANNELS as u8, -1.0e3..1.0e3, any::<[u8; 16]>()).prop_map(|(channel, offset, sensor)| {
            Message::Calibration(Calibration {
                channel,
                unit: Unit::Metre,
                scale: 1e-8,
                offset,
                full_scale: 0.1,
                date: 20_260_101,
                sensor,
            })
        }),
    ]
}

proptest! {
    #[test]
    fn what_is_encoded_is_decoded(messages in prop::collection::vec(any_message(), 1..20), cut in 1_usize..40) {
        let stream: Vec<u8> = messages.iter().flat_map(wire_of).collect();
        let mut deframer = Deframer::new();
        let mut found = Vec::new();
        // The line delivers in pieces of any size.
        for piece in stream.chunks(cut) {
            deframer.feed(piece, |result| found.push(result.expect("sound")));
        }
        prop_assert_eq!(found, messages);
    }

    #[test]
    fn after_any_garbage_the_second_frame_is_whole(garbage in prop::collection::vec(any::<u8>(), 0..400),
                                                  first in any_sample(), second in any_sample()) {
        let mut stream = garbage;
        stream.extend(wire_of(&Message::Sample(first)));
        stream.extend(wire_of(&Message::Sample(second)));
        let messages: Vec<Message> = decoded(&stream).into_iter().flatten().collect();
        prop_assert_eq!(messages.last(), Some(&Message::Sample(second)));
    }

    #[test]
    fn counts_and_values_agree_within_half_a_count(value in -0.0999_f64..0.0999, channel in 0_u8..5) {
        let calibration = Calibration { channel, unit: Unit::Metre, scale: 0.1 / 8_388_608.0, offset: 0.0,
                                        full_scale: 0.1, date: 0, sensor: [0; 16] };
        let (counts, fits) = calibration.counts(value);
        prop_assert!(fits);
        prop_assert!((calibration.value(counts) - value).abs() <= 0.500_001 * calibration.scale);
    }
}

#[test]
fn values_beyond_the_range_are_cut_and_said_to_be() {
    let calibration = Calibration {
        channel: 0,
        unit: Unit::Metre,
        scale: -0.1 / 8_388_608.0,
        offset: 0.0,
        full_scale: 0.1,
        date: 0,
        sensor: [0; 16],
    };
    assert_eq!(calibration.counts(0.2), (COUNTS_MIN, false));
    assert_eq!(calibration.counts(-0.2), (COUNTS_MAX, false));
    assert!(!calibration.counts(f64::NAN).1);
}

#[test]
fn lengths_and_fields_that_do_not_fit_are_named() {
    assert_eq!(decoded(&[2, 1, 0]), [Err(WireError::TooShort { received: 1 })]);
    assert_eq!(decoded(&[9, 1, 0]), [Err(WireError::Cobs)]);
    let long = vec![1; 3 * WIRE_MAX];
    let mut stream = long;
    stream.push(0);
    assert_eq!(decoded(&stream), [Err(WireError::TooLong)]);
    assert_eq!(decoded(&[0, 0, 0]), []);
}
