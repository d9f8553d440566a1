//! How far the mass presses beyond half the gap, against what the bumper bears. Called by the watch
//! with every sample.

use crate::safety::context::Context;
use crate::safety::judge::Estimate;
use crate::safety::observation::Setup;
use crate::safety::spec::Detection;

/// Hard limit on D.
pub struct RelativeDisplacement {
    half_gap_m: f64,
    margin_m: f64,
}

impl RelativeDisplacement {
    /// For the bumpers of a specimen, or none.
    pub fn new(setup: &Setup, detection: &Detection) -> Self {
        match (setup.total_gap_m, setup.bumper_stiffness_n_m) {
            (Some(gap_m), Some(stiffness_n_m)) => {
                Self { half_gap_m: 0.5 * gap_m, margin_m: margin_m(&detection.bumper_margins, stiffness_n_m) }
            }
            _ => Self { half_gap_m: 0.0, margin_m: detection.free_displacement_m },
        }
    }

    /// Share of the margin in use; below 0 while the mass is free.
    pub fn estimate(&self, c: &Context) -> Estimate {
        Estimate::Value((c.channels.relative_displacement_m.abs() - self.half_gap_m) / self.margin_m)
    }
}

/// Margin for a stiffness: the logarithms are interpolated, the ends kept.
fn margin_m(pairs: &[[f64; 2]], stiffness_n_m: f64) -> f64 {
    let above = pairs.iter().position(|[stiffness, _]| *stiffness >= stiffness_n_m);
    match above {
        Some(0) => pairs[0][1],
        Some(i) => {
            let ([k0, m0], [k1, m1]) = (pairs[i - 1], pairs[i]);
            m0 * (m1 / m0).powf((stiffness_n_m / k0).ln() / (k1 / k0).ln())
        }
        None => pairs.last().map_or(0.0, |[_, margin]| *margin),
    }
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn the_margin_of_the_bumper_counts() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::RelativeDisplacement);
        let after = bench.until_trip(DetectorId::RelativeDisplacement, |_, o| {
            o.sample.channels.relative_displacement_m = 0.0101 + 0.025;
        });
        assert!(after == Some(4), "{after:?}");
    }

    #[test]
    fn margins_are_interpolated() {
        let pairs = [[33e3, 25e-3], [175e3, 16e-3]];
        let margin = |k| super::margin_m(&pairs, k);
        assert_eq!((margin(1e3), margin(33e3), margin(1e6)), (25e-3, 25e-3, 16e-3));
        assert!((margin((33e3_f64 * 175e3).sqrt()) - 20e-3).abs() < 1e-9);
    }
}
