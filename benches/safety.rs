//! Cost of all detectors together, and of the whole guard, a sample.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use shaketable::control::setup::{Setup, model_of_case};
use shaketable::rig::{Rig, RigSpec};
use shaketable::safety::{self, Observation, Period, SafetySpec, Watch};
use shaketable::sweep::{Generator, SweepSpec};

/// Samples of a cell with many contacts, and what belongs to them.
fn observations(setup: &Setup) -> Vec<Observation> {
    let mut rig = setup.simulated_rig().expect("built");
    let mut model = setup.onboard().expect("model");
    let mut generator = Generator::new(&setup.schedule().expect("schedule"), setup.rig.sample_rate_hz);
    let mut reference = generator.next_point();
    let mut observations = Vec::new();
    while observations.len() < 20_480 {
        rig.advance();
        while let Ok(Some(sample)) = rig.read() {
            let response = model.follow(&sample);
            observations.push(Observation { sample, reference, response });
        }
        reference = generator.next_point();
        rig.write(&reference.command).expect("a healthy rig");
    }
    observations
}

fn setup() -> Setup {
    let case = "B4-G1-0.05".parse().expect("a case");
    let model = model_of_case(&case);
    let sweep = SweepSpec::paper();
    Setup {
        rig: RigSpec::default(),
        sweep,
        specimen: model.clone(),
        model,
        case: Some(case),
        safety: None,
        seed: 1,
        name: "bench".into(),
    }
}

fn detectors(c: &mut Criterion) {
    let setup = setup();
    let observations = observations(&setup);
    let spec = SafetySpec::built_in().expect("valid");
    let known = safety::Setup::new(setup.rig.sample_rate_hz, 1.3e-3, setup.rig.capacity(), &setup.model);
    let mut group = c.benchmark_group("safety");
    group.throughput(Throughput::Elements(observations.len() as u64));
    group.bench_function("detectors", |b| {
        b.iter(|| {
            let mut watch = Watch::new(&spec, &known);
            for observation in &observations {
                watch.observe(observation);
                watch.period(&Period { samples: 1, ..Period::default() });
            }
            watch.findings()
        });
    });
    group.bench_function("guard", |b| {
        b.iter(|| {
            let mut guard = setup.guard(1.3e-3).expect("valid");
            let mut generator =
                Generator::new(&setup.schedule().expect("schedule"), setup.rig.sample_rate_hz);
            for observation in &observations {
                guard.observe(observation);
                guard.decide(&Period { samples: 1, ..Period::default() }, &mut generator);
            }
            guard.state()
        });
    });
    group.finish();
}

criterion_group!(benches, detectors);
criterion_main!(benches);
