//! The sums and tables of a comparison, from its channels.

use super::force::ResidualForce;
use super::response::Channels;
use super::slices::{Cells, Slice, Sums, nrmse};
use super::window::Window;
use super::{Error, NoiseFloor, StepMisfit, harmonics};
use crate::record::Kind;
use crate::record::quality::span;
use crate::sweep::Direction;
use std::ops::Range;

/// RMS of A and D that the noise of the driving channel leaves in the response of the model, over the
/// whole steps: what a resonance passes is slow, and the counted cycles hold few of its swings.
pub fn propagated(windows: &[Window], one: &Channels, other: &Channels) -> [f64; 2] {
    let rms = |a: &[f64], b: &[f64]| {
        let (mut sum, mut count) = (0.0, 0.0);
        for window in windows {
            for (a, b) in a[window.whole.clone()].iter().zip(&b[window.whole.clone()]) {
                sum += (a - b).powi(2);
                count += 1.0;
            }
        }
        (sum / f64::max(count, 1.0)).sqrt()
    };
    [rms(&one.model_a, &other.model_a), rms(&one.model_d, &other.model_d)]
}

/// Error and floor of the whole.
pub fn overall(
    kind: Kind,
    total: &Sums,
    floor: &NoiseFloor,
    mass_kg: f64,
    propagated: Option<[f64; 2]>,
) -> Error {
    let rms = |[_, measured]: [f64; 2]| (measured > 0.0).then(|| (measured / total.count.max(1.0)).sqrt());
    let (rms_a, rms_d) = (rms(total.a), rms(total.d));
    let [input_a, input_d] = propagated.unwrap_or_default();
    let sensor_a = if kind == Kind::Component { floor.force_n / mass_kg } else { floor.acceleration_m_s2 };
    let nrmse_a = nrmse(total.a);
    Error {
        nrmse_a,
        nrmse_d: nrmse(total.d),
        nrmse_force: nrmse_a.filter(|_| kind == Kind::Component),
        noise_floor_a: rms_a.map(|rms| sensor_a.hypot(input_a) / rms),
        noise_floor_d: rms_d.map(|rms| floor.displacement_m.hypot(input_d) / rms),
        rms_a_m_s2: rms_a,
        rms_d_m: rms_d,
    }
}

/// Sums of the compared channels by everything that is asked.
#[derive(Default)]
pub struct Gathered {
    /// By regime.
    pub cells: Cells,
    /// By window.
    pub windows: Vec<Sums>,
    /// By twelfth of the cycle.
    pub phases: Vec<Sums>,
    /// By quarter of the largest |D|.
    pub amplitudes: Vec<Sums>,
    /// By third of the record.
    pub times: Vec<Sums>,
}

impl Gathered {
    /// Named slices of parts.
    pub fn named(&self, parts: &[Sums], name: impl Fn(usize) -> String) -> Vec<Slice> {
        let total = self.cells.total();
        let filled = parts.iter().enumerate().filter(|(_, part)| part.count > 0.0);
        filled.map(|(i, part)| Slice::new(name(i), part, &total)).collect()
    }

    /// Forward and backward.
    pub fn directions(&self, windows: &[Window]) -> Vec<Slice> {
        let mut parts = [Sums::default(); 2];
        for (window, sums) in windows.iter().zip(&self.windows) {
            if let Some(direction) = window.direction {
                parts[usize::from(direction == Direction::Backward)] += sums;
            }
        }
        self.named(&parts, |i| ["forward", "backward"][i.min(1)].to_owned())
    }
}

/// Sums over the free samples of the windows; `delay` samples lie between a motion and its filtered residual.
pub fn gather(
    windows: &[Window],
    channels: &Channels,
    free: &[Range<usize>],
    delay: usize,
    rate: f64,
) -> Gathered {
    let mut out = Gathered {
        phases: vec![Sums::default(); 12],
        amplitudes: vec![Sums::default(); 4],
        times: vec![Sums::default(); 3],
        ..Gathered::default()
    };
    let n = channels.model_a.len();
    let motion = if channels.measured_d.is_empty() { &channels.model_d } else { &channels.measured_d };
    let counted = windows.iter().flat_map(|window| window.counted.clone());
    let largest = counted.map(|i| motion[i].abs()).fold(1e-300, f64::max);
    let square = |measured: &[f64], model: &[f64], i: usize| match measured.get(i) {
        Some(x) => [(x - model[i]).powi(2), x * x],
        None => [0.0; 2],
    };
    for window in windows {
        let mut sums = Sums::default();
        for range in free {
            let (from, to) = (window.counted.start.max(range.start), window.counted.end.min(range.end));
            for (i, at_d) in motion.iter().enumerate().take(to).skip(from) {
                let sample = Sums {
                    count: 1.0,
                    a: square(&channels.measured_a, &channels.model_a, i),
                    d: square(&channels.measured_d, &channels.model_d, i),
                    ..Sums::default()
                };
                // The filter delays the residual against the motion that made it.
                let at = i.saturating_sub(delay).max(range.start);
                *out.cells.of(channels.regime[at], channels.outward[at]) += &sample;
                sums += &sample;
                if let Some(place) = window.cycle_place(at, rate) {
                    out.phases[((12.0 * place) as usize).min(11)] += &sample;
                }
                out.amplitudes[((4.0 * at_d.abs() / largest) as usize).min(3)] += &sample;
                out.times[(3 * i / n.max(1)).min(2)] += &sample;
            }
        }
        out.windows.push(sums);
    }
    out
}

/// The misfit of each step.
pub fn steps(
    windows: &[Window],
    sums: &[Sums],
    channels: &Channels,
    force: Option<&ResidualForce>,
    rate: f64,
) -> Vec<StepMisfit> {
    let rows = windows.iter().zip(sums).enumerate();
    rows.filter(|(_, (window, sums))| window.step >= 0 && sums.count > 0.0)
        .map(|(i, (window, sums))| {
            let residual_n = force.and_then(|force| force.windows.get(i)).map(|w| w.residual_rms_n);
            step(window, sums, channels, residual_n, rate)
        })
        .collect()
}

fn step(window: &Window, sums: &Sums, channels: &Channels, residual_n: Option<f64>, rate: f64) -> StepMisfit {
    let cut = |channel: &'_ [f64]| channel.get(window.counted.clone()).unwrap_or_default().to_vec();
    let (a, model_a) = (cut(&channels.measured_a), cut(&channels.model_a));
    let (d, model_d) = (cut(&channels.measured_d), cut(&channels.model_d));
    let peak = |x: &[f64]| (!x.is_empty()).then(|| x.iter().fold(0.0, |top: f64, x| top.max(x.abs())));
    let excursion = |x: &[f64]| {
        let (low, high) = span(x);
        (!x.is_empty()).then_some(high - low)
    };
    let harmonics = |measured: &[f64], model: &[f64]| match window.frequency_hz {
        Some(f) if !measured.is_empty() => harmonics::misfit(measured, model, f, rate),
        _ => Vec::new(),
    };
    let rms = |sum: f64, there: &[f64]| (!there.is_empty()).then(|| (sum / sums.count).sqrt());
    StepMisfit {
        index: window.step,
        direction: window.direction,
        frequency_hz: window.frequency_hz,
        from_s: window.counted.start as f64 / rate,
        nrmse_a: nrmse(sums.a),
        nrmse_d: nrmse(sums.d),
        rms_a_measured_m_s2: rms(sums.a[1], &a),
        rms_a_residual_m_s2: rms(sums.a[0], &a),
        rms_d_measured_m: rms(sums.d[1], &d),
        rms_d_residual_m: rms(sums.d[0], &d),
        a_max_m_s2: peak(&a),
        model_a_max_m_s2: peak(&model_a).filter(|_| !a.is_empty()),
        excursion_m: excursion(&d),
        model_excursion_m: excursion(&model_d).filter(|_| !d.is_empty()),
        force_residual_n: residual_n,
        harmonics_a: harmonics(&a, &model_a),
        harmonics_d: harmonics(&d, &model_d),
    }
}
