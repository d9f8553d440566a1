//! The kept inputs of the fuzzers and their mutation, for the test that runs them at every build and for the example that runs
//! many more. One file a side in `corpus/`, one input a line in hexadecimal.

use std::path::Path;

/// All inputs of one side: `daq_line` or `can_frames`.
///
/// # Errors
/// Names the file, and the line that is no hexadecimal.
pub fn corpus(name: &str) -> Result<Vec<Vec<u8>>, String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(format!("{name}.hex"));
    let text = std::fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
    let byte =
        |line: &str, at: usize| line.get(at..at + 2).and_then(|pair| u8::from_str_radix(pair, 16).ok());
    let input = |line: &str| (0..line.len()).step_by(2).map(|at| byte(line, at)).collect::<Option<Vec<u8>>>();
    let numbered = text.lines().enumerate();
    numbered
        .map(|(n, line)| input(line).ok_or_else(|| format!("{}:{}: not hexadecimal", path.display(), n + 1)))
        .collect()
}

/// Xorshift of Marsaglia (2003): fast, and good enough to bend bytes.
pub struct Random(u64);

impl Random {
    /// Any seed will do.
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    /// A number below `limit`, 0 when that is 0.
    pub fn below(&mut self, limit: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as usize % limit.max(1)
    }
}

/// One to four changes: a byte, a bit, cut, joined with another input, a byte put in.
pub fn mutate(bytes: &mut Vec<u8>, inputs: &[Vec<u8>], random: &mut Random) {
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
