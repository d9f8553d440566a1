//! Samples that stand alone: a word lost on the line, a laser that saw dust. The mass does not go there and back within a few samples: its
//! displacement is smooth, and what its acceleration shows in such a time has to show as a bend of the displacement.

use super::{Record, Role};
use crate::record::quality::{deviation_by_median, of_rounding, one_of};
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// Fourth difference of a sample beyond which it may stand alone, in units of what is usual; what may be left beside it once it is out, in
/// those units and over what it was.
const OUT: f64 = 25.0;
const USUAL: f64 = 5.0;
const GONE: f64 = 0.1;
/// Samples that stand alone together at most.
const WIDEST: usize = 3;
/// Samples on each side that tell what is usual there.
const AROUND: usize = 100;
/// One of so many samples may stand alone, but a few in any record; more are no faults of single samples.
const ONE_OF: usize = 1000;
const A_FEW: usize = 3;
/// Samples on each side of a bend of the displacement that tell its angle, shorter ones first.
const BESIDE: [usize; 3] = [12, 40, 120];
/// How well a bend has to be known to tell a pulse of the acceleration from a fault, and share of it that must be missing; both over what
/// the pulse would make.
const KNOWN: f64 = 0.15;
const MISSING: f64 = 0.5;

/// Samples that stand alone.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Spike {
    /// The first of them.
    pub(super) first: usize,
    /// What runs through those beside, in place of them.
    instead: Vec<f64>,
}

impl Spike {
    pub(super) fn take_out(&self, channel: &mut [f64]) {
        channel[self.range()].copy_from_slice(&self.instead);
    }

    fn range(&self) -> Range<usize> {
        self.first..self.first + self.instead.len()
    }
}

/// The spikes of a channel that cannot be motion.
pub(super) fn find(record: &Record, role: Role) -> Vec<Spike> {
    let channel = record.channel(role);
    let spikes = standing_alone(channel);
    if spikes.len() > A_FEW.max(channel.len() / ONE_OF) {
        return Vec::new();
    }
    let moves: &[f64] = match role {
        Role::RelativeDisplacement | Role::Displacement | Role::TableDisplacement => return spikes,
        Role::MassAcceleration1 | Role::MassAcceleration2 => &record.relative_displacement_m,
        Role::TableAcceleration => &record.table_displacement_m,
        Role::Acceleration => &record.displacement_m,
        // A force may well be a blow.
        Role::Force | Role::Time | Role::Step => return Vec::new(),
    };
    if moves.len() != channel.len() || spikes.is_empty() {
        return Vec::new();
    }
    let moves = without(moves, &standing_alone(moves));
    let noise_m = deviation_by_median(fourths(&moves).into_iter()) / 70f64.sqrt();
    let mass = matches!(role, Role::MassAcceleration1 | Role::MassAcceleration2);
    let table = if mass { record.table_acceleration_m_s2.as_slice() } else { &[] };
    spikes
        .into_iter()
        .filter(|spike| {
            let smooth = without(channel, std::slice::from_ref(spike));
            let relative = |n: usize| smooth[n] - table.get(n).copied().unwrap_or(0.0);
            let pulse: f64 = spike.range().map(|n| channel[n] - smooth[n]).sum();
            let bend = bend(&moves, relative, spike.range(), record.sample_rate_hz, noise_m);
            bend.is_some_and(|(bend, sigma)| {
                let would = pulse / record.sample_rate_hz;
                sigma < KNOWN * would.abs() && (bend / would).abs() < MISSING
            })
        })
        .collect()
}

fn without(channel: &[f64], spikes: &[Spike]) -> Vec<f64> {
    let mut out = channel.to_vec();
    spikes.iter().for_each(|spike| spike.take_out(&mut out));
    out
}

/// Fourth differences at each sample but two at the ends.
fn fourths(x: &[f64]) -> Vec<f64> {
    x.windows(5).map(|w| w[0] - 4.0 * w[1] + 6.0 * w[2] - 4.0 * w[3] + w[4]).collect()
}

/// Samples far from what runs through those beside them, where those fit together.
fn standing_alone(x: &[f64]) -> Vec<Spike> {
    let differences = fourths(x);
    let usual = deviation_by_median(differences.iter().copied().step_by(one_of(differences.len())));
    // Of a channel that is told in whole counts nothing but those is seen at rest.
    let usual = usual.max(of_rounding(x) * 70f64.sqrt());
    let mut out: Vec<Spike> = Vec::new();
    if usual == 0.0 || !usual.is_finite() {
        return out;
    }
    let mut n = 0;
    while n < differences.len() {
        if differences[n].abs() <= OUT * usual {
            n += 1;
            continue;
        }
        // The largest of those nearby is in the midst of it.
        let near = n..(n + 2 * WIDEST).min(differences.len());
        let top = near.clone().max_by(|a, b| differences[*a].abs().total_cmp(&differences[*b].abs()));
        let alone = top.and_then(|top| alone(x, &differences, usual, top + 2));
        n = near.end.max(alone.as_ref().map_or(0, |spike| spike.range().end + 2));
        out.extend(alone);
    }
    out
}

/// The fewest samples about one without which the rest runs on.
fn alone(x: &[f64], differences: &[f64], usual: f64, about: usize) -> Option<Spike> {
    let around = (about.saturating_sub(AROUND)..(about + AROUND).min(differences.len()))
        .filter(|n| n.abs_diff(about) > 2 * WIDEST)
        .map(|n| differences[n]);
    let usual = usual.max(deviation_by_median(around));
    let tried = (1..=WIDEST).flat_map(|width| (0..width).map(move |before| (width, before)));
    tried.into_iter().find_map(|(width, before)| {
        let first = about.checked_sub(before)?;
        let spike = bridged(x, first, width)?;
        // Differences that any of the samples is in.
        let touched = first.checked_sub(4)?..(first + width).min(differences.len());
        let was = differences[touched.clone()].iter().fold(0.0_f64, |top, e| top.max(e.abs()));
        let mut patch = x.get(touched.start..touched.end + 4)?.to_vec();
        patch[4..4 + width].copy_from_slice(&spike.instead);
        let is = fourths(&patch).iter().fold(0.0_f64, |top, e| top.max(e.abs()));
        (was > OUT * usual && is < (USUAL * usual).min(GONE * was)).then_some(spike)
    })
}

/// So many samples from one on, replaced by the cubic through two on each side (Lagrange's interpolation).
fn bridged(x: &[f64], first: usize, width: usize) -> Option<Spike> {
    let knots = [first.checked_sub(2)?, first - 1, first + width, first + width + 1];
    if knots[3] >= x.len() {
        return None;
    }
    let at = |n: usize| -> f64 {
        let weight = |i: usize| -> f64 {
            let others = (0..4).filter(|j| *j != i);
            others.map(|j| (n as f64 - knots[j] as f64) / (knots[i] as f64 - knots[j] as f64)).product()
        };
        (0..4).map(|i| weight(i) * x[knots[i]]).sum()
    };
    Some(Spike { first, instead: (first..first + width).map(at).collect() })
}

/// By how much the displacement bends where a pulse of the acceleration was taken out, beside what the rest of the acceleration makes: a
/// change of velocity (m/s) with its standard deviation.
fn bend(
    moves_m: &[f64],
    acceleration_m_s2: impl Fn(usize) -> f64,
    at: Range<usize>,
    rate_hz: f64,
    noise_m: f64,
) -> Option<(f64, f64)> {
    let mut best = None;
    for beside in BESIDE {
        let range = at.start.checked_sub(beside)?..(at.end + beside).min(moves_m.len());
        let (mut x, mut v) = (0.0, 0.0);
        let middle = 0.5 * (at.start + at.end - 1) as f64;
        let mut left = Vec::with_capacity(range.len());
        let mut columns = Vec::with_capacity(4 * range.len());
        for n in range.clone() {
            let t = (n as f64 - middle) / rate_hz;
            left.push(moves_m[n] - x);
            columns.extend([1.0, t, t * t, t.max(0.0)]);
            let (here, next) =
                (acceleration_m_s2(n), if n + 1 < range.end { acceleration_m_s2(n + 1) } else { 0.0 });
            x += v / rate_hz + (here / 3.0 + next / 6.0) / rate_hz.powi(2);
            v += 0.5 * (here + next) / rate_hz;
        }
        let design = DMatrix::from_row_slice(range.len(), 4, &columns);
        let inverse = (design.transpose() * &design).try_inverse()?;
        let found = &inverse * (design.transpose() * DVector::from_vec(left.clone()));
        let rest = DVector::from_vec(left) - &design * &found;
        let noise = (rest.norm_squared() / (range.len() - 4) as f64).sqrt().max(noise_m);
        let sigma = noise * inverse[(3, 3)].max(0.0).sqrt();
        if best.is_none_or(|(_, least)| sigma < least) {
            best = Some((found[3], sigma));
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Kind;
    use rand::{SeedableRng, prelude::Distribution};
    use std::f64::consts::TAU;

    const RATE_HZ: f64 = 400.0;

    /// A mass that swings at 2 Hz, with a blow of one sample on it that changes its velocity, or without.
    fn swinging(blow_m_s2: f64) -> Record {
        let mut random = rand_pcg::Pcg64::seed_from_u64(3);
        let mut noise = |rms: f64| -> f64 {
            let z: f64 = rand_distr::StandardNormal.sample(&mut random);
            rms * z
        };
        let mut record = Record::empty("it", Kind::Force, RATE_HZ);
        for i in 0..4000 {
            let t = f64::from(i) / RATE_HZ;
            let wave = 0.01 * (TAU * 2.0 * t).sin();
            let after = (t - 5.0).max(0.0);
            record.time_s.push(t);
            record.force_n.push(0.0);
            record.displacement_m.push(wave + blow_m_s2 / RATE_HZ * after + noise(2e-5));
            let blow = if i == 2000 { blow_m_s2 } else { 0.0 };
            record.acceleration_m_s2.push(blow - (TAU * 2.0_f64).powi(2) * wave + noise(5e-3));
        }
        record
    }

    #[test]
    fn samples_of_the_displacement_that_stand_alone_are_found() {
        let clean = swinging(0.0);
        let mut spoilt = clean.clone();
        spoilt.displacement_m[1000] += 0.02;
        spoilt.displacement_m[1700..1703].iter_mut().for_each(|x| *x -= 0.01);
        let found = find(&spoilt, Role::Displacement);
        let ranges: Vec<_> = found.iter().map(Spike::range).collect();
        assert_eq!(ranges, [1000..1001, 1700..1703]);
        let mended = without(&spoilt.displacement_m, &found);
        for n in [1000, 1700, 1701, 1702] {
            assert!((mended[n] - clean.displacement_m[n]).abs() < 2e-4, "{n}");
        }
        assert!(find(&clean, Role::Displacement).is_empty());
    }

    #[test]
    fn a_pulse_of_the_acceleration_is_a_fault_where_the_displacement_does_not_bend() {
        let mut spoilt = swinging(0.0);
        spoilt.acceleration_m_s2[2000] += 20.0;
        assert_eq!(find(&spoilt, Role::Acceleration).len(), 1);
        // A blow changes the velocity.
        assert!(find(&swinging(20.0), Role::Acceleration).is_empty());
        // Nothing tells which it is.
        spoilt.displacement_m.clear();
        assert!(find(&spoilt, Role::Acceleration).is_empty());
    }

    #[test]
    fn counts_of_a_place_that_is_held_are_none() {
        // Told to a micrometre: a count to and fro between long rests, and a word that was lost.
        let mut record = swinging(0.0);
        let flickers = |i: &usize| (2000..2200).contains(i) && i.is_multiple_of(3);
        let place = |i: usize| if i % 97 == 5 || flickers(&i) { 4e-6 } else { 3e-6 };
        record.displacement_m = (0..4000).map(place).collect();
        assert!(find(&record, Role::Displacement).is_empty());
        record.displacement_m[1000] = 1e-3;
        assert_eq!(find(&record, Role::Displacement).len(), 1);
    }

    #[test]
    fn steps_and_bends_are_none() {
        let mut record = swinging(0.0);
        record.displacement_m[1500..].iter_mut().for_each(|x| *x += 0.01);
        for (i, x) in record.displacement_m.iter_mut().enumerate().skip(2500) {
            *x += 0.01 * (i - 2500) as f64;
        }
        assert!(find(&record, Role::Displacement).is_empty());
    }
}
