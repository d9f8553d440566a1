//! Fundamental of the table acceleration against the command, complex: amplitude and phase. Demodulating
//! the difference of the two gives abs(A1/A_G - 1) at once. Called by the watch with every sample.

use crate::safety::context::{Context, Halves};
use crate::safety::judge::Estimate;

#[derive(Clone, Copy, Default)]
struct Sums {
    n: f64,
    sin: f64,
    cos: f64,
}

/// Drift of the fundamental.
#[derive(Default)]
pub struct TableFundamental {
    halves: Halves<Sums>,
}

impl TableFundamental {
    /// Share of A_G by which the fundamental is off, each half-cycle.
    pub fn estimate(&mut self, c: &Context) -> Estimate {
        let Some(place) = &c.place else {
            self.halves.clear();
            return Estimate::Idle;
        };
        let joined = self.halves.turn(place);
        let now = self.halves.now();
        now.n += 1.0;
        now.sin += c.table_error_m_s2 * place.sin;
        now.cos += c.table_error_m_s2 * place.cos;
        joined.map_or(Estimate::Keep, |(a, b)| {
            let amplitude = 2.0 * (a.sin + b.sin).hypot(a.cos + b.cos) / (a.n + b.n);
            Estimate::Value(amplitude / place.scale_m_s2)
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn a_tenth_too_little_trips_after_three_half_cycles() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::TableFundamental);
        let after = bench.until_trip(DetectorId::TableFundamental, |_, o| {
            o.sample.channels.table_acceleration_m_s2 *= 0.89;
        });
        assert!(after.is_some_and(|n| (1024 * 3 - 10..=1024 * 5).contains(&n)), "{after:?}");
    }
}
