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
const STIFFNESS_N_M: f64 = 2e5;
const DAMPING_N_S_M: f64 = 3e3;

/// A spring with a dashpot as someone takes it to be, some per cent off.
pub fn nominal() -> ModelSpec {
    ModelSpec {
        name: "component".into(),
        mass_kg: 1.0,
        isolator: IsolatorSpec {
            stiffness_n_m: vec![0.93 * STIFFNESS_N_M],
            breakpoints_m: vec![],
            damping_n_s_m: 1.06 * DAMPING_N_S_M,
        },
        bumper: None,
        effects: vec![],
        uncertainty: None,
    }
}

/// Hysteresis of Bouc and Wen beside a spring and a dashpot: stiffness N/m, yield displacement m, sharpness and unloading shape.
pub fn hysteresis([kh, dy, n, gamma]: [f64; 4], seed: u64) -> Record {
    let mut z = 0.0_f64;
    record("hysteresis", seed, move |[x0, x1], h_s| {
        let slope =
            |z: f64| 1.0 - ((1.0 - gamma) * ((x1 - x0) * z).signum() + gamma) * (z / dy).abs().powf(n);
        let half = z + 0.5 * (x1 - x0) * slope(z);
        z += (x1 - x0) * slope(half);
        STIFFNESS_N_M * x1 + DAMPING_N_S_M * (x1 - x0) / h_s + kh * z
    })
}

/// A spring with a dashpot behind a joint with so much play, m: no force while it is open, the element relaxes then.
pub fn joint(play_m: f64, seed: u64) -> Record {
    let mut element = 0.0_f64;
    record("joint", seed, move |[_, x], h_s| {
        let free = element * (-h_s * STIFFNESS_N_M / DAMPING_N_S_M).exp();
        let next = free.clamp(x - 0.5 * play_m, x + 0.5 * play_m);
        let force = STIFFNESS_N_M * next + DAMPING_N_S_M * (next - element) / h_s;
        element = next;
        if next == free { 0.0 } else { force }
    })
}

/// Waves of 0.2 to 1.8 Hz and some millimetres for a minute, the force of each fine step told by what a component makes of both its ends.
fn record(name: &str, seed: u64, mut component: impl FnMut([f64; 2], f64) -> f64) -> Record {
    let mut random = Pcg64::seed_from_u64(seed);
    let waves: Vec<(f64, f64)> =
        (0..40).map(|_| (TAU * random.random_range(0.2..1.8), random.random_range(0.0..TAU))).collect();
    let h_s = 1.0 / (RATE_HZ * FINE as f64);
    let place = |i: usize| {
        let t = i as f64 * h_s;
        // It begins at rest.
        t.min(1.0) * 4e-4 * waves.iter().map(|(w, phase)| (w * t + phase).sin()).sum::<f64>()
    };
    let (mut x, mut force) = (place(0), 0.0);
    let mut out = Record::empty(name, Kind::Component, RATE_HZ);
    for i in 0..SAMPLES {
        out.time_s.push(i as f64 / RATE_HZ);
        out.displacement_m.push(x + noise(&mut random, 5e-7));
        out.force_n.push(force + noise(&mut random, 1.0));
        for j in 1..=FINE {
            let next = place(i * FINE + j);
            force = component([x, next], h_s);
            x = next;
        }
    }
    out
}
