//! Search among values that slopes say nothing about: peaks lie on the steps of a sweep and jump with them, so
//! that an objective made of them has terraces and cliffs. [`super::fit`] ends with it.
//!
//! Deterministic: the same objective from the same start ends at the same place.

use crate::identify::least_squares::Free;
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

/// Largest step, in the scales of the numbers, below which a search is over.
const ENDED: f64 = 2e-3;

/// Rates of the strategy, from the number of free numbers (Hansen's defaults).
struct Rates {
    weights: Vec<f64>,
    population: usize,
    effective: f64,
    /// Of the path and the update of the covariance, and of the best so far in it.
    path: f64,
    one: f64,
    many: f64,
    /// Of the path of the step, and its damping.
    step: f64,
    damping: f64,
    /// Expected length of a standard normal vector.
    length: f64,
}

impl Rates {
    fn of(numbers: usize) -> Self {
        let n = numbers as f64;
        let population = 4 + (3.0 * n.ln()).floor().max(0.0) as usize;
        let parents = population / 2;
        let raw: Vec<f64> = (1..=parents).map(|i| (parents as f64 + 0.5).ln() - (i as f64).ln()).collect();
        let sum: f64 = raw.iter().sum();
        let weights: Vec<f64> = raw.iter().map(|w| w / sum).collect();
        let effective = 1.0 / weights.iter().map(|w| w * w).sum::<f64>();
        let one = 2.0 / ((n + 1.3).powi(2) + effective);
        let step = (effective + 2.0) / (n + effective + 5.0);
        Self {
            population,
            effective,
            path: (4.0 + effective / n) / (n + 4.0 + 2.0 * effective / n),
            one,
            many: (1.0 - one)
                .min(2.0 * (effective - 2.0 + 1.0 / effective) / ((n + 2.0).powi(2) + effective)),
            step,
            damping: 1.0 + 2.0 * (((effective - 1.0) / (n + 1.0)).max(0.0).sqrt() - 1.0).max(0.0) + step,
            length: n.sqrt() * (1.0 - 0.25 / n + 1.0 / (21.0 * n * n)),
            weights,
        }
    }
}

/// Where the least of an objective (with the priors of its numbers) is found about a start, and its value there,
/// by an evolution strategy with adapted covariance (N. Hansen, The CMA Evolution Strategy: A Tutorial, 2016,
/// arXiv 1604.00772) that begins as wide in every direction as `covariance` says and looks at about `trials`
/// places. Never worse than the start.
pub(super) fn search(
    free: &[Free],
    start: Vec<f64>,
    covariance: &DMatrix<f64>,
    trials: usize,
    objective: &mut impl FnMut(&[f64]) -> f64,
) -> (Vec<f64>, f64) {
    let n = free.len();
    let mut cost = |x: &[f64]| -> f64 {
        let prior = |(free, x): (&Free, &f64)| ((x - free.prior.0) / free.prior.1).powi(2);
        let value = objective(x) + free.iter().zip(x).map(prior).sum::<f64>();
        if value.is_finite() { value } else { f64::INFINITY }
    };
    let mut best = (cost(&start), DVector::from_vec(start));
    let rates = Rates::of(n.max(1));
    if n == 0 || trials < rates.population {
        return (best.1.as_slice().to_vec(), best.0);
    }
    let mut random = rand_pcg::Pcg64::seed_from_u64(20_200_608);
    let (mut mean, mut shape, mut reach) = (best.1.clone(), covariance.clone(), 1.0);
    let (mut path, mut step_path) = (DVector::zeros(n), DVector::zeros(n));
    let scale = DVector::from_iterator(n, free.iter().map(|free| free.scale));
    for generation in 1..=(trials / rates.population) as i32 {
        let eigen = SymmetricEigen::new(shape.clone());
        let spread = eigen.eigenvalues.map(|value| value.max(1e-18).sqrt());
        let turn = &eigen.eigenvectors;
        let mut trial = || {
            let wide = DVector::from_fn(n, |i, _| {
                let normal: f64 = StandardNormal.sample(&mut random);
                spread[i] * normal
            });
            let mut x = &mean + reach * (turn * wide);
            x.iter_mut().zip(free).for_each(|(x, free)| *x = x.clamp(free.bounds.0, free.bounds.1));
            (cost(x.as_slice()), x)
        };
        let mut ranked: Vec<(f64, DVector<f64>)> = (0..rates.population).map(|_| trial()).collect();
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        if ranked[0].0 < best.0 {
            best = ranked[0].clone();
        }
        let steps: Vec<DVector<f64>> = ranked.iter().map(|(_, x)| (x - &mean) / reach).collect();
        let weighted = || steps.iter().zip(&rates.weights);
        let moved = weighted().fold(DVector::zeros(n), |sum, (step, weight)| sum + *weight * step);
        mean += reach * &moved;
        let white = turn * (turn.transpose() * &moved).component_div(&spread);
        step_path = (1.0 - rates.step) * step_path
            + (rates.step * (2.0 - rates.step) * rates.effective).sqrt() * white;
        let settled = (1.0 - (1.0 - rates.step).powi(2 * generation)).sqrt();
        let stalls = step_path.norm() / settled > (1.4 + 2.0 / (n as f64 + 1.0)) * rates.length;
        path *= 1.0 - rates.path;
        if !stalls {
            path += (rates.path * (2.0 - rates.path) * rates.effective).sqrt() * moved;
        }
        shape *= 1.0 - rates.one - rates.many;
        shape += rates.one * &path * path.transpose();
        for (step, weight) in weighted() {
            shape += rates.many * *weight * step * step.transpose();
        }
        reach *=
            ((rates.step / rates.damping) * (step_path.norm() / rates.length - 1.0)).clamp(-1.0, 1.0).exp();
        let widest = (0..n).map(|i| reach * shape[(i, i)].max(0.0).sqrt() / scale[i]).fold(0.0, f64::max);
        if widest < ENDED {
            break;
        }
    }
    (best.1.as_slice().to_vec(), best.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn free(prior: f64) -> Free {
        let bounds = (-10.0, 10.0);
        Free { key: "x".to_owned(), start: 0.0, scale: 1.0, prior: (0.0, prior), bounds }
    }

    #[test]
    fn the_bottom_of_a_terraced_valley_is_found() {
        // A valley of condition 1e4 along a diagonal, in terraces that hide every slope.
        let mut evaluations = 0;
        let mut terraces = |x: &[f64]| {
            evaluations += 1;
            let along: f64 = x.iter().map(|x| x - 1.0).sum::<f64>() / 5.0;
            let across: f64 = x.iter().map(|x| (x - 1.0 - along).powi(2)).sum();
            (4.0 * (along * along + 1e4 * across)).round() / 4.0
        };
        let numbers = vec![free(1e3); 5];
        let began = terraces(&[0.0, 0.3, 0.1, -0.2, 0.4]);
        let wide = DMatrix::from_diagonal_element(5, 5, 0.25);
        let (x, least) = search(&numbers, vec![0.0, 0.3, 0.1, -0.2, 0.4], &wide, 2000, &mut terraces);
        assert!(began > 500.0 && least < 0.26, "{began} to {least} at {x:?}");
        assert!(evaluations <= 2001);
    }

    #[test]
    fn priors_count_and_a_start_is_never_left_for_worse() {
        let wide = DMatrix::from_diagonal_element(1, 1, 1.0);
        let (x, least) = search(&[free(1.0)], vec![3.0], &wide, 600, &mut |x| (x[0] - 2.0).powi(2));
        assert!((x[0] - 1.0).abs() < 0.02 && (least - 2.0).abs() < 1e-3, "{x:?} {least}");
        let (x, least) = search(&[free(f64::INFINITY)], vec![0.5], &wide, 600, &mut |x| {
            if x[0] == 0.5 { 1.0 } else { f64::NAN }
        });
        assert_eq!((x[0], least), (0.5, 1.0));
        let (x, _) = search(&[], Vec::new(), &DMatrix::zeros(0, 0), 100, &mut |_| 1.0);
        assert!(x.is_empty());
    }
}
