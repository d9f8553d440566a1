//! The residual force: measured restoring force less that of the model along the *measured* motion.
//! Unlike the residual of a free simulation it is local: it shows where the model is wrong, not where
//! the error ends up.

use super::CompareError;
use super::response::Measured;
use super::slices::Cells;
use super::window::Window;
use crate::model::{ModelSpec, build};
use crate::record::Kind;
use serde::Serialize;

/// Bins of the map along each axis.
const BINS: usize = 21;

/// Residual force over one counted window.
#[derive(Clone, Debug, Default)]
pub struct ForceWindow {
    /// RMS residual, N.
    pub residual_rms_n: f64,
}

/// Mean residual force over displacement and velocity.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ForceMap {
    /// Edges of the displacement bins, m.
    pub displacement_edges_m: Vec<f64>,
    /// Edges of the velocity bins, m/s.
    pub velocity_edges_m_s: Vec<f64>,
    /// Mean residual in each bin, N, a row a velocity bin; `null` where no sample lies.
    pub mean_n: Vec<Vec<Option<f64>>>,
    /// Standard deviation within the bin, N: much of it at the same (D, D') is memory or time.
    pub deviation_n: Vec<Vec<Option<f64>>>,
    /// Samples in each bin.
    pub count: Vec<Vec<u32>>,
}

/// Residual force of all windows.
pub struct ResidualForce {
    /// By regime (of the model along the measured motion).
    pub cells: Cells,
    /// By window.
    pub windows: Vec<ForceWindow>,
    /// Along the counted samples of each window, N.
    pub residual_n: Vec<Vec<f32>>,
    /// Over (D, D').
    pub map: ForceMap,
}

struct Point {
    d: f64,
    v: f64,
    r: f64,
}

/// Residual force over the counted windows; `None` where acceleration (or force) or displacement is
/// not measured.
///
/// # Errors
/// [`CompareError::Model`] for a model that cannot be built.
pub fn residual(
    measured: &Measured,
    spec: &ModelSpec,
    windows: &[Window],
) -> Result<Option<ResidualForce>, CompareError> {
    if measured.d.is_empty() || measured.a.is_empty() {
        return Ok(None);
    }
    let rate = 1.0 / measured.dt_s;
    let mut specimen = build(spec, measured.dt_s)?;
    let mut cells = Cells::default();
    let mut points = Vec::new();
    let mut out = Vec::with_capacity(windows.len());
    let mut along = Vec::with_capacity(windows.len());
    for window in windows {
        let cycle = window.frequency_hz.map_or(measured.cycle, |_| window.cycle_samples(rate));
        let first = points.len();
        // A hidden state needs the motion before; a component's state is followed without a break.
        let lead = if measured.kind == Kind::Component { window.counted.start } else { cycle };
        let warm_from = window.counted.start.saturating_sub(lead);
        let mut sum = 0.0;
        for i in warm_from..window.counted.start {
            specimen.impose(measured.d[i], measured.velocity(i, cycle));
        }
        let rows: Vec<_> = window
            .counted
            .clone()
            .map(|i| {
                let v = measured.velocity(i, cycle);
                let response = specimen.impose(measured.d[i], v);
                (i, v, response, restoring(measured, i))
            })
            .collect();
        let raw = |row: &(usize, f64, crate::model::Response, f64)| {
            row.3 + measured.mass_kg * row.2.mass_acceleration_m_s2
        };
        // The zeros of the accelerometers are nothing of the specimen.
        let zero = if measured.kind == Kind::Component || window.frequency_hz.is_none() {
            0.0
        } else {
            rows.iter().map(raw).sum::<f64>() / rows.len().max(1) as f64
        };
        let smooth = smoothed(&rows.iter().map(|row| raw(row) - zero).collect::<Vec<_>>(), cycle / 50);
        along.push(smooth.iter().map(|r| *r as f32).collect());
        for ((i, v, response, force), r) in rows.iter().zip(smooth) {
            let outward = measured.d[*i] * v > 0.0;
            let cell = cells.of(response.regime, outward);
            cell.force_count += 1.0;
            cell.force[0] += r * r;
            cell.force[1] += force * force;
            sum += r * r;
            points.push(Point { d: measured.d[*i], v: *v, r });
        }
        let count = (points.len() - first).max(1) as f64;
        out.push(ForceWindow { residual_rms_n: (sum / count).sqrt() });
    }
    Ok(Some(ResidualForce { cells, windows: out, residual_n: along, map: map(&points) }))
}

/// Measured restoring force, N: -M A of the mass, less what is applied.
fn restoring(measured: &Measured, sample: usize) -> f64 {
    let a = measured.a[sample] / measured.gain_a;
    match measured.kind {
        Kind::Force => -measured.mass_kg * (measured.drive[sample] + a),
        Kind::Base | Kind::Component => -measured.mass_kg * a,
    }
}

/// Centred running mean over `2 half + 1` samples, shorter at the ends.
fn smoothed(values: &[f64], half: usize) -> Vec<f64> {
    if half == 0 {
        return values.to_vec();
    }
    let mut sum = 0.0;
    let sums: Vec<f64> = std::iter::once(0.0)
        .chain(values.iter().map(|x| {
            sum += x;
            sum
        }))
        .collect();
    (0..values.len())
        .map(|i| {
            let (from, to) = (i.saturating_sub(half), (i + half + 1).min(values.len()));
            (sums[to] - sums[from]) / (to - from) as f64
        })
        .collect()
}

fn map(points: &[Point]) -> ForceMap {
    let reach = |of: fn(&Point) -> f64| points.iter().map(|p| of(p).abs()).fold(1e-300, f64::max);
    let (d_max, v_max) = (reach(|p| p.d), reach(|p| p.v));
    let bin = |x: f64, top: f64| (((x / top + 1.0) * 0.5 * BINS as f64) as usize).min(BINS - 1);
    let edges = |top: f64| (0..=BINS).map(|i| top * (2.0 * i as f64 / BINS as f64 - 1.0)).collect();
    let mut sums = vec![vec![(0u32, 0.0, 0.0); BINS]; BINS];
    for point in points {
        let (count, sum, square) = &mut sums[bin(point.v, v_max)][bin(point.d, d_max)];
        *count += 1;
        *sum += point.r;
        *square += point.r * point.r;
    }
    let table = |of: &dyn Fn(f64, f64, f64) -> f64| -> Vec<Vec<Option<f64>>> {
        sums.iter()
            .map(|row| row.iter().map(|(n, s, q)| (*n > 0).then(|| of(f64::from(*n), *s, *q))).collect())
            .collect()
    };
    ForceMap {
        displacement_edges_m: edges(d_max),
        velocity_edges_m_s: edges(v_max),
        mean_n: table(&|n, s, _| s / n),
        deviation_n: table(&|n, s, q| (q / n - (s / n).powi(2)).max(0.0).sqrt()),
        count: sums.iter().map(|row| row.iter().map(|(n, _, _)| *n).collect()).collect(),
    }
}
