//! The acceleration of the table, from its accelerometer and its displacement together: what drives a model.
//!
//! White noise of an accelerometer grows towards low frequencies as motion goes, and its zero pushes like a constant force; a displacement
//! twice differentiated is quiet there. A complementary filter takes what the displacement says below a corner and leaves what the
//! accelerometer says above it, without any change of the motion itself (Brown and Hwang, Introduction to Random Signals and Applied
//! Kalman Filtering, 4th ed., chapter 8). The accelerometer stays the gauge: how far the displacement is from it in gain and delay is
//! found from the motion (least squares) and taken out; a displacement that has nothing to do with it is left alone.
//!
//! The control step pushes every sample through a [`TableMotion`]; [`table_acceleration`] does the same to a whole record.

use super::butterworth::Section;
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::{FRAC_PI_8, TAU};

/// The corner over the frequency at which both noises are alike: a specimen resonates below it.
const CORNER: f64 = 1.6;
/// Corners that are used, Hz, and the largest over the sampling rate: the bilinear transform is a derivative well below it.
const CORNERS_HZ: (f64, f64) = (0.3, 15.0);
const LARGEST_CORNER: f64 = 1.0 / 128.0;
/// How far a displacement is expected to be from the accelerometer (standard deviations): gain and delay, s.
const EXPECTED: (f64, f64) = (5e-3, 1e-3);
/// A displacement that is farther from it has another reason, and is left alone.
const LARGEST: (f64, f64) = (0.05, 10e-3);
/// RMS that may be left between both, over that of the acceleration.
const LEFT: f64 = 0.05;
/// Samples that are missing and are filled in.
const FILLED: u64 = 2048;
/// Samples between two looks at gain and delay.
const PERIOD: u64 = 64;
/// Beginning of a record that is reflected before it, cycles of the corner.
const LEAD: f64 = 12.0;

/// White noise of the two sensors of the table, rms a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TableNoise {
    /// Of the displacement, m.
    pub displacement_m: f64,
    /// Of the acceleration, m/s2.
    pub acceleration_m_s2: f64,
}

impl TableNoise {
    /// Of two channels, from their third differences in which no motion is left: the lower quartile over pieces, so that
    /// impacts do not count.
    pub fn of(displacement_m: &[f64], acceleration_m_s2: &[f64]) -> Self {
        Self { displacement_m: white(displacement_m), acceleration_m_s2: white(acceleration_m_s2) }
    }
}

/// Acceleration of the table sample by sample; allocates nothing.
#[derive(Clone, Debug)]
pub struct TableMotion {
    filter: Complementary,
    sums: Sums,
    agreement: Option<Agreement>,
    last: Option<(u64, f64, f64)>,
    origin_m: f64,
    period_s: f64,
}

impl TableMotion {
    /// For a table at rest.
    pub fn new(sample_rate_hz: f64, noise: TableNoise) -> Self {
        let sums = Sums::new(noise.acceleration_m_s2);
        let agreement = sums.agreement();
        Self {
            filter: Complementary::new(sample_rate_hz, noise),
            sums,
            agreement,
            last: None,
            origin_m: 0.0,
            period_s: 1.0 / sample_rate_hz,
        }
    }

    /// The next sample: its number, displacement (m) and acceleration (m/s2) as measured; gives the acceleration, m/s2. A few samples
    /// that are missing are taken to lie on an arc; what is not a number is passed on.
    pub fn process(&mut self, sequence: u64, displacement_m: f64, acceleration_m_s2: f64) -> f64 {
        if !(displacement_m.is_finite() && acceleration_m_s2.is_finite()) {
            return acceleration_m_s2;
        }
        let (before, x, a) = match self.last {
            None => {
                self.origin_m = displacement_m;
                (sequence.wrapping_sub(1), 0.0, acceleration_m_s2)
            }
            Some(last) => last,
        };
        let now = (displacement_m - self.origin_m, acceleration_m_s2);
        let missing = sequence.wrapping_sub(before).wrapping_sub(1);
        if missing <= FILLED {
            let span = (missing + 1) as f64;
            for i in 1..=missing {
                let part = i as f64 / span;
                // The arc of a constant acceleration.
                let arc = 0.25 * (a + now.1) * part * (1.0 - part) * (span * self.period_s).powi(2);
                self.filter.process(x + part * (now.0 - x) - arc, a + part * (now.1 - a));
            }
        }
        self.last = Some((sequence, now.0, now.1));
        let seen = self.filter.process(now.0, now.1);
        self.sums.add(&seen);
        if self.sums.count.is_multiple_of(PERIOD) {
            self.agreement = self.sums.agreement();
        }
        self.agreement.map_or(acceleration_m_s2, |agreement| acceleration_m_s2 + agreement.correction(&seen))
    }
}

/// Acceleration of the table over a whole record, m/s2, from its displacement (m) and its acceleration (m/s2) of equal lengths;
/// `None` where the displacement was not measured or does not go with the acceleration.
pub fn table_acceleration(
    displacement_m: &[f64],
    acceleration_m_s2: &[f64],
    sample_rate_hz: f64,
) -> Option<Vec<f64>> {
    let noise = TableNoise::of(displacement_m, acceleration_m_s2);
    let (seen, agreement) = agreed(displacement_m, acceleration_m_s2, sample_rate_hz, noise)?;
    Some(seen.iter().zip(acceleration_m_s2).map(|(seen, a)| a + agreement.correction(seen)).collect())
}

/// What noise of the two sensors alone makes of [`table_acceleration`], m/s2: channels of noise, m and m/s2, of the sizes `noise`.
pub fn table_noise(
    displacement_m: &[f64],
    acceleration_m_s2: &[f64],
    sample_rate_hz: f64,
    noise: TableNoise,
) -> Vec<f64> {
    let mut filter = Complementary::new(sample_rate_hz, noise);
    displacement_m.iter().zip(acceleration_m_s2).map(|(x, a)| a + filter.process(*x, *a).difference).collect()
}

fn agreed(x: &[f64], a: &[f64], rate: f64, noise: TableNoise) -> Option<(Vec<Seen>, Agreement)> {
    if x.len() != a.len() || x.iter().chain(a).any(|value| !value.is_finite()) {
        return None;
    }
    let origin = *x.first()?;
    let zero = a.iter().sum::<f64>() / a.len() as f64;
    let mut filter = Complementary::new(rate, noise);
    // Reflected about its first sample it goes on as it came, whatever it was doing.
    let lead = ((LEAD * rate / filter.corner_hz) as usize).min(x.len() - 1);
    for i in (1..=lead).rev() {
        filter.process(origin - x[i], 2.0 * zero - a[i]);
    }
    let mut sums = Sums::new(noise.acceleration_m_s2);
    let seen: Vec<Seen> = x.iter().zip(a).map(|(x, a)| filter.process(x - origin, *a)).collect();
    seen.iter().for_each(|seen| sums.add(seen));
    sums.agreement().map(|agreement| (seen, agreement))
}

/// What the filter gives for a sample, all below the corner.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    /// Displacement twice differentiated less the acceleration, m/s2.
    difference: f64,
    /// Acceleration, m/s2.
    acceleration: f64,
    /// Its rate, m/s3.
    jerk: f64,
}

/// Fourth-order Butterworth denominator w; below the corner `(2.61 w^3 s + w^4) / w(s)`, whose complement goes with the square of the
/// frequency. One section a pair of poles.
#[derive(Clone, Debug)]
struct Complementary {
    corner_hz: f64,
    /// Of displacement, acceleration and its rate.
    first: [Section; 3],
    /// Of difference, acceleration and its rate.
    second: [Section; 3],
}

impl Complementary {
    fn new(sample_rate_hz: f64, noise: TableNoise) -> Self {
        let alike_hz = (noise.acceleration_m_s2 / noise.displacement_m.max(1e-300)).sqrt() / TAU;
        let corner_hz =
            (CORNER * alike_hz).clamp(CORNERS_HZ.0, CORNERS_HZ.1.min(LARGEST_CORNER * sample_rate_hz));
        let w = TAU * corner_hz;
        // Twice the cosine of the angle of each pair of poles from the negative axis.
        let (one, two) = (2.0 * (3.0 * FRAC_PI_8).cos(), 2.0 * FRAC_PI_8.cos());
        let section = |damping: f64, numerator: [f64; 3]| {
            bilinear(numerator, [w * w, damping * w, 1.0], sample_rate_hz)
        };
        let of = |order: usize| {
            let mut numerator = [0.0; 3];
            numerator[order] = w * w;
            section(one, numerator)
        };
        Self {
            corner_hz,
            first: [of(2), of(0), of(1)],
            second: [section(two, [w * w, (one + two) * w, 0.0]); 3],
        }
    }

    fn process(&mut self, x: f64, a: f64) -> Seen {
        let [displacement, acceleration, jerk] = &mut self.first;
        let low = acceleration.process(a);
        let [difference, acceleration, rate] = &mut self.second;
        Seen {
            difference: difference.process(displacement.process(x) - low),
            acceleration: acceleration.process(low),
            jerk: rate.process(jerk.process(a)),
        }
    }
}

/// A section from the coefficients of s^0, s^1 and s^2, by `s = 2 f (1 - 1/z) / (1 + 1/z)`.
fn bilinear(numerator: [f64; 3], denominator: [f64; 3], sample_rate_hz: f64) -> Section {
    let k = 2.0 * sample_rate_hz;
    let of = |[c0, c1, c2]: [f64; 3]| {
        let (c1, c2) = (c1 * k, c2 * k * k);
        [c0 + c1 + c2, 2.0 * (c0 - c2), c0 - c1 + c2]
    };
    let [norm, a1, a2] = of(denominator);
    Section { b: of(numerator).map(|b| b / norm), a: [a1 / norm, a2 / norm], state: [0.0; 2] }
}

/// Sums of the least-squares fit `difference = gain acceleration + delay jerk + zero`.
#[derive(Clone, Debug)]
struct Sums {
    normal: Matrix3<f64>,
    right: Vector3<f64>,
    squares: f64,
    count: u64,
    /// What the noise alone leaves between both, m2/s4 a sample.
    noise: f64,
}

impl Sums {
    /// With what is expected of gain and delay beforehand. The difference is narrow-band noise: its power times its correlation is
    /// twice the variance of a sample of the accelerometer, whatever the corner.
    fn new(acceleration_noise_m_s2: f64) -> Self {
        let noise = 2.0 * acceleration_noise_m_s2 * acceleration_noise_m_s2;
        let weight = |sigma: f64| (noise / (sigma * sigma)).max(f64::MIN_POSITIVE);
        Self {
            normal: Matrix3::from_diagonal(&Vector3::new(weight(EXPECTED.0), weight(EXPECTED.1), 1.0)),
            right: Vector3::zeros(),
            squares: 0.0,
            count: 0,
            noise,
        }
    }

    fn add(&mut self, seen: &Seen) {
        let row = Vector3::new(seen.acceleration, seen.jerk, 1.0);
        self.normal += row * row.transpose();
        self.right += row * seen.difference;
        self.squares += seen.difference * seen.difference;
        self.count += 1;
    }

    /// Gain and delay, where the two sensors agree but for them.
    fn agreement(&self) -> Option<Agreement> {
        let inverse = self.normal.cholesky()?.inverse();
        let found = inverse * self.right;
        let agreement = Agreement {
            gain: found[0],
            delay_s: found[1],
            zero_m_s2: self.normal[(0, 2)] / self.normal[(2, 2)],
        };
        let left = (self.squares - found.dot(&self.right)).max(0.0);
        let moved = self.normal[(0, 0)] - self.normal[(0, 2)].powi(2) / self.normal[(2, 2)];
        let may = LEFT * LEFT * moved + self.noise * self.count as f64;
        let agrees = found[0].abs() < LARGEST.0 && found[1].abs() < LARGEST.1 && left <= may;
        agrees.then_some(agreement)
    }
}

/// How far the displacement is from the accelerometer.
#[derive(Clone, Copy, Debug)]
struct Agreement {
    /// Relative excess of its gain.
    gain: f64,
    /// Its lead, s.
    delay_s: f64,
    /// Zero of the accelerometer, m/s2.
    zero_m_s2: f64,
}

impl Agreement {
    fn correction(&self, seen: &Seen) -> f64 {
        seen.difference - self.gain * (seen.acceleration - self.zero_m_s2) - self.delay_s * seen.jerk
    }
}

fn white(channel: &[f64]) -> f64 {
    const PIECES: usize = 64;
    let third = |w: &[f64]| (w[3] - 3.0 * w[2] + 3.0 * w[1] - w[0]).powi(2);
    let mut squares: Vec<f64> = channel
        .chunks((channel.len() / PIECES).max(64))
        .filter(|piece| piece.len() >= 32)
        .map(|piece| piece.windows(4).map(third).sum::<f64>() / (piece.len() - 3) as f64)
        .collect();
    squares.sort_by(f64::total_cmp);
    // Squares of the coefficients add up to 20.
    squares.get(squares.len() / 4).map_or(0.0, |square| (square / 20.0).sqrt())
}

#[cfg(test)]
#[path = "table_motion_tests.rs"]
mod tests;
