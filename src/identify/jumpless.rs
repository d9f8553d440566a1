//! Noise of a force that jumps: where friction turns or a joint opens, twice a cycle and in every stretch of a record, jumps fill the upper
//! band that tells the noise. They are levelled before. Called when a motion is made of a component's record, and for what a comparison of
//! one can reach.

use super::spectral::{noise_of_sensor, noise_of_whole};
use crate::signal::Spectrum;
use std::borrow::Cow;

/// Samples on either side whose line tells where a channel was, and is after.
const SIDE: usize = 4;
/// Weights of those, from the farthest to the nearest, of a line's value two and three samples beyond their middle: `1/4 + u/5 (2 or 3)`.
const NEXT: [f64; SIDE] = [-0.35, 0.05, 0.45, 0.85];
const BEYOND_ONE: [f64; SIDE] = [-0.65, -0.05, 0.55, 1.15];
/// Times what is usual from which on a change is a jump.
const JUMP: f64 = 6.0;
/// Samples to one jump, at least: else what looks like them is how the channel is.
const RARE: usize = 16;

/// Noise of a channel that may jump, rms.
pub(super) fn noise_beside_jumps(x: &[f64], sample_rate_hz: f64) -> f64 {
    noise_of_sensor(&levelled(x), sample_rate_hz)
}

/// The same from all of a channel, where that tells more.
pub fn noise_of_whole_beside_jumps(x: &[f64], sample_rate_hz: f64) -> f64 {
    let level = levelled(x);
    noise_of_whole(&level, &Spectrum::tapered(&level, sample_rate_hz))
}

/// By how much a channel changes between a sample and the next, by the lines through those before and after.
fn change(x: &[f64], i: usize, weights: [f64; SIDE], gap: usize) -> f64 {
    let before: f64 = (0..SIDE).map(|j| weights[j] * x[i - gap + 1 + j - SIDE]).sum();
    let after: f64 = (0..SIDE).map(|j| weights[j] * x[i + gap + SIDE - j]).sum();
    after - before
}

/// Standard deviation of what is normal but for some values that are far off, by the median of the sizes.
pub(super) fn usual_deviation(x: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = x.iter().map(|x| x.abs()).collect();
    let middle = sizes.len() / 2;
    if sizes.is_empty() {
        return 0.0;
    }
    // The median of what is normal is 0.6745 of its deviation.
    *sizes.select_nth_unstable_by(middle, f64::total_cmp).1 / 0.6745
}

/// A channel with its jumps taken out, the two samples beside each laid between their neighbours.
fn levelled(x: &[f64]) -> Cow<'_, [f64]> {
    let ends = SIDE + 1;
    if x.len() < 4 * RARE {
        return Cow::Borrowed(x);
    }
    let places = ends..x.len() - ends - 1;
    let changes: Vec<f64> = places.clone().map(|i| change(x, i, NEXT, 0)).collect();
    let least = JUMP * usual_deviation(&changes);
    let is_most = |k: usize| {
        let around = &changes[k.saturating_sub(SIDE)..(k + SIDE + 1).min(changes.len())];
        changes[k].abs() > least && around.iter().all(|other| other.abs() <= changes[k].abs())
    };
    let jumps: Vec<usize> = (0..changes.len()).filter(|k| is_most(*k)).map(|k| places.start + k).collect();
    if jumps.is_empty() || jumps.len() * RARE > x.len() {
        return Cow::Borrowed(x);
    }
    let mut level = x.to_vec();
    let mut next = jumps.iter().copied().peekable();
    let mut by = 0.0;
    for (i, at) in level.iter_mut().enumerate() {
        *at -= by;
        if next.peek() == Some(&i) {
            next.next();
            by += change(x, i, BEYOND_ONE, 1);
        }
    }
    for i in jumps {
        let (before, after) = (level[i - 1], level[i + 2]);
        level[i] = (2.0 * before + after) / 3.0;
        level[i + 1] = (before + 2.0 * after) / 3.0;
    }
    Cow::Owned(level)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, prelude::Distribution};

    fn seen(at: impl Fn(f64) -> f64, noise: f64) -> Vec<f64> {
        let mut random = rand_pcg::Pcg64::seed_from_u64(8);
        let mut noise = || -> f64 {
            let z: f64 = rand_distr::StandardNormal.sample(&mut random);
            noise * z
        };
        (0..20_000).map(|i| at(f64::from(i) / 200.0) + noise()).collect()
    }

    #[test]
    fn noise_of_a_force_is_told_beside_its_jumps() {
        for noise in [0.03, 0.003, 0.001] {
            // 1.3 Hz with friction; a joint that opens, whose corners stay.
            let friction = |t: f64| (8.2 * t).sin() + 0.4 * (8.2 * t).cos().signum();
            let joint = |t: f64| if (8.2 * t).sin().abs() < 0.3 { 0.0 } else { 1.0 - (8.2 * t).cos() };
            for x in [seen(friction, noise), seen(joint, noise), seen(|t| (8.2 * t).sin(), noise)] {
                let told = noise_beside_jumps(&x, 200.0);
                assert!((0.9..1.2).contains(&(told / noise)), "{noise}: {told}");
                assert!((0.9..1.2).contains(&(noise_of_whole_beside_jumps(&x, 200.0) / noise)), "{noise}");
            }
        }
    }

    #[test]
    fn what_changes_at_every_sample_is_left_as_it_is() {
        let x = seen(|t| (200.0 * t).sin() + (457.0 * t).cos(), 1e-3);
        assert!(matches!(levelled(&x), Cow::Borrowed(_)));
    }
}
