//! Records of an applied force from rigs that are not the product's: a milligram oscillator at 600 Hz with nine samples a cycle, and a
//! servo axis of a hundred kilograms that nothing holds back. Integrated here, in fine steps, by nothing of the product.

use rand::{Rng, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;
use shaketable::model::{IsolatorSpec, ModelSpec};
use shaketable::record::{Kind, Record};
use std::f64::consts::TAU;

/// A mass on springs that bend, drag and dry friction.
#[derive(Clone, Copy, Debug, Default)]
pub struct Body {
    /// kg.
    pub mass_kg: f64,
    /// N/m.
    pub stiffness_n_m: f64,
    /// N s/m.
    pub damping_n_s_m: f64,
    /// N/m3.
    pub cubic_n_m3: f64,
    /// Damping that grows with the square of the displacement, N s/m3.
    pub growing_n_s_m3: f64,
    /// N.
    pub friction_n: f64,
    /// What pushes it all the time, in the sense of a restoring force, N.
    pub constant_n: f64,
}

impl Body {
    /// Acceleration beside friction, m/s2.
    pub(crate) fn free_m_s2(&self, force_n: f64, x_m: f64, v_m_s: f64) -> f64 {
        let spring_n = self.stiffness_n_m * x_m + self.cubic_n_m3 * x_m.powi(3);
        let dashpot_n_s_m = self.damping_n_s_m + self.growing_n_s_m3 * x_m.powi(2);
        (force_n - self.constant_n - spring_n - dashpot_n_s_m * v_m_s) / self.mass_kg
    }

    /// One fine step of `h_s` with friction: where it turns it goes on from rest, or stays where it is held.
    fn slide(&self, state: &mut (f64, f64), force_n: f64, h_s: f64) {
        let free_n = |x: f64| self.mass_kg * self.free_m_s2(force_n, x, 0.0);
        let sense = match state.1 {
            0.0 if free_n(state.0).abs() <= self.friction_n => return,
            0.0 => free_n(state.0).signum(),
            v => v.signum(),
        };
        let forces = [force_n - self.friction_n * sense; 3];
        let mut next = *state;
        self.swing(&mut next, forces, h_s);
        if next.1 * sense < 0.0 {
            // Velocities run along lines within so short a step.
            let until_s = h_s * state.1 / (state.1 - next.1);
            self.swing(state, forces, until_s);
            state.1 = 0.0;
            let rest_s = h_s - until_s;
            let on_n = free_n(state.0);
            if on_n.abs() > self.friction_n {
                self.swing(state, [force_n - self.friction_n.copysign(on_n); 3], rest_s);
            }
        } else {
            *state = next;
        }
    }

    /// One fine step of `h_s` without friction (Runge and Kutta), the force at its beginning, middle and end.
    pub(crate) fn swing(&self, state: &mut (f64, f64), [f0, f1, f2]: [f64; 3], h_s: f64) {
        let (x, v) = *state;
        let rates = |f: f64, x: f64, v: f64| (v, self.free_m_s2(f, x, v));
        let k1 = rates(f0, x, v);
        let k2 = rates(f1, x + 0.5 * h_s * k1.0, v + 0.5 * h_s * k1.1);
        let k3 = rates(f1, x + 0.5 * h_s * k2.0, v + 0.5 * h_s * k2.1);
        let k4 = rates(f2, x + h_s * k3.0, v + h_s * k3.1);
        state.0 += h_s / 6.0 * (k1.0 + 2.0 * k2.0 + 2.0 * k3.0 + k4.0);
        state.1 += h_s / 6.0 * (k1.1 + 2.0 * k2.1 + 2.0 * k3.1 + k4.1);
    }

    /// A model of its springs and drag that is off by some per cent.
    pub fn nominal(&self, name: &str, seed: u64) -> ModelSpec {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut off = |low: f64, high: f64| {
            let by = random.random_range(low..high);
            if random.random_bool(0.5) { 1.0 + by } else { 1.0 - by }
        };
        ModelSpec {
            name: name.into(),
            mass_kg: self.mass_kg * off(0.0, 0.02),
            isolator: IsolatorSpec {
                stiffness_n_m: vec![self.stiffness_n_m * off(0.05, 0.1)],
                breakpoints_m: vec![],
                damping_n_s_m: self.damping_n_s_m * off(0.05, 0.1),
            },
            bumper: None,
            effects: vec![],
            uncertainty: None,
        }
    }
}

/// Noise of a sensor.
pub(crate) fn noise(random: &mut Pcg64, rms: f64) -> f64 {
    rms * random.sample::<f64, _>(StandardNormal)
}

/// Waves up to 200 Hz drive an oscillator at some 70 Hz for most of a minute, seen 610 times a second by its displacement.
pub fn waves(body: &Body, seed: u64) -> Record {
    driven(body, seed, |record, (x, _), _, random| {
        record.displacement_m.push(x + noise(random, 2e-4));
    })
}

/// The same, seen ten times as well: where the waves end stands out of the noise.
pub fn waves_seen_well(body: &Body, seed: u64) -> Record {
    driven(body, seed, |record, (x, _), _, random| {
        record.displacement_m.push(x + noise(random, 2e-5));
    })
}

/// The same, seen by its acceleration alone.
pub fn felt_waves(body: &Body, seed: u64) -> Record {
    driven(body, seed, |record, (x, v), force_n, random| {
        record.acceleration_m_s2.push(body.free_m_s2(force_n, x, v) + noise(random, 30.0));
    })
}

fn driven(body: &Body, seed: u64, mut see: impl FnMut(&mut Record, (f64, f64), f64, &mut Pcg64)) -> Record {
    const RATE_HZ: f64 = 610.35;
    const FINE: usize = 32;
    const SAMPLES: usize = 24_000;
    const WAVES: usize = 300;
    const RMS_N: f64 = 0.05;
    let mut random = Pcg64::seed_from_u64(seed);
    let waves: Vec<(f64, f64)> =
        (0..WAVES).map(|_| (TAU * random.random_range(1.0..200.0), random.random_range(0.0..TAU))).collect();
    let amplitude_n = RMS_N * (2.0 / WAVES as f64).sqrt();
    // Each wave turns on by half a fine step.
    let half_s = 0.5 / (RATE_HZ * FINE as f64);
    let turns: Vec<(f64, f64)> = waves.iter().map(|(w, _)| (w * half_s).sin_cos()).collect();
    let mut now: Vec<(f64, f64)> = waves.iter().map(|(_, phase)| phase.sin_cos()).collect();
    let mut next = || {
        now.iter_mut()
            .zip(&turns)
            .for_each(|((s, c), (st, ct))| (*s, *c) = (*s * ct + *c * st, *c * ct - *s * st));
        amplitude_n * now.iter().map(|(s, _)| s).sum::<f64>()
    };
    let mut record = Record::empty("waves", Kind::Force, RATE_HZ);
    let (mut state, mut force) = ((0.0, 0.0), next());
    for i in 0..SAMPLES {
        record.time_s.push(i as f64 / RATE_HZ);
        record.force_n.push(force + noise(&mut random, 2e-4));
        see(&mut record, state, force, &mut random);
        for _ in 0..FINE {
            let forces = [force, next(), next()];
            body.swing(&mut state, forces, 2.0 * half_s);
            force = forces[2];
        }
    }
    record
}

/// Blows of a hammer, 12 ms each, every second or two for twenty seconds, seen by force, displacement and acceleration 2000 times a second.
pub fn struck(body: &Body, seed: u64) -> Record {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut blows: Vec<(f64, f64)> = vec![(0.3, 300.0)];
    while let Some((at, _)) = blows.last().filter(|(at, _)| *at < 17.0) {
        blows.push((at + random.random_range(1.2..1.9), random.random_range(160.0..400.0)));
    }
    under_blows(body, &blows, &mut random)
}

/// Blows of a hammer at such instants (s), else as [`struck`].
pub fn struck_at(body: &Body, instants_s: &[f64], seed: u64) -> Record {
    let mut random = Pcg64::seed_from_u64(seed);
    let blows: Vec<_> = instants_s.iter().map(|at| (*at, random.random_range(160.0..400.0))).collect();
    under_blows(body, &blows, &mut random)
}

/// A sine of so much force (N) swept from one frequency to another (Hz), by as many hertz in each of twenty seconds.
pub fn swept(body: &Body, amplitude_n: f64, (from_hz, to_hz): (f64, f64), seed: u64) -> Record {
    let turned = |t: f64| from_hz * t + (to_hz - from_hz) / 40.0 * t * t;
    let force = |t: f64| amplitude_n * (TAU * turned(t)).sin();
    let noises = [1e-3 * amplitude_n, 5e-6, 0.05];
    swinging(body, 0.0, force, (2000.0, noises), &mut Pcg64::seed_from_u64(seed))
}

/// Under blows at such instants (s) with such peaks (N).
fn under_blows(body: &Body, blows: &[(f64, f64)], random: &mut Pcg64) -> Record {
    let force = |t: f64| {
        let of = |(at, peak): &(f64, f64)| match (t - at) / 0.012 {
            x if (0.0..1.0).contains(&x) => peak * 0.5 * (1.0 - (TAU * x).cos()),
            _ => 0.0,
        };
        blows.iter().map(of).sum::<f64>()
    };
    swinging(body, 0.0, force, (2000.0, [0.02, 5e-6, 4e-3]), random)
}

/// Pulled aside by so much and let go, nothing to drive it; seen so many times a second.
pub fn let_go(body: &Body, start_m: f64, rate_hz: f64, seed: u64) -> Record {
    swinging(body, start_m, |_| 0.0, (rate_hz, [0.0, 6e-6, 4e-3]), &mut Pcg64::seed_from_u64(seed))
}

/// Twenty seconds at a rate (Hz); noise of force (N), displacement (m) and acceleration (m/s2), rms.
fn swinging(
    body: &Body,
    start_m: f64,
    force: impl Fn(f64) -> f64,
    (rate_hz, [of_force, of_displacement, of_acceleration]): (f64, [f64; 3]),
    random: &mut Pcg64,
) -> Record {
    const FINE_S: f64 = 1.6e-5;
    let fine = (1.0 / (rate_hz * FINE_S)).ceil() as usize;
    let h_s = 1.0 / (rate_hz * fine as f64);
    let mut record = Record::empty("swinging", Kind::Force, rate_hz);
    let mut state = (start_m, 0.0);
    for i in 0..(20.0 * rate_hz) as usize {
        let t = i as f64 / rate_hz;
        let held = body.friction_n.copysign(state.1) / body.mass_kg;
        let free = body.free_m_s2(force(t), state.0, state.1);
        let still = state.1 == 0.0 && free.abs() <= held.abs();
        record.time_s.push(t);
        record.force_n.push(force(t) + noise(random, of_force));
        record.displacement_m.push(state.0 + noise(random, of_displacement));
        record.acceleration_m_s2.push(if still { 0.0 } else { free - held } + noise(random, of_acceleration));
        for k in 0..fine {
            let at = t + k as f64 * h_s;
            if body.friction_n > 0.0 {
                body.slide(&mut state, force(at), h_s);
            } else {
                body.swing(&mut state, [force(at), force(at + 0.5 * h_s), force(at + h_s)], h_s);
            }
        }
    }
    record
}

/// A converter holds each sample of the force that pushes an axis to and fro for half a minute, 1000 a second; its place is seen to two micrometres.
pub fn held(body: &Body, seed: u64) -> Record {
    const RATE_HZ: f64 = 1000.0;
    const FINE: usize = 32;
    const SAMPLES: usize = 25_000;
    const WAVES_HZ: [f64; 5] = [0.3, 0.7, 1.1, 1.9, 3.1];
    let mut random = Pcg64::seed_from_u64(seed);
    let waves: Vec<(f64, f64, f64)> = WAVES_HZ
        .iter()
        .map(|hz| (TAU * hz, random.random_range(15.0..40.0), random.random_range(0.0..TAU)))
        .collect();
    let mut record = Record::empty("held", Kind::Force, RATE_HZ);
    let mut state = (0.0, 0.0);
    for i in 0..SAMPLES {
        let t = i as f64 / RATE_HZ;
        let force_n = waves.iter().map(|(w, n, phase)| n * (w * t + phase).sin()).sum();
        record.time_s.push(t);
        record.force_n.push(force_n);
        record.displacement_m.push(state.0 + noise(&mut random, 2e-6));
        for _ in 0..FINE {
            body.swing(&mut state, [force_n; 3], 1.0 / (RATE_HZ * FINE as f64));
        }
    }
    record
}

/// A Bouc-Wen hysteresis that grows stiffer as it is loaded, of the benchmark of J.-P. Noel and M. Schoukens (Hysteretic benchmark with a
/// dynamic nonlinearity, Workshop on Nonlinear System Identification Benchmarks, Brussels 2016): mass (kg), stiffness (N/m) and damping
/// (N s/m) beside it, its own stiffness (N/m), what turns it as it is loaded and unloaded (1/m).
pub const STIFFENING: [f64; 6] = [2.0, 5e4, 10.0, 5e4, 0.8e3, -1.1e3];

/// Waves of 5 to 150 Hz, 50 N rms, drive it for some seconds; its displacement is told 750 times a second to eight micrometres, as there.
pub fn stiffening(seed: u64) -> Record {
    const RATE_HZ: f64 = 750.0;
    const FINE: usize = 20;
    const SAMPLES: usize = 6000;
    const WAVES: usize = 400;
    const RMS_N: f64 = 50.0;
    let [mass, stiffness, damping, own, loaded, unloaded] = STIFFENING;
    let mut random = Pcg64::seed_from_u64(seed);
    let waves: Vec<(f64, f64)> =
        (0..WAVES).map(|_| (TAU * random.random_range(5.0..150.0), random.random_range(0.0..TAU))).collect();
    let force = |t: f64| {
        RMS_N
            * (2.0 / WAVES as f64).sqrt()
            * waves.iter().map(|(w, phase)| (w * t + phase).sin()).sum::<f64>()
    };
    let rates = |f: f64, [x, v, z]: [f64; 3]| {
        let turned = loaded * v.abs() * z + unloaded * v * z.abs();
        [v, (f - stiffness * x - damping * v - z) / mass, own * v - turned]
    };
    let on = |at: [f64; 3], by: [f64; 3], h: f64| [0, 1, 2].map(|i| at[i] + h * by[i]);
    let h = 1.0 / (RATE_HZ * FINE as f64);
    let mut record = Record::empty("stiffening", Kind::Force, RATE_HZ);
    let mut state = [0.0; 3];
    let mut now = force(0.0);
    for i in 0..SAMPLES {
        record.time_s.push(i as f64 / RATE_HZ);
        record.force_n.push(now);
        record.displacement_m.push(state[0] + noise(&mut random, 8e-6));
        for k in 0..FINE {
            let t = h * (i * FINE + k) as f64;
            let (middle, end) = (force(t + 0.5 * h), force(t + h));
            let k1 = rates(now, state);
            let k2 = rates(middle, on(state, k1, 0.5 * h));
            let k3 = rates(middle, on(state, k2, 0.5 * h));
            let k4 = rates(end, on(state, k3, h));
            state = [0, 1, 2].map(|i| state[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]));
            now = end;
        }
    }
    record
}

/// A drive moves an axis to and fro between places, and holds it there; its force is told 1000 times a second, its place to a micrometre.
pub fn axis(body: &Body, seed: u64) -> Record {
    const RATE_HZ: f64 = 1000.0;
    const FINE: usize = 32;
    const PLACES_M: [f64; 8] = [0.23, 0.0, 0.1, 0.2, 0.05, 0.23, 0.0, 0.15];
    const EACH_S: f64 = 3.0;
    const PLACE_1_S: f64 = 30.0;
    const SPEED_N_S_M: f64 = 3000.0;
    const STEP_S: f64 = 1.0 / (RATE_HZ * FINE as f64);
    let mut random = Pcg64::seed_from_u64(seed);
    let mut record = Record::empty("axis", Kind::Force, RATE_HZ);
    let (mut state, mut from) = ((0.0, 0.0), 0.0);
    for to in PLACES_M {
        let lasts = random.random_range(0.4..0.8) * EACH_S;
        let force = |t_s: f64, (x, v): (f64, f64)| {
            let part = (t_s / lasts).min(1.0);
            let aim = from + (to - from) * part.powi(3) * (10.0 - 15.0 * part + 6.0 * part * part);
            SPEED_N_S_M * (PLACE_1_S * (aim - x) - v)
        };
        for i in 0..(EACH_S * RATE_HZ) as usize {
            let t_s = i as f64 / RATE_HZ;
            record.time_s.push(record.time_s.len() as f64 / RATE_HZ);
            record.force_n.push(force(t_s, state) + noise(&mut random, 0.3));
            record.displacement_m.push((state.0 / 1e-6).round() * 1e-6);
            for j in 0..FINE {
                let force_n = force(t_s + j as f64 * STEP_S, state);
                body.slide(&mut state, force_n, STEP_S);
            }
        }
        from = to;
    }
    record
}
