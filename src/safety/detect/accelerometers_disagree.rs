//! The two accelerometers on the mass must tell the same, but for yaw. Called by the watch with every
//! sample.

use crate::safety::context::{Context, MeanSquare};
use crate::safety::judge::Estimate;
use crate::safety::spec::Detection;
use crate::signal::LowPass;

/// Corner of the low-pass, Hz, and memory of the rms values, s.
const CORNER_HZ: f64 = 30.0;
const MEMORY_S: f64 = 0.1;

/// Difference of the accelerometers.
pub struct AccelerometersDisagree {
    filters: [LowPass; 2],
    squares: [MeanSquare; 2],
    floor_m_s2: f64,
}

impl AccelerometersDisagree {
    /// At a sampling rate, Hz.
    pub fn new(sample_rate_hz: f64, detection: &Detection) -> Self {
        Self {
            filters: [LowPass::new(CORNER_HZ, sample_rate_hz); 2],
            squares: [MeanSquare::new(MEMORY_S, sample_rate_hz); 2],
            floor_m_s2: detection.acceleration_floor_m_s2,
        }
    }

    /// Rms of the difference over rms of the mean, or over the floor.
    pub fn estimate(&mut self, c: &Context) -> Estimate {
        let (a, b) = (c.channels.mass_acceleration_1_m_s2, c.channels.mass_acceleration_2_m_s2);
        let difference = self.squares[0].add(self.filters[0].process(a - b));
        let mean = self.squares[1].add(self.filters[1].process(0.5 * (a + b)));
        Estimate::Value((difference / mean.max(self.floor_m_s2 * self.floor_m_s2)).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn a_reversed_accelerometer_trips() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::AccelerometersDisagree);
        let after = bench.until_trip(DetectorId::AccelerometersDisagree, |_, o| {
            o.sample.channels.mass_acceleration_2_m_s2 *= -1.0;
        });
        assert!(after.is_some_and(|n| (100..1024).contains(&n)), "{after:?}");
    }
}
