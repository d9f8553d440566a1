//! Control periods that were skipped. Called by the watch once a control period.

use crate::safety::context::Recent;
use crate::safety::judge::Estimate;
use crate::safety::observation::Period;

/// Counts skipped periods.
pub struct ControlSlips {
    recent: Recent,
}

impl ControlSlips {
    /// At a control rate, Hz.
    pub fn new(rate_hz: f64) -> Self {
        Self { recent: Recent::new(rate_hz) }
    }

    /// Skipped periods within about the last second.
    pub fn estimate(&mut self, period: &Period) -> Estimate {
        Estimate::Value(self.recent.add(period.skipped))
    }
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn a_stall_as_long_as_the_drive_bears_trips() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::ControlSlips);
        let stall = |skipped| crate::safety::Period { samples: 1, skipped, ..Default::default() };
        assert!(!bench.watch.period(&stall(50)).tripped.has(DetectorId::ControlSlips));
        assert!(bench.watch.period(&stall(160)).tripped.has(DetectorId::ControlSlips));
    }
}
