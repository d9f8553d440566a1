//! Where, when and in which regime a model fails, judged offline from a record.
//!
//! [`compare`] drives the model with what was imposed on the specimen, puts model and measurement
//! through the same band-pass and tells their difference by step, direction, amplitude, phase and
//! regime, against the noise floor of the record. The command line and reports call it.
//!
//! NRMSE is the RMS of the residual over the RMS of the measurement, both over the counted samples:
//! the last whole cycles of each step, or a whole record that has no steps.

mod account;
mod against;
mod band;
mod force;
mod harmonics;
mod lag;
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

use crate::identify::holding;
use crate::model::{ModelError, ModelSpec};
use crate::record::mended::mended;
use crate::record::quality::{self, Finding, Severity};
use crate::record::{Kind, Record};
use crate::sweep::Direction;
use band::Band;
use force::ResidualForce;
use response::Measured;
use serde::Serialize;
use slices::Cells;

/// Times the noise floor from which on what is left may be a lag's.
const OUTSTANDING: f64 = 1.5;

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
    /// Of the force: `component` the measured one, else the restoring force -M A (less what is applied)
    /// along the measured motion.
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
    /// Sampling rate, Hz.
    pub sample_rate_hz: f64,
    /// Mass of the model with its effects, kg.
    pub mass_kg: f64,
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
    /// Residual force along the counted samples of each window, N; for plots.
    #[serde(skip)]
    pub force_along: Vec<Vec<f32>>,
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
    let record = &*mended(record);
    std::thread::scope(|scope| {
        let quality = scope.spawn(|| quality(record, spec));
        let mut comparison = judge(record, spec)?;
        comparison.quality = joined(quality);
        Ok(comparison)
    })
}

/// What is wrong with a record, on its own and then against a model that is to judge it or be judged; the worst first.
pub fn quality(record: &Record, spec: &ModelSpec) -> Vec<Finding> {
    let mut findings = quality::examine(record);
    if findings.iter().all(|finding| finding.severity != Severity::Error) {
        findings.splice(0..0, against::examine(record, spec));
    }
    findings
}

/// Waits for a thread; its panic goes on in this one.
fn joined<T>(thread: std::thread::ScopedJoinHandle<'_, T>) -> T {
    thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

fn judge(record: &Record, spec: &ModelSpec) -> Result<Comparison, CompareError> {
    let spec = &*holding(spec, [record]);
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
    let input_noise = noise::of_input(record);
    let hiss = response::drive_noise(&measured, input_noise);
    let (simulated, hissing, force, floor) = std::thread::scope(|scope| {
        let hissing = scope.spawn(|| {
            if hiss.is_empty() {
                return None;
            }
            let mut channels = response::simulate(&measured, spec, &hiss).ok()?.1;
            filter([&mut channels.model_a, &mut channels.model_d], band.as_ref(), rate);
            Some(channels)
        });
        let rest = scope.spawn(|| {
            let floor = noise::in_band(record, &windows, band.as_ref(), input_noise);
            (force::residual(&measured, spec, &windows), floor)
        });
        let simulated = simulate(&measured, spec, band.as_ref());
        let (force, floor) = joined(rest);
        (simulated, joined(hissing), force, floor)
    });
    let (method, mut channels, free) = simulated?;
    let force = force?;
    (channels.measured_a, channels.measured_d) = (measured.a, measured.d);
    if record.kind == Kind::Component {
        // The displacement is imposed: there is nothing to compare.
        channels.imposed_d = std::mem::take(&mut channels.measured_d);
    }
    filter([&mut channels.measured_a, &mut channels.measured_d], band.as_ref(), rate);
    let delay = band.as_ref().map_or(0, |band| band.delay_samples(rate));
    let gathered = account::gather(&windows, &channels, &free, delay, rate);
    let mut error = account::overall(
        record.kind,
        &gathered.cells.total(),
        &floor,
        measured.mass_kg,
        hissing.map(|other| account::propagated(&windows, &channels, &other)),
    );
    if record.kind != Kind::Base && held {
        notes.extend(late(record.kind, &error, lag::of_force(&windows, &channels, rate)));
    }
    if record.kind != Kind::Component {
        error.nrmse_force = force.as_ref().and_then(|force| slices::nrmse(force.cells.total().force));
    }
    let steps = account::steps(&windows, &gathered.windows, &channels, force.as_ref(), rate);
    let sentence = sentence::sentence(force.as_ref().map(|f| &f.cells), &gathered.cells, &windows, &steps);
    let regimes = regimes(&gathered.cells, force.as_ref());
    Ok(Comparison {
        record: record.source.clone(),
        model: spec.name.clone(),
        kind: record.kind,
        sample_rate_hz: rate,
        mass_kg: measured.mass_kg,
        method,
        band_hz: band.map(|band| [band.low_hz, band.high_hz]),
        error,
        steps,
        regimes,
        directions: gathered.directions(&windows),
        phases: gathered.named(&gathered.phases, |i| format!("{}-{} deg", 30 * i, 30 * (i + 1))),
        amplitudes: gathered
            .named(&gathered.amplitudes, |i| format!("|D| {}-{} % of the largest", 25 * i, 25 * (i + 1))),
        times: gathered
            .named(&gathered.times, |i| ["first third", "middle third", "last third"][i.min(2)].to_owned()),
        force_along: force.as_ref().map(|force| force.residual_n.clone()).unwrap_or_default(),
        residual_force: force.map(|force| force.map),
        quality: Vec::new(),
        sentence,
        notes,
        channels,
        windows,
    })
}

/// What is to be said of a lag of a force, with which so much would be left of A and D, or of a component's force.
fn late(kind: Kind, error: &Error, lag: Option<(f64, [Option<f64>; 2])>) -> Option<String> {
    let (late_s, [a, d]) = lag?;
    let floors = [(a, error.noise_floor_a, error.nrmse_a), (d, error.noise_floor_d, error.nrmse_d)];
    let stands_out =
        |(_, floor, now): &(_, Option<f64>, Option<f64>)| now > &floor.map(|floor| OUTSTANDING * floor);
    let [what, than, of_a] = match kind {
        Kind::Component => ["the force", "the displacement that it takes", "it"],
        Kind::Base | Kind::Force => ["what answers the force", "it says", "A"],
    };
    floors.iter().any(stands_out).then(|| {
        let sense = if late_s > 0.0 { "later" } else { "earlier" };
        let left = [(of_a, a), ("D", d)]
            .map(|(name, left)| left.map(|left| format!(" {:.3} % of {name}", 100.0 * left)));
        let left: Vec<String> = left.into_iter().flatten().collect();
        format!(
            "{what} comes {:.0} us {sense} than {than}: with that taken back{} would be left",
            1e6 * late_s.abs(),
            left.join(" and")
        )
    })
}

/// The simulation, checked and filtered.
fn simulate(
    measured: &Measured,
    spec: &ModelSpec,
    band: Option<&Band>,
) -> Result<(Method, Channels, Vec<std::ops::Range<usize>>), CompareError> {
    let (method, mut channels, free) = response::simulate(measured, spec, &[])?;
    if let Some(at) = channels.model_a.iter().position(|a| !a.is_finite()) {
        return Err(CompareError::Diverged(spec.name.clone(), at as f64 * measured.dt_s));
    }
    filter([&mut channels.model_a, &mut channels.model_d], band, 1.0 / measured.dt_s);
    Ok((method, channels, free))
}

fn filter(channels: [&mut Vec<f64>; 2], band: Option<&Band>, rate: f64) {
    if let Some(band) = band {
        let [one, two] = channels;
        band.filter_pair(one, two, rate);
    }
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
