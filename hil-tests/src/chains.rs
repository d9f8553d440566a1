//! Base records as other laboratories make them: few samples a cycle, filters against aliases, accelerometers that block what is slow. Integrated
//! and filtered here, in fine steps, by nothing of the product.

use crate::forced::{Body, noise};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use shaketable::record::{Kind, Record};
use std::f64::consts::TAU;

/// Fine steps in a sample.
const FINE: usize = 32;
/// Frequencies of the steps over that of the mass, and their length in cycles.
const STEPS: [f64; 7] = [0.5, 0.7, 0.85, 1.0, 1.1, 1.3, 1.6];
const CYCLES: f64 = 40.0;
/// Amplitude of the table, m/s2.
const TABLE_M_S2: f64 = 0.3;

/// What lies between the mass and the file.
#[derive(Clone, Copy, Debug)]
pub struct Chain {
    /// Samples a second, Hz.
    pub rate_hz: f64,
    /// Corner of a Butterworth filter of fourth order before each converter, Hz.
    pub against_aliases_hz: Option<f64>,
    /// Corner below which the accelerometers on the mass, and the table's, see nothing, Hz.
    pub blocks_hz: [Option<f64>; 2],
    /// Whether there is an accelerometer on the mass.
    pub accelerometer: bool,
    /// Noise of each sensor over the rms of what it sees.
    pub noise: f64,
}

/// A stepped sine of a mass, seen through a chain.
pub fn stepped(body: &Body, chain: Chain, seed: u64) -> Record {
    let (own_hz, h_s) = (own_hz(body), chain.fine_s());
    let mut steps = Vec::new();
    let mut turns = Vec::new();
    for (step, share) in STEPS.into_iter().enumerate() {
        let turn = share * own_hz * h_s;
        let count = (CYCLES / turn / FINE as f64) as usize * FINE;
        steps.resize(steps.len() + count / FINE, i32::try_from(step).unwrap_or(-1));
        turns.resize(turns.len() + count, turn);
    }
    Record { step: steps, ..driven(body, chain, seed, &turns) }
}

/// A sine of a mass swept from a quarter of its frequency to so many times that within so many seconds, by as many octaves in each, seen through a
/// chain.
pub fn swept(body: &Body, chain: Chain, seed: u64, (times, seconds): (f64, f64)) -> Record {
    let (own_hz, h_s) = (own_hz(body), chain.fine_s());
    let count = (seconds / h_s) as usize / FINE * FINE;
    let turn = |i: usize| 0.25 * own_hz * h_s * (4.0 * times).powf(i as f64 / count as f64);
    let record = driven(body, chain, seed, &(0..count).map(turn).collect::<Vec<f64>>());
    Record { step: vec![-1; record.time_s.len()], ..record }
}

fn own_hz(body: &Body) -> f64 {
    (body.stiffness_n_m / body.mass_kg).sqrt() / TAU
}

impl Chain {
    /// Length of a fine step, s.
    fn fine_s(&self) -> f64 {
        1.0 / (self.rate_hz * FINE as f64)
    }
}

/// A mass on a table that turns by so much of a cycle in each fine step, seen through a chain.
fn driven(body: &Body, chain: Chain, seed: u64, turns: &[f64]) -> Record {
    let h_s = chain.fine_s();
    let mut channels = [const { Vec::new() }; 3];
    let (mut state, mut turned) = ((0.0, 0.0), 0.0);
    for turn in turns {
        let table = |part: f64| TABLE_M_S2 * (TAU * (turned + part * turn)).sin();
        let seen = table(0.0);
        let forces = [seen, table(0.5), table(1.0)].map(|a| -body.mass_kg * a);
        let relative_m_s2 = body.free_m_s2(forces[0], state.0, state.1);
        for (channel, x) in channels.iter_mut().zip([state.0, relative_m_s2 + seen, seen]) {
            channel.push(x);
        }
        body.swing(&mut state, forces, h_s);
        turned += turn;
    }
    let mut random = Pcg64::seed_from_u64(seed);
    let blocks = [None, chain.blocks_hz[0], chain.blocks_hz[1]];
    let [displacement, mass, table]: [Vec<f64>; 3] = std::array::from_fn(|i| {
        let mut channel = std::mem::take(&mut channels[i]);
        let rms = (channel.iter().map(|x| x * x).sum::<f64>() / channel.len() as f64).sqrt();
        if let Some(corner_hz) = blocks[i] {
            block(&mut channel, TAU * corner_hz * h_s);
        }
        let Some(corner_hz) = chain.against_aliases_hz else {
            return channel.iter().step_by(FINE).map(|x| x + noise(&mut random, chain.noise * rms)).collect();
        };
        // What reaches the converter's band is as white there as without the filter.
        channel.iter_mut().for_each(|x| *x += noise(&mut random, chain.noise * rms * (FINE as f64).sqrt()));
        low_pass(&mut channel, TAU * corner_hz * h_s);
        channel.into_iter().step_by(FINE).collect()
    });
    let mut record = Record::empty("driven", Kind::Base, chain.rate_hz);
    record.time_s = (0..displacement.len()).map(|i| i as f64 / chain.rate_hz).collect();
    (record.relative_displacement_m, record.table_acceleration_m_s2) = (displacement, table);
    if chain.accelerometer {
        record.mass_acceleration_1_m_s2 = mass;
    }
    record
}

/// `y' + w y = x'`, exact along lines between fine steps; `w` in radians a step.
fn block(channel: &mut [f64], w: f64) {
    let (kept, passes) = ((-w).exp(), (1.0 - (-w).exp()) / w);
    let (mut last, mut out) = (channel[0], channel[0]);
    for x in channel {
        out = kept * out + passes * (*x - last);
        last = std::mem::replace(x, out);
    }
}

/// Butterworth's filter of fourth order (bilinear); its corner in radians a step.
fn low_pass(channel: &mut [f64], w: f64) {
    for quality in [0.541_196_1, 1.306_563] {
        let (sin, cos) = w.sin_cos();
        let alpha = sin / (2.0 * quality);
        let b = 0.5 * (1.0 - cos) / (1.0 + alpha);
        let (a1, a2) = (-2.0 * cos / (1.0 + alpha), (1.0 - alpha) / (1.0 + alpha));
        let (mut x1, mut x2, mut y1, mut y2) = (0.0, 0.0, 0.0, 0.0);
        for x in channel.iter_mut() {
            let y = b * (*x + 2.0 * x1 + x2) - a1 * y1 - a2 * y2;
            (x2, x1, y2, y1) = (x1, *x, y1, y);
            *x = y;
        }
    }
}
