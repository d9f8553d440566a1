//! The diagnosis on base records of a healthy mass behind the chains of measurement of other laboratories.

use hil_tests::chains::{Chain, stepped, swept};
use hil_tests::forced::Body;
use shaketable::diagnose::{Diagnosis, Options, Verdict, diagnose};
use shaketable::record::Record;
use std::f64::consts::TAU;

/// 50 kg at 5 Hz.
const MACHINE: Body = Body {
    mass_kg: 50.0,
    stiffness_n_m: 49_348.0,
    damping_n_s_m: 94.2,
    cubic_n_m3: 0.0,
    growing_n_s_m3: 0.0,
    friction_n: 0.0,
    constant_n: 0.0,
};
const PLAIN: Chain = Chain {
    rate_hz: 500.0,
    against_aliases_hz: None,
    blocks_hz: [None; 2],
    accelerometer: true,
    noise: 1e-3,
};

/// The diagnosis of its steps, which has to find nothing missing and its numbers within four deviations.
fn sound(chain: Chain, seed: u64) -> Diagnosis {
    sound_in(&stepped(&MACHINE, chain, seed), seed, &format!("{chain:?}"))
}

/// The same of a record.
fn sound_in(record: &Record, seed: u64, of: &str) -> Diagnosis {
    let nominal = MACHINE.nominal("machine", seed);
    let nominal = shaketable::model::ModelSpec { mass_kg: MACHINE.mass_kg, ..nominal };
    let found = diagnose(record, &nominal, &Options::default()).expect("a sound record");
    let of = format!("{of}: {:?} {:?} {:?}", found.effects, found.refused, found.notes);
    assert_eq!(found.verdict, Verdict::Adequate, "{of}");
    assert!(found.effects.is_empty() && found.error_after < 1.05 * found.noise_floor, "{of}");
    for (key, truth) in [
        ("isolator.stiffness_n_m[0]", MACHINE.stiffness_n_m),
        ("isolator.damping_n_s_m", MACHINE.damping_n_s_m),
    ] {
        let number = found.reidentified.iter().find(|number| number.key == key).expect("identified");
        let sigma = (number.high95 - number.low95) / 3.92;
        assert!((number.value - truth).abs() < 4.0 * sigma, "{key} {} +- {sigma}: {of}", number.value);
    }
    found
}

#[test]
fn few_samples_a_cycle_make_no_hysteresis() {
    // Lines between 16 samples of what drives the mass take 1.3 % off it: a false hysteresis had made up for that.
    for (rate_hz, accelerometer) in [(80.0, false), (80.0, true), (160.0, false), (160.0, true)] {
        sound(Chain { rate_hz, accelerometer, ..PLAIN }, 1);
    }
}

#[test]
fn good_sensors_at_few_samples_a_cycle_show_nothing_that_is_not_there() {
    // A step ends within a sample of whole cycles: the mean of the rest, a hundred times such a noise, had passed for a zero of A.
    for (rate_hz, noise, seed) in [(170.0, 1e-4, 7), (220.0, 1e-4, 8), (340.0, 5e-5, 9)] {
        sound(Chain { rate_hz, noise, ..PLAIN }, seed);
    }
}

#[test]
fn a_filter_against_aliases_is_no_physics() {
    // The upper band, which tells the noise, has less of it: the rest was outside the catalogue.
    for share in [0.3, 0.35, 0.4] {
        sound(Chain { against_aliases_hz: Some(share * PLAIN.rate_hz), ..PLAIN }, 2);
    }
    sound(Chain { against_aliases_hz: Some(0.4 * PLAIN.rate_hz), accelerometer: false, ..PLAIN }, 3);
}

#[test]
fn accelerometers_that_block_what_is_slow_are_put_right() {
    let corner_hz = 0.1;
    let of_all = sound(Chain { blocks_hz: [Some(corner_hz); 2], ..PLAIN }, 4);
    let of_mass = sound(Chain { blocks_hz: [Some(corner_hz), None], ..PLAIN }, 5);
    for (found, channels) in [(of_all, 2), (of_mass, 1)] {
        let told: Vec<&String> = found.notes.iter().filter(|note| note.contains("(AC)")).collect();
        assert_eq!(told.len(), channels, "{:?}", found.notes);
        assert!(
            told.iter().all(|note| note.contains("corner 0.1") || note.contains("corner 0.09")),
            "{told:?}"
        );
    }
    assert!(sound(PLAIN, 6).notes.iter().all(|note| !note.contains("(AC)")));
}

#[test]
fn hum_that_a_sweep_hides_is_found_in_what_the_model_leaves() {
    // The sweep passes 50 Hz, six hundred times as strong as the hum, which has the size of the noise: good sensors were outside the catalogue.
    let mut record = swept(&MACHINE, PLAIN, 10, (20.0, 60.0));
    let hum = |i: usize| 5e-4 * (TAU * 50.02 * i as f64 / PLAIN.rate_hz + 0.4).sin();
    record.mass_acceleration_1_m_s2.iter_mut().enumerate().for_each(|(i, a)| *a += hum(i));
    let said =
        |found: &Diagnosis| found.notes.iter().filter(|note| note.contains("hum of the mains")).count();
    let found = sound_in(&record, 10, "hum");
    assert_eq!(said(&found), 1, "{:?}", found.notes);
    let note = found.notes.iter().find(|note| note.contains("hum of the mains at 50.02 Hz")).expect("said");
    let told: f64 =
        note.split(&[' ', ','][..]).find_map(|word| word.parse().ok().filter(|x| *x < 1.0)).expect("a size");
    assert!((told / 5e-4 - 1.0).abs() < 0.1, "{note}");
    assert_eq!(said(&sound_in(&swept(&MACHINE, PLAIN, 11, (20.0, 60.0)), 11, "without")), 0);
}
