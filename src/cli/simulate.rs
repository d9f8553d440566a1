//! `simulate`: the response of a model to a sweep on an ideal table.

use super::{CliError, Outcome};
use crate::config::{ConfigError, builtin::find};
use crate::model::{ModelSpec, Observer, Options, Response, Specimen, StepPeaks, build_with, simulate_sweep};
use crate::record::data::{self, Format};
use crate::record::{Kind, Record};
use crate::sweep::{Direction, Generator, Schedule, Step, SweepSpec, Transition};
use crate::units::SAMPLE_RATE_HZ;
use std::f64::consts::TAU;
use std::path::PathBuf;
use std::time::Instant;

/// Response of a model to a sweep on an ideal table.
#[derive(clap::Args)]
pub struct Args {
    /// Model, by name or file
    #[arg(long)]
    model: String,
    /// Sweep, by name or file
    #[arg(long, default_value = "andreaus-2020")]
    sweep: String,
    /// Peak table acceleration in g, in place of the sweep's
    #[arg(long, allow_negative_numbers = true)]
    ag: Option<f64>,
    /// Write every sample to this file; its name tells the format
    #[arg(long)]
    samples: Option<PathBuf>,
    /// Local error allowed where the model has no closed form
    #[arg(long, default_value_t = 1e-8)]
    tolerance: f64,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Simulates, writes the samples, reports.
///
/// # Errors
/// [`CliError::Usage`] for a refused configuration, [`CliError::Failed`] when a file cannot be written.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    let (model, schedule) = setup(&args)?;
    let options = Options { tolerance: args.tolerance };
    let format = match &args.samples {
        None => None,
        Some(path) => Some(Format::of_name(path).ok_or_else(|| {
            CliError::usage(format!("{}: the name tells no format (try .parquet)", path.display()))
        })?),
    };
    let began = Instant::now();
    let mut columns = match format {
        Some(_) => Some(Columns::new(&model)?),
        None => None,
    };
    let (peaks, duration_s) = if schedule.transition() == Transition::None {
        ideal(&model, &schedule, &options, columns.as_mut())?
    } else {
        smooth(&model, &schedule, &options, columns.as_mut())?
    };
    let wall_s = began.elapsed().as_secs_f64();
    if let (Some(path), Some(format), Some(columns)) = (&args.samples, format, columns) {
        data::write(&columns.record, path, format).map_err(CliError::failed)?;
    }
    report(&args, schedule.steps(), &peaks, duration_s, wall_s);
    Ok(Outcome::Done)
}

fn setup(args: &Args) -> Result<(ModelSpec, Schedule), CliError> {
    let usage = |error: ConfigError| CliError::Usage(error.into());
    let model: ModelSpec = find("models", &args.model).and_then(|source| source.parse()).map_err(usage)?;
    let mut sweep: SweepSpec =
        find("sweeps", &args.sweep).and_then(|source| source.parse()).map_err(usage)?;
    if let Some(ag) = args.ag {
        if !(1e-6..=10.0).contains(&ag) {
            return Err(CliError::usage(format!("--ag {ag} g; allowed: 0.000001 to 10 g")));
        }
        sweep.acceleration_g = ag;
    }
    if !(1e-14..=1e-2).contains(&args.tolerance) {
        return Err(CliError::usage(format!("--tolerance {}; allowed: 1e-14 to 0.01", args.tolerance)));
    }
    Ok((model, Schedule::new(&sweep).map_err(CliError::usage)?))
}

/// Steps concatenated at phase 0.
fn ideal(
    model: &ModelSpec,
    schedule: &Schedule,
    options: &Options,
    mut columns: Option<&mut Columns>,
) -> Result<(Vec<StepPeaks>, f64), CliError> {
    let steps = schedule.steps();
    let response =
        simulate_sweep(model, steps, 1.0 / SAMPLE_RATE_HZ, options, &mut |_, index, a, response| {
            if let Some(columns) = columns.as_deref_mut() {
                let w = TAU * steps[index].frequency_hz;
                columns.push(-a / (w * w), a, index as i32, response);
            }
        })
        .map_err(CliError::usage)?;
    Ok((response.peaks, schedule.duration_s()))
}

/// The command with its ramps and transitions, sampled and held to first order.
fn smooth(
    model: &ModelSpec,
    schedule: &Schedule,
    options: &Options,
    mut columns: Option<&mut Columns>,
) -> Result<(Vec<StepPeaks>, f64), CliError> {
    let mut specimen: Box<dyn Specimen> =
        build_with(model, 1.0 / SAMPLE_RATE_HZ, options).map_err(CliError::usage)?;
    let mut generator = Generator::new(schedule, SAMPLE_RATE_HZ);
    let mut peaks = vec![StepPeaks::NONE; schedule.steps().len()];
    let mut samples = 0_usize;
    while !generator.is_done() {
        let point = generator.next_point();
        let a = point.command.acceleration_m_s2;
        let response = specimen.step(a);
        let counted = point.counted_step();
        if let (Some(phase), Ok(index)) = (&point.phase, usize::try_from(counted)) {
            let cycles = f64::from(schedule.steps()[index].cycles);
            if phase.phase_rad >= TAU * (cycles - crate::model::sweep::PEAK_CYCLES).max(0.0) - 1e-9 {
                peaks[index].take(&response);
            }
        }
        if let Some(columns) = columns.as_deref_mut() {
            columns.push(point.command.displacement_m, a, counted, &response);
        }
        samples += 1;
    }
    Ok((peaks, samples as f64 / SAMPLE_RATE_HZ))
}

/// The samples as a record, through the instruments of the model.
struct Columns {
    observer: Observer,
    record: Record,
}

impl Columns {
    fn new(model: &ModelSpec) -> Result<Self, CliError> {
        let observer = Observer::new(model, 1.0 / SAMPLE_RATE_HZ).map_err(CliError::usage)?;
        let source = format!("simulated: {}", model.name);
        Ok(Self { observer, record: Record::empty(source, Kind::Base, SAMPLE_RATE_HZ) })
    }

    fn push(&mut self, table_m: f64, table_m_s2: f64, step: i32, response: &Response) {
        let seen = self.observer.observe(response);
        let record = &mut self.record;
        record.time_s.push(record.time_s.len() as f64 / SAMPLE_RATE_HZ);
        record.table_displacement_m.push(table_m);
        record.table_acceleration_m_s2.push(table_m_s2);
        record.mass_acceleration_1_m_s2.push(seen.mass_acceleration_1_m_s2);
        record.mass_acceleration_2_m_s2.push(seen.mass_acceleration_2_m_s2);
        record.relative_displacement_m.push(seen.relative_displacement_m);
        record.step.push(step);
    }
}

fn report(args: &Args, steps: &[Step], peaks: &[StepPeaks], duration_s: f64, wall_s: f64) {
    if args.json {
        let steps: Vec<_> = steps
            .iter()
            .zip(peaks)
            .map(|(step, peak)| {
                serde_json::json!({
                    "index": step.index,
                    "direction": step.direction,
                    "frequency_hz": step.frequency_hz,
                    "a_max_m_s2": peak.a_max_m_s2,
                    "excursion_m": peak.excursion_m(),
                })
            })
            .collect();
        println!("{}", serde_json::json!({ "steps": steps, "duration_s": duration_s, "wall_s": wall_s }));
        return;
    }
    println!("step  direction  f (Hz)  A_max (m/s2)  E_max (mm)");
    for (step, peak) in steps.iter().zip(peaks) {
        let direction = match step.direction {
            Direction::Forward => "forward",
            Direction::Backward => "backward",
        };
        let (hz, a, e) = (step.frequency_hz, peak.a_max_m_s2, 1e3 * peak.excursion_m());
        println!("{:>4}  {direction:>9}  {hz:>6.2}  {a:>12.4}  {e:>10.4}", step.index);
    }
    eprintln!("{duration_s:.1} s of table time in {:.1} ms", 1e3 * wall_s);
}
