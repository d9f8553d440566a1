//! How fast a record moves, for models that hold only up to a frequency: a springpot is carried by a few states, and a solver's steps
//! are the shorter the faster these are. Whoever fits or compares a model has it hold for the record first.

use crate::model::{EffectSpec, ModelSpec};
use crate::record::{Kind, Record};
use crate::signal::Spectrum;
use realfft::num_complex::Complex64;
use std::borrow::Cow;
use std::f64::consts::TAU;

/// A record moves faster than what a springpot's usual states hold for from this share of its sampling rate on, and so much of what moves
/// a springpot is below the frequency that is told: power of the displacement, times frequency.
const SLOW: f64 = 0.0025;
const NEARLY_ALL: f64 = 0.98;
/// Samples that are looked at, in the middle.
const PIECE: usize = 1 << 17;

/// Frequency up to which a record of another rig moves, Hz; 0 where every model holds so far at its rate, and of a base record.
pub(super) fn fastest_hz(record: &Record) -> f64 {
    let (channel, is_acceleration) = match record.kind {
        Kind::Base => return 0.0,
        _ if !record.displacement_m.is_empty() => (&record.displacement_m, false),
        _ => (&record.acceleration_m_s2, true),
    };
    let from = channel.len().saturating_sub(PIECE) / 2;
    let piece = &channel[from..(from + PIECE).min(channel.len())];
    let spectrum = Spectrum::tapered(piece, record.sample_rate_hz);
    let moves = |(bin, x): (usize, &Complex64)| {
        let w = spectrum.omega_rad_s(bin);
        x.norm_sqr() * if is_acceleration { w.powi(-3) } else { w }
    };
    // Below a few cycles of the piece there is nothing but its drift.
    let powers: Vec<f64> = spectrum.bins.iter().enumerate().skip(4).map(moves).collect();
    let all: f64 = powers.iter().sum();
    let mut below = 0.0;
    let last = powers.iter().position(|power| {
        below += power;
        below > NEARLY_ALL * all
    });
    let hz = last.map_or(0.0, |bin| spectrum.omega_rad_s(bin + 4) / TAU);
    if hz > SLOW * record.sample_rate_hz { hz } else { 0.0 }
}

/// A model whose springpots hold for motions as fast as the fastest of some records, where it does not say itself how fast they are.
pub fn holding<'m, 'r>(
    spec: &'m ModelSpec,
    records: impl IntoIterator<Item = &'r Record>,
) -> Cow<'m, ModelSpec> {
    let mut held = Cow::Borrowed(spec);
    // Of a model without them nothing is asked of the records.
    if spec.effects.iter().any(EffectSpec::is_springpot) {
        let fastest_hz = records.into_iter().map(fastest_hz).fold(0.0, f64::max);
        held.to_mut().effects.iter_mut().for_each(|effect| effect.hold_up_to(fastest_hz));
    }
    held
}
