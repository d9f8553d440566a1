//! Jumps of the acceleration, where a damped contact begins or friction turns: spread over the samples beside them in a simulation, and
//! left out of the sums, where the record or a fitted response has them. Called by every simulation and once by the search.

use super::{Laid, Measured, Simulated, Specimens};
use crate::identify::problem::Part;
use crate::model::ModelSpec;
use std::sync::Arc;

/// A second difference of the measured acceleration above so many times its noise is a jump, as where a damped contact begins:
/// which of two samples it falls between is chance.
const JUMP: f64 = 7.0;
/// Samples on each side of a jump that do not count.
const AROUND: usize = 2;
/// Share of the samples that are beside jumps at most; more is no jumps.
const MOST: f64 = 0.2;
/// A simulated acceleration that spreading changes by more than this, in units of the noise, has a jump beside it.
const SPREAD: f64 = 0.2;

/// Share of the samples beside jumps that is beside others when a model has them elsewhere: 6 % had the numbers of a Hertz contact 2.3
/// of their deviations off (rms), in place of 0.9.
const OTHERS: f64 = 0.01;

/// A simulated step with what spreading its jumps takes: relative velocity and table acceleration at each sample.
pub(super) struct Sampled {
    pub(super) simulated: Simulated,
    pub(super) velocity_m_s: Vec<f64>,
    pub(super) table_m_s2: Vec<f64>,
}

impl Sampled {
    /// Spreads its jumps, where the table moves as it is driven.
    pub(super) fn spread(&mut self, specimens: &Specimens, rate_hz: f64) {
        if !specimens.kicks {
            spread_jumps(&mut self.simulated, &self.velocity_m_s, &self.table_m_s2, rate_hz);
        }
    }
}

impl Measured<'_> {
    /// Whether each sample of the acceleration counts.
    pub(super) fn counts(&self) -> Arc<Vec<bool>> {
        let told = self.told.read().map(|told| told.clone()).unwrap_or_default();
        told.unwrap_or_else(|| Arc::clone(&self.counts))
    }

    /// Lets the samples beside the jumps of a fitted response not count, those that noise hides in the record too: a record tells a
    /// jump's instant to half a sample at best, a fit would have it tell more. A better model has them elsewhere, so it tells them anew;
    /// but not beside noise that has been told with them. Says whether they are others than before.
    pub fn learn_jumps(&self, spec: &ModelSpec, laid: [(Part, &Laid); 2]) -> bool {
        let before = self.told.read().map(|told| told.clone()).unwrap_or_default();
        if self.coarse || before.is_some() && self.is_driven_at_random() {
            return false;
        }
        let Some(mut specimens) = self.specimens(spec) else { return false };
        let mut counts = Vec::clone(&self.counts);
        for (part, laid) in laid {
            for (k, own) in self.windows(part).iter().zip(&laid.nuisances) {
                let window = &self.motion.windows[*k];
                let common = self.common(&laid.values, window);
                let mut sampled = self.sampled(&mut specimens, window, common, own);
                let simulated = sampled.simulated.clone();
                sampled.spread(&specimens, self.motion.sample_rate_hz);
                for (i, (of, spread)) in simulated.iter().zip(&sampled.simulated).enumerate() {
                    if (of.0 - spread.0).abs() > SPREAD * self.motion.restoring_noise_m_s2 {
                        leave_out(&mut counts, window.range.start + i);
                    }
                }
            }
        }
        let changed = before.is_none_or(|before| are_others(&before, &counts));
        if changed && let Ok(mut told) = self.told.write() {
            *told = Some(Arc::new(counts));
        }
        changed
    }
}

/// A jump of the simulated acceleration, where a damped contact begins or friction turns, goes over from sample to sample when it
/// comes earlier or later. So that the cost has no steps there, the acceleration of each sample is its mean over the samples
/// beside it, which the velocities give however it runs between them, sharpened again by the second difference of those means (of
/// fourth order where nothing jumps). The ends stay as they are.
pub(super) fn spread_jumps(
    simulated: &mut Simulated,
    velocity_m_s: &[f64],
    table_m_s2: &[f64],
    rate_hz: f64,
) {
    let n = simulated.len();
    if n < 5 {
        return;
    }
    let mean = |i: usize| {
        let table = 0.25 * (table_m_s2[i - 1] + 2.0 * table_m_s2[i] + table_m_s2[i + 1]);
        0.5 * (velocity_m_s[i + 1] - velocity_m_s[i - 1]) * rate_hz + table
    };
    let mut beside = [mean(1), mean(2)];
    for (i, of) in simulated.iter_mut().enumerate().take(n - 2).skip(2) {
        let after = mean(i + 1);
        of.0 = (8.0 * beside[1] - beside[0] - after) / 6.0;
        beside = [beside[1], after];
    }
}

/// The same where there may be few samples in a cycle: sixth differences pass no motion even then, but a jump as well as second ones;
/// their noise over that of those.
pub(in crate::identify) fn beside_jumps_of_few_samples(acceleration: &[f64], noise: f64) -> Vec<bool> {
    const SHARPER: f64 = 12.4;
    let mut counts = vec![true; acceleration.len()];
    for (n, w) in acceleration.windows(7).enumerate() {
        let sixth = w[0] - 6.0 * w[1] + 15.0 * w[2] - 20.0 * w[3] + 15.0 * w[4] - 6.0 * w[5] + w[6];
        if sixth.abs() > JUMP * SHARPER * noise {
            leave_out(&mut counts, n + 3);
        }
    }
    counts
}

/// Whether each sample counts: not beside a jump. Of a motion that good sensors see at few samples a cycle, sixth differences tell: there
/// second ones stand out of the noise everywhere.
pub(super) fn beside_jumps(acceleration: &[f64], noise: f64) -> Vec<bool> {
    let counts = beside_bends(acceleration, noise);
    if are_too_many(&counts) { beside_jumps_of_few_samples(acceleration, noise) } else { counts }
}

/// Whether more samples do not count than there can be beside jumps.
pub(in crate::identify) fn are_too_many(counts: &[bool]) -> bool {
    counts.iter().filter(|counts| !**counts).count() as f64 > MOST * counts.len() as f64
}

/// Whether jumps are elsewhere: a good part of what does not count in either does in the other.
fn are_others(before: &[bool], now: &[bool]) -> bool {
    let (mut either, mut one) = (0usize, 0usize);
    for (before, now) in before.iter().zip(now) {
        either += usize::from(!before || !now);
        one += usize::from(before != now);
    }
    one as f64 > OTHERS * either as f64
}

fn beside_bends(acceleration: &[f64], noise: f64) -> Vec<bool> {
    let mut counts = vec![true; acceleration.len()];
    for (n, x) in acceleration.windows(3).enumerate() {
        if (x[2] - 2.0 * x[1] + x[0]).abs() > JUMP * noise {
            leave_out(&mut counts, n + 1);
        }
    }
    counts
}

/// The samples about a jump do not count.
fn leave_out(counts: &mut [bool], jump: usize) {
    let end = (jump + AROUND + 1).min(counts.len());
    counts[jump.saturating_sub(AROUND)..end].fill(false);
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, prelude::Distribution};

    #[test]
    fn a_jump_is_seen_where_there_are_few_samples_in_a_cycle() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(9);
        let mut normal = || -> f64 { rand_distr::StandardNormal.sample(&mut random) };
        // Nine samples a cycle, two hundred times the noise.
        let mut a: Vec<f64> = (0..2000).map(|i| 2.0 * (0.7 * f64::from(i)).sin() + 0.01 * normal()).collect();
        assert!(beside_bends(&a, 0.01).iter().all(|counts| !counts), "second differences see the motion");
        let left_out = |a: &[f64]| {
            let counts = beside_jumps_of_few_samples(a, 0.01);
            (0..counts.len()).filter(|i| !counts[*i]).collect::<Vec<usize>>()
        };
        // Chance alone is beyond the limit in four of a thousand, and five samples are then left out.
        let by_chance = left_out(&a);
        assert!(by_chance.len() < 80, "{} of {}", by_chance.len(), a.len());
        a[1000..].iter_mut().for_each(|a| *a += 0.4);
        let beside: Vec<usize> = left_out(&a).into_iter().filter(|i| !by_chance.contains(i)).collect();
        assert!(beside.contains(&999) && beside.contains(&1000), "{beside:?}");
        assert!(beside.iter().all(|i| (990..1010).contains(i)), "{beside:?}");
    }

    #[test]
    fn a_motion_at_few_samples_a_cycle_is_no_jump_wherever_good_sensors_see_it() {
        let tone = |i: usize| (std::f64::consts::TAU * i as f64 / 34.0).sin();
        let mut seen: Vec<f64> = (0..3400).map(tone).collect();
        seen[2000..].iter_mut().for_each(|a| *a += 0.1);
        let counts = beside_jumps(&seen, 5e-4);
        let out: Vec<usize> = (0..seen.len()).filter(|i| !counts[*i]).collect();
        assert!(out.contains(&2000) && out.len() < 12, "{out:?}");
    }
}
