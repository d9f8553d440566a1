//! The stops: at once by a minimum-jerk deceleration from whatever is commanded, or gently by letting the sine die
//! away; then the slow return to the centre. Used by the guard when the supervisor orders it; promises to stay inside
//! stroke, velocity, acceleration and jerk of the rig for every state that a sweep can reach (SR-08), and to end at
//! rest.

use super::spec::Stops;
use crate::rig::Capacity;
use crate::stream::Command;
use crate::sweep::{CommandPoint, Segment};
use std::f64::consts::TAU;

/// Times that are tried: from, to (s), ratio from one to the next.
const SHORTEST_S: f64 = 5e-3;
const LONGEST_S: f64 = 20.0;
const RATIO: f64 = 1.02;
/// Halvings of the interval in which the shortest time lies.
const HALVINGS: u32 = 20;

/// Bounds of one stop.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    displacement_m: f64,
    velocity_m_s: f64,
    /// In the direction in which the table is accelerated already: with what a stop begins it must live.
    acceleration_m_s2: f64,
    /// Against it.
    braking_m_s2: f64,
    jerk_m_s3: f64,
}

/// `v(t) = v0 + a0 t + b t^2 + c t^3` with `b = -(3 v0 + 2 a0 T)/T^2`, `c = (2 v0 + a0 T)/T^3`: velocity and
/// acceleration are zero at T, and of all such motions the integral of the squared jerk is least (Flash and
/// Hogan 1985, J. Neurosci. 5(7), with the end position left free).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MinimumJerkStop {
    start: Command,
    b: f64,
    c: f64,
    duration_s: f64,
}

impl MinimumJerkStop {
    /// The gentlest stop from a commanded state that keeps inside the rig's capacity: the shortest with
    /// an acceleration of `least_share` of A_G, with more only where the stroke asks for it.
    /// `amplitude_m_s2` is A_G. A sweep near its turning point accelerates by nearly A_G one way, and to brake as hard the
    /// other way would throw a mass that has been swinging just short of its bumpers into one of them.
    pub fn new(start: &Command, amplitude_m_s2: f64, stops: &Stops, capacity: &Capacity) -> Self {
        let share = stops.capacity_share;
        let most_m_s2 = (share * capacity.acceleration_m_s2).max(start.acceleration_m_s2.abs());
        let bounds = |acceleration_m_s2: f64, jerk_m_s3: f64| Bounds {
            displacement_m: (share * capacity.displacement_m).max(start.displacement_m.abs()),
            velocity_m_s: (share * capacity.velocity_m_s).max(start.velocity_m_s.abs()),
            acceleration_m_s2: acceleration_m_s2.max(start.acceleration_m_s2.abs()).min(most_m_s2),
            braking_m_s2: acceleration_m_s2.min(most_m_s2),
            jerk_m_s3,
        };
        let gentle_m_s3 = stops.jerk_m_s3.min(share * capacity.jerk_m_s3);
        let between = stops.least_share + 0.5 * (stops.most_share - stops.least_share);
        let tries = [
            (stops.least_share * amplitude_m_s2, gentle_m_s3),
            (between * amplitude_m_s2, gentle_m_s3),
            (stops.most_share * amplitude_m_s2, gentle_m_s3),
            (most_m_s2, gentle_m_s3),
            (most_m_s2, share * capacity.jerk_m_s3),
        ];
        tries
            .iter()
            .find_map(|&(acceleration, jerk)| Self::shortest(start, &bounds(acceleration, jerk)))
            .unwrap_or_else(|| Self::least_excess(start, &bounds(most_m_s2, share * capacity.jerk_m_s3)))
    }

    fn of_duration(start: &Command, duration_s: f64) -> Self {
        let (v, a, t) = (start.velocity_m_s, start.acceleration_m_s2, duration_s);
        let (b, c) = (-(3.0 * v + 2.0 * a * t) / (t * t), (2.0 * v + a * t) / (t * t * t));
        Self { start: *start, b, c, duration_s }
    }

    /// The shortest stop inside the bounds, if any.
    fn shortest(start: &Command, bounds: &Bounds) -> Option<Self> {
        let fits = |t: f64| Self::of_duration(start, t).excess(bounds) <= 1e-9;
        let mut long = SHORTEST_S;
        while !fits(long) {
            long *= RATIO;
            if long > LONGEST_S {
                return None;
            }
        }
        let mut short = long / RATIO;
        for _ in 0..HALVINGS {
            let middle = 0.5 * (short + long);
            *(if fits(middle) { &mut long } else { &mut short }) = middle;
        }
        Some(Self::of_duration(start, long))
    }

    /// From a state that no sweep reaches and that cannot be stopped inside the bounds: the stop that
    /// exceeds them least.
    fn least_excess(start: &Command, bounds: &Bounds) -> Self {
        let mut best = Self::of_duration(start, SHORTEST_S);
        let mut duration_s = SHORTEST_S;
        while duration_s < LONGEST_S {
            let stop = Self::of_duration(start, duration_s);
            if stop.excess(bounds) < best.excess(bounds) {
                best = stop;
            }
            duration_s *= RATIO;
        }
        best
    }

    /// Largest relative excess over the bounds; 0 inside. In closed form: velocity and acceleration
    /// vanish at T, which leaves one other root to each.
    fn excess(&self, bounds: &Bounds) -> f64 {
        let inside = |t: f64| (t > 0.0 && t < self.duration_s).then(|| self.at(t));
        // v = c (t - T)^2 (t - s), a = 3 c (t - T)(t - r), a' = 0 at -b/3c; a zero c gives no finite root.
        let turn = inside(-self.start.velocity_m_s / (self.c * self.duration_s * self.duration_s));
        let fastest = inside(self.start.acceleration_m_s2 / (3.0 * self.c * self.duration_s));
        let steepest = inside(-self.b / (3.0 * self.c));
        let end = self.at(self.duration_s);
        let over = |value: f64, bound: f64| value.abs() / bound - 1.0;
        let brakes = |now: &Command| now.acceleration_m_s2 * self.start.acceleration_m_s2 <= 0.0;
        let jerk = (2.0 * self.b).abs().max((2.0 * self.b + 6.0 * self.c * self.duration_s).abs());
        [turn, fastest, steepest, Some(self.start), Some(end)]
            .into_iter()
            .flatten()
            .map(|command| {
                let most = if brakes(&command) { bounds.braking_m_s2 } else { bounds.acceleration_m_s2 };
                over(command.displacement_m, bounds.displacement_m)
                    .max(over(command.velocity_m_s, bounds.velocity_m_s))
                    .max(over(command.acceleration_m_s2, most))
            })
            .fold(over(jerk, bounds.jerk_m_s3).max(0.0), f64::max)
    }

    /// Command at a time since the stop began, s; at rest from the end on.
    pub fn at(&self, time_s: f64) -> Command {
        let t = time_s.clamp(0.0, self.duration_s);
        let Command { displacement_m: x, velocity_m_s: v, acceleration_m_s2: a } = self.start;
        let displacement_m = x + t * (v + t * (a / 2.0 + t * (self.b / 3.0 + t * self.c / 4.0)));
        if time_s >= self.duration_s {
            return Command { displacement_m, velocity_m_s: 0.0, acceleration_m_s2: 0.0 };
        }
        Command {
            displacement_m,
            velocity_m_s: v + t * (a + t * (self.b + t * self.c)),
            acceleration_m_s2: a + t * (2.0 * self.b + t * 3.0 * self.c),
        }
    }

    /// Time from the decision to rest, s.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }
}

/// The gentle stop: the sine of a step keeps its frequency and phase while its amplitude falls as
/// `1 - S(t/T)` with the quintic `S(u) = 10 u^3 - 15 u^4 + 6 u^5`; it ends at rest in the centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decay {
    amplitude_m: f64,
    rate_rad_s: f64,
    phase_rad: f64,
    duration_s: f64,
}

impl Decay {
    /// From a point of the sweep; `None` outside steps and from `decay_below_hz` on, where a stop at once is gentler.
    pub fn of(point: &CommandPoint, stops: &Stops) -> Option<Self> {
        let phase = point.phase.filter(|_| point.segment == Segment::Step)?;
        if phase.frequency_hz >= stops.decay_below_hz || phase.frequency_hz <= 0.0 {
            return None;
        }
        let rate_rad_s = TAU * phase.frequency_hz;
        Some(Self {
            amplitude_m: phase.acceleration_amplitude_m_s2 / (rate_rad_s * rate_rad_s),
            rate_rad_s,
            phase_rad: phase.phase_rad,
            duration_s: f64::from(stops.decay_cycles) / phase.frequency_hz,
        })
    }

    /// Command at a time since the stop began, s; at rest in the centre from the end on.
    pub fn at(&self, time_s: f64) -> Command {
        if time_s >= self.duration_s {
            return Command::default();
        }
        let (rate, w) = (1.0 / self.duration_s, self.rate_rad_s);
        let u = (time_s * rate).max(0.0);
        let share = 1.0 - u * u * u * (10.0 + u * (6.0 * u - 15.0));
        let slope = -30.0 * u * u * (1.0 - u) * (1.0 - u) * rate;
        let bend = -60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) * rate * rate;
        let (sin, cos) = (self.phase_rad + w * time_s).sin_cos();
        let (x, v, a) = (-sin, -w * cos, w * w * sin);
        Command {
            displacement_m: self.amplitude_m * share * x,
            velocity_m_s: self.amplitude_m * (share * v + slope * x),
            acceleration_m_s2: self.amplitude_m * (share * a + 2.0 * slope * v + bend * x),
        }
    }

    /// Time from the decision to rest, s.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }
}

/// The slow return to the centre: minimum-jerk from rest to rest (Flash and Hogan 1985).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Return {
    from_m: f64,
    duration_s: f64,
}

impl Return {
    /// From a place of rest, m. Peak speed and acceleration of the quintic are 1.875 d/T and 5.774 d/T^2,
    /// its jerk is 60 d/T^3.
    pub fn new(from_m: f64, stops: &Stops) -> Self {
        let distance_m = from_m.abs();
        let by_speed = 1.875 * distance_m / stops.return_speed_m_s;
        let by_acceleration = (5.774 * distance_m / stops.return_acceleration_m_s2).sqrt();
        let by_jerk = (60.0 * distance_m / stops.jerk_m_s3).cbrt();
        Self { from_m, duration_s: by_speed.max(by_acceleration).max(by_jerk).max(0.1) }
    }

    /// Command at a time since the return began, s.
    pub fn at(&self, time_s: f64) -> Command {
        let u = (time_s / self.duration_s).clamp(0.0, 1.0);
        let (w, rate) = (1.0 - u, 1.0 / self.duration_s);
        let left = 1.0 - u * u * u * (10.0 + u * (6.0 * u - 15.0));
        Command {
            displacement_m: self.from_m * left,
            velocity_m_s: -self.from_m * 30.0 * u * u * w * w * rate,
            acceleration_m_s2: -self.from_m * 60.0 * u * w * (1.0 - 2.0 * u) * rate * rate,
        }
    }

    /// Time until the centre is reached, s.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }
}

#[cfg(test)]
#[path = "stop_tests.rs"]
mod tests;
