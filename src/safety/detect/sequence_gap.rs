//! Sample numbers that never came. Called by the watch with every sample.

use crate::safety::context::{Context, Recent};
use crate::safety::judge::Estimate;

/// Counts missing numbers.
pub struct SequenceGap {
    recent: Recent,
}

impl SequenceGap {
    /// At a sampling rate, Hz.
    pub fn new(sample_rate_hz: f64) -> Self {
        Self { recent: Recent::new(sample_rate_hz) }
    }

    /// Missing samples within about the last second.
    pub fn estimate(&mut self, c: &Context) -> Estimate {
        Estimate::Value(self.recent.add(c.missing))
    }
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn two_of_three_lost_trip() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::SequenceGap);
        let after = bench.until_trip(DetectorId::SequenceGap, |k, o| {
            o.sample.sequence += 2 * k;
        });
        assert!(after.is_some_and(|n| n <= 60), "{after:?}");
    }
}
