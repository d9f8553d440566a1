//! The ring to the recorder fills up. Called by the watch once a control period.

use crate::safety::judge::Estimate;
use crate::safety::observation::Period;

/// Share of the ring in use.
pub fn estimate(period: &Period) -> Estimate {
    Estimate::Value(period.recorder_used)
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn a_full_ring_trips() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::RecorderBehind);
        let used = |recorder_used| crate::safety::Period { samples: 1, recorder_used, ..Default::default() };
        assert!(!bench.watch.period(&used(0.8)).tripped.has(DetectorId::RecorderBehind));
        assert!(bench.watch.period(&used(0.96)).tripped.has(DetectorId::RecorderBehind));
    }
}
