//! Study of the diagnosis on records with a hidden effect: makes cases from seeds, diagnoses each,
//! prints one line a case (tab separated), with the effects' numbers whose 95 % interval does not hold the truth, and a summary:
//! verdicts, how many intervals hold the truth where it was named, number by number,
//! held-out error over noise floor, how often what was named is there by its probability. With `--told true` wrong verdicts are
//! laid beside the specimen itself; with `--shaking noise` the table moves as in an earthquake, with `--sensors laser-alone` fewer see the mass; `--save FOLDER` leaves
//! there what `shaketable diagnose` takes: each record, its nominal model, and the specimen. Studies: `blind`, `healthy`,
//! `outside`, `pairs`, and `removed`, where the effect and its twin are taken out of the catalogue. Never quote seeds that were
//! developed on.
//!
//! `cargo run --release -p hil-tests --example hidden -- blind --seeds 1000..1200 --size 0.05 --noise 1`

use hil_tests::arguments;
use hil_tests::hidden::{self, Hidden, Recipe, Sensors, Shaking};
use shaketable::diagnose::report::{NamedEffect, ParameterEstimate};
use shaketable::diagnose::search::{Effort, Searcher};
use shaketable::diagnose::thresholds::Thresholds;
use shaketable::diagnose::trial::Trial;
use shaketable::diagnose::verdict;
use shaketable::diagnose::{Diagnosis, Options, Verdict, candidates, diagnose};
use shaketable::identify::kinematics::Tolerances;
use shaketable::identify::motion::Motion;
use shaketable::model::effects;
use shaketable::record::data::{self, Format};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Limits of the probabilities that are counted together.
const BINS: [f64; 5] = [0.0, 0.5, 0.9, 0.99, 1.1];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1);
    let study = words.next().unwrap_or_else(|| "blind".to_owned());
    let (mut seeds, mut size, mut noise, mut only) = (0..20u64, 0.05, 1.0, None);
    let (mut verbose, mut told, mut shaking, mut sensors) = (false, false, Shaking::Sweep, Sensors::All);
    let mut save: Option<PathBuf> = None;
    arguments::each(words, |word, value| {
        match word {
            "--seeds" => seeds = arguments::seeds(&value)?,
            "--size" => size = value.parse()?,
            "--noise" => noise = value.parse()?,
            "--verbose" => verbose = value.parse()?,
            "--told" => told = value.parse()?,
            "--shaking" => {
                shaking = match value.as_str() {
                    "sweep" => Shaking::Sweep,
                    "noise" => Shaking::Noise,
                    _ => return Err(format!("--shaking {value}: sweep or noise").into()),
                };
            }
            "--sensors" => {
                sensors = match value.as_str() {
                    "all" => Sensors::All,
                    "one-accelerometer" => Sensors::OneAccelerometer,
                    "accelerometer-alone" => Sensors::AccelerometerAlone,
                    "laser-alone" => Sensors::LaserAlone,
                    _ => {
                        let known = "all, one-accelerometer, accelerometer-alone or laser-alone";
                        return Err(format!("--sensors {value}: {known}").into());
                    }
                };
            }
            "--only" => only = Some(value),
            "--save" => save = Some(PathBuf::from(value)),
            _ => return Ok(false),
        }
        Ok(true)
    })?;
    let removed = study == "removed";
    let all = if removed || sensors != Sensors::All { hidden::of_motion() } else { hidden::studied() };
    let mut tally: BTreeMap<&str, usize> = BTreeMap::new();
    let mut cases = 0;
    let mut over_floor: Vec<f64> = Vec::new();
    // Of the model's own numbers and of the effects', in standard deviations.
    let mut deviations: [BTreeMap<String, Vec<f64>>; 2] = Default::default();
    // Probability of each effect that was named, and whether the specimen has it.
    let mut said: Vec<(f64, bool)> = Vec::new();
    for seed in seeds {
        let effects: Vec<&'static str> = match (study.as_str(), &only) {
            ("healthy" | "outside", _) => vec![],
            ("pairs", _) => hidden::pair(seed),
            (_, Some(name)) => vec![effects::find(name)?.name],
            _ => vec![all[seed as usize % all.len()]],
        };
        let foreign = (study == "outside").then_some(seed as usize % hidden::FOREIGN.len());
        let recipe = Recipe { seed, effects: effects.clone(), foreign, size, noise, shaking, sensors };
        let Some(case) = hidden::make(&recipe) else {
            println!("{seed}\t{}\tnot reached", effects.join("+"));
            continue;
        };
        cases += 1;
        if let Some(folder) = &save {
            let models = [("nominal", &case.nominal), ("specimen", &case.truth)];
            for (name, model) in models {
                std::fs::write(folder.join(format!("{seed}-{name}.toml")), toml::to_string(model)?)?;
            }
            data::write(&case.record, &folder.join(format!("{seed}.parquet")), Format::Parquet)?;
        }
        let options = Options {
            without: if removed { hidden::with_twin(effects[0]) } else { vec![] },
            ..Options::default()
        };
        let found = match diagnose(&case.record, &case.nominal, &options) {
            Ok(found) => found,
            Err(error) => {
                println!("{seed}\t{}\terror: {error}", effects.join("+"));
                *tally.entry("error").or_default() += 1;
                continue;
            }
        };
        let named: Vec<String> =
            found.effects.iter().map(|e| format!("{} {:.2}", e.name, e.probability)).collect();
        let first = found.effects.first().map(|e| e.name.as_str());
        let right = match found.verdict {
            Verdict::Adequate => effects.is_empty() && foreign.is_none(),
            Verdict::OutsideCatalogue => foreign.is_some() || removed,
            _ if removed => false,
            _ => {
                !effects.is_empty()
                    && effects
                        .iter()
                        .all(|name| found.effects.iter().take(effects.len()).any(|e| e.name == *name))
            }
        };
        let second = right
            || first.is_some()
                && !effects.is_empty()
                && effects.iter().all(|name| {
                    found.effects.iter().any(|e| e.name == *name)
                        || found.ambiguous_with.iter().any(|a| a == name)
                });
        *tally
            .entry(if right {
                "right"
            } else if second {
                "among the first two"
            } else {
                "wrong"
            })
            .or_default() += 1;
        *tally.entry(found.verdict.name()).or_default() += 1;
        said.extend(found.effects.iter().map(|e| (e.probability, effects.contains(&e.name.as_str()))));
        if right {
            if verbose {
                tell_numbers(&found, &case);
            }
            tell_effects(&found, &case, verbose);
            let of = [base_intervals(&found, &case), effect_intervals(&found, &case)];
            for (deviations, of) in deviations.iter_mut().zip(of) {
                of.into_iter().for_each(|(key, off)| deviations.entry(key).or_default().push(off));
            }
            over_floor.push(found.error_after / found.noise_floor);
        }
        if !right || verbose || found.effects.len() > effects.len().max(1) {
            println!("\t\tspecimen: {:?}", case.truth.effects);
            for refused in found.refused.iter().take(6) {
                println!("\t\t{}: {}", refused.name, refused.reason);
            }
            if told {
                tell(&case, &effects);
            }
        }
        println!(
            "{seed}\t{}\t{}\t{}\t[{}]\t~[{}]\tbefore {:.4} refit {:.4} after {:.4} floor {:.4} left {:.3} structure {:.4}\t{:.1} s\t{}",
            if right {
                "ok"
            } else if second {
                "2nd"
            } else {
                "WRONG"
            },
            foreign.map_or_else(|| effects.join("+"), |number| hidden::FOREIGN[number].0.to_owned()),
            found.verdict.name(),
            named.join(", "),
            found.ambiguous_with.join(", "),
            found.error_before,
            found.error_reidentified,
            found.error_after,
            found.noise_floor,
            found.share_left,
            found.structure_left.unwrap_or(f64::NAN),
            found.wall_s,
            case.nominal.bumper.as_ref().map_or("none".into(), |b| format!(
                "{:.0}/{:.0} mm",
                b.stiffness_n_m / 1e3,
                b.total_gap_m * 1e3
            )),
        );
    }
    println!("{cases} cases: {tally:?}");
    for bin in BINS.windows(2) {
        let of: Vec<bool> =
            said.iter().filter(|(p, _)| (bin[0]..bin[1]).contains(p)).map(|(_, there)| *there).collect();
        let there = of.iter().filter(|there| **there).count();
        println!(
            "named with a probability from {} to {}: {there} of {} are there",
            bin[0],
            bin[1].min(1.0),
            of.len()
        );
    }
    let [base, effect] = deviations.map(|deviations| {
        let mut together = Coverage::default();
        for (key, off) in &deviations {
            let rms = (off.iter().map(|x| x * x).sum::<f64>() / off.len() as f64).sqrt();
            let mut of_key = Coverage::default();
            off.iter().for_each(|off| of_key.count(holds(*off)));
            together = Coverage { inside: together.inside + of_key.inside, all: together.all + of_key.all };
            println!("{key}: {of_key} intervals hold the truth; rms {rms:.2} standard deviations");
        }
        together
    });
    over_floor.sort_by(f64::total_cmp);
    let quantile =
        |q: f64| over_floor.get((q * over_floor.len() as f64) as usize).copied().unwrap_or(f64::NAN);
    println!(
        "95 % intervals that hold the truth where it was named: model {base}, effects {effect}; \
         held-out error over noise floor: median {:.3}, nine in ten below {:.3}",
        quantile(0.5),
        quantile(0.9),
    );
    Ok(())
}

/// What a fit that starts at the specimen itself brings, beside what the search found: nats over the specimen. Tells a
/// fit that did not arrive from a record that does not tell.
fn tell(case: &Hidden, effects: &[&'static str]) {
    let Ok(motion) = Motion::of(&case.record, case.nominal.mass_kg, Tolerances::default()) else { return };
    let searcher = Searcher::new(&motion, &case.nominal, Effort::default());
    let Some(base) = searcher.base(&case.nominal) else { return };
    let search = searcher.search(base, Thresholds::default());
    let base = &search.base;
    let mut itself = base.clone();
    itself.names = effects.iter().map(|name| (*name).to_owned()).collect();
    itself.refit.spec = case.truth.clone();
    let scales = candidates::scales(&base.refit.spec, &motion);
    for index in 0..case.truth.effects.len() {
        itself.refit.numbers.add_effect(&case.truth, index, &scales);
    }
    let mut exactly = itself.clone();
    exactly.refit.numbers = Default::default();
    let (itself, exactly) = (searcher.finish(&itself), searcher.finish(&exactly));
    println!("\t\t{:?} {:?}", case.truth.isolator, case.truth.bumper);
    let against = exactly.as_ref().unwrap_or(base);
    let line = |trial: &Trial| {
        println!(
            "\t\t  {:?}: {:.1} nats ({:.1} on held-out steps, freedom {:.1}), excess {:.4}, colour {:.2}, zero {:.1e}, {:?}",
            trial.names,
            verdict::apart(trial, against),
            verdict::gain(trial, against),
            trial.response.as_ref().map_or(0.0, |r| r.freedom_nats),
            trial.excess(),
            trial.response.as_ref().map_or(0.0, |r| r.colour()),
            trial.refit.zero_m,
            trial.response.as_ref().map_or(&trial.refit.fit.values, |r| &r.training.values),
        );
    };
    println!("\t\tover the specimen itself: that, its numbers fitted, the base model and what was found:");
    exactly.iter().chain(&itself).for_each(line);
    line(base);
    search.stages.iter().flat_map(|stage| &stage.finalists).for_each(line);
    println!("\t\t  shapes: {:?}", searcher.shaped(base, search.best(), Thresholds::default()));
    for trial in [base, search.best()] {
        let shape =
            searcher.shape_left(trial, Thresholds::default()).map(|shape| (shape.expression, shape.nats));
        println!("\t\t  beside {:?}: {shape:?}", trial.names);
    }
}

/// The model's own numbers beside the truth.
fn tell_numbers(found: &Diagnosis, case: &Hidden) {
    found.notes.iter().for_each(|note| println!("\t\t{note}"));
    for number in &found.reidentified {
        let (value, half) = (number.value, 0.5 * (number.high95 - number.low95));
        if let Ok(truth) = case.truth.get(&number.key) {
            println!("\t\t{} {value:.6e} +- {half:.1e}, is {truth:.6e} ({:+.1e})", number.key, value - truth);
        }
    }
}

/// The same of the effects' own, with how many standard deviations they are off: of all, or those alone that are off.
fn tell_effects(found: &Diagnosis, case: &Hidden, all: bool) {
    for (named, name, p, truth) in beside_truth(found, case) {
        let off = off(p.value, (p.low95, p.high95), truth);
        if all || !holds(off) {
            println!(
                "\t\t{}.{name} {:.4e} ({:.4e} to {:.4e}), is {truth:.4e} ({off:+.1} standard deviations)",
                named.name, p.value, p.low95, p.high95
            );
        }
    }
}

/// The parameters of the effects that are there and were named, each with its name and the truth.
fn beside_truth<'a>(
    found: &'a Diagnosis,
    case: &'a Hidden,
) -> impl Iterator<Item = (&'a NamedEffect, &'a String, &'a ParameterEstimate, f64)> {
    let hidden = |name: &str| case.truth.effects.iter().find(|effect| effect.name == name);
    let pairs = found.effects.iter().filter_map(move |named| Some((named, hidden(&named.name)?)));
    pairs.flat_map(|(named, hidden)| {
        let truth = |name: &String| hidden.parameters.get(name).copied();
        named.parameters.iter().filter_map(move |(name, p)| Some((named, name, p, truth(name)?)))
    })
}

/// Intervals that hold the truth, of how many.
#[derive(Default)]
struct Coverage {
    inside: usize,
    all: usize,
}

impl Coverage {
    fn count(&mut self, inside: bool) {
        self.inside += usize::from(inside);
        self.all += 1;
    }
}

impl std::fmt::Display for Coverage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} of {}", self.inside, self.all)
    }
}

/// How far each of the model's own numbers is from the truth, in standard deviations as its interval has them.
fn base_intervals(found: &Diagnosis, case: &Hidden) -> Vec<(String, f64)> {
    let own = found.reidentified.iter().filter(|n| !n.key.starts_with("effect["));
    own.filter_map(|n| {
        let truth = case.truth.get(&n.key).ok()?;
        Some((n.key.clone(), off(n.value, (n.low95, n.high95), truth)))
    })
    .collect()
}

/// How many standard deviations a value is from the truth, as the side of its interval has them that the truth is on.
fn off(value: f64, (low95, high95): (f64, f64), truth: f64) -> f64 {
    1.96 * (value - truth) / if truth < value { value - low95 } else { high95 - value }
}

/// Whether a 95 % interval holds the truth that is so many of its standard deviations off.
fn holds(off: f64) -> bool {
    off.abs() <= 1.96
}

/// The same of the parameters of the effects that were named rightly.
fn effect_intervals(found: &Diagnosis, case: &Hidden) -> Vec<(String, f64)> {
    let off = |(named, name, p, truth): (&NamedEffect, &String, &ParameterEstimate, f64)| {
        (format!("{}.{name}", named.name), off(p.value, (p.low95, p.high95), truth))
    };
    beside_truth(found, case).map(off).collect()
}
