//! Records that were low-passed after they were sampled: what noise they have is no longer white, and next to nothing is left of it above
//! the filter, so that whatever a model leaves would stand out of it. Such a record is told again at the rate that its band needs.
//! Called before a motion is made of a record that a model is to be fitted to.

use super::coherence::shared;
use crate::record::quality::of_rounding;
use crate::record::{Kind, Record};
use crate::signal::Spectrum;
use std::borrow::Cow;

/// Parts of the band whose levels are compared.
const PARTS: usize = 64;
/// So many in a row, within such a factor of one another, are noise that a filter let through; it stands so many times above what it left
/// of the top of the band.
const LEVEL_PARTS: usize = 8;
const LEVEL: f64 = 2.0;
const LEFT: f64 = 30.0;
/// Coherence of what is level with what drives the mass from which on it is no noise.
const DRIVEN: f64 = 0.5;
/// Part of the band above which a filter takes too little to matter.
const HIGHEST: f64 = 0.75;

/// A record at the rate that its band needs, with a note, where a filter emptied the top of it in all channels of what answers; the record
/// itself otherwise, and one of a component, whose force may be as steep as it likes.
pub(super) fn at_its_rate(record: &Record) -> Cow<'_, Record> {
    match filtered_above_hz(record).and_then(|end_hz| thinned(record, end_hz)) {
        Some(thinned) => Cow::Owned(thinned),
        None => Cow::Borrowed(record),
    }
}

/// Frequency above which a filter took the noise out of every channel of what answers, Hz; none where it is what drives the mass that ends there.
fn filtered_above_hz(record: &Record) -> Option<f64> {
    let channels = match record.kind {
        Kind::Component => return None,
        Kind::Base => vec![
            &record.mass_acceleration_1_m_s2,
            &record.mass_acceleration_2_m_s2,
            &record.relative_displacement_m,
        ],
        Kind::Force => vec![&record.displacement_m, &record.acceleration_m_s2],
    };
    let measured = channels.into_iter().filter(|channel| !channel.is_empty());
    let ends: Option<Vec<usize>> = measured
        .map(|channel| {
            let (end, is_hiss_above) = end_of_level(channel)?;
            let level = |part: usize| part as f64 / PARTS as f64;
            let driven = || shared(channel, record.input(), level(end - LEVEL_PARTS)..level(end));
            (!is_hiss_above || driven() < DRIVEN).then_some(end)
        })
        .collect();
    let part_hz = 0.5 * record.sample_rate_hz / PARTS as f64;
    ends?.into_iter().min().map(|end| end as f64 * part_hz)
}

/// First part of the band that a filter took the noise of a channel out of: noise that is level below it, and next to none at the top; and
/// whether that is level, too, and more than rounding makes.
fn end_of_level(channel: &[f64]) -> Option<(usize, bool)> {
    let spectrum = Spectrum::tapered(channel, 1.0);
    let part = (spectrum.bins.len() - 1) / PARTS;
    if part < 16 || channel.iter().any(|x| !x.is_finite()) {
        return None;
    }
    let levels: Vec<f64> = spectrum.bins[1..]
        .chunks_exact(part)
        .take(PARTS)
        .map(|bins| {
            let mut powers: Vec<f64> = bins.iter().map(|z| z.norm_sqr()).collect();
            let (_, median, _) = powers.select_nth_unstable_by(part / 2, f64::total_cmp);
            *median
        })
        .collect();
    let top = levels.iter().rev().take(PARTS / 16).fold(0.0_f64, |most, level| most.max(*level));
    // From above: the first that are level and stand out of the top.
    let starts = 1..=(HIGHEST * PARTS as f64) as usize - LEVEL_PARTS;
    let start = starts.rev().find(|start| {
        let of = &levels[*start..start + LEVEL_PARTS];
        let (least, most) = of.iter().fold((f64::INFINITY, 0.0_f64), |(l, m), x| (l.min(*x), m.max(*x)));
        least > LEFT * top && most < LEVEL * least
    })?;
    let above = &levels[PARTS - LEVEL_PARTS..];
    let least = above.iter().fold(f64::INFINITY, |least, level| level.min(least));
    // The median of the power of noise is ln 2 of its mean.
    let rounding = std::f64::consts::LN_2 * spectrum.white_noise_power(of_rounding(channel));
    Some((start + LEVEL_PARTS, top < LEVEL * least && least > LEVEL * rounding))
}

/// The record at twice the frequency of its end.
fn thinned(record: &Record, end_hz: f64) -> Option<Record> {
    let rate = record.sample_rate_hz;
    let mut out = Record::empty(record.source.clone(), record.kind, rate);
    let mut shift_s = 0.0;
    let channels = [
        (&record.table_displacement_m, &mut out.table_displacement_m),
        (&record.table_acceleration_m_s2, &mut out.table_acceleration_m_s2),
        (&record.mass_acceleration_1_m_s2, &mut out.mass_acceleration_1_m_s2),
        (&record.mass_acceleration_2_m_s2, &mut out.mass_acceleration_2_m_s2),
        (&record.relative_displacement_m, &mut out.relative_displacement_m),
        (&record.force_n, &mut out.force_n),
        (&record.displacement_m, &mut out.displacement_m),
        (&record.acceleration_m_s2, &mut out.acceleration_m_s2),
    ];
    let mut samples = 0;
    for (channel, to) in channels.into_iter().filter(|(channel, _)| !channel.is_empty()) {
        (*to, out.sample_rate_hz, shift_s) = Spectrum::of(channel, rate).up_to(end_hz);
        samples = to.len();
    }
    let start_s = record.time_s.first()? + shift_s;
    out.time_s = (0..samples).map(|i| start_s + i as f64 / out.sample_rate_hz).collect();
    let nearest = |i: usize| ((shift_s + i as f64 / out.sample_rate_hz) * rate).round() as usize;
    out.step = (0..samples).filter_map(|i| record.step.get(nearest(i)).copied()).collect();
    out.notes.clone_from(&record.notes);
    // Four figures of what is told to no more.
    let decimals = |hz: f64| (3 - hz.abs().max(1e-12).log10().floor() as i32).clamp(0, 9) as usize;
    let (end, taken_hz) = (decimals(end_hz), out.sample_rate_hz);
    out.notes.push(format!(
        "all sensors of what answers were low-passed at about {end_hz:.end$} Hz after they were sampled: taken at {taken_hz:.taken$} Hz, where their noise is white",
        taken = decimals(taken_hz),
    ));
    (record.step.is_empty() || out.step.len() == samples).then_some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng as _, SeedableRng};
    use rand_pcg::Pcg64;
    use realfft::num_complex::Complex64;
    use std::f64::consts::TAU;

    const RATE_HZ: f64 = 400.0;

    /// A record of two sensors that see a tone and noise, each low-passed there.
    fn record(low_pass_hz: Option<f64>) -> Record {
        let mut random = Pcg64::seed_from_u64(7);
        let mut channel = |amplitude: f64| {
            let tone = |i: usize| amplitude * (TAU * 3.1 * i as f64 / RATE_HZ).sin();
            let seen: Vec<f64> =
                (0..12_000).map(|i| tone(i) + 1e-3 * amplitude * (random.random::<f64>() - 0.5)).collect();
            let Some(cut_hz) = low_pass_hz else { return seen };
            let low = |w: f64| Complex64::from(1.0 / (1.0 + (w / (TAU * cut_hz)).powi(8)));
            Spectrum::of(&seen, RATE_HZ).multiply(low).channel()
        };
        let mut record = Record::empty("it", Kind::Force, RATE_HZ);
        (record.displacement_m, record.acceleration_m_s2) = (channel(0.01), channel(4.0));
        record.force_n.clone_from(&record.acceleration_m_s2);
        record.time_s = (0..12_000).map(|i| i as f64 / RATE_HZ).collect();
        record.step = (0..12_000).map(|i| i / 4000).collect();
        record
    }

    #[test]
    fn a_record_with_white_noise_stays_as_it_is() {
        assert!(matches!(at_its_rate(&record(None)), Cow::Borrowed(_)));
    }

    #[test]
    fn a_filtered_record_is_taken_at_the_rate_of_its_band_and_shows_the_same() {
        let filtered = record(Some(60.0));
        let thinned = at_its_rate(&filtered);
        // The filter takes half of the power out at 0.9 of its frequency.
        assert!((90.0..115.0).contains(&thinned.sample_rate_hz), "{}", thinned.sample_rate_hz);
        assert_eq!(thinned.notes.len(), 1);
        assert_eq!(thinned.time_s.len(), thinned.displacement_m.len());
        assert_eq!(thinned.time_s.len(), thinned.step.len());
        for (t, d) in thinned.time_s.iter().zip(&thinned.displacement_m).skip(20).take(3000) {
            assert!((d - 0.01 * (TAU * 3.1 * t).sin()).abs() < 2e-5, "{t} s");
        }
        let of = |step: i32| thinned.step.iter().filter(|s| **s == step).count();
        assert!(of(0).abs_diff(of(1)) <= 1 && of(1).abs_diff(of(2)) <= 1);
    }
}
