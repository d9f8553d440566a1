use super::*;
use rand::{Rng, SeedableRng};
use std::f64::consts::TAU;

/// Exact response of a damped linear oscillator, stepped through frequencies, at any scale of length
/// and time; noise relative to the motion.
fn oscillator(length: f64, time: f64, noise: f64, seed: u64) -> Record {
    let rate = 512.0 / time;
    let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
    let mut record = Record::empty("made", Kind::Base, rate);
    let (wn, zeta) = (TAU * 1.1 / time, 0.12);
    for (index, relative) in [0.6, 0.9, 1.1, 1.4, 2.2].into_iter().enumerate() {
        let w = TAU * relative / time;
        let x = length / (relative * relative);
        // D'' + 2 zeta wn D' + wn^2 D = -a, a = -x w^2 sin.
        let (re, im) = (wn * wn - w * w, 2.0 * zeta * wn * w);
        let size = x * w * w / re.hypot(im);
        let lag = im.atan2(re);
        for i in 0..(8.0 * rate / (relative / time)) as usize {
            let p = w * i as f64 / rate;
            let mut off = |scale: f64| noise * scale * (random.random::<f64>() - 0.5);
            let d = size * (p - lag).sin();
            let a = -x * w * w * p.sin();
            let mass = a - w * w * d;
            record.time_s.push(record.time_s.len() as f64 / rate);
            let acceleration = length * w * w;
            record.table_displacement_m.push(x * p.sin() + off(length));
            record.table_acceleration_m_s2.push(a + off(acceleration));
            record.mass_acceleration_1_m_s2.push(mass + off(acceleration) + 0.02 * acceleration);
            record.mass_acceleration_2_m_s2.push(mass + off(acceleration));
            record.relative_displacement_m.push(d + off(length));
            record.step.push(index as i32);
        }
    }
    record
}

fn named(record: &Record) -> Vec<(Problem, Option<&'static str>)> {
    examine(record).into_iter().map(|finding| (finding.problem, finding.channel)).collect()
}

#[test]
fn sound_records_of_any_magnitude_raise_nothing() {
    for seed in 0..5 {
        for (length, time) in [(0.03, 1.0), (5e-6, 2e-3), (1e-9, 1e-2), (10.0, 30.0), (2e-3, 0.01)] {
            for noise in [0.0, 0.003, 0.03] {
                let record = oscillator(length, time, noise, seed);
                assert_eq!(named(&record), [], "{length} m, {time} s, noise {noise}");
            }
        }
    }
}

#[test]
fn coarse_quantisation_is_no_saturation() {
    for bits in [9, 12, 16] {
        let mut record = oscillator(0.03, 1.0, 0.003, 1);
        let grain = 0.25 / f64::from(1 << bits);
        record.relative_displacement_m.iter_mut().for_each(|d| *d = (*d / grain).round() * grain);
        assert_eq!(named(&record), [], "{bits} bits");
    }
}

#[test]
fn a_mass_that_comes_to_rest_at_its_farthest_is_not_cut_off() {
    // Moved to and fro and held by friction in between, by an encoder of 1 um.
    let mut record = Record::empty("axis", Kind::Force, 1000.0);
    for i in 0..8000 {
        let part = (f64::from(i % 2000) / 1000.0).min(1.0);
        let way = part * part * (3.0 - 2.0 * part);
        let place = if (i / 2000) % 2 == 0 { way } else { 1.0 - way };
        record.time_s.push(f64::from(i) / 1000.0);
        record.displacement_m.push((0.2 * place / 1e-6).round() * 1e-6);
        record.force_n.push((0.001 * f64::from(i * i % 997)).sin());
    }
    let saturated = |record: &Record| named(record).iter().any(|(problem, _)| *problem == Problem::Saturated);
    assert!(!saturated(&record), "{:?}", named(&record));
    record.displacement_m.iter_mut().for_each(|d| *d = d.min(0.15));
    assert!(saturated(&record), "{:?}", named(&record));
    // A slow sine with noise of its own leaves the edge and comes back many times.
    let mut random = rand_pcg::Pcg64::seed_from_u64(4);
    for i in 0..8000 {
        let sine = (f64::from(i) / 1000.0 * 0.4).sin();
        record.displacement_m[i as usize] = (sine + 0.01 * random.random_range(-1.0..1.0)).min(0.6);
    }
    assert!(saturated(&record), "{:?}", named(&record));
}

#[test]
fn signs_are_named() {
    for role in [
        Role::TableAcceleration,
        Role::MassAcceleration1,
        Role::MassAcceleration2,
        Role::RelativeDisplacement,
    ] {
        let mut record = oscillator(0.03, 1.0, 0.003, 2);
        record.channel_mut(role).expect("there").iter_mut().for_each(|x| *x = -*x);
        assert_eq!(named(&record), [(Problem::WrongSign, Some(role.name()))]);
    }
}

#[test]
fn units_are_named() {
    for role in [
        Role::TableDisplacement,
        Role::TableAcceleration,
        Role::MassAcceleration1,
        Role::MassAcceleration2,
        Role::RelativeDisplacement,
    ] {
        for factor in [1e3, 1e-3] {
            let mut record = oscillator(5e-6, 2e-3, 0.003, 3);
            record.channel_mut(role).expect("there").iter_mut().for_each(|x| *x *= factor);
            assert_eq!(named(&record), [(Problem::WrongUnit, Some(role.name()))], "{factor}");
            let text = examine(&record)[0].text.clone();
            assert!(text.contains("1000") == text.contains("times too"), "{text}");
        }
    }
}

#[test]
fn a_table_that_hardly_moves_beside_its_mass_is_told_all_the_same() {
    // 12 kg at 9 Hz that ring for long, shaken by noise.
    let rate = 500.0;
    let mut random = rand_pcg::Pcg64::seed_from_u64(11);
    let mut specimen =
        crate::model::build(&crate::model::testing::oscillator(12.0, 40e3, 14.0), 1.0 / rate).expect("valid");
    let mut sound = Record::empty("driven", Kind::Base, rate);
    let mut table = [0.0; 2];
    for i in 0..20_000 {
        table[0] += 0.1 * (random.random_range(-1.0..1.0) - table[0]);
        table[1] += 0.1 * (table[0] - table[1]);
        let response = specimen.step(table[1]);
        sound.time_s.push(f64::from(i) / rate);
        sound.table_acceleration_m_s2.push(table[1]);
        sound
            .mass_acceleration_1_m_s2
            .push(response.mass_acceleration_m_s2 + 1e-3 * random.random_range(-1.0..1.0));
        sound
            .relative_displacement_m
            .push(response.relative_displacement_m + 1e-6 * random.random_range(-1.0..1.0));
    }
    assert_eq!(named(&sound), []);
    for (factor, problem) in [
        (1.0 / crate::units::STANDARD_GRAVITY_M_S2, Problem::WrongUnit),
        (1e-3, Problem::WrongUnit),
        (-1.0, Problem::WrongSign),
    ] {
        let mut record = sound.clone();
        record.table_acceleration_m_s2.iter_mut().for_each(|a| *a *= factor);
        assert_eq!(named(&record), [(problem, Some("table_acceleration_m_s2"))], "{factor}");
    }
}

#[test]
fn exchanged_sensors_are_named() {
    let mut record = oscillator(0.03, 1.0, 0.003, 4);
    std::mem::swap(&mut record.table_acceleration_m_s2, &mut record.mass_acceleration_1_m_s2);
    assert_eq!(named(&record), [(Problem::Swapped, Some("table_acceleration_m_s2"))]);
    let mut record = oscillator(0.03, 1.0, 0.003, 4);
    std::mem::swap(&mut record.table_displacement_m, &mut record.relative_displacement_m);
    assert_eq!(named(&record), [(Problem::Swapped, Some("table_displacement_m"))]);
}

#[test]
fn saturated_constant_and_stuck_channels_are_named() {
    let sound = oscillator(0.03, 1.0, 0.003, 5);
    let (_, top) = span(&sound.mass_acceleration_1_m_s2);
    let mut record = sound.clone();
    record.mass_acceleration_1_m_s2.iter_mut().for_each(|x| *x = x.clamp(-0.9 * top, 0.9 * top));
    assert_eq!(named(&record), [(Problem::Saturated, Some("mass_acceleration_1_m_s2"))]);
    assert_eq!(examine(&record)[0].severity, Severity::Error);

    let mut record = sound.clone();
    record.relative_displacement_m.fill(0.012);
    assert_eq!(named(&record), [(Problem::Constant, Some("relative_displacement_m"))]);

    let mut record = sound.clone();
    let held = record.relative_displacement_m[2000];
    record.relative_displacement_m[2000..3000].fill(held);
    assert!(named(&record).contains(&(Problem::Stuck, Some("relative_displacement_m"))));

    // A sensor that is not connected.
    let mut record = sound.clone();
    let mut random = rand_pcg::Pcg64::seed_from_u64(9);
    record.relative_displacement_m.fill_with(|| 1e-5 * random.random::<f64>());
    assert_eq!(named(&record), [(Problem::Silent, Some("relative_displacement_m"))]);

    // What drives it, too, unless it is at rest there, as one may be that was made and not measured.
    let stuck = (Problem::Stuck, Some("table_acceleration_m_s2"));
    for (held, is_named) in [(0.5 * span(&sound.table_acceleration_m_s2).1, true), (0.0, false)] {
        let mut record = sound.clone();
        record.table_acceleration_m_s2[2000..3000].fill(held);
        assert_eq!(named(&record).contains(&stuck), is_named, "{held}");
    }
}

#[test]
fn short_and_unsteady_records_are_named() {
    let mut record = oscillator(0.03, 1.0, 0.003, 6);
    record.truncate(700);
    assert_eq!(named(&record), [(Problem::TooShort, None)]);

    // Undamped growth over all of a single step.
    let mut record = oscillator(0.03, 1.0, 0.003, 6);
    record.step.fill(0);
    let growth = |t: f64| (0.25 * t).exp();
    let times = record.time_s.clone();
    for role in [Role::RelativeDisplacement, Role::MassAcceleration1, Role::MassAcceleration2] {
        let channel = record.channel_mut(role).expect("there");
        channel.iter_mut().zip(&times).for_each(|(x, t)| *x *= growth(*t));
    }
    assert!(named(&record).contains(&(Problem::NoSteadyState, None)), "{:?}", examine(&record));
}

#[test]
fn a_force_record_is_checked_between_its_two_motions() {
    let base = oscillator(1e-4, 0.05, 0.003, 7);
    let mut record = Record::empty("force", Kind::Force, base.sample_rate_hz);
    record.time_s = base.time_s.clone();
    record.force_n = base.mass_acceleration_1_m_s2.clone();
    record.displacement_m = base.table_displacement_m.clone();
    record.acceleration_m_s2 = base.table_acceleration_m_s2.clone();
    record.step = base.step.clone();
    assert_eq!(named(&record), []);
    record.displacement_m.iter_mut().for_each(|d| *d *= -1.0);
    assert_eq!(named(&record)[0].0, Problem::WrongSign);
    record.displacement_m.iter_mut().for_each(|d| *d *= -1e3);
    assert_eq!(named(&record)[0].0, Problem::WrongUnit);
}

#[test]
fn white_noise_is_measured_beside_the_motion() {
    let mut random = rand_pcg::Pcg64::seed_from_u64(9);
    let normal = rand_distr::Normal::new(0.0, 0.01).expect("valid");
    let values: Vec<f64> =
        (0..200_000).map(|i| (TAU * f64::from(i) * 3.0 / 2048.0).sin() + random.sample(normal)).collect();
    let found = white_noise(&values);
    assert!((found / 0.01 - 1.0).abs() < 0.03, "{found}");
}

#[test]
fn the_measured_damper_raises_nothing() {
    let folder =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/friction-damper-backlash");
    let Ok(files) = std::fs::read_dir(&folder) else {
        eprintln!("measured files are not beside this checkout: nothing to examine");
        return;
    };
    for path in files
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|e| e == "parquet"))
    {
        let record = Record::open(&path, &Default::default()).expect("read");
        assert_eq!(examine(&record), [], "{}", path.display());
    }
}

/// A mass of 1 kg at 5 Hz: 20 s at 500 Hz, swings from `start_m` on, forced as told, seen by displacement and force.
fn swinging(start_m: f64, force_n: impl Fn(f64) -> f64) -> Record {
    let (rate, fine) = (500.0, 20);
    let mut record = Record::empty("made", Kind::Force, rate);
    let (k, c, dt) = ((TAU * 5.0).powi(2), 0.6, 1.0 / rate / fine as f64);
    let (mut d, mut v) = (start_m, 0.0);
    for i in 0..10_000 * fine {
        let t = i as f64 * dt;
        if i % fine == 0 {
            record.time_s.push(t);
            record.displacement_m.push(d);
            record.force_n.push(force_n(t));
        }
        v += dt * (force_n(t) - k * d - c * v);
        d += dt * v;
    }
    record
}

#[test]
fn what_is_struck_or_let_go_swings_long_after() {
    // Blows of a hammer, 10 ms long, every 4 s; one alone.
    let blow = |t: f64| if t < 0.01 { 50.0 * (t * TAU / 0.02).sin() } else { 0.0 };
    assert_eq!(named(&swinging(0.0, |t| blow(t % 4.0))), []);
    assert_eq!(named(&swinging(0.0, blow)), []);
    // Let go, and nothing after.
    let findings = examine(&swinging(0.02, |_| 0.0));
    let [finding] = findings.as_slice() else { panic!("{findings:?}") };
    assert_eq!((finding.problem, finding.severity), (Problem::Constant, Severity::Notice));
    // A force sensor that says nothing of what drives the mass is as bad as ever, and so is a mass that hardly swings.
    let mut silent = swinging(0.0, |t| (TAU * 3.0 * t).sin());
    silent.force_n.fill(0.0);
    assert!(examine(&silent).iter().any(|f| f.severity == Severity::Error));
    let mut short = swinging(0.0, blow);
    short.truncate(200);
    assert_eq!(named(&short), [(Problem::TooShort, None)]);
}
