//! A model laid against a motion: residuals in the force domain (the measured motion imposed on
//! the model) and in the output domain (the model simulated from the measured state).
//!
//! The force domain has no memory of the model's own errors, needs no simulation and starts every
//! fit; the output domain decides. Residuals are in units of their noise, so that a sum of squares
//! over the count is 1 when nothing is left.

use super::kinematics::Instruments;
use super::motion::{Motion, Window};
pub use super::output_error::OutputError;
use crate::model::{self, ModelSpec, Specimen};
use crate::parallel;
use crate::record::Kind;

/// Which windows a residual is formed over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Those that a fit may see.
    Training,
    /// The last cycles of some of those, for fits of the simulated response.
    Brief,
    /// Those that judge it.
    HeldOut,
    /// All.
    All,
}

impl Part {
    /// Whether a window belongs to the part.
    pub fn takes(self, window: &Window) -> bool {
        match self {
            Self::Training | Self::Brief => !window.held_out,
            Self::HeldOut => window.held_out,
            Self::All => true,
        }
    }
}

/// A motion thinned for fitting, with the weight of each sample.
pub struct Problem<'a> {
    /// The motion.
    pub motion: &'a Motion,
    /// Every so many samples one counts in the force domain.
    pub thin: usize,
    /// One over the noise of the restoring force at each thinned sample, by window; zero where the
    /// force is not defined (rest, where friction may have any value).
    pub(super) weights: Vec<Vec<f64>>,
    /// Change of the restoring force over the mass with the displacement, 1/s2, as the weights.
    pub(super) slopes: Vec<Vec<f64>>,
    /// What the noise of displacement and velocity makes of the force over the mass, m/s2 rms, as the weights.
    pub(super) carried: Vec<Vec<f64>>,
    /// Drift of the displacement sensor from window to window, m rms.
    pub(super) drift_m: f64,
    /// Stretches that are simulated in fits: the last cycles of some of the training windows.
    brief: Vec<Window>,
    /// Whether each window is looked at.
    used: Vec<bool>,
}

/// Steps that are looked at at least to sort out.
const FEWEST_STEPS: usize = 12;
/// Noises of the displacement within which a bend of the force is not to be trusted: of a model that is yet to be fitted, and
/// of one that is.
pub const WIDE: f64 = 16.0;
/// As [`WIDE`], for a fitted model.
pub const NARROW: f64 = 4.0;
/// Slow noise of a displacement sensor over the motion it measures: 10 um for the paper's rig.
pub(super) const DRIFT: f64 = 1e-3;
/// Correlation of that drift from one cycle to the next.
pub(super) const DRIFT_MEMORY: f64 = 0.8;
/// Cycles that a simulation runs free before it counts: the error of its start decays.
const SETTLING_CYCLES: usize = 3;
/// Cycles of a window that count in fits of the simulated response.
const BRIEF_CYCLES: f64 = 2.0;
/// Simulated steps that a fit may take at each evaluation.
const BRIEF_STEPS: usize = 80_000;

impl<'a> Problem<'a> {
    /// Chooses the thinning and weighs the samples for the given model.
    pub fn new(motion: &'a Motion, spec: &ModelSpec, most_samples: usize) -> Self {
        let (_, thin) = thinning(motion, most_samples);
        Self::weighed(motion, spec, thin, vec![true; motion.windows.len()])
    }

    /// The same for sorting out: of a record that has far more samples and many steps, every so many steps of each part.
    pub fn of_some(motion: &'a Motion, spec: &ModelSpec, most_samples: usize) -> Self {
        let (total, thin) = thinning(motion, most_samples);
        let every = (total / (thin * most_samples.max(1))).min(motion.windows.len() / FEWEST_STEPS).max(1);
        let mut before = [0, 0];
        let used = |window: &Window| {
            let before = &mut before[usize::from(window.held_out)];
            *before += 1;
            (*before - 1) % every == 0
        };
        Self::weighed(motion, spec, thin, motion.windows.iter().map(used).collect())
    }

    fn weighed(motion: &'a Motion, spec: &ModelSpec, thin: usize, used: Vec<bool>) -> Self {
        // The motion of a component is imposed, and read where it is.
        let drift = if motion.kind == Kind::Component { 0.0 } else { DRIFT };
        let drift_m = drift * motion.rms(&motion.displacement_m);
        let mut problem = Self {
            motion,
            thin,
            weights: Vec::new(),
            slopes: Vec::new(),
            carried: Vec::new(),
            drift_m,
            brief: brief(motion),
            used,
        };
        problem.weigh(spec, 0.0, WIDE);
        problem
    }

    fn takes(&self, part: Part, k: usize) -> bool {
        self.used[k] && part.takes(&self.motion.windows[k])
    }

    /// Samples of a window that are looked at.
    pub fn samples(&self, window: &Window) -> impl Iterator<Item = usize> + use<> {
        (self.first(window)..window.range.end).step_by(self.thin)
    }

    /// The first of them: of a component those of one window go on where those of the one before end, and no memory is lost there.
    fn first(&self, window: &Window) -> usize {
        let start = window.range.start;
        if self.motion.kind == Kind::Component { start.next_multiple_of(self.thin) } else { start }
    }

    /// Restoring force over the mass of the model along the measured motion, by window, the
    /// displacement shifted by `shift_m`, nothing for windows that are not of the part; `None` when the model cannot be built.
    pub fn restoring(&self, spec: &ModelSpec, shift_m: f64, part: Part) -> Option<Vec<Vec<f64>>> {
        let motion = self.motion;
        let windows = &motion.windows;
        // Where windows follow one another without a break, what is before one is its warming up.
        let mut imposed: Vec<bool> = (0..windows.len()).map(|k| self.takes(part, k)).collect();
        for k in (1..windows.len()).rev() {
            let follows = windows[k].range.start == windows[k - 1].range.end
                && windows[k].source == windows[k - 1].source;
            imposed[k - 1] |= imposed[k] && follows;
        }
        let mut specimens = self.specimens(spec, motion.dt_s() * self.thin as f64)?;
        // What a force over another mass would have been.
        let lighter = 1.0 - motion.driven_by(spec);
        let mut out = Vec::with_capacity(motion.windows.len());
        let mut at = (usize::MAX, 0);
        for (window, imposed) in windows.iter().zip(imposed) {
            if !imposed {
                out.push(Vec::new());
                continue;
            }
            let specimen = &mut *specimens[window.source];
            // Neighbouring windows continue where the last one ended; others are warmed up.
            let mut n = self.first(window);
            if at != (n, window.source) {
                self.warm(specimen, window, shift_m);
            }
            let mut forces = Vec::with_capacity(window.range.len() / self.thin + 1);
            while n < window.range.end {
                let response = specimen.impose(motion.displacement_m[n] + shift_m, motion.velocity_m_s[n]);
                let more = if lighter == 0.0 { 0.0 } else { lighter * motion.seen_to_drive_m_s2(n) };
                forces.push(-response.mass_acceleration_m_s2 - more);
                n += self.thin;
            }
            at = (n, window.source);
            out.push(forces);
        }
        Some(out)
    }

    /// The model as it stood at each record of the motion; `None` when it cannot be built.
    fn specimens(&self, spec: &ModelSpec, dt_s: f64) -> Option<Vec<Box<dyn Specimen>>> {
        let sources = &self.motion.sources;
        sources.iter().map(|source| model::build(&source.setting.of(spec), dt_s).ok()).collect()
    }

    /// Time of a sample on the clock of its record, s.
    fn time_s(&self, window: &Window, sample: usize) -> f64 {
        self.motion.sources[window.source].time_s(sample, self.motion.dt_s())
    }

    /// Imposes the motion before a window.
    fn warm(&self, specimen: &mut dyn Specimen, window: &Window, shift_m: f64) {
        let motion = self.motion;
        let start = self.first(window);
        let steps = (start - window.warm_from) / self.thin;
        let first = start - steps * self.thin;
        specimen.reset();
        specimen.set_time_s(self.time_s(window, first));
        motion.retrace(specimen, window, first, shift_m);
        for i in 0..steps {
            let n = first + i * self.thin;
            specimen.impose(motion.displacement_m[n] + shift_m, motion.velocity_m_s[n]);
        }
    }

    /// Measured minus modelled restoring force in units of its noise, over the windows of a part.
    /// Returns false when the model cannot be built.
    pub fn force_residuals(&self, spec: &ModelSpec, shift_m: f64, part: Part, out: &mut Vec<f64>) -> bool {
        out.clear();
        let Some(modelled) = self.restoring(spec, shift_m, part) else { return false };
        for (k, window) in self.motion.windows.iter().enumerate().filter(|(k, _)| self.takes(part, *k)) {
            let begin = out.len();
            self.push_off(k, window, &modelled[k], out);
            out[begin..].iter_mut().zip(&self.weights[k]).for_each(|(r, weight)| *r *= weight);
            self.take_out_drift(k, &mut out[begin..]);
        }
        self.take_out_leak(part, out);
        true
    }

    /// Takes out what may have leaked of the table's acceleration into that of the mass (or a common error of gain, seen
    /// from the table), within what the kinematics leave open: along a base record it looks like a force of its own.
    fn take_out_leak(&self, part: Part, residuals: &mut [f64]) {
        let motion = self.motion;
        let Some(Instruments { accelerometers: [one, two], .. }) = &motion.instruments else { return };
        let sigma = 0.5 * (one.leak.sigma + two.leak.sigma);
        let mut at = Vec::with_capacity(residuals.len());
        for (k, window) in motion.windows.iter().enumerate().filter(|(k, _)| self.takes(part, *k)) {
            let samples = self.samples(window).zip(&self.weights[k]);
            at.extend(samples.map(|(n, weight)| weight * motion.drive_m_s2[n]));
        }
        let (mut along, mut power) = (0.0, sigma.max(1e-300).powi(-2));
        for (r, table) in residuals.iter().zip(&at) {
            along += r * table;
            power += table * table;
        }
        let leak = along / power;
        residuals.iter_mut().zip(&at).for_each(|(r, table)| *r -= leak * table);
    }

    /// Weight of a thinned sample of a window: one over its noise, 1/(m/s2); zero where it does not count.
    pub fn weight(&self, window: usize, sample: usize) -> f64 {
        self.weights[window][sample]
    }

    /// Number of samples of a part that carry weight.
    pub fn weighted_count(&self, part: Part) -> usize {
        let windows = self.motion.windows.iter().zip(&self.weights).filter(|(w, _)| part.takes(w));
        windows.map(|(_, weights)| weights.iter().filter(|w| **w > 0.0).count()).sum()
    }

    /// Simulates a window from the measured state and hands every counted sample to `each` as
    /// (sample, simulated A, simulated D as the laser would see it), driven by a share of what drove the motion. Hidden states are warmed up along the measured motion;
    /// the first cycles of the simulation are left to settle where there is room.
    pub fn simulate(
        &self,
        specimen: &mut dyn Specimen,
        share: f64,
        window: &Window,
        shift_m: f64,
        mut each: impl FnMut(usize, f64, f64),
    ) {
        let motion = self.motion;
        let cycle = (motion.sample_rate_hz / window.frequency_hz.max(1e-9)) as usize;
        let free_from =
            window.range.start.saturating_sub(cycle).max(window.warm_from + 1).min(window.range.start);
        specimen.reset();
        specimen.set_time_s(self.time_s(window, window.warm_from));
        motion.retrace(specimen, window, window.warm_from, shift_m);
        let drive = |n: usize| share * motion.drive_m_s2[n];
        for n in window.warm_from..free_from {
            specimen.impose(motion.displacement_m[n] + shift_m, motion.velocity_m_s[n]);
        }
        // The input at the start of the first free step.
        if free_from > 0 {
            specimen.prime(drive(free_from - 1));
        }
        for n in free_from..window.range.end {
            let response = specimen.step(drive(n));
            if n >= window.range.start {
                let a = response.mass_acceleration_m_s2 + (1.0 - share) * motion.seen_to_drive_m_s2(n);
                each(n, a, response.relative_displacement_m - shift_m);
            }
        }
    }

    /// Measured minus simulated A, then D, window by window, each in units of its noise, every `stride`th sample of
    /// the windows of a part. Means over a window do not count for A. Returns false when the model
    /// cannot be built or the simulation does not stay finite.
    pub fn output_residuals(
        &self,
        spec: &ModelSpec,
        shift_m: f64,
        part: Part,
        stride: usize,
        out: &mut Vec<f64>,
    ) -> bool {
        out.clear();
        let motion = self.motion;
        if motion.kind == Kind::Component {
            return self.force_residuals(spec, shift_m, part, out);
        }
        let Some(mut specimens) = self.specimens(spec, motion.dt_s()) else { return false };
        let share = motion.driven_by(spec);
        let (sa, sd) = (motion.restoring_noise_m_s2.max(1e-300), motion.laser_noise_m.max(1e-300));
        let mut laser = Vec::new();
        let full = motion.windows.iter().filter(|w| part.takes(w) && part != Part::Brief);
        let brief = self.brief.iter().filter(|_| part == Part::Brief);
        for window in full.chain(brief) {
            let begin = out.len();
            laser.clear();
            self.simulate(&mut *specimens[window.source], share, window, shift_m, |n, a, d| {
                if (n - window.range.start) % stride == 0 {
                    if motion.sees_acceleration {
                        out.push((-motion.restoring_m_s2[n] - a) / sa);
                    }
                    if !motion.laser_m.is_empty() {
                        laser.push((motion.laser_m[n] - d) / sd);
                    }
                }
            });
            // The drift of the laser in this window, within its prior, which counts as a residual.
            if !laser.is_empty() {
                let n = laser.len() as f64;
                let mean = laser.iter().sum::<f64>() / n;
                let prior = (sd / self.drift_m.max(1e-300)).powi(2);
                let drift = mean * n / (n + prior);
                laser.iter_mut().for_each(|r| *r -= drift);
                out.append(&mut laser);
                out.push(drift * sd / self.drift_m.max(1e-300));
            }
            if out[begin..].iter().any(|x| !x.is_finite()) {
                return false;
            }
        }
        true
    }

    /// Errors of the simulated response over the windows of a part; `None` when the model cannot
    /// be built or leaves the finite numbers. For a component record A is the force.
    pub fn output_error(&self, spec: &ModelSpec, shift_m: f64, part: Part) -> Option<OutputError> {
        self.sum(&self.output_errors(spec, shift_m, part)?, part)
    }

    /// The sum over those windows that belong to a part; `None` when it leaves the finite numbers.
    pub fn sum(&self, errors: &[(usize, OutputError)], part: Part) -> Option<OutputError> {
        let motion = self.motion;
        let of_part = errors.iter().filter(|(k, _)| part.takes(&motion.windows[*k]));
        let sum = of_part.fold(OutputError::default(), |sum, (_, error)| sum.with(error));
        (motion.kind == Kind::Component || sum.is_finite()).then_some(sum)
    }

    /// The errors window by window, each with its number; `None` when the model cannot be built.
    pub fn output_errors(
        &self,
        spec: &ModelSpec,
        shift_m: f64,
        part: Part,
    ) -> Option<Vec<(usize, OutputError)>> {
        let motion = self.motion;
        let windows = motion.windows.iter().enumerate().filter(|(_, w)| part.takes(w));
        if motion.kind == Kind::Component {
            return self.force_errors(spec, shift_m, part);
        }
        let share = motion.driven_by(spec);
        let response = |specimens: &mut Vec<Box<dyn Specimen>>, (k, window): &(usize, &Window)| {
            let mut error = OutputError::default();
            let laser = motion.laser_m.get(window.range.clone()).unwrap_or(&[]);
            let mean = laser.iter().sum::<f64>() / laser.len().max(1) as f64;
            self.simulate(&mut *specimens[window.source], share, window, shift_m, |n, a, d| {
                if motion.sees_acceleration {
                    error.sum_a += (-motion.restoring_m_s2[n] - a).powi(2);
                    error.power_a += motion.restoring_m_s2[n].powi(2);
                }
                if let Some(measured) = motion.laser_m.get(n) {
                    error.sum_d += (measured - d).powi(2);
                    error.power_d += (measured - mean).powi(2);
                }
                error.count += 1;
            });
            Some((*k, error))
        };
        let length = |(_, window): &(usize, &Window)| window.range.len();
        let windows: Vec<_> = windows.collect();
        parallel::map_with(&windows, length, || self.specimens(spec, motion.dt_s()), response)
    }
}

/// Samples of all steps with their warming up, and every how many one counts.
fn thinning(motion: &Motion, most_samples: usize) -> (usize, usize) {
    let total: usize = motion.windows.iter().map(|w| w.range.end - w.warm_from).sum();
    let highest = motion.windows.iter().map(|w| w.frequency_hz).fold(0.0, f64::max).max(1e-12);
    // At least 100 samples a cycle of the fastest step, so that a contact is not skipped.
    let coarsest = ((motion.sample_rate_hz / (100.0 * highest)) as usize).max(1);
    (total, total.div_ceil(most_samples.max(1)).clamp(1, coarsest))
}

/// The last cycles of every so many training windows.
fn brief(motion: &Motion) -> Vec<Window> {
    let mut windows: Vec<Window> = motion.windows.iter().filter(|w| !w.held_out).cloned().collect();
    let mut steps = 0;
    for window in &mut windows {
        let cycle = motion.sample_rate_hz / window.frequency_hz.max(1e-9);
        let counted = ((BRIEF_CYCLES * cycle) as usize).clamp(1, window.range.len());
        window.range.start = window.range.end - counted;
        steps += counted + SETTLING_CYCLES * cycle as usize;
    }
    let every = steps.div_ceil(BRIEF_STEPS).max(1);
    windows.into_iter().step_by(every).collect()
}
