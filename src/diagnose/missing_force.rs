//! The shape of the force that the model lacks, over displacement and velocity, with its
//! uncertainty; and a draft of an `expression` effect from it.

use crate::identify::problem::{Part, Problem};
use crate::identify::refit::Refit;
use nalgebra::{DMatrix, DVector};
use serde::Serialize;

/// Residual force on a grid of displacement and velocity.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MissingForce {
    /// Centres of the displacement bins, m.
    pub displacement_m: Vec<f64>,
    /// Centres of the velocity bins, m/s.
    pub velocity_m_s: Vec<f64>,
    /// Mean force by displacement (rows) and velocity (columns), N; null where nothing was seen.
    pub force_n: Vec<Vec<Option<f64>>>,
    /// Standard error of the mean, N.
    pub sigma_n: Vec<Vec<Option<f64>>>,
    /// Share of the residual's power that the surface explains; what is left is memory, time,
    /// contact history or noise.
    pub explained_by_surface: f64,
    /// Share of the residual's power in contact with a bumper, beyond its share of the time.
    pub power_in_contact: f64,
    /// Share of the time in contact.
    pub time_in_contact: f64,
    /// Slope of the residual's power over the record, relative per record: far from 0 says time.
    pub trend: f64,
    /// A draft for an `expression` effect, when one explains the residual; to be edited.
    pub expression: Option<Draft>,
}

/// A drafted expression in `d` (m) and `v` (m/s), giving N.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Draft {
    /// Text for the `expression` key.
    pub expression: String,
    /// Its parameters.
    pub parameters: std::collections::BTreeMap<String, f64>,
    /// Share of the residual's power that it explains.
    pub explains: f64,
}

const BINS: usize = 13;

/// One residual sample.
struct Sample {
    d: f64,
    v: f64,
    force: f64,
    contact: bool,
    /// Position in the record, 0 to 1.
    when: f64,
}

/// Residual restoring force of a fitted model over the windows of a part.
pub fn map(problem: &Problem<'_>, refit: &Refit, part: Part) -> Option<MissingForce> {
    let samples = residual(problem, refit, part)?;
    if samples.len() < 100 {
        return None;
    }
    let peak = |f: fn(&Sample) -> f64| samples.iter().map(f).fold(0.0_f64, |m, x| m.max(x.abs())).max(1e-300);
    let (dm, vm) = (peak(|s| s.d), peak(|s| s.v));
    let bin = |x: f64, m: f64| (((x / m + 1.0) * 0.5 * BINS as f64) as usize).min(BINS - 1);
    let mut cells = vec![(0usize, 0.0, 0.0); BINS * BINS];
    for s in &samples {
        let cell = &mut cells[bin(s.d, dm) * BINS + bin(s.v, vm)];
        *cell = (cell.0 + 1, cell.1 + s.force, cell.2 + s.force * s.force);
    }
    let total: f64 = samples.iter().map(|s| s.force * s.force).sum();
    // A cell's mean explains its own noise as well: one degree of freedom each is given back.
    let mut explained = 0.0;
    let grid = |value: &dyn Fn(usize, f64, f64) -> Option<f64>| -> Vec<Vec<Option<f64>>> {
        let cell = |i: usize, j: usize| cells[i * BINS + j];
        (0..BINS)
            .map(|i| {
                (0..BINS)
                    .map(|j| {
                        let (n, s, q) = cell(i, j);
                        value(n, s, q)
                    })
                    .collect()
            })
            .collect()
    };
    for &(n, sum, squares) in &cells {
        if n > 3 {
            let mean_power = sum * sum / n as f64;
            explained += mean_power - (squares - mean_power).max(0.0) / (n as f64 - 1.0);
        }
    }
    let centre = |m: f64| (0..BINS).map(|i| ((i as f64 + 0.5) / BINS as f64 * 2.0 - 1.0) * m).collect();
    let contact: Vec<&Sample> = samples.iter().filter(|s| s.contact).collect();
    let count = samples.len() as f64;
    Some(MissingForce {
        displacement_m: centre(dm),
        velocity_m_s: centre(vm),
        force_n: grid(&|n, s, _| (n > 3).then(|| s / n as f64)),
        sigma_n: grid(&|n, s, q| {
            (n > 3).then(|| ((q / n as f64 - (s / n as f64).powi(2)).max(0.0) / (n as f64 - 1.0)).sqrt())
        }),
        explained_by_surface: (explained / total.max(1e-300)).clamp(0.0, 1.0),
        // The sum of nothing is minus zero.
        power_in_contact: (contact.iter().map(|s| s.force * s.force).sum::<f64>() / total.max(1e-300))
            .max(0.0),
        time_in_contact: contact.len() as f64 / count,
        trend: trend(&samples),
        expression: draft(&samples, dm, vm, total),
    })
}

fn residual(problem: &Problem<'_>, refit: &Refit, part: Part) -> Option<Vec<Sample>> {
    let motion = problem.motion;
    let modelled = problem.restoring(&refit.spec, refit.zero_m, part)?;
    let mass = refit.spec.mass_kg;
    let half_gaps: Vec<f64> = motion
        .sources
        .iter()
        .map(|source| source.setting.of(&refit.spec).bumper.map_or(f64::INFINITY, |b| 0.5 * b.total_gap_m))
        .collect();
    let length = motion.displacement_m.len().max(1) as f64;
    let mut out = Vec::new();
    for (k, window) in motion.windows.iter().enumerate().filter(|(_, w)| part.takes(w)) {
        for (i, n) in problem.samples(window).enumerate() {
            let d = motion.displacement_m[n] + refit.zero_m;
            out.push(Sample {
                d,
                v: motion.velocity_m_s[n],
                force: mass * (motion.restoring_m_s2[n] - modelled[k][i]),
                contact: d.abs() > half_gaps[window.source],
                when: n as f64 / length,
            });
        }
    }
    Some(out)
}

fn trend(samples: &[Sample]) -> f64 {
    let half = |late: bool| {
        let part: Vec<f64> =
            samples.iter().filter(|s| (s.when > 0.5) == late).map(|s| s.force * s.force).collect();
        part.iter().sum::<f64>() / part.len().max(1) as f64
    };
    let (early, late) = (half(false), half(true));
    (late - early) / (late + early).max(1e-300)
}

/// Forward selection over a small library; stops when a further term explains less than 3 % of
/// the power.
fn draft(samples: &[Sample], dm: f64, vm: f64, total: f64) -> Option<Draft> {
    type Term = (&'static str, &'static str, fn(f64, f64) -> f64);
    // Arguments are d and v over their peaks.
    const LIBRARY: &[Term] = &[
        ("c", "", |_, _| 1.0),
        ("d", "(d/dm)", |d, _| d),
        ("v", "(v/vm)", |_, v| v),
        ("d2", "(d/dm)^2", |d, _| d * d),
        ("d3", "(d/dm)^3", |d, _| d * d * d),
        ("d5", "(d/dm)^5", |d, _| d.powi(5)),
        ("v2", "(v/vm)^2", |_, v| v * v),
        ("vv", "(v/vm)*abs(v/vm)", |_, v| v * v.abs()),
        ("v3", "(v/vm)^3", |_, v| v * v * v),
        ("dv", "(d/dm)*(v/vm)", |d, v| d * v),
        ("d2v", "(d/dm)^2*(v/vm)", |d, v| d * d * v),
        ("dv2", "(d/dm)*(v/vm)^2", |d, v| d * v * v),
        ("absdv", "abs(d/dm)*(v/vm)", |d, v| d.abs() * v),
        ("signv", "signum(v)", |_, v| v.signum()),
        ("sind", "sin(6.283185307179586*d/dm)", |d, _| (std::f64::consts::TAU * d).sin()),
    ];
    let step = samples.len().div_ceil(20_000).max(1);
    let thinned: Vec<&Sample> = samples.iter().step_by(step).collect();
    let y = DVector::from_iterator(thinned.len(), thinned.iter().map(|s| s.force));
    let power: f64 = y.norm_squared();
    let columns: Vec<DVector<f64>> = LIBRARY
        .iter()
        .map(|(_, _, f)| DVector::from_iterator(thinned.len(), thinned.iter().map(|s| f(s.d / dm, s.v / vm))))
        .collect();
    let mut taken: Vec<usize> = Vec::new();
    let mut left = power;
    let mut values = DVector::zeros(0);
    while taken.len() < 4 {
        let best = (0..LIBRARY.len())
            .filter(|j| !taken.contains(j))
            .filter_map(|j| {
                let mut trial = taken.clone();
                trial.push(j);
                let (x, rest) = solve(&columns, &trial, &y)?;
                Some((j, x, rest))
            })
            .min_by(|a, b| a.2.total_cmp(&b.2))?;
        if left - best.2 < 0.03 * power {
            break;
        }
        taken.push(best.0);
        values = best.1;
        left = best.2;
    }
    let explains = 1.0 - left / power.max(1e-300);
    if taken.is_empty() || explains < 0.1 || total <= 0.0 {
        return None;
    }
    let mut parameters = std::collections::BTreeMap::new();
    let mut text = Vec::new();
    for (j, value) in taken.iter().zip(values.iter()) {
        let (name, shape, _) = LIBRARY[*j];
        parameters.insert(format!("f_{name}_n"), *value);
        text.push(if shape.is_empty() { format!("f_{name}_n") } else { format!("f_{name}_n*{shape}") });
    }
    let expression = text.join(" + ");
    for (name, value) in [("dm", dm), ("vm", vm)] {
        if expression.contains(&format!("/{name}")) {
            parameters.insert(name.to_owned(), value);
        }
    }
    Some(Draft { expression, parameters, explains })
}

fn solve(columns: &[DVector<f64>], taken: &[usize], y: &DVector<f64>) -> Option<(DVector<f64>, f64)> {
    let n = taken.len();
    let normal = DMatrix::from_fn(n, n, |i, j| columns[taken[i]].dot(&columns[taken[j]]));
    let right = DVector::from_fn(n, |i, _| columns[taken[i]].dot(y));
    let x = normal.cholesky()?.solve(&right);
    let left = y.norm_squared() - x.dot(&right);
    Some((x, left.max(0.0)))
}
