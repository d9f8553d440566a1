//! The benches in wall time: rounds of the control thread and of `cyclictest` in turn, so that both see
//! the same machine; figures as ratios.

use super::cyclictest::Cyclictest;
use crate::cli::{CliError, Outcome};
use crate::config::Case;
use crate::control::session::{self, Finished, Pace};
use serde::Serialize;

/// What both benches in wall time take.
#[derive(Debug, clap::Args)]
pub(super) struct WallArgs {
    /// Length of one round, s.
    #[arg(long, default_value_t = 5.0)]
    seconds: f64,
    /// Rounds of each, in turn.
    #[arg(long, default_value_t = 3)]
    rounds: u32,
    /// CPU to pin both to; without it the last one.
    #[arg(long)]
    cpu: Option<usize>,
    /// Case that is run.
    #[arg(long, default_value = "B1-G2-0.05")]
    case: Case,
}

impl WallArgs {
    fn cpu(&self) -> usize {
        self.cpu.unwrap_or_else(|| std::thread::available_parallelism().map_or(0, |n| n.get() - 1))
    }
}

/// Both side by side at one rate.
#[derive(Debug, Serialize)]
struct Comparison {
    rate_hz: f64,
    real_time: String,
    cycles: u64,
    lost_samples: u64,
    slips: u64,
    slips_per_100k: f64,
    /// Slips by the phase that took the time.
    slips_by_phase: std::collections::BTreeMap<String, u64>,
    /// Mean over the rounds, us: p50, p99, p99.9.
    wake_up_us: [f64; 3],
    step_p50_us: f64,
    step_p999_us: f64,
    simulate_p50_us: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    cyclictest: Option<Yardstick>,
}

#[derive(Debug, Serialize)]
struct Yardstick {
    cycles: u64,
    slips: u64,
    slips_per_100k: f64,
    /// Mean over the rounds, us: p50, p99, p99.9.
    wake_up_us: [f64; 3],
    /// Control thread over `cyclictest`: p50, p99, p99.9.
    ratios: [f64; 3],
}

const SHARES: [f64; 3] = [0.5, 0.99, 0.999];

fn per_100k(slips: u64, cycles: u64) -> f64 {
    1e5 * slips as f64 / cycles.max(1) as f64
}

/// Runs the rounds at one rate.
fn compare(args: &WallArgs, rate_hz: f64) -> Result<Comparison, CliError> {
    if !(100.0..=50_000.0).contains(&rate_hz) {
        return Err(CliError::usage(format!("{rate_hz} Hz; allowed: 100 to 50000 Hz")));
    }
    let interval_us = (1e6 / rate_hz).round() as u64;
    let rounds = f64::from(args.rounds.max(1));
    let mut yardstick: Option<(Cyclictest, [f64; 3])> = None;
    let mut all = Comparison {
        rate_hz,
        real_time: String::new(),
        cycles: 0,
        lost_samples: 0,
        slips: 0,
        slips_per_100k: 0.0,
        slips_by_phase: std::collections::BTreeMap::new(),
        wake_up_us: [0.0; 3],
        step_p50_us: 0.0,
        step_p999_us: 0.0,
        simulate_p50_us: 0.0,
        cyclictest: None,
    };
    for _ in 0..args.rounds.max(1) {
        if let Some(run) = Cyclictest::run(interval_us, args.seconds, args.cpu())? {
            let (sum, means) = yardstick.get_or_insert_with(Default::default);
            for (mean, share) in means.iter_mut().zip(SHARES) {
                *mean += run.quantile_us(share) / rounds;
            }
            sum.add(&run);
        }
        round(args, rate_hz, rounds, &mut all)?;
    }
    all.slips_per_100k = per_100k(all.slips, all.cycles);
    all.cyclictest = yardstick.map(|(sum, means)| {
        let slips = sum.slips(interval_us);
        Yardstick {
            cycles: sum.cycles(),
            slips,
            slips_per_100k: per_100k(slips, sum.cycles()),
            wake_up_us: means,
            ratios: std::array::from_fn(|i| all.wake_up_us[i] / means[i].max(0.5)),
        }
    });
    Ok(all)
}

/// One round of the control thread, recording included.
fn round(args: &WallArgs, rate_hz: f64, rounds: f64, all: &mut Comparison) -> Result<(), CliError> {
    let setup = super::dwell(&args.case, rate_hz, args.seconds);
    let out = std::env::temp_dir().join(format!("shaketable-bench-{}", std::process::id()));
    let pace = Pace::Wall { cpu: Some(args.cpu()), require_realtime: false };
    let (plan, _faults) = setup.plan(&out, pace).map_err(CliError::usage)?;
    let session = session::start(plan).map_err(CliError::failed)?;
    let Finished { manifest, timing, folder, .. } = session.wait(|_| {}).map_err(CliError::failed)?;
    let events = std::fs::read_to_string(folder.events()).unwrap_or_default();
    for event in events.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok()) {
        if event["event"] == "slip" {
            *all.slips_by_phase.entry(event["phase"].as_str().unwrap_or("?").to_owned()).or_default() += 1;
        }
    }
    // The folder was only made to have recording in the measurement.
    std::fs::remove_dir_all(&out).map_err(CliError::failed)?;
    let wake = &timing.wake_up_latency;
    all.real_time = manifest.real_time.as_ref().map(|state| state.line()).unwrap_or_default();
    all.cycles += timing.cycles;
    all.lost_samples += manifest.lost.samples;
    all.slips += timing.slips;
    for (mean, value) in all.wake_up_us.iter_mut().zip([wake.p50_us, wake.p99_us, wake.p999_us]) {
        *mean += value / rounds;
    }
    all.step_p50_us += timing.step.p50_us / rounds;
    all.step_p999_us += timing.step.p999_us / rounds;
    all.simulate_p50_us += timing.phases.first().map_or(0.0, |phase| phase.times.p50_us) / rounds;
    Ok(())
}

fn show(comparison: &Comparison) {
    let c = comparison;
    println!("{:.0} Hz, {}", c.rate_hz, c.real_time);
    println!(
        "{:<16} {:>9} {:>9} {:>9} {:>8} {:>12}",
        "wake-up (us)", "p50", "p99", "p99.9", "slips", "per 100,000"
    );
    let line = |name: &str, us: &[f64; 3], slips: u64, rate: f64| {
        println!("{name:<16} {:>9.1} {:>9.1} {:>9.1} {slips:>8} {rate:>12.1}", us[0], us[1], us[2]);
    };
    line("control thread", &c.wake_up_us, c.slips, c.slips_per_100k);
    match &c.cyclictest {
        Some(yardstick) => {
            line("cyclictest", &yardstick.wake_up_us, yardstick.slips, yardstick.slips_per_100k);
            let [p50, p99, p999] = yardstick.ratios;
            println!("{:<16} {p50:>9.2} {p99:>9.2} {p999:>9.2}", "ratio");
        }
        None => println!("cyclictest is not installed (package rt-tests)"),
    }
    println!(
        "step p50 {:.2} us, p99.9 {:.2} us (simulation of the rig {:.2} us more); lost samples: {}; slips by phase: {:?}",
        c.step_p50_us, c.step_p999_us, c.simulate_p50_us, c.lost_samples, c.slips_by_phase
    );
}

/// `bench latency`.
pub(super) fn latency(args: &WallArgs, rate_hz: f64, json: bool) -> Result<Outcome, CliError> {
    let comparison = compare(args, rate_hz)?;
    if json {
        println!("{}", serde_json::to_string(&comparison).map_err(CliError::failed)?);
    } else {
        show(&comparison);
    }
    Ok(Outcome::Done)
}

/// Keeps up: nothing lost, and slips no more frequent than those of `cyclictest`, give or take what so few
/// events scatter by (two standard deviations of both counts).
fn keeps_up(c: &Comparison) -> bool {
    let allowed = c.cyclictest.as_ref().map_or(f64::INFINITY, |yardstick| {
        let scale = c.cycles as f64 / yardstick.cycles.max(1) as f64;
        let expected = yardstick.slips as f64 * scale;
        expected + 2.0 * (expected * scale + expected + 1.0).sqrt()
    });
    c.lost_samples == 0 && c.slips as f64 <= allowed
}

/// `bench rate`.
pub(super) fn rates(args: &WallArgs, rates_hz: &[f64], json: bool) -> Result<Outcome, CliError> {
    let mut comparisons = Vec::with_capacity(rates_hz.len());
    for &rate_hz in rates_hz {
        let comparison = compare(args, rate_hz)?;
        if !json {
            show(&comparison);
            println!();
        }
        comparisons.push(comparison);
    }
    let highest = comparisons.iter().filter(|c| keeps_up(c)).map(|c| c.rate_hz).fold(0.0, f64::max);
    if json {
        println!("{}", serde_json::json!({ "highest_rate_hz": highest, "rates": comparisons }));
    } else {
        println!("keeps up at {highest:.0} Hz: nothing lost, slips no more frequent than cyclictest's");
    }
    Ok(Outcome::Done)
}
