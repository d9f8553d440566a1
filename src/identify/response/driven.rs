//! Noise in what drives a step that is no sine - an earthquake, random noise -: nothing tells it from the motion, and the mass answers it
//! as a resonator does, in both channels and over many cycles. Residuals and slopes are made white there, as what is left of them
//! when a filter along the linearised motion has said what the noise has done so far. The search has it told with the jumps.

use super::{Measured, QUIET, Window};
use crate::identify::least_squares::dot;
use crate::identify::motion::Motion;
use crate::model::ModelSpec;
use crate::model::system::Oscillation;
use crate::record::Kind;

/// The least deviation of the zero of the table's acceleration.
const LEAST_ZERO_M_S2: f64 = 1e-6;

/// What an isolator and its bumpers do beside a displacement: restoring acceleration over displacement (1/s2) and velocity (1/s).
type Slope = [f64; 2];

/// Innovations of the errors that noise in the drive makes in A and D (Kalman 1960; as residuals of a prediction error method:
/// Ljung, System Identification, 2nd ed. 1999, ch. 7). Errors of displacement and velocity start from nothing: the state at the start of
/// a step is estimated beside it.
#[derive(Clone, Debug, Default)]
pub(super) struct Innovations {
    /// Over the noise of D.
    of_d: f64,
    samples: Vec<Sample>,
}

/// One sample: what becomes of the errors of displacement and velocity until then, what the error in A is to them, and gain and inverse
/// deviation of both channels.
#[derive(Clone, Debug)]
struct Sample {
    later: Oscillation,
    of_a: [f64; 2],
    gain_a: [f64; 2],
    gain_d: [f64; 2],
    over: [f64; 2],
}

/// Errors of displacement and velocity a sample later.
fn after(later: &Oscillation, [d, v]: [f64; 2]) -> [f64; 2] {
    later.after(d, v, 0.0, 0.0).into()
}

impl Innovations {
    /// Along a motion with such slopes: deviation of the drive's noise, of A's and D's, and where A counts.
    fn new(slopes: &[Slope], counts: &[bool], [drive, a, d]: [f64; 3], dt: f64) -> Self {
        // Covariance of the errors: displacement, both, velocity.
        let mut p = [0.0; 3];
        let (of_d, grows) = (1.0 / d, (drive * dt).powi(2));
        let seen = |p: &mut [f64; 3], h: [f64; 2]| -> ([f64; 2], f64) {
            let through = [p[0] * h[0] + p[1] * h[1], p[1] * h[0] + p[2] * h[1]];
            let variance = 1.0 + h[0] * through[0] + h[1] * through[1];
            let gain = through.map(|x| x / variance);
            p[0] -= gain[0] * through[0];
            p[1] -= gain[0] * through[1];
            p[2] -= gain[1] * through[1];
            (gain, 1.0 / variance.sqrt())
        };
        // Slopes change from one branch to another alone.
        let mut at = ([f64::NAN; 2], Oscillation::default());
        let samples = slopes.iter().zip(counts).map(|(&slope, &counts)| {
            if slope != at.0 {
                at = (slope, Oscillation::new(slope[0], slope[1], dt));
            }
            let later = at.1;
            // Columns of the transition, then the covariance through it.
            let (c, e) = (after(&later, [1.0, 0.0]), after(&later, [0.0, 1.0]));
            let through =
                |x: usize, y: usize| c[x] * (c[y] * p[0] + e[y] * p[1]) + e[x] * (c[y] * p[1] + e[y] * p[2]);
            p = [through(0, 0), through(0, 1), through(1, 1) + grows];
            let of_a = slope.map(|s| -s / a);
            let (gain_a, over_a) = if counts { seen(&mut p, of_a) } else { ([0.0; 2], 0.0) };
            let (gain_d, over_d) = seen(&mut p, [of_d, 0.0]);
            Sample { later, of_a, gain_a, gain_d, over: [over_a, over_d] }
        });
        Self { of_d, samples: samples.collect() }
    }

    /// Takes the place of both channels, A before D, in units of their noise.
    fn whiten(&self, channels: &mut [f64]) {
        let n = self.samples.len().min(channels.len() / 2);
        let (in_a, in_d) = channels.split_at_mut(n);
        let mut error = [0.0; 2];
        for ((sample, a), d) in self.samples.iter().zip(in_a).zip(in_d) {
            error = after(&sample.later, error);
            let left_a = *a - sample.of_a[0] * error[0] - sample.of_a[1] * error[1];
            (0..2).for_each(|i| error[i] += sample.gain_a[i] * left_a);
            let left_d = *d - self.of_d * error[0];
            (0..2).for_each(|i| error[i] += sample.gain_d[i] * left_d);
            [*a, *d] = [sample.over[0] * left_a, sample.over[1] * left_d];
        }
    }
}

impl Measured<'_> {
    /// Tells what noise in the drive does beside the motion of a fitted model. Once; says whether there is any.
    pub fn learn_noise_of_drive(&self, spec: &ModelSpec) -> bool {
        let noisy =
            |window: &Window| window.random && window.drive_noise_m_s2 > QUIET * self.table_noise_m_s2;
        if self.driven.get().is_some() || !self.motion.windows.iter().any(noisy) {
            return false;
        }
        let motion = self.motion;
        let of = |window: &Window| {
            if !noisy(window) {
                return None;
            }
            let spec = motion.sources[window.source].setting.of(spec);
            let range = window.range.clone();
            let slopes: Vec<Slope> =
                motion.displacement_m[range.clone()].iter().map(|d| slope(&spec, *d)).collect();
            let displacement = if self.sees_displacement { motion.laser_noise_m } else { f64::INFINITY };
            let noises = [window.drive_noise_m_s2, motion.restoring_noise_m_s2, displacement];
            Some(Innovations::new(&slopes, &self.counts()[range], noises, motion.dt_s()))
        };
        self.driven.set(motion.windows.iter().map(of).collect()).is_ok()
    }

    /// Makes both channels of a step white.
    pub(super) fn whiten(&self, window: &Window, channels: &mut [f64]) {
        match self.innovations(window) {
            Some(innovations) => innovations.whiten(channels),
            None => self.whiten_displacement(window.source, &mut channels[window.range.len()..]),
        }
    }

    /// Takes from both channels of a step what noise in the drive has done: what is left is as much as their own noise.
    pub(super) fn follow_drive(&self, window: &Window, channels: &mut [f64]) {
        if let Some(innovations) = self.innovations(window) {
            innovations.whiten(channels);
        }
    }

    fn innovations(&self, window: &Window) -> Option<&Innovations> {
        let all = self.driven.get().filter(|_| window.random)?;
        let index = self.motion.windows.iter().position(|w| std::ptr::eq(w, window))?;
        all.get(index)?.as_ref()
    }
}

/// Deviation of the zero of the table's acceleration, its mean over a record: without a displacement of the table nothing says that it
/// ends as fast as it began. A force that is off all the time is a finding. How fast either may be goes with the acceleration in the first and last cycle.
pub(super) fn zero_of_table_m_s2(motion: &Motion) -> f64 {
    let random = motion.kind == Kind::Base && motion.windows.iter().any(|window| window.random);
    if !random || motion.table_crossover_rad_s > 0.0 {
        return LEAST_ZERO_M_S2;
    }
    let (drive, frequency_hz) = (&motion.drive_m_s2, motion.median_frequency_hz());
    let cycle = ((motion.sample_rate_hz / frequency_hz) as usize).clamp(1, drive.len());
    let rms = |a: &[f64]| (dot(a, a) / a.len() as f64).sqrt();
    let ends = rms(&drive[..cycle]).hypot(rms(&drive[drive.len() - cycle..]));
    let speed_m_s = ends / (std::f64::consts::TAU * frequency_hz);
    (speed_m_s / (drive.len() as f64 * motion.dt_s())).max(LEAST_ZERO_M_S2)
}

/// Slopes of the restoring acceleration of isolator and bumper at a displacement.
fn slope(spec: &ModelSpec, displacement_m: f64) -> Slope {
    let isolator = &spec.isolator;
    let far = displacement_m.abs();
    let segment = isolator.breakpoints_m.iter().filter(|knee| far > **knee).count();
    let mut stiffness = isolator.stiffness_n_m.get(segment).copied().unwrap_or(0.0);
    let mut damping = isolator.damping_n_s_m;
    if let Some(bumper) = spec.bumper.as_ref().filter(|bumper| far > 0.5 * bumper.total_gap_m) {
        stiffness += bumper.stiffness_n_m;
        damping += bumper.damping_n_s_m;
    }
    [stiffness / spec.mass_kg, damping / spec.mass_kg]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, prelude::Distribution};

    #[test]
    fn what_noise_in_the_drive_does_is_made_white() {
        let (dt, n, slope) = (1e-3, 60_000, [650.0, 2.5]);
        let noises = [0.02, 7e-3, 8e-6];
        let later = Oscillation::new(slope[0], slope[1], dt);
        let mut random = rand_pcg::Pcg64::seed_from_u64(5);
        let mut normal = || -> f64 { rand_distr::StandardNormal.sample(&mut random) };
        let mut error = [0.0; 2];
        let (mut a, mut d) = (Vec::new(), Vec::new());
        for _ in 0..n {
            error = after(&later, error);
            error[1] += noises[0] * dt * normal();
            a.push((-slope[0] * error[0] - slope[1] * error[1]) / noises[1] + normal());
            d.push(error[0] / noises[2] + normal());
        }
        let covariance = |x: &[f64], lag: usize| dot(&x[lag..], &x[..x.len() - lag]) / x.len() as f64;
        assert!(covariance(&d, 4) > 0.5, "{}", covariance(&d, 4));
        let mut counts = vec![true; n];
        counts[1000..1010].fill(false);
        a[1000..1010].fill(0.0);
        let mut white = [a, d].concat();
        let innovations = Innovations::new(&vec![slope; n], &counts, noises, dt);
        innovations.whiten(&mut white);
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
    }
}
