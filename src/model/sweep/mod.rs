//! The response of a model to an ideal sweep: the table follows `a = A_G sin(phase)` exactly, steps
//! follow each other at phase 0, from rest. The command line, the bench and campaigns call it.

mod closed;
mod plan;
#[cfg(test)]
mod precise;
mod sampled;
#[cfg(test)]
mod tests;

pub(in crate::model) use plan::Plan;

use super::exact::{Closed, Exact};
use super::general;
use super::system::System;
use super::{ModelError, ModelSpec, Options, Regime, Response};
use crate::sweep::Step;

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

/// Columns of a sweep's history, one entry a sample.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SweepHistory {
    /// Relative displacement D, m.
    pub relative_displacement_m: Vec<f64>,
    /// Its rate, m/s.
    pub relative_velocity_m_s: Vec<f64>,
    /// Absolute acceleration of the mass A, m/s2.
    pub mass_acceleration_m_s2: Vec<f64>,
    /// First sample of every stretch of one regime, and the regime.
    pub regimes: Vec<(usize, Regime)>,
}

impl SweepHistory {
    fn resize(&mut self, samples: usize) {
        for column in [
            &mut self.relative_displacement_m,
            &mut self.relative_velocity_m_s,
            &mut self.mass_acceleration_m_s2,
        ] {
            if column.capacity() < samples {
                // Zeroed by the system, page by page, only where it is written.
                *column = vec![0.0; samples];
            } else {
                column.resize(samples, 0.0);
            }
        }
        self.regimes.clear();
    }

    fn enter(&mut self, sample: usize, regime: Regime) {
        if self.regimes.last().is_none_or(|(_, last)| *last != regime) {
            self.regimes.push((sample, regime));
        }
    }
}

/// How a model is best driven through a sweep.
enum Way {
    /// From event to event.
    Closed(Box<Exact>, Vec<Closed>),
    /// From sample to sample, by exact transitions.
    Exact(Box<Exact>),
    /// By the general solver.
    General(Box<dyn general::Sweepable>),
}

fn choose(spec: &ModelSpec, plan: &Plan<'_>, options: &Options) -> Result<Way, ModelError> {
    Ok(match Exact::new(System::compile(spec, plan.dt)?) {
        Ok(exact) => match exact.closed(plan) {
            Some(closed) => Way::Closed(Box::new(exact), closed),
            None => Way::Exact(Box::new(exact)),
        },
        Err(system) => Way::General(general::swept(*system, options)?),
    })
}

impl Way {
    fn visit(self, plan: &Plan<'_>, visit: &mut Visit<'_>) -> SweepResponse {
        if plan.steps.is_empty() {
            return SweepResponse { peaks: Vec::new(), contacts: 0, samples: 0 };
        }
        match self {
            Way::Closed(mut exact, closed) => closed::visit(&mut exact, &closed, plan, visit),
            Way::Exact(mut exact) => sampled::run_exact(&mut exact, plan, visit),
            Way::General(mut solver) => {
                let mut account = sampled::Account::new(plan, visit);
                sampled::run_general(solver.as_mut(), plan, &mut account);
                account.response
            }
        }
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
    Ok(choose(spec, &plan, options)?.visit(&plan, visit))
}

/// Peaks of an ideal sweep, without its samples: in closed form only those are evaluated that may be
/// the largest of their step.
///
/// # Errors
/// [`ModelError`] as [`super::build`].
pub fn sweep_peaks(
    spec: &ModelSpec,
    steps: &[Step],
    dt_s: f64,
    options: &Options,
) -> Result<SweepResponse, ModelError> {
    let plan = Plan::new(steps, dt_s);
    match choose(spec, &plan, options)? {
        Way::Closed(mut exact, closed) => Ok(closed::peaks(&mut exact, &closed, &plan)),
        way => Ok(way.visit(&plan, &mut |_, _, _, _| {})),
    }
}

/// Steady states of an ideal sweep from the last `cycles` cycles of each step, between samples too where the
/// general solver is needed: the quickest way to the peaks of a model, for those who evaluate thousands.
/// `dt_s` (s) is how finely peaks in closed form are looked at, and the sample of models in between.
///
/// # Errors
/// [`ModelError`] as [`super::build`].
pub fn steady_peaks(
    spec: &ModelSpec,
    steps: &[Step],
    dt_s: f64,
    options: &Options,
    cycles: f64,
) -> Result<Vec<StepPeaks>, ModelError> {
    let plan = Plan::counting(steps, dt_s, cycles);
    Ok(match choose(spec, &plan, options)? {
        Way::Closed(mut exact, closed) => closed::peaks(&mut exact, &closed, &plan).peaks,
        Way::General(mut solver) => sampled::peaks_general(solver.as_mut(), &plan),
        way => way.visit(&plan, &mut |_, _, _, _| {}).peaks,
    })
}

/// [`simulate_sweep`] into columns, whose memory is used again when it suffices.
///
/// # Errors
/// [`ModelError`] as [`super::build`].
pub fn sweep_history(
    spec: &ModelSpec,
    steps: &[Step],
    dt_s: f64,
    options: &Options,
    history: &mut SweepHistory,
) -> Result<SweepResponse, ModelError> {
    let plan = Plan::new(steps, dt_s);
    let way = choose(spec, &plan, options)?;
    history.resize(if steps.is_empty() { 0 } else { plan.samples() });
    Ok(match way {
        Way::Closed(mut exact, closed) => closed::history(&mut exact, &closed, &plan, history),
        way => way.visit(&plan, &mut |i, _, _, response| {
            history.relative_displacement_m[i] = response.relative_displacement_m;
            history.relative_velocity_m_s[i] = response.relative_velocity_m_s;
            history.mass_acceleration_m_s2[i] = response.mass_acceleration_m_s2;
            history.enter(i, response.regime);
        }),
    })
}
