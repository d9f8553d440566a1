//! What the fuzzers found worth keeping, run again by every test; and a quick mutation of it, so that a decoder that begins to
//! panic is noticed without a fuzzer.

use firmware_bridge::check;
use std::path::Path;

fn corpus(name: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(name);
    let files = std::fs::read_dir(folder).expect("the corpus");
    files.map(|file| std::fs::read(file.expect("a file").path()).expect("readable")).collect()
}

/// Runs each input as it is, then mutated `rounds` times: bytes changed, cut, repeated.
fn run(name: &str, rounds: u32, target: fn(&[u8])) {
    let inputs = corpus(name);
    assert!(inputs.len() >= 15, "{name}: {}", inputs.len());
    let mut random = 0x2545_F491_4F6C_DD1D_u64;
    let mut next = |below: usize| {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        random as usize % below.max(1)
    };
    for input in &inputs {
        target(input);
        for _ in 0..rounds {
            let mut bytes = input.clone();
            for _ in 0..=next(4) {
                let at = next(bytes.len());
                match next(4) {
                    0 if !bytes.is_empty() => bytes[at] = next(256) as u8,
                    1 if !bytes.is_empty() => bytes[at] ^= 1 << next(8),
                    2 => bytes.truncate(at),
                    _ => bytes.extend_from_slice(&inputs[next(inputs.len())]),
                }
            }
            target(&bytes);
        }
    }
}

#[test]
fn the_daq_line_survives_its_corpus() {
    run("daq_line", 300, check::daq_line);
}

#[test]
fn the_can_decoders_survive_their_corpus() {
    run("can_frames", 300, check::can_frames);
}
