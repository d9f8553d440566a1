//! What the fuzzers found worth keeping, run again by every test; and a quick mutation of it, so that a decoder that begins to
//! panic is noticed without a fuzzer.

mod inputs;

use firmware_bridge::check;
use inputs::{Random, corpus, mutate};

/// Runs each input as it is, then mutated `rounds` times.
fn run(name: &str, rounds: u32, target: fn(&[u8])) {
    let inputs = corpus(name).expect("the corpus");
    assert!(inputs.len() > 100, "{name}: {}", inputs.len());
    let mut random = Random::new(1);
    for input in &inputs {
        target(input);
        for _ in 0..rounds {
            let mut bytes = input.clone();
            mutate(&mut bytes, &inputs, &mut random);
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
