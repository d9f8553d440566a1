//! `bench diagnose`: a whole sweep through the whole catalogue, and how long each part of it takes.

use super::PAPERS_MODEL;
use super::compare::sweep;
use crate::cli::reading::read_model;
use crate::cli::{CliError, Outcome, parts};
use crate::diagnose::{Options, diagnose};
use crate::model::{Scales, effects};
use crate::units::SAMPLE_RATE_HZ;
use rustix::time::{ClockId, clock_gettime};
use serde_json::{Map, Value, json};
use std::sync::{Arc, Mutex};
use std::time::Instant;

/// What the specimen of each sweep carries.
#[derive(Debug, clap::Args)]
pub struct DiagnoseArgs {
    /// Hidden effects, one sweep for each, with their starting values; `none` for a model that lacks nothing.
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "none,cubic-stiffness,coulomb-friction,maxwell-branch,hertz-contact,bouc-wen-hysteresis"
    )]
    effects: Vec<String>,
}

/// Seconds of every part, and those of all cores together, in the order in which they first ended.
struct Watch {
    times: Vec<(String, [f64; 2])>,
    last: (Instant, f64),
}

/// Now, and how long the cores have worked for this process, s.
fn now() -> (Instant, f64) {
    let worked = clock_gettime(ClockId::ProcessCPUTime);
    (Instant::now(), worked.tv_sec as f64 + 1e-9 * worked.tv_nsec as f64)
}

impl Watch {
    /// Adds up what the parts of a diagnosis take.
    fn ended(&mut self, part: String) {
        let now = now();
        let last = std::mem::replace(&mut self.last, now);
        let passed = [(now.0 - last.0).as_secs_f64(), now.1 - last.1];
        match self.times.iter_mut().find(|(name, _)| *name == part) {
            Some((_, sums)) => sums.iter_mut().zip(passed).for_each(|(sum, s)| *sum += s),
            None => self.times.push((part, passed)),
        }
    }
}

/// Times a diagnosis of the paper's sweep (B1-G2 at 0.05 g) with the noise of the sensors for each hidden effect.
///
/// # Errors
/// [`CliError::Usage`] for an effect that is not in the catalogue; a diagnosis that fails.
pub fn execute(args: &DiagnoseArgs, json: bool) -> Result<Outcome, CliError> {
    let model = read_model(PAPERS_MODEL)?;
    let scales = Scales::of_spec(&model, 1.0 / SAMPLE_RATE_HZ);
    // A name that is not known is refused before any time is spent.
    let mut specimens = Vec::with_capacity(args.effects.len());
    for name in &args.effects {
        let mut specimen = model.clone();
        if name != "none" {
            specimen.effects.push(effects::find(name).map_err(CliError::usage)?.starting_spec(&scales));
        }
        specimens.push((name, specimen));
    }
    let mut told = Vec::new();
    for (name, specimen) in specimens {
        let record = sweep(&specimen)?;
        let watch = Arc::new(Mutex::new(Watch { times: Vec::new(), last: now() }));
        let on_watch = Arc::clone(&watch);
        let ended = move |news| {
            if let (parts::News::Done(part), Ok(mut watch)) = (news, on_watch.lock()) {
                watch.ended(part);
            }
        };
        let found = parts::told(ended, || diagnose(&record, &model, &Options::default()));
        let found = found.map_err(CliError::failed)?;
        let said = found.effects.iter().map(|effect| effect.name.as_str()).collect::<Vec<_>>().join(" + ");
        let said = if said.is_empty() { found.verdict.name().to_owned() } else { said };
        let times = watch.lock().map(|mut watch| std::mem::take(&mut watch.times)).unwrap_or_default();
        if json {
            let mut figures = Map::new();
            figures.insert("hidden".to_owned(), name.clone().into());
            figures.insert("said".to_owned(), said.into());
            figures.insert("samples".to_owned(), record.len().into());
            figures.insert("diagnose_s".to_owned(), found.wall_s.into());
            for (key, which) in [("parts_s", 0), ("parts_of_all_cores_s", 1)] {
                let parts = times.iter().map(|(part, seconds)| (part.clone(), seconds[which].into()));
                figures.insert(key.to_owned(), Value::Object(parts.collect()));
            }
            told.push(Value::Object(figures));
            continue;
        }
        println!("hidden {name}, said {said}: {} samples, {:.2} s", record.len(), found.wall_s);
        for (part, [seconds, worked]) in &times {
            println!("  {part:<32} {seconds:>6.2} s, of all cores {worked:>6.2} s");
        }
    }
    if json {
        println!("{}", json!({ "sweeps": told }));
    }
    Ok(Outcome::Done)
}
