//! Reading a full sweep back: a million samples of time, five channels and the step mark, from each format. Throughput is
//! of the decoded numbers (8 bytes each), on one core.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use shaketable::record::data::{self, Format, ReadOptions};
use shaketable::record::{Kind, Record};
use std::f64::consts::TAU;

const SAMPLES: usize = 1_000_000;
const RATE_HZ: f64 = 2048.0;

/// A sweep with noise, so that nothing compresses better than a measurement does.
fn sweep() -> Record {
    let mut record = Record::empty("bench", Kind::Base, RATE_HZ);
    let mut state = 1u64;
    let mut noise = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / f64::from(1u32 << 31) - 0.5
    };
    let mut phase = 0.0f64;
    for i in 0..SAMPLES {
        let step = i / (SAMPLES / 92);
        phase += TAU * (0.5 + 0.05 * step as f64) / RATE_HZ;
        let s = phase.sin();
        record.time_s.push(i as f64 / RATE_HZ);
        record.table_displacement_m.push(0.01 * s + 1e-6 * noise());
        record.table_acceleration_m_s2.push(0.5 * s + 1e-3 * noise());
        record.mass_acceleration_1_m_s2.push(0.7 * s + 1e-3 * noise());
        record.mass_acceleration_2_m_s2.push(0.7 * s + 1e-3 * noise());
        record.relative_displacement_m.push(0.005 * s + 1e-6 * noise());
        record.step.push(step as i32);
    }
    record
}

fn reading(criterion: &mut Criterion) {
    let folder = tempfile::tempdir().expect("folder");
    let record = sweep();
    let mut group = criterion.benchmark_group("read 1M x 6");
    group.throughput(Throughput::Bytes(6 * 8 * SAMPLES as u64)).sample_size(10);
    for (format, name) in [
        (Format::Hdf5, "hdf5.h5"),
        (Format::Parquet, "parquet.parquet"),
        (Format::Mat, "mat.mat"),
        (Format::Csv, "csv.csv"),
        (Format::Uff58, "uff58.uff"),
    ] {
        let path = folder.path().join(name);
        data::write(&record, &path, format).expect("written");
        group.bench_function(name.split('.').next().unwrap_or(name), |bencher| {
            bencher.iter(|| Record::open(&path, &ReadOptions::default()).expect("read"));
        });
    }
    group.finish();
}

criterion_group!(benches, reading);
criterion_main!(benches);
