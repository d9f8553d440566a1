//! A recorded run played back through the whole chain: the third sibling behind [`Rig`]. Commands are
//! taken and ignored; samples come as they were delivered, gaps included.

use super::{Rig, RigFault};
use crate::stream::{Command, Sample};

/// Plays samples back, one a period of the sequence numbers.
pub struct ReplayRig {
    samples: Vec<Sample>,
    next: usize,
    now: Option<u64>,
    chain_delay_s: f64,
}

impl ReplayRig {
    /// A rig that plays `samples`; `chain_delay_s` is that of the rig which they were taken on.
    pub fn new(samples: Vec<Sample>, chain_delay_s: f64) -> Self {
        Self { samples, next: 0, now: None, chain_delay_s }
    }

    /// Samples not yet played.
    pub fn remaining(&self) -> usize {
        self.samples.len() - self.next
    }
}

impl Rig for ReplayRig {
    fn read(&mut self) -> Result<Option<Sample>, RigFault> {
        let (Some(sample), Some(now)) = (self.samples.get(self.next), self.now) else {
            return if self.next >= self.samples.len() { Err(RigFault::EndOfRecord) } else { Ok(None) };
        };
        if sample.sequence > now {
            return Ok(None);
        }
        self.next += 1;
        Ok(Some(*sample))
    }

    fn write(&mut self, _command: &Command) -> Result<(), RigFault> {
        Ok(())
    }

    fn quick_stop(&mut self) {}

    fn advance(&mut self) {
        self.now = match self.now {
            Some(now) => Some(now + 1),
            None => self.samples.first().map(|first| first.sequence),
        };
    }

    fn chain_delay_s(&self) -> f64 {
        self.chain_delay_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_come_at_their_numbers_and_the_end_is_told() {
        let samples: Vec<Sample> =
            [7, 8, 11].map(|sequence| Sample { sequence, ..Sample::default() }).to_vec();
        let mut rig = ReplayRig::new(samples, 0.0);
        let mut seen = Vec::new();
        for period in 0..5 {
            rig.advance();
            while let Ok(Some(sample)) = rig.read() {
                seen.push((period, sample.sequence));
            }
        }
        assert_eq!(seen, [(0, 7), (1, 8), (4, 11)]);
        assert_eq!(rig.read(), Err(RigFault::EndOfRecord));
    }
}
