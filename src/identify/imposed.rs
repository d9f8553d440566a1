//! A displacement that is imposed on a component, and its velocity: along ramps, or low-passed where its noise reaches it. Where the velocity has
//! a few corners (another frequency from one cycle to the next, a sudden start) they fill the band: it is taken to end where it does without
//! them, and what lies beside them is not told.

use super::fused::{Fused, cut_rad_s, differentiated, passes};
use super::jumpless::usual_deviation;
use super::ramps;
use crate::record::quality::span;
use crate::signal::Spectrum;
use realfft::num_complex::Complex64;
use std::f64::consts::TAU;
use std::ops::Range;

/// By how much lower another low-pass begins, and how many deviations what hangs on that may be usual.
const LOWER: f64 = 1.5;
const FAR_MORE: f64 = 6.0;
/// Half cycles of where the band ends that a sudden start rings for, at most.
const RINGS: f64 = 16.0;
/// So many times that, the first that leaves but a few samples at corners.
const TIMES: [f64; 6] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0];
/// Largest share of the samples that lies beside corners: more, and that is how the motion is.
const AT_CORNERS: f64 = 0.1;
/// Pieces of a record that are looked at for where the motion usually ends, samples in one at least and pieces at least; bins that are looked
/// at together in one; times the noise's power.
const PIECES: usize = 32;
const LEAST_SAMPLES: usize = 128;
const LEAST_PIECES: usize = 8;
const BINS: usize = 4;
const ABOVE: f64 = 4.0;
/// Velocity over its noise below which its sense is not known, and a place over its own within which it is at rest; samples on each side of one,
/// most of which are as slow where a place is held.
const SLOW: f64 = 3.0;
const HELD: usize = 8;
/// Quarters of a cycle before a clear stop in which it is still so many times as fast as that.
const SUDDEN: (usize, f64) = (2, 10.0);
/// What rings beside a rest is faster than that by so much.
const BESIDE_RESTS: f64 = 3.0;
/// What is left of noise moves a place that is held by less than so many deviations of it.
const WITHIN: f64 = 6.0;
/// Share of the band that has to be gained, and rms over that of noise of what is given up at most.
const WORTH: f64 = 0.75;
const NOISE: f64 = 1.1;

/// A displacement that is imposed, of a noise (m rms a sample).
pub(super) fn imposed(displacement: &[f64], sd: f64, rate: f64) -> Fused {
    let (mut fused, corners) = match ramps::examine(displacement, sd, rate) {
        Some(ramps) => (Fused::of_ramps(ramps), None),
        None => {
            let (fused, corners) = of_band(displacement, sd, rate);
            (fused, Some(corners))
        }
    };
    let rests = still_at_rest(&mut fused, sd, corners.is_none());
    let about = rests.with_about();
    if let Some(away) = corners.and_then(|corners| corners.at_the_ends_of(&about)) {
        fused.velocity_is_told.iter_mut().zip(away).for_each(|(told, away)| *told &= away);
    }
    let slow_m_s = BESIDE_RESTS * SLOW * fused.velocity_noise_m_s;
    for n in about.into_iter().flatten() {
        fused.velocity_is_told[n] &= fused.velocity_m_s[n].abs() > slow_m_s;
    }
    fused.is_held = rests.is_held();
    fused.velocity_is_told.iter_mut().zip(&fused.is_held).for_each(|(told, held)| *told |= held);
    fused
}

/// Where a place is held, those where a motion clearly stopped, and samples of a quarter of a cycle elsewhere.
struct Rests {
    held: Vec<Range<usize>>,
    stopped: Vec<Range<usize>>,
    quarter: usize,
    samples: usize,
}

impl Rests {
    /// With a quarter of a cycle about each.
    fn with_about(&self) -> Vec<Range<usize>> {
        let about = |held: &Range<usize>| {
            held.start.saturating_sub(self.quarter)..(held.end + self.quarter).min(self.samples)
        };
        self.held.iter().map(about).collect()
    }

    /// Whether each sample is held after a clear stop. Where a motion fades below the noise friction still turns.
    fn is_held(&self) -> Vec<bool> {
        let mut is_held = vec![false; self.samples];
        self.stopped.iter().for_each(|held| is_held[held.clone()].fill(true));
        is_held
    }
}

/// Where a place is held there is no velocity. What noise leaves of one is faster than usual by chance, and friction turned there. A motion that
/// turns is slow for less than a quarter of its cycle; along straight lines it never is.
fn still_at_rest(fused: &mut Fused, sd: f64, along_lines: bool) -> Rests {
    let (place_m, velocity_m_s) = (&mut fused.displacement_m, &mut fused.velocity_m_s);
    let stays = |place_m: &[f64]| {
        let (low, high) = span(place_m);
        high - low < WITHIN * sd
    };
    let slow_m_s = SLOW * fused.velocity_noise_m_s;
    let slow: Vec<bool> = velocity_m_s.iter().map(|v| v.abs() < slow_m_s).collect();
    let mostly = mostly(&slow);
    let (samples, last) = (slow.len(), slow.len().saturating_sub(1));
    let (mut moving, mut turns, mut sense) = (0usize, 1usize, 0.0);
    for n in (0..samples).filter(|n| !slow[*n] && !mostly[*n]) {
        moving += 1;
        turns += usize::from(velocity_m_s[n] * sense < 0.0);
        sense = velocity_m_s[n];
    }
    let quarter = if along_lines { HELD } else { (moving / turns / 2).max(HELD) };
    // What is faster by chance for a while, or rings at the ends of the record, goes nowhere.
    let goes_on = |from: usize, to: usize| {
        to.saturating_sub(from) <= quarter && stays(&place_m[from.saturating_sub(1)..(to + 1).min(samples)])
    };
    let (mut from, mut held) = (0, Vec::<Range<usize>>::new());
    for run in mostly.chunk_by(|a, b| a == b) {
        let range = from..from + run.len();
        from = range.end;
        match held.last_mut() {
            _ if !run[0] => {}
            Some(before) if goes_on(before.end, range.start) => before.end = range.end,
            _ => held.push(range),
        }
    }
    // What begins slowly creeps. About its ends a place may ring.
    let inner = |range: &Range<usize>| range.start + range.len() / 4..range.end - range.len() / 4;
    held.retain(|range| range.len() > quarter && stays(&place_m[inner(range)]));
    if let Some(range) = held.first_mut().filter(|range| goes_on(0, range.start)) {
        range.start = 0;
    }
    if let Some(range) = held.last_mut().filter(|range| goes_on(range.end, samples)) {
        range.end = samples;
    }
    for range in &mut held {
        let place = &place_m[inner(range)];
        let mean_m = place.iter().sum::<f64>() / place.len().max(1) as f64;
        // It comes to rest later than its velocity is slow, and nothing of its way is lost.
        let is_there = |n: &usize| (place_m[*n] - mean_m).abs() < SLOW * fused.displacement_noise_m;
        let first = if range.start == 0 { Some(0) } else { range.clone().find(is_there) };
        let last = if range.end == samples { Some(last) } else { range.clone().rfind(is_there) };
        if let (Some(first), Some(last)) = (first, last) {
            *range = first..last + 1;
        }
        // A hysteresis creeps where noise turns it to and fro.
        place_m[range.clone()].fill(mean_m);
        velocity_m_s[range.clone()].fill(0.0);
    }
    let is_sudden = |range: &&Range<usize>| {
        let before = range.start.saturating_sub(SUDDEN.0 * quarter)..range.start;
        velocity_m_s[before].iter().any(|v| v.abs() > SUDDEN.1 * slow_m_s)
    };
    let stopped = held.iter().filter(is_sudden).cloned().collect();
    Rests { held, stopped, quarter, samples }
}

/// Whether most are slow about each sample.
fn mostly(slow: &[bool]) -> Vec<bool> {
    let last = slow.len().saturating_sub(1);
    let mut about = slow.iter().take(HELD).filter(|slow| **slow).count();
    let mut mostly = Vec::with_capacity(slow.len());
    for n in 0..slow.len() {
        about += usize::from(n + HELD <= last && slow[n + HELD]);
        let (from, to) = (n.saturating_sub(HELD), (n + HELD).min(last));
        mostly.push(2 * about > to - from + 1);
        about -= usize::from(n >= HELD && slow[n - HELD]);
    }
    mostly
}

/// Corners of a velocity.
struct Corners {
    /// What of the velocity hangs on where its band ends, m/s, and how much of it is more than usual.
    hangs_m_s: Vec<f64>,
    more_m_s: f64,
    /// Samples of half a cycle there.
    near: f64,
}

impl Corners {
    /// Whether each sample is away from those about rests, where a sudden start or stop rings for long; nothing where there are none, or too many.
    fn at_the_ends_of(mut self, rests: &[Range<usize>]) -> Option<Vec<bool>> {
        if rests.is_empty() {
            return None;
        }
        let rings = (RINGS * self.near).ceil() as usize;
        let mut from = 0;
        for rest in rests {
            self.hangs_m_s[from..rest.start.saturating_sub(rings).max(from)].fill(0.0);
            from = (rest.end + rings).min(self.hangs_m_s.len());
        }
        self.hangs_m_s[from..].fill(0.0);
        // What rings is small where it turns.
        self.away(self.near)
    }

    /// Whether each sample is away from all of them; nothing where they are everywhere.
    fn away(&self, joined: f64) -> Option<Vec<bool>> {
        let told = |size: f64| {
            let told = |aside| away_from(&self.hangs_m_s, size, aside, joined);
            [self.near, 0.0].into_iter().find_map(told)
        };
        TIMES.into_iter().find_map(|times| told(times * self.more_m_s))
    }
}

/// The same where it does not run along ramps, with its corners.
fn of_band(displacement: &[f64], sd: f64, rate: f64) -> (Fused, Corners) {
    let (spectrum, end) = (Spectrum::of(displacement, rate), cut_rad_s(displacement, sd, rate));
    let usual = usual_end_rad_s(displacement, sd, rate);
    let cut = usual
        .filter(|usual| *usual < WORTH * end && loses_nothing(&spectrum, *usual, end, sd))
        .unwrap_or(end);
    let fused = differentiated(&spectrum, cut, sd);
    let (hangs_m_s, _) = between(&spectrum, cut / LOWER, cut, sd);
    let more_m_s = FAR_MORE * usual_deviation(&hangs_m_s);
    let corners = Corners { hangs_m_s, more_m_s, near: 0.5 * TAU / cut * rate };
    let velocity_is_told = corners.away(0.0).unwrap_or_else(|| vec![true; displacement.len()]);
    (Fused { velocity_is_told, ..fused }, corners)
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
    let Some(told) = away_from(&lost, FAR_MORE * noise, aside, 0.0) else { return false };
    let rest = lost.iter().zip(&told).filter(|(_, told)| **told).map(|(lost, _)| lost * lost);
    let (sum, count) = rest.fold((0.0, 0usize), |(sum, count), square| (sum + square, count + 1));
    sum <= (NOISE * noise).powi(2) * count as f64
}

#[cfg(test)]
mod tests {
    use super::super::fused::differentiate;
    use super::*;
    use rand::{SeedableRng, prelude::Distribution};

    #[test]
    fn what_is_fast_by_chance_is_at_rest_where_a_place_is_held_and_moves_elsewhere() {
        let velocity = |n: usize| match n {
            50 | 71 => 0.04,
            30..100 => 0.002,
            _ => 0.3 * (n as f64 / 20.0 * TAU).sin(),
        };
        let seen: Vec<f64> = (0..140).map(velocity).collect();
        // The place is known far better than its change.
        let motion = |place_m: &dyn Fn(usize) -> f64| Fused {
            displacement_m: (0..seen.len()).map(place_m).collect(),
            displacement_noise_m: 1e-4,
            velocity_noise_m_s: 0.02 / SLOW,
            velocity_m_s: seen.clone(),
            ..differentiate(&[0.0; 140], 1e-3, 250.0)
        };
        let mut rests_there = motion(&|n| if (34..96).contains(&n) { 0.0 } else { 1e-2 });
        let rests = still_at_rest(&mut rests_there, 1e-3, false);
        let is_held = rests.is_held();
        assert!((34..96).all(|n| rests_there.velocity_m_s[n] == 0.0 && is_held[n]));
        assert!((0..34).chain(96..140).all(|n| rests_there.velocity_m_s[n] == seen[n] && !is_held[n]));
        let [about] = &rests.with_about()[..] else { panic!("{:?}", rests.held) };
        assert_eq!(*about, 26..104);
        // What fades is at rest, and friction may turn there.
        let mut fades = motion(&|n| if (34..96).contains(&n) { 0.0 } else { 1e-2 });
        fades.velocity_m_s[..30].iter_mut().for_each(|v| *v *= 0.5);
        let rests = still_at_rest(&mut fades, 1e-3, false);
        assert!((34..96).all(|n| fades.velocity_m_s[n] == 0.0) && !rests.is_held().contains(&true));
        // What creeps is not held.
        let mut creeps = motion(&|n| 1e-3 * n as f64);
        assert!(still_at_rest(&mut creeps, 1e-3, false).held.is_empty() && creeps.velocity_m_s == seen);
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
