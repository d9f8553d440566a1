//! Ideal sweeps from event to event against the same sweeps sample by sample.

use super::closed;
use super::plan::Plan;
use super::sampled::run_exact;
use super::*;
use crate::model::testing::{b1_g2, effect};
use crate::sweep::{Schedule, SweepSpec, Transition};

const DT: f64 = 1.0 / 2048.0;

fn schedule(ag: f64) -> Schedule {
    let mut sweep = SweepSpec { transition: Transition::None, acceleration_g: ag, ..SweepSpec::paper() };
    (sweep.start_hz, sweep.stop_hz, sweep.step_hz, sweep.cycles) = (Some(0.5), Some(2.0), Some(0.3), 6);
    Schedule::new(&sweep).expect("valid")
}

fn exact(spec: &ModelSpec) -> Exact {
    let Ok(exact) = Exact::new(System::compile(spec, DT).expect("compiles")) else {
        panic!("not piecewise linear: {:?}", spec.effects)
    };
    exact
}

fn variants() -> Vec<(ModelSpec, f64)> {
    let with = |effects: Vec<crate::model::EffectSpec>, gap: f64, k: f64, c: f64| {
        let mut spec = b1_g2();
        spec.effects = effects;
        spec.bumper = Some(crate::model::BumperSpec { stiffness_n_m: k, damping_n_s_m: c, total_gap_m: gap });
        spec
    };
    vec![
        (with(vec![], 0.020, 33e3, 300.0), 0.05),
        (with(vec![], 0.020, 175e3, 500.0), 0.05),
        // Knee and gap coincide; both bumpers at once; a bumper without damping; a stiff one.
        (with(vec![], 0.016, 33e3, 300.0), 0.05),
        (with(vec![], 0.0, 33e3, 300.0), 0.05),
        (with(vec![], 0.020, 33e3, 0.0), 0.05),
        (with(vec![], 0.015, 3e6, 3000.0), 0.07),
        // Beyond 40 mm.
        (with(vec![], 0.080, 33e3, 300.0), 0.10),
        (with(vec![effect("coulomb-friction", &[("fc_n", 60.0)])], 0.020, 33e3, 300.0), 0.05),
        (with(vec![effect("coulomb-friction", &[("fc_n", 240.0)])], 0.020, 33e3, 300.0), 0.05),
        (
            with(
                vec![effect("gap-asymmetry", &[("s_m", 0.002)]), effect("constant-force", &[("f_n", 20.0)])],
                0.020,
                33e3,
                300.0,
            ),
            0.05,
        ),
        (with(vec![effect("bumper-preload", &[("f0_n", 30.0)])], 0.020, 33e3, 300.0), 0.05),
    ]
}

#[test]
fn events_and_samples_agree_and_peaks_are_those_of_the_samples() {
    for (spec, ag) in variants() {
        let schedule = schedule(ag);
        let plan = Plan::new(schedule.steps(), DT);
        let mut stepped: Vec<Response> = Vec::new();
        let reference = run_exact(&mut exact(&spec), &plan, &mut |_, _, _, r| stepped.push(*r));
        let mut solver = exact(&spec);
        let pieces = solver.closed(&plan).expect("closed form");
        let mut worst = [0.0_f64; 3];
        let mut scanned = vec![StepPeaks::NONE; plan.steps.len()];
        let mut next = 0;
        let response = closed::visit(&mut solver, &pieces, &plan, &mut |i, step, _, r| {
            assert_eq!(i, next);
            next += 1;
            let other = &stepped[i];
            let apart = |f: fn(&Response) -> f64| (f(r) - f(other)).abs();
            worst[0] = worst[0].max(apart(|r| r.relative_displacement_m));
            worst[1] = worst[1].max(apart(|r| r.relative_velocity_m_s));
            if r.regime == other.regime {
                worst[2] = worst[2].max(apart(|r| r.mass_acceleration_m_s2));
            }
            if i >= plan.first_counted(step) {
                scanned[step].take(r);
            }
        });
        assert_eq!((next, response.samples), (reference.samples, reference.samples));
        assert!(worst[0] < 1e-11 && worst[1] < 1e-9, "{worst:?}");
        // At rest between both bumpers (no gap) it is a matter of taste which one touches first.
        let unsure = usize::from(spec.bumper.as_ref().is_some_and(|b| b.total_gap_m == 0.0));
        assert!(response.contacts.abs_diff(reference.contacts) <= unsure, "{response:?}");
        for (i, (found, scanned)) in response.peaks.iter().zip(&scanned).enumerate() {
            let pairs = [
                (found.a_max_m_s2, scanned.a_max_m_s2),
                (found.d_max_m, scanned.d_max_m),
                (found.d_min_m, scanned.d_min_m),
            ];
            for (one, two) in pairs {
                assert!((one - two).abs() <= 1e-10 * two.abs().max(1e-4), "step {i}: {one} {two}");
            }
        }
    }
}
