//! The diagnosis on components of other rigs: a displacement imposed, a force measured.

use hil_tests::imposed::{
    DASHPOT, FREE_DASHPOT, Rig, SPRING, friction, growing, hysteresis, hysteresis_between_rests, joint,
    nominal, orifice, pressed_and_held, rested, stepped,
};
use shaketable::compare::compare;
use shaketable::diagnose::adding::add;
use shaketable::diagnose::report::NamedEffect;
use shaketable::diagnose::{Diagnosis, Options, Verdict, diagnose};
use shaketable::model::{EffectSpec, IsolatorUncertainty, ModelSpec, Uncertainty};
use shaketable::record::Record;

/// What is found where one effect is missing.
fn found(record: &Record, rig: Rig, name: &str) -> Diagnosis {
    found_with(record, &nominal(rig), name)
}

fn found_with(record: &Record, nominal: &ModelSpec, name: &str) -> Diagnosis {
    let found = diagnose(record, nominal, &Options::default()).expect("a sound record");
    let named = hil_tests::named(&found);
    assert_eq!((found.verdict, named), (Verdict::Missing, vec![name]), "{:?}", found.refused);
    found
}

/// Numbers of an effect are within a share of the truth.
fn are_told<const N: usize>(effect: &NamedEffect, numbers: [(&str, f64); N], within: f64) {
    for (name, truth) in numbers {
        let told = &effect.parameters[name];
        assert!((told.value / truth - 1.0).abs() < within, "{name}: {told:?}");
    }
}

fn is_at_the_floor(found: &Diagnosis) {
    assert!(found.error_after < 1.2 * found.noise_floor, "{} {}", found.error_after, found.noise_floor);
}

/// A hysteresis is named alone, its numbers within a share of the truth.
fn shape_is_told(shape: [(&str, f64); 4], seed: u64, within: f64) {
    let found =
        found(&hysteresis(SPRING, shape.map(|(_, value)| value), seed), SPRING, "bouc-wen-hysteresis");
    are_told(&found.effects[0], shape, within);
    is_at_the_floor(&found);
}

#[test]
fn the_shape_of_a_hysteresis_is_told_and_nothing_makes_up_for_it() {
    shape_is_told([("kh_n_m", 2e5), ("dy_m", 1.4e-3), ("n", 1.3), ("gamma", 0.35)], 1, 0.02);
}

#[test]
fn a_bilinear_bearing_is_told_as_sharp_as_it_is() {
    // Its corners were rounded to n = 5, and the other numbers went with them.
    shape_is_told([("kh_n_m", 2e5), ("dy_m", 1.4e-3), ("n", 15.0), ("gamma", 0.5)], 15, 0.03);
}

#[test]
fn the_shape_of_a_hysteresis_is_told_beside_a_force_that_hid_it() {
    // It was fitted without the offset, and left as it was.
    let shape = [("kh_n_m", 2e5), ("dy_m", 1.4e-3), ("n", 2.0), ("gamma", 0.5)];
    let mut record = hysteresis(SPRING, shape.map(|(_, value)| value), 12);
    let rms = (record.force_n.iter().map(|f| f * f).sum::<f64>() / record.force_n.len() as f64).sqrt();
    record.force_n.iter_mut().for_each(|f| *f += 0.5 * rms);
    let found = diagnose(&record, &nominal(SPRING), &Options::default()).expect("a sound record");
    let mut named = hil_tests::named(&found);
    named.sort_unstable();
    assert_eq!(named, ["bouc-wen-hysteresis", "constant-force"], "{:?}", found.refused);
    let hysteresis = found.effects.iter().find(|effect| effect.name == "bouc-wen-hysteresis").expect("named");
    are_told(hysteresis, shape, 0.02);
    is_at_the_floor(&found);
}

/// A rig as someone guesses it who knows nothing of it.
fn guessed(rig: Rig) -> ModelSpec {
    let isolator = IsolatorUncertainty {
        stiffness_n_m: vec![1.0],
        damping_n_s_m: Some(1.0),
        ..IsolatorUncertainty::default()
    };
    let uncertainty = Uncertainty { isolator: Some(isolator), ..Uncertainty::default() };
    ModelSpec { uncertainty: Some(uncertainty), ..nominal(rig) }
}

#[test]
fn a_guess_of_half_of_what_is_there_is_no_missing_effect() {
    // A number could not become more than 1.95 times what was given, and effects stood in for the rest.
    let mut guess = guessed(SPRING);
    guess.isolator.stiffness_n_m[0] *= 0.4;
    guess.isolator.damping_n_s_m *= 0.3;
    let record = friction(SPRING, 0.0, 13);
    let found = diagnose(&record, &guess, &Options::default()).expect("a sound record");
    assert_eq!(found.verdict, Verdict::Adequate, "{:?} {:?}", found.effects, found.refused);
    for (key, truth) in [
        ("isolator.stiffness_n_m[0]", SPRING.stiffness_n_m),
        ("isolator.damping_n_s_m", SPRING.damping_n_s_m),
    ] {
        let told = found.reidentified.iter().find(|number| number.key == key).expect("identified");
        assert!((told.value / truth - 1.0).abs() < 0.01, "{key}: {told:?}");
    }
}

/// A damper whose force is a power of its velocity, which the catalogue has not.
fn fluid_damper() -> Record {
    let mut record = orifice(DASHPOT, [2000.0, 0.35], 14);
    for channel in [&mut record.time_s, &mut record.displacement_m, &mut record.force_n] {
        channel.truncate(5000);
    }
    record
}

#[test]
fn a_fluid_damper_is_outside_the_catalogue_and_drafted() {
    // Coulomb's friction with a springpot came near.
    let found = diagnose(&fluid_damper(), &nominal(DASHPOT), &Options::default()).expect("a sound record");
    assert_eq!(found.verdict, Verdict::OutsideCatalogue, "{:?}", found.effects);
    let draft = found.missing_force.as_ref().and_then(|force| force.expression.as_ref()).expect("a draft");
    assert!((draft.parameters["p"] - 0.35).abs() < 0.02, "{draft:?}");
    // About rest the force is steep: what the velocity's noise makes of it is in no floor.
    assert!(draft.explains > 0.99 && found.error_after < 0.02 * found.error_reidentified, "{}", found.text());
    assert!(found.text().contains("p = 0.3"), "{}", found.text());
}

#[test]
fn a_dashpot_that_is_none_is_told_so_beside_a_damper_whatever_was_guessed() {
    // It ended at a twentieth of the guess, and the power of the law made up for that.
    let of = |damping_n_s_m: f64| Rig { damping_n_s_m, ..SPRING };
    let damper = orifice(of(0.0), [2000.0, 0.5], 16);
    let found = diagnose(&damper, &guessed(of(3000.0)), &Options::default()).expect("a sound record");
    assert_eq!(found.verdict, Verdict::OutsideCatalogue, "{:?}", found.effects);
    let draft = found.missing_force.as_ref().and_then(|force| force.expression.as_ref()).expect("a draft");
    assert!((draft.parameters["p"] - 0.5).abs() < 0.01, "{draft:?}");
    let told = found.reidentified.iter().find(|number| number.key == "isolator.damping_n_s_m");
    assert!(told.is_some_and(|dashpot| dashpot.low95 <= 0.0 && dashpot.value < 0.02 * 3000.0), "{told:?}");
}

#[test]
fn what_is_named_and_leaves_more_than_noise_says_so() {
    // Beside a hysteresis the same force has no name of its own; what comes near stood there as if it were all.
    let (mut record, mut yielded_m) = (fluid_damper(), 0.0_f64);
    for i in 1..record.force_n.len() {
        let moved_m = record.displacement_m[i] - record.displacement_m[i - 1];
        let loads = 0.5 * (moved_m * yielded_m).signum() + 0.5;
        yielded_m += moved_m * (1.0 - loads * (yielded_m / 4e-3).abs());
        record.force_n[i] += 1.5e5 * yielded_m;
    }
    let found = diagnose(&record, &nominal(DASHPOT), &Options::default()).expect("a sound record");
    assert_eq!(found.verdict, Verdict::Missing, "{:?}", found.refused);
    let left = found.left.as_ref().expect("more than noise");
    assert!((left.times_noise / (found.error_after / found.noise_floor) - 1.0).abs() < 1e-9, "{left:?}");
    assert!(left.times_noise > 1.2 && found.text().contains("Not all of it"), "{}", found.text());
    // What was refused beside one that is named says nothing against it.
    assert!(found.effects.iter().all(|effect| effect.probability > 0.3), "{:?}", found.effects);
}

#[test]
fn play_is_told_alone() {
    // Where the joint opens and closes falls between samples; a second effect made up for that.
    for (play_m, seed) in [(2.5e-3, 122), (1.3e-3, 57)] {
        let found = found(&joint(SPRING, play_m, seed), SPRING, "backlash");
        let play = &found.effects[0].parameters["b_m"];
        assert!((play.value - play_m).abs() < 5e-6, "{play:?}");
        is_at_the_floor(&found);
        assert_eq!(found.left, None);
    }
}

#[test]
fn what_would_hang_on_a_component_is_no_matter() {
    // Force over another mass than 1 kg was laid against the force itself.
    let shape = [("kh_n_m", 2e5), ("dy_m", 1.4e-3), ("n", 1.3), ("gamma", 0.35)];
    let record = hysteresis(SPRING, shape.map(|(_, value)| value), 4);
    let heavy = ModelSpec { mass_kg: 750.0, ..nominal(SPRING) };
    let [light, heavy] =
        [nominal(SPRING), heavy].map(|nominal| found_with(&record, &nominal, "bouc-wen-hysteresis"));
    for (name, light) in &light.effects[0].parameters {
        let told = &heavy.effects[0].parameters[name];
        assert!((told.value / light.value - 1.0).abs() < 1e-3, "{name}: {told:?}, {light:?}");
    }
    assert!((heavy.error_after / light.error_after - 1.0).abs() < 1e-3);
}

#[test]
fn what_a_dashpot_makes_of_the_noise_of_its_displacement_is_noise() {
    // Second and third effects made up for it, and the floor was told without it.
    let shape = [("kh_n_m", 4e4), ("dy_m", 1.4e-3), ("n", 1.2), ("gamma", 0.4)];
    for seed in 1..4 {
        let record = hysteresis(DASHPOT, shape.map(|(_, value)| value), seed);
        let found = found(&record, DASHPOT, "bouc-wen-hysteresis");
        are_told(&found.effects[0], shape, 0.1);
        assert!((0.8..1.2).contains(&(found.error_after / found.noise_floor)), "{found:?}");
    }
}

#[test]
fn a_motion_of_one_frequency_that_grows_shows_no_memory() {
    // A low-pass close above that frequency, or noise that it let through, was made up for by a Maxwell branch or a springpot in 9 of 12.
    let rigs = [(2e4, 400.0, 1.7, 20.0, 1.5e-3), (8e5, 3e4, 1.2, 12.0, 9e-3), (8e4, 3e3, 0.6, 30.0, 5e-3)];
    for ((stiffness_n_m, damping_n_s_m, hz, cycles, amplitude_m), seed) in rigs.into_iter().zip(1..) {
        let rig =
            Rig { stiffness_n_m, damping_n_s_m, displacement_noise_m: 1.5e-3 * amplitude_m, force_late: 0 };
        let record = growing(rig, hz, cycles, amplitude_m, seed);
        let found = diagnose(&record, &nominal(rig), &Options::default()).expect("a sound record");
        assert_eq!(found.verdict, Verdict::Adequate, "{:?} {:?}", found.effects, found.refused);
        for (key, truth) in
            [("isolator.stiffness_n_m[0]", stiffness_n_m), ("isolator.damping_n_s_m", damping_n_s_m)]
        {
            let told = found.reidentified.iter().find(|number| number.key == key).expect("identified");
            assert!((told.value - truth).abs() < told.high95 - told.low95, "{key}: {told:?}");
        }
    }
}

#[test]
fn a_force_that_comes_late_is_put_on_time() {
    // Half a sample was made up for by a Maxwell branch and a quadratic damping.
    let late = Rig { force_late: 16, ..SPRING };
    let is_said = |found: &Diagnosis| {
        let note = found.notes.iter().find(|note| note.starts_with("the force comes"));
        let us = note.and_then(|note| note.split(' ').nth(3)?.parse::<f64>().ok());
        us.is_some_and(|us| (us - 2000.0).abs() < 100.0)
    };
    let shape = [("kh_n_m", 2e5), ("dy_m", 1.4e-3), ("n", 1.3), ("gamma", 0.35)];
    let record = hysteresis(late, shape.map(|(_, value)| value), 11);
    let found = found(&record, late, "bouc-wen-hysteresis");
    assert!(is_said(&found), "{:?}", found.notes);
    are_told(&found.effects[0], shape, 0.02);
    is_at_the_floor(&found);
    // What is added to a model is fitted so, too.
    let start = [("kh_n_m", 5e4), ("dy_m", 3e-3)].map(|(name, value)| (name.to_owned(), value));
    let given = EffectSpec { name: "bouc-wen-hysteresis".into(), expression: None, parameters: start.into() };
    let added = add(&record, &nominal(late), &given, &[]).expect("fits");
    let after = added.error_after.expect("known");
    assert!((after / found.error_after - 1.0).abs() < 0.01, "{after} {}", found.error_after);
    let comes_late = |note: &String| note.starts_with("the force comes") && note.contains("later");
    assert!(added.notes.iter().any(comes_late), "{:?}", added.notes);
    // With the right model a comparison says so.
    let compared = compare(&record, &added.model).expect("a sound record");
    assert!(compared.notes.iter().any(comes_late), "{:?}", compared.notes);
}

#[test]
fn a_velocity_that_jumps_from_step_to_step_is_no_memory() {
    // Corners of the displacement were taken for a band as wide as theirs: all of its noise came out in the velocity.
    let rig = Rig { stiffness_n_m: 2e5, damping_n_s_m: 1.5e4, displacement_noise_m: 1.5e-6, force_late: 0 };
    let hz = [0.9, 1.3, 0.6, 1.7];
    let healthy = diagnose(&stepped(rig, 0.0, hz, 3e-3, 1), &nominal(rig), &Options::default());
    let healthy = healthy.expect("a sound record");
    assert_eq!(healthy.verdict, Verdict::Adequate, "{:?} {:?}", healthy.effects, healthy.refused);
    let found = found(&stepped(rig, 3e9, hz, 3e-3, 2), rig, "cubic-stiffness");
    let told = &found.effects[0].parameters["k3_n_m3"];
    assert!((told.value / 3e9 - 1.0).abs() < 0.01, "{told:?}");
    is_at_the_floor(&found);
}

#[test]
fn friction_that_holds_through_rests_is_no_hysteresis() {
    // What noise makes of the velocity at rest turned it, and so did what rings about a sudden start.
    let rig = Rig { displacement_noise_m: 1e-5, ..SPRING };
    for (rest_s, seed) in [(3.0, 21), (30.0, 22)] {
        let found = found(&rested(rig, 600.0, rest_s, seed), rig, "coulomb-friction");
        let fc = &found.effects[0].parameters["fc_n"];
        assert!((fc.value - 600.0).abs() < 6.0, "{fc:?}");
        is_at_the_floor(&found);
    }
}

#[test]
fn a_hysteresis_between_rests_is_told_alone() {
    // Noise about a place that is held turned it to and fro until it had forgotten its force.
    let rig = Rig { displacement_noise_m: 1e-5, ..SPRING };
    let found =
        found(&hysteresis_between_rests(rig, [2e5, 1.4e-3, 1.0, 0.5], 24), rig, "bouc-wen-hysteresis");
    are_told(&found.effects[0], [("kh_n_m", 2e5), ("dy_m", 1.4e-3)], 0.03);
    is_at_the_floor(&found);
}

#[test]
fn what_relaxes_while_it_is_held_is_told_to_a_hundredth() {
    // Holds did not count, and a record without three cycles was none.
    let rig = Rig { displacement_noise_m: 1e-5, ..SPRING };
    let found = found(&pressed_and_held(rig, [8e4, 2.0], 25), rig, "maxwell-branch");
    are_told(&found.effects[0], [("km_n_m", 8e4), ("tau_s", 2.0)], 0.01);
    is_at_the_floor(&found);
}

#[test]
fn the_noise_of_what_is_imposed_wears_no_hysteresis() {
    // `compare` followed it from sample to sample: 7.5 % of the force. What is left of it pulls at the springs.
    let rig = Rig { displacement_noise_m: 2e-5, ..SPRING };
    let shape = [("kh_n_m", 4e5), ("dy_m", 1e-3), ("n", 1.3), ("gamma", 0.35)];
    let record = hysteresis(rig, shape.map(|(_, value)| value), 23);
    let mut model = nominal(rig);
    model.isolator.stiffness_n_m[0] = rig.stiffness_n_m;
    model.isolator.damping_n_s_m = rig.damping_n_s_m;
    let parameters = shape.map(|(name, value)| (name.to_owned(), value)).into();
    model.effects.push(EffectSpec { name: "bouc-wen-hysteresis".into(), expression: None, parameters });
    let error = compare(&record, &model).expect("comparable").error;
    let (told, floor) = (error.nrmse_force.expect("a force"), error.noise_floor_a.expect("a force"));
    assert!(told < 2.0 * floor, "{told} {floor}");
}

#[test]
fn a_force_that_drifts_is_no_physics() {
    // A drift of 5 % sent it outside the catalogue.
    let shape = [("kh_n_m", 2e5), ("dy_m", 1.4e-3), ("n", 1.3), ("gamma", 0.35)];
    let mut record = hysteresis(SPRING, shape.map(|(_, value)| value), 6);
    let count = record.force_n.len() as f64;
    let rms = (record.force_n.iter().map(|f| f * f).sum::<f64>() / count).sqrt();
    record.force_n.iter_mut().enumerate().for_each(|(i, f)| *f += 0.05 * rms * i as f64 / count);
    let found = found(&record, SPRING, "bouc-wen-hysteresis");
    is_at_the_floor(&found);
    assert!(found.notes.iter().any(|note| note.starts_with("the force drifts by")), "{:?}", found.notes);
}

#[test]
fn a_dashpot_that_nothing_holds_back_is_fitted() {
    // It was left as it was given, and a Maxwell branch or a springpot was named in place of what it was off.
    let healthy = friction(FREE_DASHPOT, 0.0, 7);
    let adequate = diagnose(&healthy, &nominal(FREE_DASHPOT), &Options::default()).expect("a sound record");
    assert_eq!(adequate.verdict, Verdict::Adequate, "{:?}", adequate.effects);
    let found = found(&friction(FREE_DASHPOT, 20.0, 8), FREE_DASHPOT, "coulomb-friction");
    for number in adequate.reidentified.iter().chain(&found.reidentified) {
        assert_eq!(number.key, "isolator.damping_n_s_m");
        assert!((number.value / FREE_DASHPOT.damping_n_s_m - 1.0).abs() < 2e-3, "{number:?}");
    }
    let told = &found.effects[0].parameters["fc_n"];
    assert!(told.low95 < 20.0 && told.high95 > 20.0 && told.low95 > 18.0, "{told:?}");
}

#[test]
fn what_is_added_explains_as_much_as_was_promised_and_knows_no_less() {
    // The shape was left out when it was added; and how strong it is was told as if the rest of it were known.
    let shape = [("kh_n_m", 2e5), ("dy_m", 1.4e-3), ("n", 1.6), ("gamma", 0.2)];
    let record = hysteresis(SPRING, shape.map(|(_, value)| value), 9);
    let found = found(&record, SPRING, "bouc-wen-hysteresis");
    let start = [("kh_n_m", 5e4), ("dy_m", 3e-3)].map(|(name, value)| (name.to_owned(), value));
    let given = EffectSpec { name: "bouc-wen-hysteresis".into(), expression: None, parameters: start.into() };
    let added = add(&record, &nominal(SPRING), &given, &[]).expect("fits");
    let after = added.error_after.expect("known");
    assert!((after / found.error_after - 1.0).abs() < 0.01, "{after} {}", found.error_after);
    for (name, told) in &found.effects[0].parameters {
        let key = format!("effect[0].{name}");
        let number = added.parameters.iter().find(|number| number.key == key).expect("fitted");
        let times = (number.high95 - number.low95) / (told.high95 - told.low95);
        assert!((0.8..1.25).contains(&times), "{name}: {number:?} {told:?}");
    }
    // In the model, it is nothing that went astray.
    let again = diagnose(&record, &added.model, &Options::default()).expect("a sound record");
    assert!(again.notes.iter().all(|note| !note.contains("effect[0]")), "{:?}", again.notes);
}
