//! From an indicator to a finding: thresholds, persistence, high-water mark, clear condition. The same
//! for every detector, so that a detector only computes its indicator (SR-10).

use super::action::Clear;
use super::spec::Row;

/// What a detector says of one sample or period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Estimate {
    /// No new estimate; the last one stands.
    Keep,
    /// Nothing to judge at the moment (no step, no bumpers, no such link).
    Idle,
    /// A new estimate, in the unit of the detector.
    Value(f64),
}

/// How far an indicator has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Below every threshold, or not for long enough.
    #[default]
    Quiet,
    /// At the warning threshold for the persistence.
    Warn,
    /// At the trip threshold for the persistence.
    Trip,
}

/// State of one detector, for events and the live view.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reading {
    /// Last estimate.
    pub value: f64,
    /// Largest estimate since the last reset of the marks.
    pub high_water: f64,
    /// Level of the condition now.
    pub level: Level,
    /// The trip is kept although its condition may be gone.
    pub kept: bool,
}

/// Judges the estimates of one detector.
#[derive(Clone, Debug)]
pub struct Judge {
    on: bool,
    warn: f64,
    trip: f64,
    persistence: u32,
    clear: Clear,
    above_warn: u32,
    above_trip: u32,
    reading: Reading,
}

impl Judge {
    /// By a row of the configuration.
    pub fn new(row: &Row) -> Self {
        Self {
            on: row.disabled.is_none(),
            warn: row.warn.unwrap_or(f64::INFINITY),
            trip: row.trip,
            persistence: row.persistence,
            clear: row.clear,
            above_warn: 0,
            above_trip: 0,
            reading: Reading::default(),
        }
    }

    /// Takes an estimate; returns whether the finding has changed.
    pub fn judge(&mut self, estimate: Estimate) -> bool {
        let value = match estimate {
            Estimate::Keep => return false,
            Estimate::Idle => 0.0,
            // What is not a number is as bad as it can be.
            Estimate::Value(value) if value.is_nan() => f64::INFINITY,
            Estimate::Value(value) => value,
        };
        self.reading.value = value;
        self.reading.high_water = self.reading.high_water.max(value);
        let count = |above: bool, n: u32| if above { n.saturating_add(1) } else { 0 };
        self.above_warn = count(value >= self.warn, self.above_warn);
        self.above_trip = count(value >= self.trip, self.above_trip);
        let level = if self.above_trip >= self.persistence {
            Level::Trip
        } else if self.above_warn >= self.persistence {
            Level::Warn
        } else {
            Level::Quiet
        };
        if !self.on || level == self.reading.level {
            return false;
        }
        self.reading.level = level;
        self.reading.kept |= level == Level::Trip && self.clear != Clear::Gone;
        true
    }

    /// Forgets a trip whose condition is gone. Returns whether nothing is left that keeps the table from
    /// running.
    pub fn reset(&mut self) -> bool {
        if self.reading.level == Level::Trip || self.clear == Clear::Never && self.reading.kept {
            return !self.reading.kept;
        }
        self.reading.kept = false;
        true
    }

    /// Forgets the high-water mark.
    pub fn reset_high_water(&mut self) {
        self.reading.high_water = 0.0;
    }

    /// The present state.
    pub fn reading(&self) -> &Reading {
        &self.reading
    }

    /// Trips now, or has tripped and is kept.
    pub fn tripped(&self) -> bool {
        self.reading.kept || self.reading.level == Level::Trip
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::safety::Action;

    fn row(clear: Clear) -> Row {
        Row { action: Action::Abort, warn: Some(1.0), trip: 2.0, persistence: 3, clear, disabled: None }
    }

    fn show(judge: &mut Judge, values: &[f64]) -> Vec<Level> {
        let level = |value: &f64| {
            judge.judge(Estimate::Value(*value));
            judge.reading().level
        };
        values.iter().map(level).collect()
    }

    // SR-10
    #[test]
    fn persistence_counts_estimates_in_a_row() {
        use Level::{Quiet, Trip, Warn};
        let mut judge = Judge::new(&row(Clear::Reset));
        let seen = show(&mut judge, &[2.0, 2.0, 1.5, 2.0, 2.0, 2.0, 0.0]);
        assert_eq!(seen, [Quiet, Quiet, Warn, Warn, Warn, Trip, Quiet]);
        assert!(judge.tripped() && judge.reading().high_water == 2.0);
    }

    #[test]
    fn a_reset_needs_the_condition_gone() {
        let mut judge = Judge::new(&row(Clear::Reset));
        show(&mut judge, &[9.0; 3]);
        assert!(!judge.reset() && judge.tripped());
        show(&mut judge, &[0.0]);
        assert!(judge.tripped(), "kept until reset");
        assert!(judge.reset() && !judge.tripped());
        let mut never = Judge::new(&row(Clear::Never));
        show(&mut never, &[9.0, 9.0, 9.0, 0.0]);
        assert!(!never.reset() && never.tripped());
    }

    #[test]
    fn what_is_not_a_number_trips_and_what_is_off_does_not() {
        let mut judge = Judge::new(&row(Clear::Reset));
        assert_eq!(show(&mut judge, &[f64::NAN; 3])[2], Level::Trip);
        let off = Row { disabled: Some("no such sensor".into()), ..row(Clear::Reset) };
        let mut judge = Judge::new(&off);
        assert_eq!(show(&mut judge, &[9.0; 5])[4], Level::Quiet);
        assert_eq!(judge.reading().high_water, 9.0, "still shown");
    }
}
