//! The simulated response of a model laid against the measured one, step by step, with everything that is not the model's
//! own estimated beside it: the state at the start of each step, the slow noise of the displacement sensor, what the table's
//! acceleration leaks into that of the mass, and a part of a sample between the two. What is then left of a right model is
//! the white noise of the instruments, so that sums of squares are likelihoods and intervals hold what they say (output
//! error method: Jategaonkar, Flight Vehicle System Identification, 2006, ch. 4; nuisances are eliminated step by step from
//! the normal equations, Golub and Pereyra 1973). Diagnosis decides by it wherever a record drives a simulation; of a force record F/M
//! takes the place of the table's acceleration, with the other sign.

mod columns;
mod descent;
mod driven;
mod innovations;
mod jumps;
mod left;
mod memory;
mod priors;
mod profile;
mod settle;
mod slow;
mod specimens;
mod steps;
mod tangent;
#[cfg(test)]
mod tests;
mod until;

pub use descent::PROMISED;
pub use left::Left;
pub use tangent::{Score, Tangent};
pub use until::Until;

use driven::{OfWindows, zero_of_table_m_s2};
use jumps::beside_jumps;
pub(super) use jumps::{are_too_many, beside_jumps_of_few_samples};
use memory::Walks;
use slow::Slow;
use specimens::Specimens;

use super::kinematics::{Estimate, Tolerances};
use super::least_squares::{Fit, Free, dot};
use super::motion::{Motion, Window};
use super::numbers::Numbers;
use super::problem::{DRIFT, Part};
use super::refit::{with_zero, zero_sigma_m};
use crate::model::ModelSpec;
use crate::parallel;
use crate::record::Kind;
use nalgebra::{DMatrix, DVector};
use std::sync::{Arc, OnceLock, RwLock};

/// A step in which the mean square of the residuals is so many times that of the noise begins to count by its logarithm: one in
/// which a stiff contact leads elsewhere does not rule the fit.
const ROBUST: f64 = 1.5;
/// Standard deviation of the time between the table's channel and the others, in samples.
const LAG: f64 = 0.3;
/// Numbers beyond the model's of each record: zero of the displacement sensor, leak, lag, gains of the displacement sensor and of the
/// accelerometers, as far as the kinematics leave them open, zero of the table's acceleration where it need not come back.
const COMMON: usize = 6;
/// Nuisances of every step that take a simulation to follow: start displacement and velocity, amplitude, time and frequency of what
/// drives it.
/// After them come the offsets of what drives it in each half cycle, where there is noise in it; then, without a simulation, the zero
/// of A and the knots of the displacement sensor's drift.
const STARTING: usize = 5;
/// How far off the start of a step is, over the rms of the motion, where nothing but an integrated acceleration tells it.
const SLOW_START: f64 = 0.1;
/// Noise of what drives a step below this share of the table's own is not followed.
const QUIET: f64 = 0.1;
/// Nor in a step of more half cycles than these: each takes a simulation.
const OFFSETS: usize = 16;
/// Offsets of a cycle in which the mass settles.
const FINE: usize = 16;
/// A residual of the acceleration above so many times its noise counts by its size, no more by its square (Huber 1964): where a
/// simulated contact begins some samples off, the jump does not rule the fit.
const HUBER: f64 = 6.0;
/// A change of a residual by less than this, in units of the noise, within the small difference of a slope is no jump that went
/// over a sample.
const OVER: f64 = 1.0;

/// The measured response.
#[derive(Clone)]
pub struct Measured<'a> {
    motion: &'a Motion,
    /// Whether there is a displacement sensor.
    sees_displacement: bool,
    /// Numbers of the windows of each part.
    training: Vec<usize>,
    held_out: Vec<usize>,
    /// Those that there was no room for in either.
    left_out: Vec<usize>,
    zero_sigma_m: f64,
    leak_sigma: f64,
    gain_sigmas: [f64; 2],
    drift_m: f64,
    /// Deviations of the start displacement (m) and velocity (m/s) of a step that no displacement sensor tells.
    slow_start: [f64; 2],
    table_noise_m_s2: f64,
    table_zero_m_s2: f64,
    /// Jumps of the acceleration are left as they are.
    coarse: bool,
    /// Whether each sample of the acceleration counts, by the record alone.
    counts: Arc<Vec<bool>>,
    /// The same when a fitted model has said where jumps are.
    told: Arc<RwLock<Option<Arc<Vec<bool>>>>>,
    /// Slow noise of each record's displacement sensor, when a fitted model has told it.
    slow: Arc<RwLock<Arc<Vec<Slow>>>>,
    /// What noise in what drives each window does, when a fitted model has told it.
    driven: Arc<RwLock<Arc<OfWindows>>>,
    /// What a springpot remembers at the beginning of each window.
    remembered: Arc<OnceLock<Vec<Vec<f64>>>>,
    /// What a hysteresis is left with there.
    walks: Arc<Walks>,
}

/// What is estimated in one step beside the model's numbers: start displacement, start velocity (against the measured
/// ones), amplitude (relative) and time (s) of what drives it and how much later it is at the end than in the middle (s), its offsets
/// (m/s2), zero of A, then the knots of the drift.
pub type Nuisances = Vec<f64>;

/// A model laid against the steps of a part.
#[derive(Clone, Debug)]
pub struct Laid {
    /// Model's numbers, then of each record zero (m), leak, lag (s), gains of the displacement sensor and of the accelerometers less 1,
    /// zero of the table (m/s2).
    pub values: Vec<f64>,
    nuisances: Vec<Nuisances>,
    /// Twice the negative logarithm of the likelihood but for a constant: squares in units of the noise, in steps far from
    /// it their logarithm.
    pub cost: f64,
    /// Squares of the priors of the model's numbers and of what is common to all steps.
    pub prior: f64,
    /// How far it would fall still, to second order.
    promised: f64,
    /// Residuals.
    pub count: usize,
    /// Information on the values, the nuisances of the steps eliminated.
    information: DMatrix<f64>,
}

impl Laid {
    /// What a fit minimises: the cost with the priors.
    pub fn total(&self) -> f64 {
        self.cost + self.prior
    }

    /// How far what a fit minimises would fall still if it went on, to second order.
    pub fn promised(&self) -> f64 {
        self.promised
    }

    fn as_fit(&self, values: &[f64], information: DMatrix<f64>) -> Fit {
        Fit {
            values: values.to_vec(),
            residual_sum: self.cost,
            prior_sum: self.prior,
            count: self.count,
            information,
            iterations: 0,
        }
    }
}

/// Simulated A and D of a step.
type Simulated = Vec<(f64, f64)>;

struct Step<'b> {
    window: &'b Window,
    residuals: Vec<f64>,
    simulated: Simulated,
}

impl<'a> Measured<'a> {
    /// Prepares the steps of a motion; `None` where nothing drives a simulation (a component).
    pub fn new(motion: &'a Motion) -> Option<Self> {
        let sees_displacement = motion.laser_m.len() == motion.displacement_m.len();
        let driven = motion.kind != Kind::Component && (sees_displacement || motion.sees_acceleration);
        if !driven || motion.restoring_noise_m_s2 <= 0.0 || sees_displacement && motion.laser_noise_m <= 0.0 {
            return None;
        }
        let [of_laser, of_accelerometers, leak_sigma] = gains_and_leak(motion).map(|sigma| sigma.max(1e-6));
        let [training, held_out, left_out] = steps::of(motion);
        let coarse = motion.is_coarse();
        (!training.is_empty() && !held_out.is_empty()).then(|| Self {
            motion,
            sees_displacement,
            training,
            held_out,
            left_out,
            zero_sigma_m: zero_sigma_m(motion),
            gain_sigmas: [of_laser, of_accelerometers],
            leak_sigma,
            drift_m: DRIFT * motion.rms(&motion.displacement_m),
            slow_start: [&motion.displacement_m, &motion.velocity_m_s].map(|x| SLOW_START * motion.rms(x)),
            table_noise_m_s2: motion.drive_noise_m_s2,
            table_zero_m_s2: zero_of_table_m_s2(motion),
            coarse,
            counts: Arc::new(match motion.kind {
                _ if coarse => vec![true; motion.restoring_m_s2.len()],
                _ if !motion.sees_acceleration => vec![false; motion.restoring_m_s2.len()],
                Kind::Force => {
                    beside_jumps_of_few_samples(&motion.restoring_m_s2, motion.restoring_noise_m_s2)
                }
                _ => beside_jumps(&motion.restoring_m_s2, motion.restoring_noise_m_s2),
            }),
            told: Arc::default(),
            slow: Arc::default(),
            driven: Arc::default(),
            remembered: Arc::default(),
            walks: Arc::default(),
        })
    }

    /// An applied force drives it, known at its samples: what a solver makes of it between them is made up for, but for some
    /// thousandths of the motion.
    pub fn is_forced(&self) -> bool {
        self.motion.kind == Kind::Force
    }

    fn windows(&self, part: Part) -> &[usize] {
        if part == Part::HeldOut { &self.held_out } else { &self.training }
    }

    /// The numbers of a fit with what is common to all steps.
    fn free(&self, numbers: &Numbers, zero_m: f64) -> Vec<Free> {
        let mut free = with_zero(numbers, zero_m, self.zero_sigma_m);
        let of_record = free.split_off(free.len() - 1);
        for _ in 0..self.records() {
            free.extend(of_record.iter().cloned());
            free.extend(
                [
                    ("leak", self.leak_sigma),
                    ("lag", LAG * self.motion.dt_s()),
                    ("gain of the displacement sensor", self.gain_sigmas[0]),
                    ("gain of the accelerometers", self.gain_sigmas[1]),
                    ("zero of the table's acceleration", self.table_zero_m_s2),
                ]
                .map(|(key, sigma)| Free {
                    key: key.into(),
                    start: 0.0,
                    scale: sigma,
                    prior: (0.0, sigma),
                    bounds: (-20.0 * sigma, 20.0 * sigma),
                }),
            );
        }
        free
    }

    fn records(&self) -> usize {
        self.motion.sources.len().max(1)
    }

    /// How many values are the model's numbers.
    fn of_model(&self, values: &[f64]) -> usize {
        values.len() - COMMON * self.records()
    }

    /// What is common to all steps of a window's record.
    fn common<'v>(&self, values: &'v [f64], window: &Window) -> &'v [f64] {
        let first = self.of_model(values) + COMMON * window.source;
        &values[first..first + COMMON]
    }

    /// Residuals of a step that count.
    fn count(&self, window: &Window) -> usize {
        let displacements = if self.sees_displacement { window.range.len() } else { 0 };
        displacements + self.counts()[window.range.clone()].iter().filter(|c| **c).count()
    }

    /// One over the noises of A and D; nothing for a displacement that was not measured.
    fn over_noises(&self) -> (f64, f64) {
        let displacement = if self.sees_displacement { 1.0 / self.motion.laser_noise_m } else { 0.0 };
        (1.0 / self.motion.restoring_noise_m_s2, displacement)
    }

    fn knots(&self, window: &Window) -> usize {
        (window.range.len() as f64 * window.frequency_hz / self.motion.sample_rate_hz).round().max(1.0)
            as usize
            + 1
    }

    /// Offsets of what drives a step: one in each half cycle, where an applied force is noisy; more where that is all there is to tell a number by,
    /// since noise within half a slow cycle moves the mass by more than the displacement sensor's.
    fn offsets(&self, window: &Window) -> usize {
        if window.random {
            return 0;
        }
        if window.settling {
            return FINE * (self.knots(window) - 1);
        }
        // Of a base record a filter follows it.
        let noisy = self.is_forced() && window.drive_noise_m_s2 > QUIET * self.table_noise_m_s2;
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

    /// Weights of the two knots beside a sample, and the left one's number.
    fn beside(&self, window: &Window, i: usize, knots: usize) -> (usize, f64) {
        let at = i as f64 * (knots - 1) as f64 / window.range.len() as f64;
        let left = (at as usize).min(knots - 2);
        (left, at - left as f64)
    }

    /// Acceleration and displacement of the mass itself at a sample of a step: an applied force is no acceleration of what it stands on.
    fn of_mass(&self, window: &Window, simulated: &Simulated, i: usize) -> (f64, f64) {
        let (a, d) = simulated[i];
        let force =
            if self.is_forced() { self.motion.seen_to_drive_m_s2(window.range.start + i) } else { 0.0 };
        (a - force, d)
    }

    /// Rise from that sample to the next of both. A force is sampled at few samples a cycle, where central differences fall short.
    fn rise_of_mass(&self, window: &Window, simulated: &Simulated, i: usize) -> (f64, f64) {
        let mass = |i: usize| self.of_mass(window, simulated, i);
        let near = slopes(mass, simulated.len(), i);
        if !self.is_forced() || i < 2 || i + 2 >= simulated.len() {
            return near;
        }
        let (before, after) = (mass(i - 2), mass(i + 2));
        let over_four = |near: f64, before: f64, after: f64| (4.0 * near - 0.25 * (after - before)) / 3.0;
        (over_four(near.0, before.0, after.0), over_four(near.1, before.1, after.1))
    }

    /// Measured less simulated A, then D, over their noises.
    fn misfit(&self, window: &Window, simulated: &Simulated, common: &[f64], nuisances: &[f64]) -> Vec<f64> {
        let motion = self.motion;
        let (sa, sd) = self.over_noises();
        let (zero_m, leak, lag) = (common[0], common[1], common[2] * motion.sample_rate_hz);
        let (gain_d, more_a) = (1.0 + common[3], common[4]);
        let followed = self.followed(window);
        let (offset, drift) = (nuisances[followed], &nuisances[followed + 1..]);
        let (n, counts) = (simulated.len(), self.counts());
        let mut out = vec![0.0; 2 * n];
        for (i, (a, d)) in simulated.iter().enumerate() {
            let at = window.range.start + i;
            let (own_a, _) = self.of_mass(window, simulated, i);
            let (slope_a, slope_d) = self.rise_of_mass(window, simulated, i);
            let (left, share) = self.beside(window, i, drift.len());
            let slow = drift[left] * (1.0 - share) + drift[left + 1] * share;
            if counts[at] {
                out[i] = sa
                    * (-motion.restoring_m_s2[at]
                        - leak * motion.drive_m_s2[at]
                        - offset
                        - a
                        - more_a * own_a
                        + lag * slope_a);
            }
            let seen = motion.laser_m.get(at).unwrap_or(&0.0);
            out[n + i] = sd * (seen - slow - gain_d * d + zero_m + lag * slope_d);
        }
        out
    }

    /// The misfit, slow noise of the displacement sensor made white, and what noise in the drive does.
    fn white_misfit(
        &self,
        window: &Window,
        simulated: &Simulated,
        common: &[f64],
        nuisances: &[f64],
    ) -> Vec<f64> {
        let mut out = self.misfit(window, simulated, common, nuisances);
        self.whiten(window, &mut out);
        out
    }

    /// The same, a large one of the acceleration as the root of its share of the cost.
    fn residuals(
        &self,
        window: &Window,
        simulated: &Simulated,
        common: &[f64],
        nuisances: &[f64],
    ) -> Vec<f64> {
        let mut out = self.white_misfit(window, simulated, common, nuisances);
        for r in out[..simulated.len()].iter_mut().filter(|r| r.abs() > HUBER) {
            *r = (HUBER * (2.0 * r.abs() - HUBER)).sqrt().copysign(*r);
        }
        out
    }

    /// Lays values against the steps of a part: the cost and the steps; `None` when the model cannot be built or leaves the finite
    /// numbers.
    fn lay(
        &self,
        spec: &ModelSpec,
        part: Part,
        values: &[f64],
        nuisances: &[Nuisances],
    ) -> Option<(f64, Vec<Step<'a>>)> {
        let laid = self.lay_each(spec, part, values, nuisances)?;
        let cost = laid.iter().map(|(of_step, _)| of_step).sum();
        Some((cost, laid.into_iter().map(|(_, step)| step).collect()))
    }

    /// The same, each step with its share of the cost.
    fn lay_each(
        &self,
        spec: &ModelSpec,
        part: Part,
        values: &[f64],
        nuisances: &[Nuisances],
    ) -> Option<Vec<(f64, Step<'a>)>> {
        let each: Vec<(&usize, &Nuisances)> = self.windows(part).iter().zip(nuisances).collect();
        parallel::map_with(
            &each,
            |(k, _)| self.motion.windows[**k].range.len(),
            || self.specimens(spec),
            |specimens, (k, own)| self.lay_one(specimens, **k, values, own),
        )
    }

    /// One step's share of the cost, and the step.
    fn lay_one(
        &self,
        specimens: &mut Specimens,
        k: usize,
        values: &[f64],
        own: &[f64],
    ) -> Option<(f64, Step<'a>)> {
        let window = &self.motion.windows[k];
        let common = self.common(values, window);
        let simulated = self.simulate(specimens, window, common, own);
        let residuals = self.residuals(window, &simulated, common, own);
        let chi2 = dot(&residuals, &residuals);
        let own = DVector::from_column_slice(own);
        let prior = (&own.transpose() * self.precision(window) * &own)[(0, 0)];
        let cost = robust(chi2 + prior, self.count(window)).0;
        chi2.is_finite().then_some((cost, Step { window, residuals, simulated }))
    }
}

/// What is open of the gains of laser and accelerometers, and of the leak of the table's acceleration into those: what the kinematics leave.
/// One sensor of the mass alone says nothing of either, nor does an applied force need them.
fn gains_and_leak(motion: &Motion) -> [f64; 3] {
    match (&motion.instruments, motion.kind) {
        (Some(i), _) => {
            let [one, two] = &i.accelerometers;
            let mean = |one: Estimate, two: Estimate| 0.5 * (one.sigma + two.sigma);
            [i.laser_gain.sigma, mean(one.gain, two.gain), mean(one.leak, two.leak)]
        }
        (None, Kind::Base) => {
            let tolerances = Tolerances::default();
            [tolerances.laser_gain, tolerances.accelerometer_gain, 0.5 * tolerances.leak]
        }
        (None, Kind::Force | Kind::Component) => [0.0; 3],
    }
}

/// Rise from one of so many samples to the next, by central differences, at the ends by those to the only neighbour, a sample.
fn slopes(sample: impl Fn(usize) -> (f64, f64), of: usize, i: usize) -> (f64, f64) {
    let (first, last) = (i.saturating_sub(1), (i + 1).min(of - 1));
    let (before, after) = (sample(first), sample(last));
    let over = 1.0 / (last - first).max(1) as f64;
    (over * (after.0 - before.0), over * (after.1 - before.1))
}

/// A step's share of the cost and its slope by the sum of squares.
fn robust(chi2: f64, count: usize) -> (f64, f64) {
    let count = count.max(1) as f64;
    let mean = chi2 / count;
    if mean <= ROBUST { (chi2, 1.0) } else { (count * ROBUST * (1.0 + (mean / ROBUST).ln()), ROBUST / mean) }
}
