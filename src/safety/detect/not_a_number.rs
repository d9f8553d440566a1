//! Channels that are not finite. Called by the watch with every sample.

use crate::safety::context::Context;
use crate::safety::judge::Estimate;

/// Number of channels that are not finite.
pub fn estimate(c: &Context) -> Estimate {
    Estimate::Value(f64::from(c.not_finite))
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn three_samples_in_a_row_trip() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::NotANumber);
        let after = bench.until_trip(DetectorId::NotANumber, |_, o| {
            o.sample.channels.relative_displacement_m = f64::NAN;
        });
        assert!(after == Some(3), "{after:?}");
    }
}
