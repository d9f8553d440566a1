//! Hum of the mains in a channel: a line at 50 Hz or 60 Hz, or a multiple, that is there from the beginning of the record to its end whatever
//! the mass does. Its frequency wanders, so that a long record is taken in parts.

use super::rms_about_mean;
use crate::signal::{Spectrum, fundamental_hz, hann, project};
use realfft::num_complex::Complex64;
use std::f64::consts::TAU;
use std::ops::Range;

/// Frequencies of the mains, Hz; multiples of them that are looked for where they hum, and how far they are off at most, Hz.
const MAINS_HZ: [f64; 2] = [50.0, 60.0];
const MULTIPLES: u32 = 4;
const OFF_HZ: f64 = 0.25;
/// Highest frequency that is looked at, over the sampling rate.
const HIGHEST: f64 = 0.45;
/// Blocks that the band about a line is told by, s, and how many there are in a part of the record at least and at most.
const BLOCK_S: f64 = 0.5;
const FEWEST: usize = 16;
const MOST: usize = 60;
/// Share of the power in the band of a block that is in the line.
const COHERENT: f64 = 0.3;
/// The same in each quarter of a part: amplitude over that of all, and phase from it, rad.
const ALIKE: Range<f64> = 0.6..1.6;
const IN_PHASE_RAD: f64 = 0.7;
/// Amplitude over the rms of the channel from which on it is no hum, and over that of what was imposed: there it is meant. Less of it may
/// hum in all channels alike.
const LOUDEST: f64 = 0.3;
const MEANT: f64 = 0.1;
/// It stands so many times above whatever else there is within such a distance of it, Hz: tests with many lines have others there, and so have
/// their answers.
const STANDS_OUT: f64 = 3.0;
const AROUND_HZ: f64 = 15.0;
/// Share of the power of what was imposed in its largest sine from which on that is a tone.
const A_TONE: f64 = 0.3;
/// Share of the parts that have the line.
const IN_PARTS: f64 = 0.9;

/// A line, part by part.
#[derive(Clone, Debug)]
pub struct Line {
    parts: Vec<Tone>,
}

#[derive(Clone, Debug)]
struct Tone {
    samples: Range<usize>,
    frequency_hz: f64,
    /// Real part of it times exp(i w t), from the first sample of the part on, is the tone.
    phasor: Complex64,
}

impl Line {
    /// Mean frequency, Hz.
    pub fn frequency_hz(&self) -> f64 {
        self.parts.iter().map(|tone| tone.frequency_hz).sum::<f64>() / self.parts.len() as f64
    }

    /// Mean amplitude.
    pub fn amplitude(&self) -> f64 {
        self.parts.iter().map(|tone| tone.phasor.norm()).sum::<f64>() / self.parts.len() as f64
    }

    /// Takes it out of the channel that it was found in.
    pub fn take_out(&self, channel: &mut [f64], rate_hz: f64) {
        for tone in &self.parts {
            let turn = Complex64::from_polar(1.0, TAU * tone.frequency_hz / rate_hz);
            let mut now = tone.phasor;
            for x in &mut channel[tone.samples.clone()] {
                *x -= now.re;
                now *= turn;
            }
        }
    }
}

/// Whether a frequency is so near to one of the mains, or a multiple, that what shows there may be hum.
pub fn may_be_hum(frequency_hz: f64) -> bool {
    let near = |mains_hz: f64| {
        let multiple = (frequency_hz / mains_hz).round();
        multiple > 0.0 && (frequency_hz - multiple * mains_hz).abs() < 2.0 * OFF_HZ
    };
    MAINS_HZ.into_iter().any(near)
}

/// The lines of the mains in a channel; `input` is what was imposed, whose harmonics are no hum.
pub(super) fn find(channel: &[f64], input: &[f64], rate_hz: f64) -> Vec<Line> {
    let loudest = LOUDEST * rms_about_mean(channel);
    lines(rate_hz, |near_hz| {
        let blocks = (channel.len() / (block_of(rate_hz) / 2)).saturating_sub(1);
        let parts = blocks.div_ceil(MOST);
        let length = channel.len() / parts.max(1);
        let bounds = |part: usize| {
            let end = if part + 1 == parts { channel.len() } else { (part + 1) * length };
            part * length..end
        };
        line(parts, |part| {
            let samples = bounds(part);
            let piece = &channel[samples.clone()];
            let tone = tone(&blocks_of(piece, 0, rate_hz, near_hz), samples.clone(), rate_hz, near_hz)?;
            let hums = tone.phasor.norm() < loudest
                && input.get(samples).is_some_and(|input| !is_imposed(tone.frequency_hz, input, rate_hz))
                && stands_out(tone.frequency_hz, piece, rate_hz);
            hums.then_some(tone)
        })
    })
}

/// The same in what a model leaves of pieces of a channel, each with its first sample: what was imposed does not hide it there.
pub fn find_left(pieces: &[(usize, Vec<f64>)], input: &[f64], rate_hz: f64) -> Vec<Line> {
    lines(rate_hz, |near_hz| {
        let of_piece = |(first, left): &(usize, Vec<f64>)| blocks_of(left, *first, rate_hz, near_hz);
        let blocks: Vec<Block> = pieces.iter().flat_map(of_piece).collect();
        let parts = blocks.len().div_ceil(MOST);
        let length = blocks.len().div_ceil(parts.max(1));
        let parts: Vec<&[Block]> = blocks.chunks(length.max(1)).collect();
        // Each goes on to where the next one begins.
        let begins = |part: usize| match parts.get(part) {
            _ if part == 0 => 0,
            Some(blocks) => blocks[0].first,
            None => input.len(),
        };
        line(parts.len(), |part| {
            let samples = begins(part)..begins(part + 1);
            let turned = Complex64::from_polar(1.0, TAU * near_hz / rate_hz * samples.start as f64);
            let since = |block: &Block| Block { first: block.first - samples.start, sum: block.sum * turned };
            let blocks: Vec<Block> = parts[part].iter().map(since).collect();
            let tone = tone(&blocks, samples.clone(), rate_hz, near_hz)?;
            (!is_imposed(tone.frequency_hz, &input[samples], rate_hz)).then_some(tone)
        })
    })
}

/// Lines near the frequencies of the mains and, where there is one, near its multiples.
fn lines(rate_hz: f64, near: impl Fn(f64) -> Option<Line>) -> Vec<Line> {
    let mut out = Vec::new();
    for mains_hz in MAINS_HZ {
        for multiple in 1..=MULTIPLES {
            let near_hz = f64::from(multiple) * mains_hz;
            let line = if near_hz > HIGHEST * rate_hz { None } else { near(near_hz) };
            match line {
                Some(line) => out.push(line),
                None if multiple == 1 => break,
                None => {}
            }
        }
    }
    out
}

/// A line that is in nearly all of so many parts.
fn line(parts: usize, tone_in: impl Fn(usize) -> Option<Tone>) -> Option<Line> {
    let mut without = 0;
    let mut tones = Vec::with_capacity(parts);
    for part in 0..parts {
        match tone_in(part) {
            Some(tone) => tones.push(tone),
            None => without += 1,
        }
        // Most channels have none: a few parts tell.
        if ((parts - without) as f64) < IN_PARTS * parts as f64 {
            return None;
        }
    }
    (!tones.is_empty()).then_some(Line { parts: tones })
}

/// A frequency is in a piece of what was imposed, or a multiple of that of its tone, as well as the piece tells.
fn is_imposed(frequency_hz: f64, input: &[f64], rate_hz: f64) -> bool {
    let count = input.len() as f64;
    let power = input.iter().map(|x| x * x).sum::<f64>() / count;
    let amplitude_at = |hz: f64| project::<1>(input, hz, rate_hz, 0.0)[0].norm();
    // What is imposed may be noise: of white noise next to none shows more.
    if amplitude_at(frequency_hz) > MEANT.max(6.0 / count.sqrt()) * power.sqrt() {
        return true;
    }
    let Some(hz) = fundamental_hz(input, rate_hz) else { return false };
    let off_hz = (frequency_hz / hz).round() * hz - frequency_hz;
    off_hz.abs() * count < rate_hz && 0.5 * amplitude_at(hz).powi(2) > A_TONE * power
}

/// A line stands out of everything about it.
fn stands_out(frequency_hz: f64, x: &[f64], rate_hz: f64) -> bool {
    let spectrum = Spectrum::tapered(x, rate_hz);
    let top = |from_hz: f64, to_hz: f64| {
        let bins = &spectrum.bins[spectrum.band(from_hz.max(0.0), to_hz.min(0.5 * rate_hz))];
        bins.iter().fold(0.0_f64, |top, z| top.max(z.norm()))
    };
    let (near, far) = (2.0 * OFF_HZ, AROUND_HZ);
    let line = top(frequency_hz - near, frequency_hz + near);
    let others =
        top(frequency_hz - far, frequency_hz - near).max(top(frequency_hz + near, frequency_hz + far));
    line > STANDS_OUT * others
}

/// A tapered block of a channel, its first sample, and the sum of its second differences turned back by a frequency from sample 0 on.
#[derive(Clone, Copy, Debug)]
struct Block {
    first: usize,
    sum: Complex64,
}

/// Samples of a block: two hops.
fn block_of(rate_hz: f64) -> usize {
    (BLOCK_S * rate_hz).round() as usize / 2 * 2
}

/// Blocks of a piece of a channel that begins at such a sample, overlapping by half. Second differences keep the motion out of the band; each
/// block is tapered (Hann).
fn blocks_of(x: &[f64], first: usize, rate_hz: f64, near_hz: f64) -> Vec<Block> {
    let block = block_of(rate_hz);
    let turn = Complex64::from_polar(1.0, -TAU * near_hz / rate_hz);
    let taper: Vec<f64> = hann(block).collect();
    let hop = block / 2;
    let count = (x.len().saturating_sub(2) / hop).saturating_sub(1);
    let mut blocks: Vec<Block> =
        (0..count).map(|b| Block { first: first + b * hop, sum: Complex64::ZERO }).collect();
    let mut now = turn * Complex64::from_polar(1.0, -TAU * near_hz / rate_hz * first as f64);
    for (n, w) in x.windows(3).enumerate() {
        let at = now * (w[2] - 2.0 * w[1] + w[0]);
        now *= turn;
        let (of, within) = (n / hop, n % hop);
        if let Some(block) = blocks.get_mut(of) {
            block.sum += at * taper[within];
        }
        if of > 0
            && let Some(block) = blocks.get_mut(of - 1)
        {
            block.sum += at * taper[within + hop];
        }
    }
    blocks
}

/// The tone near a frequency in the blocks of a part, which begins at its first sample, if it is there throughout.
fn tone(blocks: &[Block], samples: Range<usize>, rate_hz: f64, near_hz: f64) -> Option<Tone> {
    let count = blocks.len();
    if count < FEWEST {
        return None;
    }
    let block = block_of(rate_hz);
    let centre_s = |of: &Block| (of.first + block / 2) as f64 / rate_hz;
    let turned = |off_hz: f64, blocks: &[Block]| -> Complex64 {
        let back = |of: &Block| Complex64::from_polar(1.0, -TAU * off_hz * centre_s(of));
        blocks.iter().map(|of| of.sum * back(of)).sum()
    };
    let seconds = samples.len() as f64 / rate_hz;
    let best_of = |middle_hz: f64, wide_hz: f64, step_hz: f64| {
        let steps = (wide_hz / step_hz).ceil() as i32;
        let offs = (-steps..=steps).map(|i| middle_hz + f64::from(i) * step_hz);
        offs.max_by(|a, b| turned(*a, blocks).norm().total_cmp(&turned(*b, blocks).norm()))
    };
    let coarse_hz = best_of(0.0, OFF_HZ, 0.25 / seconds)?;
    let off_hz = best_of(coarse_hz, 0.25 / seconds, 0.02 / seconds)?;
    let all = turned(off_hz, blocks);
    let power: f64 = blocks.iter().map(|of| of.sum.norm_sqr()).sum();
    if all.norm_sqr() < COHERENT * power * count as f64 || power == 0.0 {
        return None;
    }
    let throughout = (0..4).all(|quarter| {
        let of = turned(off_hz, &blocks[quarter * count / 4..(quarter + 1) * count / 4]) * 4.0 / all;
        ALIKE.contains(&of.norm()) && of.arg().abs() < IN_PHASE_RAD
    });
    let frequency_hz = near_hz + off_hz;
    // Of a tone c exp(i w t) the second difference is -4 sin2(w/2) of it; half of a cosine turns this way.
    let gain = -4.0 * (0.5 * TAU * frequency_hz / rate_hz).sin().powi(2);
    let weight = 0.5 * hann(block).sum::<f64>() * count as f64;
    throughout.then(|| Tone { samples, frequency_hz, phasor: all / (gain * weight) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, prelude::Distribution};

    const RATE_HZ: f64 = 400.0;

    fn noise(count: usize, rms: f64) -> Vec<f64> {
        let mut random = rand_pcg::Pcg64::seed_from_u64(3);
        let normal = rand_distr::Normal::new(0.0, rms).expect("valid");
        (0..count).map(|_| normal.sample(&mut random)).collect()
    }

    fn sine(hz: f64, amplitude: f64) -> impl Fn(usize) -> f64 {
        move |n| amplitude * (TAU * hz * n as f64 / RATE_HZ + 1.0).sin()
    }

    fn seen(count: usize, of: impl Fn(usize) -> f64) -> Vec<f64> {
        noise(count, 3e-3).into_iter().enumerate().map(|(n, noise)| noise + of(n)).collect()
    }

    #[test]
    fn hum_beside_a_motion_is_found_and_taken_out() {
        let (motion, hum) = (sine(2.37, 1.0), sine(50.03, 4e-3));
        let input: Vec<f64> = (0..16_000).map(&motion).collect();
        let clean = seen(16_000, &motion);
        let mut spoilt: Vec<f64> = clean.iter().enumerate().map(|(n, x)| x + hum(n)).collect();
        let lines = find(&spoilt, &input, RATE_HZ);
        assert_eq!(lines.len(), 1);
        assert!(
            (lines[0].frequency_hz() - 50.03).abs() < 5e-3
                && (lines[0].amplitude() / 4e-3 - 1.0).abs() < 0.05
        );
        lines[0].take_out(&mut spoilt, RATE_HZ);
        let left = clean.iter().zip(&spoilt).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / 16_000.0;
        assert!(left.sqrt() < 2e-4, "{}", left.sqrt());
        assert!(find(&clean, &input, RATE_HZ).is_empty());
    }

    #[test]
    fn hum_of_every_channel_is_taken_out_of_what_was_imposed_too() {
        let with_hum: Vec<f64> = (0..16_000).map(|n| sine(2.37, 1.0)(n) + sine(50.0, 0.05)(n)).collect();
        let channel = seen(16_000, |n| with_hum[n]);
        for of in [&channel, &with_hum] {
            let lines = find(of, &with_hum, RATE_HZ);
            assert_eq!(lines.len(), 1);
            assert!((lines[0].amplitude() / 0.05 - 1.0).abs() < 0.02, "{}", lines[0].amplitude());
        }
    }

    #[test]
    fn hum_that_wanders_is_followed() {
        let mut phase = 0.0;
        let hum: Vec<f64> = (0..120_000)
            .map(|n| {
                phase += TAU / RATE_HZ * (50.0 + 0.02 * (TAU * n as f64 / 60_000.0).sin());
                0.02 * phase.cos()
            })
            .collect();
        let mut channel = seen(120_000, |n| hum[n]);
        let input = noise(120_000, 1.0);
        // All of it is hum: louder than it may be beside a motion.
        assert!(find(&channel, &input, RATE_HZ).is_empty());
        channel.iter_mut().enumerate().for_each(|(n, x)| *x += sine(3.1, 1.0)(n));
        let lines = find(&channel, &input, RATE_HZ);
        assert_eq!(lines.len(), 1);
        lines[0].take_out(&mut channel, RATE_HZ);
        let left =
            channel.iter().enumerate().map(|(n, x)| (x - sine(3.1, 1.0)(n)).powi(2)).sum::<f64>() / 120_000.0;
        assert!(left.sqrt() < 4.5e-3, "{}", left.sqrt());
    }

    #[test]
    fn hum_in_what_a_model_leaves_is_found_beside_gaps() {
        let hum = sine(50.03, 4e-3);
        let left = seen(40_000, &hum);
        // What was imposed passes the frequency, and is left out where it does not count.
        let input: Vec<f64> = noise(40_000, 1.0);
        let pieces: Vec<(usize, Vec<f64>)> = (0..20)
            .filter(|k| k % 7 != 3)
            .map(|k| (500 + k * 1950, left[500 + k * 1950..500 + (k + 1) * 1950].to_vec()))
            .collect();
        let lines = find_left(&pieces, &input, RATE_HZ);
        assert!(lines.len() == 1 && lines[0].parts.len() > 2, "{lines:?}");
        let mut without = left;
        lines[0].take_out(&mut without, RATE_HZ);
        let rms = rms_about_mean(&without);
        assert!((rms / 3e-3 - 1.0).abs() < 0.02, "{rms}");
        let none: Vec<(usize, Vec<f64>)> =
            pieces.iter().map(|(first, x)| (*first, noise(x.len(), 3e-3))).collect();
        assert!(find_left(&none, &input, RATE_HZ).is_empty());
        assert!(find_left(&[(0, Vec::new())], &input, RATE_HZ).is_empty());
    }

    #[test]
    fn a_line_among_the_many_of_a_test_is_none() {
        // Lines of 1 Hz are imposed but for every fourth; a spring that bends answers there, too.
        let line = |k: usize, n: usize| sine(k as f64 + 0.01, 0.1)(n + 37 * k);
        let input: Vec<f64> =
            (0..16_000).map(|n| (1..90).filter(|k| k % 4 != 2).map(|k| line(k, n)).sum()).collect();
        assert!(input.iter().all(|x| x.is_finite()));
        let answer = seen(16_000, |n| input[n] + (2..90).step_by(4).map(|k| 0.1 * line(k, n)).sum::<f64>());
        assert!(find(&answer, &input, RATE_HZ).is_empty());
        // Nor is the one that is imposed beside a slow tone.
        let two: Vec<f64> = (0..16_000).map(|n| sine(2.37, 1.0)(n) + sine(50.0, 0.1)(n)).collect();
        assert!(find(&seen(16_000, |n| two[n]), &two, RATE_HZ).is_empty());
    }

    #[test]
    fn what_is_near_a_multiple_of_the_mains_may_be_hum() {
        assert!([50.2, 59.8, 149.6, 180.0].into_iter().all(may_be_hum));
        assert!(![0.1, 2.5, 49.0, 84.0, 110.0].into_iter().any(may_be_hum));
    }

    #[test]
    fn harmonics_of_what_is_imposed_and_what_lasts_for_a_while_are_none() {
        let input: Vec<f64> = (0..16_000).map(sine(2.5, 1.0)).collect();
        let driven = seen(16_000, |n| sine(2.5, 1.0)(n) + sine(50.0, 0.02)(n));
        assert!(find(&driven, &input, RATE_HZ).is_empty());
        let other: Vec<f64> = (0..16_000).map(sine(2.37, 1.0)).collect();
        let a_while = seen(16_000, |n| sine(2.37, 1.0)(n) + if n < 9000 { sine(50.0, 0.02)(n) } else { 0.0 });
        assert!(find(&a_while, &other, RATE_HZ).is_empty());
    }
}
