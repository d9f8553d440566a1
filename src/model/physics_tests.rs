//! Laws that hold whatever the parameters: time reversal, grazing, chatter, cost, and a step
//! path that does not allocate.

use super::effects::CATALOGUE;
use super::testing::{b1_g2, effect, oscillator};
use super::{BumperSpec, ModelSpec, Response, Scales, build};
use assert_no_alloc::assert_no_alloc;
use proptest::prelude::*;
use std::f64::consts::TAU;

const DT: f64 = 1.0 / 2048.0;

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// Without losses a motion runs backwards when its velocity and its input do.
    #[test]
    fn time_reversal_brings_a_lossless_specimen_back(
        gap in 0.004_f64..0.03,
        bumper in 1e4_f64..4e5,
        amplitude in 0.1_f64..0.6,
        hz in 0.5_f64..3.0,
    ) {
        let mut spec = b1_g2();
        spec.isolator.damping_n_s_m = 0.0;
        spec.bumper =
            Some(BumperSpec { stiffness_n_m: bumper, damping_n_s_m: 0.0, total_gap_m: gap });
        let table: Vec<f64> =
            (0..1500).map(|i| amplitude * (TAU * hz * f64::from(i) * DT).sin()).collect();
        let mut forth = build(&spec, DT).expect("builds");
        let mut end = Response::default();
        for a in &table[1..] {
            end = forth.step(*a);
        }
        let mut back = build(&spec, DT).expect("builds");
        back.impose(end.relative_displacement_m, -end.relative_velocity_m_s);
        back.prime(table[table.len() - 1]);
        for a in table[..table.len() - 1].iter().rev() {
            end = back.step(*a);
        }
        prop_assert!(end.relative_displacement_m.abs() < 1e-9, "{end:?}");
        prop_assert!(end.relative_velocity_m_s.abs() < 1e-8, "{end:?}");
    }
}

#[test]
fn grazing_a_bumper_or_a_knee_is_decided_by_the_last_digits() {
    // Free vibration without losses: D reaches v0 / w exactly, after a quarter of the period (509 samples).
    let (m, k, v0) = (500.0_f64, 20e3_f64, 0.1_f64);
    let (w, samples) = ((k / m).sqrt(), 600);
    let peak = v0 / w;
    for short in [1e-6, 1e-9, 1e-12, -1e-12, -1e-9, -1e-6] {
        let mut bumper = oscillator(m, k, 0.0);
        bumper.bumper =
            Some(BumperSpec { stiffness_n_m: 5e5, damping_n_s_m: 300.0, total_gap_m: 2.0 * (peak - short) });
        let mut knee = oscillator(m, k, 0.0);
        knee.isolator.stiffness_n_m = vec![k, 0.5 * k];
        knee.isolator.breakpoints_m = vec![peak - short];
        for (spec, [stiffness, damping]) in [(bumper, [5e5, 300.0]), (knee, [0.5 * k, 0.0])] {
            let mut specimen = build(&spec, DT).expect("builds");
            specimen.impose(0.0, v0);
            specimen.prime(0.0);
            let (mut touched, mut apart) = (false, 0.0_f64);
            for i in 1..=samples {
                let response = specimen.step(0.0);
                touched |= response.regime.right_contact || response.regime.isolator_branch == 1;
                let undisturbed = peak * (w * f64::from(i) * DT).sin();
                apart = apart.max((response.relative_displacement_m - undisturbed).abs());
            }
            let reach = short.max(0.0);
            assert!(reach > 0.0 || !touched, "{short} {damping}: touched what is out of reach");
            // The velocity that the way beyond the edge costs: damper on the way in, spring throughout.
            let beyond_s = 2.0 * (2.0 * reach / peak).sqrt() / w;
            let most = 1.2 * reach * (damping + stiffness * beyond_s) / m;
            let least = 0.9 * reach * damping / m;
            let since = w * f64::from(samples) * DT - 0.5 * std::f64::consts::PI;
            assert!(apart <= 1e-13 + most / w, "{short} {damping}: {apart}");
            // Even what lies between two samples shows afterwards.
            assert!(apart >= least * since.sin() / w - 1e-13, "{short} {damping}: {apart}");
            assert!(reach < 1e-7 || touched, "{short} {damping}: missed");
        }
    }
}

#[test]
fn chatter_dies_out_and_rests_on_the_bumper() {
    // Pressed to the right bumper, the mass bounces ever lower.
    let mut spec = oscillator(500.0, 0.0, 60.0);
    spec.bumper = Some(BumperSpec { stiffness_n_m: 3e6, damping_n_s_m: 3000.0, total_gap_m: 0.002 });
    spec.effects.push(effect("constant-force", &[("f_n", -300.0)]));
    let mut specimen = build(&spec, DT).expect("builds");
    specimen.impose(0.0, 0.0);
    specimen.prime(0.0);
    let (mut impacts, mut before, mut last) = (0, false, Response::default());
    for _ in 0..40_000 {
        last = specimen.step(0.0);
        impacts += usize::from(last.regime.right_contact && !before);
        before = last.regime.right_contact;
    }
    assert!(impacts >= 2, "{impacts}");
    assert!((last.relative_displacement_m - 0.001 - 300.0 / 3e6).abs() < 1e-9, "{last:?}");
    assert!(last.relative_velocity_m_s.abs() < 1e-9 && last.regime.right_contact);
}

#[test]
fn no_step_of_any_model_allocates() {
    let mut models: Vec<ModelSpec> = vec![b1_g2()];
    for entry in CATALOGUE {
        let mut spec = b1_g2();
        let mut added = entry.starting_spec(&Scales::of_spec(&spec, DT));
        if entry.name == "expression" {
            added.expression = Some("k_n_m*d + 30*tanh(v/1e-3) + p_r^1.5*exp(-t) + 0*a".into());
            added.parameters.insert("k_n_m".into(), 100.0);
        }
        spec.effects.push(added);
        models.push(spec);
    }
    for spec in models {
        let mut specimen = build(&spec, DT).expect("builds");
        let input: Vec<f64> = (0..2048).map(|i| 0.6 * (TAU * f64::from(i) * DT).sin()).collect();
        let largest = assert_no_alloc(|| {
            specimen.reset();
            specimen.impose(0.001, 0.01);
            specimen.prime(input[0]);
            specimen.set_time_s(3.0);
            input.iter().map(|a| specimen.step(*a).relative_displacement_m.abs()).fold(0.0, f64::max)
        });
        assert!(largest > 1e-3, "{:?}", spec.effects);
    }
}
