//! What is neither mean nor fundamental in the table acceleration below 100 Hz. Called by the watch with
//! every sample.

use crate::safety::context::{Context, Halves};
use crate::safety::judge::Estimate;
use crate::signal::LowPass;

/// Corner of the low-pass, Hz.
const CORNER_HZ: f64 = 100.0;

#[derive(Clone, Copy, Default)]
struct Sums {
    n: f64,
    mean: f64,
    square: f64,
    sin: f64,
    cos: f64,
}

/// Distortion of the table acceleration.
pub struct TableDistortion {
    low_pass: LowPass,
    halves: Halves<Sums>,
}

impl TableDistortion {
    /// At a sampling rate, Hz.
    pub fn new(sample_rate_hz: f64) -> Self {
        Self { low_pass: LowPass::new(CORNER_HZ, sample_rate_hz), halves: Halves::default() }
    }

    /// Amplitude equivalent of the rest (root of twice its mean square) over A_G, each half-cycle.
    pub fn estimate(&mut self, c: &Context) -> Estimate {
        let a = self.low_pass.process(c.channels.table_acceleration_m_s2);
        let Some(place) = &c.place else {
            self.halves.clear();
            return Estimate::Idle;
        };
        let joined = self.halves.turn(place);
        let now = self.halves.now();
        now.n += 1.0;
        now.mean += a;
        now.square += a * a;
        now.sin += a * place.sin;
        now.cos += a * place.cos;
        joined.map_or(Estimate::Keep, |(x, y)| {
            let n = x.n + y.n;
            let (mean, square) = ((x.mean + y.mean) / n, (x.square + y.square) / n);
            let (sin, cos) = (2.0 * (x.sin + y.sin) / n, 2.0 * (x.cos + y.cos) / n);
            let rest = square - mean * mean - 0.5 * (sin * sin + cos * cos);
            Estimate::Value((2.0 * rest.max(0.0)).sqrt() / place.scale_m_s2)
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn a_fifth_harmonic_trips() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::TableDistortion);
        let after = bench.until_trip(DetectorId::TableDistortion, |k, o| {
            o.sample.channels.table_acceleration_m_s2 +=
                0.33 * (std::f64::consts::TAU * 5.0 * k as f64 / 2048.0).sin();
        });
        assert!(after.is_some_and(|n| (1024 * 4 - 10..=1024 * 6).contains(&n)), "{after:?}");
    }
}
