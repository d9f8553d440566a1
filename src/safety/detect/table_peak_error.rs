//! Largest error of the table acceleration below 30 Hz, within a cycle. Called by the watch with every
//! sample.

use crate::safety::context::{Context, Halves};
use crate::safety::judge::Estimate;
use crate::signal::LowPass;

/// Corner of the low-pass, Hz.
const CORNER_HZ: f64 = 30.0;

/// Peak error of the table acceleration.
pub struct TablePeakError {
    low_pass: LowPass,
    halves: Halves<f64>,
}

impl TablePeakError {
    /// At a sampling rate, Hz.
    pub fn new(sample_rate_hz: f64) -> Self {
        Self { low_pass: LowPass::new(CORNER_HZ, sample_rate_hz), halves: Halves::default() }
    }

    /// Peak over A_G, each half-cycle.
    pub fn estimate(&mut self, c: &Context) -> Estimate {
        let error = self.low_pass.process(c.table_error_m_s2).abs();
        let Some(place) = &c.place else {
            self.halves.clear();
            return Estimate::Idle;
        };
        let joined = self.halves.turn(place);
        let now = self.halves.now();
        *now = now.max(error);
        joined.map_or(Estimate::Keep, |(a, b)| Estimate::Value(a.max(b) / place.scale_m_s2))
    }
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn short_blows_once_a_half_cycle_trip() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::TablePeakError);
        let after = bench.until_trip(DetectorId::TablePeakError, |k, o| {
            if k % 1024 > 970 {
                o.sample.channels.table_acceleration_m_s2 += 0.8;
            }
        });
        assert!(after.is_some_and(|n| (1024 * 4 - 10..=1024 * 6).contains(&n)), "{after:?}");
    }
}
