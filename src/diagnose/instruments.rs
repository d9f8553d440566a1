//! Instruments before physics: which instrument effects a record shows beyond their tolerance.

use crate::identify::kinematics::{Estimate, HANN_MEAN_SQUARE, Instruments, Tolerances, tapered};
use crate::record::Record;
use realfft::num_complex::Complex64;
use serde::Serialize;

/// An instrument off by more than its tolerance.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Effect of the catalogue.
    pub name: String,
    /// Its parameters: name, value, 95 % interval, unit.
    pub parameters: Vec<(String, Estimate95, String)>,
    /// What was seen.
    pub text: String,
}

/// A value with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate95 {
    /// Best value.
    pub value: f64,
    /// Lower end.
    pub low95: f64,
    /// Upper end.
    pub high95: f64,
}

impl From<Estimate> for Estimate95 {
    fn from(e: Estimate) -> Self {
        Self { value: e.value, low95: e.value - 1.96 * e.sigma, high95: e.value + 1.96 * e.sigma }
    }
}

/// Judges what the kinematics told.
pub fn judge(found: &Instruments, record: &Record, tolerances: Tolerances) -> Vec<Finding> {
    let mut out = Vec::new();
    let beyond =
        |e: Estimate, neutral: f64, tolerance: f64| (e.value - neutral).abs() > tolerance + 3.0 * e.sigma;
    let [one, two] = found.accelerometers;
    if beyond(found.laser_delay_s, 0.0, tolerances.delay_s) {
        out.push(finding(
            "laser-delay",
            "dt_s",
            "s",
            found.laser_delay_s,
            "D'' comes late against A - a_table",
        ));
    }
    let late = Estimate {
        value: 0.5 * (one.delay_s.value + two.delay_s.value),
        sigma: 0.5 * one.delay_s.sigma.hypot(two.delay_s.sigma),
    };
    if beyond(late, 0.0, tolerances.delay_s) {
        out.push(finding("accelerometer-delay", "dt_s", "s", late, "A comes late against D'' and a_table"));
    }
    // A gain is a finding from twice its tolerance: the priors that share the ratios between laser,
    // accelerometers and leak are as wide as the tolerances themselves.
    if beyond(found.laser_gain, 1.0, 5.0 * tolerances.laser_gain) {
        out.push(finding(
            "laser-gain",
            "gain",
            "1",
            found.laser_gain,
            "D'' is out of proportion to A - a_table",
        ));
    }
    let yaw = yaw(record, &found.accelerometers.map(|a| a.noise_m_s2));
    let apart = (one.gain.value - two.gain.value).abs();
    let apart_sigma = one.gain.sigma.hypot(two.gain.sigma);
    if let Some(yaw) = yaw {
        out.push(yaw);
    } else if apart > 2.0 * tolerances.accelerometer_gain + 3.0 * apart_sigma {
        let (which, gain) = if (one.gain.value - 1.0).abs() > (two.gain.value - 1.0).abs() {
            (1, one.gain)
        } else {
            (2, two.gain)
        };
        out.push(finding(
            "accelerometer-gain",
            "gain",
            "1",
            gain,
            &format!("accelerometer {which} is out of proportion to the other, to D'' and to a_table"),
        ));
    } else if beyond(one.gain, 1.0, 2.0 * tolerances.accelerometer_gain)
        && beyond(two.gain, 1.0, 2.0 * tolerances.accelerometer_gain)
    {
        let both = Estimate {
            value: 0.5 * (one.gain.value + two.gain.value),
            sigma: one.gain.sigma.max(two.gain.sigma),
        };
        out.push(finding("accelerometer-gain", "gain", "1", both, "both accelerometers on the mass alike"));
    }
    out
}

fn finding(name: &str, parameter: &str, unit: &str, estimate: Estimate, text: &str) -> Finding {
    Finding {
        name: name.to_owned(),
        parameters: vec![(parameter.to_owned(), estimate.into(), unit.to_owned())],
        text: text.to_owned(),
    }
}

/// Steps at most, and how often one is halved.
const GAUSS_NEWTON: usize = 30;
const HALVED: i32 = 6;
/// Variance of a coefficient told by tapered spectra over that by plain ones: mean fourth power of a Hann window over the square of
/// its mean square.
const HANN_SHARED: f64 = 35.0 / 18.0;

/// A rotational mode shows in the difference of the accelerometers as a resonance: the ratio of
/// the difference to the mean changes with frequency as `w^2/(w0^2 - w^2 + 2 i zeta w0 w)` does,
/// while a gain or a leak keeps it (or its share of the table's) constant.
fn yaw(record: &Record, noise: &[f64; 2]) -> Option<Finding> {
    let n = record.mass_acceleration_1_m_s2.len();
    if record.mass_acceleration_2_m_s2.len() != n || n < 1024 {
        return None;
    }
    let rate = record.sample_rate_hz;
    let pair = || record.mass_acceleration_1_m_s2.iter().zip(&record.mass_acceleration_2_m_s2);
    let difference: Vec<f64> = pair().map(|(a, b)| 0.5 * (a - b)).collect();
    let mean: Vec<f64> = pair().map(|(a, b)| 0.5 * (a + b)).collect();
    // Tapered: what one noisy sample at an end stands for beyond it would be several times the noise at low frequencies.
    let difference = tapered(&difference, rate);
    let mean = tapered(&mean, rate);
    let table = tapered(&record.table_acceleration_m_s2, rate);
    let of_difference = 0.25 * (noise[0].powi(2) + noise[1].powi(2)) * HANN_MEAN_SQUARE;
    let per_bin = of_difference * n as f64;
    // Bins with signal in the mean: the response there is known.
    let bins: Vec<usize> = difference
        .band(0.05, 0.3 * rate)
        .filter(|&b| mean.bins[b].norm_sqr() > 100.0 * per_bin)
        .take(200_000)
        .collect();
    if bins.len() < 64 {
        return None;
    }
    let stride = bins.len().div_ceil(20_000);
    let bins: Vec<usize> = bins.into_iter().step_by(stride).collect();
    let below = |(w0, zeta): (f64, f64), w: f64| Complex64::new(w0 * w0 - w * w, 2.0 * zeta * w0 * w);
    // Plain: difference = g mean + l table (real constants). Yaw adds c H(w) mean.
    let fit = |mode: Option<(f64, f64)>| -> (f64, [f64; 3]) {
        use nalgebra::{Matrix3, Vector3};
        let mut normal = Matrix3::<f64>::zeros();
        let mut right = Vector3::<f64>::zeros();
        let mut power = 0.0;
        for &b in &bins {
            let w = difference.omega_rad_s(b);
            let h = mode.map_or(Complex64::ZERO, |mode| Complex64::from(w * w) / below(mode, w));
            let columns = [mean.bins[b], table.bins[b], h * mean.bins[b]];
            for i in 0..3 {
                for j in 0..3 {
                    normal[(i, j)] += (columns[i].conj() * columns[j]).re;
                }
                right[i] += (columns[i].conj() * difference.bins[b]).re;
            }
            power += difference.bins[b].norm_sqr();
        }
        for i in 0..3 {
            normal[(i, i)] += 1e-12 * normal[(0, 0)].max(1e-300);
        }
        let x = normal.cholesky().map(|c| c.solve(&right)).unwrap_or_default();
        (power - x.dot(&right), [x[0], x[1], x[2]])
    };
    let (plain, _) = fit(None);
    let floor = per_bin * bins.len() as f64;
    if plain < 1.3 * floor {
        return None;
    }
    let low = difference.omega_rad_s(*bins.first()?);
    let high = 0.4 * std::f64::consts::TAU * rate;
    let mut best = (f64::INFINITY, (0.0, 0.0), [0.0; 3]);
    for i in 0..=48 {
        let w0 = low * (high / low).powf(f64::from(i) / 48.0);
        for zeta in [0.01, 0.03, 0.1, 0.3] {
            let (left, x) = fit(Some((w0, zeta)));
            if left < best.0 {
                best = (left, (w0, zeta), x);
            }
        }
    }
    for round in 0..24 {
        let shrink = 0.12 * 0.8_f64.powi(round);
        let (w0, zeta) = best.1;
        for (fw, fz) in [
            (1.0 + shrink, 1.0),
            (1.0 - shrink, 1.0),
            (1.0, 1.0 + 4.0 * shrink),
            (1.0, 1.0 / (1.0 + 4.0 * shrink)),
        ] {
            let trial = (w0 * fw, (zeta * fz).min(0.9));
            let (left, x) = fit(Some(trial));
            if left < best.0 {
                best = (left, trial, x);
            }
        }
    }
    // Slopes along gain, leak, mode and the logarithms of its frequency and damping, and what pulls along them. Below a resonance the
    // last three go together.
    let slopes = |(w0, zeta): (f64, f64), x: [f64; 3]| {
        let mut information = nalgebra::SMatrix::<f64, 5, 5>::zeros();
        let mut pull = nalgebra::SVector::<f64, 5>::zeros();
        for &b in &bins {
            let w = difference.omega_rad_s(b);
            let below = below((w0, zeta), w);
            let h = Complex64::from(w * w) / below;
            let along_w0 = -h * Complex64::new(2.0 * w0 * w0, 2.0 * zeta * w0 * w) / below;
            let along_zeta = -h * Complex64::new(0.0, 2.0 * zeta * w0 * w) / below;
            let of_mean = [Complex64::ONE, Complex64::ZERO, h, x[2] * along_w0, x[2] * along_zeta];
            let mut slopes = of_mean.map(|of_mean| of_mean * mean.bins[b]);
            slopes[1] = table.bins[b];
            let left = difference.bins[b] - slopes[0] * x[0] - slopes[1] * x[1] - slopes[2] * x[2];
            for i in 0..5 {
                pull[i] += (slopes[i].conj() * left).re;
                for j in 0..5 {
                    information[(i, j)] += (slopes[i].conj() * slopes[j]).re;
                }
            }
        }
        (information, pull)
    };
    // Frequency and damping pull on each other and on the strength: Gauss-Newton steps, halved where they lead astray.
    for _ in 0..GAUSS_NEWTON {
        let (information, pull) = slopes(best.1, best.2);
        let Some(inverse) = information.try_inverse() else { break };
        let step = inverse * pull;
        let shortened = (0..HALVED).map(|k| 0.5_f64.powi(k)).find_map(|share| {
            let trial = (
                best.1.0 * (share * step[3]).clamp(-1.0, 1.0).exp(),
                (best.1.1 * (share * step[4]).clamp(-1.0, 1.0).exp()).min(0.9),
            );
            let (left, x) = fit(Some(trial));
            (left < best.0).then_some((left, trial, x))
        });
        let Some(better) = shortened else { break };
        let settled = best.0 - better.0 < 1e-3 * per_bin;
        best = better;
        if settled {
            break;
        }
    }
    let (left, (w0, zeta), x) = best;
    // The mode has to explain most of what a gain and a leak do not.
    if (left - floor).max(0.0) > 0.3 * (plain - floor) {
        return None;
    }
    let (information, _) = slopes((w0, zeta), x);
    // A bin's noise lies half in its real part; tapering has neighbouring bins share theirs.
    let noise = 0.5 * HANN_SHARED * left / bins.len() as f64;
    let covariance = information.try_inverse()?;
    let sigma = |i: usize| (covariance[(i, i)].max(0.0) * noise).sqrt();
    // A1 - A2 = 2 y'', y'' = H(w) (3 e / L) A with L = 0.5 m half the spacing.
    let half_spacing_m = 0.5;
    let around = |value: f64, sigma: f64| Estimate95 {
        value,
        low95: value - 1.96 * sigma,
        high95: value + 1.96 * sigma,
    };
    let e_m = x[2] * half_spacing_m / 3.0;
    let f_hz = w0 / std::f64::consts::TAU;
    Some(Finding {
        name: "yaw-rotation".to_owned(),
        parameters: vec![
            ("e_m".to_owned(), around(e_m, sigma(2) * half_spacing_m / 3.0), "m".to_owned()),
            ("f_hz".to_owned(), around(f_hz, sigma(3) * f_hz), "Hz".to_owned()),
            ("zeta".to_owned(), around(zeta, sigma(4) * zeta), "1".to_owned()),
        ],
        text: "the accelerometers on the mass differ as a rotational mode does".to_owned(),
    })
}
