//! One candidate tried: fitted together with the base model's numbers, judged on held-out steps.

use super::whole::Evidence;
use crate::identify::kinematics::Estimate;
use crate::identify::least_squares::Settings;
use crate::identify::numbers::Numbers;
use crate::identify::problem::{Part, Problem};
use crate::identify::refit::{Domain, Refit, inflation, refit};
use crate::identify::response::{Laid, Left, Measured, Until};
use crate::model::effects::expression;
use crate::model::{EffectSpec, ModelSpec, Scales};
use crate::record::Kind;

/// How a fitted model does on what it has not seen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Score {
    /// Sum of squared noise-weighted residuals.
    pub chi2: f64,
    /// Number of residuals that carry weight.
    pub count: usize,
    /// Covariance of neighbouring residuals: what is left has structure, noise has none, whatever
    /// its level.
    pub excess: f64,
    /// How many residuals count as one independent one, apart from their size.
    pub colour: f64,
    /// Mean over stretches of the logarithm of their mean squares: a step in which a simulation left on another branch
    /// counts as one, however far off it is.
    pub log_mean: f64,
}

/// Everything is judged against the base model: its fit must not stop half-way.
const BASE_ITERATIONS: usize = 30;
/// Median over the steps of the mean square over the noise above which a model is too far off for first order, and covariance of
/// neighbouring residuals; and how many of those count as one where much is left although neither says so.
const FAR: f64 = 1.15;
const STRUCTURED: f64 = 0.01;
const COLOURED: f64 = 1.3;
/// Stretches of [`Score::log_mean`].
const STRETCHES: usize = 64;

impl Score {
    /// Scores residuals; `carried` is the covariance of neighbours that is no structure.
    fn of(residuals: &[f64], carried: f64) -> Self {
        let count = residuals.iter().filter(|r| **r != 0.0).count();
        let chi2: f64 = residuals.iter().map(|r| r * r).sum();
        let neighbours: f64 = residuals.windows(2).map(|r| r[0] * r[1]).sum();
        let mean = chi2 / count.max(1) as f64;
        Self {
            chi2,
            count,
            excess: (neighbours / count.max(1) as f64 - carried).max(0.0),
            colour: (inflation(residuals) / mean.max(1.0)).max(1.0),
            log_mean: log_mean(residuals),
        }
    }

    /// Mean square in units of the noise: about 1 when nothing is left.
    pub fn mean(&self) -> f64 {
        self.chi2 / self.count.max(1) as f64
    }
}

fn log_mean(residuals: &[f64]) -> f64 {
    let stretches = residuals.chunks(residuals.len().div_ceil(STRETCHES).max(1));
    let (mut sum, mut count) = (0.0, 0usize);
    for stretch in stretches {
        let mean = stretch.iter().map(|r| r * r).sum::<f64>() / stretch.len() as f64;
        if mean > 0.0 {
            sum += mean.ln();
            count += 1;
        }
    }
    sum / count.max(1) as f64
}

/// A candidate with its fit.
#[derive(Clone, Debug)]
pub struct Trial {
    /// Effects beyond the given model, in the order they were added.
    pub names: Vec<String>,
    /// The fit.
    pub refit: Refit,
    /// Restoring force along the measured motion of held-out steps: ranks explanations.
    pub force: Score,
    /// Number of those residuals of the training steps that carry weight.
    pub training: usize,
    /// Sum of their squares and the priors', as minimised.
    pub objective: f64,
    /// How many of those residuals count as one independent one.
    pub colour: f64,
    /// Simulated response of held-out steps: an explanation has to improve it. `None` for rivals
    /// that the force alone already refuses.
    pub output: Option<Score>,
    /// Simulated response with everything that is not the model's estimated beside it; decides where there is one.
    pub response: Option<Response>,
    /// The same fitted to all steps, those held out among them; where others come near.
    pub whole: Option<Evidence>,
}

/// How a model does by its simulated response.
#[derive(Clone, Debug)]
pub struct Response {
    /// Laid against the steps of training, as fitted.
    pub training: Laid,
    /// Laid against the held-out steps.
    pub held_out: Laid,
    /// What is left in those of training and in the held-out ones.
    pub left: [Left; 2],
    /// What the freedom of its numbers is worth on the steps of training, nats.
    pub freedom_nats: f64,
    /// Share of the steps in which impacts kick the table.
    pub kicked: f64,
    /// A sampled force drives it.
    pub forced: bool,
}

impl Response {
    /// What the steps of training say.
    pub fn evidence(&self) -> Evidence {
        let (total, colour) = (self.training.total(), self.colour());
        Evidence { total, colour, freedom_nats: self.freedom_nats }
    }

    /// How many residuals count as one independent one.
    pub fn colour(&self) -> f64 {
        0.5 * (self.left[0].colour + self.left[1].colour)
    }

    /// How many residuals there are.
    pub fn count(&self) -> usize {
        self.training.count + self.held_out.count
    }

    /// Structure that is left, in units of the noise.
    pub fn excess(&self) -> f64 {
        0.5 * (self.left[0].excess + self.left[1].excess)
    }
}

/// Fits a model by its response from where a force fit or another fit of the response ended, and judges it.
pub fn respond(
    measured: &Measured<'_>,
    trial: &Trial,
    from: Option<&Laid>,
    settings: Settings,
) -> Option<Trial> {
    let (numbers, training) = fit_response(measured, trial, from, settings, Until::default())?;
    judge_response(measured, trial, numbers, training)
}

/// The same, not judged yet, and given up where it is not worth going on.
pub fn fit_response(
    measured: &Measured<'_>,
    trial: &Trial,
    from: Option<&Laid>,
    settings: Settings,
    until: Until<'_>,
) -> Option<(Numbers, Laid)> {
    let (spec, mut numbers) = (&trial.refit.spec, trial.refit.numbers.clone());
    numbers.start_from(spec);
    let training = measured.fit_up_to(spec, &numbers, (trial.refit.zero_m, from), settings, until)?;
    Some((numbers, training))
}

/// Judges what was fitted by the response.
pub fn judge_response(
    measured: &Measured<'_>,
    trial: &Trial,
    numbers: Numbers,
    training: Laid,
) -> Option<Trial> {
    let mut spec = trial.refit.spec.clone();
    numbers.put(&training.values, &mut spec);
    let held_out = measured.judge(&spec, &numbers, &training)?;
    let left =
        [measured.left(&spec, Part::Training, &training)?, measured.left(&spec, Part::HeldOut, &held_out)?];
    let refit = measured.refit(&spec, &numbers, &training, left[0].colour);
    let freedom_nats = measured.freedom_nats(&numbers, &training, left[0].colour);
    let kicked = measured.kicked();
    let forced = measured.is_forced();
    let response = Some(Response { training, held_out, left, freedom_nats, kicked, forced });
    Some(Trial { refit, response, whole: None, ..trial.clone() })
}

impl Trial {
    /// What was gained over another trial on the training steps, nats, coloured residuals considered.
    pub fn training_gain(&self, from: &Self) -> f64 {
        if let (Some(with), Some(of)) = (&self.response, &from.response) {
            let fall = of.training.total() - with.training.total();
            return 0.5 * fall / with.colour().max(1.0);
        }
        0.5 * (from.objective - self.objective) / self.colour.max(1.0)
    }

    /// Nats that a better explanation may bring: what hangs together in the residuals of the response.
    pub fn nats_left(&self) -> f64 {
        self.response
            .as_ref()
            .map_or(0.0, |response| 0.5 * response.excess().max(0.0) * response.count() as f64)
    }

    /// What a fit of the response comes to that is so many nats behind on the steps of the fit; none where no response decides.
    pub fn total_behind(&self, nats: f64) -> f64 {
        let behind =
            |response: &Response| response.training.total() + 2.0 * nats * response.colour().max(1.0);
        self.response.as_ref().map_or(f64::INFINITY, behind)
    }

    /// Standard deviation of the excess of a response that leaves nothing but white noise.
    pub fn chance(&self) -> f64 {
        self.response.as_ref().map_or(f64::INFINITY, |response| {
            let [fitted, held_out] = response.left;
            0.5 * fitted.chance.hypot(held_out.chance)
        })
    }

    /// Its effects, in words.
    pub fn said(&self) -> String {
        self.names.join(" with ")
    }

    /// Whether its simulated response is too far off for first order.
    pub fn is_far(&self) -> bool {
        self.response.as_ref().is_some_and(|r| r.left[0].median > FAR || r.excess() > STRUCTURED)
    }

    /// The same, or residuals that are less than far off but hang together.
    pub fn leaves_much(&self) -> bool {
        self.is_far() || self.response.as_ref().is_some_and(|r| r.colour() > COLOURED)
    }

    /// What its response says of each record's gains; nothing where it does not follow the records.
    pub fn gains(&self, measured: &Measured<'_>) -> Vec<[Estimate; 2]> {
        let followed = self.response.as_ref().filter(|_| !self.is_far());
        followed.map_or(Vec::new(), |response| {
            measured.gains(&self.refit.numbers, &response.training, response.left[0].colour)
        })
    }

    /// By how much its response says that each record's answer comes later than it, s.
    pub fn lags_s(&self, measured: &Measured<'_>) -> Vec<Estimate> {
        self.response.as_ref().map_or(Vec::new(), |response| {
            measured.lags_s(&self.refit.numbers, &response.training, response.left[0].colour)
        })
    }

    /// Number of fitted values.
    pub fn dimension(&self) -> usize {
        self.refit.fit.values.len()
    }

    /// Share of the excess of `base` that is left, by force or by response, whichever is less: a
    /// hard contact amplifies the noise of the start in the response, and that of the laser in
    /// the force.
    pub fn share_left(&self, base: &Self) -> f64 {
        if let (Some(with), Some(of)) = (&self.response, &base.response) {
            return with.excess() / of.excess().max(1e-3);
        }
        let share = |with: &Score, of: &Score| with.excess / of.excess.max(1e-3);
        let force = share(&self.force, &base.force);
        match (&self.output, &base.output) {
            (Some(with), Some(of)) => force.min(share(with, of)),
            _ => force,
        }
    }

    /// The trial on a model that has an expression more at its end, of whose numbers these are to be fitted along with the trial's own.
    pub fn with_expression(&self, spec: ModelSpec, fitted: &[&str], scales: &Scales) -> Self {
        let mut with = self.clone();
        with.names.push(expression::EFFECT.name.to_owned());
        let index = spec.effects.len() - 1;
        let own = format!("effect[{index}].");
        with.refit.numbers.add_effect(&spec, index, scales);
        with.refit.numbers.retain(|key| key.strip_prefix(&own).is_none_or(|name| fitted.contains(&name)));
        with.refit.spec = spec;
        with
    }

    /// Structure that is left, in units of the noise.
    pub fn excess(&self) -> f64 {
        if let Some(response) = &self.response {
            return response.excess();
        }
        self.output.map_or(self.force.excess, |output| output.excess.min(self.force.excess))
    }
}

/// Re-fits the base model by the force along the measured motion alone.
pub fn base_by_force(problem: &Problem<'_>, nominal: &ModelSpec, from: Option<&Refit>) -> Option<Refit> {
    let mut numbers = Numbers::of_base(nominal, problem.motion.kind);
    if !problem.motion.tells_mass() {
        numbers.retain(|key| key != "mass_kg");
    }
    for index in 0..nominal.effects.len() {
        numbers.add_effect(nominal, index, &super::candidates::scales(nominal, problem.motion));
    }
    if let Some(from) = from {
        numbers.start_from(&from.spec);
    }
    let start = from.map_or(nominal, |from| &from.spec);
    let zero_m = from.map_or(0.0, |from| from.zero_m);
    let settings = Settings { iterations: BASE_ITERATIONS, ..Settings::default() };
    refit(problem, start, &numbers, zero_m, Domain::Force, Part::Training, settings)
}

/// Adds an effect to a fitted base and fits everything in the force domain.
pub fn in_force(
    problem: &Problem<'_>,
    from: &Refit,
    start: &EffectSpec,
    scales: &Scales,
    settings: Settings,
) -> Option<Refit> {
    let spec = super::candidates::beside(&from.spec, start);
    let mut numbers = from.numbers.clone();
    numbers.start_from(&spec);
    numbers.add_effect(&spec, spec.effects.len() - 1, scales);
    refit(problem, &spec, &numbers, from.zero_m, Domain::Force, Part::Training, settings)
}

/// Residuals plus priors.
pub fn objective(refit: &Refit) -> f64 {
    refit.fit.residual_sum + refit.fit.prior_sum
}

/// What a fall of the objective is worth, nats: coloured residuals considered, less half the logarithm of the independent ones
/// for each parameter added (Schwarz 1978).
pub fn schwarz_nats(fall: f64, added: f64, count: usize, colour: f64) -> f64 {
    let colour = colour.max(1.0);
    0.5 * fall / colour - 0.5 * added * (count as f64 / colour).max(1.0).ln()
}

/// Re-fits from the values of `from`, on another problem or in another domain.
pub fn polish(problem: &Problem<'_>, from: &Refit, domain: Domain, settings: Settings) -> Option<Refit> {
    let mut numbers = from.numbers.clone();
    numbers.start_from(&from.spec);
    let part = if domain == Domain::Force { Part::Training } else { Part::Brief };
    refit(problem, &from.spec, &numbers, from.zero_m, domain, part, settings)
}

/// Scores a fit on the held-out steps by force.
pub fn judge_by_force(problem: &Problem<'_>, names: &[String], refit: Refit) -> Option<Trial> {
    let mut residuals = Vec::new();
    let sound = problem.force_residuals(&refit.spec, refit.zero_m, Part::HeldOut, &mut residuals);
    // Half as much again: the noise of the displacement is not known better than that.
    let carried = 1.5 * problem.carried_noise(Part::HeldOut);
    let training = problem.weighted_count(Part::Training);
    let (objective, colour) = (objective(&refit), refit.inflation.max(1.0));
    let force = Score::of(&residuals, carried);
    sound.then(|| Trial {
        names: names.to_vec(),
        force,
        training,
        objective,
        colour,
        refit,
        output: None,
        response: None,
        whole: None,
    })
}

/// Refines a fit by the simulated response and scores it on the held-out steps. Where the
/// simulation makes it worse on what was fitted (another branch of a jump), the force fit stays.
pub fn finish(problem: &Problem<'_>, trial: &Trial, stride: usize) -> Option<Trial> {
    if problem.motion.kind == Kind::Component {
        return Some(trial.clone());
    }
    let settings = Settings { iterations: 4, tolerance: 1e-4, ..Settings::default() };
    let polished = polish(problem, &trial.refit, Domain::Output { stride }, settings);
    let mean = |refit: &Refit| output_score(problem, refit, Part::Training, stride).map(|s| s.mean());
    let refit = polished.filter(|p| {
        let (with, without) = (mean(p), mean(&trial.refit));
        with.is_some_and(|with| without.is_none_or(|without| with < without))
    });
    let refit = refit.unwrap_or_else(|| trial.refit.clone());
    let output = Some(output_score(problem, &refit, Part::HeldOut, stride)?);
    Some(Trial { refit, output, ..trial.clone() })
}

/// Scores a fitted model on the simulated steps of a part.
fn output_score(problem: &Problem<'_>, refit: &Refit, part: Part, stride: usize) -> Option<Score> {
    let mut residuals = Vec::new();
    let sound = problem.output_residuals(&refit.spec, refit.zero_m, part, stride, &mut residuals);
    sound.then(|| Score::of(&residuals, 0.0))
}
