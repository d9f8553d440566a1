//! Damped Gauss-Newton for weighted residuals with Gaussian priors and bounds.
//!
//! Identification and diagnosis both minimise `sum r_i(x)^2 + sum ((x_j - mean_j)/sigma_j)^2`
//! where the residuals come from an imposed motion or from a simulation. The normal matrix is all
//! that is kept of the Jacobian. (Levenberg 1944; Marquardt 1963; intervals: Seber and Wild,
//! Nonlinear Regression, 1989, ch. 2.)

use crate::parallel;
use nalgebra::{DMatrix, DVector};

/// One free number of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Free {
    /// Dotted key in the model file, or a name of a nuisance.
    pub key: String,
    /// Where the fit starts.
    pub start: f64,
    /// Typical change, which scales the number and the finite differences; above zero.
    pub scale: f64,
    /// Prior mean and standard deviation; infinite for none.
    pub prior: (f64, f64),
    /// Lowest and highest allowed value.
    pub bounds: (f64, f64),
}

/// Where a fit ended.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Best values, in the order of the free numbers.
    pub values: Vec<f64>,
    /// Sum of squared residuals without the priors.
    pub residual_sum: f64,
    /// Sum of the squared prior terms.
    pub prior_sum: f64,
    /// Number of residuals.
    pub count: usize,
    /// Normal matrix `J'J` of the residuals alone, in units of the free numbers.
    pub information: DMatrix<f64>,
    /// Iterations used.
    pub iterations: usize,
}

impl Fit {
    /// Covariance with the priors, each residual counting `1/inflation` of an independent one.
    pub fn covariance(&self, free: &[Free], inflation: f64) -> DMatrix<f64> {
        covariance(&self.information, free, inflation)
    }
}

/// Covariance of what such information and the priors tell, each residual counting `1/inflation` of an independent one.
pub fn covariance(information: &DMatrix<f64>, free: &[Free], inflation: f64) -> DMatrix<f64> {
    let n = free.len();
    let mut matrix = information / inflation.max(1e-300);
    for (j, number) in free.iter().enumerate() {
        if number.prior.1.is_finite() {
            matrix[(j, j)] += 1.0 / number.prior.1.powi(2);
        }
    }
    // Scaled to unit diagonal before inversion: the numbers span many decades.
    let d: Vec<f64> = (0..n).map(|j| matrix[(j, j)].max(1e-300).sqrt()).collect();
    let scaled = DMatrix::from_fn(n, n, |i, j| matrix[(i, j)] / (d[i] * d[j]));
    let inverse = scaled
        .clone()
        .cholesky()
        .map(|c| c.inverse())
        .or_else(|| scaled.pseudo_inverse(1e-12).ok())
        .unwrap_or_else(|| DMatrix::identity(n, n) * 1e12);
    DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] / (d[i] * d[j]))
}

/// Settings of the iteration.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// At most so many accepted or refused steps.
    pub iterations: usize,
    /// Ends when the relative decrease of the objective falls below this.
    pub tolerance: f64,
    /// Finite-difference step as a fraction of a number's scale.
    pub difference: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { iterations: 12, tolerance: 1e-6, difference: 1e-3 }
    }
}

/// Minimises the residuals over the free numbers. `residuals` fills the vector for given values
/// (always the same length) and returns false where the model cannot be evaluated; it is called from several cores at once.
///
/// `None` when the start itself cannot be evaluated.
pub fn fit(
    free: &[Free],
    settings: Settings,
    residuals: impl Fn(&[f64], &mut Vec<f64>) -> bool + Sync,
) -> Option<Fit> {
    let mut x: Vec<f64> = free.iter().map(|f| f.start.clamp(f.bounds.0, f.bounds.1)).collect();
    let mut r = Vec::new();
    if !residuals(&x, &mut r) || r.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let mut cost = sum_of_squares(&r) + prior_sum(free, &x);
    let mut damping = 1e-4;
    let mut shifted = Vec::with_capacity(r.len());
    let mut system = linearise(free, settings, &x, &r, &residuals);
    let mut used = 0;
    while used < settings.iterations {
        used += 1;
        let Some(trial) = damped_step(free, &x, &system.0, &system.1, damping) else { break };
        let sound = residuals(&trial, &mut shifted) && shifted.iter().all(|v| v.is_finite());
        let trial_cost =
            if sound { sum_of_squares(&shifted) + prior_sum(free, &trial) } else { f64::INFINITY };
        if trial_cost < cost {
            let decrease = (cost - trial_cost) / cost.max(1e-300);
            x = trial;
            std::mem::swap(&mut r, &mut shifted);
            cost = trial_cost;
            damping = (damping * 0.1).max(1e-9);
            system = linearise(free, settings, &x, &r, &residuals);
            if decrease < settings.tolerance {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e6 {
                break;
            }
        }
    }
    Some(Fit {
        residual_sum: sum_of_squares(&r),
        prior_sum: prior_sum(free, &x),
        values: x,
        count: r.len(),
        information: system.0,
        iterations: used,
    })
}

/// `(J'J, J'r)` by one-sided differences, away from a bound.
fn linearise(
    free: &[Free],
    settings: Settings,
    x: &[f64],
    r: &[f64],
    residuals: &(impl Fn(&[f64], &mut Vec<f64>) -> bool + Sync),
) -> (DMatrix<f64>, DVector<f64>) {
    let n = free.len();
    let each: Vec<usize> = (0..n).collect();
    let jacobian = parallel::map(&each, parallel::cores(), |&j| {
        let (mut at, mut column) = (x.to_vec(), Vec::with_capacity(r.len()));
        let mut h = settings.difference * free[j].scale;
        if x[j] + h > free[j].bounds.1 {
            h = -h;
        }
        at[j] = x[j] + h;
        if residuals(&at, &mut column) && column.len() == r.len() {
            column.iter_mut().zip(r).for_each(|(b, a)| {
                let slope = (*b - a) / h;
                *b = if slope.is_finite() { slope } else { 0.0 };
            });
        } else {
            column.clear();
            column.resize(r.len(), 0.0);
        }
        column
    });
    let mut normal = DMatrix::zeros(n, n);
    let mut gradient = DVector::zeros(n);
    for j in 0..n {
        gradient[j] = dot(&jacobian[j], r);
        for i in 0..=j {
            let value = dot(&jacobian[i], &jacobian[j]);
            normal[(i, j)] = value;
            normal[(j, i)] = value;
        }
    }
    (normal, gradient)
}

/// Values after a damped step that stays within the bounds: what would leave them is held there, and the rest moves as is best
/// with it there. `normal` and `gradient` are `J'J` and `J'r` of the residuals alone.
pub fn damped_step(
    free: &[Free],
    x: &[f64],
    normal: &DMatrix<f64>,
    gradient: &DVector<f64>,
    damping: f64,
) -> Option<Vec<f64>> {
    let n = free.len();
    let s: Vec<f64> = free.iter().map(|f| f.scale).collect();
    let mut matrix = DMatrix::from_fn(n, n, |i, j| normal[(i, j)] * s[i] * s[j]);
    let mut right = DVector::from_fn(n, |j, _| -gradient[j] * s[j]);
    for j in 0..n {
        let (mean, sigma) = free[j].prior;
        if sigma.is_finite() {
            let weight = s[j] / sigma;
            matrix[(j, j)] += weight * weight;
            right[j] -= weight * (x[j] - mean) / sigma;
        }
    }
    let floor = (0..n).map(|j| matrix[(j, j)]).fold(0.0, f64::max) * 1e-15;
    for j in 0..n {
        let d = matrix[(j, j)];
        matrix[(j, j)] = d * (1.0 + damping) + floor.max(1e-300);
    }
    let mut held = vec![false; n];
    let mut moved = x.to_vec();
    loop {
        let moves: Vec<usize> = (0..n).filter(|j| !held[*j]).collect();
        let part = DMatrix::from_fn(moves.len(), moves.len(), |a, b| matrix[(moves[a], moves[b])]);
        let beside = |i: usize| -> f64 {
            (0..n).filter(|j| held[*j]).map(|j| matrix[(i, j)] * (moved[j] - x[j]) / s[j]).sum()
        };
        let rest = DVector::from_fn(moves.len(), |a, _| right[moves[a]] - beside(moves[a]));
        let solution = part.cholesky()?.solve(&rest);
        let mut left = false;
        for (a, &j) in moves.iter().enumerate() {
            let to = x[j] + solution[a] * s[j];
            moved[j] = to.clamp(free[j].bounds.0, free[j].bounds.1);
            held[j] = moved[j] != to;
            left |= held[j];
        }
        if !left {
            return Some(moved);
        }
    }
}

/// Squares of the priors: how far values lie from what was expected of them.
pub fn prior_sum(free: &[Free], x: &[f64]) -> f64 {
    free.iter()
        .zip(x)
        .filter(|(f, _)| f.prior.1.is_finite())
        .map(|(f, value)| ((value - f.prior.0) / f.prior.1).powi(2))
        .sum()
}

/// Sum of squares.
pub fn sum_of_squares(r: &[f64]) -> f64 {
    dot(r, r)
}

/// Partial sums of a scalar product, so that the compiler may use vector registers and need not wait for the last sum.
const PARTIAL: usize = 8;

/// Scalar product.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; PARTIAL];
    let (chunks_a, chunks_b) = (a.chunks_exact(PARTIAL), b.chunks_exact(PARTIAL));
    let rest: f64 = chunks_a.remainder().iter().zip(chunks_b.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in chunks_a.zip(chunks_b) {
        for k in 0..PARTIAL {
            sums[k] += x[k] * y[k];
        }
    }
    sums.iter().sum::<f64>() + rest
}

/// Samples of all columns that [`gram`] and [`mixed_gram`] take at a time, so that they stay in the cache.
const BLOCK: usize = 512;

/// Scalar products of every column with every other: columns x columns. All columns are of the same length.
pub fn gram(columns: &[Vec<f64>]) -> DMatrix<f64> {
    mixed_gram(columns, columns)
}

/// Scalar products of every column of one set with every one of another: columns of the first x of the second. All columns are
/// of the same length.
pub fn mixed_gram(first: &[Vec<f64>], second: &[Vec<f64>]) -> DMatrix<f64> {
    let mut sums = DMatrix::zeros(first.len(), second.len());
    let samples = first.iter().map(Vec::len).min().unwrap_or(0);
    for start in (0..samples).step_by(BLOCK) {
        let block = start..(start + BLOCK).min(samples);
        let across = DMatrix::from_fn(first.len(), block.len(), |i, n| first[i][start + n]);
        let along = DMatrix::from_iterator(
            block.len(),
            second.len(),
            second.iter().flat_map(|column| column[block.clone()].iter().copied()),
        );
        sums.gemm(1.0, &across, &along, 1.0);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    fn free(key: &str, start: f64, scale: f64) -> Free {
        Free {
            key: key.into(),
            start,
            scale,
            prior: (0.0, f64::INFINITY),
            bounds: (f64::NEG_INFINITY, f64::INFINITY),
        }
    }

    #[test]
    fn a_decay_is_found_with_its_interval() {
        let t: Vec<f64> = (0..200).map(|i| i as f64 * 0.05).collect();
        let y: Vec<f64> = t.iter().map(|t| 3.0 * (-0.4 * t).exp()).collect();
        let free = [free("a", 1.0, 1.0), free("b", 0.1, 0.1)];
        let fit = fit(&free, Settings::default(), |x, r| {
            r.clear();
            r.extend(t.iter().zip(&y).map(|(t, y)| (x[0] * (-x[1] * t).exp() - y) / 0.01));
            true
        })
        .expect("starts");
        assert!((fit.values[0] - 3.0).abs() < 1e-6 && (fit.values[1] - 0.4).abs() < 1e-6, "{fit:?}");
        let covariance = fit.covariance(&free, 1.0);
        assert!(covariance[(0, 0)] > 0.0 && covariance[(0, 0)] < 1e-3);
    }

    #[test]
    fn what_meets_its_bound_does_not_hold_up_the_rest() {
        // Two numbers that pull on one another: with the first at its bound the second has its best at 5, not at 1.
        let mut numbers = [free("a", 0.0, 1.0), free("b", 0.0, 1.0)];
        numbers[0].bounds = (-1.0, 1.0);
        let fit = fit(&numbers, Settings::default(), |x, r| {
            r.clear();
            r.extend([x[0] + x[1] - 6.0, 0.01 * (x[0] - 5.0)]);
            true
        })
        .expect("starts");
        assert!((fit.values[0] - 1.0).abs() < 1e-12 && (fit.values[1] - 5.0).abs() < 1e-6, "{fit:?}");
    }

    #[test]
    fn a_prior_holds_what_the_data_does_not_tell() {
        let mut numbers = [free("a", 1.0, 1.0), free("idle", 5.0, 1.0)];
        numbers[1].prior = (5.0, 0.5);
        let fit = fit(&numbers, Settings::default(), |x, r| {
            r.clear();
            r.push(x[0] - 2.0);
            true
        })
        .expect("starts");
        assert_eq!(fit.values[1], 5.0);
        assert!((fit.covariance(&numbers, 1.0)[(1, 1)].sqrt() - 0.5).abs() < 1e-9);
    }
}
