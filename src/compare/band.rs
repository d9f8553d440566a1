//! The band in which measurement and model are compared, through the same causal filter.

use super::window::Window;
use crate::record::{Kind, Record};
use crate::signal::{BAND_HIGH_HZ, BAND_LOW_HZ, BandPass, rising};

/// Edges of the comparison's band-pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Band {
    /// Lower edge, Hz.
    pub low_hz: f64,
    /// Upper edge, Hz.
    pub high_hz: f64,
}

impl Band {
    /// The band of the paper, 0.16-30 Hz, wherever the motion lies well inside it; else from a sixth of
    /// the lowest to twelve times the highest frequency of the motion. `None` (no filter) for
    /// `component` records: nothing is gained by filtering a force that follows an imposed motion.
    pub fn of(record: &Record, windows: &[Window]) -> Option<Self> {
        if record.kind == Kind::Component {
            return None;
        }
        let rate = record.sample_rate_hz;
        let steps = windows.iter().filter_map(|window| window.frequency_hz);
        let (low, high) = steps.fold((f64::INFINITY, 0.0_f64), |(low, high), f| (low.min(f), high.max(f)));
        let (low, high) = if high > 0.0 { (low, high) } else { occupied(record) };
        let inside = low >= 1.5 * BAND_LOW_HZ && high <= 0.5 * BAND_HIGH_HZ;
        let band = if inside {
            Self { low_hz: BAND_LOW_HZ, high_hz: BAND_HIGH_HZ }
        } else {
            Self { low_hz: low / 6.0, high_hz: 12.0 * high }
        };
        Some(Self { high_hz: band.high_hz.min(0.45 * rate), ..band })
    }

    fn pass(&self, rate: f64) -> BandPass {
        BandPass::new(self.low_hz, self.high_hz, rate)
    }

    /// Filters a channel in place, from rest at its first sample.
    pub fn filter(&self, channel: &mut [f64], rate: f64) {
        let mut pass = self.pass(rate);
        for x in channel {
            *x = pass.process(*x);
        }
    }

    /// [`Band::filter`] of two channels at once, neither of which then waits for the other.
    pub fn filter_pair(&self, one: &mut [f64], two: &mut [f64], rate: f64) {
        let mut passes = [self.pass(rate), self.pass(rate)];
        let common = one.len().min(two.len());
        let (one, one_rest) = one.split_at_mut(common);
        let (two, two_rest) = two.split_at_mut(common);
        for (x, y) in one.iter_mut().zip(two) {
            (*x, *y) = (passes[0].process(*x), passes[1].process(*y));
        }
        for (pass, rest) in passes.iter_mut().zip([one_rest, two_rest]) {
            rest.iter_mut().for_each(|x| *x = pass.process(*x));
        }
    }

    /// Share of the power of white noise that passes.
    pub fn noise_share(&self, rate: f64) -> f64 {
        let pass = self.pass(rate);
        let points = 2048;
        let sum: f64 = (0..points)
            .map(|i| pass.response((f64::from(i) + 0.5) * 0.5 * rate / f64::from(points)).norm_sqr())
            .sum();
        sum / f64::from(points)
    }

    /// Delay of the filter in the middle of its band, samples.
    pub fn delay_samples(&self, rate: f64) -> usize {
        let pass = self.pass(rate);
        let hz = (self.low_hz * self.high_hz).sqrt().max(0.1 * self.high_hz);
        let (below, above) = (pass.response(0.95 * hz), pass.response(1.05 * hz));
        let turned = (above * below.conj()).arg();
        (-turned / (std::f64::consts::TAU * 0.1 * hz) * rate).max(0.0).round() as usize
    }
}

/// Frequencies of the slowest and the fastest whole cycle of the motion, Hz, by its rising crossings of
/// the mean with a hysteresis of a third of its RMS: no transform is needed for an edge.
fn occupied(record: &Record) -> (f64, f64) {
    let motion: &[f64] = match record.kind {
        Kind::Base if !record.relative_displacement_m.is_empty() => &record.relative_displacement_m,
        Kind::Base => &record.table_acceleration_m_s2,
        _ if !record.displacement_m.is_empty() => &record.displacement_m,
        _ => &record.acceleration_m_s2,
    };
    let rate = record.sample_rate_hz;
    let crossings: Vec<usize> = rising(motion, 0.3).map(|crossing| crossing.above).collect();
    let cycles = || crossings.windows(2).map(|two| two[1] - two[0]);
    match (cycles().max(), cycles().min()) {
        (Some(longest), Some(shortest)) => (rate / longest as f64, rate / shortest.max(2) as f64),
        _ => (2.0 * rate / motion.len().max(1) as f64, 0.05 * rate),
    }
}
