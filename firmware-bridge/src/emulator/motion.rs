//! What the emulated drive asks of the table between two SYNCs and while it stops by itself.

/// Position, velocity and acceleration asked of the table.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Demand {
    /// m.
    pub displacement_m: f64,
    /// m/s.
    pub velocity_m_s: f64,
    /// m/s2.
    pub acceleration_m_s2: f64,
}

impl Demand {
    fn after(self, s: f64) -> Self {
        Self {
            displacement_m: self.displacement_m + (self.velocity_m_s + 0.5 * self.acceleration_m_s2 * s) * s,
            velocity_m_s: self.velocity_m_s + self.acceleration_m_s2 * s,
            ..self
        }
    }
}

/// The motion as a function of time.
#[derive(Clone, Copy, Debug)]
pub enum Motion {
    /// Standing here.
    Hold(f64),
    /// Following the target of the last SYNC, carried forward.
    Follow {
        /// Target of the last SYNC.
        target: Demand,
        /// Time of that SYNC, ns.
        at_ns: f64,
    },
    /// Braking.
    Brake {
        /// Where it began.
        from: Demand,
        /// When, ns.
        at_ns: f64,
        /// Deceleration, m/s2.
        deceleration_m_s2: f64,
    },
}

/// A target is carried forward by no more than this, s: longer than the time-outs that then take over.
const CARRY_S: f64 = 0.05;

impl Motion {
    /// The demand at a time.
    pub fn at(&self, now_ns: f64) -> Demand {
        match *self {
            Self::Hold(displacement_m) => Demand { displacement_m, ..Demand::default() },
            Self::Follow { target, at_ns } => {
                target.after(((now_ns - at_ns) * 1e-9).clamp(-CARRY_S, CARRY_S))
            }
            Self::Brake { from, at_ns, deceleration_m_s2 } => {
                let duration_s = from.velocity_m_s.abs() / deceleration_m_s2;
                let braking =
                    Demand { acceleration_m_s2: -deceleration_m_s2 * from.velocity_m_s.signum(), ..from };
                let t = (now_ns - at_ns) * 1e-9;
                if t < duration_s {
                    return braking.after(t.max(0.0));
                }
                Demand { displacement_m: braking.after(duration_s).displacement_m, ..Demand::default() }
            }
        }
    }

    /// Brakes from wherever the motion is at a time.
    pub fn brake(&self, now_ns: f64, deceleration_m_s2: f64) -> Self {
        Self::Brake { from: self.at(now_ns), at_ns: now_ns, deceleration_m_s2 }
    }

    /// Whether the motion has come to rest.
    pub fn at_rest(&self, now_ns: f64) -> bool {
        self.at(now_ns).velocity_m_s == 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn braking_is_continuous_and_ends_at_rest() {
        let target = Demand { displacement_m: 0.01, velocity_m_s: -0.2, acceleration_m_s2: 0.5 };
        let follow = Motion::Follow { target, at_ns: 0.0 };
        let brake = follow.brake(1e6, 4.0);
        let (before, after) = (follow.at(1e6), brake.at(1e6));
        assert!((before.displacement_m - after.displacement_m).abs() < 1e-12);
        assert!((before.velocity_m_s - after.velocity_m_s).abs() < 1e-12);
        assert!(!brake.at_rest(40e6) && brake.at_rest(60e6));
        // v^2 / (2 d) from 1 ms after the SYNC.
        let way = before.velocity_m_s * before.velocity_m_s / 8.0;
        assert!((brake.at(1e9).displacement_m - (before.displacement_m - way)).abs() < 1e-9);
    }
}
