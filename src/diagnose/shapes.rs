//! Is there structure in what an explanation leaves of the simulated response? Forces of many shapes, generic ones that no effect
//! of the catalogue has, are scored beside it to first order, the model's own numbers following. Noise brings none of them
//! more than chance; a force that is really there brings one that is like it. The verdict "outside the catalogue" stands on it
//! wherever a base record drives a simulation.

use super::by_response::to_first_order;
use super::likeness::Likeness;
use super::search::{Searcher, Stage};
use super::thresholds::Thresholds;
use super::trial::{self, Response, Trial};
use super::{candidates, verdict};
use crate::identify::least_squares::Settings;
use crate::identify::problem::Part;
use crate::identify::response::{self, Laid, Measured, PROMISED};
use crate::model::effects::expression;
use crate::model::{EffectSpec, ModelSpec, Scales};

/// The shape of a force that would bring most.
#[derive(Clone, Debug)]
pub struct Shape {
    /// As an expression, lengths over `dm` (m), penetrations over `pm` (m), velocities over `vm` (m/s), times over `tm` (s), an
    /// amplitude `f` (N).
    pub expression: String,
    /// Nats of log-likelihood on the steps of the fit, to first order, less what a force of the bumpers may be wrong by.
    pub nats: f64,
    /// The model with it, everything moved as first order has it.
    with: ModelSpec,
}

/// What forces of some shape would bring, nats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shaped {
    /// Beside an explanation, on the steps of the fit: to first order, and fitted where that is a lot.
    pub beside: f64,
    /// One in place of all effects, fitted: by how much it does better over the whole record.
    pub instead: f64,
}

/// Share of what an explanation brings to first order below which a shape is not fitted in its place; so many effects may stand in for one
/// that there is no name for, and a shape is fitted in their place all the same.
const WORTH: f64 = 0.3;
const SEVERAL: usize = 2;

/// Share of the power of what was found that the shape most like it has at least, to be fitted in its place.
const LIKE: f64 = 0.8;

/// So many of the first are looked at again.
const AGAIN: usize = 8;

/// How a shape is fitted, in short and for longer.
const SHORT: Settings = Settings { iterations: 3, tolerance: 1e-6, difference: 1e-3 };
const LONG: Settings = Settings { iterations: 6, ..SHORT };

/// Amplitude over the typical force, for first order.
const FAINT: f64 = 1e-3;

/// Typical change of its amplitude, over the one that first order has.
const TYPICAL: f64 = 3.0;

/// Even and odd powers of displacement and velocity, a root of the velocity, and their products, waves over displacement, forces of one
/// side, friction in places, slow changes, and forces over a bumper's penetration.
const SHAPES: [&str; 29] = [
    "f*max(d/dm, 0)",
    "f*max(v/vm, 0)",
    "f*(d/dm)^2",
    "f*(d/dm)*abs(d/dm)",
    "f*max(d/dm, 0)^2",
    "f*max(0-d/dm, 0)^2",
    "f*(d/dm)^5",
    "f*(v/vm)^2",
    "f*(v/vm)^3",
    "f*(v/vm)/sqrt(0.01+abs(v/vm))",
    "f*abs(d/dm)*(v/vm)",
    "f*(d/dm)^2*(v/vm)",
    "f*(d/dm)*(v/vm)",
    "f*(d/dm)*(v/vm)^2",
    "f*(d/dm)*abs(v/vm)",
    "f*abs(d/dm)*tanh(10*v/vm)",
    "f*abs(v/vm)*(v/vm)*tanh(10*d/dm)",
    "f*sin(6.283185307179586*d/dm)",
    "f*sin(9.42477796076938*d/dm)",
    "f*sin(12.566370614359172*d/dm)",
    "f*cos(6.283185307179586*d/dm)",
    "f*tanh(20*v/vm)*exp(0-(4*d/dm-2)^2)",
    "f*tanh(20*v/vm)*exp(0-(4*d/dm)^2)",
    "f*(d/dm)*sin(6.283185307179586*t/tm)",
    "f*(v/vm)*sin(6.283185307179586*t/tm)",
    "f*(p_r-p_l)*(p_r+p_l)/pm^2",
    "f*(p_r+p_l)/pm*(v/vm)",
    "f*(p_r+p_l)/pm",
    "f*tanh(20*(p_r-p_l)/pm)",
];

impl Searcher<'_> {
    /// What shapes bring beside the trial that was taken and in its place; one that brings too little beside it is not worth a fit.
    pub fn shaped(&self, base: &Trial, taken: &Trial, thresholds: Thresholds) -> Shaped {
        let enough = thresholds.of_shape(taken);
        let beside = self.shape_left(taken, thresholds).map_or(0.0, |shape| match shape.nats {
            nats if nats > enough => self.fitted(taken, shape, thresholds).unwrap_or(0.0),
            nats => nats,
        });
        let instead = if taken.names.is_empty() { None } else { self.shape_instead(base, taken, thresholds) };
        Shaped { beside, instead: instead.map_or(f64::NEG_INFINITY, |(_, ahead)| ahead) }
    }

    /// The base model with a shape that leaves nothing of a record but noise, which no first effect does, and is ahead of each of those as one
    /// has to be that stands in their place: what pairs would make of such a force takes minutes and is refused for the shape.
    pub(super) fn shaped_alone(&self, base: &Trial, first: &Stage, thresholds: Thresholds) -> Option<Trial> {
        let at_noise = |trial: &Trial| {
            self.over_noise(trial).is_some_and(|times| times <= thresholds.most_over_noise(self.motion))
        };
        // At few samples a cycle neighbours may have nothing in common of what is far above the noise.
        let leaves_nothing =
            |trial: &Trial| trial.response.is_some() && trial.excess() <= trial.chance() && at_noise(trial);
        let best = first.finalists.iter().fold(base, verdict::better);
        if best.names.is_empty() || leaves_nothing(best) {
            return None;
        }
        let (shaped, ahead) = self.shape_instead(base, best, thresholds)?;
        let alone = ahead > thresholds.of_shape_instead(best) && leaves_nothing(&shaped);
        alone.then_some(shaped)
    }

    /// What a shape beside a trial brings to the steps of the fit when it is fitted, nothing where those held out speak against it.
    fn fitted(&self, taken: &Trial, shape: Shape, thresholds: Thresholds) -> Option<f64> {
        let doubt = doubt(&shape.expression, taken.response.as_ref()?, thresholds);
        let fitted =
            trial::respond(self.measured.as_ref()?, &self.with_shape(taken, shape.with), None, LONG)?;
        let beyond_one = 1.0 - self.share_of_one_part(&fitted, taken).unwrap_or(0.0);
        (verdict::gain(&fitted, taken) > 0.0).then(|| beyond_one * fitted.training_gain(taken) - doubt)
    }

    /// Share of one part, the one with most, in what a trial brings to a record without steps: where the mass jumps, or leaves its branch a little
    /// sooner than the model, any shape leads back. Nothing in one of steps, of which some tell by themselves.
    fn share_of_one_part(&self, with: &Trial, from: &Trial) -> Option<f64> {
        let measured = self.measured.as_ref().filter(|measured| measured.is_without_steps())?;
        let costs = |trial: &Trial| {
            let training = &trial.response.as_ref()?.training;
            measured.costs(&trial.refit.spec, Part::Training, training)
        };
        let gained: Vec<f64> =
            costs(from)?.iter().zip(costs(with)?).map(|(from, with)| from - with).collect();
        let all = gained.iter().sum::<f64>();
        let most = gained.into_iter().fold(0.0, f64::max);
        (all > 0.0).then(|| (most / all).min(1.0))
    }

    /// The shape that brings most beside a trial; none where the simulated response does not decide.
    pub fn shape_left(&self, trial: &Trial, thresholds: Thresholds) -> Option<Shape> {
        let (measured, response) = (self.measured.as_ref()?, trial.response.as_ref()?);
        let tangent = measured.tangent(&trial.refit.spec, &trial.refit.numbers, &response.training)?;
        let scales = candidates::scales(&trial.refit.spec, self.motion);
        let with = |start: &EffectSpec| candidates::beside(&trial.refit.spec, start);
        let starts: Vec<EffectSpec> = usable(&scales).collect();
        let told = to_first_order(&tangent, &starts, with, grown, |told| told.truncate(AGAIN));
        let shape = |(start, score): (EffectSpec, response::Score)| {
            let grown = with(&grown(&start, score.scale)?);
            let with = trial.refit.numbers.moved(grown, &score.followed, score.scale)?;
            let expression = start.expression?;
            let doubt = doubt(&expression, response, thresholds);
            Some(Shape { expression, nats: score.nats - doubt, with })
        };
        told.into_iter().filter_map(shape).max_by(|a, b| a.nats.total_cmp(&b.nats))
    }

    /// The shape on the base model that does best, and how much better than the effects that were taken: the one that brings most there
    /// to first order, the one most like what they do together, or, where that model is far off, the one that the force tells.
    fn shape_instead(&self, base: &Trial, taken: &Trial, thresholds: Thresholds) -> Option<(Trial, f64)> {
        let several = taken.names.len() >= SEVERAL;
        let most = self.shape_left(base, thresholds);
        let most = most.filter(|shape| several || shape.nats >= WORTH * taken.training_gain(base));
        let most = most.map(|shape| (shape.expression, shape.with));
        let like = if several { self.shape_like(base, taken) } else { None };
        let like = like.filter(|like| most.as_ref().is_none_or(|most| most.0 != like.0));
        let by_force = if base.is_far() { self.shape_by_the_force(base) } else { None };
        // A long record brings a shape to one place from wherever it starts.
        let long = self.measured.as_ref().is_some_and(Measured::is_long);
        let told = |shape: &(String, ModelSpec)| most.as_ref().is_some_and(|most| most.0 == shape.0);
        let by_force = by_force.filter(|shape| !(long && told(shape)));
        let ahead = |(expression, with): (String, ModelSpec)| {
            let doubt = doubt(&expression, taken.response.as_ref()?, thresholds);
            let fitted = self.fitted_instead(base, taken, with)?;
            let ahead = verdict::apart(&fitted, taken) - doubt;
            Some((fitted, ahead))
        };
        [most, like, by_force].into_iter().flatten().filter_map(ahead).max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// A shape beside the base model, fitted for as long as it may come to be better than what was taken.
    fn fitted_instead(&self, base: &Trial, taken: &Trial, with: ModelSpec) -> Option<Trial> {
        let measured = self.measured.as_ref()?;
        let fitted = trial::respond(measured, &self.with_shape(base, with), None, SHORT)?;
        let ahead = verdict::apart(&fitted, taken);
        let laid = fitted.response.as_ref().map(|response| &response.training);
        let promised = 0.5 * laid.map_or(0.0, Laid::promised);
        if ahead + PROMISED * promised < 0.0 {
            return Some(fitted);
        }
        trial::respond(measured, &fitted, laid, LONG)
    }

    /// The shape most like what the effects of a trial do together; none where no shape is much like it.
    fn shape_like(&self, base: &Trial, taken: &Trial) -> Option<(String, ModelSpec)> {
        let (share, shape) = self.most_like(&Likeness::new(&self.screening, base, taken)?, base)?;
        (share > LIKE).then_some(shape)
    }

    /// The shape most like the force that the base model leaves along the measured motion.
    fn shape_by_the_force(&self, base: &Trial) -> Option<(String, ModelSpec)> {
        Some(self.most_like(&Likeness::to_what_is_left(&self.screening, base)?, base)?.1)
    }

    /// The shape that has most of a force, its share of it, and the model with it.
    fn most_like(&self, likeness: &Likeness<'_>, base: &Trial) -> Option<(f64, (String, ModelSpec))> {
        let scales = candidates::scales(&base.refit.spec, self.motion);
        let like = |start: EffectSpec| {
            let like = likeness.of(&start, grown)?;
            Some((like.share, (start.expression?, like.with)))
        };
        usable(&scales).filter_map(like).max_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// A trial with a shape beside it, whose amplitude is to be fitted along with the trial's own numbers.
    fn with_shape(&self, from: &Trial, spec: ModelSpec) -> Trial {
        let mut with = from.with_expression(spec.clone(), &["f"], &candidates::scales(&spec, self.motion));
        // Differences of a faint amplitude are to be above the solver's errors.
        if let Some(free) = with.refit.numbers.free.last_mut() {
            free.scale = TYPICAL * free.start.abs();
        }
        with
    }
}

/// Shapes, faint, that a record with such motions has.
fn usable(scales: &Scales) -> impl Iterator<Item = EffectSpec> {
    let usable = SHAPES.into_iter().filter(|shape| !of_bumper(shape) || scales.penetration_m.is_some());
    usable.map(|shape| faint(shape, scales))
}

fn of_bumper(expression: &str) -> bool {
    expression.contains("pm")
}

/// Nats that what a shape brings may be wrong by.
fn doubt(expression: &str, response: &Response, thresholds: Thresholds) -> f64 {
    if of_bumper(expression) { thresholds.doubt(response) } else { 0.0 }
}

/// A shape with so many times its amplitude.
fn grown(start: &EffectSpec, factor: f64) -> Option<EffectSpec> {
    let mut spec = start.clone();
    *spec.parameters.get_mut("f")? *= factor;
    Some(spec)
}

/// A shape of small amplitude.
fn faint(expression: &'static str, scales: &Scales) -> EffectSpec {
    let all = [
        ("f", FAINT * scales.force_n),
        ("dm", scales.displacement_m),
        ("vm", scales.velocity_m_s),
        ("tm", scales.duration_s),
    ];
    let of_bumper = scales.penetration_m.map(|penetration_m| ("pm", penetration_m));
    let used = all.into_iter().chain(of_bumper).filter(|(name, _)| expression.contains(name));
    EffectSpec {
        name: expression::EFFECT.name.into(),
        expression: Some(expression.into()),
        parameters: used.map(|(name, value)| (name.to_owned(), value)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::search::Effort;
    use crate::diagnose::testing::{seen, with};
    use crate::identify::kinematics::Tolerances;
    use crate::identify::motion::Motion;
    use crate::model::build;
    use crate::model::effects::coulomb_friction;
    use crate::model::testing::{b1_g2, effect};

    #[test]
    fn every_shape_is_an_effect_that_can_be_simulated() {
        let scales = Scales::of_spec(&b1_g2(), 1.0 / 2048.0);
        for expression in SHAPES {
            let mut spec = b1_g2();
            spec.effects.push(faint(expression, &scales));
            assert!(build(&spec, 1.0 / 2048.0).is_ok(), "{expression}");
        }
    }

    /// Cubic damping is made up for by quadratic damping and a friction that turns round over a part of the velocities, to some tens
    /// of nats, wherever the base model is too far off for first order to find it.
    #[test]
    fn one_shape_is_found_in_place_of_two_effects_that_stand_in_for_it() {
        let both = [
            effect("quadratic-damping", &[("c2_n_s2_m2", 2500.0)]),
            effect("coulomb-friction", &[("fc_n", 2.0), (coulomb_friction::TURNING, 0.015)]),
        ];
        let cubic = EffectSpec {
            expression: Some("f*(v/vm)^3".into()),
            ..effect("expression", &[("f", 40.0), ("vm", 0.1)])
        };
        for (effects, stand_in) in [(&[cubic][..], true), (&both[..], false)] {
            let mut truth = b1_g2();
            truth.effects = effects.to_vec();
            let motion = Motion::of(&seen(&truth, 41), 500.0, Tolerances::default()).expect("a motion");
            let searcher = Searcher::new(&motion, &b1_g2(), Effort::default());
            let base = searcher.base(&b1_g2()).expect("fits");
            let taken = with(&searcher, &base, &both, Settings::default());
            let (like, _) = searcher.shape_like(&base, &taken).expect("much like it");
            assert_eq!(like, "f*(v/vm)^3");
            let thresholds = Thresholds::default();
            let (_, instead) = searcher.shape_instead(&base, &taken, thresholds).expect("fits");
            assert_eq!(instead > thresholds.of_shape_instead(&taken), stand_in, "{instead}");
        }
    }
}
