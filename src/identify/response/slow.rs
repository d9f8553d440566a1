//! Slow noise of the displacement sensor - a drift of temperature, of what holds it -, told from what a fitted model leaves and taken
//! account of: at the frequencies of a slow step it may be several times the white noise, and sums of squares that took it for white
//! had numbers of the isolator known half again as well as they are. The search has it told; every residual and every slope is made white.

use super::columns::Job;
use super::descent::Fitted;
use super::driven::Driven;
use super::{Laid, Measured, ROBUST, Step};
use crate::identify::least_squares::{dot, gram};
use crate::identify::numbers::Numbers;
use crate::identify::problem::Part;
use crate::model::ModelSpec;
use crate::parallel;
use nalgebra::DVector;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Frequencies at which slow noise may equal the white one: from one, over the usual frequency of the steps, by a factor, so many.
const LOWEST: f64 = 0.02;
const NEXT: f64 = 1.25;
const CORNERS: i32 = 28;
/// Means of so many stretches of a cycle tell slow noise.
const A_CYCLE: f64 = 32.0;
/// Corners that are no farther apart are the same.
const CHANCE: f64 = 1.5;
/// Harmonics of a step that are no noise: a model may lack them.
const HARMONICS: i32 = 6;
/// Steps tell together; one that wants something else by so many nats holds a motion that no harmonic has.
const ASTRAY: f64 = 6.0;
const ROUNDS: usize = 8;
/// Steps of a record that are looked at, at most.
const STEPS: usize = 24;
/// Share of its last variance at which a walk has settled.
const SETTLED: f64 = 0.9999;
/// Beside noise in what drives a step, every so manieth corner is looked at.
const SPARSE: usize = 2;
const _: () = assert!((CORNERS as usize).is_multiple_of(SPARSE));
/// Nats that slow noise has to bring there.
const LEAST: f64 = 3.0;
/// Columns that say the same are told apart by no more than this.
const ALIKE: f64 = 1e-9;

/// Makes a channel with white and slow noise white: the innovations of a random walk in white noise of unit variance, which starts
/// from nothing (Kalman 1960; Harvey, Forecasting, structural time series models and the Kalman filter, 1989, ch. 4).
#[derive(Clone, Debug, Default)]
pub(super) struct Whitening {
    /// Gain and inverse deviation of the innovation at each sample, until they stay.
    gains: Vec<[f64; 2]>,
}

impl Whitening {
    /// For a random walk that grows by so much variance a sample, over that of the white noise.
    fn new(growth: f64) -> Self {
        let (mut gains, mut variance) = (Vec::new(), 0.0);
        let settled = 0.5 * growth + (0.25 * growth * growth + growth).sqrt();
        while variance < SETTLED * settled {
            variance += growth;
            let gain = variance / (variance + 1.0);
            gains.push([gain, (1.0 - gain).sqrt()]);
            if variance < SETTLED * settled {
                variance *= 1.0 - gain;
            }
        }
        Self { gains }
    }

    /// Takes the place of a channel in units of the white noise.
    pub(super) fn whiten(&self, channel: &mut [f64]) {
        let Some(last) = self.gains.last() else { return };
        let mut slow = 0.0;
        for (i, x) in channel.iter_mut().enumerate() {
            let [gain, over] = self.gains.get(i).unwrap_or(last);
            let innovation = *x - slow;
            slow += gain * innovation;
            *x = over * innovation;
        }
    }

    /// What was made white, as it was.
    fn restore(&self, channel: &mut [f64]) {
        let Some(last) = self.gains.last() else { return };
        let mut slow = 0.0;
        for (i, x) in channel.iter_mut().enumerate() {
            let [gain, over] = self.gains.get(i).unwrap_or(last);
            let innovation = *x / over;
            *x = innovation + slow;
            slow += gain * innovation;
        }
    }

    /// Sum of the logarithms of the innovations' variances over so many samples.
    fn log_determinant(&self, samples: usize) -> f64 {
        let Some(last) = self.gains.last() else { return 0.0 };
        (0..samples).map(|i| -2.0 * self.gains.get(i).unwrap_or(last)[1].ln()).sum()
    }
}

/// Slow noise of the displacement sensor of one record.
#[derive(Clone, Debug, Default)]
pub(super) struct Slow {
    corner_hz: f64,
    whitening: Whitening,
}

impl Measured<'_> {
    /// Makes what a step has of the displacement sensor white.
    pub(super) fn whiten_displacement(&self, source: usize, displacement: &mut [f64]) {
        if let Some(slow) = self.slow().get(source) {
            slow.whitening.whiten(displacement);
        }
    }

    /// What was made white of a step, as it was.
    pub(super) fn restore_displacement(&self, source: usize, displacement: &mut [f64]) {
        if let Some(slow) = self.slow().get(source) {
            slow.whitening.restore(displacement);
        }
    }

    /// Variance that slow noise which equals the white one at a frequency grows by, a sample, over that of the white one.
    fn growth(&self, corner_hz: f64) -> f64 {
        (TAU * corner_hz / self.motion.sample_rate_hz).powi(2)
    }

    /// Frequency at which the slow noise of each record's displacement sensor equals its white noise, Hz: 0 without any; nothing
    /// before it was told.
    pub fn slow_noise_hz(&self) -> Vec<f64> {
        self.slow().iter().map(|slow| slow.corner_hz).collect()
    }

    fn slow(&self) -> Arc<Vec<Slow>> {
        self.slow.read().map(|slow| slow.clone()).unwrap_or_default()
    }

    /// Tells slow noise of each record's displacement sensor from what a fitted model leaves beside harmonics of each step and what
    /// belongs to it: the corner where it equals the white noise, by the restricted likelihood (Patterson and Thompson 1971). What a
    /// model lacks may pose as slow noise, so a better one tells it anew. Says whether anything changed by more than chance.
    pub fn learn_slow_noise(&self, spec: &ModelSpec, numbers: &Numbers, laid: [(Part, &Laid); 2]) -> bool {
        let lowest_hz = LOWEST * self.motion.median_frequency_hz();
        let corners: Vec<f64> =
            [0.0].into_iter().chain((0..CORNERS).map(|i| lowest_hz * NEXT.powi(i))).collect();
        let mut told: Vec<Vec<Vec<f64>>> = vec![Vec::new(); self.records()];
        let noisy = self.motion.windows.iter().any(|w| !w.random && self.driven_in(w).is_some());
        for (part, laid) in laid {
            let Some((_, steps)) = self.lay(spec, part, &laid.values, &laid.nuisances) else { return false };
            let free = self.free(numbers, 0.0);
            let fitted = Fitted::at_rest(spec, numbers, &free);
            let every = steps.len().div_ceil(STEPS).max(1);
            let each: Vec<usize> = (0..steps.len()).step_by(every).collect();
            let profiles = parallel::map_with(
                &each,
                |k| steps[*k].simulated.len(),
                || self.job(&fitted, &laid.values),
                |job, &k| {
                    let of_step = self.profile_of_slow_noise(job, &steps[k], &laid.nuisances[k], &corners);
                    Some(of_step.map(|profile| (steps[k].window.source, profile)))
                },
            );
            for (source, profile) in profiles.into_iter().flatten().flatten() {
                told[source].push(profile);
            }
        }
        let slow: Vec<Slow> = told
            .iter()
            .map(|profiles| {
                let corner_hz = corners[agreed(profiles, if noisy { LEAST } else { 0.0 })];
                Slow { corner_hz, whitening: Whitening::new(self.growth(corner_hz)) }
            })
            .collect();
        let before = self.slow();
        let another = |(i, slow): (usize, &Slow)| {
            let before = before.get(i).map_or(0.0, |before| before.corner_hz);
            (slow.corner_hz.max(lowest_hz) / before.max(lowest_hz)).ln().abs() > CHANCE * NEXT.ln()
        };
        let changed = slow.iter().enumerate().any(another);
        if changed && let Ok(mut now) = self.slow.write() {
            let growths: Vec<f64> = slow.iter().map(|slow| self.growth(slow.corner_hz)).collect();
            self.noise_of_drive_beside(&growths);
            *now = Arc::new(slow);
        }
        changed
    }

    /// Restricted log-likelihood of each corner in a steady step that the model follows.
    fn profile_of_slow_noise(
        &self,
        job: &mut Job<'_>,
        step: &Step<'_>,
        own: &[f64],
        corners: &[f64],
    ) -> Option<Vec<f64>> {
        let window = step.window;
        let far = dot(&step.residuals, &step.residuals) > ROBUST * self.count(window) as f64;
        if far || window.settling || window.random {
            return None;
        }
        let (_, beside) = self.columns(job, step, own, None);
        match self.driven_in(window) {
            Some(driven) => self.profile_beside(&driven, step, &beside, corners),
            None => self.profile_of_displacement(step, &beside, corners),
        }
    }

    /// The same from the displacement alone, by its means over some samples, beside what belongs to the step.
    fn profile_of_displacement(
        &self,
        step: &Step<'_>,
        beside: &[Vec<f64>],
        corners: &[f64],
    ) -> Option<Vec<f64>> {
        let (window, n, rate) = (step.window, step.simulated.len(), self.motion.sample_rate_hz);
        let block = ((rate / window.frequency_hz.max(1e-9) / A_CYCLE) as usize).max(1);
        let seen = |white: &[f64]| -> Vec<f64> {
            let mut channel = white[n..].to_vec();
            self.restore_displacement(window.source, &mut channel);
            channel.chunks_exact(block).map(|c| c.iter().sum::<f64>() / (block as f64).sqrt()).collect()
        };
        let residual = seen(&step.residuals);
        let turn = TAU * window.frequency_hz * block as f64 / rate;
        let seen_beside = beside.iter().map(|column| seen(column));
        let columns = of_length_one(seen_beside.chain(harmonics(turn, residual.len())));
        let likelihood = |corner: &f64| {
            // Means of stretches walk as far as the samples do.
            let whitening = Whitening::new((TAU * corner / rate * block as f64).powi(2));
            let white = |channel: &mut [f64]| whitening.whiten(channel);
            restricted(&residual, &columns, white, whitening.log_determinant(residual.len()))
        };
        corners.iter().map(likelihood).collect()
    }

    /// The same beside noise in what drives the step: both channels tell it, and every sample.
    fn profile_beside(
        &self,
        driven: &Driven,
        step: &Step<'_>,
        beside: &[Vec<f64>],
        corners: &[f64],
    ) -> Option<Vec<f64>> {
        let (window, n, rate) = (step.window, step.simulated.len(), self.motion.sample_rate_hz);
        let seen = |white: &[f64]| {
            let mut channels = white.to_vec();
            driven.innovations().restore(&mut channels);
            channels
        };
        let of_d = harmonics(TAU * window.frequency_hz / rate, n).map(|wave| [vec![0.0; n], wave].concat());
        let columns = of_length_one(beside.iter().map(|column| seen(column)).chain(of_d));
        let (residual, counts) = (seen(&step.residuals), self.counts());
        let likelihood = |corner: &f64| {
            let innovations = driven.beside(self.growth(*corner));
            let white = |channels: &mut [f64]| innovations.whiten(&counts[window.range.clone()], channels);
            restricted(&residual, &columns, white, innovations.log_determinant())
        };
        let looked_at: Vec<f64> = corners.iter().step_by(SPARSE).map(likelihood).collect::<Option<_>>()?;
        let between = |i: usize| {
            let (left, share) = (i / SPARSE, (i % SPARSE) as f64 / SPARSE as f64);
            let next = looked_at.get(left + 1).unwrap_or(&looked_at[left]);
            looked_at[left] + share * (next - looked_at[left])
        };
        Some((0..corners.len()).map(between).collect())
    }
}

/// Harmonics of a step that turns by so much from one to the next of so many values.
fn harmonics(turn: f64, values: usize) -> impl Iterator<Item = Vec<f64>> {
    let wave = move |harmonic: i32, of: fn(f64) -> f64| {
        (0..values).map(|i| of(f64::from(harmonic) * turn * i as f64)).collect()
    };
    (1..=HARMONICS).flat_map(move |harmonic| [wave(harmonic, f64::cos), wave(harmonic, f64::sin)])
}

/// Columns over their length, those of none left out.
fn of_length_one(columns: impl Iterator<Item = Vec<f64>>) -> Vec<Vec<f64>> {
    let sized = columns.map(|column| (dot(&column, &column).sqrt(), column)).filter(|(size, _)| *size > 0.0);
    sized.map(|(size, column)| column.into_iter().map(|x| x / size).collect()).collect()
}

/// Restricted log-likelihood of a channel beside columns, from what makes them white and the logarithm of the determinant of its covariance.
fn restricted(
    channel: &[f64],
    columns: &[Vec<f64>],
    white: impl Fn(&mut [f64]),
    log_determinant: f64,
) -> Option<f64> {
    if channel.len() < 2 * columns.len() {
        return None;
    }
    let whitened = |channel: &[f64]| {
        let mut channel = channel.to_vec();
        white(&mut channel);
        channel
    };
    let of = whitened(channel);
    let along: Vec<Vec<f64>> = columns.iter().map(|column| whitened(column)).collect();
    let mut gram = gram(&along);
    (0..along.len()).for_each(|i| gram[(i, i)] *= 1.0 + ALIKE);
    let slope = DVector::from_fn(along.len(), |i, _| dot(&along[i], &of));
    let root = gram.cholesky()?;
    let square = dot(&of, &of) - slope.dot(&root.solve(&slope));
    let determinant = 2.0 * root.l_dirty().diagonal().iter().map(|x| x.ln()).sum::<f64>();
    Some(-0.5 * (log_determinant + determinant + square))
}

/// The number of the corner that most of the steps agree on: the first, which is none, without any, and where it brings too few nats.
fn agreed(profiles: &[Vec<f64>], least: f64) -> usize {
    let best =
        |profile: &[f64]| (0..profile.len()).max_by(|a, b| profile[*a].total_cmp(&profile[*b])).unwrap_or(0);
    let mut each: Vec<usize> = profiles.iter().map(|profile| best(profile)).collect();
    each.sort_unstable();
    let (mut found, mut gained) = (each.get(each.len() / 2).copied().unwrap_or(0), 0.0);
    for _ in 0..ROUNDS {
        let agrees = |profile: &&Vec<f64>| profile[best(profile)] - profile[found] < ASTRAY;
        let together = profiles.iter().filter(agrees).fold(Vec::new(), |sum: Vec<f64>, profile| {
            profile.iter().enumerate().map(|(i, x)| x + sum.get(i).unwrap_or(&0.0)).collect()
        });
        let next = best(&together);
        gained = together.get(next).zip(together.first()).map_or(0.0, |(with, without)| with - without);
        if next == found {
            break;
        }
        found = next;
    }
    if gained < least { 0 } else { found }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;
    use rand::{SeedableRng, prelude::Distribution};

    fn walk(growth: f64, samples: usize, seed: u64) -> Vec<f64> {
        let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
        let mut normal = || -> f64 { rand_distr::StandardNormal.sample(&mut random) };
        let mut slow = 0.0;
        let mut seen = || {
            slow += growth.sqrt() * normal();
            slow + normal()
        };
        (0..samples).map(|_| seen()).collect()
    }

    #[test]
    fn a_walk_in_noise_is_made_white_and_is_had_back() {
        let seen = walk(1e-3, 40_000, 1);
        let (mut white, whitening) = (seen.clone(), Whitening::new(1e-3));
        whitening.whiten(&mut white);
        let n = white.len() as f64;
        let covariance = |lag: usize| dot(&white[lag..], &white[..white.len() - lag]) / n;
        assert!((covariance(0) - 1.0).abs() < 5.0 * (2.0 / n).sqrt(), "{}", covariance(0));
        for lag in [1, 3, 10, 100, 1000] {
            assert!(covariance(lag).abs() < 5.0 / n.sqrt(), "{lag}: {}", covariance(lag));
        }
        whitening.restore(&mut white);
        assert!(white.iter().zip(&seen).all(|(a, b)| (a - b).abs() < 1e-9));
    }

    #[test]
    fn the_determinant_is_that_of_the_covariance() {
        let (growth, n) = (0.3, 6);
        // Covariance of a walk in white noise.
        let covariance =
            DMatrix::from_fn(n, n, |i, j| growth * (i.min(j) + 1) as f64 + f64::from(u8::from(i == j)));
        let told = Whitening::new(growth).log_determinant(n);
        assert!((told - covariance.determinant().ln()).abs() < 1e-4, "{told}");
    }

    #[test]
    fn steps_agree_on_what_most_of_them_have() {
        let of = |best: f64, nats: f64| (0..20).map(|i| -nats * (f64::from(i) - best).powi(2)).collect();
        let profiles = [of(5.0, 0.1), of(7.0, 0.1), of(6.0, 0.1), of(19.0, 3.0)];
        // It brings 10.8 nats in the three that agree.
        assert_eq!([0.0, 10.0, 11.0].map(|least| agreed(&profiles, least)), [6, 6, 0]);
        assert_eq!(agreed(&[], 0.0), 0);
    }
}
