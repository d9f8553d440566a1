//! `bench compare`: the parts of a comparison of a whole sweep, with the record in memory.

use super::PAPERS_MODEL;
use crate::cli::reading::read_model;
use crate::cli::{CliError, Outcome};
use crate::compare::{compare, noise_floor, windows};
use crate::model::{ModelSpec, Options, build, simulate_sweep};
use crate::record::{Kind, Record, quality};
use crate::report::comparison;
use crate::sweep::{Schedule, SweepSpec, Transition};
use crate::units::SAMPLE_RATE_HZ;
use rand::{Rng, SeedableRng};
use std::hint::black_box;
use std::time::Instant;

/// Repeats of each figure; the smallest counts.
const REPEATS: usize = 5;

/// Times a comparison of the paper's sweep (B1-G2 at 0.05 g) with the noise of the sensors.
///
/// # Errors
/// [`CliError::Usage`] when a configuration is refused.
pub fn execute(json: bool) -> Result<Outcome, CliError> {
    let model = read_model(PAPERS_MODEL)?;
    let record = sweep(&model)?;
    let compared = compare(&record, &model).map_err(CliError::failed)?;
    let mut specimen = build(&model, 1.0 / SAMPLE_RATE_HZ).map_err(CliError::usage)?;
    let parts = [
        ("compare_s", fastest(|| compare(&record, &model).map_or(0.0, |c| c.mass_kg))),
        ("quality_s", fastest(|| quality::examine(&record).len() as f64)),
        ("windows_s", fastest(|| windows(&record).len() as f64)),
        ("noise_floor_s", fastest(|| noise_floor(&record).input)),
        (
            "simulate_s",
            fastest(|| {
                let drive = record.table_acceleration_m_s2.iter();
                drive.map(|a| specimen.step(*a).relative_displacement_m).sum()
            }),
        ),
        ("page_s", fastest(|| comparison::page(&compared).map_or(0, |page| page.html().len()) as f64)),
    ];
    if json {
        let mut figures = serde_json::Map::new();
        figures.insert("samples".to_owned(), record.len().into());
        figures.extend(parts.iter().map(|(name, seconds)| ((*name).to_owned(), (*seconds).into())));
        println!("{}", serde_json::Value::Object(figures));
    } else {
        println!("{} samples; times in ms; the parts of `compare` run side by side", record.len());
        for (name, seconds) in parts {
            println!("{:<14} {:>8.1}", name.trim_end_matches("_s"), 1e3 * seconds);
        }
    }
    Ok(Outcome::Done)
}

fn fastest(mut run: impl FnMut() -> f64) -> f64 {
    let mut best = f64::INFINITY;
    for _ in 0..REPEATS {
        let began = Instant::now();
        black_box(run());
        best = best.min(began.elapsed().as_secs_f64());
    }
    best
}

/// The record of an ideal table with noisy sensors.
pub(super) fn sweep(model: &ModelSpec) -> Result<Record, CliError> {
    let sweep = SweepSpec { transition: Transition::None, acceleration_g: 0.05, ..SweepSpec::paper() };
    let schedule = Schedule::new(&sweep).map_err(CliError::usage)?;
    let mut record = Record::empty("bench", Kind::Base, SAMPLE_RATE_HZ);
    let mut random = rand_pcg::Pcg64::seed_from_u64(1);
    let mut hiss = |sigma: f64| {
        let x: f64 = random.sample(rand_distr::StandardNormal);
        sigma * x
    };
    let dt = 1.0 / SAMPLE_RATE_HZ;
    simulate_sweep(model, schedule.steps(), dt, &Options::default(), &mut |sample, step, table, response| {
        record.time_s.push(sample as f64 * dt);
        record.table_acceleration_m_s2.push(table + hiss(0.01));
        record.mass_acceleration_1_m_s2.push(response.mass_acceleration_m_s2 + hiss(0.01));
        record.mass_acceleration_2_m_s2.push(response.mass_acceleration_m_s2 + hiss(0.01));
        record.relative_displacement_m.push(response.relative_displacement_m + hiss(3e-5));
        record.step.push(i32::try_from(step).unwrap_or(-1));
    })
    .map_err(CliError::usage)?;
    Ok(record)
}
