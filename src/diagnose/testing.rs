//! Records for tests of fits and diagnosis: a coarse sweep as the instruments of the rig would show it; and models fitted to them.

use super::candidates;
use super::engine;
use super::search::Searcher;
use super::trial::{self, Trial};
use crate::identify::least_squares::Settings;
use crate::identify::refit::Refit;
use crate::model::effects::CATALOGUE;
use crate::model::{EffectSpec, ModelSpec, Observer, Options, simulate_sweep};
use crate::record::{Kind, Record};
use crate::sweep::{Schedule, SweepSpec, Transition};
use rand::{SeedableRng, prelude::Distribution};

const DT: f64 = 1.0 / 2048.0;

/// What the instruments would have seen of a model, with the noise of the rig's sensors.
pub fn seen(spec: &ModelSpec, seed: u64) -> Record {
    let mut sweep = SweepSpec { transition: Transition::None, ..SweepSpec::paper() };
    (sweep.start_hz, sweep.stop_hz, sweep.step_hz, sweep.cycles) = (Some(0.5), Some(2.3), Some(0.3), 10);
    seen_over(spec, &sweep, seed)
}

/// The same of fewer steps, where a few tell what is asked.
pub fn seen_briefly(spec: &ModelSpec, seed: u64) -> Record {
    let mut sweep = SweepSpec { transition: Transition::None, ..SweepSpec::paper() };
    (sweep.start_hz, sweep.stop_hz, sweep.step_hz, sweep.cycles) = (Some(0.7), Some(2.3), Some(0.4), 8);
    seen_over(spec, &sweep, seed)
}

/// The same over a sweep.
pub fn seen_over(spec: &ModelSpec, sweep: &SweepSpec, seed: u64) -> Record {
    let schedule = Schedule::new(sweep).expect("valid");
    let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
    let normal = rand_distr::Normal::new(0.0, 1.0).expect("valid");
    let mut hiss = |sigma: f64| sigma * normal.sample(&mut random);
    let mut observer = Observer::new(spec, DT).expect("builds");
    let mut record = Record::empty("test", Kind::Base, 1.0 / DT);
    let options = Options::default();
    simulate_sweep(spec, schedule.steps(), DT, &options, &mut |sample, step, table, response| {
        let now = observer.observe(response);
        record.time_s.push(sample as f64 * DT);
        record.table_displacement_m.push(0.0);
        record.table_acceleration_m_s2.push(table + hiss(0.01));
        record.mass_acceleration_1_m_s2.push(now.mass_acceleration_1_m_s2 + hiss(0.01));
        record.mass_acceleration_2_m_s2.push(now.mass_acceleration_2_m_s2 + hiss(0.01));
        record.relative_displacement_m.push(now.relative_displacement_m + hiss(3e-5));
        record.step.push(step as i32);
    })
    .expect("runs");
    record
}

/// The force that a motion imposed on a model takes, steps of several frequencies and amplitudes, with some noise on both.
pub fn imposed(spec: &ModelSpec, seed: u64) -> Record {
    const RATE_HZ: f64 = 1000.0;
    const CYCLES: f64 = 6.0;
    let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
    let normal = rand_distr::Normal::new(0.0, 1.0).expect("valid");
    let mut hiss = |sigma: f64| sigma * normal.sample(&mut random);
    let mut specimen = crate::model::build(spec, 1.0 / RATE_HZ).expect("builds");
    let mut record = Record::empty("test", Kind::Component, RATE_HZ);
    let steps = [(0.7, 0.014), (1.1, 0.016), (1.9, 0.015), (2.6, 0.013), (0.9, 0.015), (1.5, 0.014)];
    for (step, (frequency_hz, amplitude_m)) in (0i32..).zip(steps) {
        let w = std::f64::consts::TAU * frequency_hz;
        for i in 0..(CYCLES * RATE_HZ / frequency_hz) as usize {
            let (sin, cos) = (w * i as f64 / RATE_HZ).sin_cos();
            let force_n = -spec.mass_kg
                * specimen.impose(amplitude_m * sin, amplitude_m * w * cos).mass_acceleration_m_s2;
            record.time_s.push(record.time_s.len() as f64 / RATE_HZ);
            record.displacement_m.push(amplitude_m * sin + hiss(2e-6));
            record.force_n.push(force_n + hiss(1.0));
            record.step.push(step);
        }
    }
    record
}

/// A diagnosis that tries such effects alone.
pub fn among(names: &[&str]) -> engine::Options {
    let without = CATALOGUE.iter().map(|effect| effect.name).filter(|name| !names.contains(name)).collect();
    engine::Options { without, ..engine::Options::default() }
}

/// A fitted model with effects more, fitted by the response.
pub fn with(searcher: &Searcher<'_>, base: &Trial, effects: &[EffectSpec], settings: Settings) -> Trial {
    let scales = candidates::scales(&base.refit.spec, searcher.motion);
    let (mut spec, mut numbers) = (base.refit.spec.clone(), base.refit.numbers.clone());
    for effect in effects {
        spec = candidates::beside(&spec, effect);
        numbers.add_effect(&spec, spec.effects.len() - 1, &scales);
    }
    let names = effects.iter().map(|effect| effect.name.clone()).collect();
    let trial = Trial { names, refit: Refit { spec, numbers, ..base.refit.clone() }, ..base.clone() };
    trial::respond(searcher.measured.as_ref().expect("seen"), &trial, None, settings).expect("fits")
}
