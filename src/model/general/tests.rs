//! The general solver on its own.

use crate::model::testing::{b1_g2, effect, oscillator};
use crate::model::{build, simulate_sampled};
use std::f64::consts::TAU;

const DT: f64 = 1.0 / 2048.0;

#[test]
fn one_slope_without_bumpers_reaches_the_textbook_steady_state() {
    let (m, k, c, f) = (500.0_f64, 20e3_f64, 1100.0_f64, 1.3_f64);
    let w = TAU * f;
    let input: Vec<f64> = (1..=2048 * 40).map(|i| 0.5 * (w * f64::from(i) * DT).sin()).collect();
    let history = simulate_sampled(&oscillator(m, k, c), DT, &input).expect("runs");
    let gain = m * 0.5 / ((k - m * w * w).powi(2) + (c * w).powi(2)).sqrt();
    let phase = (-c * w).atan2(k - m * w * w);
    // First-order hold replaces the sine by chords: (wh)^2/12 = 1.3e-6 smaller.
    let shrink = 1.0 - (w * DT).powi(2) / 12.0;
    for i in (input.len() - 4000)..input.len() {
        let expected = -gain * shrink * (w * (i + 1) as f64 * DT + phase).sin();
        let got = history.relative_displacement_m[i];
        assert!((got - expected).abs() < 1e-8 * gain, "{i}: {got} {expected}");
    }
}

#[test]
fn contact_pushes_only_and_both_sides_are_reached() {
    let w = TAU * 1.0;
    let input: Vec<f64> = (1..=20480).map(|i| 0.5 * (w * f64::from(i) * DT).sin()).collect();
    let history = simulate_sampled(&b1_g2(), DT, &input).expect("runs");
    assert!(history.regime.iter().any(|r| r.right_contact) && history.regime.iter().any(|r| r.left_contact));
    for i in 0..history.len() {
        assert!(history.right_contact_force_n[i] >= -1e-6 && history.left_contact_force_n[i] >= -1e-6);
        let d = history.relative_displacement_m[i];
        assert!(!(d < 0.010 && history.regime[i].right_contact && history.regime[i].left_contact));
        if d > 0.0101 && history.relative_velocity_m_s[i] > 0.0 {
            assert!(history.regime[i].right_contact, "sample {i}: D = {d} m");
        }
    }
}

#[test]
fn what_is_far_too_stiff_to_be_followed_is_left_off() {
    let input: Vec<f64> = (1..=2048).map(|i| 0.5 * (TAU * f64::from(i) * DT).sin()).collect();
    let last = |dy_m: f64| {
        let mut spec = b1_g2();
        spec.effects.push(effect("bouc-wen-hysteresis", &[("kh_n_m", 1e4), ("dy_m", dy_m)]));
        let history = simulate_sampled(&spec, DT, &input).expect("runs");
        *history.relative_displacement_m.last().expect("samples")
    };
    assert!(last(1e-5).is_finite());
    // A time constant of some hundredths of a microsecond.
    assert!(last(1e-9).is_nan());
}

#[test]
fn imposing_the_simulated_motion_returns_the_simulated_force() {
    let w = TAU * 1.0;
    let input: Vec<f64> = (1..=20480).map(|i| 0.5 * (w * f64::from(i) * DT).sin()).collect();
    type Case<'a> = (Option<(&'a str, &'a [(&'a str, f64)])>, f64);
    // Permitted error, m/s2: what acts within a sample is not resolved.
    let cases: [Case<'_>; 7] = [
        (None, 1e-6),
        (Some(("maxwell-branch", &[("km_n_m", 3000.0), ("tau_s", 0.1)])), 1e-6),
        (Some(("fractional-damping", &[("ca", 500.0), ("alpha", 0.4)])), 1e-4),
        (Some(("bouc-wen-hysteresis", &[("kh_n_m", 5000.0), ("dy_m", 0.003)])), 2e-4),
        (Some(("stand-compliance", &[("ks_n_m", 2e5), ("ms_kg", 10.0)])), 5e-3),
        (Some(("hertz-contact", &[("kh", 3e5), ("n", 1.5)])), 1e-6),
        (Some(("coulomb-friction", &[("fc_n", 40.0)])), 1e-6),
    ];
    for (extra, permitted) in cases {
        let extra = extra.map(|(name, parameters)| effect(name, parameters));
        let mut spec = b1_g2();
        spec.effects.extend(extra);
        let history = simulate_sampled(&spec, DT, &input).expect("runs");
        let mut specimen = build(&spec, DT).expect("builds");
        for i in 0..history.len() {
            let response =
                specimen.impose(history.relative_displacement_m[i], history.relative_velocity_m_s[i]);
            let expected = history.mass_acceleration_m_s2[i];
            let corner = response.regime != history.regime[i];
            let off = (response.mass_acceleration_m_s2 - expected).abs();
            assert!(corner || off < permitted, "{:?}: sample {i}: {off} m/s2", spec.effects);
        }
    }
}

#[test]
fn a_stand_under_a_linear_bumper_is_followed_as_closely_as_one_that_is_searched_for_events() {
    // A nonlinear bumper is, and this one is next to linear.
    let forces = |mu: f64| {
        let mut spec = b1_g2();
        spec.bumper.as_mut().expect("has bumpers").damping_n_s_m = 700.0;
        spec.effects.push(effect("stand-compliance", &[("ks_n_m", 2e5), ("ms_kg", 3.0), ("zeta", 0.05)]));
        if mu > 0.0 {
            spec.effects.push(effect("hunt-crossley-damping", &[("mu_n_s_m2", mu)]));
        }
        let mut specimen = build(&spec, 2e-3).expect("builds");
        let (w, d) = (TAU * 1.7, 0.016);
        let at = |i: i32| (w * f64::from(i) * 2e-3).sin_cos();
        let imposed = (0..5000).map(at).map(|(sin, cos)| specimen.impose(d * sin, d * w * cos));
        imposed.map(|response| response.right_contact_force_n).collect::<Vec<f64>>()
    };
    let rms = |x: &mut dyn Iterator<Item = f64>| x.map(|x| x * x).sum::<f64>().sqrt();
    let (sampled, searched) = (forces(0.0), forces(1e-3));
    let apart = rms(&mut sampled.iter().zip(&searched).map(|(a, b)| a - b));
    let share = apart / rms(&mut searched.iter().copied());
    assert!(share < 1e-3, "{share}");
}

#[test]
fn a_blow_that_turned_between_two_samples_is_felt_on_the_way_back() {
    let mut spec = b1_g2();
    spec.effects.push(effect("bumper-stiffening", &[("kb3_n_m3", 3e8)]));
    let bumper = spec.bumper.as_mut().expect("has bumpers");
    (bumper.stiffness_n_m, bumper.damping_n_s_m, bumper.total_gap_m) = (140e3, 0.0, 0.012);
    let mut specimen = build(&spec, DT).expect("builds");
    specimen.impose(0.0059, 0.1);
    // A tip without damping follows the mass: it pushes for as long as it is pressed in.
    for (p, v) in [(4e-5, -0.02), (3e-5, -0.04), (1e-5, -0.06), (-2e-5, -0.08)] {
        let felt = specimen.impose(0.006 + p, v).right_contact_force_n;
        let expected = if p > 0.0 { 140e3 * p + 3e8 * p * p * p } else { 0.0 };
        assert!((felt - expected).abs() < 1e-6, "{p} m, {v} m/s: {felt} N, not {expected}");
    }
    // One with much damping stays behind where it was pushed to.
    spec.bumper.as_mut().expect("has bumpers").damping_n_s_m = 10e3;
    let mut specimen = build(&spec, DT).expect("builds");
    specimen.impose(0.0059, 0.1);
    assert!(specimen.impose(0.006 + 4e-5, -0.02).right_contact_force_n == 0.0);
}

#[test]
fn an_imposed_motion_starts_undeformed_whatever_pulls_at_the_mass() {
    // In its equilibrium the soft spring would be stretched by a metre, its hysteresis and the joint with it.
    let mut free = oscillator(1.0, 1e3, 10.0);
    free.effects.push(effect("bouc-wen-hysteresis", &[("kh_n_m", 1e5), ("dy_m", 2e-3)]));
    free.effects.push(effect("backlash", &[("b_m", 1e-3)]));
    let mut pulled = free.clone();
    pulled.effects.push(effect("constant-force", &[("f_n", 1e3)]));
    let [mut free, mut pulled] = [free, pulled].map(|spec| build(&spec, DT).expect("builds"));
    for i in 1..=2048 {
        let (sin, cos) = (TAU * f64::from(i) * DT).sin_cos();
        let [one, other] =
            [&mut free, &mut pulled].map(|s| s.impose(0.01 * sin, 0.01 * TAU * cos).mass_acceleration_m_s2);
        assert!((one - other - 1e3).abs() < 1e-6, "sample {i}: {one} {other}");
    }
}

#[test]
fn a_start_in_the_middle_of_a_record_goes_on_at_its_time() {
    let mut spec = oscillator(500.0, 20e3, 1100.0);
    spec.effects.push(effect("stiffness-degradation", &[("delta", 0.3), ("tau_s", 5.0)]));
    let mut drift = effect("expression", &[("f_n", 40.0)]);
    drift.expression = Some("f_n*sin(0.7*t)".into());
    spec.effects.push(drift);
    let table: Vec<f64> = (0..20_480).map(|i| 0.5 * (TAU * f64::from(i) * DT).sin()).collect();
    let mut whole = build(&spec, DT).expect("builds");
    let responses: Vec<_> = table.iter().map(|a| whole.step(*a)).collect();
    let middle = 10_000;
    let (mut late, mut wrong) = (build(&spec, DT).expect("builds"), build(&spec, DT).expect("builds"));
    let start = responses[middle];
    for specimen in [&mut late, &mut wrong] {
        specimen.impose(start.relative_displacement_m, start.relative_velocity_m_s);
        specimen.prime(table[middle]);
    }
    late.set_time_s((middle + 1) as f64 * DT);
    let mut apart = 0.0_f64;
    for i in middle + 1..table.len() {
        let expected = responses[i].relative_displacement_m;
        assert!((late.step(table[i]).relative_displacement_m - expected).abs() < 1e-9, "{i}");
        apart = apart.max((wrong.step(table[i]).relative_displacement_m - expected).abs());
    }
    assert!(apart > 1e-4, "the time made no difference: {apart} m");
}

#[test]
fn a_model_that_runs_away_ends_without_a_state() {
    let mut model = b1_g2();
    model.effects.push(effect("quadratic-damping", &[("c2_n_s2_m2", -1e5)]));
    let input: Vec<f64> = (1..=4096).map(|i| 1.0 * (TAU * 1.3 * f64::from(i) * DT).sin()).collect();
    let history = simulate_sampled(&model, DT, &input).expect("builds");
    assert!(history.relative_displacement_m[200].is_finite());
    assert!(history.relative_displacement_m[input.len() - 1].is_nan());
}

#[test]
fn steps_over_many_samples_are_the_steps_from_sample_to_sample() {
    let w = TAU * 1.0;
    let input: Vec<f64> = (1..=20480).map(|i| 0.5 * (w * f64::from(i) * DT).sin()).collect();
    let cases: [(&str, &[(&str, f64)]); 7] = [
        ("maxwell-branch", &[("km_n_m", 3000.0), ("tau_s", 0.1)]),
        ("bouc-wen-hysteresis", &[("kh_n_m", 5000.0), ("dy_m", 0.003)]),
        (
            "iwan-hysteresis",
            &[("kp_n_m", 5000.0), ("exponent", -0.3), ("yield_min_m", 1e-4), ("yield_max_m", 0.01)],
        ),
        ("stribeck-friction", &[("fc_n", 40.0), ("fs_n", 60.0), ("vs_m_s", 0.02)]),
        ("stand-compliance", &[("ks_n_m", 2e5), ("ms_kg", 10.0)]),
        ("bumper-stiffening", &[("kb3_n_m3", 3e8)]),
        ("table-interaction", &[("m_eff_inv_1_kg", 1e-5)]),
    ];
    for (name, parameters) in cases {
        let mut spec = b1_g2();
        spec.effects.push(effect(name, parameters));
        let mut one = build(&spec, DT).expect("builds");
        let mut other = build(&spec, DT).expect("builds");
        let stepped: Vec<_> = input.iter().map(|a| one.step(*a)).collect();
        let mut run = Vec::new();
        for stretch in input.chunks(7000) {
            other.run(stretch, &mut |response| run.push(*response));
        }
        assert_eq!(run.len(), stepped.len(), "{name}");
        // Chords in place of the sine: (wh)^2/12 = 8e-7 of the motion, more where contacts spread it.
        let apart = run
            .iter()
            .zip(&stepped)
            .map(|(a, b)| (a.relative_displacement_m - b.relative_displacement_m).abs());
        let worst = apart.fold(0.0, f64::max);
        // Iwan's force is a power of the distance from a reversal: its slope has no bound there.
        let most = if name == "iwan-hysteresis" { 3e-7 } else { 5e-8 };
        assert!(worst < most, "{name}: {worst} m");
    }
}

#[test]
fn behind_an_open_joint_all_that_damps_the_isolator_holds_it_back() {
    let (k, c, c2, play_m) = (1e3, 20.0, 2e3, 2e-3);
    let mut spec = oscillator(1.0, k, c);
    spec.effects.push(effect("quadratic-damping", &[("c2_n_s2_m2", c2)]));
    spec.effects.push(effect("backlash", &[("b_m", play_m)]));
    let mut specimen = build(&spec, DT).expect("builds");
    // Pushed to 10 mm, and let go into the middle of the play, where it creeps back to the stop at 9 mm.
    let pushed_m = 0.01 + 0.5 * play_m;
    for i in 1..=100 {
        specimen.impose(pushed_m * f64::from(i) / 100.0, pushed_m / (100.0 * DT));
    }
    specimen.impose(0.01, -0.5 * play_m / DT);
    let free = (1..).take_while(|_| specimen.impose(0.01, 0.0).mass_acceleration_m_s2 == 0.0).count();
    let (mut element_m, mut time_s, h) = (0.01, 0.0, 1e-6);
    while element_m > 0.01 - 0.5 * play_m {
        element_m -= h * (-c + f64::sqrt(c * c + 4.0 * c2 * k * element_m)) / (2.0 * c2);
        time_s += h;
    }
    let expected = time_s / DT;
    assert!((free as f64 - expected).abs() < 3.0, "after {free} samples, not {expected:.1}");
}
