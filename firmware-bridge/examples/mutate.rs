//! Runs a great number of mutations of the kept corpus through every decoder, on the stable tool chain:
//! `cargo run --release --example mutate -- 50000000` (inputs a side, seed optional behind it).

use firmware_bridge::check;
use std::path::Path;
use std::process::ExitCode;

/// Xorshift of Marsaglia (2003): fast, and good enough to bend bytes.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as usize % limit.max(1)
    }
}

fn corpus(name: &str) -> std::io::Result<Vec<Vec<u8>>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(name);
    std::fs::read_dir(folder)?.map(|file| std::fs::read(file?.path())).collect()
}

fn mutate(bytes: &mut Vec<u8>, inputs: &[Vec<u8>], random: &mut Random) {
    for _ in 0..=random.below(4) {
        let at = random.below(bytes.len());
        match random.below(5) {
            0 if !bytes.is_empty() => bytes[at] = random.below(256) as u8,
            1 if !bytes.is_empty() => bytes[at] ^= 1 << random.below(8),
            2 => bytes.truncate(at),
            3 => bytes.extend_from_slice(&inputs[random.below(inputs.len())]),
            _ => bytes.insert(at, random.below(256) as u8),
        }
    }
    bytes.truncate(300);
}

type Target = fn(&[u8]);

fn main() -> ExitCode {
    let numbers: Vec<u64> = std::env::args().skip(1).filter_map(|text| text.parse().ok()).collect();
    let count = numbers.first().copied().unwrap_or(1_000_000);
    let mut random = Random(numbers.get(1).copied().unwrap_or(1).wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
    let sides: [(&str, Target); 2] = [("daq_line", check::daq_line), ("can_frames", check::can_frames)];
    for (name, target) in sides {
        let inputs = match corpus(name) {
            Ok(inputs) if !inputs.is_empty() => inputs,
            _ => {
                eprintln!("no corpus for {name}");
                return ExitCode::FAILURE;
            }
        };
        let mut bytes = Vec::with_capacity(1024);
        let begun = std::time::Instant::now();
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
