//! Files as they should not be: damaged, cut, with holes, with headers that lie.

use super::tests::{folder, open_text, sample_record};
use super::*;
use proptest::prelude::*;

const FORMATS: [(Format, &str); 5] = [
    (Format::Parquet, "a.parquet"),
    (Format::Csv, "a.csv"),
    (Format::Hdf5, "a.h5"),
    (Format::Mat, "a.mat"),
    (Format::Uff58, "a.uff"),
];

/// What may happen to a file.
#[derive(Clone, Debug)]
enum Damage {
    Cut(f64),
    Byte(f64, u8),
    /// A field of a header: eight bytes at once, mostly of the sizes that lengths and offsets have.
    Word(f64, u64),
    Erase(f64, u16),
    Repeat(f64, u16),
    Zero(f64, u16),
}

/// A place in the file, from 0 to 1: more at the ends, where headers and footers are.
fn place() -> impl Strategy<Value = f64> {
    prop_oneof![0.0..1.0f64, 0.0..0.02f64, 0.98..1.0f64]
}

fn damage() -> impl Strategy<Value = Damage> {
    let word = prop_oneof![
        any::<u64>(),
        Just(u64::MAX),
        Just(u64::MAX >> 1),
        Just(1 << 32),
        Just(1 << 31),
        (0..1u64 << 40),
        Just(0)
    ];
    prop_oneof![
        place().prop_map(Damage::Cut),
        (place(), any::<u8>()).prop_map(|(at, byte)| Damage::Byte(at, byte)),
        (place(), word).prop_map(|(at, word)| Damage::Word(at, word)),
        (place(), 1..2000u16).prop_map(|(at, count)| Damage::Erase(at, count)),
        (place(), 1..2000u16).prop_map(|(at, count)| Damage::Repeat(at, count)),
        (place(), 1..5000u16).prop_map(|(at, count)| Damage::Zero(at, count)),
    ]
}

fn hurt(bytes: &mut Vec<u8>, damage: &Damage) {
    let (share, count) = match damage {
        Damage::Cut(at) | Damage::Byte(at, _) => (*at, 1),
        Damage::Word(at, _) => (*at, 8),
        Damage::Erase(at, count) | Damage::Repeat(at, count) | Damage::Zero(at, count) => {
            (*at, *count as usize)
        }
    };
    let from = ((share * bytes.len() as f64) as usize).min(bytes.len());
    let to = (from + count).min(bytes.len());
    match damage {
        Damage::Cut(_) => bytes.truncate(from),
        Damage::Byte(_, byte) => bytes[from..to].fill(*byte),
        Damage::Word(_, word) => {
            for (byte, new) in bytes[from..to].iter_mut().zip(word.to_le_bytes()) {
                *byte = new;
            }
        }
        Damage::Erase(..) => drop(bytes.drain(from..to)),
        Damage::Repeat(..) => {
            let part = bytes[from..to].to_vec();
            bytes.splice(to..to, part);
        }
        Damage::Zero(..) => bytes[from..to].fill(0),
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, ..ProptestConfig::default() })]

    #[test]
    fn no_damage_brings_the_reader_down(format in 0..FORMATS.len(), damages in prop::collection::vec(damage(), 1..6)) {
        thread_local! {
            static SOUND: Vec<Vec<u8>> = FORMATS.map(|(to, name)| {
                let folder = folder();
                let path = folder.path().join(name);
                write(&sample_record(), &path, to).expect("written");
                std::fs::read(&path).expect("bytes")
            }).to_vec();
        }
        let mut bytes = SOUND.with(|sound| sound[format].clone());
        for damage in &damages {
            hurt(&mut bytes, damage);
        }
        let folder = folder();
        let path = folder.path().join(FORMATS[format].1);
        std::fs::write(&path, &bytes).expect("written");
        match Record::open(&path, &ReadOptions::default()) {
            Ok(found) => {
                prop_assert!(found.channels().all(|(_, values)| values.len() == found.len()));
                prop_assert!(found.channels().all(|(_, values)| values.iter().all(|value| value.is_finite())));
                prop_assert!(found.step.is_empty() || found.step.len() == found.len());
                prop_assert!(found.sample_rate_hz.is_finite() && found.sample_rate_hz > 0.0);
            }
            Err(error) => {
                let said = error.to_string();
                prop_assert!(said.contains(FORMATS[format].1), "no file in: {said}");
            }
        }
    }
}

/// Peak of the memory of this process, bytes, as Linux counts it.
fn peak_memory_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status.lines().find(|line| line.starts_with("VmHWM:")).expect("there");
    line.split_whitespace().nth(1).and_then(|kib| kib.parse::<u64>().ok()).expect("a number") << 10
}

#[test]
fn ten_gigabytes_of_nothing_are_an_error_and_take_no_memory() {
    let folder = folder();
    for (to, name) in FORMATS {
        let path = folder.path().join(name);
        write(&sample_record(), &path, to).expect("written");
        let file = std::fs::File::options().write(true).open(&path).expect("opens");
        file.set_len(10 << 30).expect("a hole");
        // HDF5 knows its own length: a hole behind it is no harm. The others end in the hole.
        match Record::open(&path, &ReadOptions::default()) {
            Ok(found) => assert_eq!(found.len(), sample_record().len(), "{name}"),
            Err(error) => assert!(!error.to_string().is_empty(), "{name}"),
        }
    }
    assert!(peak_memory_bytes() < 2 << 30, "{} MB", peak_memory_bytes() >> 20);
}

#[test]
fn a_header_that_claims_more_than_the_memory_is_refused() {
    let folder = folder();
    let path = folder.path().join("claims.h5");
    let mut file = hdf5_pure::FileBuilder::new();
    file.create_dataset("time_s").with_f64_data(&[0.0; 64]);
    file.write(&path).expect("written");
    let mut bytes = std::fs::read(&path).expect("bytes");
    // The extent of the data set, wherever it stands: the only word of value 64 in the file.
    let found: Vec<usize> =
        (0..bytes.len() - 8).filter(|&at| bytes[at..at + 8] == 64u64.to_le_bytes()).collect();
    assert!(!found.is_empty());
    for at in found {
        bytes[at..at + 8].copy_from_slice(&(1u64 << 45).to_le_bytes());
    }
    std::fs::write(&path, bytes).expect("written");
    let error = Record::open(&path, &ReadOptions::default()).expect_err("too much").to_string();
    assert!(error.contains("claims.h5"), "{error}");
}

#[test]
fn a_text_without_lines_is_refused_with_its_line() {
    let mut text = String::from("time_s,displacement_m,force_n\n0,1,2\n");
    text.extend(std::iter::repeat_n('7', lines::LONGEST + 1));
    let error = open_text(&text).expect_err("no text").to_string();
    assert!(error.contains("line 3"), "{error}");
}

#[test]
fn a_description_names_columns_units_signs_kind_and_rate() {
    let folder = folder();
    let path = folder.path().join("damper.csv");
    std::fs::write(&path, "LVDT;load cell\n1,5;-2\n2,5;4\n0,5;1\n").expect("written");
    let description = folder.path().join("columns.toml");
    let text = |unit: &str| {
        format!(
            "kind = \"force\"\nsample_rate_hz = 50.0\n\
             [[columns]]\nname = \"LVDT\"\nrole = \"displacement_m\"\nunit = \"{unit}\"\n\
             [[columns]]\nname = \"load cell\"\nrole = \"force_n\"\nunit = \"kN\"\nsign = -1\ncalibration = 2.5\n"
        )
    };
    std::fs::write(&description, text("mm")).expect("written");
    let mut options = ReadOptions::default();
    options.describe(&description).expect("understood");
    let record = Record::open(&path, &options).expect("read");
    assert_eq!((record.kind, record.sample_rate_hz), (Kind::Force, 50.0));
    assert_eq!(record.displacement_m, [1.5e-3, 2.5e-3, 0.5e-3]);
    assert_eq!(record.force_n, [5000.0, -10000.0, -2500.0]);
    for (wrong, said) in [(text("kN"), "no unit"), (text("mm").replace("sign = -1", "sgin = -1"), "sgin")] {
        std::fs::write(&description, wrong).expect("written");
        let error = ReadOptions::default().describe(&description).expect_err("wrong").to_string();
        assert!(error.contains(said), "{error}");
    }
}

#[test]
fn the_kind_and_the_units_travel_with_every_format() {
    let folder = folder();
    let base = sample_record();
    let mut record = Record::empty("made", Kind::Force, base.sample_rate_hz);
    record.time_s = base.time_s.clone();
    record.force_n = base.table_acceleration_m_s2.clone();
    record.displacement_m = base.relative_displacement_m.clone();
    record.step = base.step.clone();
    for (to, name) in FORMATS {
        let path = folder.path().join(name);
        write(&record, &path, to).expect("written");
        let again = Record::open(&path, &ReadOptions::default()).expect("read");
        // Displacement and force alone would be taken for a component.
        assert_eq!((again.kind, again.notes.is_empty()), (Kind::Force, true), "{name}: {:?}", again.notes);
    }
}

#[test]
fn a_unit_that_the_file_states_is_converted_and_said() {
    let folder = folder();
    let path = folder.path().join("mm.h5");
    let mut file = hdf5_pure::FileBuilder::new();
    file.set_attr("sample_rate_hz", hdf5_pure::AttrValue::F64(100.0));
    for (name, unit) in [("displacement_m", "mm"), ("force_n", "V")] {
        let values: Vec<f64> = (0..100).map(f64::from).collect();
        let dataset = file.create_dataset(name).with_f64_data(&values);
        dataset.set_attr("unit", hdf5_pure::AttrValue::String(unit.to_owned()));
    }
    file.write(&path).expect("written");
    let record = Record::open(&path, &ReadOptions::default()).expect("read");
    assert_eq!((record.displacement_m[3], record.force_n[3]), (3e-3, 3.0));
    assert!(
        record.notes.iter().any(|note| note.contains("mm") && note.contains("converted")),
        "{:?}",
        record.notes
    );
    assert!(record.notes.iter().any(|note| note.contains("`V`")), "{:?}", record.notes);
}
