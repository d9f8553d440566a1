//! A force whose sensor has a chain of its own comes later, or earlier, than what answers it. The motion of a model knows no clock of
//! its own but for what ages, so that one that is driven later is one that moves later: what is left of a comparison tells the lag.

use super::response::Channels;
use super::window::Window;
use crate::identify::kinematics::{OF_A_SAMPLE, earlier};

/// Rounds in which a lag is found.
const ROUNDS: usize = 6;
/// Share of the squares that a lag explains to first order to be looked for, and that is left with it at most to be spoken of.
const WORTH: f64 = 0.3;
const LEFT: f64 = 0.25;

/// What answers an applied force comes so much later than the force says (s, below zero earlier), and the NRMSE of A and D that would be
/// left without that; nothing where a lag explains little of what is left.
pub fn of_force(windows: &[Window], channels: &Channels, rate_hz: f64) -> Option<(f64, [Option<f64>; 2])> {
    let pairs = [(&channels.measured_a, &channels.model_a), (&channels.measured_d, &channels.model_d)];
    let pairs = pairs.map(|(measured, model)| (measured.as_slice(), model.clone()));
    let mut sums = Sums::of(&pairs, windows, rate_hz);
    let before = sums.left();
    if sums.along * sums.along < WORTH * sums.slope * before {
        return None;
    }
    let mut late_s = 0.0;
    for _ in 0..ROUNDS {
        // A shift by dt is -dt times the derivative.
        let step_s = -sums.along / sums.slope.max(f64::MIN_POSITIVE);
        late_s += step_s;
        let moved = pairs.each_ref().map(|(measured, model)| (*measured, earlier(model, -late_s, rate_hz)));
        sums = Sums::of(&moved, windows, rate_hz);
        if step_s.abs() < 1e-3 / rate_hz {
            break;
        }
    }
    let is_told = late_s.abs() > OF_A_SAMPLE / rate_hz && sums.left() < LEFT * before;
    is_told.then_some((late_s, sums.shares.map(|share| share.map(f64::sqrt))))
}

/// Of both channels together, each over its power.
#[derive(Default)]
struct Sums {
    /// Residual along the model's rate, 1/s.
    along: f64,
    /// The rate's square, 1/s2.
    slope: f64,
    /// Squares of the residual of A and of D over those of the measurement.
    shares: [Option<f64>; 2],
}

impl Sums {
    fn of(pairs: &[(&[f64], Vec<f64>); 2], windows: &[Window], rate_hz: f64) -> Self {
        let mut out = Self::default();
        for ((measured, model), share) in pairs.iter().zip(&mut out.shares) {
            let (mut along, mut slope, mut left, mut power) = (0.0, 0.0, 0.0, 0.0);
            let last = measured.len().min(model.len()).saturating_sub(1);
            for i in windows.iter().flat_map(|window| window.counted.clone()) {
                if i == 0 || i >= last {
                    continue;
                }
                let rate = 0.5 * rate_hz * (model[i + 1] - model[i - 1]);
                let apart = measured[i] - model[i];
                along += apart * rate;
                slope += rate * rate;
                left += apart * apart;
                power += measured[i] * measured[i];
            }
            if power > 0.0 {
                out.along += along / power;
                out.slope += slope / power;
                *share = Some(left / power);
            }
        }
        out
    }

    fn left(&self) -> f64 {
        self.shares.iter().flatten().sum()
    }
}
