//! Signs, units and places of sensors from kinematics alone: D'' = A - a_table, x'' = a_table, and a
//! specimen that takes energy up.
//!
//! Called by [`quality::examine`](super::quality::examine). Each relation is formed in the frequency
//! domain over short windows; a fault (a sign, a power of a thousand, g for m/s2, two channels
//! exchanged) is named when it, and it alone, makes all relations hold.

use super::data::{Kind, Record, Role};
use super::quality::{Finding, Problem, Severity};
use crate::signal::Spectrum;
use realfft::num_complex::Complex64;

/// Relative misfit up to which a relation holds, and that a fault must bring it below.
const HOLDS: f64 = 0.35;
const EXPLAINED: f64 = 0.2;
/// Gains and cross-axis leaks that the comparison of nearly equal accelerations must bear.
const TOLERANCE: f64 = 0.03;
/// How near a fault the table's share in D'' is, relative, and what it may leave, over that share.
const NEAR: f64 = 0.15;
const LEFT: f64 = 0.3;
/// Share of the table's motion that is not the mass's own, at least, for the two to be told apart.
const APART: f64 = 0.1;
/// Windows looked at, and their length in cycles of the input.
const WINDOWS: usize = 12;
const CYCLES: f64 = 10.0;

/// Channels in the order of the matrices.
const CHANNELS: [Role; 5] = [
    Role::TableDisplacement,
    Role::TableAcceleration,
    Role::MassAcceleration1,
    Role::MassAcceleration2,
    Role::RelativeDisplacement,
];

/// Products of all pairs of channels as accelerations (displacements twice differentiated), summed over
/// the strong bins.
#[derive(Clone, Copy, Debug, Default)]
struct Products {
    gram: [[f64; 5]; 5],
    /// Noise power that twice differentiating each displacement brings.
    noise: [f64; 5],
    /// Sum of A conj(D'), of the first and second accelerometer, and of the sizes.
    power: [f64; 2],
    power_size: [f64; 2],
    there: [bool; 5],
}

/// What could be wrong with the wiring.
#[derive(Clone, Copy, Debug)]
enum Fault {
    Sign(usize),
    Unit(usize, f64),
    Swap(usize, usize),
}

/// Findings of a base record (sign, unit, swapped), or of a force record with both motions.
pub(super) fn examine(record: &Record) -> Vec<Finding> {
    match record.kind {
        Kind::Base => base(record),
        Kind::Force if !record.displacement_m.is_empty() && !record.acceleration_m_s2.is_empty() => {
            force(record)
        }
        _ => Vec::new(),
    }
}

fn base(record: &Record) -> Vec<Finding> {
    let channels: [&[f64]; 5] = CHANNELS.map(|role| record.channel(role));
    let Some(products) = products(record, &channels) else { return Vec::new() };
    let sound = misfits(&products, None);
    let worst = sound.iter().copied().fold(0.0, f64::max);
    if worst > HOLDS {
        return vec![name_fault(&products, worst)];
    }
    table_share(&products).or_else(|| energy(&products)).into_iter().collect()
}

/// A sign or unit of the table's acceleration that hides behind a mass that moves far more than the table: both accelerations'
/// shares in D'' are fitted, and the table's is a fault's.
fn table_share(products: &Products) -> Option<Finding> {
    const TABLE: usize = 1;
    const D: usize = 4;
    let gram = |i: usize, j: usize| products.gram[i][j];
    let share = |mass: usize| {
        if !(products.there[mass] && products.there[TABLE] && products.there[D]) {
            return None;
        }
        let determinant = gram(mass, mass) * gram(TABLE, TABLE) - gram(mass, TABLE).powi(2);
        if determinant < APART * gram(mass, mass) * gram(TABLE, TABLE) {
            return None;
        }
        let of_mass = (gram(D, mass) * gram(TABLE, TABLE) - gram(D, TABLE) * gram(mass, TABLE)) / determinant;
        let of_table = (gram(D, TABLE) * gram(mass, mass) - gram(D, mass) * gram(mass, TABLE)) / determinant;
        let left = gram(D, D) - of_mass * gram(D, mass) - of_table * gram(D, TABLE) - 4.0 * products.noise[D];
        let is_told = left < LEFT * LEFT * of_table * of_table * gram(TABLE, TABLE);
        is_told.then_some(-of_table)
    };
    let told = share(2).or_else(|| share(3))?;
    faults(products)
        .find(|fault| {
            let is_near = |factor: f64| (told / factor - 1.0).abs() < NEAR;
            match *fault {
                Fault::Sign(i) => i == TABLE && is_near(-1.0),
                Fault::Unit(i, factor) => i == TABLE && is_near(factor),
                Fault::Swap(..) => false,
            }
        })
        .map(|fault| finding(&fault, format!("{}: D'' = A - a_table tells", describe(&fault)), told))
}

/// The fault that explains a broken relation.
fn name_fault(products: &Products, worst: f64) -> Finding {
    let explained = |fault: &Fault| misfits(products, Some(*fault)).into_iter().fold(0.0, f64::max);
    let mut candidates: Vec<(f64, Fault)> = faults(products)
        .map(|fault| (explained(&fault), fault))
        .filter(|(left, _)| *left < EXPLAINED.min(0.5 * worst))
        .collect();
    // What drops the relations to a like level is parted by energy: a specimen takes it up.
    let passive = |fault: &Fault| dissipation(products, Some(*fault)).is_none_or(|share| share > -0.02);
    let least = candidates.iter().map(|(left, _)| *left).fold(f64::INFINITY, f64::min);
    candidates.retain(|(left, _)| *left < 2.0 * least + 0.03);
    if candidates.iter().any(|(_, fault)| passive(fault)) {
        candidates.retain(|(_, fault)| passive(fault));
    }
    let Some((_, fault)) = candidates.first() else {
        let severity = if worst > 0.7 { Severity::Error } else { Severity::Warning };
        let text = format!(
            "D'' = A - a_table is off by {:.0} %, and no sign, unit or exchange of channels explains it",
            100.0 * worst
        );
        return Finding::new(severity, Problem::Inconsistent, None, text, worst);
    };
    let others: Vec<String> = candidates[1..].iter().map(|(_, fault)| describe(fault)).collect();
    let or = if others.is_empty() { String::new() } else { format!(" (or: {})", others.join("; ")) };
    finding(fault, format!("{}{or}: D'' = A - a_table, x'' = a_table tell", describe(fault)), worst)
}

/// A fault that was told, in a sentence and a figure.
fn finding(fault: &Fault, text: String, figure: f64) -> Finding {
    let (problem, channel) = match *fault {
        Fault::Sign(i) => (Problem::WrongSign, i),
        Fault::Unit(i, _) => (Problem::WrongUnit, i),
        Fault::Swap(i, _) => (Problem::Swapped, i),
    };
    Finding::new(Severity::Error, problem, Some(CHANNELS[channel]), text, figure)
}

fn describe(fault: &Fault) -> String {
    match *fault {
        Fault::Sign(i) => format!("{} has the wrong sign", CHANNELS[i].name()),
        Fault::Unit(i, factor) => {
            let what = if factor < 1.0 { "large" } else { "small" };
            format!("{} is {:.6} times too {what}: wrong unit", CHANNELS[i].name(), factor.max(1.0 / factor))
        }
        Fault::Swap(i, j) => format!("{} and {} are exchanged", CHANNELS[i].name(), CHANNELS[j].name()),
    }
}

/// All single faults of the channels that are there; signs first, for a tie.
fn faults(products: &Products) -> impl Iterator<Item = Fault> {
    let there: Vec<usize> = (0..5).filter(|i| products.there[*i]).collect();
    let g = crate::units::STANDARD_GRAVITY_M_S2;
    let signs = there.clone().into_iter().map(Fault::Sign);
    let units = there.clone().into_iter().flat_map(move |i| {
        let gravity = matches!(i, 1..=3).then_some([g, 1.0 / g]).into_iter().flatten();
        [1e-3, 1e3, 1e-6, 1e6].into_iter().chain(gravity).map(move |factor| Fault::Unit(i, factor))
    });
    let pairs = [(0, 4), (1, 2), (1, 3)];
    let swaps = pairs.into_iter().filter(move |(i, j)| there.contains(i) && there.contains(j));
    signs.chain(units).chain(swaps.map(|(i, j)| Fault::Swap(i, j)))
}

/// Channel that a row of a relation is taken from, and its factor, once the fault is put right.
fn source(channel: usize, fault: Option<Fault>) -> (usize, f64) {
    match fault {
        Some(Fault::Sign(i)) if i == channel => (channel, -1.0),
        Some(Fault::Unit(i, factor)) if i == channel => (channel, factor),
        Some(Fault::Swap(i, j)) if i == channel => (j, 1.0),
        Some(Fault::Swap(i, j)) if j == channel => (i, 1.0),
        _ => (channel, 1.0),
    }
}

/// Relative misfits of the relations whose channels are there.
fn misfits(products: &Products, fault: Option<Fault>) -> Vec<f64> {
    // Left side, then the two of the right: D'' = A1 - a, D'' = A2 - a, x'' = a.
    let relations: [(usize, &[(usize, f64)]); 3] =
        [(4, &[(2, 1.0), (1, -1.0)]), (4, &[(3, 1.0), (1, -1.0)]), (0, &[(1, 1.0)])];
    let there = |i: usize| products.there[source(i, fault).0];
    relations
        .into_iter()
        .filter(|(left, right)| there(*left) && right.iter().all(|(i, _)| there(*i)))
        .map(|(left, right)| misfit(products, fault, left, right))
        .collect()
}

/// Size of left minus right over the sizes of both, tolerances and noise allowed for.
fn misfit(products: &Products, fault: Option<Fault>, left: usize, right: &[(usize, f64)]) -> f64 {
    let mut coefficients = [0.0; 5];
    let (i, factor) = source(left, fault);
    coefficients[i] += factor;
    let left_size = factor * factor * products.gram[i][i];
    let noise = factor * factor * products.noise[i];
    let mut right_only = [0.0; 5];
    let mut tolerance = 0.0;
    for (channel, sign) in right {
        let (i, factor) = source(*channel, fault);
        right_only[i] += sign * factor;
        tolerance += TOLERANCE * TOLERANCE * factor * factor * products.gram[i][i];
    }
    for (coefficient, right) in coefficients.iter_mut().zip(right_only) {
        *coefficient -= right;
    }
    let size = |c: &[f64; 5]| -> f64 {
        (0..5).map(|i| (0..5).map(|j| c[i] * c[j] * products.gram[i][j]).sum::<f64>()).sum()
    };
    let apart = (size(&coefficients) - 4.0 * noise).max(0.0);
    (apart / (left_size + size(&right_only) + tolerance).max(f64::MIN_POSITIVE)).sqrt()
}

/// Mean power that the specimen takes up over what its force and speed could: -A D' over sizes.
fn dissipation(products: &Products, fault: Option<Fault>) -> Option<f64> {
    let accelerometer = if products.there[2] { 0 } else { 1 };
    let sign = |i: usize| source(i, fault).1.signum();
    let share = products.power[accelerometer] / products.power_size[accelerometer].max(f64::MIN_POSITIVE);
    let both = sign(2 + accelerometer) * sign(4);
    // With table and mass exchanged the work of the table acceleration takes the place of that of
    // the mass; the two differ by that of D'' on D', which is nothing.
    products.there[4].then_some(-both * share)
}

/// All relations hold, but the specimen would give off energy: D and the accelerations are turned.
fn energy(products: &Products) -> Option<Finding> {
    let share = dissipation(products, None)?;
    (share < -0.02).then(|| {
        let text = format!(
            "the specimen would give off energy ({:.1} % of force times speed): accelerations and \
             displacements have opposite senses of time, or A stands for the table's",
            -100.0 * share
        );
        Finding::new(Severity::Warning, Problem::Inconsistent, None, text, share)
    })
}

/// Displacement against acceleration of a force record.
fn force(record: &Record) -> Vec<Finding> {
    let channels: [&[f64]; 5] = [&record.displacement_m, &record.acceleration_m_s2, &[], &[], &[]];
    let Some(products) = products(record, &channels) else { return Vec::new() };
    let worst = misfits(&products, None).into_iter().fold(0.0, f64::max);
    if worst <= HOLDS {
        return Vec::new();
    }
    let better = |factor: f64| {
        misfits(&products, Some(Fault::Unit(1, factor))).into_iter().fold(0.0, f64::max) < EXPLAINED
    };
    let (problem, text) = if better(-1.0) {
        (Problem::WrongSign, "displacement_m and acceleration_m_s2 have opposite signs".to_owned())
    } else {
        match [1e-3, 1e3, 1e-6, 1e6].into_iter().find(|factor| better(*factor)) {
            Some(factor) => {
                let text = format!(
                    "acceleration_m_s2 times {factor:e} would be the second derivative of displacement_m: wrong unit"
                );
                (Problem::WrongUnit, text)
            }
            None => (
                Problem::Inconsistent,
                format!(
                    "acceleration_m_s2 is not the second derivative of displacement_m ({:.0} % off)",
                    100.0 * worst
                ),
            ),
        }
    };
    vec![Finding::new(Severity::Error, problem, Some(Role::Acceleration), text, worst)]
}

/// Sums over windows spread over the record; `None` when there is too little to say.
fn products(record: &Record, channels: &[&[f64]; 5]) -> Option<Products> {
    let input = channels[1];
    let length = record.len();
    let cycle = typical_cycle(input)?;
    let window = ((CYCLES * cycle) as usize).clamp(64, length);
    let count = (length / window).clamp(1, WINDOWS);
    let mut sum = Products { there: channels.map(|channel| channel.len() == length), ..Products::default() };
    for k in 0..count {
        let start = if count > 1 { k * (length - window) / (count - 1) } else { 0 };
        let spectra = channels.map(|channel| {
            let piece = if channel.len() == length { &channel[start..start + window] } else { &[] };
            Spectrum::tapered(piece, record.sample_rate_hz)
        });
        add_window(&mut sum, &spectra);
    }
    Some(sum)
}

/// Typical distance of the input's upward crossings, samples.
pub(crate) fn typical_cycle(input: &[f64]) -> Option<f64> {
    let n = input.len().max(1) as f64;
    let mean = input.iter().sum::<f64>() / n;
    let rms = (input.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt();
    let (mut low, mut crossings) = (false, Vec::new());
    for (i, x) in input.iter().enumerate() {
        if x - mean < -0.5 * rms {
            low = true;
        } else if low && x - mean > 0.5 * rms {
            low = false;
            crossings.push(i);
        }
    }
    let mut gaps: Vec<usize> = crossings.windows(2).map(|pair| pair[1] - pair[0]).collect();
    gaps.sort_unstable();
    // The longer ones, so that the windows hold enough cycles of all.
    gaps.get(gaps.len() * 9 / 10).map(|gap| *gap as f64)
}

/// Adds the bins that hold the motion.
fn add_window(sum: &mut Products, spectra: &[Spectrum; 5]) {
    let table = &spectra[1];
    let bins = table.bins.len();
    let bin = |i: usize, k: usize| spectra[i].bins.get(k).copied().unwrap_or_default();
    let strength = |k: usize| bin(1, k).norm_sqr() + bin(2, k).norm_sqr() + bin(3, k).norm_sqr();
    let top = (4..bins).map(strength).fold(0.0, f64::max);
    // White noise of the displacements from the top tenth of the band, where nothing moves.
    let high = bins * 9 / 10..bins;
    let floor = |spectrum: &Spectrum| {
        let piece = spectrum.bins.get(high.clone()).unwrap_or(&[]);
        piece.iter().map(|z| z.norm_sqr()).sum::<f64>() / piece.len().max(1) as f64
    };
    let floors: [f64; 5] = std::array::from_fn(|i| floor(&spectra[i]));
    for k in (4..bins).filter(|k| strength(*k) > 0.01 * top) {
        let w = table.omega_rad_s(k);
        let order = |i: usize| if matches!(i, 0 | 4) { -w * w } else { 1.0 };
        let value: [Complex64; 5] = std::array::from_fn(|i| bin(i, k) * order(i));
        for i in 0..5 {
            for j in 0..5 {
                sum.gram[i][j] += (value[i] * value[j].conj()).re;
            }
            if matches!(i, 0 | 4) {
                sum.noise[i] += w.powi(4) * floors[i];
            }
        }
        let speed = bin(4, k) * Complex64::new(0.0, w);
        for (side, i) in [2, 3].into_iter().enumerate() {
            sum.power[side] += (value[i] * speed.conj()).re;
            sum.power_size[side] += value[i].norm() * speed.norm();
        }
    }
}
