//! A channel that repeats one value while the table moves. Called by the watch with every sample.

use crate::safety::context::{Context, channel_values};
use crate::safety::judge::Estimate;

/// Counts equal values in a row, channel by channel.
#[derive(Default)]
pub struct FrozenSensor {
    last: [f64; 5],
    equal: [u32; 5],
}

impl FrozenSensor {
    /// Samples for which the worst channel has repeated its value.
    pub fn estimate(&mut self, c: &Context) -> Estimate {
        // Raw values: one that is not a number equals nothing and is another detector's business.
        let values = channel_values(&c.sample.channels);
        let mut worst = 0;
        for ((value, last), equal) in values.iter().zip(&mut self.last).zip(&mut self.equal) {
            *equal = if c.moving && *value == *last { *equal + 1 } else { 0 };
            *last = *value;
            worst = worst.max(*equal);
        }
        Estimate::Value(f64::from(worst))
    }
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn twenty_equal_values_trip() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::FrozenSensor);
        let after = bench.until_trip(DetectorId::FrozenSensor, |_, o| {
            o.sample.channels.relative_displacement_m = 0.00123;
        });
        assert!(after.is_some_and(|n| (20..=60).contains(&n)), "{after:?}");
    }
}
