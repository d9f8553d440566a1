//! Onboard model against measurement: the relative displacement. Called by the watch with every sample.

use crate::safety::context::{Context, MeanSquare};
use crate::safety::judge::Estimate;
use crate::safety::spec::Detection;

/// Memory, s.
const MEMORY_S: f64 = 2.0;

/// How far the onboard model is off.
pub struct ModelDivergence {
    difference: MeanSquare,
    level: MeanSquare,
    floor_m2: f64,
}

impl ModelDivergence {
    /// At a sampling rate, Hz.
    pub fn new(sample_rate_hz: f64, detection: &Detection) -> Self {
        Self {
            difference: MeanSquare::new(MEMORY_S, sample_rate_hz),
            level: MeanSquare::new(MEMORY_S, sample_rate_hz),
            floor_m2: detection.model_floor_m * detection.model_floor_m,
        }
    }

    /// Rms of the difference over rms of D.
    pub fn estimate(&mut self, c: &Context) -> Estimate {
        let d = c.channels.relative_displacement_m;
        let difference = self.difference.add(d - c.response.relative_displacement_m);
        let level = self.level.add(d);
        Estimate::Value((difference / level.max(self.floor_m2)).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn a_model_in_opposition_is_told() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::ModelDivergence);
        let after = bench.until_trip(DetectorId::ModelDivergence, |_, o| {
            o.response.relative_displacement_m *= -1.0;
        });
        assert!(after.is_some_and(|n| n > 2048), "{after:?}");
    }
}
