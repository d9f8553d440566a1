//! The simulated response of a model laid against the measured one, step by step, with everything that is not the model's
//! own estimated beside it: the state at the start of each step, the slow noise of the displacement sensor, what the table's
//! acceleration leaks into that of the mass, and a part of a sample between the two. What is then left of a right model is
//! the white noise of the instruments, so that sums of squares are likelihoods and intervals hold what they say (output
//! error method: Jategaonkar, Flight Vehicle System Identification, 2006, ch. 4; nuisances are eliminated step by step from
//! the normal equations, Golub and Pereyra 1973). Diagnosis decides by it wherever a base record drives a simulation.

mod descent;
mod tangent;
#[cfg(test)]
mod tests;

pub use tangent::{Score, Tangent};

use super::least_squares::{Free, dot};
use super::motion::{Motion, Window};
use super::numbers::Numbers;
use super::problem::{DRIFT, DRIFT_MEMORY, OutputError, Part};
use super::refit::{with_zero, zero_sigma_m};
use super::together::Source;
use crate::model::{self, EffectSpec, IsolatorSpec, ModelSpec, Specimen};
use nalgebra::{DMatrix, DVector};
use std::sync::{Arc, OnceLock};

/// A step in which the mean square of the residuals is so many times that of the noise begins to count by its logarithm: one in
/// which a stiff contact leads elsewhere does not rule the fit.
const ROBUST: f64 = 1.5;
/// Samples that are simulated at most in one evaluation; steps are left out evenly beyond it.
const SAMPLES: usize = 120_000;
/// Standard deviation of the time between the table's channel and the others, in samples.
const LAG: f64 = 0.3;
/// Numbers beyond the model's: zero of the displacement sensor, leak, lag, gains of the displacement sensor and of the
/// accelerometers, as far as the kinematics leave them open.
const COMMON: usize = 5;
/// Nuisances of every step that take a simulation to follow: start displacement and velocity, amplitude and time of what drives it.
/// After them come the offsets of what drives it in each half cycle, where there is noise in it; then, without a simulation, the zero
/// of A and the knots of the displacement sensor's drift.
const STARTING: usize = 4;
/// Noise of what drives a step below this share of the table's own is not followed.
const QUIET: f64 = 0.1;
/// Nor in a step of more half cycles than these: each takes a simulation.
const OFFSETS: usize = 16;
/// A second difference of the measured acceleration above so many times its noise is a jump, as where a damped contact begins:
/// which of two samples it falls between is chance.
const JUMP: f64 = 7.0;
/// Samples between neighbours whose covariance is structure: beyond what filters and lags make.
const NEAR: usize = 8;
/// Share of the steps, those with most left, in which a stiff contact may have led elsewhere.
const ELSEWHERE: f64 = 0.15;
/// A residual of the acceleration above so many times its noise counts by its size, no more by its square (Huber 1964): where a
/// simulated contact begins some samples off, the jump does not rule the fit.
const HUBER: f64 = 6.0;
/// Samples on each side of a jump that do not count.
const AROUND: usize = 2;
/// A change of a residual by more than this, in units of its noise, within the small difference of a slope is a jump that went
/// over a sample.
const OVER: f64 = 1.0;

/// The measured response.
#[derive(Clone)]
pub struct Measured<'a> {
    motion: &'a Motion,
    /// Numbers of the windows of each part.
    training: Vec<usize>,
    held_out: Vec<usize>,
    zero_sigma_m: f64,
    leak_sigma: f64,
    gain_sigmas: [f64; 2],
    drift_m: f64,
    table_noise_m_s2: f64,
    /// Whether each sample of the acceleration counts.
    counts: Vec<bool>,
    /// What a springpot remembers at the beginning of each window.
    remembered: Arc<OnceLock<Vec<Vec<f64>>>>,
}

/// What is estimated in one step beside the model's numbers: start displacement, start velocity (against the measured
/// ones), amplitude (relative) and time (s) of what drives it, its offsets (m/s2), zero of A, then the knots of the drift.
pub type Nuisances = Vec<f64>;

/// A model laid against the steps of a part.
#[derive(Clone, Debug)]
pub struct Laid {
    /// Model's numbers, zero (m), leak, lag (s), gains of the displacement sensor and of the accelerometers less 1.
    pub values: Vec<f64>,
    nuisances: Vec<Nuisances>,
    /// Twice the negative logarithm of the likelihood but for a constant: squares in units of the noise, in steps far from
    /// it their logarithm.
    pub cost: f64,
    /// Squares of the priors of the model's numbers and of what is common to all steps.
    pub prior: f64,
    /// Residuals.
    pub count: usize,
    /// Information on the values, the nuisances of the steps eliminated.
    information: DMatrix<f64>,
}

/// What is left in the residuals of a part.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Left {
    /// Covariance of neighbouring residuals, in units of the noise: noise has none, whatever its level.
    pub excess: f64,
    /// How many residuals count as one independent one.
    pub colour: f64,
    /// Mean square over that of the noise, its median over the steps.
    pub median: f64,
}

/// Simulated A and D of a step.
type Simulated = Vec<(f64, f64)>;

/// The model as it stood at each record.
struct Specimens {
    each: Vec<Box<dyn Specimen>>,
    /// An effect forgets by a power law: slower than in the cycles before a step.
    remembers: bool,
    /// The table moves otherwise than it is driven.
    kicks: bool,
}

struct Step<'b> {
    window: &'b Window,
    residuals: Vec<f64>,
    simulated: Simulated,
}

impl<'a> Measured<'a> {
    /// Prepares the steps of a motion; `None` where there is no base motion with a displacement sensor.
    pub fn new(motion: &'a Motion) -> Option<Self> {
        let base =
            motion.kind == crate::record::Kind::Base && motion.laser_m.len() == motion.displacement_m.len();
        if !base || motion.restoring_noise_m_s2 <= 0.0 || motion.laser_noise_m <= 0.0 {
            return None;
        }
        let of = |held_out: bool| -> Vec<usize> {
            let all: Vec<usize> =
                (0..motion.windows.len()).filter(|k| motion.windows[*k].held_out == held_out).collect();
            let samples: usize =
                all.iter().map(|k| motion.windows[*k].range.end - motion.windows[*k].warm_from).sum();
            all.into_iter().step_by(samples.div_ceil(SAMPLES).max(1)).collect()
        };
        let leak = motion.instruments.as_ref().map(|i| {
            let [one, two] = &i.accelerometers;
            0.5 * (one.leak.sigma + two.leak.sigma)
        });
        let gains = motion.instruments.as_ref().map(|i| {
            let [one, two] = &i.accelerometers;
            [i.laser_gain.sigma, 0.5 * (one.gain.sigma + two.gain.sigma)]
        });
        let (training, held_out) = (of(false), of(true));
        (!training.is_empty() && !held_out.is_empty()).then(|| Self {
            motion,
            training,
            held_out,
            zero_sigma_m: zero_sigma_m(motion),
            gain_sigmas: gains.unwrap_or([0.0; 2]).map(|sigma| sigma.max(1e-6)),
            leak_sigma: leak.unwrap_or(0.0).max(1e-6),
            drift_m: DRIFT * motion.rms(&motion.displacement_m),
            table_noise_m_s2: motion
                .instruments
                .as_ref()
                .map_or(motion.restoring_noise_m_s2, |i| i.table_noise_m_s2),
            counts: beside_jumps(&motion.restoring_m_s2, motion.restoring_noise_m_s2),
            remembered: Arc::default(),
        })
    }

    /// The same with every so many steps of training alone, for fits that sort out.
    pub fn every(&self, steps: usize) -> Self {
        let training = self.training.iter().copied().step_by(steps.max(1)).collect();
        Self { training, ..self.clone() }
    }

    fn windows(&self, part: Part) -> &[usize] {
        if part == Part::HeldOut { &self.held_out } else { &self.training }
    }

    /// The numbers of a fit with what is common to all steps.
    fn free(&self, numbers: &Numbers, zero_m: f64) -> Vec<Free> {
        let mut free = with_zero(numbers, zero_m, self.zero_sigma_m);
        for (key, sigma) in [
            ("leak", self.leak_sigma),
            ("lag", LAG * self.motion.dt_s()),
            ("gain of the displacement sensor", self.gain_sigmas[0]),
            ("gain of the accelerometers", self.gain_sigmas[1]),
        ] {
            free.push(Free {
                key: key.into(),
                start: 0.0,
                scale: sigma,
                prior: (0.0, sigma),
                bounds: (-20.0 * sigma, 20.0 * sigma),
            });
        }
        free
    }

    /// Residuals of a step that count.
    fn count(&self, window: &Window) -> usize {
        window.range.len() + self.counts[window.range.clone()].iter().filter(|c| **c).count()
    }

    fn knots(&self, window: &Window) -> usize {
        (window.range.len() as f64 * window.frequency_hz / self.motion.sample_rate_hz).round().max(1.0)
            as usize
            + 1
    }

    /// Offsets of what drives a step: one in each half cycle, where it is noisy.
    fn offsets(&self, window: &Window) -> usize {
        let noisy = window.drive_noise_m_s2 > QUIET * self.table_noise_m_s2;
        let half_cycles = 2 * (self.knots(window) - 1);
        if noisy && half_cycles <= OFFSETS { half_cycles } else { 0 }
    }

    /// Nuisances of a step that take a simulation to follow.
    fn followed(&self, window: &Window) -> usize {
        STARTING + self.offsets(window)
    }

    fn still(&self, part: Part) -> Vec<Nuisances> {
        let nothing = |k: &usize| {
            let window = &self.motion.windows[*k];
            vec![0.0; self.followed(window) + 1 + self.knots(window)]
        };
        self.windows(part).iter().map(nothing).collect()
    }

    /// Simulates a step from the measured state, moved by so much; hidden states are warmed up along the measured motion.
    fn simulate(&self, specimens: &mut Specimens, window: &Window, zero_m: f64, start: &[f64]) -> Simulated {
        let motion = self.motion;
        let specimen = &mut *specimens.each[window.source];
        specimen.reset();
        let source = &motion.sources[window.source];
        let last = window.range.start.max(1) - 1;
        let first = window.warm_from.min(last);
        specimen.set_time_s(source.time_s(first, motion.dt_s()));
        if specimens.remembers {
            specimen.recall(self.remembered(window));
        }
        for n in first..last {
            specimen.impose(motion.displacement_m[n] + zero_m, motion.velocity_m_s[n]);
        }
        specimen
            .impose(motion.displacement_m[last] + zero_m + start[0], motion.velocity_m_s[last] + start[1]);
        // What drives the step, its amplitude and time as they are estimated.
        let end = motion.drive_m_s2.len() - 1;
        let offsets = &start[STARTING..self.followed(window)];
        let drive = |n: usize| {
            let at = n.saturating_sub(window.range.start) * offsets.len() / window.range.len();
            let slope = 0.5
                * (motion.drive_m_s2[(n + 1).min(end)] - motion.drive_m_s2[n.max(1) - 1])
                * motion.sample_rate_hz;
            motion.drive_m_s2[n] * (1.0 + start[2]) + slope * start[3] + offsets.get(at).unwrap_or(&0.0)
        };
        specimen.prime(drive(last));
        let table: Vec<f64> = window.range.clone().map(drive).collect();
        let mut simulated = Simulated::with_capacity(table.len());
        let mut velocity_m_s = Vec::with_capacity(table.len());
        specimen.run(&table, &mut |response| {
            simulated.push((response.mass_acceleration_m_s2, response.relative_displacement_m));
            velocity_m_s.push(response.relative_velocity_m_s);
        });
        if !specimens.kicks {
            spread_jumps(&mut simulated, &velocity_m_s, &table, motion.sample_rate_hz);
        }
        simulated
    }

    /// What a springpot remembers where the warming up of a step begins, the motion before it run through once.
    fn remembered(&self, window: &Window) -> &[f64] {
        let all = self.remembered.get_or_init(|| {
            let motion = self.motion;
            let mut states = Vec::with_capacity(motion.windows.len());
            let mut walk: Option<(usize, usize, Box<dyn Specimen>)> = None;
            for window in &motion.windows {
                let (from, source) = (motion.sources[window.source].first, window.source);
                let (at, mut specimen) = match walk.take() {
                    Some((of, at, specimen)) if of == source && at <= window.warm_from => (at, specimen),
                    _ => match springpot(motion.dt_s()) {
                        Some(specimen) => (from, specimen),
                        None => return Vec::new(),
                    },
                };
                for n in at..window.warm_from {
                    specimen.impose(motion.displacement_m[n], motion.velocity_m_s[n]);
                }
                states.push(specimen.memory());
                walk = Some((source, window.warm_from.max(at), specimen));
            }
            states
        });
        let index = self.motion.windows.iter().position(|w| std::ptr::eq(w, window));
        index.and_then(|index| all.get(index)).map_or(&[], Vec::as_slice)
    }

    /// Weights of the two knots beside a sample, and the left one's number.
    fn beside(&self, window: &Window, i: usize, knots: usize) -> (usize, f64) {
        let at = i as f64 * (knots - 1) as f64 / window.range.len() as f64;
        let left = (at as usize).min(knots - 2);
        (left, at - left as f64)
    }

    /// Measured less simulated A, then D, over their noises.
    fn misfit(&self, window: &Window, simulated: &Simulated, common: &[f64], nuisances: &[f64]) -> Vec<f64> {
        let motion = self.motion;
        let (sa, sd) = (1.0 / motion.restoring_noise_m_s2, 1.0 / motion.laser_noise_m);
        let (zero_m, leak, lag) = (common[0], common[1], common[2] * motion.sample_rate_hz);
        let (gain_d, gain_a) = (1.0 + common[3], 1.0 + common[4]);
        let followed = self.followed(window);
        let (offset, drift) = (nuisances[followed], &nuisances[followed + 1..]);
        let n = simulated.len();
        let mut out = vec![0.0; 2 * n];
        for (i, (a, d)) in simulated.iter().enumerate() {
            let at = window.range.start + i;
            let (slope_a, slope_d) = slopes(simulated, i);
            let (left, share) = self.beside(window, i, drift.len());
            let slow = drift[left] * (1.0 - share) + drift[left + 1] * share;
            if self.counts[at] {
                out[i] = sa
                    * (-motion.restoring_m_s2[at] - leak * motion.drive_m_s2[at] - offset - gain_a * a
                        + lag * slope_a);
            }
            out[n + i] = sd * (motion.laser_m[at] - slow - gain_d * d + zero_m + lag * slope_d);
        }
        out
    }

    /// The misfit, a large one of the acceleration as the root of its share of the cost.
    fn residuals(
        &self,
        window: &Window,
        simulated: &Simulated,
        common: &[f64],
        nuisances: &[f64],
    ) -> Vec<f64> {
        let mut out = self.misfit(window, simulated, common, nuisances);
        for r in out[..simulated.len()].iter_mut().filter(|r| r.abs() > HUBER) {
            *r = (HUBER * (2.0 * r.abs() - HUBER)).sqrt().copysign(*r);
        }
        out
    }

    /// Prior deviations of a step's nuisances before the drift.
    fn sigmas(&self, window: &Window) -> Vec<f64> {
        let motion = self.motion;
        let drive = &motion.drive_m_s2[window.range.clone()];
        let power = dot(drive, drive).max(1e-300);
        // Of the amplitude of a sine in white noise, relative; its phase is as uncertain.
        let amplitude = self.table_noise_m_s2 / power.sqrt();
        let w = std::f64::consts::TAU * window.frequency_hz.max(1e-9);
        let offsets = self.offsets(window);
        let half_cycle = window.range.len() as f64 / offsets.max(1) as f64;
        let mut sigmas = vec![
            3.0 * motion.displacement_noise_m,
            3.0 * motion.velocity_noise_m_s,
            amplitude,
            amplitude / w,
        ];
        sigmas.extend(vec![window.drive_noise_m_s2 / half_cycle.sqrt(); offsets]);
        sigmas.push(motion.restoring_noise_m_s2);
        sigmas
    }

    /// Prior precisions of a step's nuisances; those of the drift are correlated.
    fn precision(&self, window: &Window) -> DMatrix<f64> {
        let sigmas = self.sigmas(window);
        let (first, knots) = (sigmas.len(), self.knots(window));
        let mut out = DMatrix::zeros(first + knots, first + knots);
        for (j, sigma) in sigmas.into_iter().enumerate() {
            out[(j, j)] = sigma.max(1e-300).powi(-2);
        }
        // A first-order autoregression from knot to knot.
        let innovation = (1.0 - DRIFT_MEMORY * DRIFT_MEMORY) * self.drift_m.max(1e-300).powi(2);
        for j in first..first + knots {
            let ends = j == first || j + 1 == first + knots;
            out[(j, j)] = (1.0 + if ends { 0.0 } else { DRIFT_MEMORY * DRIFT_MEMORY }) / innovation;
            if j + 1 < first + knots {
                out[(j, j + 1)] = -DRIFT_MEMORY / innovation;
                out[(j + 1, j)] = -DRIFT_MEMORY / innovation;
            }
        }
        out
    }

    /// Lays values against the steps of a part; `None` when the model cannot be built or leaves the finite numbers.
    fn lay(
        &self,
        spec: &ModelSpec,
        part: Part,
        values: &[f64],
        nuisances: &[Nuisances],
    ) -> Option<(f64, Vec<Step<'a>>)> {
        let common = &values[values.len() - COMMON..];
        let mut specimens = self.specimens(spec)?;
        let mut cost = 0.0;
        let mut steps = Vec::with_capacity(nuisances.len());
        for (k, own) in self.windows(part).iter().zip(nuisances) {
            let window = &self.motion.windows[*k];
            let simulated = self.simulate(&mut specimens, window, common[0], own);
            let residuals = self.residuals(window, &simulated, common, own);
            let chi2 = dot(&residuals, &residuals);
            if !chi2.is_finite() {
                return None;
            }
            let own = DVector::from_column_slice(own);
            let prior = (&own.transpose() * self.precision(window) * &own)[(0, 0)];
            cost += robust(chi2 + prior, self.count(window)).0;
            steps.push(Step { window, residuals, simulated });
        }
        Some((cost, steps))
    }

    fn specimens(&self, spec: &ModelSpec) -> Option<Specimens> {
        let sources = &self.motion.sources;
        let build = |source: &Source| model::build(&source.setting.of(spec), self.motion.dt_s()).ok();
        let has = |name: &str| spec.effects.iter().any(|effect| effect.name == name);
        let (remembers, kicks) = (has("fractional-damping"), has("table-interaction"));
        Some(Specimens { each: sources.iter().map(build).collect::<Option<_>>()?, remembers, kicks })
    }

    /// Errors of A and D step by step with what is estimated beside the model taken out, samples beside jumps left out; each with
    /// the number of its window.
    pub fn errors(&self, spec: &ModelSpec, part: Part, laid: &Laid) -> Option<Vec<(usize, OutputError)>> {
        let (motion, common) = (self.motion, &laid.values[laid.values.len() - COMMON..]);
        let (_, steps) = self.lay(spec, part, &laid.values, &laid.nuisances)?;
        let of = |((step, own), k): ((&Step<'_>, &Nuisances), &usize)| {
            let misfit = self.misfit(step.window, &step.simulated, common, own);
            let (of_a, of_d) = misfit.split_at(step.simulated.len());
            let laser = &motion.laser_m[step.window.range.clone()];
            let mean = laser.iter().sum::<f64>() / laser.len().max(1) as f64;
            let mut error = OutputError::default();
            for (i, n) in step.window.range.clone().enumerate().filter(|(_, n)| self.counts[*n]) {
                error.sum_a += (motion.restoring_noise_m_s2 * of_a[i]).powi(2);
                error.power_a += motion.restoring_m_s2[n].powi(2);
                error.sum_d += (motion.laser_noise_m * of_d[i]).powi(2);
                error.power_d += (laser[i] - mean).powi(2);
                error.count += 1;
            }
            (*k, error)
        };
        Some(steps.iter().zip(&laid.nuisances).zip(self.windows(part)).map(of).collect())
    }

    /// What is left of the residuals of a part.
    pub fn left(&self, spec: &ModelSpec, part: Part, laid: &Laid) -> Option<Left> {
        let (_, steps) = self.lay(spec, part, &laid.values, &laid.nuisances)?;
        let (mut power, mut count) = (0.0, 0usize);
        let mut means: Vec<f64> = Vec::with_capacity(steps.len());
        let mut neighbours: Vec<f64> = Vec::with_capacity(steps.len());
        // Sums of products at lags that grow by a quarter, each standing for those it skips.
        let mut lags: Vec<(usize, usize, f64)> = Vec::new();
        let mut lag = 1;
        while lag < 4096 {
            let next = (lag + 1).max(lag * 5 / 4);
            lags.push((lag, next - lag, 0.0));
            lag = next;
        }
        for step in &steps {
            let chi2 = dot(&step.residuals, &step.residuals);
            let counted = self.count(step.window);
            let weight = robust(chi2, counted).1;
            means.push(chi2 / counted as f64);
            let pairs =
                step.residuals.chunks(step.simulated.len()).map(|c| dot(&c[NEAR..], &c[..c.len() - NEAR]));
            neighbours.push(pairs.sum::<f64>() / counted as f64);
            for channel in step.residuals.chunks(step.simulated.len()) {
                power += weight * dot(channel, channel);
                count += channel.len();
                for (lag, _, sum) in lags.iter_mut().filter(|(lag, _, _)| *lag < channel.len() / 2) {
                    *sum += weight * dot(&channel[*lag..], &channel[..channel.len() - *lag]);
                }
            }
        }
        let mut colour = 1.0;
        for (_, stands_for, sum) in lags {
            let rho = sum / power.max(1e-300);
            if rho < 2.0 / (count as f64).sqrt() {
                break;
            }
            colour += 2.0 * rho * stands_for as f64;
        }
        means.sort_by(f64::total_cmp);
        neighbours.sort_by(f64::total_cmp);
        neighbours.truncate(neighbours.len() - (ELSEWHERE * neighbours.len() as f64) as usize);
        Some(Left {
            excess: (neighbours.iter().sum::<f64>() / neighbours.len().max(1) as f64).max(0.0),
            colour,
            median: means.get(means.len() / 2).copied().unwrap_or(f64::INFINITY),
        })
    }
}

/// A specimen that is nothing but a springpot.
fn springpot(dt_s: f64) -> Option<Box<dyn Specimen>> {
    let isolator = IsolatorSpec { stiffness_n_m: vec![1.0], breakpoints_m: vec![], damping_n_s_m: 0.0 };
    let parameters = [("ca".to_owned(), 1.0), ("alpha".to_owned(), 0.5)].into_iter().collect();
    let spring = EffectSpec { name: "fractional-damping".into(), expression: None, parameters };
    let spec = ModelSpec {
        name: "springpot".into(),
        mass_kg: 1.0,
        isolator,
        bumper: None,
        effects: vec![spring],
        uncertainty: None,
    };
    model::build(&spec, dt_s).ok()
}

/// A jump of the simulated acceleration, where a damped contact begins or friction turns, goes over from sample to sample when it
/// comes earlier or later. So that the cost has no steps there, the acceleration of each sample is its mean over the samples
/// beside it, which the velocities give however it runs between them, sharpened again by the second difference of those means (of
/// fourth order where nothing jumps). The ends stay as they are.
fn spread_jumps(simulated: &mut Simulated, velocity_m_s: &[f64], table_m_s2: &[f64], rate_hz: f64) {
    let n = simulated.len();
    if n < 5 {
        return;
    }
    let mean = |i: usize| {
        let table = 0.25 * (table_m_s2[i - 1] + 2.0 * table_m_s2[i] + table_m_s2[i + 1]);
        0.5 * (velocity_m_s[i + 1] - velocity_m_s[i - 1]) * rate_hz + table
    };
    let mut beside = [mean(1), mean(2)];
    for i in 2..n - 2 {
        let after = mean(i + 1);
        simulated[i].0 = (8.0 * beside[1] - beside[0] - after) / 6.0;
        beside = [beside[1], after];
    }
}

/// Whether each sample counts: not beside a jump.
fn beside_jumps(acceleration: &[f64], noise: f64) -> Vec<bool> {
    let mut counts = vec![true; acceleration.len()];
    for (n, x) in acceleration.windows(3).enumerate() {
        if (x[2] - 2.0 * x[1] + x[0]).abs() > JUMP * noise {
            counts[(n + 1).saturating_sub(AROUND)..(n + 2 + AROUND).min(acceleration.len())].fill(false);
        }
    }
    counts
}

/// Rise of a simulated sample to the next, by central differences, a sample.
fn slopes(simulated: &Simulated, i: usize) -> (f64, f64) {
    let (before, after) = (simulated[i.saturating_sub(1)], simulated[(i + 1).min(simulated.len() - 1)]);
    (0.5 * (after.0 - before.0), 0.5 * (after.1 - before.1))
}

/// A step's share of the cost and its slope by the sum of squares.
fn robust(chi2: f64, count: usize) -> (f64, f64) {
    let count = count.max(1) as f64;
    let mean = chi2 / count;
    if mean <= ROBUST { (chi2, 1.0) } else { (count * ROBUST * (1.0 + (mean / ROBUST).ln()), ROBUST / mean) }
}
