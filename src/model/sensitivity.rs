//! Sensitivities of a simulated response with respect to the numbers of a model; identification
//! stands on them.
//!
//! Both solvers place events to the last bits and take the same steps for neighbouring parameters,
//! so the response is smooth in each of them and central differences carry the jumps of the
//! derivative at events (saltation) by themselves. Two differences, one of half the other's step, are
//! combined (Richardson 1911), which leaves an error of fourth order in the step; a test holds them
//! against derivatives in closed form.

use super::simulate::{History, simulate_from};
use super::{ModelError, ModelSpec};
use crate::config::Check;

/// Largest relative change of a parameter.
const STEP: f64 = 2e-4;

/// Derivatives of D and A with respect to one parameter, one entry a sample.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sensitivity {
    /// Dotted key of the parameter.
    pub key: String,
    /// dD/dp, m per unit of the parameter.
    pub relative_displacement: Vec<f64>,
    /// dA/dp, m/s2 per unit of the parameter.
    pub mass_acceleration: Vec<f64>,
}

/// Response to a sampled table acceleration (m/s2, every `dt_s` s) and its derivatives with respect
/// to the parameters under `keys`, from `initial` (D in m, D' in m/s), or from rest. Parameters run
/// in parallel on the cores there are.
///
/// # Errors
/// [`ModelError`] for an unknown key or a model that is refused.
pub fn simulate_with_sensitivities(
    spec: &ModelSpec,
    keys: &[&str],
    dt_s: f64,
    table_acceleration_m_s2: &[f64],
    initial: Option<(f64, f64)>,
) -> Result<(History, Vec<Sensitivity>), ModelError> {
    let input = table_acceleration_m_s2;
    let history = simulate_from(spec, dt_s, input, initial)?;
    let workers = std::thread::available_parallelism().map_or(1, usize::from).min(keys.len().max(1));
    let share = keys.len().div_ceil(workers).max(1);
    let parts: Vec<Result<Vec<Sensitivity>, ModelError>> = std::thread::scope(|scope| {
        let running: Vec<_> = keys
            .chunks(share)
            .map(|keys| {
                scope
                    .spawn(|| keys.iter().map(|key| one(spec, key, dt_s, input, initial, &history)).collect())
            })
            .collect();
        let lost = || ModelError::invalid("sensitivities", "a worker thread ended early");
        running.into_iter().map(|worker| worker.join().unwrap_or_else(|_| Err(lost()))).collect()
    });
    let mut all = Vec::with_capacity(keys.len());
    for part in parts {
        all.extend(part?);
    }
    Ok((history, all))
}

fn one(
    spec: &ModelSpec,
    key: &str,
    dt_s: f64,
    input: &[f64],
    initial: Option<(f64, f64)>,
    centre: &History,
) -> Result<Sensitivity, ModelError> {
    let value = spec.get(key)?;
    let scale = if value == 0.0 { zero_scale(key, spec, dt_s) } else { value.abs() };
    let at = |offset: f64| -> Result<Option<History>, ModelError> {
        let mut moved = spec.clone();
        moved.set(key, value + offset)?;
        // Beyond the edge of what is allowed (a gap below zero) there is no response.
        if moved.check().is_err() { Ok(None) } else { simulate_from(&moved, dt_s, input, initial).map(Some) }
    };
    let h = STEP * scale;
    let (wide, narrow) = ((at(h)?, at(-h)?), (at(0.5 * h)?, at(-0.5 * h)?));
    let column = |pick: fn(&History) -> &Vec<f64>| -> Vec<f64> {
        let slope = |up: &Option<History>, down: &Option<History>, step: f64, i: usize| match (up, down) {
            (Some(up), Some(down)) => (pick(up)[i] - pick(down)[i]) / (2.0 * step),
            (Some(up), None) => (pick(up)[i] - pick(centre)[i]) / step,
            (None, Some(down)) => (pick(centre)[i] - pick(down)[i]) / step,
            (None, None) => 0.0,
        };
        let order = if wide.0.is_some() && wide.1.is_some() { 3.0 } else { 1.0 };
        (0..centre.len())
            .map(|i| {
                let (coarse, fine) = (slope(&wide.0, &wide.1, h, i), slope(&narrow.0, &narrow.1, 0.5 * h, i));
                fine + (fine - coarse) / order
            })
            .collect()
    };
    Ok(Sensitivity {
        key: key.to_owned(),
        relative_displacement: column(|h| &h.relative_displacement_m),
        mass_acceleration: column(|h| &h.mass_acceleration_m_s2),
    })
}

/// Magnitude of a parameter that stands at zero: its starting value in the catalogue, or one.
fn zero_scale(key: &str, spec: &ModelSpec, dt_s: f64) -> f64 {
    let inside = key.strip_prefix("effect[").and_then(|rest| rest.split_once("]."));
    let named = inside.and_then(|(index, name)| {
        let effect = spec.effects.get(index.parse::<usize>().ok()?)?;
        let entry = super::effects::find(&effect.name).ok()?;
        let parameters = (entry.parameters)(&super::Scales::of_spec(spec, dt_s));
        parameters.iter().find(|p| p.name == name).map(|p| p.start.abs())
    });
    named.filter(|start| *start > 0.0).unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::testing::oscillator;
    use std::f64::consts::TAU;

    #[test]
    fn steady_state_derivatives_are_those_of_the_closed_form() {
        let (m, k, c, dt) = (500.0_f64, 20e3_f64, 1100.0_f64, 1.0 / 2048.0);
        let w = TAU * 1.1;
        let input: Vec<f64> = (1..=60_000).map(|i| 0.5 * (w * f64::from(i) * dt).sin()).collect();
        let keys = ["isolator.stiffness_n_m[0]", "isolator.damping_n_s_m"];
        let (_, got) =
            simulate_with_sensitivities(&oscillator(m, k, c), &keys, dt, &input, None).expect("runs");
        // D = -m a / z, z = k - m w^2 + i c w: dD/dk = m a / z^2, dD/dc = i w m a / z^2.
        let (re, im) = (k - m * w * w, c * w);
        let (re2, im2) = (re * re - im * im, 2.0 * re * im);
        let size = m * 0.5 / (re2 * re2 + im2 * im2).sqrt();
        let angle = -im2.atan2(re2);
        for (i, (dk, dc)) in
            got[0].relative_displacement.iter().zip(&got[1].relative_displacement).enumerate().skip(58_000)
        {
            let phase = w * (i + 1) as f64 * dt + angle;
            assert!((dk - size * phase.sin()).abs() < 3e-6 * size, "{i}");
            assert!((dc - w * size * phase.cos()).abs() < 3e-6 * w * size, "{i}");
        }
    }
}
