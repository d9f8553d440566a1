//! A displacement that is imposed on a component, and its velocity: along ramps, or low-passed where its noise reaches it. Where the velocity has
//! a few corners (another frequency from one cycle to the next, a sudden start) they fill the band: it is taken to end where it does without
//! them, and what lies beside them is not told.

use super::fused::{Fused, cut_rad_s, differentiated, passes};
use super::jumpless::usual_deviation;
use super::ramps;
use crate::signal::Spectrum;
use realfft::num_complex::Complex64;
use std::f64::consts::TAU;

/// By how much lower another low-pass begins, and how many deviations what hangs on that may be usual: the first of these that leaves but a
/// few corners, about which the velocity rings.
const LOWER: f64 = 1.5;
const FAR_MORE: [f64; 4] = [6.0, 12.0, 24.0, 48.0];
/// Largest share of the samples that lies beside corners: more, and that is how the motion is.
const AT_CORNERS: f64 = 0.1;
/// Pieces of a record that are looked at for where the motion usually ends, samples in one at least and pieces at least; bins that are looked
/// at together in one; times the noise's power.
const PIECES: usize = 32;
const LEAST_SAMPLES: usize = 128;
const LEAST_PIECES: usize = 8;
const BINS: usize = 4;
const ABOVE: f64 = 4.0;
/// Velocity over its noise below which its sense is not known; samples on each side of one, most of which are as slow where a place is held.
const SLOW: f64 = 3.0;
const HELD: usize = 8;
/// Share of the band that has to be gained, and rms over that of noise of what is given up at most.
const WORTH: f64 = 0.75;
const NOISE: f64 = 1.1;

/// A displacement that is imposed, of a noise (m rms a sample).
pub(super) fn imposed(displacement: &[f64], sd: f64, rate: f64) -> Fused {
    let mut fused = match ramps::examine(displacement, sd, rate) {
        Some(ramps) => Fused::of_ramps(ramps),
        None => of_band(displacement, sd, rate),
    };
    still_at_rest(&mut fused.velocity_m_s, SLOW * fused.velocity_noise_m_s);
    fused
}

/// Where a place is held there is no velocity. What noise leaves of one is faster than usual by chance, and friction turned there.
fn still_at_rest(velocity_m_s: &mut [f64], slow_m_s: f64) {
    let slow: Vec<bool> = velocity_m_s.iter().map(|v| v.abs() < slow_m_s).collect();
    let last = slow.len().saturating_sub(1);
    let mut about = slow.iter().take(HELD).filter(|slow| **slow).count();
    for (n, v) in velocity_m_s.iter_mut().enumerate() {
        about += usize::from(n + HELD <= last && slow[n + HELD]);
        let (from, to) = (n.saturating_sub(HELD), (n + HELD).min(last));
        if 2 * about > to - from + 1 {
            *v = 0.0;
        }
        about -= usize::from(n >= HELD && slow[n - HELD]);
    }
}

/// The same where it does not run along ramps.
fn of_band(displacement: &[f64], sd: f64, rate: f64) -> Fused {
    let (spectrum, end) = (Spectrum::of(displacement, rate), cut_rad_s(displacement, sd, rate));
    let usual = usual_end_rad_s(displacement, sd, rate);
    let cut = usual
        .filter(|usual| *usual < WORTH * end && loses_nothing(&spectrum, *usual, end, sd))
        .unwrap_or(end);
    let fused = differentiated(&spectrum, cut, sd);
    let (hangs, _) = between(&spectrum, cut / LOWER, cut, sd);
    let (usual, near) = (usual_deviation(&hangs), 0.5 * TAU / cut * rate);
    // What rings is small where it turns.
    let told =
        |more: &f64| [near, 0.0].into_iter().find_map(|aside| away_from(&hangs, more * usual, aside, near));
    let velocity_is_told = FAR_MORE.iter().find_map(told);
    let velocity_is_told = velocity_is_told.unwrap_or_else(|| vec![true; hangs.len()]);
    Fused { velocity_is_told, ..fused }
}

/// Whether each sample is away from those beyond a size by so many samples, and not between two that are no farther apart than `joined`; nothing
/// where not most are.
fn away_from(x: &[f64], size: f64, samples: f64, joined: f64) -> Option<Vec<bool>> {
    let most = AT_CORNERS * x.len() as f64;
    let beyond: Vec<usize> = (0..x.len()).filter(|n| x[*n].abs() > size).collect();
    if beyond.len() as f64 > most {
        return None;
    }
    let (mut away, aside) = (vec![true; x.len()], samples.ceil() as usize);
    let mut before = None;
    for n in beyond {
        let joins = before.filter(|before| (n - before) as f64 <= joined);
        let from = joins.unwrap_or(n).min(n.saturating_sub(aside));
        away[from..(n + aside + 1).min(x.len())].fill(false);
        before = Some(n);
    }
    (away.iter().filter(|away| !**away).count() as f64 <= most).then_some(away)
}

/// What of the velocity lies between two low-passes, m/s, and what noise alone puts there, m/s rms.
fn between(spectrum: &Spectrum, low: f64, high: f64, sd: f64) -> (Vec<f64>, f64) {
    let apart = |w: f64| w * (passes(w, high) - passes(w, low));
    let bins = spectrum.bins.len();
    let noise: f64 = (0..bins).map(|bin| apart(spectrum.omega_rad_s(bin)).powi(2)).sum();
    let channel = spectrum.clone().multiply(|w| Complex64::new(0.0, apart(w))).channel();
    (channel, sd * (noise / bins.max(1) as f64).sqrt())
}

/// Where the motion ends in most pieces of a record, rad/s; nothing where it is too short.
fn usual_end_rad_s(displacement: &[f64], sd: f64, rate: f64) -> Option<f64> {
    let samples = (2 * displacement.len() / (PIECES + 1)).max(LEAST_SAMPLES) / 2 * 2;
    let pieces = (2 * displacement.len() / samples).saturating_sub(1);
    if pieces < LEAST_PIECES {
        return None;
    }
    let spectra: Vec<Spectrum> = (0..pieces)
        .map(|k| Spectrum::tapered(&displacement[k * samples / 2..k * samples / 2 + samples], rate))
        .collect();
    let first = spectra.first()?;
    let floor = ABOVE * BINS as f64 * first.white_noise_power(sd);
    let usually_above = |chunk: &usize| {
        let power =
            |s: &Spectrum| s.bins.iter().skip(chunk * BINS).take(BINS).map(|z| z.norm_sqr()).sum::<f64>();
        spectra.iter().filter(|spectrum| power(spectrum) > floor).count() * 2 > pieces
    };
    let last = (0..first.bins.len() / BINS).rfind(usually_above)?;
    Some(first.omega_rad_s((last + 1) * BINS))
}

/// Whether what of the velocity is given up with a lower low-pass is noise but for a few places and what is beside them.
fn loses_nothing(spectrum: &Spectrum, usual: f64, end: f64, sd: f64) -> bool {
    let (lost, noise) = between(spectrum, usual, end, sd);
    let aside = TAU / usual * spectrum.sample_rate_hz();
    let Some(told) = away_from(&lost, FAR_MORE[0] * noise, aside, aside) else { return false };
    let rest = lost.iter().zip(&told).filter(|(_, told)| **told).map(|(lost, _)| lost * lost);
    let (sum, count) = rest.fold((0.0, 0usize), |(sum, count), square| (sum + square, count + 1));
    sum <= (NOISE * noise).powi(2) * count as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, prelude::Distribution};

    #[test]
    fn what_is_fast_by_chance_is_at_rest_where_a_place_is_held_and_moves_elsewhere() {
        let velocity = |n: usize| match n {
            50 | 71 => 0.04,
            30..100 => 0.002,
            _ => 0.1 * (n as f64 / 20.0 * TAU).sin(),
        };
        let seen: Vec<f64> = (0..140).map(velocity).collect();
        let mut told = seen.clone();
        still_at_rest(&mut told, 0.02);
        assert!((40..90).all(|n| told[n] == 0.0));
        assert!((0..24).chain(106..140).all(|n| told[n] == seen[n]), "{told:?}");
        for short in [vec![], vec![0.1]] {
            let mut told = short.clone();
            still_at_rest(&mut told, 0.02);
            assert_eq!(told, short);
        }
    }

    /// Cycles of one frequency and then another, at 250 Hz, with their velocity.
    fn cycles(hz: [f64; 2], noise: f64) -> (Vec<f64>, Vec<f64>) {
        let mut random = rand_pcg::Pcg64::seed_from_u64(4);
        let mut phase = 0.0_f64;
        (0..8000)
            .map(|i| {
                let z: f64 = rand_distr::StandardNormal.sample(&mut random);
                let w = TAU * hz[i / 4000];
                let at = (phase.sin() + noise * z, w * phase.cos());
                phase += w / 250.0;
                at
            })
            .unzip()
    }

    #[test]
    fn a_corner_of_the_velocity_is_not_told_and_what_is_beside_it_is_told_as_well_as_without_it() {
        let noise = 5e-4;
        let (with, velocity) = cycles([0.9, 1.7], noise);
        let [jumps, smooth] = [&with, &cycles([0.9, 0.9], noise).0].map(|x| imposed(x, noise, 250.0));
        assert!(jumps.velocity_noise_m_s < 2.0 * smooth.velocity_noise_m_s, "{}", jumps.velocity_noise_m_s);
        let told = |fused: &Fused| fused.velocity_is_told.iter().filter(|told| **told).count();
        assert!((7700..8000).contains(&told(&jumps)) && told(&smooth) > 7900, "{}", told(&jumps));
        assert!(!jumps.velocity_is_told[4000]);
        for n in (100..7900).filter(|n| jumps.velocity_is_told[*n]) {
            let off = (jumps.velocity_m_s[n] - velocity[n]).abs();
            // A fiftieth of the jump.
            assert!(off < 0.02 * 0.8 * TAU, "{n}: {off}");
        }
    }
}
