//! Re-fitting a model to a motion: force domain first, then the simulated response.

use super::least_squares::{self, Fit, Free, Settings};
use super::motion::Motion;
use super::numbers::{Number, Numbers};
use super::problem::{Part, Problem};
use crate::model::ModelSpec;
use crate::record::Kind;
use serde::Serialize;

/// Standard deviations to each side within which 95 % are.
const TIMES: f64 = 1.96;

/// A model fitted to a motion.
#[derive(Clone, Debug)]
pub struct Refit {
    /// The fitted model.
    pub spec: ModelSpec,
    /// What was moved.
    pub numbers: Numbers,
    /// Zero of the displacement sensor, m: true displacement = measured + zero.
    pub zero_m: f64,
    /// The fit; the last value is the zero.
    pub fit: Fit,
    /// How many residuals count as one independent one (coloured residuals).
    pub inflation: f64,
    /// Standard deviations of the values, coloured residuals considered.
    pub sigmas: Vec<f64>,
    /// 95 % limits of the values as the fit moves them, where the profile of the likelihood was followed; else empty.
    pub limits: Vec<(f64, f64)>,
}

/// A number of a model that was fitted.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FittedNumber {
    /// Key in the model file.
    pub key: String,
    /// In the model that was given; of an effect's parameter, where it started.
    pub nominal: f64,
    /// Best value.
    pub value: f64,
    /// Lower end of the 95 % interval.
    pub low95: f64,
    /// Upper end.
    pub high95: f64,
    /// It ended at the limit of what it may be, given the model file's uncertainty: the record asks for more, or for less.
    pub at_limit: bool,
}

/// Share of the way from a start to a limit that a number at the limit falls short of it at most.
const SHORT_OF_LIMIT: f64 = 1e-4;
/// Share of what a number was given as that is nothing.
const NOTHING: f64 = 1e-3;

impl FittedNumber {
    /// What is to be said behind it.
    pub fn remark(&self) -> &'static str {
        if self.at_limit { "; at the limit of what it may be, see its uncertainty" } else { "" }
    }
}

impl Refit {
    /// All that was fitted of what a given model has.
    pub fn fitted(&self, given: &ModelSpec) -> Vec<FittedNumber> {
        let of = |number: &Number| {
            let (value, low95, high95) = self.interval(&number.key)?;
            let nominal = given.get(&number.key).ok()?;
            let at_limit = self.is_at_limit(&number.key);
            Some(FittedNumber { key: number.key.clone(), nominal, value, low95, high95, at_limit })
        };
        self.numbers.numbers.iter().filter_map(of).collect()
    }

    /// Whether a number ended at a limit.
    fn is_at_limit(&self, key: &str) -> bool {
        let mut all = self.numbers.free.iter().zip(&self.fit.values);
        all.find(|(free, _)| free.key == key).is_some_and(
            |(Free { bounds: (low, high), start, prior, .. }, value)| {
                let short_of = |limit: f64| (value - limit).abs() <= SHORT_OF_LIMIT * (start - limit).abs();
                // What may vanish and does is none.
                let is_nothing = |limit: f64| limit.abs() < NOTHING * prior.0.abs();
                [*low, *high].into_iter().any(|limit| short_of(limit) && !is_nothing(limit))
            },
        )
    }

    /// Value and 95 % interval of a key.
    pub fn interval(&self, key: &str) -> Option<(f64, f64, f64)> {
        let index = self.numbers.numbers.iter().position(|n| n.key == key)?;
        let (value, half) = (self.fit.values[index], TIMES * self.sigmas[index]);
        let limits = self.limits.get(index).copied().unwrap_or((value - half, value + half));
        Some(self.numbers.interval(index, value, limits))
    }

    /// Correlation coefficients of the fitted values, in their order.
    pub fn correlations(&self, free: &[Free]) -> nalgebra::DMatrix<f64> {
        let c = self.fit.covariance(free, self.inflation);
        nalgebra::DMatrix::from_fn(c.nrows(), c.ncols(), |i, j| {
            c[(i, j)] / (c[(i, i)] * c[(j, j)]).max(1e-300).sqrt()
        })
    }
}

/// What a re-fit compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Domain {
    /// Restoring force along the measured motion.
    Force,
    /// Simulated A and D, every so many samples.
    Output {
        /// Every so many samples.
        stride: usize,
    },
}

/// Zero of a displacement sensor over the rms of the motion, in steady steps: 20 um for the paper's rig. Elsewhere over the largest displacement: a
/// range holds the peaks of an earthquake or of a mass that is let go, which are several times their rms.
const ZERO_OF_RMS: f64 = 1.5e-3;
const ZERO_OF_PEAK: f64 = 4e-3;

/// Standard deviation of the displacement sensor's zero for a motion, m.
pub fn zero_sigma_m(motion: &Motion) -> f64 {
    let steady = ZERO_OF_RMS * motion.rms(&motion.displacement_m);
    if motion.kind != Kind::Base || motion.windows.iter().any(|window| !window.random) {
        return steady;
    }
    let peak = motion.displacement_m.iter().fold(0.0_f64, |peak, d| peak.max(d.abs()));
    steady.max(ZERO_OF_PEAK * peak)
}

/// Fits the numbers of `start` over the windows of a part.
///
/// `None` when the model cannot be evaluated at its start.
pub fn refit(
    problem: &Problem<'_>,
    start: &ModelSpec,
    numbers: &Numbers,
    zero_m: f64,
    domain: Domain,
    part: Part,
    settings: Settings,
) -> Option<Refit> {
    let free = with_zero(numbers, zero_m, zero_sigma_m(problem.motion));
    let evaluate = |x: &[f64], r: &mut Vec<f64>| {
        let mut spec = start.clone();
        let zero = x[x.len() - 1];
        numbers.put(x, &mut spec)
            && match domain {
                Domain::Force => problem.force_residuals(&spec, zero, part, r),
                Domain::Output { stride } => problem.output_residuals(&spec, zero, part, stride, r),
            }
    };
    let fit = least_squares::fit(&free, settings, evaluate)?;
    let mut residuals = Vec::new();
    evaluate(&fit.values, &mut residuals);
    let inflation = inflation(&residuals);
    let covariance = fit.covariance(&free, inflation);
    let sigmas = (0..free.len()).map(|j| covariance[(j, j)].max(0.0).sqrt()).collect();
    let mut spec = start.clone();
    numbers.put(&fit.values, &mut spec);
    let zero_m = fit.values.last().copied().unwrap_or(0.0);
    Some(Refit { spec, numbers: numbers.clone(), zero_m, fit, inflation, sigmas, limits: Vec::new() })
}

/// The fit's numbers with the zero of the displacement sensor as the last.
pub fn with_zero(numbers: &Numbers, zero_m: f64, sigma_m: f64) -> Vec<Free> {
    let mut free = numbers.free.clone();
    free.push(Free {
        key: "displacement zero".into(),
        start: zero_m,
        scale: sigma_m.max(1e-300),
        prior: (0.0, sigma_m.max(1e-300)),
        bounds: (-20.0 * sigma_m, 20.0 * sigma_m),
    });
    free
}

/// Residuals that are coloured or larger than their noise carry less: the mean square times the
/// sum of the autocorrelation up to its first zero (Bartlett 1946), at least 1.
pub fn inflation(residuals: &[f64]) -> f64 {
    let n = residuals.len();
    let power = least_squares::sum_of_squares(residuals) / n.max(1) as f64;
    if n < 16 || power <= 0.0 {
        return 1.0;
    }
    let mut sum = 1.0;
    let mut lag = 1;
    // Lags grow by a quarter, each standing for those it skips.
    while lag < n / 8 {
        let rho = least_squares::dot(&residuals[..n - lag], &residuals[lag..]) / (n as f64 * power);
        if rho < 2.0 / (n as f64).sqrt() {
            break;
        }
        let next = (lag + 1).max(lag * 5 / 4);
        sum += 2.0 * rho * (next - lag) as f64;
        lag = next;
    }
    (power * sum).max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, prelude::Distribution};

    #[test]
    fn coloured_residuals_count_less() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(5);
        let normal = rand_distr::Normal::new(0.0, 1.0).expect("valid");
        let white: Vec<f64> = (0..50_000).map(|_| normal.sample(&mut random)).collect();
        assert!((inflation(&white) - 1.0).abs() < 0.1, "{}", inflation(&white));
        // First-order autoregression with rho = 0.9: variance 1/(1 - 0.81), times 1.9/0.1.
        let mut last = 0.0;
        let coloured: Vec<f64> = white
            .iter()
            .map(|w| {
                last = 0.9 * last + w;
                last
            })
            .collect();
        let expected = 1.0 / 0.19 * 19.0;
        let found = inflation(&coloured);
        assert!((found / expected - 1.0).abs() < 0.3, "{found} {expected}");
    }
}
