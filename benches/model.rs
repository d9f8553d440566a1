//! The specimen model on the paper's sweep (B1-G2, 0.05 g, 92 steps, 989,542 samples), beside general
//! integrators from two kept crates on the same work: `cargo bench -p shaketable model`.

use criterion::{Criterion, criterion_group, criterion_main};
use differential_equations::prelude::*;
use shaketable::config::builtin::find;
use shaketable::model::{
    EffectSpec, ModelSpec, Options, SweepHistory, build, simulate_sweep, sweep_history, sweep_peaks,
};
use shaketable::sweep::{Schedule, Step, SweepSpec, Transition};
use std::f64::consts::TAU;
use std::hint::black_box;

const DT: f64 = 1.0 / 2048.0;

fn paper() -> (ModelSpec, Schedule) {
    let model = find("models", "andreaus-2020-b1-g2").and_then(|source| source.parse()).expect("built in");
    let sweep = SweepSpec { transition: Transition::None, acceleration_g: 0.05, ..SweepSpec::paper() };
    (model, Schedule::new(&sweep).expect("valid"))
}

/// One regime of the published model for the crate: displacement, velocity, both tips.
struct Regime {
    contact: [bool; 2],
    segment: i32,
    amplitude: f64,
    w: f64,
}

const KNEES: [f64; 3] = [0.008, 0.040, f64::INFINITY];
const LINES: [(f64, f64); 3] = [(20e3, 0.0), (18e3, 16.0), (2e3, 656.0)];
const BUMPER: (f64, f64) = (33e3, 300.0);
const HALF_GAP: f64 = 0.010;

impl Regime {
    fn contact_force(&self, side: usize, y: &[f64; 4]) -> f64 {
        let sign = 1.0 - 2.0 * side as f64;
        if self.contact[side] { BUMPER.0 * (sign * y[0] - HALF_GAP) + BUMPER.1 * sign * y[1] } else { 0.0 }
    }

    fn guards(&self, y: &[f64; 4]) -> [f64; 4] {
        let index = self.segment.unsigned_abs() as usize;
        let (outer, inner) = (KNEES[index], if index > 0 { KNEES[index - 1] } else { -KNEES[0] });
        let sign = if self.segment < 0 { -1.0 } else { 1.0 };
        let side = |side: usize| {
            let p = (1.0 - 2.0 * side as f64) * y[0] - HALF_GAP;
            if self.contact[side] { self.contact_force(side, y) } else { y[2 + side] - p }
        };
        [outer - sign * y[0], sign * y[0] - inner, side(0), side(1)]
    }
}

impl ODE<f64, [f64; 4]> for Regime {
    fn diff(&self, t: f64, y: &[f64; 4], dydt: &mut [f64; 4]) {
        let (slope, intercept) = LINES[self.segment.unsigned_abs() as usize];
        let elastic = slope * y[0] + f64::from(self.segment.signum()) * intercept;
        let force = elastic + 1100.0 * y[1] + self.contact_force(0, y) - self.contact_force(1, y);
        dydt[0] = y[1];
        dydt[1] = -force / 500.0 - self.amplitude * (self.w * t).sin();
        for side in 0..2 {
            let rate = (1.0 - 2.0 * side as f64) * y[1];
            dydt[2 + side] = if self.contact[side] { rate } else { -BUMPER.0 / BUMPER.1 * y[2 + side] };
        }
    }
}

impl Event<f64, [f64; 4]> for Regime {
    fn config(&self) -> EventConfig {
        EventConfig::default().terminal()
    }

    fn event(&self, _t: f64, y: &[f64; 4]) -> f64 {
        self.guards(y).into_iter().fold(f64::INFINITY, f64::min)
    }
}

/// The sweep by the crate, regime by regime with its own event finder, sampled at 2048 Hz.
fn by_crate(steps: &[Step]) -> usize {
    let mut regime = Regime { contact: [false; 2], segment: 0, amplitude: 0.0, w: 0.0 };
    let (mut y, mut samples) = ([0.0; 4], 0);
    for step in steps {
        (regime.amplitude, regime.w) = (step.acceleration_amplitude_m_s2, TAU * step.frequency_hz);
        let (mut t, end) = (0.0, f64::from(step.cycles) / step.frequency_hz);
        while end - t > 1e-9 {
            let method = ExplicitRungeKutta::dop853().rtol(1e-8).atol(1e-12);
            let Ok(solution) = IVP::ode(&regime, t, end, y).even(DT).event(&regime).method(method).solve()
            else {
                return samples;
            };
            samples += solution.t.len();
            (t, y) = match (solution.t.last(), solution.y.last()) {
                (Some(t), Some(y)) => (*t, *y),
                _ => return samples,
            };
            if end - t > 1e-9 {
                let guards = regime.guards(&y);
                let first = (0..4).min_by(|i, j| guards[*i].total_cmp(&guards[*j])).unwrap_or(0);
                enter(&mut regime, first, &mut y);
                // Past the corner, where its event would be found again.
                let mut rates = [0.0; 4];
                regime.diff(t, &y, &mut rates);
                y = std::array::from_fn(|i| y[i] + 1e-7 * rates[i]);
                t += 1e-7;
            }
        }
    }
    samples
}

/// The sweep by `diffsol` (Tsitouras 5(4)), with its own root finder and interpolation, sampled at 2048 Hz.
#[cfg(feature = "peers")]
fn by_diffsol(steps: &[Step]) -> Result<usize, diffsol::DiffsolError> {
    use diffsol::{NalgebraMat, OdeBuilder, OdeSolverMethod, OdeSolverStopReason};
    use std::cell::{Cell, RefCell};
    let regime = RefCell::new(Regime { contact: [false; 2], segment: 0, amplitude: 0.0, w: 0.0 });
    let begin = Cell::new(0.0);
    let four = |y: &[f64]| [y[0], y[1], y[2], y[3]];
    let rates = |y: [f64; 4], t: f64| {
        let mut dy = [0.0; 4];
        regime.borrow().diff(t - begin.get(), &y, &mut dy);
        dy
    };
    let problem = OdeBuilder::<NalgebraMat<f64>>::new()
        .rtol(1e-8)
        .atol([1e-12])
        .h0(DT)
        .rhs(|y, _, t, dy| dy.copy_from_slice(&rates(four(y), t)))
        .root(|y, _, _, g| g.copy_from_slice(&regime.borrow().guards(&four(y)).map(|g| g.min(1.0))), 4)
        .init(|_, _, y| y.fill(0.0), 4)
        .build()?;
    let mut solver = problem.tsit45()?;
    let mut row = solver.state().y.clone();
    let (mut samples, mut end) = (0_u32, 0.0);
    for step in steps {
        begin.set(end);
        end += f64::from(step.cycles) / step.frequency_hz;
        {
            let mut regime = regime.borrow_mut();
            (regime.amplitude, regime.w) = (step.acceleration_amplitude_m_s2, TAU * step.frequency_hz);
        }
        solver.set_stop_time(end)?;
        loop {
            let reason = solver.step()?;
            let until = match reason {
                OdeSolverStopReason::RootFound(t, _) => t,
                _ => solver.state().t,
            };
            while f64::from(samples) * DT <= until {
                solver.interpolate_inplace(f64::from(samples) * DT, &mut row)?;
                samples += 1;
            }
            match reason {
                OdeSolverStopReason::InternalTimestep => {}
                OdeSolverStopReason::TstopReached => break,
                OdeSolverStopReason::RootFound(t, guard) => {
                    solver.state_mut_back(t)?;
                    let state = solver.state_mut();
                    let mut y = [0, 1, 2, 3].map(|i| state.y[i]);
                    enter(&mut regime.borrow_mut(), guard, &mut y);
                    // Past the corner, where its root would be found again.
                    let dy = rates(y, t);
                    for i in 0..4 {
                        state.y[i] = y[i] + 1e-7 * dy[i];
                        state.dy[i] = dy[i];
                    }
                    *state.t = t + 1e-7;
                    if end - *state.t < 1e-9 {
                        break;
                    }
                }
            }
        }
    }
    Ok(samples as usize)
}

fn enter(regime: &mut Regime, guard: usize, y: &mut [f64; 4]) {
    match guard {
        0 => regime.segment += if y[0] > 0.0 { 1 } else { -1 },
        1 if regime.segment == 0 => regime.segment = -1,
        1 => regime.segment -= regime.segment.signum(),
        _ => {
            let side = guard - 2;
            regime.contact[side] = !regime.contact[side];
            y[guard] = (1.0 - 2.0 * side as f64) * y[0] - HALF_GAP;
        }
    }
}

fn model(c: &mut Criterion) {
    let (spec, schedule) = paper();
    let (steps, options) = (schedule.steps(), Options::default());
    let mut smooth = spec.clone();
    smooth.effects.push(EffectSpec {
        name: "cubic-stiffness".into(),
        expression: None,
        parameters: [("k3_n_m3".to_owned(), 1e6)].into(),
    });
    let mut input = Vec::new();
    simulate_sweep(&spec, steps, DT, &options, &mut |_, _, a, _| input.push(a)).expect("runs");
    let mut history = SweepHistory::default();
    let mut group = c.benchmark_group("model");
    group.sample_size(10);
    group.bench_function("sweep with histories", |b| {
        b.iter(|| black_box(sweep_history(&spec, steps, DT, &options, &mut history).expect("runs").contacts));
    });
    group.bench_function("sweep, peaks only", |b| {
        b.iter(|| black_box(sweep_peaks(&spec, steps, DT, &options).expect("runs").contacts));
    });
    let longer: Vec<Step> = steps.iter().map(|step| Step { cycles: 4 * step.cycles, ..*step }).collect();
    group.bench_function("sweep, peaks only, four times the cycles", |b| {
        b.iter(|| black_box(sweep_peaks(&spec, &longer, DT, &options).expect("runs").contacts));
    });
    group.bench_function("sweep with histories, four times the cycles", |b| {
        b.iter(|| {
            black_box(sweep_history(&spec, &longer, DT, &options, &mut history).expect("runs").contacts)
        });
    });
    group.throughput(criterion::Throughput::Elements(input.len() as u64));
    group.bench_function("sampled input", |b| {
        b.iter(|| {
            let mut specimen = build(&spec, DT).expect("builds");
            black_box(input.iter().filter(|a| specimen.step(**a).regime.right_contact).count())
        });
    });
    group.bench_function("general solver, cubic-stiffness, 1e-8", |b| {
        b.iter(|| {
            black_box(sweep_history(&smooth, steps, DT, &options, &mut history).expect("runs").contacts)
        });
    });
    group.bench_function("differential-equations, dop853, 1e-8", |b| b.iter(|| black_box(by_crate(steps))));
    #[cfg(feature = "peers")]
    group.bench_function("diffsol, tsit45, 1e-8", |b| b.iter(|| black_box(by_diffsol(steps).expect("runs"))));
    group.finish();
}

criterion_group!(benches, model);
criterion_main!(benches);
