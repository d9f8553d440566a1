//! The model driven by what was imposed on the specimen, beside what was measured.

use super::CompareError;
use super::window::Window;
use crate::identify::imposed_on_component;
use crate::identify::motion::{self, ALONG_LINES};
use crate::model::system::System;
use crate::model::{ModelSpec, Observer, Regime, Specimen, build};
use crate::record::quality::white_noise;
use crate::record::{Kind, Record};
use crate::signal::{TableNoise, hann, rising, table_acceleration, table_noise};
use rand::{Rng, SeedableRng};
use serde::Serialize;
use std::ops::Range;

/// How the model was run beside the measurement.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum Method {
    /// From rest at the first sample.
    FromRest,
    /// Along the measured motion up to `from_s`, free from there on: the record starts in motion.
    WarmStart {
        /// End of the imposed motion, s after the first sample.
        from_s: f64,
    },
    /// Nothing holds the mass back: short pieces, each started from the measured state.
    ShortHorizons {
        /// Length of a piece, s.
        horizon_s: f64,
    },
    /// The measured motion was imposed, the force compared.
    Imposed,
}

/// Measured and modelled channels, sample by sample; an absent channel is empty.
#[derive(Clone, Debug, Default)]
pub struct Channels {
    /// Absolute acceleration of the mass, m/s2 (`component`: minus the force over the mass).
    pub measured_a: Vec<f64>,
    /// The model's.
    pub model_a: Vec<f64>,
    /// Displacement, m.
    pub measured_d: Vec<f64>,
    /// The model's.
    pub model_d: Vec<f64>,
    /// Displacement that was imposed (`component`), m.
    pub imposed_d: Vec<f64>,
    /// The model's regime.
    pub regime: Vec<Regime>,
    /// Whether the model is moving towards the side it is on (contact: approaching).
    pub outward: Vec<bool>,
}

/// Measured channels with their zeros taken out, and what drives the model.
pub struct Measured {
    /// Kind of the record.
    pub kind: Kind,
    /// Sample period, s.
    pub dt_s: f64,
    /// Mass of the model, kg.
    pub mass_kg: f64,
    /// Table acceleration that drives the model, m/s2; empty for `component`.
    pub drive: Vec<f64>,
    /// The same as a solver that joins samples by lines is to be given it; empty where that makes no difference.
    lines: Vec<f64>,
    /// Noise of the two sensors that tell the motion of the table together; absent where the accelerometer alone does.
    pub table: Option<TableNoise>,
    /// Acceleration, m/s2.
    pub a: Vec<f64>,
    /// Which of the two accelerometers tell it.
    seen_by: [bool; 2],
    /// Their gain together, as the model has it.
    pub gain_a: f64,
    /// Displacement, m.
    pub d: Vec<f64>,
    /// Its rate where it was imposed (`component`), m/s; empty otherwise.
    imposed_m_s: Vec<f64>,
    /// White noise of the displacement, m.
    noise_m: f64,
    /// Samples of the fastest cycle.
    pub cycle: usize,
}

/// Part of a cycle to either side that tells a state, and times the noise that a cubic leaves there at most to be the motion.
const STATE: usize = 12;
const SMOOTH: f64 = 1.5;

impl Measured {
    /// Takes the channels of a record, by its kind.
    /// # Errors
    /// [`CompareError::Model`] for a model that is refused.
    pub fn of(
        record: &Record,
        spec: &ModelSpec,
        windows: &[Window],
        notes: &mut Vec<String>,
    ) -> Result<Self, CompareError> {
        // That of the effects included.
        let system = System::compile(spec, 1.0 / record.sample_rate_hz)?;
        let mass_kg = system.mass_kg;
        let zeroed = |mut channel: Vec<f64>| {
            let mean = steady_mean(&channel);
            channel.iter_mut().for_each(|x| *x -= mean);
            channel
        };
        let mut table = None;
        let (drive, a, d) = match record.kind {
            Kind::Base => (
                zeroed(driving(record, &mut table)),
                zeroed(record.mass_acceleration_m_s2()),
                record.relative_displacement_m.clone(),
            ),
            Kind::Force => (
                record.force_n.iter().map(|f| -f / mass_kg).collect(),
                zeroed(record.acceleration_m_s2.clone()),
                record.displacement_m.clone(),
            ),
            Kind::Component => (
                Vec::new(),
                record.force_n.iter().map(|f| -f / mass_kg).collect(),
                record.displacement_m.clone(),
            ),
        };
        let rate = record.sample_rate_hz;
        let cycle = windows.iter().filter(|w| w.frequency_hz.is_some()).map(|w| w.cycle_samples(rate)).min();
        let cycle = cycle.unwrap_or_else(|| typical_cycle(if d.is_empty() { &a } else { &d }));
        let d = if record.kind == Kind::Component { d } else { without_offset(d, notes) };
        let short = record.kind == Kind::Base && cycle < ALONG_LINES;
        let lines = if record.kind == Kind::Force || short {
            // Its sign is the table's.
            let over_mass: Vec<f64> = drive.iter().map(|a| -a).collect();
            motion::driving(&over_mass, &d, rate)
        } else {
            Vec::new()
        };
        let seen_by = match record.kind {
            Kind::Base => {
                [&record.mass_acceleration_1_m_s2, &record.mass_acceleration_2_m_s2].map(|a| !a.is_empty())
            }
            Kind::Force | Kind::Component => [true, false],
        };
        let [one, two] = system.instruments.accelerometer_gains;
        let gain_a = match (record.kind, seen_by) {
            (Kind::Component, _) => 1.0,
            (_, [true, false]) => one,
            (_, [false, true]) => two,
            _ => 0.5 * (one + two),
        };
        let noise_m = white_noise(&d);
        // Models are fitted along the same.
        let imposed = (record.kind == Kind::Component).then(|| imposed_on_component(record).ok()).flatten();
        let [d, imposed_m_s] = imposed.unwrap_or([d, Vec::new()]);
        Ok(Self {
            gain_a,
            noise_m,
            kind: record.kind,
            dt_s: 1.0 / rate,
            mass_kg,
            drive,
            lines,
            table,
            a,
            seen_by,
            d,
            imposed_m_s,
            cycle,
        })
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.a.len().max(self.d.len())
    }

    /// Rate of the displacement at a sample, m/s: that which was imposed, or the difference of two neighbouring means, each an
    /// eightieth of `cycle` samples wide, so that noise does not drown it; beyond the last place with
    /// room for both means it goes on as it changed before.
    pub fn velocity(&self, sample: usize, cycle: usize) -> f64 {
        if let Some(v) = self.imposed_m_s.get(sample) {
            return *v;
        }
        let last = self.d.len().saturating_sub(1);
        let wide = (cycle / 80).max(1);
        if last < 3 * wide {
            let (from, to) = (sample.saturating_sub(1), (sample + 1).min(last));
            return (self.d[to] - self.d[from]) / ((to - from).max(1) as f64 * self.dt_s);
        }
        let within = |sample: usize| {
            // The two means are centred half a width before and behind the sample.
            let sum = |range: Range<usize>| range.map(|i| self.d[i]).sum::<f64>();
            let apart = sum(sample + 1..sample + wide + 1) - sum(sample - wide..sample);
            apart / wide as f64 / ((wide + 1) as f64 * self.dt_s)
        };
        let inner = sample.clamp(wide, last - wide);
        let beside = if sample < inner { inner + wide } else { inner - wide };
        let change = if sample == inner { 0.0 } else { within(inner) - within(beside) };
        within(inner) + change * sample.abs_diff(inner) as f64 / wide as f64
    }

    /// Displacement (m) and its rate (m/s) at a sample by the cubic through a sixth of a cycle about it, which noise moves least; nothing
    /// where it leaves more than noise.
    fn state(&self, sample: usize) -> Option<(f64, f64)> {
        let half = self.cycle / STATE;
        let piece = self.d.get(sample.checked_sub(half)?..=sample + half).filter(|_| half > 2)?;
        let at = |i: usize| i as f64 - half as f64;
        let sum = |power: i32| (0..piece.len()).map(|i| at(i).powi(power)).sum::<f64>();
        let of = |power: i32| piece.iter().enumerate().map(|(i, d)| at(i).powi(power) * d).sum::<f64>();
        let (none, two, four, six) = (sum(0), sum(2), sum(4), sum(6));
        let even = none * four - two * two;
        let (d, bend) = ((four * of(0) - two * of(2)) / even, (none * of(2) - two * of(0)) / even);
        let odd = two * six - four * four;
        let (slope, twist) = ((six * of(1) - four * of(3)) / odd, (two * of(3) - four * of(1)) / odd);
        let cubic = |t: f64| d + t * (slope + t * (bend + t * twist));
        let left = piece.iter().enumerate().map(|(i, d)| (d - cubic(at(i))).powi(2)).sum::<f64>();
        let is_motion = left < (SMOOTH * self.noise_m).powi(2) * piece.len() as f64;
        is_motion.then_some((d, slope / self.dt_s))
    }

    /// Length of the imposed beginning, samples: none when the record starts from rest, which the
    /// position and speed over its first tenth of a cycle tell.
    fn imposed_start(&self) -> usize {
        let n = self.d.len();
        let half = self.cycle / 20;
        if half == 0 || 2 * half > n {
            return 0;
        }
        let mean = |range: &[f64]| range.iter().sum::<f64>() / range.len().max(1) as f64;
        let (early, late) = (mean(&self.d[..half]), mean(&self.d[half..2 * half]));
        let rms = (self.d.iter().map(|d| d * d).sum::<f64>() / n.max(1) as f64).sqrt();
        // A neighbour's difference holds the noise and hardly any motion.
        let pairs: Vec<f64> =
            self.d.windows(2).take(self.cycle).map(|pair| (pair[1] - pair[0]).powi(2)).collect();
        let noise = (0.5 * mean(&pairs) / half as f64).sqrt();
        let turn = half as f64 * std::f64::consts::TAU / self.cycle as f64;
        let place = 0.5 * (early + late).abs();
        let speed = (late - early).abs() / turn;
        let moves =
            (place > 0.1 * rms && place > 4.0 * noise) || (speed > 0.1 * rms && speed > 6.0 * noise / turn);
        if moves { (2 * self.cycle).min(n / 5) } else { 0 }
    }
}

/// Acceleration of the table as it drives the model on board, m/s2.
fn driving(record: &Record, noise: &mut Option<TableNoise>) -> Vec<f64> {
    let (x, a) = (&record.table_displacement_m, &record.table_acceleration_m_s2);
    let together = table_acceleration(x, a, record.sample_rate_hz);
    *noise = together.is_some().then(|| TableNoise::of(x, a));
    together.unwrap_or_else(|| a.clone())
}

/// Mean that whole cycles do not enter: weighted with a Hann window over the channel.
fn steady_mean(channel: &[f64]) -> f64 {
    let sum: f64 = channel.iter().zip(hann(channel.len())).map(|(x, weight)| x * weight).sum();
    sum / channel.len().max(1) as f64
}

/// A displacement whose zero is far from the middle of its motion has an arbitrary zero.
fn without_offset(mut d: Vec<f64>, notes: &mut Vec<String>) -> Vec<f64> {
    let mean = steady_mean(&d);
    let rms = (d.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / d.len().max(1) as f64).sqrt();
    if mean.abs() > rms {
        notes.push(format!("displacement has a zero of its own: {mean:.4e} m taken out"));
        d.iter_mut().for_each(|x| *x -= mean);
    }
    d
}

/// Samples between rising crossings of the mean, from the first to the last: a motion that dies out rests for most of its channel.
fn typical_cycle(channel: &[f64]) -> usize {
    let at: Vec<usize> = rising(channel, 0.3).map(|crossing| crossing.above).collect();
    match at[..] {
        [first, .., last] => (last - first) / (at.len() - 1),
        _ => channel.len() / (at.len() + 1),
    }
    .max(1)
}

/// Whether something brings the mass back: a spring, or a cubic one.
pub fn is_held(spec: &ModelSpec) -> bool {
    spec.isolator.stiffness_n_m.first().is_some_and(|k| *k > 0.0)
        || spec.effects.iter().any(|effect| effect.name == "cubic-stiffness")
}

/// Runs the model beside the measurement. `drive_noise` is added to the drive (may be empty).
///
/// # Errors
/// [`CompareError::Model`] for a model that cannot be built.
pub fn simulate(
    measured: &Measured,
    spec: &ModelSpec,
    drive_noise: &[f64],
) -> Result<(Method, Channels, Vec<Range<usize>>), CompareError> {
    let specimen = build(spec, measured.dt_s)?;
    let observer = Observer::new(spec, measured.dt_s)?;
    let n = measured.len();
    let mut run = Run { measured, drive_noise, specimen, observer, out: Channels::default() };
    run.out.model_a.reserve_exact(n);
    run.out.model_d.reserve_exact(n);
    if drive_noise.is_empty() {
        run.out.regime.reserve_exact(n);
        run.out.outward.reserve_exact(n);
    }
    let whole = |from: usize| std::iter::once(from..n).collect::<Vec<_>>();
    let (method, free) = if measured.kind == Kind::Component {
        run.impose(0..n);
        (Method::Imposed, whole(0))
    } else if !is_held(spec) && !measured.d.is_empty() {
        let (sync, horizon) = ((measured.cycle / 4).max(2), (measured.cycle / 4).max(2));
        let mut free = Vec::new();
        let mut at = 0;
        while at < n {
            let (middle, end) = ((at + sync).min(n), (at + sync + horizon).min(n));
            run.impose(at..middle);
            run.step(middle..end);
            free.push(middle..end);
            at = end;
        }
        (Method::ShortHorizons { horizon_s: horizon as f64 * measured.dt_s }, free)
    } else {
        let start = measured.imposed_start();
        run.impose(0..start);
        run.step(start..n);
        let from_s = start as f64 * measured.dt_s;
        (if start > 0 { Method::WarmStart { from_s } } else { Method::FromRest }, whole(start))
    };
    Ok((method, run.out, free))
}

struct Run<'a> {
    measured: &'a Measured,
    drive_noise: &'a [f64],
    specimen: Box<dyn Specimen>,
    observer: Observer,
    out: Channels,
}

impl Run<'_> {
    fn drive(&self, sample: usize) -> f64 {
        let Measured { drive, lines, .. } = self.measured;
        let noise = self.drive_noise.get(sample).copied().unwrap_or(0.0);
        lines.get(sample).or(drive.get(sample)).copied().unwrap_or(0.0) + noise
    }

    fn impose(&mut self, range: Range<usize>) {
        let Some(last) = range.clone().last() else { return };
        for i in range {
            let v = self.measured.velocity(i, self.measured.cycle);
            // What it goes on from as well as it is known.
            let state = if i == last { self.measured.state(i) } else { None };
            let (d, v) = state.unwrap_or((self.measured.d[i], v));
            let response = self.specimen.impose(d, v);
            self.push(i, &response);
        }
        self.specimen.prime(self.drive(last));
    }

    fn step(&mut self, range: Range<usize>) {
        for i in range {
            let drive = self.drive(i);
            let response = self.specimen.step(drive);
            self.push(i, &response);
        }
    }

    fn push(&mut self, sample: usize, response: &crate::model::Response) {
        let mut moved = *response;
        if self.measured.kind == Kind::Force {
            // What the accelerometer is on moves as force and restoring force have it.
            moved.mass_acceleration_m_s2 -= self.measured.drive.get(sample).copied().unwrap_or(0.0);
        }
        let seen = self.observer.observe(&moved);
        let [one, two] = [seen.mass_acceleration_1_m_s2, seen.mass_acceleration_2_m_s2];
        let a = match (self.measured.kind, self.measured.seen_by) {
            // A force sensor knows nothing of the accelerometers' effects.
            (Kind::Component, _) => response.mass_acceleration_m_s2,
            (_, [true, false]) => one,
            (_, [false, true]) => two,
            _ => 0.5 * (one + two),
        };
        self.out.model_a.push(a);
        self.out.model_d.push(seen.relative_displacement_m);
        // Of the run with noise nothing but the channels is asked.
        if self.drive_noise.is_empty() {
            self.out.regime.push(response.regime);
            self.out.outward.push(response.relative_displacement_m * response.relative_velocity_m_s > 0.0);
        }
    }
}

/// Noise like that of the driving channel, once more: what it makes of the response is what the
/// noise already there has made. Empty where the drive is not measured or silent.
///
/// `input_noise` is in the unit of the record's input channel.
pub fn drive_noise(measured: &Measured, input_noise: f64) -> Vec<f64> {
    let sigma = if measured.kind == Kind::Force { input_noise / measured.mass_kg } else { input_noise };
    let white = |sigma: f64, seed: u64| match rand_distr::Normal::new(0.0, sigma) {
        Ok(normal) if sigma > 0.0 => {
            let random = rand_pcg::Pcg64::seed_from_u64(seed);
            random.sample_iter(normal).take(measured.drive.len()).collect()
        }
        _ => Vec::new(),
    };
    match measured.table {
        Some(noise) if sigma > 0.0 => {
            let (mut x, a) = (white(noise.displacement_m, 2), white(sigma, 1));
            x.resize(a.len(), 0.0);
            table_noise(&x, &a, 1.0 / measured.dt_s, noise)
        }
        _ => white(sigma, 1),
    }
}
