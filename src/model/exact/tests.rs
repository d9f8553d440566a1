//! The exact propagator against the general solver.

use crate::model::general::boxed;
use crate::model::system::System;
use crate::model::testing::{b1_g2, effect};
use crate::model::{Options, Specimen, build};
use std::f64::consts::TAU;

const DT: f64 = 1.0 / 2048.0;

#[test]
fn both_solvers_agree_through_contacts_knees_and_sticking() {
    for effects in [
        vec![],
        vec![effect("coulomb-friction", &[("fc_n", 40.0)])],
        // The right gap and the first knee coincide at 8 mm.
        vec![effect("gap-asymmetry", &[("s_m", 0.002)]), effect("constant-force", &[("f_n", 20.0)])],
        vec![effect("bumper-preload", &[("f0_n", 30.0)])],
    ] {
        let mut spec = b1_g2();
        spec.effects = effects;
        let mut exact = build(&spec, DT).expect("builds");
        let system = System::compile(&spec, DT).expect("compiles");
        let mut general: Box<dyn Specimen> = boxed(system, &Options { tolerance: 1e-12 }).expect("builds");
        let (mut contacts, mut worst) = (0, 0.0_f64);
        for i in 0..40_000 {
            let t = f64::from(i) * DT;
            let a = 0.5 * (TAU * (0.5 + 0.05 * t) * t).sin();
            let (one, two) = (exact.step(a), general.step(a));
            worst = worst.max((one.relative_displacement_m - two.relative_displacement_m).abs());
            contacts += usize::from(one.regime.right_contact);
        }
        assert!(contacts > 1000 && worst < 1e-9, "{:?}: {contacts} samples, {worst} m", spec.effects);
    }
}

#[test]
fn the_paper_case_has_the_published_number_of_samples_and_the_expected_contacts() {
    use crate::model::simulate_sweep;
    use crate::sweep::{Schedule, SweepSpec, Transition};
    let sweep = SweepSpec { transition: Transition::None, ..SweepSpec::paper() };
    let schedule = Schedule::new(&sweep).expect("valid");
    for (stiffness, damping, contacts) in [(33e3, 300.0, 404), (175e3, 500.0, 500)] {
        let mut spec = b1_g2();
        if let Some(bumper) = &mut spec.bumper {
            (bumper.stiffness_n_m, bumper.damping_n_s_m) = (stiffness, damping);
        }
        let response = simulate_sweep(&spec, schedule.steps(), DT, &Options::default(), &mut |_, _, _, _| {});
        let response = response.expect("runs");
        assert_eq!(response.samples, 989_542);
        assert_eq!(response.contacts, contacts);
        for (up, down) in response.peaks.iter().zip(response.peaks.iter().rev()).take(3) {
            assert!((up.a_max_m_s2 / down.a_max_m_s2 - 1.0).abs() < 1e-3);
        }
    }
}
