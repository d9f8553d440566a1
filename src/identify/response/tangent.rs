//! The response about a fitted model, linearised: a further effect is scored by one simulation, before any fit. Called by the
//! search for every start of every effect.

use super::descent::{Eliminated, Fitted};
use super::{COMMON, HUBER, Laid, Measured, Step};
use crate::identify::least_squares::dot;
use crate::identify::numbers::Numbers;
use crate::identify::problem::Part;
use crate::model::ModelSpec;
use nalgebra::{DMatrix, DVector};

/// The response about a fitted model, linearised: what a further effect would bring, to first order.
pub struct Tangent<'b, 'a> {
    measured: &'b Measured<'a>,
    laid: &'b Laid,
    steps: Vec<Step<'a>>,
    /// Their misfits.
    misfits: Vec<Vec<f64>>,
    own: Vec<Eliminated>,
    gradient: DVector<f64>,
    inverse: DMatrix<f64>,
}

impl<'a> Measured<'a> {
    /// Linearises the response to the training steps about a fitted model.
    pub fn tangent<'b>(
        &'b self,
        spec: &ModelSpec,
        numbers: &'b Numbers,
        laid: &'b Laid,
    ) -> Option<Tangent<'b, 'a>> {
        let free = self.free(numbers, 0.0);
        let (_, steps) = self.lay(spec, Part::Training, &laid.values, &laid.nuisances)?;
        let fitted = Fitted { spec: spec.clone(), numbers, free: &free, moving: true };
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
        let common = &laid.values[laid.values.len() - COMMON..];
        let misfit =
            |(step, own): (&Step<'_>, &Vec<f64>)| self.misfit(step.window, &step.simulated, common, own);
        let misfits = steps.iter().zip(&laid.nuisances).map(misfit).collect();
        Some(Tangent { measured: self, laid, steps, misfits, own: system.own, gradient, inverse })
    }
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
}

impl Tangent<'_, '_> {
    /// What a model with a faint effect more brings when the effect is scaled at will and everything else follows (score
    /// test, Rao 1948).
    pub fn score(&self, with: &ModelSpec) -> Option<Score> {
        let measured = self.measured;
        let values = &self.laid.values;
        let common = &values[values.len() - COMMON..];
        let mut specimens = measured.specimens(with)?;
        let (mut square, mut slope) = (0.0, 0.0);
        let (mut power, mut count) = (0.0, 0usize);
        let mut mixed = DVector::zeros(self.gradient.len());
        let steps = self.steps.iter().zip(&self.misfits).zip(&self.own).zip(&self.laid.nuisances);
        for (((step, before), own), nuisances) in steps {
            let weight = own.weight;
            let simulated = measured.simulate(&mut specimens, step.window, common[0], nuisances);
            let mut changed = measured.misfit(step.window, &simulated, common, nuisances);
            changed.iter_mut().zip(before).for_each(|(c, r)| *c -= r);
            let large = step.residuals[..simulated.len()].iter().enumerate().filter(|(_, r)| r.abs() > HUBER);
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
        }
        let through = &self.inverse * &mixed;
        let (square, slope) = (square - mixed.dot(&through), slope - self.gradient.dot(&through));
        (square > 0.0).then(|| Score {
            nats: 0.5 * slope * slope / square,
            scale: -slope / square,
            change: (power / count.max(1) as f64).sqrt(),
            followed: through.iter().map(|x| -x).collect(),
        })
    }
}
