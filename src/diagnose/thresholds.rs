//! What the decision asks of an explanation, of a shape of force, and of what is left.

use super::trial::{Response, Trial};
use super::verdict::last_name;
use crate::identify::motion::Motion;
use crate::identify::spectral::stretches_noise_sigma;
use crate::model::effects::{self, Place};
use crate::record::Kind;

/// Thresholds of the decision, each with its reason.
#[derive(Clone, Copy, Debug)]
pub struct Thresholds {
    /// Gain of log-likelihood that an effect must bring on the held-out steps and on those of the fit, each, and together (nats,
    /// coloured residuals considered): below it, chance and numerical error are explanation enough.
    pub gain: [f64; 2],
    /// The same where the simulated response decides, set so that records with nothing missing stay below
    /// (docs/diagnosis-method.md).
    pub response: [f64; 2],
    /// The same beside an effect that was taken already: what the fit of that one has left is taken up, too.
    pub further: [f64; 2],
    /// Nats that a generic shape of force brings beside a model with nothing missing, and beside an explanation,
    /// from which on something is there that the catalogue does not have.
    pub shape: [f64; 2],
    /// Covariance of neighbouring residuals of the response, in units of the noise, that is structure.
    pub structure: f64,
    /// The same beside an explanation, in standard deviations that chance gives it, and the share of the base model's that it then
    /// is: what explains all but a faint share stands.
    pub beside: [f64; 2],
    /// Share of the base model's misfit of a force record, in structure and in power of the error, below which what explains the rest
    /// stands although something is left.
    pub nearly: f64,
    /// Share of the error that an effect must take away from the response to a sampled force, and structure that does not count there, nor
    /// in a component's force, beside an error that is that of the noise: what goes on between samples is known no better.
    pub faint: [f64; 2],
    /// Error of the simulated response of held-out steps over the noise's that a complete explanation does not have, steps beside
    /// which a stiff contact leads elsewhere included.
    pub over_noise: f64,
    /// Nats for every residual that an effect of the bumpers must bring beyond that where impacts kick the table: what drives a
    /// simulation then is not known better beside a contact.
    pub kicked: f64,
    /// Difference of log-likelihood below which two explanations are not told apart, nats.
    pub tie: f64,
    /// Share of the base model's excess that may be left by a complete explanation.
    pub left: f64,
    /// Mean-square excess over the noise floor that is not worth a verdict.
    pub excess: f64,
}

impl Default for Thresholds {
    fn default() -> Self {
        Self {
            gain: [3.0, 24.0],
            response: [1.0, 6.0],
            further: [2.5, 10.0],
            shape: [20.0, 60.0],
            kicked: 5e-4,
            structure: 0.03,
            beside: [3.0, 0.02],
            nearly: 0.05,
            faint: [0.02, 0.1],
            over_noise: 1.05,
            tie: 6.0,
            left: 0.05,
            excess: 0.02,
        }
    }
}

/// Nats that the best of many shapes brings more than a rival from the catalogue does.
const OF_MANY: f64 = 4.0;

impl Thresholds {
    /// What a shape has to bring beside a trial.
    pub fn of_shape(&self, taken: &Trial) -> f64 {
        self.shape[usize::from(!taken.names.is_empty())]
    }

    /// Nats by which one in place of what was taken does better, from which on that is it: it is the best of many, as two effects
    /// together are.
    pub fn of_shape_instead(&self, taken: &Trial) -> f64 {
        self.tie + if taken.names.len() > 1 { 0.0 } else { OF_MANY }
    }

    /// Error over the noise's that a complete explanation has at most. The noise of another rig's sensors is told from the record,
    /// of a short one badly.
    pub(super) fn most_over_noise(self, motion: &Motion) -> f64 {
        // Of each record alone, and mixed as its samples are.
        let all = motion.displacement_m.len();
        let lengths = motion.records().map(|record| record.len());
        let variance = |samples: usize| {
            let share = samples as f64 / all.max(1) as f64;
            (share * stretches_noise_sigma(samples)).powi(2)
        };
        let told_to = match motion.kind {
            Kind::Base => 0.0,
            Kind::Force | Kind::Component => lengths.map(variance).sum::<f64>().sqrt(),
        };
        self.over_noise + 2.0 * told_to
    }

    /// Nats that what a force of the bumpers brings may be wrong by.
    pub fn doubt(self, response: &Response) -> f64 {
        self.kicked * response.kicked * response.count() as f64
    }

    /// What a trial has to bring on each part of the steps and together.
    pub(super) fn asked(self, trial: &Trial, from: &Trial) -> [f64; 2] {
        let Some(response) = &trial.response else { return self.gain };
        let [each, together] = if from.names.is_empty() { self.response } else { self.further };
        let of_bumpers = effects::find(&last_name(trial))
            .is_ok_and(|effect| matches!(effect.place, Place::Bumper | Place::Stand));
        let doubt = if of_bumpers { self.doubt(response) } else { 0.0 };
        let independent = response.count() as f64 / response.colour().max(1.0);
        let faint = if response.forced { self.faint[0] * independent } else { 0.0 };
        [each, together + doubt + faint]
    }
}
