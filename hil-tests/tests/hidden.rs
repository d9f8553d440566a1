//! The diagnosis on records with a hidden effect; a small part of the study that the book reports.

use hil_tests::hidden::{self, Recipe, Sensors, Shaking};
use shaketable::compare::compare;
use shaketable::diagnose::live::evidence;
use shaketable::diagnose::next_test::SweepProposal;
use shaketable::diagnose::report::StepErrors;
use shaketable::diagnose::{Diagnosis, Options, Verdict, diagnose, diagnose_together};
use shaketable::model::{EffectSpec, ModelSpec};
use shaketable::record::Record;
use shaketable::record::data::ReadOptions;
use std::path::Path;

/// The diagnosis of what a recipe makes.
fn diagnosed(recipe: &Recipe) -> Diagnosis {
    let case = hidden::make(recipe).expect("the effect reaches its size");
    diagnose(&case.record, &case.nominal, &Options::default()).expect("a sound record")
}

/// The diagnosis of an ordinary specimen's sweep.
fn case(seed: u64, effects: &[&'static str], size: f64) -> Diagnosis {
    diagnosed(&Recipe::of(seed, effects, size))
}

/// The diagnosis of a case with a force at 12 % that the catalogue does not hold.
fn foreign(seed: u64, which: usize) -> Diagnosis {
    diagnosed(&Recipe { foreign: Some(which), ..Recipe::of(seed, &[], 0.12) })
}

#[test]
fn a_missing_effect_is_named_and_the_held_out_error_falls() {
    for (seed, name) in [(5_000_004, "bouc-wen-hysteresis"), (5_000_002, "quadratic-damping")] {
        let found = case(seed, &[name], 0.12);
        assert_eq!(found.verdict, Verdict::Missing, "{name}: {:?} {:?}", found.effects, found.refused);
        assert_eq!(found.effects[0].name, name);
        // Re-fitting hides part of it; of what it leaves above the noise, the effect takes most.
        let above = |error: f64| error.powi(2) - found.noise_floor.powi(2);
        assert!(above(found.error_after) < 0.5 * above(found.error_reidentified), "{name}");
        assert!(found.error_after < 1.25 * found.noise_floor, "{name}");
        assert!(!found.effects[0].parameters.is_empty() && !found.refused.is_empty());
        // So it is in every step, whatever the noise is over its motion there.
        let floors = found.steps.iter().map(|step| step.noise_floor);
        assert!(floors.clone().fold(0.0, f64::max) > 5.0 * floors.fold(f64::INFINITY, f64::min), "{name}");
        let over = |step: &StepErrors| step.after / step.noise_floor;
        assert!(
            found.steps.iter().all(|step| (0.9..1.25).contains(&over(step))),
            "{name}: {:?}",
            found.steps
        );
    }
}

#[test]
#[ignore = "minutes: `./test blind`"]
fn a_hysteresis_of_another_sharpness_than_it_is_first_taken_for_is_named_alone() {
    // Iwan's was far enough ahead of one with the usual sharpness that no other was tried, and the pair of both named.
    sharpness_is_told(10_080_008, 1.613);
}

#[test]
#[ignore = "minutes: `./test blind`"]
fn a_hysteresis_of_a_sharpness_that_is_far_from_the_usual_one_is_named_alone() {
    // It was not reached from the usual one, and Iwan's named.
    sharpness_is_told(10_086_014, 1.993);
}

fn sharpness_is_told(seed: u64, sharpness: f64) {
    let found = case(seed, &["bouc-wen-hysteresis"], 0.05);
    let named = hil_tests::named(&found);
    assert_eq!((found.verdict, named), (Verdict::Missing, vec!["bouc-wen-hysteresis"]), "seed {seed}");
    let n = &found.effects[0].parameters["n"];
    assert!(n.low95 < sharpness && sharpness < n.high95, "{n:?}");
    // It has no unit, the stiffness beside it has.
    let text = found.text();
    let line = |name: &str| text.lines().find(|line| line.trim_start().starts_with(name)).expect("told");
    assert!(!line("n = ").contains(" 1 (") && line("kh_n_m = ").contains(" N/m (95 %"), "{text}");
}

#[test]
fn what_others_hide_is_tried() {
    // To first order, four hysteretic and damping effects do better than a friction of less than a tenth of a newton; three of those come
    // within 6 nats once their fits arrive, and are told apart by the steps that the search has no room for.
    are_named(&[(10_091_004, "coulomb-friction", 0.05, Verdict::Missing)]);
}

#[test]
#[ignore = "minutes: `./test blind`"]
fn what_hides_otherwise_is_tried() {
    // A yaw shows between the accelerometers at a frequency that their mean has nothing of; a stand under soft bumpers rings at 8 Hz; a knee
    // that went to 5 mm, although 8 are given, hides that the isolator softens. A cubic stiffness brings 13 nats on the steps of the fit, and
    // noise takes half a one on those held out. A preload brings 80 nats, of which noise takes three on the held-out steps. A damping that
    // grows with penetration brings 24, of which first order saw one: a bumper's own makes up for all but a thousandth of what it changes.
    are_named(&[
        (10_097_309, "bumper-preload", 0.02, Verdict::Missing),
        (10_112_509, "hunt-crossley-damping", 0.05, Verdict::Missing),
        (10_086_093, "yaw-rotation", 0.05, Verdict::Missing),
        (10_097_509, "stand-compliance", 0.05, Verdict::Missing),
        (10_099_037, "cubic-stiffness", 0.05, Verdict::Missing),
        (10_112_501, "cubic-stiffness", 0.05, Verdict::Missing),
    ]);
}

/// Each of such a seed, with one effect of such a size, gets the verdict and that name.
fn are_named(cases: &[(u64, &'static str, f64, Verdict)]) {
    for &(seed, name, size, verdict) in cases {
        let found = case(seed, &[name], size);
        let named = hil_tests::named(&found);
        assert_eq!((found.verdict, named), (verdict, vec![name]), "seed {seed}");
    }
}

#[test]
fn spikes_and_hum_are_no_physics() {
    let case = hidden::make(&Recipe::of(5_000_101, &[], 0.0)).expect("a record");
    let mut record = case.record.clone();
    let samples = record.relative_displacement_m.len();
    record.relative_displacement_m[samples / 3] += 0.02;
    let omega = std::f64::consts::TAU * 50.01 / record.sample_rate_hz;
    let hum = |i: usize| 0.05 * (omega * i as f64).sin();
    record.mass_acceleration_1_m_s2.iter_mut().enumerate().for_each(|(i, a)| *a += hum(i));
    let found = diagnose(&record, &case.nominal, &Options::default()).expect("a sound record");
    assert_eq!(found.verdict, Verdict::Adequate, "{:?}", found.effects);
    assert!(found.error_after < 1.05 * found.noise_floor, "{} {}", found.error_after, found.noise_floor);
    for said in ["relative_displacement_m: 1 spike", "mass_acceleration_1_m_s2: hum of the mains at 50.01 Hz"]
    {
        assert!(found.notes.iter().any(|note| note.starts_with(said)), "{said}: {:?}", found.notes);
    }
}

#[test]
fn parameters_that_are_merely_off_are_no_missing_effect() {
    for seed in [5_000_101, 5_000_102] {
        let found = case(seed, &[], 0.0);
        assert_eq!(found.verdict, Verdict::Adequate, "seed {seed}: {:?}", found.effects);
        assert!(found.effects.is_empty());
        assert!(found.error_reidentified < found.error_before);
    }
}

#[test]
fn a_late_laser_is_an_instrument_and_no_physics() {
    let found = case(5_000_018, &["laser-delay"], 0.05);
    assert_eq!(found.effects.first().map(|e| e.name.as_str()), Some("laser-delay"), "{:?}", found.effects);
}

#[test]
fn a_yaw_leaves_nothing_in_the_mean_and_hides_no_gain() {
    // Divided by gains that the mode had posed as, the accelerometers had kept some of it in their mean: a stand that is not there.
    beside_a_yaw(1.02, &["accelerometer-gain", "yaw-rotation"]);
}

#[test]
#[ignore = "minutes: `./test blind`"]
fn a_yaw_alone_leaves_nothing_in_the_mean() {
    beside_a_yaw(1.0, &["yaw-rotation"]);
}

/// What is named on the record of a mass that yaws, its first accelerometer of such a gain.
fn beside_a_yaw(gain: f64, expected: &[&str]) {
    let mut case = hidden::make(&Recipe::of(10_108_401, &["yaw-rotation"], 0.12)).expect("a record");
    case.record.mass_acceleration_1_m_s2.iter_mut().for_each(|a| *a *= gain);
    let found = diagnose(&case.record, &case.nominal, &Options::default()).expect("a sound record");
    let mut named = hil_tests::named(&found);
    named.sort_unstable();
    assert_eq!((found.verdict, named.as_slice()), (Verdict::Missing, expected));
}

#[test]
fn records_of_two_gaps_are_diagnosed_together() {
    let first = hidden::make(&Recipe::of(5_000_302, &["hunt-crossley-damping"], 0.08))
        .expect("the effect reaches its size");
    let second = hidden::again(&first, 0.004, 5_000_303).expect("a response");
    let tests = [(&first.record, &first.nominal), (&second.record, &second.nominal)];
    let found = diagnose_together(&tests, &Options::default()).expect("records that belong together");
    assert_eq!(found.verdict, Verdict::Missing, "{:?} {:?}", found.effects, found.refused);
    assert_eq!(found.effects[0].name, "hunt-crossley-damping");
    let steps = |record: &shaketable::record::Record| *record.step.iter().max().expect("steps") as usize + 1;
    assert_eq!(found.steps.len(), steps(&first.record) + steps(&second.record));
    // The hint that is given while a run goes on points the same way.
    let hint = evidence(&first.record, &first.nominal).expect("enough steps");
    assert_eq!(hint.candidates[0].name, "hunt-crossley-damping", "{hint:?}");
}

/// What a slow sweep was to part: the one step at resonance, held out, put a Bouc-Wen element ten nats before the Iwan element that is
/// there, whose numbers the other steps leave open.
#[test]
#[ignore = "minutes: `./test blind`"]
fn which_of_two_it_is_is_told_by_all_steps() {
    let first = hidden::make(&Recipe::of(10_114_105, &["iwan-hysteresis"], 0.01)).expect("reaches its size");
    let test = SweepProposal {
        start_hz: 0.2996,
        stop_hz: 2.1751,
        step_hz: 0.23443,
        cycles: 10,
        acceleration_g: 0.03,
        without_bumpers: false,
        total_gap_m: None,
    };
    let second = hidden::tested(&first, &test, 10_114_105 ^ 0xadd).expect("a response");
    let tests = [(&first.record, &first.nominal), (&second.record, &second.nominal)];
    let found = diagnose_together(&tests, &Options::default()).expect("records that belong together");
    let all = || found.effects.iter().map(|e| e.name.clone()).chain(found.ambiguous_with.clone());
    assert!(all().any(|name| name == "iwan-hysteresis"), "{:?} {:?}", found.effects, found.refused);
}

/// What a fault changes of a record.
type Fault = fn(&mut Record);

#[test]
fn what_is_wrong_with_a_record_is_named_before_any_physics() {
    let case = hidden::make(&Recipe::of(5_000_401, &[], 0.05)).expect("nothing to reach");
    let faults: [(&str, Fault); 5] = [
        ("cycles of the input", |r| r.truncate(2000)),
        ("saturated", |r| r.mass_acceleration_1_m_s2.iter_mut().for_each(|a| *a = a.clamp(-0.3, 0.3))),
        ("is constant", |r| r.relative_displacement_m.fill(0.012)),
        ("wrong sign", |r| r.relative_displacement_m.iter_mut().for_each(|d| *d = -*d)),
        ("wrong unit", |r| r.relative_displacement_m.iter_mut().for_each(|d| *d *= 1000.0)),
    ];
    for (said, fault) in faults {
        let mut record = case.record.clone();
        fault(&mut record);
        let error = diagnose(&record, &case.nominal, &Options::default()).expect_err(said).to_string();
        assert!(error.contains("not fit") && error.contains(said), "{said}: {error}");
    }
}

#[test]
fn a_force_that_no_effect_explains_is_outside_the_catalogue() {
    // One that pushes on one side only.
    told_outside_as_a_surface(5_000_201, 1);
}

#[test]
#[ignore = "minutes: `./test blind`"]
fn a_force_that_many_effects_come_near_is_outside_the_catalogue() {
    // A ripple over the displacement.
    told_outside_as_a_surface(5_000_201, 0);
}

fn told_outside_as_a_surface(seed: u64, which: usize) {
    let found = foreign(seed, which);
    assert_eq!(found.verdict, Verdict::OutsideCatalogue, "{:?}", found.effects);
    let shape = found.missing_force.expect("a shape");
    assert!(shape.explained_by_surface > 0.5, "{}", shape.explained_by_surface);
}

#[test]
fn a_force_that_two_effects_make_up_for_is_outside_the_catalogue() {
    // A damping that grows with the root of velocity, of which a square and a friction make much.
    told_outside(10_113_390, 6);
}

#[test]
#[ignore = "minutes: `./test blind`"]
fn a_force_that_two_effects_nearly_make_up_for_is_outside_the_catalogue() {
    // A damping that grows with the cube of velocity. One shape does better than every pair, the one of a square and a friction among them
    // that takes a quarter of the velocities to turn round; in the second record by 9 nats. Of the third the base model is so far off that
    // first order takes another shape for it.
    [10_097_103, 10_112_307, 10_113_315].into_iter().for_each(|seed| told_outside(seed, 3));
}

fn told_outside(seed: u64, which: usize) {
    let found = foreign(seed, which);
    assert_eq!(found.verdict, Verdict::OutsideCatalogue, "{seed}: {:?}", found.effects);
}

#[test]
#[ignore = "minutes: `./test blind`"]
fn a_faint_damping_stands_before_a_hysteresis_that_does_nearly_as_well() {
    let found = case(10_097_320, &["quadratic-damping"], 0.02);
    let named = hil_tests::named(&found);
    assert!(matches!(found.verdict, Verdict::Missing | Verdict::Ambiguous), "{:?}", found.verdict);
    assert_eq!(named, ["quadratic-damping"]);
}

#[test]
fn a_record_driven_by_noise_is_judged_as_one_of_steps_is() {
    let of = |seed: u64, effects: &[&'static str]| {
        let recipe = Recipe { shaking: Shaking::Noise, ..Recipe::of(seed, effects, 0.05) };
        let case = hidden::make(&recipe).expect("the effect reaches its size");
        let mut record = case.record.clone();
        // Without a displacement of the table, as most records of earthquakes are.
        record.table_displacement_m.clear();
        let found = diagnose(&record, &case.nominal, &Options::default()).expect("a sound record");
        assert!(found.error_after < 1.05 * found.noise_floor, "{} {}", found.error_after, found.noise_floor);
        (found, case.truth)
    };
    let (healthy, _) = of(5_000_601, &[]);
    assert_eq!(healthy.verdict, Verdict::Adequate, "{:?}", healthy.effects);
    let (found, truth) = of(5_000_602, &["quadratic-damping"]);
    assert_eq!(
        found.effects.first().map(|e| e.name.as_str()),
        Some("quadratic-damping"),
        "{:?}",
        found.effects
    );
    let damping = &found.effects[0].parameters["c2_n_s2_m2"];
    let meant = truth.effects[0].parameters["c2_n_s2_m2"];
    assert!((damping.value - meant).abs() < 1.5 * (damping.high95 - damping.low95), "{damping:?} {meant}");
}

#[test]
fn one_sensor_of_the_mass_is_enough() {
    are_enough(&[Sensors::LaserAlone]);
}

#[test]
#[ignore = "minutes: `./test blind`"]
fn one_accelerometer_alone_or_with_the_laser_is_enough() {
    are_enough(&[Sensors::AccelerometerAlone, Sensors::OneAccelerometer]);
}

/// With such sensors a healthy record is adequate, and a missing effect is named.
fn are_enough(sensors: &[Sensors]) {
    for &sensors in sensors {
        for (seed, effects) in [(5_000_701, &[][..]), (5_000_702, &["cubic-stiffness"])] {
            let recipe = Recipe { sensors, ..Recipe::of(seed, effects, 0.08) };
            let found = diagnosed(&recipe);
            let named = hil_tests::named(&found);
            let verdict = if effects.is_empty() { Verdict::Adequate } else { Verdict::Missing };
            assert_eq!(
                (found.verdict, named.as_slice()),
                (verdict, effects),
                "{sensors:?}: {:?}",
                found.refused
            );
            let of_noise = found.error_after / found.noise_floor;
            assert!(of_noise < 1.03, "{sensors:?}: {of_noise} of the noise");
        }
    }
}

#[test]
fn a_knee_that_was_left_just_beyond_the_motion_is_found_within() {
    let found = case(9_200_005, &["stribeck-friction"], 0.05);
    let names = hil_tests::named(&found);
    assert_eq!(names, ["stribeck-friction"]);
    let knee = found.reidentified.iter().find(|r| r.key == "isolator.breakpoints_m[1]").expect("fitted");
    assert!((knee.value - 0.037926).abs() < 1e-4 && knee.nominal > knee.high95, "{knee:?}");
}

#[test]
fn a_gain_is_told_by_the_response_where_the_kinematics_leave_it_open() {
    let found = case(5_000_603, &["laser-gain"], 0.05);
    let gain = &found.effects.first().filter(|e| e.name == "laser-gain").expect("named").parameters["gain"];
    assert!(gain.high95 - gain.low95 < 2e-3, "{gain:?}");
    let meant = hidden::make(&Recipe::of(5_000_603, &["laser-gain"], 0.05)).expect("made").truth.effects[0]
        .parameters["gain"];
    assert!((gain.value - meant).abs() < gain.high95 - gain.low95, "{gain:?} {meant}");
}

#[test]
#[ignore = "minutes: `./test blind`"]
fn the_noise_of_a_scaled_accelerometer_is_scaled_with_it() {
    let found = case(9_610_016, &["accelerometer-gain"], 0.12);
    let names = hil_tests::named(&found);
    assert_eq!((found.verdict, names), (Verdict::Missing, vec!["accelerometer-gain"]));
    assert!(found.error_after < 1.02 * found.noise_floor, "{} {}", found.error_after, found.noise_floor);
}

/// A component with nothing promised of it, as the book has it.
const DAMPER: &str = r#"
name = "damper"
mass_kg = 1.0
[isolator]
stiffness_n_m = [1e5]
breakpoints_m = []
damping_n_s_m = 1e4
[uncertainty]
isolator.stiffness_n_m = [1.0]
isolator.damping_n_s_m = 1.0
"#;

#[test]
fn the_measured_damper_shows_memory_then_play() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/friction-damper-backlash");
    if !folder.is_dir() {
        eprintln!("measured files are not beside this checkout: nothing to diagnose");
        return;
    }
    let open = |name: &str| Record::open(&folder.join(name), &ReadOptions::default()).expect("read");
    let nominal: ModelSpec = toml::from_str(DAMPER).expect("a model");
    let found =
        diagnose(&open("0.5Hz36lb1in.parquet"), &nominal, &Options::default()).expect("a sound record");
    let named = hil_tests::named(&found);
    // Friction differs in its two directions, a constant force; play shows beside it.
    let expected = vec!["bouc-wen-hysteresis", "constant-force", "backlash"];
    assert_eq!((found.verdict, named), (Verdict::Missing, expected));
    assert!(found.error_after < 0.15, "{} after {}", found.error_after, found.error_reidentified);

    // Files that the model has not seen; at 2 Hz the band slips at half the force, which none of the others shows.
    let mut model = nominal;
    for number in &found.reidentified {
        model.set(&number.key, number.value).expect("a number of the model");
    }
    model.effects.extend(found.effects.iter().map(|effect| EffectSpec {
        name: effect.name.clone(),
        expression: None,
        parameters: effect.parameters.iter().map(|(name, of)| (name.clone(), of.value)).collect(),
    }));
    let unseen = [
        "0.25Hz36lb1.5in",
        "0.25Hz36lb1in",
        "0.5Hz36lb0.5in",
        "0.5Hz36lb1.5in",
        "1Hz36lb0.5in",
        "1Hz36lb1in",
    ];
    let errors = unseen.map(|name| {
        let record = open(&format!("{name}.parquet"));
        compare(&record, &model).expect("a sound record").error.nrmse_force.expect("a force")
    });
    assert!(errors.iter().all(|error| *error < 0.25), "{errors:?}");
    assert!(errors.iter().sum::<f64>() < 0.15 * errors.len() as f64, "{errors:?}");
}

#[test]
fn an_effect_taken_out_of_the_catalogue_is_outside_it() {
    is_outside_without(10_114_210, "backlash", 0.12);
}

#[test]
#[ignore = "minutes: `./test blind`"]
fn an_effect_taken_out_that_others_come_near_is_outside_the_catalogue() {
    is_outside_without(5_000_507, "stiffness-degradation", 0.08);
}

fn is_outside_without(seed: u64, name: &'static str, size: f64) {
    let case = hidden::make(&Recipe::of(seed, &[name], size)).expect("the effect reaches its size");
    let without = hidden::with_twin(name);
    let options = Options { without: without.clone(), ..Options::default() };
    let found = diagnose_together(&[(&case.record, &case.nominal)], &options).expect("a base record");
    assert_eq!(found.verdict, Verdict::OutsideCatalogue, "{:?}", found.effects);
    let told =
        |name: &&str| found.notes.iter().any(|note| note.starts_with(*name) && note.contains("not tried"));
    assert!(without.iter().all(told), "{:?}", found.notes);
}
