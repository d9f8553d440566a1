//! The noise floor of a comparison, measured from the record itself: what would be left between a
//! perfect model and this measurement.
//!
//! White noise of each sensor comes from the quiet upper part of its spectrum (median of the bins, so
//! that lines do not count; the quietest parts of it where the motion reaches there), scaled to the band of the comparison; slower noise of the accelerometers
//! from the part of their difference that does not repeat from cycle to cycle (gain errors, leaks and
//! yaw repeat).

use super::band::Band;
use super::window::{Window, windows};
use crate::identify::spectral::noise_of_whole;
use crate::identify::{applied_noise, noise_of_whole_beside_jumps};
use crate::record::{Kind, Record};
use crate::signal::Spectrum;

/// Samples that are looked at for white noise.
const PIECE: usize = 1 << 17;

/// RMS noise in the band of the comparison; 0 for what is not measured.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NoiseFloor {
    /// Of the acceleration that is compared (mean of both accelerometers), m/s2.
    pub acceleration_m_s2: f64,
    /// Of the displacement, m.
    pub displacement_m: f64,
    /// Of the force that is compared (`component`), N.
    pub force_n: f64,
    /// White noise of the channel that drives the model, over its whole band: m/s2 of table
    /// acceleration, N of applied force, m of imposed displacement.
    pub input: f64,
}

/// Noise floor of a record, in the band in which it is compared.
pub fn noise_floor(record: &Record) -> NoiseFloor {
    let windows = windows(record);
    let band = Band::of(record, &windows);
    in_band(record, &windows, band.as_ref(), of_input(record))
}

/// White noise of the channel that drives the model, over its whole band.
pub(super) fn of_input(record: &Record) -> f64 {
    let hiss = white(record.input(), record.sample_rate_hz);
    let answers = [&record.displacement_m[..], &record.acceleration_m_s2];
    match record.kind {
        Kind::Force => applied_noise(hiss, record.input(), answers, record.sample_rate_hz),
        Kind::Base | Kind::Component => hiss,
    }
}

/// [`noise_floor`] with windows, band and the noise of the input at hand.
pub(super) fn in_band(record: &Record, windows: &[Window], band: Option<&Band>, input: f64) -> NoiseFloor {
    let rate = record.sample_rate_hz;
    let share = band.map_or(1.0, |band| band.noise_share(rate).sqrt());
    match record.kind {
        Kind::Base => NoiseFloor {
            acceleration_m_s2: accelerometers(record, windows, band, share),
            displacement_m: share * white(&record.relative_displacement_m, rate),
            force_n: 0.0,
            input,
        },
        Kind::Force => NoiseFloor {
            acceleration_m_s2: share * white(&record.acceleration_m_s2, rate),
            displacement_m: share * white(&record.displacement_m, rate),
            force_n: 0.0,
            input,
        },
        Kind::Component => {
            let scatter = scatter(&record.force_n, windows, rate).unwrap_or(0.0);
            let hiss = middle(&record.force_n).map_or(0.0, |x| noise_of_whole_beside_jumps(x, rate));
            NoiseFloor { force_n: hiss.max(scatter), input, ..NoiseFloor::default() }
        }
    }
}

/// Noise of the mean of the accelerometers in the band.
fn accelerometers(record: &Record, windows: &[Window], band: Option<&Band>, share: f64) -> f64 {
    let rate = record.sample_rate_hz;
    let (one, two) = (&record.mass_acceleration_1_m_s2, &record.mass_acceleration_2_m_s2);
    if one.is_empty() || two.is_empty() {
        return share * white(if one.is_empty() { two } else { one }, rate);
    }
    let hissing = 0.5 * share * white(one, rate).hypot(white(two, rate));
    let mut half: Vec<f64> = one.iter().zip(two).map(|(a, b)| 0.5 * (a - b)).collect();
    if let Some(band) = band {
        band.filter(&mut half, rate);
    }
    hissing.max(scatter(&half, windows, rate).unwrap_or(0.0))
}

/// White noise of a channel over its whole band, RMS.
fn white(channel: &[f64], rate: f64) -> f64 {
    middle(channel).map_or(0.0, |piece| noise_of_whole(piece, &Spectrum::tapered(piece, rate)))
}

/// What is looked at of a channel.
fn middle(channel: &[f64]) -> Option<&[f64]> {
    let from = (channel.len().saturating_sub(PIECE)) / 2;
    channel.get(from..(from + PIECE).min(channel.len())).filter(|piece| piece.len() > 32)
}

/// RMS of what does not repeat from one counted cycle to the next: the median over the steps, so that
/// steps that had not settled do not count.
fn scatter(channel: &[f64], windows: &[Window], rate: f64) -> Option<f64> {
    let mut squares: Vec<f64> = windows
        .iter()
        .filter_map(|window| {
            let samples = channel.get(window.counted.clone())?;
            let cycle = rate / window.frequency_hz?;
            let (whole, part) = (cycle as usize, cycle.fract());
            let pairs = samples.len().checked_sub(whole + 2)?;
            if pairs < whole / 2 {
                return None;
            }
            let sum: f64 = (0..pairs)
                .map(|i| {
                    let later = samples[i + whole] * (1.0 - part) + samples[i + whole + 1] * part;
                    (samples[i] - later).powi(2)
                })
                .sum();
            Some(0.5 * sum / pairs as f64)
        })
        .collect();
    squares.sort_by(f64::total_cmp);
    squares.get(squares.len() / 2).map(|square| square.sqrt())
}
