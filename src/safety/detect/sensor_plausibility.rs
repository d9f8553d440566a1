//! A - a_table must be the second derivative of D, whatever the specimen does. Both pass the same low-pass;
//! zeros of the instruments are taken out. Called by the watch with every sample.

use crate::safety::context::{Context, MeanSquare};
use crate::safety::judge::Estimate;
use crate::safety::spec::Detection;
use crate::signal::LowPass;

/// Corner of the low-pass, Hz; memory of the rms values and of the mean, s.
const CORNER_HZ: f64 = 10.0;
const MEMORY_S: f64 = 0.25;
const MEAN_S: f64 = 1.0;
/// Time after a start or a gap before the filters are believed, s.
const WARM_UP_S: f64 = 0.3;

/// Kinematics of the instruments.
pub struct SensorPlausibility {
    acceleration: LowPass,
    displacement: LowPass,
    /// The second derivative lets the laser's noise pass in full above the corner; once more through a low-pass, the
    /// two sides alike.
    smooth: [LowPass; 2],
    zero_m: f64,
    mean_m_s2: f64,
    mean_share: f64,
    difference: MeanSquare,
    level: MeanSquare,
    floor_m_s2: f64,
    warm_up: u32,
    warm: u32,
}

impl SensorPlausibility {
    /// At a sampling rate, Hz.
    pub fn new(sample_rate_hz: f64, detection: &Detection) -> Self {
        Self {
            acceleration: LowPass::new(CORNER_HZ, sample_rate_hz),
            displacement: LowPass::of_second_derivative(CORNER_HZ, sample_rate_hz),
            smooth: [LowPass::new(CORNER_HZ, sample_rate_hz); 2],
            zero_m: 0.0,
            mean_m_s2: 0.0,
            mean_share: 1.0 / (MEAN_S * sample_rate_hz),
            difference: MeanSquare::new(MEMORY_S, sample_rate_hz),
            level: MeanSquare::new(MEMORY_S, sample_rate_hz),
            floor_m_s2: detection.acceleration_floor_m_s2,
            warm_up: (WARM_UP_S * sample_rate_hz) as u32,
            warm: 0,
        }
    }

    /// Rms of the difference over rms of A - a_table, or over the floor.
    pub fn estimate(&mut self, c: &Context) -> Estimate {
        let d = c.channels.relative_displacement_m;
        if c.missing > 0 || c.repeated || self.warm == 0 {
            self.restart(d);
        }
        let relative = c.channels.mass_acceleration_m_s2() - c.channels.table_acceleration_m_s2;
        let from_acceleration = self.acceleration.process(relative);
        let off = self.smooth[0].process(from_acceleration - self.displacement.process(d - self.zero_m));
        let from_acceleration = self.smooth[1].process(from_acceleration);
        self.warm = self.warm.saturating_add(1);
        if self.warm <= self.warm_up {
            return Estimate::Keep;
        }
        self.mean_m_s2 += self.mean_share * (off - self.mean_m_s2);
        let difference = self.difference.add(off - self.mean_m_s2);
        let level = self.level.add(from_acceleration);
        Estimate::Value((difference / level.max(self.floor_m_s2 * self.floor_m_s2)).sqrt())
    }

    /// A jump in time or the first sample: what the filters remember belongs to something else.
    fn restart(&mut self, d: f64) {
        self.acceleration.reset();
        self.displacement.reset();
        self.smooth.iter_mut().for_each(LowPass::reset);
        self.difference.reset();
        self.level.reset();
        self.zero_m = d;
        self.warm = 0;
    }
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn a_laser_that_is_reversed_trips() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::SensorPlausibility);
        let after = bench.until_trip(DetectorId::SensorPlausibility, |_, o| {
            o.sample.channels.relative_displacement_m *= -1.0;
        });
        assert!(after.is_some_and(|n| (100..2048).contains(&n)), "{after:?}");
    }
}
