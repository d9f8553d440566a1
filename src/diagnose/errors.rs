//! What the simulated response of a trial says of the record: errors step by step, over the noise, and gains of its sensors.

use super::search::Searcher;
use super::trial::Trial;
use crate::identify::kinematics::Estimate;
use crate::identify::motion::{FINEST, Motion};
use crate::identify::problem::{OutputError, Part};
use crate::identify::refit::Refit;
use crate::model::ModelSpec;
use crate::record::Kind;
use crate::record::mended::{Line, find_left};

/// What is left is clearly less than noise when it is below this share of it.
const CLEARLY_LESS: f64 = 0.7;

/// Share of what an explanation of a component's force leaves that a line in time takes away where the force drifts.
const DRIFTS: f64 = 0.2;

/// Forces to one side at both ends of a cycle: none, and two that grow with it.
const EVEN: usize = 3;

/// Time and what is left, sample by sample, without their parts along the forces to one side that go before them: in cycles that grow, such a
/// force grows too, and is no drift.
fn beside_one_side(mut left: Vec<[f64; EVEN + 2]>) -> impl Iterator<Item = [f64; 2]> {
    for one in 0..EVEN {
        let product = |other: usize| left.iter().map(|of| of[one] * of[other]).sum::<f64>();
        let power = product(one);
        let shares: Vec<f64> = (one + 1..EVEN + 2).map(|other| product(other) / power.max(1e-300)).collect();
        for of in &mut left {
            let along = of[one];
            of[one + 1..].iter_mut().zip(&shares).for_each(|(other, share)| *other -= share * along);
        }
    }
    left.into_iter().map(|[.., time, force]| [time, force])
}

impl Searcher<'_> {
    /// Errors of the simulated response step by step, each with the number of its window: with what belongs to each step estimated
    /// where the response was fitted, else from the measured start.
    pub fn errors(&self, trial: &Trial) -> Option<Vec<(usize, OutputError)>> {
        let (spec, problem) = (&trial.refit.spec, self.problem());
        let (Some(measured), Some(response)) = (&self.measured, &trial.response) else {
            return problem.output_errors(spec, trial.refit.zero_m, Part::All);
        };
        let mut errors = measured.errors(spec, Part::Training, &response.training)?;
        errors.extend(measured.errors(spec, Part::HeldOut, &response.held_out)?);
        // Of long records the response is laid against a part of the steps.
        if errors.len() < self.motion.windows.len() {
            let all = problem.output_errors(spec, trial.refit.zero_m, Part::All)?;
            let rest = all.into_iter().filter(|(k, _)| errors.iter().all(|(known, _)| known != k));
            errors.extend(rest.collect::<Vec<_>>());
        }
        errors.sort_by_key(|(k, _)| *k);
        Some(errors)
    }

    /// The same of the base model re-fitted to instruments that are as they are: nothing of them is estimated beside it, as a gain would be.
    pub fn errors_as_seen(&self, nominal: &ModelSpec) -> Option<Vec<(usize, OutputError)>> {
        let Refit { spec, zero_m, .. } = self.base(nominal)?.refit;
        self.problem().output_errors(&spec, zero_m, Part::All)
    }

    /// The sum of those errors over the held-out steps.
    pub fn held_out_error(&self, trial: &Trial) -> Option<OutputError> {
        self.problem().sum(&self.errors(trial)?, Part::HeldOut)
    }

    /// Error of the simulated response of held-out steps over that of the noise alone; nothing where the response does not decide.
    pub fn over_noise(&self, trial: &Trial) -> Option<f64> {
        let held_out = &trial.response.as_ref()?.held_out;
        let errors = self.measured.as_ref()?.errors(&trial.refit.spec, Part::HeldOut, held_out)?;
        let error = self.problem().sum(&errors, Part::HeldOut)?;
        Some(error.nrmse() / error.noise_floor(self.motion))
    }

    /// The motion with less noise, where what a trial leaves of the response is clearly less than was taken for noise: a force, or
    /// the harmonics and jumps of a response, that fill the upper band look like it.
    pub fn quieter(&self, trial: &Trial) -> Option<Motion> {
        if self.motion.kind == Kind::Component || trial.response.is_none() {
            return None;
        }
        let all = self.errors(trial)?.iter().fold(OutputError::default(), |sum, (_, error)| sum.with(error));
        let rms = |sum: f64| (sum / all.count.max(1) as f64).sqrt();
        let finest = self.motion.finest();
        let mut quieter = self.motion.clone();
        let mut less = false;
        for (left, noise) in [
            (rms(all.sum_a).max(finest * rms(all.power_a)), &mut quieter.restoring_noise_m_s2),
            (rms(all.sum_d).max(FINEST * rms(all.power_d)), &mut quieter.laser_noise_m),
        ] {
            // Nothing is left of a channel that was not measured.
            if left > 0.0 && left < CLEARLY_LESS * *noise {
                (*noise, less) = (left, true);
            }
        }
        less.then_some(quieter)
    }

    /// The motion of a component without the drift of its force, where a line in time takes a good part away of what a trial leaves; and how
    /// far that goes over the record, over the rms of the force. No effect pushes ever more to one side.
    pub fn steadier(&self, trial: &Trial) -> Option<(Motion, f64)> {
        if self.motion.kind != Kind::Component || self.motion.sources.len() != 1 {
            return None;
        }
        let problem = self.problem();
        let modelled = problem.restoring(&trial.refit.spec, trial.refit.zero_m, Part::All)?;
        let force = &self.motion.restoring_m_s2;
        let mut left: Vec<[f64; EVEN + 2]> = Vec::new();
        for (k, window) in self.motion.windows.iter().enumerate() {
            let samples = problem.samples(window).zip(&modelled[k]).enumerate();
            // What friction holds at rest is no drift.
            let counted =
                samples.filter(|(i, (n, _))| problem.weight(k, *i) > 0.0 && !self.motion.is_held_at(*n));
            left.extend(counted.map(|(_, (n, model))| {
                let d = self.motion.displacement_m[n] + trial.refit.zero_m;
                [1.0, d.abs(), d * d, n as f64, force[n] - model]
            }));
        }
        let (mut along, mut across, mut power) = (0.0, 0.0, 0.0);
        for [n, r] in beside_one_side(left) {
            along += n * n;
            across += n * r;
            power += r * r;
        }
        if along == 0.0 || across.powi(2) < DRIFTS * along * power {
            return None;
        }
        let a_sample = across / along;
        let mut steadier = self.motion.clone();
        let drifting = steadier.restoring_m_s2.iter_mut().enumerate();
        // Sensors are zeroed before a test.
        drifting.for_each(|(n, force)| *force -= a_sample * n as f64);
        let rms = self.motion.restoring_rms_m_s2();
        Some((steadier, a_sample * force.len() as f64 / rms))
    }

    /// The motion without hum of the mains in what a trial leaves of A and D, and what is to be said of that: what is imposed hides it in
    /// the record where that passes its frequency.
    pub fn without_hum(&self, trial: &Trial) -> Option<(Motion, Vec<String>)> {
        let (measured, response) = (self.measured.as_ref()?, trial.response.as_ref()?);
        if self.motion.sources.len() != 1 {
            return None;
        }
        let spec = &trial.refit.spec;
        let mut left = measured.misfits(spec, Part::Training, &response.training)?;
        left.extend(measured.misfits(spec, Part::HeldOut, &response.held_out)?);
        left.sort_by_key(|(k, _)| *k);
        let rate_hz = self.motion.sample_rate_hz;
        let lines = |channel: usize, sign: f64| {
            let piece = |(k, of): &(usize, [Vec<f64>; 2])| {
                (self.motion.windows[*k].range.start, of[channel].iter().map(|x| sign * x).collect())
            };
            let pieces: Vec<(usize, Vec<f64>)> = left.iter().map(piece).collect();
            find_left(&pieces, &self.motion.drive_m_s2, rate_hz)
        };
        // The restoring acceleration is that of the mass, with the other sign.
        let (of_a, of_d) = (lines(0, -1.0), lines(1, 1.0));
        if of_a.is_empty() && of_d.is_empty() {
            return None;
        }
        let mut without = self.motion.clone();
        of_a.iter().for_each(|line| line.take_out(&mut without.restoring_m_s2, rate_hz));
        of_d.iter().for_each(|line| line.take_out(&mut without.laser_m, rate_hz));
        let said = |channel: &str, unit: &str, line: &Line| {
            let (hz, amplitude) = (line.frequency_hz(), line.amplitude());
            format!(
                "{channel}: hum of the mains at {hz:.2} Hz, {amplitude:.2e} {unit}, in what the model leaves: taken out"
            )
        };
        let of_a = of_a.iter().map(|line| said("acceleration of the mass", "m/s2", line));
        let of_d = of_d.iter().map(|line| said("displacement", "m", line));
        Some((without, of_a.chain(of_d).collect()))
    }

    /// What a model's response says of each record's gains; nothing where it does not follow them.
    pub fn gains(&self, trial: &Trial) -> Vec<[Estimate; 2]> {
        self.measured.as_ref().map_or(Vec::new(), |measured| trial.gains(measured))
    }
}
