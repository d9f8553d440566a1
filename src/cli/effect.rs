//! `effect`: the catalogue, and effects into and out of model files.

use super::fitted::{
    print_errors, print_numbers, refuse_existing, refuse_invalid, refuse_unfit, write_model,
};
use super::reading::{ReadingArgs, read_model, say_new};
use super::{CliError, Outcome};
use crate::diagnose::adding::{self, Added};
use crate::model::effects::{self, CATALOGUE, Effect};
use crate::model::{EffectSpec, ModelSpec, Scales, build};
use crate::record::mended::mended;
use crate::units::SAMPLE_RATE_HZ;
use std::f64::consts::TAU;
use std::path::PathBuf;

/// List, show, add or remove effects of a model.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(clap::Subcommand)]
enum Action {
    /// List the catalogue
    List {
        /// Print one JSON object
        #[arg(long)]
        json: bool,
    },
    /// Show one effect: equation, source, parameters with priors, and its force
    Show {
        /// Name, as in the list
        name: String,
        /// Model whose magnitudes set priors and starting values, by name or file
        #[arg(long, default_value = "andreaus-2020-b1-g2")]
        model: String,
        /// Print one JSON object
        #[arg(long)]
        json: bool,
    },
    /// Add an effect to a model and write a new model file
    Add {
        /// Name, as in the list
        name: String,
        /// Model, by name or file
        #[arg(long)]
        model: String,
        /// Model file to write
        #[arg(short, long)]
        output: PathBuf,
        /// A parameter as name=value; those left out get their starting values. A fit starts there
        #[arg(long = "param", value_parser = parse_parameter)]
        parameters: Vec<(String, f64)>,
        /// The expression of an `expression` effect
        #[arg(long)]
        expression: Option<String>,
        /// Fit the parameters, and the model's own numbers with them, to this record (run folder or
        /// data file)
        #[arg(long, value_name = "RECORD")]
        fit: Option<PathBuf>,
        #[command(flatten)]
        reading: ReadingArgs,
        /// Fit to a record that is too short, saturated, of wrong sign or unit, ... all the same
        #[arg(long, requires = "fit")]
        anyway: bool,
        /// Replace an existing file
        #[arg(long)]
        force: bool,
        /// Print one JSON object
        #[arg(long)]
        json: bool,
    },
    /// Remove an effect from a model and write a new model file
    Remove {
        /// Name, as in the list; the last one of that name goes
        name: String,
        /// Model, by name or file
        #[arg(long)]
        model: String,
        /// Model file to write
        #[arg(short, long)]
        output: PathBuf,
        /// Replace an existing file
        #[arg(long)]
        force: bool,
    },
}

/// Does what was asked.
///
/// # Errors
/// [`CliError::Usage`] for unknown names and refused models, [`CliError::Failed`] when a file cannot
/// be written.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    match args.action {
        Action::List { json } => list(json),
        Action::Show { name, model, json } => {
            show(effects::find(&name).map_err(CliError::usage)?, &read_model(&model)?, json)?;
        }
        Action::Add { name, model, output, parameters, expression, fit, reading, anyway, force, json } => {
            refuse_existing(&output, force)?;
            let nominal = read_model(&model)?;
            let scales = Scales::of_spec(&nominal, 1.0 / SAMPLE_RATE_HZ);
            let mut spec = effects::find(&name).map_err(CliError::usage)?.starting_spec(&scales);
            spec.parameters.extend(parameters.iter().cloned());
            spec.expression = expression;
            let mut model = nominal.clone();
            model.effects.push(spec.clone());
            refuse_invalid(&model)?;
            let given: Vec<&str> = parameters.iter().map(|(name, _)| name.as_str()).collect();
            let added = match fit {
                None => None,
                Some(record) => {
                    let record = reading.of(record).open()?;
                    refuse_unfit(&mended(&record), &nominal, anyway)?;
                    let added = adding::add(&record, &nominal, &spec, &given).map_err(CliError::failed)?;
                    say_new(&added.notes, &record);
                    Some(added)
                }
            };
            if let Some(added) = &added {
                model = added.model.clone();
            }
            model.name = format!("{}+{name}", nominal.name);
            write_model(&model, &output)?;
            report(&model, added.as_ref(), json);
        }
        Action::Remove { name, model, output, force } => {
            let mut model = read_model(&model)?;
            let Some(index) = model.effects.iter().rposition(|effect| effect.name == name) else {
                let has: Vec<_> = model.effects.iter().map(|effect| effect.name.as_str()).collect();
                return Err(CliError::usage(format!(
                    "{} has no effect `{name}`; it has: {}",
                    model.name,
                    has.join(", ")
                )));
            };
            model.effects.remove(index);
            model.name = model.name.replacen(&format!("+{name}"), "", 1);
            refuse_existing(&output, force)?;
            write_model(&model, &output)?;
        }
    }
    Ok(Outcome::Done)
}

fn parse_parameter(text: &str) -> Result<(String, f64), String> {
    let (name, value) = text.split_once('=').ok_or_else(|| format!("`{text}`; wanted: name=value"))?;
    let value = value.trim().parse().map_err(|_| format!("`{value}` is not a number"))?;
    Ok((name.trim().to_owned(), value))
}

/// What a fit found; nothing to say without one unless JSON is wanted.
fn report(model: &ModelSpec, added: Option<&Added>, json: bool) {
    if json {
        let fit = added.map(|added| {
            serde_json::json!({
                "parameters": added.parameters, "error_before": added.error_before,
                "error_reidentified": added.error_reidentified, "error_after": added.error_after,
                "noise_floor": added.noise_floor, "notes": added.notes,
            })
        });
        println!("{}", serde_json::json!({ "model": model, "fit": fit }));
        return;
    }
    let Some(added) = added else { return };
    print_numbers(&added.parameters);
    print_errors(&[
        ("as given", added.error_before),
        ("re-fitted without the effect", added.error_reidentified),
        ("with it", added.error_after),
        ("noise floor", added.noise_floor),
    ]);
}

fn list(json: bool) {
    if json {
        let entries: Vec<_> = CATALOGUE
            .iter()
            .map(|e| serde_json::json!({ "name": e.name, "place": e.place, "equation": e.equation, "piecewise_linear": e.piecewise_linear }))
            .collect();
        println!("{}", serde_json::json!({ "effects": entries }));
        return;
    }
    for effect in CATALOGUE {
        println!(
            "{:<24}{:<12}{}",
            effect.name,
            format!("{:?}", effect.place).to_lowercase(),
            effect.equation
        );
    }
}

fn show(effect: &Effect, model: &ModelSpec, json: bool) -> Result<(), CliError> {
    let scales = Scales::of_spec(model, 1.0 / SAMPLE_RATE_HZ);
    let parameters = (effect.parameters)(&scales);
    if json {
        let entry = serde_json::json!({
            "name": effect.name, "place": effect.place, "equation": effect.equation, "source": effect.source,
            "states": effect.states, "regime": effect.regime, "shows": effect.shows,
            "experiment": effect.experiment, "piecewise_linear": effect.piecewise_linear, "parameters": parameters,
        });
        println!("{entry}");
        return Ok(());
    }
    println!("{} ({})", effect.name, format!("{:?}", effect.place).to_lowercase());
    for (label, text) in [
        ("equation", effect.equation),
        ("source", effect.source),
        ("states", effect.states),
        ("regime", effect.regime),
        ("shows", effect.shows),
        ("experiment", effect.experiment),
    ] {
        if !text.is_empty() {
            println!("  {label:<11}{text}");
        }
    }
    for p in &parameters {
        let (low, high) = p.prior;
        let optional = if p.default.is_some() { ", may be left out" } else { "" };
        println!(
            "  {:<16}{} ({}): {low:.3e} to {high:.3e}, starts at {:.3e}{optional}",
            p.name, p.about, p.unit, p.start
        );
    }
    if let Some(rows) = loop_plot(effect, model, &scales)? {
        println!("\n  force of the effect against D, two cycles of growing motion");
        rows.iter().for_each(|row| println!("  |{row}|"));
    }
    Ok(())
}

/// The force that the effect adds along a motion that grows over two cycles, as rows of characters;
/// `None` when it adds none (instruments).
fn loop_plot(effect: &Effect, model: &ModelSpec, scales: &Scales) -> Result<Option<Vec<String>>, CliError> {
    const WIDTH: usize = 61;
    const HEIGHT: usize = 17;
    if effect.is_instrument() || effect.name == "expression" {
        return Ok(None);
    }
    let mut with = model.clone();
    let spec: EffectSpec = effect.starting_spec(scales);
    with.effects.push(spec);
    let rate_hz = 400.0 * scales.frequency_hz;
    let build = |spec: &ModelSpec| build(spec, 1.0 / rate_hz).map_err(CliError::usage);
    let (mut without, mut with) = (build(model)?, build(&with)?);
    let points: Vec<(f64, f64)> = (0..800)
        .map(|i| {
            let part = f64::from(i) / 800.0;
            let (sin, cos) = (2.0 * TAU * part).sin_cos();
            let d = scales.displacement_m * part * sin;
            let v = scales.displacement_m * (sin / 800.0 + part * cos * 2.0 * TAU / 800.0) * rate_hz;
            let force = |a: f64| -a * model.mass_kg;
            let plain = force(without.impose(d, v).mass_acceleration_m_s2);
            (d, force(with.impose(d, v).mass_acceleration_m_s2) - plain)
        })
        .collect();
    let reach = |f: fn(&(f64, f64)) -> f64| points.iter().map(f).fold(0.0_f64, |m, x| m.max(x.abs()));
    let (far, high) = (reach(|p| p.0), reach(|p| p.1));
    if high.is_nan() || high <= 0.0 {
        return Ok(None);
    }
    let mut rows = vec![vec![' '; WIDTH]; HEIGHT];
    for (d, f) in points {
        let column = ((d / far + 1.0) * 0.5 * (WIDTH - 1) as f64).round() as usize;
        let row = ((1.0 - f / high) * 0.5 * (HEIGHT - 1) as f64).round() as usize;
        rows[row.min(HEIGHT - 1)][column.min(WIDTH - 1)] = '*';
    }
    Ok(Some(rows.into_iter().map(String::from_iter).collect()))
}
