//! The stop of the table from any motion: minimum-jerk, end position free, from the commanded state. A
//! command is never frozen while the table moves: that alone asks 15 m/s2 of it at 0.07 g and 0.5 Hz.

use crate::stream::Command;

/// Largest jerk of a stop, m/s3.
const JERK_M_S3: f64 = 60.0;
/// Shortest and longest stop that is tried, s, and their distance.
const DURATIONS_S: (f64, f64, f64) = (0.1, 3.0, 0.02);

/// `v(t) = v0 + a0 t + b t^2 + c t^3` with `b = -(3 v0 + 2 a0 T)/T^2`, `c = (2 v0 + a0 T)/T^3`: velocity
/// and acceleration are continuous at the start and zero at T.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StopTrajectory {
    start: Command,
    b: f64,
    c: f64,
    duration_s: f64,
    time_s: f64,
    step_s: f64,
}

impl StopTrajectory {
    /// The shortest stop from a commanded state within an acceleration (m/s2; never less than what the
    /// state has already) and the jerk of all stops.
    pub fn new(start: Command, acceleration_limit_m_s2: f64, sample_rate_hz: f64) -> Self {
        let limit = acceleration_limit_m_s2.max(start.acceleration_m_s2.abs());
        let (shortest, longest, step) = DURATIONS_S;
        let mut stop = Self::lasting(start, longest, sample_rate_hz);
        let mut duration_s = shortest;
        while duration_s < longest {
            let candidate = Self::lasting(start, duration_s, sample_rate_hz);
            let (acceleration, jerk) = candidate.peaks();
            if acceleration <= limit * (1.0 + 1e-9) && jerk <= JERK_M_S3 {
                stop = candidate;
                break;
            }
            duration_s += step;
        }
        stop
    }

    fn lasting(start: Command, duration_s: f64, sample_rate_hz: f64) -> Self {
        let (v0, a0, t) = (start.velocity_m_s, start.acceleration_m_s2, duration_s);
        Self {
            start,
            b: -(3.0 * v0 + 2.0 * a0 * t) / (t * t),
            c: (2.0 * v0 + a0 * t) / (t * t * t),
            duration_s,
            time_s: 0.0,
            step_s: 1.0 / sample_rate_hz,
        }
    }

    /// Largest acceleration (m/s2) and jerk (m/s3): the acceleration is a parabola, the jerk a line.
    fn peaks(&self) -> (f64, f64) {
        let acceleration = |t: f64| self.start.acceleration_m_s2 + t * (2.0 * self.b + 3.0 * t * self.c);
        let vertex = if self.c == 0.0 { 0.0 } else { -self.b / (3.0 * self.c) };
        let peak = acceleration(vertex.clamp(0.0, self.duration_s)).abs();
        let jerk = (2.0 * self.b).abs().max((2.0 * self.b + 6.0 * self.c * self.duration_s).abs());
        (peak.max(self.start.acceleration_m_s2.abs()), jerk)
    }

    /// The command of the next period.
    pub fn next_command(&mut self) -> Command {
        self.time_s = (self.time_s + self.step_s).min(self.duration_s);
        let (t, s) = (self.time_s, &self.start);
        let (v0, a0, b, c) = (s.velocity_m_s, s.acceleration_m_s2, self.b, self.c);
        Command {
            displacement_m: s.displacement_m + t * (v0 + t * (a0 / 2.0 + t * (b / 3.0 + t * c / 4.0))),
            velocity_m_s: v0 + t * (a0 + t * (b + t * c)),
            acceleration_m_s2: a0 + t * (2.0 * b + 3.0 * t * c),
        }
    }

    /// Whether the table has been asked to rest.
    pub fn is_done(&self) -> bool {
        self.time_s >= self.duration_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn any_stop_is_continuous_within_limits_and_ends_at_rest(
            x in -0.1..0.1f64, v in -0.35..0.35f64, a in -1.0..1.0f64,
        ) {
            let start = Command { displacement_m: x, velocity_m_s: v, acceleration_m_s2: a };
            let limit = 0.6f64;
            let mut stop = StopTrajectory::new(start, limit, 2048.0);
            let (mut last, mut periods) = (start, 0);
            while !stop.is_done() {
                let next = stop.next_command();
                let jerk = (next.acceleration_m_s2 - last.acceleration_m_s2) * 2048.0;
                prop_assert!(jerk.abs() <= JERK_M_S3 * 1.01);
                prop_assert!(next.acceleration_m_s2.abs() <= limit.max(a.abs()) * 1.000_001);
                prop_assert!((next.velocity_m_s - last.velocity_m_s).abs() <= 1.1 * limit.max(a.abs()) / 2048.0);
                prop_assert!((next.displacement_m - last.displacement_m).abs() <= 0.7 / 2048.0);
                last = next;
                periods += 1;
            }
            prop_assert!(periods <= 3 * 2048 + 1);
            prop_assert!(last.velocity_m_s.abs() < 1e-9 && last.acceleration_m_s2.abs() < 1e-9);
        }
    }
}
