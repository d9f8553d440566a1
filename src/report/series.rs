//! The channels of a run as its figures need them, collected row by row.

use crate::signal::{BandPass, FilterBank};
use crate::stream::Row;

/// Channels of a run, band-passed where the paper does. Single precision: figures need no more, and a
/// run has a million samples.
#[derive(Clone, Debug)]
pub struct RunSeries {
    sample_rate_hz: f64,
    filters: FilterBank<5>,
    first_sequence: Option<u64>,
    /// Time since the first sample, s.
    pub time_s: Vec<f64>,
    /// Commanded displacement, m.
    pub command_m: Vec<f32>,
    /// Commanded acceleration, m/s2.
    pub command_acceleration_m_s2: Vec<f32>,
    /// Measured displacement of the table, m.
    pub table_m: Vec<f32>,
    /// Measured acceleration of the table, band-passed, m/s2.
    pub table_acceleration_m_s2: Vec<f32>,
    /// Measured acceleration of the mass (mean of both), band-passed, m/s2.
    pub mass_acceleration_m_s2: Vec<f32>,
    /// Measured relative displacement, band-passed, m.
    pub relative_m: Vec<f32>,
    /// Acceleration of the mass, onboard model, band-passed, m/s2.
    pub model_acceleration_m_s2: Vec<f32>,
    /// Relative displacement, onboard model, band-passed, m.
    pub model_relative_m: Vec<f32>,
    /// Step of the counted cycles, -1 elsewhere.
    pub step: Vec<i32>,
}

impl RunSeries {
    /// Nothing yet, at this sampling rate.
    pub fn new(sample_rate_hz: f64) -> Self {
        Self {
            sample_rate_hz,
            filters: FilterBank::new(BandPass::paper(sample_rate_hz)),
            first_sequence: None,
            time_s: Vec::new(),
            command_m: Vec::new(),
            command_acceleration_m_s2: Vec::new(),
            table_m: Vec::new(),
            table_acceleration_m_s2: Vec::new(),
            mass_acceleration_m_s2: Vec::new(),
            relative_m: Vec::new(),
            model_acceleration_m_s2: Vec::new(),
            model_relative_m: Vec::new(),
            step: Vec::new(),
        }
    }

    /// Adds the next row. A value that is no number counts as zero in the filters, which would not
    /// recover from it.
    pub fn push(&mut self, row: &Row) {
        let channels = &row.sample.channels;
        let first = *self.first_sequence.get_or_insert(row.sample.sequence);
        let number = |value: f64| if value.is_finite() { value } else { 0.0 };
        let filtered = self.filters.process(&[
            number(channels.table_acceleration_m_s2),
            number(channels.mass_acceleration_m_s2()),
            number(channels.relative_displacement_m),
            number(row.model_acceleration_m_s2),
            number(row.model_displacement_m),
        ]);
        self.time_s.push(row.sample.sequence.saturating_sub(first) as f64 / self.sample_rate_hz);
        self.command_m.push(row.command.displacement_m as f32);
        self.command_acceleration_m_s2.push(row.command.acceleration_m_s2 as f32);
        self.table_m.push(channels.table_displacement_m as f32);
        let [table, mass, relative, model_mass, model_relative] = filtered.map(|value| value as f32);
        self.table_acceleration_m_s2.push(table);
        self.mass_acceleration_m_s2.push(mass);
        self.relative_m.push(relative);
        self.model_acceleration_m_s2.push(model_mass);
        self.model_relative_m.push(model_relative);
        self.step.push(row.step);
    }

    /// Samples collected.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// Whether nothing was collected.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// The samples of the last `seconds` of a step's counted cycles; empty when there are none.
    pub fn end_of_step(&self, index: u32, seconds: f64) -> std::ops::Range<usize> {
        let is_it = |step: &i32| u32::try_from(*step) == Ok(index);
        let end = self.step.iter().rposition(is_it).map_or(0, |last| last + 1);
        let first = self.step.iter().position(is_it).unwrap_or(end);
        let wanted = (seconds * self.sample_rate_hz).round() as usize;
        first.max(end.saturating_sub(wanted))..end
    }

    /// Central difference of a channel, per second; one-sided at the ends.
    pub fn rate(&self, channel: &[f32], i: usize) -> f64 {
        let (before, after) = (i.saturating_sub(1), (i + 1).min(channel.len().saturating_sub(1)));
        let span_s = (after - before) as f64 / self.sample_rate_hz;
        if span_s > 0.0 { f64::from(channel[after] - channel[before]) / span_s } else { 0.0 }
    }
}

/// A long channel as a band of lowest and highest values in so many columns; short ones as they are.
pub fn envelope(time_s: &[f64], values: &[f32], scale: f64, columns: usize) -> Vec<(f64, f64)> {
    let length = time_s.len().min(values.len());
    let scaled = |i: usize| f64::from(values[i]) * scale;
    if length <= 4 * columns.max(1) {
        return (0..length).map(|i| (time_s[i], scaled(i))).collect();
    }
    let mut points = Vec::with_capacity(2 * columns);
    for column in 0..columns {
        let bucket = column * length / columns..(column + 1) * length / columns;
        let middle_s = time_s[bucket.start + bucket.len() / 2];
        let (low, high) =
            bucket.map(scaled).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        // Alternating the order saves half of the strokes from one column to the next.
        let pair = if column % 2 == 0 { [low, high] } else { [high, low] };
        points.extend(pair.map(|value| (middle_s, value)));
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_envelope_keeps_every_extreme() {
        let time_s: Vec<f64> = (0..10_000).map(|i| f64::from(i) * 0.01).collect();
        let mut values: Vec<f32> = (0..10_000).map(|i| (i as f32 * 0.3).sin()).collect();
        values[7777] = 5.0;
        values[3333] = -4.0;
        let points = envelope(&time_s, &values, 2.0, 100);
        assert_eq!(points.len(), 200);
        assert!(points.iter().any(|p| p.1 == 10.0) && points.iter().any(|p| p.1 == -8.0));
        assert!(points.windows(2).all(|pair| pair[0].0 <= pair[1].0));
        assert_eq!(envelope(&time_s[..50], &values[..50], 1.0, 100).len(), 50);
    }

    #[test]
    fn the_end_of_a_step_is_found_and_a_rate_is_a_slope() {
        let mut series = RunSeries::new(100.0);
        for i in 0..1000u64 {
            let mut row = Row { step: if (300..800).contains(&i) { 4 } else { -1 }, ..Row::default() };
            row.sample.sequence = 50 + i;
            row.sample.channels.table_displacement_m = 0.25 * i as f64 / 100.0;
            series.push(&row);
        }
        assert_eq!(series.end_of_step(4, 2.0), 600..800);
        assert_eq!(series.end_of_step(4, 99.0), 300..800);
        assert!(series.end_of_step(5, 1.0).is_empty());
        assert!((series.rate(&series.table_m, 500) - 0.25).abs() < 1e-4);
        assert_eq!(series.time_s[0], 0.0);
    }
}
