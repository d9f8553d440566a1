//! A sample number that came before. Called by the watch with every sample.

use crate::safety::context::{Context, Recent};
use crate::safety::judge::Estimate;

/// Counts repeated numbers.
pub struct RepeatedSample {
    recent: Recent,
}

impl RepeatedSample {
    /// At a sampling rate, Hz.
    pub fn new(sample_rate_hz: f64) -> Self {
        Self { recent: Recent::new(sample_rate_hz) }
    }

    /// Repeated samples within about the last second.
    pub fn estimate(&mut self, c: &Context) -> Estimate {
        Estimate::Value(self.recent.add(u64::from(c.repeated)))
    }
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn a_number_that_stands_still_trips() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::RepeatedSample);
        let after = bench.until_trip(DetectorId::RepeatedSample, |_, o| {
            o.sample.sequence = 17;
        });
        assert!(after.is_some_and(|n| (20..=22).contains(&n)), "{after:?}");
    }
}
