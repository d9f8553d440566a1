use super::*;
use crate::model::testing::{b1_g2, effect, oscillator};
use crate::model::{ModelSpec, build};
use rand::{Rng, SeedableRng};
use std::f64::consts::TAU;

const RATE: f64 = 1024.0;

/// Noise of the sensors.
#[derive(Clone, Copy)]
struct Noise {
    acceleration_m_s2: f64,
    displacement_m: f64,
}

const QUIET: Noise = Noise { acceleration_m_s2: 0.0, displacement_m: 0.0 };
const LAB: Noise = Noise { acceleration_m_s2: 0.01, displacement_m: 3e-5 };

/// A record of the specimen under steps of ten cycles at given frequencies, joined at phase 0.
fn swept(spec: &ModelSpec, hz: &[f64], amplitude_m_s2: f64, noise: Noise) -> Record {
    let mut record = Record::empty("test", Kind::Base, RATE);
    let mut specimen = build(spec, 1.0 / RATE).expect("valid");
    let mut random = rand_pcg::Pcg64::seed_from_u64(5);
    let mut hiss = move |sigma: f64| {
        let x: f64 = random.sample(rand_distr::StandardNormal);
        sigma * x
    };
    for (step, f) in hz.iter().enumerate() {
        for i in 0..(10.0 * RATE / f) as usize {
            let table = amplitude_m_s2 * (TAU * f * i as f64 / RATE).sin();
            let response = specimen.step(table);
            let a = response.mass_acceleration_m_s2;
            record.time_s.push(record.time_s.len() as f64 / RATE);
            record.table_acceleration_m_s2.push(table + hiss(noise.acceleration_m_s2));
            record.mass_acceleration_1_m_s2.push(a + 0.02 + hiss(noise.acceleration_m_s2));
            record.mass_acceleration_2_m_s2.push(a - 0.01 + hiss(noise.acceleration_m_s2));
            record
                .relative_displacement_m
                .push(response.relative_displacement_m + hiss(noise.displacement_m));
            record.step.push(step as i32);
        }
    }
    record
}

const STEPS: [f64; 9] = [0.8, 1.1, 1.4, 1.7, 2.0, 1.7, 1.4, 1.1, 0.8];

#[test]
fn a_record_that_ends_in_motion_leaves_no_force_at_its_end() {
    let mut record = swept(&b1_g2(), &STEPS, 0.5, LAB);
    let ranges = record.step_ranges();
    let step = ranges[2].1.clone();
    // Of its last cycles, the samples where the mass is farthest out and where it is fastest.
    let d = record.relative_displacement_m.clone();
    let late = step.end - 500..step.end - 20;
    let farthest = late.clone().max_by(|a, b| d[*a].abs().total_cmp(&d[*b].abs())).expect("samples");
    let fastest = late.max_by(|a, b| (d[*a + 9] - d[*a - 9]).abs().total_cmp(&(d[*b + 9] - d[*b - 9]).abs()));
    let left = |record: &Record| {
        compare(record, &b1_g2()).expect("comparable").steps[2].force_residual_n.expect("measured")
    };
    let whole = left(&record);
    let fastest = fastest.expect("samples");
    for end in [farthest.max(fastest), farthest.min(fastest)] {
        record.truncate(end);
        let cut = left(&record);
        assert!(cut < 1.2 * whole, "cut at {end}: {cut} N of {whole} N");
    }
}

#[test]
fn the_right_model_leaves_the_noise_floor_and_no_more() {
    let found = compare(&swept(&b1_g2(), &STEPS, 0.5, LAB), &b1_g2()).expect("comparable");
    assert_eq!(found.method, Method::FromRest);
    assert_eq!(found.steps.len(), STEPS.len());
    let within = |error: Option<f64>, floor: Option<f64>| {
        let ratio = error.expect("measured") / floor.expect("measured");
        assert!((0.7..1.3).contains(&ratio), "{ratio}: {:?}", found.error);
    };
    within(found.error.nrmse_a, found.error.noise_floor_a);
    within(found.error.nrmse_d, found.error.noise_floor_d);
    assert!(found.error.nrmse_a.is_some_and(|e| e < 0.01), "{:?}", found.error);
    let directions: Vec<_> = found.steps.iter().map(|step| step.direction).collect();
    assert_eq!(directions[1], Some(Direction::Forward));
    assert_eq!(directions[7], Some(Direction::Backward));
}

#[test]
fn shares_of_disjoint_parts_add_up() {
    let record = swept(&b1_g2(), &STEPS, 0.5, LAB);
    let found = compare(&record, &b1_g2()).expect("comparable");
    let share = |names: &[&str], of: fn(&Slice) -> Option<f64>| -> f64 {
        found.regimes.iter().filter(|slice| names.contains(&slice.name.as_str())).filter_map(of).sum()
    };
    for of in [
        |s: &Slice| Some(s.share_of_samples),
        |s: &Slice| s.share_of_misfit_a,
        |s: &Slice| s.share_of_misfit_force,
    ] {
        let all = share(&["free", "right-contact", "left-contact"], of);
        assert!((all - 1.0).abs() < 1e-9, "{all}");
    }
    let phases: f64 = found.phases.iter().map(|slice| slice.share_of_samples).sum();
    assert!((phases - 1.0).abs() < 1e-9, "{phases}");
}

#[test]
fn a_wrong_bumper_is_found_in_contact() {
    let mut truth = b1_g2();
    truth.effects.push(effect("bumper-stiffening", &[("kb3_n_m3", 6e8)]));
    let found = compare(&swept(&truth, &STEPS, 0.5, LAB), &b1_g2()).expect("comparable");
    let contact: f64 = found
        .regimes
        .iter()
        .filter(|slice| slice.name == "right-contact" || slice.name == "left-contact")
        .filter_map(|slice| slice.share_of_misfit_force)
        .sum();
    assert!(contact > 0.8, "{contact}: {}", found.sentence);
    assert!(found.sentence.contains("contact"), "{}", found.sentence);
    let error = found.error;
    assert!(error.nrmse_a > error.noise_floor_a.map(|floor| 3.0 * floor), "{error:?}");
}

#[test]
fn nrmse_is_the_ratio_of_the_two_rms() {
    // Of a linear specimen whose every number but the mass is 1 % too large nothing but D changes
    // when D alone is scaled: the error of D is that scale.
    let spec = oscillator(500.0, 20e3, 1100.0);
    let mut record = swept(&spec, &[1.0, 1.3], 0.5, QUIET);
    record.relative_displacement_m.iter_mut().for_each(|d| *d *= 1.04);
    let found = compare(&record, &spec).expect("comparable");
    let d = found.error.nrmse_d.expect("measured");
    assert!((d - 0.04 / 1.04).abs() < 1e-4, "{d}");
    // The zero of the table's accelerometer is estimated to some 1e-5 of its amplitude.
    assert!(found.error.nrmse_a.is_some_and(|a| a < 1e-4), "{:?}", found.error);
    let first = &found.steps[0].harmonics_d[0];
    assert!((first.residual / first.measured - 0.04 / 1.04).abs() < 1e-4, "{first:?}");
}

#[test]
fn a_record_that_starts_in_motion_is_started_there() {
    let spec = b1_g2();
    let whole = swept(&spec, &[1.4], 0.5, LAB);
    let from = whole.len() * 4 / 10;
    let mut cut = Record::empty("cut", Kind::Base, RATE);
    cut.time_s = whole.time_s[from..].iter().map(|t| t - whole.time_s[from]).collect();
    cut.table_acceleration_m_s2 = whole.table_acceleration_m_s2[from..].to_vec();
    cut.mass_acceleration_1_m_s2 = whole.mass_acceleration_1_m_s2[from..].to_vec();
    cut.relative_displacement_m = whole.relative_displacement_m[from..].to_vec();
    let found = compare(&cut, &spec).expect("comparable");
    assert!(matches!(found.method, Method::WarmStart { .. }), "{:?}", found.method);
    assert!(found.steps.is_empty());
    assert!(found.error.nrmse_a.is_some_and(|e| e < 0.03), "{:?}", found.error);
    assert!(found.error.nrmse_d.is_some_and(|e| e < 0.03), "{:?}", found.error);
}

#[test]
fn a_free_mass_is_judged_over_short_horizons() {
    let mut spec = oscillator(2.0, 0.0, 3.0);
    spec.effects.push(effect("coulomb-friction", &[("fc_n", 0.5)]));
    let mut record = swept(&spec, &[4.0, 6.0], 2.0, Noise { acceleration_m_s2: 1e-3, displacement_m: 1e-7 });
    // A table accelerometer that is off by 1 % would let a free-running model drift away.
    record.table_acceleration_m_s2.iter_mut().for_each(|a| *a += 0.02);
    let found = compare(&record, &spec).expect("comparable");
    assert!(matches!(found.method, Method::ShortHorizons { .. }), "{:?}", found.method);
    assert!(found.error.nrmse_a.is_some_and(|e| e < 0.05), "{:?}", found.error);
    assert!(found.error.nrmse_d.is_some_and(|e| e < 0.05), "{:?}", found.error);
}

#[test]
fn a_component_is_judged_by_its_force_at_any_magnitude() {
    // Micrometres at 200 Hz.
    let rate = 20_000.0;
    let spec = oscillator(0.003, 4e4, 2.0);
    let mut record = Record::empty("component", Kind::Component, rate);
    for i in 0..20_000 {
        let phase = TAU * 200.0 * i as f64 / rate;
        let (d, v) = (5e-6 * phase.sin(), 5e-6 * TAU * 200.0 * phase.cos());
        record.time_s.push(i as f64 / rate);
        record.displacement_m.push(d);
        record.force_n.push(1.05 * (4e4 * d + 2.0 * v));
        record.step.push(0);
    }
    let found = compare(&record, &spec).expect("comparable");
    let force = found.error.nrmse_force.expect("measured");
    assert!((force - 0.05 / 1.05).abs() < 2e-3, "{force}");
    assert_eq!(found.error.nrmse_a, found.error.nrmse_force);
    assert_eq!(found.error.nrmse_d, None);
}

/// A record of a mass that a sine of 4 Hz drives, smooth between the samples.
fn forced(spec: &ModelSpec) -> Record {
    let mut record = Record::empty("force", Kind::Force, RATE);
    const FINE: usize = 32;
    let mass_kg = spec.mass_kg;
    let mut specimen = build(spec, 1.0 / (RATE * FINE as f64)).expect("valid");
    for i in 0..(20.0 * RATE) as usize {
        let at = |k: usize| 3.0 * (TAU * 4.0 * k as f64 / (RATE * FINE as f64)).sin();
        for k in (i * FINE + 1).saturating_sub(FINE)..i * FINE {
            specimen.step(-at(k) / mass_kg);
        }
        let force = at(i * FINE);
        let response = specimen.step(-force / mass_kg);
        record.time_s.push(i as f64 / RATE);
        record.force_n.push(force);
        record.displacement_m.push(response.relative_displacement_m);
        record.acceleration_m_s2.push(response.mass_acceleration_m_s2 + force / mass_kg);
        record.step.push(0);
    }
    record
}

#[test]
fn an_applied_force_gives_displacement_and_acceleration() {
    let spec = oscillator(2.0, 2000.0, 8.0);
    let record = forced(&spec);
    let right = compare(&record, &spec).expect("comparable").error;
    assert!(right.nrmse_a.is_some_and(|e| e < 1e-6) && right.nrmse_d.is_some_and(|e| e < 1e-6), "{right:?}");
    let wrong = compare(&record, &oscillator(2.0, 2200.0, 8.0)).expect("comparable").error;
    assert!(wrong.nrmse_d.is_some_and(|e| e > 0.05), "{wrong:?}");
}

#[test]
fn an_accelerometer_sees_the_motion_that_force_and_restoring_force_make() {
    let mut spec = oscillator(2.0, 2000.0, 8.0);
    let mut record = forced(&spec);
    // 0.9 of it, four samples late.
    let a = record.acceleration_m_s2.clone();
    for (i, seen) in record.acceleration_m_s2.iter_mut().enumerate() {
        *seen = 0.9 * a[i.saturating_sub(4)];
    }
    spec.effects.push(effect("accelerometer-gain", &[("gain", 0.9)]));
    spec.effects.push(effect("accelerometer-delay", &[("dt_s", 4.0 / RATE)]));
    let left = compare(&record, &spec).expect("comparable").error.nrmse_a.expect("measured");
    assert!(left < 1e-5, "{left}");
    record.acceleration_m_s2 = a.iter().map(|a| 0.9 * a).collect();
    spec.effects.truncate(1);
    let left = compare(&record, &spec).expect("comparable").error.nrmse_force.expect("measured");
    assert!(left < 0.01, "{left}");
}

#[test]
fn a_lag_of_the_force_is_told_with_what_would_be_left() {
    let spec = oscillator(2.0, 2000.0, 8.0);
    let mut record = forced(&spec);
    assert!(compare(&record, &spec).expect("comparable").notes.is_empty());
    let force = record.force_n.clone();
    for (i, late) in record.force_n.iter_mut().enumerate() {
        *late = force[i.saturating_sub(3)];
    }
    let found = compare(&record, &spec).expect("comparable");
    let us = (3e6 / RATE).round();
    assert!(
        found.notes.iter().any(|note| note.contains(&format!("comes {us} us earlier"))),
        "{:?}",
        found.notes
    );
    // A spring that is off leaves no lag at resonance and beside it.
    let soft = compare(&forced(&spec), &oscillator(2.0, 1900.0, 8.0)).expect("comparable");
    assert!(soft.notes.is_empty(), "{:?}", soft.notes);
}

#[test]
fn each_accelerometer_that_there_is_has_its_gain() {
    let spec = oscillator(500.0, 20e3, 1100.0);
    let with = |gains: &[(&str, f64)]| {
        let mut spec = spec.clone();
        spec.effects.push(effect("accelerometer-gain", gains));
        spec
    };
    let left = |record: &Record, spec: &ModelSpec| {
        compare(record, spec).expect("comparable").error.nrmse_a.expect("measured")
    };
    let mut record = swept(&spec, &[1.0, 1.3], 0.5, QUIET);
    record.mass_acceleration_1_m_s2.iter_mut().for_each(|a| *a *= 1.03);
    record.mass_acceleration_2_m_s2.iter_mut().for_each(|a| *a *= 1.03);
    assert!(left(&record, &with(&[("gain", 1.03), ("gain_2", 1.03)])) < 1e-4);
    record.mass_acceleration_2_m_s2.clear();
    assert!(left(&record, &with(&[("gain", 1.03)])) < 1e-4);
    record.mass_acceleration_2_m_s2 = std::mem::take(&mut record.mass_acceleration_1_m_s2);
    assert!(left(&record, &with(&[("gain", 1.0), ("gain_2", 1.03)])) < 1e-4);
}

#[test]
fn what_is_missing_is_said() {
    let mut record = swept(&b1_g2(), &[1.4], 0.5, QUIET);
    record.table_acceleration_m_s2.clear();
    let error = compare(&record, &b1_g2()).expect_err("refused").to_string();
    assert!(error.contains("table_acceleration_m_s2"), "{error}");
    let short = Record { time_s: vec![0.0; 3], ..Record::empty("short", Kind::Base, RATE) };
    assert!(compare(&short, &b1_g2()).is_err());
}

#[test]
fn the_page_shows_what_the_record_has() {
    let html = |found: &Comparison| crate::report::comparison::page(found).expect("drawn").html();
    let base = compare(&swept(&b1_g2(), &STEPS, 0.5, LAB), &b1_g2()).expect("comparable");
    let page = html(&base);
    for part in
        ["A_max (m/s2)", "Hysteresis loop", "Phase portrait", "Residual force over time", "fundamental"]
    {
        assert!(page.contains(part), "{part}");
    }
    assert!(page.contains(&base.sentence) && !page.contains("NaN") && !page.contains("#F1"));
    // Only a displacement, no steps: neither loops nor residual force.
    let mut bare = swept(&b1_g2(), &[1.4], 0.5, LAB);
    bare.mass_acceleration_1_m_s2.clear();
    bare.mass_acceleration_2_m_s2.clear();
    bare.step.clear();
    let found = compare(&bare, &b1_g2()).expect("comparable");
    assert!(found.residual_force.is_none() && found.steps.is_empty());
    let page = html(&found);
    assert!(page.contains("Displacement D") && !page.contains("Hysteresis loop"), "{}", found.sentence);
}

#[test]
fn the_force_of_a_free_specimen_is_judged_along_its_motion() {
    let record = swept(&b1_g2(), &STEPS, 0.5, LAB);
    let right = compare(&record, &b1_g2()).expect("comparable").error.nrmse_force.expect("measured");
    let mut soft = b1_g2();
    soft.isolator.stiffness_n_m.iter_mut().for_each(|k| *k *= 0.9);
    let wrong = compare(&record, &soft).expect("comparable").error.nrmse_force.expect("measured");
    assert!(right < 0.02 && (0.04..0.12).contains(&wrong), "{right} {wrong}");
}

#[test]
fn a_table_that_is_seen_at_few_samples_a_cycle_drives_the_model_as_it_moved() {
    // Along lines between 20 to 40 samples a cycle it would drive it by 0.2 to 0.8 % less.
    let specimen = oscillator(500.0, 500.0 * (TAU * 1.5_f64).powi(2), 500.0);
    let fine = swept(&specimen, &STEPS, 0.5, QUIET);
    let every = |channel: &[f64]| channel.iter().step_by(32).copied().collect::<Vec<f64>>();
    let mut record = Record::empty("coarse", Kind::Base, RATE / 32.0);
    record.time_s = every(&fine.time_s);
    record.table_acceleration_m_s2 = every(&fine.table_acceleration_m_s2);
    record.mass_acceleration_1_m_s2 = every(&fine.mass_acceleration_1_m_s2);
    record.mass_acceleration_2_m_s2 = every(&fine.mass_acceleration_2_m_s2);
    record.relative_displacement_m = every(&fine.relative_displacement_m);
    record.step = fine.step.iter().step_by(32).copied().collect();
    let found = compare(&record, &specimen).expect("comparable");
    let [a, d] = [found.error.nrmse_a, found.error.nrmse_d].map(|error| error.expect("measured"));
    assert!(a < 1e-3 && d < 1e-3, "{a} {d}");
}

#[test]
fn a_force_that_reaches_far_up_the_band_is_no_noise() {
    let spec = oscillator(2.0, 2.0 * (TAU * 60.0_f64).powi(2), 40.0);
    for part_of_nyquist in [0.66, 0.82, 0.95] {
        const FINE: usize = 8;
        let mut random = rand_pcg::Pcg64::seed_from_u64(7);
        let mut hiss = move |sigma: f64| {
            let x: f64 = random.sample(rand_distr::StandardNormal);
            sigma * x
        };
        // Lines of random phase up to a part of the band.
        let n = 8192;
        let lines = (part_of_nyquist * n as f64 / 2.0) as usize;
        let phases: Vec<f64> = (0..lines).map(|_| TAU * hiss(1.0)).collect();
        let mut force = vec![0.0; FINE * n];
        let turns: Vec<(f64, f64)> =
            (0..FINE * n).map(|i| (TAU * i as f64 / (FINE * n) as f64).sin_cos()).collect();
        for (k, phase) in phases.iter().enumerate().step_by(4) {
            let (sin, cos) = phase.sin_cos();
            for (i, f) in force.iter_mut().enumerate() {
                let (s, c) = turns[(k + 1) * i % (FINE * n)];
                *f += s * cos + c * sin;
            }
        }
        let rms = (force.iter().map(|f| f * f).sum::<f64>() / force.len() as f64).sqrt();
        let mut record = Record::empty("wide", Kind::Force, RATE);
        let mut specimen = build(&spec, 1.0 / (RATE * FINE as f64)).expect("valid");
        for (i, f) in force.iter().enumerate() {
            let response = specimen.step(-f / 2.0);
            if i % FINE == 0 {
                record.time_s.push(record.time_s.len() as f64 / RATE);
                record.force_n.push(f + hiss(2e-3 * rms));
                record.displacement_m.push(response.relative_displacement_m);
            }
        }
        let size = (record.displacement_m.iter().map(|d| d * d).sum::<f64>() / n as f64).sqrt();
        record.displacement_m.iter_mut().for_each(|d| *d += hiss(3e-3 * size));
        let error = compare(&record, &spec).expect("comparable").error;
        let (left, floor) = (error.nrmse_d.expect("measured"), error.noise_floor_d.expect("measured"));
        // The displacement's noise is 3e-3 of it: the force's is made up for between its samples.
        assert!((2.7e-3..5e-3).contains(&left), "{part_of_nyquist}: {left}");
        // A motion that fills the band leaves no quiet part to tell its sensor's noise by: the floor is then an upper bound.
        let least = if part_of_nyquist > 0.9 { 0.1 } else { 0.5 };
        assert!((least..2.0).contains(&(left / floor)), "{part_of_nyquist}: {left} {floor}");
    }
}

#[test]
fn a_free_decay_is_started_where_it_still_moves() {
    let mut spec = oscillator(2.0, 2842.0, 1.5);
    spec.effects.push(effect("coulomb-friction", &[("fc_n", 0.3), ("vt_m_s", 1e-3)]));
    let mut random = rand_pcg::Pcg64::seed_from_u64(9);
    let mut record = Record::empty("decay", Kind::Force, RATE);
    let mut specimen = build(&spec, 1.0 / RATE).expect("valid");
    for i in 0..20_000 {
        let response = if i == 0 { specimen.impose(0.02, 0.0) } else { specimen.step(0.0) };
        let hiss: f64 = random.sample(rand_distr::StandardNormal);
        record.time_s.push(f64::from(i) / RATE);
        record.force_n.push(0.0);
        record.displacement_m.push(response.relative_displacement_m + 7e-6 * hiss);
    }
    let found = compare(&record, &spec).expect("comparable");
    assert!(matches!(found.method, Method::WarmStart { from_s } if from_s < 0.5), "{:?}", found.method);
    let (left, floor) =
        (found.error.nrmse_d.expect("measured"), found.error.noise_floor_d.expect("measured"));
    assert!(left < 1.5 * floor, "{left} {floor}");
}
