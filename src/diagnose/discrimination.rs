//! How well a test would part two fitted explanations: not by how far their responses differ, but by what is left of the difference
//! when the wrong one is fitted again to both what was measured and the new test (Box and Hill 1967; T-optimality: Atkinson and
//! Fedorov 1975). The next test is chosen by it.

use super::next_test::{Reach, SweepProposal};
use crate::identify::refit::{Refit, with_zero};
use crate::model::{self, ModelSpec};
use crate::units::STANDARD_GRAVITY_M_S2;
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;

/// What a laser's zero is good to, m.
const LASER_ZERO_M: f64 = 20e-6;
/// Frequencies of the sweep that are simulated; samples a cycle, cycles until the motion is steady, and then.
const FREQUENCIES: u32 = 5;
const SAMPLES: u32 = 128;
const SETTLING: u32 = 5;
const STEADY: u32 = 2;
/// Cycles of a step that are not counted while it settles; samples of a test beyond which no more are counted.
const LOST: f64 = 2.0;
const COUNTED: f64 = 300_000.0;
/// Share of the displacement sensor's noise that is slow, and its memory, s: at low frequencies it is most of the noise.
const SLOW: f64 = 0.2;
const MEMORY_S: f64 = 5.0;
/// Standard deviations by which a fit's numbers are moved to see where its response goes.
const MOVED: f64 = 0.3;
/// Rounds in which the wrong one is fitted again, how often a step is halved, and the fall that ends it.
const ROUNDS: usize = 6;
const HALVED: i32 = 5;
const SETTLED: f64 = 0.5;

/// What is expected of a test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expected {
    /// RMS difference of A and D as they were fitted, each over its noise.
    pub difference: f64,
    /// What is left for the right one when the other is fitted again, nats: the less of the two ways round.
    pub nats: f64,
}

/// A fitted explanation, ready to be fitted again.
pub struct Rival<'a> {
    fit: &'a Refit,
    /// Steps of the numbers whose covariance is one: the columns of a root of the fit's covariance.
    steps: Vec<Vec<f64>>,
}

impl<'a> Rival<'a> {
    /// Takes the covariance of the fit's numbers apart.
    pub fn new(fit: &'a Refit) -> Self {
        let kept = fit.numbers.numbers.len();
        let free = with_zero(&fit.numbers, fit.zero_m, LASER_ZERO_M);
        let covariance = if free.len() == fit.fit.values.len() {
            fit.fit.covariance(&free, fit.inflation)
        } else {
            DMatrix::from_diagonal(&DVector::from_column_slice(&fit.sigmas).map(|s| s * s))
        };
        let width: Vec<f64> = (0..kept).map(|j| covariance[(j, j)].max(1e-300).sqrt()).collect();
        let scaled = DMatrix::from_fn(kept, kept, |i, j| {
            covariance[(i, j)] / (width[i] * width[j]) + if i == j { 1e-9 } else { 0.0 }
        });
        let root = scaled.cholesky().map_or_else(|| DMatrix::identity(kept, kept), |c| c.l());
        let steps = (0..kept).map(|k| (0..kept).map(|j| width[j] * root[(j, k)]).collect()).collect();
        Self { fit, steps }
    }

    /// The model so many steps away from the fit.
    fn at(&self, by: &DVector<f64>) -> Option<ModelSpec> {
        let numbers = self.steps.first().map_or(0, Vec::len);
        let sum = |j: usize| self.steps.iter().zip(by.iter()).map(|(step, by)| step[j] * by).sum();
        let moved: Vec<f64> = (0..numbers).map(sum).collect();
        self.fit.numbers.moved(self.fit.spec.clone(), &moved, 1.0)
    }

    /// Where the response goes along each step; nothing along one that leads out of what can be simulated.
    fn slopes(
        &self,
        by: &DVector<f64>,
        response: &[f64],
        test: &SweepProposal,
        reach: &Reach,
    ) -> DMatrix<f64> {
        let mut slopes = DMatrix::zeros(response.len(), self.steps.len());
        for k in 0..self.steps.len() {
            let mut moved = by.clone();
            moved[k] += MOVED;
            if let Some(moved) = self.at(&moved).and_then(|spec| respond(&spec, test, reach)) {
                let slope = moved.iter().zip(response).map(|(m, r)| (m - r) / MOVED);
                slopes.column_mut(k).iter_mut().zip(slope).for_each(|(to, slope)| *to = slope);
            }
        }
        slopes
    }

    /// Half the squares that are left when this model is fitted to another one's response in a test, beside what it was fitted to
    /// before.
    fn fitted_to(&self, other: &[f64], test: &SweepProposal, reach: &Reach, rounds: usize) -> Option<f64> {
        let mut by = DVector::zeros(self.steps.len());
        let mut response = respond(&self.fit.spec, test, reach)?;
        let mut left = apart(other, &response).norm_squared();
        for round in 1..=rounds {
            let (slopes, rest) = (self.slopes(&by, &response, test, reach), apart(other, &response));
            let bends = slopes.tr_mul(&slopes) + DMatrix::identity(by.len(), by.len());
            let pull = slopes.tr_mul(&rest) - &by;
            let step = bends.cholesky()?.solve(&pull);
            // A first look does without the simulation.
            if rounds == 1 {
                return Some(0.5 * (left - pull.dot(&step)).max(0.0));
            }
            let better = (0..HALVED).map(|k| 0.5_f64.powi(k)).find_map(|share| {
                let moved = &by + &step * share;
                let there = respond(&self.at(&moved)?, test, reach)?;
                let to = apart(other, &there).norm_squared() + moved.norm_squared();
                (to < left).then_some((to, moved, there))
            });
            let Some((to, moved, there)) = better else { break };
            let fall = left - to;
            (left, by, response) = (to, moved, there);
            if fall < SETTLED || round == rounds {
                break;
            }
        }
        Some(0.5 * left)
    }
}

/// How far two models differ in a test as they were fitted, with what that would be worth; `None` where one cannot be simulated.
pub fn difference(a: &Rival<'_>, b: &Rival<'_>, test: &SweepProposal, reach: &Reach) -> Option<Expected> {
    let apart = apart(&respond(&a.fit.spec, test, reach)?, &respond(&b.fit.spec, test, reach)?);
    Some(Expected { difference: rms_of(&apart, test, reach), nats: 0.5 * apart.norm_squared() })
}

/// What a test is expected to tell, to first order at a glance, else with the wrong one fitted in some rounds; `None` where one of the
/// two cannot be simulated.
pub fn expected(
    a: &Rival<'_>,
    b: &Rival<'_>,
    test: &SweepProposal,
    reach: &Reach,
    glance: bool,
) -> Option<Expected> {
    let (one, two) = (respond(&a.fit.spec, test, reach)?, respond(&b.fit.spec, test, reach)?);
    let rounds = if glance { 1 } else { ROUNDS };
    let colour = a.fit.inflation.max(b.fit.inflation).max(1.0);
    let left = b.fitted_to(&one, test, reach, rounds)?.min(a.fitted_to(&two, test, reach, rounds)?);
    let difference = rms_of(&apart(&one, &two), test, reach);
    left.is_finite().then_some(Expected { difference, nats: left / colour })
}

fn apart(a: &[f64], b: &[f64]) -> DVector<f64> {
    DVector::from_iterator(a.len(), a.iter().zip(b).map(|(a, b)| a - b))
}

fn rms_of(apart: &DVector<f64>, test: &SweepProposal, reach: &Reach) -> f64 {
    (0.5 * apart.norm_squared() / frequencies(test).map(|f| counted(test, f, reach)).sum::<f64>()).sqrt()
}

fn frequencies(test: &SweepProposal) -> impl Iterator<Item = f64> {
    let (start, stop) = (test.start_hz, test.stop_hz);
    (0..FREQUENCIES).map(move |i| start + (stop - start) * f64::from(i) / f64::from(FREQUENCIES - 1))
}

/// Samples of A that one of the simulated frequencies stands for.
fn counted(test: &SweepProposal, frequency_hz: f64, reach: &Reach) -> f64 {
    let steps = (test.stop_hz - test.start_hz) / test.step_hz + 1.0;
    let cycles = (f64::from(test.cycles) - LOST).max(1.0);
    let of = |f: f64| steps / f64::from(FREQUENCIES) * cycles * reach.rate_hz / f;
    of(frequency_hz) * (COUNTED / frequencies(test).map(of).sum::<f64>()).min(1.0)
}

/// Noise of the displacement sensor at a frequency over its white noise, both as they spread over the samples.
fn slow(frequency_hz: f64, reach: &Reach) -> f64 {
    let rolled_off = 1.0 + (TAU * frequency_hz * MEMORY_S).powi(2);
    (1.0 + SLOW * SLOW * MEMORY_S * reach.rate_hz / rolled_off).sqrt()
}

/// Steady A and D over a test but for their means (the zeros of a step are free), each sample over the noise of all those that it
/// stands for.
fn respond(spec: &ModelSpec, test: &SweepProposal, reach: &Reach) -> Option<Vec<f64>> {
    let spec = test.setting(spec).of(spec);
    let amplitude = test.acceleration_g * STANDARD_GRAVITY_M_S2;
    let noise_m_s2 = reach.noise_m_s2.max(1e-300);
    let mut all = Vec::with_capacity((2 * FREQUENCIES * SAMPLES * STEADY) as usize);
    for f in frequencies(test) {
        let dt = 1.0 / (f64::from(SAMPLES) * f);
        let mut specimen = model::build(&spec, dt).ok()?;
        specimen.reset();
        let laser_m = reach.laser_noise_m.max(1e-300) * slow(f, reach);
        let weight = (counted(test, f, reach) / f64::from(SAMPLES * STEADY)).sqrt();
        let (mut a, mut d) = (Vec::new(), Vec::new());
        for n in 1..=SAMPLES * (SETTLING + STEADY) {
            let out = specimen.step(amplitude * (TAU * f * f64::from(n) * dt).sin());
            if n > SAMPLES * SETTLING {
                a.push(out.mass_acceleration_m_s2 / noise_m_s2);
                d.push(out.relative_displacement_m / laser_m);
            }
        }
        for channel in [a, d] {
            let mean = channel.iter().sum::<f64>() / channel.len() as f64;
            all.extend(channel.iter().map(|x| weight * (x - mean)));
        }
    }
    all.iter().all(|x| x.is_finite()).then_some(all)
}
