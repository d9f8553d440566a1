//! `bench model`: how long the specimen model takes, by solver and by what is wanted.

use super::PAPERS_MODEL;
use crate::cli::reading::read_model;
use crate::cli::{CliError, Outcome};
use crate::model::{EffectSpec, Options, SweepHistory, build, simulate_sweep, sweep_history, sweep_peaks};
use crate::sweep::{Schedule, SweepSpec, Transition};
use crate::units::SAMPLE_RATE_HZ;
use std::hint::black_box;
use std::time::Instant;

/// Repeats of each figure; the smallest counts.
const REPEATS: usize = 5;

/// Times the model on the paper's sweep (B1-G2 at 0.05 g).
///
/// # Errors
/// [`CliError::Usage`] when a configuration is refused.
pub fn execute(json: bool) -> Result<Outcome, CliError> {
    let model = read_model(PAPERS_MODEL)?;
    let mut smooth = model.clone();
    smooth.effects.push(EffectSpec {
        name: "cubic-stiffness".into(),
        expression: None,
        parameters: [("k3_n_m3".to_owned(), 1e6)].into(),
    });
    let sweep = SweepSpec { transition: Transition::None, acceleration_g: 0.05, ..SweepSpec::paper() };
    let schedule = Schedule::new(&sweep).map_err(CliError::usage)?;
    let (steps, dt, options) = (schedule.steps(), 1.0 / SAMPLE_RATE_HZ, Options::default());
    let mut input = Vec::new();
    simulate_sweep(&model, steps, dt, &options, &mut |_, _, a, _| input.push(a)).map_err(CliError::usage)?;

    let mut history = SweepHistory::default();
    let sweep_with_histories_s =
        fastest(|| sweep_history(&model, steps, dt, &options, &mut history).map(|r| r.samples))?;
    let sweep_peaks_s = fastest(|| sweep_peaks(&model, steps, dt, &options).map(|r| r.samples))?;
    let sampled_s = fastest(|| {
        let mut specimen = build(&model, dt)?;
        Ok(input.iter().filter(|a| specimen.step(**a).regime.right_contact).count())
    })?;
    let general_sweep_s =
        fastest(|| sweep_history(&smooth, steps, dt, &options, &mut history).map(|r| r.samples))?;
    let sampled_ns_per_sample = 1e9 * sampled_s / input.len() as f64;
    if json {
        let figures = serde_json::json!({
            "sweep_with_histories_s": sweep_with_histories_s,
            "sweep_peaks_s": sweep_peaks_s,
            "sampled_ns_per_sample": sampled_ns_per_sample,
            "general_sweep_s": general_sweep_s,
        });
        println!("{figures}");
    } else {
        println!("sweep with histories   {:>8.2} ms", 1e3 * sweep_with_histories_s);
        println!("sweep, peaks only      {:>8.2} ms", 1e3 * sweep_peaks_s);
        println!("sampled input          {sampled_ns_per_sample:>8.2} ns a sample");
        println!("general solver, sweep  {:>8.2} ms", 1e3 * general_sweep_s);
    }
    Ok(Outcome::Done)
}

fn fastest(mut run: impl FnMut() -> Result<usize, crate::model::ModelError>) -> Result<f64, CliError> {
    let mut best = f64::INFINITY;
    for _ in 0..REPEATS {
        let began = Instant::now();
        black_box(run().map_err(CliError::usage)?);
        best = best.min(began.elapsed().as_secs_f64());
    }
    Ok(best)
}
