//! What noise in what drives a step makes of A and D, and slow noise of the displacement sensor beside it, made white: what a filter
//! along the linearised motion has not known before (Kalman 1960; as residuals of a prediction error method: Ljung, System
//! Identification, 2nd ed. 1999, ch. 7).

use crate::model::system::Oscillation;
use nalgebra::{Matrix3, Vector3};

/// What an isolator and its bumpers do beside a displacement: restoring acceleration over displacement (1/s2) and velocity (1/s).
pub(super) type Slope = [f64; 2];

/// The motion of a step, and its noise.
#[derive(Clone, Debug)]
pub(super) struct Along {
    /// At each sample.
    pub slopes: Vec<Slope>,
    /// Whether A counts there.
    pub counts: Vec<bool>,
    /// Deviation of the noise in what drives it there, m/s2.
    pub drive_m_s2: Vec<f64>,
    /// Deviation of the noise of A, m/s2.
    pub noise_of_a_m_s2: f64,
    /// The same of D, m.
    pub noise_of_d_m: f64,
    /// Sample period, s.
    pub dt_s: f64,
}

/// Gains of the filter. Its errors - of displacement (m), of velocity (m/s), slow noise of D over its white one - start from nothing: the state
/// at the start of a step is estimated beside it.
#[derive(Clone, Debug)]
pub(super) struct Innovations {
    branches: Vec<Branch>,
    samples: Vec<Sample>,
    /// What an error of displacement is in D, over its noise.
    of_d: f64,
}

/// A branch that a motion goes through: what becomes of the errors of displacement and velocity within a sample, and what they are in A,
/// over its noise.
#[derive(Clone, Copy, Debug)]
struct Branch {
    later: [[f64; 2]; 2],
    of_a: [f64; 2],
}

/// One sample: its branch, gains, and inverse deviations of the innovations of A and D.
#[derive(Clone, Copy, Debug)]
struct Sample {
    branch: usize,
    gain_a: [f64; 3],
    gain_d: [f64; 3],
    over: [f64; 2],
}

impl Branch {
    fn new(slope: Slope, along: &Along) -> Self {
        let later = Oscillation::new(slope[0], slope[1], along.dt_s);
        let (d, v) = (later.after(1.0, 0.0, 0.0, 0.0), later.after(0.0, 1.0, 0.0, 0.0));
        Self { later: [[d.0, v.0], [d.1, v.1]], of_a: slope.map(|s| -s / along.noise_of_a_m_s2) }
    }

    /// Errors a sample later.
    fn after(&self, [d, v, slow]: [f64; 3]) -> [f64; 3] {
        let [of_d, of_v] = self.later;
        [of_d[0] * d + of_d[1] * v, of_v[0] * d + of_v[1] * v, slow]
    }

    fn in_a(&self, [d, v, _]: [f64; 3]) -> f64 {
        self.of_a[0] * d + self.of_a[1] * v
    }
}

fn corrected(error: [f64; 3], gain: [f64; 3], by: f64) -> [f64; 3] {
    std::array::from_fn(|i| error[i] + gain[i] * by)
}

impl Innovations {
    /// Slow noise of D is a random walk that grows by so much variance a sample, over that of its white noise.
    pub fn new(along: &Along, growth: f64) -> Self {
        let of_d = 1.0 / along.noise_of_d_m;
        let (mut slopes, mut branches): (Vec<Slope>, Vec<Branch>) = Default::default();
        let mut covariance = Matrix3::zeros();
        let seen = |covariance: &mut Matrix3<f64>, channel: Vector3<f64>| -> ([f64; 3], f64) {
            let through = *covariance * channel;
            let variance = 1.0 + channel.dot(&through);
            let gain = through / variance;
            *covariance -= gain * through.transpose();
            (gain.into(), 1.0 / variance.sqrt())
        };
        let each = along.slopes.iter().zip(&along.counts).zip(&along.drive_m_s2);
        let samples = each.map(|((slope, counts), drive)| {
            let known = slopes.iter().position(|known| known == slope);
            let branch = known.unwrap_or_else(|| {
                slopes.push(*slope);
                branches.push(Branch::new(*slope, along));
                branches.len() - 1
            });
            let Branch { later: [d, v], of_a } = branches[branch];
            let later = Matrix3::new(d[0], d[1], 0.0, v[0], v[1], 0.0, 0.0, 0.0, 1.0);
            covariance = later * covariance * later.transpose();
            covariance[(1, 1)] += (drive * along.dt_s).powi(2);
            covariance[(2, 2)] += growth;
            let in_a = Vector3::new(of_a[0], of_a[1], 0.0);
            let (gain_a, over_a) = if *counts { seen(&mut covariance, in_a) } else { ([0.0; 3], 0.0) };
            let (gain_d, over_d) = seen(&mut covariance, Vector3::new(of_d, 0.0, 1.0));
            Sample { branch, gain_a, gain_d, over: [over_a, over_d] }
        });
        let samples = samples.collect();
        Self { branches, samples, of_d }
    }

    /// Takes the place of both channels, A before D, in units of their noise; where A counts may have been told anew since.
    pub fn whiten(&self, counts: &[bool], channels: &mut [f64]) {
        let n = self.samples.len().min(channels.len() / 2);
        let (in_a, in_d) = channels.split_at_mut(n);
        let mut error = [0.0; 3];
        for (((sample, a), d), counts) in self.samples.iter().zip(in_a).zip(in_d).zip(counts) {
            let branch = &self.branches[sample.branch];
            error = branch.after(error);
            let left_a = if *counts { *a - branch.in_a(error) } else { 0.0 };
            error = corrected(error, sample.gain_a, left_a);
            let left_d = *d - self.of_d * error[0] - error[2];
            error = corrected(error, sample.gain_d, left_d);
            [*a, *d] = [sample.over[0] * left_a, sample.over[1] * left_d];
        }
    }

    /// Sum of the logarithms of the innovations' variances.
    pub fn log_determinant(&self) -> f64 {
        let each = self.samples.iter().flat_map(|sample| sample.over).filter(|over| *over > 0.0);
        each.map(|over| -2.0 * over.ln()).sum()
    }

    /// Both channels as they were before; A where it does not count is nothing.
    pub fn restore(&self, channels: &mut [f64]) {
        let n = self.samples.len().min(channels.len() / 2);
        let (in_a, in_d) = channels.split_at_mut(n);
        let mut error = [0.0; 3];
        for ((sample, a), d) in self.samples.iter().zip(in_a).zip(in_d) {
            let branch = &self.branches[sample.branch];
            error = branch.after(error);
            let seen_a = branch.in_a(error);
            let left_a = if *a == 0.0 { 0.0 } else { *a / sample.over[0] };
            *a = if *a == 0.0 { 0.0 } else { left_a + seen_a };
            error = corrected(error, sample.gain_a, left_a);
            let left_d = *d / sample.over[1];
            *d = left_d + self.of_d * error[0] + error[2];
            error = corrected(error, sample.gain_d, left_d);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::least_squares::dot;
    use rand::{SeedableRng, prelude::Distribution};

    #[test]
    fn what_noise_in_the_drive_does_is_made_white_with_slow_noise_beside_it() {
        let (dt_s, n, growth) = (1e-3, 60_000, 1e-4_f64);
        let (isolator, bumper, drive) = ([650.0, 2.5], [6000.0, 8.0], 0.02);
        // In contact for a tenth of the time; noise in the drive for half of it.
        let along = Along {
            slopes: (0..n).map(|i| if i % 400 < 40 { bumper } else { isolator }).collect(),
            counts: (0..n).map(|i| !(1000..1010).contains(&i)).collect(),
            drive_m_s2: (0..n).map(|i| if i % 400 < 200 { drive } else { 0.0 }).collect(),
            noise_of_a_m_s2: 7e-3,
            noise_of_d_m: 8e-6,
            dt_s,
        };
        let mut random = rand_pcg::Pcg64::seed_from_u64(5);
        let mut normal = || -> f64 { rand_distr::StandardNormal.sample(&mut random) };
        let (mut error, mut slow) = ((0.0, 0.0), 0.0);
        let (mut a, mut d) = (Vec::new(), Vec::new());
        for (i, slope) in along.slopes.iter().enumerate() {
            error = Oscillation::new(slope[0], slope[1], dt_s).after(error.0, error.1, 0.0, 0.0);
            error.1 += along.drive_m_s2[i] * dt_s * normal();
            slow += growth.sqrt() * normal();
            let in_a = -slope[0] * error.0 - slope[1] * error.1;
            a.push(if along.counts[i] { in_a / along.noise_of_a_m_s2 + normal() } else { 0.0 });
            d.push(error.0 / along.noise_of_d_m + slow + normal());
        }
        let covariance = |x: &[f64], lag: usize| dot(&x[lag..], &x[..x.len() - lag]) / x.len() as f64;
        assert!(covariance(&d, 4) > 0.5, "{}", covariance(&d, 4));
        let seen = [a, d].concat();
        let mut white = seen.clone();
        let innovations = Innovations::new(&along, growth);
        innovations.whiten(&along.counts, &mut white);
        for channel in white.chunks(n) {
            assert!((covariance(channel, 0) - 1.0).abs() < 5.0 * (2.0 / n as f64).sqrt());
            for lag in [1, 4, 30, 250, 2000] {
                let found = covariance(channel, lag);
                assert!(found.abs() < 5.0 / (n as f64).sqrt(), "{lag}: {found}");
            }
        }
        assert!(white[1000..1010].iter().all(|x| *x == 0.0));
        let across = dot(&white[..n], &white[n..]) / n as f64;
        assert!(across.abs() < 5.0 / (n as f64).sqrt(), "{across}");
        innovations.restore(&mut white);
        assert!(white.iter().zip(&seen).all(|(a, b)| (a - b).abs() < 1e-6));
    }
}
