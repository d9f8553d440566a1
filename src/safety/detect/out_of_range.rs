//! A channel beyond what its instrument can measure. Called by the watch with every sample.

use crate::safety::context::{Context, channel_values};
use crate::safety::judge::Estimate;
use crate::safety::spec::Detection;

/// Largest channel over its range.
pub fn estimate(c: &Context, detection: &Detection) -> Estimate {
    let [table, table_acceleration, first, second, relative] = channel_values(&c.channels).map(f64::abs);
    let displacement = table.max(relative) / detection.displacement_range_m;
    let acceleration = table_acceleration.max(first).max(second) / detection.acceleration_range_m_s2;
    Estimate::Value(displacement.max(acceleration))
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn an_input_at_its_end_trips() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::OutOfRange);
        let after = bench.until_trip(DetectorId::OutOfRange, |_, o| {
            o.sample.channels.mass_acceleration_2_m_s2 = -49.5;
        });
        assert!(after == Some(3), "{after:?}");
    }
}
