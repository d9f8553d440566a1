//! Records of a component on its own, a displacement imposed and its force measured, from rigs that are not the product's. Integrated here,
//! in fine steps, by nothing of the product.

use crate::forced::noise;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use shaketable::model::{IsolatorSpec, ModelSpec};
use shaketable::record::{Kind, Record};
use std::f64::consts::TAU;

const RATE_HZ: f64 = 250.0;
const FINE: usize = 32;
const SAMPLES: usize = 15_000;

/// A spring with a dashpot, and the sensor of its displacement.
#[derive(Clone, Copy)]
pub struct Rig {
    pub stiffness_n_m: f64,
    pub damping_n_s_m: f64,
    pub displacement_noise_m: f64,
    /// So many of 32 parts of a sample does the sensor of the force come later.
    pub force_late: usize,
}

/// Mostly a spring, its displacement known well.
pub const SPRING: Rig =
    Rig { stiffness_n_m: 2e5, damping_n_s_m: 3e3, displacement_noise_m: 5e-7, force_late: 0 };

/// Mostly a dashpot: the noise of its displacement comes out in the force by way of the velocity.
pub const DASHPOT: Rig =
    Rig { stiffness_n_m: 2e4, damping_n_s_m: 2e4, displacement_noise_m: 2e-5, force_late: 0 };

/// A dashpot that no spring holds back.
pub const FREE_DASHPOT: Rig =
    Rig { stiffness_n_m: 0.0, damping_n_s_m: 5e3, displacement_noise_m: 5e-7, force_late: 0 };

/// A rig as someone takes it to be, some per cent off.
pub fn nominal(rig: Rig) -> ModelSpec {
    ModelSpec {
        name: "component".into(),
        mass_kg: 1.0,
        isolator: IsolatorSpec {
            stiffness_n_m: vec![0.93 * rig.stiffness_n_m],
            breakpoints_m: vec![],
            damping_n_s_m: 1.06 * rig.damping_n_s_m,
        },
        bumper: None,
        effects: vec![],
        uncertainty: None,
    }
}

/// Hysteresis of Bouc and Wen beside a rig's spring and dashpot: stiffness N/m, yield displacement m, sharpness and unloading shape.
pub fn hysteresis(rig: Rig, shape: [f64; 4], seed: u64) -> Record {
    record("hysteresis", rig, seed, yielding(rig, shape))
}

/// The same in runs of cycles that swell and fade, with rests of seconds between them.
pub fn hysteresis_between_rests(rig: Rig, shape: [f64; 4], seed: u64) -> Record {
    const RUNS: [(f64, f64); 5] = [(0.7, 0.006), (1.1, 0.012), (0.5, 0.004), (0.9, 0.015), (1.4, 0.008)];
    const CYCLES: f64 = 5.0;
    let place = |t: f64| {
        // Twelve seconds for each, the last ones at rest.
        let (frequency_hz, amplitude_m) = RUNS[(t / 12.0) as usize % RUNS.len()];
        let turns = frequency_hz * (t % 12.0);
        let swells = turns.min(CYCLES - turns).clamp(0.0, 0.5);
        amplitude_m * (TAU * turns).sin() * (0.5 * TAU * swells).sin().powi(2)
    };
    along("between rests", rig, place, seed, yielding(rig, shape))
}

/// What a rig's spring and dashpot take beside a hysteresis of Bouc and Wen, from one place to the next one.
fn yielding(rig: Rig, [kh, dy, n, gamma]: [f64; 4]) -> impl FnMut([f64; 2], f64) -> f64 {
    let mut z = 0.0_f64;
    move |[x0, x1], h_s| {
        let slope =
            |z: f64| 1.0 - ((1.0 - gamma) * ((x1 - x0) * z).signum() + gamma) * (z / dy).abs().powf(n);
        let half = z + 0.5 * (x1 - x0) * slope(z);
        z += (x1 - x0) * slope(half);
        rig.stiffness_n_m * x1 + rig.damping_n_s_m * (x1 - x0) / h_s + kh * z
    }
}

/// A Maxwell branch, N/m and s, beside a rig's spring and dashpot, pressed to eight places and held at each for seconds.
pub fn pressed_and_held(rig: Rig, [km, tau_s]: [f64; 2], seed: u64) -> Record {
    const PLACES_M: [f64; 9] = [0.0, 0.01, 0.004, 0.012, 0.016, 0.008, 0.0, -0.006, 0.0];
    let place = |t: f64| {
        let at = t / 60.0 * (PLACES_M.len() - 1) as f64;
        let before = (at as usize).min(PLACES_M.len() - 2);
        let part = (8.0 * at.fract()).min(1.0);
        PLACES_M[before] + part * (PLACES_M[before + 1] - PLACES_M[before])
    };
    let mut branch_m = 0.0;
    along("held", rig, place, seed, move |[x0, x1], h_s| {
        let decays = (-h_s / tau_s).exp();
        branch_m = branch_m * decays + tau_s * (1.0 - decays) * (x1 - x0) / h_s;
        rig.stiffness_n_m * x1 + rig.damping_n_s_m * (x1 - x0) / h_s + km * branch_m
    })
}

/// Dry friction beside a rig's spring and dashpot, N.
pub fn friction(rig: Rig, friction_n: f64, seed: u64) -> Record {
    record("friction", rig, seed, move |[x0, x1], h_s| {
        rig.stiffness_n_m * x1 + rig.damping_n_s_m * (x1 - x0) / h_s + friction_n * (x1 - x0).signum()
    })
}

/// A damper whose force grows with a power of the velocity beside a rig's spring and dashpot: N at 1 m/s, and the power.
pub fn orifice(rig: Rig, [force_n, power]: [f64; 2], seed: u64) -> Record {
    record("orifice", rig, seed, move |[x0, x1], h_s| {
        let velocity_m_s = (x1 - x0) / h_s;
        let drag_n = force_n * velocity_m_s.abs().powf(power) * velocity_m_s.signum();
        rig.stiffness_n_m * x1 + rig.damping_n_s_m * velocity_m_s + drag_n
    })
}

/// A rig's spring and dashpot behind a joint with so much play, m: no force while it is open, the element relaxes then.
pub fn joint(rig: Rig, play_m: f64, seed: u64) -> Record {
    let mut element = 0.0_f64;
    record("joint", rig, seed, move |[_, x], h_s| {
        let free = element * (-h_s * rig.stiffness_n_m / rig.damping_n_s_m).exp();
        let next = free.clamp(x - 0.5 * play_m, x + 0.5 * play_m);
        let force = rig.stiffness_n_m * next + rig.damping_n_s_m * (next - element) / h_s;
        element = next;
        if next == free { 0.0 } else { force }
    })
}

/// A rig's spring and dashpot in so many cycles of one frequency, whose amplitude grows from a fifth to the whole, m.
pub fn growing(rig: Rig, frequency_hz: f64, cycles: f64, amplitude_m: f64, seed: u64) -> Record {
    let mut random = Pcg64::seed_from_u64(seed);
    let (w, end_s) = (TAU * frequency_hz, cycles / frequency_hz);
    let mut out = Record::empty("growing", Kind::Component, RATE_HZ);
    for i in 0..(end_s * RATE_HZ) as usize {
        let t = i as f64 / RATE_HZ;
        let (grown, growth) = (amplitude_m * (0.2 + 0.8 * t / end_s), amplitude_m * 0.8 / end_s);
        let (sin, cos) = (w * t).sin_cos();
        let force = rig.stiffness_n_m * grown * sin + rig.damping_n_s_m * (grown * w * cos + growth * sin);
        out.time_s.push(t);
        out.displacement_m.push(grown * sin + noise(&mut random, rig.displacement_noise_m));
        out.force_n.push(force + noise(&mut random, 3e-3 * rig.stiffness_n_m * amplitude_m));
    }
    out
}

/// A rig's spring and dashpot with a cubic spring, N/m3, in cycles of four frequencies, each from one sample to the next: its velocity jumps.
pub fn stepped(rig: Rig, cubic_n_m3: f64, frequencies_hz: [f64; 4], amplitude_m: f64, seed: u64) -> Record {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut out = Record::empty("stepped", Kind::Component, RATE_HZ);
    let mut phase = 0.0_f64;
    for i in 0..SAMPLES {
        let w = TAU * frequencies_hz[4 * i / SAMPLES];
        let (x, v) = (amplitude_m * phase.sin(), amplitude_m * w * phase.cos());
        out.time_s.push(i as f64 / RATE_HZ);
        out.displacement_m.push(x + noise(&mut random, rig.displacement_noise_m));
        let force = rig.stiffness_n_m * x + rig.damping_n_s_m * v + cubic_n_m3 * x.powi(3);
        out.force_n.push(force + noise(&mut random, 5e-4 * rig.stiffness_n_m * amplitude_m));
        phase += w / RATE_HZ;
    }
    out
}

/// A rig's spring and dashpot with dry friction, N, in three runs of six cycles that begin and end of a sudden, with rests of so many seconds
/// about them, through which friction holds.
pub fn rested(rig: Rig, friction_n: f64, rest_s: f64, seed: u64) -> Record {
    const RUNS: [(f64, f64); 3] = [(0.5, 0.01), (0.5, 0.02), (1.0, 0.015)];
    let mut random = Pcg64::seed_from_u64(seed);
    let mut out = Record::empty("rested", Kind::Component, RATE_HZ);
    let mut holds = 0.0;
    for (frequency_hz, amplitude_m) in RUNS {
        let (w, runs) = (TAU * frequency_hz, (6.0 / frequency_hz * RATE_HZ) as usize);
        let rests = (rest_s * RATE_HZ) as usize;
        for i in 0..rests + runs {
            let phase = w * i.saturating_sub(rests) as f64 / RATE_HZ;
            let v = if i < rests { 0.0 } else { amplitude_m * w * phase.cos() };
            let x = amplitude_m * phase.sin();
            holds = if v == 0.0 { holds } else { friction_n * f64::signum(v) };
            out.time_s.push(out.time_s.len() as f64 / RATE_HZ);
            out.displacement_m.push(x + noise(&mut random, rig.displacement_noise_m));
            let force = rig.stiffness_n_m * x + rig.damping_n_s_m * v + holds;
            out.force_n.push(force + noise(&mut random, 10.0));
        }
    }
    out
}

/// Waves of 0.2 to 1.8 Hz and some millimetres for a minute.
fn record(name: &str, rig: Rig, seed: u64, component: impl FnMut([f64; 2], f64) -> f64) -> Record {
    let mut random = Pcg64::seed_from_u64(seed);
    let waves: Vec<(f64, f64)> =
        (0..40).map(|_| (TAU * random.random_range(0.2..1.8), random.random_range(0.0..TAU))).collect();
    // It begins at rest.
    let place =
        |t: f64| t.min(1.0) * 4e-4 * waves.iter().map(|(w, phase)| (w * t + phase).sin()).sum::<f64>();
    along(name, rig, place, random.random(), component)
}

/// A minute along places (m at s), the force of each fine step told by what a component makes of both its ends.
fn along(
    name: &str,
    rig: Rig,
    place: impl Fn(f64) -> f64,
    seed: u64,
    mut component: impl FnMut([f64; 2], f64) -> f64,
) -> Record {
    let mut random = Pcg64::seed_from_u64(seed);
    let h_s = 1.0 / (RATE_HZ * FINE as f64);
    let place = |i: usize| place(i as f64 * h_s);
    let (mut x, mut late) = (place(0), 0.0);
    let mut out = Record::empty(name, Kind::Component, RATE_HZ);
    for i in 0..SAMPLES {
        out.time_s.push(i as f64 / RATE_HZ);
        out.displacement_m.push(x + noise(&mut random, rig.displacement_noise_m));
        out.force_n.push(late + noise(&mut random, 1.0));
        for j in 1..=FINE {
            let next = place(i * FINE + j);
            let force = component([x, next], h_s);
            x = next;
            if j + rig.force_late == FINE {
                late = force;
            }
        }
    }
    out
}
