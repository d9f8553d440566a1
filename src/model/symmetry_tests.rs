//! Mirror symmetry and time reversal of every effect of the catalogue: those that have a symmetry have it for
//! whatever parameters, those that have not are seen to break it.

use super::effects::CATALOGUE;
use super::energy_tests::candidates;
use super::general::General;
use super::system::System;
use super::testing::{b1_g2, effect};
use super::{BumperSpec, EffectSpec, ModelSpec, Observation, Observer, Options, Response, Specimen};
use super::{build, build_with};
use proptest::prelude::*;
use std::f64::consts::TAU;

const DT: f64 = 1.0 / 2048.0;

/// Every effect at a strength from 0 to 1, those of the instruments too; a force of one's own with sides.
fn every(strength: f64) -> Vec<EffectSpec> {
    let s = strength;
    let instruments = [
        effect("yaw-rotation", &[("e_m", 0.02 * s), ("f_hz", 15.0), ("zeta", 0.02), ("half_spacing_m", 0.5)]),
        effect("laser-delay", &[("dt_s", 3e-3 * s)]),
        effect("laser-gain", &[("gain", 1.0 + 0.05 * s)]),
        effect("accelerometer-gain", &[("gain", 1.0 + 0.05 * s)]),
        effect("accelerometer-delay", &[("dt_s", 3e-3 * s)]),
    ];
    let mut sided = effect("expression", &[("k_n_m2", 3e5 * s), ("c_n_s_m2", 2e5 * s)]);
    sided.expression = Some("k_n_m2*d^2 + c_n_s_m2*v*(p_r + 0.3*p_l)".into());
    candidates(s).into_iter().map(|(effect, _)| effect).chain(instruments).chain([sided]).collect()
}

/// The model seen in a mirror: right is left, and every parameter with a sense of its own changes its sign.
fn mirrored(spec: &ModelSpec) -> ModelSpec {
    let mut spec = spec.clone();
    for effect in &mut spec.effects {
        let sided = match effect.name.as_str() {
            "constant-force" => Some("f_n"),
            "gap-asymmetry" => Some("s_m"),
            _ => None,
        };
        if let Some(value) = sided.and_then(|name| effect.parameters.get_mut(name)) {
            *value = -*value;
        }
        if let Some(text) = effect.expression.as_mut().filter(|text| text.contains("p_r")) {
            // -f(-d, -v, p_l, p_r) of the one above.
            *text = "-k_n_m2*d^2 + c_n_s_m2*v*(p_l + 0.3*p_r)".into();
        }
    }
    spec
}

/// A sweep of some seconds with a part that has a side.
fn input(amplitude: f64, hz: f64, samples: usize) -> Vec<f64> {
    let at = |i: usize| {
        let t = i as f64 * DT;
        amplitude * ((TAU * (hz + 0.15 * t) * t).sin() + 0.3 * (1.0 - (TAU * 0.4 * t).cos()))
    };
    (0..samples).map(at).collect()
}

/// Responses and what the instruments say of them.
fn run(spec: &ModelSpec, input: &[f64], sign: f64) -> Vec<(Response, Observation)> {
    let mut specimen = build(spec, DT).expect("builds");
    let mut observer = Observer::new(spec, DT).expect("builds");
    let mut step = |a: &f64| {
        let response = specimen.step(sign * a);
        (response, observer.observe(&response))
    };
    input.iter().map(&mut step).collect()
}

/// How far two responses are from being mirror images: lengths relative to a millimetre, accelerations to
/// 0.1 m/s2, forces to 100 N.
fn unlike(one: &(Response, Observation), two: &(Response, Observation)) -> f64 {
    let ((r, seen), (l, mirror)) = (one, two);
    let motion = [
        (r.relative_displacement_m, l.relative_displacement_m, 1e-3),
        (r.relative_velocity_m_s, l.relative_velocity_m_s, 1e-2),
        (seen.relative_displacement_m, mirror.relative_displacement_m, 1e-3),
        (seen.mass_acceleration_1_m_s2, mirror.mass_acceleration_1_m_s2, 0.1),
        (seen.mass_acceleration_2_m_s2, mirror.mass_acceleration_2_m_s2, 0.1),
        (r.right_contact_force_n, -l.left_contact_force_n, 100.0),
        (r.left_contact_force_n, -l.right_contact_force_n, 100.0),
    ];
    motion.into_iter().map(|(one, two, size)| (one + two).abs() / size).fold(0.0, f64::max)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 6, ..ProptestConfig::default() })]

    /// Every effect has mirror symmetry once its own sides are changed too, and those of the base model.
    #[test]
    fn every_effect_mirrors_with_its_sides(
        strength in 0.2_f64..1.0,
        gap in 0.01_f64..0.03,
        bumper in (1e4_f64..2e5, 50.0_f64..800.0),
        sides in (-2e-3_f64..2e-3, -30.0_f64..30.0),
        amplitude in 0.2_f64..0.6,
        hz in 0.5_f64..1.5,
    ) {
        let input = input(amplitude, hz, 2500);
        for added in every(strength) {
            let mut spec = b1_g2();
            spec.bumper = Some(BumperSpec { stiffness_n_m: bumper.0, damping_n_s_m: bumper.1, total_gap_m: gap });
            for (name, key, value) in [("gap-asymmetry", "s_m", sides.0), ("constant-force", "f_n", sides.1)] {
                if added.name != name {
                    spec.effects.push(effect(name, &[(key, value)]));
                }
            }
            let name = added.name.clone();
            spec.effects.push(added);
            let (one, two) = (run(&spec, &input, 1.0), run(&mirrored(&spec), &input, -1.0));
            let worst = one.iter().zip(&two).map(|(one, two)| unlike(one, two)).fold(0.0, f64::max);
            prop_assert!(worst < 1e-6, "{name}: {worst}");
        }
    }

    /// Forces that depend on the place alone, and masses, let a motion run backwards when its velocity and its
    /// input do.
    #[test]
    fn conservative_effects_run_backwards(
        strength in 0.2_f64..1.0,
        gap in 0.006_f64..0.03,
        bumper in 1e4_f64..2e5,
        amplitude in 0.2_f64..0.6,
        hz in 0.5_f64..1.5,
    ) {
        let input = input(amplitude, hz, 1200);
        let reversible = every(strength).into_iter().filter(|effect| irreversible(effect).is_none());
        for added in reversible {
            let name = added.name.clone();
            let (apart, _) = there_and_back(&lossless(added, gap, bumper), &input);
            prop_assert!(apart < 1e-6, "{name}: {apart}");
        }
    }

    /// Losses, memory and clocks do not.
    #[test]
    fn effects_that_lose_or_remember_do_not(strength in 0.5_f64..1.0, amplitude in 0.4_f64..0.6) {
        let input = input(amplitude, 0.9, 1200);
        for added in every(strength).into_iter().filter(|effect| irreversible(effect).is_some()) {
            let name = added.name.clone();
            let (apart, moved) = there_and_back(&lossless(added, 0.016, 33e3), &input);
            prop_assert!(moved > 1.0 && apart > 1e-3, "{name}: {apart} of {moved}");
        }
    }
}

/// Why an effect has no time reversal, where it has none.
fn irreversible(effect: &EffectSpec) -> Option<&'static str> {
    Some(match effect.name.as_str() {
        "coulomb-friction" | "stribeck-friction" | "quadratic-damping" | "hunt-crossley-damping" => {
            "loses work"
        }
        "bouc-wen-hysteresis" | "iwan-hysteresis" => "remembers where the motion turned",
        "maxwell-branch" | "fractional-damping" => "relaxes",
        "stiffness-degradation" => "ages",
        "expression" => "odd in the velocity, as written here",
        _ => return None,
    })
}

#[test]
fn every_effect_is_either_reversible_or_known_not_to_be() {
    let known = every(0.5);
    for entry in CATALOGUE {
        assert!(known.iter().any(|effect| effect.name == entry.name), "{}", entry.name);
    }
}

/// The base model without losses, with an effect that has none either where it can be had so.
fn lossless(mut added: EffectSpec, gap: f64, bumper: f64) -> ModelSpec {
    let mut spec = b1_g2();
    spec.isolator.damping_n_s_m = 0.0;
    spec.bumper = Some(BumperSpec { stiffness_n_m: bumper, damping_n_s_m: 0.0, total_gap_m: gap });
    if added.name == "stand-compliance" {
        added.parameters.insert("zeta".into(), 0.0);
    }
    spec.effects.push(added);
    spec
}

/// How far from its rest (in the sizes of [`unlike`]) a specimen ends that went there and back, and how far from
/// it that it was.
fn there_and_back(spec: &ModelSpec, input: &[f64]) -> (f64, f64) {
    let options = Options { tolerance: 1e-12 };
    let size = |response: &Response, rest: &Response| {
        let d = response.relative_displacement_m - rest.relative_displacement_m;
        (d.abs() / 1e-3).max(response.relative_velocity_m_s.abs() / 1e-2)
    };
    let back = input[..input.len() - 1].iter().rev();
    if spec.effects.iter().any(|effect| effect.name == "stand-compliance") {
        // Its stands move too: the whole state turns, by hand.
        let system = System::compile(spec, DT).expect("compiles");
        let mut specimen = General::<6>::new(system, &options);
        let rest = specimen.step(0.0);
        let moved = input.iter().map(|a| size(&specimen.step(*a), &rest)).fold(0.0, f64::max);
        let [d, v, right, right_rate, left, left_rate] = *specimen.state();
        specimen.set_state([d, -v, right, -right_rate, left, -left_rate]);
        specimen.prime(input[input.len() - 1]);
        let end = back.map(|a| specimen.step(*a)).last().expect("samples");
        return (size(&end, &rest), moved);
    }
    let mut specimen = build_with(spec, DT, &options).expect("builds");
    let rest = specimen.step(0.0);
    let (mut moved, mut end) = (0.0_f64, rest);
    for a in input {
        end = specimen.step(*a);
        moved = moved.max(size(&end, &rest));
    }
    let mut again = build_with(spec, DT, &options).expect("builds");
    again.impose(end.relative_displacement_m, -end.relative_velocity_m_s);
    again.prime(input[input.len() - 1]);
    let end = back.map(|a| again.step(*a)).last().expect("samples");
    (size(&end, &rest), moved)
}

/// What remembers its reversals starts from where the constant force has pushed it, whichever side that is.
#[test]
fn a_start_under_a_constant_force_mirrors_exactly() {
    let input = input(0.441116, 1.3728621, 400);
    let mut spec = b1_g2();
    spec.effects.push(effect("gap-asymmetry", &[("s_m", 1.7e-3)]));
    spec.effects.push(effect("constant-force", &[("f_n", -30.0)]));
    spec.effects.extend(every(1.0).into_iter().filter(|added| added.name == "iwan-hysteresis"));
    let (one, two) = (run(&spec, &input, 1.0), run(&mirrored(&spec), &input, -1.0));
    let worst = one.iter().zip(&two).map(|(one, two)| unlike(one, two)).fold(0.0, f64::max);
    assert!(worst < 1e-12, "{worst}");
}
