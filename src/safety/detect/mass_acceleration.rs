//! Acceleration of the mass, raw. Called by the watch with every sample.

use crate::safety::context::Context;
use crate::safety::judge::Estimate;

/// Magnitude of the mean of both accelerometers, m/s2.
pub fn estimate(c: &Context) -> Estimate {
    Estimate::Value(c.channels.mass_acceleration_m_s2().abs())
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn eighteen_m_s2_trip() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::MassAcceleration);
        let after = bench.until_trip(DetectorId::MassAcceleration, |_, o| {
            o.sample.channels.mass_acceleration_1_m_s2 = 18.1;
            o.sample.channels.mass_acceleration_2_m_s2 = 18.1;
        });
        assert!(after == Some(3), "{after:?}");
    }
}
