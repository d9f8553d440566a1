//! Periods without a sample. Called by the watch once a control period.

use crate::safety::judge::Estimate;
use crate::safety::observation::Period;

/// Counts periods since the last sample.
#[derive(Default)]
pub struct StaleSample {
    periods: u32,
}

impl StaleSample {
    /// Control periods since a sample came.
    pub fn estimate(&mut self, period: &Period) -> Estimate {
        self.periods = if period.samples > 0 { 0 } else { self.periods.saturating_add(1) };
        Estimate::Value(f64::from(self.periods))
    }
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn fifty_periods_without_a_sample_trip_and_a_burst_of_33_does_not() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::StaleSample);
        let empty = crate::safety::Period::default();
        assert!((0..33).all(|_| !bench.watch.period(&empty).tripped.has(DetectorId::StaleSample)));
        bench.watch.period(&crate::safety::Period { samples: 33, ..empty });
        let tripped = (1..=60).find(|_| bench.watch.period(&empty).tripped.has(DetectorId::StaleSample));
        assert_eq!(tripped, Some(50));
    }
}
