//! Records with a hidden effect: a specimen that carries what the nominal model lacks, nominal
//! numbers that are off, and instruments that are not perfect, all drawn from one seed.

use rand::{Rng, SeedableRng, prelude::Distribution};
use rand_pcg::Pcg64;
use shaketable::diagnose::candidates;
use shaketable::diagnose::next_test::SweepProposal;
use shaketable::identify::together::Setting;
use shaketable::model::effects::{self, Sign};
use shaketable::model::{self, BumperSpec, EffectSpec, IsolatorSpec, ModelSpec, Scales};
use shaketable::record::{Kind, Record};
use shaketable::units::{SAMPLE_RATE_HZ, STANDARD_GRAVITY_M_S2};
use std::f64::consts::TAU;

/// What a hidden case is made of.
#[derive(Clone, Debug)]
pub struct Recipe {
    /// Everything random follows from it.
    pub seed: u64,
    /// Effects that the specimen carries.
    pub effects: Vec<&'static str>,
    /// A force that the catalogue does not have, by its number in [`FOREIGN`].
    pub foreign: Option<usize>,
    /// RMS change of A that each effect makes, relative.
    pub size: f64,
    /// Multiple of 0.01 m/s2 and 30 um of sensor noise.
    pub noise: f64,
    /// How the table moves.
    pub shaking: Shaking,
    /// What sees the mass.
    pub sensors: Sensors,
}

impl Recipe {
    /// A sweep of a specimen that carries effects of the catalogue, with the rig's usual noise.
    pub fn of(seed: u64, effects: &[&'static str], size: f64) -> Self {
        Self {
            seed,
            effects: effects.to_vec(),
            foreign: None,
            size,
            noise: 1.0,
            shaking: Shaking::Sweep,
            sensors: Sensors::All,
        }
    }
}

/// How the table of a record moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shaking {
    /// Steps of a sine, up and down again.
    Sweep,
    /// Noise from below the isolator's frequency to the bumpers', which swells and ebbs as an earthquake does.
    Noise,
}

/// Sensors of the mass; other rigs have fewer than this one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensors {
    /// Two accelerometers and the laser.
    All,
    /// One accelerometer and the laser.
    OneAccelerometer,
    /// One accelerometer alone.
    AccelerometerAlone,
    /// The laser alone.
    LaserAlone,
}

impl Sensors {
    /// Takes the others from a record.
    fn keep(self, record: &mut Record) {
        if self != Self::All {
            record.mass_acceleration_2_m_s2.clear();
        }
        match self {
            Self::All | Self::OneAccelerometer => {}
            Self::AccelerometerAlone => record.relative_displacement_m.clear(),
            Self::LaserAlone => record.mass_acceleration_1_m_s2.clear(),
        }
    }
}

/// A record, the model that someone would have of it, and the truth.
pub struct Hidden {
    /// The measured record.
    pub record: Record,
    /// The model on board.
    pub nominal: ModelSpec,
    /// The specimen.
    pub truth: ModelSpec,
}

/// Effects that a study of single base records goes through: all of the catalogue but those that
/// need a second kind of evidence (the table's own command, a weighed mass, a user's formula).
pub fn studied() -> Vec<&'static str> {
    effects::CATALOGUE
        .iter()
        .map(|e| e.name)
        .filter(|name| !matches!(*name, "mass-error" | "table-interaction" | "expression"))
        .collect()
}

/// An effect with the one that does much the same, if there is one.
pub fn with_twin(name: &'static str) -> Vec<&'static str> {
    std::iter::once(name).chain(candidates::twin(name)).collect()
}

/// Those of them that are no instrument.
pub fn of_motion() -> Vec<&'static str> {
    studied().into_iter().filter(|name| effects::find(name).is_ok_and(|e| !e.is_instrument())).collect()
}

/// Forces that the catalogue does not have, with an amplitude `f` in N over scaled displacement `d/dm` and velocity
/// `v/vm`: what they are, and the expression.
pub const FOREIGN: [(&str, &str); 12] = [
    ("ripple over D", "f*sin(9.42477796076938*d/dm)"),
    ("force on one side only", "f*max(d/dm, 0)^2"),
    ("damping that grows with D", "f*(d/dm)^2*(v/vm)"),
    ("cubic damping", "f*(v/vm)^3"),
    ("friction over a stretch", "f*tanh(20*v/vm)*exp(0-(6*d/dm-3)^2)"),
    ("force that swells", "f*(d/dm)*sin(0.35*t)"),
    ("root damping", "f*(v/vm)/sqrt(0.02+abs(v/vm))"),
    ("spring that saturates", "f*tanh(4*d/dm)"),
    ("spring about the middle", "f*(d/dm)*exp(0-(4*d/dm)^2)"),
    ("damping one way", "f*max(v/vm, 0)^2"),
    ("damping that wears off", "f*(v/vm)*exp(0-t/30)"),
    ("friction that grows with D", "f*(1+4*(d/dm)^2)*tanh(20*v/vm)"),
];

/// Two different physical effects from a seed.
pub fn pair(seed: u64) -> Vec<&'static str> {
    let physical = of_motion();
    let mut random = Pcg64::seed_from_u64(seed ^ 0x5eed);
    let first = random.random_range(0..physical.len());
    let second = (first + random.random_range(1..physical.len())) % physical.len();
    vec![physical[first], physical[second]]
}

/// Makes a case. `None` when the effect cannot reach the size on that specimen.
pub fn make(recipe: &Recipe) -> Option<Hidden> {
    let mut random = Pcg64::seed_from_u64(recipe.seed);
    let needs_bumper = recipe.effects.iter().any(|name| effects::find(name).is_ok_and(|e| e.needs_bumper()));
    let nominal = nominal(&mut random, needs_bumper);
    let acceleration = [0.03, 0.04, 0.05][random.random_range(0..3)] * STANDARD_GRAVITY_M_S2;
    let mut truth = off_nominal(&nominal, &mut random);
    let input = match recipe.shaking {
        Shaking::Sweep => sweep(acceleration),
        Shaking::Noise => noise(acceleration, &mut random),
    };
    for name in &recipe.effects {
        truth = with_effect(&truth, effects::find(name).ok()?, None, recipe.size, &input, &mut random)?;
    }
    if let Some((_, text)) = recipe.foreign.map(|number| FOREIGN[number]) {
        let own = effects::find("expression").ok()?;
        truth = with_effect(&truth, own, Some(text), recipe.size, &input, &mut random)?;
    }
    let mut record = measure(&truth, &input, recipe.noise, &mut random)?;
    recipe.sensors.keep(&mut record);
    Some(Hidden { record, nominal, truth })
}

/// The specimen of a case tested again at 0.04 g, its total gap made wider by so much and its instruments mounted anew.
pub fn again(case: &Hidden, wider_m: f64, seed: u64) -> Option<Hidden> {
    let setting = Setting { wider_m, ..Setting::default() };
    measured_again(case, setting, &sweep(0.04 * STANDARD_GRAVITY_M_S2), seed)
}

/// The specimen of a case put to a proposed test, up and down, its instruments mounted anew.
pub fn tested(case: &Hidden, test: &SweepProposal, seed: u64) -> Option<Hidden> {
    let steps = ((test.stop_hz - test.start_hz) / test.step_hz).round() as usize;
    let up = (0..=steps).map(|i| test.start_hz + test.step_hz * i as f64).collect();
    let input = input(test.acceleration_g * STANDARD_GRAVITY_M_S2, up, f64::from(test.cycles));
    measured_again(case, test.setting(&case.nominal), &input, seed)
}

fn measured_again(case: &Hidden, setting: Setting, input: &Input, seed: u64) -> Option<Hidden> {
    let (nominal, truth) = (setting.of(&case.nominal), setting.of(&case.truth));
    let mut random = Pcg64::seed_from_u64(seed);
    let record = measure(&truth, input, 1.0, &mut random)?;
    Some(Hidden { record, nominal, truth })
}

/// The paper's specimen with one of the bumpers and gaps.
fn nominal(random: &mut Pcg64, needs_bumper: bool) -> ModelSpec {
    let bumpers = [(33e3, 300.0), (175e3, 500.0), (650e3, 1500.0), (0.0, 0.0)];
    let (stiffness, damping) = bumpers[random.random_range(0..if needs_bumper { 3 } else { 4 })];
    let gap = [0.015, 0.020, 0.025, 0.030][random.random_range(0..4)];
    ModelSpec {
        name: "nominal".into(),
        mass_kg: 500.0,
        isolator: IsolatorSpec {
            stiffness_n_m: vec![20e3, 18e3, 2e3],
            breakpoints_m: vec![0.008, 0.040],
            damping_n_s_m: 1100.0,
        },
        bumper: (stiffness > 0.0).then_some(BumperSpec {
            stiffness_n_m: stiffness,
            damping_n_s_m: damping,
            total_gap_m: gap,
        }),
        effects: vec![],
        uncertainty: None,
    }
}

/// Slopes and dampings 5-10 % off, knees up to 6 %, gap up to 2 %.
fn off_nominal(nominal: &ModelSpec, random: &mut Pcg64) -> ModelSpec {
    let mut truth = nominal.clone();
    let mut off = |low: f64, high: f64| {
        let size = random.random_range(low..high);
        1.0 + if random.random_bool(0.5) { size } else { -size }
    };
    for k in &mut truth.isolator.stiffness_n_m {
        *k *= off(0.05, 0.10);
    }
    for knee in &mut truth.isolator.breakpoints_m {
        *knee *= off(0.0, 0.06);
    }
    truth.isolator.damping_n_s_m *= off(0.05, 0.10);
    if let Some(bumper) = &mut truth.bumper {
        bumper.stiffness_n_m *= off(0.05, 0.10);
        bumper.damping_n_s_m *= off(0.05, 0.10);
        bumper.total_gap_m *= off(0.0, 0.02);
    }
    truth
}

/// Input of a coarse sweep up and down: table acceleration and step of each sample.
struct Input {
    acceleration: Vec<f64>,
    displacement: Vec<f64>,
    step: Vec<i32>,
}

fn sweep(amplitude: f64) -> Input {
    input(amplitude, (0..10).map(|i| 0.6 + 0.35 * f64::from(i)).collect(), 10.0)
}

/// A minute of noise of such an rms at its strongest, from 0.3 to 6 Hz, twice swelling and ebbing from rest to rest.
fn noise(rms: f64, random: &mut Pcg64) -> Input {
    const WAVES: usize = 150;
    const DURATION_S: f64 = 60.0;
    let samples = (DURATION_S * SAMPLE_RATE_HZ) as usize;
    let amplitude = rms * (2.0 / WAVES as f64).sqrt();
    let waves: Vec<(f64, f64)> = (0..WAVES)
        .map(|i| {
            let low = 0.3 * 20.0_f64.powf(i as f64 / WAVES as f64);
            let high = 0.3 * 20.0_f64.powf((i + 1) as f64 / WAVES as f64);
            (TAU * random.random_range(low..high), random.random_range(0.0..TAU))
        })
        .collect();
    let mut input = Input { acceleration: vec![], displacement: vec![], step: vec![] };
    let turn = TAU / DURATION_S;
    for n in 0..samples {
        let t = n as f64 / SAMPLE_RATE_HZ;
        // Envelope and its derivatives, of the displacement: the table ends where it began.
        let (sin, cos) = (turn * t).sin_cos();
        let envelope = [sin * sin, 2.0 * turn * sin * cos, 2.0 * turn * turn * (cos * cos - sin * sin)];
        let mut of = [0.0; 3];
        for (w, phase) in &waves {
            let (sin, cos) = (w * t + phase).sin_cos();
            of[0] -= amplitude * sin / (w * w);
            of[1] -= amplitude * cos / w;
            of[2] += amplitude * sin;
        }
        input.displacement.push(envelope[0] * of[0]);
        input.acceleration.push(envelope[2] * of[0] + 2.0 * envelope[1] * of[1] + envelope[0] * of[2]);
    }
    input
}

/// So many cycles at each frequency, up and down again.
fn input(amplitude: f64, up: Vec<f64>, cycles: f64) -> Input {
    let frequencies: Vec<f64> = up.iter().chain(up.iter().rev()).copied().collect();
    let mut input = Input { acceleration: vec![], displacement: vec![], step: vec![] };
    for (k, f) in frequencies.iter().enumerate() {
        let samples = (cycles * SAMPLE_RATE_HZ / f).round() as usize;
        let w = TAU * f;
        for n in 0..samples {
            let s = (w * (n as f64 + 1.0) / SAMPLE_RATE_HZ).sin();
            input.acceleration.push(amplitude * s);
            input.displacement.push(-amplitude / (w * w) * s);
            input.step.push(k as i32);
        }
    }
    input
}

/// Adds an effect with shape parameters drawn at random and the amplitude that changes A by
/// `size`.
fn with_effect(
    truth: &ModelSpec,
    effect: &effects::Effect,
    expression: Option<&str>,
    size: f64,
    input: &Input,
    random: &mut Pcg64,
) -> Option<ModelSpec> {
    let dt = 1.0 / SAMPLE_RATE_HZ;
    let reference = response(truth, &input.acceleration)?;
    let mut scales = Scales::of_spec(truth, dt);
    let peak = |x: &[f64]| 1.5 * rms(x);
    scales.displacement_m = peak(&reference.0);
    scales.acceleration_m_s2 = peak(&reference.1);
    scales.force_n = truth.mass_kg * scales.acceleration_m_s2;
    scales.frequency_hz = 1.5;
    scales.velocity_m_s = scales.displacement_m * TAU * 1.5;
    scales.duration_s = input.acceleration.len() as f64 * dt;
    if let Some(bumper) = &truth.bumper {
        let largest = reference.0.iter().fold(0.0_f64, |m, d| m.max(d.abs()));
        scales.penetration_m = Some((largest - 0.5 * bumper.total_gap_m).max(0.02 * largest));
    }
    let parameters: Vec<_> =
        (effect.parameters)(&scales).into_iter().filter(|p| p.default.is_none()).collect();
    let mut spec = EffectSpec {
        name: effect.name.to_owned(),
        expression: expression.map(str::to_owned),
        parameters: Default::default(),
    };
    for p in &parameters {
        let q = random.random_range(0.35..0.65);
        let (low, high) = p.prior;
        let value = if p.log_scale && low > 0.0 {
            low * (high / low).powf(q)
        } else if p.sign == Sign::Either {
            high * (0.1 + 0.4 * q) * if random.random_bool(0.5) { 1.0 } else { -1.0 }
        } else {
            low + (high - low) * q
        };
        spec.parameters.insert(p.name.to_owned(), value);
    }
    // Shapes that a model file may leave out, from numbers of their own.
    let mut shape = Pcg64::seed_from_u64(random.clone().random::<u64>() ^ 0x05a9e);
    match effect.name {
        "bouc-wen-hysteresis" => {
            let gamma: f64 = shape.random_range(0.0..0.6);
            for (name, value) in
                [("n", 2f64.powf(shape.random_range(0.0..1.0))), ("beta", 1.0 - gamma), ("gamma", gamma)]
            {
                spec.parameters.insert(name.to_owned(), value);
            }
        }
        "stand-compliance" => {
            spec.parameters.insert("zeta".to_owned(), shape.random_range(0.01..0.05));
        }
        _ => {}
    }
    // A gain is off by the size itself.
    if effect.is_instrument()
        && let Some(gain) = spec.parameters.get_mut("gain")
    {
        *gain = if random.random_bool(0.5) { 1.0 + size } else { 1.0 - size };
        let mut with = truth.clone();
        with.effects.push(spec);
        return Some(with);
    }
    // Bisect the leading parameter, or what takes its place, on a logarithmic scale.
    let leading = match (expression, parameters.first()) {
        (Some(_), _) => {
            for (name, value) in
                [("dm", scales.displacement_m), ("vm", scales.velocity_m_s), ("f", 0.1 * scales.force_n)]
            {
                if expression.is_some_and(|text| text.contains(name)) {
                    spec.parameters.insert(name.to_owned(), value);
                }
            }
            "f"
        }
        (None, first) => first?.name,
    };
    let start = spec.parameters.clone();
    let grown = |factor: f64| {
        let mut spec = spec.clone();
        let mut set = |name: &str, value: f64| spec.parameters.insert(name.to_owned(), value);
        match (effect.name, scales.penetration_m) {
            // Breakaway friction stays above the sliding one by as much.
            ("stribeck-friction", _) => {
                set("fc_n", start["fc_n"] * factor);
                set("fs_n", start["fs_n"].max(1.3 * start["fc_n"]) * factor);
            }
            // A stand is seen the more the softer it is.
            ("stand-compliance", _) => {
                set("ks_n_m", start["ks_n_m"] / factor);
            }
            // As stiff as the linear bumper at the usual penetration, more and more bent.
            ("hertz-contact", Some(_)) => {
                let n = (1.0 + 0.3 * factor).min(3.0);
                set("n", n);
                set("kh", scales.contact_coefficient(n));
            }
            _ => {
                set(leading, start[leading] * factor);
            }
        }
        spec
    };
    let change = |factor: f64| -> Option<f64> {
        let mut with = truth.clone();
        with.effects.push(grown(factor));
        let changed = response(&with, &input.acceleration)?;
        let over = |a: &[f64], b: &[f64], of: &[f64]| {
            rms(&a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<f64>>()) / rms(of)
        };
        let of_a =
            over(&reference.1, &changed.1, &reference.1).max(over(&reference.2, &changed.2, &reference.1));
        Some(of_a.max(over(&reference.0, &changed.0, &reference.0)))
    };
    let (mut low, mut high) = (1e-4_f64, 30.0_f64);
    for _ in 0..14 {
        let middle = (low * high).sqrt();
        match change(middle) {
            Some(c) if c < size => low = middle,
            _ => high = middle,
        }
    }
    let reached = change((low * high).sqrt())?;
    if !(0.5..2.0).contains(&(reached / size)) {
        return None;
    }
    let mut with = truth.clone();
    with.effects.push(grown((low * high).sqrt()));
    Some(with)
}

fn rms(x: &[f64]) -> f64 {
    (x.iter().map(|v| v * v).sum::<f64>() / x.len().max(1) as f64).sqrt()
}

/// D, mean A and half the difference of both A as the instruments would show them without noise.
fn response(spec: &ModelSpec, input: &[f64]) -> Option<(Vec<f64>, Vec<f64>, Vec<f64>)> {
    let channels = observed(spec, input)?;
    let of = |channel: &dyn Fn(&(f64, f64, f64)) -> f64| channels.iter().map(channel).collect();
    Some((of(&|o| o.0), of(&|o| 0.5 * (o.1 + o.2)), of(&|o| 0.5 * (o.1 - o.2))))
}

fn observed(spec: &ModelSpec, input: &[f64]) -> Option<Vec<(f64, f64, f64)>> {
    let dt = 1.0 / SAMPLE_RATE_HZ;
    let mut specimen = model::build(spec, dt).ok()?;
    let mut observer = model::Observer::new(spec, dt).ok()?;
    specimen.reset();
    let mut out = Vec::with_capacity(input.len());
    for a in input {
        let o = observer.observe(&specimen.step(*a));
        if !o.relative_displacement_m.is_finite() {
            return None;
        }
        out.push((o.relative_displacement_m, o.mass_acceleration_1_m_s2, o.mass_acceleration_2_m_s2));
    }
    Some(out)
}

/// Adds sensor zeros, a leak of table acceleration, slow noise, white noise.
fn measure(truth: &ModelSpec, input: &Input, noise: f64, random: &mut Pcg64) -> Option<Record> {
    let channels = observed(truth, &input.acceleration)?;
    let normal = rand_distr::StandardNormal;
    let zeros: [f64; 3] = std::array::from_fn(|_| random.random_range(-0.02..0.02));
    let laser_zero = random.random_range(-2e-5..2e-5);
    let leak = [random.random_range(-0.002..0.002), random.random_range(-0.002..0.002)];
    let n = input.acceleration.len();
    let (sa, sd) = (0.01 * noise, 30e-6 * noise);
    // Slow noise: first-order, 5 s, a fifth of the white one for the laser.
    let (decay, mut slow) = ((-1.0 / (5.0 * SAMPLE_RATE_HZ)).exp(), 0.0);
    let mut white = |s: f64| -> f64 {
        let z: f64 = normal.sample(random);
        s * z
    };
    let mut record = Record::empty("hidden", Kind::Base, SAMPLE_RATE_HZ);
    record.time_s = (0..n).map(|i| i as f64 / SAMPLE_RATE_HZ).collect();
    record.step.clone_from(&input.step);
    for (i, (d, a1, a2)) in channels.iter().enumerate() {
        let table = input.acceleration[i];
        slow = decay * slow + white(0.2 * sd * (1.0 - decay * decay).sqrt());
        record.table_displacement_m.push(input.displacement[i] + white(1e-5 * noise));
        record.table_acceleration_m_s2.push(table + zeros[0] + white(sa));
        record.mass_acceleration_1_m_s2.push(a1 + leak[0] * table + zeros[1] + white(sa));
        record.mass_acceleration_2_m_s2.push(a2 + leak[1] * table + zeros[2] + white(sa));
        record.relative_displacement_m.push(d + laser_zero + slow + white(sd));
    }
    Some(record)
}
