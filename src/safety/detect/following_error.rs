//! Measured table displacement against the delayed command. The limit is that of the row, or a time
//! at the commanded speed where that is more. Called by the watch with every sample.

use crate::safety::context::Context;
use crate::safety::judge::Estimate;
use crate::safety::spec::{Detection, Row};

/// Following error, scaled by what is asked.
pub struct FollowingError {
    time_s: f64,
    floor_m: f64,
}

impl FollowingError {
    /// With the smallest threshold of its row as the floor.
    pub fn new(detection: &Detection, row: &Row) -> Self {
        Self { time_s: detection.following_time_s, floor_m: row.warn.unwrap_or(row.trip) }
    }

    /// Error in m, divided by how much the limits have grown.
    pub fn estimate(&self, c: &Context) -> Estimate {
        let growth = (self.time_s * c.speed_amplitude_m_s / self.floor_m).max(1.0);
        Estimate::Value(c.following_error_m.abs() / growth)
    }
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn half_a_millimetre_for_four_samples_trips() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::FollowingError);
        let after = bench.until_trip(DetectorId::FollowingError, |_, o| {
            o.sample.channels.table_displacement_m += 0.52e-3;
        });
        assert!(after == Some(4), "{after:?}");
    }
}
