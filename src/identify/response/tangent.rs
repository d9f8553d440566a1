//! The response about a fitted model, linearised: a further effect is scored by one simulation, before any fit. Called by the
//! search for every start of every effect.

use super::descent::{Eliminated, Fitted};
use super::{HUBER, Laid, Measured, Nuisances, Specimens, Step};
use crate::identify::least_squares::dot;
use crate::identify::numbers::Numbers;
use crate::identify::problem::Part;
use crate::model::{EffectSpec, ModelSpec, effects};
use nalgebra::{DMatrix, DVector};

/// So many samples tell enough for first order; half of them of a long record, a quarter of a very long one.
const TOLD: usize = 80_000;
/// Every so many of the steps tell how large a change is.
const GLANCE: usize = 4;

/// The response about a fitted model, linearised: what a further effect would bring, to first order.
pub struct Tangent<'b, 'a> {
    measured: Measured<'a>,
    numbers: &'b Numbers,
    laid: Laid,
    /// Every so many steps of training are looked at.
    thinned: usize,
    steps: Vec<Step<'a>>,
    /// Their misfits, by the exact solver and by the general one: these differ by more than a faint effect does.
    misfits: [Vec<Vec<f64>>; 2],
    own: Vec<Eliminated>,
    gradient: DVector<f64>,
    inverse: DMatrix<f64>,
}

impl<'a> Measured<'a> {
    /// Linearises the response to the training steps about a fitted model.
    pub fn tangent<'b>(
        &self,
        spec: &ModelSpec,
        numbers: &'b Numbers,
        laid: &Laid,
    ) -> Option<Tangent<'b, 'a>> {
        // Of a long record a part tells enough.
        let samples: usize = self.training.iter().map(|k| self.motion.windows[*k].range.len()).sum();
        let told = match (self.is_long(), self.is_very_long()) {
            (_, true) => TOLD / 4,
            (true, false) => TOLD / 2,
            (false, false) => TOLD,
        };
        let thinned = samples.div_ceil(told).max(1);
        let mut laid = laid.clone();
        laid.nuisances = laid.nuisances.into_iter().step_by(thinned).collect();
        self.every(thinned).linear(spec, numbers, laid, thinned)
    }

    fn linear<'b>(
        self,
        spec: &ModelSpec,
        numbers: &'b Numbers,
        laid: Laid,
        thinned: usize,
    ) -> Option<Tangent<'b, 'a>> {
        let free = self.free(numbers, 0.0);
        let (_, steps) = self.lay(spec, Part::Training, &laid.values, &laid.nuisances)?;
        let fitted = Fitted::new(spec, numbers, &free, false);
        let system = self.linearise(&fitted, &laid.values, &laid.nuisances, &steps, None)?;
        let mut normal = system.normal.clone();
        let mut gradient = system.gradient.clone();
        for (j, f) in free.iter().enumerate().filter(|(_, f)| f.prior.1.is_finite()) {
            normal[(j, j)] += f.prior.1.powi(-2);
            gradient[j] += (laid.values[j] - f.prior.0) * f.prior.1.powi(-2);
        }
        let scale: Vec<f64> = (0..free.len()).map(|j| 1.0 / normal[(j, j)].max(1e-300).sqrt()).collect();
        let scaled = DMatrix::from_fn(free.len(), free.len(), |i, j| normal[(i, j)] * scale[i] * scale[j]);
        let inverse = scaled.cholesky()?.inverse();
        let inverse = DMatrix::from_fn(free.len(), free.len(), |i, j| inverse[(i, j)] * scale[i] * scale[j]);
        let misfit = |(step, own): (&Step<'_>, &Vec<f64>)| {
            self.white_misfit(step.window, &step.simulated, self.common(&laid.values, step.window), own)
        };
        let own: Vec<_> = steps.iter().zip(&laid.nuisances).map(misfit).collect();
        let mut general = own.clone();
        if is_piecewise_linear(spec) {
            let mut specimens = self.specimens(&with_nothing(spec))?;
            for ((step, own), general) in steps.iter().zip(&laid.nuisances).zip(&mut general) {
                let common = self.common(&laid.values, step.window);
                let simulated = self.simulate(&mut specimens, step.window, common, own);
                *general = self.white_misfit(step.window, &simulated, common, own);
            }
        }
        let misfits = [own, general];
        let own = system.own;
        Some(Tangent { measured: self, numbers, laid, thinned, steps, misfits, own, gradient, inverse })
    }
}

/// Whether the exact solver takes a model.
pub(super) fn is_piecewise_linear(spec: &ModelSpec) -> bool {
    effects::are_piecewise_linear(&spec.effects)
}

/// The same model, in the hands of the general solver.
fn with_nothing(spec: &ModelSpec) -> ModelSpec {
    let mut spec = spec.clone();
    let parameters = [("c2_n_s2_m2".to_owned(), 0.0)].into_iter().collect();
    spec.effects.push(EffectSpec { name: "quadratic-damping".into(), expression: None, parameters });
    spec
}

/// What an effect brings to first order.
#[derive(Clone, Debug)]
pub struct Score {
    /// Gain of log-likelihood.
    pub nats: f64,
    /// What the effect is scaled by.
    pub scale: f64,
    /// Change that the effect as given makes, in units of the noise, rms: to first order only while it is not large.
    pub change: f64,
    /// How far each value of the model moves for a scale of 1.
    pub followed: Vec<f64>,
    /// The same of the nuisances of each step.
    beside: Vec<Nuisances>,
}

impl Tangent<'_, '_> {
    /// What a model with a faint effect more brings when the effect is scaled at will and everything else follows (score
    /// test, Rao 1948).
    pub fn score(&self, with: &ModelSpec) -> Option<Score> {
        self.project(with, None)
    }

    /// The same with everything else moved already as `score` has it follow. What the effect alone changes is mostly taken up again,
    /// and where it shifts contacts it is not of first order at all.
    pub fn score_again(&self, with: &ModelSpec, score: &Score) -> Option<Score> {
        self.project(with, Some(score))
    }

    /// Change that an effect as given makes, as [`Score::change`], by some of the steps.
    pub fn change(&self, with: &ModelSpec) -> Option<f64> {
        let measured = &self.measured;
        let values = &self.laid.values;
        let misfits = &self.misfits[usize::from(!is_piecewise_linear(with))];
        let mut specimens = measured.specimens(with)?;
        let (mut power, mut count) = (0.0, 0usize);
        for k in (0..self.steps.len()).step_by(GLANCE) {
            let changed = self.changed(&mut specimens, k, values, &self.laid.nuisances[k], &misfits[k]);
            power += self.own[k].weight * dot(&changed, &changed);
            count += changed.len();
        }
        power.is_finite().then(|| (power / count.max(1) as f64).sqrt())
    }

    /// Change of a step's misfit that specimens make.
    fn changed(
        &self,
        specimens: &mut Specimens,
        k: usize,
        values: &[f64],
        nuisances: &[f64],
        before: &[f64],
    ) -> Vec<f64> {
        let window = self.steps[k].window;
        let common = self.measured.common(values, window);
        let simulated = self.measured.simulate(specimens, window, common, nuisances);
        let mut changed = self.measured.white_misfit(window, &simulated, common, nuisances);
        changed.iter_mut().zip(before).for_each(|(c, r)| *c -= r);
        changed
    }

    fn project(&self, with: &ModelSpec, moved: Option<&Score>) -> Option<Score> {
        let measured = &self.measured;
        let mut values = self.laid.values.clone();
        let mut spec = with.clone();
        if let Some(score) = moved {
            spec = self.numbers.moved(spec, &score.followed, 1.0)?;
            values.iter_mut().zip(&score.followed).for_each(|(x, by)| *x += by);
        }
        let mut specimens = measured.specimens(&spec)?;
        let (mut square, mut slope) = (0.0, 0.0);
        let (mut power, mut count) = (0.0, 0usize);
        let mut mixed = DVector::zeros(self.gradient.len());
        let mut inners = Vec::with_capacity(self.steps.len());
        let misfits = &self.misfits[usize::from(!is_piecewise_linear(with))];
        for (k, (step, own)) in self.steps.iter().zip(&self.own).enumerate() {
            let weight = own.weight;
            let mut nuisances = self.laid.nuisances[k].clone();
            if let Some(score) = moved {
                nuisances.iter_mut().zip(&score.beside[k]).for_each(|(x, by)| *x += by);
            }
            let mut changed = self.changed(&mut specimens, k, &values, &nuisances, &misfits[k]);
            let large =
                step.residuals[..step.simulated.len()].iter().enumerate().filter(|(_, r)| r.abs() > HUBER);
            large.for_each(|(i, r)| changed[i] *= HUBER / r.abs());
            if changed.iter().any(|c| !c.is_finite()) {
                return None;
            }
            let against = |columns: &[Vec<f64>]| {
                DVector::from_fn(columns.len(), |i, _| weight * dot(&columns[i], &changed))
            };
            power += weight * dot(&changed, &changed);
            count += changed.len();
            let inner = against(&own.beside);
            let eliminated = &own.inverse * &inner;
            square += weight * dot(&changed, &changed) - inner.dot(&eliminated);
            slope += weight * dot(&changed, &step.residuals) - own.pull.dot(&eliminated);
            mixed += against(&own.along) - &own.mixed * &eliminated;
            inners.push(inner);
        }
        let through = &self.inverse * &mixed;
        let (square, slope) = (square - mixed.dot(&through), slope - self.gradient.dot(&through));
        let mut followed: Vec<f64> = through.iter().map(|x| -x).collect();
        let follow = |(own, inner): (&Eliminated, DVector<f64>)| -> Nuisances {
            let step = &own.inverse * (inner - own.mixed.transpose() * &through);
            step.iter().map(|x| -x).collect()
        };
        let mut beside: Vec<Nuisances> = self.own.iter().zip(inners).map(follow).collect();
        if let Some(score) = moved {
            let add = |to: &mut [f64], by: &[f64]| to.iter_mut().zip(by).for_each(|(x, by)| *x += by);
            add(&mut followed, &score.followed);
            beside.iter_mut().zip(&score.beside).for_each(|(to, by)| add(to, by));
        }
        (square > 0.0).then(|| Score {
            nats: 0.5 * self.thinned as f64 * slope * slope / square,
            scale: -slope / square,
            change: (power / count.max(1) as f64).sqrt(),
            followed,
            beside,
        })
    }
}
