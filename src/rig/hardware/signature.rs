//! What a small sine says about the wiring: five complex amplitudes, and which single fault explains them.
//! Pure functions; the pre-flight measures, this judges.
//!
//! With the table moving as `x`, the table accelerometer must show `-w^2 x`, and the mass, whatever holds
//! it, must show `A = a_table + D''`: kinematics alone, so that no specimen model is needed.

use nalgebra::Complex;
use serde::Serialize;

/// Names of the channels, in the order of a sample.
pub const NAMES: [&str; 5] = [
    "table displacement",
    "table acceleration",
    "mass acceleration 1",
    "mass acceleration 2",
    "relative displacement",
];

/// Complex amplitudes of the five channels, by the amplitude of the command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Response {
    /// By channel: m or m/s2 a metre of command.
    pub channels: [Complex<f64>; 5],
    /// Angular frequency, rad/s.
    pub w: f64,
}

/// What the check found.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "finding")]
pub enum Finding {
    /// A channel does not move.
    Dead {
        /// Its name.
        channel: &'static str,
    },
    /// A channel has the wrong sign.
    Inverted {
        /// Its name.
        channel: &'static str,
    },
    /// Two channels have changed places.
    Swapped {
        /// One of them.
        first: &'static str,
        /// The other.
        second: &'static str,
    },
    /// A channel shows too much or too little.
    Gain {
        /// Its name.
        channel: &'static str,
        /// What it shows over what it should.
        gain: f64,
    },
    /// The table follows too late.
    Delay {
        /// Delay, s.
        delay_s: f64,
    },
    /// No single fault explains it.
    Unexplained {
        /// Largest deviation, relative.
        deviation: f64,
    },
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Dead { channel } => write!(f, "{channel} does not move: sensor dead or not connected"),
            Self::Inverted { channel } => write!(f, "{channel} has the wrong sign"),
            Self::Swapped { first, second } => write!(f, "{first} and {second} have changed places"),
            Self::Gain { channel, gain } => {
                write!(f, "{channel} shows {:.1} % of what it should", 100.0 * gain)
            }
            Self::Delay { delay_s } => write!(f, "the table follows {:.1} ms late", 1e3 * delay_s),
            Self::Unexplained { deviation } => {
                write!(
                    f,
                    "the channels do not fit together (by {:.0} %), and no single fault explains it",
                    100.0 * deviation
                )
            }
        }
    }
}

/// The four ratios that are 1 on a sound rig: table displacement over command (delay taken out), table acceleration
/// over table displacement, each mass accelerometer over the kinematics of table and laser.
pub fn ratios(r: &Response) -> [Complex<f64>; 4] {
    let [x, a, a1, a2, d] = r.channels;
    let w2 = r.w * r.w;
    let delayed = Complex::from_polar(1.0, -r.w * delay_s(r));
    let mass = a - d * w2;
    [x / delayed, a / (-x * w2), a1 / mass, a2 / mass]
}

/// Delay from command to table displacement, s, modulo half a cycle: an inverted sensor is no delay.
pub fn delay_s(r: &Response) -> f64 {
    let half = std::f64::consts::PI;
    let lag = (-r.channels[0].arg()).rem_euclid(half);
    // A little lead is noise, not a delay of half a cycle.
    (if lag > 0.9 * half { lag - half } else { lag }) / r.w
}

fn deviation(r: &Response) -> f64 {
    let worst = ratios(r).iter().map(|ratio| (ratio - 1.0).norm()).fold(0.0, f64::max);
    if worst.is_nan() { f64::INFINITY } else { worst }
}

/// Judges a response; nothing found means that every ratio is within `tolerance` and the delay within
/// `longest_delay_s`.
pub fn judge(r: &Response, tolerance: f64, longest_delay_s: f64) -> Vec<Finding> {
    let delay_s = delay_s(r);
    let mut findings = Vec::new();
    if deviation(r) > tolerance {
        findings.push(explain(r, tolerance));
    } else if delay_s > longest_delay_s {
        findings.push(Finding::Delay { delay_s });
    }
    findings
}

/// The single fault after whose repair everything fits best.
fn explain(r: &Response, tolerance: f64) -> Finding {
    let mut wirings = Vec::new();
    for (i, first) in NAMES.into_iter().enumerate() {
        let mut inverted = *r;
        inverted.channels[i] = -inverted.channels[i];
        wirings.push((inverted, Finding::Inverted { channel: first }));
        for (j, second) in NAMES.into_iter().enumerate().skip(i + 1) {
            let mut swapped = *r;
            swapped.channels.swap(i, j);
            wirings.push((swapped, Finding::Swapped { first, second }));
        }
    }
    let scaled = (0..5).filter_map(|i| {
        let gain = gain(r, i);
        let mut scaled = *r;
        scaled.channels[i] /= gain;
        (gain.is_finite() && gain > 0.0).then_some((scaled, Finding::Gain { channel: NAMES[i], gain }))
    });
    // A gain can be fitted to almost anything, so that a wrong wiring is looked for first.
    best_fit(wirings.into_iter(), tolerance)
        .or_else(|| dead(r).map(|dead| Finding::Dead { channel: NAMES[dead] }))
        .or_else(|| best_fit(scaled, tolerance))
        .unwrap_or(Finding::Unexplained { deviation: deviation(r) })
}

/// Of several repaired responses the one that fits best, if it fits at all.
fn best_fit(repaired: impl Iterator<Item = (Response, Finding)>, tolerance: f64) -> Option<Finding> {
    repaired
        .map(|(response, finding)| (deviation(&response), finding))
        .filter(|(left, _)| *left <= tolerance)
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, finding)| finding)
}

/// A channel that shows less than a fiftieth of what the others make one expect. The mass cannot stand still
/// relative to the table and in space at once.
fn dead(r: &Response) -> Option<usize> {
    let [x, a, a1, a2, d] = r.channels.map(|c| c.norm());
    let w2 = r.w * r.w;
    let table = x.max(a / w2);
    let mass = a1.max(a2);
    let expected = [1.0_f64.max(table), w2 * x.max(1.0), mass.max(0.1 * w2), mass.max(0.1 * w2)];
    (0..4)
        .find(|&i| [x, a, a1, a2][i] < 0.02 * expected[i])
        // The laser is dead when the accelerometers show that the mass moves against the table.
        .or_else(|| (d < 0.02 * (r.channels[2] - r.channels[1]).norm() / w2).then_some(4))
}

/// Gain of one channel that makes the others fit.
fn gain(r: &Response, channel: usize) -> f64 {
    let [x, a, a1, a2, d] = r.channels;
    let w2 = r.w * r.w;
    match channel {
        0 => x.norm(),
        1 => (a / (-x * w2)).norm(),
        2 => (a1 / (a - d * w2)).norm(),
        3 => (a2 / (a - d * w2)).norm(),
        _ => (d * w2 / (a - 0.5 * (a1 + a2))).norm(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A mass on a spring of 1 Hz with 20 % damping, 2 Hz shaking, chain delay 4 ms, all sound.
    fn sound() -> Response {
        let w = std::f64::consts::TAU * 2.0;
        let r = Complex::new(2.0, 0.0);
        let i = Complex::new(0.0, 1.0);
        let x = Complex::from_polar(1.0, -w * 0.004);
        let d = x * r * r / (1.0 - r * r + i * 2.0 * 0.2 * r);
        let a = -x * w * w;
        let mass = a - d * w * w;
        Response { channels: [x, a, mass, mass, d], w }
    }

    #[test]
    fn a_sound_rig_passes_and_its_delay_is_known() {
        let rig = sound();
        assert_eq!(judge(&rig, 0.05, 0.02), []);
        assert!((delay_s(&rig) - 0.004).abs() < 1e-9);
        assert_eq!(judge(&rig, 0.05, 0.003), [Finding::Delay { delay_s: delay_s(&rig) }]);
    }

    #[test]
    fn every_single_fault_is_named() {
        for (i, name) in NAMES.into_iter().enumerate() {
            let mut dead = sound();
            dead.channels[i] *= 1e-3;
            assert_eq!(judge(&dead, 0.05, 0.02), [Finding::Dead { channel: name }]);
            let mut inverted = sound();
            inverted.channels[i] = -inverted.channels[i];
            assert_eq!(judge(&inverted, 0.05, 0.02), [Finding::Inverted { channel: name }]);
            for wrong in [0.5, 2.0] {
                let mut scaled = sound();
                scaled.channels[i] *= wrong;
                let [Finding::Gain { channel, gain }] = judge(&scaled, 0.05, 0.02)[..] else {
                    panic!("{i} {wrong}: {:?}", judge(&scaled, 0.05, 0.02))
                };
                assert_eq!(channel, name);
                assert!((gain / wrong - 1.0).abs() < 1e-6, "{gain}");
            }
            for (j, second) in NAMES.into_iter().enumerate().skip(i + 1) {
                let mut swapped = sound();
                swapped.channels.swap(i, j);
                if (i, j) == (2, 3) {
                    // Two accelerometers on one rigid mass show the same; only yaw would tell them apart.
                    assert_eq!(judge(&swapped, 0.05, 0.02), []);
                } else {
                    let expected = Finding::Swapped { first: name, second };
                    assert_eq!(judge(&swapped, 0.05, 0.02), [expected]);
                }
            }
        }
    }

    #[test]
    fn two_faults_are_not_guessed_at() {
        let mut both = sound();
        both.channels[1] *= 0.5;
        both.channels[4] *= 1.7;
        assert!(matches!(judge(&both, 0.05, 0.02)[..], [Finding::Unexplained { .. }]));
    }
}
