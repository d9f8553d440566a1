//! Runs a great number of mutations of the kept corpus through every decoder, on the stable tool chain:
//! `cargo run --release -p firmware-bridge --example mutate -- 50000000` (inputs a side, seed optional behind it).

#[path = "../tests/inputs/mod.rs"]
mod inputs;

use firmware_bridge::check;
use inputs::{Random, corpus, mutate};
use std::process::ExitCode;
use std::time::Instant;

type Target = fn(&[u8]);

fn main() -> ExitCode {
    let numbers: Vec<u64> = std::env::args().skip(1).filter_map(|text| text.parse().ok()).collect();
    let count = numbers.first().copied().unwrap_or(1_000_000);
    let mut random = Random::new(numbers.get(1).copied().unwrap_or(1));
    let sides: [(&str, Target); 2] = [("daq_line", check::daq_line), ("can_frames", check::can_frames)];
    for (name, target) in sides {
        let inputs = match corpus(name) {
            Ok(inputs) => inputs,
            Err(error) => {
                eprintln!("{error}");
                return ExitCode::FAILURE;
            }
        };
        let mut bytes = Vec::with_capacity(1024);
        let begun = Instant::now();
        for n in 0..count {
            // A chain of mutations that begins anew from the corpus every sixteenth time.
            if n % 16 == 0 {
                bytes.clear();
                bytes.extend_from_slice(&inputs[random.below(inputs.len())]);
            }
            mutate(&mut bytes, &inputs, &mut random);
            target(&bytes);
        }
        println!("{name}: {count} inputs in {:.0} s, no panic", begun.elapsed().as_secs_f64());
    }
    ExitCode::SUCCESS
}
