use super::*;
use std::f64::consts::TAU;

/// A stepped-sine base record: three frequencies, ten cycles each, marked.
pub(super) fn sample_record() -> Record {
    let rate = 512.0;
    let mut record = Record::empty("made", Kind::Base, rate);
    let mut phase = 0.0f64;
    for (index, hz) in [2.0, 3.0, 4.0].into_iter().enumerate() {
        for _ in 0..(10.0 * rate / hz) as usize {
            let t = record.time_s.len() as f64 / rate;
            record.time_s.push(t);
            let s = phase.sin();
            record.table_displacement_m.push(-0.01 * s / 3.0);
            record.table_acceleration_m_s2.push(0.5 * s);
            record.mass_acceleration_1_m_s2.push(0.7 * s + 0.1);
            record.mass_acceleration_2_m_s2.push(0.7 * s - 0.1);
            record.relative_displacement_m.push(0.003 * (phase - 0.4).sin());
            record.step.push(index as i32);
            phase += TAU * hz / rate;
        }
    }
    record
}

pub(super) fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("folder")
}

#[test]
fn every_format_gives_back_what_was_written() {
    let folder = folder();
    let record = sample_record();
    for (to, name, exact) in [
        (Format::Parquet, "a.parquet", 0.0),
        (Format::Csv, "a.csv", 0.0),
        (Format::Hdf5, "a.h5", 0.0),
        (Format::Mat, "a.mat", 0.0),
        (Format::Uff58, "a.uff", 1e-12),
    ] {
        let path = folder.path().join(name);
        write(&record, &path, to).expect("written");
        let again = Record::open(&path, &ReadOptions::default()).expect("read");
        assert_eq!(again.kind, Kind::Base);
        assert_eq!(again.step, record.step, "{name}");
        assert_eq!(again.sample_rate_hz, 512.0, "{name}");
        assert!(again.notes.is_empty(), "{name}: {:?}", again.notes);
        for (role, values) in record.channels() {
            let found = again.channel(role);
            assert_eq!(found.len(), values.len(), "{name} {}", role.name());
            let worst = values.iter().zip(found).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(worst <= exact, "{name} {}: {worst}", role.name());
        }
    }
    let sidecar = std::fs::read_to_string(folder.path().join("a.csv.toml")).expect("sidecar");
    let sidecar: toml::Table = sidecar.parse().expect("valid");
    assert_eq!(sidecar["columns"].as_array().map(Vec::len), Some(7));
    assert_eq!(sidecar["columns"][2]["unit"].as_str(), Some("m/s2"));
}

#[test]
fn component_records_of_the_measured_damper_open_without_options() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/friction-damper-backlash");
    if !folder.is_dir() {
        eprintln!("measured files are not beside this checkout: nothing to read");
        return;
    }
    for (name, hz, samples) in [("0.25Hz36lb1.5in", 0.25, 28673), ("2Hz36lb0.5in", 2.0, 3585)] {
        let path = folder.join(format!("{name}.parquet"));
        let record = Record::open(&path, &ReadOptions::default()).expect("read");
        assert_eq!((record.kind, record.sample_rate_hz, record.len()), (Kind::Component, 1024.0, samples));
        let steps = record.step_ranges();
        assert_eq!(steps.len(), 1, "{name}: one steady stretch, {steps:?}");
        let input = &record.displacement_m[steps[0].1.clone()];
        let found = crate::signal::fundamental_hz(input, 1024.0).expect("a sine");
        assert!((found / hz - 1.0).abs() < 5e-3, "{name}: {found}");
    }
}

#[test]
fn displacement_and_force_of_a_driven_mass_open_as_a_force_record() {
    let folder = folder();
    let path = folder.path().join("driven.csv");
    for (mass_kg, kind) in [(1.0, Kind::Force), (0.0, Kind::Component)] {
        let row = |i: usize| {
            let t = i as f64 / 256.0;
            let (x, a) = [2.0, 5.0, 9.0, 14.0].into_iter().fold((0.0, 0.0), |(x, a), w: f64| {
                let wave = 1e-3 * (w * t + w * w).sin();
                (x + wave, a - w * w * wave)
            });
            format!("{t},{x},{}\n", mass_kg * a + 64.0 * x)
        };
        let rows: String = (0..4000).map(row).collect();
        std::fs::write(&path, format!("time_s,displacement_m,force_n\n{rows}")).expect("written");
        let record = Record::open(&path, &ReadOptions::default()).expect("read");
        assert_eq!(record.kind, kind);
        assert!(record.notes.iter().any(|note| note.contains("alone were taken as")), "{:?}", record.notes);
    }
}

#[test]
fn units_signs_names_and_the_rate_come_from_the_options() {
    let folder = folder();
    let path = folder.path().join("foreign.csv");
    std::fs::write(&path, "acc T;acc M;laser\n1,5;2;-3\n-1,5;4;5\n0;1;2\n").expect("written");
    let options = ReadOptions {
        map: ["table_acceleration=acc T:g", "mass_acceleration_1=-acc M", "relative_displacement=laser:mm"]
            .map(|text| text.parse().expect("valid"))
            .to_vec(),
        sample_rate_hz: Some(100.0),
        ..ReadOptions::default()
    };
    let record = Record::open(&path, &options).expect("read");
    assert_eq!(record.table_acceleration_m_s2, [1.5 * 9.806_65, -1.5 * 9.806_65, 0.0]);
    assert_eq!(record.mass_acceleration_1_m_s2, [-2.0, -4.0, -1.0]);
    assert_eq!(record.relative_displacement_m, [-3e-3, 5e-3, 2e-3]);
    assert_eq!(record.time_s, [0.0, 0.01, 0.02]);
    assert!(record.mass_acceleration_2_m_s2.is_empty());
    let error = Record::open(&path, &ReadOptions::default()).expect_err("no contract names");
    assert!(error.to_string().contains("acc T"), "{error}");
}

fn component(time_s: &[f64], values: impl Fn(f64) -> f64) -> String {
    let mut text = String::from("time_s,displacement_m,force_n\n");
    for t in time_s {
        text += &format!("{t},{},{}\n", values(*t), 100.0 * values(*t));
    }
    text
}

pub(super) fn open_text(text: &str) -> Result<Record, DataError> {
    let folder = folder();
    let path = folder.path().join("x.csv");
    std::fs::write(&path, text).expect("written");
    Record::open(&path, &ReadOptions::default())
}

#[test]
fn rounded_time_stamps_move_no_value() {
    let wave = |t: f64| (TAU * 3.0 * t).sin();
    let exact: Vec<f64> = (0..3000).map(|i| f64::from(i) / 2048.0).collect();
    let values: Vec<f64> = exact.iter().map(|t| wave(*t)).collect();
    let decimals = |t: &f64| (t * 1e4).round() / 1e4;
    let single = |t: &f64| f64::from(*t as f32 + 400.0);
    for rounded in [exact.iter().map(decimals).collect::<Vec<_>>(), exact.iter().map(single).collect()] {
        let mut text = String::from("time_s,displacement_m,force_n\n");
        for (t, v) in rounded.iter().zip(&values) {
            text += &format!("{t},{v},{v}\n");
        }
        let record = open_text(&text).expect("read");
        assert_eq!(record.displacement_m, values);
        assert!((record.sample_rate_hz / 2048.0 - 1.0).abs() < 1e-5, "{}", record.sample_rate_hz);
    }
}

#[test]
fn jitter_is_resampled_and_gaps_are_bridged_and_both_are_said() {
    let wave = |t: f64| (TAU * 5.0 * t).sin();
    let jittered: Vec<f64> =
        (0..4000).map(|i| (f64::from(i) + 0.3 * (f64::from(i) * 12.9898).sin()) / 1000.0).collect();
    let record = open_text(&component(&jittered, wave)).expect("read");
    assert!(record.notes.iter().any(|note| note.contains("resampled")), "{:?}", record.notes);
    assert!((record.sample_rate_hz - 1000.0).abs() < 1e-2, "{}", record.sample_rate_hz);
    let worst = record
        .time_s
        .iter()
        .zip(&record.displacement_m)
        .skip(2)
        .take(3990)
        .map(|(t, d)| (d - wave(*t)).abs())
        .fold(0.0, f64::max);
    assert!(worst < 2e-6, "cubic through 200 samples a cycle: {worst}");

    let gappy: Vec<f64> =
        (0..4000).filter(|i| !(1000..1005).contains(i)).map(|i| f64::from(i) / 1000.0).collect();
    let record = open_text(&component(&gappy, wave)).expect("read");
    assert_eq!((record.len(), record.sample_rate_hz), (4000, 1000.0));
    assert!(record.notes.iter().any(|note| note.starts_with("5 samples missing")), "{:?}", record.notes);
    assert_eq!(record.displacement_m[999], wave(0.999));
    assert_eq!(record.displacement_m[1005], wave(1.005));
}

#[test]
fn a_stamp_beyond_all_counting_is_refused() {
    let mut time: Vec<f64> = (0..4000).map(|i| f64::from(i) / 1000.0).collect();
    time.truncate(3990);
    time.extend([1e30, 2e30]);
    let refused = open_text(&component(&time, f64::sin)).expect_err("no record").to_string();
    assert!(refused.contains("sampling intervals"), "{refused}");
}

#[test]
fn numbers_that_are_none_are_bridged_and_said() {
    let mut text = String::from("time_s,displacement_m,force_n\n");
    for i in 0..200 {
        let force = if (50..53).contains(&i) { "nan".to_owned() } else { format!("{}", 2 * i) };
        text += &format!("{},{},{force}\n", f64::from(i) / 100.0, i);
    }
    let record = open_text(&text).expect("read");
    assert_eq!(record.force_n[48..55], [96.0, 98.0, 100.0, 102.0, 104.0, 106.0, 108.0]);
    assert!(record.notes.iter().any(|note| note.starts_with("3 samples of force_n")), "{:?}", record.notes);
}

#[test]
fn steps_are_found_where_there_are_some_and_only_there() {
    let mut marked = sample_record();
    marked.step.clear();
    steps::find(&mut marked);
    let found = marked.step_ranges();
    assert_eq!(found.len(), 3, "{found:?}");
    for ((index, range), (hz, start)) in found.iter().zip([(2.0, 0.0), (3.0, 5.0), (4.0, 25.0 / 3.0)]) {
        assert!(*index < 3);
        let cycles = range.len() as f64 / 512.0 * hz;
        assert!((8.0..10.5).contains(&cycles), "{hz} Hz: {cycles} cycles");
        assert!(range.start as f64 / 512.0 >= start - 0.3 / hz);
    }
    // A chirp and an irregular input have none.
    let mut other = Record::empty("other", Kind::Component, 512.0);
    let mut state = 1u64;
    let mut smooth = 0.0;
    for i in 0..20_000 {
        let t = f64::from(i) / 512.0;
        other.time_s.push(t);
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let noise = (state >> 33) as f64 / f64::from(1u32 << 31) - 0.5;
        smooth += 0.05 * (noise - smooth);
        other.displacement_m.push(smooth);
        other.force_n.push((TAU * (1.0 + 0.1 * t) * t).sin());
    }
    steps::find(&mut other);
    assert!(other.step.iter().all(|step| *step == -1));
    std::mem::swap(&mut other.displacement_m, &mut other.force_n);
    steps::find(&mut other);
    assert!(other.step.iter().all(|step| *step == -1), "{:?}", other.step_ranges());
}

#[test]
fn what_is_no_record_is_refused_with_its_reason() {
    for (text, word) in [
        ("", "empty"),
        ("time_s,displacement_m\n0,1\n1,2\n", "force"),
        ("1,2,3\n4,5,6\n", "name the columns"),
        ("time_s,displacement_m,force_n\n0,1,1\n", "advance"),
        ("time_s,displacement_m,force_n\n3,1,1\n2,1,1\n1,1,1\n0,1,1\n", "advance"),
        ("time_s,displacement_m,force_n\n0,1,1\n1,1,1\n2,1,1\n9e9,1,1\n", "sampling intervals"),
        ("displacement_m,force_n\n1,1\n2,2\n", "--rate"),
        ("time_s,table_acceleration_m_s2\n0,1\n1,1\n", "mass_acceleration_1_m_s2"),
    ] {
        let error = open_text(text).expect_err(text).to_string();
        assert!(error.contains(word), "{text:?}: {error}");
    }
}

#[test]
fn damaged_files_are_errors_or_shorter_records_and_never_panic() {
    let folder = folder();
    let record = sample_record();
    let mut state = 7u64;
    let mut random = move |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 33) as usize % below
    };
    for (to, name) in [
        (Format::Parquet, "a.parquet"),
        (Format::Csv, "a.csv"),
        (Format::Hdf5, "a.h5"),
        (Format::Mat, "a.mat"),
        (Format::Uff58, "a.uff"),
    ] {
        let path = folder.path().join(name);
        write(&record, &path, to).expect("written");
        let sound = std::fs::read(&path).expect("bytes");
        let hurt = folder.path().join(format!("hurt-{name}"));
        for round in 0..40 {
            let mut bytes = sound.clone();
            match round % 3 {
                0 => bytes.truncate(random(sound.len())),
                // Headers are at the start, Parquet's at the end.
                1 => (0..8).for_each(|_| bytes[random(sound.len().min(600))] = random(256) as u8),
                _ => (0..8).for_each(|_| {
                    let end = sound.len();
                    bytes[end - 1 - random(end.min(900))] = random(256) as u8;
                }),
            }
            std::fs::write(&hurt, &bytes).expect("written");
            if let Ok(found) = Record::open(&hurt, &ReadOptions::default()) {
                assert!(found.channels().all(|(_, values)| values.len() == found.len()));
            }
        }
    }
}
