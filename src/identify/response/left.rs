//! What a model laid against the record leaves: structure, colour, and errors step by step.

use super::{Laid, Measured, Nuisances, Step, robust};
use crate::identify::least_squares::dot;
use crate::identify::problem::{OutputError, Part};
use crate::model::ModelSpec;

/// Samples between neighbours whose covariance is structure: beyond what filters and lags make.
const NEAR: usize = 8;
/// Share of the steps, those with most left, in which a stiff contact may have led elsewhere.
const ELSEWHERE: f64 = 0.15;

/// What is left in the residuals of a part.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Left {
    /// Covariance of neighbouring residuals, in units of the noise, its mean over the steps: noise has none, whatever its level.
    pub excess: f64,
    /// Standard deviation of that where nothing but white noise is left.
    pub chance: f64,
    /// How many residuals count as one independent one.
    pub colour: f64,
    /// Mean square over that of the noise, its median over the steps.
    pub median: f64,
}

impl Measured<'_> {
    /// Errors of A and D step by step with what is estimated beside the model taken out, samples beside jumps left out; each with
    /// the number of its window.
    pub fn errors(&self, spec: &ModelSpec, part: Part, laid: &Laid) -> Option<Vec<(usize, OutputError)>> {
        let motion = self.motion;
        let (_, steps) = self.lay(spec, part, &laid.values, &laid.nuisances)?;
        let counted = self.counts();
        let of = |((step, own), k): ((&Step<'_>, &Nuisances), &usize)| {
            let common = self.common(&laid.values, step.window);
            let mut misfit = self.misfit(step.window, &step.simulated, common, own);
            self.follow_drive(step.window, &mut misfit);
            let (of_a, of_d) = misfit.split_at(step.simulated.len());
            let laser = motion.laser_m.get(step.window.range.clone()).unwrap_or(&[]);
            let mean = laser.iter().sum::<f64>() / laser.len().max(1) as f64;
            let mut error = OutputError::default();
            let counts = |n: &usize| counted[*n] || !motion.sees_acceleration;
            for (i, n) in step.window.range.clone().enumerate().filter(|(_, n)| counts(n)) {
                if motion.sees_acceleration {
                    error.sum_a += (motion.restoring_noise_m_s2 * of_a[i]).powi(2);
                    error.power_a += motion.restoring_m_s2[n].powi(2);
                }
                if let Some(seen) = laser.get(i) {
                    error.sum_d += (motion.laser_noise_m * of_d[i]).powi(2);
                    error.power_d += (seen - mean).powi(2);
                }
                error.count += 1;
            }
            (*k, error)
        };
        Some(steps.iter().zip(&laid.nuisances).zip(self.windows(part)).map(of).collect())
    }

    /// What each step of a part has of the cost.
    pub fn costs(&self, spec: &ModelSpec, part: Part, laid: &Laid) -> Option<Vec<f64>> {
        let each = self.lay_each(spec, part, &laid.values, &laid.nuisances)?;
        Some(each.into_iter().map(|(cost, _)| cost).collect())
    }

    /// What is left of A (m/s2) and of D (m) in the windows of a part with what is estimated beside the model taken out, each with the number of its
    /// window; nothing of a channel that was not measured. Where samples of A do not count the others stand for them: tones keep their size.
    pub fn misfits(&self, spec: &ModelSpec, part: Part, laid: &Laid) -> Option<Vec<(usize, [Vec<f64>; 2])>> {
        let (_, steps) = self.lay(spec, part, &laid.values, &laid.nuisances)?;
        let motion = self.motion;
        let seen = [motion.sees_acceleration, self.sees_displacement];
        let noise = [motion.restoring_noise_m_s2, motion.laser_noise_m];
        let of = |((step, own), k): ((&Step<'_>, &Nuisances), &usize)| {
            let common = self.common(&laid.values, step.window);
            let misfit = self.misfit(step.window, &step.simulated, common, own);
            let (of_a, of_d) = misfit.split_at(step.simulated.len());
            let counted = self.counts()[step.window.range.clone()].iter().filter(|counts| **counts).count();
            let unit = [noise[0] * of_a.len() as f64 / counted.max(1) as f64, noise[1]];
            let channel = |of: &[f64], i: usize| -> Vec<f64> {
                if seen[i] { of.iter().map(|x| unit[i] * x).collect() } else { Vec::new() }
            };
            (*k, [channel(of_a, 0), channel(of_d, 1)])
        };
        Some(steps.iter().zip(&laid.nuisances).zip(self.windows(part)).map(of).collect())
    }

    /// What is left of the residuals of a part.
    pub fn left(&self, spec: &ModelSpec, part: Part, laid: &Laid) -> Option<Left> {
        let (_, steps) = self.lay(spec, part, &laid.values, &laid.nuisances)?;
        let (mut power, mut count, mut variance) = (0.0, 0usize, 0.0);
        let mut means: Vec<f64> = Vec::with_capacity(steps.len());
        let mut neighbours: Vec<f64> = Vec::with_capacity(steps.len());
        // Sums of products at lags that grow by a quarter, each standing for those it skips.
        let mut lags: Vec<(usize, usize, f64)> = Vec::new();
        let mut lag = 1;
        while lag < 4096 {
            let next = (lag + 1).max(lag * 5 / 4);
            lags.push((lag, next - lag, 0.0));
            lag = next;
        }
        for step in &steps {
            let chi2 = dot(&step.residuals, &step.residuals);
            let counted = self.count(step.window);
            variance += 1.0 / counted.max(1) as f64;
            let weight = robust(chi2, counted).1;
            means.push(chi2 / counted as f64);
            let pairs =
                step.residuals.chunks(step.simulated.len()).map(|c| dot(&c[NEAR..], &c[..c.len() - NEAR]));
            neighbours.push(pairs.sum::<f64>() / counted as f64);
            for channel in step.residuals.chunks(step.simulated.len()) {
                power += weight * dot(channel, channel);
                count += channel.len();
                for (lag, _, sum) in lags.iter_mut().filter(|(lag, _, _)| *lag < channel.len() / 2) {
                    *sum += weight * dot(&channel[*lag..], &channel[..channel.len() - *lag]);
                }
            }
        }
        let mut colour = 1.0;
        for (_, stands_for, sum) in lags {
            let rho = sum / power.max(1e-300);
            if rho < 2.0 / (count as f64).sqrt() {
                break;
            }
            colour += 2.0 * rho * stands_for as f64;
        }
        means.sort_by(f64::total_cmp);
        neighbours.sort_by(f64::total_cmp);
        neighbours.truncate(neighbours.len() - (ELSEWHERE * neighbours.len() as f64) as usize);
        Some(Left {
            excess: (neighbours.iter().sum::<f64>() / neighbours.len().max(1) as f64).max(0.0),
            chance: variance.sqrt() / steps.len().max(1) as f64,
            colour,
            median: means.get(means.len() / 2).copied().unwrap_or(f64::INFINITY),
        })
    }
}
