//! Guards: what must stay above zero for the mode to hold, and the search for the first that fails.

use super::super::system::System;
use super::dynamics::{Forces, Joint, Layout, Mode, Sliding};

/// Knees up and down, right and left bumper, bearings, joint towards each stop, reversal.
pub const GUARDS: usize = 8;
/// Values of all guards; an inactive one is infinite.
pub type Guards = [f64; GUARDS];

/// Index of each guard.
pub mod guard {
    pub const KNEE_UP: usize = 0;
    pub const KNEE_DOWN: usize = 1;
    pub const RIGHT: usize = 2;
    pub const LEFT: usize = 3;
    pub const BEARINGS: usize = 4;
    pub const JOINT_UP: usize = 5;
    pub const JOINT_DOWN: usize = 6;
    pub const REVERSAL: usize = 7;
}

impl System {
    /// Values of the guards at one instant.
    pub(super) fn guards<const N: usize>(
        &self,
        (time_s, table): (f64, f64),
        y: &[f64; N],
        mode: &Mode,
        layout: &Layout,
        forces: &Forces,
    ) -> Guards {
        let mut g = [f64::INFINITY; GUARDS];
        let element = if mode.joint == Joint::Rigid { y[0] } else { y[layout.element] };
        if !self.knees_m.is_empty() {
            let (low, high) = self.bounds(mode.segment);
            (g[guard::KNEE_UP], g[guard::KNEE_DOWN]) = (high - element, element - low);
        }
        if self.has_bumper {
            for side in 0..2 {
                let (p, _) = self.approach(side, y, layout);
                g[guard::RIGHT + side] = if mode.contact[side] {
                    let force = forces.contact_n[side];
                    // A preloaded tip stops at its rest position while it still pushes.
                    if self.bumper.preload_n > 0.0 {
                        force.min(p * self.bumper.preload_n.max(1.0) * 1e6)
                    } else {
                        force
                    }
                } else {
                    let tip = &mode.tips[side];
                    self.bumper.relaxed_m(tip.deformation_m, time_s - tip.since_s) - p
                };
            }
        }
        match mode.sliding {
            Sliding::Smooth => {}
            Sliding::Slip(sign) => g[guard::BEARINGS] = f64::from(sign) * y[1],
            Sliding::Stick => {
                let reaction = self.table_inverse_mass_1_kg * (forces.contact_n[0] - forces.contact_n[1]);
                let pull = forces.without_friction_n + self.mass_kg * (table + reaction);
                g[guard::BEARINGS] = self.friction.map_or(0.0, |f| f.breakaway_n) - pull.abs();
            }
        }
        let half = self.joint_half_width_m.unwrap_or(0.0);
        match mode.joint {
            Joint::Rigid => {}
            Joint::Open => {
                g[guard::JOINT_UP] = half - (y[0] - element);
                g[guard::JOINT_DOWN] = half + (y[0] - element);
            }
            Joint::Closed(sign) => g[guard::JOINT_UP] = f64::from(sign) * forces.element_n,
        }
        if mode.direction != 0 {
            g[guard::REVERSAL] = f64::from(mode.direction) * forces.element_velocity_m_s;
        }
        g
    }
}

/// First failing guard within a stretch: (guard, part of the stretch), from values at any part.
/// `nearly` marks the guards that may dip below zero and come back.
pub fn first_failure(
    start: &Guards,
    end: &Guards,
    nearly: &[bool; GUARDS],
    mut values: impl FnMut(f64) -> Guards,
) -> Option<(usize, f64)> {
    const PIECES: usize = 8;
    let mut samples = [*start; PIECES + 1];
    samples[PIECES] = *end;
    for (i, sample) in samples.iter_mut().enumerate().take(PIECES).skip(1) {
        *sample = values(i as f64 / PIECES as f64);
    }
    let mut first: Option<(usize, f64)> = None;
    for index in 0..GUARDS {
        if end[index] >= 0.0 && !nearly[index] {
            continue;
        }
        if let Some(part) = failure_of(index, &samples, &mut values)
            && first.is_none_or(|(_, earliest)| part < earliest)
        {
            first = Some((index, part));
        }
    }
    first
}

fn failure_of(index: usize, samples: &[Guards], values: &mut impl FnMut(f64) -> Guards) -> Option<f64> {
    let pieces = (samples.len() - 1) as f64;
    let mut armed = samples[0][index] > 0.0;
    for i in 1..samples.len() {
        let (before, after) = (samples[i - 1][index], samples[i][index]);
        let (low, high) = ((i - 1) as f64 / pieces, i as f64 / pieces);
        if after < 0.0 {
            return Some(if armed && before > 0.0 {
                root((low, before), (high, after), |part| values(part)[index])
            } else {
                late_start(index, low, high, armed, values)
            });
        }
        armed = armed || after > 0.0;
        // A dip between three samples: the vertex of their parabola decides.
        if i + 1 < samples.len() {
            let next = samples[i + 1][index];
            let bend = before - 2.0 * after + next;
            if bend > 0.0 && after <= before && after <= next && after.is_finite() {
                let part = (i as f64 + 0.5 * (before - next) / bend) / pieces;
                let vertex = values(part)[index];
                if vertex < 0.0 {
                    return Some(root((low, before), (part, vertex), |part| values(part)[index]));
                }
            }
        }
    }
    // A dip in the first or last piece has no sample on its other side.
    for (from, to) in [(0.0, 1.0 / pieces), (1.0 - 1.0 / pieces, 1.0)] {
        let middle = values(0.5 * (from + to))[index];
        if middle < 0.0 && armed {
            let start = values(from)[index];
            return Some(if start > 0.0 {
                root((from, start), (0.5 * (from + to), middle), |part| values(part)[index])
            } else {
                from
            });
        }
    }
    None
}

/// A guard that begins at zero and fails: it may rise first. Looks for that rise close to the start.
fn late_start(index: usize, low: f64, high: f64, armed: bool, values: &mut impl FnMut(f64) -> Guards) -> f64 {
    let mut part = high;
    for _ in 0..40 {
        let next = low + 0.5 * (part - low);
        let value = values(next)[index];
        if value > 0.0 {
            let after = values(part)[index];
            return root((next, value), (part, after), |part| values(part)[index]);
        }
        part = next;
    }
    if armed { low } else { 0.0 }
}

/// Where a value falls through zero, between two places with what it is there, by the Illinois variant of false position (M. Dowell and
/// P. Jarratt, BIT 11 (1971) 168), to the last bits.
pub(super) fn root(above: (f64, f64), below: (f64, f64), mut of: impl FnMut(f64) -> f64) -> f64 {
    let ((mut a, mut fa), (mut b, mut fb)) = (above, below);
    let mut side = 0_i8;
    for round in 0..200 {
        if (b - a).abs() <= 4.0 * f64::EPSILON {
            break;
        }
        let secant = a + (b - a) * fa / (fa - fb);
        // Every third point halves the bracket: where a value is rounding alone, false position stalls.
        let part = if round % 3 < 2 && secant > a && secant < b { secant } else { 0.5 * (a + b) };
        let value = of(part);
        if value > 0.0 {
            (a, fa) = (part, value);
            fb *= if side == 1 { 0.5 } else { 1.0 };
            side = 1;
        } else {
            (b, fb) = (part, value);
            fa *= if side == -1 { 0.5 } else { 1.0 };
            side = -1;
            if value == 0.0 {
                break;
            }
        }
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_root_is_found_to_the_last_bits() {
        let (d, v, a, h) = (7.484165605880424e-3, 0.07032790371541355, 0.115, 1.0 / 2048.0);
        let gap = |part: f64| 0.0075 - (d + v * h * part + 0.5 * a * (h * part) * (h * part));
        let values = |part: f64| {
            let mut g = [f64::INFINITY; GUARDS];
            g[guard::RIGHT] = gap(part);
            g
        };
        let (start, end) = (values(0.0), values(1.0));
        let (index, part) = first_failure(&start, &end, &[false; GUARDS], values).expect("fails");
        assert_eq!(index, guard::RIGHT);
        assert!(gap(part).abs() < 2e-18, "{} {}", part, gap(part));
        // A tip that has all but come back: the guard is above zero by next to nothing.
        let hardly = |part: f64| {
            let mut g = [f64::INFINITY; GUARDS];
            g[guard::RIGHT] = gap(part) + 1.5e-320;
            g
        };
        let (start, end) = (hardly(0.0), hardly(1.0));
        let (_, again) = first_failure(&start, &end, &[false; GUARDS], hardly).expect("fails");
        assert!((again - part).abs() < 1e-13, "{part} {again}");
    }
}
