//! Where, when and in which regime a model fails, judged offline from a record.
//!
//! [`compare`] drives the model with what was imposed on the specimen, puts model and measurement
//! through the same band-pass and tells their difference by step, direction, amplitude, phase and
//! regime, against the noise floor of the record. The command line and reports call it.
//!
//! NRMSE is the RMS of the residual over the RMS of the measurement, both over the counted samples:
//! the last whole cycles of each step, or a whole record that has no steps.

mod band;
mod force;
mod harmonics;
mod noise;
mod response;
mod sentence;
mod slices;
#[cfg(test)]
mod tests;
mod window;

pub use force::ForceMap;
pub use harmonics::HarmonicMisfit;
pub use noise::{NoiseFloor, noise_floor};
pub use response::{Channels, Method};
pub use slices::Slice;
pub use window::{Window, windows};

use crate::model::{ModelError, ModelSpec};
use crate::record::quality::{self, Finding};
use crate::record::{Kind, Record};
use crate::sweep::Direction;
use band::Band;
use force::ResidualForce;
use response::Measured;
use serde::Serialize;
use slices::{Cells, Sums, nrmse};
use std::ops::Range;

/// Why a comparison could not be made.
#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    /// The model was refused.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The record lacks what its kind needs.
    #[error("{record}: {reason}")]
    Record {
        /// Where the record came from.
        record: String,
        /// What is missing.
        reason: String,
    },
    /// The simulation left the range of numbers.
    #[error("the response of model `{0}` is not finite from {1:.3} s on")]
    Diverged(String, f64),
}

/// Overall error and noise floor, in NRMSE; absent where nothing was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Error {
    /// Of the acceleration A (`component`: of the force over the mass).
    pub nrmse_a: Option<f64>,
    /// Of the displacement D.
    pub nrmse_d: Option<f64>,
    /// Of the force (`component`).
    pub nrmse_force: Option<f64>,
    /// What noise alone would leave in A.
    pub noise_floor_a: Option<f64>,
    /// What noise alone would leave in D.
    pub noise_floor_d: Option<f64>,
    /// RMS of the measured A, m/s2.
    pub rms_a_m_s2: Option<f64>,
    /// RMS of the measured D, m.
    pub rms_d_m: Option<f64>,
}

/// The misfit of one step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StepMisfit {
    /// Index of the step.
    pub index: i32,
    /// Rising or falling frequency.
    pub direction: Option<Direction>,
    /// Frequency of the excitation, Hz.
    pub frequency_hz: Option<f64>,
    /// First counted sample, s after the start of the record.
    pub from_s: f64,
    /// Error of A.
    pub nrmse_a: Option<f64>,
    /// Error of D.
    pub nrmse_d: Option<f64>,
    /// RMS of the measured A, m/s2.
    pub rms_a_measured_m_s2: Option<f64>,
    /// RMS of the residual of A, m/s2.
    pub rms_a_residual_m_s2: Option<f64>,
    /// RMS of the measured D, m.
    pub rms_d_measured_m: Option<f64>,
    /// RMS of the residual of D, m.
    pub rms_d_residual_m: Option<f64>,
    /// Largest magnitude of A, measured, m/s2.
    pub a_max_m_s2: Option<f64>,
    /// The model's.
    pub model_a_max_m_s2: Option<f64>,
    /// Excursion of D, measured, m.
    pub excursion_m: Option<f64>,
    /// The model's.
    pub model_excursion_m: Option<f64>,
    /// RMS residual force along the measured motion, N.
    pub force_residual_n: Option<f64>,
    /// Fundamental and harmonics of A.
    pub harmonics_a: Vec<HarmonicMisfit>,
    /// Fundamental and harmonics of D.
    pub harmonics_d: Vec<HarmonicMisfit>,
}

/// Everything that [`compare`] finds.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// The record.
    pub record: String,
    /// Name of the model.
    pub model: String,
    /// Kind of the record.
    pub kind: Kind,
    /// How the model was run.
    pub method: Method,
    /// Band-pass of both sides, Hz; absent when nothing is filtered.
    pub band_hz: Option<[f64; 2]>,
    /// Overall error.
    pub error: Error,
    /// By step.
    pub steps: Vec<StepMisfit>,
    /// By regime; parts overlap.
    pub regimes: Vec<Slice>,
    /// By sweep direction.
    pub directions: Vec<Slice>,
    /// By phase of the excitation's cycle, twelfths.
    pub phases: Vec<Slice>,
    /// By momentary magnitude of D, quarters of the largest.
    pub amplitudes: Vec<Slice>,
    /// By thirds of the record.
    pub times: Vec<Slice>,
    /// Residual force over displacement and velocity.
    pub residual_force: Option<ForceMap>,
    /// What is wrong with the record itself; to be read before the rest.
    pub quality: Vec<Finding>,
    /// Where most of the misfit lives.
    pub sentence: String,
    /// What was noticed or repaired.
    pub notes: Vec<String>,
    /// The compared channels, for plots.
    #[serde(skip)]
    pub channels: Channels,
    /// The counted stretches.
    #[serde(skip)]
    pub windows: Vec<Window>,
}

/// Compares a record with a model.
///
/// # Errors
/// [`CompareError`] when the record lacks what its kind needs, the model is refused or diverges.
pub fn compare(record: &Record, spec: &ModelSpec) -> Result<Comparison, CompareError> {
    check(record)?;
    let rate = record.sample_rate_hz;
    let windows = windows(record);
    let mut notes = record.notes.clone();
    let measured = Measured::of(record, spec, &windows, &mut notes)?;
    let held = measured.kind == Kind::Component || measured.d.is_empty() || response::is_held(spec);
    if !held {
        notes.push(
            "nothing holds the mass back: judged over short horizons from the measured state".to_owned(),
        );
    }
    let band = if held { Band::of(record, &windows) } else { None };
    let floor = noise::in_band(record, &windows, band.as_ref());
    let hiss = response::drive_noise(&measured, floor.input);
    let (simulated, hissing, force, quality) = std::thread::scope(|scope| {
        let hissing = scope.spawn(|| {
            if hiss.is_empty() {
                None
            } else {
                response::simulate(&measured, spec, &hiss).ok().map(|run| run.1)
            }
        });
        let force = scope.spawn(|| force::residual(&measured, spec, &windows));
        let quality = scope.spawn(|| quality::examine(record));
        let simulated = response::simulate(&measured, spec, &[]);
        (simulated, hissing.join(), force.join(), quality.join())
    });
    let (method, mut channels, free) = simulated?;
    let mut hissing = hissing.ok().flatten();
    let force = match force {
        Ok(force) => force?,
        Err(panic) => std::panic::resume_unwind(panic),
    };
    if let Some(at) = channels.model_a.iter().position(|a| !a.is_finite()) {
        return Err(CompareError::Diverged(spec.name.clone(), at as f64 / rate));
    }
    (channels.measured_a, channels.measured_d) = (measured.a, measured.d);
    if record.kind == Kind::Component {
        // The displacement is imposed: there is nothing to compare.
        channels.measured_d.clear();
    }
    if let Some(band) = &band {
        filter(&mut channels, band, rate);
        if let Some(other) = &mut hissing {
            filter(other, band, rate);
        }
    }
    let delay = band.as_ref().map_or(0, |band| band.delay_samples(rate));
    let gathered = gather(&windows, &channels, &free, delay, rate);
    let error = overall(
        record.kind,
        &gathered.cells.total(),
        &floor,
        spec.mass_kg,
        hissing.map(|other| propagated(&windows, &channels, &other)),
    );
    let steps = steps(&windows, &gathered.windows, &channels, force.as_ref(), rate);
    let sentence = sentence::sentence(force.as_ref().map(|f| &f.cells), &gathered.cells, &windows, &steps);
    Ok(Comparison {
        record: record.source.clone(),
        model: spec.name.clone(),
        kind: record.kind,
        method,
        band_hz: band.map(|band| [band.low_hz, band.high_hz]),
        error,
        steps,
        regimes: regimes(&gathered.cells, force.as_ref()),
        directions: gathered.directions(&windows),
        phases: gathered.named(&gathered.phases, |i| format!("{}-{} deg", 30 * i, 30 * (i + 1))),
        amplitudes: gathered
            .named(&gathered.amplitudes, |i| format!("|D| {}-{} % of the largest", 25 * i, 25 * (i + 1))),
        times: gathered
            .named(&gathered.times, |i| ["first third", "middle third", "last third"][i.min(2)].to_owned()),
        residual_force: force.map(|force| force.map),
        quality: quality.unwrap_or_default(),
        sentence,
        notes,
        channels,
        windows,
    })
}

/// Regimes of the simulation with the shares of the residual force, whose regimes are those of the
/// measured motion.
fn regimes(response: &Cells, force: Option<&ResidualForce>) -> Vec<Slice> {
    let mut slices = response.slices();
    for along in force.map(|force| force.cells.slices()).unwrap_or_default() {
        match slices.iter_mut().find(|slice| slice.name == along.name) {
            Some(slice) => {
                slice.share_of_misfit_force = along.share_of_misfit_force;
                slice.force_rms_n = along.force_rms_n;
            }
            None => slices.push(along),
        }
    }
    slices
}

fn check(record: &Record) -> Result<(), CompareError> {
    let refuse = |reason: String| Err(CompareError::Record { record: record.source.clone(), reason });
    let n = record.len();
    if n < 32 {
        return refuse(format!("{n} samples are too few to compare; at least 32 are needed"));
    }
    if record.input().len() != n {
        return refuse(match record.kind {
            Kind::Base => "a `base` record needs table_acceleration_m_s2".to_owned(),
            Kind::Force => "a `force` record needs force_n".to_owned(),
            Kind::Component => "a `component` record needs displacement_m".to_owned(),
        });
    }
    let measured = match record.kind {
        Kind::Base => {
            let a = record.mass_acceleration_1_m_s2.len().max(record.mass_acceleration_2_m_s2.len());
            a.max(record.relative_displacement_m.len())
        }
        Kind::Force => record.displacement_m.len().max(record.acceleration_m_s2.len()),
        Kind::Component => record.force_n.len(),
    };
    if measured != n {
        return refuse("no measured response in it: neither acceleration, displacement nor force".to_owned());
    }
    Ok(())
}

fn filter(channels: &mut Channels, band: &Band, rate: f64) {
    for channel in
        [&mut channels.measured_a, &mut channels.model_a, &mut channels.measured_d, &mut channels.model_d]
    {
        band.filter(channel, rate);
    }
}

/// RMS of A and D that the noise of the driving channel leaves in the response of the model, over the
/// whole steps: what a resonance passes is slow, and the counted cycles hold few of its swings.
fn propagated(windows: &[Window], one: &Channels, other: &Channels) -> [f64; 2] {
    let rms = |a: &[f64], b: &[f64]| {
        let (mut sum, mut count) = (0.0, 0.0);
        for window in windows {
            for (a, b) in a[window.whole.clone()].iter().zip(&b[window.whole.clone()]) {
                sum += (a - b).powi(2);
                count += 1.0;
            }
        }
        (sum / f64::max(count, 1.0)).sqrt()
    };
    [rms(&one.model_a, &other.model_a), rms(&one.model_d, &other.model_d)]
}

fn overall(
    kind: Kind,
    total: &Sums,
    floor: &NoiseFloor,
    mass_kg: f64,
    propagated: Option<[f64; 2]>,
) -> Error {
    let rms = |[_, measured]: [f64; 2]| (measured > 0.0).then(|| (measured / total.count.max(1.0)).sqrt());
    let (rms_a, rms_d) = (rms(total.a), rms(total.d));
    let [input_a, input_d] = propagated.unwrap_or_default();
    let sensor_a = if kind == Kind::Component { floor.force_n / mass_kg } else { floor.acceleration_m_s2 };
    let nrmse_a = nrmse(total.a);
    Error {
        nrmse_a,
        nrmse_d: nrmse(total.d),
        nrmse_force: nrmse_a.filter(|_| kind == Kind::Component),
        noise_floor_a: rms_a.map(|rms| sensor_a.hypot(input_a) / rms),
        noise_floor_d: rms_d.map(|rms| floor.displacement_m.hypot(input_d) / rms),
        rms_a_m_s2: rms_a,
        rms_d_m: rms_d,
    }
}

/// Sums of the compared channels by everything that is asked.
#[derive(Default)]
struct Gathered {
    cells: Cells,
    windows: Vec<Sums>,
    phases: Vec<Sums>,
    amplitudes: Vec<Sums>,
    times: Vec<Sums>,
}

impl Gathered {
    fn named(&self, parts: &[Sums], name: impl Fn(usize) -> String) -> Vec<Slice> {
        let total = self.cells.total();
        let filled = parts.iter().enumerate().filter(|(_, part)| part.count > 0.0);
        filled.map(|(i, part)| Slice::new(name(i), part, &total)).collect()
    }

    fn directions(&self, windows: &[Window]) -> Vec<Slice> {
        let mut parts = [Sums::default(); 2];
        for (window, sums) in windows.iter().zip(&self.windows) {
            if let Some(direction) = window.direction {
                parts[usize::from(direction == Direction::Backward)] += sums;
            }
        }
        self.named(&parts, |i| ["forward", "backward"][i.min(1)].to_owned())
    }
}

fn gather(
    windows: &[Window],
    channels: &Channels,
    free: &[Range<usize>],
    delay: usize,
    rate: f64,
) -> Gathered {
    let mut out = Gathered {
        phases: vec![Sums::default(); 12],
        amplitudes: vec![Sums::default(); 4],
        times: vec![Sums::default(); 3],
        ..Gathered::default()
    };
    let n = channels.model_a.len();
    let motion = if channels.measured_d.is_empty() { &channels.model_d } else { &channels.measured_d };
    let counted = windows.iter().flat_map(|window| window.counted.clone());
    let largest = counted.map(|i| motion[i].abs()).fold(1e-300, f64::max);
    let square = |measured: &[f64], model: &[f64], i: usize| match measured.get(i) {
        Some(x) => [(x - model[i]).powi(2), x * x],
        None => [0.0; 2],
    };
    for window in windows {
        let mut sums = Sums::default();
        for range in free {
            let (from, to) = (window.counted.start.max(range.start), window.counted.end.min(range.end));
            for (i, at_d) in motion.iter().enumerate().take(to).skip(from) {
                let sample = Sums {
                    count: 1.0,
                    a: square(&channels.measured_a, &channels.model_a, i),
                    d: square(&channels.measured_d, &channels.model_d, i),
                    ..Sums::default()
                };
                // The filter delays the residual against the motion that made it.
                let at = i.saturating_sub(delay).max(range.start);
                *out.cells.of(channels.regime[at], channels.outward[at]) += &sample;
                sums += &sample;
                if let Some(place) = window.cycle_place(at, rate) {
                    out.phases[((12.0 * place) as usize).min(11)] += &sample;
                }
                out.amplitudes[((4.0 * at_d.abs() / largest) as usize).min(3)] += &sample;
                out.times[(3 * i / n.max(1)).min(2)] += &sample;
            }
        }
        out.windows.push(sums);
    }
    out
}

fn steps(
    windows: &[Window],
    sums: &[Sums],
    channels: &Channels,
    force: Option<&ResidualForce>,
    rate: f64,
) -> Vec<StepMisfit> {
    let rows = windows.iter().zip(sums).enumerate();
    rows.filter(|(_, (window, sums))| window.step >= 0 && sums.count > 0.0)
        .map(|(i, (window, sums))| {
            let residual_n = force.and_then(|force| force.windows.get(i)).map(|w| w.residual_rms_n);
            step(window, sums, channels, residual_n, rate)
        })
        .collect()
}

fn step(window: &Window, sums: &Sums, channels: &Channels, residual_n: Option<f64>, rate: f64) -> StepMisfit {
    let cut = |channel: &'_ [f64]| channel.get(window.counted.clone()).unwrap_or_default().to_vec();
    let (a, model_a) = (cut(&channels.measured_a), cut(&channels.model_a));
    let (d, model_d) = (cut(&channels.measured_d), cut(&channels.model_d));
    let peak = |x: &[f64]| (!x.is_empty()).then(|| x.iter().fold(0.0, |top: f64, x| top.max(x.abs())));
    let excursion = |x: &[f64]| {
        let range = x.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)));
        (!x.is_empty()).then_some(range.1 - range.0)
    };
    let harmonics = |measured: &[f64], model: &[f64]| match window.frequency_hz {
        Some(f) if !measured.is_empty() => harmonics::misfit(measured, model, f, rate),
        _ => Vec::new(),
    };
    let rms = |sum: f64, there: &[f64]| (!there.is_empty()).then(|| (sum / sums.count).sqrt());
    StepMisfit {
        index: window.step,
        direction: window.direction,
        frequency_hz: window.frequency_hz,
        from_s: window.counted.start as f64 / rate,
        nrmse_a: nrmse(sums.a),
        nrmse_d: nrmse(sums.d),
        rms_a_measured_m_s2: rms(sums.a[1], &a),
        rms_a_residual_m_s2: rms(sums.a[0], &a),
        rms_d_measured_m: rms(sums.d[1], &d),
        rms_d_residual_m: rms(sums.d[0], &d),
        a_max_m_s2: peak(&a),
        model_a_max_m_s2: peak(&model_a).filter(|_| !a.is_empty()),
        excursion_m: excursion(&d),
        model_excursion_m: excursion(&model_d).filter(|_| !d.is_empty()),
        force_residual_n: residual_n,
        harmonics_a: harmonics(&a, &model_a),
        harmonics_d: harmonics(&d, &model_d),
    }
}
