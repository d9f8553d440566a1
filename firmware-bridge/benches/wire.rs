//! How fast the wire format is: decoding with the checksum against the 2048 Hz stream, and one
//! message to bytes.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use firmware_bridge::canopen::nmt::sync;
use firmware_bridge::canopen::pdo::Outputs;
use firmware_bridge::drive::CanBus;
use firmware_bridge::wire::{Deframer, Message, SampleFrame, WIRE_MAX, encode};
use std::hint::black_box;
use std::os::unix::net::UnixDatagram;

const RATE_HZ: u64 = 2048;

fn sample(n: u64) -> Message {
    let wave = (n as f64 * 0.01).sin();
    Message::Sample(SampleFrame {
        status: 0,
        sequence: n as u32,
        device_time_us: n * 488,
        counts: [1.0, 0.7, -0.3, 0.2, -0.9].map(|gain| (wave * gain * 8.0e6) as i32),
    })
}

fn wire(c: &mut Criterion) {
    let mut stream = Vec::new();
    for n in 0..RATE_HZ {
        let mut bytes = [0; WIRE_MAX];
        let used = encode(&sample(n), &mut bytes);
        stream.extend(&bytes[..used]);
    }
    let mut group = c.benchmark_group("daq line");
    // Elements a second over 2048 is the multiple of the stream.
    group.throughput(Throughput::Elements(RATE_HZ));
    group.bench_function("decode one second of samples", |b| {
        b.iter(|| {
            let mut deframer = Deframer::new();
            let mut sum = 0_i64;
            for piece in black_box(&stream).chunks(36) {
                deframer.feed(piece, |result| {
                    if let Ok(Message::Sample(frame)) = result {
                        sum += i64::from(frame.counts[0]);
                    }
                });
            }
            sum
        });
    });
    group.throughput(Throughput::Elements(1));
    let message = sample(12_345);
    group.bench_function("encode one sample", |b| {
        let mut bytes = [0; WIRE_MAX];
        b.iter(|| encode(black_box(&message), &mut bytes));
    });
    group.finish();
}

/// One command to the bus: both process data frames and SYNC through the kernel, the other end's reading included.
fn command(c: &mut Criterion) {
    let (host, device) = UnixDatagram::pair().expect("a socket pair");
    let bus = CanBus::from_socket(host.into()).expect("a bus");
    let mut device = CanBus::from_socket(device.into()).expect("a bus");
    let mut outputs = Outputs::default();
    c.bench_function("one command to the bus", |b| {
        b.iter(|| {
            outputs.target_position += 1;
            for frame in black_box(&outputs).frames(5) {
                bus.send(&frame).expect("sent");
            }
            bus.send(&sync()).expect("sent");
            while let Ok(Some(event)) = device.poll() {
                black_box(event);
            }
        });
    });
}

criterion_group!(benches, wire, command);
criterion_main!(benches);
