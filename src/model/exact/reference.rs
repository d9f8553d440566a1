//! The published model solved by an independent integrator (Dormand and Prince 8(5,3) of the crate
//! `differential-equations`, tip displacements as states of their own, corners bisected on fresh
//! integrations), against the closed form.

use crate::model::sweep::simulate_sweep;
use crate::model::testing::b1_g2;
use crate::model::{ModelSpec, Options};
use crate::sweep::{Schedule, SweepSpec, Transition};
use differential_equations::prelude::*;
use std::f64::consts::TAU;

const DT: f64 = 1.0 / 2048.0;

/// One regime: sign of the segment of the isolator, contacts, and the table's sine.
#[derive(Clone, Copy)]
struct Regime {
    m: f64,
    c: f64,
    /// Slope and intercept of the isolator's line.
    line: (f64, f64),
    bumper: (f64, f64),
    half_gap: f64,
    contact: [bool; 2],
    amplitude: f64,
    w: f64,
}

impl Regime {
    fn approach(&self, side: usize, y: &[f64; 4]) -> (f64, f64) {
        let sign = if side == 0 { 1.0 } else { -1.0 };
        (sign * y[0] - self.half_gap, sign * y[1])
    }

    fn contact_force(&self, side: usize, y: &[f64; 4]) -> f64 {
        let (p, rate) = self.approach(side, y);
        if self.contact[side] { self.bumper.0 * p + self.bumper.1 * rate } else { 0.0 }
    }

    /// Above zero while the regime holds, one entry a corner.
    fn holds(&self, segment: i32, y: &[f64; 4]) -> [f64; 4] {
        let knees = [0.008, 0.040];
        let outer = |s: i32| knees.get(s.unsigned_abs() as usize).copied().unwrap_or(f64::INFINITY);
        let inner = |s: i32| knees[s.unsigned_abs() as usize - 1];
        let (low, high) = match segment {
            0 => (-outer(0), outer(0)),
            s if s > 0 => (inner(s), outer(s)),
            s => (-outer(s), -inner(s)),
        };
        let side = |side: usize| {
            if self.contact[side] {
                self.contact_force(side, y)
            } else {
                y[2 + side] - self.approach(side, y).0
            }
        };
        [high - y[0], y[0] - low, side(0), side(1)]
    }
}

impl ODE<f64, [f64; 4]> for Regime {
    fn diff(&self, t: f64, y: &[f64; 4], dydt: &mut [f64; 4]) {
        let force = self.line.0 * y[0] + self.line.1 + self.c * y[1] + self.contact_force(0, y)
            - self.contact_force(1, y);
        dydt[0] = y[1];
        dydt[1] = -force / self.m - self.amplitude * (self.w * t).sin();
        for side in 0..2 {
            dydt[2 + side] = if self.contact[side] {
                self.approach(side, y).1
            } else {
                -self.bumper.0 / self.bumper.1 * y[2 + side]
            };
        }
    }
}

fn advance(regime: &Regime, from: f64, to: f64, y: [f64; 4]) -> [f64; 4] {
    let method = ExplicitRungeKutta::dop853().rtol(1e-13).atol(1e-16).h0(to - from);
    let solution = IVP::ode(regime, from, to, y).method(method).solve().expect("integrates");
    *solution.y.last().expect("an end")
}

/// D and A at every sample and the number of contacts, step after step.
fn independent(spec: &ModelSpec, schedule: &Schedule) -> (Vec<(f64, f64)>, usize) {
    let bumper = spec.bumper.as_ref().expect("bumpers");
    let lines = [(20e3, 0.0), (18e3, 16.0), (2e3, 656.0)];
    let mut regime = Regime {
        m: spec.mass_kg,
        c: spec.isolator.damping_n_s_m,
        line: lines[0],
        bumper: (bumper.stiffness_n_m, bumper.damping_n_s_m),
        half_gap: 0.5 * bumper.total_gap_m,
        contact: [false; 2],
        amplitude: 0.0,
        w: 0.0,
    };
    let (mut y, mut segment, mut contacts) = ([0.0; 4], 0_i32, 0);
    let mut out = vec![(0.0, 0.0)];
    let mut begin = 0.0;
    for step in schedule.steps() {
        let end = begin + f64::from(step.cycles) / step.frequency_hz;
        (regime.amplitude, regime.w) = (step.acceleration_amplitude_m_s2, TAU * step.frequency_hz);
        let mut t = 0.0;
        while t < end - begin {
            // To the next sample, or to the end of the step.
            let sample = out.len() as f64 * DT - begin;
            let to = sample.min(end - begin);
            while t < to {
                let trial = advance(&regime, t, to, y);
                let fails = |y: &[f64; 4]| regime.holds(segment, y).iter().position(|g| *g < 0.0);
                if fails(&trial).is_none() {
                    (y, t) = (trial, to);
                    break;
                }
                let (mut low, mut high) = (0.0, to - t);
                while high - low > 2e-16 {
                    let middle = 0.5 * (low + high);
                    if middle <= low || middle >= high {
                        break;
                    }
                    if fails(&advance(&regime, t, t + middle, y)).is_none() {
                        low = middle
                    } else {
                        high = middle
                    }
                }
                let after = advance(&regime, t, t + high, y);
                let corner = fails(&after).expect("fails there");
                (y, t) = (after, t + high);
                match corner {
                    0 => segment += 1,
                    1 => segment -= 1,
                    _ => {
                        let side = corner - 2;
                        regime.contact[side] = !regime.contact[side];
                        contacts += usize::from(regime.contact[side]);
                        y[corner] = regime.approach(side, &y).0;
                    }
                }
                let (slope, intercept) = lines[segment.unsigned_abs() as usize];
                regime.line = (slope, f64::from(segment.signum()) * intercept);
            }
            if t >= sample && sample < end - begin {
                let mut rates = [0.0; 4];
                regime.diff(t, &y, &mut rates);
                out.push((y[0], rates[1] + regime.amplitude * (regime.w * t).sin()));
            }
        }
        begin = end;
    }
    (out, contacts)
}

#[test]
fn closed_form_is_what_an_independent_integrator_finds() {
    for (stiffness, damping, ag) in [(33e3, 300.0, 0.05), (175e3, 500.0, 0.07)] {
        let mut sweep = SweepSpec { transition: Transition::None, acceleration_g: ag, ..SweepSpec::paper() };
        (sweep.start_hz, sweep.stop_hz, sweep.step_hz, sweep.cycles) = (Some(0.9), Some(1.3), Some(0.2), 2);
        let schedule = Schedule::new(&sweep).expect("valid");
        let mut spec = b1_g2();
        let bumper = spec.bumper.as_mut().expect("bumpers");
        (bumper.stiffness_n_m, bumper.damping_n_s_m) = (stiffness, damping);
        let (expected, contacts) = independent(&spec, &schedule);
        let (mut worst_d, mut worst_a) = (0.0_f64, 0.0_f64);
        let response = simulate_sweep(&spec, schedule.steps(), DT, &Options::default(), &mut |i, _, _, r| {
            if let Some((d, a)) = expected.get(i) {
                worst_d = worst_d.max((r.relative_displacement_m - d).abs());
                worst_a = worst_a.max((r.mass_acceleration_m_s2 - a).abs());
            }
        });
        let response = response.expect("runs");
        assert_eq!(response.contacts, contacts);
        assert!(contacts >= 10 && expected.len() + 1 >= response.samples, "{contacts} {}", expected.len());
        assert!(worst_d < 1e-11 && worst_a < 1e-8, "D {worst_d} m, A {worst_a} m/s2");
    }
}
