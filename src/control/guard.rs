//! Hard limits that the control step watches at every sample and period. Each has a name, a limit and a
//! persistence; the first that trips is the cause of the abort and stays so.

use crate::stream::{Sample, StatusBits};
use crate::sweep::CommandPoint;

/// What can end a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cause {
    /// A channel delivers no number.
    NotANumber,
    /// The drive is not enabled, has tripped, or a link is down.
    DeviceStatus,
    /// No sample for too long.
    StaleSample,
    /// The table is not where its command was a chain delay ago.
    FollowingError,
    /// The table accelerates beyond its limit.
    TableAcceleration,
    /// The mass accelerates beyond its limit.
    MassAcceleration,
}

impl Cause {
    /// Name as in events and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::NotANumber => "not-a-number",
            Self::DeviceStatus => "device-status",
            Self::StaleSample => "stale-sample",
            Self::FollowingError => "following-error",
            Self::TableAcceleration => "table-acceleration",
            Self::MassAcceleration => "mass-acceleration",
        }
    }
}

/// Following error that is not tolerated, m.
const FOLLOWING_ERROR_M: f64 = 0.5e-3;
/// Largest table acceleration, m/s2.
const TABLE_ACCELERATION_M_S2: f64 = 3.5;
/// Largest acceleration of the mass, m/s2.
const MASS_ACCELERATION_M_S2: f64 = 18.0;
/// Time without a sample that is not tolerated, s.
const SILENCE_S: f64 = 0.05;
/// Samples in a row that a limit must be exceeded for, in the order of the checks below.
const PERSISTENCE: [(Cause, u8); 5] = [
    (Cause::NotANumber, 3),
    (Cause::DeviceStatus, 3),
    (Cause::FollowingError, 4),
    (Cause::TableAcceleration, 3),
    (Cause::MassAcceleration, 3),
];

/// The counters of the limits.
#[derive(Clone, Debug)]
pub struct Guard {
    counts: [u8; PERSISTENCE.len()],
    chain_delay_s: f64,
    silent_periods: u64,
    silence_limit: u64,
    enabled: bool,
}

impl Guard {
    /// Counters at zero, for a rig's delay and a control rate.
    pub fn new(chain_delay_s: f64, sample_rate_hz: f64) -> Self {
        Self {
            counts: [0; PERSISTENCE.len()],
            chain_delay_s,
            silent_periods: 0,
            silence_limit: (SILENCE_S * sample_rate_hz).ceil() as u64,
            enabled: false,
        }
    }

    /// Looks at one sample under its command; the limit that has now been exceeded for long enough.
    pub fn look(&mut self, sample: &Sample, reference: &CommandPoint) -> Option<Cause> {
        self.silent_periods = 0;
        let c = &sample.channels;
        let numbers = [
            c.table_displacement_m,
            c.table_acceleration_m_s2,
            c.mass_acceleration_1_m_s2,
            c.mass_acceleration_2_m_s2,
            c.relative_displacement_m,
        ];
        let command = &reference.command;
        let late_m = command.displacement_m - self.chain_delay_s * command.velocity_m_s;
        // Before the drive was first seen enabled its bit says nothing: a replayed or starting rig.
        self.enabled |= sample.status.has(StatusBits::DRIVE_ENABLED);
        let down = self.enabled && !sample.status.has(StatusBits::DRIVE_ENABLED);
        let exceeded = [
            numbers.iter().any(|value| !value.is_finite()),
            down || sample.status.has(StatusBits::DRIVE_FAULT | StatusBits::LINK_DOWN),
            (c.table_displacement_m - late_m).abs() > FOLLOWING_ERROR_M,
            c.table_acceleration_m_s2.abs() > TABLE_ACCELERATION_M_S2,
            c.mass_acceleration_m_s2().abs() > MASS_ACCELERATION_M_S2,
        ];
        let mut tripped = None;
        for ((count, exceeded), (cause, persistence)) in self.counts.iter_mut().zip(exceeded).zip(PERSISTENCE)
        {
            *count = if exceeded { count.saturating_add(1) } else { 0 };
            if *count >= persistence && tripped.is_none() {
                tripped = Some(cause);
            }
        }
        tripped
    }

    /// Counts periods without a sample.
    pub fn silence(&mut self, periods: u64) -> Option<Cause> {
        self.silent_periods += periods;
        (self.silent_periods > self.silence_limit).then_some(Cause::StaleSample)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::Command;
    use crate::sweep::Segment;

    fn point(displacement_m: f64) -> CommandPoint {
        let command = Command { displacement_m, ..Command::default() };
        CommandPoint { command, jerk_m_s3: 0.0, phase: None, segment: Segment::Step }
    }

    fn healthy() -> Sample {
        Sample { status: StatusBits(StatusBits::DRIVE_ENABLED), ..Sample::default() }
    }

    #[test]
    fn each_limit_trips_after_its_persistence_and_not_before() {
        type Spoil = fn(&mut Sample);
        let spoils: [(Spoil, Cause, u8); 5] = [
            (|s| s.channels.relative_displacement_m = f64::NAN, Cause::NotANumber, 3),
            (|s| s.status = StatusBits(0), Cause::DeviceStatus, 3),
            (|s| s.channels.table_displacement_m = 0.51e-3, Cause::FollowingError, 4),
            (|s| s.channels.table_acceleration_m_s2 = -3.6, Cause::TableAcceleration, 3),
            (
                |s| {
                    s.channels.mass_acceleration_1_m_s2 = 18.1;
                    s.channels.mass_acceleration_2_m_s2 = 18.1;
                },
                Cause::MassAcceleration,
                3,
            ),
        ];
        for (spoil, cause, persistence) in spoils {
            let mut guard = Guard::new(1e-3, 2048.0);
            assert_eq!(guard.look(&healthy(), &point(0.0)), None);
            let mut bad = healthy();
            spoil(&mut bad);
            for _ in 1..persistence {
                assert_eq!(guard.look(&bad, &point(0.0)), None);
            }
            // One good sample in between starts the count anew.
            assert_eq!(guard.look(&healthy(), &point(0.0)), None);
            for _ in 1..persistence {
                assert_eq!(guard.look(&bad, &point(0.0)), None);
            }
            assert_eq!(guard.look(&bad, &point(0.0)), Some(cause));
        }
    }

    #[test]
    fn silence_trips_after_fifty_milliseconds() {
        let mut guard = Guard::new(0.0, 2048.0);
        assert_eq!(guard.silence(103), None);
        assert_eq!(guard.silence(1), Some(Cause::StaleSample));
        guard.look(&healthy(), &point(0.0));
        assert_eq!(guard.silence(1), None);
    }
}
