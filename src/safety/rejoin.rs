//! The way back to the sweep after control periods that passed without a command. The drive has gone on along the
//! last command meanwhile, so the next command begins there, and the distance to the sweep dies away smoothly. Used
//! by the guard; promises a command without a jump in displacement, velocity or acceleration, and none over what the
//! rig can do as long as the sweep leaves it room.

use super::spec::Stops;
use crate::rig::Capacity;
use crate::stream::Command;
use crate::sweep::CommandPoint;
use std::f64::consts::TAU;

/// Times that are tried: from (s), ratio from one to the next, how many; the last is 2.4 s.
const SHORTEST_S: f64 = 0.075;
const RATIO: f64 = 2.0;
const TRIES: i32 = 6;
/// Acceleration of the way back over A_G, aimed at.
const SHARE: f64 = 0.25;
/// Instants at which a way back is examined.
const INSTANTS: i32 = 24;

/// Distance from the sweep: `d(t) = d0 + v0 t + a0 t^2/2 + t^3 (b + c t + e t^2)`, the quintic that vanishes at T with
/// its first two derivatives (Biagiotti and Melchiorri 2008, Trajectory Planning for Automatic Machines and Robots,
/// section 2.1.5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rejoin {
    start: Command,
    b: f64,
    c: f64,
    e: f64,
    duration_s: f64,
}

impl Rejoin {
    /// The shortest way that is gentle and within the rig's capacity beside the sweep at `point`; where there is none,
    /// the one that exceeds these bounds least.
    pub fn new(distance: &Command, point: &CommandPoint, stops: &Stops, capacity: &Capacity) -> Self {
        let room = room_beside(point, stops, capacity);
        let mut best = Self::of_duration(distance, SHORTEST_S);
        for k in 1..TRIES {
            let least = best.excess(&room, stops.jerk_m_s3);
            if least <= 0.0 {
                break;
            }
            let longer = Self::of_duration(distance, SHORTEST_S * RATIO.powi(k));
            if longer.excess(&room, stops.jerk_m_s3) < least {
                best = longer;
            }
        }
        best
    }

    fn of_duration(start: &Command, duration_s: f64) -> Self {
        let t = duration_s;
        let Command { displacement_m: d, velocity_m_s: v, acceleration_m_s2: a } = *start;
        Self {
            start: *start,
            b: -(20.0 * d + 12.0 * v * t + 3.0 * a * t * t) / (2.0 * t.powi(3)),
            c: (30.0 * d + 16.0 * v * t + 3.0 * a * t * t) / (2.0 * t.powi(4)),
            e: -(12.0 * d + 6.0 * v * t + a * t * t) / (2.0 * t.powi(5)),
            duration_s,
        }
    }

    /// Largest relative excess over the room, negative inside.
    fn excess(&self, room: &Command, jerk_m_s3: f64) -> f64 {
        let over = |value: f64, bound: f64| value.abs() / bound - 1.0;
        (0..=INSTANTS)
            .map(|k| {
                let time_s = self.duration_s * f64::from(k) / f64::from(INSTANTS);
                let at = self.at(time_s);
                over(at.displacement_m, room.displacement_m)
                    .max(over(at.velocity_m_s, room.velocity_m_s))
                    .max(over(self.jerk_m_s3(time_s), jerk_m_s3))
                    // With what it begins it must live.
                    .max(over(
                        at.acceleration_m_s2,
                        room.acceleration_m_s2.max(1.001 * self.start.acceleration_m_s2.abs()),
                    ))
            })
            .fold(f64::NEG_INFINITY, f64::max)
    }

    /// Distance at a time since the way back began, s; zero from its end on.
    pub fn at(&self, time_s: f64) -> Command {
        if time_s >= self.duration_s {
            return Command::default();
        }
        let t = time_s.max(0.0);
        let Command { displacement_m: d, velocity_m_s: v, acceleration_m_s2: a } = self.start;
        let (b, c, e) = (self.b, self.c, self.e);
        Command {
            displacement_m: d + t * (v + t * (0.5 * a + t * (b + t * (c + t * e)))),
            velocity_m_s: v + t * (a + t * (3.0 * b + t * (4.0 * c + t * 5.0 * e))),
            acceleration_m_s2: a + t * (6.0 * b + t * (12.0 * c + t * 20.0 * e)),
        }
    }

    fn jerk_m_s3(&self, t: f64) -> f64 {
        6.0 * self.b + t * (24.0 * self.c + t * 60.0 * self.e)
    }

    /// Time until the sweep is joined again, s.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }
}

/// What is left to the rig beside a sine of the sweep's amplitude and frequency; of the acceleration no more than a
/// share of A_G.
fn room_beside(point: &CommandPoint, stops: &Stops, capacity: &Capacity) -> Command {
    let (amplitude_m_s2, angular_rad_s) = point.phase.map_or((0.0, f64::INFINITY), |phase| {
        (phase.acceleration_amplitude_m_s2, TAU * phase.frequency_hz.max(1e-3))
    });
    let left = |most: f64, used: f64| (stops.capacity_share * most - used).max(1e-3 * most);
    Command {
        displacement_m: left(capacity.displacement_m, amplitude_m_s2 / angular_rad_s.powi(2)),
        velocity_m_s: left(capacity.velocity_m_s, amplitude_m_s2 / angular_rad_s),
        acceleration_m_s2: left(capacity.acceleration_m_s2, amplitude_m_s2)
            .min((SHARE * amplitude_m_s2).max(1e-3 * capacity.acceleration_m_s2)),
    }
}
