//! Ideal sweeps sample by sample: pieces that closed form does not suit, and the general solver.

use super::plan::Plan;
use super::{StepPeaks, SweepResponse, Visit};
use crate::model::Response;
use crate::model::exact::{Exact, Wave};
use crate::model::general::{self, Drive, Sine};
use std::f64::consts::TAU;

/// Peaks and contacts while a sweep runs.
pub(super) struct Account<'v, 'a> {
    pub(super) response: SweepResponse,
    touched: [bool; 2],
    index: usize,
    counted_from: f64,
    visit: &'v mut Visit<'a>,
}

impl<'v, 'a> Account<'v, 'a> {
    pub(super) fn new(plan: &Plan<'_>, visit: &'v mut Visit<'a>) -> Self {
        let response =
            SweepResponse { peaks: vec![StepPeaks::NONE; plan.steps.len()], contacts: 0, samples: 0 };
        Self { response, touched: [false; 2], index: 0, counted_from: plan.counted_from(0), visit }
    }

    fn enter(&mut self, index: usize, plan: &Plan<'_>) {
        (self.index, self.counted_from) = (index, plan.counted_from(index));
    }

    fn count(&mut self, contacts: [bool; 2]) {
        for (touched, now) in self.touched.iter_mut().zip(contacts) {
            self.response.contacts += usize::from(now && !*touched);
            *touched = now;
        }
    }

    fn sample(&mut self, time_s: f64, table: f64, response: &Response) {
        if time_s >= self.counted_from - 1e-12 {
            self.response.peaks[self.index].take(response);
        }
        (self.visit)(self.response.samples, self.index, table, response);
        self.response.samples += 1;
    }
}

pub(super) fn run_exact(exact: &mut Exact, plan: &Plan<'_>, visit: &mut Visit<'_>) -> SweepResponse {
    let mut account = Account::new(plan, visit);
    let wave_at = |index: usize, t: f64| {
        let step = &plan.steps[index];
        let w = TAU * step.frequency_hz;
        let (sin, cos) = (w * t).sin_cos();
        let a = step.acceleration_amplitude_m_s2;
        Wave { value: a * sin, quadrature: a * cos, angular_frequency: w }
    };
    let mut waves = exact.waves(TAU * plan.steps[0].frequency_hz);
    account.sample(0.0, 0.0, &exact.respond(0.0));
    let mut index = 0;
    let mut wave = wave_at(0, 0.0);
    let mut turn = (TAU * plan.steps[0].frequency_hz * plan.dt).sin_cos();
    for n in 0..plan.samples() - 1 {
        let (start, end) = (n as f64 * plan.dt, (n + 1) as f64 * plan.dt);
        let border = plan.end_of(index);
        if end >= border && index + 1 < plan.steps.len() {
            index += 1;
            exact.split_sample(wave, wave_at(index, 0.0), border - start);
            waves = exact.waves(TAU * plan.steps[index].frequency_hz);
            turn = (TAU * plan.steps[index].frequency_hz * plan.dt).sin_cos();
            account.enter(index, plan);
            wave = wave_at(index, end - plan.starts[index]);
        } else {
            exact.wave_sample(&waves, wave);
            // Turned from sample to sample, and set afresh before rounding adds up.
            wave = if n % 32 == 0 { wave_at(index, end - plan.starts[index]) } else { wave.turned(turn) };
        }
        account.count(exact.contacts());
        account.sample(end, wave.value, &exact.respond(wave.value));
    }
    account.response
}

pub(super) fn run_general(
    solver: &mut dyn general::Sweepable,
    plan: &Plan<'_>,
    account: &mut Account<'_, '_>,
) {
    let mut next = 0;
    for index in 0..plan.steps.len() {
        let step = &plan.steps[index];
        let start = plan.starts[index];
        account.enter(index, plan);
        let w = TAU * step.frequency_hz;
        let drive = Sine { amplitude: step.acceleration_amplitude_m_s2, angular_frequency: w };
        let turn = (w * plan.dt).sin_cos();
        let duration = plan.end_of(index) - start;
        let last = index + 1 == plan.steps.len();
        // One past the last sample of this step of the sweep; one on the border belongs to the next.
        let until = if last {
            plan.samples()
        } else {
            ((plan.end_of(index) / plan.dt).ceil() as usize).min(plan.samples())
        };
        solver.stretch(duration, drive, &mut |begin, end, contacts, state| {
            account.count(contacts);
            let inverse = 1.0 / (end - begin);
            let mut wave: Option<Wave> = None;
            while next < until {
                let time = next as f64 * plan.dt;
                let t = time - start;
                if t >= end && end < duration {
                    return;
                }
                // Turned from sample to sample, set afresh with every step of the solver.
                let now = match wave {
                    Some(wave) => wave.turned(turn),
                    None => {
                        let (sin, cos) = (w * t).sin_cos();
                        let a = drive.amplitude;
                        Wave { value: a * sin, quadrature: a * cos, angular_frequency: w }
                    }
                };
                let part = ((t - begin) * inverse).clamp(0.0, 1.0);
                account.sample(time, now.value, &state(part, now.value));
                wave = Some(now);
                next += 1;
            }
        });
    }
}

/// Parts that a step of the solver is cut into where peaks are looked for.
const PARTS: usize = 4;

/// Peaks alone, on the dense output of the solver's steps: nothing is evaluated before the cycles that count.
pub(super) fn peaks_general(solver: &mut dyn general::Sweepable, plan: &Plan<'_>) -> Vec<StepPeaks> {
    let mut all = vec![StepPeaks::NONE; plan.steps.len()];
    for (index, (step, peaks)) in plan.steps.iter().zip(&mut all).enumerate() {
        let (start, w) = (plan.starts[index], TAU * step.frequency_hz);
        let counted = plan.counted_from(index) - start;
        let drive = Sine { amplitude: step.acceleration_amplitude_m_s2, angular_frequency: w };
        solver.stretch(plan.end_of(index) - start, drive, &mut |begin, end, _, state| {
            if end <= counted {
                return;
            }
            let (first, length) = (((counted - begin) / (end - begin)).max(0.0), end - begin);
            // Between events and knees everything is smooth: parabolas hold within a step, not across its ends.
            let row: [Response; PARTS + 1] = std::array::from_fn(|i| {
                let part = first + (1.0 - first) * i as f64 / PARTS as f64;
                state(part, drive.at(begin + part * length))
            });
            row.iter().for_each(|response| peaks.take(response));
            for three in row.windows(3) {
                let [d, a] =
                    [|r: &Response| r.relative_displacement_m, |r: &Response| r.mass_acceleration_m_s2]
                        .map(|of| vertex([of(&three[0]), of(&three[1]), of(&three[2])]));
                peaks.take(&Response { relative_displacement_m: d, mass_acceleration_m_s2: a, ..three[1] });
            }
        });
    }
    all
}

/// The turn of the parabola through three values in equal steps where it lies between them, else the middle
/// value.
fn vertex([before, middle, after]: [f64; 3]) -> f64 {
    let (slope, bend) = (0.5 * (after - before), after - 2.0 * middle + before);
    if slope.abs() > bend.abs() || bend == 0.0 { middle } else { middle - 0.5 * slope * slope / bend }
}
