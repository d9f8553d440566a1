//! The response of a model to an ideal sweep: the table follows `a = A_G sin(phase)` exactly, steps
//! follow each other at phase 0, from rest. The command line, the bench and campaigns call it.

use super::exact::{Exact, Wave};
use super::general::{self, Drive, Sine};
use super::system::System;
use super::{History, ModelError, ModelSpec, Options, Response};
use crate::sweep::Step;
use std::f64::consts::TAU;

/// Cycles at the end of a step from which its peaks are taken.
pub const PEAK_CYCLES: f64 = 3.0;

/// Peaks of one step, from the samples of its last three cycles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepPeaks {
    /// A_max = max |A|, m/s2.
    pub a_max_m_s2: f64,
    /// Largest D, m.
    pub d_max_m: f64,
    /// Smallest D, m.
    pub d_min_m: f64,
}

impl StepPeaks {
    /// Of no sample yet.
    pub(crate) const NONE: Self =
        Self { a_max_m_s2: 0.0, d_max_m: f64::NEG_INFINITY, d_min_m: f64::INFINITY };

    /// E_max = D_max - D_min, m.
    pub fn excursion_m(&self) -> f64 {
        self.d_max_m - self.d_min_m
    }

    pub(crate) fn take(&mut self, response: &Response) {
        self.a_max_m_s2 = self.a_max_m_s2.max(response.mass_acceleration_m_s2.abs());
        self.d_max_m = self.d_max_m.max(response.relative_displacement_m);
        self.d_min_m = self.d_min_m.min(response.relative_displacement_m);
    }
}

/// What an ideal sweep gave.
#[derive(Clone, Debug, PartialEq)]
pub struct SweepResponse {
    /// Peaks of every step.
    pub peaks: Vec<StepPeaks>,
    /// Contacts that began, both sides together.
    pub contacts: usize,
    /// Samples.
    pub samples: usize,
}

/// What a sweep visits sample by sample: index of the sample, index of its step, table acceleration
/// (m/s2), response.
pub type Visit<'a> = dyn FnMut(usize, usize, f64, &Response) + 'a;

/// Places of the steps on the time axis of samples.
struct Plan<'a> {
    steps: &'a [Step],
    starts: Vec<f64>,
    end: f64,
    dt: f64,
}

impl<'a> Plan<'a> {
    fn new(steps: &'a [Step], dt: f64) -> Self {
        let mut starts = Vec::with_capacity(steps.len());
        let mut end = 0.0;
        for step in steps {
            starts.push(end);
            end += f64::from(step.cycles) / step.frequency_hz;
        }
        Self { steps, starts, end, dt }
    }

    fn samples(&self) -> usize {
        (self.end / self.dt * (1.0 + 1e-14)) as usize + 1
    }

    fn end_of(&self, index: usize) -> f64 {
        self.starts.get(index + 1).copied().unwrap_or(self.end)
    }

    /// Peaks are taken from here on, s.
    fn counted_from(&self, index: usize) -> f64 {
        let step = &self.steps[index];
        self.end_of(index) - PEAK_CYCLES.min(f64::from(step.cycles)) / step.frequency_hz
    }
}

/// Peaks and contacts while a sweep runs.
struct Account<'v, 'a> {
    response: SweepResponse,
    touched: [bool; 2],
    index: usize,
    counted_from: f64,
    visit: &'v mut Visit<'a>,
}

impl<'v, 'a> Account<'v, 'a> {
    fn new(plan: &Plan<'_>, visit: &'v mut Visit<'a>) -> Self {
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

/// Response from rest to an ideal sweep sampled every `dt_s` s; `visit` sees every sample.
///
/// # Errors
/// [`ModelError`] as [`super::build`].
pub fn simulate_sweep(
    spec: &ModelSpec,
    steps: &[Step],
    dt_s: f64,
    options: &Options,
    visit: &mut Visit<'_>,
) -> Result<SweepResponse, ModelError> {
    let plan = Plan::new(steps, dt_s);
    if steps.is_empty() {
        return Ok(SweepResponse { peaks: Vec::new(), contacts: 0, samples: 0 });
    }
    match Exact::new(System::compile(spec, dt_s)?) {
        Ok(mut exact) => Ok(run_exact(&mut exact, &plan, visit)),
        Err(system) => {
            let mut solver = general::swept(*system, options)?;
            let mut account = Account::new(&plan, visit);
            run_general(solver.as_mut(), &plan, &mut account);
            Ok(account.response)
        }
    }
}

/// [`simulate_sweep`] into columns.
///
/// # Errors
/// [`ModelError`] as [`super::build`].
pub fn sweep_history(
    spec: &ModelSpec,
    steps: &[Step],
    dt_s: f64,
    options: &Options,
) -> Result<(SweepResponse, History), ModelError> {
    let mut history = History::with_capacity(Plan::new(steps, dt_s).samples());
    let response = simulate_sweep(spec, steps, dt_s, options, &mut |_, _, _, r| history.push(r))?;
    Ok((response, history))
}

fn run_exact(exact: &mut Exact, plan: &Plan<'_>, visit: &mut Visit<'_>) -> SweepResponse {
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

fn run_general(solver: &mut dyn general::Sweepable, plan: &Plan<'_>, account: &mut Account<'_, '_>) {
    let mut next = 0;
    for index in 0..plan.steps.len() {
        let step = &plan.steps[index];
        let start = plan.starts[index];
        account.enter(index, plan);
        let drive =
            Sine { amplitude: step.acceleration_amplitude_m_s2, angular_frequency: TAU * step.frequency_hz };
        let duration = plan.end_of(index) - start;
        let last = index + 1 == plan.steps.len();
        solver.stretch(duration, drive, &mut |begin, end, contacts, state| {
            account.count(contacts);
            loop {
                let t = next as f64 * plan.dt - start;
                if t > end && !(last && t <= duration * (1.0 + 1e-14))
                    || t > duration && !last
                    || next >= plan.samples()
                {
                    return;
                }
                if end < duration && t >= end {
                    return;
                }
                let part = ((t - begin) / (end - begin)).clamp(0.0, 1.0);
                account.sample(t + start, drive.at(t), &state(part));
                next += 1;
            }
        });
    }
}
