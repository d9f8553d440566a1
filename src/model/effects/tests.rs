//! Every effect on its own, against what its equation says in closed form.

use super::*;
use crate::model::build;
use crate::model::testing::{b1_g2, effect, oscillator};

const DT: f64 = 1.0 / 2048.0;

#[test]
fn every_effect_builds_with_its_starting_values_and_moves_finitely() {
    for entry in CATALOGUE.iter().filter(|entry| entry.name != "expression") {
        let mut spec = b1_g2();
        spec.effects.push(entry.starting_spec(&Scales::of_spec(&spec, DT)));
        let mut specimen = build(&spec, DT).unwrap_or_else(|error| panic!("{}: {error}", entry.name));
        let mut largest = 0.0_f64;
        for i in 0..8192 {
            let a = 0.5 * (std::f64::consts::TAU * f64::from(i) * DT).sin();
            largest = largest.max(specimen.step(a).relative_displacement_m.abs());
        }
        assert!(largest > 1e-3 && largest < 0.1, "{}: {largest}", entry.name);
    }
}

#[test]
fn names_and_parameters_are_unique_and_complete() {
    let scales = Scales::of_spec(&b1_g2(), DT);
    for (i, entry) in CATALOGUE.iter().enumerate() {
        assert!(CATALOGUE[..i].iter().all(|other| other.name != entry.name));
        for p in (entry.parameters)(&scales) {
            assert!(
                p.prior.0 < p.prior.1 && p.prior.0 <= p.start && p.start <= p.prior.1,
                "{} {}",
                entry.name,
                p.name
            );
        }
    }
}

#[test]
fn dry_friction_decays_linearly_and_sticks() {
    // Den Hartog: the amplitude falls by 4 Fc/k a cycle.
    let (m, k, fc) = (2.0, 800.0, 4.0);
    let mut spec = oscillator(m, k, 0.0);
    spec.effects.push(effect("coulomb-friction", &[("fc_n", fc)]));
    let mut specimen = build(&spec, DT).expect("builds");
    specimen.impose(0.0, 2.0);
    specimen.prime(0.0);
    let (mut peaks, mut last) = (Vec::new(), 2.0);
    let mut end = crate::model::Response::default();
    for _ in 0..8192 {
        end = specimen.step(0.0);
        if end.relative_velocity_m_s * last < 0.0 && !end.regime.sticking {
            peaks.push(end.relative_displacement_m.abs());
        }
        if end.relative_velocity_m_s != 0.0 {
            last = end.relative_velocity_m_s;
        }
    }
    assert!(peaks.len() > 5);
    for pair in peaks.windows(2) {
        assert!((pair[0] - pair[1] - 2.0 * fc / k).abs() < 2e-5, "{pair:?}");
    }
    assert!(
        end.regime.sticking
            && end.relative_velocity_m_s == 0.0
            && end.relative_displacement_m.abs() <= fc / k
    );
}

#[test]
fn friction_that_turns_round_over_next_to_no_velocity_is_one_that_sticks() {
    let moved = |parameters: &[(&str, f64)]| -> Vec<f64> {
        let mut spec = b1_g2();
        spec.effects.push(effect("coulomb-friction", parameters));
        let mut specimen = build(&spec, DT).expect("builds");
        let input = (0..16384).map(|i| 0.5 * (std::f64::consts::TAU * f64::from(i) * DT).sin());
        input.map(|a| specimen.step(a).relative_displacement_m).collect()
    };
    let sticking = moved(&[("fc_n", 40.0)]);
    let apart = |over_m_s: f64| {
        let smooth = moved(&[("fc_n", 40.0), ("vt_m_s", over_m_s)]);
        smooth.iter().zip(&sticking).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    };
    // It creeps for as long as it would stick: what it moves by then is in proportion to that velocity.
    let [little, less, least] = [1e-4, 1e-5, f64::MIN_POSITIVE.sqrt()].map(apart);
    assert!(little < 5e-5 && less < 0.2 * little && least < less, "{little} {less} {least}");
}

/// Force over an imposed sine, N, and the energy it takes a cycle, J, in the last of `cycles`.
fn loop_of(spec: &ModelSpec, amplitude: f64, hz: f64, cycles: u32) -> (Vec<f64>, f64) {
    let n = 4096_u32;
    let dt = 1.0 / (hz * f64::from(n));
    let w = std::f64::consts::TAU * hz;
    let mut specimen = build(spec, dt).expect("builds");
    let (mut last, mut work, mut before) = (Vec::new(), 0.0, (0.0, 0.0));
    for i in 1..=n * cycles {
        let (sin, cos) = (w * f64::from(i) * dt).sin_cos();
        let response = specimen.impose(amplitude * sin, amplitude * w * cos);
        let force = -response.mass_acceleration_m_s2 * spec.mass_kg;
        if i > n * (cycles - 1) {
            work += 0.5 * (force + before.1) * (amplitude * sin - before.0);
            last.push(force);
        }
        before = (amplitude * sin, force);
    }
    (last, work)
}

#[test]
fn a_maxwell_branch_loses_most_at_one_over_tau() {
    let (km, tau, x) = (1000.0, 0.2, 0.01);
    let mut spec = oscillator(1.0, 0.0, 0.0);
    spec.effects.push(effect("maxwell-branch", &[("km_n_m", km), ("tau_s", tau)]));
    for wt in [0.3, 1.0, 3.0] {
        let (_, work) = loop_of(&spec, x, wt / tau / std::f64::consts::TAU, 12);
        let expected = std::f64::consts::PI * x * x * km * wt / (1.0 + wt * wt);
        assert!((work / expected - 1.0).abs() < 1e-5, "{wt}: {work} {expected}");
    }
}

#[test]
fn a_springpot_turns_the_force_by_its_order() {
    let (ca, alpha, x, hz) = (500.0, 0.4, 0.01, 2.0);
    let mut spec = oscillator(1.0, 0.0, 0.0);
    spec.effects.push(effect("fractional-damping", &[("ca", ca), ("alpha", alpha)]));
    let (_, work) = loop_of(&spec, x, hz, 12);
    let w = std::f64::consts::TAU * hz;
    let half = std::f64::consts::FRAC_PI_2 * alpha;
    let expected = std::f64::consts::PI * x * x * ca * w.powf(alpha) * half.sin();
    assert!((work / expected - 1.0).abs() < 1e-3, "{work} {expected}");
}

/// Forces over an imposed sine after two cycles of so many samples, N.
fn forces_along(spec: &ModelSpec, amplitude: f64, samples: u32) -> Vec<f64> {
    let w = std::f64::consts::TAU;
    let dt = 1.0 / f64::from(samples);
    let mut specimen = build(spec, dt).expect("builds");
    let mut force = |i: u32| {
        // Where it turns is between samples.
        let (sin, cos) = (w * (f64::from(i) * dt + 0.02)).sin_cos();
        -specimen.impose(amplitude * sin, amplitude * w * cos).mass_acceleration_m_s2 * spec.mass_kg
    };
    (0..3 * samples).map(&mut force).skip(2 * samples as usize).collect()
}

#[test]
fn few_samples_of_an_imposed_cycle_tell_what_many_tell() {
    let shape = [("kh_n_m", 1000.0), ("dy_m", 0.003), ("n", 1.3), ("beta", 0.6), ("gamma", 0.4)];
    let sliders = [("kp_n_m", 1000.0), ("yield_min_m", 0.001), ("yield_max_m", 0.006), ("exponent", -0.3)];
    let elements = [
        effect("bouc-wen-hysteresis", &shape),
        effect("iwan-hysteresis", &sliders),
        effect("maxwell-branch", &[("km_n_m", 1000.0), ("tau_s", 0.15)]),
    ];
    for element in elements {
        let mut spec = oscillator(1.0, 0.0, 0.0);
        spec.effects.push(element);
        let (few, many) = (forces_along(&spec, 0.01, 14), forces_along(&spec, 0.01, 1400));
        let most = many.iter().map(|f| f.abs()).fold(0.0, f64::max);
        let off = few.iter().zip(many.iter().step_by(100)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 2e-3 * most, "{:?}: {off} of {most}", spec.effects);
    }
}

#[test]
fn hysteresis_closes_its_loop_and_does_not_know_time() {
    for hysteresis in [
        effect("bouc-wen-hysteresis", &[("kh_n_m", 2000.0), ("dy_m", 0.002)]),
        effect(
            "iwan-hysteresis",
            &[("kp_n_m", 2000.0), ("exponent", -0.5), ("yield_min_m", 0.0), ("yield_max_m", 0.02)],
        ),
    ] {
        let mut spec = oscillator(1.0, 0.0, 0.0);
        spec.effects.push(hysteresis.clone());
        let (slow, slow_work) = loop_of(&spec, 0.01, 0.5, 4);
        let (again, _) = loop_of(&spec, 0.01, 0.5, 5);
        let (fast, fast_work) = loop_of(&spec, 0.01, 5.0, 4);
        let peak = slow.iter().fold(0.0_f64, |m, f| m.max(f.abs()));
        assert!(slow_work > 0.0 && (fast_work / slow_work - 1.0).abs() < 1e-6, "{}", hysteresis.name);
        for i in 0..slow.len() {
            assert!(
                (slow[i] - again[i]).abs() < 1e-6 * peak && (slow[i] - fast[i]).abs() < 1e-6 * peak,
                "{}",
                hysteresis.name
            );
        }
    }
}

#[test]
fn iwan_loss_is_a_power_of_amplitude() {
    let mut spec = oscillator(1.0, 0.0, 0.0);
    let parameters = [("kp_n_m", 2000.0), ("exponent", -0.5), ("yield_min_m", 0.0), ("yield_max_m", 0.1)];
    spec.effects.push(effect("iwan-hysteresis", &parameters));
    let ratio = loop_of(&spec, 0.02, 1.0, 3).1 / loop_of(&spec, 0.01, 1.0, 3).1;
    assert!((ratio.log2() - 2.5).abs() < 1e-3, "{}", ratio.log2());
}

#[test]
fn play_shows_as_a_flat_stretch_of_its_width() {
    let b = 0.004;
    let mut spec = oscillator(1.0, 1000.0, 0.0);
    spec.effects.push(effect("backlash", &[("b_m", b)]));
    let (force, work) = loop_of(&spec, 0.01, 1.0, 3);
    let flat = force.iter().filter(|f| f.abs() < 1e-9).count() as f64 / force.len() as f64;
    // Within b/2 of the centre a sine of amplitude x stays asin(b / 2x) / (pi/2) of the time.
    let expected = (b / 2.0 / 0.01_f64).asin() / std::f64::consts::FRAC_PI_2;
    assert!((flat - expected).abs() < 2e-3, "{flat} {expected}");
    let peak = force.iter().fold(0.0_f64, |m, f| m.max(*f));
    assert!((peak - 1000.0 * (0.01 - b / 2.0)).abs() < 1e-3 && work.abs() < 1e-5, "{peak} {work}");
}

#[test]
fn hertz_contact_time_falls_as_speed_to_the_fifth_root() {
    let dt = 1e-5;
    let contact_time = |speed: f64| {
        let mut spec = oscillator(1.0, 0.0, 0.0);
        spec.bumper =
            Some(crate::model::BumperSpec { stiffness_n_m: 1.0, damping_n_s_m: 0.0, total_gap_m: 0.01 });
        spec.effects.push(effect("hertz-contact", &[("kh", 1e6), ("n", 1.5)]));
        let mut specimen = build(&spec, dt).expect("builds");
        specimen.impose(0.0, speed);
        specimen.prime(0.0);
        let touches = (0..20_000).map(|_| specimen.step(0.0).regime.right_contact);
        touches.skip_while(|touch| !touch).take_while(|touch| *touch).count() as f64 * dt
    };
    let (slow, fast) = (contact_time(1.0), contact_time(4.0));
    assert!(slow > 0.005, "{slow}");
    assert!(((fast / slow).ln() / 4.0_f64.ln() + 0.2).abs() < 0.002, "{slow} {fast}");
    // Hertz: T = 2.94 (depth at most)/v, depth^(5/2) = (5/4) m v^2 / k.
    let expected = 2.9432 * (1.25 / 1e6_f64).powf(0.4);
    assert!((slow / expected - 1.0).abs() < 2e-3, "{slow} {expected}");
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(24))]

    /// Without losses the energy stays through knees and impacts, in both solvers.
    #[test]
    fn energy_stays_without_losses(
        speed in 0.05_f64..0.6, gap in 0.0_f64..0.03, stiffness in 1e4_f64..3e5, cubic in proptest::bool::ANY,
        rate in 1000.0_f64..4000.0,
    ) {
        let mut spec = b1_g2();
        spec.isolator.damping_n_s_m = 0.0;
        spec.bumper = Some(crate::model::BumperSpec { stiffness_n_m: stiffness, damping_n_s_m: 0.0, total_gap_m: gap });
        let k3 = if cubic { 1e6 } else { 0.0 };
        if cubic {
            spec.effects.push(effect("cubic-stiffness", &[("k3_n_m3", k3)]));
        }
        let system = crate::model::system::System::compile(&spec, 1.0 / rate).expect("compiles");
        let mut specimen = build(&spec, 1.0 / rate).expect("builds");
        specimen.impose(0.0, speed);
        specimen.prime(0.0);
        let potential = |d: f64| {
            let elastic: f64 = (0..system.slopes_n_m.len()).map(|i| {
                let inner = if i == 0 { 0.0 } else { system.knees_m[i - 1] };
                let outer = system.knees_m.get(i).copied().unwrap_or(f64::INFINITY).min(d.abs());
                if outer <= inner { return 0.0; }
                0.5 * system.slopes_n_m[i] * (outer * outer - inner * inner) + system.intercepts_n[i] * (outer - inner)
            }).sum();
            elastic + 0.5 * stiffness * (d.abs() - 0.5 * gap).max(0.0).powi(2) + 0.25 * k3 * d.powi(4)
        };
        let start = 0.5 * spec.mass_kg * speed * speed;
        for i in 0..4000 {
            let r = specimen.step(0.0);
            let energy = 0.5 * spec.mass_kg * r.relative_velocity_m_s.powi(2) + potential(r.relative_displacement_m);
            proptest::prop_assert!((energy / start - 1.0).abs() < if cubic { 1e-6 } else { 1e-9 }, "sample {i}: {energy} {start}");
        }
    }

    /// A table moving the other way gives the mirror image.
    #[test]
    fn mirrored_input_gives_the_mirrored_response(amplitude in 0.1_f64..1.0, hz in 0.5_f64..4.0, fc in 0.0_f64..60.0) {
        let mut spec = b1_g2();
        spec.effects.push(effect("coulomb-friction", &[("fc_n", fc)]));
        let (mut one, mut two) = (build(&spec, DT).expect("builds"), build(&spec, DT).expect("builds"));
        for i in 1..4000 {
            let a = amplitude * (std::f64::consts::TAU * hz * f64::from(i) * DT).sin();
            let (r, l) = (one.step(a), two.step(-a));
            proptest::prop_assert!((r.relative_displacement_m + l.relative_displacement_m).abs() < 1e-12);
            proptest::prop_assert!((r.right_contact_force_n - l.left_contact_force_n).abs() < 1e-6);
        }
    }
}

/// Models with one effect of the catalogue each, at its starting values.
fn with_each_effect() -> impl Iterator<Item = (&'static str, crate::model::ModelSpec)> {
    CATALOGUE.iter().filter(|entry| entry.name != "expression").map(|entry| {
        let mut spec = b1_g2();
        spec.effects.push(entry.starting_spec(&Scales::of_spec(&spec, DT)));
        (entry.name, spec)
    })
}

#[test]
fn every_effect_but_those_with_a_side_mirrors() {
    for (name, spec) in with_each_effect() {
        let (mut one, mut two) = (build(&spec, DT).expect("builds"), build(&spec, DT).expect("builds"));
        let mut apart = 0.0_f64;
        for i in 1..6000 {
            let t = f64::from(i) * DT;
            let a = 0.6 * (std::f64::consts::TAU * (0.7 + 0.2 * t) * t).sin();
            let (r, l) = (one.step(a), two.step(-a));
            apart = apart.max((r.relative_displacement_m + l.relative_displacement_m).abs());
        }
        let has_side = matches!(name, "constant-force" | "gap-asymmetry");
        assert!(if has_side { apart > 1e-4 } else { apart < 1e-9 }, "{name}: {apart}");
    }
}

/// The motion is that of the force: v^2/2 grows by the integral of (A - a_table) v, whatever the model.
#[test]
fn kinetic_energy_is_the_work_of_the_forces_that_are_reported() {
    let dt = 0.125 * DT;
    // A table that gives way moves otherwise than its command.
    for (name, spec) in with_each_effect().filter(|(name, _)| *name != "table-interaction") {
        let mut specimen = build(&spec, dt).expect("builds");
        let (mut work, mut turnover, mut worst) = (0.0, 0.0, 0.0_f64);
        let (mut d0, mut force0) = (0.0, None);
        for i in 0..40_000 {
            let t = f64::from(i) * dt;
            let a = 0.5 * (std::f64::consts::TAU * (0.8 + 0.2 * t) * t).sin();
            let now = specimen.step(a);
            let (d, v) = (now.relative_displacement_m, now.relative_velocity_m_s);
            let force = now.mass_acceleration_m_s2 - a;
            if let Some(before) = force0 {
                let share = 0.5 * (force + before) * (d - d0);
                work += share;
                turnover += f64::abs(share);
            } else {
                work = 0.5 * v * v;
            }
            worst = worst.max((0.5 * v * v - work).abs());
            (d0, force0) = (d, Some(force));
        }
        assert!(turnover > 0.01 && worst < 1e-4 * turnover, "{name}: {worst} of {turnover}");
    }
}
