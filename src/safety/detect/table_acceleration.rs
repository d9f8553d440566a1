//! Acceleration of the table below 100 Hz. Called by the watch with every sample.

use crate::safety::context::Context;
use crate::safety::judge::Estimate;
use crate::signal::LowPass;

/// Corner of the low-pass, Hz.
const CORNER_HZ: f64 = 100.0;

/// Hard limit on the table acceleration.
pub struct TableAcceleration {
    low_pass: LowPass,
}

impl TableAcceleration {
    /// At a sampling rate, Hz.
    pub fn new(sample_rate_hz: f64) -> Self {
        Self { low_pass: LowPass::new(CORNER_HZ, sample_rate_hz) }
    }

    /// Magnitude, m/s2.
    pub fn estimate(&mut self, c: &Context) -> Estimate {
        Estimate::Value(self.low_pass.process(c.channels.table_acceleration_m_s2).abs())
    }
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn a_runaway_trips_within_the_filter() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::TableAcceleration);
        let after = bench.until_trip(DetectorId::TableAcceleration, |_, o| {
            o.sample.channels.table_acceleration_m_s2 = 4.0;
        });
        assert!(after.is_some_and(|n| (3..20).contains(&n)), "{after:?}");
    }
}
